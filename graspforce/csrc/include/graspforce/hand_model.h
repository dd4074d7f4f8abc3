/* Kinematics and inverse dynamics of a hand, in the coordinates of its motors.
 *
 * The numbers of a hand are a table that `graspforce hands codegen` writes. The joints of the kinematic tree follow the motors:
 *
 *     q_full = T q + q0,    v_full = T v,    tau = Tᵀ tau_full + D a
 *
 * with the rotor inertias D. The reference implementation in Python is graspforce/hand/kinematics/coupled_model.py, which the
 * tests compare with this one.
 *
 * Twists and wrenches are in H, about H's origin, with the linear part first. Matrices are stored by rows. No function allocates
 * memory or writes global state.
 *
 * Reference: Featherstone (2008), chapter 5.
 */
#ifndef GF_HAND_MODEL_H
#define GF_HAND_MODEL_H

#include <stddef.h>

#include "graspforce/real.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A moving link and the joint that moves it. Frames: P parent link, L this link. */
typedef struct {
    int parent;               /* index of the parent link, less than the own one; −1: base */
    int is_prismatic;         /* nonzero: the joint slides */
    gf_real p_PL[3], R_PL[9]; /* pose of L in P at joint position 0, p in m */
    gf_real axis[3];          /* unit vector of the joint in L */
    gf_real mass, p_LM[3];    /* kg; centre of mass in L, m */
    gf_real inertia[9];       /* about the centre of mass, in L, kg·m² */
} gf_link;

/* The numbers of a hand. Torques of prismatic joints are forces, and their positions lengths. */
typedef struct {
    int motor_count, joint_count;
    const gf_link *links;           /* (joint_count) */
    const gf_real *T;               /* (joint_count, motor_count) */
    const gf_real *q0;              /* (joint_count) rad */
    const gf_real *rotor_inertia;   /* (motor_count) kg·m² */
    const gf_real *q_limits;        /* (2, motor_count) lower and upper, rad */
    const gf_real *torque_limits;   /* (2, motor_count) lower and upper, N·m */
    const gf_real *velocity_limit;  /* (motor_count) rad/s */
    const gf_real *torque_weight;   /* (motor_count) diagonal of W in the cost of the forces */
    const char *const *motor_names; /* (motor_count) */
} gf_hand_model;

/* Motion of the links. The caller provides the arrays. */
typedef struct {
    gf_real *joint_rates;       /* (joint_count) rad/s */
    gf_real *link_poses;        /* (1 + joint_count, 12) of the base and the links: p_HL in m, then R_HL */
    gf_real *joint_twists;      /* (6, joint_count) twists of the links after each joint for unit rate, in columns */
    gf_real *joint_twist_rates; /* (6, joint_count) their time derivatives */
    gf_real *link_twists;       /* (joint_count, 6) m/s and rad/s */
} gf_hand_motion;

/* Return the numbers in the block of a hand's motion. */
size_t gf_hand_motion_size(const gf_hand_model *hand);

/* Return the motion whose fields follow one another in a block. */
gf_hand_motion gf_map_hand_motion(const gf_hand_model *hand, gf_real *block);

/* Compute the motion of all links.
 *
 * q, v    (motor_count) positions and rates of the motors, rad and rad/s
 * motion  written */
void gf_move_hand(const gf_hand_model *hand, const gf_real *q, const gf_real *v, const gf_hand_motion *motion);

/* Return the numbers of workspace that gf_hand_inverse_dynamics() needs. */
size_t gf_hand_dynamics_work_size(const gf_hand_model *hand);

/* Compute tau = M a + c + g.
 *
 * motion   of the links, as gf_move_hand() wrote it
 * a        (motor_count) accelerations of the motors, rad/s²
 * gravity  (3) acceleration of gravity in H, m/s²
 * work     workspace
 * tau      (motor_count) written, N·m */
void gf_hand_inverse_dynamics(const gf_hand_model *hand, const gf_hand_motion *motion, const gf_real *a,
                              const gf_real gravity[3], gf_real *work, gf_real *tau);

#ifdef __cplusplus
}
#endif

#endif
