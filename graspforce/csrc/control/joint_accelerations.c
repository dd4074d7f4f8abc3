/* Implementation of gf_joint_accelerations() by the normal equations of A, for constraints of full row rank. */
#include "graspforce/contact_kinematics.h"

#include "../real.inc"

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

/* Write L⁻¹ of K = A Aᵀ + λ² S = L Lᵀ to the lower triangle of K (r, r), and the trace of K. Return tr K⁻¹, infinite if K is not
 * positive definite to rounding. */
static double gf_invert_normal_equations(const gf_constraints *constraints, double squared_damping, double *K, double *trace)
{
    const int r = constraints->rows, n = constraints->motor_count;
    double inverse_norm = 0.0;
    *trace = 0.0;
    for (int i = 0; i < r; i++) {
        const double *row = constraints->A + i * n;
        for (int j = 0; j <= i; j++) {
            double sum = 0.0;
            for (int k = 0; k < n; k++) sum += row[k] * constraints->A[j * n + k];
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

int gf_joint_accelerations(const gf_constraints *constraints, const double *object_acceleration, const double *posture,
                           double rank_tolerance, double *work, double *joint_acceleration)
{
    const int r = constraints->rows, n = constraints->motor_count;
    const double *A = constraints->A;
    double *K = work, *residual = work + r * r, trace, inverse_norm = gf_invert_normal_equations(constraints, 0.0, K, &trace);
    for (int i = 0; i < r; i++) {
        residual[i] = constraints->beta[i];
        for (int k = 0; k < 6; k++) residual[i] += constraints->B[6 * i + k] * object_acceleration[k];
        for (int k = 0; k < n; k++) residual[i] -= A[i * n + k] * posture[k]; /* m/s² */
    }
    if (constraints->damped_rows > 0 && constraints->damping > 0.0) {
        const double share = 1.0 / (inverse_norm * constraints->damping_start * constraints->damping_start); /* σ²/σ₀² */
        const double damping = constraints->damping * (1.0 - share);
        if (share < 1.0) inverse_norm = gf_invert_normal_equations(constraints, damping * damping, K, &trace);
    }
    /* ‖L⁻¹‖² = tr K⁻¹ ≥ 1/σ_min² and tr K ≥ σ_max²: this bounds the ratio of singular values of A. */
    if (!(trace * inverse_norm < 1.0 / (rank_tolerance * rank_tolerance))) return 0;
    for (int i = r - 1; i >= 0; i--) { /* L⁻¹ residual in place, from the last row */
        double sum = 0.0;
        for (int j = 0; j <= i; j++) sum += K[i * r + j] * residual[j];
        residual[i] = sum;
    }
    for (int k = 0; k < n; k++) joint_acceleration[k] = posture[k];
    for (int i = 0; i < r; i++) {
        double weight = 0.0; /* component of K⁻¹ residual = L⁻ᵀ L⁻¹ residual */
        for (int j = i; j < r; j++) weight += K[j * r + i] * residual[j];
        for (int k = 0; k < n; k++) joint_acceleration[k] += A[i * n + k] * weight;
    }
    return 1;
}
