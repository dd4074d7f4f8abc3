"""QRQP: CasADi's own active-set method on sparse QR factors (Andersson and Rawlings 2018)."""

from __future__ import annotations

from graspforce.bench import casadi_adapter
from graspforce.bench.adapter import BoundSolver
from graspforce.force.cone_program import ConicProgram

PACKAGE = "casadi"
EXACT_CONES = False
WARM_START = True


def bind(program: ConicProgram, settings: str) -> BoundSolver:
    """Bind QRQP, without output.

    Args:
        program: program without second-order cones.
        settings: ignored; the default tolerances of QRQP are those of an exact method, 1e-8 or less.
    """
    return casadi_adapter.bind(program, "qrqp", {"print_iter": False, "print_header": False, "print_info": False})
