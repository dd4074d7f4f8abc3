"""Fingertip forces inside their friction cones with least motor torque, certified."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from graspforce.contact.contact import Contact, ContactModel, ContactSet
from graspforce.core.errors import GraspForceError, InvalidInput
from graspforce.force.batch import StackedSolutions, solve_batch, solve_stack
from graspforce.force.problem import Cone, ForceProblem, Objective
from graspforce.force.problem_file import load
from graspforce.force.solution import Certificate, Infeasibility, Multipliers, Solution, Status
from graspforce.force.solver import Solver, available_backends, solve
from graspforce.hand.actuation import Actuation

if TYPE_CHECKING:
    from graspforce import control, problems, service
    from graspforce.hand.hand import Hand

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
    "StackedSolutions",
    "Status",
    "available_backends",
    "control",
    "load",
    "problems",
    "service",
    "solve",
    "solve_batch",
    "solve_stack",
]

# What brings Pinocchio or Zenoh is imported when it is first named: neither is needed to solve a problem.
_LATER = {
    "Hand": "graspforce.hand.hand",
    "control": "graspforce.control",
    "problems": "graspforce.problems",
    "service": "graspforce.service",
}


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module 'graspforce' has no attribute {name!r}")
    module = importlib.import_module(_LATER[name])
    return module.Hand if name == "Hand" else module
