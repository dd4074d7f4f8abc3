/* Follow the short-step path on random problems and print how far it is from its laws: short_step_laws CONTACTS JOINTS COUNT.
 *
 * One line for each kind of problem: optimal ones, infeasible ones, full steps that left a cone, most steps, then the largest of
 *
 *     |μ⁺/(σ μ) − 1|                                      each step reduces the mean complementarity by σ
 *     ‖r⁺ − σ r‖ / (σ ‖r‖) while ‖r‖ > 1e-6 ‖r⁰‖          and the residuals
 *     ‖λ ∘ λ − μ e‖/μ                                     the distance from the central path, at most β
 *     |eᵀ(s + z) + τ + κ + xᵀHx/τ − (1 + μ) N| / N        the bound of the iterates
 *     (1 − β)/(T τ) and κ/(μ T)                           for optimal ones: τ ≥ (1 − β)/T and κ ≤ μ T, with T of the optimum
 *     (1 − β)/(T κ) and τ/(μ T)                           for infeasible ones, with T of the proof
 */
#include <stdio.h>
#include <stdlib.h>

#include "kernel/solve.c"
/* after the kernel, whose variables have the same names */
#include "../../benchmarks/random_problem.inc"

enum { PATH = 4000 };
static const double COARSE = 1e-6; /* of the first residual: those below are measured with rounding */

typedef struct {
    double mu, residual, size, distance, tau, kappa; /* `size` is eᵀ(s + z) + τ + κ + xᵀHx/τ */
} path_point;

/* Return twice the sum of (a − μ)² over the eigenvalues a of λ ∘ λ for one cone or half-line, at lane l. */
static double cone_distance(int n, const gf_lane *s, const gf_lane *dual, int l, double mean)
{
    double s_det = lane_get(s, l) * lane_get(s, l), z_det = lane_get(dual, l) * lane_get(dual, l),
           sz = lane_get(s, l) * lane_get(dual, l);
    if (n == 1) return 2.0 * (sz - mean) * (sz - mean);
    for (int i = 1; i < n; i++) {
        s_det -= lane_get(s + i, l) * lane_get(s + i, l), z_det -= lane_get(dual + i, l) * lane_get(dual + i, l);
        sz += lane_get(s + i, l) * lane_get(dual + i, l);
    }
    const double squares = 4.0 * sz * sz -
                           2.0 * s_det * z_det; /* the eigenvalues have the sum 2 sᵀz and the product det s det z */
    return squares - 4.0 * mean * sz + 2.0 * mean * mean;
}

/* Add the fingers of a group to the sums of a point. */
static void add_group(const gf_finger_group *g, double mean, path_point *point, double *squares, double *xHx)
{
    for (int l = 0; l < g->used; l++) {
        for (int o = 0; o < 2 * g->rows; o++) {
            if (lane_get(g->z + o, l) == 0.0) continue; /* there is no limit */
            point->size += lane_get(g->s + o, l) + lane_get(g->z + o, l);
            *squares += cone_distance(1, g->s + o, g->z + o, l, mean);
        }
        for (int q = 0, o = 2 * g->rows; q < g->cones; o += g->cone_size[q++]) {
            point->size += lane_get(g->s + o, l) + lane_get(g->z + o, l);
            *squares += cone_distance(g->cone_size[q], g->s + o, g->z + o, l, mean);
        }
        for (int i = 0; i < g->d; i++) {
            point->residual = fmax(point->residual, fabs(lane_get(g->rx + i, l)));
            *xHx += lane_get(g->ridge + i, l) * lane_get(g->x + i, l) * lane_get(g->x + i, l);
        }
        for (int o = 0; o < g->slacks; o++) point->residual = fmax(point->residual, fabs(lane_get(g->rz + o, l)));
        for (int j = 0; j < g->rows; j++) {
            double along = 0.0;
            for (int i = 0; i < g->d; i++) along += lane_get(g->A + j * g->d + i, l) * lane_get(g->x + i, l);
            *xHx += lane_get(g->weight + j, l) * along * along;
        }
    }
}

/* Return the numbers of the present point, which has been measured. */
static path_point point_of(const gf_iteration *a)
{
    path_point point = {.mu = a->mu, .size = a->tau + a->kappa, .tau = a->tau, .kappa = a->kappa};
    const double product = a->tau * a->kappa - a->mu;
    double squares = 2.0 * product * product, xHx = 0.0;
    for (const gf_finger_group *g = a->p->groups; g < a->p->groups + a->p->group_count; g++)
        add_group(g, a->mu, &point, &squares, &xHx);
    for (int r = 0; r < WRENCH; r++) point.residual = fmax(point.residual, fabs(a->ry[r]));
    point.size += xHx / a->tau;
    point.distance = sqrt(squares) / a->mu;
    return point;
}

/* Largest violations of the laws; see the top of this file. */
typedef struct {
    double mu, residual, distance, size, share, product;
    int optimal, infeasible, left, steps;
} path_laws;

/* Add the laws of a path to `laws`. */
static void add_path(const gf_iteration *a, const path_point *path, int last, int is_optimal, path_laws *laws)
{
    const double sigma = a->centring;
    for (int i = 0; i <= last; i++) {
        const path_point *b = path + i;
        laws->distance = fmax(laws->distance, b->distance);
        laws->size = fmax(laws->size, fabs(b->size - (1.0 + b->mu) * a->degree) / a->degree);
        if (i == 0) continue;
        laws->mu = fmax(laws->mu, fabs(b->mu / (sigma * b[-1].mu) - 1.0));
        if (b->residual > COARSE * path[0].residual)
            laws->residual = fmax(laws->residual, fabs(b->residual / (sigma * b[-1].residual) - 1.0));
    }
    /* near the end, (s, z, x)/τ is the optimum, and z/κ the proof */
    const double scale = is_optimal ? path[last].tau : path[last].kappa, T = path[last].size / scale;
    for (int i = 0; i <= last; i++) {
        const double large = is_optimal ? path[i].tau : path[i].kappa, small = is_optimal ? path[i].kappa : path[i].tau;
        laws->share = fmax(laws->share, (1.0 - NEIGHBOURHOOD) / (T * large));
        laws->product = fmax(laws->product, small / (path[i].mu * T));
    }
    laws->optimal += is_optimal, laws->infeasible += !is_optimal;
    laws->steps = laws->steps > last ? laws->steps : last;
}

/* Follow the path of a problem to its verdict. */
static void follow(const gf_structure *hand, const gf_problem *problem, void *workspace, path_laws *laws)
{
    static path_point path[PATH];
    const gf_solution solution = solution_arrays();
    gf_scaled_problem p = {.structure = hand, .problem = problem, .k = structure_size(hand)};
    gf_arena memory_left;
    lay_out_workspace(workspace, hand, p.k, &p, &memory_left);
    gf_iteration a;
    if (!sort_structure(&p) || !scale_problem(&p)) abort();
    form_groups(&p, &memory_left);
    pack(&p);
    initialise(&a, &p, 1e-9);
    start_short_steps(&a);
    for (int i = 0; i < PATH; i++) {
        measure_iterate(&a, 0);
        path[i] = point_of(&a);
        const int is_optimal = fmax(a.primal, fmax(a.dual, a.gap)) <= a.tolerance;
        const int has_proof = !is_optimal && a.proof > 0.0 && a.proof > a.proof_demand * a.proof_error;
        if (is_optimal || (has_proof && unpack_proof(&p, a.y, &solution))) {
            add_path(&a, path, i, is_optimal, laws);
            return;
        }
        if (has_proof) a.proof_demand *= DEMAND_GROWTH;
        if (!(make_step(&a, 0) >= 1.0)) laws->left++;
        take_step(&a, 0, 1.0);
    }
}

int main(int count, char **arguments)
{
    if (count != 4) return 2;
    const int contacts = atoi(arguments[1]), joints = atoi(arguments[2]), problems = atoi(arguments[3]);
    if (contacts < 1 || contacts > MAX_CONTACTS || joints < 0 || joints > MAX_JOINTS) return 2;
    void *workspace = NULL;
    for (problem_kind kind = ORDINARY; kind < KINDS; kind++) {
        path_laws laws = {0};
        for (int i = 0; i < problems; i++) {
            const gf_problem problem = next_problem(contacts, joints, kind);
            const gf_structure hand = structure_of(contacts, joints);
            if (workspace == NULL) workspace = malloc(gf_workspace_size(&hand));
            if (workspace == NULL) return 1;
            follow(&hand, &problem, workspace, &laws);
        }
        printf("%d %d %d %d %.3e %.3e %.3e %.3e %.3e %.3e\n", laws.optimal, laws.infeasible, laws.left, laws.steps, laws.mu,
               laws.residual, laws.distance, laws.size, laws.share, laws.product);
    }
    free(workspace);
    return 0;
}
