/* Grasp matrix, wrench about the centroid, and fingers: grasp_matrix.h. */
#include "graspforce/grasp_matrix.h"

#include <stdint.h>
#include <string.h>

#include "../real.inc"

/* Return √(mean ‖v − from‖²) of `count` vectors, without overflow or underflow. */
static double root_mean_square(int count, const double *v, const double *from)
{
    double largest = 0.0, sum = 0.0;
    for (int i = 0; i < 3 * count; i++) largest = fmax(largest, fabs(v[i] - from[i % 3]));
    if (!(largest > 0.0)) return 0.0;
    for (int i = 0; i < 3 * count; i++) {
        double ratio = (v[i] - from[i % 3]) / largest;
        sum += ratio * ratio;
    }
    return largest * sqrt(sum / count);
}

int gf_grasp_matrix(const gf_structure *s, const double *p, const double *R, double *G, gf_moment_reference *reference)
{
    static const double origin[3] = {0.0, 0.0, 0.0};
    const int N = s->contacts;
    double *c = reference->centroid;
    c[0] = c[1] = c[2] = 0.0;
    for (int i = 0; i < 3 * N; i++) c[i % 3] += p[i];
    for (int a = 0; a < 3; a++) c[a] /= N;
    double distance = root_mean_square(N, p, origin), spread = root_mean_square(N, p, c);
    reference->length = spread > 1e-12 * distance ? spread : distance > 0.0 ? distance : 1.0;

    int k = 0, column = 0, finite = 1;
    for (int i = 0; i < N; i++) k += s->components[i];
    for (int i = 0; i < N; i++) {
        const double *frame = R + 9 * i, x = p[3 * i] - c[0], y = p[3 * i + 1] - c[1], z = p[3 * i + 2] - c[2];
        for (int a = s->components[i] == 1 ? 2 : 0; a < (s->components[i] == 4 ? 4 : 3); a++, column++) {
            const int axis = a < 3 ? a : 2;
            const double e[3] = {frame[axis], frame[3 + axis], frame[6 + axis]};
            const double arm[3] = {y * e[2] - z * e[1], z * e[0] - x * e[2], x * e[1] - y * e[0]};
            for (int r = 0; r < 3; r++) {
                G[r * k + column] = a < 3 ? e[r] : 0.0;
                G[(3 + r) * k + column] = a < 3 ? arm[r] : e[r];
                finite &= fabs(arm[r]) <= DBL_MAX && fabs(e[r]) <= DBL_MAX;
            }
        }
    }
    return finite;
}

/* Largest error of RᵀR = I. */
static const double ROTATION_ERROR = GF_BY_PRECISION(1e-10, 1e-5);

int gf_are_rotations(int count, const double *R)
{
    for (const double *m = R; m < R + 9 * count; m += 9) {
        for (int a = 0; a < 3; a++)
            for (int b = 0; b <= a; b++) {
                double product = m[a] * m[b] + m[3 + a] * m[3 + b] + m[6 + a] * m[6 + b];
                if (!(fabs(product - (a == b)) <= ROTATION_ERROR)) return 0;
            }
        double volume = m[0] * (m[4] * m[8] - m[5] * m[7]) + m[1] * (m[5] * m[6] - m[3] * m[8]);
        if (!(volume + m[2] * (m[3] * m[7] - m[4] * m[6]) > 0.0)) return 0;
    }
    return 1;
}

void gf_wrench_about_centroid(const gf_moment_reference *reference, const double *about_O, double *w)
{
    const double *c = reference->centroid, x = about_O[0], y = about_O[1], z = about_O[2];
    w[0] = x, w[1] = y, w[2] = z;
    w[3] = about_O[3] - (c[1] * z - c[2] * y);
    w[4] = about_O[4] - (c[2] * x - c[0] * z);
    w[5] = about_O[5] - (c[0] * y - c[1] * x);
}

void gf_wrench_size(const gf_moment_reference *reference, const double *about_O, double *size)
{
    const double x = fabs(reference->centroid[0]), y = fabs(reference->centroid[1]), z = fabs(reference->centroid[2]);
    for (int r = 0; r < 6; r++) size[r] = fabs(about_O[r]);
    size[3] += z * size[1] + y * size[2];
    size[4] += z * size[0] + x * size[2];
    size[5] += y * size[0] + x * size[1];
}

/* Move every contact of finger `from` to finger `to`. */
static void merge_fingers(int contacts, int *block, int from, int to)
{
    for (int i = 0; i < contacts; i++)
        if (block[i] == from) block[i] = to;
}

enum { STRIDE = 16 };

/* Return 1 if STRIDE numbers are all 0 or −0, whose only set bit in IEEE 754 may be the sign. */
static int all_zero(const double *x)
{
    uint64_t bits[STRIDE], any = 0;
    memcpy(bits, x, sizeof bits);
    for (int q = 0; q < STRIDE; q++) any |= bits[q];
    return any << 1 == 0;
}

/* Return the first j ≥ from with x[j] ≠ 0, or count. A row of J is mostly zeros if there are many fingers. */
static int next_nonzero(int count, const double *x, int from)
{
    for (int j = from; j < count; j++) {
        while (j + STRIDE <= count && all_zero(x + j)) j += STRIDE;
        if (j < count && x[j] != 0.0) return j;
    }
    return count;
}

int gf_find_fingers(int contacts, const int *components, int joints, const double *J, int *contact_block, int *joint_block,
                    int *largest)
{
    for (int i = 0; i < contacts; i++) contact_block[i] = i;
    for (int j = 0; j < joints; j++) joint_block[j] = -1;
    for (int i = 0; i < contacts; i++)
        for (int c = 0; c < components[i]; c++, J += joints)
            for (int j = next_nonzero(joints, J, 0); j < joints; j = next_nonzero(joints, J, j + 1)) {
                if (joint_block[j] == i) continue; /* so far joint_block[j] is the first contact that the joint moves */
                if (joint_block[j] < 0) joint_block[j] = i;
                int other = contact_block[joint_block[j]], own = contact_block[i];
                if (own != other) merge_fingers(contacts, contact_block, own > other ? own : other, own > other ? other : own);
            }
    for (int j = 0; j < joints; j++) joint_block[j] = contact_block[joint_block[j] < 0 ? 0 : joint_block[j]];

    *largest = 0;
    for (int first = 0; first < contacts; first++) { /* so far a finger has the number of its first contact */
        int size = 0;
        for (int i = first; i < contacts && contact_block[first] == first; i++)
            if (contact_block[i] == first) size += components[i];
        if (size > *largest) *largest = size;
    }
    int fingers = 0;
    for (int i = 0; i < contacts; i++) /* the first contact of a finger comes before the others, which copy its number */
        contact_block[i] = contact_block[i] == i ? fingers++ : contact_block[contact_block[i]];
    for (int j = 0; j < joints; j++) joint_block[j] = contact_block[joint_block[j]];
    return fingers;
}
