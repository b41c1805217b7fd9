/* What the current driver of two coils does with the bytes on its serial line: frames in, current
 * set points and replies out.
 *
 * Portable C99 without I/O, clock, heap or floats, so that the very same code runs on the driver,
 * in host tests and inside the emulated driver. The caller passes the time in.
 *
 * Frame, COBS-stuffed and closed by 00:
 *   53 sequence flags i16 x_ma i16 y_ma, CRC-16/CCITT-FALSE; all little-endian
 * Reply to a poll, at once, framed alike:
 *   54 sequence status version, i16 x_ma y_ma (measured), u16 supply_mv, i16 temperature_dc,
 *   u16 received rejected, u16 current_max_ma, u32 slew_ma_s, u16 watchdog_ms, CRC
 *
 * Sequence: a frame is new if it is 1 to 127 steps ahead of the last new one, modulo 256; or if
 * the driver has been silent (nothing new for its watchdog's time, or nothing since power-up),
 * which is how a restarted controller is taken up. Frames that are not new never set currents and
 * never feed the watchdog; but a frame that tells to stop is obeyed, new or not.
 *
 * Limits: where a wished current exceeds current_max_ma both are scaled alike, which keeps the
 * field's direction. The set points move in a straight line in the plane of the two currents,
 * neither faster than slew_ma_s; so do they to 0 on a stop, a silence, an emergency stop or heat: a
 * current broken off at once would drive the coils' energy into the supply.
 *
 * Emergency stop: latched by any frame that checks and has the flag, by a temperature of
 * temperature_max_dc, and by field_emergency_stop. Only field_init clears it, that is, switching the
 * driver off and on.
 */
#ifndef FIELD_CORE_H
#define FIELD_CORE_H

#include "framing.h"

#ifdef __cplusplus
extern "C" {
#endif

#define FIELD_VERSION 1u
#define FIELD_WATCHDOG_MS 250u
#define FIELD_REPLY_SIZE 28u                /* stuffed, with the closing 00 */
#define FIELD_TEMPERATURE_UNKNOWN (-32768)

enum { FIELD_FLAG_RUN = 1, FIELD_FLAG_EMERGENCY_STOP = 2, FIELD_FLAG_POLL = 4 };
enum {
    FIELD_STATUS_RUNNING = 1,           /* the last frame let it run */
    FIELD_STATUS_EMERGENCY_STOPPED = 2, /* latched */
    FIELD_STATUS_SILENT = 4,            /* the watchdog has stopped it */
    FIELD_STATUS_LIMITED = 8,           /* the last frame wished more than current_max_ma */
    FIELD_STATUS_HOT = 16               /* stopped by its temperature; latched */
};

typedef enum {
    FIELD_NOTHING,  /* in the middle of a frame */
    FIELD_ACCEPTED, /* a new frame */
    FIELD_STALE,    /* a good frame, old or a duplicate; only a stop in it was obeyed */
    FIELD_REJECTED, /* wrong stuffing, length, CRC or flags */
    FIELD_FOREIGN   /* a good frame that is no command */
} field_event;

/* What the driver and its coils bear; built into the driver, told in replies. */
typedef struct {
    uint16_t current_max_ma;    /* 1 to 32767 */
    uint32_t slew_ma_s;         /* of each current, at least 1 */
    uint16_t watchdog_ms;       /* FIELD_WATCHDOG_MS unless there is a reason */
    int16_t temperature_max_dc; /* tenths of a degree Celsius */
} field_limits;

/* Private: use the functions. */
typedef struct {
    field_limits limits;
    framing_reader reader;
    uint32_t heard_ms, moved_ms; /* the last new frame; when the set points were last moved */
    int32_t wished_ua[2], set_ua[2];
    int16_t measured_ma[2], temperature_dc;
    uint16_t supply_mv, received, rejected;
    uint8_t sequence, echo;
    bool running, silent, emergency_stopped, limited, hot, reply_pending;
} field_core;

/* Power-up: no current, silent, not latched, nothing measured. */
void field_init(field_core *core, const field_limits *limits, uint32_t now_ms);

/* Latch the emergency stop. Call it after field_init if the chip's own watchdog has reset the chip:
 * the memory that held an emergency stop is lost then. */
void field_emergency_stop(field_core *core);

/* Take one byte from the serial line. */
field_event field_push(field_core *core, uint8_t byte, uint32_t now_ms);

/* Give the currents [uA] to regulate to now. Call it every millisecond: watchdog and slew are done
 * here. */
void field_currents(field_core *core, uint32_t now_ms, int32_t *x_ua, int32_t *y_ua);

/* Tell what was measured, for the next replies and the temperature's limit; a supply of 0 mV and
 * FIELD_TEMPERATURE_UNKNOWN say not known. */
void field_measured(field_core *core, int16_t x_ma, int16_t y_ma, uint16_t supply_mv,
                    int16_t temperature_dc);

/* Write the pending reply, if any, and return its size, else 0. */
size_t field_take_reply(field_core *core, uint32_t now_ms, uint8_t reply[FIELD_REPLY_SIZE]);

/* FIELD_STATUS_ bits as they stand now. */
uint8_t field_status(field_core *core, uint32_t now_ms);

/* Size of field_core, for callers that cannot see the type. */
size_t field_size(void);

#ifdef __cplusplus
}
#endif

#endif
