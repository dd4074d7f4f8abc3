/* Implementation of controller.h. */
#include "graspforce/controller.h"

#include <stdint.h>
#include <string.h>

#include "../real.inc"
#include "force_problem.inc"

/* Rate with which the spin of a soft pad is taken back, rad/s: as in graspforce/control/contacts/pad_spin.py. */
static const double GF_SPIN_RETURN_RATE = 10.0;

/* Memory after a step: two copies, of which a step reads one and writes the other. */
typedef struct {
    double *integral, *R_OC, *creep, *p_OF, *R_OF, *p_OC, *spin;
} gf_step_memory;

struct gf_controller {
    const gf_controller_setup *setup;
    gf_step_problem problem;
    gf_hand_motion motion;
    gf_step_targets targets;
    gf_step_result result;
    gf_step_memory memory[2];
    int step_count; /* 0 before the first step, then 1 or 2 by turns */
    int has_spin;
    double *link_poses, *dynamics_work, *targets_work, *tau_u, *f, *tau, *spin_acceleration;
};

/* ---- memory ------------------------------------------------------------------------------------------------------------- */

/* Take bytes from the memory, aligned for any number. With base NULL it only counts. */
static void *gf_take(char *base, size_t *used, size_t bytes)
{
    const size_t start = (*used + 15) / 16 * 16;
    *used = start + bytes;
    return base == NULL ? NULL : base + start;
}

static double *gf_take_numbers(char *base, size_t *used, size_t count)
{
    return gf_take(base, used, count * sizeof(double));
}

static void gf_place_problem(const gf_controlled_grasp *g, char *base, size_t *used, gf_step_problem *p)
{
    const size_t N = (size_t)g->contact_count, n = (size_t)g->motor_count, k = (size_t)g->force_size;
    double **const parts[] = {&p->G,
                              &p->J,
                              &p->mu_shift,
                              &p->lower_normal,
                              &p->upper_normal,
                              &p->w,
                              &p->tau_u,
                              &p->unit_torque,
                              &p->scratch,
                              &p->f,
                              &p->y,
                              &p->z,
                              &p->nu_lower,
                              &p->nu_upper,
                              &p->lambda_lower,
                              &p->lambda_upper,
                              &p->tau};
    const size_t sizes[] = {6 * k, k * n, N, N, N, 6, n, n, n + 2 * k, k, 6, k, N, N, n, n, n};
    for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++) *parts[i] = gf_take_numbers(base, used, sizes[i]);
    p->contact_block = gf_take(base, used, N * sizeof(int));
    p->joint_block = gf_take(base, used, n * sizeof(int));
    p->span = gf_take(base, used, 2 * k * sizeof(int));
}

/* Place all parts of a controller. Return the bytes without the solver's workspace. */
static size_t gf_place_parts(const gf_controller_setup *setup, char *base, gf_controller *c)
{
    const gf_controlled_grasp *g = &setup->grasp;
    const size_t N = (size_t)g->contact_count, n = (size_t)g->motor_count;
    size_t used = sizeof *c;
    gf_place_problem(g, base, &used, &c->problem);
    double *motion = gf_take_numbers(base, &used, gf_hand_motion_size(setup->hand));
    double *targets = gf_take_numbers(base, &used, gf_targets_size(g));
    double *result = gf_take_numbers(base, &used, gf_result_size(g));
    if (base != NULL) {
        c->motion = gf_map_hand_motion(setup->hand, motion);
        c->targets = gf_map_targets(g, targets);
        c->result = gf_map_result(g, result);
    }
    for (int m = 0; m < 2; m++) {
        gf_step_memory *memory = c->memory + m;
        double **const parts[] = {&memory->integral, &memory->R_OC, &memory->creep, &memory->p_OF,
                                  &memory->R_OF,     &memory->p_OC, &memory->spin};
        const size_t sizes[] = {6, 9 * N, 2 * N, 3 * N, 9 * N, 3 * N, 2 * N};
        for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++) *parts[i] = gf_take_numbers(base, &used, sizes[i]);
    }
    c->link_poses = gf_take_numbers(base, &used, 12 * N);
    c->dynamics_work = gf_take_numbers(base, &used, gf_hand_dynamics_work_size(setup->hand));
    c->targets_work = gf_take_numbers(base, &used, gf_targets_work_size(g));
    c->tau_u = gf_take_numbers(base, &used, n);
    c->f = gf_take_numbers(base, &used, (size_t)g->force_size);
    c->tau = gf_take_numbers(base, &used, n);
    c->spin_acceleration = gf_take_numbers(base, &used, N);
    return (used + 15) / 16 * 16;
}

/* Return whether the sizes of a setup fit together. */
static int gf_is_valid_setup(const gf_controller_setup *setup)
{
    const gf_controlled_grasp *g = &setup->grasp;
    int size = 0;
    if (setup->hand == NULL || g->contact_count < 1 || g->motor_count < 1 || g->joint_count != setup->hand->joint_count ||
        g->motor_count != setup->hand->motor_count)
        return 0;
    for (int i = 0; i < g->contact_count; i++) {
        if (setup->tip_links[i] < 0 || setup->tip_links[i] > g->joint_count) return 0;
        size += setup->components[i];
    }
    return size == g->force_size;
}

/* Return the larger of the solver's workspaces for one finger with all contacts and for one finger for each contact. */
static size_t gf_largest_workspace(const gf_controller_setup *setup)
{
    enum { MAX_CONTACTS = 64, MAX_MOTORS = 256 };
    static const int zeros[MAX_MOTORS] = {0};
    const gf_controlled_grasp *g = &setup->grasp;
    int own[MAX_CONTACTS];
    if (g->contact_count > MAX_CONTACTS || g->motor_count > MAX_MOTORS) return 0;
    for (int i = 0; i < g->contact_count; i++) own[i] = i;
    gf_structure s = {.contacts = g->contact_count,
                      .joints = g->motor_count,
                      .blocks = 1,
                      .components = setup->components,
                      .contact_block = zeros,
                      .joint_block = zeros};
    const size_t together = gf_workspace_size(&s);
    s.blocks = g->contact_count, s.contact_block = own;
    const size_t apart = gf_workspace_size(&s);
    return together > apart ? together : apart;
}

size_t gf_controller_size(const gf_controller_setup *setup)
{
    gf_controller parts;
    if (!gf_is_valid_setup(setup)) return 0;
    const size_t workspace = gf_largest_workspace(setup);
    return workspace == 0 ? 0 : gf_place_parts(setup, NULL, &parts) + workspace;
}

gf_controller *gf_controller_init(const gf_controller_setup *setup, void *memory, size_t size)
{
    const size_t needed = gf_controller_size(setup);
    if (needed == 0 || size < needed || memory == NULL || (uintptr_t)memory % sizeof(double) != 0) return NULL;
    const gf_controlled_grasp *g = &setup->grasp;
    memset(memory, 0, needed);
    gf_controller *c = memory;
    const size_t used = gf_place_parts(setup, memory, c);
    c->setup = setup;
    gf_step_problem *p = &c->problem;
    p->structure = (gf_structure){.contacts = g->contact_count,
                                  .joints = g->motor_count,
                                  .components = setup->components,
                                  .contact_block = p->contact_block,
                                  .joint_block = p->joint_block,
                                  .span = p->span};
    gf_find_structure(setup, p->J, p);
    const size_t workspace = gf_workspace_size(&p->structure);
    if (workspace == 0 || used + workspace > size) return NULL;
    p->workspace = (char *)memory + used;
    memcpy(c->memory[0].R_OC, g->R_OC, 9 * (size_t)g->contact_count * sizeof(double));
    return c;
}

/* ---- step --------------------------------------------------------------------------------------------------------------- */

/* Return whether all numbers are finite. An array that is NULL is. */
static int gf_all_finite(const double *x, int count)
{
    int is_finite = 1;
    for (int i = 0; x != NULL && i < count; i++) is_finite &= isfinite(x[i]) != 0;
    return is_finite;
}

static int gf_are_valid_inputs(const gf_control_inputs *in, int n)
{
    const struct {
        const double *x;
        int count;
    } arrays[] = {{in->q, n},   {in->v, n},   {in->p_HO, 3},    {in->R_HO, 9},           {in->twist, 6},
                  {in->p_d, 3}, {in->R_d, 9}, {in->twist_d, 6}, {in->acceleration_d, 6}, {in->q_d, n},
                  {in->v_d, n}, {in->a_d, n}, {in->external, 6}};
    for (size_t i = 0; i < sizeof arrays / sizeof *arrays; i++)
        if (!gf_all_finite(arrays[i].x, arrays[i].count)) return 0;
    return gf_are_rotations(1, in->R_HO) && gf_are_rotations(1, in->R_d);
}

/* Compute contacts, accelerations and wrench. Return as gf_compute_targets(). */
static int gf_step_to_targets(gf_controller *c, const gf_control_inputs *in, const gf_step_memory *memory)
{
    static const double zeros[6] = {0};
    const gf_controller_setup *setup = c->setup;
    gf_move_hand(setup->hand, in->q, in->v, &c->motion);
    for (int i = 0; i < setup->grasp.contact_count; i++) {
        memcpy(c->link_poses + 12 * i, c->motion.link_poses + 12 * setup->tip_links[i], 12 * sizeof(double));
        c->spin_acceleration[i] = -GF_SPIN_RETURN_RATE * GF_SPIN_RETURN_RATE * memory->spin[2 * i] -
                                  2.0 * GF_SPIN_RETURN_RATE * memory->spin[2 * i + 1];
    }
    const gf_step_inputs inputs = {.q = in->q,
                                   .v = in->v,
                                   .p_HO = in->p_HO,
                                   .R_HO = in->R_HO,
                                   .twist = in->twist,
                                   .p_d = in->p_d,
                                   .R_d = in->R_d,
                                   .twist_d = in->twist_d == NULL ? zeros : in->twist_d,
                                   .acceleration_d = in->acceleration_d == NULL ? zeros : in->acceleration_d,
                                   .integral = memory->integral,
                                   .R_OC_last = memory->R_OC,
                                   .joint_twists = c->motion.joint_twists,
                                   .joint_twist_rates = c->motion.joint_twist_rates,
                                   .q_d = in->q_d,
                                   .v_d = in->v_d,
                                   .a_d = in->a_d,
                                   .external = in->external,
                                   .spin_acceleration = c->has_spin ? c->spin_acceleration : NULL,
                                   .link_poses = c->link_poses};
    return gf_compute_targets(&setup->grasp, &inputs, c->targets_work, &c->targets);
}

/* Compute tau_u without its limits. */
static void gf_own_torques(gf_controller *c)
{
    const gf_controller_setup *setup = c->setup;
    gf_hand_inverse_dynamics(setup->hand, &c->motion, c->targets.joint_acceleration, setup->grasp.gravity_H, c->dynamics_work,
                             c->tau_u);
}

/* Put tau_u within its limits. */
static void gf_limit_free_torques(gf_controller *c)
{
    const gf_controller_setup *setup = c->setup;
    const int n = setup->grasp.motor_count;
    for (int j = 0; j < n; j++) {
        if (c->tau_u[j] < setup->tau_u_limits[j]) c->tau_u[j] = setup->tau_u_limits[j];
        if (c->tau_u[j] > setup->tau_u_limits[n + j]) c->tau_u[j] = setup->tau_u_limits[n + j];
    }
}

/* Find certified forces with the largest of some slip margins. Write the margin, N. */
static gf_control_status gf_find_forces(gf_controller *c, double *margin, int *iterations)
{
    static const double fractions[] = {1.0, 0.75, 0.5, 0.25, 0.0};
    const gf_controller_setup *setup = c->setup;
    gf_step_problem *p = &c->problem;
    for (size_t i = 0; i < sizeof fractions / sizeof *fractions; i++) {
        *margin = fractions[i] * setup->margin;
        if (i > 0 && setup->margin == 0.0) break;
        if (gf_solve_margin(setup, &setup->nominal, *margin, &c->targets, c->tau_u, p, iterations))
            return i == 0 ? GF_CONTROL_FULL : GF_CONTROL_REDUCED;
    }
    *margin = 0.0;
    return gf_solve_margin(setup, &setup->bare, 0.0, &c->targets, c->tau_u, p, iterations) ? GF_CONTROL_REDUCED
                                                                                           : GF_CONTROL_REUSED;
}

/* Compute the sliding of the first step, for which there are no earlier tips, from the measured velocities, m. */
static void gf_first_creep(const gf_controller *c, const gf_control_inputs *in, const gf_step_result *result)
{
    const gf_controlled_grasp *g = &c->setup->grasp;
    const gf_contacts *contacts = &c->targets.contacts;
    double twist_O[6];
    for (int k = 0; k < 6; k++) {
        const double *column = in->R_HO + k % 3, *half = in->twist + k / 3 * 3;
        twist_O[k] = column[0] * half[0] + column[3] * half[1] + column[6] * half[2];
    }
    for (int i = 0; i < g->contact_count; i++) {
        for (int t = 0; t < 2; t++) {
            double slip = contacts->velocity[3 * i + t];
            for (int k = 0; k < 6; k++) slip -= contacts->B[6 * (3 * i + t) + k] * twist_O[k];
            result->creep[2 * i + t] = g->period * slip;
        }
        result->creep_distance[i] = hypot(result->creep[2 * i], result->creep[2 * i + 1]);
    }
}

/* Compute the spin of a soft pad after the step; see graspforce/control/contacts/pad_spin.py. */
static void gf_next_spin(const gf_controlled_grasp *g, int i, const gf_step_memory *before, const gf_contacts *now,
                         double spin[2])
{
    const double *R = now->R_OF + 9 * i, *S = before->R_OF + 9 * i, *frame = now->R_OC + 9 * i;
    double turn[9];
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++)
            turn[3 * a + b] = R[3 * a] * S[3 * b] + R[3 * a + 1] * S[3 * b + 1] + R[3 * a + 2] * S[3 * b + 2];
    double sine = 0.5 * ((turn[7] - turn[5]) * frame[2] + (turn[2] - turn[6]) * frame[5] + (turn[3] - turn[1]) * frame[8]);
    if (sine > 1.0) sine = 1.0;
    if (sine < -1.0) sine = -1.0;
    spin[0] = before->spin[2 * i] + asin(sine);
    spin[1] = asin(sine) / g->period;
}

/* Return whether the memory holds the spins of soft pads. */
static int gf_tracks_spin(const gf_controlled_grasp *g)
{
    return g->spin_damping > 0.0 || g->spin_compliance > 0.0;
}

/* Write the memory after a step. */
static void gf_keep_memory(const gf_controller *c, const gf_step_memory *before, const gf_step_memory *after)
{
    const gf_controlled_grasp *g = &c->setup->grasp;
    const gf_contacts *contacts = &c->targets.contacts;
    const size_t N = (size_t)g->contact_count, number = sizeof(double);
    memcpy(after->integral, c->result.integral, 6 * number);
    memcpy(after->R_OC, contacts->R_OC, 9 * N * number);
    memcpy(after->creep, c->result.creep, 2 * N * number);
    memcpy(after->p_OF, contacts->p_OF, 3 * N * number);
    memcpy(after->R_OF, contacts->R_OF, 9 * N * number);
    memcpy(after->p_OC, contacts->p_OC, 3 * N * number);
    for (int i = 0; i < g->contact_count && c->step_count > 0 && gf_tracks_spin(g); i++)
        gf_next_spin(g, i, before, contacts, after->spin + 2 * i);
}

/* Finish an output with the torques of the last step. */
static gf_control_status gf_hold(const gf_controller *c, gf_control_outputs *out, gf_control_status status)
{
    out->tau = c->tau, out->f = c->f, out->error = c->targets.error;
    out->p_OC = c->targets.contacts.p_OC, out->R_OC = c->targets.contacts.R_OC;
    return status;
}

gf_control_status gf_controller_step(gf_controller *c, const gf_control_inputs *in, gf_control_outputs *out)
{
    const gf_controller_setup *setup = c->setup;
    const gf_controlled_grasp *g = &setup->grasp;
    const int n = g->motor_count, k = g->force_size, is_first = c->step_count == 0;
    const gf_step_memory *before = c->memory + (c->step_count == 1), *after = c->memory + (c->step_count != 1);
    out->margin = 0.0, out->flags = 0, out->iterations = 0;
    if (!gf_are_valid_inputs(in, n)) return gf_hold(c, out, GF_CONTROL_INVALID);
    const int is_complete = gf_step_to_targets(c, in, before);
    if (!gf_all_finite(c->targets.contacts.R_OC, 9 * g->contact_count) || !gf_all_finite(c->targets.acceleration_H, 6))
        return gf_hold(c, out, GF_CONTROL_INVALID);
    if (!is_complete) return gf_hold(c, out, GF_CONTROL_SINGULAR);
    gf_own_torques(c);
    gf_limit_free_torques(c);
    if (!gf_all_finite(c->tau_u, n) || !gf_all_finite(c->targets.w, 6)) return gf_hold(c, out, GF_CONTROL_INVALID);
    const gf_control_status status = gf_find_forces(c, &out->margin, &out->iterations);
    gf_integral_rule rule = GF_INTEGRAL_NEVER;
    if (status != GF_CONTROL_REUSED)
        rule = status == GF_CONTROL_REDUCED && out->margin > 0.0 ? GF_INTEGRAL_ALWAYS : GF_INTEGRAL_UNLESS_SATURATED;
    const gf_contacts *now = &c->targets.contacts;
    const gf_result_inputs inputs = {.q = in->q,
                                     .tau_u = c->tau_u,
                                     .f = status == GF_CONTROL_REUSED ? c->f : c->problem.f,
                                     .integral = before->integral,
                                     .creep = before->creep,
                                     .p_OF = is_first ? now->p_OF : before->p_OF,
                                     .R_OF = is_first ? now->R_OF : before->R_OF,
                                     .p_OC = is_first ? now->p_OC : before->p_OC,
                                     .integral_rule = rule};
    out->flags = gf_compute_result(g, &c->targets, &inputs, &c->result);
    if (!gf_all_finite(c->result.tau, n) || !gf_all_finite(c->result.integral, 6)) return gf_hold(c, out, GF_CONTROL_INVALID);
    if (is_first) gf_first_creep(c, in, &c->result);
    if (status != GF_CONTROL_REUSED) memcpy(c->f, c->problem.f, (size_t)k * sizeof(double));
    memcpy(c->tau, c->result.tau, (size_t)n * sizeof(double));
    gf_keep_memory(c, before, after);
    c->has_spin = gf_tracks_spin(g);
    c->step_count = c->step_count == 1 ? 2 : 1;
    return gf_hold(c, out, status);
}

const char *gf_control_status_string(int status)
{
    static const char *const names[] = {"full", "reduced", "reused", "singular", "invalid"};
    return status >= 0 && status <= GF_CONTROL_INVALID ? names[status] : "unknown";
}
