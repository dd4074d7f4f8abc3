"""Contact forces and motor torques of multi-finger hands: minimum torque, exact friction cones, certified.

`import graspforce` loads only NumPy. Solvers, hands, control, planning and the service are loaded at first use. So are the
adapters `graspforce.torch` and `graspforce.jax`, which need their extras.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from graspforce.core.lazy import lazy_exports
from graspforce.core.optional_libraries import optional_imports

if TYPE_CHECKING:
    from graspforce import control, planning, problems, service, simulation, view
    from graspforce.analysis.explain import Explanation, explain
    from graspforce.analysis.quality import Quality, quality
    from graspforce.analysis.sensitivity import Sensitivities, sensitivities
    from graspforce.analysis.solve_many import solve_many
    from graspforce.contact.contact import Contact, ContactModel, ContactSet
    from graspforce.control.object_controller import ObjectController
    from graspforce.core.c_sources import get_cmake_dir, get_include
    from graspforce.core.errors import GraspForceError, InvalidInput
    from graspforce.force.backends.protocol import SolverSettings
    from graspforce.force.backends.registry import available_backends
    from graspforce.force.batch import solve_batch
    from graspforce.force.certificate import Certificate
    from graspforce.force.infeasibility import Infeasibility
    from graspforce.force.multipliers import Multipliers
    from graspforce.force.problem import ForceProblem
    from graspforce.force.problem_file import load
    from graspforce.force.problem_options import Cone, Objective
    from graspforce.force.solution import Solution
    from graspforce.force.solver import Solver, solve
    from graspforce.force.stack import StackedGradients, StackedSolutions, solve_stack
    from graspforce.force.status import Status
    from graspforce.force.uncertainty import Uncertainty
    from graspforce.grasp.body import Body
    from graspforce.grasp.grasp import Grasp
    from graspforce.grasp.search.search import find_grasp
    from graspforce.hand.actuation import Actuation
    from graspforce.hand.hand import Hand

__version__ = "0.2.0"

__all__ = [
    "Actuation",
    "Body",
    "Certificate",
    "Cone",
    "Contact",
    "ContactModel",
    "ContactSet",
    "Explanation",
    "ForceProblem",
    "Grasp",
    "GraspForceError",
    "Hand",
    "Infeasibility",
    "InvalidInput",
    "Multipliers",
    "ObjectController",
    "Objective",
    "Quality",
    "Sensitivities",
    "Solution",
    "Solver",
    "SolverSettings",
    "StackedGradients",
    "StackedSolutions",
    "Status",
    "Uncertainty",
    "available_backends",
    "control",
    "explain",
    "find_grasp",
    "get_cmake_dir",
    "get_include",
    "load",
    "planning",
    "problems",
    "quality",
    "sensitivities",
    "service",
    "simulation",
    "solve",
    "solve_batch",
    "solve_many",
    "solve_stack",
    "view",
]

_ADAPTERS = {"torch": "graspforce.analysis.torch_adapter", "jax": "graspforce.analysis.jax_adapter"}  # need their extras
_SUBPACKAGES = ("control", "planning", "problems", "service", "simulation", "view")
_object = lazy_exports(
    __name__,
    {
        **dict.fromkeys(("Explanation", "explain"), "graspforce.analysis.explain"),
        **dict.fromkeys(("Quality", "quality"), "graspforce.analysis.quality"),
        **dict.fromkeys(("Sensitivities", "sensitivities"), "graspforce.analysis.sensitivity"),
        "solve_many": "graspforce.analysis.solve_many",
        **dict.fromkeys(("Contact", "ContactModel", "ContactSet"), "graspforce.contact.contact"),
        "ObjectController": "graspforce.control.object_controller",
        **dict.fromkeys(("get_cmake_dir", "get_include"), "graspforce.core.c_sources"),
        **dict.fromkeys(("GraspForceError", "InvalidInput"), "graspforce.core.errors"),
        "SolverSettings": "graspforce.force.backends.protocol",
        "available_backends": "graspforce.force.backends.registry",
        **dict.fromkeys(("StackedGradients", "StackedSolutions", "solve_stack"), "graspforce.force.stack"),
        "solve_batch": "graspforce.force.batch",
        **dict.fromkeys(("Cone", "Objective"), "graspforce.force.problem_options"),
        "ForceProblem": "graspforce.force.problem",
        "load": "graspforce.force.problem_file",
        "Certificate": "graspforce.force.certificate",
        "Infeasibility": "graspforce.force.infeasibility",
        "Multipliers": "graspforce.force.multipliers",
        "Solution": "graspforce.force.solution",
        **dict.fromkeys(("Solver", "solve"), "graspforce.force.solver"),
        "Status": "graspforce.force.status",
        "Uncertainty": "graspforce.force.uncertainty",
        "Body": "graspforce.grasp.body",
        "Grasp": "graspforce.grasp.grasp",
        "find_grasp": "graspforce.grasp.search.search",
        "Actuation": "graspforce.hand.actuation",
        "Hand": "graspforce.hand.hand",
    },
)


def __getattr__(name: str) -> Any:
    if name in _ADAPTERS:
        return importlib.import_module(_ADAPTERS[name])
    if name not in _SUBPACKAGES:
        return _object(name)
    with optional_imports():
        return importlib.import_module(f"graspforce.{name}")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
