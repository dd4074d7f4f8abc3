/* The homogeneous self-dual interior-point method behind solve.h.
 *
 *     layout.inc scaling.inc pack.inc     sort and scale the problem, and write it into lanes
 *     lanes.inc cone.inc                  vector arithmetic and second-order cones
 *     finger_newton.inc finger_step.inc   operations on one finger
 *     schur.inc iteration.inc             operations on the object, and the iteration
 *     start.inc short_step.inc            starting points, and the path whose number of steps is bounded
 *     range_proof.inc                     proofs for wrenches outside the range of G
 *     unpack.inc                          forces and multipliers in SI units
 *
 * The .inc files are compiled as part of this file, so that one flattened function contains the whole iteration.
 *
 * The scaled problem is: minimise ½ xᵀHx + cᵀx subject to G x = w, E x = e, A x + s = h and s in K. K is a product of
 * half-lines and second-order cones; rows of cones have A = −1 and h = 0. The homogeneous embedding looks for x, y, v, s, z
 * and τ, κ ≥ 0 with
 *
 *     rx = H x + Gᵀy + Eᵀv + Aᵀz + c τ = 0        ry = G x − w τ = 0      re = E x − e τ = 0     rz = A x + s − h τ = 0
 *     κ + xᵀHx/τ + cᵀx + wᵀy + eᵀv + hᵀz = 0      s ∘ z = 0               τ κ = 0
 *
 * A solution with τ > 0 is optimal after division by τ. A solution with wᵀy + eᵀv + hᵀz < 0 and Gᵀy + Eᵀv + Aᵀz = 0 proves
 * that no feasible x exists. Each iteration takes a predictor step (σ = 0) and a corrector step with second-order terms
 * (Mehrotra 1992). These steps have no bound of their number; where they end without a verdict, short steps can follow
 * (short_step.inc).
 *
 * A Newton step solves K (dx, dy, dv) = right-hand side with K = [M Gᵀ Eᵀ; G 0 0; E 0 0] and M = H + AᵀW⁻²A. It solves twice:
 * for the residuals and for the column of τ, (−c, w, e, h). M is block diagonal with one Cholesky factor L for each finger;
 * V = L⁻¹Gᵀ leaves the 6 x 6 Schur complement S = Σ VᵀV. Four measures make the steps accurate to 1e-9:
 *
 *  - cones are scaled in light-cone coordinates (cone.inc);
 *  - the column of τ is solved as a difference from the iterate, (xt, …) = τ (solution) − (x, …). Its right-hand side is small,
 *    and Δτ = τ numerator/denominator has a sum of squares as denominator, without cancellation;
 *  - z replaces W⁻²s, which is equal to it and is never computed from s;
 *  - late steps are refined against the unregularised equations.
 */
#include "graspforce/solve.h"

#include "../real.inc"
#include "pack.inc"
#include "range_proof.inc"
#include "short_step.inc"
#include "target_clones.inc"
#include "unpack.inc"

/* Header of the workspace, kept between calls for warm starts. */
typedef struct {
    uint64_t fingerprint; /* of the last optimal solution, zero if there is none */
    double y[SHARED], tau;
} gf_warm_memory;

static const double DEMAND_GROWTH = 4.0, LARGEST_DEMAND = 1e4;  /* of `proof_demand`, while a proof cannot be completed */
static const double LEAST_MARGIN = GF_BY_PRECISION(1e-8, 1e-4); /* in units of F: a smaller negative margin counts as zero */

/* Run the iteration, compiled into one function. */
GF_TARGET_CLONES static gf_status run_iteration(gf_iteration *a, int max_iterations, int *iterations)
{
    return iterate(a, 0, max_iterations, iterations);
}

/* Run the iteration of a problem with a level, likewise. */
GF_TARGET_CLONES static gf_status run_level_iteration(gf_iteration *a, int max_iterations, int *iterations)
{
    return iterate(a, 1, max_iterations, iterations);
}

/* Run the iteration until a verdict or the limit is reached; an infeasibility proof is then in `solution`. */
static gf_status run_to_verdict(gf_iteration *a, int max_iterations, gf_solution *solution)
{
    const gf_scaled_problem *p = a->p;
    for (;; a->proof_demand *= DEMAND_GROWTH) {
        const gf_status status = p->structure->level == GF_LEVEL_NONE
                                     ? run_iteration(a, max_iterations, &solution->iterations)
                                     : run_level_iteration(a, max_iterations, &solution->iterations);
        /* an optimal margin below zero: its multipliers prove that no forces have the margin zero */
        const int is_negative = status == GF_OPTIMAL && p->structure->level == GF_LEVEL_MARGIN &&
                                a->y[WRENCH] * p->level_unit < -LEAST_MARGIN * a->tau;
        if (is_negative) return unpack_proof(p, a->y, solution) ? GF_INFEASIBLE : GF_OPTIMAL;
        if (status != GF_INFEASIBLE || unpack_proof(p, a->y, solution)) {
            if (status == GF_OPTIMAL || status == GF_INFEASIBLE || !prove_outside_range(a)) return status;
            return unpack_proof(p, a->y, solution) ? GF_INFEASIBLE : GF_FAILED;
        }
        if (!(a->proof_demand < LARGEST_DEMAND)) return GF_FAILED;
    }
}

/* Run the iteration, and where it ends without a verdict, the short-step path. */
static gf_status run_both_paths(gf_iteration *a, const gf_options *options, gf_solution *solution)
{
    const gf_status status = run_to_verdict(a, options->max_iterations, solution);
    if (status == GF_OPTIMAL || status == GF_INFEASIBLE || options->short_steps <= 0) return status;
    start_short_steps(a);
    return run_to_verdict(a, solution->iterations + options->short_steps, solution);
}

int gf_short_step_bound(const gf_structure *structure, double reduction)
{
    if (structure_size(structure) == 0 || !(reduction > 0.0)) return 0;
    const double steps = ceil(log(reduction) / log(short_step_centring(largest_degree(structure))));
    return steps < 0.0 ? 0 : steps < INT_MAX ? (int)steps : INT_MAX;
}

/* Place the parts of a workspace. Return its header. */
static gf_warm_memory *lay_out_workspace(void *workspace, const gf_structure *s, int k, gf_scaled_problem *p, gf_arena *a)
{
    uintptr_t aligned = ((uintptr_t)workspace + sizeof(gf_lane) - 1) / sizeof(gf_lane) * sizeof(gf_lane);
    *a = (gf_arena){.base = (char *)aligned};
    gf_warm_memory *kept = arena_take(a, 1, sizeof(gf_warm_memory));
    scaled_problem_allocate(p, s, k, a);
    return kept;
}

size_t gf_workspace_size(const gf_structure *s)
{
    int k = structure_size(s);
    if (k == 0) return 0;
    gf_scaled_problem p;
    gf_arena a;
    lay_out_workspace(NULL, s, k, &p, &a);
    for (int b = 0; b < s->blocks; b++) { /* upper bound: every finger in a group of its own */
        gf_finger_group g = {.d = 0};
        for (int i = 0; i < s->contacts; i++) {
            if (s->contact_block[i] != b) continue;
            g.d += s->components[i];
            g.cones += s->components[i] > 1;
            g.fixed++, g.rows += 1 + (s->level == GF_LEVEL_LARGEST_NORMAL);
        }
        for (int j = 0; j < s->joints; j++)
            if (s->joint_block[j] == b) g.fixed++, g.rows++;
        for (int r = 0; r < s->facets; r++) g.rows += s->contact_block[s->facet_contact[r]] == b;
        g.slacks = 2 * g.rows + g.d;
        group_allocate(&g, &a);
    }
    return a.used + sizeof(gf_lane);
}

gf_status gf_solve(const gf_structure *structure, const gf_problem *problem, const gf_options *options, void *workspace,
                   gf_solution *solution)
{
    gf_scaled_problem p = {.structure = structure, .problem = problem, .k = structure_size(structure)};
    solution->iterations = 0;
    solution->primal = solution->dual = solution->gap = INFINITY;
    if (p.k == 0 || workspace == NULL) return GF_FAILED;
    gf_arena memory_left;
    gf_warm_memory *kept = lay_out_workspace(workspace, structure, p.k, &p, &memory_left);
    uint64_t last = options->warm ? kept->fingerprint : 0;
    kept->fingerprint = 0;
    if (!sort_structure(&p) || !scale_problem(&p)) {
        clear_solution(&p, solution);
        for (int c = 0; c < p.k; c++) solution->f[c] = NAN;
        return GF_FAILED;
    }
    if (find_contradiction(&p, solution)) return GF_INFEASIBLE;
    form_groups(&p, &memory_left);
    pack(&p);
    gf_iteration a;
    initialise(&a, &p, options->tolerance);
    a.is_over = options->is_over, a.context = options->context;
    if (last == p.fingerprint)
        start_warm(&a, kept->y, kept->tau);
    else
        start_cold(&a);
    const gf_status status = run_both_paths(&a, options, solution);
    solution->primal = a.primal;
    solution->dual = a.dual;
    solution->gap = a.gap;
    if (status == GF_INFEASIBLE) return status;
    if (!unpack(&p, a.y, a.tau, solution)) return GF_FAILED;
    if (status == GF_OPTIMAL) {
        kept->fingerprint = p.fingerprint;
        kept->tau = a.tau;
        memcpy(kept->y, a.y, sizeof a.y);
    }
    return status;
}
