/* Pose and twist of a held object from its fingertips, whose contacts roll without slip.
 *
 * The pose keeps what the contacts have kept since the start of the grasp: the accumulated slip along t1 and t2 is zero, the gap
 * stays, and a contact with torsional friction does not spin. One Gauss–Newton step from the predicted pose,
 *
 *     ξ = (Bᵀ W B)⁺ Bᵀ W r,
 *
 * removes the residuals r; more follow after a gap in the measurements. The laws are stated in
 * graspforce/estimation/pose/contact_pose.py, the reference implementation in Python, which the tests compare with this one.
 *
 * Frames: H is the hand's base, O the object, C a contact, F a fingertip, L a link. Matrices are stored by rows, and arrays are
 * contiguous. No function allocates memory or writes global state.
 */
#ifndef GF_CONTACT_POSE_H
#define GF_CONTACT_POSE_H

#include <stddef.h>

#include "graspforce/contact_kinematics.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Numbers and arrays of a grasp: FIELD(name, shape). The shapes depend on contact_count (N), motor_count (n) and joint_count.
 *
 * period      time between two steps, s
 * least_eigenvalue  of Bᵀ W B, with rotations as displacements at 30 mm, that is not treated as zero
 * radii       of the fingertips, m; 0 for a tip that touches with its origin
 * p_OC, R_OC  contact points, m, and contact frames at the start of the grasp
 * p_LF, R_LF  tip frames in the links that carry them, p in m
 * T           motor rates to joint rates */
#define GF_TRACKED_FIELDS(FIELD)     \
    FIELD(period, 1)                 \
    FIELD(least_eigenvalue, 1)       \
    FIELD(radii, contact_count)      \
    FIELD(p_OC, contact_count, 3)    \
    FIELD(R_OC, contact_count, 3, 3) \
    FIELD(p_LF, contact_count, 3)    \
    FIELD(R_LF, contact_count, 3, 3) \
    FIELD(T, joint_count, motor_count)

/* A grasp, constant during all steps. */
typedef struct {
    int contact_count, motor_count, joint_count;
    gf_surface surface;
#define GF_POINTER(name, ...) const double *name;
    GF_TRACKED_FIELDS(GF_POINTER)
#undef GF_POINTER
    const unsigned char *moves_tip; /* (contact_count, joint_count) nonzero if the joint moves the tip */
} gf_tracked_grasp;

/* Measured hand and weights of a step. The hand's motion is computed at the estimated joint positions and rates. */
typedef struct {
    const double *v;                 /* (motor_count) joint rates, rad/s */
    const double *joint_twists;      /* (6, joint_count) twist at H's origin of the links after each joint, for unit rate */
    const double *joint_twist_rates; /* (6, joint_count) their time derivatives */
    const double *link_poses;        /* (contact_count, 12) of the links that carry the tips: p_HL in m, then R_HL */
    const double *gap;               /* (contact_count) gaps that count as touching, m */
    const double *weights; /* (contact_count, 4) of the residuals along t1, t2 and n, and about n; zero: starts anew */
} gf_tracking_inputs;

/* Pose of the object, and state of its contacts. GF_CONTACT_FIELDS follow in the same block.
 *
 * p_HO, R_HO  pose in H, p in m
 * twist       in H, m/s and rad/s
 * slip        slip along t1 and t2 since the start that no motion of the object explains, m
 * spin        the same about n, rad */
#define GF_CONTACT_POSE_FIELDS(FIELD) \
    FIELD(p_HO, 3)                    \
    FIELD(R_HO, 3, 3)                 \
    FIELD(twist, 6)                   \
    FIELD(slip, contact_count, 2)     \
    FIELD(spin, contact_count)

typedef struct {
#define GF_POINTER(name, ...) double *name;
    GF_CONTACT_POSE_FIELDS(GF_POINTER)
#undef GF_POINTER
    gf_contacts contacts;
} gf_contact_pose;

/* Return the numbers of workspace that gf_track_contacts() needs. */
size_t gf_tracking_work_size(const gf_tracked_grasp *grasp);

/* Compute the pose after a period.
 *
 * last  pose of the last period; its pose, twist, slip, spin, p_OC, R_OC, p_OF and R_OF are used
 * next  written; no part of it may overlap `last`
 *
 * Return the number of Gauss–Newton steps, or 0 if a number is not finite; `next` is then undefined. */
int gf_track_contacts(const gf_tracked_grasp *grasp, const gf_tracking_inputs *inputs, const gf_contact_pose *last,
                      double *work, const gf_contact_pose *next);

/* Noise of the residuals of a pose. */
typedef struct {
    double joint_variance;   /* of each estimated joint position, rad² */
    double contact_variance; /* of each momentary residual, m² */
    const double *weights;   /* (contact_count, 4) of the residuals along t1, t2 and n, and about n */
    const double *reference; /* (4 contact_count, 4 contact_count) covariance of errors from the start, m² */
} gf_residual_noise;

/* Return the numbers of workspace that gf_pose_uncertainty() needs. */
size_t gf_uncertainty_work_size(const gf_tracked_grasp *grasp);

/* Compute the covariance of a pose from noise, and the displacements that the contacts leave free.
 *
 * grasp         contact_count, motor_count and least_eigenvalue are used
 * contacts      of the pose
 * covariance    (6, 6) of p in O, m², and of the rotation vector in O, rad²; written
 * free_motions  (6, 6) F such that F Fᵀ is the covariance of unit displacements along all free motions; written
 *
 * Return 1, or 0 if a number is not finite. */
int gf_pose_uncertainty(const gf_tracked_grasp *grasp, const gf_contacts *contacts, const gf_residual_noise *noise,
                        double *work, double covariance[36], double free_motions[36]);

#ifdef __cplusplus
}
#endif

#endif
