/* The vector table of a test in QEMU: where the stack begins, and the C library's start. */
extern void _start(void);
extern char __stack[];

__attribute__((section(".vectors"), used)) static const struct {
    char *stack;
    void (*start)(void);
} vectors = {__stack, _start};
