/* Implementation of slip_step.h. */
#include "graspforce/slip_step.h"

#include <math.h>
#include <string.h>

#include "slip_test.inc"

enum { REFRESH_STEPS = 64, LAST_STARTING_STEP = 512, ANCHOR_STEPS = 50 };
static const double FULL_TIMES = 8.0;        /* time constants after which a mean of residuals is full */
static const double FULL_FORCE_TIMES = 4.0;  /* the same for forces */
static const double FRESH_POSE_TIME = 0.005; /* s: no test without the pose is needed after a pose */
static const double LIMIT_DEVIATIONS = 5.0;  /* standard deviations between a force at its limit and the largest planned one */
static const double SAME_PERIOD = 1e-3;      /* of the period: difference of two periods that are the same */

size_t gf_slip_work_size(int contact_count)
{
    return (size_t)(9 * contact_count * contact_count + 42 * contact_count);
}

/* Copy the state that a step may leave as it was. */
static void gf_copy_state(const gf_slip_settings *settings, const gf_slip_state *last, const gf_slip_state *next)
{
    const size_t contact_count = (size_t)settings->contact_count, window_count = (size_t)settings->window_count;
#define GF_PRODUCT(a, b, c, ...) ((a) * (b) * (c))
#define GF_COPY(name, ...)       memcpy(next->name, last->name, GF_PRODUCT(__VA_ARGS__, 1, 1, 1) * sizeof(double));
    GF_SLIP_STATE_FIELDS(GF_COPY)
#undef GF_COPY
#undef GF_PRODUCT
}

/* Compute the slip since the start, and the contacts from which it is measured further. */
static void gf_measure_slip(const gf_slip_settings *settings, const gf_contact_pose *pose, const gf_slip_state *last,
                            double *slip, const gf_slip_state *next)
{
    const int N = settings->contact_count;
    const gf_contacts *now = &pose->contacts;
    for (int i = 0; i < N; i++) {
        const gf_tip_contact before = {last->p_OF + 3 * i, last->R_OF + 9 * i, last->p_OC + 3 * i};
        const gf_tip_contact present = {now->p_OF + 3 * i, now->R_OF + 9 * i, now->p_OC + 3 * i};
        double since[2], until[2];
        gf_slip_displacement(&before, present.p_OF, present.R_OF, now->R_OC + 9 * i, since);
        gf_slip_displacement(&present, before.p_OF, before.R_OF, last->R_OC + 9 * i, until);
        for (int k = 0; k < 2; k++) slip[2 * i + k] = last->slip[2 * i + k] + 0.5 * (since[k] - until[k]);
    }
    next->age[0] = last->age[0] + 1.0;
    if (next->age[0] < ANCHOR_STEPS) return;
    next->age[0] = 0.0;
    memcpy(next->p_OF, now->p_OF, (size_t)(3 * N) * sizeof(double));
    memcpy(next->R_OF, now->R_OF, (size_t)(9 * N) * sizeof(double));
    memcpy(next->p_OC, now->p_OC, (size_t)(3 * N) * sizeof(double));
    memcpy(next->R_OC, now->R_OC, (size_t)(9 * N) * sizeof(double));
    memcpy(next->slip, slip, (size_t)(2 * N) * sizeof(double));
}

/* Compute the residuals y (3 N), m, and those for the estimated pose. */
static void gf_slip_residuals(const gf_slip_settings *settings, const gf_contact_pose *pose, const gf_slip_inputs *inputs,
                              const double *slip, double *y, const gf_slip_state *next)
{
    const int n = settings->motor_count;
    for (int row = 0; row < 3 * settings->contact_count; row++) {
        const int i = row / 3, k = row % 3;
        y[row] = gf_inner(n, pose->contacts.A + n * row, inputs->joint_error);
        y[row] += k < 2 ? slip[2 * i + k] : -pose->contacts.gap[i];
        next->residual[row] = y[row];
        if (inputs->pose_error != NULL) y[row] -= gf_inner(TWIST, pose->contacts.B + TWIST * row, inputs->pose_error);
    }
}

/* Update the means of a test with a residual. */
static void gf_update_means(const gf_slip_settings *settings, double elapsed, const double *y, double updates, double *values,
                            double *variance)
{
    const int K = settings->window_count, rows = 3 * settings->contact_count;
    const int is_regular = fabs(elapsed - settings->period[0]) <= SAME_PERIOD * settings->period[0];
    const double step = is_regular ? settings->period[0] : elapsed;
    double longest = settings->times[0];
    for (int k = 1; k <= K; k++) longest = fmax(longest, settings->times[k]);
    const double start = ceil(FULL_TIMES / -expm1(-step / longest));
    for (int k = 0; k <= K; k++) {
        const double full = -expm1(-step / settings->times[k]), g = updates > start ? full : fmax(full, 1.0 / updates);
        variance[k] = updates > start ? full / (2.0 - full) : (1.0 - g) * (1.0 - g) * variance[k] + g * g;
        for (int j = 0; j < rows; j++) values[rows * k + j] = (1.0 - g) * values[rows * k + j] + g * y[j];
    }
}

/* Return whether a test is computed anew after so many residuals from the start: after 2, 4, 8 …, 512. */
static int gf_is_starting_step(double updates)
{
    for (int step = 2; step <= LAST_STARTING_STEP; step *= 2)
        if (updates == (double)step) return 1;
    return 0;
}

/* Update a test of the motion with the residual y. Return 1 if `fresh` was written, 0 if not, or −1 on failure. */
static int gf_update_test(const gf_slip_settings *settings, const gf_contact_pose *pose, int kind, double t, const double *y,
                          double *work, const gf_slip_test *fresh, const gf_slip_state *next)
{
    const int K = settings->window_count, N = settings->contact_count, rows = 3 * N;
    double *values = next->values + (K + 1) * rows * kind, *variance = next->variance + (K + 1) * kind;
    double *place = next->place + rows * kind, *updates = next->test_updates + kind, *age = next->test_age + kind;
    const double elapsed = t - next->test_t[kind], baseline = settings->times[K];
    if (updates[0] == 0.0 || elapsed > baseline) { /* start */
        for (int k = 0; k <= K; k++) {
            memcpy(values + rows * k, y, (size_t)rows * sizeof(double));
            variance[k] = 1.0;
        }
        memcpy(place, pose->contacts.p_OC, (size_t)rows * sizeof(double));
        updates[0] = 1.0;
    } else {
        if (elapsed <= 0.0) return 0; /* the same measurement again */
        updates[0] += 1.0, age[0] += 1.0;
        gf_update_means(settings, elapsed, y, updates[0], values, variance);
        if (age[0] < REFRESH_STEPS && !gf_is_starting_step(updates[0])) {
            next->test_t[kind] = t;
            return 0;
        }
        const double share = -expm1(-age[0] * elapsed / baseline);
        for (int j = 0; j < rows; j++) place[j] += share * (pose->contacts.p_OC[j] - place[j]);
    }
    next->test_t[kind] = t, age[0] = 0.0;
    return gf_make_slip_test(settings, pose, place, variance, kind == GF_POSE_TEST, work, fresh) ? 1 : -1;
}

/* Return ‖L⁻¹ x‖² over all contacts, for the covariances L Lᵀ (N, 3, 3) of x; NaN if one is not positive definite. */
static double gf_normalised_square(int contact_count, const double *covariance, const double *x)
{
    double sum = 0.0;
    for (int i = 0; i < contact_count; i++) {
        double L[9], z[3] = {x[3 * i], x[3 * i + 1], x[3 * i + 2]};
        memcpy(L, covariance + 9 * i, sizeof L);
        if (!gf_decompose(3, L)) return NAN;
        gf_solve_forward(3, L, z);
        sum += gf_inner(3, z, z);
    }
    return sum;
}

/* Update the means of the forces. Return the largest statistic of unexpected forces, over its mean in the past. */
static double gf_force_statistic(const gf_slip_settings *settings, const gf_slip_inputs *inputs, double *work,
                                 const gf_slip_state *next)
{
    const int N = settings->contact_count, rows = 3 * N;
    double *values = next->force_values, *c = next->force_variance, g[3];
    const double *mismatch = inputs->forces->mismatch;
    if (next->force_updates[0] == 0.0) {
        memcpy(values, inputs->forces->f, (size_t)rows * sizeof(double));
        for (int k = 0; k < 3; k++) {
            memcpy(values + rows * (k + 1), mismatch, (size_t)rows * sizeof(double));
            c[k] = 1.0;
        }
        next->force_updates[0] = next->level[0] = 1.0;
        return 0.0;
    }
    const double updates = next->force_updates[0] += 1.0, start = 1.0 / updates;
    const int is_full = updates >= ceil(FULL_FORCE_TIMES / settings->force_gains[2]);
    for (int k = 0; k < 3; k++) {
        const double full = settings->force_gains[k];
        g[k] = is_full ? full : fmax(full, start);
        c[k] = is_full ? full / (2.0 - full) : (1.0 - g[k]) * (1.0 - g[k]) * c[k] + g[k] * g[k];
    }
    for (int j = 0; j < rows; j++) {
        values[j] += g[0] * (inputs->forces->f[j] - values[j]);
        for (int k = 0; k < 3; k++) values[rows * (k + 1) + j] += g[k] * (mismatch[j] - values[rows * (k + 1) + j]);
    }
    double statistic = 0.0;
    for (int k = 0; k < 2; k++) {
        for (int j = 0; j < rows; j++) work[j] = values[rows * (k + 1) + j] - values[3 * rows + j];
        const double value = gf_normalised_square(N, inputs->gains->mismatch_noise, work) / (c[k] + c[2]);
        statistic = k == 0 || value > statistic || isnan(value) ? value : statistic;
    }
    const double past = fmax(next->level[0], 1.0);
    next->level[0] += fmax(settings->level_gain[0], start) * (statistic / rows - next->level[0]);
    return statistic / past;
}

/* Find the contacts whose mean force is at its friction limit. Return whether there is one. */
static int gf_find_limits(const gf_slip_settings *settings, const gf_slip_inputs *inputs, const gf_slip_state *next)
{
    const int rows = 3 * settings->contact_count;
    int is_any = 0;
    for (int i = 0; i < settings->contact_count; i++) {
        const double *f = next->force_values + 3 * i, *noise = inputs->gains->noise + (rows + 1) * (3 * i);
        const double mu = inputs->mu[i], tangential = hypot(f[0], f[1]), limit = mu * fmax(f[2], 0.0); /* N */
        const double variance = fmax(noise[0], noise[rows + 1]) + mu * mu * noise[2 * (rows + 1)];
        const double excess = tangential - settings->planned_ratio[0] * limit;
        next->at_limit[i] = tangential > settings->limit_ratio[0] * limit &&
                            excess > LIMIT_DEVIATIONS * sqrt(next->force_variance[0] * variance);
        is_any |= next->at_limit[i] != 0.0;
    }
    return is_any;
}

/* Return the bits of an alarm from the statistics of a test; 0 without one. */
static int gf_find_alarm(const gf_slip_settings *settings, const gf_slip_test *test, const double *values, int is_alert,
                         double *work, const gf_slip_state *next)
{
    const int largest = gf_finger_statistics(settings, test, values, work, next->statistics);
    const double threshold = is_alert ? settings->alert_threshold[0] : settings->threshold[0];
    if (next->statistics[largest] > threshold) return GF_SLIP_ALARM + GF_SLIP_WINDOW * (largest / settings->contact_count);
    if (!is_alert) return 0;
    double most = 0.0;
    int window = 0;
    for (int k = 0; k < settings->window_count; k++) {
        const double joint = gf_joint_statistic(settings, test, values, k, work);
        if (joint > most) most = joint, window = k;
    }
    return most > settings->joint_threshold[0] ? GF_SLIP_ALARM + GF_SLIP_WINDOW * window : 0;
}

int gf_slip_step(const gf_slip_settings *settings, const gf_contact_pose *pose, const gf_slip_inputs *inputs,
                 const gf_slip_state *last, const gf_slip_test tests[GF_SLIP_TESTS], double *work, const gf_slip_test *fresh,
                 const gf_slip_state *next)
{
    const int N = settings->contact_count, K = settings->window_count;
    const int kind = inputs->pose_error != NULL ? GF_POSE_TEST : GF_CONTACT_TEST;
    double *slip = work, *y = work + 2 * N, *rest = work + 5 * N;
    int bits = 0;
    gf_copy_state(settings, last, next);
    gf_measure_slip(settings, pose, last, slip, next);
    gf_slip_residuals(settings, pose, inputs, slip, y, next);
    const int is_tested = kind == GF_POSE_TEST || last->test_updates[GF_POSE_TEST] == 0.0 ||
                          inputs->t - last->test_t[GF_POSE_TEST] > FRESH_POSE_TIME;
    if (is_tested) {
        const int renewed = gf_update_test(settings, pose, kind, inputs->t, y, rest, fresh, next);
        if (renewed < 0) return GF_SLIP_FAILED;
        bits |= GF_SLIP_HAS_RESIDUALS + GF_SLIP_NEW_TEST * renewed;
    }
    memset(next->at_limit, 0, (size_t)N * sizeof(double));
    next->force_statistic[0] = 0.0;
    if (inputs->forces != NULL) {
        next->force_statistic[0] = gf_force_statistic(settings, inputs, rest, next);
        if (next->force_statistic[0] > settings->force_threshold[0]) next->alert_until[0] = inputs->t + settings->alert_time[0];
        if (inputs->mu != NULL && gf_find_limits(settings, inputs, next)) bits |= GF_SLIP_AT_LIMIT;
    }
    const int is_alert = inputs->t <= next->alert_until[0];
    if (is_alert) bits |= GF_SLIP_ALERT;
    memset(next->statistics, 0, (size_t)(K * N) * sizeof(double));
    if (!is_tested || N == 0) return bits;
    const double *values = next->values + (K + 1) * 3 * N * kind;
    return bits | gf_find_alarm(settings, bits & GF_SLIP_NEW_TEST ? fresh : &tests[kind], values, is_alert, rest, next);
}
