/* What contacts and a hand's Jacobian make of the numbers of structured.h: the grasp matrix, the wrench about the contacts'
 * centroid, the fingers. Whoever already has these needs nothing of this file.
 *
 * Equilibrium is taken about the contacts' centroid c, so that it does not matter where the object's frame O stands:
 *
 *     G f = w,    G's column of a force component e is (R e; (p − c) × R e), of a moment about the normal (0; n),
 *                 w = (force; moment about O − c × force).
 *
 * The laws in Python are graspforce/contact/grasp_matrix.py and graspforce/force/problem.py; both give the same numbers but for rounding.
 */
#ifndef GF_GRASP_MATRIX_H
#define GF_GRASP_MATRIX_H

#include "graspforce/solve.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Where the contacts stand. */
typedef struct {
    double centroid[3]; /* of their positions, in O, m */
    double length;      /* L: their root mean square distance from it, m; from O where they coincide, 1 if that is zero */
} gf_moment_reference;

/* Writes G (6, k) and `place` from positions p (N, 3), m, and frames R (N, 3, 3), columns t1, t2, n, in O. Returns 1, or 0 if
 * a number of G is not finite. */
int gf_grasp_matrix(const gf_structure *structure, const double *p, const double *R, double *G, gf_moment_reference *place);

/* Whether the N matrices R (N, 3, 3) are rotations, to 1e-10. */
int gf_are_rotations(int count, const double *R);

/* Writes w about the centroid, from w about O: N and N·m. */
void gf_wrench_about_centroid(const gf_moment_reference *place, const double *about_O, double *w);

/* Numbers the fingers: contacts that share a joint are in one, and a joint that moves no contact is in the first contact's.
 * Reads J (k, n); writes contact_block (N) and joint_block (n). Returns how many fingers there are, and in `largest` the
 * force components of the largest. */
int gf_find_fingers(int contacts, const int *components, int joints, const double *J, int *contact_block, int *joint_block,
                    int *largest);

#ifdef __cplusplus
}
#endif

#endif
