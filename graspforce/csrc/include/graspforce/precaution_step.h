/* One step of the test for precautions: forces or motion of the fingertips that surely differ from the commanded ones.
 *
 * Means of the displacements of N fingertips along the surface of the object in its desired pose, over three windows, less the mean
 * over a long time, are compared with the noise of the encoders. So is the statistic of unexpected forces of slip_step.h. The laws
 * are stated in graspforce/estimation/slip/precaution.py, the reference implementation in Python, which the tests compare with this
 * one.
 *
 * Matrices are stored by rows, and arrays are contiguous. H is the hand's base, O the object. No function allocates memory or writes
 * global state.
 */
#ifndef GF_PRECAUTION_STEP_H
#define GF_PRECAUTION_STEP_H

#include "graspforce/contact_pose.h"
#include "graspforce/slip_step.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { GF_PRECAUTION_WINDOWS = 3, GF_PRECAUTION_MEANS = GF_PRECAUTION_WINDOWS + 1 };

/* Settings, constant during all steps: FIELD(name, shape).
 *
 * gains             gains of the means over the windows and over the baseline
 * level_gain        gain of the mean statistics
 * start             periods without a precaution at the start
 * refresh           periods between two computations of the covariances
 * encoder_variance  variance of the noise of a joint position, rad²
 * least_variance    variance that is added to each displacement, m²
 * force_threshold   statistic of unexpected forces from which a precaution is due
 * motion_threshold  the same of the displacement of a finger
 * tail              threshold of a statistic with one degree of freedom
 * noise_level       largest mean of a statistic of noise, relative to its expectation */
#define GF_PRECAUTION_SETTING_FIELDS(FIELD) \
    FIELD(gains, 4)                         \
    FIELD(level_gain, 1)                    \
    FIELD(start, 1)                         \
    FIELD(refresh, 1)                       \
    FIELD(encoder_variance, 1)              \
    FIELD(least_variance, 1)                \
    FIELD(force_threshold, 1)               \
    FIELD(motion_threshold, 1)              \
    FIELD(tail, 1)                          \
    FIELD(noise_level, 1)

typedef struct {
    int contact_count, motor_count;
#define GF_POINTER(name, ...) const double *name;
    GF_PRECAUTION_SETTING_FIELDS(GF_POINTER)
#undef GF_POINTER
} gf_precaution_settings;

/* State of N contacts: FIELD(name, shape).
 *
 * means     means of the displacements over the windows and the baseline, m
 * variance  their variances as fractions of that of one period
 * updates   periods since the start; 0: none yet
 * level     mean statistic of each finger, relative to that of noise
 * factor    Cholesky factor of the covariance of each displacement: L11, L21, L22, m */
#define GF_PRECAUTION_STATE_FIELDS(FIELD) \
    FIELD(means, 4, 2 * contact_count)    \
    FIELD(variance, 4)                    \
    FIELD(updates, 1)                     \
    FIELD(level, contact_count)           \
    FIELD(factor, contact_count, 3)

typedef struct {
#define GF_POINTER(name, ...) double *name;
    GF_PRECAUTION_STATE_FIELDS(GF_POINTER)
#undef GF_POINTER
} gf_precaution_state;

/* Desired pose of the object in a period, in H. */
typedef struct {
    const double *p_HO; /* (3) position, m */
    const double *R_HO; /* (3, 3) axes */
} gf_desired_pose;

/* Compute the state after a period.
 *
 * pose     contacts at the estimated pose
 * desired  desired pose of the object
 * slip     state of the slip detector after the period; its residual, force_statistic and level are used
 * last     state after the last period
 * next     written; no part of it may overlap `last`
 *
 * Return 1 if a precaution is due, otherwise 0. */
int gf_precaution_step(const gf_precaution_settings *settings, const gf_contact_pose *pose, const gf_desired_pose *desired,
                       const gf_slip_state *slip, const gf_precaution_state *last, const gf_precaution_state *next);

#ifdef __cplusplus
}
#endif

#endif
