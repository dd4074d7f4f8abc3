/* Print the times of a plain and a rigorous certificate of random numbers: four contacts with three motors each. */
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "graspforce/rigorous.h"

enum { N = 4, K = 3 * N, JOINTS = 3 * N, REPEATS = 200000 };

static void fill(int count, double *x)
{
    for (int i = 0; i < count; i++) x[i] = rand() / (double)RAND_MAX - 0.5;
}

static double seconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

int main(void)
{
    static double G[6 * K], w[6], y[6], f[K], z[K], tau_u[JOINTS], p[3 * N], R[9 * N], J[K * JOINTS], tau[JOINTS];
    static double mu[N], gamma[N], least[N], most[N], nu[N], lower[JOINTS], upper[JOINTS], weight[JOINTS], lambda[JOINTS];
    static double scratch[4 * JOINTS], distance[N], point[3], unit[JOINTS];
    static const int components[N] = {3, 3, 3, 3}, blocks[N] = {0, 1, 2, 3};
    int joint_block[JOINTS];
    fill(6 * K, G), fill(6, w), fill(6, y), fill(K, f), fill(JOINTS, tau_u), fill(3 * N, p), fill(9 * N, R);
    for (int i = 0; i < N; i++) mu[i] = 0.5, most[i] = 20.0, nu[i] = 0.1;
    for (int c = 0; c < K; c++) fill(3, J + c * JOINTS + 3 * (c / 3));
    for (int j = 0; j < JOINTS; j++)
        lower[j] = -1.0, upper[j] = 1.0, weight[j] = 1.0, lambda[j] = 0.1, unit[j] = 1.0, joint_block[j] = j / 3;
    const gf_structure hand = {.contacts = N,
                               .joints = JOINTS,
                               .blocks = N,
                               .components = components,
                               .contact_block = blocks,
                               .joint_block = joint_block};
    const gf_problem problem = {.G = G,
                                .w = w,
                                .mu = mu,
                                .gamma = gamma,
                                .min_normal = least,
                                .max_normal = most,
                                .J = J,
                                .tau_u = tau_u,
                                .lower = lower,
                                .upper = upper,
                                .weight = weight};
    const gf_solution solution = {
        .f = f, .y = y, .z = z, .nu_lower = nu, .nu_upper = nu, .lambda_lower = lambda, .lambda_upper = lambda};
    const gf_units units = {1.0, 1.0, 1.0, unit};
    const gf_contact_places places = {p, R, point, 1.0};
    double best[2] = {1.0, 1.0}, sum = 0.0;
    for (int round = 0; round < 5; round++)
        for (int rigorous = 0; rigorous < 2; rigorous++) {
            const double start = seconds();
            for (int i = 0; i < REPEATS; i++) {
                gf_residuals residuals = {0.0, 0.0, 0.0};
                gf_proven_bounds bounds = {0.0, 0.0, 0.0, 0.0};
                f[0] += 1e-9;
                if (rigorous)
                    (void)gf_bound_optimality(&hand, &problem, &places, NULL, &solution, &units, 1e6, scratch, distance, &bounds);
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
