"""Certificates: the proof that a solution is optimal, or that a problem is infeasible, from numbers alone.

No solver is trusted: the forces or the multipliers may come from any source.

Optimality. Multipliers with the right signs give a lower bound on the cost of all feasible forces. The multipliers z of the
cones follow from stationarity at f, so that

    cost(f) − least cost ≤ gap = yᵀ(G f − w) + Σ zᵀf + Σ multiplier · slack,    if z is in K* and all multipliers are ≥ 0.

The certificate therefore measures feasibility, signs, z in K*, and the gap. Source: Boyd and Vandenberghe (2004), section 5.9.

Infeasibility. If Gᵀ y + z + E (ν_lower − ν_upper) + J (λ_lower − λ_upper) = 0 with the same signs, every feasible f satisfies

    0 ≥ value = yᵀw + ν_lowerᵀ min − ν_upperᵀ max + λ_lowerᵀ(lower − tau_u) − λ_upperᵀ(upper − tau_u),

so that value > 0 proves that no feasible f exists. Rounding leaves z slightly outside K*. For a contact whose normal force is
bounded, a larger ν_upper puts z back into K* and the proof stays exact. For an unbounded contact, the proof covers all forces
up to value/distance, which must exceed every force that could be needed (`_required_range`).

Residuals are relative to the problem's own units (`scale`). Moments are about the contacts' centroid, so that the certificate
does not depend on the position of O.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from graspforce.contact import friction
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.json_text import JsonRecord
from graspforce.force.compiled_certificate import ProvenBounds, bound_optimality, prove_infeasibility
from graspforce.force.multipliers import Multipliers
from graspforce.force.problem import ForceProblem
from graspforce.force.scale import Scale, scale

TIGHT_TOLERANCE = 1e-8  # of an optimal solution: ten times the error of a converged interior-point method
LOOSE_TOLERANCE = 1e-5  # of an inaccurate solution, which a controller may still use

# The proof for an unbounded contact must cover forces up to _PROOF_RANGE force units, and up to _PROOF_RANGE_FRICTION times
# the normal force with which the contact of least friction bears one force unit. No hand reaches such forces.
_PROOF_RANGE = 1e6
_PROOF_RANGE_FRICTION = 1e3
INFEASIBILITY_TOLERANCE = 1.0 / _PROOF_RANGE  # of dual_residual/gap of a proof of infeasibility
_PROVEN_GAP = 0.2 * TIGHT_TOLERANCE  # relative gap up to which the reach of a rigorous certificate is not reduced
_LEAST_REACH = 10.0  # sums of the normal forces: no reach is smaller
_RECORD = ("verified", "primal_residual", "dual_residual", "gap", "tolerance")
_ROUNDING = 8.0 * float(np.finfo(float).eps)  # relative rounding error of a few operations


@dataclass(frozen=True, slots=True)
class Certificate:
    """Residuals of a proof, relative to the problem's own units.

    Args:
        verified: the proof holds at ``tolerance``.
        primal_residual: largest violation of equilibrium, cones and limits; 0 for a proof of infeasibility.
        dual_residual: largest violation of the multipliers' signs and cones.
        gap: upper bound on the decrease of the cost that remains possible. For a proof of infeasibility: the amount by
            which the constraints contradict each other, which must be positive.
        tolerance: the bound on the residuals and the gap; for a proof of infeasibility the bound on dual_residual/gap.
        proven: the bounds of a rigorous certificate, which hold in exact arithmetic; None for a plain one.
    """

    verified: bool
    primal_residual: float
    dual_residual: float
    gap: float
    tolerance: float
    proven: ProvenBounds | None = None

    @classmethod
    def from_residuals(cls, primal: float, dual: float, gap: float) -> Certificate:
        """Return the certificate of measured residuals: verified at `TIGHT_TOLERANCE`, at `LOOSE_TOLERANCE`, or not at all.

        Args:
            primal: largest violation of equilibrium, cones and limits, relative.
            dual: largest violation of the multipliers' signs and cones, relative.
            gap: possible decrease of the cost, relative.
        """
        worst = max(primal, dual, gap)
        tolerance = TIGHT_TOLERANCE if worst <= TIGHT_TOLERANCE else LOOSE_TOLERANCE
        return cls(worst <= tolerance, primal, dual, gap, tolerance)

    @property
    def is_tight(self) -> bool:
        """Whether the residuals are within `TIGHT_TOLERANCE`."""
        return self.verified and self.tolerance <= TIGHT_TOLERANCE

    def to_dict(self) -> JsonRecord:
        """Return the ``certificate`` record of a solution."""
        record = {name: getattr(self, name) for name in _RECORD}
        return record if self.proven is None else {**record, "proven": self.proven.to_dict()}

    @classmethod
    def from_dict(cls, record: object, field: str = "certificate") -> Certificate:
        """Return the certificate of a ``certificate`` record, without proven bounds.

        Args:
            record: as `to_dict` returns it.
            field: its path, for error messages.

        Raises:
            InvalidInput: a field is missing, unknown or not a number.
        """
        values = fields.check_record(record, field, required=_RECORD, optional=["proven"])
        values.pop("proven", None)
        verified = fields.check_boolean(values.pop("verified"), f"{field}.verified")
        primal, dual, gap, tolerance = (arrays.check_number(values[name], f"{field}.{name}") for name in _RECORD[1:])
        return cls(verified, primal, dual, gap, tolerance)


@dataclass(frozen=True, eq=False, slots=True)
class InfeasibilityProof:
    """A proof that no feasible forces exist.

    Args:
        certificate: whether the proof holds, and its residuals.
        multipliers: the proof, with the sign of each multiplier corrected and the largest term scaled to 1.
        z: (k,) the multipliers of the cones that follow.
        reach: sum of the normal forces at contacts without max_normal up to which the proof holds, N; inf for all forces.
    """

    certificate: Certificate
    multipliers: Multipliers
    z: Array
    reach: float = 0.0


def certify(problem: ForceProblem, f: Array, multipliers: Multipliers, *, rigorous: bool = False) -> Certificate:
    """Return the certificate that forces are optimal.

    Args:
        problem: the force problem.
        f: (k,) stacked contact forces, N and N·m.
        multipliers: of equilibrium and limits; those of the cones are computed here.
        rigorous: account for the rounding of the certificate itself, so that `Certificate.proven` holds in exact arithmetic.
            The violation of multipliers then counts in the gap.

    Returns:
        The certificate: verified at `TIGHT_TOLERANCE`, at `LOOSE_TOLERANCE`, or not at all.

    Raises:
        BackendError: rigorous, and graspforce was installed without a C compiler.
    """
    if rigorous:
        return _certify_rigorously(problem, f, multipliers)
    with np.errstate(all="ignore"):  # a diverged solver returns numbers that overflow
        unit = scale(problem)
        primal = _primal_residual(problem, f, unit)
        dual, gap = _dual_residual_and_gap(problem, f, multipliers.about(problem.contacts.centroid), unit)
    if not np.isfinite([primal, dual, gap]).all():
        huge = float(np.finfo(float).max)  # JSON has no infinity
        primal, dual, gap = (x if np.isfinite(x) else huge for x in (primal, dual, gap))
    return Certificate.from_residuals(primal, dual, gap)


def _certify_rigorously(problem: ForceProblem, f: Array, multipliers: Multipliers) -> Certificate:
    """Return the certificate whose residuals are bounds that hold in exact arithmetic."""
    with np.errstate(all="ignore"):  # a diverged solver returns numbers that overflow
        unit, m = scale(problem), multipliers.about(problem.contacts.centroid)
        total, reach = unit.cost + abs(problem.cost(f)), _PROOF_RANGE * unit.force
        bounds = bound_optimality(problem, f, m, unit, reach)
        if bounds.gap > _PROVEN_GAP * total:  # rounding may cost more over a large reach than over the forces that matter
            largest = float(np.abs(f[problem.contacts.normal_rows]).sum())  # N
            reach = max(reach * _PROVEN_GAP * total / bounds.gap, _LEAST_REACH * max(largest, unit.force))
            bounds = bound_optimality(problem, f, m, unit, min(reach, _PROOF_RANGE * unit.force))
    if not np.isfinite([bounds.violation, bounds.gap, total]).all():
        huge = float(np.finfo(float).max)  # JSON has no infinity
        return Certificate.from_residuals(huge, huge, huge)
    return replace(Certificate.from_residuals(bounds.violation, 0.0, bounds.gap / total), proven=bounds)


def primal_residual(problem: ForceProblem, f: Array) -> float:
    """Return the largest violation of equilibrium, cones and limits by forces, relative to the problem's own units.

    Args:
        problem: the force problem.
        f: (k,) stacked contact forces, N and N·m.
    """
    with np.errstate(all="ignore"):  # a diverged solver returns numbers that overflow
        residual = _primal_residual(problem, f, scale(problem))
    return residual if np.isfinite(residual) else float(np.finfo(float).max)


def _primal_residual(problem: ForceProblem, f: Array, unit: Scale) -> float:
    """Return the largest violation of equilibrium, cones, normal forces and torques, each over its unit."""
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
    """Return (N,) the distance of each contact's force from the problem's cone, N."""
    contacts, padded = problem.contacts, problem.contacts.pad(f)
    if problem.cone.type == "exact":
        return friction.violation(padded, contacts.mu, contacts.gamma)
    without = np.where(contacts.mu > 0, 0.0, friction.violation(padded, contacts.mu, contacts.gamma))
    slip = np.where(contacts.mu > 0, np.maximum(-problem.cone_margins(f), 0.0), 0.0)
    unsupported_moment = np.where((contacts.gamma == 0) & (contacts.mu > 0), np.abs(padded[:, friction.M_N]), 0.0)
    return np.asarray(np.maximum.reduce([without, slip, unsupported_moment, np.maximum(-padded[:, friction.F_N], 0.0)]))


def _dual_residual_and_gap(problem: ForceProblem, f: Array, m: Multipliers, unit: Scale) -> tuple[float, float]:
    """Return the violation of the multipliers' signs and cones, as a cost, and the duality gap; both relative to the cost."""
    contacts, actuation, kind = problem.contacts, problem.actuation, problem.objective.type
    normals = f[contacts.normal_rows]  # N
    z = cost_gradient(problem, f, m) - multiplier_gradient(problem, m)  # cost per N, and per N·m
    cost = problem.cost(f)
    whole = unit.cost + abs(cost)
    if not np.isfinite(whole):
        return np.inf, np.inf  # relative residuals are meaningless if the cost overflows
    largest_force = max(unit.force, float(np.abs(normals).max()))  # N
    # a violation of z costs at most the violation times the contact's largest normal force
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
    gap = float(m.y @ _equilibrium_error(problem, f)) + float(z @ f) + float(np.sum(slack))
    if kind == "max_normal":
        gap += float(m.level @ (cost - normals))
        dual += [-m.level * largest_force, np.abs([m.level.sum() - 1.0]) * largest_force]
    if kind == "margin":
        # stationarity in s: the multiplier of s ≥ 0 is Σ z_n/μ − 1, which must be ≥ 0
        rough = contacts.mu > 0
        mu = _facet_friction(problem)[rough]
        dual.append(np.array([1.0 - float((z[contacts.normal_rows][rough] / mu).sum())]) * largest_force)
        gap -= cost
    return float(np.max(np.concatenate(dual), initial=0.0)) / whole, abs(gap) / whole


def _products(multiplier: Array, slack: Array) -> list[float]:
    """Return multiplier · slack, 0 if the multiplier is 0: the slack of an absent limit is infinite."""
    return [float(x * s) if x != 0.0 else 0.0 for x, s in zip(multiplier, slack, strict=True)]


def cost_gradient(problem: ForceProblem, f: Array, m: Multipliers) -> Array:
    """Return (k,) ∇cost at f: J W tau + ρ f, f, or the weights of the normal forces; 0 for "margin".

    Args:
        problem: the force problem.
        f: (k,) stacked contact forces, N and N·m.
        m: the multipliers, of which "max_normal" uses the level.
    """
    kind, gradient = problem.objective.type, np.zeros(problem.size)
    if kind == "torque":
        assert problem.actuation is not None  # checked when the problem was made
        gradient = problem.actuation.J @ (problem.actuation.weight * problem.torques(f))
        gradient += problem.objective.force_weight * problem.force_weights * f
    elif kind == "force":
        gradient = problem.force_weights * f
    elif kind == "sum_normal":
        gradient[problem.contacts.normal_rows] = 1.0
    elif kind == "max_normal":
        gradient[problem.contacts.normal_rows] = m.level
    return gradient


def _equilibrium_error(problem: ForceProblem, f: Array) -> Array:
    """Return (6,) G f − w with moments about the contacts' centroid, N and N·m."""
    return np.asarray(problem.G_centred @ f - problem.w_centred)


def multiplier_gradient(problem: ForceProblem, m: Multipliers) -> Array:
    """Return (k,) Gᵀ y + E (ν_lower − ν_upper) + J (λ_lower − λ_upper), cost per N and per N·m.

    Args:
        problem: the force problem.
        m: multipliers about the contacts' centroid.
    """
    result = problem.G_centred.T @ m.y
    result[problem.contacts.normal_rows] += m.normal_lower - m.normal_upper
    if problem.actuation is not None:
        result += problem.actuation.J @ (m.torque_lower - m.torque_upper)
    return np.asarray(result)


def _facet_friction(problem: ForceProblem) -> Array:
    """Return (N,) the friction coefficient of the cone, or of the pyramid's facets."""
    mu = problem.contacts.mu
    return mu if problem.cone.type == "exact" else friction.pyramid_friction(mu, problem.cone.facets, problem.cone.side)


def _dual_distances(problem: ForceProblem, z: Array) -> Array:
    """Return (N,) the normal component that moves each z into the dual of the problem's cone, cost per N."""
    contacts, padded = problem.contacts, problem.contacts.pad(z)
    if problem.cone.type == "exact":
        return friction.dual_violation(padded, contacts.mu, contacts.gamma)
    shape = (problem.cone.facets, problem.cone.side)
    lacking = [
        -float((friction.pyramid_rays(*shape, float(mu), float(gamma)) @ one).min())
        for one, mu, gamma in zip(padded, contacts.mu, contacts.gamma, strict=True)
    ]
    return np.maximum(lacking, 0.0)


def certify_infeasibility(problem: ForceProblem, multipliers: Multipliers, *, rigorous: bool = False) -> InfeasibilityProof:
    """Return the proof of infeasibility that multipliers give; its certificate states whether it holds.

    Args:
        problem: the force problem.
        multipliers: a ray of the dual problem, of any length and from any source.
        rigorous: account for the rounding of the proof itself, so that `Certificate.proven` holds in exact arithmetic.

    Raises:
        BackendError: rigorous, and graspforce was installed without a C compiler.
    """
    proof = _measure_infeasibility(problem, multipliers)
    if not rigorous:
        return proof
    with np.errstate(all="ignore"):  # a diverged solver returns numbers that overflow
        unit = scale(problem)
        proven = prove_infeasibility(problem, proof.multipliers.about(problem.contacts.centroid), unit)
        required = _required_range(problem, unit) * unit.force  # N
    if proven is None or proven[1].reach < required:
        return replace(proof, certificate=Certificate(False, 0.0, 0.0, 0.0, INFEASIBILITY_TOLERANCE))
    value, bounds = proven
    residual = value * required / bounds.reach / _PROOF_RANGE if np.isfinite(bounds.reach) else 0.0
    certificate = Certificate(True, 0.0, residual, value, INFEASIBILITY_TOLERANCE, bounds)
    return replace(proof, certificate=certificate, reach=bounds.reach)


def _measure_infeasibility(problem: ForceProblem, multipliers: Multipliers) -> InfeasibilityProof:
    """Return the proof of infeasibility that multipliers give, measured in floating point."""
    contacts, actuation = problem.contacts, problem.actuation
    with np.errstate(all="ignore"):  # a diverged solver returns numbers that overflow
        unit = scale(problem)
        m = _clipped_multipliers(problem, multipliers.about(contacts.centroid))
        z = -multiplier_gradient(problem, m)
        distance = _dual_distances(problem, z)  # per N
        bounded = np.isfinite(contacts.max_normal)
        upper = m.normal_upper + np.where(bounded, distance, 0.0)
        z[contacts.normal_rows] += np.where(bounded, distance, 0.0)
        open_distance = float(np.where(bounded, 0.0, distance).sum())
        m = replace(m, normal_upper=upper)
        terms = [m.y * problem.w_centred, _products_or_zero(m.normal_lower, contacts.min_normal)]
        terms.append(-_products_or_zero(upper, contacts.max_normal))
        if actuation is not None:
            terms.append(_products_or_zero(m.torque_lower, actuation.lower - actuation.tau_u))
            terms.append(-_products_or_zero(m.torque_upper, actuation.upper - actuation.tau_u))
        flat = np.concatenate(terms)
        largest = float(np.abs(flat).max())
        names = ("y", "normal_lower", "normal_upper", "torque_lower", "torque_upper")
        scaled = {name: getattr(m, name) / largest for name in names}
        if largest == 0.0 or not np.isfinite(np.concatenate([flat, z, *scaled.values()])).all():
            return InfeasibilityProof(Certificate(False, 0.0, 0.0, 0.0, INFEASIBILITY_TOLERANCE), multipliers, z)
        value = float((flat / largest).sum())
        above_rounding = value > _rounding(problem, m, unit) / largest
        residual = open_distance * unit.force * (_required_range(problem, unit) / _PROOF_RANGE) / largest
        reach = value * largest / open_distance if open_distance > 0.0 else np.inf  # N
    verified = above_rounding and residual * _PROOF_RANGE <= value
    certificate = Certificate(bool(verified), 0.0, residual, value, INFEASIBILITY_TOLERANCE)
    return InfeasibilityProof(certificate, replace(m, **scaled), z / largest, float(reach))


def _rounding(problem: ForceProblem, m: Multipliers, unit: Scale) -> float:
    """Return a bound on the rounding error of a proof's value, including that of z over forces up to the force unit.

    Far from O, the moment of w about the centroid is a small difference of large numbers.
    """
    contacts, actuation = problem.contacts, problem.actuation
    x, y, z = np.abs(contacts.centroid).tolist()  # m
    arm = np.array([[0.0, z, y], [z, 0.0, x], [y, x, 0.0]])
    price, w = _ROUNDING * np.abs(m.y), np.abs(problem.w)
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
    """Return the force up to which a proof must hold, in force units; small friction needs large normal forces."""
    mu, gamma = problem.contacts.mu, problem.contacts.gamma
    smoothest = min(mu[mu > 0].min(initial=1.0), gamma[gamma > 0].min(initial=np.inf) / unit.length)
    return max(_PROOF_RANGE, _PROOF_RANGE_FRICTION / max(float(smoothest), np.finfo(float).tiny))


def _clipped_multipliers(problem: ForceProblem, m: Multipliers) -> Multipliers:
    """Return the multipliers with negative values, and those of absent limits, set to 0."""
    contacts, actuation = problem.contacts, problem.actuation
    zero = np.zeros(len(contacts))
    torque_lower, torque_upper = np.maximum(m.torque_lower, 0.0), np.maximum(m.torque_upper, 0.0)
    if actuation is not None:
        torque_lower = np.where(np.isfinite(actuation.lower), torque_lower, 0.0)
        torque_upper = np.where(np.isfinite(actuation.upper), torque_upper, 0.0)
    upper = np.where(np.isfinite(contacts.max_normal), np.maximum(m.normal_upper, 0.0), 0.0)
    return Multipliers(m.y, np.maximum(m.normal_lower, 0.0), upper, torque_lower, torque_upper, zero, m.point)


def _products_or_zero(multiplier: Array, limit: Array) -> Array:
    """Return multiplier · limit, 0 if the multiplier is 0: an absent limit is infinite."""
    return np.where(multiplier == 0.0, 0.0, multiplier * np.where(np.isfinite(limit), limit, 0.0))
