/* One step of the detector of slip, from the relative motion of fingertips and object, and from contact forces.
 *
 * Rolling contact keeps the accumulated slip along t1 and t2 and the gap along n. Measured joint positions, and a measured pose of
 * the object if there is one, give these residuals y of N contacts. Means of y over K windows, less the mean over a long time, are
 * tested for slip of each finger. After unexpected forces a lower threshold holds, and slip of all fingers together is tested,
 * too. The laws are stated in graspforce/estimation/slip, the reference implementation in Python, which the tests compare with
 * this one. The fingers of an alarm are found there.
 *
 * Frames: O is the object, C a contact, F a fingertip. Matrices are stored by rows, and arrays are contiguous. No function
 * allocates memory or writes global state.
 */
#ifndef GF_SLIP_STEP_H
#define GF_SLIP_STEP_H

#include <stddef.h>

#include "graspforce/contact_forces.h"
#include "graspforce/contact_pose.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Settings of N contacts and K windows, constant during all steps: FIELD(name, shape).
 *
 * period           time between two steps, s
 * times            lengths of the windows and of the baseline, s
 * encoder_noise    variance of the noise of each joint position, rad²
 * encoder_bias     variance of its constant error, rad²
 * pose_noise       variances of a measured pose, m² and rad²
 * compliance       variances of the residuals from deformation of the contacts, m²
 * rolling_error    variance of the error of a contact's path, relative to the square of its length
 * evident_error    the same for evident slip
 * force_gains      gains of the means of forces over two windows and the baseline
 * level_gain       gain of the mean of the force statistic
 * limit_ratio      fraction of the friction coefficient at which a contact counts as at its limit
 * planned_ratio    fraction of the friction coefficient that planned forces use
 * threshold        statistic from which a finger counts as slipping
 * alert_threshold  the same while forces are unexpected
 * joint_threshold  statistic of all fingers together while forces are unexpected
 * force_threshold  statistic from which forces count as unexpected
 * alert_time       time for which they then do, s
 * hold_time        time for which a finger counts as slipping after an alarm, s */
#define GF_SLIP_SETTING_FIELDS(FIELD)    \
    FIELD(period, 1)                     \
    FIELD(times, window_count + 1)       \
    FIELD(encoder_noise, 1)              \
    FIELD(encoder_bias, 1)               \
    FIELD(pose_noise, 6)                 \
    FIELD(compliance, 3 * contact_count) \
    FIELD(rolling_error, 1)              \
    FIELD(evident_error, 1)              \
    FIELD(force_gains, 3)                \
    FIELD(level_gain, 1)                 \
    FIELD(limit_ratio, 1)                \
    FIELD(planned_ratio, 1)              \
    FIELD(threshold, 1)                  \
    FIELD(alert_threshold, 1)            \
    FIELD(joint_threshold, 1)            \
    FIELD(force_threshold, 1)            \
    FIELD(alert_time, 1)                 \
    FIELD(hold_time, 1)

typedef struct {
    int contact_count, motor_count, window_count;
#define GF_POINTER(name, ...) const double *name;
    GF_SLIP_SETTING_FIELDS(GF_POINTER)
#undef GF_POINTER
} gf_slip_settings;

/* Test of the means at one posture: FIELD(name, shape).
 *
 * noise        covariance of the residuals' noise, m²
 * bias         covariance of errors that differ between a window and the baseline, m²
 * variance     variances of the means as fractions of that of one residual, the baseline's last
 * B            twist of the object in O to the residuals
 * model_error  variances beyond these that evidence of slip must exceed, m²
 * information  inverse covariance of the means less the baseline, without motions of the object that are free, 1/m²
 * whitener     means less the baseline to the slips of each finger alone with unit covariance, 1/m */
#define GF_SLIP_TEST_FIELDS(FIELD)                                         \
    FIELD(noise, 3 * contact_count, 3 * contact_count)                     \
    FIELD(bias, 3 * contact_count, 3 * contact_count)                      \
    FIELD(variance, window_count + 1)                                      \
    FIELD(B, 3 * contact_count, 6)                                         \
    FIELD(model_error, 3 * contact_count)                                  \
    FIELD(information, window_count, 3 * contact_count, 3 * contact_count) \
    FIELD(whitener, window_count, 2 * contact_count, 3 * contact_count)

typedef struct {
#define GF_POINTER(name, ...) double *name;
    GF_SLIP_TEST_FIELDS(GF_POINTER)
#undef GF_POINTER
} gf_slip_test;

/* The two tests: of the residuals that no motion of the object explains, and of those with the measured pose. */
enum { GF_CONTACT_TEST = 0, GF_POSE_TEST = 1, GF_SLIP_TESTS = 2 };

/* State of the detector, and its result: FIELD(name, shape). Flags are 0 or 1.
 *
 * p_OF, R_OF, p_OC, R_OC  contacts from which slip is measured
 * slip             slip up to these contacts along t1 and t2, m
 * age              periods since
 * test_t           time of the last residual of each test, s
 * test_updates     residuals since the start or the last restart; 0: no residual yet
 * test_age         residuals since the test was computed
 * values           means of the residuals over windows and baseline, m
 * variance         their variances as fractions of that of one residual
 * place            contact points in O, mean over the baseline, m
 * force_values     contact forces over the first window, and their mismatch over both windows and the baseline, N
 * force_variance   variances of the means over both windows and the baseline
 * force_updates    periods since the first; 0: none yet
 * level            mean of the force statistic, relative to that of noise
 * alert_until      time until which forces count as unexpected, s
 * alarm, evident   times of the last alarm, and of the last evident slip of each finger, s
 * residual         result: slip and gap of each finger for the estimated pose and the measured joint positions, m
 * force_statistic  result: statistic of unexpected forces, over its mean in the past; zero without forces
 * at_limit         result: whether a contact force is at its friction limit
 * statistics       result: statistics by window, and by finger in each; zero without residuals */
#define GF_SLIP_STATE_FIELDS(FIELD)                       \
    FIELD(p_OF, contact_count, 3)                         \
    FIELD(R_OF, contact_count, 3, 3)                      \
    FIELD(p_OC, contact_count, 3)                         \
    FIELD(R_OC, contact_count, 3, 3)                      \
    FIELD(slip, contact_count, 2)                         \
    FIELD(age, 1)                                         \
    FIELD(test_t, 2)                                      \
    FIELD(test_updates, 2)                                \
    FIELD(test_age, 2)                                    \
    FIELD(values, 2, window_count + 1, 3 * contact_count) \
    FIELD(variance, 2, window_count + 1)                  \
    FIELD(place, 2, contact_count, 3)                     \
    FIELD(force_values, 4, 3 * contact_count)             \
    FIELD(force_variance, 3)                              \
    FIELD(force_updates, 1)                               \
    FIELD(level, 1)                                       \
    FIELD(alert_until, 1)                                 \
    FIELD(alarm, contact_count)                           \
    FIELD(evident, contact_count)                         \
    FIELD(residual, 3 * contact_count)                    \
    FIELD(force_statistic, 1)                             \
    FIELD(at_limit, contact_count)                        \
    FIELD(statistics, contact_count *window_count)

typedef struct {
#define GF_POINTER(name, ...) double *name;
    GF_SLIP_STATE_FIELDS(GF_POINTER)
#undef GF_POINTER
} gf_slip_state;

/* Measurements of one period.
 *
 * t            time, s
 * joint_error  (n) measured less estimated joint positions, rad
 * pose_error   (6) measured less estimated pose of the object in O, m and rad; NULL if no pose arrived
 * forces, gains  contact forces of fingertip sensors; NULL without them
 * mu           (N) friction coefficients at which slip is expected; NULL if they are not known */
typedef struct {
    double t;
    const double *joint_error, *pose_error, *mu;
    const gf_contact_force *forces;
    const gf_force_gains *gains;
} gf_slip_inputs;

/* Bits of the result of gf_slip_step(). */
enum {
    GF_SLIP_FAILED = -1,       /* a covariance is not positive definite */
    GF_SLIP_HAS_RESIDUALS = 1, /* a test was made in this period */
    GF_SLIP_NEW_TEST = 2,      /* `fresh` was written: it replaces the test that was made */
    GF_SLIP_ALERT = 4,         /* forces are unexpected */
    GF_SLIP_AT_LIMIT = 8,      /* a contact force is at its friction limit */
    GF_SLIP_ALARM = 16,        /* a finger slips, in the window in the bits above GF_SLIP_WINDOW */
    GF_SLIP_WINDOW = 32
};

/* Return the numbers of workspace that gf_slip_step() needs. */
size_t gf_slip_work_size(int contact_count);

/* Compute the state after a period.
 *
 * settings  of the detector
 * pose      the contacts; p_OF, R_OF, p_OC, R_OC, gap, A and B are used
 * inputs    measurements of the period
 * last      state after the last period
 * tests     tests of both kinds at the last period; not used for a kind with no residual yet
 * work      workspace
 * fresh     written if a test is computed anew
 * next      written; it must not overlap `last`
 *
 * Return the bits above, or GF_SLIP_FAILED; `next` is then undefined. */
int gf_slip_step(const gf_slip_settings *settings, const gf_contact_pose *pose, const gf_slip_inputs *inputs,
                 const gf_slip_state *last, const gf_slip_test tests[GF_SLIP_TESTS], double *work, const gf_slip_test *fresh,
                 const gf_slip_state *next);

#ifdef __cplusplus
}
#endif

#endif
