/* One update of the filter of joint positions, joint rates and accelerations of disturbances.
 *
 *     x⁺ = G (x, a, y)    for each joint,
 *
 * with the last state x, the commanded acceleration a within its limit, the measurements y, and gains G that include the
 * prediction. The law is stated in graspforce/estimation/joint_filter.py, the reference implementation in Python, which the
 * tests compare with this one. The function neither allocates memory nor writes global state.
 */
#ifndef GF_JOINT_FILTER_H
#define GF_JOINT_FILTER_H

#ifdef __cplusplus
extern "C" {
#endif

/* Inputs of gf_filter_joints(). Matrices are stored by rows.
 *
 * motor_count   n
 * gains         (3, 5), or (3, 6) with measured rates
 * x             (3, n) positions, rad, rates, rad/s, and accelerations of disturbances, rad/s²
 * acceleration  (n) commanded, rad/s²; NULL: zero
 * limits        (n) largest acceleration that counts, rad/s²
 * q             (n) measured positions, rad
 * v             (n) measured rates, rad/s; NULL if not measured */
typedef struct {
    int motor_count;
    const double *gains, *x, *acceleration, *limits, *q, *v;
} gf_joint_filter_inputs;

/* Compute the state (3, n) after a measurement. `next` must not overlap the inputs. */
void gf_filter_joints(const gf_joint_filter_inputs *inputs, double *next);

#ifdef __cplusplus
}
#endif

#endif
