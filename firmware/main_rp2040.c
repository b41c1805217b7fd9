/* An RP2040 board in place of the mbed, with the Pico SDK. NEVER RUN ON A ROBOT, as no robot was at
 * hand. All decisions are in m3pi_core.c and m3pi_shell.c. This file only connects them to the
 * hardware.
 *
 * XBee on GP0 (tx), GP1 (rx), transparent mode at RADIO_BAUD; 3pi with the serial-slave program on
 * GP4 (tx), GP5 (rx), its reset on GP6. The 3pi has logic of 5 V and the RP2040 of 3.3 V: GP5 and GP6
 * need a level shifter. Build once per robot with -DROBOT_INDEX=0, 1, ...
 */
#include "m3pi_shell.h"

#include "hardware/watchdog.h"
#include "pico/stdlib.h"

#ifndef ROBOT_INDEX
#error "define ROBOT_INDEX: the robot's place in the spec, from 0"
#endif
#ifndef RADIO_BAUD
#define RADIO_BAUD 57600
#endif
#define BASE_BAUD 115200
#define BASE_RESET 6

static int read_one(uart_inst_t *port)
{
    return uart_is_readable(port) ? (uint8_t)uart_getc(port) : -1;
}

static int radio_read(void *context)
{
    (void)context;
    return read_one(uart0);
}

static int base_read(void *context)
{
    (void)context;
    return read_one(uart1);
}

static void radio_write(void *context, const uint8_t *data, size_t length)
{
    (void)context;
    uart_write_blocking(uart0, data, length);
}

static void base_write(void *context, const uint8_t *data, size_t length)
{
    (void)context;
    uart_write_blocking(uart1, data, length);
}

static uint32_t now_ms(void) { return to_ms_since_boot(get_absolute_time()); }

static void hold_base(bool held)
{
    gpio_init(BASE_RESET);
    gpio_put(BASE_RESET, !held);
    gpio_set_dir(BASE_RESET, true);
}

static void open_port(uart_inst_t *port, uint baud, uint tx)
{
    uart_init(port, baud);
    gpio_set_function(tx, GPIO_FUNC_UART);
    gpio_set_function(tx + 1, GPIO_FUNC_UART);
}

static void open_ports(void)
{
    open_port(uart0, RADIO_BAUD, 0);
    open_port(uart1, BASE_BAUD, 4);
}

static void start_watchdog(uint32_t ms) { watchdog_enable(ms, true); }

int main(void)
{
    const m3pi_board board = {
        .ports = {NULL, radio_read, radio_write, base_read, base_write},
        .hold_base = hold_base,
        .open_ports = open_ports,
        .now_ms = now_ms,
        .wait_ms = sleep_ms,
        .start_watchdog = start_watchdog,
        .feed_watchdog = watchdog_update,
        .was_reset_by_watchdog = watchdog_enable_caused_reboot(), /* not a new program, no button */
    };

    m3pi_shell_run(&board, ROBOT_INDEX);
    return 0;
}
