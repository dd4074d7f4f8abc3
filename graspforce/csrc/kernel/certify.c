/* The proof behind certify.h. Plain loops in the order of the law; nothing is shared with the solver. */
#include "graspforce/certify.h"

#include <float.h>
#include <math.h>

/* The largest so far. NaN stays, so that no comparison can lose it. */
static double max_or_nan(double largest, double value)
{
    return value > largest || isnan(value) ? value : largest;
}

static double positive_part(double value)
{
    return value <= 0.0 ? 0.0 : value; /* NaN stays here too */
}

/* Multiplier times slack, where an absent limit (infinite slack) may only have the multiplier 0. */
static double multiplier_times_slack(double multiplier, double slack)
{
    return multiplier != 0.0 ? multiplier * slack : 0.0;
}

/* A contact's components as (f_t1, f_t2, f_n, m_n), zeros where its model has none. */
static void pad(int components, const double *f, double *padded)
{
    padded[0] = components > 1 ? f[0] : 0.0;
    padded[1] = components > 1 ? f[1] : 0.0;
    padded[2] = components > 1 ? f[2] : f[0];
    padded[3] = components > 3 ? f[3] : 0.0;
}

/* How far a force is outside its exact cone, N: pulling, slipping, or twisting beyond what γ bears. */
static double cone_violation(const double *f, double mu, double gamma)
{
    double slip = hypot(f[0], f[1]), load = gamma > 0.0 ? hypot(slip, mu / gamma * f[3]) : slip;
    double twist = gamma > 0.0 ? fabs(f[3]) / gamma - f[2] : fabs(f[3]);
    return max_or_nan(max_or_nan(positive_part(-f[2]), positive_part(load - mu * f[2])), positive_part(twist));
}

/* How much z_n lacks for z to be in the dual cone. */
static double dual_distance(const double *z, double mu, double gamma)
{
    double tangential = mu * hypot(z[0], z[1]);
    return positive_part((gamma > 0.0 ? hypot(tangential, gamma * z[3]) : tangential) - z[2]);
}

/* Σ a_i b_i, four sums at a time. */
static double dot(int count, const double *a, const double *b)
{
    double sum[4] = {0.0, 0.0, 0.0, 0.0};
    int i = 0;
    for (; i + 4 <= count; i += 4)
        for (int q = 0; q < 4; q++) sum[q] += a[i + q] * b[i + q];
    for (; i < count; i++) sum[0] += a[i] * b[i];
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

/* b −= share a */
static void subtract(int count, double share, const double *restrict a, double *restrict b)
{
    for (int i = 0; i < count; i++) b[i] -= share * a[i];
}

/* A row of J: of motor first + j, 0 ≤ j < count, it is rate[j], and zero of all others. */
typedef struct {
    int first, count;
    const double *rate;
} gf_jacobian_row;

/* J's row c, which is held at `at`; moves that to the next. */
static gf_jacobian_row next_row(const gf_structure *s, int c, const double **at)
{
    int first = s->span ? s->span[2 * c] : 0, last = s->span ? s->span[2 * c + 1] : s->joints;
    gf_jacobian_row J = {first, last - first, *at};
    *at += last - first;
    return J;
}

/* Largest violation of cones and limits; adds multiplier times slack of all limits to `gap`, and lifts `largest_normal` to
 * that of the normal forces. */
static double limits(const gf_structure *s, const gf_problem *data, const gf_solution *x, const gf_units *unit,
                     const double *tau, double *gap, double *largest_normal)
{
    double primal = 0.0;
    for (int i = 0, c = 0; i < s->contacts; c += s->components[i++]) {
        double f[4], gamma = s->components[i] == 4 ? data->gamma[i] : 0.0, mu = s->components[i] > 1 ? data->mu[i] : 0.0;
        pad(s->components[i], x->f + c, f);
        double below = f[2] - data->min_normal[i], above = data->max_normal[i] - f[2];
        primal = max_or_nan(primal, cone_violation(f, mu, gamma) / unit->force);
        primal = max_or_nan(primal, max_or_nan(positive_part(-below), positive_part(-above)) / unit->force);
        *gap += multiplier_times_slack(x->nu_lower[i], below) + multiplier_times_slack(x->nu_upper[i], above);
        *largest_normal = max_or_nan(*largest_normal, fabs(f[2]));
    }
    for (int j = 0; j < s->joints; j++) {
        double below = tau[j] - data->lower[j], above = data->upper[j] - tau[j];
        primal = max_or_nan(primal, max_or_nan(positive_part(-below), positive_part(-above)) / unit->torque[j]);
        *gap += multiplier_times_slack(x->lambda_lower[j], below) + multiplier_times_slack(x->lambda_upper[j], above);
    }
    return primal;
}

/* The largest cost that wrong signs and z outside K* could hide; what z lacks hides no more than the contact may press. */
static double hidden_cost_bound(const gf_structure *s, const gf_problem *data, const gf_solution *x, const gf_units *unit,
                                const double *z, const double *tau, double largest_normal)
{
    double dual = 0.0;
    for (int i = 0, c = 0; i < s->contacts; c += s->components[i++]) {
        double padded[4], gamma = s->components[i] == 4 ? data->gamma[i] : 0.0, mu = s->components[i] > 1 ? data->mu[i] : 0.0;
        pad(s->components[i], z + c, padded);
        double pressing = data->max_normal[i] < largest_normal ? data->max_normal[i] : largest_normal;
        dual = max_or_nan(dual, dual_distance(padded, mu, gamma) * pressing);
        dual = max_or_nan(dual, max_or_nan(-x->nu_lower[i], -x->nu_upper[i]) * largest_normal);
    }
    for (int j = 0; j < s->joints; j++) {
        double loaded = max_or_nan(unit->torque[j], fabs(tau[j]));
        dual = max_or_nan(dual, max_or_nan(-x->lambda_lower[j], -x->lambda_upper[j]) * loaded);
    }
    return dual;
}

/* A joint that forces load less than this beside the most loaded one is loaded by rounding alone. */
static const double NEGLIGIBLE_LEVER = 1e-14;

/* size / lever, zero where there is no lever. */
static double divide_or_zero(double size, double lever)
{
    return lever > 0.0 ? size / lever : 0.0;
}

/* (n) the most that a unit force at any contact loads each joint with, N·m per N; returns the largest. */
static double unit_force_torques(const gf_structure *s, const gf_problem *data, double length, double *unit_torque)
{
    const int n = s->joints;
    const double *at = data->J;
    double largest = 0.0;
    for (int j = 0; j < n; j++) unit_torque[j] = 0.0;
    for (int i = 0, component = 0; i < s->contacts; i++)
        for (int c = 0; c < s->components[i]; c++, component++) {
            gf_jacobian_row J = next_row(s, component, &at);
            int normal = c == (s->components[i] == 1 ? 0 : 2);
            double bears = normal ? INFINITY : data->max_normal[i] == 0.0 ? 0.0 : c == 3 ? data->gamma[i] : data->mu[i];
            double unit = c == 3 ? length : 1.0;
            for (int j = 0; j < J.count && bears > 0.0; j++) {
                double load = fabs(J.rate[j]) * unit, *most = unit_torque + J.first + j;
                *most = load > *most ? load : *most;
            }
        }
    for (int j = 0; j < n; j++) largest = max_or_nan(largest, unit_torque[j]);
    for (int j = 0; j < n; j++)
        if (!(unit_torque[j] > NEGLIGIBLE_LEVER * largest)) unit_torque[j] = 0.0;
    return largest;
}

void gf_problem_units(const gf_structure *s, const gf_problem *data, double length, double *torque, gf_units *units)
{
    const double *w = data->w;
    double *unit_torque = torque, farthest = unit_force_torques(s, data, length, unit_torque), lever = 0.0, pushed = 0.0,
           biased = 0.0;
    double force = max_or_nan(hypot(hypot(w[0], w[1]), w[2]), hypot(hypot(w[3], w[4]), w[5]) / length);
    for (int i = 0; i < s->contacts; i++) force = max_or_nan(force, data->min_normal[i]);
    for (int j = 0; j < s->joints; j++) {
        double root = sqrt(data->weight[j]), bias = fabs(data->tau_u[j]);
        double beyond = max_or_nan(data->lower[j] - data->tau_u[j], data->tau_u[j] - data->upper[j]);
        if (beyond > 0.0) force = max_or_nan(force, divide_or_zero(beyond, unit_torque[j]));
        lever = max_or_nan(lever, root * unit_torque[j]);
        if (unit_torque[j] > 0.0) pushed = max_or_nan(pushed, root * bias);
        biased = max_or_nan(biased, bias);
    }
    force = max_or_nan(force, divide_or_zero(pushed, lever));
    if (force == 0.0) force = divide_or_zero(biased, farthest);
    if (force == 0.0) force = 1.0;

    int k = 0;
    double slope = 0.0;
    for (int i = 0; i < s->contacts; i++) k += s->components[i];
    for (int c = 0; c < k && data->cost; c++) slope = max_or_nan(slope, fabs(data->cost[c]));
    double cost = slope > 0.0 ? slope * force : (lever * lever + data->force_weight) * (force * force);
    for (int j = 0; j < s->joints; j++) {
        double bias = fabs(data->tau_u[j]);
        torque[j] = bias == 0.0 && unit_torque[j] == 0.0 ? 1.0 : max_or_nan(bias, unit_torque[j] * force);
    }
    *units = (gf_units){force, length, cost == 0.0 ? 1.0 : cost, torque};
}

int gf_certify(const gf_structure *s, const gf_problem *data, const gf_solution *x, const gf_units *unit, double *tau,
               double *z, double *scratch, gf_residuals *residuals)
{
    if (s->facets > 0) return 0;
    int k = 0, n = s->joints;
    for (int i = 0; i < s->contacts; i++) k += s->components[i];

    /* tau = tau_u + Jᵀ f and cost = ½ tauᵀ W tau + ½ ρ fᵀf + cᵀf */
    for (int j = 0; j < n; j++) tau[j] = data->tau_u[j];
    const double *at = data->J;
    for (int c = 0; c < k; c++) {
        gf_jacobian_row J = next_row(s, c, &at);
        for (int j = 0; j < J.count; j++) tau[J.first + j] += J.rate[j] * x->f[c];
    }
    double cost = 0.5 * data->force_weight * dot(k, x->f, x->f) + (data->cost ? dot(k, data->cost, x->f) : 0.0);
    for (int j = 0; j < n; j++) cost += 0.5 * data->weight[j] * tau[j] * tau[j];

    /* G f − w, and yᵀ(G f − w) */
    double primal = 0.0, gap = 0.0;
    for (int r = 0; r < 6; r++) {
        double error = dot(k, data->G + (size_t)r * (size_t)k, x->f) - data->w[r];
        primal = max_or_nan(primal, fabs(error) / (r < 3 ? unit->force : unit->force * unit->length));
        gap += x->y[r] * error;
    }

    double largest_normal = unit->force;
    primal = max_or_nan(primal, limits(s, data, x, unit, tau, &gap, &largest_normal));

    /* z; each motor's torque has the price W tau − lambda_lower + lambda_upper */
    double *price = scratch;
    for (int j = 0; j < n; j++) price[j] = data->weight[j] * tau[j] - x->lambda_lower[j] + x->lambda_upper[j];
    at = data->J;
    for (int c = 0; c < k; c++) {
        gf_jacobian_row J = next_row(s, c, &at);
        z[c] = dot(J.count, J.rate, price + J.first) + data->force_weight * x->f[c] + (data->cost ? data->cost[c] : 0.0);
    }
    for (int r = 0; r < 6; r++) subtract(k, x->y[r], data->G + (size_t)r * (size_t)k, z);
    for (int i = 0, c = 0; i < s->contacts; c += s->components[i++])
        z[s->components[i] == 1 ? c : c + 2] += x->nu_upper[i] - x->nu_lower[i];

    gap += dot(k, z, x->f);
    double whole = unit->cost + fabs(cost), dual = hidden_cost_bound(s, data, x, unit, z, tau, largest_normal);
    if (!isfinite(whole)) whole = NAN; /* beside an infinite cost everything would be nothing */
    *residuals = (gf_residuals){primal, dual / whole, fabs(gap) / whole};
    if (!isfinite(residuals->primal)) residuals->primal = DBL_MAX;
    if (!isfinite(residuals->dual)) residuals->dual = DBL_MAX;
    if (!isfinite(residuals->gap)) residuals->gap = DBL_MAX;
    return 1;
}
