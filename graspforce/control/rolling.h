/* Contacts that roll: the law of rolling.py, whose names and equations these are, one contact at a time, for surfaces whose
 * nearest points have a closed form. All vectors are in O but those that say H. */
#ifndef GRASPFORCE_ROLLING_H
#define GRASPFORCE_ROLLING_H

#include <string.h>

#include "../shapes/feet.h"

static const double TINY = 1e-9;   /* m: a middle nearer to the surface than this gives no normal */
static const double TURNED = 1e-9; /* rad: n nearer to the last t₁ than this leaves nothing of it */
static const double AHEAD = 1e-4;  /* s: half the span of the difference that the nearest point's rate is */

enum { T1, T2, N }; /* columns of a contact's frame */

typedef double vector[3];
typedef double matrix[9]; /* by rows */

/* The object, the same for all contacts. */
typedef struct {
    surface shape;
    vector p_HO;     /* m */
    matrix R_HO;
    double twist[6]; /* in H, m/s and rad/s */
    vector omega;    /* rad/s */
} held_object;

/* A fingertip, and the contact that it makes. */
typedef struct {
    double radius; /* m */
    vector p_HF;   /* m */
    matrix R_HF;
    const double *rates; /* (6, n + 2): J, twist and drift, in H */
    vector p_hold;       /* m, where the hold began */
    matrix R_hold, before; /* the contact's frames where the hold began, and at the last step */
} touching_tip;

/* A contact's part of each array of RollingContacts and its Touched and Spin. */
typedef struct {
    double *p_OC, *R_OC, *A, *B, *beta, *velocity, *gap, *p_OF, *R_OF, *spin_A, *spin_B, *spin_beta;
} rolling_contact;

static inline double dot(const vector a, const vector b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static inline void cross(const vector a, const vector b, vector c)
{
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

/* From H's axes to O's. */
static inline void to_O(const matrix R_HO, const vector v_H, vector v)
{
    for (int k = 0; k < 3; k++) v[k] = R_HO[k] * v_H[0] + R_HO[3 + k] * v_H[1] + R_HO[6 + k] * v_H[2];
}

/* From O's axes to H's. */
static inline void to_H(const matrix R_HO, const vector v, vector v_H)
{
    for (int k = 0; k < 3; k++) v_H[k] = dot(R_HO + 3 * k, v);
}

/* A frame whose n leads from a ball's middle to the surface, `inward`, or away from it where the middle is inside, which the
 * last n tells apart. t₂ = n × t₁' is carried on from the last t₁'; where n has turned into t₁' itself, the last t₂ stays.
 * Returns how far, in m, the surface is from the middle, against n where it is inside. */
static inline double place_frame(const vector inward, const matrix before, matrix R)
{
    vector last[3], n, t1, t2;
    for (int axis = 0; axis < 3; axis++)
        for (int k = 0; k < 3; k++) last[axis][k] = before[3 * k + axis];
    double away = copysign(hypot(hypot(inward[0], inward[1]), inward[2]), dot(inward, last[N])); /* m */
    for (int k = 0; k < 3; k++) n[k] = fabs(away) > TINY ? inward[k] / away : last[N][k];
    cross(n, last[T1], t2);
    double size = hypot(hypot(t2[0], t2[1]), t2[2]);
    for (int k = 0; k < 3; k++) t2[k] = size > TURNED ? t2[k] / size : last[T2][k];
    cross(t2, n, t1);
    for (int k = 0; k < 3; k++) R[3 * k + T1] = t1[k], R[3 * k + T2] = t2[k], R[3 * k + N] = n[k];
    return away;
}

/* Where the contact of a tip is, its frame, and its velocity over the object; the tip is at c, and the object sees it move at
 * c_rate. Returns the gap. */
static inline double touch(const held_object *o, const touching_tip *tip, const vector c, const vector c_rate, vector x,
                           matrix R, vector over)
{
    vector off, n, inward;
    for (int k = 0; k < 3; k++) off[k] = tip->p_hold[k] - c[k], n[k] = tip->R_hold[3 * k + N];
    if (tip->radius == 0.0) {
        memcpy(x, tip->p_hold, sizeof(vector));
        memcpy(R, tip->R_hold, sizeof(matrix));
        memset(over, 0, sizeof(vector));
        return dot(off, n);
    }
    if (o->shape.kind == FLAT) {
        double height = dot(off, n), rise = dot(c_rate, n);
        for (int k = 0; k < 3; k++) x[k] = c[k] + height * n[k], over[k] = c_rate[k] - rise * n[k];
    } else {
        vector ahead, behind, soon, lately;
        for (int k = 0; k < 3; k++) ahead[k] = c[k] + AHEAD * c_rate[k], behind[k] = c[k] - AHEAD * c_rate[k];
        foot_of(&o->shape, c, x);
        foot_of(&o->shape, ahead, soon);
        foot_of(&o->shape, behind, lately);
        for (int k = 0; k < 3; k++) over[k] = (soon[k] - lately[k]) * (0.5 / AHEAD);
    }
    for (int k = 0; k < 3; k++) inward[k] = x[k] - c[k];
    return place_frame(inward, tip->before, R) - tip->radius;
}

/* The velocity along an axis e of the contact that each of n + 2 twists at the tip's origin makes `arm` away from it:
 * e·(v + ω × arm) = e·v + (arm × e)·ω. All but A's part go to `rest`, the tip's velocity and its drift. */
static inline void along_axis(const matrix R_HO, const vector arm, const vector e, const double *rates, int n, double *A,
                              double rest[2])
{
    vector lever, row[2];
    cross(arm, e, lever);
    to_H(R_HO, e, row[0]);
    to_H(R_HO, lever, row[1]);
    const int width = n + 2;
    for (int j = 0; j < n; j++) {
        const double *r = rates + j;
        A[j] = row[0][0] * r[0] + row[0][1] * r[width] + row[0][2] * r[2 * width] + row[1][0] * r[3 * width] +
               row[1][1] * r[4 * width] + row[1][2] * r[5 * width];
    }
    for (int j = 0; j < 2; j++) {
        rest[j] = 0.0;
        for (int k = 0; k < 6; k++) rest[j] += row[k / 3][k % 3] * rates[k * width + n + j];
    }
}

/* The spin about n, and what keeps it: n·(ω̇_F − ω̇_O) + ṅ·(ω_F − ω_O) = 0. `apart` is ẋ − ċ, `away` the middle's way to x. */
static inline void keep_spin(const held_object *o, const touching_tip *tip, const vector n, const vector apart, double away,
                             const vector spin, int joints, const rolling_contact *c)
{
    const int width = joints + 2;
    const double *r = tip->rates + 3 * width;
    vector n_H, n_rate = {0.0, 0.0, 0.0};
    to_H(o->R_HO, n, n_H);
    for (int j = 0; j < joints; j++) c->spin_A[j] = n_H[0] * r[j] + n_H[1] * r[width + j] + n_H[2] * r[2 * width + j];
    for (int k = 0; k < 3; k++) c->spin_B[k] = 0.0, c->spin_B[3 + k] = n[k];
    double parting = dot(apart, n), drift = 0.0;
    if (tip->radius == 0.0)
        cross(o->omega, n, n_rate); /* n turns with the object */
    else if (fabs(away) > TINY)
        for (int k = 0; k < 3; k++) n_rate[k] = (apart[k] - parting * n[k]) / away;
    for (int k = 0; k < 3; k++) drift += n_H[k] * r[k * width + joints + 1];
    c->spin_beta[0] = -drift - dot(n_rate, spin);
}

/* One contact, of a hand with n joints. */
static inline void roll(const held_object *o, const touching_tip *tip, int n, const rolling_contact *out)
{
    const int width = n + 2;
    vector from_O, parting, turning; /* the tip as the object's origin sees it, in H */
    vector c, c_rate, spin;          /* c − p, ċ − ṗ and ω_F − ω_O */
    for (int k = 0; k < 3; k++) {
        from_O[k] = tip->p_HF[k] - o->p_HO[k];
        parting[k] = tip->rates[k * width + n] - o->twist[k];
        turning[k] = tip->rates[(3 + k) * width + n] - o->twist[3 + k];
    }
    to_O(o->R_HO, from_O, c);
    to_O(o->R_HO, parting, c_rate);
    to_O(o->R_HO, turning, spin);

    vector swept, seen, x, over, n_O;
    matrix R;
    cross(o->omega, c, swept);
    for (int k = 0; k < 3; k++) seen[k] = c_rate[k] - swept[k];
    double gap = touch(o, tip, c, seen, x, R, over);

    vector x_rate, arm, apart, omega_F, bent, bent_F; /* x_rate is ẋ − ṗ, apart ẋ − ċ, m/s */
    cross(o->omega, x, x_rate);
    for (int k = 0; k < 3; k++) {
        x_rate[k] += over[k];
        arm[k] = x[k] - c[k];
        apart[k] = x_rate[k] - c_rate[k];
        omega_F[k] = spin[k] + o->omega[k];
        n_O[k] = R[3 * k + N];
    }
    cross(o->omega, x_rate, bent);
    cross(omega_F, apart, bent_F);
    for (int k = 0; k < 3; k++) bent[k] -= bent_F[k]; /* ω_O × (ẋ − ṗ) − ω_F × (ẋ − ċ), m/s² */

    for (int row = T1; row <= N; row++) {
        const vector e = {R[row], R[3 + row], R[6 + row]};
        double own[2]; /* the velocity of the finger's point at x along e, m/s, and its drift, m/s² */
        along_axis(o->R_HO, arm, e, tip->rates, n, out->A + row * n, own);
        memcpy(out->B + 6 * row, e, sizeof(vector));
        cross(x, e, out->B + 6 * row + 3);
        out->velocity[row] = own[0];
        out->beta[row] = dot(e, bent) - own[1];
    }
    keep_spin(o, tip, n_O, apart, gap + tip->radius, spin, n, out);

    memcpy(out->p_OC, x, sizeof(vector));
    memcpy(out->R_OC, R, sizeof(matrix));
    memcpy(out->p_OF, c, sizeof(vector));
    out->gap[0] = gap;
    for (int k = 0; k < 3; k++) { /* R_OF = R_HOᵀ R_HF, column by column */
        const vector axis_H = {tip->R_HF[k], tip->R_HF[3 + k], tip->R_HF[6 + k]};
        vector axis;
        to_O(o->R_HO, axis_H, axis);
        for (int j = 0; j < 3; j++) out->R_OF[3 * j + k] = axis[j];
    }
}

/* How far a fingertip slid along t₁ and t₂ of R_OC between two instants, m: the point of the finger that touched then has gone
 * away from the point of the object that it touched. */
static inline void slide(const vector p_before, const matrix R_before, const vector touched, const vector p_now,
                         const matrix R_now, const matrix R_OC, double slid[2])
{
    vector off, lever, apart; /* from the tip's origin to the point that touched: in O, and in the tip's frame */
    for (int k = 0; k < 3; k++) off[k] = touched[k] - p_before[k];
    to_O(R_before, off, lever);
    to_H(R_now, lever, apart);
    for (int k = 0; k < 3; k++) apart[k] += p_now[k] - touched[k];
    for (int t = T1; t <= T2; t++) slid[t] = apart[0] * R_OC[t] + apart[1] * R_OC[3 + t] + apart[2] * R_OC[6 + t];
}

#endif
