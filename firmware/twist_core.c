/* The way of a byte: twist_push collects a line, read_line checks its CRC, read_command its words,
 * and obey does what it says. The way out: twist_wheels and twist_take_reply. The format of lines is
 * in twist_core.h. */
#include "twist_core.h"

#include <string.h>

#define KNOWN_FLAGS 7     /* all flags together */
#define SEQUENCE_MAX 255
#define AHEAD_MAX 127u    /* a sequence that is further ahead is one of the past: it is a byte */
#define NUMBER_DIGITS 6u  /* most digits of a number in a command */
#define REPLY_DIGITS 5u   /* digits of 65535, the greatest number in a reply */
#define CRC_DIGITS 4u
#define CRC_POLYNOMIAL 0x1021u

/* The words of a line that are still to be read. */
typedef struct {
    const char *next;
    const char *end;
} words;

/* A command, as far as it concerns this robot. */
typedef struct {
    uint8_t sequence;
    bool run;
    bool emergency_stop;
    bool poll;
    bool names_me;
    int32_t left;  /* mm/s, if it names this robot */
    int32_t right; /* mm/s */
} command;

/* CRC-16/CCITT-FALSE, bit by bit. */
static uint16_t crc16(const char *text, size_t length)
{
    uint32_t crc = 0xFFFFu;
    for (size_t i = 0; i < length; i++) {
        crc ^= (uint32_t)(uint8_t)text[i] << 8;
        for (int bit = 0; bit < 8; bit++) {
            const bool carries = (crc & 0x8000u) != 0;
            crc = (crc << 1) & 0xFFFFu;
            if (carries) {
                crc ^= CRC_POLYNOMIAL;
            }
        }
    }
    return (uint16_t)crc;
}

static char hex_digit(unsigned value)
{
    return (char)(value < 10u ? '0' + value : 'A' + (value - 10u));
}

/* Write a CRC in hexadecimal, the highest digit first. */
static void put_crc(uint16_t crc, char digits[CRC_DIGITS])
{
    for (size_t i = 0; i < CRC_DIGITS; i++) {
        const size_t shift = 4u * (CRC_DIGITS - 1u - i);
        digits[i] = hex_digit((unsigned)(crc >> shift) & 0xFu);
    }
}

/* Whether a time has come, also after the clock has wrapped round: times less than half of its
 * range apart are compared. */
static bool is_due(uint32_t now_ms, uint32_t due_ms)
{
    return (uint32_t)(now_ms - due_ms) < 0x80000000u;
}

static void stop(twist_core *core)
{
    core->left = 0;
    core->right = 0;
    core->running = false;
}

/* The watchdog. A robot that is silent stays so until a new command comes, also when the clock wraps
 * round. */
static void watch(twist_core *core, uint32_t now_ms)
{
    const uint32_t quiet_ms = now_ms - core->heard_ms;

    core->silent |= quiet_ms >= TWIST_WATCHDOG_MS;
    core->forgotten |= quiet_ms >= TWIST_FORGET_MS;
    if (core->silent) {
        stop(core);
    }
}

/* Read a space and a decimal number from `least` to `greatest`; false if there is none. */
static bool read_number(words *line, int32_t least, int32_t greatest, int32_t *number)
{
    bool negative = false;
    size_t digits = 0;
    int32_t size = 0;

    if (line->next == line->end || *line->next != ' ') {
        return false;
    }
    line->next++;
    if (line->next != line->end && *line->next == '-') {
        negative = true;
        line->next++;
    }
    while (line->next != line->end && *line->next >= '0' && *line->next <= '9') {
        size = 10 * size + (*line->next - '0');
        line->next++;
        digits++;
        if (digits > NUMBER_DIGITS) {
            return false;
        }
    }
    *number = negative ? -size : size;
    return digits > 0 && *number >= least && *number <= greatest;
}

/* The speed of a wheel [mm/s] by which a robot turns at w [mrad/s], to the nearest whole number. */
static int32_t rim_speed(int32_t w, uint16_t radius_mm)
{
    const int64_t size_um_s = (int64_t)(w < 0 ? -w : w) * radius_mm;
    const int32_t size_mm_s = (int32_t)((size_um_s + 500) / 1000);
    return w < 0 ? -size_mm_s : size_mm_s;
}

/* Do what a command says. One that is not new, or comes from another order, may only stop a robot:
 * it drives none, feeds no watchdog, and is answered only if it stops. */
static twist_event obey(twist_core *core, uint32_t now_ms, const command *order)
{
    const uint8_t ahead = (uint8_t)(order->sequence - core->sequence);
    const bool is_next = core->known && ahead >= 1u && ahead <= AHEAD_MAX;
    const bool is_new = core->forgotten || is_next;

    core->received++;
    if (order->emergency_stop) {
        core->emergency_stopped = true;
    }
    if (!order->run || core->emergency_stopped) {
        stop(core);
    } else if (is_new && !order->names_me) {
        stop(core);
    } else if (is_new) {
        core->left = order->left;
        core->right = order->right;
        core->running = true;
    }
    if (is_new) {
        core->sequence = order->sequence;
        core->heard_ms = now_ms;
        core->silent = false;
        core->forgotten = false;
        core->known = true;
    }
    if (order->poll && (is_new || !order->run)) {
        core->reply_pending = true;
        core->echo = order->sequence;
        core->due_ms = now_ms + (uint32_t)core->index * TWIST_REPLY_SLOT_MS;
    }
    return is_new ? TWIST_ACCEPTED : TWIST_STALE;
}

/* Read `{index v w}` or `{index left right}` to the end of a line; false if a number is wrong. The
 * first entry of this robot counts. */
static bool read_entries(const twist_core *core, words *line, bool of_wheels, command *order)
{
    const int32_t second_max = of_wheels ? TWIST_SPEED_MAX : TWIST_TURN_MAX;
    int32_t index;
    int32_t first;
    int32_t second;

    while (line->next != line->end) {
        if (!read_number(line, 0, (int32_t)TWIST_ROBOTS_MAX - 1, &index) ||
            !read_number(line, -TWIST_SPEED_MAX, TWIST_SPEED_MAX, &first) ||
            !read_number(line, -second_max, second_max, &second)) {
            return false;
        }
        if (index != core->index || order->names_me) {
            continue;
        }
        order->names_me = true;
        if (of_wheels) {
            order->left = first;
            order->right = second;
        } else {
            order->left = first - rim_speed(second, core->radius_mm);
            order->right = first + rim_speed(second, core->radius_mm);
        }
    }
    return true;
}

/* Read and obey a command of which the CRC is right. */
static twist_event read_command(twist_core *core, size_t size, uint32_t now_ms)
{
    words line = {core->line + 1, core->line + size};
    command order = {0};
    int32_t sequence;
    int32_t flags;

    if (!read_number(&line, 0, SEQUENCE_MAX, &sequence) ||
        !read_number(&line, 0, KNOWN_FLAGS, &flags) ||
        !read_entries(core, &line, core->line[0] == 'W', &order)) {
        return TWIST_REJECTED;
    }
    order.sequence = (uint8_t)sequence;
    order.run = (flags & TWIST_FLAG_RUN) != 0;
    order.emergency_stop = (flags & TWIST_FLAG_EMERGENCY_STOP) != 0;
    order.poll = (flags & TWIST_FLAG_POLL) != 0;
    return obey(core, now_ms, &order);
}

/* The size of a line without its CRC; 0 if it has none, or a wrong one. */
static size_t checked_size(const char *line, size_t size)
{
    char digits[CRC_DIGITS];
    size_t checked;

    if (size <= CRC_DIGITS + 1u) {
        return 0;
    }
    checked = size - CRC_DIGITS - 1u;
    put_crc(crc16(line, checked), digits);
    if (line[checked] != '*' || memcmp(digits, line + checked + 1u, CRC_DIGITS) != 0) {
        return 0;
    }
    return checked;
}

/* Take the whole line that has been received. */
static twist_event read_line(twist_core *core, uint32_t now_ms)
{
    twist_event event = TWIST_REJECTED;
    size_t size = core->length;
    size_t checked;

    if (size > 0 && core->line[size - 1] == '\r') {
        size--;
    }
    if (size == 0 && !core->overlong) {
        return TWIST_NOTHING;
    }
    checked = core->overlong ? 0 : checked_size(core->line, size);
    if (checked > 0) {
        const bool is_command = core->line[0] == 'T' || core->line[0] == 'W';
        event = is_command ? read_command(core, checked, now_ms) : TWIST_FOREIGN;
    }
    if (event == TWIST_REJECTED) {
        core->rejected++;
    }
    return event;
}

void twist_init(twist_core *core, uint8_t index, uint16_t radius_mm)
{
    memset(core, 0, sizeof *core);
    core->index = index;
    core->radius_mm = radius_mm;
    core->silent = true;
}

twist_event twist_push(twist_core *core, uint8_t byte, uint32_t now_ms)
{
    twist_event event;

    watch(core, now_ms);
    if (byte != '\n') {
        if (core->length < TWIST_LINE_MAX) {
            core->line[core->length++] = (char)byte;
        } else {
            core->overlong = true;
        }
        return TWIST_NOTHING;
    }
    event = read_line(core, now_ms);
    core->length = 0;
    core->overlong = false;
    return event;
}

void twist_wheels(twist_core *core, uint32_t now_ms, int32_t *left, int32_t *right)
{
    watch(core, now_ms);
    *left = core->left;
    *right = core->right;
}

uint8_t twist_status(twist_core *core, uint32_t now_ms)
{
    watch(core, now_ms);
    return (uint8_t)((core->running ? TWIST_STATUS_RUNNING : 0) |
                     (core->emergency_stopped ? TWIST_STATUS_EMERGENCY_STOPPED : 0) |
                     (core->silent ? TWIST_STATUS_SILENT : 0));
}

void twist_set_battery(twist_core *core, uint16_t battery_mv)
{
    core->battery_mv = battery_mv;
}

/* Write a space and a number of at most REPLY_DIGITS digits; return the size. */
static size_t put_number(char *text, uint16_t number)
{
    char reversed[REPLY_DIGITS];
    size_t digits = 0;
    size_t size = 0;

    do {
        reversed[digits] = (char)('0' + number % 10u);
        digits++;
        number = (uint16_t)(number / 10u);
    } while (number > 0);
    text[size] = ' ';
    size++;
    while (digits > 0) {
        digits--;
        text[size] = reversed[digits];
        size++;
    }
    return size;
}

size_t twist_take_reply(twist_core *core, uint32_t now_ms, char reply[TWIST_REPLY_MAX])
{
    size_t size = 1;
    uint16_t crc;
    uint8_t status;

    status = twist_status(core, now_ms);
    if (!core->reply_pending || !is_due(now_ms, core->due_ms)) {
        return 0;
    }
    core->reply_pending = false;
    reply[0] = 'S';
    size += put_number(reply + size, core->index);
    size += put_number(reply + size, core->echo);
    size += put_number(reply + size, status);
    size += put_number(reply + size, core->battery_mv);
    size += put_number(reply + size, core->received);
    size += put_number(reply + size, core->rejected);
    crc = crc16(reply, size);
    reply[size] = '*';
    put_crc(crc, reply + size + 1u);
    size += 1u + CRC_DIGITS;
    reply[size] = '\n';
    return size + 1u;
}

size_t twist_size(void)
{
    return sizeof(twist_core);
}
