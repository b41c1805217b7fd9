/* An RP2040 board in place of the mbed, with the Pico SDK. NEVER RUN ON A ROBOT, as no robot was at
 * hand. All decisions are in m3pi_core.c and m3pi_shell.c. This file only connects them to the
 * hardware.
 *
 * XBee on GP0 (tx), GP1 (rx), transparent mode at RADIO_BAUD; 3pi with the serial-slave program on
 * GP4 (tx), GP5 (rx), its reset on GP6. The 3pi has logic of 5 V and the RP2040 of 3.3 V: GP5 and GP6
 * need a level shifter. Build once per robot with -DROBOT_INDEX=0, 1, ...
 */
#include "m3pi_robot.h"

#include "hardware/watchdog.h"
#include "pico/stdlib.h"

#define BASE_RESET 6

static const uint first_pin[M3PI_PORTS] = {0, 4}; /* tx; rx is the next one */

static uart_inst_t *uart_of(m3pi_port port) { return port == M3PI_RADIO ? uart0 : uart1; }

static int read_one(void *context, m3pi_port port)
{
    (void)context;
    return uart_is_readable(uart_of(port)) ? (uint8_t)uart_getc(uart_of(port)) : -1;
}

static void write_all(void *context, m3pi_port port, const uint8_t *data, size_t length)
{
    (void)context;
    uart_write_blocking(uart_of(port), data, length);
}

static uint32_t now_ms(void) { return to_ms_since_boot(get_absolute_time()); }

static void hold_base(bool held)
{
    gpio_init(BASE_RESET);
    gpio_put(BASE_RESET, !held);
    gpio_set_dir(BASE_RESET, true);
}

static void open_port(m3pi_port port)
{
    uart_init(uart_of(port), port_baud[port]);
    gpio_set_function(first_pin[port], GPIO_FUNC_UART);
    gpio_set_function(first_pin[port] + 1, GPIO_FUNC_UART);
}

static void open_ports(void)
{
    open_port(M3PI_RADIO);
    open_port(M3PI_BASE);
}

static void start_watchdog(uint32_t ms) { watchdog_enable(ms, true); }

int main(void)
{
    const m3pi_board board = {
        .ports = {NULL, read_one, write_all},
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
