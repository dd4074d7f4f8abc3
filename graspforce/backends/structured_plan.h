/* The problem sorted by fingers and scaled, and where all of it stands in the caller's workspace.
 *
 * Scaled variables. Force component c is f_c = F u_c x_c with u_n = 1/a, u_t = μ/a, u_m = γ/a, a = max(1, μ): every friction
 * cone becomes ‖x₁‖ ≤ x₀. Components that friction forces to zero are left out, and so are contacts whose normal
 * force is fixed at zero. Each finger then has
 *
 *     d variables x, a contact's normal first:  its part of G x = w, in units of F and F L
 *     rows         lower ≤ a·x ≤ upper, ‖a‖ = 1: normal forces, torques, facets
 *     cones        slices of x
 *     fixed rows   e·x = value: normal forces and torques whose two limits are one
 *
 * and the cost ½ Σ weight (a·x)² + ½ Σ ridge x² + c·x, in units of the largest finger's mean curvature.
 */
#ifndef GRASPFORCE_STRUCTURED_PLAN_H
#define GRASPFORCE_STRUCTURED_PLAN_H

#include <stdint.h>
#include <string.h>

#include "structured.h"
#include "structured_cone.h"

enum { WRENCH = 6, SCHUR = WRENCH * (WRENCH + 1) / 2 };

static const double NO_LIMIT = 1e6;   /* in units of F: a limit beyond is left out */
static const double ONE_LIMIT = 1e-10; /* in units of F: two limits closer than this are one */

/* Up to LANES fingers of one shape, and everything that the iteration keeps for them. `K` stands for slacks. */
typedef struct {
    int block[LANES]; /* the fingers; lanes beyond `used` repeat the first and count for nothing */
    int used;
    int d, rows, cones, fixed;
    int slacks;         /* 2 rows + the cones' entries */
    int point;          /* one point contact: the shape that the compiler knows in advance */
    int *cone_at;       /* (cones) first variable */
    int *cone_size;     /* (cones) */
    lane *live;         /* 1 in the lanes that count, else 0 */
    lane *G, *A, *E;    /* (6, d), (rows, d), (fixed, d) */
    lane *h, *e;        /* (2 rows) upper limits, then minus the lower ones; (fixed) */
    lane_bits *has;     /* (2 rows) which of these limits exist */
    lane *weight, *ridge, *c, *reach; /* (rows), (d), (d); (d) bound of |x| */
    lane *x, *s, *z, *v;              /* (d), (K), (K), (fixed): the iterate; s = h − A x, or x itself for cones */
    lane *best_x, *best_z, *best_v;
    lane *rx, *rz, *re, *pull; /* (d), (K), (fixed): residuals; (d) Aᵀz */
    lane *s_inv, *z_inv, *zs;  /* (2 rows) each: 1/s, 1/z, z/s */
    lane *scaling;             /* (cones, SCALING) */
    lane *M, *V, *Q, *R, *QV;  /* packed factor L, diagonal inverted; L⁻¹Gᵀ (6, d); L⁻¹Eᵀ = Q R; QᵀV (6, fixed) */
    lane *b, *t, *be, *te;     /* (d), (d), (fixed), (fixed): right sides of the step and of τ's column */
    lane *ask;                 /* (K) */
    lane *dx, *ds, *dz, *dv;   /* the step … */
    lane *xt, *st, *zt, *vt;   /* … and τ times the homogeneous solution */
} group;

typedef struct {
    char *base; /* NULL to measure only */
    size_t used;
} arena;

/* What the caller gave, and how it was sorted and scaled. */
typedef struct {
    const graspforce_structure *s;
    const graspforce_data *data;
    int k;
    int *first;                                       /* (N + 1) stacked components of a contact */
    ptrdiff_t *row;                                   /* (k) where column 0 of J's row would stand */
    int *contact, *contact_begin;                     /* contacts by finger, (N) and (B + 1) */
    int *joint, *joint_begin;                         /* motors by finger */
    int *facet, *facet_begin;                         /* facets by finger */
    int *variable;                                    /* (k) the component of each variable, from first[i] on */
    int *size, *cone;                                 /* (N) variables of a contact; 1 if they form a cone */
    int *start;                                       /* (N) its first variable within the finger */
    int *contact_fixed, *joint_fixed;                 /* (N), (n) 1 if the two limits are one */
    int *cone_pool;                                   /* (2 N) the groups' cones */
    double *unit;                                     /* (k) u */
    double *norm;                                     /* (n) of u ∘ J's column, m/rad */
    double length, force, cost;                       /* L, F and the unit of cost: m, N, cost */
    group *groups;                                    /* (B) */
    int group_count;
    uint64_t fingerprint;
} plan;

/* ---- memory ------------------------------------------------------------------------------------------------------------- */

static void *take(arena *a, size_t count, size_t size)
{
    void *memory = a->base ? a->base + a->used : NULL;
    a->used += (count * size + sizeof(lane) - 1) / sizeof(lane) * sizeof(lane);
    return memory;
}

static lane *take_lanes(arena *a, int count)
{
    return take(a, (size_t)count, sizeof(lane));
}

static void group_take(group *g, arena *a)
{
    int d = g->d, sides = 2 * g->rows, K = g->slacks, E = g->fixed;
    /* the iterate first: it must stay where it is from one call to the next */
    g->x = take_lanes(a, d), g->s = take_lanes(a, K), g->z = take_lanes(a, K), g->v = take_lanes(a, E);
    g->live = take_lanes(a, 1);
    g->G = take_lanes(a, WRENCH * d), g->A = take_lanes(a, g->rows * d), g->E = take_lanes(a, E * d);
    g->h = take_lanes(a, sides), g->e = take_lanes(a, E);
    g->has = take(a, (size_t)sides, sizeof(lane_bits));
    g->weight = take_lanes(a, g->rows), g->ridge = take_lanes(a, d), g->c = take_lanes(a, d), g->reach = take_lanes(a, d);
    g->best_x = take_lanes(a, d), g->best_z = take_lanes(a, K), g->best_v = take_lanes(a, E);
    g->rx = take_lanes(a, d), g->rz = take_lanes(a, K), g->re = take_lanes(a, E), g->pull = take_lanes(a, d);
    g->s_inv = take_lanes(a, sides), g->z_inv = take_lanes(a, sides), g->zs = take_lanes(a, sides);
    g->scaling = take_lanes(a, SCALING * g->cones);
    g->M = take_lanes(a, d * (d + 1) / 2), g->V = take_lanes(a, WRENCH * d);
    g->Q = take_lanes(a, E * d), g->R = take_lanes(a, E * (E + 1) / 2), g->QV = take_lanes(a, WRENCH * E);
    g->b = take_lanes(a, d), g->t = take_lanes(a, d), g->be = take_lanes(a, E), g->te = take_lanes(a, E);
    g->ask = take_lanes(a, K);
    g->dx = take_lanes(a, d), g->ds = take_lanes(a, K), g->dz = take_lanes(a, K), g->dv = take_lanes(a, E);
    g->xt = take_lanes(a, d), g->st = take_lanes(a, K), g->zt = take_lanes(a, K), g->vt = take_lanes(a, E);
}

static void plan_take(plan *p, const graspforce_structure *s, int k, arena *a)
{
    size_t N = (size_t)s->contacts, n = (size_t)s->joints, B = (size_t)s->blocks, m = (size_t)s->facets;
    p->first = take(a, N + 1, sizeof(int));
    p->row = take(a, (size_t)k, sizeof(ptrdiff_t));
    p->contact = take(a, N, sizeof(int)), p->contact_begin = take(a, B + 1, sizeof(int));
    p->joint = take(a, n, sizeof(int)), p->joint_begin = take(a, B + 1, sizeof(int));
    p->facet = take(a, m, sizeof(int)), p->facet_begin = take(a, B + 1, sizeof(int));
    p->variable = take(a, (size_t)k, sizeof(int));
    p->size = take(a, N, sizeof(int)), p->cone = take(a, N, sizeof(int)), p->start = take(a, N, sizeof(int));
    p->contact_fixed = take(a, N, sizeof(int)), p->joint_fixed = take(a, n, sizeof(int));
    p->cone_pool = take(a, 2 * N, sizeof(int));
    p->unit = take(a, (size_t)k, sizeof(double)), p->norm = take(a, n, sizeof(double));
    p->groups = take(a, B, sizeof(group));
}

/* ---- structure ---------------------------------------------------------------------------------------------------------- */

/* k, or 0 if the structure makes no sense. */
static int structure_size(const graspforce_structure *s)
{
    const int most = 1 << 20;
    if (s == NULL || s->contacts < 1 || s->blocks < 1 || s->joints < 0 || s->facets < 0) return 0;
    if (s->contacts > most || s->blocks > most || s->joints > most || s->facets > most) return 0;
    if (s->components == NULL || s->contact_block == NULL) return 0;
    if ((s->joints > 0 && s->joint_block == NULL) || (s->facets > 0 && s->facet_contact == NULL)) return 0;
    int k = 0;
    for (int i = 0; i < s->contacts; i++) {
        int c = s->components[i], b = s->contact_block[i];
        if ((c != 1 && c != 3 && c != 4) || b < 0 || b >= s->blocks) return 0;
        k += c;
    }
    for (int j = 0; j < s->joints; j++)
        if (s->joint_block[j] < 0 || s->joint_block[j] >= s->blocks) return 0;
    for (int r = 0; r < s->facets; r++)
        if (s->facet_contact[r] < 0 || s->facet_contact[r] >= s->contacts) return 0;
    return k;
}

/* Sorts 0 … count−1 by finger: those of finger b stand at begin[b] ≤ … < begin[b + 1]. */
static void sort_by_block(int count, const int *block, const int *through, int blocks, int *order, int *begin)
{
    memset(begin, 0, ((size_t)blocks + 1) * sizeof(int));
    for (int i = 0; i < count; i++) begin[block[through ? through[i] : i] + 1]++;
    for (int b = 0; b < blocks; b++) begin[b + 1] += begin[b];
    for (int i = 0; i < count; i++) order[begin[block[through ? through[i] : i]]++] = i;
    for (int b = blocks; b > 0; b--) begin[b] = begin[b - 1];
    begin[0] = 0;
}

/* Where the rows of J begin. Returns 0 where a row does not hold all motors of its finger. */
static int find_rows(plan *p)
{
    const graspforce_structure *s = p->s;
    ptrdiff_t at = 0;
    for (int i = 0; i < s->contacts; i++) {
        const int *own = p->joint + p->joint_begin[s->contact_block[i]], *end = p->joint + p->joint_begin[s->contact_block[i] + 1];
        for (int c = p->first[i]; c < p->first[i + 1]; c++) {
            int begin = s->span ? s->span[2 * c] : 0, stop = s->span ? s->span[2 * c + 1] : s->joints;
            if (begin < 0 || stop < begin || (own < end && (own[0] < begin || end[-1] >= stop))) return 0;
            p->row[c] = at - begin;
            at += stop - begin;
        }
    }
    return 1;
}

/* J of component c and motor j, which must be of one finger. */
static double rate(const plan *p, int c, int j)
{
    return p->data->J[p->row[c] + j];
}

static int sort_structure(plan *p)
{
    const graspforce_structure *s = p->s;
    p->first[0] = 0;
    for (int i = 0; i < s->contacts; i++) p->first[i + 1] = p->first[i] + s->components[i];
    sort_by_block(s->contacts, s->contact_block, NULL, s->blocks, p->contact, p->contact_begin);
    sort_by_block(s->joints, s->joint_block, NULL, s->blocks, p->joint, p->joint_begin);
    sort_by_block(s->facets, s->contact_block, s->facet_contact, s->blocks, p->facet, p->facet_begin);
    return find_rows(p);
}

/* ---- scales ------------------------------------------------------------------------------------------------------------- */

static int normal_component(int components)
{
    return components == 1 ? 0 : 2;
}

static double least_normal(const graspforce_data *data, int i)
{
    return data->min_normal[i] > 0.0 ? data->min_normal[i] : 0.0;
}

/* Which components a contact keeps, in the order of its variables (normal, tangential, moment), and their units u. */
static void choose_variables(plan *p, int i)
{
    int components = p->s->components[i], *variable = p->variable + p->first[i], size = 0;
    double *unit = p->unit + p->first[i], mu = p->data->mu[i], gamma = p->data->gamma[i];
    double a = mu > 1.0 && components > 1 ? mu : 1.0;
    unit[normal_component(components)] = 1.0 / a;
    variable[size++] = normal_component(components);
    if (components > 1) {
        unit[0] = unit[1] = mu / a;
        if (mu > 0.0) variable[size++] = 0, variable[size++] = 1;
    }
    if (components == 4) {
        unit[3] = gamma / a;
        if (gamma > 0.0) variable[size++] = 3;
    }
    p->size[i] = size;
    p->cone[i] = size > 1;
}

/* L = the contacts' root mean square distance from the origin: a rotation's three columns have Σ‖p × e‖² = 2 ‖p‖². */
static double length_scale(const plan *p)
{
    double forces = 0.0, moments = 0.0, length = 0.0;
    for (int i = 0; i < p->s->contacts; i++) {
        int components = p->s->components[i];
        for (int c = p->first[i]; c < p->first[i] + (components == 4 ? 3 : components); c++)
            for (int r = 0; r < 3; r++) {
                double force = p->data->G[r * p->k + c], moment = p->data->G[(r + 3) * p->k + c];
                forces += force * force;
                moments += moment * moment;
            }
        if (components == 4 && p->data->gamma[i] > length) length = p->data->gamma[i];
    }
    double radius = sqrt(1.5 * moments / forces);
    if (radius > length) length = radius;
    return length > 1e-12 ? length : 1.0;
}

static double larger(double a, double b)
{
    return a > b ? a : b;
}

/* F = the largest of the wrench, the least normal forces, a hundredth of the forces that would relieve the motors; raised
 * towards a hundredth of the smallest limit, but no more than tenfold. */
static double force_scale(const plan *p)
{
    const double *w = p->data->w;
    double force = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]);
    force = larger(force, sqrt(w[3] * w[3] + w[4] * w[4] + w[5] * w[5]) / p->length);
    double limit = INFINITY;
    for (int i = 0; i < p->s->contacts; i++) {
        double most = p->data->max_normal[i];
        force = larger(force, least_normal(p->data, i));
        if (most > 0.0 && most < limit) limit = most;
    }
    for (int j = 0; j < p->s->joints; j++) {
        if (p->norm[j] == 0.0) continue;
        double tau_u = p->data->tau_u[j], range = larger(p->data->upper[j] - tau_u, tau_u - p->data->lower[j]) / p->norm[j];
        if (p->data->weight[j] > 0.0) force = larger(force, 1e-2 * fabs(tau_u) / p->norm[j]);
        if (range > 0.0 && range < limit) limit = range;
    }
    if (isinf(limit)) limit = 0.0;
    force = force > 0.0 ? larger(force, fmin(1e-2 * limit, 10.0 * force)) : 1e-2 * limit;
    return force > 0.0 ? force : 1.0;
}

/* The cost of one F along a mean direction of the stiffest finger, over F². */
static double cost_scale(const plan *p)
{
    const graspforce_structure *s = p->s;
    double curvature = 0.0, slope = 0.0;
    for (int b = 0; b < s->blocks; b++) {
        double trace = 0.0;
        int variables = 0;
        for (int q = p->contact_begin[b]; q < p->contact_begin[b + 1]; q++) {
            int i = p->contact[q];
            for (int v = 0; v < p->size[i]; v++) {
                int c = p->first[i] + p->variable[p->first[i] + v];
                trace += p->data->force_weight * p->unit[c] * p->unit[c];
                if (p->data->cost) slope = larger(slope, fabs(p->data->cost[c]) * p->unit[c]);
            }
            variables += p->size[i];
        }
        for (int q = p->joint_begin[b]; q < p->joint_begin[b + 1]; q++) {
            int j = p->joint[q];
            trace += p->data->weight[j] * p->norm[j] * p->norm[j];
        }
        if (variables > 0) curvature = larger(curvature, trace / variables);
    }
    if (!(curvature > 0.0)) curvature = slope / p->force;
    return curvature > 0.0 ? curvature : 1.0;
}

/* ‖u ∘ J_j‖ within the finger, zero where it is lost in the rounding of the largest. */
static void joint_norms(plan *p)
{
    const graspforce_structure *s = p->s;
    double largest = 0.0;
    for (int b = 0; b < s->blocks; b++)
        for (int q = p->joint_begin[b]; q < p->joint_begin[b + 1]; q++) {
            int j = p->joint[q];
            double sum = 0.0;
            for (int t = p->contact_begin[b]; t < p->contact_begin[b + 1]; t++) {
                int i = p->contact[t];
                for (int v = 0; v < p->size[i]; v++) {
                    int c = p->first[i] + p->variable[p->first[i] + v];
                    double scaled = rate(p, c, j) * p->unit[c];
                    sum += scaled * scaled;
                }
            }
            p->norm[j] = sqrt(sum);
            largest = larger(largest, p->norm[j]);
        }
    for (int j = 0; j < s->joints; j++)
        if (!(p->norm[j] > 1e-12 * largest)) p->norm[j] = 0.0;
}

/* Numbers that make a problem: finite, of the right sign. NaN in a sum of squares stays there. */
static int sensible(const plan *p)
{
    const graspforce_structure *s = p->s;
    const graspforce_data *data = p->data;
    if (!data->G || !data->w || !data->mu || !data->gamma || !data->min_normal || !data->max_normal) return 0;
    if (s->joints > 0 && (!data->J || !data->tau_u || !data->lower || !data->upper || !data->weight)) return 0;
    if (s->facets > 0 && !data->facet) return 0;
    double sum = data->force_weight * data->force_weight;
    for (int c = 0; c < WRENCH * p->k; c++) sum += data->G[c] * data->G[c];
    for (int r = 0; r < WRENCH; r++) sum += data->w[r] * data->w[r];
    if (data->cost)
        for (int c = 0; c < p->k; c++) sum += data->cost[c] * data->cost[c];
    for (int r = 0; r < 4 * s->facets; r++) sum += data->facet[r] * data->facet[r];
    for (int i = 0; i < s->contacts; i++) {
        sum += data->mu[i] * data->mu[i] + data->min_normal[i] * data->min_normal[i];
        if (s->components[i] == 4) sum += data->gamma[i] * data->gamma[i];
        if (data->mu[i] < 0.0 || (s->components[i] == 4 && data->gamma[i] < 0.0) || !(data->max_normal[i] >= 0.0)) return 0;
    }
    for (int j = 0; j < s->joints; j++) {
        sum += data->tau_u[j] * data->tau_u[j] + data->weight[j] * data->weight[j];
        if (!(data->weight[j] >= 0.0) || !(data->lower[j] < INFINITY) || !(data->upper[j] > -INFINITY)) return 0;
    }
    return sum < INFINITY && data->force_weight >= 0.0;
}

/* All scales, and what is fixed or left out. Returns 0 if the numbers make no problem. */
static int scale(plan *p)
{
    const graspforce_structure *s = p->s;
    if (!sensible(p)) return 0;
    for (int i = 0; i < s->contacts; i++) choose_variables(p, i);
    for (int r = 0; r < s->facets; r++) p->cone[s->facet_contact[r]] = 0;
    joint_norms(p);
    p->length = length_scale(p);
    p->force = force_scale(p);
    for (int i = 0; i < s->contacts; i++) {
        double least = least_normal(p->data, i), most = p->data->max_normal[i];
        p->contact_fixed[i] = most - least <= ONE_LIMIT * p->force;
        if (most <= ONE_LIMIT * p->force) p->size[i] = p->cone[i] = p->contact_fixed[i] = 0;
    }
    for (int j = 0; j < s->joints; j++)
        p->joint_fixed[j] = p->norm[j] > 0.0 && p->data->upper[j] - p->data->lower[j] <= ONE_LIMIT * p->force * p->norm[j];
    p->cost = cost_scale(p) * p->force * p->force;
    double product = p->length * p->force * p->cost;
    for (int j = 0; j < s->joints; j++) product += p->norm[j];
    return product > 0.0 && product < INFINITY;
}

#endif
