"""qpOASES: a parametric active-set method (Ferreau, Kirches, Potschka, Bock and Diehl 2014), called through CasADi."""

from __future__ import annotations

from graspforce.bench import casadi_adapter
from graspforce.bench.adapter import BoundSolver
from graspforce.force.cone_program import ConicProgram

PACKAGE = "casadi"
EXACT_CONES = False
WARM_START = True

_OPTIONS = {
    "enableEqualities": True,
    "initialStatusBounds": "inactive",
}  # no bound is active initially: the variables have none
_INFEASIBLE = (
    "Initial QP could not be solved due to infeasibility!",
    "QP not solved due to infeasibility",
    "QP problem is infeasible",
)


def bind(program: ConicProgram, settings: str) -> BoundSolver:
    """Bind the dense solver of qpOASES, without output.

    Args:
        program: program without second-order cones.
        settings: ignored; the default tolerances of qpOASES are those of an exact method, about 1e-9.
    """
    return casadi_adapter.bind(program, "qpoases", {"printLevel": "none", **_OPTIONS}, _INFEASIBLE)
