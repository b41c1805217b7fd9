/* Host tests of the core and the shell; the Python side drives the core again, against its codec. */
#include "m3pi_shell.h"

#include <stdio.h>
#include <string.h>

static int failures;

#define CHECK(what)                                                      \
    do {                                                                 \
        if (!(what)) {                                                   \
            printf("%s:%d: %s: %s\n", __FILE__, __LINE__, __func__, #what); \
            failures++;                                                  \
        }                                                                \
    } while (0)

static uint16_t crc16(const uint8_t *data, size_t length) /* by nibbles: not the core's way */
{
    unsigned crc = 0xFFFFu;
    for (size_t i = 0; i < length; i++) {
        unsigned x = ((crc >> 8) ^ data[i]) & 0xFFu;
        x ^= x >> 4;
        crc = ((crc << 8) ^ (x << 12) ^ (x << 5) ^ x) & 0xFFFFu;
    }
    return (uint16_t)crc;
}

static size_t stuff(const uint8_t *data, size_t length, uint8_t *out)
{
    size_t code = 0, at = 1;
    for (size_t i = 0; i < length; i++) {
        if (data[i] != 0) {
            out[at++] = data[i];
        } else {
            out[code] = (uint8_t)(at - code);
            code = at++;
        }
    }
    out[code] = (uint8_t)(at - code);
    out[at++] = 0;
    return at;
}

/* One robot's frame for index 0, or `robots` times the same wheels. */
static size_t make(uint8_t *out, uint8_t sequence, uint8_t flags, uint8_t robots, int8_t left,
                   int8_t right)
{
    uint8_t body[M3PI_FRAME_MAX + 8] = {0x51, sequence, flags, robots};
    size_t size = 4;
    for (uint8_t i = 0; i < robots; i++) {
        body[size++] = (uint8_t)left;
        body[size++] = (uint8_t)right;
    }
    const uint16_t crc = crc16(body, size);
    body[size++] = (uint8_t)(crc & 0xFFu);
    body[size++] = (uint8_t)(crc >> 8);
    return stuff(body, size, out);
}

/* A robot that was switched on long ago; the times of a test begin at 0. */
static void switch_on(m3pi_core *core, uint8_t index)
{
    m3pi_init(core, index);
    (void)m3pi_status(core, M3PI_FORGET_MS);
}

static m3pi_event push(m3pi_core *core, const uint8_t *data, size_t length, uint32_t now)
{
    m3pi_event last = M3PI_NOTHING;
    for (size_t i = 0; i < length; i++) {
        last = m3pi_push(core, data[i], now);
    }
    return last;
}

static m3pi_event send(m3pi_core *core, uint8_t sequence, uint8_t flags, int8_t left, int8_t right,
                       uint32_t now)
{
    uint8_t frame[128];
    return push(core, frame, make(frame, sequence, flags, 1, left, right), now);
}

static bool drives(m3pi_core *core, uint32_t now, int left, int right)
{
    int8_t l, r;
    m3pi_wheels(core, now, &l, &r);
    return l == left && r == right;
}

static void test_documented_frame(void)
{
    const uint8_t frame[] = {0x09, 0x51, 0x07, 0x01, 0x03, 0x40, 0xC0,
                             0x7F, 0x7F, 0x01, 0x01, 0x02, 0x7D, 0x00};
    const int wheels[4][2] = {{64, -64}, {127, 127}, {0, 0}, {0, 0}};
    for (uint8_t index = 0; index < 4; index++) {
        m3pi_core core;
        switch_on(&core, index);
        CHECK(drives(&core, 0, 0, 0));
        CHECK(push(&core, frame, sizeof frame, 1000) == M3PI_ACCEPTED);
        CHECK(drives(&core, 1000, wheels[index][0], wheels[index][1]));
        CHECK(m3pi_status(&core, 1000) == (index < 3 ? M3PI_STATUS_RUNNING : 0));
    }
}

static void test_damaged_frames_change_nothing(void)
{
    uint8_t frame[128], bad[128];
    const size_t size = make(frame, 8, M3PI_FLAG_RUN, 1, 20, 30);
    for (size_t at = 0; at + 1 < size; at++) {
        for (unsigned bit = 0; bit < 8; bit++) {
            m3pi_core core;
            switch_on(&core, 0);
            CHECK(send(&core, 7, M3PI_FLAG_RUN, 5, 6, 0) == M3PI_ACCEPTED);
            memcpy(bad, frame, size);
            bad[at] = (uint8_t)(bad[at] ^ (1u << bit));
            CHECK(push(&core, bad, size, 1) == M3PI_REJECTED);
            CHECK(drives(&core, 1, 5, 6));
            CHECK(send(&core, 8, M3PI_FLAG_RUN, 7, 8, 2) == M3PI_ACCEPTED); /* resynchronised */
            CHECK(drives(&core, 2, 7, 8));
        }
    }
}

static void test_malformed_frames(void)
{
    uint8_t frame[256], flood[1000];
    m3pi_core core;
    switch_on(&core, 0);
    CHECK(send(&core, 1, 8, 5, 5, 0) == M3PI_REJECTED);    /* unknown flag */
    CHECK(send(&core, 1, 1, -128, 5, 0) == M3PI_REJECTED); /* no count */
    CHECK(push(&core, frame, make(frame, 1, 1, 33, 1, 1), 0) == M3PI_REJECTED);
    memset(flood, 0x55, sizeof flood);
    CHECK(push(&core, flood, sizeof flood, 0) == M3PI_NOTHING);
    CHECK(m3pi_push(&core, 0, 0) == M3PI_REJECTED);
    CHECK(m3pi_push(&core, 0, 0) == M3PI_NOTHING);
    CHECK(push(&core, frame, make(frame, 1, 1, 32, 9, 9), 0) == M3PI_ACCEPTED);
    CHECK(drives(&core, 0, 9, 9));
}

static void test_watchdog(void)
{
    m3pi_core core;
    switch_on(&core, 0);
    CHECK(m3pi_status(&core, 0) == M3PI_STATUS_SILENT);
    (void)send(&core, 1, M3PI_FLAG_RUN, 50, 60, 1000);
    CHECK(drives(&core, 1249, 50, 60));
    CHECK(drives(&core, 1250, 0, 0));
    CHECK(m3pi_status(&core, 1250) == M3PI_STATUS_SILENT);
    CHECK(drives(&core, 1001, 0, 0)); /* a clock that goes back does not wake it */
    CHECK(drives(&core, 1000u + 0x80000000u, 0, 0));
    (void)send(&core, 2, M3PI_FLAG_RUN, 50, 60, UINT32_MAX - 99); /* across the wrap */
    CHECK(drives(&core, 149, 50, 60));
    CHECK(drives(&core, 150, 0, 0));
}

static void test_sequence(void)
{
    m3pi_core core;
    switch_on(&core, 0);
    CHECK(send(&core, 250, M3PI_FLAG_RUN, 1, 1, 0) == M3PI_ACCEPTED);
    CHECK(send(&core, 250, M3PI_FLAG_RUN, 2, 2, 100) == M3PI_STALE); /* duplicate */
    CHECK(send(&core, 249, M3PI_FLAG_RUN, 2, 2, 100) == M3PI_STALE); /* old */
    CHECK(send(&core, 122, M3PI_FLAG_RUN, 2, 2, 100) == M3PI_STALE); /* 128 ahead: old */
    CHECK(drives(&core, 249, 1, 1));
    CHECK(drives(&core, 250, 0, 0)); /* stale frames did not feed the watchdog */
    switch_on(&core, 0);
    CHECK(send(&core, 250, M3PI_FLAG_RUN, 1, 1, 0) == M3PI_ACCEPTED);
    CHECK(send(&core, 121, M3PI_FLAG_RUN, 2, 2, 1) == M3PI_ACCEPTED); /* 127 ahead, wrapped */
    CHECK(drives(&core, 1, 2, 2));
    CHECK(send(&core, 3, M3PI_FLAG_RUN, 3, 3, 200) == M3PI_STALE); /* controller restarts ... */
    CHECK(send(&core, 4, M3PI_FLAG_RUN, 3, 3, 1000) == M3PI_STALE);
    CHECK(send(&core, 5, M3PI_FLAG_RUN, 3, 3, 1001) == M3PI_ACCEPTED); /* ... taken up here */
    CHECK(drives(&core, 1001, 3, 3));
    CHECK(send(&core, 1, 0, 9, 9, 1002) == M3PI_STALE); /* a stop is obeyed, even an old one */
    CHECK(drives(&core, 1002, 0, 0));
    CHECK(send(&core, 6, M3PI_FLAG_RUN, 4, 4, 1003) == M3PI_ACCEPTED);
    CHECK(drives(&core, 1003, 4, 4));
}

/* Regression: a frame that the radio delivered late drove a robot that the watchdog had stopped. */
static void test_a_late_frame_does_not_drive_a_robot_that_stands(void)
{
    m3pi_core core;
    switch_on(&core, 0);
    CHECK(send(&core, 7, M3PI_FLAG_RUN, 9, 9, 5000) == M3PI_ACCEPTED);
    CHECK(send(&core, 9, 0, 0, 0, 5100) == M3PI_ACCEPTED);
    CHECK(send(&core, 8, M3PI_FLAG_RUN, 9, 9, 5800) == M3PI_STALE); /* sent before the stop */
    CHECK(send(&core, 8, 0, 0, 0, 5900) == M3PI_STALE);             /* its number is not taken */
    CHECK(send(&core, 9, M3PI_FLAG_RUN, 9, 9, 6099) == M3PI_STALE);
    CHECK(drives(&core, 6099, 0, 0));
    CHECK(m3pi_status(&core, 6099) == M3PI_STATUS_SILENT);
    CHECK(send(&core, 10, M3PI_FLAG_RUN, 9, 9, 6099) == M3PI_ACCEPTED); /* the same controller */
    CHECK(drives(&core, 6099, 9, 9));
}

static void test_a_robot_that_was_just_switched_on_waits(void)
{
    m3pi_core core;
    uint8_t reply[M3PI_REPLY_SIZE];
    m3pi_init(&core, 0);
    CHECK(send(&core, 7, M3PI_FLAG_RUN, 9, 9, 10) == M3PI_STALE);
    CHECK(send(&core, 8, M3PI_FLAG_RUN, 9, 9, 999) == M3PI_STALE);
    CHECK(drives(&core, 999, 0, 0));
    CHECK(send(&core, 9, M3PI_FLAG_POLL, 0, 0, 999) == M3PI_STALE);
    CHECK(m3pi_take_reply(&core, 999, reply) == M3PI_REPLY_SIZE); /* it answers */
    CHECK(send(&core, 6, M3PI_FLAG_RUN, 9, 9, 1000) == M3PI_ACCEPTED);
    CHECK(drives(&core, 1000, 9, 9));
}

static void test_emergency_stop_is_latched(void)
{
    m3pi_core core;
    switch_on(&core, 0);
    (void)send(&core, 10, M3PI_FLAG_RUN, 9, 9, 0);
    CHECK(send(&core, 9, M3PI_FLAG_RUN | M3PI_FLAG_EMERGENCY_STOP, 9, 9, 1) == M3PI_STALE);
    CHECK(drives(&core, 1, 0, 0)); /* old, and with RUN: still */
    for (uint32_t now = 2; now < 1000; now += 20) {
        (void)send(&core, (uint8_t)(11 + now / 20), M3PI_FLAG_RUN, 9, 9, now);
        CHECK(drives(&core, now, 0, 0));
        CHECK(m3pi_status(&core, now) == M3PI_STATUS_EMERGENCY_STOPPED);
    }
    switch_on(&core, 0); /* switched off and on */
    (void)send(&core, 1, M3PI_FLAG_RUN, 9, 9, 0);
    CHECK(drives(&core, 0, 9, 9));
}

/* Regression: a robot whose own watchdog had reset it took up the next frame. */
static void test_a_robot_can_begin_latched(void)
{
    m3pi_core core;
    switch_on(&core, 0);
    m3pi_emergency_stop(&core);
    CHECK(m3pi_status(&core, 0) == (M3PI_STATUS_EMERGENCY_STOPPED | M3PI_STATUS_SILENT));
    CHECK(send(&core, 1, M3PI_FLAG_RUN, 9, 9, 0) == M3PI_ACCEPTED);
    CHECK(drives(&core, 0, 0, 0));
    CHECK(m3pi_status(&core, 0) == M3PI_STATUS_EMERGENCY_STOPPED);
    switch_on(&core, 0);
    (void)send(&core, 1, M3PI_FLAG_RUN, 9, 9, 0);
    m3pi_emergency_stop(&core);
    CHECK(drives(&core, 0, 0, 0)); /* also in the middle of a drive */
}

static void test_reply(void)
{
    uint8_t reply[M3PI_REPLY_SIZE], expected[32];
    const uint8_t body[] = {0x52, 2, 0, 0, 0x88, 0x13, 1, 0, 1, 0};
    uint8_t sealed[12];
    m3pi_core core;
    switch_on(&core, 2);
    m3pi_set_battery(&core, 5000);
    CHECK(m3pi_take_reply(&core, 0, reply) == 0);
    (void)m3pi_push(&core, 0x33, 0);
    CHECK(m3pi_push(&core, 0, 0) == M3PI_REJECTED);
    CHECK(send(&core, 0, M3PI_FLAG_POLL, 0, 0, UINT32_MAX) == M3PI_ACCEPTED);
    CHECK(m3pi_take_reply(&core, 18, reply) == 0); /* its slot is the third */
    CHECK(m3pi_take_reply(&core, 19, reply) == M3PI_REPLY_SIZE);
    memcpy(sealed, body, sizeof body);
    sealed[10] = (uint8_t)(crc16(body, sizeof body) & 0xFFu);
    sealed[11] = (uint8_t)(crc16(body, sizeof body) >> 8);
    CHECK(stuff(sealed, sizeof sealed, expected) == M3PI_REPLY_SIZE);
    CHECK(memcmp(reply, expected, sizeof reply) == 0);
    CHECK(m3pi_take_reply(&core, 30, reply) == 0); /* once */
    CHECK(push(&core, expected, M3PI_REPLY_SIZE, 30) == M3PI_FOREIGN); /* another robot's */
    CHECK(drives(&core, 30, 0, 0));
}

static void test_garbage_never_drives(void)
{
    m3pi_core core;
    uint32_t random = 1;
    switch_on(&core, 0);
    for (uint32_t i = 0; i < 2000000; i++) {
        random = random * 1664525u + 1013904223u;
        /* many zeros make many short frames */
        const uint8_t byte = (uint8_t)((random >> 24) & ((random >> 8) & 1u ? 0xFFu : 0x07u));
        (void)m3pi_push(&core, byte, i / 100);
        CHECK(drives(&core, i / 100, 0, 0));
    }
}

/* A radio and a 3pi made of arrays, by port. */
typedef struct {
    uint8_t in[M3PI_PORTS][256], out[M3PI_PORTS][256];
    size_t size[M3PI_PORTS], at[M3PI_PORTS], sent[M3PI_PORTS];
} bench;

static int bench_read(void *context, m3pi_port port)
{
    bench *b = context;
    return b->at[port] < b->size[port] ? b->in[port][b->at[port]++] : -1;
}

static void bench_write(void *context, m3pi_port port, const uint8_t *data, size_t length)
{
    bench *b = context;
    memcpy(b->out[port] + b->sent[port], data, length);
    b->sent[port] += length;
}

static bool base_got(bench *b, const uint8_t *data, size_t length)
{
    const bool same =
        b->sent[M3PI_BASE] == length && memcmp(b->out[M3PI_BASE], data, length) == 0;
    b->sent[M3PI_BASE] = 0;
    return same;
}

static void test_shell(void)
{
    static bench b;
    const m3pi_hal hal = {&b, bench_read, bench_write};
    const uint8_t started[] = {0xC1, 0, 0xC5, 0, 0xB1};
    const uint8_t turning[] = {0xC1, 40, 0xC6, 127};
    const uint8_t stopped[] = {0xC1, 0, 0xC5, 0};
    m3pi_shell shell;

    memset(&b, 0, sizeof b);
    m3pi_shell_start(&shell, &hal, 0, 0);
    CHECK(base_got(&b, started, sizeof started));
    m3pi_shell_step(&shell, M3PI_FORGET_MS); /* it was just switched on */
    b.sent[M3PI_BASE] = 0;
    m3pi_shell_step(&shell, 1001);
    CHECK(b.sent[M3PI_BASE] == 0); /* nothing new to say */
    b.size[M3PI_RADIO] = make(b.in[M3PI_RADIO], 1, M3PI_FLAG_RUN | M3PI_FLAG_POLL, 1, 40, -127);
    b.in[M3PI_BASE][0] = 0x39; /* 5.433 V, as the 3pi answers */
    b.in[M3PI_BASE][1] = 0x15;
    b.size[M3PI_BASE] = 2;
    m3pi_shell_step(&shell, 1002);
    CHECK(base_got(&b, turning, sizeof turning));
    CHECK(b.sent[M3PI_RADIO] == M3PI_REPLY_SIZE);
    CHECK(b.out[M3PI_RADIO][1] == 0x52 && b.out[M3PI_RADIO][5] == 0x39 && b.out[M3PI_RADIO][6] == 0x15);
    m3pi_shell_step(&shell, 1021);
    CHECK(b.sent[M3PI_BASE] == 0);
    m3pi_shell_step(&shell, 1022); /* repeated: a lost byte must not last */
    CHECK(base_got(&b, turning, sizeof turning));
    m3pi_shell_step(&shell, 1252);
    CHECK(base_got(&b, stopped, sizeof stopped));
    m3pi_shell_step(&shell, 2000); /* asks again, gets no answer, and says unknown next time */
    CHECK(b.sent[M3PI_BASE] == 5 && b.out[M3PI_BASE][4] == 0xB1);
    m3pi_shell_step(&shell, 3000);
    CHECK(shell.core.battery_mv == 0);
}

/* Every command of Pololu's serial slave program on which the robot relies. Motors: m1_forward() and
 * the three functions after it, in examples/3pi-serial-slave/slave.c of Pololu's AVR library. M1 is
 * the left motor. The form of commands: Pololu 3pi Robot User's Guide (0J21), 2019, section 10, page
 * 63: a command is one byte from 80 to FF, and data are bytes from 00 to 7F. */
static void test_commands_of_the_serial_slave_program(void)
{
    static const struct {
        int8_t left, right;
        uint8_t command[4];
    } vectors[] = {
        {1, 1, {0xC1, 1, 0xC5, 1}},          {-1, 1, {0xC2, 1, 0xC5, 1}},
        {1, -1, {0xC1, 1, 0xC6, 1}},         {-1, -1, {0xC2, 1, 0xC6, 1}},
        {127, 127, {0xC1, 127, 0xC5, 127}},  {-127, 127, {0xC2, 127, 0xC5, 127}},
        {127, -127, {0xC1, 127, 0xC6, 127}}, {-127, -127, {0xC2, 127, 0xC6, 127}},
    };
    static bench b;
    const m3pi_hal hal = {&b, bench_read, bench_write};

    for (size_t i = 0; i < sizeof vectors / sizeof vectors[0]; i++) {
        m3pi_shell shell;

        memset(&b, 0, sizeof b);
        m3pi_shell_start(&shell, &hal, 0, 0);
        m3pi_shell_step(&shell, M3PI_FORGET_MS);
        b.sent[M3PI_BASE] = 0;
        b.size[M3PI_RADIO] =
            make(b.in[M3PI_RADIO], 1, M3PI_FLAG_RUN, 1, vectors[i].left, vectors[i].right);
        m3pi_shell_step(&shell, M3PI_FORGET_MS + 1);
        CHECK(base_got(&b, vectors[i].command, sizeof vectors[i].command));
    }
}

/* Page 64 of the same guide: B1 asks for the battery's voltage [mV], which comes as two bytes. Page
 * 63: the least significant byte comes first. */
static void test_the_battery_of_the_serial_slave_program(void)
{
    static const uint8_t query[] = {0xC1, 0, 0xC5, 0, 0xB1};
    static bench b;
    const m3pi_hal hal = {&b, bench_read, bench_write};
    m3pi_shell shell;

    memset(&b, 0, sizeof b);
    m3pi_shell_start(&shell, &hal, 0, 0);
    CHECK(base_got(&b, query, sizeof query));
    b.in[M3PI_BASE][0] = 0x88; /* 5000 = 0x1388 */
    b.in[M3PI_BASE][1] = 0x13;
    b.size[M3PI_BASE] = 2;
    m3pi_shell_step(&shell, 1);
    CHECK(shell.core.battery_mv == 5000);
}

int main(void)
{
    test_documented_frame();
    test_damaged_frames_change_nothing();
    test_malformed_frames();
    test_watchdog();
    test_sequence();
    test_a_late_frame_does_not_drive_a_robot_that_stands();
    test_a_robot_that_was_just_switched_on_waits();
    test_emergency_stop_is_latched();
    test_a_robot_can_begin_latched();
    test_reply();
    test_garbage_never_drives();
    test_shell();
    test_commands_of_the_serial_slave_program();
    test_the_battery_of_the_serial_slave_program();
    printf("%s\n", failures ? "FAILED" : "passed");
    return failures != 0;
}
