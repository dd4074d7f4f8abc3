"""SLSQP: sequential least squares for nonlinear programs (Kraft 1988), from SciPy. A baseline that returns no multipliers.

Cones are smooth inequalities (`graspforce.bench.smooth_cones`), with exact gradients. The method needs independent equations,
so equations that repeat others are dropped. SciPy returns multipliers only from version 1.16 on, so this adapter passes none.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import linalg, optimize

from graspforce.bench.adapter import TOLERANCE, BoundSolver, SolverResult, SolverStatus, make_result
from graspforce.bench.smooth_cones import cone_heads, cone_parts, interior_start
from graspforce.core.arrays import Array
from graspforce.force.cone_program import ConicProgram

PACKAGE = "scipy"
EXACT_CONES = True
WARM_START = True

_DEPENDENT = 1e-12  # relative size below which a row counts as dependent on others
_MAX_ITERATIONS = 1000  # SciPy's default of 100 ends runs before a requested tolerance is reached


def bind(program: ConicProgram, settings: str) -> BoundSolver:
    """Bind SLSQP with dense rows and gradients.

    Args:
        program: program to solve.
        settings: accuracy settings, a key of `TOLERANCE`.
    """
    tolerance = TOLERANCE[settings]
    options = {} if tolerance is None else {"ftol": tolerance, "maxiter": _MAX_ITERATIONS}
    constraints = _constraints(program)
    first = interior_start(program)

    def cost(x: Array) -> tuple[float, Array]:
        gradient = program.P @ x
        return float(0.5 * x @ gradient + program.q @ x), gradient + program.q

    def run(start: Any) -> Any:
        x = first if start is None or len(start.x) != len(first) else start.x
        return optimize.minimize(cost, x, jac=True, method="SLSQP", constraints=constraints, options=options)

    def read(output: Any) -> SolverResult:
        status = SolverStatus.SOLVED if output.success else SolverStatus.NO_ANSWER
        return make_result(program, status, output.x, None, None, output.nit)

    return BoundSolver(run, read)


def _constraints(program: ConicProgram) -> list[dict[str, Any]]:
    """Return the rows, the heads of the cones, and the cones as constraints of SciPy; inequalities are ≥ 0."""
    C, d = program.C, program.d
    A, b = _independent_equations(program.A, program.b)
    found: list[dict[str, Any]] = [{"type": "eq", "fun": lambda x: A @ x - b, "jac": lambda _: A}]
    if len(d):
        found.append({"type": "ineq", "fun": lambda x: d - C @ x, "jac": lambda _: -C})
    if program.cones:
        parts = cone_parts(program)
        S, r = cone_heads(program)
        found.append({"type": "ineq", "fun": lambda x: r - S @ x, "jac": lambda _: -S})
        found.append({"type": "ineq", "fun": lambda x: _margins(parts, x), "jac": lambda x: _gradients(parts, x)})
    return found


def _independent_equations(A: Array, b: Array) -> tuple[Array, Array]:
    """Return the rows of A x = b without those that repeat others; all rows if they contradict one another."""
    _, R, order = linalg.qr(A.T, mode="economic", pivoting=True)
    sizes = np.abs(np.diag(R))
    kept = np.sort(order[: int((sizes > _DEPENDENT * sizes.max(initial=0.0)).sum())])
    x = np.linalg.lstsq(A[kept], b[kept], rcond=None)[0]
    consistent = np.allclose(A @ x, b, rtol=0.0, atol=1e-9 * max(1.0, float(np.abs(b).max())))
    return (A[kept], b[kept]) if consistent else (A, b)


def _margins(parts: list[tuple[Array, Array]], x: Array) -> Array:
    """Return t² − ‖v‖² of each cone."""
    values = (r - S @ x for S, r in parts)
    return np.array([v[0] ** 2 - v[1:] @ v[1:] for v in values])


def _gradients(parts: list[tuple[Array, Array]], x: Array) -> Array:
    """Return the gradients of `_margins`, one row for each cone."""
    rows = []
    for S, r in parts:
        v = r - S @ x
        rows.append(-2.0 * v[0] * S[0] + 2.0 * v[1:] @ S[1:])
    return np.array(rows)
