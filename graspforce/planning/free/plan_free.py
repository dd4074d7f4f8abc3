"""The fastest move of a held object from pose to pose, whichever way it goes: object, fingers and forces planned together."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from graspforce.contact.contact import ContactModel
from graspforce.core import arrays, fields
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Box, Cylinder, Sphere
from graspforce.planning import tip_contacts
from graspforce.planning.check import TOLERANCE
from graspforce.planning.failure import STOPPED, UNSOLVED, PlanFailure
from graspforce.planning.free import guess
from graspforce.planning.free.program import UNBOUNDED, WorkspaceBounds, object_move_program
from graspforce.planning.path.paths import StraightPath
from graspforce.planning.path.plan_along import plan_along
from graspforce.planning.plan import Plan, Trajectory
from graspforce.planning.progress import (
    DEFAULT_BUDGET,
    EQUATIONS,
    STRAIGHT_PATH_SHARE,
    PlanningBudget,
    ProgressCallback,
)
from graspforce.planning.search import find_faster_plan
from graspforce.planning.task import Task

_NOT_FOUND = "No motion was found that keeps to its room, although both ends can be held."


def plan_free(
    task: Task,
    p_start: Any,
    R_start: Any,
    p_goal: Any,
    R_goal: Any,
    q_start: Any = None,
    *,
    intervals: int = 40,
    workspace: WorkspaceBounds = UNBOUNDED,
    budget: float = DEFAULT_BUDGET,
    callback: ProgressCallback | None = None,
    compiled: bool = False,
    tolerance: float = TOLERANCE,
) -> Plan | PlanFailure:
    """The fastest move from pose to pose from rest to rest, checked between its knots; or why there is none.

    The plan along the straight line between both is where the search begins, and what is handed out where the search finds
    nothing faster that passes the check, or is stopped. Accelerations are linear between knots and equations hold at knots;
    what breaks a limit in between is slowed just enough. Round tips roll on the object, as along a path; where they end on it
    is free. A local optimum: nothing says that there is no faster way.

    Args:
        task: hand, object, contacts, gravity, slip margin. Point contacts with friction, fingers of three joints or more.
        p_start, p_goal: (3,) O's origin in H, m.
        R_start, R_goal: (3, 3) O's axes in H; less than half a turn apart.
        q_start: (n,) a posture near the start, rad; by default neutral.
        intervals: between knots.
        room: where the object may be on its way.
        budget: s after which the best plan so far is handed out; looked at between stages and once an iteration.
        watch: called at every stage and iteration; returns False to stop.
        compiled: translate the equations to machine code first, where there is a C compiler; kept for later.
        tolerance: how much of each limit may be exceeded between knots.

    Raises:
        InvalidInput: what the task must be and is not.
    """
    _check_task(task)
    fields.check_integer(intervals, "intervals", minimum=4, maximum=2000)
    started, planning_budget = time.perf_counter(), PlanningBudget(budget, callback)
    path = StraightPath(p_start, R_start, p_goal, R_goal)
    straight = _is_inside(path, workspace)
    watched = planning_budget.sub_callback(0.0, STRAIGHT_PATH_SHARE)
    along = plan_along(
        task, path, q_start, intervals=intervals, budget=planning_budget.remaining, callback=watched, tolerance=tolerance
    )
    if isinstance(along, Plan) and straight:
        planning_budget.add_plan(along)
    none = along if isinstance(along, PlanFailure) else PlanFailure(UNSOLVED, _NOT_FOUND)
    if none.kind == STOPPED or not planning_budget.should_continue(EQUATIONS, STRAIGHT_PATH_SHARE):
        return planning_budget.result(none)
    if isinstance(along, Plan):
        first: Trajectory | PlanFailure = guess.guess_from_plan(along, intervals)
    else:
        first = guess.guess_from_end_poses(
            task, path, None if q_start is None else arrays.check_array(q_start, "q_start", (task.joints,)), intervals
        )
    if isinstance(first, PlanFailure):
        return first
    move = object_move_program(task, first, workspace, compiled=compiled)
    find_faster_plan(move, planning_budget, time.perf_counter() - started, tolerance, _contacts_on_faces)
    return planning_budget.result(none)


def _contacts_on_faces(plan: Plan) -> bool:
    """Whether no contact has rolled to where the surface has no normal."""
    return tip_contacts.edge_contact(plan.task, plan.knots.p_OC) is None


def _is_inside(path: StraightPath, workspace: WorkspaceBounds) -> bool:
    """Whether the straight path stays in the room; it never turns more than its ends ask for."""
    p = path.points(np.array([0.0, 1.0])).p
    return bool((p >= workspace.lower - 1e-9).all() and (p <= workspace.upper + 1e-9).all())


def _check_task(task: Task) -> None:
    contacts = task.contacts
    if contacts is None or task.body is None:
        raise InvalidInput("task", "no object", "one with an object; fingers alone go with plan_fingers")
    for i, model in enumerate(contacts.models):
        if model is not ContactModel.POINT or contacts.mu[i] <= 0.0:
            raise InvalidInput(f"contacts[{i}].model", model.value, "a point contact with friction")
    if task.hand is None:
        return
    shape = task.body.shape
    if task.is_rolling.any() and shape is not None and not isinstance(shape, Sphere | Cylinder | Box):
        raise InvalidInput("body.shape", type(shape).__name__, "a Sphere, Cylinder or Box where tips roll, or none")
    taken: dict[int, str] = {}
    for name in task.fingers:
        joints = task.hand.finger(name).joints
        if len(joints) < 3:
            raise InvalidInput("fingers", name, "fingers of at least three joints, which can move their tips anywhere")
        for joint in joints:
            if joint in taken:
                shared = f"fingers that share no joint: {taken[joint]} and {name} share {task.hand.joints[joint].name}"
                raise InvalidInput("fingers", task.fingers, shared)
            taken[joint] = name
