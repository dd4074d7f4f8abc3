"""Check of static equilibrium along a path: a move begins and ends at rest.

If every place of a path can be held still with a margin, a slow motion along it exists. If one cannot, the infeasibility
certificate of its force problem gives the reason.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from graspforce.force.infeasibility import Infeasibility
from graspforce.force.problem import ForceProblem
from graspforce.force.problem_options import Objective
from graspforce.force.solver import solve
from graspforce.force.status import Status
from graspforce.planning.failure import OVERLOADED, UNHOLDABLE, PlanFailure
from graspforce.planning.path.knots import PathKnots
from graspforce.planning.task import FingerTask, HandTask, ObjectTask, Task
from graspforce.planning.tip_contacts import contacts_at


def find_static_failure(task: Task, knots: PathKnots, indices: Iterable[int]) -> PlanFailure | None:
    """Return the failure at the first of some knots at which the task cannot be held still; None if there is none.

    Args:
        task: the task.
        knots: the path at its knots.
        indices: knots to check.
    """
    for i in indices:
        failure = _failure_at(task, knots, i)
        if failure is not None:
            return failure
    return None


def _failure_at(task: Task, knots: PathKnots, i: int) -> PlanFailure | None:
    """Return the failure at knot i; None if the task can be held still there."""
    if isinstance(task, FingerTask):
        return _gravity_failure(task, knots, i)
    return _equilibrium_failure(task, knots, i)


def _equilibrium_failure(task: ObjectTask, knots: PathKnots, i: int) -> PlanFailure | None:
    """Return the failure of an object that the contacts cannot hold still, or not with the slip margin."""
    s, poses = float(knots.s[i]), knots.poses
    contacts = contacts_at(task.contacts, knots.contacts.p_OC[i], knots.contacts.R_OC[i])
    problem = task.static_problem(poses.p[i], poses.R[i], knots.joints.q[i], contacts)
    solution = solve(problem, explain=False)
    if solution.status is Status.INFEASIBLE:
        return _infeasible_failure(task, s, solve(problem).infeasibility)
    if task.slip_margin == 0.0:
        return None
    rough = problem.contacts.mu > 0.0
    if solution.found and problem.cone_margins(solution.f)[rough].min(initial=np.inf) >= task.slip_margin:
        return None
    margin_problem = ForceProblem(problem.contacts, problem.w, problem.actuation, objective=Objective("margin"))
    best = solve(margin_problem, explain=False).objective
    if best is None or best >= task.slip_margin:
        return None
    reason = (
        f"{_place_text(s)} the object can be held still, but the slip margin is at most {best:.4g} N, "
        f"less than the required {task.slip_margin:.4g} N."
    )
    return PlanFailure(UNHOLDABLE, reason, s)


def _infeasible_failure(task: ObjectTask, s: float, infeasibility: Infeasibility | None) -> PlanFailure:
    """Return the failure of an object that cannot be held still, with its infeasibility certificate."""
    reason = f"{_place_text(s)} the object cannot be held still."
    if infeasibility is None:
        return PlanFailure(UNHOLDABLE, reason, s)
    joint = None
    if isinstance(task, HandTask) and infeasibility.joints:
        joint = task.hand.joints[infeasibility.joints[0]].name
    reason = f"{reason} {infeasibility.explanation}{_remedies(infeasibility)}"
    return PlanFailure(UNHOLDABLE, reason, s, joint, infeasibility)


def _gravity_failure(task: FingerTask, knots: PathKnots, i: int) -> PlanFailure | None:
    """Return the failure of a motor that cannot hold its finger against gravity."""
    hand, s = task.hand, float(knots.s[i])
    tau = hand.gravity_torque(knots.joints.q[i], task.gravity_H)
    excess = np.maximum(tau - hand.torque_upper, hand.torque_lower - tau)
    joint = int(excess.argmax())
    if excess[joint] <= 0.0:
        return None
    name, limit = hand.joints[joint].name, hand.joints[joint].torque
    reason = (
        f"{_place_text(s)} joint {name} needs {abs(tau[joint]):.4g} N·m to hold its finger against gravity; "
        f"its limit is {limit:.4g} N·m."
    )
    return PlanFailure(OVERLOADED, reason, s, name)


def _place_text(s: float) -> str:
    return {0.0: "At the start", 1.0: "At the goal"}.get(s, f"At s = {s:.3f}")


def _remedies(infeasibility: Infeasibility) -> str:
    """Return the sentence that states which increases would make the problem feasible."""
    factors = ((infeasibility.friction_factor, "the friction"), (infeasibility.torque_factor, "the motors' torque limits"))
    remedies = [f"{factor:.4g} times {words}" for factor, words in factors if factor is not None]
    return f" It would be possible with {' or '.join(remedies)}." if remedies else ""
