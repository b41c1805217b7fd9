/* The mbed LPC1768 in the socket of a stock m3pi. NEVER RUN ON A ROBOT, as no robot was at hand: it
 * is compiled, and a test plays the chip around it. All decisions are in m3pi_core.c and
 * m3pi_shell.c. This file only connects them to the hardware.
 *
 *   mbed pin          LPC1768                 m3pi
 *   p28, p27          P0.10, P0.11: UART 2    XBee in transparent mode at RADIO_BAUD
 *   p9, p10           P0.0, P0.1: UART 3      3pi with Pololu's serial slave program
 *   p23               P2.3                    reset of the 3pi, low to hold it
 *   p26 (unused)      P2.0, pulled up         reset of the XBee
 *
 * These pins are those of the public mbed libraries for the m3pi and its XBee socket. The 3pi's
 * reset was on p8 in the first prototypes. The chip runs at the 12 MHz of the mbed's crystal,
 * without the PLL: that is fast enough, and less can go wrong.
 */
#include "lpc1768.h"
#include "m3pi_robot.h"

#define CRYSTAL_HZ 12000000u
#define BASE_RESET (1u << 3) /* in port 2 */

static const uint32_t uarts[M3PI_PORTS] = {LPC_UART2, LPC_UART3};

static void change(uint32_t address, uint32_t clear, uint32_t set)
{
    lpc_write(address, (lpc_read(address) & ~clear) | set);
}

static void hold_base(bool held)
{
    lpc_write(held ? LPC_FIO2CLR : LPC_FIO2SET, BASE_RESET);
    change(LPC_FIO2DIR, 0, BASE_RESET);
}

static void change_pll(uint32_t control)
{
    lpc_write(LPC_PLL0CON, control);
    lpc_write(LPC_PLL0FEED, 0xAA); /* takes effect only now */
    lpc_write(LPC_PLL0FEED, 0x55);
}

static void start_clock(void)
{
    change(LPC_SCS, 0, LPC_SCS_CRYSTAL_ON);
    while (!(lpc_read(LPC_SCS) & LPC_SCS_CRYSTAL_READY)) {
    }
    change_pll(1); /* disconnect it, then switch it off, if the boot ROM has left it on */
    change_pll(0);
    lpc_write(LPC_CLKSRCSEL, LPC_CLKSRCSEL_CRYSTAL);
    lpc_write(LPC_CCLKCFG, 0); /* divide by 1 */
}

/* Timer 0 counts milliseconds, modulo 2^32. */
static void start_timer(void)
{
    change(LPC_PCLKSEL0, 3u << LPC_PCLKSEL0_TIMER0, 1u << LPC_PCLKSEL0_TIMER0);
    lpc_write(LPC_T0TCR, LPC_T0TCR_RESET);
    lpc_write(LPC_T0PR, CRYSTAL_HZ / 1000u - 1u);
    lpc_write(LPC_T0TCR, LPC_T0TCR_RUN);
}

static uint32_t now_ms(void) { return lpc_read(LPC_T0TC); }

static void wait_ms(uint32_t ms)
{
    const uint32_t since = now_ms();
    while (now_ms() - since < ms) {
    }
}

/* The rate is CRYSTAL_HZ / (16 divisor (1 + add / mul)), UM10360 14.4.12.1, page 314: take what is
 * closest. */
static void set_rate(uint32_t uart, uint32_t baud)
{
    uint32_t closest = UINT32_MAX, divisor = 0, fraction = 0;

    for (uint32_t mul = 1; mul <= 15u; mul++) {
        for (uint32_t add = 0; add < mul; add++) {
            const uint32_t clock = CRYSTAL_HZ * mul;
            const uint32_t bits = 16u * baud * (mul + add);
            const uint32_t whole = (clock + bits / 2u) / bits;
            const uint32_t product = whole * bits;
            const uint32_t error = (product > clock ? product - clock : clock - product) / mul;
            if (whole >= 3u && error < closest) { /* a fraction is allowed from 3 on */
                closest = error;
                divisor = whole;
                fraction = mul << 4 | add;
            }
        }
    }
    lpc_write(uart + LPC_UART_LINE, LPC_UART_LINE_8N1 | LPC_UART_LINE_DIVISOR_OPEN);
    lpc_write(uart + LPC_UART_DIVISOR_LOW, divisor & 0xFFu);
    lpc_write(uart + LPC_UART_DIVISOR_HIGH, divisor >> 8);
    lpc_write(uart + LPC_UART_FRACTION, fraction);
    lpc_write(uart + LPC_UART_LINE, LPC_UART_LINE_8N1);
}

static void open_ports(void)
{
    change(LPC_PCONP, 0, LPC_PCONP_UART2 | LPC_PCONP_UART3);
    change(LPC_PCLKSEL1, 3u << LPC_PCLKSEL1_UART2 | 3u << LPC_PCLKSEL1_UART3,
           1u << LPC_PCLKSEL1_UART2 | 1u << LPC_PCLKSEL1_UART3);
    for (int port = 0; port < M3PI_PORTS; port++) {
        set_rate(uarts[port], port_baud[port]);
        lpc_write(uarts[port] + LPC_UART_FIFO, LPC_UART_FIFO_ON_AND_EMPTY);
    }
    change(LPC_PINSEL0, 0xFu | 0xFu << 20, /* P0.0, P0.1: 10 is UART 3; P0.10, P0.11: 01 is UART 2 */
           0xAu | 0x5u << 20);
}

static int read_one(void *context, m3pi_port port)
{
    const bool received = lpc_read(uarts[port] + LPC_UART_STATUS) & LPC_UART_STATUS_RECEIVED;

    (void)context;
    return received ? (int)(lpc_read(uarts[port] + LPC_UART_DATA) & 0xFFu) : -1;
}

static void write_all(void *context, m3pi_port port, const uint8_t *data, size_t length)
{
    (void)context;
    for (size_t i = 0; i < length; i++) {
        while (i % LPC_UART_FIFO_SIZE == 0 &&
               !(lpc_read(uarts[port] + LPC_UART_STATUS) & LPC_UART_STATUS_SENT)) {
        }
        lpc_write(uarts[port] + LPC_UART_DATA, data[i]);
    }
}

/* Whether the watchdog caused the last reset. The answer is erased. */
static bool take_watchdog_reset(void)
{
    const bool caused = lpc_read(LPC_RSID) & LPC_RSID_WATCHDOG;
    lpc_write(LPC_RSID, LPC_RSID_ALL);
    return caused;
}

static void feed_watchdog(void)
{
    lpc_write(LPC_WDFEED, 0xAA);
    lpc_write(LPC_WDFEED, 0x55);
}

static void start_watchdog(uint32_t ms)
{
    lpc_write(LPC_WDCLKSEL, LPC_WDCLKSEL_RC);
    lpc_write(LPC_WDTC, ms * LPC_WDTC_A_MS);
    lpc_write(LPC_WDMOD, LPC_WDMOD_ON_WITH_RESET);
    feed_watchdog(); /* the first starts it */
}

int main(void)
{
    const m3pi_board board = {
        .ports = {NULL, read_one, write_all},
        .hold_base = hold_base,
        .open_ports = open_ports,
        .now_ms = now_ms,
        .wait_ms = wait_ms,
        .start_watchdog = start_watchdog,
        .feed_watchdog = feed_watchdog,
        .was_reset_by_watchdog = take_watchdog_reset(),
    };

    hold_base(true); /* the 3pi stands even if the crystal does not start */
    start_clock();
    start_timer();
    m3pi_shell_run(&board, ROBOT_INDEX);
    return 0;
}
