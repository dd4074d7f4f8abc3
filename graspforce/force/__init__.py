"""The force problem, its solvers, and the certificates of their solutions."""
