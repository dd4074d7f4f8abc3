"""Verdicts on solver results, from the certificate and the proven answer of the case. The solver's status is not trusted.

Forces are judged by themselves: by their violation of equilibrium, cones and limits, and by their cost against the proven
optimum. Multipliers are judged by the certificate. A solver without multipliers can therefore be correct.

A result is wrong only if its claim is false at the requested tolerance. Where friction is tiny, forces may miss the cones by
much although the solver meets its tolerance on its own rows. Such forces are inexact, not wrong.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from graspforce.bench.adapter import SolverResult, SolverStatus
from graspforce.bench.case_program import forces_residual, load_error
from graspforce.core.arrays import Array
from graspforce.core.errors import BackendError
from graspforce.force.certificate import (
    LOOSE_TOLERANCE,
    TIGHT_TOLERANCE,
    certify,
    certify_infeasibility,
)
from graspforce.force.problem import ForceProblem
from graspforce.force.scale import scale
from graspforce.force.solver import solve
from graspforce.problems.case import ExpectedOptimum

# Largest residual of the certificate that is accepted, by settings, relative to the scale of the problem. It is about 100 times
# the tolerance of the solver on its own rows.
ACCEPTED_RESIDUAL = {"default": LOOSE_TOLERANCE, "high": TIGHT_TOLERANCE, "low": 1e-2, "float32": 1e-2}
# Residual of the forces above which a reported solution is wrong if its rows contradict it, too. At high settings the requested
# tolerance is 1e-10. The other settings request little accuracy or none.
WRONG_RESIDUAL = {"default": 1e-2, "high": 1e-4, "low": 1e-2, "float32": 1e-2}
# Missing share of the load above which forces outside the accepted residual are wrong. The unit of force exceeds the load where
# motors or normal limits determine the forces; the residual then hides a wrong load. Other settings permit such errors.
WRONG_LOAD_ERROR = {"high": 1e-4}
# Error of the solver's own rows up to which its claim is true: 100 times the requested tolerance; 1e-3 by default, the largest
# default tolerance of the solvers.
TRUE_CLAIM = {"default": 1e-3, "high": 1e-8, "low": 1e-2, "float32": 1e-1}


class Verdict(str, Enum):
    """Verdict on one solver and one case."""

    CERTIFIED = "certified"  # the certificate verifies the solution or the infeasibility proof
    CORRECT = "correct, without multipliers"  # forces within the accepted residual; the solver returned no multipliers
    UNVERIFIED = "correct, inexact multipliers"  # the same, with multipliers that do not prove the forces
    UNPROVEN = "unproven"  # correctly reported infeasible, without a valid proof
    INEXACT = "inexact"  # residual above the accepted one, and not wrong
    WRONG = "wrong"  # a false claim at the requested tolerance: reported solved, or infeasible although feasible
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
    Verdict.UNVERIFIED,
    Verdict.CORRECT,
    Verdict.CERTIFIED,
)
SOLVED_VERDICTS = (Verdict.CERTIFIED, Verdict.CORRECT, Verdict.UNVERIFIED)  # their times count
CORRECT_VERDICTS = (*SOLVED_VERDICTS, Verdict.UNPROVEN)
CLAIMED_VERDICTS = (*CORRECT_VERDICTS, Verdict.INEXACT, Verdict.WRONG)  # reported solved or infeasible


@dataclass(frozen=True, slots=True)
class Judgement:
    """A verdict and a residual.

    Args:
        verdict: the verdict.
        residual: largest relative residual: of the certificate if multipliers decided the verdict, otherwise of the forces.
            None if nothing was measured.
    """

    verdict: Verdict
    residual: float | None = None

    @property
    def is_solved(self) -> bool:
        """Whether the solver found correct forces, or a valid proof of infeasibility."""
        return self.verdict in SOLVED_VERDICTS

    @property
    def is_correct(self) -> bool:
        """Whether the result is solved, or correctly reported infeasible."""
        return self.verdict in CORRECT_VERDICTS


def judge(
    problem: ForceProblem, feasible: bool, result: SolverResult, settings: str, optimum: ExpectedOptimum | None = None
) -> Judgement:
    """Judge the result of a solver.

    Args:
        problem: the problem.
        feasible: proven feasibility of the problem.
        result: result of the solver.
        settings: accuracy settings of the run, a key of `ACCEPTED_RESIDUAL`.
        optimum: proven optimum of a feasible problem; computed and certified here by default.
    """
    if result.status is SolverStatus.NO_ANSWER:
        return Judgement(Verdict.NO_ANSWER)
    if result.status is SolverStatus.INFEASIBLE:
        return _judge_infeasible(problem, feasible, result, settings)
    if result.f is None:
        return Judgement(Verdict.WRONG)
    accepted, proof_residual = ACCEPTED_RESIDUAL[settings], None
    if result.multipliers is not None:
        certificate = certify(problem, result.f, result.multipliers)
        proof_residual = max(certificate.primal_residual, certificate.dual_residual, certificate.gap)
        if proof_residual <= accepted:
            return Judgement(Verdict.CERTIFIED, proof_residual)
    residual = forces_residual(problem, result.f)
    is_wrong = residual > WRONG_RESIDUAL[settings] or load_error(problem, result.f) > WRONG_LOAD_ERROR.get(settings, np.inf)
    is_wrong = is_wrong and (result.row_error is None or result.row_error > TRUE_CLAIM[settings])
    if feasible and residual <= WRONG_RESIDUAL[settings]:
        excess = cost_excess(problem, result.f, optimum or proven_optimum(problem))
        residual, is_wrong = max(residual, excess), is_wrong or excess > WRONG_RESIDUAL[settings]
    if residual > accepted:
        return Judgement(Verdict.WRONG if is_wrong else Verdict.INEXACT, residual)
    return Judgement(Verdict.CORRECT, residual) if proof_residual is None else Judgement(Verdict.UNVERIFIED, proof_residual)


def _judge_infeasible(problem: ForceProblem, feasible: bool, result: SolverResult, settings: str) -> Judgement:
    """Judge a claim that a problem is infeasible.

    A ray that excludes all forces up to a reach proves infeasibility at the tolerance "unit of force / reach".
    """
    proof = None if result.multipliers is None else certify_infeasibility(problem, result.multipliers)
    if proof is not None and proof.certificate.verified:
        return Judgement(Verdict.CERTIFIED)
    if not feasible:
        return Judgement(Verdict.UNPROVEN)
    if proof is not None and proof.reach > 0.0:
        tolerance = scale(problem).force / proof.reach
        if tolerance <= ACCEPTED_RESIDUAL[settings]:
            return Judgement(Verdict.INEXACT, tolerance)
    return Judgement(Verdict.WRONG)


def cost_excess(problem: ForceProblem, f: Array, optimum: ExpectedOptimum) -> float:
    """Return by how much the cost of forces exceeds the proven optimum c*, relative to the cost, as the certificate's gap is.

        max(0, c(f) − c* − δ |c*|) / (c₀ + |c(f)|),    δ: accuracy of c*, c₀: unit of cost; signs reversed for "margin"

    Args:
        problem: the force problem.
        f: (k,) stacked contact forces, N and N·m.
        optimum: the proven optimum.
    """
    with np.errstate(all="ignore"):  # a diverged solver returns numbers that overflow
        cost = problem.cost(f)
        excess = optimum.objective - cost if problem.objective.type == "margin" else cost - optimum.objective
        ratio = (excess - optimum.tolerance * abs(optimum.objective)) / (scale(problem).cost + abs(cost))
    return max(0.0, ratio) if np.isfinite(ratio) else float(np.finfo(float).max)


def proven_optimum(problem: ForceProblem) -> ExpectedOptimum:
    """Return the certified optimum of a feasible problem.

    Args:
        problem: the problem.

    Raises:
        BackendError: no certified solution was found.
    """
    solution = solve(problem, explain=False)
    if solution.objective is None or solution.certificate is None:
        raise BackendError("the optimum of the problem could not be certified")
    return ExpectedOptimum(solution.objective, solution.certificate.tolerance)


def worst_judgement(judgements: Iterable[Judgement]) -> Judgement:
    """Return the worst of several judgements of one case: by `VERDICTS_WORST_FIRST`, then by the larger residual."""
    return min(judgements, key=lambda one: (VERDICTS_WORST_FIRST.index(one.verdict), -(one.residual or 0.0)))
