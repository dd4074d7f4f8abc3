/* Fingers of one shape side by side, their scaled numbers written into lanes. */
#ifndef GRASPFORCE_STRUCTURED_PACK_H
#define GRASPFORCE_STRUCTURED_PACK_H

#include "structured_plan.h"

/* ---- groups ------------------------------------------------------------------------------------------------------------- */

static uint64_t stir(uint64_t hash, int value)
{
    return (hash ^ (uint64_t)(unsigned)value) * UINT64_C(1099511628211);
}

static int same_contacts(const plan *p, int a, int b)
{
    int count = p->contact_begin[a + 1] - p->contact_begin[a];
    if (p->contact_begin[b + 1] - p->contact_begin[b] != count) return 0;
    for (int q = 0; q < count; q++) {
        int i = p->contact[p->contact_begin[a] + q], j = p->contact[p->contact_begin[b] + q];
        if (p->size[i] != p->size[j] || p->cone[i] != p->cone[j]) return 0;
    }
    return 1;
}

/* The shape of finger b. */
static void measure(const plan *p, int b, group *g)
{
    int joints = p->joint_begin[b + 1] - p->joint_begin[b];
    g->d = g->cones = g->fixed = 0;
    g->rows = joints + p->facet_begin[b + 1] - p->facet_begin[b];
    g->slacks = 0;
    for (int q = p->contact_begin[b]; q < p->contact_begin[b + 1]; q++) {
        int i = p->contact[q];
        g->d += p->size[i];
        g->fixed += p->contact_fixed[i];
        g->rows += p->size[i] > 0 && !p->contact_fixed[i];
        g->cones += p->cone[i];
        g->slacks += p->cone[i] ? p->size[i] : 0;
    }
    for (int q = p->joint_begin[b]; q < p->joint_begin[b + 1]; q++) g->fixed += p->joint_fixed[p->joint[q]];
    g->slacks += 2 * g->rows;
    g->point = g->d == 3 && g->cones == 1 && g->slacks == 2 * g->rows + 3;
}

/* Puts every finger into a group of its shape, and gives the groups their memory. */
static void form_groups(plan *p, arena *a)
{
    p->group_count = 0;
    int *pool = p->cone_pool;
    uint64_t hash = UINT64_C(14695981039346656037);
    for (int b = 0; b < p->s->blocks; b++) {
        group shape = {.used = 1};
        measure(p, b, &shape);
        hash = stir(hash, shape.d);
        if (shape.d == 0) continue;
        int home = p->group_count - 1;
        for (; home >= 0; home--) {
            group *g = p->groups + home;
            if (g->used < LANES && g->rows == shape.rows && g->fixed == shape.fixed && g->slacks == shape.slacks &&
                same_contacts(p, g->block[0], b))
                break;
        }
        hash = stir(stir(stir(stir(hash, shape.rows), shape.fixed), shape.cones), home);
        if (home >= 0) {
            p->groups[home].block[p->groups[home].used++] = b;
            continue;
        }
        group *g = p->groups + p->group_count++;
        *g = shape;
        g->block[0] = b;
        g->cone_at = pool, g->cone_size = pool + g->cones;
        pool += 2 * g->cones;
        for (int q = p->contact_begin[b], at = 0, cone = 0; q < p->contact_begin[b + 1]; at += p->size[p->contact[q++]])
            if (p->cone[p->contact[q]]) g->cone_at[cone] = at, g->cone_size[cone++] = p->size[p->contact[q]];
        group_take(g, a);
    }
    p->fingerprint = hash;
}

/* ---- packing ------------------------------------------------------------------------------------------------------------ */

/* Limits of a row in units of F; what is too far to matter is left out. */
static void put_limits(group *g, int row, int l, double lower, double upper)
{
    int above = upper < NO_LIMIT, below = lower > -NO_LIMIT;
    lane_put(g->h + row, l, above ? upper : 0.0);
    lane_put(g->h + g->rows + row, l, below ? -lower : 0.0);
    lane_flag(g->has + row, l, above);
    lane_flag(g->has + g->rows + row, l, below);
}

static void put_contact(const plan *p, group *g, int l, int i, int at, int *row, int *fixed)
{
    const graspforce_data *data = p->data;
    int d = g->d, size = p->size[i], normal = p->first[i] + normal_component(p->s->components[i]);
    double a = 1.0 / p->unit[normal], least = least_normal(data, i), most = data->max_normal[i];
    double curvature = p->cost / (p->force * p->force), slope = p->cost / p->force;
    p->start[i] = at;
    if (size == 0) return;
    for (int v = 0; v < size; v++) {
        int c = p->first[i] + p->variable[p->first[i] + v];
        double unit = p->unit[c];
        for (int r = 0; r < WRENCH; r++)
            lane_put(g->G + r * d + at + v, l, data->G[r * p->k + c] * unit / (r < 3 ? 1.0 : p->length));
        lane_put(g->ridge + at + v, l, data->force_weight * unit * unit / curvature);
        lane_put(g->c + at + v, l, data->cost ? data->cost[c] * unit / slope : 0.0);
        lane_put(g->reach + at + v, l, fmin(a * most / p->force, NO_LIMIT));
    }
    lane *target = p->contact_fixed[i] ? g->E + *fixed * d : g->A + *row * d;
    for (int v = 0; v < d; v++) lane_put(target + v, l, v == at ? 1.0 : 0.0);
    if (p->contact_fixed[i]) {
        lane_put(g->e + (*fixed)++, l, a * 0.5 * (least + most) / p->force);
        return;
    }
    lane_put(g->weight + *row, l, 0.0);
    put_limits(g, *row, l, p->cone[i] && least == 0.0 ? -INFINITY : a * least / p->force, a * most / p->force);
    (*row)++;
}

static void put_joint(const plan *p, group *g, int l, int j, int *row, int *fixed)
{
    const graspforce_data *data = p->data;
    int d = g->d, b = g->block[l];
    double norm = p->norm[j], tau_u = data->tau_u[j], unit = norm * p->force;
    double weight = data->weight[j] * unit * unit / p->cost, slope = data->weight[j] * tau_u * unit / p->cost;
    for (int q = p->contact_begin[b]; q < p->contact_begin[b + 1]; q++) {
        int i = p->contact[q];
        for (int v = 0; v < p->size[i]; v++) {
            int c = p->first[i] + p->variable[p->first[i] + v], at = p->start[i] + v;
            double a = norm > 0.0 ? rate(p, c, j) * p->unit[c] / norm : 0.0;
            lane_put(g->A + *row * d + at, l, a);
            lane_put(g->c + at, l, lane_get(g->c + at, l) + slope * a);
            if (p->joint_fixed[j]) lane_put(g->E + *fixed * d + at, l, a);
        }
    }
    lane_put(g->weight + *row, l, weight);
    if (norm > 0.0 && !p->joint_fixed[j])
        put_limits(g, *row, l, (data->lower[j] - tau_u) / unit, (data->upper[j] - tau_u) / unit);
    else
        put_limits(g, *row, l, -INFINITY, INFINITY);
    (*row)++;
    if (p->joint_fixed[j]) lane_put(g->e + (*fixed)++, l, (0.5 * (data->lower[j] + data->upper[j]) - tau_u) / unit);
}

static void put_facet(const plan *p, group *g, int l, int facet, int row)
{
    static const int column[3][4] = {{2}, {0, 1, 2}, {0, 1, 2, 3}};
    int i = p->s->facet_contact[facet], components = p->s->components[i], d = g->d;
    double norm = 0.0;
    for (int v = 0; v < d; v++) lane_put(g->A + row * d + v, l, 0.0);
    for (int v = 0; v < p->size[i]; v++) {
        int c = p->variable[p->first[i] + v];
        double a = p->data->facet[4 * facet + column[components == 1 ? 0 : components - 2][c]] * p->unit[p->first[i] + c];
        lane_put(g->A + row * d + p->start[i] + v, l, a);
        norm += a * a;
    }
    norm = sqrt(norm);
    for (int v = 0; v < p->size[i] && norm > 0.0; v++) {
        lane *a = g->A + row * d + p->start[i] + v;
        lane_put(a, l, lane_get(a, l) / norm);
    }
    lane_put(g->weight + row, l, 0.0);
    put_limits(g, row, l, -INFINITY, norm > 0.0 ? 0.0 : INFINITY);
}

static void pack(const plan *p)
{
    for (group *g = p->groups; g < p->groups + p->group_count; g++) {
        for (int l = 0; l < LANES; l++) {
            if (l >= g->used) g->block[l] = g->block[0];
            lane_put(g->live, l, l < g->used ? 1.0 : 0.0);
            int b = g->block[l], at = 0, row = 0, fixed = 0;
            for (int q = p->contact_begin[b]; q < p->contact_begin[b + 1]; at += p->size[p->contact[q++]])
                put_contact(p, g, l, p->contact[q], at, &row, &fixed);
            for (int q = p->joint_begin[b]; q < p->joint_begin[b + 1]; q++) put_joint(p, g, l, p->joint[q], &row, &fixed);
            for (int q = p->facet_begin[b]; q < p->facet_begin[b + 1]; q++) put_facet(p, g, l, p->facet[q], row++);
        }
    }
}

#endif
