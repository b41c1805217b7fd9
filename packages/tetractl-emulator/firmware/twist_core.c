#include "twist_core.h"

#include <string.h>

#define KNOWN_FLAGS 7
#define AHEAD_MAX 127u
#define CRC_DIGITS 4u

static uint16_t crc16(const char *text, size_t length)
{
    uint16_t crc = 0xFFFFu;
    for (size_t i = 0; i < length; i++) {
        crc = (uint16_t)(crc ^ (uint16_t)((uint16_t)(uint8_t)text[i] << 8));
        for (int bit = 0; bit < 8; bit++) {
            crc = (uint16_t)((crc & 0x8000u) ? ((uint32_t)crc << 1) ^ 0x1021u : (uint32_t)crc << 1);
        }
    }
    return crc;
}

static char hex_digit(unsigned value)
{
    return (char)(value < 10u ? '0' + value : 'A' + (value - 10u));
}

static void put_crc(uint16_t crc, char digits[CRC_DIGITS])
{
    for (size_t i = 0; i < CRC_DIGITS; i++) {
        digits[i] = hex_digit((unsigned)(crc >> (12u - 4u * i)) & 0xFu);
    }
}

static void stop(twist_core *core)
{
    core->left = 0;
    core->right = 0;
    core->running = false;
}

/* Once silent it stays so until a new command comes, also when the clock wraps round. */
static void watch(twist_core *core, uint32_t now_ms)
{
    if ((uint32_t)(now_ms - core->heard_ms) >= TWIST_WATCHDOG_MS) {
        core->silent = true;
    }
    if (core->silent) {
        stop(core);
    }
}

/* Read " number" at `*at`, a decimal number from -greatest to greatest; false if there is none. */
static bool number(const twist_core *core, size_t *at, size_t end, int32_t greatest, int32_t *value)
{
    bool negative = false;
    size_t digits = 0;

    if (*at >= end || core->line[*at] != ' ') {
        return false;
    }
    ++*at;
    if (*at < end && core->line[*at] == '-') {
        negative = true;
        ++*at;
    }
    for (*value = 0; *at < end && core->line[*at] >= '0' && core->line[*at] <= '9'; ++*at) {
        *value = 10 * *value + (core->line[*at] - '0');
        if (++digits > 6) {
            return false;
        }
    }
    if (digits == 0 || *value > greatest) {
        return false;
    }
    *value = negative ? -*value : *value;
    return true;
}

/* The nearest whole number of w radius / 1000. */
static int32_t rim(int32_t w, uint16_t radius_mm)
{
    const int64_t twice = (int64_t)(w < 0 ? -w : w) * radius_mm;
    const int32_t size = (int32_t)((twice + 500) / 1000);
    return w < 0 ? -size : size;
}

static twist_event obey(twist_core *core, uint32_t now_ms, uint8_t sequence, int32_t flags,
                        bool is_named, int32_t left, int32_t right)
{
    const uint8_t ahead = (uint8_t)(sequence - core->sequence);
    const bool is_new = core->silent || (ahead >= 1u && ahead <= AHEAD_MAX);

    core->received++;
    if (flags & TWIST_FLAG_EMERGENCY_STOP) {
        core->emergency_stopped = true;
    }
    if (!(flags & TWIST_FLAG_RUN) || core->emergency_stopped) {
        stop(core);
    } else if (is_new) {
        core->left = is_named ? left : 0;
        core->right = is_named ? right : 0;
        core->running = is_named;
    }
    if (is_new) {
        core->sequence = sequence;
        core->heard_ms = now_ms;
        core->silent = false;
    }
    if ((flags & TWIST_FLAG_POLL) && (is_new || !(flags & TWIST_FLAG_RUN))) {
        core->reply_pending = true;
        core->echo = sequence;
        core->due_ms = now_ms + (uint32_t)core->index * TWIST_REPLY_SLOT_MS;
    }
    return is_new ? TWIST_ACCEPTED : TWIST_STALE;
}

static twist_event read_command(twist_core *core, size_t end, uint32_t now_ms)
{
    const bool wheels = core->line[0] == 'W';
    const int32_t second = wheels ? TWIST_SPEED_MAX : TWIST_TURN_MAX;
    int32_t sequence, flags, index, one, two, left = 0, right = 0;
    bool is_named = false;
    size_t at = 1;

    if (!number(core, &at, end, 255, &sequence) || sequence < 0 ||
        !number(core, &at, end, KNOWN_FLAGS, &flags) || flags < 0) {
        return TWIST_REJECTED;
    }
    while (at < end) {
        if (!number(core, &at, end, (int32_t)TWIST_ROBOTS_MAX - 1, &index) || index < 0 ||
            !number(core, &at, end, TWIST_SPEED_MAX, &one) ||
            !number(core, &at, end, second, &two)) {
            return TWIST_REJECTED;
        }
        if (index == core->index && !is_named) {
            is_named = true;
            left = wheels ? one : one - rim(two, core->radius_mm);
            right = wheels ? two : one + rim(two, core->radius_mm);
        }
    }
    return obey(core, now_ms, (uint8_t)sequence, flags, is_named, left, right);
}

static twist_event read_line(twist_core *core, uint32_t now_ms)
{
    char digits[CRC_DIGITS];
    size_t end = core->length;
    twist_event event = TWIST_REJECTED;

    if (end > 0 && core->line[end - 1] == '\r') {
        end--;
    }
    if (end == 0 && !core->overlong) {
        return TWIST_NOTHING;
    }
    if (!core->overlong && end > CRC_DIGITS + 1u && core->line[end - CRC_DIGITS - 1u] == '*') {
        end -= CRC_DIGITS + 1u;
        put_crc(crc16(core->line, end), digits);
        if (memcmp(digits, core->line + end + 1u, CRC_DIGITS) == 0) {
            event = core->line[0] == 'T' || core->line[0] == 'W' ? read_command(core, end, now_ms)
                                                                 : TWIST_FOREIGN;
        }
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

static size_t put_number(char *at, unsigned value)
{
    char reversed[5];
    size_t size = 0, count = 0;
    do {
        reversed[count++] = (char)('0' + value % 10u);
        value /= 10u;
    } while (value > 0);
    at[size++] = ' ';
    while (count > 0) {
        at[size++] = reversed[--count];
    }
    return size;
}

size_t twist_take_reply(twist_core *core, uint32_t now_ms, char reply[TWIST_REPLY_MAX])
{
    const unsigned numbers[] = {core->index,      core->echo,     twist_status(core, now_ms),
                                core->battery_mv, core->received, core->rejected};
    size_t size = 0;

    if (!core->reply_pending || (uint32_t)(now_ms - core->due_ms) >= 0x80000000u) {
        return 0;
    }
    core->reply_pending = false;
    reply[size++] = 'S';
    for (size_t i = 0; i < sizeof numbers / sizeof numbers[0]; i++) {
        size += put_number(reply + size, numbers[i]);
    }
    const uint16_t crc = crc16(reply, size);
    reply[size++] = '*';
    put_crc(crc, reply + size);
    size += CRC_DIGITS;
    reply[size++] = '\n';
    return size;
}

size_t twist_size(void)
{
    return sizeof(twist_core);
}
