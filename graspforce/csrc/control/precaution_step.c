/* Implementation of precaution_step.h. */
#include "graspforce/precaution_step.h"

#include <math.h>
#include <string.h>

#include "linear_algebra.inc"
#include "pose_error.inc"

enum { TWIST = 6 };

/* Compute the small motion from the estimated to the desired pose, in the axes of the estimated one, m and rad. */
static void gf_motion_to_desired(const gf_contact_pose *pose, const gf_desired_pose *desired, double motion[TWIST])
{
    double error[TWIST];
    gf_pose_error(desired->p_HO, desired->R_HO, pose->p_HO, pose->R_HO, error);
    for (int part = 0; part < 2; part++)
        for (int k = 0; k < 3; k++) {
            double sum = 0.0;
            for (int i = 0; i < 3; i++) sum += pose->R_HO[3 * i + k] * error[3 * part + i];
            motion[3 * part + k] = sum;
        }
}

/* Compute the Cholesky factors of the covariances of the displacements. */
static void gf_displacement_factors(const gf_precaution_settings *settings, const gf_contact_pose *pose, double *factor)
{
    const int n = settings->motor_count;
    const double variance = settings->encoder_variance[0], least = settings->least_variance[0];
    for (int i = 0; i < settings->contact_count; i++) {
        const double *first = pose->contacts.A + n * (3 * i), *second = first + n;
        double *L = factor + 3 * i;
        L[0] = sqrt(variance * gf_inner(n, first, first) + least);
        L[1] = variance * gf_inner(n, first, second) / L[0];
        L[2] = sqrt(variance * gf_inner(n, second, second) + least - L[1] * L[1]);
    }
}

/* Return by how much a threshold grows with the level of a statistic with so many degrees of freedom. */
static double gf_growth(const gf_precaution_settings *settings, int freedom, double level)
{
    return freedom * settings->tail[0] * fmax(1.0 - settings->noise_level[0] / level, 0.0);
}

/* Update the mean statistic of each finger. Return whether the motion of a finger is a reason for a precaution. */
static int gf_test_motion(const gf_precaution_settings *settings, const gf_precaution_state *next)
{
    const int rows = 2 * settings->contact_count;
    const double *base = next->means + rows * GF_PRECAUTION_WINDOWS, *variance = next->variance;
    const double gain = fmax(settings->level_gain[0], 1.0 / next->updates[0]);
    int is_moved = 0;
    for (int i = 0; i < settings->contact_count; i++) {
        const double *L = next->factor + 3 * i;
        double largest = 0.0, sum = 0.0;
        for (int k = 0; k < GF_PRECAUTION_WINDOWS; k++) {
            const double *mean = next->means + rows * k + 2 * i;
            const double x = (mean[0] - base[2 * i]) / L[0], y = (mean[1] - base[2 * i + 1] - L[1] * x) / L[2];
            const double statistic = (x * x + y * y) / (variance[k] + variance[GF_PRECAUTION_WINDOWS]);
            largest = fmax(largest, statistic), sum += statistic;
        }
        const double level = fmax(next->level[i], 1.0);
        is_moved |= largest / level > settings->motion_threshold[0] + gf_growth(settings, 2, level);
        next->level[i] += gain * (0.5 * sum / GF_PRECAUTION_WINDOWS - next->level[i]);
    }
    return is_moved;
}

int gf_precaution_step(const gf_precaution_settings *settings, const gf_contact_pose *pose, const gf_desired_pose *desired,
                       const gf_slip_state *slip, const gf_precaution_state *last, const gf_precaution_state *next)
{
    const int N = settings->contact_count, rows = 2 * N;
    const double updates = next->updates[0] = last->updates[0] + 1.0;
    double motion[TWIST], gains[GF_PRECAUTION_MEANS];
    gf_motion_to_desired(pose, desired, motion);
    for (int k = 0; k < GF_PRECAUTION_MEANS; k++) {
        const double g = gains[k] = fmax(settings->gains[k], 1.0 / updates);
        next->variance[k] = (1.0 - g) * (1.0 - g) * last->variance[k] + g * g;
    }
    for (int j = 0; j < rows; j++) {
        const int row = 3 * (j / 2) + j % 2;
        const double y = slip->residual[row] - gf_inner(TWIST, pose->contacts.B + TWIST * row, motion);
        for (int k = 0; k < GF_PRECAUTION_MEANS; k++) {
            const double mean = last->means[rows * k + j];
            next->means[rows * k + j] = mean + gains[k] * (y - mean);
        }
    }
    if (updates == 1.0 || fmod(updates, settings->refresh[0]) == 0.0)
        gf_displacement_factors(settings, pose, next->factor);
    else
        memcpy(next->factor, last->factor, (size_t)(3 * N) * sizeof(double));
    for (int i = 0; i < N; i++) next->level[i] = updates == 1.0 ? 1.0 : last->level[i];
    if (updates == 1.0) return 0;
    const int is_moved = gf_test_motion(settings, next);
    const double pushed = settings->force_threshold[0] + gf_growth(settings, 3 * N, fmax(slip->level[0], 1.0));
    return updates > settings->start[0] && (is_moved || slip->force_statistic[0] > pushed);
}
