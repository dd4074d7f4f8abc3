"""Certificates that account for their own rounding, in C (``csrc/include/graspforce/rigorous.h``).

The data of the statement are the floats of the problem as they are stored: positions, contact frames, wrench, friction, limits,
Jacobian, torques and weights. The statement holds for these numbers in exact arithmetic.
"""

from __future__ import annotations

import contextlib
import importlib
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from graspforce.contact.contact import ContactModel
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import BackendError, UnsupportedProblem
from graspforce.core.json_text import JsonRecord
from graspforce.force.multipliers import Multipliers
from graspforce.force.problem import ForceProblem
from graspforce.force.scale import Scale

_certify: Any = None
with contextlib.suppress(ImportError):  # not built: no C compiler
    _certify = importlib.import_module("graspforce.force.backends._structured").certify_rigorously

OBJECTIVES = ("torque", "force", "sum_normal")
_COMPONENTS = {model: len(model.columns) for model in ContactModel}


@dataclass(frozen=True, eq=False, slots=True)
class ProvenBounds:
    """Numbers that hold in exact arithmetic.

    Args:
        violation: largest violation of the constraints by the forces, at most: forces over the force unit, moments over it
            times the length unit, torques over their units. 0 for a proof of infeasibility.
        gap: no forces within the reach that satisfy all constraints cost less than those of the solution by more than this,
            in the unit of the objective. 0 for a proof of infeasibility.
        reach: sum of the normal forces at contacts without max_normal up to which the statement holds, N; inf for all forces.
        distance: (N,) amount that moves each cone's multiplier into the dual cone along the normal, per N.
    """

    violation: float
    gap: float
    reach: float
    distance: Array

    def to_dict(self) -> JsonRecord:
        """Return the record; a reach without bound is null."""
        reach = self.reach if math.isfinite(self.reach) else None
        return {"violation": self.violation, "gap": self.gap, "reach": reach}


def bound_optimality(problem: ForceProblem, f: Array, multipliers: Multipliers, unit: Scale, reach: float) -> ProvenBounds:
    """Return bounds on the violation and the gap of forces that hold in exact arithmetic; not finite numbers prove nothing.

    Args:
        problem: the force problem, with exact cones and an objective of `OBJECTIVES`.
        f: (k,) stacked contact forces, N and N·m.
        multipliers: about any point; negative ones count as zero.
        unit: units of the violation.
        reach: sum of the normal forces at contacts without max_normal for which the bounds hold, N.

    Raises:
        UnsupportedProblem: another objective, or pyramids.
        BackendError: the C code was not built.
    """
    if problem.objective.type not in OBJECTIVES:
        raise UnsupportedProblem(f"rigorous certificates support {', '.join(OBJECTIVES)}, not {problem.objective.type}")
    _, violation, gap, _, reach, distance = _run(problem, f, multipliers, unit, reach)
    return ProvenBounds(violation, gap, reach, distance)


def prove_infeasibility(problem: ForceProblem, multipliers: Multipliers, unit: Scale) -> tuple[float, ProvenBounds] | None:
    """Return the least value of a proof over its largest term, and its reach, in exact arithmetic; None if it proves nothing.

    Args:
        problem: the force problem, with exact cones.
        multipliers: about any point; negative ones count as zero.
        unit: the units of the problem.

    Raises:
        UnsupportedProblem: pyramids.
        BackendError: the C code was not built.
    """
    proven, _, _, value, reach, distance = _run(problem, np.zeros(problem.size), multipliers, unit, None)
    return (value, ProvenBounds(0.0, 0.0, reach, distance)) if proven else None


def _run(
    problem: ForceProblem, f: Array, m: Multipliers, unit: Scale, reach: float | None
) -> tuple[bool, float, float, float, float, Array]:
    """Return whether the statement is proven, violation, gap, value, reach and distances. No reach asks for infeasibility."""
    if problem.cone.type != "exact":
        raise UnsupportedProblem("rigorous certificates support exact cones, not pyramids")
    if _certify is None:
        raise BackendError("rigorous certificates are not available: graspforce was installed without a C compiler")
    c, actuation, objective = problem.contacts, problem.actuation, problem.objective
    n = 0 if actuation is None else len(actuation.tau_u)
    none = np.zeros(0)
    hand = (none, none, none, none, none)
    if actuation is not None:
        weight = actuation.weight if objective.type == "torque" else np.zeros(n)
        hand = (actuation.J, actuation.tau_u, actuation.lower, actuation.upper, weight)
    cost = None
    if objective.type == "sum_normal":
        cost = np.zeros(problem.size)
        cost[c.normal_rows] = 1.0
    force_weight = 1.0 if objective.type == "force" else objective.force_weight
    components = np.array([_COMPONENTS[model] for model in c.models], dtype=np.intc)
    units, distance = np.array([unit.force, unit.length, reach or 0.0]), np.zeros(len(c))
    limits = (m.normal_lower, m.normal_upper, m.torque_lower, m.torque_upper)
    contacts = (c.p_OC, c.R_OC, m.point, problem.w, c.mu, c.gamma, c.min_normal, c.max_normal)
    numbers = (units, *contacts, *hand, cost, f, m.y, *limits, unit.torque, np.zeros(4 * n), distance)
    proven, *bounds = _certify(components, reach is None, force_weight, objective.moment_length, *numbers)
    violation, gap, value, proven_reach = bounds
    return bool(proven), violation, gap, value, proven_reach, arrays.freeze(distance)
