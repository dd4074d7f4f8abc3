/* Motion of a rigid body: that of a frame fixed in it, and that after a short time.
 *
 * The reference implementation in Python is graspforce/contact/motion.py. Twists and accelerations have the linear part first.
 * Matrices are stored by rows. No function allocates memory or writes global state.
 */
#ifndef GF_BODY_MOTION_H
#define GF_BODY_MOTION_H

#ifdef __cplusplus
extern "C" {
#endif

/* Motion of a body with the frame O in the frame H: FIELD(name, shape). In a block the arrays follow one another.
 *
 * p_HO, R_HO    pose, p in m
 * twist         of O's origin, m/s and rad/s, in H
 * acceleration  its time derivative, m/s² and rad/s², in H */
#define GF_BODY_MOTION_FIELDS(FIELD) \
    FIELD(p_HO, 3)                   \
    FIELD(R_HO, 3, 3)                \
    FIELD(twist, 6)                  \
    FIELD(acceleration, 6)

typedef struct {
    double p_HO[3], R_HO[9], twist[6], acceleration[6];
} gf_body_motion;

/* Compute the motion of a frame P that is fixed in a body, at p_OP with the axes R_OP in O. It must not overlap the body's. */
void gf_fixed_frame_motion(const gf_body_motion *body, const double p_OP[3], const double R_OP[9], gf_body_motion *frame);

/* Compute the motion after a short time, s, with constant acceleration: p + v t + a t²/2 and exp(ω t + α t²/2) R. It must not
 * overlap the body's. */
void gf_motion_after(const gf_body_motion *body, double duration, gf_body_motion *later);

/* Compute the motion after a short time, s, of a frame P that is fixed in a body: in P, the body is at p_PO with the axes R_PO.
 * `parent` must not overlap the body's motion. */
void gf_parent_frame_motion(const gf_body_motion *body, double duration, const double p_PO[3], const double R_PO[9],
                            gf_body_motion *parent);

#ifdef __cplusplus
}
#endif

#endif
