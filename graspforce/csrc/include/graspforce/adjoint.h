/* Gradients of a function of optimal forces with respect to the data of their problem.
 *
 * With the active limits a(f) = 0 as equations, the optimum x = (f, y, α) solves
 *
 *     ∇cost(f) − Gᵀ y + ∇a(f)ᵀ α = 0,     G f = w,     a(f) = 0,
 *
 * which is F(x, θ) = 0 with the data θ. For a function φ(f, tau, objective), its gradient is ∂φ/∂θ − λᵀ ∂F/∂θ with the one
 * linear solve (∂F/∂x) λ = ∂φ/∂x. gf_adjoint() finds the active limits from the forces and multipliers of a solution, refines
 * the solution by Newton's method, and computes all gradients. It shares no code with gf_solve().
 *
 * A gradient exists if each limit is either active or not and ∂F/∂x is regular. Otherwise the optimum is degenerate: the status
 * says why, and nothing is written.
 *
 * The reference implementation in Python is graspforce/analysis/sensitivity.py.
 *
 * References: Fiacco (1983); Amos and Kolter (2017). Estimate of the condition: Hager (1984).
 */
#ifndef GF_ADJOINT_H
#define GF_ADJOINT_H

#include <stddef.h>

#include "graspforce/certify.h"
#include "graspforce/grasp_matrix.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Result of gf_adjoint(). A limit is undecided if its slack and its multiplier are both below 1e-4 of their units. */
typedef enum {
    GF_ADJOINT_FOUND = 0,        /* the gradients are written */
    GF_ADJOINT_CONE = 1,         /* the friction cone of a contact may be active or not */
    GF_ADJOINT_LOWER_NORMAL = 2, /* the lower normal force limit of a contact may be active or not */
    GF_ADJOINT_UPPER_NORMAL = 3, /* the upper one */
    GF_ADJOINT_LOWER_TORQUE = 4, /* the lower torque limit of a motor may be active or not */
    GF_ADJOINT_UPPER_TORQUE = 5, /* the upper one */
    GF_ADJOINT_NOT_UNIQUE = 6,   /* the optimum is not unique, or its active limits depend on each other */
    GF_ADJOINT_NO_SOLUTION = 7,  /* the conditions have no solution with these active limits */
    GF_ADJOINT_UNSUPPORTED = 8   /* facets, a level, or a compressed J */
} gf_adjoint_status;

/* Contacts in O: the p and R from which gf_grasp_matrix() computed G and its reference. */
typedef struct {
    const double *p;                      /* (N, 3) positions, m */
    const double *R;                      /* (N, 3, 3) frames with columns t1, t2, n */
    const gf_moment_reference *reference; /* point of the moments of G, w and y */
} gf_adjoint_places;

/* Gradient of the function with respect to the optimum. */
typedef struct {
    const double *f;   /* (k) with respect to the forces */
    const double *tau; /* (n) with respect to the motor torques; optional if n = 0 */
    double objective;  /* with respect to the objective */
} gf_adjoint_seed;

/* Gradient of the function with respect to the data. Each keeps all other data: moved contacts keep their J. */
typedef struct {
    double *w;        /* (6) of the wrench about O */
    double *mu;       /* (N) of the friction coefficients */
    double *p;        /* (N, 3) of the contact positions */
    double *rotation; /* (N, 3) of rotation vectors of the contact frames in O */
    double *tau_u;    /* (n) of the motor torques without contact forces; optional if n = 0, as the rest */
    double *lower;    /* (n) of the lower torque limits */
    double *upper;    /* (n) of the upper torque limits */
    double *J;        /* (k, n) of the hand Jacobian */
} gf_adjoint_gradient;

/* Return the bytes of workspace that any problem of this structure needs. The alignment of malloc() is sufficient. */
size_t gf_adjoint_size(const gf_structure *structure);

/* Compute the gradient of a function of the optimum, and return the status.
 *
 * problem    with G and w about the centroid of `places`
 * unit       of gf_problem_units()
 * solution   f, y, nu and lambda of a certified optimum are read
 * workspace  gf_adjoint_size() bytes
 * gradient   written if the status is GF_ADJOINT_FOUND
 * index      written: contact or motor of the undecided limit, otherwise −1 */
gf_adjoint_status gf_adjoint(const gf_structure *structure, const gf_problem *problem, const gf_adjoint_places *places,
                             const gf_units *unit, const gf_solution *solution, const gf_adjoint_seed *seed, void *workspace,
                             const gf_adjoint_gradient *gradient, int *index);

#ifdef __cplusplus
}
#endif

#endif
