/* Implementation of joint_filter.h. */
#include "graspforce/joint_filter.h"

#include <stddef.h>

/* Return the last command of joint j within its limit. NaN stays. */
static double gf_limited_command(const gf_joint_filter_inputs *inputs, int j)
{
    const double a = inputs->acceleration == NULL ? 0.0 : inputs->acceleration[j], limit = inputs->limits[j];
    return a < -limit ? -limit : a > limit ? limit : a;
}

/* Predict the present state from the state after the measurement and the commands since. */
static void gf_predict_present(const gf_joint_filter_inputs *inputs, const gf_joint_filter_outputs *outputs)
{
    const int n = inputs->motor_count, m = inputs->latency;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < n; j++) {
            const double *row = inputs->prediction + (3 + m) * i;
            double sum = row[0] * outputs->x[j] + row[1] * outputs->x[n + j] + row[2] * outputs->x[2 * n + j];
            for (int k = 0; k < m; k++) sum += row[3 + k] * outputs->commands[n * k + j];
            outputs->present[n * i + j] = sum;
        }
}

void gf_filter_joints(const gf_joint_filter_inputs *inputs, const gf_joint_filter_outputs *outputs)
{
    const int n = inputs->motor_count, m = inputs->latency, width = inputs->v == NULL ? 5 : 6;
    for (int j = 0; j < n; j++) {
        const double newest = gf_limited_command(inputs, j), a = m == 0 ? newest : inputs->commands[j];
        for (int i = 0; i < 3; i++) {
            const double *g = inputs->gains + width * i;
            double sum = g[0] * inputs->x[j] + g[1] * inputs->x[n + j] + g[2] * inputs->x[2 * n + j];
            sum += g[3] * a + g[4] * inputs->q[j];
            outputs->x[n * i + j] = inputs->v == NULL ? sum : sum + g[5] * inputs->v[j];
        }
        for (int k = 0; k < m; k++) outputs->commands[n * k + j] = k + 1 < m ? inputs->commands[n * (k + 1) + j] : newest;
    }
    if (m > 0) gf_predict_present(inputs, outputs);
}
