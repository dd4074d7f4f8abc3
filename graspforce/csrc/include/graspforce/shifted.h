/* Robust forces by nominal problems: forces that stay in their cones when a vertex of the wrench's errors shifts them.
 *
 * Vertex v shifts the force of contact i by βᵢᵥ. For a primary vertex A and a secondary vertex B of each contact, the nominal
 * problem for f' = f + β_A − offset has the wrench w − G a, the bias torques tau_u + Jᵀ a with a = offset − β_A, and one more
 * motor for each contact. With the quadratic form Q(x) = μ² f_n² − ‖f_t‖² − (μ m_n/γ)² of the cone and D = β_B − β_A, that motor
 * keeps
 *
 *     Q(f' + D) ≥ Q(f'),    which is the half-space 2 Q(f', D) + Q(D) ≥ 0:
 *
 * there f' in the cone implies f' + D in the cone. Its multiplier η moves the normal of the first cone towards that of the
 * second one. While it moves by less than the whole, the optimum is that of both cones together.
 */
#ifndef GF_SHIFTED_H
#define GF_SHIFTED_H

#ifdef __cplusplus
extern "C" {
#endif

/* Numbers of one grasp that stay the same while wrench, Jacobian and bias torques change. */
typedef struct {
    int contacts;          /* N */
    int vertices;          /* V ≥ 1 */
    int components;        /* k */
    int motors;            /* n */
    int weighs_forces;     /* nonzero: k more motors have the torques root f */
    const double *beta;    /* (V, k, 6) shifts by the wrench about O */
    const double *further; /* (V, k) shifts by further wrenches, N and N·m */
    const double *G;       /* (6, k) grasp matrix about O */
    const double *offset;  /* (k) normal forces that give the slip margin, N */
    const double *form;    /* (k) diagonal of Q; zero for contacts without friction */
    const double *owner;   /* (k) contact of each component, an integer */
    const double *root;    /* (k) square roots of the weights of f; read if weighs_forces */
    const double *normal;  /* (2, N) limits of the normal forces, N */
} gf_shift_data;

/* The shifted problem. */
typedef struct {
    double *shifts;  /* (V, k) β, N and N·m */
    double *a;       /* (k) */
    double *w;       /* (6) */
    double *J;       /* (k, n + N), or (k, n + k + N) if weighs_forces */
    double *tau_u;   /* as many as J has columns */
    double *limits;  /* (2, n) torque limits that leave room for all shifts, N·m */
    double *normal;  /* (2, N) limits of the normal forces of f', N */
    double *largest; /* (N) ‖D‖, N; zero for idle motors */
} gf_shifted_problem;

/* Write the shifted problem. Return 1 if its limits leave room, otherwise 0.
 *
 * pair         (N, 3) primary and secondary vertex of each contact, integers; equal ones leave the further motor idle. The third
 *              number is for gf_check_shifted()
 * w, J, tau_u  of the problem; lower, upper its torque limits */
int gf_shift_problem(const gf_shift_data *data, const double *pair, const double *w, const double *J, const double *tau_u,
                     const double *lower, const double *upper, gf_shifted_problem *shifted);

/* Outcome of a solution of the shifted problem. */
typedef enum {
    GF_SHIFT_SOLVED = 0, /* f is optimal for all vertices */
    GF_SHIFT_AGAIN = 1,  /* the pairs have changed: shift and solve again */
    GF_SHIFT_FAILED = 2, /* three vertices limit one contact */
    GF_SHIFT_LIMITS = 3  /* a torque is near a limit that has changed: solve again with the new limits */
} gf_shift_outcome;

/* Write f = a + f' and check it for all vertices; change the pairs of contacts that need others.
 *
 * solution   (k) f', (k) z of its cones
 * eta        (N) multipliers of the further motors' lower limits
 * room       (N) torques of the further motors: how far f' is from the half-spaces' boundaries, N
 * tau, used  (n) motor torques, and (2, n) the torque limits with which the problem was solved
 * mu, gamma  (N) friction
 * margin     slip margin that must remain, less its tolerance, N
 * pair       changed. The third number is the primary vertex before; set it to −1 before the first solution of a problem
 * f          (k) written */
gf_shift_outcome gf_check_shifted(const gf_shift_data *data, const gf_shifted_problem *shifted, const double *solution,
                                  const double *z, const double *eta, const double *room, const double *tau, const double *used,
                                  const double *mu, const double *gamma, double margin, double *pair, double *f);

#ifdef __cplusplus
}
#endif

#endif
