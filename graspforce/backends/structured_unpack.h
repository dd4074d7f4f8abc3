/* From the scaled iterate back to forces and multipliers in SI units. */
#ifndef GRASPFORCE_STRUCTURED_UNPACK_H
#define GRASPFORCE_STRUCTURED_UNPACK_H

#include "structured_pack.h"

static void clear_answer(const plan *p, const graspforce_answer *out)
{
    size_t N = (size_t)p->s->contacts, n = (size_t)p->s->joints;
    memset(out->f, 0, (size_t)p->k * sizeof(double));
    memset(out->z, 0, (size_t)p->k * sizeof(double));
    memset(out->y, 0, WRENCH * sizeof(double));
    memset(out->nu_lower, 0, N * sizeof(double));
    memset(out->nu_upper, 0, N * sizeof(double));
    if (n > 0) {
        memset(out->lambda_lower, 0, n * sizeof(double));
        memset(out->lambda_upper, 0, n * sizeof(double));
    }
}

/* The multiplier of a fixed row may have either sign: it belongs to the lower limit or to the upper one. */
static void split(double multiplier, double *lower, double *upper)
{
    *lower = multiplier > 0.0 ? multiplier : 0.0;
    *upper = multiplier < 0.0 ? -multiplier : 0.0;
}

static void unpack_block(const plan *p, const group *g, int l, double f_unit, double z_unit, const graspforce_answer *out)
{
    int b = g->block[l], row = 0, fixed = 0;
    for (int q = p->contact_begin[b]; q < p->contact_begin[b + 1]; q++) {
        int i = p->contact[q], normal = p->first[i] + normal_component(p->s->components[i]);
        for (int v = 0; v < p->size[i]; v++) {
            int c = p->first[i] + p->variable[p->first[i] + v];
            out->f[c] = lane_get(g->x + p->start[i] + v, l) * p->unit[c] * f_unit;
        }
        double unit = z_unit / p->unit[normal];
        if (p->size[i] == 0) continue;
        if (p->contact_fixed[i]) {
            split(-lane_get(g->v + fixed++, l) * unit, out->nu_lower + i, out->nu_upper + i);
        } else {
            out->nu_upper[i] = lane_get(g->z + row, l) * unit;
            out->nu_lower[i] = lane_get(g->z + g->rows + row++, l) * unit;
        }
    }
    for (int q = p->joint_begin[b]; q < p->joint_begin[b + 1]; q++, row++) {
        int j = p->joint[q];
        double unit = p->norm[j] > 0.0 ? z_unit / p->norm[j] : 0.0;
        if (p->joint_fixed[j]) {
            split(-lane_get(g->v + fixed++, l) * unit, out->lambda_lower + j, out->lambda_upper + j);
        } else {
            out->lambda_upper[j] = lane_get(g->z + row, l) * unit;
            out->lambda_lower[j] = lane_get(g->z + g->rows + row, l) * unit;
        }
    }
}

/* z from the stationarity of the rest, which it then satisfies to rounding; `with_cost` is 0 for a proof of infeasibility.
 * Contacts held at zero force get the least z_n that their tangential multipliers allow, and nu takes the difference. */
static void complete_multipliers(const plan *p, int with_cost, const graspforce_answer *out)
{
    const graspforce_structure *s = p->s;
    const graspforce_data *data = p->data;
    for (int c = 0; c < p->k; c++) {
        double sum = with_cost ? data->force_weight * out->f[c] + (data->cost ? data->cost[c] : 0.0) : 0.0;
        for (int r = 0; r < WRENCH; r++) sum -= data->G[r * p->k + c] * out->y[r];
        out->z[c] = sum;
    }
    for (int b = 0; b < s->blocks; b++) {
        for (int t = p->joint_begin[b]; t < p->joint_begin[b + 1]; t++) {
            int j = p->joint[t];
            double torque = data->tau_u[j];
            for (int q = p->contact_begin[b]; q < p->contact_begin[b + 1]; q++) {
                int i = p->contact[q];
                for (int c = p->first[i]; c < p->first[i + 1]; c++) torque += rate(p, c, j) * out->f[c];
            }
            double pull = (with_cost ? data->weight[j] * torque : 0.0) - out->lambda_lower[j] + out->lambda_upper[j];
            for (int q = p->contact_begin[b]; q < p->contact_begin[b + 1]; q++) {
                int i = p->contact[q];
                for (int c = p->first[i]; c < p->first[i + 1]; c++) out->z[c] += rate(p, c, j) * pull;
            }
        }
    }
    for (int i = 0; i < s->contacts; i++) {
        double *z = out->z + p->first[i], *normal = z + normal_component(s->components[i]), mu = data->mu[i];
        double tangential = s->components[i] > 1 ? mu * sqrt(z[0] * z[0] + z[1] * z[1]) : 0.0;
        double moment = s->components[i] == 4 ? data->gamma[i] * fabs(z[3]) : 0.0;
        *normal += out->nu_upper[i] - out->nu_lower[i];
        double least = sqrt(tangential * tangential + moment * moment);
        if (p->size[i] == 0) {
            least = p->cone[i] ? least : 2.0 * tangential + moment; /* also in the dual of every pyramid */
            split(*normal - least, out->nu_lower + i, out->nu_upper + i);
            *normal = least;
        } else if (!with_cost && *normal < least && !isinf(data->max_normal[i])) {
            out->nu_upper[i] += least - *normal; /* makes the proof exact, at the price of its value */
            *normal = least;
        }
    }
}

/* f and z are finite, and so is all that they were made from. */
static int all_finite(const plan *p, const graspforce_answer *out)
{
    double sum = 0.0;
    for (int c = 0; c < p->k; c++) sum += fabs(out->f[c]) + fabs(out->z[c]);
    return sum < INFINITY;
}

/* Forces and multipliers of the iterate (x, y, …)/τ. Returns 0 if they left the finite numbers. */
static int unpack(const plan *p, const double *y, double tau, const graspforce_answer *out)
{
    double f_unit = p->force / tau, z_unit = p->cost / (p->force * tau);
    clear_answer(p, out);
    for (const group *g = p->groups; g < p->groups + p->group_count; g++)
        for (int l = 0; l < g->used; l++) unpack_block(p, g, l, f_unit, z_unit, out);
    for (int r = 0; r < WRENCH; r++) out->y[r] = -y[r] * z_unit / (r < 3 ? 1.0 : p->length);
    for (int i = 0; i < p->s->contacts; i++) {
        double *f = out->f + p->first[i] + normal_component(p->s->components[i]);
        if (p->size[i] == 0) *f = 0.5 * (least_normal(p->data, i) + p->data->max_normal[i]);
    }
    complete_multipliers(p, 1, out);
    return all_finite(p, out);
}

static double product(double multiplier, double limit)
{
    return multiplier > 0.0 ? multiplier * limit : 0.0; /* no limit has no multiplier */
}

/* Completes a proof of infeasibility and scales it to the value one. Returns 0 if it proves nothing. */
static int finish_proof(const plan *p, const graspforce_answer *out)
{
    const graspforce_data *data = p->data;
    complete_multipliers(p, 0, out);
    double value = 0.0;
    for (int r = 0; r < WRENCH; r++) value += out->y[r] * data->w[r];
    for (int i = 0; i < p->s->contacts; i++)
        value += product(out->nu_lower[i], least_normal(data, i)) - product(out->nu_upper[i], data->max_normal[i]);
    for (int j = 0; j < p->s->joints; j++) {
        value += product(out->lambda_lower[j], data->lower[j] - data->tau_u[j]);
        value -= product(out->lambda_upper[j], data->upper[j] - data->tau_u[j]);
    }
    if (!(value > 0.0 && 1.0 / value < INFINITY) || !all_finite(p, out)) return 0;
    for (int r = 0; r < WRENCH; r++) out->y[r] /= value;
    for (int c = 0; c < p->k; c++) out->z[c] /= value, out->f[c] = NAN;
    for (int i = 0; i < p->s->contacts; i++) out->nu_lower[i] /= value, out->nu_upper[i] /= value;
    for (int j = 0; j < p->s->joints; j++) out->lambda_lower[j] /= value, out->lambda_upper[j] /= value;
    return 1;
}

/* The proof that the iterate's multipliers hold. */
static int unpack_proof(const plan *p, const double *y, const graspforce_answer *out)
{
    (void)unpack(p, y, 1.0, out);
    memset(out->f, 0, (size_t)p->k * sizeof(double));
    return finish_proof(p, out);
}

/* Limits that contradict each other, or a motor beyond its limit that no contact force loads. Returns 1 with the proof. */
static int contradiction(const plan *p, const graspforce_answer *out)
{
    const graspforce_data *data = p->data;
    for (int i = 0; i < p->s->contacts; i++)
        if (least_normal(data, i) > data->max_normal[i]) {
            clear_answer(p, out);
            out->nu_lower[i] = out->nu_upper[i] = 1.0;
            return finish_proof(p, out);
        }
    for (int j = 0; j < p->s->joints; j++) {
        int low = data->tau_u[j] < data->lower[j], high = data->tau_u[j] > data->upper[j];
        int crossed = data->lower[j] > data->upper[j];
        if (crossed || (p->norm[j] == 0.0 && (low || high))) {
            clear_answer(p, out);
            out->lambda_lower[j] = crossed || low;
            out->lambda_upper[j] = crossed || high;
            return finish_proof(p, out);
        }
    }
    return 0;
}

#endif
