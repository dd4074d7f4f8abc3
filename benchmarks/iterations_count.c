/* Solve random problems and print the sum of their iterations, for callgrind: iterations_count CONTACTS JOINTS SOLVES.
 *
 * JOINTS is the number of motors of each contact's finger. */
#include <stdio.h>
#include <stdlib.h>

#include "graspforce/solve.h"
#include "random_problem.inc"

int main(int count, char **arguments)
{
    if (count != 4) return 2;
    const int contacts = atoi(arguments[1]), joints = atoi(arguments[2]), solves = atoi(arguments[3]);
    if (contacts < 1 || contacts > MAX_CONTACTS || joints < 0 || joints > MAX_JOINTS) return 2;
    long iterations = 0, solved = 0;
    void *workspace = NULL;
    for (int s = 0; s < solves; s++) {
        const gf_problem problem = next_problem(contacts, joints, ORDINARY);
        const gf_structure hand = structure_of(contacts, joints);
        gf_solution solution = solution_arrays();
        const gf_options options = GF_OPTIONS_DEFAULT;
        if (workspace == NULL) workspace = malloc(gf_workspace_size(&hand));
        if (workspace == NULL) return 1;
        solved += gf_solve(&hand, &problem, &options, workspace, &solution) == GF_OPTIMAL;
        iterations += solution.iterations;
    }
    printf("%ld %ld\n", iterations, solved);
    free(workspace);
    return 0;
}
