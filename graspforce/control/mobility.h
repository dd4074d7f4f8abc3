/* Joint accelerations that keep the contacts, where the fingers can move them every way: the first case of mobility.py. */
#ifndef GRASPFORCE_MOBILITY_H
#define GRASPFORCE_MOBILITY_H

#include <math.h>

/* The lower factor L of a symmetric K = L Lᵀ, (r, r), and its inverse, both in place of what is there: L⁻¹ in K's place.
 * Returns 0 where K is not positive definite to rounding. */
static inline int invert_factor(int r, double *K)
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
        double inverse = 1.0 / K[i * r + i];
        for (int j = 0; j < i; j++) { /* row i of L⁻¹ from the rows above it */
            double sum = 0.0;
            for (int k = j; k < i; k++) sum += K[i * r + k] * K[k * r + j];
            K[i * r + j] = -inverse * sum;
        }
        K[i * r + i] = inverse;
    }
    return 1;
}

/* q̈ = posture + A⁺ (B a + β − A posture), A⁺ = Aᵀ K⁻¹ and K = A Aᵀ, for A (r, n) and B (r, 6). Returns 0 where some direction
 * may be one in which the joints move a contact by less than `least_lever` of the best. `work` holds r (r + 1) numbers. */
static inline int keep_contacts(int r, int n, const double *A, const double *B, const double *beta, const double wanted[6],
                                const double *posture, double least_lever, double *work, double *joints)
{
    double *K = work, *lacking = work + r * r, trace = 0.0, size = 0.0;
    for (int i = 0; i < r; i++) {
        const double *row = A + i * n;
        lacking[i] = beta[i];
        for (int k = 0; k < 6; k++) lacking[i] += B[6 * i + k] * wanted[k];
        for (int k = 0; k < n; k++) lacking[i] -= row[k] * posture[k]; /* m/s² */
        for (int j = 0; j <= i; j++) {
            double sum = 0.0;
            for (int k = 0; k < n; k++) sum += row[k] * A[j * n + k];
            K[i * r + j] = sum;
        }
        trace += K[i * r + i];
    }
    if (!invert_factor(r, K)) return 0;
    for (int i = 0; i < r; i++)
        for (int j = 0; j <= i; j++) size += K[i * r + j] * K[i * r + j];
    /* ‖L⁻¹‖² = tr K⁻¹ ≥ 1/σ_min² and tr K ≥ σ_max²: enough to know that every direction can be moved. */
    if (!(trace * size < 1.0 / (least_lever * least_lever))) return 0;
    for (int i = r - 1; i >= 0; i--) { /* L⁻¹ lacking, from the last, each needing only those before it */
        double sum = 0.0;
        for (int j = 0; j <= i; j++) sum += K[i * r + j] * lacking[j];
        lacking[i] = sum;
    }
    for (int k = 0; k < n; k++) joints[k] = posture[k];
    for (int i = 0; i < r; i++) {
        double pull = 0.0; /* of K⁻¹ (B a + β − A posture) = L⁻ᵀ L⁻¹ (…) */
        for (int j = i; j < r; j++) pull += K[j * r + i] * lacking[j];
        for (int k = 0; k < n; k++) joints[k] += A[i * n + k] * pull;
    }
    return 1;
}

#endif
