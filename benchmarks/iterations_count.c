/* Solve random problems and print the sum of their iterations, for callgrind: iterations_count CONTACTS JOINTS SOLVES.
 *
 * JOINTS is the number of motors of each contact's finger. The forces that make each problem feasible are 0.9 of the friction. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "graspforce/solve.h"

enum { MAX_CONTACTS = 100, MAX_JOINTS = 8, K = 3 * MAX_CONTACTS, MOTORS = MAX_CONTACTS * MAX_JOINTS };

static unsigned long long state = 1;

/* Return a number from −1 to 1, the same on every machine. */
static double number(void)
{
    state = state * 6364136223846793005ULL + 1442695040888963407ULL;
    return (double)(state >> 11) / 4503599627370496.0 - 1.0;
}

static double G[6 * K], w[6], J[K * MAX_JOINTS], tau_u[MOTORS], lower[MOTORS], upper[MOTORS], weight[MOTORS];
static double mu[MAX_CONTACTS], gamma_[MAX_CONTACTS], least[MAX_CONTACTS], most[MAX_CONTACTS];
static double f[K], y[6], z[K], nu[2][MAX_CONTACTS], lambda[2][MOTORS];
static int components[MAX_CONTACTS], block[MAX_CONTACTS], joint_block[MOTORS], span[2 * K];

/* Write contact i: its columns of G at a random place of a sphere of 5 cm, its force, its motors. */
static void make_contact(int i, int contacts, int joints)
{
    const int k = 3 * contacts;
    double frame[3][3], *n = frame[2], *t = frame[0], *b = frame[1], length = 0.0, along = 0.0;
    for (int r = 0; r < 3; r++) n[r] = number(), length += n[r] * n[r];
    for (int r = 0; r < 3; r++) n[r] /= sqrt(length), t[r] = number(), along += t[r] * n[r];
    length = 0.0;
    for (int r = 0; r < 3; r++) t[r] -= along * n[r], length += t[r] * t[r];
    for (int r = 0; r < 3; r++) t[r] /= sqrt(length);
    for (int r = 0; r < 3; r++) b[r] = n[(r + 1) % 3] * t[(r + 2) % 3] - n[(r + 2) % 3] * t[(r + 1) % 3];
    mu[i] = 0.5 + 0.3 * number(), most[i] = 20.0;
    double force[3] = {0.6 * mu[i] * number(), 0.6 * mu[i] * number(), 1.0};
    for (int c = 0; c < 3; c++) force[c] *= 3.0 + 2.0 * number() * (c == 2);
    for (int c = 0; c < 3; c++)
        for (int r = 0; r < 3; r++) {
            const double moment = -0.05 * (n[(r + 1) % 3] * frame[c][(r + 2) % 3] - n[(r + 2) % 3] * frame[c][(r + 1) % 3]);
            G[r * k + 3 * i + c] = frame[c][r], G[(r + 3) * k + 3 * i + c] = moment;
            w[r] += frame[c][r] * force[c], w[r + 3] += moment * force[c];
        }
    for (int j = 0; j < joints; j++) {
        double load = tau_u[i * joints + j] = 0.02 * number();
        for (int c = 0; c < 3; c++) {
            J[(3 * i + c) * joints + j] = 0.05 * number();
            load += J[(3 * i + c) * joints + j] * force[c];
        }
        upper[i * joints + j] = 1.2 * fabs(load) + 0.02, lower[i * joints + j] = -upper[i * joints + j];
        weight[i * joints + j] = 1.0, joint_block[i * joints + j] = i;
    }
    for (int c = 0; c < 3; c++) span[2 * (3 * i + c)] = i * joints, span[2 * (3 * i + c) + 1] = (i + 1) * joints;
    components[i] = 3, block[i] = i;
}

int main(int count, char **arguments)
{
    if (count != 4) return 2;
    const int contacts = atoi(arguments[1]), joints = atoi(arguments[2]), solves = atoi(arguments[3]);
    if (contacts < 1 || contacts > MAX_CONTACTS || joints < 0 || joints > MAX_JOINTS) return 2;
    long iterations = 0, solved = 0;
    void *workspace = NULL;
    for (int s = 0; s < solves; s++) {
        for (int r = 0; r < 6; r++) w[r] = 0.0;
        for (int i = 0; i < contacts; i++) make_contact(i, contacts, joints);
        const gf_structure hand = {.contacts = contacts,
                                   .joints = contacts * joints,
                                   .blocks = contacts,
                                   .components = components,
                                   .contact_block = block,
                                   .joint_block = joint_block,
                                   .span = span};
        const gf_problem problem = {.G = G,
                                    .w = w,
                                    .mu = mu,
                                    .gamma = gamma_,
                                    .min_normal = least,
                                    .max_normal = most,
                                    .J = J,
                                    .tau_u = tau_u,
                                    .lower = lower,
                                    .upper = upper,
                                    .weight = weight,
                                    .force_weight = joints > 0 ? 0.0 : 1.0};
        gf_solution solution = {
            .f = f, .y = y, .z = z, .nu_lower = nu[0], .nu_upper = nu[1], .lambda_lower = lambda[0], .lambda_upper = lambda[1]};
        const gf_options options = GF_OPTIONS_DEFAULT;
        if (workspace == NULL) workspace = malloc(gf_workspace_size(&hand));
        if (workspace == NULL) return 1;
        solved += gf_solve(&hand, &problem, &options, workspace, &solution) == GF_OPTIMAL;
        iterations += solution.iterations;
    }
    printf("%ld %ld\n", iterations, solved);
    free(workspace);
    return 0;
}
