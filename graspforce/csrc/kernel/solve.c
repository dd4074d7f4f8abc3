/* The homogeneous self-dual interior-point method behind structured.h. What it does to each finger is in structured_finger.h,
 * the cones' algebra in structured_cone.h, sorting and scaling in structured_plan.h, packing in structured_pack.h, the way
 * back in structured_unpack.h.
 *
 * With everything scaled, the problem reads: minimise ½ xᵀHx + cᵀx subject to G x = w, E x = e, A x + s = h, s in K, where K
 * is a product of half-lines and second-order cones (for these, A = −1 and h = 0). The embedding looks for x, y, v, s, z and
 * τ, κ ≥ 0 with
 *
 *     rx = H x + Gᵀy + Eᵀv + Aᵀz + c τ = 0        ry = G x − w τ = 0      re = E x − e τ = 0     rz = A x + s − h τ = 0
 *     κ + xᵀHx/τ + cᵀx + wᵀy + eᵀv + hᵀz = 0      s ∘ z = 0               τ κ = 0
 *
 * A solution with τ > 0 is optimal after division by τ; one with wᵀy + eᵀv + hᵀz < 0 and rx = 0 but for H x + c τ proves that
 * no x exists. Each iteration is Mehrotra's: a step towards σ = 0, then one with its second-order terms.
 *
 * A Newton step solves K (dx, dy, dv) = right side, K = [M Gᵀ Eᵀ; G 0 0; E 0 0], M = H + AᵀW⁻²A, twice: for the residuals and
 * for τ's column (−c, w, e, h). M is block diagonal, one Cholesky factor L a finger; V = L⁻¹Gᵀ leaves S = Σ VᵀV, 6 x 6. Four
 * things make it accurate to 1e-9, where the textbook's formulas are not:
 *
 *  - cones are scaled in light-cone coordinates (structured_cone.h);
 *  - τ's column is solved as a difference to the present iterate, (xt, …) = τ (column's solution) − (x, …), so that its right
 *    side is small and Δτ = τ num/den has a denominator without cancellation, a sum of squares;
 *  - W⁻²s is z: it is never computed from s;
 *  - late steps are refined against the unregularised equations.
 */
#include "graspforce/solve.h"

#include "finger_newton.inc"
#include "unpack.inc"

static const double SCHUR_RIDGE = 1e-13;  /* of S's trace: lets rank G < 6 pass */
static const double BACK_OFF = 0.99;      /* of the way to the boundary */
static const double REFINE_BELOW = 1e-4;  /* mean complementarity */
static const double WARM_FLOOR = 1e-3;    /* least slack and multiplier of a warm start */
static const double COST_FLOOR = 1e-4;    /* costs below it count as this large */
static const double LOOSE = 1e3;          /* times the tolerance: still worth returning, as inaccurate */
static const double REFINED_ERROR = 1e-3; /* times the tolerance: what a step may leave of the equations */
enum { REFINEMENTS = 5, MAX_STALLED = 4, SHORT_STEPS = 3 };

/* The scalars of the iteration. */
typedef struct {
    const gf_scaled_problem *p;
    double tolerance;
    double w[WRENCH], w_top, c_top, degree;
    double tau, kappa, y[WRENCH];
    double ry[WRENCH]; /* residual of G x = w τ */
    double sz, mu;     /* sᵀz and mean complementarity */
    double primal, dual, gap;
    double constant;           /* ½ tau_uᵀ W tau_u, the cost that no force changes */
    double proof, proof_error; /* −(wᵀy + eᵀv + hᵀz), and what the residuals may take from it */
    double best, best_y[WRENCH], best_tau;
    double S[SCHUR];
    double dtau, dkappa, dy[WRENCH], yt[WRENCH];
} gf_iteration;

/* ---- the six equations -------------------------------------------------------------------------------------------------- */

/* S's factor, packed, diagonal inverted. */
static void factor_schur(double *S)
{
    double ridge = SCHUR_RIDGE * (S[0] + S[2] + S[5] + S[9] + S[14] + S[20]) + 1e-290;
    for (int i = 0; i < WRENCH; i++) {
        double *row = S + i * (i + 1) / 2;
        for (int j = 0; j <= i; j++) {
            const double *other = S + j * (j + 1) / 2;
            double sum = row[j] + (i == j ? ridge : 0.0);
            for (int q = 0; q < j; q++) sum -= row[q] * other[q];
            row[j] = j < i ? sum * other[j] : 1.0 / sqrt(sum > 1e-3 * ridge ? sum : ridge);
        }
    }
}

static void solve_schur(const double *S, double *y)
{
    for (int i = 0; i < WRENCH; i++) {
        for (int j = 0; j < i; j++) y[i] -= S[i * (i + 1) / 2 + j] * y[j];
        y[i] *= S[i * (i + 1) / 2 + i];
    }
    for (int i = WRENCH - 1; i >= 0; i--) {
        for (int j = i + 1; j < WRENCH; j++) y[i] -= S[j * (j + 1) / 2 + i] * y[j];
        y[i] *= S[i * (i + 1) / 2 + i];
    }
}

/* ---- the iteration ------------------------------------------------------------------------------------------------------ */

/* Residuals, gap and complementarity of the iterate. */
static void measure_iterate(gf_iteration *a)
{
    gf_residual_sums sum = {.xHx = lane_of(0.0)};
    GF_EACH_GROUP(a->p, residuals, a->tau, a->y, &sum);
    double wy = 0.0, limits = lane_sum(sum.limits), xHx = lane_sum(sum.xHx), cx = lane_sum(sum.cx), inverse = 1.0 / a->tau;
    a->primal = lane_max_element(sum.primal);
    for (int r = 0; r < WRENCH; r++) {
        a->ry[r] = lane_sum(sum.Gx[r]) - a->w[r] * a->tau;
        a->primal = max_of(a->primal, fabs(a->ry[r]));
        wy += a->w[r] * a->y[r];
    }
    double low = -0.5 * xHx * inverse * inverse - (wy + limits) * inverse;
    a->sz = lane_sum(sum.sz);
    a->mu = (a->sz + a->tau * a->kappa) / a->degree;
    double high = 0.5 * xHx * inverse * inverse + cx * inverse;
    a->gap = fabs(high - low) / (COST_FLOOR + fmin(fabs(high + a->constant), fabs(low + a->constant)));
    a->primal *= inverse / (1.0 + a->w_top);
    a->dual = lane_max_element(sum.dual) * inverse / (1.0 + a->c_top);
    a->proof = -(wy + limits);
    a->proof_error = lane_sum(sum.proof_error);
}

/* dy of the step: S dy = p + η ry. */
static void schur_step(const gf_iteration *a, const gf_lane *p, double eta, double *dy)
{
    for (int r = 0; r < WRENCH; r++) dy[r] = lane_sum(p[r]) + eta * a->ry[r];
    solve_schur(a->S, dy);
}

/* Δτ and Δκ from the step's numerator; Δτ/τ. */
static double move_tau(gf_iteration *a, double numerator, double denominator, double complement)
{
    double share = numerator / denominator;
    a->dtau = share * a->tau;
    a->dkappa = -(complement + a->kappa * a->dtau) / a->tau;
    return share;
}

static double longest_step(const gf_iteration *a)
{
    gf_lane rates = lane_of(0.0);
    GF_EACH_GROUP(a->p, inverse_step, &rates);
    double rate = max_of(lane_max_element(rates), max_of(-a->dtau / a->tau, -a->dkappa / a->kappa));
    return rate > 1.0 ? 1.0 / rate : 1.0;
}

GF_INLINE double ry_dot(const gf_iteration *a, const double *dy)
{
    double sum = 0.0;
    for (int r = 0; r < WRENCH; r++) sum += a->ry[r] * dy[r];
    return sum;
}

/* Refines the step until what it leaves is small or shrinks no more. */
GF_INLINE void refine(gf_iteration *a, double eta)
{
    double last = INFINITY;
    for (int pass = 0; pass < REFINEMENTS; pass++) {
        gf_lane p[WRENCH], Gx[WRENCH], top = lane_of(0.0);
        double more[WRENCH];
        for (int r = 0; r < WRENCH; r++) p[r] = Gx[r] = lane_of(0.0);
        GF_EACH_GROUP(a->p, refine_right_side, eta, a->dtau, a->dy, p, Gx, &top);
        double rest = lane_max_element(top);
        for (int r = 0; r < WRENCH; r++) {
            double missing = a->w[r] * a->dtau - eta * a->ry[r] - lane_sum(Gx[r]);
            more[r] = lane_sum(p[r]) - missing;
            rest = max_of(rest, fabs(missing));
        }
        if (rest <= REFINED_ERROR * a->tolerance * a->tau || !(rest < 0.5 * last)) return;
        last = rest;
        solve_schur(a->S, more);
        GF_EACH_GROUP(a->p, refine_step, more);
        for (int r = 0; r < WRENCH; r++) a->dy[r] += more[r];
    }
}

/* Makes the step; returns how far it may go. */
GF_INLINE double make_step(gf_iteration *a)
{
    gf_lane S[SCHUR], p[WRENCH], p_tau[WRENCH], numerator = lane_of(0.0), denominator = lane_of(0.0), excess = lane_of(0.0);
    for (int i = 0; i < SCHUR; i++) S[i] = lane_of(0.0);
    for (int r = 0; r < WRENCH; r++) p[r] = p_tau[r] = lane_of(0.0);
    GF_EACH_GROUP(a->p, form_matrix, S);
    for (int i = 0; i < SCHUR; i++) a->S[i] = lane_sum(S[i]);
    factor_schur(a->S);

    GF_EACH_GROUP(a->p, first_right_sides, p, p_tau);
    schur_step(a, p, 1.0, a->dy);
    schur_step(a, p_tau, 1.0, a->yt);
    GF_EACH_GROUP(a->p, step_without_tau, 1.0, 1, a->dy, &numerator);
    GF_EACH_GROUP(a->p, tau_column, a->yt, &denominator);
    for (int r = 0; r < WRENCH; r++) a->yt[r] += a->y[r];
    double tk = a->tau * a->kappa, below = lane_sum(denominator) + tk;
    double share = move_tau(a, lane_sum(numerator) - ry_dot(a, a->dy), below, tk);
    GF_EACH_GROUP(a->p, add_tau, share);
    double reach = longest_step(a);

    double sigma = (1.0 - reach) * (1.0 - reach) * (1.0 - reach), eta = 1.0 - sigma, target = sigma * a->mu;
    double complement = tk + a->dtau * a->dkappa - target;
    for (int r = 0; r < WRENCH; r++) p[r] = lane_of(0.0);
    GF_EACH_GROUP(a->p, second_right_side, eta, target, p, &excess);
    schur_step(a, p, eta, a->dy);
    numerator = lane_of(0.0);
    GF_EACH_GROUP(a->p, step_without_tau, eta, 0, a->dy, &numerator);
    double above = lane_sum(numerator) - ry_dot(a, a->dy) + eta * (tk + a->sz) - complement - (a->sz + lane_sum(excess));
    share = move_tau(a, above, below, complement);
    GF_EACH_GROUP(a->p, add_tau, share);
    for (int r = 0; r < WRENCH; r++) a->dy[r] += share * a->yt[r];

    if (a->mu < REFINE_BELOW) refine(a, eta);
    return longest_step(a);
}

/* ---- start, best iterate, verdict --------------------------------------------------------------------------------------- */

/* s = z = 1 in every cone, all else zero. */
static void start_cold(gf_iteration *a)
{
    for (gf_finger_group *g = a->p->groups; g < a->p->groups + a->p->group_count; g++) {
        for (int i = 0; i < g->d; i++) g->x[i] = lane_of(0.0);
        for (int q = 0; q < g->fixed; q++) g->v[q] = lane_of(0.0);
        for (int o = 0; o < 2 * g->rows; o++) {
            g->s[o] = lane_of(1.0);
            g->z[o] = lane_where(g->has[o], lane_of(1.0));
        }
        for (int q = 0, o = 2 * g->rows; q < g->cones; o += g->cone_size[q++])
            for (int i = 0; i < g->cone_size[q]; i++) g->s[o + i] = g->z[o + i] = lane_of(i == 0 ? 1.0 : 0.0);
    }
    for (int r = 0; r < WRENCH; r++) a->y[r] = 0.0;
    a->tau = a->kappa = 1.0;
}

static void move_inside_cone(int n, gf_lane *v)
{
    gf_lane square = v[1] * v[1];
    for (int i = 2; i < n; i++) square += v[i] * v[i];
    v[0] = lane_max(v[0], lane_sqrt(square) + WARM_FLOOR);
}

/* The last answer, moved inside. */
static void start_warm(gf_iteration *a, const double *last_y, double last_tau)
{
    double inverse = 1.0 / last_tau;
    for (gf_finger_group *g = a->p->groups; g < a->p->groups + a->p->group_count; g++) {
        for (int i = 0; i < g->d; i++) g->x[i] *= inverse;
        for (int q = 0; q < g->fixed; q++) g->v[q] *= inverse;
        for (int o = 0; o < 2 * g->rows; o++) {
            g->s[o] = lane_pick(g->has[o], lane_max(g->s[o] * inverse, lane_of(WARM_FLOOR)), lane_of(1.0));
            g->z[o] = lane_where(g->has[o], lane_max(g->z[o] * inverse, lane_of(WARM_FLOOR)));
        }
        for (int o = 2 * g->rows; o < g->slacks; o++) g->s[o] *= inverse, g->z[o] *= inverse;
        for (int q = 0, o = 2 * g->rows; q < g->cones; o += g->cone_size[q++]) {
            move_inside_cone(g->cone_size[q], g->s + o);
            move_inside_cone(g->cone_size[q], g->z + o);
        }
    }
    for (int r = 0; r < WRENCH; r++) a->y[r] = last_y[r] * inverse;
    a->tau = 1.0;
    a->kappa = WARM_FLOOR;
}

static void keep_best(gf_iteration *a, double error)
{
    a->best = error;
    if (!(error < LOOSE * a->tolerance)) return;
    for (gf_finger_group *g = a->p->groups; g < a->p->groups + a->p->group_count; g++) {
        memcpy(g->best_x, g->x, (size_t)g->d * sizeof(gf_lane));
        memcpy(g->best_z, g->z, (size_t)g->slacks * sizeof(gf_lane));
        memcpy(g->best_v, g->v, (size_t)g->fixed * sizeof(gf_lane));
    }
    memcpy(a->best_y, a->y, sizeof a->y);
    a->best_tau = a->tau;
}

static int return_best(gf_iteration *a)
{
    if (!(a->best < LOOSE * a->tolerance)) return GF_FAILED;
    for (gf_finger_group *g = a->p->groups; g < a->p->groups + a->p->group_count; g++) {
        memcpy(g->x, g->best_x, (size_t)g->d * sizeof(gf_lane));
        memcpy(g->z, g->best_z, (size_t)g->slacks * sizeof(gf_lane));
        memcpy(g->v, g->best_v, (size_t)g->fixed * sizeof(gf_lane));
    }
    memcpy(a->y, a->best_y, sizeof a->y);
    a->tau = a->best_tau;
    return GF_INACCURATE;
}

/* Iterates to a verdict. */
GF_INLINE int iterate(gf_iteration *a, int max_iterations, int *iterations)
{
    int stalled = 0, short_steps = 0;
    a->best = INFINITY;
    for (*iterations = 0;; (*iterations)++) {
        measure_iterate(a);
        double error = max_of(a->primal, max_of(a->dual, a->gap));
        if (!(error < INFINITY) || !(a->mu > 0.0) || !(a->tau > 0.0)) return return_best(a);
        if (error <= a->tolerance) return GF_OPTIMAL;
        if (a->proof > 0.0 && a->proof > a->proof_error) return GF_INFEASIBLE;
        stalled = error < a->best ? 0 : stalled + 1;
        if (stalled == 0) keep_best(a, error);
        if (*iterations == max_iterations || (stalled >= MAX_STALLED && a->best < LOOSE * a->tolerance)) return return_best(a);
        double step = BACK_OFF * make_step(a);
        short_steps += step < 1e-7;
        if (!(step > 0.0) || short_steps >= SHORT_STEPS) return return_best(a);
        GF_EACH_GROUP(a->p, advance, step);
        for (int r = 0; r < WRENCH; r++) a->y[r] += step * a->dy[r];
        a->tau += step * a->dtau;
        a->kappa += step * a->dkappa;
    }
}

/* Where no verdict was reached: has w a part that no contact force can supply? With r = w's part outside the range of G, y = r
 * proves it. r is what repeated w ← δ (G Gᵀ + δ)⁻¹ w leaves. Returns 1 with the proof as the iterate. */
static int prove_outside_range(gf_iteration *a)
{
    double gram[SCHUR] = {0.0}, rest[WRENCH];
    for (const gf_finger_group *g = a->p->groups; g < a->p->groups + a->p->group_count; g++)
        for (int r = 0; r < WRENCH; r++)
            for (int t = 0; t <= r; t++)
                gram[r * (r + 1) / 2 + t] += lane_sum(*g->active * dot(g->d, g->G + r * g->d, g->G + t * g->d));
    double ridge = 1e-10 * (gram[0] + gram[2] + gram[5] + gram[9] + gram[14] + gram[20]);
    for (int r = 0; r < WRENCH; r++) gram[r * (r + 3) / 2] += ridge;
    factor_schur(gram);
    memcpy(rest, a->w, sizeof rest);
    for (int pass = 0; pass < 3; pass++) {
        for (int r = 0; r < WRENCH; r++) rest[r] *= ridge;
        solve_schur(gram, rest);
    }
    double proof = 0.0, proof_error = 0.0;
    for (int r = 0; r < WRENCH; r++) proof += rest[r] * a->w[r];
    for (const gf_finger_group *g = a->p->groups; g < a->p->groups + a->p->group_count; g++)
        for (int i = 0; i < g->d; i++) {
            gf_lane force = lane_of(0.0);
            for (int r = 0; r < WRENCH; r++) force += g->G[r * g->d + i] * rest[r];
            proof_error += lane_sum(*g->active * lane_abs(force) * g->reach[i]);
        }
    if (!(proof > proof_error)) return 0;
    for (gf_finger_group *g = a->p->groups; g < a->p->groups + a->p->group_count; g++) {
        memset(g->z, 0, (size_t)g->slacks * sizeof(gf_lane));
        memset(g->v, 0, (size_t)g->fixed * sizeof(gf_lane));
    }
    for (int r = 0; r < WRENCH; r++) a->y[r] = -rest[r];
    return 1;
}

/* What a workspace remembers between calls. */
typedef struct {
    uint64_t fingerprint; /* of the last answer's groups, zero if there is none */
    double y[WRENCH], tau;
} gf_warm_memory;

static void initialise(gf_iteration *a, const gf_scaled_problem *p, double tolerance)
{
    *a = (gf_iteration){.p = p, .tolerance = tolerance, .degree = 1.0};
    for (int r = 0; r < WRENCH; r++) {
        a->w[r] = p->data->w[r] / (r < 3 ? p->force : p->force * p->length);
        a->w_top = max_of(a->w_top, fabs(a->w[r]));
    }
    for (int j = 0; j < p->s->joints; j++)
        a->constant += 0.5 * p->data->weight[j] * p->data->tau_u[j] * p->data->tau_u[j] / p->cost;
    for (gf_finger_group *g = p->groups; g < p->groups + p->group_count; g++) {
        gf_lane count = lane_of(g->cones), top = lane_of(0.0);
        for (int o = 0; o < 2 * g->rows; o++) count += lane_where(g->has[o], lane_of(1.0));
        for (int i = 0; i < g->d; i++) top = lane_max(top, lane_abs(g->c[i]));
        a->degree += lane_sum(count * *g->active);
        a->c_top = max_of(a->c_top, lane_max_element(top));
    }
}

#if defined(__x86_64__) && defined(__gnu_linux__) && __GNUC__ >= 12 && !defined(__clang__) && GF_LANES > 1 && !defined(__AVX2__)
/* Compiled for AVX2 and for any x86-64; which one runs is chosen when the library loads. */
#define GF_TARGET_CLONES __attribute__((flatten, target_clones("arch=x86-64-v3", "default")))
#elif defined(__GNUC__)
#define GF_TARGET_CLONES __attribute__((flatten))
#else
#define GF_TARGET_CLONES
#endif

/* Everything above, compiled into one function. */
GF_TARGET_CLONES static int run_iteration(gf_iteration *a, int max_iterations, int *iterations)
{
    return iterate(a, max_iterations, iterations);
}

/* ---- the public functions ----------------------------------------------------------------------------------------------- */

/* Where a workspace's parts stand, and its aligned beginning. */
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
    for (int b = 0; b < s->blocks; b++) { /* each finger alone in a group, with everything that it can have */
        gf_finger_group g = {.d = 0};
        for (int i = 0; i < s->contacts; i++) {
            if (s->contact_block[i] != b) continue;
            g.d += s->components[i];
            g.cones += s->components[i] > 1;
            g.fixed++, g.rows++;
        }
        for (int j = 0; j < s->joints; j++)
            if (s->joint_block[j] == b) g.fixed++, g.rows++;
        for (int r = 0; r < s->facets; r++) g.rows += s->contact_block[s->facet_contact[r]] == b;
        g.slacks = 2 * g.rows + g.d;
        group_allocate(&g, &a);
    }
    return a.used + sizeof(gf_lane);
}

int gf_solve(const gf_structure *structure, const gf_problem *data, const gf_options *options, void *workspace,
             gf_solution *answer)
{
    gf_scaled_problem p = {.s = structure, .data = data, .k = structure_size(structure)};
    answer->iterations = 0;
    answer->primal = answer->dual = answer->gap = INFINITY;
    if (p.k == 0 || workspace == NULL) return GF_FAILED;
    gf_arena memory_left;
    gf_warm_memory *kept = lay_out_workspace(workspace, structure, p.k, &p, &memory_left);
    uint64_t last = options->warm ? kept->fingerprint : 0;
    kept->fingerprint = 0;
    if (!sort_structure(&p) || !scale_problem(&p)) {
        clear_answer(&p, answer);
        for (int c = 0; c < p.k; c++) answer->f[c] = NAN;
        return GF_FAILED;
    }
    if (find_contradiction(&p, answer)) return GF_INFEASIBLE;
    form_groups(&p, &memory_left);
    pack(&p);
    gf_iteration a;
    initialise(&a, &p, options->tolerance);
    if (last == p.fingerprint)
        start_warm(&a, kept->y, kept->tau);
    else
        start_cold(&a);
    int status = run_iteration(&a, options->max_iterations, &answer->iterations);
    if (status > GF_OPTIMAL && status != GF_INFEASIBLE && prove_outside_range(&a)) status = GF_INFEASIBLE;
    answer->primal = a.primal;
    answer->dual = a.dual;
    answer->gap = a.gap;
    if (status == GF_INFEASIBLE) return unpack_proof(&p, a.y, answer) ? status : GF_FAILED;
    if (!unpack(&p, a.y, a.tau, answer)) return GF_FAILED;
    if (status == GF_OPTIMAL) {
        kept->fingerprint = p.fingerprint;
        kept->tau = a.tau;
        memcpy(kept->y, a.y, sizeof a.y);
    }
    return status;
}
