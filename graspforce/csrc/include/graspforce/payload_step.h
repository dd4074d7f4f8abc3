/* One update of the payload of a held object: mass, centre of mass and external wrench from contact forces and motion.
 *
 * Newton–Euler is linear in the mass m and the first moment h = m c: the contacts supply w = Φ (m, h) − w_e. Recursive least
 * squares with exponential forgetting gives (m, h), and the remainder is the external wrench w_e. The laws are stated in
 * graspforce/estimation/payload.py, the reference implementation in Python, which the tests compare with this one.
 *
 * Frames: H is the hand's base, O the object. Matrices are stored by rows, and arrays are contiguous. No function allocates memory
 * or writes global state.
 */
#ifndef GF_PAYLOAD_STEP_H
#define GF_PAYLOAD_STEP_H

#include <stddef.h>

#include "graspforce/contact_forces.h"
#include "graspforce/contact_pose.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Settings, constant during all updates: FIELD(name, shape).
 *
 * period          time between two updates, s
 * kept            weight of the past after an update
 * external_gain   gain of the mean of the external wrench
 * prior           inverse variances of m and h before any measurement
 * theta           m and h of the given body, kg and kg·m
 * inertia         about O's origin, for each kilogram, m²
 * threshold       statistic from which a change of the wrench is sudden
 * unmodelled      variances of slow changes of the external wrench, N² and (N·m)²
 * attitude_error  largest error of the object's orientation, rad
 * adaption_time   time after which a sudden change counts as payload, s */
#define GF_PAYLOAD_SETTING_FIELDS(FIELD) \
    FIELD(period, 1)                     \
    FIELD(kept, 1)                       \
    FIELD(external_gain, 1)              \
    FIELD(prior, 4)                      \
    FIELD(theta, 4)                      \
    FIELD(inertia, 3, 3)                 \
    FIELD(threshold, 1)                  \
    FIELD(unmodelled, 6)                 \
    FIELD(attitude_error, 1)             \
    FIELD(adaption_time, 1)

typedef struct {
#define GF_POINTER(name, ...) const double *name;
    GF_PAYLOAD_SETTING_FIELDS(GF_POINTER)
#undef GF_POINTER
} gf_payload_settings;

/* Inputs of an update: FIELD(name, shape).
 *
 * w      wrench of the contacts on the object about O's origin, in O, N and N·m
 * noise  covariance of its noise
 * bias   covariance of its constant error
 * rates  rows p̈ − g, m/s², ω̇, rad/s², and ω, rad/s, in O */
#define GF_PAYLOAD_INPUT_FIELDS(FIELD) \
    FIELD(w, 6)                        \
    FIELD(noise, 6, 6)                 \
    FIELD(bias, 6, 6)                  \
    FIELD(rates, 3, 3)

typedef struct {
#define GF_POINTER(name, ...) double *name;
    GF_PAYLOAD_INPUT_FIELDS(GF_POINTER)
#undef GF_POINTER
} gf_payload_inputs;

/* State of the estimator, and the estimate: FIELD(name, shape). Φ is the regressor, R the covariance of w.
 *
 * information  Σ Φᵀ R⁻¹ Φ of the past, with forgetting
 * score        Σ Φᵀ R⁻¹ w
 * gain         Σ Φᵀ R⁻¹
 * noise        Σ Φᵀ R⁻¹ R_noise R⁻¹ Φ, with the squares of the forgetting
 * direction    unit vector along p̈ − g to which smaller turns are referred, in O; zero before the first update
 * residual     Φ θ − w over the external window: the external wrench, N and N·m
 * slow         the same over the memory time
 * disturbed    time since the begin of a sudden change, s; zero without one
 * updates      since the start
 * mass, p_OM   estimate of the mass, kg, and of the centre of mass in O, m
 * covariance   of m and h, kg and kg·m
 * external_covariance  of the external wrench, N² to (N·m)² */
#define GF_PAYLOAD_STATE_FIELDS(FIELD) \
    FIELD(information, 4, 4)           \
    FIELD(score, 4)                    \
    FIELD(gain, 4, 6)                  \
    FIELD(noise, 4, 4)                 \
    FIELD(direction, 3)                \
    FIELD(residual, 6)                 \
    FIELD(slow, 6)                     \
    FIELD(disturbed, 1)                \
    FIELD(updates, 1)                  \
    FIELD(mass, 1)                     \
    FIELD(p_OM, 3)                     \
    FIELD(covariance, 4, 4)            \
    FIELD(external_covariance, 6, 6)

typedef struct {
#define GF_POINTER(name, ...) double *name;
    GF_PAYLOAD_STATE_FIELDS(GF_POINTER)
#undef GF_POINTER
} gf_payload_state;

/* Motion and forces over some periods.
 *
 * force_sum     (N, 3) sum of the contact forces, N
 * periods       number of these forces
 * acceleration  (6) of the object in H, m/s² and rad/s²
 * twist         (6) in H, m/s and rad/s
 * gravity_H     (3) acceleration of gravity, m/s² */
typedef struct {
    const double *force_sum, *acceleration, *twist, *gravity_H;
    double periods;
} gf_payload_motion;

/* Compute the inputs of an update from contact forces.
 *
 * contact_count  N
 * pose    the contacts; R_HO and B are used
 * gains   of the contact forces; noise and bias are used
 * motion  forces and motion
 * inputs  written */
void gf_compute_payload_inputs(int contact_count, const gf_contact_pose *pose, const gf_force_gains *gains,
                               const gf_payload_motion *motion, const gf_payload_inputs *inputs);

/* Compute the state after an update. `next` is written; it must not overlap `last`. Return 1, or 0 if a covariance is not positive
 * definite; `next` is then undefined. */
int gf_payload_step(const gf_payload_settings *settings, const gf_payload_inputs *inputs, const gf_payload_state *last,
                    const gf_payload_state *next);

#ifdef __cplusplus
}
#endif

#endif
