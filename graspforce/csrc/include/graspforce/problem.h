/* Records of a grasp force problem: its structure, its numbers, the solution and the status.
 *
 * solve.h states the optimisation problem. This file describes the arrays that hold it:
 *
 *     N  contacts          k  force components of all contacts        m  facets
 *     n  motors            B  blocks, one for each finger
 *
 * Units are SI: m, rad, N, N·m. All arrays belong to the caller. Matrices are row-major. An array that is marked optional may
 * be NULL.
 *
 * The vector f stacks the forces of all contacts in contact order. A contact has 1, 3 or 4 components:
 *
 *     1  (f_n)                         frictionless
 *     3  (f_t1, f_t2, f_n)             point contact with friction
 *     4  (f_t1, f_t2, f_n, m_n)        soft contact, which also resists a moment m_n about its normal
 *
 * Forces act on the object. They are expressed in the contact frame (t1, t2, n), whose normal n points into the object, so
 * that f_n ≥ 0 pushes.
 */
#ifndef GF_PROBLEM_H
#define GF_PROBLEM_H

#include "graspforce/real.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A further variable that all contacts share, and its part of the objective. */
typedef enum {
    GF_LEVEL_NONE = 0,           /* no such variable */
    GF_LEVEL_LARGEST_NORMAL = 1, /* t ≥ f_n at every contact; the objective has the further term t */
    GF_LEVEL_MARGIN = 2 /* s ≥ 0, with √(‖f_t‖² + (μ m_n/γ)²) ≤ μ f_n − s and aᵀ f_i ≤ −s at every contact with friction;
                                  * the objective has the further term −s */
} gf_level;

/* The part of a problem that stays the same from one solution to the next: sizes, contact models and fingers.
 *
 * A block is a finger: a set of contacts and motors. J must be zero between a contact and a motor of different blocks. Fingers
 * that share a motor, such as a wrist, form one block. gf_find_fingers() of grasp_matrix.h finds the blocks of a given J. */
typedef struct {
    int contacts;             /* N ≥ 1 */
    int joints;               /* n ≥ 0, number of motors */
    int blocks;               /* B ≥ 1, number of fingers */
    int facets;               /* m ≥ 0, number of half-spaces that replace exact cones */
    const int *components;    /* (N) force components of each contact: 1, 3 or 4 */
    const int *contact_block; /* (N) block of each contact, from 0 to B − 1 */
    const int *joint_block;   /* (n) block of each motor; optional if n = 0 */
    const int *facet_contact; /* (m) contact of each facet; optional if m = 0 */
    gf_level level;           /* variable that all contacts share */
    const int *span;          /* (k, 2) stored columns of each row of J, first and past the last; NULL if J is dense */
} gf_structure;

/* The numbers of one problem.
 *
 * If `span` is given, J is compressed: row c holds the columns span[2 c] ≤ j < span[2 c + 1] only, and the rows follow each
 * other without gaps. The span of a row must contain all motors of its block. */
typedef struct {
    const gf_real *G;          /* (6, k) grasp matrix: contact forces to the wrench on the object, forces first; 1 and m */
    const gf_real *w;          /* (6) wrench that the contacts must supply, forces first; N and N·m */
    const gf_real *mu;         /* (N) friction coefficients ≥ 0 */
    const gf_real *gamma;      /* (N) torsional friction lengths ≥ 0, m; read for contacts with 4 components */
    const gf_real *min_normal; /* (N) lower limits of f_n, N; a negative limit counts as zero */
    const gf_real *max_normal; /* (N) upper limits of f_n, N; INFINITY if there is no limit */
    const gf_real *J;          /* (k, n) hand Jacobian: motor rates to contact velocities, m/rad; optional if n = 0 */
    const gf_real *tau_u;      /* (n) motor torques without contact forces, N·m; optional if n = 0 */
    const gf_real *lower;      /* (n) lower torque limits, N·m; −INFINITY if there is no limit; optional if n = 0 */
    const gf_real *upper;      /* (n) upper torque limits, N·m; INFINITY if there is no limit; optional if n = 0 */
    const gf_real *weight;     /* (n) diagonal of the torque weight W, ≥ 0; optional if n = 0 */
    const gf_real *facet;      /* (m, 4) rows a of aᵀ (f_t1, f_t2, f_n, m_n) ≤ 0; optional if m = 0 */
    const gf_real *cost;       /* (k) linear cost c of the forces; optional */
    gf_real force_weight;      /* weight ρ ≥ 0 of ½ ‖f‖² */
    gf_real moment_length;     /* length ℓ > 0 that weighs moments in ‖f‖² = Σ ‖f_i‖² + m_n²/ℓ², m; 0 stands for 1 m */
} gf_problem;

/* Result of gf_solve(). */
typedef enum {
    GF_OPTIMAL = 0,    /* f is optimal to the requested tolerance */
    GF_INACCURATE = 1, /* f is optimal to 1000 times the requested tolerance */
    GF_INFEASIBLE = 2, /* no forces satisfy the constraints; the multipliers are a proof */
    GF_FAILED = 3      /* no verdict: invalid numbers, or no progress within the iteration limit */
} gf_status;

/* Return the name of a status: "optimal", "inaccurate", "infeasible" or "failed"; "unknown" for any other number. */
const char *gf_status_string(int status);

/* Forces, multipliers and residuals that gf_solve() writes. The caller provides the arrays.
 *
 * Optimal: the multipliers satisfy the stationarity condition
 *
 *     J W tau + ρ f + c = Gᵀ y + z + E_n (nu_lower − nu_upper − level) + J (lambda_lower − lambda_upper)
 *
 * with nu ≥ 0, lambda ≥ 0 and z in the dual cones. `level` is zero except with GF_LEVEL_LARGEST_NORMAL: then level ≥ 0, and its
 * sum is one. With GF_LEVEL_MARGIN, Σ z_n/μ ≥ 1. E_n maps the N normal forces to their rows of f.
 *
 * Infeasible: f is NaN and the multipliers prove that no forces exist. They satisfy
 *
 *     Gᵀ y + z + E_n (nu_lower − nu_upper) + J (lambda_lower − lambda_upper) = 0,
 *     yᵀ w + nu_lowerᵀ min_normal − nu_upperᵀ max_normal
 *          + lambda_lowerᵀ (lower − tau_u) − lambda_upperᵀ (upper − tau_u) = 1,
 *
 * whereas feasible forces would make the second expression zero or negative.
 *
 * Inaccurate: as for optimal, to the looser tolerance.
 * Failed: the arrays hold the last iterate, or f is NaN if the numbers are invalid. */
typedef struct {
    gf_real *f;            /* (k) contact forces, N and N·m */
    gf_real *y;            /* (6) multipliers of G f = w */
    gf_real *z;            /* (k) multipliers of the friction cones */
    gf_real *nu_lower;     /* (N) multipliers of min_normal ≤ f_n */
    gf_real *nu_upper;     /* (N) multipliers of f_n ≤ max_normal */
    gf_real *lambda_lower; /* (n) multipliers of lower ≤ tau; optional if n = 0 */
    gf_real *lambda_upper; /* (n) multipliers of tau ≤ upper; optional if n = 0 */
    gf_real *level;        /* (N) multipliers of f_n ≤ t; optional */
    int iterations;        /* number of iterations */
    gf_real primal;        /* last violation of the constraints, relative to the size of the problem */
    gf_real dual;          /* last violation of stationarity, likewise */
    gf_real gap;           /* last difference between primal and dual objective, likewise */
} gf_solution;

#ifdef __cplusplus
}
#endif

#endif
