"""HPIPM: an interior-point method for optimal control (Frison and Diehl 2020), called through CasADi with a single stage."""

from __future__ import annotations

from graspforce.bench import casadi_adapter
from graspforce.bench.adapter import TOLERANCE, BoundSolver
from graspforce.force.cone_program import ConicProgram

PACKAGE = "casadi"
EXACT_CONES = False
WARM_START = False


def bind(program: ConicProgram, settings: str) -> BoundSolver:
    """Bind HPIPM: all variables are the state of the first stage, and the second stage is empty.

    A force problem has no stages in time; the interface for optimal control then permits this form only. The tolerances are
    those of HPIPM's four residuals; its other options keep their defaults in CasADi.

    Args:
        program: program without second-order cones.
        settings: accuracy settings, a key of `TOLERANCE`.
    """
    rows, m, tolerance = len(program.b) + len(program.d), len(program.q), TOLERANCE[settings]
    stages = {"N": 1, "nx": [m, 0], "nu": [0, 0], "ng": [rows, 0]}
    names = ("res_g_max", "res_b_max", "res_d_max", "res_m_max")
    options = {} if tolerance is None else {"hpipm": dict.fromkeys(names, tolerance)}
    return casadi_adapter.bind(program, "hpipm", {**stages, **options})
