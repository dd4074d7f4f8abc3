"""Conversion of a cone program to SI units: newtons, newton metres, and the cost of the problem; and to single precision.

`conic_program` divides each variable, row and cost by its own unit, which helps every solver. Without that scaling, a solver
depends on its own scaling and tolerances.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from graspforce.force.cone_program import ConicProgram
from graspforce.force.scale import scale


def to_si_units(program: ConicProgram) -> ConicProgram:
    """Return the same program in SI units: x in N and N·m, rows in N and N·m, the cost in its own unit.

    Args:
        program: program in the units of the problem.
    """
    force = float(scale(program.problem).force)  # N
    extra = len(program.q) - len(program.component_indices)
    u = np.concatenate([program.units[program.component_indices], np.full(extra, force)])  # N, N·m
    wrench = np.concatenate([program.wrench_units, [limit.unit for limit in program.limits[: len(program.b) - 6] if limit]])
    linear = np.array([force if limit is None else limit.unit for limit in program.limits[len(program.b) - 6 :]])
    return dataclasses.replace(
        program,
        P=program.P * program.cost_unit / np.outer(u, u),
        q=program.q * program.cost_unit / u,
        A=program.A * wrench[:, None] / u,
        b=program.b * wrench,
        C=program.C * linear.reshape(-1, 1) / u,
        d=program.d * linear,
        S=program.S * force / u,
        r=program.r * force,
        limits=tuple(None if limit is None else dataclasses.replace(limit, unit=1.0) for limit in program.limits),
        units=np.ones(len(program.units)),
        wrench_units=np.ones(6),
        cost_unit=1.0,
    )


def to_single_precision(program: ConicProgram) -> ConicProgram:
    """Return the same program with the numbers of P, q, A, b, C, d, S and r rounded to single precision.

    Args:
        program: the program.
    """
    parts = {name: getattr(program, name) for name in ("P", "q", "A", "b", "C", "d", "S", "r")}
    return dataclasses.replace(program, **{name: part.astype(np.float32).astype(np.float64) for name, part in parts.items()})
