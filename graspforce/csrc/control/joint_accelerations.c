/* Implementation of gf_joint_accelerations() by the normal equations of A, for constraints of full row rank. */
#include <stddef.h>

#include "graspforce/contact_kinematics.h"

#include "../real.inc"

static const double COMPLIANT_TOLERANCE = 0.1; /* of the rank tolerance: where the object yields, it bounds the accelerations */

/* Replace the lower triangle of a symmetric K = L Lᵀ, (r, r), by L⁻¹. Return 0 if K is not positive definite to rounding. */
static int gf_invert_cholesky(int r, double *K)
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
    for (int i = 0; i < r; i++) {
        const double inverse = 1.0 / K[i * r + i];
        for (int j = 0; j < i; j++) { /* row i of L⁻¹ from the rows above it */
            double sum = 0.0;
            for (int k = j; k < i; k++) sum += K[i * r + k] * K[k * r + j];
            K[i * r + j] = -inverse * sum;
        }
        K[i * r + i] = inverse;
    }
    return 1;
}

/* Write L⁻¹ of K = A Aᵀ + λ² S + Y Yᵀ = L Lᵀ to the lower triangle of K (r, r), and the trace of K. Return tr K⁻¹, infinite if K
 * is not positive definite to rounding. Y is (r, 6), or NULL for 0. */
static double gf_invert_normal_equations(const gf_constraints *constraints, double squared_damping, const double *Y, double *K,
                                         double *trace)
{
    const int r = constraints->rows, n = constraints->motor_count;
    double inverse_norm = 0.0;
    *trace = 0.0;
    for (int i = 0; i < r; i++) {
        const double *row = constraints->A + i * n;
        for (int j = 0; j <= i; j++) {
            double sum = 0.0;
            for (int k = 0; k < n; k++) sum += row[k] * constraints->A[j * n + k];
            for (int k = 0; k < 6 && Y != NULL; k++) sum += Y[6 * i + k] * Y[6 * j + k];
            K[i * r + j] = sum;
        }
        if (i >= r - constraints->damped_rows) K[i * r + i] += squared_damping;
        *trace += K[i * r + i];
    }
    if (!gf_invert_cholesky(r, K)) return INFINITY;
    for (int i = 0; i < r; i++)
        for (int j = 0; j <= i; j++) inverse_norm += K[i * r + j] * K[i * r + j];
    return inverse_norm;
}

/* Return x₀ (1 − σ²/start²), at least 0, for σ² = 1/inverse_norm. */
static double gf_share_near_loss(double largest, double start, double inverse_norm)
{
    const double share = 1.0 / (inverse_norm * start * start);
    return largest > 0.0 && share < 1.0 ? largest * (1.0 - share) : 0.0;
}

/* Compute Y = ℓ B N, (r, 6). */
static void gf_scale_constraints(const gf_constraints *constraints, double compliance, double *Y)
{
    for (int i = 0; i < constraints->rows; i++)
        for (int k = 0; k < 6; k++) {
            double sum = 0.0;
            for (int l = 0; l < 6; l++) sum += constraints->B[6 * i + l] * constraints->mobility[6 * l + k];
            Y[6 * i + k] = compliance * sum;
        }
}

/* Let the object yield, a −= ℓ N Yᵀ ν. */
static void gf_yield(const gf_constraints *constraints, double compliance, const double *Y, const double *multipliers,
                     double *object_acceleration)
{
    double load[6] = {0};
    for (int i = 0; i < constraints->rows; i++)
        for (int k = 0; k < 6; k++) load[k] += Y[6 * i + k] * multipliers[i];
    for (int l = 0; l < 6; l++)
        for (int k = 0; k < 6; k++) object_acceleration[l] -= compliance * constraints->mobility[6 * l + k] * load[k];
}

int gf_joint_accelerations(const gf_constraints *constraints, double *object_acceleration, const double *posture,
                           double rank_tolerance, double *work, double *joint_acceleration)
{
    const int r = constraints->rows, n = constraints->motor_count;
    const double *A = constraints->A;
    double *K = work, *residual = K + r * r, *Y = residual + r, trace;
    double inverse_norm = gf_invert_normal_equations(constraints, 0.0, NULL, K, &trace);
    for (int i = 0; i < r; i++) {
        residual[i] = constraints->beta[i];
        for (int k = 0; k < 6; k++) residual[i] += constraints->B[6 * i + k] * object_acceleration[k];
        for (int k = 0; k < n; k++) residual[i] -= A[i * n + k] * posture[k]; /* m/s² */
    }
    const double damping = constraints->damped_rows > 0
                               ? gf_share_near_loss(constraints->damping, constraints->damping_start, inverse_norm)
                               : 0.0;
    const double compliance = gf_share_near_loss(constraints->compliance, constraints->compliance_start, inverse_norm);
    if (compliance > 0.0) {
        rank_tolerance *= COMPLIANT_TOLERANCE;
        gf_scale_constraints(constraints, compliance, Y);
    }
    if (damping > 0.0 || compliance > 0.0)
        inverse_norm = gf_invert_normal_equations(constraints, damping * damping, compliance > 0.0 ? Y : NULL, K, &trace);
    /* ‖L⁻¹‖² = tr K⁻¹ ≥ 1/σ_min² and tr K ≥ σ_max²: this bounds the ratio of singular values of A. */
    if (!(trace * inverse_norm < 1.0 / (rank_tolerance * rank_tolerance))) return 0;
    for (int i = r - 1; i >= 0; i--) { /* L⁻¹ residual in place, from the last row */
        double sum = 0.0;
        for (int j = 0; j <= i; j++) sum += K[i * r + j] * residual[j];
        residual[i] = sum;
    }
    for (int k = 0; k < n; k++) joint_acceleration[k] = posture[k];
    for (int i = 0; i < r; i++) {
        double multiplier = 0.0; /* component of K⁻¹ residual = L⁻ᵀ L⁻¹ residual; row i is not needed any more */
        for (int j = i; j < r; j++) multiplier += K[j * r + i] * residual[j];
        for (int k = 0; k < n; k++) joint_acceleration[k] += A[i * n + k] * multiplier;
        residual[i] = multiplier;
    }
    if (compliance > 0.0) gf_yield(constraints, compliance, Y, residual, object_acceleration);
    return 1;
}
