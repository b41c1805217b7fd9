#include "field_core.h"

#include <string.h>

#define COMMAND 0x53u
#define REPLY 0x54u
#define COMMAND_SIZE 7u
#define KNOWN_FLAGS 7u
#define AHEAD_MAX 127u

static int32_t magnitude(int32_t value)
{
    return value < 0 ? -value : value;
}

static int32_t larger(int32_t a, int32_t b)
{
    return magnitude(a) > magnitude(b) ? magnitude(a) : magnitude(b);
}

static int16_t get16(const uint8_t *at)
{
    const int32_t value = at[0] | at[1] << 8;
    return (int16_t)(value < 32768 ? value : value - 65536);
}

static void stop(field_core *core)
{
    core->wished_ua[0] = 0;
    core->wished_ua[1] = 0;
    core->running = false;
    core->limited = false;
}

/* Set points on the straight line to what is wished, as far as the slew limit lets them by now.
 * Slew in mA/s is uA/ms. */
static void move(field_core *core, uint32_t now_ms)
{
    const uint64_t room = (uint64_t)(uint32_t)(now_ms - core->moved_ms) * core->limits.slew_ma_s;
    const int32_t dx = core->wished_ua[0] - core->set_ua[0];
    const int32_t dy = core->wished_ua[1] - core->set_ua[1];
    const int32_t peak = larger(dx, dy);

    core->moved_ms = now_ms;
    if ((uint64_t)peak <= room) {
        core->set_ua[0] += dx;
        core->set_ua[1] += dy;
    } else {
        core->set_ua[0] += (int32_t)(dx * (int64_t)room / peak);
        core->set_ua[1] += (int32_t)(dy * (int64_t)room / peak);
    }
}

/* Move up to now under the last wish, then look whether the watchdog ends it. Once silent it stays
 * so until a new frame comes, also when the clock wraps round. */
static void watch(field_core *core, uint32_t now_ms)
{
    move(core, now_ms);
    if ((uint32_t)(now_ms - core->heard_ms) >= core->limits.watchdog_ms) {
        core->silent = true;
    }
    if (core->silent || core->emergency_stopped) {
        stop(core);
    }
}

static void wish(field_core *core, int32_t x_ma, int32_t y_ma)
{
    const int32_t limit = core->limits.current_max_ma;
    const int32_t peak = larger(x_ma, y_ma);

    core->limited = peak > limit;
    core->wished_ua[0] = 1000 * (core->limited ? x_ma * limit / peak : x_ma);
    core->wished_ua[1] = 1000 * (core->limited ? y_ma * limit / peak : y_ma);
    core->running = true;
}

static field_event obey(field_core *core, uint32_t now_ms)
{
    const uint8_t *frame = core->reader.frame;
    const uint8_t sequence = frame[1];
    const uint8_t flags = frame[2];
    const uint8_t ahead = (uint8_t)(sequence - core->sequence);
    const bool is_new = core->silent || (ahead >= 1u && ahead <= AHEAD_MAX);

    if (flags & FIELD_FLAG_EMERGENCY_STOP) {
        core->emergency_stopped = true;
    }
    if (!(flags & FIELD_FLAG_RUN) || core->emergency_stopped) {
        stop(core);
    } else if (is_new) {
        wish(core, get16(frame + 3), get16(frame + 5));
    }
    if (is_new) {
        core->sequence = sequence;
        core->heard_ms = now_ms;
        core->silent = false;
    }
    if ((flags & FIELD_FLAG_POLL) && (is_new || !(flags & FIELD_FLAG_RUN))) {
        core->reply_pending = true;
        core->echo = sequence;
    }
    return is_new ? FIELD_ACCEPTED : FIELD_STALE;
}

void field_init(field_core *core, const field_limits *limits, uint32_t now_ms)
{
    memset(core, 0, sizeof *core);
    core->limits = *limits;
    core->moved_ms = now_ms;
    core->silent = true;
    core->temperature_dc = FIELD_TEMPERATURE_UNKNOWN;
}

void field_emergency_stop(field_core *core)
{
    core->emergency_stopped = true;
    stop(core);
}

field_event field_push(field_core *core, uint8_t byte, uint32_t now_ms)
{
    const framing_event event = framing_push(&core->reader, byte);

    watch(core, now_ms);
    if (event == FRAMING_OPEN) {
        return FIELD_NOTHING;
    }
    if (event == FRAMING_GOOD && core->reader.frame[0] != COMMAND) {
        return FIELD_FOREIGN;
    }
    if (event == FRAMING_BAD || core->reader.length != COMMAND_SIZE ||
        (core->reader.frame[2] & ~KNOWN_FLAGS) != 0) {
        core->rejected++;
        return FIELD_REJECTED;
    }
    core->received++;
    return obey(core, now_ms);
}

void field_currents(field_core *core, uint32_t now_ms, int32_t *x_ua, int32_t *y_ua)
{
    watch(core, now_ms);
    *x_ua = core->set_ua[0];
    *y_ua = core->set_ua[1];
}

void field_measured(field_core *core, int16_t x_ma, int16_t y_ma, uint16_t supply_mv,
                    int16_t temperature_dc)
{
    core->measured_ma[0] = x_ma;
    core->measured_ma[1] = y_ma;
    core->supply_mv = supply_mv;
    core->temperature_dc = temperature_dc;
    if (temperature_dc >= core->limits.temperature_max_dc) {
        core->hot = true;
        core->emergency_stopped = true;
    }
}

uint8_t field_status(field_core *core, uint32_t now_ms)
{
    watch(core, now_ms);
    return (uint8_t)((core->running ? FIELD_STATUS_RUNNING : 0) |
                     (core->emergency_stopped ? FIELD_STATUS_EMERGENCY_STOPPED : 0) |
                     (core->silent ? FIELD_STATUS_SILENT : 0) |
                     (core->limited ? FIELD_STATUS_LIMITED : 0) |
                     (core->hot ? FIELD_STATUS_HOT : 0));
}

static uint8_t *put16(uint8_t *at, uint16_t value)
{
    at[0] = (uint8_t)(value & 0xFFu);
    at[1] = (uint8_t)(value >> 8);
    return at + 2;
}

size_t field_take_reply(field_core *core, uint32_t now_ms, uint8_t reply[FIELD_REPLY_SIZE])
{
    uint8_t body[FIELD_REPLY_SIZE - 4u] = {REPLY, core->echo, 0, FIELD_VERSION};
    uint8_t *at = body + 4;

    if (!core->reply_pending) {
        return 0;
    }
    core->reply_pending = false;
    body[2] = field_status(core, now_ms);
    at = put16(at, (uint16_t)core->measured_ma[0]);
    at = put16(at, (uint16_t)core->measured_ma[1]);
    at = put16(at, core->supply_mv);
    at = put16(at, (uint16_t)core->temperature_dc);
    at = put16(at, core->received);
    at = put16(at, core->rejected);
    at = put16(at, core->limits.current_max_ma);
    at = put16(at, (uint16_t)(core->limits.slew_ma_s & 0xFFFFu));
    at = put16(at, (uint16_t)(core->limits.slew_ma_s >> 16));
    at = put16(at, core->limits.watchdog_ms);
    return framing_seal(body, (size_t)(at - body), reply);
}

size_t field_size(void)
{
    return sizeof(field_core);
}
