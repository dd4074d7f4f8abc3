/* One step of the controller but for the hand's inverse dynamics and the forces: the law of object_controller.py, whose names
 * and equations these are. */
#ifndef GRASPFORCE_STEP_H
#define GRASPFORCE_STEP_H

#include "mobility.h"
#include "pose.h"
#include "tips.h"

static const double SPIN_ARM = 0.03; /* m: as ties.py */

/* A hold and its settings: what no step changes. */
typedef struct {
    int N, n, full, r, k; /* contacts, motors, joints, velocities that are tied, force components */
    surface shape;
    double kp[6], kd[6], ki[6], integral_limits[2];
    double stiffness, damping, least_lever;            /* 1/s², 1/s */
    double period, kept_creep, creep_limit, touch_gap; /* s, 1, m, m */
    vector gravity_H;
    double mass; /* kg */
    matrix inertia;
    vector p_OM;
    const double *radii, *p_hold, *R_hold, *q_hold; /* (N), (N, 3), (N, 9), (n) */
    const double *reach;                            /* (n) the strongest pull on a joint towards its posture, rad/s² */
    const double *p_LF, *R_LF, *T;                  /* (N, 3), (N, 9), (full, n) */
    const double *tau_limits, *at_limits, *q_limits; /* (2, n) least and most: torques, where they count as at a limit, joints */
    const unsigned char *moved; /* (N, full) */
    const int *link;            /* (N) which link of the hand carries each tip */
    const int *tied, *force;    /* (r), (k): which of the padded rows, 4 i + (t₁, t₂, n, spin) */
} hold_numbers;

/* What a step is told. */
typedef struct {
    const double *q, *v;
    const double *q_d, *v_d, *q_dd; /* (n) where the joints should be as far as they are free to, rad, rad/s, rad/s² */
    vector p_HO, p_d;
    matrix R_HO, R_d;
    double twist[6], twist_d[6], a_d[6], integral[6], external[6];
    const double *R_before; /* (N, 9) */
    joint_motion joints;
    const double *place;    /* (N, 12) where the tips' links are: p and R */
} told;

/* What it wants, part after part in this order. */
typedef struct {
    double *error, *acceleration, *object, *w, *joints; /* (6) in H, (6) in H, (6) in O, (6), (n) */
    double *J;                                          /* (k, n) */
    double *contact[12];                                /* as rolling_contact */
} wanted;

enum { WANTED_PARTS = 18 };

static inline void wanted_sizes(const hold_numbers *h, long sizes[WANTED_PARTS])
{
    const long N = h->N, n = h->n;
    const long all[WANTED_PARTS] = {6,     6,     6, 6,     n,     h->k * n, 3 * N, 9 * N, 3 * N * n,
                                    18 * N, 3 * N, 3 * N, N, 3 * N, 9 * N,    N * n, 6 * N, N};
    memcpy(sizes, all, sizeof all);
}

static inline long lay_out(const hold_numbers *h, double *block, wanted *out)
{
    long sizes[WANTED_PARTS], total = 0;
    double *parts[WANTED_PARTS];
    wanted_sizes(h, sizes);
    for (int p = 0; p < WANTED_PARTS; total += sizes[p++]) parts[p] = block == NULL ? NULL : block + total;
    out->error = parts[0], out->acceleration = parts[1], out->object = parts[2], out->w = parts[3];
    out->joints = parts[4], out->J = parts[5];
    memcpy(out->contact, parts + 6, sizeof out->contact);
    return total;
}

enum { C_P_OC, C_R_OC, C_A, C_B, C_BETA, C_VELOCITY, C_GAP, C_P_OF, C_R_OF, C_SPIN_A, C_SPIN_B, C_SPIN_BETA };

/* a = a_d + K_d (V_d − V) + K_p e + K_i ∫e. */
static inline void follow(const hold_numbers *h, const told *now, const wanted *out)
{
    pose_error(now->p_d, now->R_d, now->p_HO, now->R_HO, out->error);
    for (int k = 0; k < 6; k++)
        out->acceleration[k] = now->a_d[k] + h->kd[k] * (now->twist_d[k] - now->twist[k]) + h->kp[k] * out->error[k] +
                               h->ki[k] * now->integral[k];
    to_O(now->R_HO, out->acceleration, out->object);
    to_O(now->R_HO, out->acceleration + 3, out->object + 3);
}

/* The contacts of all tips. `rates` holds 6 (n + 2) numbers. */
static inline void roll_on(const hold_numbers *h, const told *now, double *rates, const wanted *out)
{
    held_object o = {.shape = h->shape};
    memcpy(o.p_HO, now->p_HO, sizeof o.p_HO);
    memcpy(o.R_HO, now->R_HO, sizeof o.R_HO);
    memcpy(o.twist, now->twist, sizeof o.twist);
    to_O(o.R_HO, o.twist + 3, o.omega);
    double *const *all = out->contact;
    const int n = h->n, size[12] = {3, 9, 3 * n, 18, 3, 3, 1, 3, 9, n, 6, 1};
    for (int i = 0; i < h->N; i++) {
        touching_tip tip = {.radius = h->radii[i], .rates = rates};
        double *own[12];
        for (int part = 0; part < 12; part++) own[part] = all[part] + i * size[part];
        place_tip(now->place + 12 * i, now->place + 12 * i + 3, h->p_LF + 3 * i, h->R_LF + 9 * i, tip.p_HF, tip.R_HF);
        tip_rates(&now->joints, tip.p_HF, h->moved + i * h->full, rates);
        memcpy(tip.p_hold, h->p_hold + 3 * i, sizeof tip.p_hold);
        memcpy(tip.R_hold, h->R_hold + 9 * i, sizeof tip.R_hold);
        memcpy(tip.before, now->R_before + 9 * i, sizeof tip.before);
        const rolling_contact contact = {own[0], own[1], own[2], own[3], own[4],  own[5],
                                         own[6], own[7], own[8], own[9], own[10], own[11]};
        roll(&o, &tip, n, &contact);
    }
}

/* Rows of `plain` (3 N) and `spin` (N), as many numbers wide, by their padded places, spins weighed; one after the other. */
static inline void gather(int count, const int *rows, int width, const double *plain, const double *spin, double arm, double *to)
{
    for (int i = 0; i < count; i++, to += width) {
        const int contact = rows[i] / 4, component = rows[i] % 4, spins = component == 3;
        const double *from = spins ? spin + contact * width : plain + (3 * contact + component) * width;
        for (int j = 0; j < width; j++) to[j] = (spins ? arm : 1.0) * from[j];
    }
}

/* The wrench about O that the body needs: `Body.wrench_at`, of p̈ − g, ω̇ and ω in O's axes. */
static inline void wrench_for(const hold_numbers *h, const vector felt, const vector turning, const vector omega, double w[6])
{
    const double *c = h->p_OM;
    vector torque, momentum, u, along_turn, along_spin, gyroscopic, moment; /* u = ω × c, m/s */
    for (int k = 0; k < 3; k++) {
        torque[k] = turning[0] * h->inertia[k] + turning[1] * h->inertia[3 + k] + turning[2] * h->inertia[6 + k];   /* N·m */
        momentum[k] = omega[0] * h->inertia[k] + omega[1] * h->inertia[3 + k] + omega[2] * h->inertia[6 + k]; /* kg·m²/s */
    }
    cross(omega, c, u);
    cross(turning, c, along_turn);
    cross(omega, u, along_spin);
    for (int k = 0; k < 3; k++) w[k] = h->mass * (felt[k] + along_turn[k] + along_spin[k]); /* N */
    cross(omega, momentum, gyroscopic);
    cross(c, w, moment);
    for (int k = 0; k < 3; k++) w[3 + k] = torque[k] + gyroscopic[k] + moment[k];
}

/* How many numbers `want` needs to work with. */
static inline size_t want_room(const hold_numbers *h)
{
    const size_t n = (size_t)h->n, r = (size_t)h->r;
    return 6 * (n + 2) + r * (n + 7) + r * (r + 1) + n;
}

/* All that is wanted before any force is known. Returns 0 where the fingers may not be able to move their contacts every way:
 * then the acceleration is what was commanded, and joints and w are not written. */
static inline int want(const hold_numbers *h, const told *now, double *work, const wanted *out)
{
    const int n = h->n, r = h->r;
    double *rates = work, *A = rates + 6 * (n + 2), *B = A + r * n, *beta = B + 6 * r, *K = beta + r, *posture = K + r * (r + 1);
    double *const *c = out->contact;
    follow(h, now, out);
    roll_on(h, now, rates, out);
    gather(h->k, h->force, n, c[C_A], c[C_SPIN_A], 1.0, out->J);
    gather(r, h->tied, n, c[C_A], c[C_SPIN_A], SPIN_ARM, A);
    gather(r, h->tied, 6, c[C_B], c[C_SPIN_B], SPIN_ARM, B);
    gather(r, h->tied, 1, c[C_BETA], c[C_SPIN_BETA], SPIN_ARM, beta);
    for (int j = 0; j < n; j++) { /* rad/s² */
        double pull = h->stiffness * (now->q_d[j] - now->q[j]);
        if (pull > h->reach[j]) pull = h->reach[j];
        if (pull < -h->reach[j]) pull = -h->reach[j];
        posture[j] = now->q_dd[j] + h->damping * (now->v_d[j] - now->v[j]) + pull;
    }
    if (!keep_contacts(r, n, A, B, beta, out->object, posture, h->least_lever, K, out->joints)) return 0;

    vector felt, omega, g;
    to_O(now->R_HO, h->gravity_H, g);
    to_O(now->R_HO, now->twist + 3, omega);
    for (int k = 0; k < 3; k++) felt[k] = out->object[k] - g[k];
    wrench_for(h, felt, out->object + 3, omega, out->w);
    for (int k = 0; k < 6; k++) out->w[k] -= now->external[k];
    return 1;
}

/* w − G n s/μ and tau_u + Jᵀ n s/μ: with these the usual cones keep the margin. `shift` (N) is s/μ, N. */
static inline void tighten(const hold_numbers *h, const wanted *out, const double *tau_u, const double *shift, double w[6],
                           double *tau)
{
    const double *A = out->contact[C_A], *B = out->contact[C_B];
    memcpy(w, out->w, 6 * sizeof(double));
    memcpy(tau, tau_u, (size_t)h->n * sizeof(double));
    for (int i = 0; i < h->N; i++) {
        for (int k = 0; k < 6; k++) w[k] -= shift[i] * B[18 * i + 12 + k];
        for (int j = 0; j < h->n; j++) tau[j] += shift[i] * A[(3 * i + N) * h->n + j];
    }
}

/* Whether some number is not between its bounds, (2, n). */
static inline int leaves(int n, const double *x, const double *bounds)
{
    int inside = 1;
    for (int j = 0; j < n; j++) inside &= (x[j] - bounds[j]) * (bounds[n + j] - x[j]) > 0.0; /* not so for NaN */
    return !inside;
}

/* What was before, and what is to come of it. */
typedef struct {
    const double *q, *tau_u, *f, *integral, *creep;  /* (n), (n), (k), (6), (N, 2) */
    const double *p_OF, *R_OF, *p_OC;                /* where the tips stood: (N, 3), (N, 9), (N, 3) */
    int grows;                                       /* whether the integral may */
} before;

typedef struct {
    double *tau, *creep, *crept, *integral; /* (n), (N, 2), (N), (6) */
} after;

enum { SATURATED = 1, OFF = 2, AT_END = 4 }; /* a motor at its limit; a tip that slips or does not touch; a joint at its end */

/* The torques that make the forces, within the motors' limits; what the tips slid; and the integral. Returns the signs above. */
static inline int settle(const hold_numbers *h, const wanted *now, const before *b, const after *out)
{
    const int n = h->n;
    int signs = 0;
    memcpy(out->tau, b->tau_u, (size_t)n * sizeof(double));
    for (int i = 0; i < h->k; i++)
        for (int j = 0; j < n; j++) out->tau[j] += b->f[i] * now->J[i * n + j];
    for (int j = 0; j < n; j++) { /* as NumPy's maximum and minimum: what is no number stays */
        if (out->tau[j] < h->tau_limits[j]) out->tau[j] = h->tau_limits[j];
        if (out->tau[j] > h->tau_limits[n + j]) out->tau[j] = h->tau_limits[n + j];
    }
    if (leaves(n, out->tau, h->at_limits)) signs |= SATURATED;
    if (leaves(n, b->q, h->q_limits)) signs |= AT_END;
    for (int i = 0; i < h->N; i++) {
        double slid[2];
        slide(b->p_OF + 3 * i, b->R_OF + 9 * i, b->p_OC + 3 * i, now->contact[C_P_OF] + 3 * i, now->contact[C_R_OF] + 9 * i,
              now->contact[C_R_OC] + 9 * i, slid);
        for (int t = 0; t < 2; t++) out->creep[2 * i + t] = h->kept_creep * b->creep[2 * i + t] + slid[t];
        out->crept[i] = hypot(out->creep[2 * i], out->creep[2 * i + 1]); /* m */
        if (out->crept[i] > h->creep_limit || now->contact[C_GAP][i] > h->touch_gap) signs |= OFF;
    }
    const int grows = b->grows && !(signs & SATURATED);
    for (int k = 0; k < 6; k++) out->integral[k] = b->integral[k] + (grows ? h->period * now->error[k] : 0.0);
    if (grows) bound(out->integral, h->ki, h->integral_limits);
    return signs;
}

#endif
