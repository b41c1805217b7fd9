/* Plays the chip around main_lpc1768.c, as NXP's user manual UM10360 describes it. */
#define ROBOT_INDEX 0
#define main robot_main
#include "main_lpc1768.c"
#undef main

#include "board.h"

#include <string.h>

#define READS_A_MS 5u /* of the timer: time passes only then */
#define RESET_PIN 0x8u /* P2.3, p23 of the mbed */

static struct {
    uint32_t scs, source, divider, pll, pll_wished, pll_fed, power, pclksel0, pclksel1, pinsel0;
    uint32_t output, level; /* port 2 */
    uint32_t timer, timer_divider, timer_zero, reads;
    uint32_t mode, limit, watchdog_fed;
    uint32_t reset_cause;
    struct {
        uint32_t line, low, high, fraction, fifo, sent;
    } ports[2];
} chip;

static bool has_clock(void)
{
    return chip.source == 1 && (chip.scs & 0x20u) && chip.pll == 0 && chip.divider == 0;
}

static uint32_t read_timer(void)
{
    if (!(chip.timer == 1 && has_clock())) { /* it would never move on */
        board_check(false, "timer or clock");
        board_pass(2000);
    }
    if (++chip.reads % READS_A_MS == 0) {
        board_pass(1);
    }
    return board_now_ms() - chip.timer_zero;
}

static uint32_t read_port(int port, uint32_t offset)
{
    const bool is_ready = chip.ports[port].fifo == 7 && chip.ports[port].line == 3;

    board_check(is_ready, "port that is read");
    if (offset == 0x14) {
        chip.ports[port].sent = 0;
        return 0x60u | (board_has(port) ? 1u : 0u);
    }
    board_check(offset == 0 && board_has(port), "read of an empty port");
    return (uint32_t)board_read(port);
}

static void write_port(int port, uint32_t offset, uint32_t value)
{
    const bool is_open = chip.ports[port].line & 0x80u;

    board_check(chip.power & (port == BOARD_RADIO ? 1u << 24 : 1u << 25), "power of a port");
    if (offset == 0 && is_open) {
        chip.ports[port].low = value;
    } else if (offset == 0) {
        board_check(++chip.ports[port].sent <= 16, "number of bytes in a FIFO of 16");
        board_write(port, (uint8_t)value);
    } else if (offset == 4 && is_open) {
        chip.ports[port].high = value;
    } else if (offset == 8) {
        chip.ports[port].fifo = value;
    } else if (offset == 0xC) {
        chip.ports[port].line = value;
    } else if (offset == 0x28) {
        chip.ports[port].fraction = value;
    } else {
        board_check(false, "register of a port");
    }
}

static double rate_error(int port, double wished)
{
    const double divisor = 256.0 * chip.ports[port].high + chip.ports[port].low;
    const double add = chip.ports[port].fraction & 0xFu, mul = chip.ports[port].fraction >> 4;
    const double error = 12e6 / (16 * divisor * (1 + add / mul)) / wished - 1;
    return error < 0 ? -error : error;
}

uint32_t lpc_read(uint32_t address)
{
    switch (address) {
    case 0x400FC1A0: return chip.scs | (chip.scs & 0x20u) << 1; /* the crystal is ready at once */
    case 0x400FC1A8: return chip.pclksel0;
    case 0x400FC1AC: return chip.pclksel1;
    case 0x400FC0C4: return chip.power;
    case 0x400FC180: return chip.reset_cause;
    case 0x4002C000: return chip.pinsel0;
    case 0x2009C040: return chip.output;
    case 0x40004008: return read_timer();
    case 0x40098000: case 0x40098014: return read_port(BOARD_RADIO, address & 0xFFu);
    case 0x4009C000: case 0x4009C014: return read_port(BOARD_BASE, address & 0xFFu);
    default: board_check(false, "address that is read"); return 0;
    }
}

static void write_pin(void)
{
    if (chip.output & RESET_PIN) {
        board_hold_base(!(chip.level & RESET_PIN));
    }
}

static void feed_pll(uint32_t value)
{
    board_check(value == 0xAA || chip.pll_fed == 0xAA, "feeding of the PLL");
    if (value == 0x55) {
        board_check(!(chip.pll == 3 && chip.pll_wished == 0), "PLL, switched off while connected");
        chip.pll = chip.pll_wished;
    }
    chip.pll_fed = value;
}

static void feed_watchdog_of_chip(uint32_t value)
{
    board_check(value == 0xAA || chip.watchdog_fed == 0xAA, "feeding of the watchdog");
    if (value == 0x55) {
        board_check(chip.mode == 3, "mode of the watchdog");
        if (chip.limit > 0) {
            board_start_watchdog(chip.limit / 1000u); /* counts 4 MHz / 4 */
            chip.limit = 0;
        }
        board_feed_watchdog();
    }
    chip.watchdog_fed = value;
}

void lpc_write(uint32_t address, uint32_t value)
{
    switch (address) {
    case 0x400FC1A0: chip.scs = value; break;
    case 0x400FC10C: chip.source = value; break;
    case 0x400FC104: chip.divider = value; break;
    case 0x400FC080: chip.pll_wished = value; break;
    case 0x400FC08C: feed_pll(value); break;
    case 0x400FC1A8: chip.pclksel0 = value; break;
    case 0x400FC1AC: chip.pclksel1 = value; break;
    case 0x400FC0C4: chip.power = value; break;
    case 0x400FC180: chip.reset_cause &= ~value; break;
    case 0x4002C000: chip.pinsel0 = value; break;
    case 0x2009C040: chip.output = value; write_pin(); break;
    case 0x2009C058: chip.level |= value; write_pin(); break;
    case 0x2009C05C: chip.level &= ~value; write_pin(); break;
    case 0x40004004: chip.timer = value; chip.timer_zero = board_now_ms(); break;
    case 0x4000400C: chip.timer_divider = value; break;
    case 0x40000000: chip.mode = value; break;
    case 0x40000004: chip.limit = value; break;
    case 0x40000008: feed_watchdog_of_chip(value); break;
    case 0x40000010: board_check(value == 0, "clock of the watchdog"); break;
    default:
        if (address >> 8 == 0x400980) {
            write_port(BOARD_RADIO, address & 0xFFu, value);
        } else if (address >> 8 == 0x4009C0) {
            write_port(BOARD_BASE, address & 0xFFu, value);
        } else {
            board_check(false, "address that is written");
        }
    }
}

static void reset_chip(void)
{
    memset(&chip, 0, sizeof chip);
    chip.pll = 3; /* as a boot loader may leave it */
    chip.power = 0x042887DEu; /* other peripherals are on after a reset */
    chip.reset_cause = board_was_reset_by_watchdog ? 4 : 3;
}

static void check_chip(void)
{
    board_check(rate_error(BOARD_RADIO, 57600) < 0.002, "rate of the radio's port");
    board_check(rate_error(BOARD_BASE, 115200) < 0.002, "rate of the 3pi's port");
    board_check((chip.pclksel1 >> 16 & 0xFu) == 5, "clock of the ports");
    board_check((chip.pclksel0 >> 2 & 3u) == 1 && chip.timer_divider == 11999, "clock of the timer");
    board_check((chip.pinsel0 & 0xFu) == 0xA && (chip.pinsel0 >> 20 & 0xFu) == 5, "function of pins");
    board_check((chip.power & 0x042887DEu) == 0x042887DEu, "power of other peripherals");
    board_check(chip.reset_cause == 0, "erased cause of the reset");
}

int main(void) { return board_play(robot_main, reset_chip, check_chip); }
