"""ProxQP asked, by its primal_infeasibility_solving, for the nearest problem with an answer where its own has none.

Its dense solver often does not end then, whatever the tolerances; `benchmarks/proxqp_infeasible.py` tries more ways.
"""

from __future__ import annotations

from typing import Any

from proxsuite import proxqp

from graspforce.bench.entrant import Claim, Entry, Said
from graspforce.bench.solvers.proxqp import bind as bind_as_it_is
from graspforce.program import ConicProgram

PACKAGE = "proxsuite"
EXACT = False
WARM = False

_NEAREST = proxqp.QPSolverOutput.PROXQP_SOLVED_CLOSEST_PRIMAL_FEASIBLE


def bind(program: ConicProgram, settings: str) -> Entry:
    """As ProxQP's own entry, with one more setting."""
    entry = bind_as_it_is(program, settings, nearest=True)

    def read(qp: Any) -> Claim:
        if qp.results.info.status == _NEAREST:
            return Claim(Said.INFEASIBLE, None, None, int(qp.results.info.iter))
        return entry.read(qp)

    return Entry(entry.run, read)
