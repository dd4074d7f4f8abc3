/* Fusion of the pose from the contacts with late camera poses: one update of an error-state Kalman filter.
 *
 * The object's pose is T_contact D. The filter estimates the offset D and a constant error b of the camera in H, with the errors
 *
 *     x = (δ, b),    D = D̂ exp(δ),    δ in O.
 *
 * The laws are stated in graspforce/estimation/pose/pose_fusion.py, the reference implementation in Python, which the tests compare
 * with this one.
 *
 * Frames: H is the hand's base, O the object. Positions are in m, angles in rad. Matrices are stored by rows, and arrays are
 * contiguous. No function allocates memory or writes global state.
 */
#ifndef GF_POSE_FUSION_H
#define GF_POSE_FUSION_H

#ifdef __cplusplus
extern "C" {
#endif

/* State of the filter: FIELD(name, shape).
 *
 * p, R        offset D
 * bias        estimate of b
 * covariance  of x, m² and rad² */
#define GF_OFFSET_FIELDS(FIELD) \
    FIELD(p, 3)                 \
    FIELD(R, 3, 3)              \
    FIELD(bias, 6)              \
    FIELD(covariance, 12, 12)

/* The arrays of a state. */
typedef struct {
#define GF_POINTER(name, ...) double *name;
    GF_OFFSET_FIELDS(GF_POINTER)
#undef GF_POINTER
} gf_offset_state;

/* Arrays of an update: FIELD(name, shape).
 *
 * p_measured, R_measured  measured pose in H
 * noise                   (6, 6) covariance of the measured pose in H
 * p_HO, R_HO              pose from the contacts at the time of the measured pose
 * contact_covariance      (6, 6) covariance of the pose from the contacts in O
 * free_motions            (6, 6) F: unit displacements in O that the contacts leave free have the covariance F Fᵀ */
#define GF_FUSION_ARRAYS(FIELD)     \
    FIELD(p_measured, 3)            \
    FIELD(R_measured, 3, 3)         \
    FIELD(noise, 6, 6)              \
    FIELD(p_HO, 3)                  \
    FIELD(R_HO, 3, 3)               \
    FIELD(contact_covariance, 6, 6) \
    FIELD(free_motions, 6, 6)

/* Numbers of an update.
 *
 * position_drift  growth of the variance of each coordinate of the offset since the last update, m²
 * angle_drift     the same about each axis, rad²
 * free_drift      the same along free motions, m²
 * gate            largest normalised squared innovation that is accepted */
#define GF_FUSION_NUMBERS(FIELD) \
    FIELD(position_drift)        \
    FIELD(angle_drift)           \
    FIELD(free_drift)            \
    FIELD(gate)

typedef struct {
#define GF_POINTER(name, ...) const double *name;
#define GF_NUMBER(name)       double name;
    GF_FUSION_ARRAYS(GF_POINTER)
    GF_FUSION_NUMBERS(GF_NUMBER)
#undef GF_NUMBER
#undef GF_POINTER
} gf_fusion_inputs;

/* Results of gf_fuse_pose(). Only with GF_POSE_ACCEPTED the output is defined. */
enum {
    GF_FUSION_FAILED = 0, /* a covariance is not positive definite, or a number is not finite */
    GF_POSE_OUTLIER = 1,  /* the innovation is outside the gate */
    GF_POSE_ACCEPTED = 2
};

/* Update the state with a measured pose. Return one of the results above. `next` is written; it must not overlap `last`. */
int gf_fuse_pose(const gf_fusion_inputs *inputs, const gf_offset_state *last, const gf_offset_state *next);

/* Compute the pose at a share of the way to another one: on a straight line, and about a fixed axis.
 *
 * p, R                the pose
 * p_target, R_target  the other one
 * share               from 0 to 1
 * p_next, R_next      written; they must not overlap the inputs
 *
 * Return the largest component of the whole way, m and rad. */
double gf_interpolate_pose(const double p[3], const double R[9], const double p_target[3], const double R_target[9],
                           double share, double p_next[3], double R_next[9]);

#ifdef __cplusplus
}
#endif

#endif
