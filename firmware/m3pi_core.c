#include "m3pi_core.h"

#include <string.h>

#define COMMAND 0x51u
#define REPLY 0x52u
#define HEAD 4u
#define KNOWN_FLAGS 7u
#define AHEAD_MAX 127u

static int8_t as_signed(uint8_t byte)
{
    return (int8_t)(byte < 128 ? byte : (int)byte - 256);
}

static void stop(m3pi_core *core)
{
    core->left = 0;
    core->right = 0;
    core->running = false;
}

/* Once silent it stays so until a new frame comes, also when the clock wraps round. */
static void watch(m3pi_core *core, uint32_t now_ms)
{
    const uint32_t quiet_ms = now_ms - core->heard_ms;

    core->silent |= quiet_ms >= M3PI_WATCHDOG_MS;
    core->forgotten |= quiet_ms >= M3PI_FORGET_MS;
    if (core->silent) {
        stop(core);
    }
}

static bool is_well_formed(const framing_reader *reader)
{
    const uint8_t *frame = reader->frame;
    if (reader->length < HEAD || (frame[2] & ~KNOWN_FLAGS) != 0 || frame[3] > M3PI_ROBOTS_MAX ||
        reader->length != HEAD + 2u * frame[3]) {
        return false;
    }
    for (size_t i = 0; i < 2u * frame[3]; i++) {
        if (frame[HEAD + i] == 0x80u) { /* -128 is no count */
            return false;
        }
    }
    return true;
}

static m3pi_event obey(m3pi_core *core, uint32_t now_ms)
{
    const uint8_t *frame = core->reader.frame;
    const uint8_t sequence = frame[1];
    const uint8_t flags = frame[2];
    const uint8_t ahead = (uint8_t)(sequence - core->sequence);
    const bool is_next = core->known && ahead >= 1u && ahead <= AHEAD_MAX;
    const bool is_new = core->forgotten || is_next;

    if (flags & M3PI_FLAG_EMERGENCY_STOP) {
        core->emergency_stopped = true;
    }
    if (!(flags & M3PI_FLAG_RUN) || core->emergency_stopped) {
        stop(core);
    } else if (is_new) {
        const bool is_named = core->index < frame[3];
        const uint8_t *wheels = frame + HEAD + 2u * (is_named ? core->index : 0u);
        core->left = is_named ? as_signed(wheels[0]) : 0;
        core->right = is_named ? as_signed(wheels[1]) : 0;
        core->running = is_named;
    }
    if (is_new) {
        core->sequence = sequence;
        core->heard_ms = now_ms;
        core->silent = false;
        core->forgotten = false;
        core->known = true;
    }
    if ((flags & M3PI_FLAG_POLL) && (is_new || !(flags & M3PI_FLAG_RUN))) {
        core->reply_pending = true;
        core->echo = sequence;
        core->due_ms = now_ms + (uint32_t)core->index * M3PI_REPLY_SLOT_MS;
    }
    return is_new ? M3PI_ACCEPTED : M3PI_STALE;
}

void m3pi_init(m3pi_core *core, uint8_t index)
{
    memset(core, 0, sizeof *core);
    core->index = index;
    core->silent = true;
}

void m3pi_emergency_stop(m3pi_core *core)
{
    core->emergency_stopped = true;
    stop(core);
}

m3pi_event m3pi_push(m3pi_core *core, uint8_t byte, uint32_t now_ms)
{
    const framing_event event = framing_push(&core->reader, byte);

    watch(core, now_ms);
    if (event == FRAMING_OPEN) {
        return M3PI_NOTHING;
    }
    if (event == FRAMING_GOOD && core->reader.frame[0] != COMMAND) {
        return M3PI_FOREIGN;
    }
    if (event == FRAMING_BAD || !is_well_formed(&core->reader)) {
        core->rejected++;
        return M3PI_REJECTED;
    }
    core->received++;
    return obey(core, now_ms);
}

void m3pi_wheels(m3pi_core *core, uint32_t now_ms, int8_t *left, int8_t *right)
{
    watch(core, now_ms);
    *left = core->left;
    *right = core->right;
}

uint8_t m3pi_status(m3pi_core *core, uint32_t now_ms)
{
    watch(core, now_ms);
    return (uint8_t)((core->running ? M3PI_STATUS_RUNNING : 0) |
                     (core->emergency_stopped ? M3PI_STATUS_EMERGENCY_STOPPED : 0) |
                     (core->silent ? M3PI_STATUS_SILENT : 0));
}

void m3pi_set_battery(m3pi_core *core, uint16_t battery_mv)
{
    core->battery_mv = battery_mv;
}

static void put16(uint8_t *at, uint16_t value)
{
    at[0] = (uint8_t)(value & 0xFFu);
    at[1] = (uint8_t)(value >> 8);
}

size_t m3pi_take_reply(m3pi_core *core, uint32_t now_ms, uint8_t reply[M3PI_REPLY_SIZE])
{
    uint8_t body[M3PI_REPLY_SIZE - 4u] = {REPLY, core->index, core->echo};

    if (!core->reply_pending || (uint32_t)(now_ms - core->due_ms) >= 0x80000000u) {
        return 0;
    }
    core->reply_pending = false;
    body[3] = m3pi_status(core, now_ms);
    put16(body + 4, core->battery_mv);
    put16(body + 6, core->received);
    put16(body + 8, core->rejected);
    return framing_seal(body, sizeof body, reply);
}

size_t m3pi_size(void)
{
    return sizeof(m3pi_core);
}
