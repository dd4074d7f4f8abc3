/* Implementation of body_motion.h. */
#include "graspforce/body_motion.h"

#include <string.h>

#include "rotation.inc"
#include "vector3.inc"

void gf_fixed_frame_motion(const gf_body_motion *body, const double p_OP[3], const double R_OP[9], gf_body_motion *frame)
{
    const double *omega = body->twist + 3, *alpha = body->acceleration + 3;
    double lever[3], swept[3], tangential[3], centripetal[3]; /* m, m/s, and m/s² */
    gf_multiply(body->R_HO, p_OP, lever);
    gf_multiply_matrices(body->R_HO, R_OP, 0, frame->R_HO);
    gf_cross(omega, lever, swept);
    gf_cross(alpha, lever, tangential);
    gf_cross(omega, swept, centripetal);
    for (int k = 0; k < 3; k++) {
        frame->p_HO[k] = body->p_HO[k] + lever[k];
        frame->twist[k] = body->twist[k] + swept[k], frame->twist[3 + k] = omega[k];
        frame->acceleration[k] = body->acceleration[k] + tangential[k] + centripetal[k];
        frame->acceleration[3 + k] = alpha[k];
    }
}

void gf_motion_after(const gf_body_motion *body, double duration, gf_body_motion *later)
{
    double way[6], turn[9]; /* m and rad */
    for (int k = 0; k < 6; k++) {
        way[k] = duration * body->twist[k] + 0.5 * duration * duration * body->acceleration[k];
        later->twist[k] = body->twist[k] + duration * body->acceleration[k];
    }
    for (int k = 0; k < 3; k++) later->p_HO[k] = body->p_HO[k] + way[k];
    gf_rotation_exp(way + 3, turn);
    gf_multiply_matrices(turn, body->R_HO, 0, later->R_HO);
    memcpy(later->acceleration, body->acceleration, sizeof later->acceleration);
}

void gf_parent_frame_motion(const gf_body_motion *body, double duration, const double p_PO[3], const double R_PO[9],
                            gf_body_motion *parent)
{
    gf_body_motion later;
    double p_OP[3], R_OP[9];
    gf_motion_after(body, duration, &later);
    gf_multiply_transposed(R_PO, p_PO, p_OP);
    for (int k = 0; k < 3; k++) p_OP[k] = -p_OP[k];
    for (int k = 0; k < 9; k++) R_OP[k] = R_PO[3 * (k % 3) + k / 3];
    gf_fixed_frame_motion(&later, p_OP, R_OP, parent);
}
