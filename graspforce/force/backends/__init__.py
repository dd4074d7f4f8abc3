"""Solver backends: one module each, with the interface of `protocol`, listed in `registry`."""
