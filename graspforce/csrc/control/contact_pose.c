/* Implementation of contact_pose.h. */
#include "graspforce/contact_pose.h"

#include <math.h>
#include <string.h>

#include "pose_error.inc"
#include "rotation.inc"
#include "tip_motion.inc"
#include "vector3.inc"

static const double ARM = 0.03;   /* m: converts angles to displacements, as in estimation/pose/contact_pose.py */
static const double CLOSE = 1e-4; /* m: after a smaller correction, the pose is accurate enough */
enum { MAX_ITERATIONS = 10, ROWS = 4, SPIN = 3, TWIST = 6 };

/* Move a pose by the displacement xi in its own frame, with angles as displacements at ARM. */
static void gf_move_pose(gf_object_state *object, const double xi[TWIST])
{
    const gf_vector3 turn = {xi[3] / ARM, xi[4] / ARM, xi[5] / ARM};
    gf_vector3 step;
    gf_matrix3 rotation, turned;
    gf_multiply(object->R_HO, xi, step);
    for (int k = 0; k < 3; k++) object->p_HO[k] += step[k];
    gf_rotation_exp(turn, rotation);
    gf_multiply_matrices(object->R_HO, rotation, 0, turned);
    memcpy(object->R_HO, turned, sizeof turned);
}

/* Row of B of a residual for displacements of the object. */
static void gf_row(const gf_contacts *contact, int row, double B[TWIST])
{
    const double *from = row == SPIN ? contact->spin_B : contact->B + TWIST * row;
    const double scale = row == SPIN ? ARM : 1.0;
    for (int k = 0; k < 3; k++) B[k] = scale * from[k], B[3 + k] = scale * from[3 + k] / ARM;
}

/* Rotate rows and columns p and q of the symmetric M, and columns p and q of V, so that M[p][q] becomes zero (Jacobi, 1846). */
static void gf_jacobi_rotation(double M[TWIST][TWIST], double V[TWIST][TWIST], int p, int q)
{
    if (M[p][q] == 0.0) return;
    const double theta = 0.5 * (M[q][q] - M[p][p]) / M[p][q];
    const double t = copysign(1.0, theta) / (fabs(theta) + sqrt(theta * theta + 1.0));
    const double c = 1.0 / sqrt(t * t + 1.0), s = t * c;
    for (int k = 0; k < TWIST; k++) {
        const double a = M[k][p], b = M[k][q];
        M[k][p] = c * a - s * b, M[k][q] = s * a + c * b;
    }
    for (int k = 0; k < TWIST; k++) {
        const double a = M[p][k], b = M[q][k], v = V[k][p], w = V[k][q];
        M[p][k] = c * a - s * b, M[q][k] = s * a + c * b;
        V[k][p] = c * v - s * w, V[k][q] = s * v + c * w;
    }
}

/* Compute M⁺ of a symmetric positive semidefinite M, with eigenvalues up to `least` treated as zero. M is overwritten. */
static void gf_pseudoinverse(double M[TWIST][TWIST], double least, double inverse[TWIST][TWIST])
{
    enum { SWEEPS = 12 }; /* convergence is quadratic; six sweeps are usually enough */
    double V[TWIST][TWIST] = {{0.0}};
    for (int i = 0; i < TWIST; i++) V[i][i] = 1.0;
    for (int sweep = 0; sweep < SWEEPS; sweep++)
        for (int p = 0; p < TWIST; p++)
            for (int q = p + 1; q < TWIST; q++) gf_jacobi_rotation(M, V, p, q);
    memset(inverse, 0, sizeof V);
    for (int i = 0; i < TWIST; i++)
        for (int j = 0; j < TWIST && M[i][i] > least; j++)
            for (int k = 0; k < TWIST; k++) inverse[j][k] += V[j][i] * V[k][i] / M[i][i];
}

/* Compute M⁻¹ by Cholesky's decomposition, if all eigenvalues of M certainly exceed `least`. Return whether they do. */
static int gf_definite_inverse(double M[TWIST][TWIST], double least, double inverse[TWIST][TWIST])
{
    double L[TWIST][TWIST] = {{0.0}}, trace = 0.0;
    for (int j = 0; j < TWIST; j++)
        for (int k = 0; k <= j; k++) {
            double sum = M[j][k];
            for (int i = 0; i < k; i++) sum -= L[j][i] * L[k][i];
            if (j == k && !(sum > 0.0)) return 0; /* NaN too */
            L[j][k] = j == k ? sqrt(sum) : sum / L[k][k];
        }
    for (int j = 0; j < TWIST; j++) { /* replace L by L⁻¹ */
        const double pivot = 1.0 / L[j][j];
        for (int k = 0; k < j; k++) {
            double sum = 0.0;
            for (int i = k; i < j; i++) sum += L[j][i] * L[i][k];
            L[j][k] = -pivot * sum;
        }
        L[j][j] = pivot;
    }
    for (int j = 0; j < TWIST; j++) {
        for (int k = 0; k <= j; k++) {
            double sum = 0.0;
            for (int i = j; i < TWIST; i++) sum += L[i][j] * L[i][k];
            inverse[j][k] = inverse[k][j] = sum;
        }
        trace += inverse[j][j];
    }
    return trace * least < 1.0; /* tr M⁻¹ ≥ 1/λ_min */
}

/* Compute M = Bᵀ W B and M⁺. Return 2 if all eigenvalues of M count, 1 if not, or 0 if a number is not finite. */
static int gf_information(const gf_tracked_grasp *grasp, const gf_contacts *contacts, const double *weights,
                          double M[TWIST][TWIST], double inverse[TWIST][TWIST])
{
    double B[TWIST], copy[TWIST][TWIST], sum = 0.0;
    memset(M, 0, sizeof copy);
    for (int i = 0; i < grasp->contact_count; i++) {
        const gf_contacts contact = gf_contact_at(contacts, i, grasp->motor_count);
        for (int row = 0; row < ROWS; row++) {
            const double w = weights[ROWS * i + row];
            if (w == 0.0) continue;
            gf_row(&contact, row, B);
            for (int j = 0; j < TWIST; j++)
                for (int k = 0; k < TWIST; k++) M[j][k] += w * B[j] * B[k];
        }
    }
    for (int j = 0; j < TWIST; j++)
        for (int k = 0; k < TWIST; k++) sum += copy[j][k] = M[j][k];
    if (!isfinite(sum)) return 0;
    if (gf_definite_inverse(M, grasp->least_eigenvalue[0], inverse)) return 2;
    gf_pseudoinverse(copy, grasp->least_eigenvalue[0], inverse);
    return 1;
}

/* Compute the displacement x = (Bᵀ W B)⁺ Bᵀ W y. Return 1, or 0 if a number is not finite. */
static int gf_fit(const gf_tracked_grasp *grasp, const gf_contacts *contacts, const double *weights, const double *y,
                  double x[TWIST])
{
    double M[TWIST][TWIST], inverse[TWIST][TWIST], B[TWIST], fitted[TWIST] = {0.0}, sum = 0.0;
    for (int i = 0; i < grasp->contact_count; i++) {
        const gf_contacts contact = gf_contact_at(contacts, i, grasp->motor_count);
        for (int row = 0; row < ROWS; row++) {
            const double w = weights[ROWS * i + row];
            if (w == 0.0) continue;
            gf_row(&contact, row, B);
            for (int j = 0; j < TWIST; j++) fitted[j] += w * B[j] * y[ROWS * i + row];
        }
    }
    if (!gf_information(grasp, contacts, weights, M, inverse)) return 0;
    for (int j = 0; j < TWIST; j++) {
        x[j] = 0.0;
        for (int k = 0; k < TWIST; k++) x[j] += inverse[j][k] * fitted[k];
        sum += x[j];
    }
    return isfinite(sum);
}

/* A fingertip of a step: its pose in H, p in m, and its rates (6, n + 2). */
static gf_fingertip gf_tip_at(const gf_tracked_grasp *grasp, const gf_contact_pose *last, const double *tips, int i)
{
    const int n = grasp->motor_count;
    const double *pose = tips + (12 + 6 * (n + 2)) * i;
    gf_fingertip tip = {.motor_count = n, .radius = grasp->radii[i], .rates = pose + 12};
    memcpy(tip.p_HF, pose, sizeof tip.p_HF);
    memcpy(tip.R_HF, pose + 3, sizeof tip.R_HF);
    memcpy(tip.p_OC_start, grasp->p_OC + 3 * i, sizeof tip.p_OC_start);
    memcpy(tip.R_OC_start, grasp->R_OC + 9 * i, sizeof tip.R_OC_start);
    memcpy(tip.R_OC_last, last->contacts.R_OC + 9 * i, sizeof tip.R_OC_last);
    return tip;
}

/* Compute poses and rates of all tips, (N, 12 + 6 (n + 2)). `joint_rates` is workspace. */
static void gf_compute_tips(const gf_tracked_grasp *grasp, const gf_tracking_inputs *inputs, double *joint_rates, double *tips)
{
    const int n = grasp->motor_count, joint_count = grasp->joint_count;
    const gf_joint_motion joints = {n, joint_count, grasp->T, joint_rates, inputs->joint_twists, inputs->joint_twist_rates};
    for (int j = 0; j < joint_count; j++) {
        joint_rates[j] = 0.0;
        for (int i = 0; i < n; i++) joint_rates[j] += grasp->T[j * n + i] * inputs->v[i];
    }
    for (int i = 0; i < grasp->contact_count; i++, tips += 12 + 6 * (n + 2)) {
        gf_tip_pose(inputs->link_poses + 12 * i, grasp->p_LF + 3 * i, grasp->R_LF + 9 * i, tips, tips + 3);
        gf_tip_rates(&joints, tips, grasp->moves_tip + i * joint_count, tips + 12);
    }
}

/* Return slip and spin of a contact since the last step, r (4) without the gap: the mean of two separations along t1 and t2, of
 * the material points that touched at the last step, and of those that touch now. */
static void gf_slip_since(const gf_contacts *last, const gf_contacts *now, double r[ROWS])
{
    const gf_tip_contact before = {last->p_OF, last->R_OF, last->p_OC}, after = {now->p_OF, now->R_OF, now->p_OC};
    gf_matrix3 turned;
    gf_vector3 turn, n;
    double since[2], until[2];
    gf_slip_displacement(&before, now->p_OF, now->R_OF, now->R_OC, since);
    gf_slip_displacement(&after, last->p_OF, last->R_OF, last->R_OC, until);
    for (int t = 0; t < 2; t++) r[t] = 0.5 * (since[t] - until[t]);
    gf_multiply_matrices(now->R_OF, last->R_OF, 1, turned);
    gf_rotation_log(turned, turn);
    for (int k = 0; k < 3; k++) n[k] = now->R_OC[3 * k + 2];
    r[SPIN] = gf_dot(n, turn); /* rad */
}

/* Compute the contacts at a pose, and the residuals r (N, 4): slip, gap and spin, m. Write slip and spin to `next`. */
static void gf_residuals(const gf_tracked_grasp *grasp, const gf_tracking_inputs *inputs, const gf_contact_pose *last,
                         const gf_object_state *object, const double *tips, const gf_contact_pose *next, double *r)
{
    for (int i = 0; i < grasp->contact_count; i++, r += ROWS) {
        const double *weights = inputs->weights + ROWS * i;
        const gf_contacts before = gf_contact_at(&last->contacts, i, grasp->motor_count);
        const gf_contacts now = gf_contact_at(&next->contacts, i, grasp->motor_count);
        const gf_fingertip tip = gf_tip_at(grasp, last, tips, i);
        gf_compute_contact_place(object, &tip, &now);
        gf_slip_since(&before, &now, r);
        for (int t = 0; t < 2; t++) {
            r[t] += weights[t] > 0.0 ? last->slip[2 * i + t] : 0.0;
            next->slip[2 * i + t] = weights[t] > 0.0 ? r[t] : 0.0;
        }
        r[SPIN] += weights[SPIN] > 0.0 ? last->spin[i] : 0.0;
        next->spin[i] = weights[SPIN] > 0.0 ? r[SPIN] : 0.0;
        r[SPIN] *= ARM;
        r[2] = inputs->gap[i] - now.gap[0];
    }
}

size_t gf_tracking_work_size(const gf_tracked_grasp *grasp)
{
    const size_t N = (size_t)grasp->contact_count, n = (size_t)grasp->motor_count;
    return (size_t)grasp->joint_count + N * (12 + 6 * (n + 2)) + ROWS * N;
}

int gf_track_contacts(const gf_tracked_grasp *grasp, const gf_tracking_inputs *inputs, const gf_contact_pose *last,
                      double *work, const gf_contact_pose *next)
{
    const int N = grasp->contact_count, n = grasp->motor_count;
    double *tips = work + grasp->joint_count, *r = tips + N * (12 + 6 * (n + 2)), xi[TWIST];
    gf_object_state object = {.surface = grasp->surface};
    int iterations = 0;
    gf_compute_tips(grasp, inputs, work, tips);
    memcpy(object.p_HO, last->p_HO, sizeof object.p_HO);
    memcpy(object.R_HO, last->R_HO, sizeof object.R_HO);
    gf_multiply_transposed(last->R_HO, last->twist, xi); /* predict with the last twist */
    gf_multiply_transposed(last->R_HO, last->twist + 3, xi + 3);
    for (int k = 0; k < TWIST; k++) xi[k] *= grasp->period[0] * (k < 3 ? 1.0 : ARM);
    gf_move_pose(&object, xi);
    for (double step = INFINITY; step > CLOSE && iterations < MAX_ITERATIONS; iterations++) {
        gf_residuals(grasp, inputs, last, &object, tips, next, r);
        if (!gf_fit(grasp, &next->contacts, inputs->weights, r, xi)) return 0;
        gf_move_pose(&object, xi);
        step = 0.0;
        for (int k = 0; k < TWIST; k++) step = fmax(step, fabs(xi[k]));
    }
    gf_residuals(grasp, inputs, last, &object, tips, next, r);
    for (int i = 0; i < N; i++) { /* velocities of the fingers at the contacts */
        const double *spin_A = next->contacts.spin_A + n * i;
        for (int k = 0; k < 3; k++) r[ROWS * i + k] = next->contacts.velocity[3 * i + k];
        r[ROWS * i + SPIN] = 0.0;
        for (int j = 0; j < n; j++) r[ROWS * i + SPIN] += ARM * spin_A[j] * inputs->v[j];
    }
    if (!gf_fit(grasp, &next->contacts, inputs->weights, r, xi)) return 0;
    for (int k = 3; k < TWIST; k++) xi[k] /= ARM;
    gf_multiply(object.R_HO, xi, next->twist);
    gf_multiply(object.R_HO, xi + 3, next->twist + 3);
    memcpy(next->p_HO, object.p_HO, sizeof object.p_HO);
    memcpy(next->R_HO, object.R_HO, sizeof object.R_HO);
    return iterations;
}

size_t gf_uncertainty_work_size(const gf_tracked_grasp *grasp)
{
    const size_t rows = ROWS * (size_t)grasp->contact_count, n = (size_t)grasp->motor_count;
    return TWIST * (rows + n) + rows;
}

/* Compute the gain K = (Bᵀ W B)⁺ Bᵀ W of twists, (6, 4 N). Return 1, or 0 if a number is not finite. */
static int gf_gain(const gf_tracked_grasp *grasp, const gf_contacts *contacts, const double *weights, double *K,
                   double *free_motions)
{
    double M[TWIST][TWIST], inverse[TWIST][TWIST], B[TWIST];
    const int rows = ROWS * grasp->contact_count, rank = gf_information(grasp, contacts, weights, M, inverse);
    if (rank == 0) return 0;
    for (int j = 0; j < TWIST; j++) {
        const double unit = j < 3 ? 1.0 : 1.0 / ARM; /* twist per displacement */
        for (int row = 0; row < rows; row++) {
            const gf_contacts contact = gf_contact_at(contacts, row / ROWS, grasp->motor_count);
            gf_row(&contact, row % ROWS, B);
            K[j * rows + row] = 0.0;
            for (int k = 0; k < TWIST && weights[row] != 0.0; k++)
                K[j * rows + row] += unit * weights[row] * inverse[j][k] * B[k];
        }
        for (int k = 0; k < TWIST; k++) { /* 1 − M⁺ M projects on the free motions */
            double *projection = free_motions + TWIST * j + k;
            *projection = rank == 1 && j == k ? unit : 0.0;
            for (int i = 0; i < TWIST && rank == 1; i++) *projection -= unit * inverse[j][i] * M[i][k];
        }
    }
    return 1;
}

int gf_pose_uncertainty(const gf_tracked_grasp *grasp, const gf_contacts *contacts, const gf_residual_noise *noise,
                        double *work, double covariance[36], double free_motions[36])
{
    const int rows = ROWS * grasp->contact_count, n = grasp->motor_count;
    double *K = work, *joints = K + TWIST * rows, *kept = joints + TWIST * n; /* K, K A (6, n), and a row of K C₀ */
    if (!gf_gain(grasp, contacts, noise->weights, K, free_motions)) return 0;
    for (int j = 0; j < TWIST; j++) {
        for (int m = 0; m < n; m++) {
            double sum = 0.0;
            for (int row = 0; row < rows; row++) {
                const int i = row / ROWS, c = row % ROWS;
                const double a = c == SPIN ? ARM * contacts->spin_A[i * n + m] : contacts->A[(3 * i + c) * n + m];
                if (noise->weights[row] != 0.0) sum += K[j * rows + row] * a;
            }
            joints[j * n + m] = sum;
        }
    }
    for (int j = 0; j < TWIST; j++) {
        for (int row = 0; row < rows; row++) {
            kept[row] = noise->contact_variance * K[j * rows + row];
            for (int i = 0; i < rows; i++) kept[row] += K[j * rows + i] * noise->reference[i * rows + row];
        }
        for (int k = 0; k < TWIST; k++) {
            double sum = 0.0;
            for (int m = 0; m < n; m++) sum += noise->joint_variance * joints[j * n + m] * joints[k * n + m];
            for (int row = 0; row < rows; row++) sum += kept[row] * K[k * rows + row];
            covariance[TWIST * j + k] = sum;
        }
    }
    return 1;
}
