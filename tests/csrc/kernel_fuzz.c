/* Call the kernel, its certificate and their preparation with random and invalid numbers, for a build under sanitizers.
 *
 * Every array is on the heap and has exactly the size that problem.h states. The program prints how often each status occurred.
 * It returns a nonzero value if a law of the headers is violated: an unknown status, too many iterations, an optimal solution
 * that is not finite, or a NaN in the wrench that does not return GF_FAILED.
 */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#include "graspforce/adjoint.h"
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

static double special_number(void)
{
    static const double special[] = {0.0, -0.0, 1e300, -1e300, 1e-300, 5e-324, 1e20, -1.0, INFINITY, -INFINITY, NAN, 1e154};
    return special[roll(sizeof special / sizeof *special)];
}

/* ---- arrays of one problem, which are freed together -------------------------------------------------------------------- */

enum { MAX_ARRAYS = 96 };
static void *arrays[MAX_ARRAYS];
static int array_count = 0;

static void *allocate(size_t bytes)
{
    void *array = calloc(1, bytes > 0 ? bytes : 1);
    if (array == NULL || array_count == MAX_ARRAYS) exit(2);
    return arrays[array_count++] = array;
}

static void free_arrays(void)
{
    while (array_count > 0) free(arrays[--array_count]);
}

/* Return random numbers; one in `rarity` is special, none if rarity is zero. */
static double *numbers(int count, double low, double high, unsigned rarity)
{
    double *x = allocate((size_t)count * sizeof *x);
    for (int i = 0; i < count; i++) x[i] = rarity && roll(rarity) == 0 ? special_number() : uniform(low, high);
    return x;
}

static double *zeros(int count)
{
    return allocate((size_t)count * sizeof(double));
}

static int *integers(int count, int sides)
{
    int *x = allocate((size_t)count * sizeof *x);
    for (int i = 0; i < count; i++) x[i] = (int)roll((unsigned)sides);
    return x;
}

static int violated(const char *law, int number)
{
    printf("problem %d: %s\n", number, law);
    return 1;
}

/* ---- random problems ---------------------------------------------------------------------------------------------------- */

static gf_structure random_structure(int *k)
{
    static const int models[] = {1, 3, 4};
    gf_structure s = {.contacts = 1 + (int)roll(7), .joints = (int)roll(9), .blocks = 1 + (int)roll(5)};
    s.facets = (int)roll(2) * (int)roll(9);
    int *components = integers(s.contacts, 3);
    *k = 0;
    for (int i = 0; i < s.contacts; i++) *k += components[i] = models[components[i]];
    s.components = components;
    s.contact_block = integers(s.contacts, s.blocks);
    s.joint_block = integers(s.joints, s.blocks);
    s.facet_contact = integers(s.facets, s.contacts);
    return s;
}

static gf_problem random_problem(const gf_structure *s, int k, unsigned rarity)
{
    const int N = s->contacts, n = s->joints;
    double *mu = numbers(N, 0.0, 1.0, rarity), *min_normal = numbers(N, 0.0, 0.1, rarity);
    double *max_normal = numbers(N, 0.0, 50.0, rarity);
    double *lower = numbers(n, -2.0, -0.1, rarity), *upper = numbers(n, 0.1, 2.0, rarity);
    for (int i = 0; i < N; i++) {
        if (roll(5) == 0) mu[i] = 0.0;
        if (roll(5) == 0) max_normal[i] = min_normal[i];
        if (roll(5) == 0) max_normal[i] = INFINITY;
    }
    for (int j = 0; j < n; j++) {
        if (roll(6) == 0) upper[j] = lower[j];
        if (roll(6) == 0) lower[j] = -INFINITY;
    }
    const double *cost = numbers(k, -0.01, 0.01, rarity);
    return (gf_problem){.G = numbers(6 * k, -1.0, 1.0, rarity),
                        .w = numbers(6, -1.0, 1.0, rarity),
                        .mu = mu,
                        .gamma = numbers(N, 0.0, 0.02, rarity),
                        .min_normal = min_normal,
                        .max_normal = max_normal,
                        .J = numbers(k * n, -0.1, 0.1, rarity),
                        .tau_u = numbers(n, -0.1, 0.1, rarity),
                        .lower = lower,
                        .upper = upper,
                        .weight = numbers(n, 0.0, 2.0, rarity),
                        .facet = numbers(4 * s->facets, -1.0, 1.0, rarity),
                        .cost = roll(2) ? cost : NULL,
                        .force_weight = roll(3) ? uniform(0.0, 1.0) : 0.0};
}

/* Replace G, w and the units by those of random contact frames, and check the laws of grasp_matrix.h. */
static int prepare(int number, const gf_structure *s, gf_problem *problem, int k, unsigned rarity, gf_units *units)
{
    const int N = s->contacts;
    double *p = numbers(3 * N, -0.1, 0.1, rarity), *R = numbers(9 * N, -1.0, 1.0, rarity);
    double *G = zeros(6 * k), *w = zeros(6), *torque = zeros(s->joints);
    int *contact_block = integers(N, 1), *joint_block = integers(s->joints, 1), largest = 0, faults = 0;
    if (roll(2))
        for (int i = 0; i < 9 * N; i++) R[i] = i % 9 % 4 == 0;
    gf_moment_reference reference;
    const int is_finite = gf_grasp_matrix(s, p, R, G, &reference), are_rotations = gf_are_rotations(N, R);
    for (int c = 0; c < 6 * k; c++)
        if (is_finite && !isfinite(G[c])) faults += violated("G is finite", number);
    for (int i = 0; i < 9 * N && are_rotations; i++)
        if (!(fabs(R[i]) < 1.1)) faults += violated("R holds rotations", number);
    gf_wrench_about_centroid(&reference, problem->w, w);
    problem->G = G, problem->w = w;
    gf_problem_units(s, problem, reference.length, torque, units);
    const int fingers = gf_find_fingers(N, s->components, s->joints, problem->J, contact_block, joint_block, &largest);
    for (int i = 0; i < N; i++)
        if (contact_block[i] < 0 || contact_block[i] >= fingers) faults += violated("contacts belong to fingers", number);
    for (int j = 0; j < s->joints; j++)
        if (joint_block[j] < 0 || joint_block[j] >= fingers) faults += violated("motors belong to fingers", number);
    if (largest < 1 || largest > k) faults += violated("the largest finger has 1 to k components", number);
    return faults;
}

/* Compress J to the spans of the fingers. At times the last nonempty row is one column too short; then return 1. */
static int compress_jacobian(gf_structure *s, gf_problem *problem, int k)
{
    const int n = s->joints, spoil = roll(10) == 0;
    int *span = integers(2 * k, 1), c = 0, stored = 0, is_too_short = 0;
    for (int i = 0; i < s->contacts; i++)
        for (int a = 0; a < s->components[i]; a++, c++) {
            for (int j = n - 1; j >= 0; j--) {
                if (s->joint_block[j] != s->contact_block[i]) continue;
                if (span[2 * c + 1] == 0) span[2 * c + 1] = j + 1;
                span[2 * c] = j;
            }
        }
    for (int r = k - 1; r >= 0 && spoil && !is_too_short; r--)
        if (span[2 * r + 1] > 0) span[2 * r + 1] -= is_too_short = 1;
    for (int r = 0; r < k; r++) stored += span[2 * r + 1] - span[2 * r];
    double *J = zeros(stored), *to = J;
    for (int r = 0; r < k; r++)
        for (int j = span[2 * r]; j < span[2 * r + 1]; j++) *to++ = problem->J[r * n + j];
    s->span = span;
    problem->J = J;
    return is_too_short;
}

/* ---- runs --------------------------------------------------------------------------------------------------------------- */

/* Compute the gradients of a random function at a solution, right or wrong. Return the number of violated laws. */
static int run_adjoint(int number, const gf_structure *s, const gf_problem *problem, int k, const gf_units *units,
                       const gf_solution *solution, int is_optimal)
{
    const int N = s->contacts, n = s->joints;
    const gf_moment_reference reference = {.centroid = {0.01, 0.02, 0.03}, .length = 0.05};
    const gf_adjoint_places places = {numbers(3 * N, -0.1, 0.1, 0), numbers(9 * N, -1.0, 1.0, 0), &reference};
    const gf_adjoint_seed seed_of = {.f = numbers(k, -1.0, 1.0, 0), .tau = numbers(n, -1.0, 1.0, 0), .objective = 1.0};
    const int sizes[] = {6, N, 3 * N, 3 * N, n, n, n, k * n};
    double *parts[8];
    for (int a = 0; a < 8; a++) parts[a] = zeros(sizes[a]);
    const gf_adjoint_gradient gradient = {parts[0], parts[1], parts[2], parts[3], parts[4], parts[5], parts[6], parts[7]};
    int index, faults = 0;
    const gf_adjoint_status status = gf_adjoint(s, problem, &places, units, solution, &seed_of, allocate(gf_adjoint_size(s)),
                                                &gradient, &index);
    if (status > GF_ADJOINT_UNSUPPORTED) faults += violated("the status of gradients is known", number);
    const int limits = status >= GF_ADJOINT_LOWER_TORQUE ? n : N;
    if (status >= GF_ADJOINT_CONE && status <= GF_ADJOINT_UPPER_TORQUE && (index < 0 || index >= limits))
        faults += violated("an undecided limit has an index", number);
    if ((s->facets > 0 || s->span != NULL) != (status == GF_ADJOINT_UNSUPPORTED))
        faults += violated("gradients need exact cones and a dense J", number);
    for (int a = 0; a < 8 && status == GF_ADJOINT_FOUND && is_optimal; a++)
        for (int i = 0; i < sizes[a]; i++)
            if (!isfinite(parts[a][i])) faults += violated("gradients are finite", number);
    return faults;
}

/* Solve and certify one problem, cold and warm; count the statuses. Return the number of violated laws. */
static int run_one(int number, int *counts)
{
    static const unsigned rarities[] = {0, 0, 0, 300, 30, 2};
    const unsigned rarity = rarities[roll(6)];
    int k, faults = 0, is_too_short = 0;
    gf_structure s = random_structure(&k);
    gf_problem problem = random_problem(&s, k, rarity);
    const int N = s.contacts, n = s.joints;
    gf_units units = {1.0, 0.05, 1.0, numbers(n, 0.01, 1.0, rarity)};
    double *wrench = numbers(6, -1.0, 1.0, rarity);
    const int has_nan = roll(10) == 0;
    if (has_nan) wrench[roll(6)] = NAN;
    problem.w = wrench;
    if (roll(2)) faults += prepare(number, &s, &problem, k, rarity, &units);
    if (roll(2)) is_too_short = compress_jacobian(&s, &problem, k);
    double *w = zeros(6);
    for (int r = 0; r < 6; r++) w[r] = problem.w[r];
    problem.w = w;

    gf_solution solution = {.f = zeros(k),
                            .y = zeros(6),
                            .z = zeros(k),
                            .nu_lower = zeros(N),
                            .nu_upper = zeros(N),
                            .lambda_lower = zeros(n),
                            .lambda_upper = zeros(n)};
    double *tau = zeros(n), *scratch = zeros(n + 2 * k);
    gf_options options = GF_OPTIONS_DEFAULT;
    void *workspace = allocate(gf_workspace_size(&s));
    for (options.warm = 0; options.warm < 3; options.warm++) {
        const gf_status status = gf_solve(&s, &problem, &options, workspace, &solution);
        if (status > GF_FAILED)
            faults += violated("the status is known", number);
        else
            counts[status]++;
        if (solution.iterations > options.max_iterations) faults += violated("iterations are bounded", number);
        if (is_too_short && status != GF_FAILED) faults += violated("rows contain their fingers", number);
        if (has_nan && status != GF_FAILED) faults += violated("NaN in the wrench returns GF_FAILED", number);
        for (int c = 0; c < k && status == GF_OPTIMAL; c++)
            if (!isfinite(solution.f[c]) || !isfinite(solution.z[c]))
                faults += violated("optimal solutions are finite", number);
        gf_residuals residuals;
        const int measured = gf_certify(&s, &problem, &solution, &units, tau, solution.z, scratch, &residuals);
        if (measured != (s.facets == 0)) faults += violated("certificates need exact cones", number);
        double residual, value, w_size[6];
        for (int r = 0; r < 6; r++) w_size[r] = fabs(w[r]);
        const int proven = gf_certify_infeasibility(&s, &problem, &solution, &units, w_size, scratch, &residual, &value);
        if (proven && status < GF_INFEASIBLE && measured && residuals.primal < 1e-8)
            faults += violated("feasible problems are not proven infeasible", number);
        if (proven && !(value > 0.0 && residual >= 0.0)) faults += violated("proofs have a positive value", number);
        if (options.warm == 0)
            faults += run_adjoint(number, &s, &problem, k, &units, &solution, status == GF_OPTIMAL && !rarity);
        w[0] *= 1.01;
    }
    return faults;
}

int main(int count, char **arguments)
{
    int problems = count > 1 ? atoi(arguments[1]) : 1000, counts[4] = {0}, faults = 0;
    for (int i = 0; i < problems; i++) {
        faults += run_one(i, counts);
        free_arrays();
    }
    printf("%d %d %d %d\n", counts[0], counts[1], counts[2], counts[3]);
    return faults != 0;
}
