/* A control loop in C without Python: read states, write torques.
 *
 * The program reads one record a step from standard input and writes the motor torques to standard output, as numbers of type
 * gf_real. A record holds q (n), v (n), p_HO (3), R_HO (9), twist (6), p_d (3), R_d (9), twist_d (6) and acceleration_d (6).
 * Replace read_state() and send_torques() by those of your drives. */
#include <stdio.h>
#include <string.h>

#include "grasp_controller.h"

enum { N = GRASP_MOTOR_COUNT, RECORD = 2 * N + 42, MEMORY = 1 << 18 };

static _Alignas(32) unsigned char memory[MEMORY]; /* gf_controller_size() states how much a controller needs */

static int read_state(gf_real record[RECORD])
{
    return fread(record, sizeof(gf_real), RECORD, stdin) == RECORD;
}

static int send_torques(const gf_real *tau)
{
    return fwrite(tau, sizeof(gf_real), N, stdout) == N;
}

int main(void)
{
    gf_real record[RECORD];
    const gf_real *object = record + 2 * N;
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
    int counts[GF_CONTROL_INVALID + 1] = {0};
    gf_controller *controller = gf_controller_init(&grasp_controller, memory, sizeof memory);
    if (controller == NULL) {
        fprintf(stderr, "the controller needs %zu bytes\n", gf_controller_size(&grasp_controller));
        return 1;
    }
    while (read_state(record)) {
        counts[gf_controller_step(controller, &inputs, &outputs)]++;
        if (!send_torques(outputs.tau)) return 1;
    }
    for (int status = GF_CONTROL_FULL; status <= GF_CONTROL_INVALID; status++)
        if (counts[status] > 0) fprintf(stderr, "%s %d\n", gf_control_status_string(status), counts[status]);
    return 0;
}
