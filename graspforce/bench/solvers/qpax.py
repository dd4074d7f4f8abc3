"""qpax: a primal-dual interior-point method for quadratic programs in JAX (Tracy and Manchester 2024).

It computes in double precision, and with the settings "float32" in single precision, the default of JAX.

JAX compiles the solver once for each shape of the problem. Compilation is part of binding and not timed. Copies to and from
JAX's arrays are not timed either.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import jax
import numpy as np
import qpax

from graspforce.bench.adapter import TOLERANCE, BoundSolver, SolverResult, SolverStatus, make_result
from graspforce.force.cone_program import ConicProgram

PACKAGE = "qpax"
EXACT_CONES = False
WARM_START = False
FLOAT32 = True


def bind(program: ConicProgram, settings: str) -> BoundSolver:
    """Bind qpax, compiled for the shape of the problem.

    Args:
        program: program without second-order cones.
        settings: accuracy settings, a key of `TOLERANCE`.
    """
    parts = (program.P, program.q, program.A, program.b, program.C, program.d)
    double = settings != "float32"
    with jax.enable_x64(double):
        data = [jax.numpy.asarray(part, dtype=np.float64 if double else np.float32) for part in parts]
    solver = _compiled(tuple(part.shape for part in parts), TOLERANCE[settings], double)

    def run(start: Any) -> Any:
        with jax.enable_x64(double):
            return jax.block_until_ready(solver(*data))

    def read(output: Any) -> SolverResult:
        x, _, z, y, converged, iterations = output
        status = SolverStatus.SOLVED if int(converged) == 1 else SolverStatus.NO_ANSWER
        return make_result(program, status, x, -np.array(y), z, int(iterations))

    return BoundSolver(run, read)


@lru_cache(maxsize=512)  # shapes; the library has some hundreds
def _compiled(shapes: tuple[tuple[int, ...], ...], tolerance: float | None, double: bool) -> Any:
    """Return the solver, compiled for arrays of some shapes."""
    options = {} if tolerance is None else {"solver_tol": tolerance}
    with jax.enable_x64(double):
        arguments = [jax.ShapeDtypeStruct(shape, np.float64 if double else np.float32) for shape in shapes]
        return jax.jit(lambda *data: qpax.solve_qp(*data, **options)).lower(*arguments).compile()
