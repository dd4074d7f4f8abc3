/* The homogeneous self-dual interior-point method behind structured.h. The cones' algebra is in structured_cone.h, scaling and
 * packing in structured_pack.h, the way back in structured_unpack.h.
 *
 * With everything scaled, the problem reads: minimise ½ xᵀHx + cᵀx subject to G x = w, E x = e, A x + s = h, s in K, where K is a
 * product of half-lines and second-order cones (for these, A = −1 and h = 0). The embedding looks for x, y, v, s, z and τ, κ ≥ 0
 * with
 *
 *     rx = H x + Gᵀy + Eᵀv + Aᵀz + c τ = 0        ry = G x − w τ = 0      re = E x − e τ = 0     rz = A x + s − h τ = 0
 *     κ + xᵀHx/τ + cᵀx + wᵀy + eᵀv + hᵀz = 0      s ∘ z = 0               τ κ = 0
 *
 * A solution with τ > 0 is optimal after division by τ; one with wᵀy + eᵀv + hᵀz < 0 and rx = 0 but for H x + c τ proves that no x
 * exists. Each iteration is Mehrotra's: a step towards σ = 0, then one with its second-order terms.
 *
 * A Newton step solves K (dx, dy, dv) = right side, K = [M Gᵀ Eᵀ; G 0 0; E 0 0], M = H + AᵀW⁻²A, twice: for the residuals and for
 * τ's column (−c, w, e, h). M is block diagonal, one Cholesky factor L a finger; V = L⁻¹Gᵀ leaves S = Σ VᵀV, 6 x 6. Four things
 * make it accurate to 1e-9, where the textbook's formulas are not:
 *
 *  - cones are scaled in light-cone coordinates (structured_cone.h);
 *  - τ's column is solved as a difference to the present iterate, (xt, …) = τ (column's solution) − (x, …), so that its right
 *    side is small and Δτ = τ num/den has a denominator without cancellation, a sum of squares;
 *  - W⁻²s is z: it is never computed from s;
 *  - late steps are refined against the unregularised equations.
 */
#include "structured.h"

#include "structured_unpack.h"

static const double PROXIMAL = 1e-8;     /* added to M's diagonal: a step's damping, no change of the problem */
static const double ROUNDING = 1e-16;    /* of M's trace, likewise: keeps the factor sound where H leaves directions flat */
static const double SCHUR_RIDGE = 1e-13; /* of S's trace: lets rank G < 6 pass */
static const double FIXED_RIDGE = 1e-13; /* of a fixed row's square: lets rows that repeat each other pass */
static const double BACK_OFF = 0.99;     /* of the way to the boundary */
static const double REFINE_BELOW = 1e-4; /* mean complementarity */
static const double WARM_FLOOR = 1e-3;   /* least slack and multiplier of a warm start */
static const double COST_FLOOR = 1e-4;   /* costs below it count as this large */
static const double LOOSE = 1e3;         /* times the tolerance: still worth returning, as inaccurate */
static const double REFINED = 1e-3;      /* times the tolerance: what a step may leave of the equations */
enum { REFINEMENTS = 5, PATIENCE = 4, SHORT_STEPS = 3 };

/* The scalars of the iteration. */
typedef struct {
    const plan *p;
    double tolerance;
    double w[WRENCH], w_top, c_top, degree;
    double tau, kappa, y[WRENCH];
    double ry[WRENCH];              /* residual of G x = w τ */
    double sz, mu;                  /* sᵀz and mean complementarity */
    double primal, dual, gap;
    double constant;                /* ½ tau_uᵀ W tau_u, the cost that no force changes */
    double proof, slip;             /* −(wᵀy + eᵀv + hᵀz), and what the residuals may take from it */
    double best, best_y[WRENCH], best_tau;
    double S[SCHUR], p_step[WRENCH], p_tau[WRENCH];
    double dtau, dkappa, dy[WRENCH], yt[WRENCH];
} state;

/* The shape of a group: constants for the compiler where the group holds single point contacts. */
typedef struct {
    int d, rows, cones, fixed, sides;
    const int *at, *size;
} shape;

INLINE shape shape_of(const group *g, int point)
{
    static const int at[1] = {0}, size[1] = {3};
    if (point) return (shape){3, g->rows, 1, g->fixed, 2 * g->rows, at, size};
    return (shape){g->d, g->rows, g->cones, g->fixed, 2 * g->rows, g->cone_at, g->cone_size};
}

/* Calls work(group, point, …) on every group, once compiled for point contacts and once for all shapes. */
#define EACH_GROUP(p, work, ...)                                               \
    for (group *g = (p)->groups; g < (p)->groups + (p)->group_count; g++) {    \
        if (g->point)                                                          \
            work(g, 1, __VA_ARGS__);                                           \
        else                                                                   \
            work(g, 0, __VA_ARGS__);                                           \
    }

INLINE lane dot(int d, const lane *a, const lane *b)
{
    lane sum = a[0] * b[0];
    for (int i = 1; i < d; i++) sum += a[i] * b[i];
    return sum;
}

/* ---- residuals ---------------------------------------------------------------------------------------------------------- */

typedef struct {
    lane Gx[WRENCH], xHx, cx, limits, sz, primal, dual, slip;
} sums;

INLINE void residuals(group *g, int point, const state *a, sums *sum)
{
    const shape k = shape_of(g, point);
    const lane live = *g->live;
    const double tau = a->tau;
    for (int i = 0; i < k.d; i++) g->pull[i] = lane_of(0.0), g->rx[i] = g->ridge[i] * g->x[i];
    for (int r = 0; r < WRENCH; r++) sum->Gx[r] += live * dot(k.d, g->G + r * k.d, g->x);
    for (int j = 0; j < k.rows; j++) {
        const lane *row = g->A + j * k.d;
        lane along = dot(k.d, row, g->x), bend = g->weight[j] * along, net = g->z[j] - g->z[k.rows + j];
        for (int i = 0; i < k.d; i++) {
            g->rx[i] += bend * row[i];
            g->pull[i] += net * row[i];
        }
        for (int side = 0; side < 2; side++) {
            int o = side * k.rows + j;
            lane r = lane_where(g->has[o], (side ? -along : along) + g->s[o] - g->h[o] * tau);
            g->rz[o] = r;
            sum->primal = lane_max(sum->primal, lane_abs(r));
            sum->limits += live * g->h[o] * g->z[o];
            sum->sz += live * g->s[o] * g->z[o];
        }
    }
    for (int q = 0, o = k.sides; q < k.cones; o += k.size[q++]) {
        for (int i = 0; i < k.size[q]; i++) {
            lane r = g->s[o + i] - g->x[k.at[q] + i];
            g->rz[o + i] = r;
            g->pull[k.at[q] + i] -= g->z[o + i];
            sum->primal = lane_max(sum->primal, lane_abs(r));
            sum->sz += live * g->s[o + i] * g->z[o + i];
        }
    }
    sum->xHx += live * dot(k.d, g->rx, g->x);
    for (int i = 0; i < k.d; i++) {
        lane force = g->pull[i];
        for (int r = 0; r < WRENCH; r++) force += g->G[r * k.d + i] * a->y[r];
        for (int q = 0; q < k.fixed; q++) force += g->E[q * k.d + i] * g->v[q];
        sum->cx += live * g->c[i] * g->x[i];
        sum->slip += live * lane_abs(force) * g->reach[i];
        g->rx[i] += g->c[i] * tau + force;
        sum->dual = lane_max(sum->dual, lane_abs(g->rx[i]));
    }
    for (int q = 0; q < k.fixed; q++) {
        g->re[q] = dot(k.d, g->E + q * k.d, g->x) - g->e[q] * tau;
        sum->primal = lane_max(sum->primal, lane_abs(g->re[q]));
        sum->limits += live * g->e[q] * g->v[q];
    }
}

static void measure_iterate(state *a)
{
    sums sum = {.xHx = lane_of(0.0)};
    EACH_GROUP(a->p, residuals, a, &sum);
    double wy = 0.0, limits = lane_sum(sum.limits), xHx = lane_sum(sum.xHx), cx = lane_sum(sum.cx), inverse = 1.0 / a->tau;
    a->primal = lane_top(sum.primal);
    for (int r = 0; r < WRENCH; r++) {
        a->ry[r] = lane_sum(sum.Gx[r]) - a->w[r] * a->tau;
        a->primal = larger(a->primal, fabs(a->ry[r]));
        wy += a->w[r] * a->y[r];
    }
    double low = -0.5 * xHx * inverse * inverse - (wy + limits) * inverse;
    a->sz = lane_sum(sum.sz);
    a->mu = (a->sz + a->tau * a->kappa) / a->degree;
    double high = 0.5 * xHx * inverse * inverse + cx * inverse;
    a->gap = fabs(high - low) / (COST_FLOOR + fmin(fabs(high + a->constant), fabs(low + a->constant)));
    a->primal *= inverse / (1.0 + a->w_top);
    a->dual = lane_top(sum.dual) * inverse / (1.0 + a->c_top);
    a->proof = -(wy + limits);
    a->slip = lane_sum(sum.slip);
}

/* ---- Newton's matrix ---------------------------------------------------------------------------------------------------- */

/* Packed Cholesky factor in place, diagonal inverted; pivots lost in rounding are lifted. */
INLINE void factor(int d, lane *M)
{
    for (int i = 0; i < d; i++) {
        lane *row = M + i * (i + 1) / 2;
        for (int j = 0; j <= i; j++) {
            const lane *other = M + j * (j + 1) / 2;
            lane sum = row[j];
            for (int q = 0; q < j; q++) sum -= row[q] * other[q];
            row[j] = j < i ? sum * other[j] : 1.0 / lane_sqrt(lane_max(sum, 1e-16 * row[j]));
        }
    }
}

INLINE void solve_lower(int d, const lane *L, lane *x)
{
    for (int i = 0; i < d; i++) {
        const lane *row = L + i * (i + 1) / 2;
        lane sum = x[i];
        for (int j = 0; j < i; j++) sum -= row[j] * x[j];
        x[i] = sum * row[i];
    }
}

INLINE void solve_upper(int d, const lane *L, lane *x)
{
    for (int i = d - 1; i >= 0; i--) {
        lane sum = x[i];
        for (int j = i + 1; j < d; j++) sum -= L[j * (j + 1) / 2 + i] * x[j];
        x[i] = sum * L[i * (i + 1) / 2 + i];
    }
}

/* L⁻¹Eᵀ = Q R by Gram and Schmidt, twice; R packed by columns, diagonal inverted. A row that repeats others gets a ridge. */
INLINE void factor_fixed(group *g, shape k)
{
    for (int q = 0; q < k.fixed; q++) {
        lane *column = g->Q + q * k.d, *R = g->R + q * (q + 1) / 2;
        for (int i = 0; i < k.d; i++) column[i] = g->E[q * k.d + i];
        solve_lower(k.d, g->M, column);
        lane square = dot(k.d, column, column);
        for (int o = 0; o < q; o++) R[o] = lane_of(0.0);
        for (int pass = 0; pass < 2; pass++) {
            for (int o = 0; o < q; o++) {
                lane share = dot(k.d, g->Q + o * k.d, column);
                R[o] += share;
                for (int i = 0; i < k.d; i++) column[i] -= share * g->Q[o * k.d + i];
            }
        }
        R[q] = 1.0 / lane_sqrt(dot(k.d, column, column) + FIXED_RIDGE * square);
        for (int i = 0; i < k.d; i++) column[i] *= R[q];
    }
}

/* NT scaling, M and its factor, V, and the finger's part of S. V is kept without what the fixed rows take of it, QV is that part. */
INLINE void form_matrix(group *g, int point, lane *S)
{
    const shape k = shape_of(g, point);
    for (int i = 0; i < k.d * (k.d + 1) / 2; i++) g->M[i] = lane_of(0.0);
    for (int i = 0; i < k.d; i++) g->M[i * (i + 3) / 2] = g->ridge[i] + PROXIMAL;
    for (int o = 0; o < k.sides; o++) {
        g->s_inv[o] = 1.0 / g->s[o];
        g->z_inv[o] = lane_where(g->has[o], 1.0 / g->z[o]);
        g->zs[o] = g->z[o] * g->s_inv[o];
    }
    for (int j = 0; j < k.rows; j++) {
        const lane *row = g->A + j * k.d;
        lane weight = g->weight[j] + g->zs[j] + g->zs[k.rows + j];
        for (int i = 0; i < k.d; i++) {
            lane scaled = weight * row[i];
            for (int q = 0; q <= i; q++) g->M[i * (i + 1) / 2 + q] += scaled * row[q];
        }
    }
    for (int q = 0, o = k.sides; q < k.cones; o += k.size[q++]) {
        cone_scale(k.size[q], g->s + o, g->z + o, g->scaling + q * SCALING);
        cone_weigh_into(k.size[q], g->scaling + q * SCALING, k.at[q], g->M);
    }
    lane trace = lane_of(0.0);
    for (int i = 0; i < k.d; i++) trace += g->M[i * (i + 3) / 2];
    for (int i = 0; i < k.d; i++) g->M[i * (i + 3) / 2] += ROUNDING * trace;
    factor(k.d, g->M);
    factor_fixed(g, k);
    for (int r = 0; r < WRENCH; r++) {
        lane *V = g->V + r * k.d;
        for (int i = 0; i < k.d; i++) V[i] = g->G[r * k.d + i];
        solve_lower(k.d, g->M, V);
        for (int q = 0; q < k.fixed; q++) {
            lane share = dot(k.d, g->Q + q * k.d, V);
            g->QV[r * k.fixed + q] = share;
            for (int i = 0; i < k.d; i++) V[i] -= share * g->Q[q * k.d + i];
        }
        for (int t = 0; t <= r; t++) S[r * (r + 1) / 2 + t] += *g->live * dot(k.d, V, g->V + t * k.d);
    }
}

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

/* ---- one solve with the matrix ------------------------------------------------------------------------------------------ */

/* Takes a right side (b, be) of a finger half way, in place, and adds its part Vᵀ… to the right side of S. */
INLINE void reduce(const group *g, shape k, lane *b, lane *be, lane *p)
{
    solve_lower(k.d, g->M, b);
    for (int q = 0; q < k.fixed; q++) {
        const lane *R = g->R + q * (q + 1) / 2;
        for (int o = 0; o < q; o++) be[q] -= R[o] * be[o];
        be[q] *= R[q];
    }
    for (int r = 0; r < WRENCH && k.fixed > 0; r++) p[r] += *g->live * dot(k.fixed, g->QV + r * k.fixed, be);
    for (int q = 0; q < k.fixed; q++) {
        lane excess = dot(k.d, g->Q + q * k.d, b) - be[q];
        for (int i = 0; i < k.d; i++) b[i] -= excess * g->Q[q * k.d + i];
        be[q] = excess; /* R dv, but for what dy does to it */
    }
    for (int r = 0; r < WRENCH; r++) p[r] += *g->live * dot(k.d, g->V + r * k.d, b);
}

/* The finger's dx and dv once dy is known. */
INLINE void expand(const group *g, shape k, const lane *b, const lane *be, const double *dy, lane *dx, lane *dv)
{
    for (int i = 0; i < k.d; i++) {
        dx[i] = b[i];
        for (int r = 0; r < WRENCH; r++) dx[i] -= g->V[r * k.d + i] * dy[r];
    }
    solve_upper(k.d, g->M, dx);
    for (int q = k.fixed - 1; q >= 0; q--) {
        dv[q] = be[q];
        for (int r = 0; r < WRENCH; r++) dv[q] -= g->QV[r * k.fixed + q] * dy[r];
        for (int o = q + 1; o < k.fixed; o++) dv[q] -= g->R[o * (o + 1) / 2 + q] * dv[o];
        dv[q] *= g->R[q * (q + 1) / 2 + q];
    }
}

/* ---- right sides -------------------------------------------------------------------------------------------------------- */

/* The step's right side: residuals times η, complementarity as `ask` says. */
INLINE void step_right_side(group *g, shape k, double eta, const lane *ask)
{
    for (int i = 0; i < k.d; i++) g->b[i] = -eta * g->rx[i];
    for (int q = 0; q < k.fixed; q++) g->be[q] = -eta * g->re[q];
    for (int j = 0; j < k.rows; j++) {
        int up = j, low = k.rows + j;
        lane net = (ask[up] - eta * g->zs[up] * g->rz[up]) - (ask[low] - eta * g->zs[low] * g->rz[low]);
        for (int i = 0; i < k.d; i++) g->b[i] += net * g->A[j * k.d + i];
    }
    for (int q = 0, o = k.sides; q < k.cones; o += k.size[q++]) {
        lane weighed[MAX_CONE];
        cone_weigh(k.size[q], g->scaling + q * SCALING, g->rz + o, weighed);
        for (int i = 0; i < k.size[q]; i++) g->b[k.at[q] + i] += eta * weighed[i] - ask[o + i];
    }
}

/* First pass: ask for s ∘ z = 0, which is ask = z; and τ's column, whose right side differs by Aᵀz. */
INLINE void first_right_sides(group *g, int point, lane *p_step, lane *p_tau)
{
    const shape k = shape_of(g, point);
    step_right_side(g, k, 1.0, g->z);
    for (int i = 0; i < k.d; i++) g->t[i] = g->b[i] + g->pull[i];
    for (int q = 0; q < k.fixed; q++) g->te[q] = g->be[q];
    reduce(g, k, g->b, g->be, p_step);
    reduce(g, k, g->t, g->te, p_tau);
}

/* Second pass: s ∘ z = σμ with the first step's second-order terms, whose sum over all slacks is added to `excess`. */
INLINE void second_right_side(group *g, int point, double eta, double target, lane *p_step, lane *excess)
{
    const shape k = shape_of(g, point);
    lane sum = lane_of(0.0);
    for (int o = 0; o < k.sides; o++) {
        lane beyond = lane_where(g->has[o], g->ds[o] * g->dz[o] - target);
        sum += beyond;
        g->ask[o] = g->z[o] + beyond * g->s_inv[o];
    }
    for (int q = 0, o = k.sides; q < k.cones; o += k.size[q++])
        sum += cone_correct(k.size[q], g->scaling + q * SCALING, g->z + o, g->ds + o, g->dz + o, target, g->ask + o);
    *excess += *g->live * sum;
    step_right_side(g, k, eta, g->ask);
    reduce(g, k, g->b, g->be, p_step);
}

/* ---- steps -------------------------------------------------------------------------------------------------------------- */

/* dx, dv, dz, ds before τ moves, and their part of Δτ's numerator. */
INLINE void step_without_tau(group *g, int point, double eta, int first, const double *dy, lane *numerator)
{
    const shape k = shape_of(g, point);
    const lane *ask = first ? g->z : g->ask;
    expand(g, k, g->b, g->be, dy, g->dx, g->dv);
    lane sum = dot(k.d, g->rx, g->dx);
    for (int q = 0; q < k.fixed; q++) sum -= g->re[q] * g->dv[q];
    for (int j = 0; j < k.rows; j++) {
        lane along = dot(k.d, g->A + j * k.d, g->dx);
        for (int side = 0; side < 2; side++) {
            int o = side * k.rows + j;
            lane e = lane_where(g->has[o], (side ? -along : along) + eta * g->rz[o]);
            g->ds[o] = -e;
            g->dz[o] = g->zs[o] * e - ask[o];
            sum -= g->rz[o] * g->dz[o];
        }
    }
    for (int q = 0, o = k.sides; q < k.cones; o += k.size[q++]) {
        lane e[MAX_CONE];
        for (int i = 0; i < k.size[q]; i++) {
            e[i] = eta * g->rz[o + i] - g->dx[k.at[q] + i];
            g->ds[o + i] = -e[i];
        }
        cone_weigh(k.size[q], g->scaling + q * SCALING, e, g->dz + o);
        for (int i = 0; i < k.size[q]; i++) {
            g->dz[o + i] -= ask[o + i];
            sum -= g->rz[o + i] * g->dz[o + i];
        }
    }
    *numerator += *g->live * sum;
}

/* τ times the solution for τ's column, and Δτ's denominator. */
INLINE void tau_column(group *g, int point, const double *yt, lane *denominator)
{
    const shape k = shape_of(g, point);
    expand(g, k, g->t, g->te, yt, g->xt, g->vt);
    lane sum = lane_of(0.0);
    for (int i = 0; i < k.d; i++) sum += g->ridge[i] * g->xt[i] * g->xt[i];
    for (int j = 0; j < k.rows; j++) {
        lane along = dot(k.d, g->A + j * k.d, g->xt);
        sum += g->weight[j] * along * along;
        for (int side = 0; side < 2; side++) {
            int o = side * k.rows + j;
            lane e = lane_where(g->has[o], (side ? -along : along) + g->rz[o]);
            g->zt[o] = g->zs[o] * e - g->z[o];
            g->st[o] = lane_where(g->has[o], e - g->s[o]);
            sum += g->st[o] * g->zt[o];
        }
    }
    for (int q = 0, o = k.sides; q < k.cones; o += k.size[q++]) {
        lane e[MAX_CONE];
        for (int i = 0; i < k.size[q]; i++) {
            e[i] = g->rz[o + i] - g->xt[k.at[q] + i];
            g->st[o + i] = e[i] - g->s[o + i];
        }
        cone_weigh(k.size[q], g->scaling + q * SCALING, e, g->zt + o);
        for (int i = 0; i < k.size[q]; i++) {
            g->zt[o + i] -= g->z[o + i];
            sum += g->st[o + i] * g->zt[o + i];
        }
    }
    for (int i = 0; i < k.d; i++) g->xt[i] += g->x[i];
    for (int q = 0; q < k.fixed; q++) g->vt[q] += g->v[q];
    *denominator += *g->live * sum;
}

/* Adds Δτ/τ times τ's column to the step. */
INLINE void add_tau(group *g, int point, double share)
{
    const shape k = shape_of(g, point);
    for (int i = 0; i < k.d; i++) g->dx[i] += share * g->xt[i];
    for (int q = 0; q < k.fixed; q++) g->dv[q] += share * g->vt[q];
    for (int o = 0; o < g->slacks; o++) {
        g->dz[o] += share * g->zt[o];
        g->ds[o] -= share * g->st[o];
    }
}

/* What the step leaves of the unregularised equations, its largest entry in `rest`: the right side of a refinement. */
INLINE void refine_right_side(group *g, int point, const state *a, double eta, lane *p_step, lane *Gx, lane *rest)
{
    const shape k = shape_of(g, point);
    for (int i = 0; i < k.d; i++) {
        lane sum = -eta * g->rx[i] - g->c[i] * a->dtau - g->ridge[i] * g->dx[i];
        for (int r = 0; r < WRENCH; r++) sum -= g->G[r * k.d + i] * a->dy[r];
        for (int q = 0; q < k.fixed; q++) sum -= g->E[q * k.d + i] * g->dv[q];
        g->b[i] = sum;
    }
    for (int r = 0; r < WRENCH; r++) Gx[r] += *g->live * dot(k.d, g->G + r * k.d, g->dx);
    for (int q = 0; q < k.fixed; q++) g->be[q] = g->e[q] * a->dtau - eta * g->re[q] - dot(k.d, g->E + q * k.d, g->dx);
    for (int j = 0; j < k.rows; j++) {
        const lane *row = g->A + j * k.d;
        lane pull = g->weight[j] * dot(k.d, row, g->dx) + g->dz[j] - g->dz[k.rows + j];
        for (int i = 0; i < k.d; i++) g->b[i] -= pull * row[i];
    }
    for (int q = 0, o = k.sides; q < k.cones; o += k.size[q++])
        for (int i = 0; i < k.size[q]; i++) g->b[k.at[q] + i] += g->dz[o + i];
    for (int i = 0; i < k.d; i++) *rest = lane_max(*rest, lane_abs(g->b[i]));
    for (int q = 0; q < k.fixed; q++) *rest = lane_max(*rest, lane_abs(g->be[q]));
    reduce(g, k, g->b, g->be, p_step);
}

/* Adds the refinement. xt and vt serve as scratch: τ's column is in the step already. */
INLINE void refine_step(group *g, int point, const double *dy)
{
    const shape k = shape_of(g, point);
    lane *x = g->xt;
    expand(g, k, g->b, g->be, dy, x, g->vt);
    for (int i = 0; i < k.d; i++) g->dx[i] += x[i];
    for (int q = 0; q < k.fixed; q++) g->dv[q] += g->vt[q];
    for (int j = 0; j < k.rows; j++) {
        lane along = dot(k.d, g->A + j * k.d, x);
        int up = j, low = k.rows + j;
        g->ds[up] -= lane_where(g->has[up], along);
        g->ds[low] += lane_where(g->has[low], along);
        g->dz[up] += g->zs[up] * along;
        g->dz[low] -= g->zs[low] * along;
    }
    for (int q = 0, o = k.sides; q < k.cones; o += k.size[q++]) {
        lane weighed[MAX_CONE];
        cone_weigh(k.size[q], g->scaling + q * SCALING, x + k.at[q], weighed);
        for (int i = 0; i < k.size[q]; i++) {
            g->ds[o + i] += x[k.at[q] + i];
            g->dz[o + i] -= weighed[i];
        }
    }
}

/* The inverse of the longest step that keeps s and z inside. */
INLINE void step_rate(const group *g, int point, lane *rate)
{
    const shape k = shape_of(g, point);
    for (int o = 0; o < k.sides; o++) *rate = lane_max(*rate, lane_max(-g->dz[o] * g->z_inv[o], -g->ds[o] * g->s_inv[o]));
    for (int q = 0, o = k.sides; q < k.cones; o += k.size[q++]) {
        *rate = lane_max(*rate, cone_rate(k.size[q], g->s + o, g->ds + o));
        *rate = lane_max(*rate, cone_rate(k.size[q], g->z + o, g->dz + o));
    }
}

INLINE void advance(group *g, int point, double step)
{
    const shape k = shape_of(g, point);
    for (int i = 0; i < k.d; i++) g->x[i] += step * g->dx[i];
    for (int q = 0; q < k.fixed; q++) g->v[q] += step * g->dv[q];
    for (int o = 0; o < g->slacks; o++) {
        g->s[o] += step * g->ds[o];
        g->z[o] += step * g->dz[o];
    }
}

/* ---- the iteration ------------------------------------------------------------------------------------------------------ */

/* dy of the step: S dy = p + η ry. */
static void schur_step(const state *a, const lane *p, double eta, double *dy)
{
    for (int r = 0; r < WRENCH; r++) dy[r] = lane_sum(p[r]) + eta * a->ry[r];
    solve_schur(a->S, dy);
}

/* Δτ and Δκ from the step's numerator; Δτ/τ. */
static double move_tau(state *a, double numerator, double denominator, double complement)
{
    double share = numerator / denominator;
    a->dtau = share * a->tau;
    a->dkappa = -(complement + a->kappa * a->dtau) / a->tau;
    return share;
}

static double longest_step(const state *a)
{
    lane rates = lane_of(0.0);
    EACH_GROUP(a->p, step_rate, &rates);
    double rate = larger(lane_top(rates), larger(-a->dtau / a->tau, -a->dkappa / a->kappa));
    return rate > 1.0 ? 1.0 / rate : 1.0;
}

INLINE double ry_dot(const state *a, const double *dy)
{
    double sum = 0.0;
    for (int r = 0; r < WRENCH; r++) sum += a->ry[r] * dy[r];
    return sum;
}

/* Refines the step until what it leaves is small or shrinks no more. */
INLINE void refine(state *a, double eta)
{
    double last = INFINITY;
    for (int pass = 0; pass < REFINEMENTS; pass++) {
        lane p[WRENCH], Gx[WRENCH], top = lane_of(0.0);
        double more[WRENCH];
        for (int r = 0; r < WRENCH; r++) p[r] = Gx[r] = lane_of(0.0);
        EACH_GROUP(a->p, refine_right_side, a, eta, p, Gx, &top);
        double rest = lane_top(top);
        for (int r = 0; r < WRENCH; r++) {
            double missing = a->w[r] * a->dtau - eta * a->ry[r] - lane_sum(Gx[r]);
            more[r] = lane_sum(p[r]) - missing;
            rest = larger(rest, fabs(missing));
        }
        if (rest <= REFINED * a->tolerance * a->tau || !(rest < 0.5 * last)) return;
        last = rest;
        solve_schur(a->S, more);
        EACH_GROUP(a->p, refine_step, more);
        for (int r = 0; r < WRENCH; r++) a->dy[r] += more[r];
    }
}

/* Makes the step; returns how far it may go. */
INLINE double make_step(state *a)
{
    lane S[SCHUR], p[WRENCH], p_tau[WRENCH], numerator = lane_of(0.0), denominator = lane_of(0.0), excess = lane_of(0.0);
    for (int i = 0; i < SCHUR; i++) S[i] = lane_of(0.0);
    for (int r = 0; r < WRENCH; r++) p[r] = p_tau[r] = lane_of(0.0);
    EACH_GROUP(a->p, form_matrix, S);
    for (int i = 0; i < SCHUR; i++) a->S[i] = lane_sum(S[i]);
    factor_schur(a->S);

    EACH_GROUP(a->p, first_right_sides, p, p_tau);
    schur_step(a, p, 1.0, a->dy);
    schur_step(a, p_tau, 1.0, a->yt);
    EACH_GROUP(a->p, step_without_tau, 1.0, 1, a->dy, &numerator);
    EACH_GROUP(a->p, tau_column, a->yt, &denominator);
    for (int r = 0; r < WRENCH; r++) a->yt[r] += a->y[r];
    double tk = a->tau * a->kappa, below = lane_sum(denominator) + tk;
    double share = move_tau(a, lane_sum(numerator) - ry_dot(a, a->dy), below, tk);
    EACH_GROUP(a->p, add_tau, share);
    double reach = longest_step(a);

    double sigma = (1.0 - reach) * (1.0 - reach) * (1.0 - reach), eta = 1.0 - sigma, target = sigma * a->mu;
    double complement = tk + a->dtau * a->dkappa - target;
    for (int r = 0; r < WRENCH; r++) p[r] = lane_of(0.0);
    EACH_GROUP(a->p, second_right_side, eta, target, p, &excess);
    schur_step(a, p, eta, a->dy);
    numerator = lane_of(0.0);
    EACH_GROUP(a->p, step_without_tau, eta, 0, a->dy, &numerator);
    double above = lane_sum(numerator) - ry_dot(a, a->dy) + eta * (tk + a->sz) - complement - (a->sz + lane_sum(excess));
    share = move_tau(a, above, below, complement);
    EACH_GROUP(a->p, add_tau, share);
    for (int r = 0; r < WRENCH; r++) a->dy[r] += share * a->yt[r];

    if (a->mu < REFINE_BELOW) refine(a, eta);
    return longest_step(a);
}

/* ---- start, best iterate, verdict --------------------------------------------------------------------------------------- */

/* s = z = 1 in every cone, all else zero. */
static void start_cold(state *a)
{
    for (group *g = a->p->groups; g < a->p->groups + a->p->group_count; g++) {
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

static void lift(int n, lane *v)
{
    lane square = v[1] * v[1];
    for (int i = 2; i < n; i++) square += v[i] * v[i];
    v[0] = lane_max(v[0], lane_sqrt(square) + WARM_FLOOR);
}

/* The last answer, moved inside. */
static void start_warm(state *a, const double *last_y, double last_tau)
{
    double inverse = 1.0 / last_tau;
    for (group *g = a->p->groups; g < a->p->groups + a->p->group_count; g++) {
        for (int i = 0; i < g->d; i++) g->x[i] *= inverse;
        for (int q = 0; q < g->fixed; q++) g->v[q] *= inverse;
        for (int o = 0; o < 2 * g->rows; o++) {
            g->s[o] = lane_pick(g->has[o], lane_max(g->s[o] * inverse, lane_of(WARM_FLOOR)), lane_of(1.0));
            g->z[o] = lane_where(g->has[o], lane_max(g->z[o] * inverse, lane_of(WARM_FLOOR)));
        }
        for (int o = 2 * g->rows; o < g->slacks; o++) g->s[o] *= inverse, g->z[o] *= inverse;
        for (int q = 0, o = 2 * g->rows; q < g->cones; o += g->cone_size[q++]) {
            lift(g->cone_size[q], g->s + o);
            lift(g->cone_size[q], g->z + o);
        }
    }
    for (int r = 0; r < WRENCH; r++) a->y[r] = last_y[r] * inverse;
    a->tau = 1.0;
    a->kappa = WARM_FLOOR;
}

static void keep_best(state *a, double error)
{
    a->best = error;
    if (!(error < LOOSE * a->tolerance)) return;
    for (group *g = a->p->groups; g < a->p->groups + a->p->group_count; g++) {
        memcpy(g->best_x, g->x, (size_t)g->d * sizeof(lane));
        memcpy(g->best_z, g->z, (size_t)g->slacks * sizeof(lane));
        memcpy(g->best_v, g->v, (size_t)g->fixed * sizeof(lane));
    }
    memcpy(a->best_y, a->y, sizeof a->y);
    a->best_tau = a->tau;
}

static int return_best(state *a)
{
    if (!(a->best < LOOSE * a->tolerance)) return GRASPFORCE_FAILED;
    for (group *g = a->p->groups; g < a->p->groups + a->p->group_count; g++) {
        memcpy(g->x, g->best_x, (size_t)g->d * sizeof(lane));
        memcpy(g->z, g->best_z, (size_t)g->slacks * sizeof(lane));
        memcpy(g->v, g->best_v, (size_t)g->fixed * sizeof(lane));
    }
    memcpy(a->y, a->best_y, sizeof a->y);
    a->tau = a->best_tau;
    return GRASPFORCE_INACCURATE;
}

/* Iterates to a verdict. */
INLINE int iterate(state *a, int max_iterations, int *iterations)
{
    int waited = 0, short_steps = 0;
    a->best = INFINITY;
    for (*iterations = 0;; (*iterations)++) {
        measure_iterate(a);
        double error = larger(a->primal, larger(a->dual, a->gap));
        if (!(error < INFINITY) || !(a->mu > 0.0) || !(a->tau > 0.0)) return return_best(a);
        if (error <= a->tolerance) return GRASPFORCE_OPTIMAL;
        if (a->proof > 0.0 && a->proof > a->slip) return GRASPFORCE_INFEASIBLE;
        waited = error < a->best ? 0 : waited + 1;
        if (waited == 0) keep_best(a, error);
        if (*iterations == max_iterations || (waited >= PATIENCE && a->best < LOOSE * a->tolerance)) return return_best(a);
        double step = BACK_OFF * make_step(a);
        short_steps += step < 1e-7;
        if (!(step > 0.0) || short_steps >= SHORT_STEPS) return return_best(a);
        EACH_GROUP(a->p, advance, step);
        for (int r = 0; r < WRENCH; r++) a->y[r] += step * a->dy[r];
        a->tau += step * a->dtau;
        a->kappa += step * a->dkappa;
    }
}

/* Where no verdict was reached: has w a part that no contact force can supply? With r = w's part outside the range of G, y = r
 * proves it. r is what repeated w ← δ (G Gᵀ + δ)⁻¹ w leaves. Returns 1 with the proof as the iterate. */
static int outside_range(state *a)
{
    double gram[SCHUR] = {0.0}, rest[WRENCH];
    for (const group *g = a->p->groups; g < a->p->groups + a->p->group_count; g++)
        for (int r = 0; r < WRENCH; r++)
            for (int t = 0; t <= r; t++) gram[r * (r + 1) / 2 + t] += lane_sum(*g->live * dot(g->d, g->G + r * g->d, g->G + t * g->d));
    double ridge = 1e-10 * (gram[0] + gram[2] + gram[5] + gram[9] + gram[14] + gram[20]);
    for (int r = 0; r < WRENCH; r++) gram[r * (r + 3) / 2] += ridge;
    factor_schur(gram);
    memcpy(rest, a->w, sizeof rest);
    for (int pass = 0; pass < 3; pass++) {
        for (int r = 0; r < WRENCH; r++) rest[r] *= ridge;
        solve_schur(gram, rest);
    }
    double proof = 0.0, slip = 0.0;
    for (int r = 0; r < WRENCH; r++) proof += rest[r] * a->w[r];
    for (const group *g = a->p->groups; g < a->p->groups + a->p->group_count; g++)
        for (int i = 0; i < g->d; i++) {
            lane force = lane_of(0.0);
            for (int r = 0; r < WRENCH; r++) force += g->G[r * g->d + i] * rest[r];
            slip += lane_sum(*g->live * lane_abs(force) * g->reach[i]);
        }
    if (!(proof > slip)) return 0;
    for (group *g = a->p->groups; g < a->p->groups + a->p->group_count; g++) {
        memset(g->z, 0, (size_t)g->slacks * sizeof(lane));
        memset(g->v, 0, (size_t)g->fixed * sizeof(lane));
    }
    for (int r = 0; r < WRENCH; r++) a->y[r] = -rest[r];
    return 1;
}

/* What a workspace remembers between calls. */
typedef struct {
    uint64_t fingerprint; /* of the last answer's groups, zero if there is none */
    double y[WRENCH], tau;
} memory;

static void start(state *a, const plan *p, double tolerance)
{
    *a = (state){.p = p, .tolerance = tolerance, .degree = 1.0};
    for (int r = 0; r < WRENCH; r++) {
        a->w[r] = p->data->w[r] / (r < 3 ? p->force : p->force * p->length);
        a->w_top = larger(a->w_top, fabs(a->w[r]));
    }
    for (int j = 0; j < p->s->joints; j++) a->constant += 0.5 * p->data->weight[j] * p->data->tau_u[j] * p->data->tau_u[j] / p->cost;
    for (group *g = p->groups; g < p->groups + p->group_count; g++) {
        lane count = lane_of(g->cones), top = lane_of(0.0);
        for (int o = 0; o < 2 * g->rows; o++) count += lane_where(g->has[o], lane_of(1.0));
        for (int i = 0; i < g->d; i++) top = lane_max(top, lane_abs(g->c[i]));
        a->degree += lane_sum(count * *g->live);
        a->c_top = larger(a->c_top, lane_top(top));
    }
}

#if defined(__x86_64__) && defined(__GNUC__) && defined(__gnu_linux__) && LANES > 1 && !defined(__AVX2__)
#define FOR_THIS_MACHINE __attribute__((flatten, target_clones("arch=x86-64-v3", "default"))) /* chosen when the library loads */
#elif defined(__GNUC__)
#define FOR_THIS_MACHINE __attribute__((flatten))
#else
#define FOR_THIS_MACHINE
#endif

/* Everything above, compiled into one function. */
FOR_THIS_MACHINE static int run(state *a, int max_iterations, int *iterations)
{
    return iterate(a, max_iterations, iterations);
}

/* ---- the public functions ----------------------------------------------------------------------------------------------- */

/* Where a workspace's parts stand, and its aligned beginning. */
static memory *lay_out(void *workspace, const graspforce_structure *s, int k, plan *p, arena *a)
{
    uintptr_t aligned = ((uintptr_t)workspace + sizeof(lane) - 1) / sizeof(lane) * sizeof(lane);
    *a = (arena){.base = (char *)aligned};
    memory *kept = take(a, 1, sizeof(memory));
    plan_take(p, s, k, a);
    return kept;
}

size_t graspforce_workspace_size(const graspforce_structure *s)
{
    int k = structure_size(s);
    if (k == 0) return 0;
    plan p;
    arena a;
    lay_out(NULL, s, k, &p, &a);
    for (int b = 0; b < s->blocks; b++) { /* each finger alone in a group, with everything that it can have */
        group g = {.d = 0};
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
        group_take(&g, &a);
    }
    return a.used + sizeof(lane);
}

int graspforce_solve(const graspforce_structure *structure, const graspforce_data *data, const graspforce_options *options,
                     void *workspace, graspforce_answer *answer)
{
    plan p = {.s = structure, .data = data, .k = structure_size(structure)};
    answer->iterations = 0;
    answer->primal = answer->dual = answer->gap = INFINITY;
    if (p.k == 0 || workspace == NULL) return GRASPFORCE_FAILED;
    arena memory_left;
    memory *kept = lay_out(workspace, structure, p.k, &p, &memory_left);
    uint64_t last = options->warm ? kept->fingerprint : 0;
    kept->fingerprint = 0;
    sort_structure(&p);
    if (!scale(&p)) {
        clear_answer(&p, answer);
        for (int c = 0; c < p.k; c++) answer->f[c] = NAN;
        return GRASPFORCE_FAILED;
    }
    if (contradiction(&p, answer)) return GRASPFORCE_INFEASIBLE;
    form_groups(&p, &memory_left);
    pack(&p);
    state a;
    start(&a, &p, options->tolerance);
    if (last == p.fingerprint)
        start_warm(&a, kept->y, kept->tau);
    else
        start_cold(&a);
    int status = run(&a, options->max_iterations, &answer->iterations);
    if (status > GRASPFORCE_OPTIMAL && status != GRASPFORCE_INFEASIBLE && outside_range(&a)) status = GRASPFORCE_INFEASIBLE;
    answer->primal = a.primal;
    answer->dual = a.dual;
    answer->gap = a.gap;
    if (status == GRASPFORCE_INFEASIBLE) return unpack_proof(&p, a.y, answer) ? status : GRASPFORCE_FAILED;
    if (!unpack(&p, a.y, a.tau, answer)) return GRASPFORCE_FAILED;
    if (status == GRASPFORCE_OPTIMAL) {
        kept->fingerprint = p.fingerprint;
        kept->tau = a.tau;
        memcpy(kept->y, a.y, sizeof a.y);
    }
    return status;
}
