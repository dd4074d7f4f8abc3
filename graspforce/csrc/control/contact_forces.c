/* Implementation of contact_forces.h. */
#include "graspforce/contact_forces.h"

#include <math.h>
#include <string.h>

#include "linear_algebra.inc"
#include "vector3.inc"

/* Matrices of a computation of gains. */
typedef struct {
    double *noise;       /* (n, n) covariance of the torques' noise, (N·m)² */
    double *bias;        /* (n, n) covariance of their constant errors, (N·m)² */
    double *factor;      /* (n, n) Cholesky factor of the sum */
    double *weighted;    /* (3 N, n) A (noise + bias)⁻¹ */
    double *information; /* (3 N, 3 N) about the forces, 1/N² */
    double *covariance;  /* (3 N, 3 N) its inverse, N² */
    double *tips;        /* (3 N) forces of the fingertip sensors, N */
    double *tip_bias;    /* (3 N) variances of their constant errors, N² */
    double *rows;        /* (N, n) or (3 N) intermediate results */
    double *half;        /* (3 N, n) and (3 N, 3 N) intermediate results */
} gf_gain_work;

/* Return the largest number of rows and columns of a matrix. */
static size_t gf_largest_side(int contact_count, int motor_count)
{
    return (size_t)(3 * contact_count > motor_count ? 3 * contact_count : motor_count);
}

size_t gf_force_gains_work_size(int contact_count, int motor_count)
{
    const size_t side = gf_largest_side(contact_count, motor_count);
    return 8 * side * side + 2 * side;
}

/* Divide the workspace. */
static gf_gain_work gf_divide_work(int contact_count, int motor_count, double *work)
{
    const size_t side = gf_largest_side(contact_count, motor_count), area = side * side;
    return (gf_gain_work){.noise = work,
                          .bias = work + area,
                          .factor = work + 2 * area,
                          .weighted = work + 3 * area,
                          .information = work + 4 * area,
                          .covariance = work + 5 * area,
                          .rows = work + 6 * area,
                          .half = work + 7 * area,
                          .tips = work + 8 * area,
                          .tip_bias = work + 8 * area + side};
}

/* Compute the forces of the fingertip sensors in the contact frames, (3 N), N. */
static void gf_rotate_tip_forces(int contact_count, const gf_contact_pose *pose, const double *tip_wrench, double *f)
{
    for (int i = 0; i < contact_count; i++) {
        gf_vector3 in_O;
        gf_multiply_transposed(pose->R_HO, tip_wrench + 6 * i, in_O);
        gf_multiply_transposed(pose->contacts.R_OC + 9 * i, in_O, f + 3 * i);
    }
}

/* Compute A (noise + bias)⁻¹, and the factor of the information about the forces from torques alone. Return 1, or 0 on failure. */
static int gf_weigh_torques(const gf_force_model *model, const double *A, const gf_gain_work *work)
{
    const int n = model->motor_count, rows = 3 * model->contact_count;
    for (int i = 0; i < n * n; i++) work->factor[i] = work->noise[i] + work->bias[i];
    if (!gf_decompose(n, work->factor)) return 0;
    memcpy(work->weighted, A, (size_t)(rows * n) * sizeof(double));
    gf_solve_rows(rows, n, work->factor, work->weighted);
    gf_product_transposed(rows, n, rows, work->weighted, A, work->information);
    for (int i = 0; i < rows; i++) work->information[rows * i + i] += model->prior[i];
    return 1;
}

/* Add the covariance of the torques from unknown moments about the normals, up to γ f_n, for roughly estimated forces. Return 1,
 * or 0 on failure. */
static int gf_add_torsion(const gf_force_model *model, const gf_contact_pose *pose, const gf_force_inputs *inputs,
                          const gf_gain_work *work)
{
    const int N = model->contact_count, n = model->motor_count, rows = 3 * N;
    const double *A = pose->contacts.A;
    double *f = work->tips + 0, *rough = work->half, *y = work->half + rows, largest = 0.0;
    for (int i = 0; i < N; i++) largest = fmax(largest, model->gamma[i]);
    if (largest == 0.0) return 1;
    for (int j = 0; j < n; j++) y[j] = inputs->tau[j];
    if (inputs->tip_wrench != NULL) gf_product(1, rows, n, f, A, y); /* Aᵀ f */
    for (int i = 0; i < rows; i++) rough[i] = gf_inner(n, work->weighted + n * i, y);
    if (!gf_decompose(rows, work->information)) return 0;
    gf_solve_definite(rows, work->information, rough);
    for (int i = 0; i < N; i++) {
        const double moment = model->gamma[i] * fmax(rough[3 * i + 2], 0.0); /* N·m */
        for (int j = 0; j < n; j++) work->rows[n * i + j] = moment * pose->contacts.spin_A[n * i + j];
    }
    for (int i = 0; i < N; i++)
        for (int j = 0; j < n; j++) gf_add_scaled(n, work->rows[n * i + j], work->rows + n * i, work->bias + n * j);
    return gf_weigh_torques(model, A, work);
}

/* Compute C = X V Xᵀ + Y diag(v) Yᵀ for X (r, n) and Y (r, r). `half` (r, n) is overwritten. */
static void gf_propagate(int r, int n, const double *X, const double *V, const double *Y, const double *v, double *half,
                         double *C)
{
    gf_product(r, n, n, X, V, half);
    gf_product_transposed(r, n, r, half, X, C);
    for (int i = 0; i < r; i++)
        for (int j = 0; j <= i; j++) {
            double sum = 0.5 * (C[r * i + j] + C[r * j + i]);
            for (int k = 0; k < r; k++) sum += Y[r * i + k] * v[k] * Y[r * j + k];
            C[r * i + j] = C[r * j + i] = sum;
        }
}

/* Compute the forces from torques alone, and the noise of their difference from the fingertip sensors. Return 1, or 0 on failure. */
static int gf_torque_only_gains(const gf_force_model *model, const gf_gain_work *work, const gf_force_gains *gains)
{
    const int N = model->contact_count, n = model->motor_count, rows = 3 * N;
    const double torque = model->torque_noise[0] * model->torque_noise[0], tip = model->tip_noise[0] * model->tip_noise[0];
    memcpy(work->covariance, work->information, (size_t)(rows * rows) * sizeof(double));
    if (!gf_decompose(rows, work->covariance)) return 0;
    for (int j = 0; j < n; j++) {
        for (int i = 0; i < rows; i++) work->rows[i] = work->weighted[n * i + j];
        gf_solve_definite(rows, work->covariance, work->rows);
        for (int i = 0; i < rows; i++) gains->torque_only[n * i + j] = work->rows[i];
    }
    for (int i = 0; i < N; i++)
        for (int a = 0; a < 3; a++)
            for (int b = 0; b < 3; b++) {
                const double *left = gains->torque_only + n * (3 * i + a), *right = gains->torque_only + n * (3 * i + b);
                gains->mismatch_noise[9 * i + 3 * a + b] = torque * gf_inner(n, left, right) + (a == b) * tip;
            }
    return 1;
}

int gf_compute_force_gains(const gf_force_model *model, const gf_contact_pose *pose, const double *M,
                           const gf_force_inputs *inputs, double *memory, const gf_force_gains *gains)
{
    const int N = model->contact_count, n = model->motor_count, rows = 3 * N;
    const double torque = model->torque_noise[0] * model->torque_noise[0], tip = model->tip_noise[0] * model->tip_noise[0];
    const double disturbance = model->disturbance_error[0] * model->disturbance_error[0];
    const gf_gain_work work = gf_divide_work(N, n, memory);
    gf_product_transposed(n, n, n, M, M, work.noise);
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            const double scale = model->torque_scale[0] * inputs->tau[i], bias = model->torque_bias[0];
            work.noise[n * i + j] = disturbance * work.noise[n * i + j] + (i == j) * torque;
            work.bias[n * i + j] = (i == j) * (bias * bias + scale * scale);
        }
    if (inputs->tip_wrench != NULL) gf_rotate_tip_forces(N, pose, inputs->tip_wrench, work.tips);
    if (!gf_weigh_torques(model, pose->contacts.A, &work)) return 0;
    if (!gf_add_torsion(model, pose, inputs, &work)) return 0;
    if (!gf_torque_only_gains(model, &work, gains)) return 0;
    for (int i = 0; i < rows && inputs->tip_wrench != NULL; i++) {
        const double scale = model->tip_scale[0] * work.tips[i];
        work.tip_bias[i] = model->tip_bias[0] * model->tip_bias[0] + scale * scale;
        work.information[rows * i + i] += 1.0 / (tip + work.tip_bias[i]);
    }
    if (!gf_decompose(rows, work.information)) return 0;
    gf_invert_definite(rows, work.information, work.covariance);
    gf_product(rows, rows, n, work.covariance, work.weighted, gains->from_torque);
    gf_product(rows, n, n, gains->from_torque, M, gains->inertia);
    memset(gains->from_tips, 0, (size_t)(rows * rows) * sizeof(double));
    for (int i = 0; i < rows && inputs->tip_wrench != NULL; i++)
        for (int j = 0; j < rows; j++)
            gains->from_tips[rows * i + j] = work.covariance[rows * i + j] / (tip + work.tip_bias[j]);

    double *variances = work.tips; /* the forces are not needed any more */
    for (int i = 0; i < rows; i++) variances[i] = tip;
    gf_propagate(rows, n, gains->from_torque, work.noise, gains->from_tips, variances, work.half, gains->noise);
    if (inputs->tip_wrench == NULL) memset(work.tip_bias, 0, (size_t)rows * sizeof(double));
    gf_propagate(rows, n, gains->from_torque, work.bias, gains->from_tips, work.tip_bias, work.half, gains->bias);
    for (int i = 0; i < rows; i++)
        for (int j = 0; j < rows; j++)
            for (int k = 0; k < rows; k++)
                gains->bias[rows * i + j] += work.covariance[rows * i + k] * model->prior[k] * work.covariance[rows * j + k];
    return 1;
}

void gf_compute_contact_forces(int contact_count, int motor_count, const gf_force_gains *gains, const gf_contact_pose *pose,
                               const gf_force_inputs *inputs, const gf_contact_force *forces)
{
    const int rows = 3 * contact_count, n = motor_count;
    const int has_tips = inputs->tip_wrench != NULL;
    memset(forces->measured, 0, (size_t)rows * sizeof(double));
    if (has_tips) gf_rotate_tip_forces(contact_count, pose, inputs->tip_wrench, forces->measured);
    for (int i = 0; i < rows; i++) forces->f[i] = forces->mismatch[i] = forces->inertial[i] = 0.0;
    for (int j = 0; j < n; j++) {
        double residual = inputs->tau[j] - inputs->tau_u[j]; /* N·m; less that of the measured forces at the present contacts */
        for (int i = 0; has_tips && i < rows; i++) residual -= pose->contacts.A[n * i + j] * forces->measured[i];
        for (int i = 0; i < rows; i++) {
            forces->f[i] += gains->from_torque[n * i + j] * residual;
            forces->inertial[i] += gains->inertia[n * i + j] * inputs->deviation[j];
            if (has_tips) forces->mismatch[i] -= gains->torque_only[n * i + j] * residual;
        }
    }
    for (int i = 0; i < rows; i++) forces->f[i] += forces->measured[i] - forces->inertial[i];
}
