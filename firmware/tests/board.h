/* The surroundings of a board that a test plays: a radio that receives frames at set times, and a
 * 3pi. What the robot's program does to them is checked. */
#ifndef BOARD_H
#define BOARD_H

#include <stdbool.h>
#include <stdint.h>

enum { BOARD_RADIO, BOARD_BASE }; /* the two serial ports */

extern bool board_was_reset_by_watchdog;

/* Run the program twice, for a second each: after power-up, and after a reset by the chip's own
 * watchdog. `check_chip` is called after each. Return what main() is to return. */
int board_play(int (*program)(void), void (*reset_chip)(void), void (*check_chip)(void));

void board_check(bool ok, const char *what);
uint32_t board_now_ms(void);
void board_pass(uint32_t ms); /* does not return at the end of the second */
int board_read(int port);     /* the next byte that the program could read, or -1 */
bool board_has(int port);
void board_write(int port, uint8_t byte);
void board_hold_base(bool held);
void board_start_watchdog(uint32_t ms);
void board_feed_watchdog(void);

#endif
