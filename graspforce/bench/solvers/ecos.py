"""ECOS: an interior-point method for second-order cones with a linear cost (Domahidi, Chu and Boyd 2013).

A quadratic cost is stated as a cone: with P = L Lᵀ, ½‖Lᵀx‖² ≤ t is equivalent to ‖(√2 Lᵀx, t − 1)‖ ≤ t + 1.
"""

from __future__ import annotations

from typing import Any

import ecos
import numpy as np
from scipy import sparse

from graspforce.bench.adapter import TOLERANCE, BoundSolver, SolverResult, SolverStatus, make_result
from graspforce.force.cone_program import ConicProgram

PACKAGE = "ecos"
EXACT_CONES = True
WARM_START = False

_STATUS = {0: SolverStatus.SOLVED, 10: SolverStatus.SOLVED, 1: SolverStatus.INFEASIBLE, 11: SolverStatus.INFEASIBLE}
_ROUNDING = 1e-14  # relative to the largest eigenvalue of P; smaller eigenvalues are taken as zero


def bind(program: ConicProgram, settings: str) -> BoundSolver:
    """Bind ECOS, with an extra variable t if the cost is quadratic.

    Args:
        program: program to solve.
        settings: accuracy settings, a key of `TOLERANCE`.
    """
    m, i = len(program.q), len(program.d)
    values, vectors = np.linalg.eigh(program.P)
    kept = values > _ROUNDING * max(float(values.max()), 1e-300)
    L = vectors[:, kept] * np.sqrt(values[kept])
    quadratic = int(L.shape[1] > 0)
    c = np.concatenate([program.q, np.ones(quadratic)])
    A = sparse.csc_matrix(np.pad(program.A, ((0, 0), (0, quadratic))))
    blocks, right, sizes = [np.pad(np.vstack([program.C, program.S]), ((0, 0), (0, quadratic)))], [program.d, program.r], []
    if quadratic:
        epigraph = np.zeros((L.shape[1] + 2, m + 1))
        epigraph[0, m], epigraph[1, m] = -1.0, -1.0
        epigraph[2:, :m] = -np.sqrt(2.0) * L.T
        blocks.append(epigraph)
        right.append(np.concatenate([[1.0, -1.0], np.zeros(L.shape[1])]))
        sizes.append(L.shape[1] + 2)
    G, h = sparse.csc_matrix(np.vstack(blocks)), np.concatenate(right)
    dims = {"l": i, "q": [*program.cones, *sizes]}
    tolerance = TOLERANCE[settings]
    options = {} if tolerance is None else dict.fromkeys(("abstol", "reltol", "feastol"), tolerance)

    def run(start: Any) -> Any:
        return ecos.solve(c, G, h, dims, A, program.b, verbose=False, **options)

    def read(output: Any) -> SolverResult:
        info = output["info"]
        status = _STATUS.get(info["exitFlag"], SolverStatus.NO_ANSWER)
        return make_result(program, status, output["x"][:m], -output["y"], output["z"][:i], info["iter"])

    return BoundSolver(run, read)
