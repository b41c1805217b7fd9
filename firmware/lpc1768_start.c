/* What an LPC1768 needs before main() and around it: the vectors, the reset, and its registers. */
#include "lpc1768.h"

#include <stddef.h>

extern uint32_t stack_top[], data_start[], data_end[], data_in_flash[], bss_start[], bss_end[];
extern char vector_checksum[]; /* lpc1768.ld computes these */
int main(void);
void start(void);
void hang(void);

/* The exceptions of the processor; interrupts are not used. The boot ROM starts the program only if
 * the first eight words add up to 0 [UM10360 32.3.1.1, page 617]. */
__attribute__((section(".vectors"), used)) static const struct {
    uint32_t *stack;
    void (*start)(void);
    void (*faults[5])(void);
    char *checksum;
    void (*others[8])(void);
} vectors = {
    stack_top, start, {hang, hang, hang, hang, hang}, vector_checksum,
    {NULL, NULL, NULL, hang, hang, NULL, hang, hang},
};

/* No code read protection [UM10360, chapter 32]. Certain other values in this word would lock the chip for ever. */
__attribute__((section(".protection"), used)) static const uint32_t protection = 0xFFFFFFFFu;

void start(void)
{
    const uint32_t *from = data_in_flash;

    for (uint32_t *at = data_start; at < data_end; at++) {
        *at = *from++;
    }
    for (uint32_t *at = bss_start; at < bss_end; at++) {
        *at = 0;
    }
    (void)main();
    hang();
}

/* After a fault of the program. The watchdog resets the chip then. */
void hang(void)
{
    for (;;) {
    }
}

uint32_t lpc_read(uint32_t address) { return *(volatile uint32_t *)address; }

void lpc_write(uint32_t address, uint32_t value) { *(volatile uint32_t *)address = value; }
