"""The project's own kernel (`graspforce.backends.structured`), packing of its arrays included in its time."""

from __future__ import annotations

from typing import Any

from graspforce.backends import structured
from graspforce.bench.entrant import Claim, Entry, Said
from graspforce.program import ConicProgram
from graspforce.solution import Solution, Status

PACKAGE = "graspforce"
EXACT = True
WARM = True

if not structured.available():
    raise ImportError("the structured kernel was not built")

_SAID = {Status.OPTIMAL: Said.SOLVED, Status.INACCURATE: Said.SOLVED, Status.INFEASIBLE: Said.INFEASIBLE}


def bind(program: ConicProgram, settings: str) -> Entry:
    """It works on the force problem itself, not on the cone program."""
    problem = program.problem

    def run(start: Any) -> Solution:
        return structured.solve(problem, start)

    def read(answer: Solution) -> Claim:
        said = _SAID.get(answer.status, Said.GAVE_UP)
        return Claim(said, answer.f if said is Said.SOLVED else None, answer.multipliers, answer.iterations)

    return Entry(run, read)
