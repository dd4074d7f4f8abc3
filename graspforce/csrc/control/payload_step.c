/* Implementation of payload_step.h. */
#include "graspforce/payload_step.h"

#include <math.h>
#include <string.h>

#include "linear_algebra.inc"
#include "vector3.inc"

enum { WRENCH = 6, UNKNOWNS = 4 };
static const double AFTER_CHANGE = 0.01; /* weight of the past after a change of the payload */
static const double LEAST_MASS = 1e-3;   /* of the given mass */

/* A block of forces and motion, turned to a known direction of p̈ − g. */
typedef struct {
    double rows[5][3];                  /* force, moment, p̈ − g, ω̇ and ω in O */
    double regressor[WRENCH][UNKNOWNS]; /* Φ */
} gf_payload_rows;

void gf_compute_payload_inputs(int contact_count, const gf_contact_pose *pose, const gf_force_gains *gains,
                               const gf_payload_motion *motion, const gf_payload_inputs *inputs)
{
    const int rows = 3 * contact_count;
    const double *B = pose->contacts.B;
    const double *sources[] = {gains->noise, gains->bias};
    double *covariances[] = {inputs->noise, inputs->bias}, scales[] = {1.0 / motion->periods, 1.0}, rates[3][3];
    for (int a = 0; a < WRENCH; a++) {
        inputs->w[a] = 0.0;
        for (int i = 0; i < rows; i++) inputs->w[a] += motion->force_sum[i] / motion->periods * B[WRENCH * i + a];
    }
    for (int each = 0; each < 2; each++) {
        memset(covariances[each], 0, WRENCH * WRENCH * sizeof(double));
        for (int i = 0; i < rows; i++) {
            double half[WRENCH] = {0.0}; /* row i of C B */
            for (int j = 0; j < rows; j++) gf_add_scaled(WRENCH, sources[each][rows * i + j], B + WRENCH * j, half);
            for (int a = 0; a < WRENCH; a++)
                gf_add_scaled(WRENCH, scales[each] * B[WRENCH * i + a], half, covariances[each] + WRENCH * a);
        }
    }
    for (int k = 0; k < 3; k++) {
        rates[0][k] = motion->acceleration[k] - motion->gravity_H[k];
        rates[1][k] = motion->acceleration[3 + k];
        rates[2][k] = motion->twist[3 + k];
    }
    for (int i = 0; i < 3; i++) gf_multiply_transposed(pose->R_HO, rates[i], inputs->rates + 3 * i);
}

/* Turn all vectors so that p̈ − g has the known direction; a large angle between the two gives a new direction. */
static void gf_remove_small_turns(const gf_payload_settings *settings, const double last[3], gf_payload_rows *block,
                                  double direction[3])
{
    const double *alpha = block->rows[2], length = fmax(sqrt(gf_dot(alpha, alpha)), 1e-9);
    const gf_vector3 u = {alpha[0] / length, alpha[1] / length, alpha[2] / length};
    gf_vector3 axis; /* times the sine of the angle */
    gf_cross(u, last, axis);
    const double cosine = gf_dot(u, last), limit = settings->attitude_error[0];
    if (!(cosine > 0.0 && gf_dot(axis, axis) <= limit * limit)) {
        memcpy(direction, u, sizeof u);
        return;
    }
    memcpy(direction, last, sizeof u);
    for (int i = 0; i < 5; i++) {
        gf_vector3 once, twice;
        gf_cross(axis, block->rows[i], once);
        gf_cross(axis, once, twice);
        for (int k = 0; k < 3; k++) block->rows[i][k] += once[k] + twice[k] / (1.0 + cosine);
    }
}

/* Compute Φ. */
static void gf_payload_regressor(const double inertia[9], gf_payload_rows *block)
{
    const double *alpha = block->rows[2], *omega_rate = block->rows[3], *omega = block->rows[4];
    gf_vector3 inner, moment, gyroscopic;
    gf_multiply(inertia, omega, inner);
    gf_multiply(inertia, omega_rate, moment);
    gf_cross(omega, inner, gyroscopic);
    for (int k = 0; k < 3; k++) {
        block->regressor[k][0] = alpha[k];
        block->regressor[3 + k][0] = moment[k] + gyroscopic[k];
    }
    for (int j = 0; j < 3; j++) {
        gf_vector3 unit = {0.0}, turned, swept, twice, arm;
        unit[j] = 1.0;
        gf_cross(omega_rate, unit, turned);
        gf_cross(omega, unit, swept);
        gf_cross(omega, swept, twice);
        gf_cross(unit, alpha, arm); /* h × α */
        for (int k = 0; k < 3; k++) {
            block->regressor[k][1 + j] = turned[k] + twice[k];
            block->regressor[3 + k][1 + j] = arm[k];
        }
    }
}

/* Compute C = base + Φ P Φᵀ. */
static void gf_predict_wrench(double regressor[WRENCH][UNKNOWNS], const double *P, const double *base, double *C)
{
    for (int a = 0; a < WRENCH; a++) {
        double half[UNKNOWNS];
        gf_product(1, UNKNOWNS, UNKNOWNS, regressor[a], P, half);
        for (int b = 0; b < WRENCH; b++) C[WRENCH * a + b] = base[WRENCH * a + b] + gf_inner(UNKNOWNS, half, regressor[b]);
    }
}

/* Compute Φ θ − w. */
static void gf_wrench_residual(const gf_payload_rows *block, const double theta[UNKNOWNS], double residual[WRENCH])
{
    for (int a = 0; a < WRENCH; a++) residual[a] = gf_inner(UNKNOWNS, block->regressor[a], theta) - block->rows[a / 3][a % 3];
}

/* Compute the time since the begin of a sudden change of the wrench. Return 1, or 0 on failure. */
static int gf_find_disturbance(const gf_payload_settings *settings, const gf_payload_inputs *inputs, gf_payload_rows *block,
                               const gf_payload_state *last, double *disturbed)
{
    double theta[UNKNOWNS], residual[WRENCH], base[WRENCH * WRENCH], expected[WRENCH * WRENCH], statistic = 0.0;
    for (int j = 0; j < UNKNOWNS; j++) theta[j] = j == 0 ? last->mass[0] : last->mass[0] * last->p_OM[j - 1];
    gf_wrench_residual(block, theta, residual);
    memcpy(base, inputs->noise, sizeof base);
    for (int a = 0; a < WRENCH; a++) base[(WRENCH + 1) * a] += settings->unmodelled[a];
    gf_predict_wrench(block->regressor, last->covariance, base, expected);
    for (int a = 0; a < WRENCH; a++) residual[a] -= last->slow[a];
    if (!gf_decompose(WRENCH, expected)) return 0;
    gf_solve_forward(WRENCH, expected, residual);
    statistic = gf_inner(WRENCH, residual, residual);
    disturbed[0] = statistic > settings->threshold[0] ? last->disturbed[0] + settings->period[0] : 0.0;
    return 1;
}

/* Keep little weight on the past. */
static void gf_forget_payload(const gf_payload_state *next)
{
    for (int i = 0; i < UNKNOWNS * UNKNOWNS; i++) {
        next->information[i] *= AFTER_CHANGE;
        next->noise[i] *= AFTER_CHANGE * AFTER_CHANGE;
    }
    for (int i = 0; i < UNKNOWNS * WRENCH; i++) next->gain[i] *= AFTER_CHANGE;
    for (int i = 0; i < UNKNOWNS; i++) next->score[i] *= AFTER_CHANGE;
    memset(next->slow, 0, WRENCH * sizeof(double));
    next->updates[0] = 0.0;
}

/* Add a block to the sums. Return 1, or 0 on failure. */
static int gf_add_block(const gf_payload_settings *settings, const gf_payload_inputs *inputs, const gf_payload_rows *block,
                        const gf_payload_state *next)
{
    const double kept = settings->kept[0];
    double factor[WRENCH * WRENCH], weighted[UNKNOWNS][WRENCH]; /* Φᵀ R⁻¹ */
    for (int i = 0; i < WRENCH * WRENCH; i++) factor[i] = inputs->noise[i] + inputs->bias[i];
    for (int a = 0; a < WRENCH; a++) factor[(WRENCH + 1) * a] += settings->unmodelled[a];
    if (!gf_decompose(WRENCH, factor)) return 0;
    for (int j = 0; j < UNKNOWNS; j++) {
        for (int a = 0; a < WRENCH; a++) weighted[j][a] = block->regressor[a][j];
        gf_solve_definite(WRENCH, factor, weighted[j]);
    }
    for (int i = 0; i < UNKNOWNS; i++) {
        double noisy[WRENCH], score = kept * next->score[i];
        gf_product(1, WRENCH, WRENCH, weighted[i], inputs->noise, noisy);
        for (int a = 0; a < WRENCH; a++) {
            score += weighted[i][a] * block->rows[a / 3][a % 3];
            next->gain[WRENCH * i + a] = kept * next->gain[WRENCH * i + a] + weighted[i][a];
        }
        next->score[i] = score;
        for (int j = 0; j < UNKNOWNS; j++) {
            double sum = kept * next->information[UNKNOWNS * i + j];
            for (int a = 0; a < WRENCH; a++) sum += weighted[i][a] * block->regressor[a][j];
            next->information[UNKNOWNS * i + j] = sum;
            next->noise[UNKNOWNS * i + j] = kept * kept * next->noise[UNKNOWNS * i + j] + gf_inner(WRENCH, noisy, weighted[j]);
        }
    }
    return 1;
}

/* Compute θ and its covariance from the sums. Return 1, or 0 on failure. */
static int gf_solve_payload(const gf_payload_settings *settings, const gf_payload_inputs *inputs, const gf_payload_state *next,
                            double theta[UNKNOWNS])
{
    double P[UNKNOWNS * UNKNOWNS], factor[UNKNOWNS * UNKNOWNS], inner[UNKNOWNS * UNKNOWNS], half[UNKNOWNS * UNKNOWNS];
    double bias[WRENCH * WRENCH], spread[UNKNOWNS * WRENCH];
    memcpy(factor, next->information, sizeof factor);
    for (int j = 0; j < UNKNOWNS; j++) {
        factor[(UNKNOWNS + 1) * j] += settings->prior[j];
        theta[j] = next->score[j] + settings->prior[j] * settings->theta[j];
    }
    if (!gf_decompose(UNKNOWNS, factor)) return 0;
    gf_solve_definite(UNKNOWNS, factor, theta);
    gf_invert_definite(UNKNOWNS, factor, P);
    memcpy(bias, inputs->bias, sizeof bias);
    for (int a = 0; a < WRENCH; a++) bias[(WRENCH + 1) * a] += settings->unmodelled[a];
    gf_product(UNKNOWNS, WRENCH, WRENCH, next->gain, bias, spread);
    gf_product_transposed(UNKNOWNS, WRENCH, UNKNOWNS, spread, next->gain, inner);
    for (int i = 0; i < UNKNOWNS * UNKNOWNS; i++) inner[i] += next->noise[i];
    for (int j = 0; j < UNKNOWNS; j++) inner[(UNKNOWNS + 1) * j] += settings->prior[j];
    gf_product(UNKNOWNS, UNKNOWNS, UNKNOWNS, P, inner, half);
    gf_product(UNKNOWNS, UNKNOWNS, UNKNOWNS, half, P, next->covariance);
    return 1;
}

/* Copy the state that an update starts from. */
static void gf_copy_payload(const gf_payload_state *last, const gf_payload_state *next)
{
#define GF_PRODUCT(a, b, ...) ((a) * (b))
#define GF_COPY(name, ...)    memcpy(next->name, last->name, GF_PRODUCT(__VA_ARGS__, 1, 1) * sizeof(double));
    GF_PAYLOAD_STATE_FIELDS(GF_COPY)
#undef GF_COPY
#undef GF_PRODUCT
}

int gf_payload_step(const gf_payload_settings *settings, const gf_payload_inputs *inputs, const gf_payload_state *last,
                    const gf_payload_state *next)
{
    gf_payload_rows block;
    double theta[UNKNOWNS], rest[WRENCH], base[WRENCH * WRENCH];
    gf_copy_payload(last, next);
    memcpy(block.rows[0], inputs->w, WRENCH * sizeof(double));
    memcpy(block.rows[2], inputs->rates, sizeof(gf_matrix3));
    gf_remove_small_turns(settings, last->direction, &block, next->direction);
    gf_payload_regressor(settings->inertia, &block);
    if (!gf_find_disturbance(settings, inputs, &block, last, next->disturbed)) return 0;
    if (next->disturbed[0] > settings->adaption_time[0]) { /* the change is payload */
        gf_forget_payload(next);
        next->disturbed[0] = 0.0;
    }
    const int is_calm = next->disturbed[0] == 0.0;
    if (is_calm && !gf_add_block(settings, inputs, &block, next)) return 0;
    if (!gf_solve_payload(settings, inputs, next, theta)) return 0;
    gf_wrench_residual(&block, theta, rest);
    const double g = settings->external_gain[0], start = 1.0 / (next->updates[0] + 1.0);
    for (int a = 0; a < WRENCH; a++) {
        next->residual[a] += fmax(g, start) * (rest[a] - next->residual[a]);
        if (is_calm) next->slow[a] += fmax(1.0 - settings->kept[0], start) * (rest[a] - next->slow[a]);
    }
    for (int i = 0; i < WRENCH * WRENCH; i++) base[i] = g / (2.0 - g) * inputs->noise[i] + inputs->bias[i];
    gf_predict_wrench(block.regressor, next->covariance, base, next->external_covariance);
    next->mass[0] = fmax(theta[0], LEAST_MASS * settings->theta[0]);
    for (int k = 0; k < 3; k++) next->p_OM[k] = theta[1 + k] / next->mass[0];
    next->updates[0] += 1.0;
    return 1;
}
