/* Time of the whole control step in C and of the force kernel in the same step, for records on standard input.
 *
 * A record is that of examples/c/control_loop.c. The first argument is the number of records. For each step, the program writes
 * four numbers as double to standard output: the time of the step, that of its calls of gf_solve(), and that of a fixed piece of
 * arithmetic after it, ns; and how often other processes took its core during the step. The arithmetic shows how much the machine
 * itself interrupts. The counts of each status go to standard error. The program takes real-time priority and locks its memory
 * where this is permitted. It sleeps for 1 ms after 100 steps: Linux stops processes with real-time priority that use a core all
 * the time. */
#define _GNU_SOURCE /* RUSAGE_THREAD */
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <time.h>

#include "graspforce/solve.h"

enum { CHAIN = 10000 }; /* about as long as a step */

static double kernel_time; /* ns, of the present step */

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}

/* Return how often other processes took the core of this one. */
static double preemptions(void)
{
    struct rusage usage;
    getrusage(RUSAGE_THREAD, &usage);
    return (double)usage.ru_nivcsw;
}

/* Return the time of a fixed chain of multiplications and additions, ns. */
static double time_arithmetic(void)
{
    static volatile double sink = 0.5;
    const double start = now();
    double x = sink;
    for (int i = 0; i < CHAIN; i++) x = 0.999 * x + 1e-3;
    sink = x;
    return now() - start;
}

/* Take real-time priority and lock all memory. Return whether both are permitted. */
static int become_real_time(void)
{
    const struct sched_param priority = {.sched_priority = 80};
    return sched_setscheduler(0, SCHED_FIFO, &priority) == 0 && mlockall(MCL_CURRENT | MCL_FUTURE) == 0;
}

static gf_status timed_solve(const gf_structure *structure, const gf_problem *problem, const gf_options *options,
                             void *workspace, gf_solution *solution)
{
    const double start = now();
    const gf_status status = gf_solve(structure, problem, options, workspace, solution);
    kernel_time += now() - start;
    return status;
}

#define gf_solve timed_solve /* in the controller below */
#include "controller/controller.c"
#undef gf_solve

#include "grasp_controller.h"

enum { N = GRASP_MOTOR_COUNT, RECORD = 2 * N + 42 };

int main(int argc, char **argv)
{
    const size_t count = argc > 1 ? strtoul(argv[1], NULL, 10) : 0, size = gf_controller_size(&grasp_controller);
    double *records = malloc(count * RECORD * sizeof(double)), *times = malloc(4 * count * sizeof(double));
    void *memory = malloc(size);
    if (records == NULL || times == NULL || memory == NULL) return 1;
    if (fread(records, RECORD * sizeof(double), count, stdin) != count) return 1;
    gf_controller *controller = gf_controller_init(&grasp_controller, memory, size);
    if (controller == NULL) return 1;
    const int is_real_time = become_real_time();
    int counts[GF_CONTROL_INVALID + 1] = {0};
    for (size_t i = 0; i < count; i++) {
        if (i % 100 == 0) nanosleep(&(struct timespec){.tv_nsec = 1000000}, NULL);
        const double *record = records + i * RECORD, *object = record + 2 * N;
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
        kernel_time = 0.0;
        const double before = preemptions();
        const double start = now();
        counts[gf_controller_step(controller, &inputs, &outputs)]++;
        double *const row = times + 4 * i;
        row[0] = now() - start;
        row[1] = kernel_time;
        row[3] = preemptions() - before;
        row[2] = time_arithmetic();
    }
    fwrite(times, sizeof(double), 4 * count, stdout);
    for (int status = GF_CONTROL_FULL; status <= GF_CONTROL_INVALID; status++)
        if (counts[status] > 0) fprintf(stderr, "%s %d ", gf_control_status_string(status), counts[status]);
    fprintf(stderr, "of the timed steps; memory: %zu bytes; %s\n", size,
            is_real_time ? "real-time priority (SCHED_FIFO), memory locked" : "normal priority");
    return 0;
}
