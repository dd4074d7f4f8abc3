"""The cone program of a case: of its problem, or of the squeeze that holds for all errors of an uncertain problem."""

from __future__ import annotations

import dataclasses

import numpy as np

from graspforce.core.arrays import Array
from graspforce.core.errors import UnsupportedProblem
from graspforce.force.certificate import primal_residual
from graspforce.force.cone_program import ConicProgram, conic_program
from graspforce.force.problem import ForceProblem
from graspforce.force.robust_limits import worst_case
from graspforce.force.robust_program import safe_rows
from graspforce.force.robust_set import RobustSet


def case_program(problem: ForceProblem) -> ConicProgram:
    """Return the cone program of a problem.

    Args:
        problem: the problem; its uncertainty must be exact, so that the program has the optimum of the problem.

    Raises:
        UnsupportedProblem: the uncertainty is bounded only, not exact.
    """
    if problem.uncertainty is None:
        return conic_program(problem)
    robust = RobustSet(problem)
    if not robust.is_exact:
        raise UnsupportedProblem("the uncertainty is not exact: its program has another optimum than the problem")
    rows, nominal = safe_rows(robust), robust.program
    e, i = rows.sizes.zero, rows.sizes.nonnegative
    equal, inequal = nominal.limits[: len(nominal.b) - 6], nominal.limits[len(nominal.b) - 6 :]
    return dataclasses.replace(
        nominal,
        A=rows.A[:e],
        b=rows.b[:e],
        C=rows.A[e : e + i],
        d=rows.b[e : e + i],
        S=rows.A[e + i :],
        r=rows.b[e + i :],
        cones=tuple(rows.sizes.second_order),
        limits=(*equal, *[None] * (e - len(nominal.b)), *inequal),
        problem=problem,
    )


def forces_residual(problem: ForceProblem, f: Array) -> float:
    """Return the largest violation of equilibrium, cones and limits by forces, for the worst errors of the problem.

    Args:
        problem: the force problem.
        f: (k,) stacked contact forces, N and N·m.

    Returns:
        The violation, relative to the units of the problem.
    """
    residual = primal_residual(problem, f)
    if problem.uncertainty is None or not np.isfinite(residual):
        return residual
    with np.errstate(all="ignore"):  # a diverged solver returns numbers that overflow
        robust = RobustSet(problem)
        worst = worst_case(robust, f)
        missing = (robust.uncertainty.slip_margin - float(worst.guaranteed.min())) / float(robust.program.wrench_units[0])
        residual = max(residual, missing, worst.exceeded)
    return residual if np.isfinite(residual) else float(np.finfo(float).max)


def load_error(problem: ForceProblem, f: Array) -> float:
    """Return the missing wrench of forces, relative to the load; 0 without load.

        max(‖Δw_f‖, ‖Δw_m‖ / L) / max(‖w_f‖, ‖w_m‖ / L),    about the centroid of the contacts, which are L from it

    Args:
        problem: the force problem.
        f: (k,) stacked contact forces, N and N·m.
    """
    with np.errstate(all="ignore"):  # a diverged solver returns numbers that overflow
        sizes = [
            max(float(np.linalg.norm(w[:3])), float(np.linalg.norm(w[3:])) / problem.length)
            for w in (problem.w_centred - problem.G_centred @ f, problem.w_centred)
        ]
    if sizes[1] == 0.0:
        return 0.0
    return sizes[0] / sizes[1] if np.isfinite(sizes[0]) else float(np.finfo(float).max)
