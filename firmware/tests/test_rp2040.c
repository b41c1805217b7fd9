/* Plays the board around main_rp2040.c; time passes only in its sleeps. */
#define ROBOT_INDEX 0
#define main robot_main
#include "main_rp2040.c"
#undef main

#include "board.h"

struct uart_inst {
    int port;
    uint tx, baud;
};
static uart_inst_t radio = {BOARD_RADIO, 0, 0}, base = {BOARD_BASE, 4, 0};
uart_inst_t *const uart0 = &radio, *const uart1 = &base;
static bool serial[30]; /* pins */

uint uart_init(uart_inst_t *uart, uint baud) { return uart->baud = baud; }
bool uart_is_readable(uart_inst_t *uart) { return board_has(uart->port); }
char uart_getc(uart_inst_t *uart) { return (char)board_read(uart->port); }
void uart_write_blocking(uart_inst_t *uart, const uint8_t *data, size_t size)
{
    for (size_t i = 0; i < size; i++) {
        board_write(uart->port, data[i]);
    }
}
void gpio_init(uint gpio) { board_check(gpio == 6, "pin"); }
void gpio_put(uint gpio, bool value)
{
    board_check(gpio == 6, "pin");
    board_hold_base(!value);
}
void gpio_set_dir(uint gpio, bool out) { board_check(gpio == 6 && out, "direction"); }
void gpio_set_function(uint gpio, enum gpio_function function)
{
    serial[gpio] = function == GPIO_FUNC_UART;
}
absolute_time_t get_absolute_time(void) { return board_now_ms(); }
uint32_t to_ms_since_boot(absolute_time_t time) { return (uint32_t)time; }
void sleep_ms(uint32_t ms) { board_pass(ms); }
bool watchdog_enable_caused_reboot(void) { return board_was_reset_by_watchdog; }
void watchdog_enable(uint32_t ms, bool pause_on_debug)
{
    board_check(pause_on_debug, "pause of the watchdog");
    board_start_watchdog(ms);
}
void watchdog_update(void) { board_feed_watchdog(); }

static void reset_chip(void)
{
    radio.baud = base.baud = 0;
    for (int pin = 0; pin < 30; pin++) {
        serial[pin] = false;
    }
}

static void check_chip(void)
{
    board_check(radio.baud == 57600 && base.baud == 115200, "baud");
    board_check(serial[0] && serial[1] && serial[4] && serial[5], "function of pins");
}

int main(void) { return board_play(robot_main, reset_chip, check_chip); }
