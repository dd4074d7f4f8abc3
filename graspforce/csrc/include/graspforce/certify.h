/* How well contact forces and multipliers prove each other optimal, from the problem's numbers alone.
 *
 * The law. For multipliers of the right signs, with z from stationarity,
 *
 *     z = J W tau + ρ f + c − Gᵀ y − E_n (nu_lower − nu_upper) − J (lambda_lower − lambda_upper),
 *     cost(f) − least cost ≤ gap = yᵀ(G f − w) + Σ zᵀf + Σ multiplier · slack,     if z is in K* and all nu, lambda ≥ 0.
 *
 * So feasibility, the signs, z in K* and the gap are what is measured. Nothing is taken from the solver but f, y, nu and
 * lambda: this file and certify.c share the records of structured.h with it and no line of code. What is held of J is read in
 * full, whatever the fingers. The law in Python, with its tolerances, is graspforce/force/certificate.py; both give the same numbers.
 *
 * Boyd and Vandenberghe, Convex Optimization (2004), 5.9.
 */
#ifndef GF_CERTIFY_H
#define GF_CERTIFY_H

#include "graspforce/solve.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The problem's own units, in which residuals are small numbers; all positive. */
typedef struct {
    double force;         /* F, N */
    double length;        /* L, m */
    double cost;          /* of the objective's unit */
    const double *torque; /* (n) T of each motor, N·m */
} gf_units;

/* Writes the units of a problem, and `torque` (n), to which they then point. G and w must be about the contacts' centroid, and
 * length their distance from it (grasp.h). The law and its reasons are in graspforce/force/scale.py; both give the same numbers but
 * for rounding. Objectives: ½ tauᵀ W tau + ½ ρ fᵀf without linear cost, or a linear cost alone. */
void gf_problem_units(const gf_structure *structure, const gf_problem *data, double length, double *torque, gf_units *units);

/* All relative; the largest finite number where the arithmetic left the finite ones. */
typedef struct {
    double
        primal; /* largest of |G f − w| over F and F L, cone and normal-force violations over F, torque violations over each motor's T */
    double dual; /* largest cost that a wrong sign or a z outside K* could hide, over cost + |cost(f)| */
    double gap;  /* |gap| over cost + |cost(f)| */
} gf_residuals;

/* Measures answer->f, y, nu_* and lambda_*. Writes tau (n), the motor torques, and z (k), which may be the answer's own;
 * scratch (n) is overwritten. Returns 1, or 0 if the problem has facets, whose cones are not measured here. */
int gf_certify(const gf_structure *structure, const gf_problem *data, const gf_solution *answer, const gf_units *units,
               double *tau, double *z, double *scratch, gf_residuals *residuals);

#ifdef __cplusplus
}
#endif

#endif
