"""Whether the task can be held still at places of a path: a move begins and ends at rest, and slow ones are nearly so.

Where every place can be held with room to spare, a motion that is slow enough exists; where one cannot, its force problem's
own proof says why.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from graspforce.core.arrays import Array
from graspforce.force.problem import ForceProblem, Objective
from graspforce.force.solution import Status
from graspforce.force.solver import solve
from graspforce.planning.failure import OVERLOADED, UNHOLDABLE, PlanFailure
from graspforce.planning.path.paths import ContactPoints, JointPoints, PosePoints
from graspforce.planning.task import Task


def find_static_failure(
    task: Task,
    s: Array,
    poses: PosePoints | None,
    contacts: ContactPoints | None,
    joints: JointPoints | None,
    places: Iterable[int],
) -> PlanFailure | None:
    """The first of some places at which the task cannot be held still, in words; None where all can.

    Args:
        task: what moves.
        s: (K,) the knots.
        poses, contacts, joints: the path at the knots.
        places: which knots to look at.
    """
    for i in places:
        alone = task.body is None
        failure = _gravity_failure(task, s, joints, i) if alone else _equilibrium_failure(task, s, poses, contacts, joints, i)
        if failure is not None:
            return failure
    return None


def _equilibrium_failure(
    task: Task, s: Array, poses: PosePoints | None, contacts: ContactPoints | None, joints: JointPoints | None, i: int
) -> PlanFailure | None:
    assert poses is not None
    assert contacts is not None
    q = np.zeros(0) if joints is None else joints.q[i]
    problem = task.static_problem(poses.R[i], poses.p[i], q, task.contacts_at(contacts.p_OC[i], contacts.R_OC[i]))
    answer = solve(problem, explain=False)
    where = _place_text(float(s[i]))
    if answer.status is Status.INFEASIBLE:
        why = solve(problem).infeasibility
        assert why is not None  # every infeasible answer carries its proof
        joint = task.hand.joints[why.joints[0]].name if task.hand is not None and why.joints else None
        reason = (
            f"{where} the object cannot be held still. {why.explanation}{_remedies(why.friction_factor, why.torque_factor)}"
        )
        return PlanFailure(UNHOLDABLE, reason, float(s[i]), joint, why)
    if task.slip_margin > 0.0:
        rough = problem.contacts.mu > 0.0
        if answer.found and problem.cone_margins(answer.f)[rough].min(initial=np.inf) >= task.slip_margin:
            return None
        margin = ForceProblem(problem.contacts, problem.w, problem.actuation, objective=Objective("margin"))
        best = solve(margin, explain=False)
        if best.objective is not None and best.objective < task.slip_margin:
            reason = (
                f"{where} the object can be held still, but at most {best.objective:.4g} N of friction can be kept back at "
                f"every contact, not the {task.slip_margin:.4g} N wanted."
            )
            return PlanFailure(UNHOLDABLE, reason, float(s[i]))
    return None


def _gravity_failure(task: Task, s: Array, joints: JointPoints | None, i: int) -> PlanFailure | None:
    """A motor that cannot bear its finger's weight."""
    assert task.hand is not None  # a task without an object has a hand and its joints' path
    assert joints is not None
    hand = task.hand
    tau = hand.gravity_torque(joints.q[i], task.gravity_H)
    beyond = np.maximum(tau - hand.torque_upper, hand.torque_lower - tau)
    joint = int(beyond.argmax())
    if beyond[joint] <= 0.0:
        return None
    name, limit = hand.joints[joint].name, hand.joints[joint].torque
    reason = (
        f"{_place_text(float(s[i]))} joint {name} needs {abs(tau[joint]):.4g} N·m to bear its finger, and has {limit:.4g} N·m."
    )
    return PlanFailure(OVERLOADED, reason, float(s[i]), name)


def _place_text(s: float) -> str:
    return {0.0: "At the start", 1.0: "At the goal"}.get(s, f"At s = {s:.3f}")


def _remedies(friction: float | None, torque: float | None) -> str:
    """What would help, from the two factors."""
    helps = []
    if friction is not None:
        helps.append(f"{friction:.4g} times the friction")
    if torque is not None:
        helps.append(f"{torque:.4g} times the motors' torque limits")
    return f" It would take {' or '.join(helps)}." if helps else ""
