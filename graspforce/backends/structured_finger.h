/* Everything that an iteration does to one finger, done to LANES of them at a time. structured.c has the method and its
 * symbols; each function here takes a group of fingers of one shape, and `point`, which is 1 where that shape is a single
 * point contact.
 */
#ifndef GRASPFORCE_STRUCTURED_FINGER_H
#define GRASPFORCE_STRUCTURED_FINGER_H

#include "structured_pack.h"

static const double PROXIMAL = 1e-8;     /* added to M's diagonal: a step's damping, no change of the problem */
static const double ROUNDING = 1e-16;    /* of M's trace, likewise: keeps the factor sound where H leaves directions flat */
static const double FIXED_RIDGE = 1e-13; /* of a fixed row's square: lets rows that repeat each other pass */

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

INLINE void residuals(group *g, int point, double tau, const double *y, sums *sum)
{
    const shape k = shape_of(g, point);
    const lane live = *g->live;
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
        for (int r = 0; r < WRENCH; r++) force += g->G[r * k.d + i] * y[r];
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

/* NT scaling, M and its factor, V, and the finger's part of S. V is kept without what the fixed rows take of it; QV is that
 * part. */
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
INLINE void refine_right_side(group *g, int point, double eta, double dtau, const double *dy, lane *p_step, lane *Gx,
                              lane *rest)
{
    const shape k = shape_of(g, point);
    for (int i = 0; i < k.d; i++) {
        lane sum = -eta * g->rx[i] - g->c[i] * dtau - g->ridge[i] * g->dx[i];
        for (int r = 0; r < WRENCH; r++) sum -= g->G[r * k.d + i] * dy[r];
        for (int q = 0; q < k.fixed; q++) sum -= g->E[q * k.d + i] * g->dv[q];
        g->b[i] = sum;
    }
    for (int r = 0; r < WRENCH; r++) Gx[r] += *g->live * dot(k.d, g->G + r * k.d, g->dx);
    for (int q = 0; q < k.fixed; q++) g->be[q] = g->e[q] * dtau - eta * g->re[q] - dot(k.d, g->E + q * k.d, g->dx);
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

#endif
