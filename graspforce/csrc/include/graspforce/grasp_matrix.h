/* Grasp matrix, wrench about the contacts' centroid, and fingers, from contact frames and a hand Jacobian.
 *
 * The functions prepare the arrays of problem.h. A program that already has G, w and the blocks does not need them.
 *
 * Moments are taken about the contacts' centroid c, so that results do not depend on the origin of the object frame O:
 *
 *     G f = w,     column of G for a force along the axis e at p:    (e; (p − c) × e)
 *                  column of G for a moment about the normal n:      (0; n)
 *                  w = (force; moment about O − c × force)
 *
 * The reference implementations in Python are graspforce/contact/grasp_matrix.py and graspforce/force/problem.py. Both agree
 * with this file to rounding.
 */
#ifndef GF_GRASP_MATRIX_H
#define GF_GRASP_MATRIX_H

#include "graspforce/problem.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The point about which moments are taken, and the size of the grasp. */
typedef struct {
    gf_real centroid[3]; /* c, mean of the contact positions, in O, m */
    gf_real length;      /* L, root mean square distance of the contacts from c, or from O if they coincide; never zero, m */
} gf_moment_reference;

/* Compute the grasp matrix. Return 1, or 0 if an entry of G is not finite.
 *
 * structure  contacts and components are read
 * p          (N, 3) contact positions in O, m
 * R          (N, 3, 3) contact frames in O, with columns t1, t2, n
 * G          (6, k) written
 * reference  written */
int gf_grasp_matrix(const gf_structure *structure, const gf_real *p, const gf_real *R, gf_real *G,
                    gf_moment_reference *reference);

/* Return 1 if all matrices R (count, 3, 3) are rotations to within 1e-10, otherwise 0. */
int gf_are_rotations(int count, const gf_real *R);

/* Shift a wrench from O to the contacts' centroid: about_O (6) is read, w (6) is written; N and N·m. */
void gf_wrench_about_centroid(const gf_moment_reference *reference, const gf_real *about_O, gf_real *w);

/* Compute the sizes of the numbers whose sum is the wrench about the centroid: |force| and |moment| + |c × force|, (6). */
void gf_wrench_size(const gf_moment_reference *reference, const gf_real *about_O, gf_real *size);

/* Find the fingers of a hand: the connected components of contacts and motors, linked where J is not zero. Return their
 * number. A motor that moves no contact belongs to the finger of the first contact.
 *
 * contacts       N
 * components     (N) force components of each contact
 * joints         n
 * J              (k, n) hand Jacobian, dense, m/rad
 * contact_block  (N) written: finger of each contact
 * joint_block    (n) written: finger of each motor
 * largest        written: force components of the largest finger */
int gf_find_fingers(int contacts, const int *components, int joints, const gf_real *J, int *contact_block, int *joint_block,
                    int *largest);

#ifdef __cplusplus
}
#endif

#endif
