"""Minimum time as a nonlinear program, and the solvers of it."""
