"""Proof of optimality or infeasibility, from a problem and numbers alone. It trusts no solver and knows none.

Optimality. For multipliers with the right signs the Lagrangian bounds every feasible cost from below. Given y and the limits'
multipliers, the cones' multipliers z follow from stationarity, so the Lagrangian is least at f itself and

    cost(f) − least cost ≤ gap = yᵀ(G f − w) + Σ zᵀf + Σ multiplier · slack,    if z is in K* and all multipliers are ≥ 0.

What is checked is therefore feasibility, signs, z in K*, and the gap. Boyd and Vandenberghe, Convex Optimization, 5.9.

Infeasibility. If Gᵀ y + z + E (ν_lower − ν_upper) + J (λ_lower − λ_upper) = 0 with the same signs, every feasible f has

    0 ≥ value = yᵀw + ν_lowerᵀ min − ν_upperᵀ max + λ_lowerᵀ(lower − tau_u) − λ_upperᵀ(upper − tau_u),

so value > 0 proves that there is none. Rounding leaves z a little outside K*: where a contact's normal force is bounded, its
ν_upper takes that up and the proof stays exact; where it is not, the proof covers all forces up to value/distance, which must
lie beyond every force that could be needed (`_required_range`) to count.

Scales. Residuals are relative to the problem's own units, which `scale.py` defines; equilibrium is taken about the contacts'
centroid, so that it does not matter where O stands.
"""

from __future__ import annotations

import numpy as np

from graspforce.contact import friction
from graspforce.core.arrays import Array
from graspforce.force.problem import ForceProblem
from graspforce.force.scale import Scale, scale
from graspforce.force.solution import Certificate, InfeasibilityProof, Multipliers

# An unbounded contact's proof must cover forces up to so many force units, and up to so many times what presses the smoothest
# contact until it bears the force unit: no hand reaches them.
_PROOF_RANGE = 1e6
_PROOF_RANGE_FRICTION = 1e3
_ROUNDING = 8.0 * float(np.finfo(float).eps)  # of a number that a few operations made, relative to what went into it


def certify(problem: ForceProblem, f: Array, multipliers: Multipliers) -> Certificate:
    """How well forces and multipliers prove each other optimal.

    Args:
        problem: the problem.
        f: (k,) stacked contact forces, N and N·m.
        multipliers: of equilibrium and limits; z is computed here.

    Returns:
        Verified at `TIGHT_TOLERANCE`, else at `LOOSE_TOLERANCE`, else not verified (and then with the tolerance
        `LOOSE_TOLERANCE`).
    """
    with np.errstate(all="ignore"):  # numbers of a solver that went astray may be anything
        unit = scale(problem)
        primal = _primal_residual(problem, f, unit)
        dual, gap = _dual_residual_and_gap(problem, f, multipliers, unit)
    if not np.isfinite([primal, dual, gap]).all():
        huge = float(np.finfo(float).max)  # a number that every record can carry
        primal, dual, gap = (x if np.isfinite(x) else huge for x in (primal, dual, gap))
    return Certificate.from_residuals(primal, dual, gap)


def _primal_residual(problem: ForceProblem, f: Array, unit: Scale) -> float:
    """The largest violation of equilibrium, cones, normal forces and torques, each over its unit."""
    contacts, actuation = problem.contacts, problem.actuation
    error = _equilibrium_error(problem, f)  # N, N·m
    padded = contacts.pad(f)
    normals = padded[:, friction.F_N]  # N
    parts = [
        np.abs(error[:3]) / unit.force,
        np.abs(error[3:]) / (unit.force * unit.length),
        _cone_violations(problem, f) / unit.force,
        np.maximum(contacts.min_normal - normals, 0.0) / unit.force,
        np.maximum(normals - contacts.max_normal, 0.0) / unit.force,
    ]
    if actuation is not None:
        tau = problem.torques(f)  # N·m
        parts += [np.maximum(actuation.lower - tau, 0.0) / unit.torque, np.maximum(tau - actuation.upper, 0.0) / unit.torque]
    return float(np.max(np.concatenate(parts)))


def _cone_violations(problem: ForceProblem, f: Array) -> Array:
    """(N,) how far each contact's force is outside the problem's cone, N."""
    contacts, padded = problem.contacts, problem.contacts.pad(f)
    if problem.cone.type == "exact":
        return friction.violation(padded, contacts.mu, contacts.gamma)
    without = np.where(contacts.mu > 0, 0.0, friction.violation(padded, contacts.mu, contacts.gamma))
    slip = np.where(contacts.mu > 0, np.maximum(-problem.cone_margins(f), 0.0), 0.0)
    unsupported_moment = np.where((contacts.gamma == 0) & (contacts.mu > 0), np.abs(padded[:, friction.M_N]), 0.0)
    return np.asarray(np.maximum.reduce([without, slip, unsupported_moment, np.maximum(-padded[:, friction.F_N], 0.0)]))


def _dual_residual_and_gap(problem: ForceProblem, f: Array, m: Multipliers, unit: Scale) -> tuple[float, float]:
    """Signs and cones of the multipliers, as the cost that they could hide; and the duality gap; both relative to the cost."""
    contacts, actuation, kind = problem.contacts, problem.actuation, problem.objective.type
    normals = f[contacts.normal_rows]  # N
    z = _cost_gradient(problem, f, m) - _multiplier_gradient(problem, m)  # cost per N, and per N·m
    cost = problem.cost(f)
    whole = unit.cost + abs(cost)
    if not np.isfinite(whole):
        return np.inf, np.inf  # beside an infinite cost everything would be nothing
    largest_force = max(unit.force, float(np.abs(normals).max()))  # N
    # what z lacks can hide no more than the contact may press
    max_normal_force = np.minimum(largest_force, contacts.max_normal)  # N

    dual = [_dual_distances(problem, z) * max_normal_force, -m.normal_lower * largest_force, -m.normal_upper * largest_force]
    slack = [
        *_products(m.normal_lower, normals - contacts.min_normal),
        *_products(m.normal_upper, contacts.max_normal - normals),
    ]
    if actuation is not None:
        tau = problem.torques(f)  # N·m
        largest_torque = np.maximum(unit.torque, np.abs(tau))  # N·m
        dual += [-m.torque_lower * largest_torque, -m.torque_upper * largest_torque]
        slack += [*_products(m.torque_lower, tau - actuation.lower), *_products(m.torque_upper, actuation.upper - tau)]
    gap = float(_about_centroid(problem, m.y) @ _equilibrium_error(problem, f)) + float(z @ f) + float(np.sum(slack))
    if kind == "max_normal":
        gap += float(m.level @ (cost - normals))
        dual += [-m.level * largest_force, np.abs([m.level.sum() - 1.0]) * largest_force]
    if kind == "margin":
        # s has its own stationarity: Σ z_n/μ − 1 = the multiplier of s ≥ 0, which must be ≥ 0.
        rough = contacts.mu > 0
        mu = _facet_friction(problem)[rough]
        dual.append(np.array([1.0 - float((z[contacts.normal_rows][rough] / mu).sum())]) * largest_force)
        gap -= cost
    return float(np.max(np.concatenate(dual), initial=0.0)) / whole, abs(gap) / whole


def _products(multiplier: Array, slack: Array) -> list[float]:
    """Multiplier times slack, where an absent limit (infinite slack) may only have the multiplier 0."""
    return [float(x * s) if x != 0.0 else 0.0 for x, s in zip(multiplier, slack, strict=True)]


def _cost_gradient(problem: ForceProblem, f: Array, m: Multipliers) -> Array:
    """∇cost at f: J W tau + ρ f, f, or the normals' weights; for "margin" the forces enter by the cones alone."""
    kind, gradient = problem.objective.type, np.zeros(problem.size)
    if kind == "torque":
        assert problem.actuation is not None  # checked when the problem was made
        gradient = problem.actuation.J @ (problem.actuation.weight * problem.torques(f)) + problem.objective.force_weight * f
    elif kind == "force":
        gradient = f.copy()
    elif kind == "sum_normal":
        gradient[problem.contacts.normal_rows] = 1.0
    elif kind == "max_normal":
        gradient[problem.contacts.normal_rows] = m.level
    return gradient


def _equilibrium_error(problem: ForceProblem, f: Array) -> Array:
    """(6,) G f − w, moments about the contacts' centroid: how far the forces are from equilibrium, N and N·m."""
    return np.asarray(problem.G_centred @ f - problem.w_centred)


def _about_centroid(problem: ForceProblem, y: Array) -> Array:
    """(6,) y of equilibrium about O as the multipliers of equilibrium about the contacts' centroid: yᵀG stays the same."""
    return np.concatenate([y[:3] - np.cross(problem.contacts.centroid, y[3:]), y[3:]])


def _multiplier_gradient(problem: ForceProblem, m: Multipliers) -> Array:
    """Gᵀ y + E (ν_lower − ν_upper) + J (λ_lower − λ_upper): what the multipliers of equilibrium and limits weigh each force."""
    result = problem.G_centred.T @ _about_centroid(problem, m.y)
    result[problem.contacts.normal_rows] += m.normal_lower - m.normal_upper
    if problem.actuation is not None:
        result += problem.actuation.J @ (m.torque_lower - m.torque_upper)
    return np.asarray(result)


def _facet_friction(problem: ForceProblem) -> Array:
    """(N,) μ, or what the pyramid's facets use for it."""
    mu = problem.contacts.mu
    return mu if problem.cone.type == "exact" else friction.pyramid_friction(mu, problem.cone.facets, problem.cone.side)


def _dual_distances(problem: ForceProblem, z: Array) -> Array:
    """(N,) how much normal component each z lacks to be in the dual of the problem's cone, cost per N."""
    contacts, padded = problem.contacts, problem.contacts.pad(z)
    if problem.cone.type == "exact":
        return friction.dual_violation(padded, contacts.mu, contacts.gamma)
    shape = (problem.cone.facets, problem.cone.side)
    lacking = [
        -float((friction.pyramid_rays(*shape, float(mu), float(gamma)) @ one).min())
        for one, mu, gamma in zip(padded, contacts.mu, contacts.gamma, strict=True)
    ]
    return np.maximum(lacking, 0.0)


def certify_infeasibility(problem: ForceProblem, multipliers: Multipliers) -> InfeasibilityProof:
    """Whether multipliers prove that a problem has no answer.

    Args:
        problem: the problem.
        multipliers: a ray of the dual, of any length, from wherever.
    """
    contacts, actuation = problem.contacts, problem.actuation
    with np.errstate(all="ignore"):  # numbers of a solver that went astray may be anything
        unit = scale(problem)
        m = _clipped_multipliers(problem, multipliers)
        z = -_multiplier_gradient(problem, m)
        distance = _dual_distances(problem, z)  # per N
        bounded = np.isfinite(contacts.max_normal)
        upper = m.normal_upper + np.where(bounded, distance, 0.0)
        z[contacts.normal_rows] += np.where(bounded, distance, 0.0)
        open_distance = float(np.where(bounded, 0.0, distance).sum())
        m = Multipliers(m.y, m.normal_lower, upper, m.torque_lower, m.torque_upper, m.level)
        terms = [_about_centroid(problem, m.y) * problem.w_centred, _products_or_zero(m.normal_lower, contacts.min_normal)]
        terms.append(-_products_or_zero(upper, contacts.max_normal))
        if actuation is not None:
            terms.append(_products_or_zero(m.torque_lower, actuation.lower - actuation.tau_u))
            terms.append(-_products_or_zero(m.torque_upper, actuation.upper - actuation.tau_u))
        flat = np.concatenate(terms)
        largest = float(np.abs(flat).max())
        shares = [part / largest for part in (m.y, m.normal_lower, upper, m.torque_lower, m.torque_upper, m.level)]
        if largest == 0.0 or not np.isfinite(np.concatenate([flat, z, *shares])).all():
            return InfeasibilityProof(Certificate(False, 0.0, 0.0, 0.0, 1.0 / _PROOF_RANGE), multipliers, z)
        value = float((flat / largest).sum())
        above_rounding = value > _rounding(problem, m, unit) / largest
        residual = open_distance * unit.force * (_required_range(problem, unit) / _PROOF_RANGE) / largest
    verified = above_rounding and residual * _PROOF_RANGE <= value
    return InfeasibilityProof(
        Certificate(bool(verified), 0.0, residual, value, 1.0 / _PROOF_RANGE), Multipliers(*shares), z / largest
    )


def _rounding(problem: ForceProblem, m: Multipliers, unit: Scale) -> float:
    """What rounding can have made of a proof's value, in what it weighs and in what the force unit makes of z.

    Far from O the moments about O and those about the centroid are small differences of large numbers.
    """
    contacts, actuation = problem.contacts, problem.actuation
    x, y, z = np.abs(contacts.centroid).tolist()  # m
    arm = np.array([[0.0, z, y], [z, 0.0, x], [y, x, 0.0]])
    price, w = _ROUNDING * np.abs(m.y), np.abs(problem.w)
    price[:3] += arm @ price[3:]
    w[3:] += arm @ w[:3]
    nu_lower, nu_upper = _ROUNDING * m.normal_lower, _ROUNDING * m.normal_upper
    value = float(price @ w + nu_lower @ contacts.min_normal + _products_or_zero(nu_upper, contacts.max_normal).sum())
    weight = np.abs(problem.G_centred).T @ price
    weight[contacts.normal_rows] += nu_lower + nu_upper
    if actuation is not None:
        lower, upper, bias = _ROUNDING * m.torque_lower, _ROUNDING * m.torque_upper, np.abs(actuation.tau_u)
        value += float(_products_or_zero(lower, np.abs(actuation.lower) + bias).sum())
        value += float(_products_or_zero(upper, np.abs(actuation.upper) + bias).sum())
        weight += np.abs(actuation.J) @ (lower + upper)
    padded = contacts.pad(weight)
    across = contacts.mu * (padded[:, friction.F_T1] + padded[:, friction.F_T2]) + contacts.gamma * padded[:, friction.M_N]
    return value + unit.force * float((padded[:, friction.F_N] + across).sum())


def _required_range(problem: ForceProblem, unit: Scale) -> float:
    """How far a proof must reach, in force units: `_PROOF_RANGE`, or further where friction so smooth needs large normal forces."""
    mu, gamma = problem.contacts.mu, problem.contacts.gamma
    smoothest = min(mu[mu > 0].min(initial=1.0), gamma[gamma > 0].min(initial=np.inf) / unit.length)
    return max(_PROOF_RANGE, _PROOF_RANGE_FRICTION / max(float(smoothest), np.finfo(float).tiny))


def _clipped_multipliers(problem: ForceProblem, m: Multipliers) -> Multipliers:
    """Negative multipliers, and those of limits that do not exist, set to zero: what is left is checked in full."""
    contacts, actuation = problem.contacts, problem.actuation
    zero = np.zeros(len(contacts))
    torque_lower, torque_upper = np.maximum(m.torque_lower, 0.0), np.maximum(m.torque_upper, 0.0)
    if actuation is not None:
        torque_lower = np.where(np.isfinite(actuation.lower), torque_lower, 0.0)
        torque_upper = np.where(np.isfinite(actuation.upper), torque_upper, 0.0)
    upper = np.where(np.isfinite(contacts.max_normal), np.maximum(m.normal_upper, 0.0), 0.0)
    return Multipliers(m.y, np.maximum(m.normal_lower, 0.0), upper, torque_lower, torque_upper, zero)


def _products_or_zero(multiplier: Array, limit: Array) -> Array:
    """multiplier · limit, zero where the multiplier is, even if the limit is infinite."""
    return np.where(multiplier == 0.0, 0.0, multiplier * np.where(np.isfinite(limit), limit, 0.0))
