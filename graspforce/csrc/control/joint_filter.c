/* Implementation of joint_filter.h. */
#include "graspforce/joint_filter.h"

#include <stddef.h>

void gf_filter_joints(const gf_joint_filter_inputs *inputs, double *next)
{
    const int n = inputs->motor_count, width = inputs->v == NULL ? 5 : 6;
    for (int j = 0; j < n; j++) {
        double a = inputs->acceleration == NULL ? 0.0 : inputs->acceleration[j]; /* NaN stays */
        if (a < -inputs->limits[j]) a = -inputs->limits[j];
        if (a > inputs->limits[j]) a = inputs->limits[j];
        for (int i = 0; i < 3; i++) {
            const double *g = inputs->gains + width * i;
            double sum = g[0] * inputs->x[j] + g[1] * inputs->x[n + j] + g[2] * inputs->x[2 * n + j];
            sum += g[3] * a + g[4] * inputs->q[j];
            next[n * i + j] = inputs->v == NULL ? sum : sum + g[5] * inputs->v[j];
        }
    }
}
