/* Optimal contact forces of a multi-finger hand within exact friction cones.
 *
 * Problem
 * -------
 * A hand with N contacts and n motors holds an object. gf_solve() computes the contact forces f that
 *
 *     minimise     ½ tauᵀ W tau + ½ ρ ‖f‖² + cᵀ f             where tau = tau_u + Jᵀ f are the motor torques
 *     subject to   G f = w                                    the contacts supply the wrench w
 *                  √(‖f_t‖²/μ² + m_n²/γ²) ≤ f_n               friction cone of each contact
 *                  min_normal ≤ f_n ≤ max_normal              normal force limits of each contact
 *                  lower ≤ tau ≤ upper                        torque limits of each motor
 *
 * or in place of that cost the largest normal force, or minus the slip margin that all contacts keep (gf_level),
 *
 * or proves that no such forces exist. If μ or γ is zero, the force components that it bounds are zero. A contact with facets
 * obeys the half-spaces aᵀ f_i ≤ 0 instead of the exact cone. problem.h describes the arrays, their frames and their units.
 *
 * Structure
 * ---------
 * Contacts and motors are divided into blocks, one for each finger, and J is zero between different blocks. Time and memory
 * are proportional to the number of blocks; the time for one block grows with the cube of its force components.
 *
 * Method
 * ------
 * A homogeneous self-dual primal-dual interior-point method with Nesterov–Todd scaling. Each iteration factors one small
 * matrix for each finger and one 6 x 6 Schur complement for the object.
 *
 * Guarantees
 * ----------
 * - The problem is scaled internally. Results do not depend on the units of length and force, apart from rounding.
 * - The number of iterations is bounded by max_iterations plus short_steps; is_over can end the search earlier. The best iterate
 *   is then returned as inaccurate if it is within 1000 times the tolerance.
 * - Short steps follow where the first max_iterations end without a verdict. In exact arithmetic, each reduces all residuals and
 *   the mean complementarity by the same known factor; docs/concepts/iteration_bound.md states what follows.
 * - No memory is allocated, nothing is printed, no global state is written and no locale is read.
 * - Calls with different workspaces may run in different threads at the same time.
 * - NaN, and infinity where it does not mean "no limit", return GF_FAILED.
 *
 * Build
 * -----
 * CMakeLists.txt builds and installs a library for find_package() and pkg-config. Any C11 compiler accepts the sources
 * solve.c, certify.c, grasp_matrix.c and strings.c of kernel/.
 *
 * Example
 * -------
 * Three contacts on a horizontal circle of radius 5 cm hold a weight of 1 N with minimum ½‖f‖². The friction coefficient is
 * 0.5, so each contact pushes with 2/3 N and carries 1/3 N.
 *
 *     #include <stdio.h>
 *     #include <stdlib.h>
 *     #include "graspforce/solve.h"
 *
 *     int main(void)
 *     {
 *         enum { N = 3, K = 9 };
 *         static const gf_real ux[N] = {1.0, -0.5, -0.5}, uy[N] = {0.0, 0.8660254037844386, -0.8660254037844386};
 *         gf_real G[6 * K] = {0.0}, w[6] = {0.0, 0.0, 1.0, 0.0, 0.0, 0.0};
 *         for (int i = 0; i < N; i++) {
 *             gf_real p[3] = {0.05 * ux[i], 0.05 * uy[i], 0.0};                                    // position, m
 *             gf_real axis[3][3] = {{0.0, 0.0, 1.0}, {uy[i], -ux[i], 0.0}, {-ux[i], -uy[i], 0.0}}; // t1, t2, n
 *             for (int a = 0; a < 3; a++) {
 *                 for (int r = 0; r < 3; r++) {
 *                     int s = (r + 1) % 3, t = (r + 2) % 3;
 *                     G[r * K + 3 * i + a] = axis[a][r];
 *                     G[(3 + r) * K + 3 * i + a] = p[s] * axis[a][t] - p[t] * axis[a][s];
 *                 }
 *             }
 *         }
 *         const int components[N] = {3, 3, 3}, contact_block[N] = {0, 1, 2};
 *         const gf_real mu[N] = {0.5, 0.5, 0.5}, gamma[N] = {0.0};
 *         const gf_real min_normal[N] = {0.0}, max_normal[N] = {20.0, 20.0, 20.0};
 *
 *         gf_structure hand = {.contacts = N, .blocks = N, .components = components, .contact_block = contact_block};
 *         gf_problem problem = {.G = G, .w = w, .mu = mu, .gamma = gamma, .min_normal = min_normal,
 *                               .max_normal = max_normal, .force_weight = 1.0};
 *         gf_real f[K], y[6], z[K], nu_lower[N], nu_upper[N];
 *         gf_solution solution = {.f = f, .y = y, .z = z, .nu_lower = nu_lower, .nu_upper = nu_upper};
 *         gf_options options = GF_OPTIONS_DEFAULT;
 *         void *workspace = malloc(gf_workspace_size(&hand));
 *         if (workspace == NULL) return 1;
 *         gf_status status = gf_solve(&hand, &problem, &options, workspace, &solution);
 *         printf("%s %.6f %.6f\n", gf_status_string(status), f[0], f[2]);
 *         free(workspace);
 *         return status;
 *     }
 *
 * prints "optimal 0.333333 0.666667".
 *
 * References
 * ----------
 * Homogeneous embedding with quadratic cost, and its steps: Domahidi, Chu and Boyd (2013); Goulart and Chen (2024).
 * Scaling: Nesterov and Todd (1997). Structure of grasp force problems: Boyd and Wegbreit (2007).
 */
#ifndef GF_SOLVE_H
#define GF_SOLVE_H

#include <stddef.h>

#include "graspforce/problem.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    gf_real tolerance;             /* of primal residual, dual residual and gap, relative to the size of the problem; > 0 */
    int max_iterations;            /* ≥ 1 */
    int warm;                      /* nonzero: start from the last optimal solution in the workspace if its structure matches */
    int (*is_over)(void *context); /* called before each iteration but the first; nonzero ends the search. May be NULL */
    void *context;                 /* argument of is_over */
    int short_steps;               /* ≥ 0: largest number of short steps after max_iterations; see gf_short_step_bound() */
} gf_options;

#define GF_OPTIONS_DEFAULT {1e-9, 60, 0, NULL, NULL, 0}

/* Return the bytes of workspace that any problem of this structure needs, or 0 if the structure is invalid.
 * The alignment of malloc() is sufficient. */
size_t gf_workspace_size(const gf_structure *structure);

/* Return the number of short steps that reduce all residuals and the mean complementarity, which start at 1, by a factor.
 *
 * It holds for every problem of this structure, in exact arithmetic. 1e-24 is far below the rounding of double. Return 0 if the
 * structure is invalid or `reduction` is not positive. */
int gf_short_step_bound(const gf_structure *structure, gf_real reduction);

/* Solve one problem and return its status.
 *
 * A cold start accepts a workspace with any contents. A warm start needs the workspace as an earlier call left it, or a
 * workspace that is zero. */
gf_status gf_solve(const gf_structure *structure, const gf_problem *problem, const gf_options *options, void *workspace,
                   gf_solution *solution);

#ifdef __cplusplus
}
#endif

#endif
