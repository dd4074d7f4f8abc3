"""ECOS: an interior-point method for second-order cones with a linear cost (Domahidi, Chu and Boyd 2013).

A quadratic cost becomes a cone: with P = L Lᵀ, ½‖Lᵀx‖² ≤ t is ‖(√2 Lᵀx, t − 1)‖ ≤ t + 1.
"""

from __future__ import annotations

from typing import Any

import ecos
import numpy as np
from scipy import sparse

from graspforce.bench.entrant import TOLERANCE, Claim, Entry, Said, claim
from graspforce.program import ConicProgram

PACKAGE = "ecos"
EXACT = True
WARM = False

_SAID = {0: Said.SOLVED, 10: Said.SOLVED, 1: Said.INFEASIBLE, 11: Said.INFEASIBLE}
_ROUNDING = 1e-14  # of the largest eigenvalue of P: less is zero


def bind(program: ConicProgram, settings: str) -> Entry:
    """The program with one more variable, t, where the cost is quadratic."""
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

    def read(answer: Any) -> Claim:
        info = answer["info"]
        said = _SAID.get(info["exitFlag"], Said.GAVE_UP)
        return claim(program, said, answer["x"][:m], -answer["y"], answer["z"][:i], info["iter"])

    return Entry(run, read)
