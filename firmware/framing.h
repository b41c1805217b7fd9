/* Frames on a serial line: COBS stuffing, a closing 00, CRC-16/CCITT-FALSE little-endian at the end.
 *
 * Portable C99 without I/O, heap or floats.
 */
#ifndef FRAMING_H
#define FRAMING_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define FRAMING_MAX 80u /* bytes of a payload, its CRC included */

typedef enum {
    FRAMING_OPEN, /* in the middle of a frame, or between two */
    FRAMING_GOOD, /* a frame ended and its CRC is right */
    FRAMING_BAD   /* a frame ended with wrong stuffing, length or CRC */
} framing_event;

/* All zero is the state between two frames. After FRAMING_GOOD, `frame` holds the `length` bytes of
 * the payload without CRC, until the next push. */
typedef struct {
    uint8_t length, code, code_left;
    bool started, overlong, closed;
    uint8_t frame[FRAMING_MAX];
} framing_reader;

/* Read one byte. */
framing_event framing_push(framing_reader *reader, uint8_t byte);

/* Write a payload of at most 251 bytes with CRC, stuffing and closing 00 to `out`, which has room
 * for four bytes more; return the size. */
size_t framing_seal(const uint8_t *payload, size_t length, uint8_t *out);

#ifdef __cplusplus
}
#endif

#endif
