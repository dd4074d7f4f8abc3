/* Start of a program on QEMU's mps2-an500 board, a Cortex-M7 with a double-precision unit, with semihosting. */
extern int main(void);
extern void exit(int status) __attribute__((noreturn));
extern void initialise_monitor_handles(void);
extern char __stack_top, __bss_start__, __bss_end__;

void reset(void);
void begin(void);

static void halt(void)
{
    exit(1);
}

__attribute__((section(".vectors"), used)) static const void *const vectors[7] = {&__stack_top,       (const void *)reset,
                                                                                  (const void *)halt, (const void *)halt,
                                                                                  (const void *)halt, (const void *)halt,
                                                                                  (const void *)halt};

/* Enable the floating-point unit before any function saves its registers. */
__attribute__((naked)) void reset(void)
{
    __asm volatile("ldr r0, =0xE000ED88\n ldr r1, [r0]\n orr r1, r1, #0xF00000\n str r1, [r0]\n dsb\n isb\n b begin\n");
}

void begin(void)
{
    for (char *p = &__bss_start__; p != &__bss_end__; p++) *p = 0;
    initialise_monitor_handles();
    exit(main());
}
