/* Print the times of a plain and a rigorous certificate of random numbers: four contacts with three motors each. */
#include <stdio.h>
#include <time.h>

#include "graspforce/rigorous.h"
#include "random_problem.inc"

enum { CONTACTS = 4, JOINTS = 3, REPEATS = 200000 };

static double seconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

int main(void)
{
    static double tau[CONTACTS * JOINTS], scratch[4 * CONTACTS * JOINTS], distance[CONTACTS], point[3], unit[CONTACTS * JOINTS];
    static double whole_J[3 * CONTACTS * CONTACTS * JOINTS];
    gf_problem problem = next_problem(CONTACTS, JOINTS, ORDINARY);
    gf_structure hand = structure_of(CONTACTS, JOINTS);
    for (int c = 0; c < 3 * CONTACTS; c++) /* a rigorous certificate needs all columns */
        for (int j = 0; j < JOINTS; j++) whole_J[c * hand.joints + c / 3 * JOINTS + j] = J[c * JOINTS + j];
    problem.J = whole_J, hand.span = NULL;
    const gf_solution solution = solution_arrays();
    for (int r = 0; r < 6; r++) y[r] = number();
    for (int c = 0; c < 3 * CONTACTS; c++) f[c] = number();
    for (int side = 0; side < 2; side++) {
        for (int i = 0; i < CONTACTS; i++) nu[side][i] = 0.1;
        for (int j = 0; j < CONTACTS * JOINTS; j++) lambda[side][j] = 0.1, unit[j] = 1.0;
    }
    const gf_units units = {1.0, 1.0, 1.0, unit};
    const gf_contact_places places = {p_OC, R_OC, point, 1.0};
    double best[2] = {1.0, 1.0}, sum = 0.0;
    for (int round = 0; round < 5; round++)
        for (int rigorous = 0; rigorous < 2; rigorous++) {
            const double start = seconds();
            for (int i = 0; i < REPEATS; i++) {
                gf_residuals residuals = {0.0, 0.0, 0.0};
                gf_proven_bounds bounds = {0.0, 0.0, 0.0, 0.0};
                f[0] += 1e-9;
                if (rigorous)
                    (void)gf_bound_optimality(&hand, &problem, &places, NULL, &solution, &units, 1e6, scratch, distance,
                                              &bounds);
                else
                    (void)gf_certify(&hand, &problem, &solution, &units, tau, z, scratch, &residuals);
                sum += residuals.gap + bounds.gap;
            }
            const double each = (seconds() - start) / REPEATS;
            if (each < best[rigorous]) best[rigorous] = each;
        }
    printf("C: plain %.0f ns, rigorous %.0f ns (%.2f ×).\n", 1e9 * best[0], 1e9 * best[1], best[1] / best[0]);
    return sum < 0.0;
}
