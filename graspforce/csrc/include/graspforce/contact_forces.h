/* Contact forces of a grasp from joint torques, with or without fingertip force sensors.
 *
 * Contacts add Aᵀ f to the torques tau_u of the hand's own motion:
 *
 *     Aᵀ f = tau − tau_u − M d,
 *
 * with the deviation d of the joint accelerations from the commanded ones. Fingertip sensors measure f directly. Both sources
 * are fused by weighted least squares; the gains are constant over some periods. The laws are stated in
 * graspforce/estimation/contact_forces.py, the reference implementation in Python, which the tests compare with this one.
 *
 * Frames: H is the hand's base, C a contact. Matrices are stored by rows, and arrays are contiguous. No function allocates memory
 * or writes global state.
 */
#ifndef GF_CONTACT_FORCES_H
#define GF_CONTACT_FORCES_H

#include <stddef.h>

#include "graspforce/contact_pose.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Errors of a hand's torques and sensors, as standard deviations: FIELD(name, shape).
 *
 * torque_noise, tip_noise  noise of a joint torque, N·m, and of a component of a fingertip force, N
 * disturbance_error        of the deviation d, rad/s²
 * torque_bias, tip_bias    constant errors, N·m and N
 * torque_scale, tip_scale  constant errors relative to the value
 * prior                    inverse variance of each component of a contact force before any measurement, 1/N²
 * gamma                    torsional friction lengths, m */
#define GF_FORCE_MODEL_FIELDS(FIELD) \
    FIELD(torque_noise, 1)           \
    FIELD(tip_noise, 1)              \
    FIELD(disturbance_error, 1)      \
    FIELD(torque_bias, 1)            \
    FIELD(torque_scale, 1)           \
    FIELD(tip_bias, 1)               \
    FIELD(tip_scale, 1)              \
    FIELD(prior, 3 * contact_count)  \
    FIELD(gamma, contact_count)

typedef struct {
    int contact_count, motor_count;
#define GF_POINTER(name, ...) const double *name;
    GF_FORCE_MODEL_FIELDS(GF_POINTER)
#undef GF_POINTER
} gf_force_model;

/* Gains of the forces of N contacts, and their covariances: FIELD(name, shape).
 *
 * from_torque     fused forces per torque residual tau − tau_u, 1/m
 * from_tips       fused forces per measured fingertip force; for the covariances only
 * inertia         fused forces per deviation of a joint acceleration, kg·m
 * torque_only     forces from torques alone, per torque residual, 1/m
 * noise, bias     covariances of the errors that are independent between periods, and of the constant errors, N²
 * mismatch_noise  covariance of the noise of `mismatch` of each contact, N² */
#define GF_FORCE_GAIN_FIELDS(FIELD)                        \
    FIELD(from_torque, 3 * contact_count, motor_count)     \
    FIELD(from_tips, 3 * contact_count, 3 * contact_count) \
    FIELD(inertia, 3 * contact_count, motor_count)         \
    FIELD(torque_only, 3 * contact_count, motor_count)     \
    FIELD(noise, 3 * contact_count, 3 * contact_count)     \
    FIELD(bias, 3 * contact_count, 3 * contact_count)      \
    FIELD(mismatch_noise, contact_count, 3, 3)

typedef struct {
#define GF_POINTER(name, ...) double *name;
    GF_FORCE_GAIN_FIELDS(GF_POINTER)
#undef GF_POINTER
} gf_force_gains;

/* Measurements of one period.
 *
 * tau         (n) joint torques during the last period, without joint friction, N·m
 * tau_u       (n) torques of the hand's own motion without contact, N·m
 * deviation   (n) d, rad/s²
 * tip_wrench  (N, 6) measured forces and moments of the fingers on the object, in H, N and N·m; NULL without sensors */
typedef struct {
    const double *tau, *tau_u, *deviation, *tip_wrench;
} gf_force_inputs;

/* Forces of N contacts in their frames, N: FIELD(name, shape).
 *
 * f         fused forces
 * inertial  their part from the deviation d
 * mismatch  forces of the fingertip sensors less those from torques without d; zero without sensors
 * measured  forces of the fingertip sensors; zero without sensors */
#define GF_CONTACT_FORCE_FIELDS(FIELD) \
    FIELD(f, contact_count, 3)         \
    FIELD(inertial, contact_count, 3)  \
    FIELD(mismatch, contact_count, 3)  \
    FIELD(measured, contact_count, 3)

typedef struct {
#define GF_POINTER(name, ...) double *name;
    GF_CONTACT_FORCE_FIELDS(GF_POINTER)
#undef GF_POINTER
} gf_contact_force;

/* Return the numbers of workspace that gf_compute_force_gains() needs. */
size_t gf_force_gains_work_size(int contact_count, int motor_count);

/* Compute the gains at the present contacts.
 *
 * model   errors of the hand and its sensors
 * pose    the contacts; R_HO, R_OC, A and spin_A are used
 * M       (n, n) mass matrix, kg·m²
 * inputs  tau and tip_wrench are used
 * work    workspace
 * gains   written
 *
 * Return 1, or 0 if a covariance is not positive definite; `gains` is then undefined. */
int gf_compute_force_gains(const gf_force_model *model, const gf_contact_pose *pose, const double *M,
                           const gf_force_inputs *inputs, double *work, const gf_force_gains *gains);

/* Compute the contact forces of a period.
 *
 * contact_count, motor_count  N and n
 * gains   of gf_compute_force_gains(), with or without fingertip sensors as in `inputs`
 * pose    the contacts; R_HO, R_OC and A are used
 * inputs  the measurements
 * forces  written */
void gf_compute_contact_forces(int contact_count, int motor_count, const gf_force_gains *gains, const gf_contact_pose *pose,
                               const gf_force_inputs *inputs, const gf_contact_force *forces);

#ifdef __cplusplus
}
#endif

#endif
