/* The loop around the core: radio bytes in, 3pi serial-slave commands and replies out.
 *
 * Portable too; it reaches the hardware through four functions only.
 */
#ifndef M3PI_SHELL_H
#define M3PI_SHELL_H

#include "m3pi_core.h"

#ifdef __cplusplus
extern "C" {
#endif

#define M3PI_REPEAT_MS 20u    /* wheel commands repeat: a lost byte must not last */
#define M3PI_BATTERY_MS 1000u /* time between battery queries */

typedef struct {
    void *context;
    int (*radio_read)(void *context); /* next byte, or -1 at once if there is none */
    void (*radio_write)(void *context, const uint8_t *data, size_t length);
    int (*base_read)(void *context); /* the 3pi, likewise */
    void (*base_write)(void *context, const uint8_t *data, size_t length);
} m3pi_hal;

typedef struct {
    m3pi_core core;
    m3pi_hal hal;
    uint32_t sent_ms, asked_ms;
    int8_t left, right;
    uint8_t answer[2], answered;
    bool awaits_battery;
} m3pi_shell;

/* Power-up; the 3pi is told to stop. */
void m3pi_shell_start(m3pi_shell *shell, const m3pi_hal *hal, uint8_t index, uint32_t now_ms);

/* One round; call it every millisecond or so. */
void m3pi_shell_step(m3pi_shell *shell, uint32_t now_ms);

#ifdef __cplusplus
}
#endif

#endif
