"""Fingertip forces inside their friction cones with least motor torque, certified."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from graspforce.actuation import Actuation
from graspforce.batch import Stack, solve_batch, solve_stack
from graspforce.contact import Contact, ContactModel, ContactSet
from graspforce.errors import GraspForceError, InvalidInput
from graspforce.json_text import load
from graspforce.problem import Cone, ForceProblem, Objective
from graspforce.solution import Certificate, Infeasibility, Multipliers, Solution, Status
from graspforce.solve import Solver, solve, solvers

if TYPE_CHECKING:
    from graspforce import control, problems, service
    from graspforce.hand import Hand

__version__ = "0.1.0"

__all__ = [
    "Actuation",
    "Certificate",
    "Cone",
    "Contact",
    "ContactModel",
    "ContactSet",
    "ForceProblem",
    "GraspForceError",
    "Hand",
    "Infeasibility",
    "InvalidInput",
    "Multipliers",
    "Objective",
    "Solution",
    "Solver",
    "Stack",
    "Status",
    "control",
    "load",
    "problems",
    "service",
    "solve",
    "solve_batch",
    "solve_stack",
    "solvers",
]

# What brings Pinocchio or Zenoh is imported when it is first named: neither is needed to solve a problem.
_LATER = {
    "Hand": "graspforce.hand",
    "control": "graspforce.control",
    "problems": "graspforce.problems",
    "service": "graspforce.service",
}


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module 'graspforce' has no attribute {name!r}")
    module = importlib.import_module(_LATER[name])
    return module.Hand if name == "Hand" else module
