/* Certificates of certify.h: plain loops in the order of the law, independent of the solver. */
#include "graspforce/certify.h"

#include <stddef.h>

#include "../real.inc"

/* Return the larger number, or NaN if either is NaN. */
static double max_or_nan(double largest, double value)
{
    return value > largest || isnan(value) ? value : largest;
}

/* Return max(value, 0), or NaN if value is NaN. */
static double positive_part(double value)
{
    return value <= 0.0 ? 0.0 : value;
}

/* Return multiplier times slack. An absent limit has infinite slack and the multiplier 0; their product is 0. */
static double multiplier_times_slack(double multiplier, double slack)
{
    return multiplier != 0.0 ? multiplier * slack : 0.0;
}

/* Expand the components of a contact to (f_t1, f_t2, f_n, m_n) with zeros for those that its model lacks. */
static void pad(int components, const double *f, double *padded)
{
    padded[0] = components > 1 ? f[0] : 0.0;
    padded[1] = components > 1 ? f[1] : 0.0;
    padded[2] = components > 1 ? f[2] : f[0];
    padded[3] = components > 3 ? f[3] : 0.0;
}

/* Return how far a force is outside its cone, N: the largest of pulling force, excess tangential load and excess moment. */
static double cone_violation(const double *f, double mu, double gamma)
{
    double slip = hypot(f[0], f[1]), load = gamma > 0.0 ? hypot(slip, mu / gamma * f[3]) : slip;
    double twist = gamma > 0.0 ? fabs(f[3]) / gamma - f[2] : fabs(f[3]);
    return max_or_nan(max_or_nan(positive_part(-f[2]), positive_part(load - mu * f[2])), positive_part(twist));
}

/* Return the amount by which z_n is too small for z to be in the dual cone. */
static double dual_distance(const double *z, double mu, double gamma)
{
    double tangential = mu * hypot(z[0], z[1]);
    return positive_part((gamma > 0.0 ? hypot(tangential, gamma * z[3]) : tangential) - z[2]);
}

/* Return aᵀb, in four partial sums. */
static double dot(int count, const double *a, const double *b)
{
    double sum[4] = {0.0, 0.0, 0.0, 0.0};
    int i = 0;
    for (; i + 4 <= count; i += 4)
        for (int q = 0; q < 4; q++) sum[q] += a[i + q] * b[i + q];
    for (; i < count; i++) sum[0] += a[i] * b[i];
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

/* Compute b ← b − factor a. */
static void subtract(int count, double factor, const double *restrict a, double *restrict b)
{
    for (int i = 0; i < count; i++) b[i] -= factor * a[i];
}

/* A row of J: entry[j] belongs to motor first + j, 0 ≤ j < count; all other entries are zero. */
typedef struct {
    int first, count;
    const double *entry;
} gf_jacobian_row;

/* Return row c of J, which is stored at `at`; advance `at` to the next row. */
static gf_jacobian_row next_row(const gf_structure *s, int c, const double **at)
{
    int first = s->span ? s->span[2 * c] : 0, last = s->span ? s->span[2 * c + 1] : s->joints;
    gf_jacobian_row J = {first, last - first, *at};
    *at += last - first;
    return J;
}

/* Return the largest violation of cones and limits. Add Σ multiplier · slack of all limits to `gap`, and raise
 * `largest_normal` to the largest normal force. */
static double limits(const gf_structure *s, const gf_problem *problem, const gf_solution *x, const gf_units *unit,
                     const double *tau, double *gap, double *largest_normal)
{
    double primal = 0.0;
    for (int i = 0, c = 0; i < s->contacts; c += s->components[i++]) {
        double f[4], gamma = s->components[i] == 4 ? problem->gamma[i] : 0.0, mu = s->components[i] > 1 ? problem->mu[i] : 0.0;
        pad(s->components[i], x->f + c, f);
        double below = f[2] - problem->min_normal[i], above = problem->max_normal[i] - f[2];
        primal = max_or_nan(primal, cone_violation(f, mu, gamma) / unit->force);
        primal = max_or_nan(primal, max_or_nan(positive_part(-below), positive_part(-above)) / unit->force);
        *gap += multiplier_times_slack(x->nu_lower[i], below) + multiplier_times_slack(x->nu_upper[i], above);
        *largest_normal = max_or_nan(*largest_normal, fabs(f[2]));
    }
    for (int j = 0; j < s->joints; j++) {
        double below = tau[j] - problem->lower[j], above = problem->upper[j] - tau[j];
        primal = max_or_nan(primal, max_or_nan(positive_part(-below), positive_part(-above)) / unit->torque[j]);
        *gap += multiplier_times_slack(x->lambda_lower[j], below) + multiplier_times_slack(x->lambda_upper[j], above);
    }
    return primal;
}

/* Return the largest cost that wrong signs and a z outside K* could hide. The cost hidden by z is at most its distance from
 * K* times the largest normal force that the contact can apply. */
static double hidden_cost_bound(const gf_structure *s, const gf_problem *problem, const gf_solution *x, const gf_units *unit,
                                const double *z, const double *tau, double largest_normal)
{
    double dual = 0.0;
    for (int i = 0, c = 0; i < s->contacts; c += s->components[i++]) {
        double padded[4], gamma = s->components[i] == 4 ? problem->gamma[i] : 0.0,
                          mu = s->components[i] > 1 ? problem->mu[i] : 0.0;
        pad(s->components[i], z + c, padded);
        double normal_bound = problem->max_normal[i] < largest_normal ? problem->max_normal[i] : largest_normal;
        dual = max_or_nan(dual, dual_distance(padded, mu, gamma) * normal_bound);
        dual = max_or_nan(dual, max_or_nan(-x->nu_lower[i], -x->nu_upper[i]) * largest_normal);
    }
    for (int j = 0; j < s->joints; j++) {
        double torque_bound = max_or_nan(unit->torque[j], fabs(tau[j]));
        dual = max_or_nan(dual, max_or_nan(-x->lambda_lower[j], -x->lambda_upper[j]) * torque_bound);
    }
    return dual;
}

/* A lever arm below this fraction of the largest one is rounding. */
static const double NEGLIGIBLE_LEVER = GF_BY_PRECISION(1e-14, 1e-6);

/* Return size / lever, or zero if there is no lever. */
static double divide_or_zero(double size, double lever)
{
    return lever > 0.0 ? size / lever : 0.0;
}

/* Compute the largest torque of each joint under a unit force at any contact, (n), N·m per N. Return the largest of all. */
static double unit_force_torques(const gf_structure *s, const gf_problem *problem, double length, double *unit_torque)
{
    const int n = s->joints;
    const double *at = problem->J;
    double largest = 0.0;
    for (int j = 0; j < n; j++) unit_torque[j] = 0.0;
    for (int i = 0, component = 0; i < s->contacts; i++)
        for (int c = 0; c < s->components[i]; c++, component++) {
            gf_jacobian_row J = next_row(s, component, &at);
            int normal = c == (s->components[i] == 1 ? 0 : 2);
            double bound = normal                          ? INFINITY
                           : problem->max_normal[i] == 0.0 ? 0.0
                           : c == 3                        ? problem->gamma[i]
                                                           : problem->mu[i];
            double unit = c == 3 ? length : 1.0;
            for (int j = 0; j < J.count && bound > 0.0; j++) {
                double load = fabs(J.entry[j]) * unit, *largest_load = unit_torque + J.first + j;
                *largest_load = load > *largest_load ? load : *largest_load;
            }
        }
    for (int j = 0; j < n; j++) largest = max_or_nan(largest, unit_torque[j]);
    for (int j = 0; j < n; j++)
        if (!(unit_torque[j] > NEGLIGIBLE_LEVER * largest)) unit_torque[j] = 0.0;
    return largest;
}

/* Write ρ_c f_c, the gradient of ½ ρ ‖f‖², to `gradient`; ρ_c is ρ/ℓ² for moments. Return ½ ρ ‖f‖². */
static double weighted_forces(const gf_structure *s, const gf_problem *problem, const double *f, double *gradient)
{
    const double length = problem->moment_length > 0.0 ? problem->moment_length : 1.0;
    double sum = 0.0;
    for (int i = 0, component = 0; i < s->contacts; i++)
        for (int c = 0; c < s->components[i]; c++, component++) {
            gradient[component] = problem->force_weight / (c == 3 ? length * length : 1.0) * f[component];
            sum += 0.5 * gradient[component] * f[component];
        }
    return sum;
}

void gf_problem_units(const gf_structure *s, const gf_problem *problem, double length, double *torque, gf_units *units)
{
    const double *w = problem->w;
    double *unit_torque = torque, largest_lever = unit_force_torques(s, problem, length, unit_torque), lever = 0.0,
           weighted_bias = 0.0, largest_bias = 0.0;
    double force = max_or_nan(hypot(hypot(w[0], w[1]), w[2]), hypot(hypot(w[3], w[4]), w[5]) / length);
    for (int i = 0; i < s->contacts; i++) force = max_or_nan(force, problem->min_normal[i]);
    for (int j = 0; j < s->joints; j++) {
        double root = sqrt(problem->weight[j]), bias = fabs(problem->tau_u[j]);
        double excess = max_or_nan(problem->lower[j] - problem->tau_u[j], problem->tau_u[j] - problem->upper[j]);
        if (excess > 0.0) force = max_or_nan(force, divide_or_zero(excess, unit_torque[j]));
        lever = max_or_nan(lever, root * unit_torque[j]);
        if (unit_torque[j] > 0.0) weighted_bias = max_or_nan(weighted_bias, root * bias);
        largest_bias = max_or_nan(largest_bias, bias);
    }
    force = max_or_nan(force, divide_or_zero(weighted_bias, lever));
    if (force == 0.0) force = divide_or_zero(largest_bias, largest_lever);
    if (force == 0.0) force = 1.0;

    int k = 0;
    double slope = 0.0;
    for (int i = 0; i < s->contacts; i++) k += s->components[i];
    for (int c = 0; c < k && problem->cost; c++) slope = max_or_nan(slope, fabs(problem->cost[c]));
    double cost = slope > 0.0 ? slope * force : (lever * lever + problem->force_weight) * (force * force);
    for (int j = 0; j < s->joints; j++) {
        double bias = fabs(problem->tau_u[j]);
        torque[j] = bias == 0.0 && unit_torque[j] == 0.0 ? 1.0 : max_or_nan(bias, unit_torque[j] * force);
    }
    *units = (gf_units){force, length, cost == 0.0 ? 1.0 : cost, torque};
}

int gf_certify(const gf_structure *s, const gf_problem *problem, const gf_solution *x, const gf_units *unit, double *tau,
               double *z, double *scratch, gf_residuals *residuals)
{
    if (s->facets > 0 || s->level != GF_LEVEL_NONE) return 0;
    int k = 0, n = s->joints;
    for (int i = 0; i < s->contacts; i++) k += s->components[i];

    /* tau = tau_u + Jᵀ f and cost = ½ tauᵀ W tau + ½ ρ ‖f‖² + cᵀf */
    for (int j = 0; j < n; j++) tau[j] = problem->tau_u[j];
    const double *at = problem->J;
    for (int c = 0; c < k; c++) {
        gf_jacobian_row J = next_row(s, c, &at);
        for (int j = 0; j < J.count; j++) tau[J.first + j] += J.entry[j] * x->f[c];
    }
    double cost = weighted_forces(s, problem, x->f, z) + (problem->cost ? dot(k, problem->cost, x->f) : 0.0);
    for (int j = 0; j < n; j++) cost += 0.5 * problem->weight[j] * tau[j] * tau[j];

    /* G f − w, and yᵀ(G f − w) */
    double primal = 0.0, gap = 0.0;
    for (int r = 0; r < 6; r++) {
        double error = dot(k, problem->G + (size_t)r * (size_t)k, x->f) - problem->w[r];
        primal = max_or_nan(primal, fabs(error) / (r < 3 ? unit->force : unit->force * unit->length));
        gap += x->y[r] * error;
    }

    double largest_normal = unit->force;
    primal = max_or_nan(primal, limits(s, problem, x, unit, tau, &gap, &largest_normal));

    /* z, with the price W tau − lambda_lower + lambda_upper of each motor torque */
    double *price = scratch;
    for (int j = 0; j < n; j++) price[j] = problem->weight[j] * tau[j] - x->lambda_lower[j] + x->lambda_upper[j];
    at = problem->J;
    for (int c = 0; c < k; c++) {
        gf_jacobian_row J = next_row(s, c, &at);
        z[c] += dot(J.count, J.entry, price + J.first) + (problem->cost ? problem->cost[c] : 0.0);
    }
    for (int r = 0; r < 6; r++) subtract(k, x->y[r], problem->G + (size_t)r * (size_t)k, z);
    for (int i = 0, c = 0; i < s->contacts; c += s->components[i++])
        z[s->components[i] == 1 ? c : c + 2] += x->nu_upper[i] - x->nu_lower[i];

    gap += dot(k, z, x->f);
    double total = unit->cost + fabs(cost), dual = hidden_cost_bound(s, problem, x, unit, z, tau, largest_normal);
    if (!isfinite(total)) total = NAN; /* residuals relative to an infinite cost are meaningless */
    *residuals = (gf_residuals){primal, dual / total, fabs(gap) / total};
    if (!isfinite(residuals->primal)) residuals->primal = DBL_MAX;
    if (!isfinite(residuals->dual)) residuals->dual = DBL_MAX;
    if (!isfinite(residuals->gap)) residuals->gap = DBL_MAX;
    return 1;
}

/* ---- infeasibility ------------------------------------------------------------------------------------------------------ */

static const double PROOF_FRICTION_RANGE = 1e3; /* times the largest inverse friction coefficient: forces that a proof covers */
static const double ROUNDING = 8.0 * DBL_EPSILON; /* relative rounding error of a few operations */

/* Return the multiplier of a limit: zero if it is negative or the limit is absent. */
static double limit_multiplier(double multiplier, double limit)
{
    return isfinite(limit) && !(multiplier <= 0.0) ? multiplier : 0.0;
}

/* Value of a proof of infeasibility, bounds on its errors, and its largest number. */
typedef struct {
    double value, rounding, largest;
} gf_proof_sums;

/* Add multiplier · limit, whose parts have the sum of sizes `size`. */
static void add_term(gf_proof_sums *sums, double multiplier, double limit, double size)
{
    if (multiplier == 0.0) return;
    double term = multiplier * limit;
    sums->value += term;
    sums->rounding += ROUNDING * fabs(multiplier) * size;
    sums->largest = max_or_nan(sums->largest, fabs(term));
}

/* Compute z = −Gᵀ y − E_n (nu_lower − nu_upper) − J (lambda_lower − lambda_upper) and the sum of the sizes of its terms, and
 * add the terms of the torque limits. */
static void proof_multipliers(const gf_structure *s, const gf_problem *problem, const gf_solution *x, int k, double *z,
                              double *size, gf_proof_sums *sums)
{
    for (int c = 0; c < k; c++) z[c] = size[c] = 0.0;
    for (int r = 0; r < 6; r++) {
        subtract(k, x->y[r], problem->G + (size_t)r * (size_t)k, z);
        for (int c = 0; c < k; c++) size[c] += fabs(x->y[r] * problem->G[(size_t)r * (size_t)k + (size_t)c]);
    }
    for (int j = 0; j < s->joints; j++) {
        const double lower = problem->lower[j], upper = problem->upper[j], tau_u = problem->tau_u[j];
        add_term(sums, limit_multiplier(x->lambda_lower[j], lower), lower - tau_u, fabs(lower) + fabs(tau_u));
        add_term(sums, limit_multiplier(x->lambda_upper[j], upper), tau_u - upper, fabs(upper) + fabs(tau_u));
    }
    const double *at = problem->J;
    for (int c = 0; c < k; c++) {
        gf_jacobian_row J = next_row(s, c, &at);
        for (int j = J.first; j < J.first + J.count; j++) {
            const double lower = limit_multiplier(x->lambda_lower[j], problem->lower[j]);
            const double upper = limit_multiplier(x->lambda_upper[j], problem->upper[j]);
            z[c] -= J.entry[j - J.first] * (lower - upper);
            size[c] += fabs(J.entry[j - J.first]) * (lower + upper);
        }
    }
}

/* Return the force up to which a proof must hold, in units of F: small friction needs large normal forces. */
static double required_range(const gf_structure *s, const gf_problem *problem, double length)
{
    double smoothest = 1.0;
    for (int i = 0; i < s->contacts; i++) {
        const double mu = s->components[i] > 1 ? problem->mu[i] : 0.0;
        const double gamma = s->components[i] == 4 ? problem->gamma[i] / length : 0.0;
        if (mu > 0.0 && mu < smoothest) smoothest = mu;
        if (gamma > 0.0 && gamma < smoothest) smoothest = gamma;
    }
    return fmax(GF_PROOF_RANGE, PROOF_FRICTION_RANGE / fmax(smoothest, DBL_MIN));
}

int gf_certify_infeasibility(const gf_structure *s, const gf_problem *problem, const gf_solution *x, const gf_units *unit,
                             const double *w_size, double *scratch, double *residual, double *value)
{
    int k = 0;
    for (int i = 0; i < s->contacts; i++) k += s->components[i];
    double *z = scratch, *size = scratch + k, open_distance = 0.0;
    gf_proof_sums sums = {0.0, 0.0, 0.0};
    *residual = *value = 0.0;
    if (s->facets > 0) return 0;
    for (int r = 0; r < 6; r++) add_term(&sums, x->y[r], problem->w[r], w_size[r]);
    proof_multipliers(s, problem, x, k, z, size, &sums);
    for (int i = 0, c = 0; i < s->contacts; c += s->components[i++]) {
        const double mu = s->components[i] > 1 ? problem->mu[i] : 0.0, gamma = s->components[i] == 4 ? problem->gamma[i] : 0.0;
        const double most = problem->max_normal[i], lower = limit_multiplier(x->nu_lower[i], problem->min_normal[i]);
        double upper = limit_multiplier(x->nu_upper[i], most), padded[4];
        const int normal = s->components[i] == 1 ? c : c + 2;
        z[normal] -= lower - upper;
        pad(s->components[i], z + c, padded);
        const double distance = dual_distance(padded, mu, gamma);
        if (isfinite(most)) /* a larger nu_upper puts z back into K* */
            upper += distance;
        else
            open_distance += distance;
        add_term(&sums, lower, problem->min_normal[i], problem->min_normal[i]);
        add_term(&sums, -upper, most, most);
        pad(s->components[i], size + c, padded);
        const double tangential = mu * (padded[0] + padded[1]) + gamma * padded[3];
        sums.rounding += ROUNDING * unit->force * (padded[2] + lower + upper + tangential);
    }
    for (int c = 0; c < k; c++)
        if (!isfinite(z[c])) return 0;
    if (!(sums.largest > 0.0) || !isfinite(sums.largest) || !isfinite(sums.value)) return 0;
    *value = sums.value / sums.largest;
    *residual = open_distance * unit->force * (required_range(s, problem, unit->length) / GF_PROOF_RANGE) / sums.largest;
    return sums.value > sums.rounding && *residual * GF_PROOF_RANGE <= *value;
}
