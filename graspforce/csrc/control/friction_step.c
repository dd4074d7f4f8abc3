/* Implementation of friction_step.h: planned rates by damped normal equations, then the law of each joint. */
#include <math.h>

#include "graspforce/friction_step.h"

enum { GF_SIDES = 3, GF_TORQUES = 2 };    /* right-hand sides: planned rates, feedback, and feedback along the plan */
static const double LEAST_ENERGY = 1e-20; /* J, twice the kinetic energy of an object at rest */

size_t gf_friction_work_size(const gf_friction *friction, int rows)
{
    const size_t r = (size_t)rows;
    return r * r + GF_SIDES * r + GF_TORQUES * (size_t)friction->motor_count;
}

/* Factor a symmetric K = L Lᵀ, (r, r), in place. Return 0 if it is not positive definite. */
static int gf_factor(int r, double *K)
{
    for (int i = 0; i < r; i++) {
        for (int j = 0; j < i; j++) {
            double sum = K[i * r + j];
            for (int k = 0; k < j; k++) sum -= K[i * r + k] * K[j * r + k];
            K[i * r + j] = sum / K[j * r + j];
        }
        double pivot = K[i * r + i];
        for (int k = 0; k < i; k++) pivot -= K[i * r + k] * K[i * r + k];
        if (!(pivot > 0.0)) return 0; /* NaN too */
        K[i * r + i] = sqrt(pivot);
    }
    return 1;
}

/* Solve L Lᵀ x = x in place. */
static void gf_solve_factored(int r, const double *L, double *x)
{
    for (int i = 0; i < r; i++) {
        for (int k = 0; k < i; k++) x[i] -= L[i * r + k] * x[k];
        x[i] /= L[i * r + i];
    }
    for (int i = r - 1; i >= 0; i--) {
        for (int k = i + 1; k < r; k++) x[i] -= L[k * r + i] * x[k];
        x[i] /= L[i * r + i];
    }
}

/* Rotate both halves of a twist from H to O. */
static void gf_rotate_to_object(const double *R_HO, const double *twist, double *rotated)
{
    for (int half = 0; half < 6; half += 3)
        for (int i = 0; i < 3; i++) {
            double sum = 0.0;
            for (int k = 0; k < 3; k++) sum += R_HO[3 * k + i] * twist[half + k];
            rotated[half + i] = sum;
        }
}

/* Return xᵀ M y with the object's mass matrix. */
static double gf_mass_product(const double *mass, const double *x, const double *y)
{
    double sum = 0.0;
    for (int i = 0; i < 6; i++)
        for (int k = 0; k < 6; k++) sum += x[i] * mass[6 * i + k] * y[k];
    return sum;
}

/* Compute planned rates v (motor_count), feedback accelerations (motor_count) and those along the plan (motor_count) of the
 * joints. Return 0 if a number is not finite. */
static int gf_plan_rates(const gf_friction *friction, const gf_constraints *constraints, const gf_friction_inputs *inputs,
                         double *work, double *v, double *feedback)
{
    const int r = constraints->rows, n = friction->motor_count;
    const double *A = constraints->A, *B = constraints->B;
    double *K = work, *sides[GF_SIDES], *rates[GF_SIDES] = {v, feedback, feedback + n};
    double feedback_H[6], twists[GF_SIDES][6], trace = 0.0;
    for (int k = 0; k < 6; k++)
        feedback_H[k] = friction->kd[k] * (inputs->twist_d[k] - inputs->twist[k]) + friction->kp[k] * inputs->error[k];
    gf_rotate_to_object(inputs->R_HO, inputs->twist_d, twists[0]);
    gf_rotate_to_object(inputs->R_HO, feedback_H, twists[1]);
    const double energy = gf_mass_product(friction->mass, twists[0], twists[0]);
    const double part = energy > LEAST_ENERGY ? gf_mass_product(friction->mass, twists[0], twists[1]) / energy : 0.0; /* 1/s */
    for (int k = 0; k < 6; k++) twists[2][k] = part * twists[0][k];
    for (int side = 0; side < GF_SIDES; side++) sides[side] = work + r * r + side * r;
    for (int i = 0; i < r; i++) {
        const double *row = A + i * n;
        for (int side = 0; side < GF_SIDES; side++) {
            double sum = 0.0;
            for (int k = 0; k < 6; k++) sum += B[6 * i + k] * twists[side][k];
            sides[side][i] = sum;
        }
        for (int k = 0; inputs->v_d != NULL && k < n; k++) sides[0][i] -= row[k] * inputs->v_d[k];
        for (int j = 0; j <= i; j++) {
            double sum = 0.0;
            for (int k = 0; k < n; k++) sum += row[k] * A[j * n + k];
            K[i * r + j] = sum;
        }
        trace += K[i * r + i];
    }
    for (int i = 0; i < r; i++) K[i * r + i] += friction->damping[0] * trace / r;
    if (!gf_factor(r, K)) return 0;
    for (int k = 0; k < n; k++) v[k] = inputs->v_d == NULL ? 0.0 : inputs->v_d[k], feedback[k] = feedback[n + k] = 0.0;
    for (int side = 0; side < GF_SIDES; side++) {
        gf_solve_factored(r, K, sides[side]);
        for (int i = 0; i < r; i++)
            for (int k = 0; k < n; k++) rates[side][k] += A[i * n + k] * sides[side][i];
    }
    return 1;
}

/* Write the levels after a step. `direction` is tanh(v/ε), and `torque` the feedback torques of the joints, then
 * those along the plan. */
static void gf_observe_friction(const gf_friction *friction, const double *direction, const double *torque, const double *level,
                                double *next)
{
    const int n = friction->motor_count;
    const double *share = friction->share;
    double along = 0.0, square = 0.0, drive = 0.0;
    int active = 0;
    for (int k = 0; k < n; k++) {
        along += level[k] * share[k];
        square += share[k] * share[k];
        drive += share[k] * direction[k] *
                 (friction->rate_common[0] * torque[n + k] + friction->rate_across[0] * (torque[k] - torque[n + k]));
        active += torque[k] != 0.0;
    }
    const double mean = along / square, common = drive / (active > 0 ? active : 1);
    for (int k = 0; k < n; k++) {
        const double change = friction->rate_joint[0] * direction[k] * torque[k] + share[k] * common -
                              friction->rate_forgetting[0] * fabs(direction[k]) * (level[k] - share[k] * mean);
        next[k] = fmin(fmax(level[k] + change, 0.0), friction->largest[k]);
    }
}

int gf_friction_step(const gf_friction *friction, const gf_constraints *constraints, const gf_friction_inputs *inputs,
                     double *work, const gf_friction_result *result)
{
    const int n = friction->motor_count, r = constraints->rows;
    double *v = result->v, *torque = work + r * r + GF_SIDES * r, *direction = result->tau, fastest = 0.0;
    if (!gf_plan_rates(friction, constraints, inputs, work, v, torque)) return GF_FRICTION_FAILED;
    for (int k = 0; k < n; k++) {
        direction[k] = tanh(v[k] / friction->smoothing_rate[0]);
        torque[k] *= friction->inertia[k], torque[n + k] *= friction->inertia[k];
        fastest = fmax(fastest, fabs(v[k]));
        result->level[k] = inputs->level[k];
        if (!isfinite(v[k]) || !isfinite(torque[k] + torque[n + k]) || !isfinite(inputs->level[k])) return GF_FRICTION_FAILED;
    }
    if (friction->observes) gf_observe_friction(friction, direction, torque, inputs->level, result->level);
    for (int k = 0; k < n; k++) {
        const double ratio = v[k] / friction->stribeck_velocity[k];
        const double size = result->level[k] + friction->stribeck[k] * exp(-ratio * ratio); /* N·m */
        result->tau[k] = size * direction[k] + friction->viscous[k] * v[k];
        if (!isfinite(result->tau[k])) return GF_FRICTION_FAILED;
    }
    return fastest < friction->rest_rate[0] ? GF_FRICTION_RESTS : GF_FRICTION_MOVES;
}
