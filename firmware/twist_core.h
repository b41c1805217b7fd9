/* What a robot on two wheels does with lines of text: commands in, wheel speeds and replies out.
 *
 * Portable C99 without I/O, clock, heap or floats: the same code runs on a robot, in host tests and
 * inside the emulated robots. The caller passes the time in. micropython/twist.py does the same in
 * MicroPython; both pass tests/twist_vectors.txt.
 *
 * A command, in ASCII, closed by LF (a CR before it is ignored):
 *   T sequence flags {index v w} ... *CRC        v [mm/s], w [mrad/s], anticlockwise positive
 *   W sequence flags {index left right} ... *CRC      speeds of the wheels [mm/s]
 * Numbers are decimal with one space between them; CRC is CRC-16/CCITT-FALSE of everything before
 * the *, as four hexadecimal digits. A robot obeys the first entry with its own index; a robot that
 * no entry names stops. Reply to a poll, sent `index` slots after it:
 *   S index sequence status battery_mv received rejected*CRC
 *
 * Flags, sequence, watchdog and emergency stop are those of m3pi_core.h.
 */
#ifndef TWIST_CORE_H
#define TWIST_CORE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define TWIST_ROBOTS_MAX 32u
#define TWIST_LINE_MAX 300u /* characters of a line without its end */
#define TWIST_REPLY_MAX 48u
#define TWIST_WATCHDOG_MS 250u
#define TWIST_FORGET_MS 1000u /* then any sequence is new */
#define TWIST_REPLY_SLOT_MS 20u
#define TWIST_SPEED_MAX 5000  /* mm/s */
#define TWIST_TURN_MAX 50000 /* mrad/s */

enum { TWIST_FLAG_RUN = 1, TWIST_FLAG_EMERGENCY_STOP = 2, TWIST_FLAG_POLL = 4 };
enum { TWIST_STATUS_RUNNING = 1, TWIST_STATUS_EMERGENCY_STOPPED = 2, TWIST_STATUS_SILENT = 4 };

typedef enum {
    TWIST_NOTHING,  /* in the middle of a line */
    TWIST_ACCEPTED, /* a new command */
    TWIST_STALE,    /* a good command, old or a duplicate; only a stop in it was obeyed */
    TWIST_REJECTED, /* wrong CRC, form or numbers */
    TWIST_FOREIGN   /* a good line that is no command, such as another robot's reply */
} twist_event;

/* Private: use the functions. */
typedef struct {
    /* what robot this is */
    uint8_t index;
    uint16_t radius_mm;
    uint16_t battery_mv;

    /* the line that is being received */
    char line[TWIST_LINE_MAX];
    size_t length;
    bool overlong; /* it has had more characters than there is room for */

    /* what it does */
    int32_t left;  /* mm/s */
    int32_t right; /* mm/s */
    bool running;
    bool emergency_stopped; /* until power is switched off */

    /* the last new command */
    uint8_t sequence;
    uint32_t heard_ms;
    bool silent; /* none has come for TWIST_WATCHDOG_MS */
    bool known;  /* a sequence, as one has come since power-up */
    bool forgotten; /* the sequence: none has come for TWIST_FORGET_MS */

    /* the reply that is to come */
    bool reply_pending;
    uint8_t echo; /* sequence of the poll */
    uint32_t due_ms;

    /* good lines and bad ones since power-up; both wrap round */
    uint16_t received;
    uint16_t rejected;
} twist_core;

/* Power-up: stopped, silent, not latched; times count from it. `index` is the robot's number in
 * commands, `radius_mm` the distance from a wheel to the robot's centre. */
void twist_init(twist_core *core, uint8_t index, uint16_t radius_mm);

/* Take one byte from the radio. */
twist_event twist_push(twist_core *core, uint8_t byte, uint32_t now_ms);

/* Give the speeds [mm/s] to drive the wheels with now. Call it at least every few milliseconds: the
 * watchdog is assessed here. */
void twist_wheels(twist_core *core, uint32_t now_ms, int32_t *left, int32_t *right);

/* Write the reply that is due now, if any, and return its size, else 0. */
size_t twist_take_reply(twist_core *core, uint32_t now_ms, char reply[TWIST_REPLY_MAX]);

/* Tell the battery's voltage for the next replies; 0 for unknown. */
void twist_set_battery(twist_core *core, uint16_t battery_mv);

/* TWIST_STATUS_ bits as they stand now. */
uint8_t twist_status(twist_core *core, uint32_t now_ms);

/* Size of twist_core, for callers that cannot see the type. */
size_t twist_size(void);

#ifdef __cplusplus
}
#endif

#endif
