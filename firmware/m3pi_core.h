/* What an m3pi does with the bytes its radio hands it: frames in, wheel counts and replies out.
 *
 * Portable C99 without I/O, clock, heap or floats, so that the very same code runs on the robot,
 * in host tests and inside the emulated robots. The caller passes the time in.
 *
 * Frame, COBS-stuffed and closed by 00:
 *   51 sequence flags n {i8 left, i8 right} * n, CRC-16/CCITT-FALSE little-endian
 * Reply to a poll, sent `index` slots after it, framed alike:
 *   52 index sequence status u16 battery_mv u16 received u16 rejected, CRC
 *
 * Sequence: a frame is new if it is 1 to 127 steps ahead of the last new one, modulo 256; or if
 * nothing new has come for M3PI_FORGET_MS, which is how a restarted controller is taken up. So no
 * frame is new for as long after power-up. Frames that are not new never set wheels and never feed
 * the watchdog; but a frame that tells to stop is obeyed, new or not. The watchdog stops the robot
 * long before it forgets the number, and one that has just been switched on waits: a frame that the
 * radio delivers late, by less than M3PI_FORGET_MS, cannot drive a robot that has stopped.
 *
 * Emergency stop: latched by any frame that checks and has the flag, and by m3pi_emergency_stop.
 * Only m3pi_init clears it, that is, switching the robot off and on.
 */
#ifndef M3PI_CORE_H
#define M3PI_CORE_H

#include "framing.h"

#ifdef __cplusplus
extern "C" {
#endif

#define M3PI_ROBOTS_MAX 32u
#define M3PI_FRAME_MAX (4u + 2u * M3PI_ROBOTS_MAX + 2u) /* unstuffed, with CRC */
#define M3PI_REPLY_SIZE 14u                             /* stuffed, with the closing 00 */
#define M3PI_WATCHDOG_MS 250u
#define M3PI_FORGET_MS 1000u
#define M3PI_REPLY_SLOT_MS 10u

enum { M3PI_FLAG_RUN = 1, M3PI_FLAG_EMERGENCY_STOP = 2, M3PI_FLAG_POLL = 4 };
enum { M3PI_STATUS_RUNNING = 1, M3PI_STATUS_EMERGENCY_STOPPED = 2, M3PI_STATUS_SILENT = 4 };

typedef enum {
    M3PI_NOTHING,  /* in the middle of a frame */
    M3PI_ACCEPTED, /* a new frame */
    M3PI_STALE,    /* a good frame, old or a duplicate; only a stop in it was obeyed */
    M3PI_REJECTED, /* wrong stuffing, length, CRC, flags or counts */
    M3PI_FOREIGN   /* a good frame that is no command, such as another robot's reply */
} m3pi_event;

/* Private: use the functions. */
typedef struct {
    uint32_t heard_ms; /* the last new frame */
    uint32_t due_ms;   /* when the pending reply is to leave */
    uint16_t battery_mv, received, rejected;
    uint8_t index;
    uint8_t sequence;
    uint8_t echo;
    int8_t left, right;
    bool running, silent, known, forgotten, emergency_stopped, reply_pending;
    framing_reader reader;
} m3pi_core;

/* Power-up: stopped, silent, not latched; times count from it. `index` is the robot's place in the frame, from 0. */
void m3pi_init(m3pi_core *core, uint8_t index);

/* Latch the emergency stop. Call it after m3pi_init if the chip's own watchdog has reset the chip:
 * the memory that held an emergency stop is lost then. */
void m3pi_emergency_stop(m3pi_core *core);

/* Take one byte from the radio. */
m3pi_event m3pi_push(m3pi_core *core, uint8_t byte, uint32_t now_ms);

/* Give the counts, -127..127, to drive with now. Call it at least every few milliseconds: the
 * watchdog is assessed here. */
void m3pi_wheels(m3pi_core *core, uint32_t now_ms, int8_t *left, int8_t *right);

/* Write the reply that is due now, if any, and return its size, else 0. */
size_t m3pi_take_reply(m3pi_core *core, uint32_t now_ms, uint8_t reply[M3PI_REPLY_SIZE]);

/* Tell the battery's voltage for the next replies; 0 for unknown. */
void m3pi_set_battery(m3pi_core *core, uint16_t battery_mv);

/* M3PI_STATUS_ bits as they stand now. */
uint8_t m3pi_status(m3pi_core *core, uint32_t now_ms);

/* Size of m3pi_core, for callers that cannot see the type. */
size_t m3pi_size(void);

#ifdef __cplusplus
}
#endif

#endif
