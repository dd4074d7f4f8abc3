"""qpOASES: a parametric active-set method (Ferreau, Kirches, Potschka, Bock and Diehl 2014), by way of CasADi."""

from __future__ import annotations

from graspforce.bench import casadi_conic
from graspforce.bench.entrant import Entry
from graspforce.program import ConicProgram

PACKAGE = "casadi"
EXACT = False
WARM = True

_SHAPE = {"enableEqualities": True, "initialStatusBounds": "inactive"}  # what it is not told it guesses: no variable has bounds
_INFEASIBLE = (
    "Initial QP could not be solved due to infeasibility!",
    "QP not solved due to infeasibility",
    "QP problem is infeasible",
)


def bind(program: ConicProgram, settings: str) -> Entry:
    """Its dense solver, silent."""
    return casadi_conic.bind(program, "qpoases", {"printLevel": "none", **_SHAPE}, _INFEASIBLE)
