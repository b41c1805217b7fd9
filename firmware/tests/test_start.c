/* Runs lpc1768_start.c and lpc1768.ld on an emulated Cortex-M3, whose RAM is at another address.
 *
 * Starts twice, so that the second start finds used memory.
 */
#include <stdbool.h>
#include <stdint.h>

#define SEMIHOSTING_PRINT 0x04
#define SEMIHOSTING_EXIT 0x20
#define EXIT_FROM_MAIN 0x20026u

void start(void);
extern uint32_t stack_top[];

static volatile uint32_t set[3] = {98, 1, 3}, cleared[3];
static volatile uint32_t *const starts = (volatile uint32_t *)0x20100000; /* never initialised */

static void ask_qemu(int request, const void *parameter)
{
    register int r0 __asm__("r0") = request;
    register const void *r1 __asm__("r1") = parameter;
    __asm__ volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
}

int main(void)
{
    const uint32_t here = (uint32_t)&here;
    const bool is_right = set[0] == 98 && set[1] == 1 && set[2] == 3 && cleared[0] == 0 &&
                          cleared[1] == 0 && cleared[2] == 0 && here < (uint32_t)stack_top &&
                          here > (uint32_t)stack_top - 256u;
    const uint32_t result[2] = {EXIT_FROM_MAIN, !is_right};

    if (is_right && ++*starts < 2) {
        for (int i = 0; i < 3; i++) {
            set[i] = cleared[i] = 0xFFFFFFFFu;
        }
        start();
    }
    ask_qemu(SEMIHOSTING_PRINT, is_right ? "start-up: passed\n" : "start-up: FAILED\n");
    ask_qemu(SEMIHOSTING_EXIT, result);
    return 1;
}
