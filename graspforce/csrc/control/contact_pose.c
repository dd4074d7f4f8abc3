/* Implementation of contact_pose.h. */
#include "graspforce/contact_pose.h"

#include <math.h>
#include <string.h>

#include "pose_error.inc"
#include "tip_motion.inc"
#include "vector3.inc"

static const double ARM = 0.03;   /* m: converts angles to displacements, as in estimation/contact_pose.py */
static const double CLOSE = 1e-4; /* m: after a smaller correction, the pose is accurate enough */
enum { MAX_ITERATIONS = 10, ROWS = 4, SPIN = 3, TWIST = 6 };

/* Compute R = exp(x) of a rotation vector, rad, by the unit quaternion. */
static void gf_rotation_exp(const double x[3], gf_matrix3 R)
{
    const double half = 0.5 * sqrt(gf_dot(x, x)), s = half > 0.0 ? 0.5 * sin(half) / half : 0.5;
    const double w = cos(half), i = s * x[0], j = s * x[1], k = s * x[2];
    R[0] = 1.0 - 2.0 * (j * j + k * k), R[1] = 2.0 * (i * j - w * k), R[2] = 2.0 * (i * k + w * j);
    R[3] = 2.0 * (i * j + w * k), R[4] = 1.0 - 2.0 * (i * i + k * k), R[5] = 2.0 * (j * k - w * i);
    R[6] = 2.0 * (i * k - w * j), R[7] = 2.0 * (j * k + w * i), R[8] = 1.0 - 2.0 * (i * i + j * j);
}

/* Compute C = A B, or A Bᵀ. C must not overlap A or B. */
static void gf_multiply_matrices(const gf_matrix3 A, const gf_matrix3 B, int transposed, gf_matrix3 C)
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            C[3 * i + j] = 0.0;
            for (int k = 0; k < 3; k++) C[3 * i + j] += A[3 * i + k] * (transposed ? B[3 * j + k] : B[3 * k + j]);
        }
}

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

/* Replace x by M⁺ x, with eigenvalues of M up to `least` treated as zero. M is overwritten. */
static void gf_apply_pseudoinverse(double M[TWIST][TWIST], double least, double x[TWIST])
{
    enum { SWEEPS = 12 }; /* convergence is quadratic; six sweeps are usually enough */
    double V[TWIST][TWIST] = {{0.0}}, y[TWIST];
    for (int i = 0; i < TWIST; i++) V[i][i] = 1.0;
    for (int sweep = 0; sweep < SWEEPS; sweep++)
        for (int p = 0; p < TWIST; p++)
            for (int q = p + 1; q < TWIST; q++) gf_jacobi_rotation(M, V, p, q);
    for (int i = 0; i < TWIST; i++) {
        y[i] = 0.0;
        for (int k = 0; k < TWIST; k++) y[i] += V[k][i] * x[k];
        y[i] = M[i][i] > least ? y[i] / M[i][i] : 0.0;
    }
    for (int k = 0; k < TWIST; k++) {
        x[k] = 0.0;
        for (int i = 0; i < TWIST; i++) x[k] += V[k][i] * y[i];
    }
}

/* Replace x by M⁻¹ x by Cholesky's decomposition, if all eigenvalues of M certainly exceed `least`. Return whether they do. */
static int gf_solve_definite(double M[TWIST][TWIST], double least, double x[TWIST])
{
    double L[TWIST][TWIST], inverse_norm = 0.0, y[TWIST];
    for (int j = 0; j < TWIST; j++)
        for (int k = 0; k <= j; k++) {
            double sum = M[j][k];
            for (int i = 0; i < k; i++) sum -= L[j][i] * L[k][i];
            if (j == k && !(sum > 0.0)) return 0; /* NaN too */
            L[j][k] = j == k ? sqrt(sum) : sum / L[k][k];
        }
    for (int j = 0; j < TWIST; j++) { /* replace L by L⁻¹ */
        const double inverse = 1.0 / L[j][j];
        for (int k = 0; k < j; k++) {
            double sum = 0.0;
            for (int i = k; i < j; i++) sum += L[j][i] * L[i][k];
            L[j][k] = -inverse * sum;
        }
        L[j][j] = inverse;
    }
    for (int j = 0; j < TWIST; j++) {
        y[j] = 0.0;
        for (int k = 0; k <= j; k++) y[j] += L[j][k] * x[k], inverse_norm += L[j][k] * L[j][k];
    }
    if (!(inverse_norm * least < 1.0)) return 0; /* ‖L⁻¹‖² = tr M⁻¹ ≥ 1/λ_min */
    for (int k = 0; k < TWIST; k++) {
        x[k] = 0.0;
        for (int j = k; j < TWIST; j++) x[k] += L[j][k] * y[j];
    }
    return 1;
}

/* Compute the displacement x = (Bᵀ W B)⁺ Bᵀ W y. Return 1, or 0 if a number is not finite. */
static int gf_fit(const gf_tracked_grasp *grasp, const gf_contacts *contacts, const double *weights, const double *y,
                  double x[TWIST])
{
    double M[TWIST][TWIST] = {{0.0}}, B[TWIST], sum = 0.0;
    for (int i = 0; i < TWIST; i++) x[i] = 0.0;
    for (int i = 0; i < grasp->contact_count; i++) {
        const gf_contacts contact = gf_contact_at(contacts, i, grasp->motor_count);
        for (int row = 0; row < ROWS; row++) {
            const double w = weights[ROWS * i + row];
            if (w == 0.0) continue;
            gf_row(&contact, row, B);
            for (int j = 0; j < TWIST; j++) {
                x[j] += w * B[j] * y[ROWS * i + row];
                for (int k = 0; k < TWIST; k++) M[j][k] += w * B[j] * B[k];
            }
        }
    }
    for (int j = 0; j < TWIST; j++) {
        sum += x[j];
        for (int k = 0; k < TWIST; k++) sum += M[j][k];
    }
    if (!isfinite(sum)) return 0;
    const double least = grasp->least_eigenvalue[0];
    if (!gf_solve_definite(M, least, x)) gf_apply_pseudoinverse(M, least, x);
    return 1;
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
        gf_compute_contact(object, &tip, &now);
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
