/* The registers of the LPC1768 that the m3pi's program uses, by address.
 *
 * Numbers in brackets are chapters and sections of NXP's user manual UM10360, Rev. 3 of 19 December
 * 2013. A chapter stands alone where we could not see the section. Registers are reached through two
 * functions, so that a test can play the chip.
 */
#ifndef LPC1768_H
#define LPC1768_H

#include <stdint.h>

uint32_t lpc_read(uint32_t address);
void lpc_write(uint32_t address, uint32_t value);

/* Why the chip was reset [3.4.1, page 22]. Writing a bit clears it. */
#define LPC_RSID 0x400FC180u
#define LPC_RSID_ALL 0xFu
#define LPC_RSID_WATCHDOG (1u << 2)

/* Clocks and power of the peripherals [4]. */
#define LPC_PLL0CON 0x400FC080u
#define LPC_PLL0FEED 0x400FC08Cu
#define LPC_PCONP 0x400FC0C4u
#define LPC_PCONP_UART2 (1u << 24)
#define LPC_PCONP_UART3 (1u << 25)
#define LPC_CCLKCFG 0x400FC104u
#define LPC_CLKSRCSEL 0x400FC10Cu
#define LPC_CLKSRCSEL_CRYSTAL 1u
#define LPC_SCS 0x400FC1A0u
#define LPC_SCS_CRYSTAL_ON (1u << 5)
#define LPC_SCS_CRYSTAL_READY (1u << 6)
#define LPC_PCLKSEL0 0x400FC1A8u
#define LPC_PCLKSEL0_TIMER0 2 /* first of two bits: 01 for the processor's clock */
#define LPC_PCLKSEL1 0x400FC1ACu
#define LPC_PCLKSEL1_UART2 16
#define LPC_PCLKSEL1_UART3 18

/* What the pins do [8], two bits each, and pins as outputs [9.5]. */
#define LPC_PINSEL0 0x4002C000u
#define LPC_FIO2DIR 0x2009C040u
#define LPC_FIO2SET 0x2009C058u
#define LPC_FIO2CLR 0x2009C05Cu

/* Serial ports [14.4, pages 308 and 314], as offsets from a port's address. The first two registers have another
 * meaning while the divisor is open. */
#define LPC_UART2 0x40098000u
#define LPC_UART3 0x4009C000u
#define LPC_UART_DATA 0x00u
#define LPC_UART_DIVISOR_LOW 0x00u
#define LPC_UART_DIVISOR_HIGH 0x04u
#define LPC_UART_FIFO 0x08u
#define LPC_UART_FIFO_ON_AND_EMPTY 7u
#define LPC_UART_FIFO_SIZE 16u
#define LPC_UART_LINE 0x0Cu
#define LPC_UART_LINE_8N1 3u
#define LPC_UART_LINE_DIVISOR_OPEN (1u << 7)
#define LPC_UART_STATUS 0x14u
#define LPC_UART_STATUS_RECEIVED (1u << 0)
#define LPC_UART_STATUS_SENT (1u << 5) /* the FIFO to send from is empty */
#define LPC_UART_FRACTION 0x28u

/* Timer 0 [21]. */
#define LPC_T0TCR 0x40004004u
#define LPC_T0TCR_RUN 1u
#define LPC_T0TCR_RESET 2u
#define LPC_T0TC 0x40004008u
#define LPC_T0PR 0x4000400Cu

/* The watchdog [28.3, 28.4, pages 571 and 573]. Its own RC oscillator has 4 MHz, of which it counts
 * every fourth tick. */
#define LPC_WDMOD 0x40000000u
#define LPC_WDMOD_ON_WITH_RESET 3u
#define LPC_WDTC 0x40000004u
#define LPC_WDTC_A_MS 1000u
#define LPC_WDFEED 0x40000008u
#define LPC_WDCLKSEL 0x40000010u
#define LPC_WDCLKSEL_RC 0u

#endif
