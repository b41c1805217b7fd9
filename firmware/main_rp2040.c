/* An RP2040 board on the m3pi's headers, with the Pico SDK. NOT TRIED ON HARDWARE: no robot was at
 * hand. All that decides anything is in m3pi_core.c and m3pi_shell.c; here is only wiring.
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

static void open_port(uart_inst_t *port, uint baud, uint tx)
{
    uart_init(port, baud);
    gpio_set_function(tx, GPIO_FUNC_UART);
    gpio_set_function(tx + 1, GPIO_FUNC_UART);
}

int main(void)
{
    static m3pi_shell shell;
    const m3pi_hal hal = {NULL, radio_read, radio_write, base_read, base_write};

    /* Also after the chip's own watchdog has bitten: the 3pi would drive on by itself. */
    gpio_init(BASE_RESET);
    gpio_put(BASE_RESET, false);
    gpio_set_dir(BASE_RESET, true);
    sleep_ms(10);
    gpio_put(BASE_RESET, true);
    sleep_ms(200);

    open_port(uart0, RADIO_BAUD, 0);
    open_port(uart1, BASE_BAUD, 4);
    m3pi_shell_start(&shell, &hal, ROBOT_INDEX, now_ms());
    if (watchdog_enable_caused_reboot()) { /* not a new program or the reset button */
        m3pi_emergency_stop(&shell.core);
    }
    watchdog_enable(M3PI_WATCHDOG_MS, true);
    for (;;) {
        m3pi_shell_step(&shell, now_ms());
        watchdog_update();
        sleep_ms(1);
    }
}
