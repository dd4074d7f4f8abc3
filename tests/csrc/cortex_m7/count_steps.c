/* Count the instructions and the stack of control steps under QEMU with `-icount shift=0`.
 *
 * An instruction then takes 1 ns of the board's time. The SysTick timer counts at 25 MHz, once in 40 instructions. The program
 * first counts a loop of known length, and then prints a line for each record: status, instructions, bytes of stack, iterations,
 * and the torques. */
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include "grasp_controller.h"
#include "records.h"

#define SYST_CSR (*(volatile uint32_t *)0xE000E010)
#define SYST_RVR (*(volatile uint32_t *)0xE000E014)
#define SYST_CVR (*(volatile uint32_t *)0xE000E018)

enum {
    N = GRASP_MOTOR_COUNT,
    TICK = 40,         /* instructions */
    PAINTED = 1 << 16, /* bytes of stack below main() that are filled with a pattern */
    NEAR = 512,        /* bytes of them that calls of main() itself may use */
    LOOPS = 100000
};

static _Alignas(16) unsigned char memory[1 << 17];

static uint32_t ticks_since(uint32_t start)
{
    return (start - SYST_CVR) & 0xFFFFFF;
}

int main(void)
{
    unsigned char *const frame = __builtin_frame_address(0);
    gf_controller *controller = gf_controller_init(&grasp_controller, memory, sizeof memory);
    if (controller == NULL) return 1;
    SYST_RVR = 0xFFFFFF, SYST_CVR = 0, SYST_CSR = 5;
    uint32_t start = SYST_CVR, count = LOOPS;
    __asm volatile("1: subs %0, %0, #1\n bne 1b\n" : "+r"(count) : : "cc"); /* two instructions a loop */
    printf("loop %u of %u\n", (unsigned)(ticks_since(start) * TICK), 2u * LOOPS);
    printf("memory %u\n", (unsigned)gf_controller_size(&grasp_controller));
    for (int i = 0; i < RECORDS; i++) {
        const gf_real *record = records[i], *object = record + 2 * N;
        const gf_control_inputs inputs = {.q = record,
                                          .v = record + N,
                                          .p_HO = object,
                                          .R_HO = object + 3,
                                          .twist = object + 12,
                                          .p_d = object + 18,
                                          .R_d = object + 21,
                                          .twist_d = object + 30,
                                          .acceleration_d = object + 36};
        gf_control_outputs outputs;
        memset(frame - PAINTED, 0xA5, PAINTED - NEAR);
        start = SYST_CVR;
        const gf_control_status status = gf_controller_step(controller, &inputs, &outputs);
        const unsigned instructions = (unsigned)(ticks_since(start) * TICK);
        const unsigned char *lowest = frame - PAINTED;
        while (*lowest == 0xA5) lowest++;
        printf("%s %u %u %d", gf_control_status_string(status), instructions, (unsigned)(frame - lowest), outputs.iterations);
        for (int j = 0; j < N; j++) printf(" %.17g", (double)outputs.tau[j]);
        printf("\n");
    }
    return 0;
}
