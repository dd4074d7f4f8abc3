/* Drives the structured kernel, its certificate and what stands before both with random and hostile numbers, for a build under sanitizers.
 *
 * Every array has exactly the size that structured.h states, on the heap. Prints how often each status came, and returns
 * nonzero when a law of the header is broken: a status that does not exist, too many iterations, an optimal answer that is
 * not finite, or anything but failed for NaN where numbers are read.
 */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "graspforce/certify.h"
#include "graspforce/grasp_matrix.h"
#include "graspforce/solve.h"

static uint64_t seed = 88172645463325252u;

static unsigned roll(unsigned sides)
{
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return (unsigned)(seed >> 33) % sides;
}

static double uniform(double low, double high)
{
    return low + (high - low) * roll(1u << 30) / (double)(1u << 30);
}

static double hostile(void)
{
    static const double odd[] = {0.0, -0.0, 1e300, -1e300, 1e-300, 5e-324, 1e20, -1.0, INFINITY, -INFINITY, NAN, 1e154};
    return odd[roll(sizeof odd / sizeof *odd)];
}

/* An array of its exact size; one number in `rarity` is hostile, none if that is zero. */
static double *numbers(int count, double low, double high, unsigned rarity)
{
    double *x = malloc((size_t)count * sizeof *x + (count == 0));
    if (x == NULL) exit(2);
    for (int i = 0; i < count; i++) x[i] = rarity && roll(rarity) == 0 ? hostile() : uniform(low, high);
    return x;
}

static int *integers(int count, int sides)
{
    int *x = malloc((size_t)count * sizeof *x + (count == 0));
    if (x == NULL) exit(2);
    for (int i = 0; i < count; i++) x[i] = (int)roll((unsigned)sides);
    return x;
}

static int broken(const char *law, int problem)
{
    printf("problem %d: %s\n", problem, law);
    return 1;
}

/* Places random contacts and numbers their fingers; G, w and the units are then those of grasp.h and certify.h. */
static int place(int problem, const gf_structure *s, gf_problem *data, unsigned rarity, double *G, double *w, double *torques,
                 gf_units *units)
{
    int N = s->contacts, k = 0, largest = 0, faults = 0;
    double *p = numbers(3 * N, -0.1, 0.1, rarity), *R = numbers(9 * N, -1.0, 1.0, rarity), about_O[6];
    int *contact_block = integers(N, 1), *joint_block = integers(s->joints, 1);
    for (int i = 0; i < N; i++) k += s->components[i];
    if (roll(2))
        for (int i = 0; i < 9 * N; i++) R[i] = i % 9 % 4 == 0;
    gf_moment_reference place;
    int finite = gf_grasp_matrix(s, p, R, G, &place), rotations = gf_are_rotations(N, R);
    for (int c = 0; c < 6 * k; c++)
        if (finite && !isfinite(G[c])) faults += broken("a grasp matrix that is not finite", problem);
    for (int i = 0; i < 9 * N && rotations; i++)
        if (!(fabs(R[i]) < 1.1)) faults += broken("no rotation", problem);
    for (int r = 0; r < 6; r++) about_O[r] = w[r];
    gf_wrench_about_centroid(&place, about_O, w);
    gf_problem_units(s, data, place.length, torques, units);
    int fingers = gf_find_fingers(N, s->components, s->joints, data->J, contact_block, joint_block, &largest);
    for (int i = 0; i < N; i++)
        if (contact_block[i] < 0 || contact_block[i] >= fingers) faults += broken("no such finger", problem);
    for (int j = 0; j < s->joints; j++)
        if (joint_block[j] < 0 || joint_block[j] >= fingers) faults += broken("no such finger", problem);
    if (largest < 1 || largest > k) faults += broken("no such size of a finger", problem);
    free(p), free(R), free(contact_block), free(joint_block);
    return faults;
}

/* J's rows within their fingers alone, and where these are; at times the last row that has any is one too short. */
static double *within_fingers(const gf_structure *s, const double *J, int *span, int *too_short)
{
    int n = s->joints, spoil = roll(10) == 0, c = 0, held = 0;
    for (int i = 0; i < s->contacts; i++)
        for (int a = 0; a < s->components[i]; a++, c++) {
            span[2 * c] = span[2 * c + 1] = 0;
            for (int j = n - 1; j >= 0; j--) {
                if (s->joint_block[j] != s->contact_block[i]) continue;
                if (span[2 * c + 1] == 0) span[2 * c + 1] = j + 1;
                span[2 * c] = j;
            }
        }
    for (int r = c - 1; r >= 0 && spoil && !*too_short; r--)
        if (span[2 * r + 1] > 0) span[2 * r + 1] -= *too_short = 1;
    for (int r = 0; r < c; r++) held += span[2 * r + 1] - span[2 * r];
    double *packed = numbers(held, 0.0, 0.0, 0), *to = packed;
    for (int r = 0; r < c; r++)
        for (int j = span[2 * r]; j < span[2 * r + 1]; j++) *to++ = J[r * n + j];
    return packed;
}

static int one(int problem, int *counts)
{
    static const int models[] = {1, 3, 4};
    static const unsigned rarities[] = {0, 0, 0, 300, 30, 2};
    unsigned rarity = rarities[roll(6)];
    gf_structure s = {.contacts = 1 + (int)roll(7), .joints = (int)roll(9), .blocks = 1 + (int)roll(5)};
    s.facets = (int)roll(2) * (int)roll(9);
    int N = s.contacts, n = s.joints, m = s.facets, k = 0;
    int *components = integers(N, 3), *contact_block = integers(N, s.blocks), *joint_block = integers(n, s.blocks);
    int *facet_contact = integers(m, N);
    for (int i = 0; i < N; i++) k += components[i] = models[components[i]];
    s.components = components, s.contact_block = contact_block, s.joint_block = joint_block, s.facet_contact = facet_contact;

    double *G = numbers(6 * k, -1.0, 1.0, rarity), *w = numbers(6, -1.0, 1.0, rarity), *mu = numbers(N, 0.0, 1.0, rarity);
    double *gamma = numbers(N, 0.0, 0.02, rarity), *least = numbers(N, 0.0, 0.1, rarity), *most = numbers(N, 0.0, 50.0, rarity);
    double *J = numbers(k * n, -0.1, 0.1, rarity), *tau_u = numbers(n, -0.1, 0.1, rarity);
    double *lower = numbers(n, -2.0, -0.1, rarity), *upper = numbers(n, 0.1, 2.0, rarity);
    double *weight = numbers(n, 0.0, 2.0, rarity), *facet = numbers(4 * m, -1.0, 1.0, rarity);
    double *cost = numbers(k, -0.01, 0.01, rarity);
    for (int i = 0; i < N; i++) {
        if (roll(5) == 0) mu[i] = 0.0;
        if (roll(5) == 0) most[i] = least[i];
        if (roll(5) == 0) most[i] = INFINITY;
    }
    for (int j = 0; j < n; j++) {
        if (roll(6) == 0) upper[j] = lower[j];
        if (roll(6) == 0) lower[j] = -INFINITY;
    }
    int poisoned = roll(10) == 0;
    if (poisoned) w[roll(6)] = NAN;
    gf_problem data = {.G = G,
                       .w = w,
                       .mu = mu,
                       .gamma = gamma,
                       .min_normal = least,
                       .max_normal = most,
                       .J = J,
                       .tau_u = tau_u,
                       .lower = lower,
                       .upper = upper,
                       .weight = weight,
                       .facet = facet,
                       .cost = roll(2) ? cost : NULL,
                       .force_weight = roll(3) ? uniform(0.0, 1.0) : 0.0};
    double *f = numbers(k, 0, 0, 0), *y = numbers(6, 0, 0, 0), *z = numbers(k, 0, 0, 0), *nu = numbers(2 * N, 0, 0, 0);
    double *lambda = numbers(2 * n, 0, 0, 0), *tau = numbers(n, 0, 0, 0), *scratch = numbers(n, 0, 0, 0);
    double *torques = numbers(n, 0.01, 1.0, rarity);
    gf_solution answer = {
        .f = f, .y = y, .z = z, .nu_lower = nu, .nu_upper = nu + N, .lambda_lower = lambda, .lambda_upper = lambda + n};
    gf_options options = GF_OPTIONS_DEFAULT;
    size_t size = gf_workspace_size(&s);
    void *workspace = calloc(1, size);
    if (workspace == NULL) exit(2);

    gf_units units = {1.0, 0.05, 1.0, torques};
    int faults = roll(2) ? place(problem, &s, &data, rarity, G, w, torques, &units) : 0;
    int *span = integers(2 * k, 1), too_short = 0;
    double *packed = within_fingers(&s, J, span, &too_short);
    if (roll(2))
        s.span = span, data.J = packed;
    else
        too_short = 0;
    for (options.warm = 0; options.warm < 3; options.warm++) {
        int status = gf_solve(&s, &data, &options, workspace, &answer);
        if (status < GF_OPTIMAL || status > GF_FAILED)
            faults += broken("no such status", problem);
        else
            counts[status]++;
        if (answer.iterations > options.max_iterations) faults += broken("too many iterations", problem);
        if (too_short && status != GF_FAILED) faults += broken("a row without its finger was not refused", problem);
        if (poisoned && status != GF_FAILED) faults += broken("a wrench of NaN was not refused", problem);
        for (int c = 0; c < k && status == GF_OPTIMAL; c++)
            if (!isfinite(f[c]) || !isfinite(z[c])) faults += broken("optimal, but not finite", problem);
        gf_residuals residuals;
        int measured = gf_certify(&s, &data, &answer, &units, tau, z, scratch, &residuals);
        if (measured != (m == 0)) faults += broken("facets", problem);
        w[0] *= 1.01;
    }
    void *all[] = {span,  packed, components, contact_block, joint_block, facet_contact, G,       w,        mu,   gamma,
                   least, most,   J,          tau_u,         lower,       upper,         weight,  facet,    cost, f,
                   y,     z,      nu,         lambda,        tau,         scratch,       torques, workspace};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) free(all[i]);
    return faults;
}

int main(int count, char **arguments)
{
    int problems = count > 1 ? atoi(arguments[1]) : 1000, counts[4] = {0}, faults = 0;
    for (int i = 0; i < problems; i++) faults += one(i, counts);
    printf("%d %d %d %d\n", counts[0], counts[1], counts[2], counts[3]);
    return faults != 0;
}
