"""Tags of a case: what a solver needs to support, and why the case may be difficult."""

from __future__ import annotations

import numpy as np

from graspforce.force.solver import solve
from graspforce.problems.case import Case, ExpectedOptimum

_FEW, _LARGE = 5, 50  # contacts
_LOW_FRICTION = 0.05
_WIDE = 1e4  # ratio of the largest to the smallest positive value
_NEAR = 1e-3  # of the load: a change that decides whether forces exist
_ILL_CONDITIONED = 1e3  # ratio of the singular values of equilibrium, in the units of the problem
TRAITS = ("ill-conditioned", "large", "low-friction", "near-limit", "no-interior", "rank-deficient", "wide-limits")


def case_tags(case: Case) -> tuple[str, ...]:
    """Return the tags of a case in alphabetical order.

    Objective and cone: "objective:torque", "exact" or "pyramid". Answer: "feasible" or "infeasible". Model: "soft",
    "motor-limits", "normal-limits", "robust" (forces for all errors), "linear" (no second-order cone). Difficulty: those of
    `difficulty_traits`, and "difficulty:hard" for cases with one of them. Of the others, "difficulty:easy" has at most five
    contacts and no errors, and "difficulty:medium" is the rest.

    Args:
        case: the case.
    """
    problem = case.problem
    contacts, actuation = problem.contacts, problem.actuation
    limits = np.zeros(0) if actuation is None else np.concatenate([actuation.lower, actuation.upper])
    traits = difficulty_traits(case)
    is_easy = len(contacts) <= _FEW and problem.uncertainty is None
    facts = {
        f"objective:{problem.objective.type}": True,
        problem.cone.type: True,
        "feasible" if isinstance(case.expected, ExpectedOptimum) else "infeasible": True,
        "soft": bool((contacts.gamma > 0).any()),
        "motor-limits": bool((np.isfinite(limits) & (limits != 0)).any()),
        "normal-limits": bool(np.isfinite(contacts.max_normal).any() or (contacts.min_normal > 0).any()),
        "robust": problem.uncertainty is not None,
        "linear": problem.cone.type == "pyramid" or not (contacts.mu > 0).any(),
        f"difficulty:{'hard' if traits else 'easy' if is_easy else 'medium'}": True,
        **dict.fromkeys(traits, True),
    }
    return tuple(sorted(tag for tag, holds in facts.items() if holds))


def difficulty_traits(case: Case) -> tuple[str, ...]:
    """Return those of `TRAITS` that a case has, in alphabetical order.

    "large": more than 50 contacts. "low-friction": a coefficient below 0.05. "rank-deficient": the contacts cannot resist every
    wrench. "ill-conditioned": they resist some wrench a thousand times worse than another. "no-interior": proven that no forces
    are strictly inside all cones. "wide-limits": torque limits that differ by more than 10⁴. "near-limit": a load greater by
    0.1 % cannot be held, or one that is smaller by 0.1 % can.

    Args:
        case: the case.
    """
    problem = case.problem
    contacts, actuation = problem.contacts, problem.actuation
    rough = contacts.mu[contacts.mu > 0]
    limits = np.zeros(0) if actuation is None else np.abs(np.concatenate([actuation.lower, actuation.upper]))
    limits = limits[np.isfinite(limits) & (limits > 0)]
    balance = problem.G_centred / np.array([1.0] * 3 + [problem.length] * 3)[:, None]
    rank_deficient = np.linalg.matrix_rank(balance) < 6
    sizes = np.linalg.svd(balance, compute_uv=False)
    facts = {
        "ill-conditioned": bool(not rank_deficient and sizes[0] > _ILL_CONDITIONED * sizes[-1]),
        "large": len(contacts) > _LARGE,
        "low-friction": bool((rough < _LOW_FRICTION).any()),
        "near-limit": _is_near_limit(case),
        "no-interior": isinstance(case.expected, ExpectedOptimum) and case.expected.no_interior is not None,
        "rank-deficient": bool(rank_deficient),
        "wide-limits": bool(len(limits) and limits.max() > _WIDE * limits.min()),
    }
    return tuple(trait for trait in TRAITS if facts[trait])


def _is_near_limit(case: Case) -> bool:
    """Return whether a load that differs by `_NEAR` has the other answer."""
    is_feasible = isinstance(case.expected, ExpectedOptimum)
    load = case.problem.w * (1.0 + _NEAR if is_feasible else 1.0 - _NEAR)
    return solve(case.problem.replace(w=load), explain=False).found is not is_feasible
