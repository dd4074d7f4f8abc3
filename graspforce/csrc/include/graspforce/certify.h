/* Certificates: how well forces and multipliers prove each other optimal, and whether multipliers prove infeasibility.
 *
 * The certificates do not depend on the solver. They read the problem, the forces f and the multipliers y, nu and lambda, and
 * they share no code with gf_solve(). They read all of J, whatever the blocks are.
 *
 * For multipliers of the right signs, with the cone multipliers z computed from stationarity,
 *
 *     z = J W tau + ρ f + c − Gᵀ y − E_n (nu_lower − nu_upper) − J (lambda_lower − lambda_upper),
 *     cost(f) − minimum cost ≤ gap = yᵀ(G f − w) + zᵀ f + Σ multiplier · slack     if z is in K* and nu, lambda ≥ 0.
 *
 * gf_certify() therefore measures the constraint violation, the signs, the distance of z from K*, and the gap.
 *
 * The reference implementation in Python, with its tolerances, is graspforce/force/certificate.py.
 *
 * Reference: Boyd and Vandenberghe (2004), section 5.9.
 */
#ifndef GF_CERTIFY_H
#define GF_CERTIFY_H

#include "graspforce/problem.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Natural units of a problem, all positive. Residuals are relative to them. */
typedef struct {
    gf_real force;         /* F, N */
    gf_real length;        /* L, m */
    gf_real cost;          /* in the unit of the objective */
    const gf_real *torque; /* (n) T of each motor, N·m */
} gf_units;

/* Compute the natural units of a problem.
 *
 * problem  G and w must be about the contacts' centroid. The objective must be either quadratic (W and ρ) or linear (c).
 * length   root mean square distance of the contacts from their centroid, m: gf_moment_reference.length
 * torque   (n) written; `units` points to it
 * units    written
 *
 * The reference implementation, with its reasons, is graspforce/force/scale.py. Both agree to rounding. */
void gf_problem_units(const gf_structure *structure, const gf_problem *problem, gf_real length, gf_real *torque,
                      gf_units *units);

/* Relative residuals of a solution. A residual that is not finite is reported as DBL_MAX. */
typedef struct {
    gf_real primal; /* largest violation of a constraint: forces over F, moments over F L, torques over T of the motor */
    gf_real dual;   /* largest cost that a wrong sign or a z outside K* could hide, over cost unit + |cost(f)| */
    gf_real gap;    /* |gap| over cost unit + |cost(f)| */
} gf_residuals;

/* Measure the residuals of a solution. Return 1, or 0 if the problem has facets or a level, which are not supported.
 *
 * solution   f, y, nu_lower, nu_upper, lambda_lower and lambda_upper are read
 * tau        (n) written: motor torques, N·m
 * z          (k) written: multipliers of the cones; may be solution->z
 * scratch    (n) overwritten
 * residuals  written */
int gf_certify(const gf_structure *structure, const gf_problem *problem, const gf_solution *solution, const gf_units *units,
               gf_real *tau, gf_real *z, gf_real *scratch, gf_residuals *residuals);

/* A proof of infeasibility covers all normal forces up to this many force units, and further for small friction. */
#define GF_PROOF_RANGE 1e6

/* Return 1 if multipliers prove that no forces satisfy the constraints, otherwise 0.
 *
 * Negative multipliers and those of absent limits count as zero. With z = −Gᵀ y − E_n (nu_lower − nu_upper) −
 * J (lambda_lower − lambda_upper), all forces f in the cones satisfy zᵀ f ≥ 0 if z is in K*, so that they satisfy
 *
 *     0 ≥ value = yᵀ w + nu_lowerᵀ min_normal − nu_upperᵀ max_normal
 *                 + lambda_lowerᵀ (lower − tau_u) − lambda_upperᵀ (upper − tau_u).
 *
 * value > 0 is a contradiction. A z outside K* is put back by a larger nu_upper. Without a limit on the normal force the proof
 * holds for forces up to a range, which must be GF_PROOF_RANGE force units and more for small friction. Pyramids are not
 * supported: the function returns 0. Multipliers that are not finite prove nothing.
 *
 * solution   y, nu_lower, nu_upper, lambda_lower and lambda_upper are read
 * w_size     (6) sizes of the numbers whose sum is w: w is known to their rounding only; see gf_wrench_size()
 * scratch    (2 k) overwritten
 * residual   written: the part of the value that forces within the range can cancel, over GF_PROOF_RANGE and the largest term
 * value      written: the value over its largest term */
int gf_certify_infeasibility(const gf_structure *structure, const gf_problem *problem, const gf_solution *solution,
                             const gf_units *units, const gf_real *w_size, gf_real *scratch, gf_real *residual, gf_real *value);

#ifdef __cplusplus
}
#endif

#endif
