/* Implementation of hand_model.h. All twists and wrenches are about H's origin, so that they add without transformations. */
#include "graspforce/hand_model.h"

#include <string.h>

#include "../real.inc"

#include "../control/rotation.inc"
#include "../control/vector3.inc"

size_t gf_hand_motion_size(const gf_hand_model *hand)
{
    const size_t joint_count = (size_t)hand->joint_count;
    return joint_count + 12 * (joint_count + 1) + 18 * joint_count;
}

gf_hand_motion gf_map_hand_motion(const gf_hand_model *hand, double *block)
{
    const size_t joint_count = (size_t)hand->joint_count;
    gf_hand_motion motion;
    motion.joint_rates = block, block += joint_count;
    motion.link_poses = block, block += 12 * (joint_count + 1);
    motion.joint_twists = block, block += 6 * joint_count;
    motion.joint_twist_rates = block, block += 6 * joint_count;
    motion.link_twists = block;
    return motion;
}

/* Compute y = T x. */
static void gf_joint_values(const gf_hand_model *hand, const double *x, double *y)
{
    const int n = hand->motor_count;
    for (int j = 0; j < hand->joint_count; j++) {
        y[j] = 0.0;
        for (int i = 0; i < n; i++) y[j] += hand->T[j * n + i] * x[i];
    }
}

/* Compute the pose of a link from that of its parent, and the axis of its joint in H. */
static void gf_place_link(const gf_link *link, double position, const double *parent, double *pose, double axis[3])
{
    double offset[3];
    gf_multiply(parent + 3, link->p_PL, offset);
    for (int k = 0; k < 3; k++) pose[k] = parent[k] + offset[k];
    double R[9];
    gf_multiply_matrices(parent + 3, link->R_PL, 0, R);
    gf_multiply(R, link->axis, axis);
    if (link->is_prismatic) {
        for (int k = 0; k < 3; k++) pose[k] += position * axis[k];
        memcpy(pose + 3, R, sizeof R);
        return;
    }
    /* Rodrigues' formula */
    const double *a = link->axis, s = sin(position), c = cos(position), d = 1.0 - c;
    const double turn[9] = {c + d * a[0] * a[0],        d * a[0] * a[1] - s * a[2], d * a[0] * a[2] + s * a[1],
                            d * a[1] * a[0] + s * a[2], c + d * a[1] * a[1],        d * a[1] * a[2] - s * a[0],
                            d * a[2] * a[0] - s * a[1], d * a[2] * a[1] + s * a[0], c + d * a[2] * a[2]};
    gf_multiply_matrices(R, turn, 0, pose + 3);
}

/* Compute c = V × S, the rate of a twist S that moves with the twist V. */
static void gf_twist_rate(const double V[6], const double S[6], double c[6])
{
    double other[3];
    gf_cross(V + 3, S, c);
    gf_cross(V, S + 3, other);
    for (int k = 0; k < 3; k++) c[k] += other[k];
    gf_cross(V + 3, S + 3, c + 3);
}

void gf_move_hand(const gf_hand_model *hand, const double *q, const double *v, const gf_hand_motion *motion)
{
    static const double base_pose[12] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1};
    const int joint_count = hand->joint_count;
    double *positions = motion->joint_twists; /* the first row of the twists is written after a position is read */
    gf_joint_values(hand, v, motion->joint_rates);
    gf_joint_values(hand, q, positions);
    memcpy(motion->link_poses, base_pose, sizeof base_pose);
    for (int j = 0; j < joint_count; j++) {
        const gf_link *link = hand->links + j;
        double *pose = motion->link_poses + 12 * (j + 1), *V = motion->link_twists + 6 * j, axis[3], S[6] = {0}, rate[6];
        gf_place_link(link, positions[j] + hand->q0[j], motion->link_poses + 12 * (link->parent + 1), pose, axis);
        if (link->is_prismatic) {
            memcpy(S, axis, sizeof axis);
        } else {
            gf_cross(pose, axis, S);
            memcpy(S + 3, axis, sizeof axis);
        }
        for (int k = 0; k < 6; k++)
            V[k] = (link->parent < 0 ? 0.0 : motion->link_twists[6 * link->parent + k]) + motion->joint_rates[j] * S[k];
        gf_twist_rate(V, S, rate);
        for (int k = 0; k < 6; k++) {
            motion->joint_twists[k * joint_count + j] = S[k];
            motion->joint_twist_rates[k * joint_count + j] = rate[k];
        }
    }
}

size_t gf_hand_dynamics_work_size(const gf_hand_model *hand)
{
    return 14 * (size_t)hand->joint_count;
}

/* Compute the wrench of a link with twist V and acceleration A, both about H's origin. */
static void gf_link_wrench(const gf_link *link, const double pose[12], const double V[6], const double A[6], double wrench[6])
{
    const double *R = pose + 3;
    double c[3], local[3], turned[3], l[3], h[3], other[3];
    gf_multiply(R, link->p_LM, c);
    for (int k = 0; k < 3; k++) c[k] += pose[k];
    const double *motions[2] = {V, A};
    double parts[2][6]; /* momentum, and its rate without the gyroscopic part */
    for (int m = 0; m < 2; m++) {
        const double *x = motions[m];
        gf_cross(x + 3, c, other);
        for (int k = 0; k < 3; k++) parts[m][k] = link->mass * (x[k] + other[k]);
        gf_multiply_transposed(R, x + 3, local);
        gf_multiply(link->inertia, local, turned);
        gf_multiply(R, turned, parts[m] + 3);
        gf_cross(c, parts[m], other);
        for (int k = 0; k < 3; k++) parts[m][3 + k] += other[k];
    }
    gf_cross(V + 3, parts[0], l);
    gf_cross(V + 3, parts[0] + 3, h);
    gf_cross(V, parts[0], other);
    for (int k = 0; k < 3; k++) {
        wrench[k] = parts[1][k] + l[k];
        wrench[3 + k] = parts[1][3 + k] + h[k] + other[k];
    }
}

void gf_hand_inverse_dynamics(const gf_hand_model *hand, const gf_hand_motion *motion, const double *a, const double gravity[3],
                              double *work, double *tau)
{
    const int n = hand->motor_count, joint_count = hand->joint_count;
    double *rates = work, *A = rates + joint_count, *wrenches = A + 6 * joint_count, *tau_full = wrenches + 6 * joint_count;
    gf_joint_values(hand, a, rates);
    for (int j = 0; j < joint_count; j++) {
        const int parent = hand->links[j].parent;
        for (int k = 0; k < 6; k++) {
            const double above = parent >= 0 ? A[6 * parent + k] : k < 3 ? -gravity[k] : 0.0;
            A[6 * j + k] = above + rates[j] * motion->joint_twists[k * joint_count + j] +
                           motion->joint_rates[j] * motion->joint_twist_rates[k * joint_count + j];
        }
        gf_link_wrench(hand->links + j, motion->link_poses + 12 * (j + 1), motion->link_twists + 6 * j, A + 6 * j,
                       wrenches + 6 * j);
    }
    for (int j = joint_count - 1; j >= 0; j--) {
        const int parent = hand->links[j].parent;
        tau_full[j] = 0.0;
        for (int k = 0; k < 6; k++) {
            tau_full[j] += motion->joint_twists[k * joint_count + j] * wrenches[6 * j + k];
            if (parent >= 0) wrenches[6 * parent + k] += wrenches[6 * j + k];
        }
    }
    for (int i = 0; i < n; i++) tau[i] = hand->rotor_inertia[i] * a[i];
    for (int j = 0; j < joint_count; j++)
        for (int i = 0; i < n; i++) tau[i] += hand->T[j * n + i] * tau_full[j];
}
