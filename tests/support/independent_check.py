"""A certificate that shares no formula with the package: violations, and the dual objective, contact by contact in SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from graspforce import Contact, ForceProblem, Multipliers


@dataclass
class IndependentCheck:
    """Violations in SI units, and the cost beside its lower bound by the dual objective."""

    equilibrium: float = 0.0  # N, N·m
    cone: float = 0.0  # N
    limits: float = 0.0  # N, N·m
    wrong_signs: float = 0.0
    dual_cone: float = 0.0
    cost: float = 0.0
    bound: float = 0.0


@dataclass
class _Sums:
    """What the contacts add up to."""

    wrench: np.ndarray = field(default_factory=lambda: np.zeros(6))
    normals: list[float] = field(default_factory=list)
    margins: list[float] = field(default_factory=list)
    level_weight: float = 0.0  # Σ z_n/μ


def independent_check(problem: ForceProblem, f: np.ndarray, m: Multipliers) -> IndependentCheck:
    """Return violations by scalar loops, and the lower bound on the cost by the dual objective.

    For the cost ½ tauᵀW tau + ½ρ‖f‖² the dual objective at stationarity is
    ½ tau_uᵀW tau_u − ½ (Jᵀf)ᵀW(Jᵀf) − ½ρ‖f‖² + yᵀw + Σ multiplier · limit. For linear costs the first three terms are absent.
    """
    m, sums = m.about(np.zeros(3)), _Sums()
    actuation, first = problem.actuation, 0
    limits = (m.normal_lower, m.normal_upper, m.torque_lower, m.torque_upper)
    check = IndependentCheck(wrong_signs=-min(*(part.min(initial=0.0) for part in limits), 0.0))
    check.bound = float(m.y @ problem.w)
    tau = None if actuation is None else actuation.tau_u + actuation.J.T @ f
    z = _stationarity(problem, f, tau, m)
    for i, contact in enumerate(problem.contacts.contacts):
        n = {"frictionless": 1, "point": 3, "soft": 4}[contact.model.value]
        _add_contact(check, sums, problem, contact, (f[first : first + n], z[first : first + n]))
        _add_normal_limits(check, contact, sums.normals[-1], (m.normal_lower[i], m.normal_upper[i]))
        first += n
    if actuation is not None:
        _add_torque_limits(check, problem, tau, m)
    check.equilibrium = float(np.abs(sums.wrench - problem.w).max())
    _add_cost(check, sums, problem, (f, tau), m)
    return check


def _stationarity(problem: ForceProblem, f: np.ndarray, tau: np.ndarray | None, m: Multipliers) -> np.ndarray:
    """Return (k,) the multipliers of the cones: z = ∇cost − Gᵀ y − E ν − J λ."""
    kind, actuation, normal_rows = problem.objective.type, problem.actuation, problem.contacts.normal_rows
    z = -(m.y @ problem.G)
    if actuation is not None:
        z -= actuation.J @ (m.torque_lower - m.torque_upper)
    if kind == "torque":
        z += actuation.J @ (actuation.weight * tau) + problem.objective.force_weight * f
    if kind == "force":
        z += f
    z[normal_rows] -= m.normal_lower - m.normal_upper
    if kind == "sum_normal":
        z[normal_rows] += 1.0
    if kind == "max_normal":
        z[normal_rows] += m.level
    return z


def _add_contact(
    check: IndependentCheck, sums: _Sums, problem: ForceProblem, contact: Contact, parts: tuple[np.ndarray, np.ndarray]
) -> None:
    """Add a contact's wrench, and the violations of its cone by its force and by its multipliers."""
    n = len(parts[0])
    (t1, t2, fn, mn), (z1, z2, zn, zm) = (
        (0.0, 0.0, part[0], 0.0) if n == 1 else (*part, 0.0) if n == 3 else tuple(part) for part in parts
    )
    axes = contact.R_OC
    force = axes @ np.array([t1, t2, fn])
    sums.wrench[:3] += force
    sums.wrench[3:] += np.cross(contact.position, force) + mn * axes[:, 2]
    sums.normals.append(fn)
    if n == 1:
        check.cone, check.dual_cone = max(check.cone, -fn), max(check.dual_cone, -zn)
        return
    mu, gamma = contact.friction, contact.torsional_friction if n == 4 else 0.0
    edges, facet_mu = pyramid_edges(problem, mu, gamma)
    if edges is None:
        margin = mu * (fn - math.hypot(t1 / mu, t2 / mu, mn / gamma if gamma else 0.0))
        outside = math.hypot(mu * z1, mu * z2, gamma * zm) - zn
    else:
        margin = _facet_margin(problem, (t1, t2, fn, mn), facet_mu, gamma)
        outside = max(-(z1 * a + z2 * b + zn + zm * c) for a, b, c in edges)
    sums.margins.append(margin)
    sums.level_weight += zn / facet_mu
    check.cone, check.dual_cone = max(check.cone, -margin), max(check.dual_cone, outside)


def _add_normal_limits(check: IndependentCheck, contact: Contact, fn: float, multipliers: tuple[float, float]) -> None:
    """Add the violation of a contact's limits, and their part of the bound."""
    lower, upper = multipliers
    check.limits = max(check.limits, contact.min_normal - fn)
    check.bound += lower * contact.min_normal
    if contact.max_normal is not None:
        check.limits = max(check.limits, fn - contact.max_normal)
        check.bound -= upper * contact.max_normal
    else:
        check.wrong_signs = max(check.wrong_signs, abs(upper))


def _add_torque_limits(check: IndependentCheck, problem: ForceProblem, tau: np.ndarray, m: Multipliers) -> None:
    """Add the violation of the torque limits, and their part of the bound."""
    actuation = problem.actuation
    for j in range(len(tau)):
        for side, limit, multiplier in (
            (1, actuation.lower[j], m.torque_lower[j]),
            (-1, actuation.upper[j], m.torque_upper[j]),
        ):
            if math.isinf(limit):
                check.wrong_signs = max(check.wrong_signs, abs(multiplier))
                continue
            check.limits = max(check.limits, side * (limit - tau[j]))
            check.bound += side * multiplier * (limit - actuation.tau_u[j])


def _add_cost(
    check: IndependentCheck,
    sums: _Sums,
    problem: ForceProblem,
    values: tuple[np.ndarray, np.ndarray | None],
    m: Multipliers,
) -> None:
    """Set the cost, add its part of the bound, and check the multipliers of the level."""
    actuation, kind, (f, tau) = problem.actuation, problem.objective.type, values
    if kind == "torque":
        rho, load = problem.objective.force_weight, tau - actuation.tau_u
        check.cost = 0.5 * sum(w * t * t for w, t in zip(actuation.weight, tau, strict=True)) + 0.5 * rho * sum(
            x * x for x in f
        )
        check.bound += 0.5 * float(actuation.tau_u @ (actuation.weight * actuation.tau_u))
        check.bound -= 0.5 * float(load @ (actuation.weight * load) + rho * f @ f)
    elif kind == "force":
        check.cost = 0.5 * math.fsum(x * x for x in f)
        check.bound -= 0.5 * float(f @ f)
    elif kind == "max_normal":
        check.cost = max(sums.normals)
        check.wrong_signs = max(check.wrong_signs, abs(float(m.level.sum()) - 1.0), -float(m.level.min()))
    elif kind == "sum_normal":
        check.cost = math.fsum(sums.normals)
    else:
        check.cost = -min(sums.margins)
        check.wrong_signs = max(check.wrong_signs, 1.0 - sums.level_weight)  # s ≥ 0 has the multiplier Σ z_n/μ − 1


def pyramid_edges(problem: ForceProblem, mu: float, gamma: float) -> tuple[list[tuple[float, float, float]] | None, float]:
    """Return the edges (t1, t2, m) at f_n = 1, as corners of the facets' polygon, and the friction of the facets.

    The edges are None for an exact cone and without friction.
    """
    cone = problem.cone
    if cone.type == "exact" or mu == 0.0:
        return None, mu
    facet = mu * math.cos(math.pi / cone.facets) if cone.side == "inner" else mu
    corner_radius = facet / math.cos(math.pi / cone.facets)
    angles = [(2 * k + 1) * math.pi / cone.facets for k in range(cone.facets)]
    ring = [(corner_radius * math.cos(a), corner_radius * math.sin(a)) for a in angles]
    if gamma == 0.0:
        return [(a, b, 0.0) for a, b in ring], facet
    if cone.side == "inner":
        return [(a, b, 0.0) for a, b in ring] + [(0.0, 0.0, gamma), (0.0, 0.0, -gamma)], facet
    return [(a, b, c) for a, b in ring for c in (gamma, -gamma)], facet


def _facet_margin(problem: ForceProblem, force: tuple[float, float, float, float], facet_mu: float, gamma: float) -> float:
    """Return the slip margin in a pyramid: the distance from its nearest facet, N."""
    (t1, t2, fn, mn), count = force, problem.cone.facets
    tangential = max(t1 * math.cos(2 * math.pi * k / count) + t2 * math.sin(2 * math.pi * k / count) for k in range(count))
    moment = abs(mn) * facet_mu / gamma if gamma else 0.0
    return facet_mu * fn - (tangential + moment if problem.cone.side == "inner" else max(tangential, moment))
