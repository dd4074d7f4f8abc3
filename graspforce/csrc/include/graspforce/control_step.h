/* One step of the object controller, except for the hand's inverse dynamics and the force solve.
 *
 * A step calls
 *
 *     gf_compute_targets()    a = a_d + K_d (V_d − V) + K_p e + K_i ∫ e dt, the joint accelerations q̈ that keep the
 *                             contacts, and the wrench w that the object needs for a
 *     the caller              tau_u = M q̈ + h
 *     gf_apply_slip_margin()  the shifted problem, whose usual cones keep a slip margin
 *     the caller              contact forces f of least torque, such as by gf_solve()
 *     gf_compute_result()     tau = tau_u + Jᵀ f within the torque limits, the sliding, and the integral
 *
 * The reference implementation in Python, which the tests compare with this one, is graspforce/control/object_controller.py.
 *
 * The macros below list the fields of each structure: FIELD(name, shape). Bindings to other languages take names, shapes and
 * order from them. The shapes depend on five numbers, which must be defined where a macro is used:
 *
 *     contact_count     N
 *     motor_count       n
 *     joint_count       joints of the kinematic tree, coupled ones included
 *     constraint_count  rows of the contact constraints
 *     force_size        components of the contact forces
 *
 * All arrays are contiguous and stored by rows. H is the hand's base, O the object, L a link, F a fingertip, C a contact.
 * No function allocates memory or writes global state, so a grasp may be used by several threads.
 */
#ifndef GF_CONTROL_STEP_H
#define GF_CONTROL_STEP_H

#include <stddef.h>

#include "graspforce/contact_kinematics.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Numbers of a grasp and of the controller's settings.
 *
 * posture_stiffness, posture_damping  of the joints towards their posture, 1/s² and 1/s
 * rank_tolerance     see gf_joint_accelerations()
 * spin_damping, spin_damping_start  λ₀ and σ₀ of the spin rows, see gf_joint_accelerations(), m/rad
 * period             time between two steps, s
 * creep_decay        factor of the sliding after one period
 * creep_limit        sliding distance from which a fingertip slips, m
 * contact_tolerance  gap from which a fingertip has lost contact, m
 * mass               of the object, kg */
#define GF_GRASP_NUMBERS(FIELD) \
    FIELD(posture_stiffness)    \
    FIELD(posture_damping)      \
    FIELD(rank_tolerance)       \
    FIELD(spin_damping)         \
    FIELD(spin_damping_start)   \
    FIELD(period)               \
    FIELD(creep_decay)          \
    FIELD(creep_limit)          \
    FIELD(contact_tolerance)    \
    FIELD(mass)

/* Numbers of a grasp that are 0 unless its contacts are soft.
 *
 * spin_compliance, spin_compliance_start  ℓ₀ and σ₁ of the object, see gf_joint_accelerations(), m/rad */
#define GF_SOFT_GRASP_NUMBERS(FIELD) \
    FIELD(spin_compliance)           \
    FIELD(spin_compliance_start)

/* Arrays of a grasp and of the controller's settings.
 *
 * kp, kd, ki         gains on the pose error, 1/s², 1/s and 1/s³
 * integral_limits    largest linear and angular acceleration from the integral, m/s² and rad/s²
 * gravity_H          acceleration of gravity in H, m/s²
 * inertia            of the object about its centre of mass, in O, kg·m²
 * p_OM               centre of mass in O, m
 * radii              of the fingertips, m; 0 for a tip that touches with its origin
 * p_OC, R_OC         contact points in O, m, and contact frames at the start of the grasp
 * q                  posture of the grasp, rad
 * max_posture_pull   largest acceleration towards the posture, rad/s²
 * p_LF, R_LF         tip frames in the links that carry them, p in m
 * T                  motor rates to joint rates
 * torque_limits      lower and upper limits, N·m
 * saturation_limits  torques from which a motor counts as saturated, N·m
 * q_limits           lower and upper joint positions, rad */
#define GF_GRASP_ARRAYS(FIELD)               \
    FIELD(kp, 6)                             \
    FIELD(kd, 6)                             \
    FIELD(ki, 6)                             \
    FIELD(integral_limits, 2)                \
    FIELD(gravity_H, 3)                      \
    FIELD(inertia, 3, 3)                     \
    FIELD(p_OM, 3)                           \
    FIELD(radii, contact_count)              \
    FIELD(p_OC, contact_count, 3)            \
    FIELD(R_OC, contact_count, 3, 3)         \
    FIELD(q, motor_count)                    \
    FIELD(max_posture_pull, motor_count)     \
    FIELD(p_LF, contact_count, 3)            \
    FIELD(R_LF, contact_count, 3, 3)         \
    FIELD(T, joint_count, motor_count)       \
    FIELD(torque_limits, 2, motor_count)     \
    FIELD(saturation_limits, 2, motor_count) \
    FIELD(q_limits, 2, motor_count)

/* A grasp and the controller's settings, constant during all steps.
 *
 * The rows of contact constraints and contact forces are given as 4 i + c for contact i: c = 0, 1 and 2 for t1, t2 and n, c = 3
 * for the spin or moment about n. */
typedef struct {
    int contact_count, motor_count, joint_count, constraint_count, force_size;
    gf_surface surface;
#define GF_NUMBER(name)       gf_real name;
#define GF_POINTER(name, ...) const gf_real *name;
    GF_GRASP_NUMBERS(GF_NUMBER)
    GF_SOFT_GRASP_NUMBERS(GF_NUMBER)
    GF_GRASP_ARRAYS(GF_POINTER)
#undef GF_POINTER
#undef GF_NUMBER
    const unsigned char *moves_tip; /* (contact_count, joint_count) nonzero if the joint moves the tip */
    const int *constraint_rows;     /* (constraint_count) */
    const int *force_rows;          /* (force_size) */
} gf_controlled_grasp;

/* Inputs of gf_compute_targets().
 *
 * q, v              measured joint positions and rates of the motors, rad and rad/s
 * p_HO, R_HO        measured pose of the object, p in m
 * twist             measured twist of the object in H, m/s and rad/s
 * p_d, R_d          desired pose of the object in H, p in m
 * twist_d           desired twist in H, m/s and rad/s
 * acceleration_d    desired acceleration in H, m/s² and rad/s²
 * integral          integral of the pose error, m·s and rad·s
 * R_OC_last         contact frames at the last step
 * joint_twists      twist of the links after each joint, at H's origin, for unit rate, in columns
 * joint_twist_rates time derivatives of joint_twists */
#define GF_STEP_INPUTS(FIELD)             \
    FIELD(q, motor_count)                 \
    FIELD(v, motor_count)                 \
    FIELD(p_HO, 3)                        \
    FIELD(R_HO, 3, 3)                     \
    FIELD(twist, 6)                       \
    FIELD(p_d, 3)                         \
    FIELD(R_d, 3, 3)                      \
    FIELD(twist_d, 6)                     \
    FIELD(acceleration_d, 6)              \
    FIELD(integral, 6)                    \
    FIELD(R_OC_last, contact_count, 3, 3) \
    FIELD(joint_twists, 6, joint_count)   \
    FIELD(joint_twist_rates, 6, joint_count)

/* Inputs that may be NULL.
 *
 * q_d       desired joint positions, rad; NULL: the posture of the grasp
 * v_d, a_d  desired joint rates and accelerations, rad/s and rad/s²; NULL: zero
 * external  external wrench on the object without gravity, about O's origin in O, N and N·m; NULL: zero
 * spin_acceleration  commanded accelerations of the fingers' spins about the normals, rad/s²; NULL: zero */
#define GF_OPTIONAL_STEP_INPUTS(FIELD) \
    FIELD(q_d, motor_count)            \
    FIELD(v_d, motor_count)            \
    FIELD(a_d, motor_count)            \
    FIELD(external, 6)                 \
    FIELD(spin_acceleration, contact_count)

typedef struct {
#define GF_POINTER(name, ...) const gf_real *name;
    GF_STEP_INPUTS(GF_POINTER)
    GF_OPTIONAL_STEP_INPUTS(GF_POINTER)
#undef GF_POINTER
    const gf_real *link_poses; /* (contact_count, 12) of the links that carry the tips: p_HL in m, then R_HL */
} gf_step_inputs;

/* Outputs of gf_compute_targets(). GF_CONTACT_FIELDS follow in the same block.
 *
 * error                  pose error in H: p_d − p, m, and log(R_d Rᵀ), rad
 * acceleration_H         commanded acceleration of the object in H, m/s² and rad/s²
 * acceleration_O         the same in O
 * w                      wrench that the contacts must supply, about O's origin in O, N and N·m
 * joint_acceleration     rad/s²
 * J                      contact Jacobian */
#define GF_TARGET_FIELDS(FIELD)            \
    FIELD(error, 6)                        \
    FIELD(acceleration_H, 6)               \
    FIELD(acceleration_O, 6)               \
    FIELD(w, 6)                            \
    FIELD(joint_acceleration, motor_count) \
    FIELD(J, force_size, motor_count)

typedef struct {
#define GF_POINTER(name, ...) gf_real *name;
    GF_TARGET_FIELDS(GF_POINTER)
#undef GF_POINTER
    gf_contacts contacts;
} gf_step_targets;

/* Return the numbers in the block of a grasp's targets. */
size_t gf_targets_size(const gf_controlled_grasp *grasp);

/* Return the targets whose fields follow one another in a block. */
gf_step_targets gf_map_targets(const gf_controlled_grasp *grasp, gf_real *block);

/* Return the numbers of workspace that gf_compute_targets() needs. */
size_t gf_targets_work_size(const gf_controlled_grasp *grasp);

/* Compute the targets of a step. Return 1, or 0 if the fingers may not be able to make every twist of the object.
 *
 * With 0, `acceleration_H` and `acceleration_O` are the commanded ones, and `joint_acceleration` and `w` are not written. */
int gf_compute_targets(const gf_controlled_grasp *grasp, const gf_step_inputs *inputs, gf_real *work,
                       const gf_step_targets *targets);

/* Compute w − G n s/μ and tau_u + Jᵀ n s/μ: with them the usual cones keep the slip margin s.
 *
 * tau_u        (motor_count) torques without contact forces, N·m
 * shift        (contact_count) shift s/μ of each normal force, N
 * w_shifted    (6) written, N and N·m
 * tau_shifted  (motor_count) written, N·m */
void gf_apply_slip_margin(const gf_controlled_grasp *grasp, const gf_step_targets *targets, const gf_real *tau_u,
                          const gf_real *shift, gf_real *w_shifted, gf_real *tau_shifted);

/* When the integral of the pose error grows. */
typedef enum {
    GF_INTEGRAL_NEVER = 0,
    GF_INTEGRAL_UNLESS_SATURATED = 1, /* unless a motor is at its torque limit */
    GF_INTEGRAL_ALWAYS = 2
} gf_integral_rule;

/* Inputs of gf_compute_result().
 *
 * q               measured joint positions, rad
 * tau_u           torques without contact forces, N·m
 * f               contact forces in the contact frames, N and N·m
 * integral        integral of the pose error after the last step, m·s and rad·s
 * creep           recent sliding along t1 and t2 after the last step, m
 * p_OF, R_OF      tip frames in O at the last step, p in m
 * p_OC            contact points in O at the last step, m */
#define GF_RESULT_INPUTS(FIELD)      \
    FIELD(q, motor_count)            \
    FIELD(tau_u, motor_count)        \
    FIELD(f, force_size)             \
    FIELD(integral, 6)               \
    FIELD(creep, contact_count, 2)   \
    FIELD(p_OF, contact_count, 3)    \
    FIELD(R_OF, contact_count, 3, 3) \
    FIELD(p_OC, contact_count, 3)

typedef struct {
#define GF_POINTER(name, ...) const gf_real *name;
    GF_RESULT_INPUTS(GF_POINTER)
#undef GF_POINTER
    gf_integral_rule integral_rule;
} gf_result_inputs;

/* Outputs of gf_compute_result().
 *
 * tau             motor torques within their limits, N·m
 * creep           recent sliding along t1 and t2, m
 * creep_distance  its length, m
 * integral        integral of the pose error, m·s and rad·s */
#define GF_RESULT_FIELDS(FIELD)          \
    FIELD(tau, motor_count)              \
    FIELD(creep, contact_count, 2)       \
    FIELD(creep_distance, contact_count) \
    FIELD(integral, 6)

typedef struct {
#define GF_POINTER(name, ...) gf_real *name;
    GF_RESULT_FIELDS(GF_POINTER)
#undef GF_POINTER
} gf_step_result;

/* Return the numbers in the block of a step's result. */
size_t gf_result_size(const gf_controlled_grasp *grasp);

/* Return the result whose fields follow one another in a block. */
gf_step_result gf_map_result(const gf_controlled_grasp *grasp, gf_real *block);

/* Flags that gf_compute_result() returns. */
enum {
    GF_SATURATED = 1,    /* a motor is at its torque limit */
    GF_CONTACT_LOST = 2, /* a fingertip slips or has lost contact */
    GF_JOINT_LIMIT = 4   /* a joint is at its position limit */
};

/* Compute torques, sliding and integral from the contact forces. Return the flags that apply, or 0. */
int gf_compute_result(const gf_controlled_grasp *grasp, const gf_step_targets *targets, const gf_result_inputs *inputs,
                      const gf_step_result *result);

#ifdef __cplusplus
}
#endif

#endif
