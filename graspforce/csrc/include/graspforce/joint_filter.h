/* One update of the filter of joint positions, joint rates and accelerations of disturbances.
 *
 *     x⁺ = G (x, a, y)    for each joint,
 *
 * with the last state x, the commanded acceleration a within its limit, the measurements y, and gains G that include the
 * prediction over a period. With a latency of m periods, a is the command of m periods ago, and the state is predicted over the
 * m commands since. The laws are stated in graspforce/estimation/joints/joint_filter.py, the reference implementation in Python, which
 * the tests compare with this one. The function neither allocates memory nor writes global state.
 */
#ifndef GF_JOINT_FILTER_H
#define GF_JOINT_FILTER_H

#ifdef __cplusplus
extern "C" {
#endif

/* Inputs of gf_filter_joints(). Matrices are stored by rows.
 *
 * motor_count   n
 * latency       m, in periods
 * gains         (3, 5), or (3, 6) with measured rates
 * x             (3, n) positions, rad, rates, rad/s, and accelerations of disturbances, rad/s²
 * commands      (m, n) accelerations of the commands that do not act on the measurement yet, the oldest first, rad/s²
 * acceleration  (n) of the last command, rad/s²; NULL: zero
 * limits        (n) largest acceleration that counts, rad/s²
 * q             (n) measured positions, rad
 * v             (n) measured rates, rad/s; NULL if not measured
 * prediction    (3, 3 + m) response of the present state to x⁺ and the commands since; not used without latency */
typedef struct {
    int motor_count, latency;
    const double *gains, *x, *commands, *acceleration, *limits, *q, *v, *prediction;
} gf_joint_filter_inputs;

/* Outputs of gf_filter_joints(), which must not overlap the inputs. Without latency, only `x` is written.
 *
 * x         (3, n) state after the measurement
 * commands  (m, n) accelerations of the commands, with the last one
 * present   (3, n) state predicted over the latency */
typedef struct {
    double *x, *commands, *present;
} gf_joint_filter_outputs;

/* Compute the state after a measurement. */
void gf_filter_joints(const gf_joint_filter_inputs *inputs, const gf_joint_filter_outputs *outputs);

#ifdef __cplusplus
}
#endif

#endif
