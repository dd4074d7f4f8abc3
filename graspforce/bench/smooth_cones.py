"""Second-order cones as smooth inequalities, for solvers of nonlinear programs.

(t, v) is in the cone iff t ≥ 0 and t² − ‖v‖² ≥ 0. Both are smooth, also at the apex, where the gradient of the second is zero.
A start at the apex therefore gives a solver no information; `interior_start` returns another one.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from graspforce.core.arrays import Array
from graspforce.force.cone_program import ConicProgram


def cone_parts(program: ConicProgram) -> list[tuple[Array, Array]]:
    """Return S and r of each cone: (size, m) and (size,).

    Args:
        program: the program.
    """
    heads = np.cumsum([0, *program.cones])
    return [(program.S[i:j], program.r[i:j]) for i, j in pairwise(heads)]


def cone_heads(program: ConicProgram) -> tuple[Array, Array]:
    """Return the rows of t in t = r − S x of every cone: (n, m) and (n,).

    Args:
        program: the program.
    """
    first = np.cumsum([0, *program.cones])[:-1]
    return program.S[first], program.r[first]


def interior_start(program: ConicProgram) -> Array:
    """Return (m,) variables with (t, v) close to (1, 0) in each cone, zero without cones.

    Args:
        program: the program.
    """
    if not program.cones:
        return np.zeros(len(program.q))
    inside = np.zeros(len(program.r))
    inside[np.cumsum([0, *program.cones])[:-1]] = 1.0
    return np.asarray(np.linalg.lstsq(program.S, program.r - inside, rcond=None)[0])
