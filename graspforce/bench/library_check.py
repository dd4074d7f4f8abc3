"""Check the expected answers of the problem library: solve every feasible case again, and verify every infeasibility proof.

A load that is infeasible by less than the certificate's tolerance has both a certified solution and a valid proof. Such a case
has no single answer. The library therefore requires a margin of each proof (`infeasibility_margin`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from graspforce.contact import friction
from graspforce.core.arrays import Array
from graspforce.force.certificate import TIGHT_TOLERANCE, InfeasibilityProof, certify_infeasibility
from graspforce.force.problem import ForceProblem
from graspforce.force.scale import scale
from graspforce.force.solver import solve
from graspforce.force.status import Status
from graspforce.problems.case import Case, ExpectedInfeasibility

_EQUAL = 1e-12  # rounding of an equation, relative to its terms
_STRICT = 1e-6  # value that counts as below zero, relative to its terms


@dataclass(frozen=True, slots=True)
class CaseCheck:
    """Check of one case.

    Args:
        name: name of the case.
        feasible: whether the library expects a solution.
        is_valid: whether the expected answer is confirmed.
        residual: largest relative residual of the certificate.
        difference: |computed − expected objective| over the tolerance of the expected objective; 0 for a proof.
    """

    name: str
    feasible: bool
    is_valid: bool
    residual: float
    difference: float


@dataclass(frozen=True, slots=True)
class CollectionSummary:
    """Summary of the checks of one collection.

    Args:
        collection: name of the collection.
        optimal: number of cases that are expected to be feasible.
        infeasible: number of cases that are expected to be infeasible.
        residual: largest residual.
        difference: largest difference.
        failed: names of the cases whose expected answer is not confirmed.
    """

    collection: str
    optimal: int
    infeasible: int
    residual: float
    difference: float
    failed: tuple[str, ...]


def verify_case(case: Case) -> CaseCheck:
    """Solve a case again, or verify its infeasibility proof.

    A solution must be certified, and its objective must equal the expected one within the tolerance of the case.

    Args:
        case: the case.
    """
    known = case.expected
    if isinstance(known, ExpectedInfeasibility):
        proof = certify_infeasibility(case.problem, known.proof)
        is_valid = proof.certificate.verified and infeasibility_margin(case.problem, proof) > TIGHT_TOLERANCE
        return CaseCheck(case.name, False, is_valid, proof.certificate.dual_residual, 0.0)
    solution = solve(case.problem, explain=False)
    if solution.status is not Status.OPTIMAL or solution.certificate is None or solution.objective is None:
        return CaseCheck(case.name, True, False, 1.0, 0.0)
    if known.no_interior is not None and not excludes_interior(case.problem, known.no_interior):
        return CaseCheck(case.name, True, False, 1.0, 0.0)
    certificate = solution.certificate
    difference = abs(solution.objective - known.objective) / (known.tolerance * max(abs(known.objective), 1e-300))
    residual = max(certificate.primal_residual, certificate.dual_residual, certificate.gap)
    return CaseCheck(case.name, True, difference <= 1.0, residual, difference)


def excludes_interior(problem: ForceProblem, y: Array) -> bool:
    """Return whether y proves that no forces of a problem are strictly inside all friction cones.

    Let h_i be the largest value of yᵀ G_i f_i over forces in the cone with f_n = 1. If all h_i ≤ 0, some h_i < 0, and yᵀw = 0,
    then forces that supply w have f_n = 0 at each contact with h_i < 0. Equations hold to rounding, 1e-12 of their terms.

    Args:
        problem: the problem, with exact cones.
        y: (6,) multipliers of equilibrium about O's origin.
    """
    force = y[:3] - np.cross(problem.contacts.centroid, y[3:])
    price = np.concatenate([force, y[3:]])
    terms = problem.contacts.pad(np.abs(problem.G_centred.T) @ np.abs(price)).max(axis=1)
    largest = _largest_values(problem, price) / np.where(terms > 0.0, terms, 1.0)
    balance = abs(float(price @ problem.w_centred)) / float(np.abs(price) @ np.abs(problem.w_centred))
    exact = problem.cone.type == "exact"
    return bool(exact and balance <= _EQUAL and largest.max() <= _EQUAL and largest.min() < -_STRICT)


def _largest_values(problem: ForceProblem, price: Array) -> Array:
    """Return (N,) the largest priceᵀ G_i f_i over the cone of contact i with f_n = 1."""
    c, contacts = problem.contacts.pad(problem.G_centred.T @ price), problem.contacts
    tangential = contacts.mu * np.hypot(c[:, friction.F_T1], c[:, friction.F_T2])
    return np.asarray(c[:, friction.F_N] + np.hypot(tangential, contacts.gamma * c[:, friction.M_N]))


def infeasibility_margin(problem: ForceProblem, proof: InfeasibilityProof) -> float:
    """Return a lower bound on the residual of all forces, from an infeasibility proof.

    Let f violate equilibrium, cones and limits by at most r of their units (`graspforce.force.scale`). The normal force is then
    at least −r F, and the tangential force at most μ f_n + r F. The moment is at most γ (f_n + r F). Then, for z in K*,

        zᵀf ≥ −r F (2 + 1/μ) z_n    if μ > 0,    zᵀf ≥ −r F (2 z_n + ‖z_t‖)    if μ = 0.

    The proof shows 0 ≥ value for r = 0, where value > 0 is a contradiction. For r > 0 it shows 0 ≥ value − r D with

        D = Σ F (|y_force| + L |y_moment| + ν_lower + ν_upper) + Σ T (λ_lower + λ_upper) + Σ F (2 + 1/μ) z_n.

    Args:
        problem: the problem.
        proof: proof checked by `certify_infeasibility`.

    Returns:
        value/D. All forces have a residual of at least this.
    """
    m, unit, contacts = proof.multipliers, scale(problem), problem.contacts
    z = np.abs(contacts.pad(proof.z))
    mu = contacts.mu
    if problem.cone.type != "exact":
        mu = friction.pyramid_friction(mu, problem.cone.facets, problem.cone.side)
    tangential = np.hypot(z[:, friction.F_T1], z[:, friction.F_T2])
    cones = 2.0 * z[:, friction.F_N] + np.where(mu > 0, z[:, friction.F_N] / np.where(mu > 0, mu, 1.0), tangential)
    moment = np.abs(m.y[3:]).sum() * unit.length
    force = np.abs(m.y[:3]).sum()
    normal = m.normal_lower.sum() + m.normal_upper.sum()
    D = unit.force * (force + moment + normal + cones.sum()) + (unit.torque * (m.torque_lower + m.torque_upper)).sum()
    return float(proof.certificate.gap / D)


def summarize_checks(checks: Iterable[CaseCheck]) -> Iterator[CollectionSummary]:
    """Return one summary for each collection, in the order of the checks.

    Args:
        checks: checks of cases.
    """
    grouped: dict[str, list[CaseCheck]] = {}
    for check in checks:
        grouped.setdefault(check.name.split("/")[0], []).append(check)
    for collection, own in grouped.items():
        yield CollectionSummary(
            collection,
            sum(check.feasible for check in own),
            sum(not check.feasible for check in own),
            max(check.residual for check in own),
            max(check.difference for check in own),
            tuple(check.name for check in own if not check.is_valid),
        )
