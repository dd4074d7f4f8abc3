/* Certificates of rigorous.h: running error bounds of sums, with u = 2⁻⁵³ the unit roundoff.
 *
 * A sum of m products has an error of at most (m + 1) u Σ|terms| plus the errors of its terms. The bounds themselves are
 * computed in floating point; SLACK covers their rounding, and TINY underflow.
 */
#include "graspforce/rigorous.h"

#include <float.h>
#include <math.h>
#include <stddef.h>

static const double U = 0.5 * DBL_EPSILON;
static const double SLACK = 1.0 + 1e-9; /* rounding of bounds: fewer than 10⁶ operations each */
static const double TINY = 1e-300;      /* more than the underflow of all products of a sum */

/* A number within `error` of `value`. */
typedef struct {
    double value, error;
} gf_ball;

/* A sum of balls: its terms' sizes and errors. */
typedef struct {
    double value, size, error;
    int count;
} gf_sum;

/* Add the product of two balls to a sum. */
static void add_product(gf_sum *sum, gf_ball a, gf_ball b)
{
    const double product = a.value * b.value;
    sum->value += product;
    sum->size += fabs(product);
    sum->error += fabs(a.value) * b.error + fabs(b.value) * a.error + a.error * b.error;
    sum->count++;
}

static gf_ball exact(double value)
{
    return (gf_ball){value, 0.0};
}

/* Return a sum with the bound on its error. */
static gf_ball total(gf_sum sum)
{
    return (gf_ball){sum.value, SLACK * (sum.error + (sum.count + 2) * U * sum.size) + TINY};
}

/* Return a − b of two numbers. */
static gf_ball difference(gf_ball a, gf_ball b)
{
    const double value = a.value - b.value;
    return (gf_ball){value, SLACK * (a.error + b.error + U * fabs(value)) + TINY};
}

static double upper_end(gf_ball a)
{
    return a.value + a.error + SLACK * U * (fabs(a.value) + a.error) + TINY;
}

static double lower_end(gf_ball a)
{
    return -upper_end((gf_ball){-a.value, a.error});
}

static double larger(double a, double b)
{
    return b > a || isnan(b) ? b : a; /* NaN stays */
}

/* Return a multiplier that is used: zero if it is negative or its limit is absent. */
static double used(double multiplier, double limit)
{
    return isfinite(limit) && !(multiplier <= 0.0) ? multiplier : 0.0;
}

static int normal_row(const gf_structure *s, int contact)
{
    return s->components[contact] == 1 ? 0 : 2;
}

#include "cone_data.inc"

/* Compute a b = product + error exactly. */
static double exact_product(double a, double b, double *error)
{
    const double product = a * b;
    *error = fma(a, b, -product);
    return product;
}

/* Compute a + b = sum + error exactly. */
static double exact_sum(double a, double b, double *error)
{
    const double sum = a + b, part = sum - a;
    *error = (a - (sum - part)) + (b - part);
    return sum;
}

/* Compute the wrench about c. The moment can be a small difference of large numbers, so that it is summed with twice the
 * digits. */
static void wrench_about(const double *w, const double *c, gf_ball *result)
{
    for (int a = 0; a < 3; a++) {
        const int i = (a + 1) % 3, j = (a + 2) % 3;
        double low[4];
        const double first = exact_product(-c[i], w[j], &low[0]), second = exact_product(c[j], w[i], &low[1]);
        const double high = exact_sum(exact_sum(w[3 + a], first, &low[2]), second, &low[3]);
        const double value = high + ((low[0] + low[1]) + (low[2] + low[3]));
        const double size = fabs(w[3 + a]) + fabs(first) + fabs(second);
        result[a] = exact(w[a]);
        result[3 + a] = (gf_ball){value, SLACK * (U * fabs(value) + 16.0 * U * U * size) + TINY};
    }
}

/* Compute tau = tau_u + Jᵀ f, (n) values and (n) errors. */
static void motor_torques(const gf_structure *s, const gf_problem *problem, int k, const double *f, double *tau, double *error)
{
    const int n = s->joints;
    for (int j = 0; j < n; j++) tau[j] = problem->tau_u[j], error[j] = fabs(tau[j]);
    for (int c = 0; c < k; c++) {
        const double *row = problem->J + (size_t)c * (size_t)n;
        for (int j = 0; j < n; j++) {
            const double load = row[j] * f[c];
            tau[j] += load;
            error[j] += fabs(load);
        }
    }
    for (int j = 0; j < n; j++) error[j] = SLACK * (k + 2) * U * error[j] + TINY;
}

/* Compute the price W tau − lambda_lower + lambda_upper of each torque; without tau, W counts as zero. */
static void torque_prices(const gf_structure *s, const gf_problem *problem, const gf_solution *x, const double *tau,
                          const double *tau_error, double *price, double *error)
{
    for (int j = 0; j < s->joints; j++) {
        const double lower = used(x->lambda_lower[j], problem->lower[j]), upper = used(x->lambda_upper[j], problem->upper[j]);
        const double own = tau != NULL ? problem->weight[j] * tau[j] : 0.0;
        const double carried = tau != NULL ? problem->weight[j] * tau_error[j] : 0.0;
        price[j] = own - lower + upper;
        error[j] = SLACK * (carried + 4.0 * U * (fabs(own) + lower + upper)) + TINY;
    }
}

/* Geometry of a contact: v = y_f + y_m × (p − c), whose product with an axis is that of y with a column of G. */
static void wrench_price(const double *y, const double *arm, gf_ball *v)
{
    for (int a = 0; a < 3; a++) {
        const int i = (a + 1) % 3, j = (a + 2) % 3;
        const double first = y[3 + i] * arm[j], second = y[3 + j] * arm[i];
        v[a] = (gf_ball){y[a] + (first - second), SLACK * 6.0 * U * (fabs(y[a]) + fabs(first) + fabs(second)) + TINY};
    }
}

/* Return z of one force component: the gradient of the cost, if `with_cost`, less all multipliers but those of the cones. */
static gf_ball cone_multiplier(const gf_structure *s, const gf_problem *problem, const gf_contact_places *at,
                               const gf_solution *x, const gf_ball *v, const double *prices, int contact, int c, int row,
                               int with_cost)
{
    const int n = s->joints, axis = s->components[contact] == 1 ? 2 : c;
    const double *price = prices, *price_error = prices + n, *J = problem->J + (size_t)row * (size_t)n;
    gf_sum sum = {0.0, 0.0, 0.0, n};
    double value = 0.0, size = 0.0, error = 0.0;
    for (int j = 0; j < n; j++) {
        const double load = J[j] * price[j];
        value += load;
        size += fabs(load);
        error += fabs(J[j]) * price_error[j];
    }
    sum.value = value, sum.size = size, sum.error = error;
    for (int a = 0; a < 3; a++) {
        const gf_ball along = c == 3 ? exact(x->y[3 + a]) : v[a];
        add_product(&sum, exact(-at->R[9 * contact + 3 * a + (c == 3 ? 2 : axis)]), along);
    }
    if (c == normal_row(s, contact)) {
        const double below = used(x->nu_lower[contact], 0.0), above = used(x->nu_upper[contact], problem->max_normal[contact]);
        add_product(&sum, exact(-1.0), exact(below));
        add_product(&sum, exact(1.0), exact(above));
    }
    if (with_cost) {
        const double unit = c == 3 ? at->moment_length * at->moment_length : 1.0, weight = problem->force_weight / unit;
        add_product(&sum, (gf_ball){weight, 4.0 * U * weight}, exact(x->f[row]));
        if (problem->cost != NULL) add_product(&sum, exact(1.0), exact(problem->cost[row]));
    }
    return total(sum);
}

/* Return an upper bound on the normal component that moves z into K*. */
static double cone_distance(const gf_ball *z, int components, double mu, double gamma)
{
    if (components == 1) return larger(0.0, -lower_end(z[0]));
    const double t1 = fabs(z[0].value) + z[0].error, t2 = fabs(z[1].value) + z[1].error;
    double needed = mu * hypot(t1, t2);
    if (components == 4) needed = hypot(needed, gamma * (fabs(z[3].value) + z[3].error));
    const gf_ball missing = difference((gf_ball){needed * (1.0 + 16.0 * U), 0.0}, z[2]);
    return larger(0.0, upper_end(missing));
}

/* Return the pyramid of a contact, with the first vertex of the rest; without vertices the cone is exact. */
static gf_pyramid contact_pyramid(const gf_structure *s, const gf_problem *problem, const gf_cone_data *cones, int contact,
                                  const double **rest)
{
    const int count = cones != NULL && cones->vertices != NULL && s->components[contact] > 1 ? cones->vertices[contact] : 0;
    const double gamma = s->components[contact] == 4 ? problem->gamma[contact] : 0.0;
    const gf_pyramid pyramid = {count, s->components[contact], count > 0 && cones->separate_moment, gamma, *rest};
    *rest += 2 * count;
    return pyramid;
}

/* Compute z of a contact, and the number that moves it into K*. */
static double contact_multipliers(const gf_structure *s, const gf_problem *problem, const gf_contact_places *at,
                                  const gf_pyramid *pyramid, const gf_solution *x, const double *prices, int contact, int first,
                                  int with_cost, gf_ball *z)
{
    double arm[3];
    gf_ball v[3];
    for (int a = 0; a < 3; a++) arm[a] = at->p[3 * contact + a] - at->point[a];
    wrench_price(x->y, arm, v);
    for (int c = 0; c < s->components[contact]; c++)
        z[c] = cone_multiplier(s, problem, at, x, v, prices, contact, c, first + c, with_cost);
    const int components = s->components[contact];
    if (pyramid->count > 0) return pyramid_distance(pyramid, z);
    return cone_distance(z, components, components > 1 ? problem->mu[contact] : 0.0,
                         components == 4 ? problem->gamma[contact] : 0.0);
}

/* Add the wrench of a contact's force to six sums. */
static void add_wrench(const gf_contact_places *at, const double *f, int components, int contact, gf_sum *sums)
{
    const double *R = at->R + 9 * contact;
    gf_ball force[3], arm[3];
    for (int a = 0; a < 3; a++) {
        gf_sum sum = {0.0, 0.0, 0.0, 0};
        for (int c = 0; c < components && c < 3; c++)
            add_product(&sum, exact(R[3 * a + (components == 1 ? 2 : c)]), exact(f[c]));
        force[a] = total(sum);
        const double offset = at->p[3 * contact + a] - at->point[a];
        arm[a] = (gf_ball){offset, U * fabs(offset)};
        add_product(&sums[a], exact(1.0), force[a]);
    }
    for (int a = 0; a < 3; a++) {
        const int i = (a + 1) % 3, j = (a + 2) % 3;
        add_product(&sums[3 + a], arm[i], force[j]);
        add_product(&sums[3 + a], (gf_ball){-arm[j].value, arm[j].error}, force[i]);
        if (components == 4) add_product(&sums[3 + a], exact(R[3 * a + 2]), exact(f[3]));
    }
}

/* Return the largest amount by which a contact force may be outside its cone, less a slip margin, and its limits, N. */
static double force_violation(const double *f, int components, double mu, double gamma, double lowest, double highest,
                              double margin)
{
    const double normal = f[components == 1 ? 0 : 2];
    double worst = larger(-normal, larger(lowest - normal, normal - highest));
    if (components > 1) {
        double load = hypot(f[0], f[1]);
        if (components == 4 && gamma > 0.0) {
            load = hypot(load, mu / gamma * f[3]);
            worst = larger(worst, fabs(f[3]) / gamma - normal);
        } else if (components == 4) {
            worst = larger(worst, fabs(f[3]));
        }
        worst = larger(worst, load - (mu * normal - margin) + 16.0 * U * (load + mu * fabs(normal) + fabs(margin)));
    }
    return larger(0.0, worst + 16.0 * U * (fabs(worst) + fabs(normal))) * (1.0 + 16.0 * U);
}

/* Return the largest amount by which a contact force may be outside its cone or pyramid and its limits, N. */
static double contact_violation(const gf_problem *problem, const gf_pyramid *pyramid, const gf_cone_data *cones,
                                const double *f, int contact)
{
    const double mu = pyramid->components > 1 ? problem->mu[contact] : 0.0, least = problem->min_normal[contact];
    const double facet = cones != NULL && cones->facet_friction != NULL ? cones->facet_friction[contact] : 0.0;
    const double margin = facet > 0.0 ? cones->slip_margin : 0.0, most = problem->max_normal[contact];
    if (pyramid->count == 0) return force_violation(f, pyramid->components, mu, pyramid->gamma, least, most, margin);
    const double shift = facet > 0.0 ? margin / facet : 0.0;
    const double cone = pyramid_violation(pyramid, f, (gf_ball){shift, SLACK * U * fabs(shift) + TINY});
    const double limits = larger(least - f[2], f[2] - most);
    return larger(cone, limits + 16.0 * U * (fabs(limits) + fabs(f[2])));
}

int gf_bound_optimality(const gf_structure *s, const gf_problem *problem, const gf_contact_places *at,
                        const gf_cone_data *cones, const gf_solution *x, const gf_units *units, double reach, double *scratch,
                        double *distance, gf_proven_bounds *bounds)
{
    if (s->facets > 0 || s->span != NULL) return 0;
    const int n = s->joints;
    int k = 0;
    for (int i = 0; i < s->contacts; i++) k += s->components[i];
    double *tau = scratch, *tau_error = scratch + n, *prices = scratch + 2 * n, violation = 0.0, open = 0.0;
    motor_torques(s, problem, k, x->f, tau, tau_error);
    torque_prices(s, problem, x, tau, tau_error, prices, prices + n);

    const int is_margin = cones != NULL && cones->facet_friction != NULL;
    const double *vertex = cones != NULL ? cones->vertex : NULL;
    gf_sum gap = {0.0, 0.0, 0.0, 0}, balance[6] = {{0.0, 0.0, 0.0, 0}}, shares = {0.0, 0.0, 0.0, 0};
    for (int i = 0, first = 0; i < s->contacts; first += s->components[i++]) {
        const int components = s->components[i];
        const double *f = x->f + first, most = problem->max_normal[i], normal = f[normal_row(s, i)];
        const gf_pyramid pyramid = contact_pyramid(s, problem, cones, i, &vertex);
        gf_ball z[4];
        distance[i] = contact_multipliers(s, problem, at, &pyramid, x, prices, i, first, !is_margin, z);
        add_wrench(at, f, components, i, balance);
        for (int c = 0; c < components; c++) add_product(&gap, z[c], exact(f[c]));
        const gf_ball below = difference(exact(normal), exact(problem->min_normal[i]));
        add_product(&gap, exact(used(x->nu_lower[i], 0.0)), below);
        if (isfinite(most)) {
            add_product(&gap, exact(used(x->nu_upper[i], most)), difference(exact(most), exact(normal)));
            add_product(&gap, exact(distance[i]), exact(most));
        } else {
            open = larger(open, distance[i]);
        }
        if (is_margin && cones->facet_friction[i] > 0.0) {
            const double facet = cones->facet_friction[i], inverse = 1.0 / facet;
            const gf_ball along = {inverse, U * inverse + TINY};
            add_product(&shares, z[normal_row(s, i)], along);
            add_product(&shares, exact(distance[i]), along);
        }
        violation = larger(violation, contact_violation(problem, &pyramid, cones, f, i) / units->force);
    }
    add_product(&gap, exact(open), exact(reach));
    for (int j = 0; j < n; j++) {
        const gf_ball torque = {tau[j], tau_error[j]};
        const double lower = problem->lower[j], upper = problem->upper[j], unit = units->torque[j];
        if (isfinite(lower)) {
            const gf_ball slack = difference(torque, exact(lower));
            add_product(&gap, exact(used(x->lambda_lower[j], lower)), slack);
            violation = larger(violation, -lower_end(slack) / unit);
        }
        if (isfinite(upper)) {
            const gf_ball slack = difference(exact(upper), torque);
            add_product(&gap, exact(used(x->lambda_upper[j], upper)), slack);
            violation = larger(violation, -lower_end(slack) / unit);
        }
    }
    gf_ball w[6];
    wrench_about(problem->w, at->point, w);
    for (int r = 0; r < 6; r++) {
        const gf_ball error = difference(total(balance[r]), w[r]);
        add_product(&gap, exact(x->y[r]), error);
        const double size = larger(upper_end(error), -lower_end(error));
        violation = larger(violation, size / (r < 3 ? units->force : units->force * units->length));
    }
    if (cones != NULL && cones->level != NULL) add_largest_normal(s, cones, x->f, &gap);
    const double excess = is_margin ? margin_gap(total(gap), total(shares), cones->slip_margin) : upper_end(total(gap));
    *bounds = (gf_proven_bounds){violation * (1.0 + 16.0 * U), larger(0.0, excess), 0.0, open > 0.0 ? reach : INFINITY};
    return 1;
}

int gf_prove_infeasibility(const gf_structure *s, const gf_problem *problem, const gf_contact_places *at,
                           const gf_cone_data *cones, const gf_solution *x, double *scratch, double *distance,
                           gf_proven_bounds *bounds)
{
    *bounds = (gf_proven_bounds){0.0, 0.0, 0.0, 0.0};
    if (s->facets > 0 || s->span != NULL) return 0;
    const double *vertex = cones != NULL ? cones->vertex : NULL;
    double *prices = scratch, open = 0.0;
    torque_prices(s, problem, x, NULL, NULL, prices, prices + s->joints);
    gf_sum value = {0.0, 0.0, 0.0, 0};
    for (int i = 0, first = 0; i < s->contacts; first += s->components[i++]) {
        const double most = problem->max_normal[i];
        const gf_pyramid pyramid = contact_pyramid(s, problem, cones, i, &vertex);
        gf_ball z[4];
        distance[i] = contact_multipliers(s, problem, at, &pyramid, x, prices, i, first, 0, z);
        add_product(&value, exact(used(x->nu_lower[i], 0.0)), exact(problem->min_normal[i]));
        if (isfinite(most)) {
            add_product(&value, exact(-used(x->nu_upper[i], most)), exact(most));
            add_product(&value, exact(-distance[i]), exact(most));
        } else {
            open = larger(open, distance[i]);
        }
    }
    for (int j = 0; j < s->joints; j++) {
        const gf_ball bias = exact(problem->tau_u[j]);
        const double lower = used(x->lambda_lower[j], problem->lower[j]), upper = used(x->lambda_upper[j], problem->upper[j]);
        if (lower > 0.0) add_product(&value, exact(lower), difference(exact(problem->lower[j]), bias));
        if (upper > 0.0) add_product(&value, exact(-upper), difference(exact(problem->upper[j]), bias));
    }
    gf_ball w[6];
    wrench_about(problem->w, at->point, w);
    for (int r = 0; r < 6; r++) add_product(&value, exact(x->y[r]), w[r]);
    const double least = lower_end(total(value)), largest = value.size;
    if (!(least > 0.0) || !isfinite(largest) || !isfinite(open)) return 0;
    bounds->value = least / largest;
    bounds->reach = open > 0.0 ? least / open * (1.0 - 16.0 * U) : INFINITY;
    return 1;
}
