/* graspforce structured kernel: contact forces inside exact friction cones, with least motor torque, in microseconds.
 *
 * The law. A hand with N contacts and n motors holds an object. The contact forces f (k components, stacked in contact order)
 *
 *     minimise     ½ tauᵀ W tau + ½ ρ fᵀf + cᵀf               tau = tau_u + Jᵀ f
 *     subject to   G f = w                                    the contacts supply the wrench w
 *                  √(‖f_t‖²/μ² + m_n²/γ²) ≤ f_n               at every contact; a zero μ or γ makes its components zero
 *                  min_normal ≤ f_n ≤ max_normal              at every contact
 *                  lower ≤ tau ≤ upper                        at every motor
 *
 * A contact that has facets obeys the rows aᵀ f_i ≤ 0 instead of the exact cone. Forces are those of the finger on the
 * object, in the contact's frame, with the normal inward: f_n ≥ 0 pushes. The structure that the kernel lives on: contacts
 * and motors fall into fingers ("blocks"), and J is zero between different fingers. Motors shared by several fingers, such as
 * a wrist, make one larger block of these fingers.
 *
 * The method is a homogeneous self-dual primal-dual interior point with Nesterov-Todd scaling: one small matrix a finger, one
 * 6 x 6 Schur complement for the object. Time and memory grow in proportion to the number of fingers.
 *
 * Units are SI throughout; the kernel scales inside, so the units of length and force change nothing but the numbers. It
 * allocates nothing, keeps no globals, prints nothing and reads no locale. Calls with different workspaces may run at once in
 * any threads. The number of iterations is bounded. NaN and infinity where no limit is meant give GF_FAILED.
 *
 * Example: three contacts on a horizontal circle of 5 cm hold 1 N of weight with least ½‖f‖². Friction is 0.5, so every
 * contact presses with 2/3 N and bears 1/3 N.
 *
 *     #include <stdio.h>
 *     #include <stdlib.h>
 *     #include "graspforce/solve.h"
 *
 *     int main(void)
 *     {
 *         enum { N = 3, K = 9 };
 *         static const double ux[N] = {1.0, -0.5, -0.5}, uy[N] = {0.0, 0.8660254037844386, -0.8660254037844386};
 *         double G[6 * K] = {0.0}, w[6] = {0.0, 0.0, 1.0, 0.0, 0.0, 0.0};
 *         for (int i = 0; i < N; i++) {
 *             double p[3] = {0.05 * ux[i], 0.05 * uy[i], 0.0};
 *             double axis[3][3] = {{0.0, 0.0, 1.0}, {uy[i], -ux[i], 0.0}, {-ux[i], -uy[i], 0.0}};
 *             for (int a = 0; a < 3; a++) {
 *                 for (int r = 0; r < 3; r++) {
 *                     int s = (r + 1) % 3, t = (r + 2) % 3;
 *                     G[r * K + 3 * i + a] = axis[a][r];
 *                     G[(3 + r) * K + 3 * i + a] = p[s] * axis[a][t] - p[t] * axis[a][s];
 *                 }
 *             }
 *         }
 *         const int components[N] = {3, 3, 3}, contact_block[N] = {0, 1, 2};
 *         const double mu[N] = {0.5, 0.5, 0.5}, gamma[N] = {0.0}, least[N] = {0.0}, most[N] = {20.0, 20.0, 20.0};
 *
 *         gf_structure hand = {.contacts = N, .blocks = N, .components = components, .contact_block = contact_block};
 *         gf_problem data = {.G = G, .w = w, .mu = mu, .gamma = gamma, .min_normal = least, .max_normal = most,
 *                                 .force_weight = 1.0};
 *         double f[K], y[6], z[K], nu_lower[N], nu_upper[N];
 *         gf_solution answer = {.f = f, .y = y, .z = z, .nu_lower = nu_lower, .nu_upper = nu_upper};
 *         gf_options options = GF_OPTIONS_DEFAULT;
 *         void *workspace = malloc(gf_workspace_size(&hand));
 *         if (workspace == NULL) return 1;
 *         int status = gf_solve(&hand, &data, &options, workspace, &answer);
 *         printf("%d %.6f %.6f\n", status, f[0], f[2]);
 *         free(workspace);
 *         return status;
 *     }
 *
 * prints "0 0.333333 0.666667".
 *
 * Sources: Domahidi, Chu, Boyd (2013) and Goulart, Chen (2024) for the homogeneous embedding with a quadratic cost and its
 * steps; Nesterov, Todd (1997) for the scaling; Boyd, Wegbreit (2007) for the structure of grasp force problems.
 */
#ifndef GF_SOLVE_H
#define GF_SOLVE_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* What stays the same from one problem to the next. */
typedef struct {
    int contacts;             /* N ≥ 1 */
    int joints;               /* n ≥ 0, motors */
    int blocks;               /* B ≥ 1, fingers */
    int facets;               /* rows that replace exact cones, 0 for none */
    const int *components;    /* (N) 1 = (f_n), 3 = (f_t1, f_t2, f_n), 4 = (f_t1, f_t2, f_n, m_n) */
    const int *contact_block; /* (N) the finger of each contact, 0 ≤ … < B */
    const int *joint_block;   /* (n) the finger of each motor; may be NULL if n = 0 */
    const int *facet_contact; /* (facets) the contact of each facet; may be NULL if there are none */
    const int *span; /* (k, 2) or NULL for a dense J: of row c J holds only the columns span[2 c] ≤ j < span[2 c + 1],
                                 row after row; they include the finger's motors, and what is not held is zero */
} gf_structure;

/* The numbers of one problem. Matrices are row-major and dense, J but for `span`; k is the sum of `components`. */
typedef struct {
    const double *G;          /* (6, k) contact forces to wrench on the object, force rows before moment rows (1 and m) */
    const double *w;          /* (6) wrench that the contacts supply, N and N·m */
    const double *mu;         /* (N) friction coefficients ≥ 0 */
    const double *gamma;      /* (N) torsional friction lengths ≥ 0, m; read where there are four components */
    const double *min_normal; /* (N) least normal forces, N; what is negative counts as zero */
    const double *max_normal; /* (N) largest normal forces, N; infinity for no limit */
    const double *J;          /* (k, n) motor rates to contact velocities, m/rad; read within the fingers only */
    const double *tau_u;      /* (n) motor torques without contact, N·m */
    const double *lower;      /* (n) least motor torques, N·m; minus infinity for no limit */
    const double *upper;      /* (n) largest motor torques, N·m; infinity for no limit */
    const double *weight;     /* (n) diagonal of W, ≥ 0 */
    const double *facet;      /* (facets, 4) rows a over (f_t1, f_t2, f_n, m_n): aᵀ f_i ≤ 0; NULL if there are none */
    const double *cost;       /* (k) c, linear cost of the forces, or NULL for none */
    double force_weight;      /* ρ ≥ 0, weight of ½ fᵀf */
} gf_problem;                 /* J … weight may be NULL if n = 0 */

typedef struct {
    double tolerance;   /* on primal and dual residual and gap, each relative to the problem's own scale */
    int max_iterations; /* the bound on the work */
    int warm;           /* nonzero: start from the last answer that this workspace saw, if its problem had the same shape */
} gf_options;

#define GF_OPTIONS_DEFAULT {1e-9, 60, 0}

enum {
    GF_OPTIMAL = 0,    /* f is the answer, to the tolerance */
    GF_INACCURATE = 1, /* f is near the answer: to a thousand times the tolerance */
    GF_INFEASIBLE = 2, /* no f obeys the laws, and the multipliers prove it */
    GF_FAILED = 3      /* no verdict: numbers that make no problem, or no progress */
};

/* Where the answer goes. With E_n the normal components' unit columns, an optimal answer has
 *
 *     J W tau + ρ f + c − Gᵀ y − z − E_n (nu_lower − nu_upper) − J (lambda_lower − lambda_upper) = 0,
 *
 * z_i in the dual cone { √(μ²‖z_t‖² + γ² z_m²) ≤ z_n } (or in the facets' own dual), the nu and lambda ≥ 0. An infeasible one
 * has
 *
 *     Gᵀ y + z + E_n (nu_lower − nu_upper) + J (lambda_lower − lambda_upper) = 0 and
 *     yᵀ w + nu_lowerᵀ min_normal − nu_upperᵀ max_normal + lambda_lowerᵀ (lower − tau_u) − lambda_upperᵀ (upper − tau_u) = 1,
 *
 * though every f that obeys the laws would make this number ≤ 0; f is then NaN. The other statuses leave the last iterate. */
typedef struct {
    double *f;            /* (k) contact forces, N and N·m */
    double *y;            /* (6) multipliers of G f = w */
    double *z;            /* (k) multipliers of the cones */
    double *nu_lower;     /* (N) multipliers of min_normal ≤ f_n */
    double *nu_upper;     /* (N) multipliers of f_n ≤ max_normal */
    double *lambda_lower; /* (n) multipliers of lower ≤ tau; may be NULL if n = 0 */
    double *lambda_upper; /* (n) multipliers of tau ≤ upper; likewise */
    int iterations;
    double primal; /* residuals as the kernel saw them at the end, relative to the problem's scale */
    double dual;
    double gap;
} gf_solution;

/* Bytes of workspace for any problem of this structure, aligned as malloc aligns; 0 if the structure makes no sense. */
size_t gf_workspace_size(const gf_structure *structure);

/* Solves one problem; returns a status. Before its first use a workspace may hold anything unless `warm` is set; for a warm
 * start it must be as the last call left it. */
int gf_solve(const gf_structure *structure, const gf_problem *data, const gf_options *options, void *workspace,
             gf_solution *answer);

#ifdef __cplusplus
}
#endif

#endif
