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

from graspforce.contact import friction
from graspforce.contact.contact import ContactModel
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import BackendError
from graspforce.core.json_text import JsonRecord
from graspforce.force.multipliers import Multipliers
from graspforce.force.problem import ForceProblem
from graspforce.force.scale import Scale

_certify: Any = None
with contextlib.suppress(ImportError):  # not built: no C compiler
    _certify = importlib.import_module("graspforce.force.backends._structured").certify_rigorously

_COMPONENTS = {model: len(model.columns) for model in ContactModel}


@dataclass(frozen=True, eq=False, slots=True)
class ProvenBounds:
    """Numbers that hold in exact arithmetic.

    Args:
        violation: largest violation of the constraints by the forces, at most: forces over the force unit, moments over it
            times the length unit, torques over their units. 0 for a proof of infeasibility.
        gap: no forces within the reach that satisfy all constraints cost less than those of the solution by more than this,
            in the unit of the objective; none have a larger slip margin than ``slip_margin`` by more. 0 for a proof of
            infeasibility.
        reach: sum of the normal forces at contacts without max_normal up to which the statement holds, N; inf for all forces.
        distance: (N,) amount that moves each cone's multiplier into the dual cone along the normal, per N.
        slip_margin: slip margin of the forces for the objective "margin", N: the violation counts cones that are smaller by it.
    """

    violation: float
    gap: float
    reach: float
    distance: Array
    slip_margin: float | None = None

    def to_dict(self) -> JsonRecord:
        """Return the record; a reach without bound is null."""
        reach = self.reach if math.isfinite(self.reach) else None
        record: JsonRecord = {"violation": self.violation, "gap": self.gap, "reach": reach}
        return record if self.slip_margin is None else {**record, "slip_margin": self.slip_margin}


def bound_optimality(problem: ForceProblem, f: Array, multipliers: Multipliers, unit: Scale, reach: float) -> ProvenBounds:
    """Return bounds on the violation and the gap of forces that hold in exact arithmetic; not finite numbers prove nothing.

    Args:
        problem: the force problem.
        f: (k,) stacked contact forces, N and N·m.
        multipliers: about any point; negative ones count as zero.
        unit: units of the violation.
        reach: sum of the normal forces at contacts without max_normal for which the bounds hold, N.

    Raises:
        BackendError: the C code was not built.
    """
    _, violation, gap, _, reach, distance = _run(problem, f, multipliers, unit, reach)
    slip_margin = problem.cost(f) if problem.objective.type == "margin" else None
    return ProvenBounds(violation, gap, reach, distance, slip_margin)


def prove_infeasibility(problem: ForceProblem, multipliers: Multipliers, unit: Scale) -> tuple[float, ProvenBounds] | None:
    """Return the least value of a proof over its largest term, and its reach, in exact arithmetic; None if it proves nothing.

    Args:
        problem: the force problem.
        multipliers: about any point; negative ones count as zero.
        unit: the units of the problem.

    Raises:
        BackendError: the C code was not built.
    """
    proven, _, _, value, reach, distance = _run(problem, np.zeros(problem.size), multipliers, unit, None)
    return (value, ProvenBounds(0.0, 0.0, reach, distance)) if proven else None


def used_level(multipliers: Multipliers) -> Array:
    """Return the (N,) level of the objective "max_normal" with a sum of at most 1 in exact arithmetic.

    Args:
        multipliers: those of a solution.
    """
    level = np.maximum(multipliers.level, 0.0)
    total = float(level.sum())
    return level * ((1.0 - 4.0 * len(level) * np.finfo(float).eps) / total) if total > 0.0 else level


def pyramid_vertices(problem: ForceProblem) -> list[Array]:
    """Return the (m, 2) tangential forces of each contact's pyramid edges at f_n = 1, counterclockwise; none for exact cones.

    The proven statement is about the cones over these polygons. Soft contacts share f_n with the moment in inner pyramids.

    Args:
        problem: the force problem.
    """
    c, cone = problem.contacts, problem.cone
    if cone.type == "exact":
        return [np.zeros((0, 2))] * len(c)
    rays = friction.pyramid_rays(cone.facets, cone.side, 1.0, 0.0)[:, :2]
    return [rays * mu if mu > 0.0 else np.zeros((0, 2)) for mu in c.mu.tolist()]


def facet_friction(problem: ForceProblem) -> Array:
    """Return the (N,) facet friction μ' of the slip margin; 0 without friction.

    Args:
        problem: the force problem.
    """
    mu, cone = problem.contacts.mu, problem.cone
    return mu if cone.type == "exact" else friction.pyramid_friction(mu, cone.facets, cone.side)


def _run(
    problem: ForceProblem, f: Array, m: Multipliers, unit: Scale, reach: float | None
) -> tuple[bool, float, float, float, float, Array]:
    """Return whether the statement is proven, violation, gap, value, reach and distances. No reach asks for infeasibility."""
    if _certify is None:
        raise BackendError("rigorous certificates are not available: graspforce was installed without a C compiler")
    c, actuation, objective = problem.contacts, problem.actuation, problem.objective
    kind, n = objective.type, 0 if actuation is None else len(actuation.tau_u)
    none = np.zeros(0)
    hand = (none, none, none, none, none)
    if actuation is not None:
        weight = actuation.weight if kind == "torque" else np.zeros(n)
        hand = (actuation.J, actuation.tau_u, actuation.lower, actuation.upper, weight)
    cost = level = facets = vertices = vertex = None
    if kind in ("sum_normal", "max_normal"):
        cost, level = np.zeros(problem.size), used_level(m) if kind == "max_normal" else None
        cost[c.normal_rows] = 1.0 if level is None else level
    if problem.cone.type != "exact":
        polygons = pyramid_vertices(problem)
        vertices, vertex = np.array([len(each) for each in polygons], dtype=np.intc), np.concatenate(polygons)
    slip_margin = 0.0
    if kind == "margin" and reach is not None:
        facets, slip_margin = facet_friction(problem), problem.cost(f)
    force_weight = 1.0 if kind == "force" else objective.force_weight
    components = np.array([_COMPONENTS[model] for model in c.models], dtype=np.intc)
    units, distance = np.array([unit.force, unit.length, reach or 0.0]), np.zeros(len(c))
    limits = (m.normal_lower, m.normal_upper, m.torque_lower, m.torque_upper)
    contacts = (c.p_OC, c.R_OC, m.point, problem.w, c.mu, c.gamma, c.min_normal, c.max_normal)
    numbers = (units, *contacts, *hand, cost, f, m.y, *limits, unit.torque, vertex, level, facets, np.zeros(4 * n), distance)
    scalars = (reach is None, force_weight, objective.moment_length)
    cones = (vertices, problem.cone.side == "outer", slip_margin)
    proven, *bounds = _certify(components, *scalars, *cones, *numbers)
    violation, gap, value, proven_reach = bounds
    return bool(proven), violation, gap, value, proven_reach, arrays.freeze(distance)
