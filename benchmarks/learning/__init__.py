"""Learned models: synergies, grasp priors, gloves, inverse kinematics, forces and actions; `python -m benchmarks.learning`."""
