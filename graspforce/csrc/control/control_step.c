/* Implementation of control_step.h. */
#include "graspforce/control_step.h"

#include <string.h>

#include "../real.inc"
#include "pose_error.inc"
#include "tip_motion.inc"
#include "vector3.inc"

static const double SPIN_ARM = 0.03; /* m: as in graspforce/control/contacts/contact_constraints.py */

enum { NORMAL = 2, SPIN = 3 }; /* components of a contact */

/* Define the numbers that the shapes of the field macros depend on. */
#define GF_DEFINE_SIZES(grasp)                                                                               \
    const size_t contact_count = (size_t)(grasp)->contact_count, motor_count = (size_t)(grasp)->motor_count; \
    const size_t force_size = (size_t)(grasp)->force_size;                                                   \
    (void)force_size

/* Return the product of up to three numbers. */
static size_t gf_product(size_t a, size_t b, size_t c)
{
    return a * b * c;
}

#define GF_SIZE_3(a, b, c, ...) gf_product(a, b, c)
#define GF_SIZE(...)            GF_SIZE_3(__VA_ARGS__, 1, 1, 1)

size_t gf_targets_size(const gf_controlled_grasp *grasp)
{
    GF_DEFINE_SIZES(grasp);
    size_t size = 0;
#define GF_ADD(name, ...)              size += GF_SIZE(__VA_ARGS__);
#define GF_ADD_CONTACT(name, one, ...) size += GF_SIZE(__VA_ARGS__);
    GF_TARGET_FIELDS(GF_ADD)
    GF_CONTACT_FIELDS(GF_ADD_CONTACT)
#undef GF_ADD_CONTACT
#undef GF_ADD
    return size;
}

gf_step_targets gf_map_targets(const gf_controlled_grasp *grasp, double *block)
{
    GF_DEFINE_SIZES(grasp);
    gf_step_targets targets;
#define GF_PLACE(name, ...)              targets.name = block, block += GF_SIZE(__VA_ARGS__);
#define GF_PLACE_CONTACT(name, one, ...) targets.contacts.name = block, block += GF_SIZE(__VA_ARGS__);
    GF_TARGET_FIELDS(GF_PLACE)
    GF_CONTACT_FIELDS(GF_PLACE_CONTACT)
#undef GF_PLACE_CONTACT
#undef GF_PLACE
    return targets;
}

size_t gf_result_size(const gf_controlled_grasp *grasp)
{
    GF_DEFINE_SIZES(grasp);
    size_t size = 0;
#define GF_ADD(name, ...) size += GF_SIZE(__VA_ARGS__);
    GF_RESULT_FIELDS(GF_ADD)
#undef GF_ADD
    return size;
}

gf_step_result gf_map_result(const gf_controlled_grasp *grasp, double *block)
{
    GF_DEFINE_SIZES(grasp);
    gf_step_result result;
#define GF_PLACE(name, ...) result.name = block, block += GF_SIZE(__VA_ARGS__);
    GF_RESULT_FIELDS(GF_PLACE)
#undef GF_PLACE
    return result;
}

/* Compute the pose error and a = a_d + K_d (V_d − V) + K_p e + K_i ∫ e dt. */
static void gf_object_acceleration(const gf_controlled_grasp *grasp, const gf_step_inputs *inputs,
                                   const gf_step_targets *targets)
{
    gf_pose_error(inputs->p_d, inputs->R_d, inputs->p_HO, inputs->R_HO, targets->error);
    for (int k = 0; k < 6; k++)
        targets->acceleration_H[k] = inputs->acceleration_d[k] + grasp->kd[k] * (inputs->twist_d[k] - inputs->twist[k]) +
                                     grasp->kp[k] * targets->error[k] + grasp->ki[k] * inputs->integral[k];
    gf_multiply_transposed(inputs->R_HO, targets->acceleration_H, targets->acceleration_O);
    gf_multiply_transposed(inputs->R_HO, targets->acceleration_H + 3, targets->acceleration_O + 3);
}

/* Compute the contacts of all tips. `joint_rates` (joint_count) and `rates` (6, n + 2) are workspace. */
static void gf_compute_contacts(const gf_controlled_grasp *grasp, const gf_step_inputs *inputs, double *joint_rates,
                                double *rates, const gf_contacts *contacts)
{
    const int n = grasp->motor_count, joint_count = grasp->joint_count;
    const gf_joint_motion joints = {n, joint_count, grasp->T, joint_rates, inputs->joint_twists, inputs->joint_twist_rates};
    gf_object_state object = {.surface = grasp->surface};
    memcpy(object.p_HO, inputs->p_HO, sizeof object.p_HO);
    memcpy(object.R_HO, inputs->R_HO, sizeof object.R_HO);
    memcpy(object.twist, inputs->twist, sizeof object.twist);
    for (int j = 0; j < joint_count; j++) {
        joint_rates[j] = 0.0;
        for (int i = 0; i < n; i++) joint_rates[j] += grasp->T[j * n + i] * inputs->v[i];
    }
    for (int i = 0; i < grasp->contact_count; i++) {
        gf_fingertip tip = {.motor_count = n, .radius = grasp->radii[i], .rates = rates};
        const gf_contacts contact = gf_contact_at(contacts, i, n);
        gf_tip_pose(inputs->link_poses + 12 * i, grasp->p_LF + 3 * i, grasp->R_LF + 9 * i, tip.p_HF, tip.R_HF);
        gf_tip_rates(&joints, tip.p_HF, grasp->moves_tip + i * joint_count, rates);
        memcpy(tip.p_OC_start, grasp->p_OC + 3 * i, sizeof tip.p_OC_start);
        memcpy(tip.R_OC_start, grasp->R_OC + 9 * i, sizeof tip.R_OC_start);
        memcpy(tip.R_OC_last, inputs->R_OC_last + 9 * i, sizeof tip.R_OC_last);
        gf_compute_contact(&object, &tip, &contact);
    }
}

/* Gather rows of given width from `points` (3 N rows) and `spins` (N rows), which are scaled by `arm`. `rows` holds 4 i + c. */
static void gf_gather_rows(int count, const int *rows, int width, const double *points, const double *spins, double arm,
                           double *gathered)
{
    for (int i = 0; i < count; i++, gathered += width) {
        const int contact = rows[i] / 4, component = rows[i] % 4, is_spin = component == SPIN;
        const double *row = is_spin ? spins + contact * width : points + (3 * contact + component) * width;
        for (int j = 0; j < width; j++) gathered[j] = (is_spin ? arm : 1.0) * row[j];
    }
}

/* Compute the wrench that the object needs, about O's origin in O; see Body.wrench in graspforce/grasp/body.py.
 *
 * p_ddot  acceleration of O's origin less that of gravity, m/s² */
static void gf_body_wrench(const gf_controlled_grasp *grasp, const double p_ddot[3], const double alpha[3],
                           const double omega[3], double w[6])
{
    const double *c = grasp->p_OM;
    gf_vector3 torque, momentum, u, tangential, centripetal, gyroscopic, moment;
    gf_multiply_transposed(grasp->inertia, alpha, torque);   /* N·m; the inertia is symmetric */
    gf_multiply_transposed(grasp->inertia, omega, momentum); /* kg·m²/s */
    gf_cross(omega, c, u);                                   /* m/s */
    gf_cross(alpha, c, tangential);
    gf_cross(omega, u, centripetal);
    for (int k = 0; k < 3; k++) w[k] = grasp->mass * (p_ddot[k] + tangential[k] + centripetal[k]); /* N */
    gf_cross(omega, momentum, gyroscopic);
    gf_cross(c, w, moment);
    for (int k = 0; k < 3; k++) w[3 + k] = torque[k] + gyroscopic[k] + moment[k];
}

/* Compute N with N Nᵀ = m M⁻¹, (6, 6), for the mass matrix M about O. An inertia that is not positive definite gives NaN.
 *
 * A wrench turns the object with √m L⁻ᵀ about its centre of mass, where L Lᵀ is the inertia; O moves along by p_OM × α. */
static void gf_object_mobility(const gf_controlled_grasp *grasp, double *N)
{
    const double *I = grasp->inertia, root = sqrt(grasp->mass);
    const double a = sqrt(I[0]), b = I[3] / a, c = I[6] / a, d = sqrt(I[4] - b * b), e = (I[7] - b * c) / d;
    const double f = sqrt(I[8] - c * c - e * e);
    const double columns[3][3] = {{root / a, 0.0, 0.0}, /* of √m L⁻ᵀ */
                                  {-root * b / (a * d), root / d, 0.0},
                                  {root * (b * e - c * d) / (a * d * f), -root * e / (d * f), root / f}};
    memset(N, 0, 36 * sizeof(double));
    for (int k = 0; k < 3; k++) {
        gf_vector3 linear;
        gf_cross(grasp->p_OM, columns[k], linear);
        N[7 * k] = 1.0;
        for (int i = 0; i < 3; i++) N[6 * i + 3 + k] = linear[i], N[6 * (3 + i) + 3 + k] = columns[k][i];
    }
}

/* Compute the joint accelerations of the posture, rad/s²: a_d + damping (v_d − v) + stiffness (q_d − q), the last limited. */
static void gf_posture_acceleration(const gf_controlled_grasp *grasp, const gf_step_inputs *inputs, double *posture)
{
    const double *q_d = inputs->q_d == NULL ? grasp->q : inputs->q_d;
    for (int j = 0; j < grasp->motor_count; j++) {
        const double v_d = inputs->v_d == NULL ? 0.0 : inputs->v_d[j], a_d = inputs->a_d == NULL ? 0.0 : inputs->a_d[j];
        double pull = grasp->posture_stiffness * (q_d[j] - inputs->q[j]);
        if (pull > grasp->max_posture_pull[j]) pull = grasp->max_posture_pull[j];
        if (pull < -grasp->max_posture_pull[j]) pull = -grasp->max_posture_pull[j];
        posture[j] = a_d + grasp->posture_damping * (v_d - inputs->v[j]) + pull;
    }
}

size_t gf_targets_work_size(const gf_controlled_grasp *grasp)
{
    const size_t n = (size_t)grasp->motor_count, r = (size_t)grasp->constraint_count, joint_count = (size_t)grasp->joint_count;
    return joint_count + 6 * (n + 2) + r * (n + 7) + r * (r + 7) + n;
}

int gf_compute_targets(const gf_controlled_grasp *grasp, const gf_step_inputs *inputs, double *work,
                       const gf_step_targets *targets)
{
    const int n = grasp->motor_count, r = grasp->constraint_count, *rows = grasp->constraint_rows;
    double *joint_rates = work, *rates = joint_rates + grasp->joint_count, *A = rates + 6 * (n + 2), *B = A + r * n;
    double *beta = B + 6 * r, *K = beta + r, *posture = K + r * (r + 7);
    const gf_contacts *contacts = &targets->contacts;
    gf_object_acceleration(grasp, inputs, targets);
    gf_compute_contacts(grasp, inputs, joint_rates, rates, contacts);
    gf_gather_rows(grasp->force_size, grasp->force_rows, n, contacts->A, contacts->spin_A, 1.0, targets->J);
    gf_gather_rows(r, rows, n, contacts->A, contacts->spin_A, SPIN_ARM, A);
    gf_gather_rows(r, rows, 6, contacts->B, contacts->spin_B, SPIN_ARM, B);
    gf_gather_rows(r, rows, 1, contacts->beta, contacts->spin_beta, SPIN_ARM, beta);
    gf_posture_acceleration(grasp, inputs, posture);
    int spin_count = 0;
    for (int i = 0; i < r; i++) {
        if (rows[i] % 4 != SPIN) continue;
        spin_count++;
        if (inputs->spin_acceleration != NULL) beta[i] += SPIN_ARM * inputs->spin_acceleration[rows[i] / 4];
    }
    double mobility[36];
    if (grasp->spin_compliance > 0.0) gf_object_mobility(grasp, mobility);
    const gf_constraints constraints = {r,
                                        n,
                                        A,
                                        B,
                                        beta,
                                        spin_count,
                                        grasp->spin_damping,
                                        grasp->spin_damping_start,
                                        grasp->spin_compliance,
                                        grasp->spin_compliance_start,
                                        mobility};
    double *acceleration = targets->acceleration_O;
    if (!gf_joint_accelerations(&constraints, acceleration, posture, grasp->rank_tolerance, K, targets->joint_acceleration))
        return 0;
    if (grasp->spin_compliance > 0.0) { /* the object may yield */
        gf_multiply(inputs->R_HO, acceleration, targets->acceleration_H);
        gf_multiply(inputs->R_HO, acceleration + 3, targets->acceleration_H + 3);
    }

    gf_vector3 p_ddot, omega, g;
    gf_multiply_transposed(inputs->R_HO, grasp->gravity_H, g);
    gf_multiply_transposed(inputs->R_HO, inputs->twist + 3, omega);
    for (int k = 0; k < 3; k++) p_ddot[k] = acceleration[k] - g[k];
    gf_body_wrench(grasp, p_ddot, acceleration + 3, omega, targets->w);
    for (int k = 0; k < 6; k++) targets->w[k] -= inputs->external == NULL ? 0.0 : inputs->external[k];
    return 1;
}

void gf_apply_slip_margin(const gf_controlled_grasp *grasp, const gf_step_targets *targets, const double *tau_u,
                          const double *shift, double *w_shifted, double *tau_shifted)
{
    const int n = grasp->motor_count;
    const double *A = targets->contacts.A, *B = targets->contacts.B;
    memcpy(w_shifted, targets->w, 6 * sizeof(double));
    memcpy(tau_shifted, tau_u, (size_t)n * sizeof(double));
    for (int i = 0; i < grasp->contact_count; i++) {
        const int row = 3 * i + NORMAL;
        for (int k = 0; k < 6; k++) w_shifted[k] -= shift[i] * B[6 * row + k];
        for (int j = 0; j < n; j++) tau_shifted[j] += shift[i] * A[row * n + j];
    }
}

/* Return whether a component of x is not strictly between its bounds, (2, n). NaN counts as outside. */
static int gf_is_outside(int n, const double *x, const double *bounds)
{
    int inside = 1;
    for (int j = 0; j < n; j++) inside &= (x[j] - bounds[j]) * (bounds[n + j] - x[j]) > 0.0;
    return !inside;
}

int gf_compute_result(const gf_controlled_grasp *grasp, const gf_step_targets *targets, const gf_result_inputs *inputs,
                      const gf_step_result *result)
{
    const int n = grasp->motor_count;
    const gf_contacts *contacts = &targets->contacts;
    int flags = 0;
    memcpy(result->tau, inputs->tau_u, (size_t)n * sizeof(double));
    for (int i = 0; i < grasp->force_size; i++)
        for (int j = 0; j < n; j++) result->tau[j] += inputs->f[i] * targets->J[i * n + j];
    for (int j = 0; j < n; j++) { /* NaN stays, as in NumPy's minimum and maximum */
        if (result->tau[j] < grasp->torque_limits[j]) result->tau[j] = grasp->torque_limits[j];
        if (result->tau[j] > grasp->torque_limits[n + j]) result->tau[j] = grasp->torque_limits[n + j];
    }
    if (gf_is_outside(n, result->tau, grasp->saturation_limits)) flags |= GF_SATURATED;
    if (gf_is_outside(n, inputs->q, grasp->q_limits)) flags |= GF_JOINT_LIMIT;
    for (int i = 0; i < grasp->contact_count; i++) {
        const gf_tip_contact last = {.p_OF = inputs->p_OF + 3 * i, .R_OF = inputs->R_OF + 9 * i, .p_OC = inputs->p_OC + 3 * i};
        double slip[2], *creep = result->creep + 2 * i;
        gf_slip_displacement(&last, contacts->p_OF + 3 * i, contacts->R_OF + 9 * i, contacts->R_OC + 9 * i, slip);
        for (int t = 0; t < 2; t++) creep[t] = grasp->creep_decay * inputs->creep[2 * i + t] + slip[t];
        result->creep_distance[i] = hypot(creep[0], creep[1]); /* m */
        if (result->creep_distance[i] > grasp->creep_limit || contacts->gap[i] > grasp->contact_tolerance)
            flags |= GF_CONTACT_LOST;
    }
    const int update = inputs->integral_rule == GF_INTEGRAL_ALWAYS ||
                       (inputs->integral_rule == GF_INTEGRAL_UNLESS_SATURATED && !(flags & GF_SATURATED));
    for (int k = 0; k < 6; k++) result->integral[k] = inputs->integral[k] + (update ? grasp->period * targets->error[k] : 0.0);
    if (update) gf_limit_integral(result->integral, grasp->ki, grasp->integral_limits);
    return flags;
}
