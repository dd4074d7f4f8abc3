/* Implementation of contact_kinematics.h: rolling contacts and sliding. Vectors are in O unless their name ends in _H. */
#include "graspforce/contact_kinematics.h"

#include <string.h>

#include "../real.inc"
#include "closest_point.inc"
#include "vector3.inc"

static const double MIN_DISTANCE = 1e-9;    /* m: closer to the surface, the centre of a tip gives no normal */
static const double MIN_TANGENT = 1e-9;     /* sine of the angle between n and the last t1 below which t1 is lost */
static const double DIFFERENCE_TIME = 1e-4; /* s: half of the interval of the central difference for the surface velocity */

enum { T1, T2, NORMAL }; /* columns of a contact frame */

gf_contacts gf_contact_at(const gf_contacts *all, int i, int motor_count)
{
    gf_contacts one;
#define GF_ADVANCE(name, size, ...) one.name = all->name + (long)i * (size);
    GF_CONTACT_FIELDS(GF_ADVANCE)
#undef GF_ADVANCE
    return one;
}

/* Compute a contact frame from the vector `inward`, which points from the centre of the tip to the surface.
 *
 * n points along `inward`, or against it if the centre is inside the object; the last n decides which. t2 = n × t1 continues
 * from the last t1. If n has turned into the last t1, the last t2 stays.
 *
 * Return the distance of the surface from the centre, m, negative if the centre is inside. */
static double gf_update_contact_frame(const gf_vector3 inward, const gf_matrix3 R_last, gf_matrix3 R)
{
    gf_vector3 last[3], n, t1, t2;
    for (int axis = 0; axis < 3; axis++)
        for (int k = 0; k < 3; k++) last[axis][k] = R_last[3 * k + axis];
    const double distance = copysign(gf_length(inward), gf_dot(inward, last[NORMAL])); /* m */
    for (int k = 0; k < 3; k++) n[k] = fabs(distance) > MIN_DISTANCE ? inward[k] / distance : last[NORMAL][k];
    gf_cross(n, last[T1], t2);
    const double length = gf_length(t2);
    for (int k = 0; k < 3; k++) t2[k] = length > MIN_TANGENT ? t2[k] / length : last[T2][k];
    gf_cross(t2, n, t1);
    for (int k = 0; k < 3; k++) R[3 * k + T1] = t1[k], R[3 * k + T2] = t2[k], R[3 * k + NORMAL] = n[k];
    return distance;
}

/* Compute the contact point x, its frame R and its velocity over the surface, for a tip at c that moves with c_rate relative to
 * the object. Without c_rate (NULL), the velocity is 0. Return the gap, m. */
static double gf_locate_contact(const gf_object_state *object, const gf_fingertip *tip, const gf_vector3 c,
                                const double *c_rate, gf_vector3 x, gf_matrix3 R, gf_vector3 surface_velocity)
{
    gf_vector3 offset, n, inward;
    for (int k = 0; k < 3; k++) offset[k] = tip->p_OC_start[k] - c[k], n[k] = tip->R_OC_start[3 * k + NORMAL];
    memset(surface_velocity, 0, sizeof(gf_vector3));
    if (tip->radius == 0.0) {
        memcpy(x, tip->p_OC_start, sizeof(gf_vector3));
        memcpy(R, tip->R_OC_start, sizeof(gf_matrix3));
        return gf_dot(offset, n);
    }
    if (object->surface.kind == GF_PLANE) {
        const double height = gf_dot(offset, n), speed = c_rate == NULL ? 0.0 : gf_dot(c_rate, n);
        for (int k = 0; k < 3; k++) x[k] = c[k] + height * n[k];
        for (int k = 0; k < 3 && c_rate != NULL; k++) surface_velocity[k] = c_rate[k] - speed * n[k];
    } else {
        gf_closest_point(&object->surface, c, x);
    }
    if (object->surface.kind != GF_PLANE && c_rate != NULL) {
        gf_vector3 later, earlier, x_later, x_earlier;
        for (int k = 0; k < 3; k++)
            later[k] = c[k] + DIFFERENCE_TIME * c_rate[k], earlier[k] = c[k] - DIFFERENCE_TIME * c_rate[k];
        gf_closest_point(&object->surface, later, x_later);
        gf_closest_point(&object->surface, earlier, x_earlier);
        for (int k = 0; k < 3; k++) surface_velocity[k] = (x_later[k] - x_earlier[k]) * (0.5 / DIFFERENCE_TIME);
    }
    for (int k = 0; k < 3; k++) inward[k] = x[k] - c[k];
    return gf_update_contact_frame(inward, tip->R_OC_last, R) - tip->radius;
}

/* Compute the velocity along the axis e at `arm` from the tip's origin, for each of the n + 2 columns of tip->rates:
 * e·(v + ω × arm) = e·v + (arm × e)·ω. The first n go to A, the velocity and the drift of the tip to `rest`. */
static void gf_velocity_row(const gf_matrix3 R_HO, const gf_vector3 arm, const gf_vector3 e, const gf_fingertip *tip, double *A,
                            double rest[2])
{
    gf_vector3 moment, row[2]; /* coefficients of the linear and the angular part, in H */
    gf_cross(arm, e, moment);
    gf_multiply(R_HO, e, row[0]);
    gf_multiply(R_HO, moment, row[1]);
    const int n = tip->motor_count, width = n + 2;
    for (int j = 0; j < n; j++) {
        const double *r = tip->rates + j;
        A[j] = row[0][0] * r[0] + row[0][1] * r[width] + row[0][2] * r[2 * width] + row[1][0] * r[3 * width] +
               row[1][1] * r[4 * width] + row[1][2] * r[5 * width];
    }
    for (int j = 0; j < 2; j++) {
        rest[j] = 0.0;
        for (int k = 0; k < 6; k++) rest[j] += row[k / 3][k % 3] * tip->rates[k * width + n + j];
    }
}

/* Motion of the tip and the contact point relative to the object's origin. */
typedef struct {
    gf_vector3 c, c_rate;          /* c − p, m, and ċ − ṗ, m/s */
    gf_vector3 omega_O, omega_F;   /* rad/s */
    gf_vector3 spin;               /* ω_F − ω_O, rad/s */
    gf_vector3 x_rate, separation; /* ẋ − ṗ and ẋ − ċ, m/s */
} gf_contact_motion;

/* Compute the constraint of the spin about n: n·(ω̇_F − ω̇_O) + ṅ·(ω_F − ω_O) = 0. `distance` is that of x from c, m. */
static void gf_spin_constraint(const gf_object_state *object, const gf_fingertip *tip, const gf_contact_motion *motion,
                               const gf_vector3 n, double distance, const gf_contacts *contact)
{
    const int motor_count = tip->motor_count, width = motor_count + 2;
    const double *r = tip->rates + 3 * width;
    gf_vector3 n_H, n_rate = {0.0, 0.0, 0.0}; /* ṅ, 1/s */
    gf_multiply(object->R_HO, n, n_H);
    for (int j = 0; j < motor_count; j++)
        contact->spin_A[j] = n_H[0] * r[j] + n_H[1] * r[width + j] + n_H[2] * r[2 * width + j];
    for (int k = 0; k < 3; k++) contact->spin_B[k] = 0.0, contact->spin_B[3 + k] = n[k];
    const double speed = gf_dot(motion->separation, n);
    double drift = 0.0;
    if (tip->radius == 0.0)
        gf_cross(motion->omega_O, n, n_rate); /* n is fixed in the object */
    else if (fabs(distance) > MIN_DISTANCE)
        for (int k = 0; k < 3; k++) n_rate[k] = (motion->separation[k] - speed * n[k]) / distance;
    for (int k = 0; k < 3; k++) drift += n_H[k] * r[k * width + motor_count + 1];
    contact->spin_beta[0] = -drift - gf_dot(n_rate, motion->spin);
}

/* Compute the motion of the tip; x_rate and separation are not written. */
static void gf_tip_motion_in_O(const gf_object_state *object, const gf_fingertip *tip, gf_contact_motion *motion)
{
    const int n = tip->motor_count, width = n + 2;
    gf_vector3 p, v, omega; /* relative to the object, in H */
    for (int k = 0; k < 3; k++) {
        p[k] = tip->p_HF[k] - object->p_HO[k];
        v[k] = tip->rates[k * width + n] - object->twist[k];
        omega[k] = tip->rates[(3 + k) * width + n] - object->twist[3 + k];
    }
    gf_multiply_transposed(object->R_HO, p, motion->c);
    gf_multiply_transposed(object->R_HO, v, motion->c_rate);
    gf_multiply_transposed(object->R_HO, omega, motion->spin);
    gf_multiply_transposed(object->R_HO, object->twist + 3, motion->omega_O);
    for (int k = 0; k < 3; k++) motion->omega_F[k] = motion->spin[k] + motion->omega_O[k];
}

/* Compute one contact; without `rates`, as if its point did not move over the object. */
static void gf_compute_contact_with(const gf_object_state *object, const gf_fingertip *tip, int rates,
                                    const gf_contacts *contact)
{
    gf_contact_motion motion;
    gf_vector3 swept, seen_rate, surface_velocity, arm, n, bias, bias_F;
    double *x = contact->p_OC, *R = contact->R_OC;
    gf_tip_motion_in_O(object, tip, &motion);
    gf_cross(motion.omega_O, motion.c, swept);
    for (int k = 0; k < 3; k++) seen_rate[k] = motion.c_rate[k] - swept[k];
    const double gap = gf_locate_contact(object, tip, motion.c, rates ? seen_rate : NULL, x, R, surface_velocity);

    gf_cross(motion.omega_O, x, motion.x_rate);
    for (int k = 0; k < 3; k++) {
        motion.x_rate[k] += surface_velocity[k];
        motion.separation[k] = motion.x_rate[k] - motion.c_rate[k];
        arm[k] = x[k] - motion.c[k];
        n[k] = R[3 * k + NORMAL];
    }
    gf_cross(motion.omega_O, motion.x_rate, bias);
    gf_cross(motion.omega_F, motion.separation, bias_F);
    for (int k = 0; k < 3; k++) bias[k] -= bias_F[k]; /* ω_O × (ẋ − ṗ) − ω_F × (ẋ − ċ), m/s² */

    for (int row = T1; row <= NORMAL; row++) {
        const gf_vector3 e = {R[row], R[3 + row], R[6 + row]};
        double rest[2]; /* velocity of the finger's point at x along e, m/s, and its drift, m/s² */
        gf_velocity_row(object->R_HO, arm, e, tip, contact->A + row * tip->motor_count, rest);
        memcpy(contact->B + 6 * row, e, sizeof(gf_vector3));
        gf_cross(x, e, contact->B + 6 * row + 3);
        contact->velocity[row] = rest[0];
        contact->beta[row] = gf_dot(e, bias) - rest[1];
    }
    gf_spin_constraint(object, tip, &motion, n, gap + tip->radius, contact);

    memcpy(contact->p_OF, motion.c, sizeof(gf_vector3));
    contact->gap[0] = gap;
    for (int k = 0; k < 3; k++) { /* R_OF = R_HOᵀ R_HF, column by column */
        const gf_vector3 axis_H = {tip->R_HF[k], tip->R_HF[3 + k], tip->R_HF[6 + k]};
        gf_vector3 axis;
        gf_multiply_transposed(object->R_HO, axis_H, axis);
        for (int j = 0; j < 3; j++) contact->R_OF[3 * j + k] = axis[j];
    }
}

void gf_compute_contact(const gf_object_state *object, const gf_fingertip *tip, const gf_contacts *contact)
{
    gf_compute_contact_with(object, tip, 1, contact);
}

void gf_compute_contact_place(const gf_object_state *object, const gf_fingertip *tip, const gf_contacts *contact)
{
    gf_compute_contact_with(object, tip, 0, contact);
}

void gf_slip_displacement(const gf_tip_contact *last, const double *p_OF, const double *R_OF, const double *R_OC,
                          double slip[2])
{
    gf_vector3 lever, lever_F, displacement; /* lever from the tip's origin to the last contact point, in O and in F */
    for (int k = 0; k < 3; k++) lever[k] = last->p_OC[k] - last->p_OF[k];
    gf_multiply_transposed(last->R_OF, lever, lever_F);
    gf_multiply(R_OF, lever_F, displacement);
    for (int k = 0; k < 3; k++) displacement[k] += p_OF[k] - last->p_OC[k];
    for (int t = T1; t <= T2; t++)
        slip[t] = displacement[0] * R_OC[t] + displacement[1] * R_OC[3 + t] + displacement[2] * R_OC[6 + t];
}
