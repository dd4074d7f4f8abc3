/* Implementation of pose_fusion.h. */
#include "graspforce/pose_fusion.h"

#include <math.h>
#include <string.h>

#include "graspforce/contact_kinematics.h"
#include "pose_error.inc"
#include "rotation.inc"
#include "vector3.inc"

enum { TWIST = 6, STATE = 12 };

/* Return Σ_k a[k] R[k][j]: component j of Rᵀ a. */
static double gf_column_product(const double R[9], const double *a, int stride, int j)
{
    return a[0] * R[j] + a[stride] * R[3 + j] + a[2 * stride] * R[6 + j];
}

/* Rotate a covariance of twists from H to O: diag(R, R)ᵀ C diag(R, R). */
static void gf_rotate_covariance(const double R[9], const double *C, double rotated[TWIST][TWIST])
{
    double half[TWIST][TWIST]; /* C diag(R, R) */
    for (int i = 0; i < TWIST; i++)
        for (int j = 0; j < TWIST; j++) half[i][j] = gf_column_product(R, C + TWIST * i + 3 * (j / 3), 1, j % 3);
    for (int i = 0; i < TWIST; i++)
        for (int j = 0; j < TWIST; j++) rotated[i][j] = gf_column_product(R, &half[3 * (i / 3)][j], TWIST, i % 3);
}

/* Compute the innovation z: T_contact⁻¹ T_measured against D̂, without the bias, in O. */
static void gf_innovation(const gf_fusion_inputs *inputs, const gf_offset_state *last, double z[TWIST])
{
    const double *b = last->bias;
    const gf_vector3 unturn = {-b[3], -b[4], -b[5]};
    gf_vector3 apart;
    gf_matrix3 correction, unbiased, across, seen, R_OH;
    for (int k = 0; k < 3; k++) apart[k] = inputs->p_measured[k] - inputs->p_HO[k] - b[k];
    gf_multiply_transposed(inputs->R_HO, apart, z);
    for (int k = 0; k < 3; k++) z[k] -= last->p[k];
    gf_rotation_exp(unturn, correction);
    gf_multiply_matrices(correction, inputs->R_measured, 0, unbiased);
    for (int k = 0; k < 9; k++) R_OH[k] = inputs->R_HO[3 * (k % 3) + k / 3];
    gf_multiply_matrices(R_OH, unbiased, 0, seen);
    gf_multiply_matrices(seen, last->R, 1, across);
    gf_rotation_log(across, z + 3);
}

/* Write the covariance before the update to P. */
static void gf_predict(const gf_fusion_inputs *inputs, const gf_offset_state *last, double P[STATE][STATE])
{
    memcpy(P, last->covariance, STATE * STATE * sizeof(double));
    for (int j = 0; j < TWIST; j++) {
        P[j][j] += j < 3 ? inputs->position_drift : inputs->angle_drift;
        for (int k = 0; k < TWIST; k++) {
            double sum = 0.0;
            for (int i = 0; i < TWIST; i++) sum += inputs->free_motions[TWIST * j + i] * inputs->free_motions[TWIST * k + i];
            P[j][k] += inputs->free_drift * sum;
        }
    }
}

/* Compute P Hᵀ with H = (1, diag(R, R)ᵀ), (12, 6). */
static void gf_output_covariance(const double R[9], double P[STATE][STATE], double PHt[STATE][TWIST])
{
    for (int i = 0; i < STATE; i++)
        for (int j = 0; j < TWIST; j++) PHt[i][j] = P[i][j] + gf_column_product(R, &P[i][TWIST + 3 * (j / 3)], 1, j % 3);
}

/* Decompose a symmetric S = L Lᵀ. Return whether S is positive definite to rounding. */
static int gf_cholesky(double S[TWIST][TWIST], double L[TWIST][TWIST])
{
    for (int i = 0; i < TWIST; i++)
        for (int j = 0; j <= i; j++) {
            double sum = S[i][j];
            for (int k = 0; k < j; k++) sum -= L[i][k] * L[j][k];
            if (i == j && !(sum > 0.0)) return 0; /* NaN too */
            L[i][j] = i == j ? sqrt(sum) : sum / L[j][j];
        }
    return 1;
}

/* Compute x = L⁻¹ y. */
static void gf_solve_lower(double L[TWIST][TWIST], const double *y, double *x)
{
    for (int i = 0; i < TWIST; i++) {
        x[i] = y[i];
        for (int k = 0; k < i; k++) x[i] -= L[i][k] * x[k];
        x[i] /= L[i][i];
    }
}

/* Compute the gain K = P Hᵀ S⁻¹, row by row: S⁻¹ = L⁻ᵀ L⁻¹. */
static void gf_kalman_gain(double L[TWIST][TWIST], double PHt[STATE][TWIST], double K[STATE][TWIST])
{
    for (int i = 0; i < STATE; i++) {
        double *row = K[i];
        gf_solve_lower(L, PHt[i], row);
        for (int j = TWIST - 1; j >= 0; j--) {
            for (int k = j + 1; k < TWIST; k++) row[j] -= L[k][j] * row[k];
            row[j] /= L[j][j];
        }
    }
}

/* Compute the covariance after the update, (1 − K H) P (1 − K H)ᵀ + K N Kᵀ, symmetric to the last bit (Joseph's form). */
static void gf_joseph_update(const double R[9], double K[STATE][TWIST], double P[STATE][STATE], double N[TWIST][TWIST],
                             double *covariance)
{
    double kept[STATE][STATE], half[STATE][STATE], noisy[STATE][TWIST];
    for (int i = 0; i < STATE; i++) {
        for (int j = 0; j < TWIST; j++) {
            kept[i][j] = (i == j) - K[i][j];
            const double *row = R + 3 * (j % 3); /* K diag(R, R)ᵀ */
            kept[i][TWIST + j] = (i == TWIST + j) - gf_dot(K[i] + 3 * (j / 3), row);
            noisy[i][j] = 0.0;
            for (int k = 0; k < TWIST; k++) noisy[i][j] += K[i][k] * N[k][j];
        }
    }
    for (int i = 0; i < STATE; i++)
        for (int j = 0; j < STATE; j++) {
            half[i][j] = 0.0;
            for (int k = 0; k < STATE; k++) half[i][j] += kept[i][k] * P[k][j];
        }
    for (int i = 0; i < STATE; i++)
        for (int j = 0; j <= i; j++) {
            double sum = 0.0;
            for (int k = 0; k < STATE; k++) sum += half[i][k] * kept[j][k];
            for (int k = 0; k < TWIST; k++) sum += noisy[i][k] * K[j][k];
            covariance[STATE * i + j] = covariance[STATE * j + i] = sum;
        }
}

/* Correct offset and bias by x = K z. */
static void gf_correct_offset(double K[STATE][TWIST], const double z[TWIST], const gf_offset_state *last,
                              const gf_offset_state *next)
{
    double x[STATE];
    gf_matrix3 turn;
    for (int i = 0; i < STATE; i++) {
        x[i] = 0.0;
        for (int k = 0; k < TWIST; k++) x[i] += K[i][k] * z[k];
    }
    for (int k = 0; k < 3; k++) next->p[k] = last->p[k] + x[k];
    gf_rotation_exp(x + 3, turn);
    gf_multiply_matrices(turn, last->R, 0, next->R);
    for (int k = 0; k < TWIST; k++) next->bias[k] = last->bias[k] + x[TWIST + k];
}

int gf_fuse_pose(const gf_fusion_inputs *inputs, const gf_offset_state *last, const gf_offset_state *next)
{
    double P[STATE][STATE], PHt[STATE][TWIST], S[TWIST][TWIST], N[TWIST][TWIST], L[TWIST][TWIST], K[STATE][TWIST];
    double z[TWIST], y[TWIST], distance = 0.0, sum = 0.0;
    gf_predict(inputs, last, P);
    gf_innovation(inputs, last, z);
    gf_output_covariance(inputs->R_HO, P, PHt);
    gf_rotate_covariance(inputs->R_HO, inputs->noise, N);
    for (int i = 0; i < TWIST; i++)
        for (int j = 0; j < TWIST; j++) {
            N[i][j] += inputs->contact_covariance[TWIST * i + j];
            S[i][j] = PHt[i][j] + gf_column_product(inputs->R_HO, &PHt[TWIST + 3 * (i / 3)][j], TWIST, i % 3) + N[i][j];
        }
    if (!gf_cholesky(S, L)) return GF_FUSION_FAILED;
    gf_solve_lower(L, z, y);
    for (int k = 0; k < TWIST; k++) distance += y[k] * y[k];
    if (!isfinite(distance)) return GF_FUSION_FAILED;
    if (distance > inputs->gate) return GF_POSE_OUTLIER;
    gf_kalman_gain(L, PHt, K);
    gf_correct_offset(K, z, last, next);
    gf_joseph_update(inputs->R_HO, K, P, N, next->covariance);
    for (int k = 0; k < STATE * STATE; k++) sum += next->covariance[k];
    for (int k = 0; k < 3; k++) sum += next->p[k] + next->R[4 * k] + next->bias[k] + next->bias[3 + k];
    return isfinite(sum) ? GF_POSE_ACCEPTED : GF_FUSION_FAILED;
}

double gf_interpolate_pose(const double p[3], const double R[9], const double p_target[3], const double R_target[9],
                           double share, double p_next[3], double R_next[9])
{
    gf_vector3 turn;
    gf_matrix3 across, step;
    double far = 0.0;
    gf_multiply_matrices(R_target, R, 1, across);
    gf_rotation_log(across, turn);
    for (int k = 0; k < 3; k++) {
        const double way = p_target[k] - p[k];
        far = fmax(far, fmax(fabs(way), fabs(turn[k])));
        p_next[k] = p[k] + share * way;
        turn[k] *= share;
    }
    gf_rotation_exp(turn, step);
    gf_multiply_matrices(step, R, 0, R_next);
    return far;
}
