"""QRQP: CasADi's own active-set method on sparse QR factors (Andersson and Rawlings 2018)."""

from __future__ import annotations

from graspforce.bench import casadi_conic
from graspforce.bench.entrant import Entry
from graspforce.program import ConicProgram

PACKAGE = "casadi"
EXACT = False
WARM = True


def bind(program: ConicProgram, settings: str) -> Entry:
    """Silent."""
    return casadi_conic.bind(program, "qrqp", {"print_iter": False, "print_header": False, "print_info": False})
