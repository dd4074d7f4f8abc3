/* Implementation of friction_bounds.h. */
#include "graspforce/friction_bounds.h"

#include <math.h>
#include <string.h>

enum { STICK_STEPS = 8 };               /* periods between two updates of the lower bounds */
static const double ARM = 0.03;         /* m: slip turns the normal by its length over this one */
static const double UNIFORM = 1.0 / 12; /* variance of a uniform part of 1 */
static const double ALIGNED = 0.7;      /* least cosine of the angle between slip and force */
static const double PARALLEL = 0.95;    /* the same if another finger is nearly as likely to slip */
static const double WEAK = 0.15;        /* of a ratio: standard deviation above which a slip shows nothing */
static const double WEAK_RATIO = 0.023; /* the least such deviation */
static const double STEADY = 3.0;       /* standard deviations up to which a ratio counts as constant */
static const double CHANGED = 3.0;      /* standard deviations from which a coefficient has changed */

/* Mean force of a contact, its ratio, and the standard deviations of the momentary and of the mean ratio. */
typedef struct {
    double t1, t2, ratio, noise, deviation;
} gf_force_ratio;

/* Copy the state that a step may leave as it was. */
static void gf_copy_bounds(const gf_bound_settings *settings, const gf_bound_state *last, const gf_bound_state *next)
{
    const size_t contact_count = (size_t)settings->contact_count;
#define GF_PRODUCT(a, b, ...) ((a) * (b))
#define GF_COPY(name, ...)    memcpy(next->name, last->name, GF_PRODUCT(__VA_ARGS__, 1, 1) * sizeof(double));
    GF_BOUND_STATE_FIELDS(GF_COPY)
#undef GF_COPY
#undef GF_PRODUCT
}

/* Compute the ratio of contact i with the mean force f, after slip that moved the contact with a variance, m². */
static gf_force_ratio gf_compute_ratio(const gf_bound_settings *settings, const gf_bound_inputs *inputs, int i, const double *f,
                                       double slid_variance)
{
    const int rows = 3 * settings->contact_count;
    const double n = f[2], ratio = hypot(f[0], f[1]) / n, gain = settings->gain[0];
    const double model = settings->ratio_error[0] * settings->ratio_error[0] + slid_variance / (ARM * ARM);
    double noise, bias, inertial = 0.0;
    if (inputs->has_tips) {
        noise = settings->variance[0] * (1.0 + ratio * ratio) / (n * n);
        bias = settings->variance[1] * (1.0 + ratio * ratio) / (n * n);
    } else {
        const double *N = inputs->gains->noise + (rows + 1) * (3 * i), *B = inputs->gains->bias + (rows + 1) * (3 * i);
        const double *a = inputs->forces->inertial + 3 * i;
        noise = (fmax(N[0], N[rows + 1]) + ratio * ratio * N[2 * (rows + 1)]) / (n * n);
        bias = (fmax(B[0], B[rows + 1]) + ratio * ratio * B[2 * (rows + 1)]) / (n * n);
        inertial = (a[0] * a[0] + a[1] * a[1] + a[2] * a[2]) / (n * n);
    }
    const double mean = gain / (2.0 - gain) * noise + bias + inertial + model;
    return (gf_force_ratio){f[0], f[1], ratio, sqrt(noise + inertial), sqrt(mean)};
}

/* Add a slip of finger i to its coefficient; a change of the surface starts anew. */
static void gf_add_slip(const gf_bound_settings *settings, int i, const gf_force_ratio *force, const gf_bound_state *next)
{
    const double added = 1.0 / (force->deviation * force->deviation), known = next->information[i];
    const double apart = force->ratio - next->slip_ratio[i], error = settings->ratio_error[0];
    if (known > 0.0 && fabs(apart) > CHANGED * sqrt(1.0 / known + 1.0 / added)) {
        next->information[i] = added, next->slip_ratio[i] = force->ratio;
        return;
    }
    next->slip_ratio[i] += apart * added / (known + added);
    next->information[i] = fmin(known + added, error > 0.0 ? 1.0 / (error * error) : INFINITY);
}

/* Return whether an alarm of finger i shows its friction, and keep what a later alarm needs. */
static int gf_shows_slip(const gf_bound_settings *settings, const gf_bound_inputs *inputs, int i, const gf_force_ratio *force,
                         const gf_bound_state *next)
{
    const double s1 = inputs->distance[2 * i], s2 = inputs->distance[2 * i + 1];
    const double aligned = (inputs->is_certain ? ALIGNED : PARALLEL) * hypot(s1, s2) * hypot(force->t1, force->t2);
    if (!(s1 * force->t1 + s2 * force->t2 >= aligned)) return 0;
    if (force->deviation > fmax(WEAK * force->ratio, WEAK_RATIO) || next->since_slip[i] < settings->independent[0]) return 0;
    const int is_confirmed = next->since_found[i] <= settings->confirmation[0] &&
                             fabs(force->ratio - next->found_ratio[i]) <= STEADY * force->deviation;
    next->found_ratio[i] = force->ratio, next->since_found[i] = 0.0;
    return is_confirmed || inputs->has_tips ? 1 : -1;
}

/* Update the coefficient of finger i, whose mean force is f and whose present force is `now`. */
static void gf_update_bound(const gf_bound_settings *settings, const gf_bound_inputs *inputs, int i, int all_press,
                            const double *now, const gf_bound_state *next)
{
    const double *f = next->f + 3 * i, k = settings->deviations[0], before = next->slid[i];
    const double found = inputs->alarms[i] ? hypot(inputs->distance[2 * i], inputs->distance[2 * i + 1]) : 0.0; /* m */
    next->slid[i] += found;
    if (!(fmin(f[2], now[2]) >= settings->least_normal[0])) return;
    gf_force_ratio force = gf_compute_ratio(settings, inputs, i, f, before * before + UNIFORM * found * found);
    const double lag = hypot(now[0], now[1]) / now[2] - force.ratio;
    if (fabs(lag) > STEADY * force.noise) return; /* it changes within the window */
    if (inputs->alarms[i])
        force.deviation = sqrt(force.deviation * force.deviation + fmax(lag * lag - force.noise * force.noise, 0.0));
    const int shows = inputs->alarms[i] && all_press ? gf_shows_slip(settings, inputs, i, &force, next) : 0;
    if (shows < 0) return; /* the slip may be over */
    if (shows) {
        next->since_slip[i] = 0.0;
        gf_add_slip(settings, i, &force, next);
        next->stick_ratio[i] = fmin(next->stick_ratio[i], fmax(force.ratio - k * force.deviation, 0.0));
    } else if (!inputs->slipping[i]) {
        next->stick_ratio[i] = fmax(next->stick_ratio[i], force.ratio - k * force.deviation);
        if (next->information[i] > 0.0 && next->stick_ratio[i] > next->slip_ratio[i] + k / sqrt(next->information[i]))
            next->information[i] = next->slip_ratio[i] = 0.0; /* it sticks above the coefficient at which it slipped */
    }
}

int gf_friction_bounds_step(const gf_bound_settings *settings, const gf_bound_inputs *inputs, const gf_bound_state *last,
                            const gf_bound_state *next)
{
    const int N = settings->contact_count;
    const double *now = inputs->has_tips ? inputs->forces->measured : inputs->forces->f;
    gf_copy_bounds(settings, last, next);
    for (int j = 0; j < 3 * N; j++) {
        const double gain = last->periods[0] == 0.0 ? 1.0 : settings->gain[0];
        next->f[j] += gain * (now[j] - next->f[j]);
    }
    next->periods[0] += 1.0, next->age[0] += 1.0;
    if (!inputs->has_alarm && next->age[0] < STICK_STEPS) return 0;
    int all_press = 1;
    for (int i = 0; i < N; i++) all_press &= fmin(next->f[3 * i + 2], now[3 * i + 2]) >= settings->least_normal[0];
    for (int i = 0; i < N; i++) {
        next->since_slip[i] += next->age[0], next->since_found[i] += next->age[0];
        next->stick_ratio[i] *= settings->kept[0];
        gf_update_bound(settings, inputs, i, all_press, now + 3 * i, next);
        const int is_known = next->information[i] > 0.0;
        const double width = is_known ? settings->deviations[0] / sqrt(next->information[i]) : INFINITY;
        next->lower[i] = fmax(next->stick_ratio[i], next->slip_ratio[i] - width);
        next->upper[i] = next->slip_ratio[i] + width;
        next->expected[i] = is_known ? next->slip_ratio[i] : fmax(settings->mu[i], next->stick_ratio[i]);
    }
    next->age[0] = 0.0;
    return 1;
}
