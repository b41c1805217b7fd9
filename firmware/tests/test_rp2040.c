/* Plays the board around main_rp2040.c: time passes in its sleeps only, the radio hears frames at set
 * times, and what it does to the 3pi is checked; first after power-up, then after a reset by the chip's
 * own watchdog. */
#define ROBOT_INDEX 0
#define main robot_main
#include "main_rp2040.c"
#undef main

#include <setjmp.h>
#include <stdio.h>

struct uart_inst {
    uint tx, baud;
    const uint8_t *waiting;
    size_t left;
};
static uart_inst_t radio = {0, 0, NULL, 0}, base = {4, 0, NULL, 0};
uart_inst_t *const uart0 = &radio, *const uart1 = &base;

static const uint8_t drive[] = {9, 0x51, 7, 1, 3, 0x40, 0xC0, 0x7F, 0x7F, 1, 1, 2, 0x7D, 0};
static const uint8_t battery[] = {0x34, 0x12};
static uint32_t now, fed, bitten_after, reset_low, started, stopped;
static uint8_t poll[16], answer[M3PI_REPLY_SIZE];
static size_t answered, polled;
static bool pins[30], driving, out_of_reset;
static int failures;
static bool bitten;    /* whether the chip's own watchdog caused the reset */
static jmp_buf outside; /* of the program, whose loop has no end */

static void check(bool ok, const char *what)
{
    if (!ok) {
        printf("%s is wrong\n", what);
        failures++;
    }
}

static void check_hardware(void)
{
    check(radio.baud == 57600 && base.baud == 115200, "baud");
    check(pins[0] && pins[1] && pins[4] && pins[5], "function of pins");
    check(reset_low == 10 && out_of_reset, "reset of the 3pi");
    check(bitten_after == 250 && fed >= 700 && fed <= 801, "watchdog of the chip");
    check(answered == sizeof answer && answer[1] == 0x52, "reply to a poll");
}

static void check_robot_that_drives(void)
{
    check(started >= 300 && started <= 302, "start");
    check(stopped >= 550 && stopped <= 552, "stop by the watchdog");
}

/* Regression: after a reset by the chip's own watchdog the robot took up the next frame. */
static void check_latched_robot(void)
{
    check(started == 0, "robot after a bite of the watchdog");
    check(answer[4] == M3PI_STATUS_EMERGENCY_STOPPED, "status after a bite of the watchdog");
}

static void reset(void)
{
    now = 0;
    fed = 0;
    reset_low = 0;
    out_of_reset = false;
    started = 0;
    stopped = 0;
    driving = false;
    answered = 0;
}

void sleep_ms(uint32_t ms)
{
    reset_low += out_of_reset ? 0 : ms;
    now += ms;
    if (now == 300) {
        radio.waiting = drive;
        radio.left = sizeof drive;
    } else if (now == 700) {
        const uint8_t body[] = {0x51, 8, M3PI_FLAG_POLL, 0};
        polled = framing_seal(body, sizeof body, poll);
        radio.waiting = poll;
        radio.left = polled;
    } else if (now == 1000) {
        longjmp(outside, 1);
    }
}

void uart_write_blocking(uart_inst_t *uart, const uint8_t *data, size_t size)
{
    static const uint8_t forward[] = {0xC1, 64, 0xC6, 64}, still[] = {0xC1, 0, 0xC5, 0};

    for (size_t i = 0; uart == &radio && i < size && answered < sizeof answer; i++) {
        answer[answered++] = data[i];
    }
    if (uart == &base && size == 1) {
        base.waiting = battery;
        base.left = sizeof battery;
    } else if (uart == &base) {
        const bool drives = data[1] != 0;
        check(size == 4, "size of a command");
        for (size_t i = 0; i < 4; i++) {
            check(data[i] == (drives ? forward[i] : still[i]), "command");
        }
        started = drives && !driving ? now : started;
        stopped = !drives && driving ? now : stopped;
        driving = drives;
    }
}

uint uart_init(uart_inst_t *uart, uint baud) { return uart->baud = baud; }
bool uart_is_readable(uart_inst_t *uart) { return uart->left > 0; }
char uart_getc(uart_inst_t *uart)
{
    uart->left--;
    return (char)*uart->waiting++;
}
void gpio_init(uint gpio) { check(gpio == 6, "pin"); }
void gpio_put(uint gpio, bool value) { out_of_reset = gpio == 6 && value; }
void gpio_set_dir(uint gpio, bool out) { check(gpio == 6 && out, "direction"); }
void gpio_set_function(uint gpio, enum gpio_function function)
{
    pins[gpio] = function == GPIO_FUNC_UART;
}
absolute_time_t get_absolute_time(void) { return now; }
uint32_t to_ms_since_boot(absolute_time_t time) { return (uint32_t)time; }
bool watchdog_enable_caused_reboot(void) { return bitten; }
void watchdog_enable(uint32_t ms, bool pause_on_debug)
{
    bitten_after = ms;
    check(pause_on_debug, "pause of the watchdog");
}
void watchdog_update(void) { fed++; }

int main(void)
{
    if (setjmp(outside) == 0) {
        (void)robot_main();
    }
    check_hardware();
    check_robot_that_drives();
    reset();
    bitten = true;
    if (setjmp(outside) == 0) {
        (void)robot_main();
    }
    check_hardware();
    check_latched_robot();
    printf(failures > 0 ? "failed\n" : "passed\n");
    return failures > 0;
}
