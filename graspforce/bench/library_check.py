"""Check what the problem library says of its cases: every optimum found again and certified, every proof by the law alone.

No case may have both an answer that the certificate accepts and a proof that there is none. A load that is outside of what can
be held by less than the certificate's tolerance would have both: to call it held is right, and so is to call it impossible. A
proof of the library must therefore reach further (`infeasibility_margin`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from graspforce.contact import friction
from graspforce.force.certificate import TIGHT_TOLERANCE, InfeasibilityProof, certify_infeasibility
from graspforce.force.problem import ForceProblem
from graspforce.force.scale import scale
from graspforce.force.solver import solve
from graspforce.force.status import Status
from graspforce.problems.case import Case, ExpectedInfeasibility


@dataclass(frozen=True, slots=True)
class CaseCheck:
    """What became of one case.

    Args:
        name: of the case.
        feasible: whether the library says that it has an answer.
        holds: whether what the library says holds.
        residual: the largest that the certificate found, relative.
        difference: of the objective found from the one known, over the tolerance that the library states; 0 for a proof.
    """

    name: str
    feasible: bool
    is_valid: bool
    residual: float
    difference: float


@dataclass(frozen=True, slots=True)
class CollectionSummary:
    """The checks of a collection summed up, the largest figures, and the names of the cases that do not hold."""

    collection: str
    optimal: int
    infeasible: int
    residual: float
    difference: float
    failed: tuple[str, ...]


def verify_case(case: Case) -> CaseCheck:
    """Find a case's optimum again, or check its proof.

    An optimum must come back certified, as near to the known one as the library says that it is known.
    """
    known = case.expected
    if isinstance(known, ExpectedInfeasibility):
        found = certify_infeasibility(case.problem, known.proof)
        is_valid = found.certificate.verified and infeasibility_margin(case.problem, found) > TIGHT_TOLERANCE
        return CaseCheck(case.name, False, is_valid, found.certificate.dual_residual, 0.0)
    answer = solve(case.problem, explain=False)
    if answer.status is not Status.OPTIMAL or answer.certificate is None or answer.objective is None:
        return CaseCheck(case.name, True, False, 1.0, 0.0)
    proof = answer.certificate
    difference = abs(answer.objective - known.objective) / (known.tolerance * max(abs(known.objective), 1e-300))
    residual = max(proof.primal_residual, proof.dual_residual, proof.gap)
    return CaseCheck(case.name, True, difference <= 1.0, residual, difference)


def infeasibility_margin(problem: ForceProblem, proof: InfeasibilityProof) -> float:
    """Return a lower bound on the residual of all forces, from an infeasibility proof.

    Let f miss equilibrium, cones and limits by at most r of their units (`graspforce.force.scale`). Then its normal force is
    at least
    −r F, the force across it at most μ f_n + r F, and its moment at most γ (f_n + r F), so that for z in K*

        zᵀf ≥ −r F (2 + 1/μ) z_n,    or    −r F (2 z_n + ‖z_t‖)    where μ = 0,

    and what the proof says of forces without a miss, 0 ≥ value, becomes 0 ≥ value − r D with

        D = F (|y_force| + L |y_moment| + ν_lower + ν_upper) + T (λ_lower + λ_upper) + F (2 + 1/μ) z_n,    all summed.

    Args:
        problem: the problem.
        proof: what `certify_infeasibility` found of it.

    Returns:
        value/D. An answer that certifies to less does not exist.
    """
    m, unit, contacts = proof.multipliers, scale(problem), problem.contacts
    z = np.abs(contacts.pad(proof.z))
    mu = contacts.mu
    if problem.cone.type != "exact":
        mu = friction.pyramid_friction(mu, problem.cone.facets, problem.cone.side)
    across = np.hypot(z[:, friction.F_T1], z[:, friction.F_T2])
    cones = 2.0 * z[:, friction.F_N] + np.where(mu > 0, z[:, friction.F_N] / np.where(mu > 0, mu, 1.0), across)
    moment = np.abs(m.y[3:]).sum() * unit.length
    force = np.abs(m.y[:3]).sum()
    pressed = m.normal_lower.sum() + m.normal_upper.sum()
    whole = unit.force * (force + moment + pressed + cones.sum()) + (unit.torque * (m.torque_lower + m.torque_upper)).sum()
    return float(proof.certificate.gap / whole)


def summarize_checks(checks: Iterable[CaseCheck]) -> Iterator[CollectionSummary]:
    """One for each collection, in the order of the checks."""
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
