/* Compensation of joint friction in one step of the object controller.
 *
 * The planned joint rates make the desired twist with rolling contacts, and the compensation is that of the friction model along
 * them, with observed Coulomb levels:
 *
 *     v   = v_d + A⁺ (B V_d − A v_d)
 *     tau = (c + s e^(−(v/v_s)²)) tanh(v/ε) + b v
 *
 * The levels c follow the feedback torque of the joints, their common part mainly the torque that acts along V_d. The laws are stated
 * in friction_compensation.py and disturbance_observer.py in graspforce/control/friction, the reference implementation in Python,
 * which the tests compare with this one.
 *
 * Matrices are stored by rows, and arrays are contiguous. H is the hand's base, O the object. No function allocates memory or
 * writes global state.
 */
#ifndef GF_FRICTION_STEP_H
#define GF_FRICTION_STEP_H

#include <stddef.h>

#include "graspforce/contact_kinematics.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Settings and friction model: FIELD(name, shape). The shapes depend on motor_count (n).
 *
 * smoothing_rate     ε, rad/s
 * rest_rate          the plan is at rest if all planned rates are below it, rad/s
 * damping            of A Aᵀ relative to its mean eigenvalue, for singular contacts
 * rate_common        share of the common level's error that vanishes in a period, from feedback along V_d
 * rate_across        the same from other feedback
 * rate_joint         the same of the differences between joints
 * rate_forgetting    share of the differences that is forgotten in a period of motion
 * kp, kd             gains on the pose error, 1/s² and 1/s
 * mass               mass matrix of the object about O, in O
 * inertia            of the joints, kg·m²
 * share              expected friction of each joint relative to the mean
 * largest            bound of the levels, N·m
 * stribeck, stribeck_velocity, viscous  s in N·m, v_s in rad/s and b in N·m·s/rad */
#define GF_FRICTION_FIELDS(FIELD)         \
    FIELD(smoothing_rate, 1)              \
    FIELD(rest_rate, 1)                   \
    FIELD(damping, 1)                     \
    FIELD(rate_common, 1)                 \
    FIELD(rate_across, 1)                 \
    FIELD(rate_joint, 1)                  \
    FIELD(rate_forgetting, 1)             \
    FIELD(kp, 6)                          \
    FIELD(kd, 6)                          \
    FIELD(mass, 36)                       \
    FIELD(inertia, motor_count)           \
    FIELD(share, motor_count)             \
    FIELD(largest, motor_count)           \
    FIELD(stribeck, motor_count)          \
    FIELD(stribeck_velocity, motor_count) \
    FIELD(viscous, motor_count)

typedef struct {
    int motor_count;
    int observes; /* nonzero if the levels follow the feedback torque */
#define GF_POINTER(name, ...) const double *name;
    GF_FRICTION_FIELDS(GF_POINTER)
#undef GF_POINTER
} gf_friction;

/* Plan and measurement of a step. */
typedef struct {
    const double *R_HO;    /* (3, 3) measured axes of the object in H */
    const double *twist;   /* (6) measured twist of the object in H */
    const double *twist_d; /* (6) desired twist in H */
    const double *error;   /* (6) pose error in H, m and rad */
    const double *v_d;     /* (motor_count) desired rates of the joints beside the contacts, rad/s; NULL for zeros */
    const double *level;   /* (motor_count) levels before the step, N·m */
} gf_friction_inputs;

/* Result of a step.
 *
 * tau    torques that overcome friction, N·m
 * level  levels after the step, N·m
 * v      planned joint rates, rad/s */
#define GF_FRICTION_RESULT_FIELDS(FIELD) \
    FIELD(tau, motor_count)              \
    FIELD(level, motor_count)            \
    FIELD(v, motor_count)

typedef struct {
#define GF_POINTER(name, ...) double *name;
    GF_FRICTION_RESULT_FIELDS(GF_POINTER)
#undef GF_POINTER
} gf_friction_result;

enum { GF_FRICTION_FAILED = -1, GF_FRICTION_MOVES = 0, GF_FRICTION_RESTS = 1 };

/* Return the numbers of workspace that gf_friction_step() needs for a number of constraint rows. */
size_t gf_friction_work_size(const gf_friction *friction, int rows);

/* Compute the compensation of a step.
 *
 * constraints  A and B of the contacts, B in O; beta is not used
 * work         gf_friction_work_size() numbers
 *
 * Return whether the plan moves or rests; GF_FRICTION_FAILED if a number is not finite, and the result is then undefined. */
int gf_friction_step(const gf_friction *friction, const gf_constraints *constraints, const gf_friction_inputs *inputs,
                     double *work, const gf_friction_result *result);

#ifdef __cplusplus
}
#endif

#endif
