/* Gradients of adjoint.h.
 *
 *     active_limits.inc   active limits and variables of a solution
 *     conditions.inc      conditions of optimality and their Jacobian
 *     dense_lu.inc        linear equations
 */
#include "graspforce/adjoint.h"

#include <float.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

#include "conditions.inc"
#include "target_clones.inc"

static const double CONVERGED = 1e-15;         /* of the conditions, relative to their terms: no further step */
static const double RESIDUAL = 1e-9;           /* of the conditions after Newton's method, relative to their terms */
static const double LARGEST_CONDITION = 1e11;  /* of the Jacobian in units of the variables, in the norm ‖·‖₁ */
static const double OUTSIDE = 1e-6;            /* of the refined forces, in force units */
static const double SLOW = 1e-3;               /* a step with older factors that reduces the residual less needs new ones */
static const double REFINED = 4 * DBL_EPSILON; /* residual of the linear equations, relative to their terms */
static const double LOOSE = 1e-12;             /* likewise, if refinement does not reduce it further */
enum { NEWTON_STEPS = 16, REFINEMENTS = 8 };

/* ---- workspace ---------------------------------------------------------------------------------------------------------- */

/* Place the arrays of an optimum at `base`, or measure them if it is NULL. Return the bytes. */
static size_t lay_out(gf_optimum *o, char *base)
{
    const size_t k = (size_t)o->k, N = (size_t)o->s->contacts, n = (size_t)o->s->joints, limits = 2 * N + n, m = k + 6 + limits;
    const size_t column = m + LU_GROUP - 1; /* at least lu_stride() of m, and of any smaller size */
    double **const matrices[] = {&o->constant, &o->K, &o->factors.L, &o->factors.U};
    double **const columns[] = {&o->x, &o->scale, &o->residual, &o->right, &o->z, &o->factors.diagonal};
    double *const start = (double *)base, *at = start;
    for (size_t i = 0; i < sizeof matrices / sizeof *matrices; i++) *matrices[i] = at, at += m * column;
    for (size_t i = 0; i < sizeof columns / sizeof *columns; i++) *columns[i] = at, at += column;
    o->step = at, at += column + n;
    o->f = at, at += k;
    o->tau = at, at += n;
    o->price = at, at += n;
    o->active = (gf_active_limit *)at;
    o->variable = (int *)(o->active + limits);
    o->span = o->variable + k;
    o->factors.pivot = o->span + 2 * k;
    return (size_t)((uintptr_t)(o->factors.pivot + m) - (uintptr_t)start);
}

static gf_optimum new_optimum(const gf_structure *s, const gf_problem *problem, const gf_units *unit)
{
    gf_optimum o = {.s = s, .problem = problem, .unit = unit};
    for (int i = 0; i < s->contacts; i++) o.k += s->components[i];
    return o;
}

size_t gf_adjoint_size(const gf_structure *structure)
{
    gf_optimum o = new_optimum(structure, NULL, NULL);
    return lay_out(&o, NULL) + sizeof(double);
}

/* ---- Newton's method ---------------------------------------------------------------------------------------------------- */

/* Factor the Jacobian at x. Return 0 if it is singular. */
static int factor(gf_optimum *o)
{
    set_cones(o);
    memcpy(o->factors.U, o->K, (size_t)o->size * (size_t)lu_stride(o->size) * sizeof(double));
    return lu_factor(o->size, &o->factors);
}

/* Return whether the refined optimum breaks a cone, or a cone has a multiplier of the wrong sign. */
static int leaves_limits(const gf_optimum *o)
{
    for (int l = 0; l < o->limits; l++)
        if (o->active[l].kind == LIMIT_CONE && !(o->x[o->free + 6 + l] > 0.0)) return 1;
    for (int i = 0, first = 0; i < o->s->contacts; first += o->s->components[i++]) {
        const gf_contact_friction c = contact_friction(o, i, first);
        const double normal = o->f[c.normal], excess = fmax(c.mu, 1.0) * (used_normal_force(&c, o->f) - normal);
        if (!(fmax(excess, -normal) <= OUTSIDE * o->unit->force)) return 1;
    }
    return 0;
}

/* Refine x by Newton's method, with factors that are renewed when convergence is slow. */
static gf_adjoint_status refine(gf_optimum *o)
{
    constant_jacobian(o);
    if (!factor(o)) return GF_ADJOINT_NOT_UNIQUE;
    const double condition = largest_column_sum(o->size, o->K) * inverse_norm(o->size, &o->factors, o->step);
    if (!(condition <= LARGEST_CONDITION)) return GF_ADJOINT_NOT_UNIQUE;
    double residual = conditions(o);
    for (int step = 0; step < NEWTON_STEPS && residual > CONVERGED; step++) {
        memcpy(o->step, o->residual, (size_t)o->size * sizeof(double));
        lu_solve(o->size, &o->factors, o->step);
        for (int v = 0; v < o->size; v++) o->x[v] -= o->scale[v] * o->step[v];
        const double last = residual;
        residual = conditions(o);
        if (!isfinite(residual)) return GF_ADJOINT_NO_SOLUTION;
        const int is_slow = residual > SLOW * last;
        if (is_slow && last <= RESIDUAL * SLOW) break; /* rounding */
        if (is_slow && residual > CONVERGED && !factor(o)) return GF_ADJOINT_NO_SOLUTION;
    }
    return residual <= RESIDUAL && !leaves_limits(o) ? GF_ADJOINT_FOUND : GF_ADJOINT_NO_SOLUTION;
}

/* Compute residual = right − K z. Return the sum of its sizes, and that of the sizes of all terms in `terms`. */
static double linear_residual(const gf_optimum *o, double *terms)
{
    const int m = o->size, stride = lu_stride(m), groups = stride / LU_GROUP;
    double *restrict r = o->residual, *restrict size = o->step, error = 0.0;
    for (int i = 0; i < stride; i++) r[i] = i < m ? o->right[i] : 0.0, size[i] = fabs(r[i]);
    for (int j = 0; j < m; j++) {
        const double x = o->z[j], *restrict column = o->K + j * stride;
        for (int i = 0; i < LU_GROUP * groups; i++) r[i] -= column[i] * x, size[i] += fabs(column[i] * x);
    }
    *terms = 0.0;
    for (int i = 0; i < m; i++) error += fabs(r[i]), *terms += size[i]; /* sums keep NaN */
    return error;
}

/* Compute z = K⁻¹ right at the refined x, by the last factors and iterative refinement. Return 0 if that fails. */
static int solve_refined(gf_optimum *o)
{
    const int m = o->size;
    double last = INFINITY, terms;
    set_cones(o);
    memcpy(o->z, o->right, (size_t)m * sizeof(double)); /* the multipliers z are not needed any more */
    lu_solve(m, &o->factors, o->z);
    for (int sweep = 0, renewed = 0; sweep < REFINEMENTS; sweep++) {
        const double error = linear_residual(o, &terms);
        if (error <= REFINED * terms || (error <= LOOSE * terms && error > 0.5 * last)) return 1;
        if (!renewed && error > 0.1 * last) {
            if (!factor(o)) return 0;
            renewed = 1;
        }
        last = error;
        lu_solve(m, &o->factors, o->residual);
        for (int i = 0; i < m; i++) o->z[i] += o->residual[i];
    }
    return 0;
}

/* ---- products ----------------------------------------------------------------------------------------------------------- */

/* Set `right` to the gradient of the function with respect to x, in units of the variables. */
static void seed_variables(gf_optimum *o, const gf_adjoint_seed *seed)
{
    const gf_problem *p = o->problem;
    const int n = o->s->joints;
    double *price = o->step; /* of each torque */
    for (int j = 0; j < n; j++) price[j] = seed->tau[j] + seed->objective * p->weight[j] * o->tau[j];
    memset(o->right, 0, (size_t)o->size * sizeof(double));
    for (int i = 0, c = 0; i < o->s->contacts; i++) {
        const int normal = contact_friction(o, i, c).normal;
        for (const int end = c + o->s->components[i]; c < end; c++) {
            if (o->variable[c] < 0) continue;
            const double slope = squared_weight(p, c > normal) * o->f[c] + (p->cost ? p->cost[c] : 0.0);
            const double sum = seed->f[c] + seed->objective * slope + row_times(o, c, price);
            o->right[o->variable[c]] = sum * o->scale[o->variable[c]];
        }
    }
}

/* Compute the gradients with respect to the motors' data from λ. */
static void motor_gradients(const gf_optimum *o, const gf_adjoint_seed *seed, const double *lambda,
                            const gf_adjoint_gradient *g)
{
    const gf_problem *p = o->problem;
    const int n = o->s->joints;
    double *turned = o->step; /* Jᵀ λ */
    for (int j = 0; j < n; j++) turned[j] = 0.0;
    for (int c = 0; c < o->k; c++)
        if (o->variable[c] >= 0) add_row(o, c, lambda[o->variable[c]], turned);
    for (int j = 0; j < n; j++) {
        g->tau_u[j] = seed->tau[j] + p->weight[j] * (seed->objective * o->tau[j] - turned[j]);
        g->lower[j] = g->upper[j] = 0.0;
    }
    for (int l = 0; l < o->limits; l++) {
        const gf_active_limit *a = o->active + l;
        if (a->kind != LIMIT_TORQUE) continue;
        const double value = lambda[o->free + 6 + l];
        g->tau_u[a->index] -= value;
        *(a->side > 0 ? g->upper + a->index : g->lower + a->index) = value;
    }
    for (int c = 0; c < o->k; c++) {
        const double own = o->variable[c] < 0 ? 0.0 : lambda[o->variable[c]];
        for (int j = 0; j < n; j++) g->J[c * n + j] = o->f[c] * g->tau_u[j] - own * o->price[j];
    }
}

/* Compute c ← c + factor a × b. */
static void add_cross(double factor, const double *a, const double *b, double *c)
{
    c[0] += factor * (a[1] * b[2] - a[2] * b[1]);
    c[1] += factor * (a[2] * b[0] - a[0] * b[2]);
    c[2] += factor * (a[0] * b[1] - a[1] * b[0]);
}

/* Compute the gradients with respect to places and frames from λ. With the force v and λ's force u of a contact in O, the moments
 * m and l about its normal, and the multipliers (y_f, y_m) and λ = (…, λ_f, λ_m, …):
 *
 *     p        v × λ_m − y_m × u
 *     rotation v × (λ_f + λ_m × arm) + u × (y_f + y_m × arm) + m n × λ_m + l n × y_m */
static void place_gradients(const gf_optimum *o, const gf_adjoint_places *places, const double *lambda,
                            const gf_adjoint_gradient *g)
{
    const double *y = o->x + o->free, *ly = lambda + o->free;
    for (int i = 0, first = 0; i < o->s->contacts; first += o->s->components[i++]) {
        const double *R = places->R + 9 * i, normal[3] = {R[2], R[5], R[8]};
        double v[3] = {0.0}, u[3] = {0.0}, arm[3], price[3], change[3], *p = g->p + 3 * i, *turn = g->rotation + 3 * i;
        const int components = o->s->components[i];
        for (int a = components == 1 ? 2 : 0, c = first; a < 3; a++, c++) {
            const double own = o->variable[c] < 0 ? 0.0 : lambda[o->variable[c]];
            for (int r = 0; r < 3; r++) v[r] += R[3 * r + a] * o->f[c], u[r] += R[3 * r + a] * own;
        }
        for (int r = 0; r < 3; r++) {
            arm[r] = places->p[3 * i + r] - places->reference->centroid[r];
            price[r] = y[r], change[r] = ly[r], p[r] = turn[r] = 0.0;
        }
        add_cross(1.0, y + 3, arm, price);
        add_cross(1.0, ly + 3, arm, change);
        add_cross(1.0, v, ly + 3, p);
        add_cross(-1.0, y + 3, u, p);
        add_cross(1.0, v, change, turn);
        add_cross(1.0, u, price, turn);
        if (components == 4 && o->variable[first + 3] >= 0) {
            add_cross(o->f[first + 3], normal, ly + 3, turn);
            add_cross(lambda[o->variable[first + 3]], normal, y + 3, turn);
        }
    }
    const double *c = places->reference->centroid;
    for (int r = 0; r < 6; r++) g->w[r] = -ly[r];
    add_cross(-1.0, c, ly + 3, g->w);
}

/* Compute the gradients with respect to friction from λ. */
static void friction_gradients(const gf_optimum *o, const double *lambda, const gf_adjoint_gradient *g)
{
    for (int i = 0; i < o->s->contacts; i++) g->mu[i] = 0.0;
    for (int l = 0; l < o->limits; l++) {
        if (o->active[l].kind != LIMIT_CONE) continue;
        gf_cone_derivatives d;
        cone_derivatives(o, o->active[l].index, &d);
        double sum = lambda[o->free + 6 + l] * d.mu;
        for (int v = 0; v < d.count; v++) sum += o->x[o->free + 6 + l] * lambda[d.variable[v]] * d.gradient_mu[v];
        g->mu[o->active[l].index] = -sum;
    }
}

/* Find the active limits, refine the optimum and compute all gradients; compiled into one function. */
GF_TARGET_CLONES static gf_adjoint_status compute_gradients(gf_optimum *o, const gf_adjoint_places *places,
                                                            const gf_solution *solution, const gf_adjoint_seed *seed,
                                                            const gf_adjoint_gradient *gradient)
{
    gf_adjoint_status status = find_active_limits(o, solution);
    if (status == GF_ADJOINT_FOUND) status = refine(o);
    if (status != GF_ADJOINT_FOUND) return status;
    seed_variables(o, seed);
    if (!solve_refined(o)) return GF_ADJOINT_NOT_UNIQUE;
    for (int v = 0; v < o->size; v++) o->z[v] *= o->scale[v];
    motor_gradients(o, seed, o->z, gradient);
    place_gradients(o, places, o->z, gradient);
    friction_gradients(o, o->z, gradient);
    return GF_ADJOINT_FOUND;
}

gf_adjoint_status gf_adjoint(const gf_structure *structure, const gf_problem *problem, const gf_adjoint_places *places,
                             const gf_units *unit, const gf_solution *solution, const gf_adjoint_seed *seed, void *workspace,
                             const gf_adjoint_gradient *gradient, int *index)
{
    *index = -1;
    if (structure->facets > 0 || structure->level != GF_LEVEL_NONE || structure->span) return GF_ADJOINT_UNSUPPORTED;
    gf_problem numbers = *problem;
    if (!(numbers.moment_length > 0.0)) numbers.moment_length = 1.0;
    gf_optimum o = new_optimum(structure, &numbers, unit);
    (void)lay_out(&o, (char *)(((uintptr_t)workspace + sizeof(double) - 1) / sizeof(double) * sizeof(double)));
    const gf_adjoint_status status = compute_gradients(&o, places, solution, seed, gradient);
    *index = o.undecided;
    return status;
}
