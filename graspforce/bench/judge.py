"""Verdicts on solver results, from the certificate and the proven status of the case. The solver's status is not trusted."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from graspforce.bench.adapter import SolverResult, SolverStatus
from graspforce.force.certificate import LOOSE_TOLERANCE, TIGHT_TOLERANCE, certify, certify_infeasibility
from graspforce.force.problem import ForceProblem

# Largest residual of the certificate that is accepted, by settings, relative to the scale of the problem. It is about 100 times
# the tolerance of the solver on its own rows.
ACCEPTED_RESIDUAL = {"default": LOOSE_TOLERANCE, "high": TIGHT_TOLERANCE, "low": 1e-2}
WRONG_RESIDUAL = 1e-2  # above it, relative to the load or the cost, a solution is wrong in all settings


class Verdict(str, Enum):
    """Verdict on one solver and one case."""

    CERTIFIED = "certified"  # the certificate verifies the solution or the infeasibility proof
    UNPROVEN = "unproven"  # correctly reported infeasible, without a valid proof
    INEXACT = "inexact"  # reported solved; residual above the accepted one and within `WRONG_RESIDUAL`
    WRONG = "wrong"  # reported solved or infeasible, and is not
    NO_ANSWER = "no answer"  # the solver reports that it found no solution
    TIMED_OUT = "timed out"  # stopped at the time limit
    CRASHED = "crashed"  # the process died, or an exception was raised
    UNSUPPORTED = "unsupported"  # the solver does not take such problems


# from the most to the least harmful
VERDICTS_WORST_FIRST = (
    Verdict.WRONG,
    Verdict.CRASHED,
    Verdict.TIMED_OUT,
    Verdict.INEXACT,
    Verdict.NO_ANSWER,
    Verdict.UNSUPPORTED,
    Verdict.UNPROVEN,
    Verdict.CERTIFIED,
)


@dataclass(frozen=True, slots=True)
class Judgement:
    """A verdict, and the largest relative residual of the certificate (None if nothing was measured)."""

    verdict: Verdict
    residual: float | None = None


def judge(problem: ForceProblem, feasible: bool, result: SolverResult, settings: str) -> Judgement:
    """Judge the result of a solver.

    Args:
        problem: the problem.
        feasible: proven feasibility of the problem.
        result: result of the solver.
        settings: accuracy settings of the run, a key of `ACCEPTED_RESIDUAL`.
    """
    if result.status is SolverStatus.NO_ANSWER:
        return Judgement(Verdict.NO_ANSWER)
    if result.status is SolverStatus.INFEASIBLE:
        if result.multipliers is not None and certify_infeasibility(problem, result.multipliers).certificate.verified:
            return Judgement(Verdict.CERTIFIED)
        return Judgement(Verdict.WRONG if feasible else Verdict.UNPROVEN)
    if result.f is None or result.multipliers is None:
        return Judgement(Verdict.WRONG)
    certificate = certify(problem, result.f, result.multipliers)
    residual = max(certificate.primal_residual, certificate.dual_residual, certificate.gap)
    if residual <= ACCEPTED_RESIDUAL[settings]:
        return Judgement(Verdict.CERTIFIED, residual)
    return Judgement(Verdict.INEXACT if residual <= WRONG_RESIDUAL else Verdict.WRONG, residual)


def worst_judgement(judgements: Iterable[Judgement]) -> Judgement:
    """Return the worst of several judgements of one case: by `VERDICTS_WORST_FIRST`, then by the larger residual."""
    return min(judgements, key=lambda one: (VERDICTS_WORST_FIRST.index(one.verdict), -(one.residual or 0.0)))
