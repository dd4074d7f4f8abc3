/* Contacts of fingertips that roll on an object, and the joint accelerations that keep them.
 *
 * A spherical fingertip of radius r about its origin c touches the object at the surface point x nearest to c. The contact
 * frame C has its origin at x and the columns t1, t2, n, with the inward normal n from c to x. A fingertip with r = 0 touches
 * with its origin, at a constant point of the object. The contact is kept when
 *
 *     A q̈ = B a + beta
 *
 * with the joint accelerations q̈ and the object's acceleration a. Both are derived in graspforce/contact/kinematics.py, the
 * reference implementation in Python, which the tests compare with this one.
 *
 * Frames: H is the hand's base, O the object, F a fingertip. Vectors are in O unless stated otherwise. Matrices are stored by
 * rows. Twists have the linear part first. No function allocates memory or writes global state.
 */
#ifndef GF_CONTACT_KINEMATICS_H
#define GF_CONTACT_KINEMATICS_H

#include "graspforce/real.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef gf_real gf_vector3[3];
typedef gf_real gf_matrix3[9]; /* by rows */

typedef enum {
    GF_PLANE,       /* the tangent plane of each contact at the start of the grasp, for an object of unknown shape */
    GF_SPHERE,      /* size: radius */
    GF_CYLINDER,    /* size: radius, half of the height; about the z axis */
    GF_BOX,         /* size: half of each edge */
    GF_SUPERQUADRIC /* size: half-extents a, b and c, then the exponents e1 and e2, from 0 (exclusive) to 2 */
} gf_surface_kind;

/* Surface of an object, in O. */
typedef struct {
    gf_surface_kind kind;
    gf_real size[5]; /* m, and exponents; numbers that a kind does not use are 0 */
} gf_surface;

/* Pose and twist of an object. */
typedef struct {
    gf_surface surface;
    gf_vector3 p_HO; /* m */
    gf_matrix3 R_HO;
    gf_real twist[6]; /* in H, m/s and rad/s */
} gf_object_state;

/* One fingertip and its contact. */
typedef struct {
    int motor_count; /* n */
    gf_real radius;  /* m; 0 for a tip that touches with its origin */
    gf_vector3 p_HF; /* m */
    gf_matrix3 R_HF;
    const gf_real *rates;  /* (6, n + 2) in H: Jacobian, twist, and drift J̇ v */
    gf_vector3 p_OC_start; /* contact point at the start of the grasp, m */
    gf_matrix3 R_OC_start; /* contact frame at the start of the grasp */
    gf_matrix3 R_OC_last;  /* contact frame at the last step, which the tangents follow */
} gf_fingertip;

/* Output arrays of N contacts: FIELD(name, numbers of one contact, shape of the array).
 *
 * The shapes depend on contact_count (N) and motor_count (n), which must be defined where the macro is used. In a block the
 * arrays follow one another in this order.
 *
 * p_OC       contact points, m
 * R_OC       contact frames
 * A          joint rates to velocities of the finger's point at the contact, along t1, t2 and n
 * B          twist of the object in O to velocities of its point at the contact
 * beta       velocity-dependent part of the constraint, m/s²
 * velocity   velocity of the finger's point along t1, t2 and n, m/s
 * gap        distance between fingertip and surface, m; negative if they penetrate
 * p_OF       origins of the tip frames, m
 * R_OF       axes of the tip frames
 * spin_A     joint rates to the angular velocity of the finger about n
 * spin_B     twist of the object in O to its angular velocity about n
 * spin_beta  velocity-dependent part of the spin constraint, rad/s² */
#define GF_CONTACT_FIELDS(FIELD)                              \
    FIELD(p_OC, 3, contact_count, 3)                          \
    FIELD(R_OC, 9, contact_count, 3, 3)                       \
    FIELD(A, 3 * motor_count, 3 * contact_count, motor_count) \
    FIELD(B, 18, 3 * contact_count, 6)                        \
    FIELD(beta, 3, 3 * contact_count)                         \
    FIELD(velocity, 3, contact_count, 3)                      \
    FIELD(gap, 1, contact_count)                              \
    FIELD(p_OF, 3, contact_count, 3)                          \
    FIELD(R_OF, 9, contact_count, 3, 3)                       \
    FIELD(spin_A, motor_count, contact_count, motor_count)    \
    FIELD(spin_B, 6, contact_count, 6)                        \
    FIELD(spin_beta, 1, contact_count)

/* The output arrays of all contacts, or their parts for one contact. */
typedef struct {
#define GF_POINTER(name, ...) gf_real *name;
    GF_CONTACT_FIELDS(GF_POINTER)
#undef GF_POINTER
} gf_contacts;

/* Return the parts of contact i in the arrays of all contacts. */
gf_contacts gf_contact_at(const gf_contacts *all, int i, int motor_count);

/* Compute one contact.
 *
 * object   pose, twist and surface of the object
 * tip      the fingertip
 * contact  parts of the output arrays; written */
void gf_compute_contact(const gf_object_state *object, const gf_fingertip *tip, const gf_contacts *contact);

/* Compute one contact as if its point did not move over the object: all outputs but beta and spin_beta are those of
 * gf_compute_contact(). It takes a third of the closest points. */
void gf_compute_contact_place(const gf_object_state *object, const gf_fingertip *tip, const gf_contacts *contact);

/* Pose of a fingertip on the object at one instant, and its contact point. */
typedef struct {
    const gf_real *p_OF, *R_OF, *p_OC; /* (3), (3, 3), (3); p in m */
} gf_tip_contact;

/* Compute the sliding of a fingertip between two instants along t1 and t2, m.
 *
 * It is the displacement between the point of the finger that touched at the first instant and the point of the object that it
 * touched. Rolling separates the two points along the normal only, to second order in the time step.
 *
 * last  the fingertip at the first instant
 * p_OF, R_OF  pose of the fingertip at the second instant
 * R_OC  contact frame at the second instant
 * slip  (2) written */
void gf_slip_displacement(const gf_tip_contact *last, const gf_real *p_OF, const gf_real *R_OF, const gf_real *R_OC,
                          gf_real slip[2]);

/* Constraints A q̈ = B a + beta. Near a loss of rank the last rows may be damped, or the object may yield. */
typedef struct {
    int rows, motor_count;
    const gf_real *A, *B, *beta; /* (rows, motor_count), (rows, 6), (rows) */
    int damped_rows;
    gf_real damping, damping_start;       /* λ₀ and σ₀ in the unit of A, see gf_joint_accelerations() */
    gf_real compliance, compliance_start; /* ℓ₀ and σ₁ in the unit of A; ℓ₀ = 0 for an object that does not yield */
    const gf_real *mobility;              /* (6, 6) N; not used without compliance */
} gf_constraints;

/* Compute the joint accelerations nearest to the posture's that keep the contacts, and the acceleration of the object:
 *
 *     ν = (A Aᵀ + λ² S + ℓ² B N Nᵀ Bᵀ)⁻¹ (B a_d + beta − A posture),  q̈ = posture + Aᵀ ν,  a = a_d − ℓ² N Nᵀ Bᵀ ν
 *
 * S is 1 on the diagonal for the damped rows, otherwise 0. With σ² = 1/tr (A Aᵀ)⁻¹, which is at most the square of the least
 * singular value, λ = λ₀ (1 − σ²/σ₀²) if there are damped rows and σ < σ₀, otherwise 0. Likewise ℓ = ℓ₀ (1 − σ²/σ₁²) if
 * σ < σ₁, otherwise 0. N Nᵀ is the inverse of the object's mass matrix times its mass. Far from a loss of rank,
 * Aᵀ (A Aᵀ)⁻¹ = A⁺ and a = a_d.
 * Return 1, or 0 if the rank may be lacking; q̈ then is undefined, and a is a_d. The reference implementation, for every rank, is
 * graspforce/control/contacts/mobility.py.
 *
 * object_acceleration  (6) a_d in O, m/s² and rad/s²; replaced by a
 * posture              (motor_count) joint accelerations without contacts, rad/s²
 * rank_tolerance       smallest ratio of singular values of A that counts as full rank
 * work                 rows (rows + 7) numbers
 * joint_acceleration   (motor_count) written, rad/s² */
int gf_joint_accelerations(const gf_constraints *constraints, gf_real *object_acceleration, const gf_real *posture,
                           gf_real rank_tolerance, gf_real *work, gf_real *joint_acceleration);

#ifdef __cplusplus
}
#endif

#endif
