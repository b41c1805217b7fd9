/* The loop around the core: radio bytes in, 3pi serial-slave commands and replies out.
 *
 * Portable too: it reaches the hardware only through the functions of m3pi_hal and m3pi_board.
 */
#ifndef M3PI_SHELL_H
#define M3PI_SHELL_H

#include "m3pi_core.h"

#ifdef __cplusplus
extern "C" {
#endif

#define M3PI_REPEAT_MS 20u    /* wheel commands repeat: a lost byte must not last */
#define M3PI_BATTERY_MS 1000u /* time between battery queries */

/* The two serial ports of a robot. */
typedef enum { M3PI_RADIO, M3PI_BASE, M3PI_PORTS } m3pi_port;

typedef struct {
    void *context;
    int (*read)(void *context, m3pi_port port); /* next byte, or -1 at once if there is none */
    void (*write)(void *context, m3pi_port port, const uint8_t *data, size_t length);
} m3pi_hal;

/* What a board offers besides reading and writing. */
typedef struct {
    m3pi_hal ports;
    void (*hold_base)(bool held); /* hold the 3pi in reset, or release it */
    void (*open_ports)(void);
    uint32_t (*now_ms)(void);
    void (*wait_ms)(uint32_t ms);
    void (*start_watchdog)(uint32_t ms); /* the chip's own watchdog, which resets the chip */
    void (*feed_watchdog)(void);
    bool was_reset_by_watchdog;
} m3pi_board;

typedef struct {
    m3pi_core core;
    m3pi_hal hal;
    uint32_t sent_ms, asked_ms;
    int8_t left, right;
    uint8_t answer[2], answered;
    bool awaits_battery;
} m3pi_shell;

/* Start a robot that is stopped, and stop the 3pi. */
void m3pi_shell_start(m3pi_shell *shell, const m3pi_hal *hal, uint8_t index, uint32_t now_ms);

/* Do one round of the main loop. Call it about every millisecond. */
void m3pi_shell_step(m3pi_shell *shell, uint32_t now_ms);

/* The program of a robot; it never returns. It resets the 3pi first, which would otherwise drive on
 * by itself after a reset of this chip. If the chip's own watchdog caused that reset, the robot
 * starts emergency-stopped. */
void m3pi_shell_run(const m3pi_board *board, uint8_t index);

#ifdef __cplusplus
}
#endif

#endif
