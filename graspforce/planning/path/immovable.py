"""Check whether the contacts can accelerate the object at the start of a path and brake it at the goal, however slowly.

The contacts may lack the wrench altogether, or their limits may prevent even a small acceleration. The second is certified by
the force problem of a very slow move. Without it, a plan could last for hours with forces within the check's tolerance.
"""

from __future__ import annotations

import numpy as np

from graspforce.core.arrays import Array
from graspforce.force.problem import ForceProblem
from graspforce.force.solver import solve
from graspforce.force.status import Status
from graspforce.hand.actuation import Actuation
from graspforce.planning.failure import IMMOVABLE, PlanFailure
from graspforce.planning.path.dynamics import PathDynamics
from graspforce.planning.path.force_map import unreachable_wrench
from graspforce.planning.path.knots import PathKnots
from graspforce.planning.task import ObjectTask, Task
from graspforce.planning.tip_contacts import contacts_at

_SLOW_DURATION = 100.0  # s: a move that takes longer counts as impossible


def missing_wrench_failure(dynamics: PathDynamics) -> PlanFailure | None:
    """Return the failure of a motion that needs a wrench which no contact forces supply; None if there is none.

    Args:
        dynamics: equations of motion at K knots.
    """
    wrench = unreachable_wrench(dynamics)
    if wrench is None:
        return None
    force, moment = (", ".join(f"{x:.2f}" for x in part) for part in (wrench[:3], wrench[3:]))
    reason = (
        "The contacts can hold the object still but cannot accelerate it along the path. "
        f"That needs a wrench with force ({force}) N and moment ({moment}) N·m, which no contact forces supply."
    )
    return PlanFailure(IMMOVABLE, reason)


def slow_motion_failure(task: Task, knots: PathKnots, dynamics: PathDynamics) -> PlanFailure | None:
    """Return the failure of an object that cannot begin or end even a very slow motion; None if that is not certified.

    The acceleration is that of a move of 100 s that accelerates evenly up to the middle and then brakes, s̈ = ±4/T².

    Args:
        task: the task.
        knots: the path at its knots.
        dynamics: equations of motion at these knots.
    """
    if not isinstance(task, ObjectTask):
        return None
    a = 4.0 / _SLOW_DURATION**2  # 1/s²
    for k, acceleration, words in ((0, a, "accelerate it at the start"), (-1, -a, "brake it at the goal")):
        problem = _problem_at(task, knots, dynamics, (k, acceleration))
        if solve(problem, explain=False).status is Status.INFEASIBLE:
            infeasibility = solve(problem).infeasibility
            why = "" if infeasibility is None else f" {infeasibility.explanation}"
            reason = f"The contacts can hold the object still but cannot {words}, even in a move of {_SLOW_DURATION:g} s.{why}"
            return PlanFailure(IMMOVABLE, reason, 0.0 if k == 0 else 1.0, infeasibility=infeasibility)
    return None


def _problem_at(task: ObjectTask, knots: PathKnots, dynamics: PathDynamics, at: tuple[int, float]) -> ForceProblem:
    """Return the force problem at a knot and an acceleration s̈, from rest, 1/s²."""
    k, a = at
    contacts = contacts_at(task.contacts, knots.contacts.p_OC[k], knots.contacts.R_OC[k])
    w: Array = dynamics.w_0[k] + a * dynamics.w_a[k]
    if not dynamics.tau_0.shape[1]:
        return ForceProblem(contacts, w)
    tau_u: Array = dynamics.tau_0[k] + a * dynamics.tau_a[k]
    return ForceProblem(contacts, np.asarray(w), Actuation(dynamics.J[k], tau_u, dynamics.lower, dynamics.upper))
