"""Tags of a case: what a solver needs to support, and why the case may be difficult."""

from __future__ import annotations

import numpy as np

from graspforce.problems.case import Case, ExpectedOptimum

_LARGE = 50  # contacts
_LOW_FRICTION = 0.05
_WIDE = 1e4  # ratio of the largest to the smallest positive value


def case_tags(case: Case) -> tuple[str, ...]:
    """Return the tags of a case in alphabetical order.

    Objective and cone: "objective:torque", "exact" or "pyramid". Answer: "feasible" or "infeasible". Model: "soft",
    "motor-limits", "normal-limits". Difficulty: "large" (more than 50 contacts), "low-friction" (below 0.05), "rank-deficient"
    (the contacts cannot resist every wrench), "no-interior" (proven: no forces strictly inside all cones), "wide-limits"
    (torque limits that differ by more than 10⁴), "linear" (no second-order cone).

    Args:
        case: the case.
    """
    problem = case.problem
    contacts, actuation = problem.contacts, problem.actuation
    rough = contacts.mu[contacts.mu > 0]
    limits = np.zeros(0) if actuation is None else np.abs(np.concatenate([actuation.lower, actuation.upper]))
    limits = limits[np.isfinite(limits) & (limits > 0)]
    is_linear = problem.cone.type == "pyramid" or not len(rough)
    facts = {
        f"objective:{problem.objective.type}": True,
        problem.cone.type: True,
        "feasible" if isinstance(case.expected, ExpectedOptimum) else "infeasible": True,
        "soft": bool((contacts.gamma > 0).any()),
        "motor-limits": bool(len(limits)),
        "normal-limits": bool(np.isfinite(contacts.max_normal).any() or (contacts.min_normal > 0).any()),
        "large": len(contacts) > _LARGE,
        "low-friction": bool((rough < _LOW_FRICTION).any()),
        "rank-deficient": bool(np.linalg.matrix_rank(problem.G_centred) < 6),
        "no-interior": isinstance(case.expected, ExpectedOptimum) and case.expected.no_interior is not None,
        "wide-limits": bool(len(limits) and limits.max() > _WIDE * limits.min()),
        "linear": is_linear,
    }
    return tuple(sorted(tag for tag, holds in facts.items() if holds))
