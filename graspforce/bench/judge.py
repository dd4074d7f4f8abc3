"""What a solver's claim is worth: the certificate decides, and what is known of the case; the solver's word never does."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from graspforce.bench.entrant import Claim, Said
from graspforce.certificate import certify, refute
from graspforce.problem import ForceProblem
from graspforce.solution import LOOSE, TIGHT

# What the certificate must show for an answer to count, by the settings that it was made with. Relative to the problem's own
# scale, and so some hundred times what was asked of the solver on its rows.
ACCEPTED = {"default": LOOSE, "high": TIGHT, "low": 1e-2}
GROSS = 1e-2  # an answer that misses by more than this, a hundredth of the load or of the cost, is wrong for anybody


class Verdict(str, Enum):
    """What became of a case."""

    CERTIFIED = "certified"  # an answer, or a proof that there is none, that the certificate stands behind
    UNPROVEN = "unproven"  # rightly called infeasible, with no proof that stands
    INEXACT = "inexact"  # called solved, beyond what the certificate accepts and within `GROSS`
    LIED = "lied"  # called solved or infeasible, and it is not so
    GAVE_UP = "gave up"  # the solver itself says that it has no answer
    STOPPED = "stopped"  # it did not end within the limit, and was ended
    CRASHED = "crashed"  # it took its process with it, or raised
    REFUSED = "refused"  # it does not take such problems


# from what harms most to what harms nobody
WORST_FIRST = (
    Verdict.LIED,
    Verdict.CRASHED,
    Verdict.STOPPED,
    Verdict.INEXACT,
    Verdict.GAVE_UP,
    Verdict.REFUSED,
    Verdict.UNPROVEN,
    Verdict.CERTIFIED,
)


@dataclass(frozen=True, slots=True)
class Judgement:
    """A verdict; ``residual`` is the largest that the certificate found, relative; None where there was nothing to measure."""

    verdict: Verdict
    residual: float | None = None


def judge(problem: ForceProblem, feasible: bool, claim: Claim, settings: str) -> Judgement:
    """What a claim is worth.

    Args:
        problem: the problem.
        feasible: whether it has an answer; known, not claimed.
        claim: what the solver says.
        settings: with which it was made.
    """
    if claim.said is Said.GAVE_UP:
        return Judgement(Verdict.GAVE_UP)
    if claim.said is Said.INFEASIBLE:
        if claim.multipliers is not None and refute(problem, claim.multipliers).certificate.verified:
            return Judgement(Verdict.CERTIFIED)
        return Judgement(Verdict.LIED if feasible else Verdict.UNPROVEN)
    if claim.f is None or claim.multipliers is None:
        return Judgement(Verdict.LIED)
    found = certify(problem, claim.f, claim.multipliers)
    residual = max(found.primal_residual, found.dual_residual, found.gap)
    if residual <= ACCEPTED[settings]:
        return Judgement(Verdict.CERTIFIED, residual)
    return Judgement(Verdict.INEXACT if residual <= GROSS else Verdict.LIED, residual)


def worst(judgements: Iterable[Judgement]) -> Judgement:
    """The worst of some judgements of one case: by `WORST_FIRST`, then by the larger residual."""
    return min(judgements, key=lambda one: (WORST_FIRST.index(one.verdict), -(one.residual or 0.0)))
