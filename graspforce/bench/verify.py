"""Check what the problem library says of its cases: every optimum found again and certified, every proof by the law alone."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from graspforce.certificate import refute
from graspforce.problems.case import Case, Impossible
from graspforce.solution import Status
from graspforce.solve import solve


@dataclass(frozen=True, slots=True)
class Check:
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
    holds: bool
    residual: float
    difference: float


@dataclass(frozen=True, slots=True)
class Tally:
    """The checks of a collection summed up, the largest figures, and the names of the cases that do not hold."""

    collection: str
    optimal: int
    infeasible: int
    residual: float
    difference: float
    failed: tuple[str, ...]


def verify(case: Case) -> Check:
    """Find a case's optimum again, or check its proof.

    An optimum must come back certified, as near to the known one as the library says that it is known.
    """
    known = case.expected
    if isinstance(known, Impossible):
        certificate = refute(case.problem, known.proof).certificate
        return Check(case.name, False, certificate.verified, certificate.dual_residual, 0.0)
    answer = solve(case.problem, explain=False)
    if answer.status is not Status.OPTIMAL or answer.certificate is None or answer.objective is None:
        return Check(case.name, True, False, 1.0, 0.0)
    proof = answer.certificate
    difference = abs(answer.objective - known.objective) / (known.tolerance * max(abs(known.objective), 1e-300))
    residual = max(proof.primal_residual, proof.dual_residual, proof.gap)
    return Check(case.name, True, difference <= 1.0, residual, difference)


def tallies(checks: Iterable[Check]) -> Iterator[Tally]:
    """One for each collection, in the order of the checks."""
    grouped: dict[str, list[Check]] = {}
    for check in checks:
        grouped.setdefault(check.name.split("/")[0], []).append(check)
    for collection, own in grouped.items():
        yield Tally(
            collection,
            sum(check.feasible for check in own),
            sum(not check.feasible for check in own),
            max(check.residual for check in own),
            max(check.difference for check in own),
            tuple(check.name for check in own if not check.holds),
        )
