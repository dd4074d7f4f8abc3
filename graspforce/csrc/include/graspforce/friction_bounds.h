/* One step of the estimator of friction coefficients with bounds, from forces of contacts that stick and contacts that slip.
 *
 * A contact that sticks shows that its coefficient is at least r = ‖f_t‖/f_n, a contact that slides that it equals this ratio. The
 * laws are stated in graspforce/estimation/contact_friction.py, the reference implementation in Python, which the tests compare
 * with this one. Arrays are contiguous. No function allocates memory or writes global state.
 */
#ifndef GF_FRICTION_BOUNDS_H
#define GF_FRICTION_BOUNDS_H

#include "graspforce/contact_forces.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Settings of N contacts, constant during all steps: FIELD(name, shape).
 *
 * mu            given coefficients, used as long as no finger slips at a smaller ratio
 * gain          gain of the mean of the forces
 * kept          weight of the lower bounds from sticking after some periods
 * deviations    standard deviations between an estimate and its bounds
 * ratio_error   standard deviation of the error of a ratio that is not noise
 * least_normal  normal force below which a contact shows nothing, N
 * independent   periods between two slips that count as independent
 * confirmation  periods between two findings of one slip, at most
 * variance      variances of the noise and of the constant error of a fingertip force, N² */
#define GF_BOUND_SETTING_FIELDS(FIELD) \
    FIELD(mu, contact_count)           \
    FIELD(gain, 1)                     \
    FIELD(kept, 1)                     \
    FIELD(deviations, 1)               \
    FIELD(ratio_error, 1)              \
    FIELD(least_normal, 1)             \
    FIELD(independent, 1)              \
    FIELD(confirmation, 1)             \
    FIELD(variance, 2)

typedef struct {
    int contact_count;
#define GF_POINTER(name, ...) const double *name;
    GF_BOUND_SETTING_FIELDS(GF_POINTER)
#undef GF_POINTER
} gf_bound_settings;

/* State of the estimator, and its result: FIELD(name, shape).
 *
 * f                      contact forces over the window, N
 * periods                since the start; 0: no force yet
 * age                    periods since the last update of the lower bounds
 * information            inverse variance of each coefficient from slips; zero for a finger that never slipped
 * slip_ratio             coefficient of each finger from slips
 * stick_ratio            lower bound of each finger from sticking
 * since_slip             periods since the last slip of each finger that was used
 * found_ratio            ratio of each finger when it was last found slipping
 * since_found            periods since then
 * slid                   slip of each finger that was found so far, m
 * lower, upper, expected result: bounds, infinite above for a finger that never slipped, and the likely coefficient */
#define GF_BOUND_STATE_FIELDS(FIELD)  \
    FIELD(f, contact_count, 3)        \
    FIELD(periods, 1)                 \
    FIELD(age, 1)                     \
    FIELD(information, contact_count) \
    FIELD(slip_ratio, contact_count)  \
    FIELD(stick_ratio, contact_count) \
    FIELD(since_slip, contact_count)  \
    FIELD(found_ratio, contact_count) \
    FIELD(since_found, contact_count) \
    FIELD(slid, contact_count)        \
    FIELD(lower, contact_count)       \
    FIELD(upper, contact_count)       \
    FIELD(expected, contact_count)

typedef struct {
#define GF_POINTER(name, ...) double *name;
    GF_BOUND_STATE_FIELDS(GF_POINTER)
#undef GF_POINTER
} gf_bound_state;

/* Forces and slip of one period.
 *
 * forces, gains  contact forces with their gains
 * has_tips       whether fingertip sensors measured the forces
 * slipping       (N) nonzero if a finger slips, or did so a short time ago
 * alarms         (N) nonzero if slip of the finger was found in this period
 * distance       (N, 2) slip along t1 and t2 at the last alarm, m
 * has_alarm      whether slip of any finger was found
 * is_certain     whether the fingers of the last alarm are certain */
typedef struct {
    const gf_contact_force *forces;
    const gf_force_gains *gains;
    const unsigned char *slipping, *alarms;
    const double *distance;
    int has_tips, has_alarm, is_certain;
} gf_bound_inputs;

/* Compute the state after a period. `next` is written; it must not overlap `last`. Return whether the coefficients were updated. */
int gf_friction_bounds_step(const gf_bound_settings *settings, const gf_bound_inputs *inputs, const gf_bound_state *last,
                            const gf_bound_state *next);

#ifdef __cplusplus
}
#endif

#endif
