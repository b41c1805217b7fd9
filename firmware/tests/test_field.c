/* Host tests of the current driver's core; the Python side drives it again, against a twin. */
#include "field_core.h"

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

static const field_limits limits = {1000, 10000, FIELD_WATCHDOG_MS, 800}; /* 10 mA a ms */

static field_event push(field_core *core, const uint8_t *data, size_t length, uint32_t now)
{
    field_event last = FIELD_NOTHING;
    for (size_t i = 0; i < length; i++) {
        last = field_push(core, data[i], now);
    }
    return last;
}

static field_event send(field_core *core, uint8_t sequence, uint8_t flags, int16_t x, int16_t y,
                        uint32_t now)
{
    uint8_t body[7] = {0x53, sequence, flags}, frame[11];
    body[3] = (uint8_t)((uint16_t)x & 0xFFu);
    body[4] = (uint8_t)((uint16_t)x >> 8);
    body[5] = (uint8_t)((uint16_t)y & 0xFFu);
    body[6] = (uint8_t)((uint16_t)y >> 8);
    return push(core, frame, framing_seal(body, sizeof body, frame), now);
}

static bool gives(field_core *core, uint32_t now, int32_t x_ua, int32_t y_ua)
{
    int32_t x, y;
    field_currents(core, now, &x, &y);
    return x == x_ua && y == y_ua;
}

static void test_documented_frames(void)
{
    const uint8_t frame[] = {0x0A, 0x53, 0x07, 0x05, 0x2C, 0x01, 0x06, 0xFF, 0xD7, 0xD3, 0x00};
    const uint8_t told[] = {0x54, 0x07, 0x01, 0x01, 0x2B, 0x01, 0x06, 0xFF}; /* behind the code */
    uint8_t reply[FIELD_REPLY_SIZE];
    field_core core;
    field_init(&core, &limits, 0);
    CHECK(gives(&core, 0, 0, 0));
    CHECK(push(&core, frame, sizeof frame, 0) == FIELD_ACCEPTED);
    CHECK(gives(&core, 30, 300000, -250000));
    field_measured(&core, 299, -250, 0, 253);
    CHECK(field_take_reply(&core, 30, reply) == FIELD_REPLY_SIZE);
    CHECK(memcmp(reply + 1, told, sizeof told) == 0);
    CHECK(reply[FIELD_REPLY_SIZE - 1] == 0);
    CHECK(field_take_reply(&core, 30, reply) == 0);
}

static void test_slew_is_a_straight_line(void)
{
    field_core core;
    field_init(&core, &limits, 0xFFFFFFF0u); /* the clock wraps round meanwhile */
    CHECK(send(&core, 1, FIELD_FLAG_RUN, 400, -200, 0xFFFFFFF0u) == FIELD_ACCEPTED);
    CHECK(gives(&core, 0xFFFFFFFAu, 100000, -50000));
    CHECK(gives(&core, 4, 200000, -100000));
    CHECK(gives(&core, 100, 400000, -200000));
}

static void test_extreme_wishes_are_scaled(void)
{
    field_limits wide = limits;
    field_core core;
    field_init(&core, &limits, 0);
    CHECK(send(&core, 1, FIELD_FLAG_RUN, -32768, 16384, 0) == FIELD_ACCEPTED);
    CHECK(gives(&core, 200, -1000000, 500000));
    CHECK(field_status(&core, 200) == (FIELD_STATUS_RUNNING | FIELD_STATUS_LIMITED));
    wide.current_max_ma = 32767;
    wide.slew_ma_s = 0xFFFFFFFFu;
    wide.watchdog_ms = 0xFFFFu;
    field_init(&core, &wide, 0);
    CHECK(send(&core, 1, FIELD_FLAG_RUN, 32767, -32768, 0) == FIELD_ACCEPTED);
    CHECK(send(&core, 2, FIELD_FLAG_RUN, -32767, 32767, 1) == FIELD_ACCEPTED);
    CHECK(gives(&core, 60000, -32767000, 32767000));
    CHECK(gives(&core, 0xFFFFFFFFu, -32767000, 32767000));
    CHECK(gives(&core, 0xFFFFFFFEu, 0, 0));
}

static void test_watchdog_and_latch(void)
{
    field_core core;
    field_init(&core, &limits, 0);
    CHECK(field_status(&core, 0) == FIELD_STATUS_SILENT);
    CHECK(send(&core, 1, FIELD_FLAG_RUN, 100, 0, 0) == FIELD_ACCEPTED);
    CHECK(gives(&core, FIELD_WATCHDOG_MS - 1, 100000, 0));
    CHECK(gives(&core, FIELD_WATCHDOG_MS, 100000, 0)); /* from here on down */
    CHECK(gives(&core, FIELD_WATCHDOG_MS + 5, 50000, 0));
    CHECK(gives(&core, FIELD_WATCHDOG_MS + 10, 0, 0));
    CHECK(send(&core, 2, FIELD_FLAG_EMERGENCY_STOP, 0, 0, 1000) == FIELD_ACCEPTED);
    CHECK(send(&core, 3, FIELD_FLAG_RUN, 100, 0, 1001) == FIELD_ACCEPTED);
    CHECK(gives(&core, 1100, 0, 0));
    field_init(&core, &limits, 0);
    field_measured(&core, 0, 0, 12000, 800);
    CHECK(send(&core, 1, FIELD_FLAG_RUN, 100, 0, 0) == FIELD_ACCEPTED);
    CHECK(gives(&core, 100, 0, 0));
    CHECK(field_status(&core, 100) == (FIELD_STATUS_HOT | FIELD_STATUS_EMERGENCY_STOPPED));
}

/* Regression: a driver whose own watchdog had reset it took up the next frame. */
static void test_a_driver_can_begin_latched(void)
{
    field_core core;
    field_init(&core, &limits, 0);
    field_emergency_stop(&core);
    CHECK(field_status(&core, 0) == (FIELD_STATUS_EMERGENCY_STOPPED | FIELD_STATUS_SILENT));
    CHECK(send(&core, 1, FIELD_FLAG_RUN, 100, 0, 0) == FIELD_ACCEPTED);
    CHECK(gives(&core, 100, 0, 0));
    CHECK(field_status(&core, 100) == FIELD_STATUS_EMERGENCY_STOPPED);
    field_init(&core, &limits, 0);
    CHECK(send(&core, 1, FIELD_FLAG_RUN, 100, 0, 0) == FIELD_ACCEPTED);
    CHECK(gives(&core, 10, 100000, 0));
    field_emergency_stop(&core);
    CHECK(gives(&core, 15, 50000, 0)); /* down at the slew limit, as every stop */
    CHECK(gives(&core, 20, 0, 0));
}

static void test_garbage_never_makes_a_field(void)
{
    uint32_t random = 1;
    uint8_t reply[FIELD_REPLY_SIZE];
    field_core core;
    field_init(&core, &limits, 0);
    for (uint32_t i = 0; i < 1000000; i++) {
        random = random * 1664525u + 1013904223u;
        CHECK(field_push(&core, (uint8_t)(random >> 24), i / 10) != FIELD_ACCEPTED);
    }
    CHECK(gives(&core, 100001, 0, 0));
    CHECK(field_take_reply(&core, 100001, reply) == 0);
}

int main(void)
{
    test_documented_frames();
    test_slew_is_a_straight_line();
    test_extreme_wishes_are_scaled();
    test_watchdog_and_latch();
    test_a_driver_can_begin_latched();
    test_garbage_never_makes_a_field();
    printf("%s\n", failures ? "FAILED" : "passed");
    return failures != 0;
}
