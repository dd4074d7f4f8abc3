"""Answers about grasps beyond the forces: quality and payload, explanations, and sensitivities.

- `check_proof`: a program that decides proof files in exact arithmetic
- `largest_wrench`: the largest wrench along a direction
- `wrench_set`: the wrenches that contacts and motors can supply: inscribed balls and volume
- `ellipsoids`: singular values of the grasp matrix, force and manipulability ellipsoids
- `contact_errors`: errors of contact places and normals that a grasp tolerates
- `contact_regions`: how far each contact may move along the object's surface
- `quality`: all measures of one grasp
- `explain`: what limits the forces, or why there are none
- `optimality`: the optimality conditions with a known active set
- `sensitivity`: derivatives of optima with respect to the data of their problem
- `gradients`: optima as differentiable functions of arrays, for `torch_adapter` and `jax_adapter`
"""
