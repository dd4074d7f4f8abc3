/* Certificates that account for their own rounding: theorems about the numbers of a problem.
 *
 * certify.h measures residuals in floating point. The functions here compute each sum together with a bound on its rounding
 * error, and return numbers that hold in exact arithmetic. The data are the floats p, R, w, mu, … as they are stored, and the
 * grasp matrix that p and R define exactly, with moments about any point c.
 *
 * Optimality. For multipliers ≥ 0 and z as in certify.h, every f that satisfies all constraints exactly has
 *
 *     cost(f) ≥ cost(f₀) − gap,     gap = yᵀ(G f₀ − w) + zᵀf₀ + Σ multiplier · slack + Σ dᵢ bᵢ,
 *
 * where dᵢ ≥ 0 moves zᵢ into K* along the normal and bᵢ bounds the normal force: max_normal, or for contacts without it the
 * `reach`, to which the sum of their normal forces is limited in the statement. f₀ itself violates constraints by `violation`
 * at most.
 *
 * The objective max f_n is linear for a level α ≥ 0 with Σ α ≤ 1, because max f_n ≥ Σ α f_n. The largest slip margin s is the
 * largest number for which f − (s/μ') e_n is in the cones of all contacts with friction, whose facet friction is μ'. Then
 * s Σ (z_n + d)/μ' ≤ the sum above without the cost for all f, and the gap is the bound that follows, less the margin of f₀.
 *
 * Infeasibility. value > 0 proves that no f satisfies the constraints whose normal forces at contacts without max_normal have a
 * sum up to `reach`.
 *
 * Reference for bounds of rounding errors: Higham (2002), section 3.1.
 */
#ifndef GF_RIGOROUS_H
#define GF_RIGOROUS_H

#include "graspforce/certify.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Places and frames of the contacts, and the point about which y has its moments. */
typedef struct {
    const double *p;      /* (N, 3) positions in O, m */
    const double *R;      /* (N, 3, 3) contact frames in O, columns t1, t2, n */
    const double *point;  /* (3) c in O, m */
    double moment_length; /* ℓ > 0 of ½ ρ (‖f‖² + m_n²/ℓ²), m */
} gf_contact_places;

/* Friction pyramids, and the objectives max f_n and largest slip margin. All zero: exact cones and neither objective. */
typedef struct {
    const int *vertices;          /* (N) vertices of each contact's polygon; 0 or NULL: exact cones */
    const double *vertex;         /* (Σ vertices, 2) f_t at f_n = 1, counterclockwise, about zero */
    int separate_moment;          /* 1: |m_n| ≤ γ f_n beside f_t; 0: the polygon belongs to f_n − |m_n|/γ */
    const double *level;          /* (N) α of the objective max f_n, also in the problem's cost; NULL: another objective */
    const double *facet_friction; /* (N) μ' of the slip margin, 0 without friction; NULL: another objective */
    double slip_margin;           /* s of f₀, N */
} gf_cone_data;

/* Numbers that hold in exact arithmetic. They are not finite if a number of the problem or the solution is not. */
typedef struct {
    double violation; /* of the constraints by f₀ at most: forces over F, moments over F L, torques over T of the motor */
    double gap;       /* cost(f₀) − least cost at most */
    double value;     /* of a proof of infeasibility at least, over its largest term */
    double
        reach; /* N: sum of the normal forces at contacts without max_normal, up to which the statement holds; INFINITY: all */
} gf_proven_bounds;

/* Bound violation and gap of forces. Return 1, or 0 for a compressed J or a structure with facets: pyramids are in `cones`.
 *
 * problem   w is about O; G is not read
 * solution  f, y, nu_lower, nu_upper, lambda_lower and lambda_upper are read; y has its moments about the point c. Multipliers
 *           that are negative or belong to absent limits count as zero
 * cones     pyramids and objective; NULL for none
 * units     violation is relative to them
 * reach     sum of the normal forces at contacts without max_normal for which the statement holds, N; at least 0
 * scratch   (4 n) overwritten
 * distance  (N) written: d
 * bounds    written; the value is 0 */
int gf_bound_optimality(const gf_structure *structure, const gf_problem *problem, const gf_contact_places *places,
                        const gf_cone_data *cones, const gf_solution *solution, const gf_units *units, double reach,
                        double *scratch, double *distance, gf_proven_bounds *bounds);

/* Return 1 if multipliers prove that no forces within the reach satisfy the constraints, otherwise 0. Arguments as above; the
 * forces are not read, and violation and gap are 0. The reach is as large as the proof allows; INFINITY for all forces. */
int gf_prove_infeasibility(const gf_structure *structure, const gf_problem *problem, const gf_contact_places *places,
                           const gf_cone_data *cones, const gf_solution *solution, double *scratch, double *distance,
                           gf_proven_bounds *bounds);

#ifdef __cplusplus
}
#endif

#endif
