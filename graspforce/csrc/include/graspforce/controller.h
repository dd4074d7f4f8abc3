/* The whole step of the object controller: kinematics and dynamics of the hand, contacts, forces, certificate and torques.
 *
 * A real-time loop without Python calls
 *
 *     gf_controller *controller = gf_controller_init(&grasp_controller, memory, sizeof memory);
 *     for (;;) {
 *         gf_control_status status = gf_controller_step(controller, &inputs, &outputs);
 *         ... send outputs.tau ...
 *     }
 *
 * `graspforce.control.write_controller` writes the numbers of a grasp, here `grasp_controller`. The functions allocate no memory,
 * write no global state and print nothing. Different controllers may run in different threads.
 *
 * The reference implementation in Python is graspforce/control/object_controller.py. It differs where the step cannot keep the
 * slip margin of the settings or every twist of the object: see gf_control_status.
 */
#ifndef GF_CONTROLLER_H
#define GF_CONTROLLER_H

#include "graspforce/control_step.h"
#include "graspforce/hand_model.h"
#include "graspforce/problem.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Friction and normal forces that the contacts of a step may use; arrays of N. */
typedef struct {
    const gf_real *mu;         /* friction coefficients */
    const gf_real *gamma;      /* torsional friction lengths, m */
    const gf_real *min_normal; /* N */
    const gf_real *max_normal; /* N */
} gf_contact_limits;

/* Numbers of a grasp and of the settings, constant during all steps. */
typedef struct {
    const gf_hand_model *hand;
    gf_controlled_grasp grasp;
    const int *components;       /* (N) force components of each contact: 1, 3 or 4 */
    const int *tip_links;        /* (N) link that carries each tip, from 1; 0: base */
    const gf_real *tau_u_limits; /* (2, n) lower and upper limits of the torques without contact forces, N·m */
    gf_contact_limits nominal;   /* with the friction reserve and the errors of the settings */
    gf_contact_limits bare;      /* without them */
    gf_real margin;              /* slip margin s, N */
    gf_real force_weight;        /* ρ */
} gf_controller_setup;

/* State and desired motion of one step. Poses: p in m, R by rows, a rotation to within 1e-10. Twists and accelerations in H, linear part first. */
typedef struct {
    const gf_real *q, *v;           /* (n) measured joint positions and rates, rad and rad/s */
    const gf_real *p_HO, *R_HO;     /* measured pose of the object */
    const gf_real *twist;           /* (6) measured twist of the object */
    const gf_real *p_d, *R_d;       /* desired pose of the object */
    const gf_real *twist_d;         /* (6) desired twist; NULL: zero */
    const gf_real *acceleration_d;  /* (6) desired acceleration; NULL: zero */
    const gf_real *q_d, *v_d, *a_d; /* (n) desired motion of the joints; NULL: the posture of the grasp, at rest */
    const gf_real *external;        /* (6) external wrench about O's origin in O, N and N·m; NULL: zero */
} gf_control_inputs;

/* Status of a step, from best to worst. Torques are always finite and within the torque limits. */
typedef enum {
    GF_CONTROL_FULL = 0,     /* certified forces with the slip margin of the settings */
    GF_CONTROL_REDUCED = 1,  /* certified forces with ¾, ½, ¼ or none of it */
    GF_CONTROL_REUSED = 2,   /* no certified forces: the last forces, zero before the first */
    GF_CONTROL_SINGULAR = 3, /* the fingers may not be able to make every twist of the object: the last torques */
    GF_CONTROL_INVALID = 4   /* a number is not finite, too large, or no rotation: the last torques; the memory stays */
} gf_control_status;

/* Results of one step. The arrays belong to the controller, and the next step overwrites them. */
typedef struct {
    const gf_real *tau;         /* (n) motor torques, N·m */
    const gf_real *f;           /* (k) contact forces in the contact frames, N and N·m */
    const gf_real *error;       /* (6) pose error in H, m and rad */
    const gf_real *p_OC, *R_OC; /* (N, 3), (N, 3, 3) contact points, m, and contact frames */
    gf_real margin;             /* slip margin that the forces keep, N */
    int flags;                  /* GF_SATURATED, GF_CONTACT_LOST and GF_JOINT_LIMIT */
    int iterations;             /* of the solver */
} gf_control_outputs;

typedef struct gf_controller gf_controller;

/* Return the bytes of memory that a controller needs, or 0 if the setup is invalid. */
size_t gf_controller_size(const gf_controller_setup *setup);

/* Make a controller in the caller's memory. Return NULL if the setup is invalid or the memory too small.
 *
 * memory  aligned as malloc() aligns it; it belongs to the controller until the last step
 * size    bytes */
gf_controller *gf_controller_init(const gf_controller_setup *setup, void *memory, size_t size);

/* Compute the torques of the next period. The time is bounded: at most six force problems are solved. */
gf_control_status gf_controller_step(gf_controller *controller, const gf_control_inputs *inputs, gf_control_outputs *outputs);

/* Return the name of a status: "full", "reduced", "reused", "singular" or "invalid"; "unknown" for any other number. */
const char *gf_control_status_string(int status);

#ifdef __cplusplus
}
#endif

#endif
