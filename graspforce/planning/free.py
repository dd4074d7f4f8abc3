"""The fastest move of a held object from pose to pose, whichever way it goes: object, fingers and forces planned together."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from graspforce import arrays, fields
from graspforce.contact import ContactModel
from graspforce.errors import InvalidInput
from graspforce.planning import guess, touch
from graspforce.planning.along_path import plan_along
from graspforce.planning.free_program import ANYWHERE, Room, held_move
from graspforce.planning.path import Straight
from graspforce.planning.plan import Motion, Plan
from graspforce.planning.progress import BUDGET, EQUATIONS, STRAIGHT, Course, Watch
from graspforce.planning.refusal import STOPPED, UNSOLVED, Refusal
from graspforce.planning.search import search
from graspforce.planning.task import Task
from graspforce.planning.verify import TOLERANCE
from graspforce.shapes import Box, Cylinder, Sphere

_NO_WAY = "No motion was found that keeps to its room, although both ends can be held."


def plan_free(
    task: Task,
    p_start: Any,
    R_start: Any,
    p_goal: Any,
    R_goal: Any,
    q_start: Any = None,
    *,
    intervals: int = 40,
    room: Room = ANYWHERE,
    budget: float = BUDGET,
    watch: Watch | None = None,
    compiled: bool = False,
    tolerance: float = TOLERANCE,
) -> Plan | Refusal:
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
    fields.whole(intervals, "intervals", minimum=4, maximum=2000)
    started, course = time.perf_counter(), Course(budget, watch)
    path = Straight(p_start, R_start, p_goal, R_goal)
    straight = _inside(path, room)
    watched = course.part(0.0, STRAIGHT)
    along = plan_along(task, path, q_start, intervals=intervals, budget=course.left, watch=watched, tolerance=tolerance)
    if isinstance(along, Plan) and straight:
        course.found(along)
    none = along if isinstance(along, Refusal) else Refusal(UNSOLVED, _NO_WAY)
    if none.kind == STOPPED or not course.goes_on(EQUATIONS, STRAIGHT):
        return course.outcome(none)
    if isinstance(along, Plan):
        first: Motion | Refusal = guess.from_plan(along, intervals)
    else:
        first = guess.from_ends(
            task, path, None if q_start is None else arrays.array(q_start, "q_start", (task.joints,)), intervals
        )
    if isinstance(first, Refusal):
        return first
    move = held_move(task, first, room, compiled=compiled)
    search(move, course, time.perf_counter() - started, tolerance, _on_faces)
    return course.outcome(none)


def _on_faces(plan: Plan) -> bool:
    """Whether no contact has rolled to where the surface has no normal."""
    return touch.edge(plan.task, plan.knots.p_OC) is None


def _inside(path: Straight, room: Room) -> bool:
    """Whether the straight path stays in the room; it never turns more than its ends ask for."""
    p = path.points(np.array([0.0, 1.0])).p
    return bool((p >= room.lower - 1e-9).all() and (p <= room.upper + 1e-9).all())


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
    if task.rolls.any() and shape is not None and not isinstance(shape, Sphere | Cylinder | Box):
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
