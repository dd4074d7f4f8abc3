/* Fingertips from the joints' motion: `CoupledModel.tip_motion` in C, out of what one sweep over the joints leaves. All vectors
 * are in H. */
#ifndef GRASPFORCE_TIPS_H
#define GRASPFORCE_TIPS_H

#include "rolling.h"

/* A hand's joints as one sweep leaves them: twists of what they carry at H's origin, for each unit rate, and the time derivatives
 * of these; then the joints' rates. */
typedef struct {
    int full, n;            /* joints, and motors that move them */
    const double *J, *dJ;   /* (6, full) */
    const double *v;        /* (full), rad/s */
    const double *T;        /* (full, n): joint rates from the motors' */
} joint_motion;

/* Adds a twist at H's origin, weighed, to another. */
static inline void add_twist(double weight, const double *columns, int width, double twist[6])
{
    for (int k = 0; k < 6; k++) twist[k] += weight * columns[k * width];
}

/* From a twist at H's origin to the velocity at p. */
static inline void move_to(const vector p, double twist[6])
{
    vector swept;
    cross(twist + 3, p, swept);
    for (int k = 0; k < 3; k++) twist[k] += swept[k];
}

/* `rates` (6, n + 2) of a tip at p: J, twist and drift, that is J̇ v with the classical acceleration of the tip's origin. `moved`
 * says of each joint whether it moves the tip. */
static inline void tip_rates(const joint_motion *m, const vector p, const unsigned char *moved, double *rates)
{
    const int width = m->n + 2;
    double twist[6] = {0}, drift[6] = {0};
    memset(rates, 0, 6 * (size_t)width * sizeof(double));
    for (int j = 0; j < m->full; j++) {
        if (!moved[j]) continue;
        double column[6] = {0};
        add_twist(1.0, m->J + j, m->full, column);
        move_to(p, column);
        for (int i = 0; i < m->n; i++) {
            const double part = m->T[j * m->n + i];
            for (int k = 0; k < 6 && part != 0.0; k++) rates[k * width + i] += part * column[k];
        }
        add_twist(m->v[j], column, 1, twist);
        add_twist(m->v[j], m->dJ + j, m->full, drift);
    }
    vector bent; /* ω × ṗ, m/s² */
    cross(twist + 3, twist, bent);
    move_to(p, drift);
    for (int k = 0; k < 6; k++) {
        rates[k * width + m->n] = twist[k];
        rates[k * width + m->n + 1] = drift[k] + (k < 3 ? bent[k] : 0.0);
    }
}

/* Where a frame fixed to a link is, by the link's own place: p + R p_LF and R R_LF. */
static inline void place_tip(const vector p, const matrix R, const vector p_LF, const matrix R_LF, vector p_HF, matrix R_HF)
{
    for (int i = 0; i < 3; i++) {
        const double *row = R + 3 * i;
        p_HF[i] = p[i] + dot(row, p_LF);
        for (int j = 0; j < 3; j++) R_HF[3 * i + j] = row[0] * R_LF[j] + row[1] * R_LF[3 + j] + row[2] * R_LF[6 + j];
    }
}

#endif
