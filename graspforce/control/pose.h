/* The error of a pose and the acceleration that takes it away: the law of pose.py, whose names and equations these are. */
#ifndef GRASPFORCE_POSE_H
#define GRASPFORCE_POSE_H

#include <math.h>

/* The rotation vector θ a of a rotation by rows, rad, 0 ≤ θ ≤ π. */
static inline void rotation_log(const double R[9], double log[3])
{
    const double squares[4] = {R[0] + R[4] + R[8], R[0], R[4], R[8]}; /* 4 q² = 1 + the trace, and 1 + 2 rᵢᵢ − the trace */
    int largest = 0;
    for (int i = 1; i < 4; i++)
        if (squares[i] > squares[largest]) largest = i;
    double w, v[3];
    if (largest == 0) {
        w = 1.0 + squares[0], v[0] = R[7] - R[5], v[1] = R[2] - R[6], v[2] = R[3] - R[1];
    } else {
        const int a = largest - 1, b = largest % 3, c = (largest + 1) % 3; /* a, b, c cyclic */
        w = R[3 * c + b] - R[3 * b + c];
        v[a] = 1.0 + R[4 * a] - R[4 * b] - R[4 * c];
        v[b] = R[3 * a + b] + R[3 * b + a];
        v[c] = R[3 * a + c] + R[3 * c + a];
    }
    const double sine = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    const double scale = sine == 0.0 ? 0.0 : copysign(2.0 * atan2(sine, fabs(w)) / sine, w);
    for (int k = 0; k < 3; k++) log[k] = scale * v[k];
}

/* p_d − p, m, and log(R_d Rᵀ), rad, in H. */
static inline void pose_error(const double p_d[3], const double R_d[9], const double p[3], const double R[9], double error[6])
{
    double turn[9];
    for (int i = 0; i < 9; i++) {
        const double *a = R_d + 3 * (i / 3), *b = R + 3 * (i % 3);
        turn[i] = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    }
    for (int k = 0; k < 3; k++) error[k] = p_d[k] - p[k];
    rotation_log(turn, error + 3);
}

/* In place, the integral with its linear and angular parts shortened so that ki ‖part‖ stays within the limits. */
static inline void bound(double integral[6], const double ki[6], const double limits[2])
{
    for (int part = 0; part < 2; part++) {
        double *x = integral + 3 * part;
        const double asked = ki[3 * part] * sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]); /* m/s² or rad/s² */
        for (int k = 0; k < 3 && asked > limits[part]; k++) x[k] *= limits[part] / asked;
    }
}

#endif
