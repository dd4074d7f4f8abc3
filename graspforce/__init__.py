"""Fingertip forces inside their friction cones with least motor torque, certified."""

from graspforce.actuation import Actuation
from graspforce.contact import Contact, ContactModel, ContactSet
from graspforce.errors import GraspForceError, InvalidInput
from graspforce.json_text import load
from graspforce.problem import Cone, ForceProblem, Objective
from graspforce.solution import Certificate, Infeasibility, Multipliers, Solution, Status
from graspforce.solve import Solver, backends, solve

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
    "Infeasibility",
    "InvalidInput",
    "Multipliers",
    "Objective",
    "Solution",
    "Solver",
    "Status",
    "backends",
    "load",
    "solve",
]
