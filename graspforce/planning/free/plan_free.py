"""The minimum-time planner of an object from pose to pose: path of the object, joints and contact forces together."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy.typing as npt

from graspforce.contact.contact import ContactModel
from graspforce.core import fields
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Box, Cylinder, Sphere, Superquadric
from graspforce.planning import tip_contacts
from graspforce.planning.collisions import (
    inevitable_collision,
    no_detour_failure,
    scene_of_task,
)
from graspforce.planning.failure import STOPPED, UNSOLVED, PlanFailure, no_other_path_failure
from graspforce.planning.free.guess import guess_from_end_poses
from graspforce.planning.free.program import object_move_program
from graspforce.planning.free.workspace import UNBOUNDED, WorkspaceBounds, check_workspace
from graspforce.planning.given_points import check_poses, check_start_posture
from graspforce.planning.path.paths import StraightPath
from graspforce.planning.path.plan_along import plan_along
from graspforce.planning.plan import Plan
from graspforce.planning.progress import EQUATIONS, STRAIGHT_PATH_SHARE, PlanningBudget, ProgressCallback
from graspforce.planning.search import find_faster_plan
from graspforce.planning.separation import Separation
from graspforce.planning.settings import SEARCH_INTERVALS, PlanSettings
from graspforce.planning.task import FingerTask, GraspTask, IdealTask, ObjectTask, Task
from graspforce.planning.trajectory import Trajectory

_NOT_FOUND = "No motion inside the workspace was found, although the object can be held at both ends."


def plan_free(
    task: ObjectTask,
    p_HO: npt.ArrayLike,
    R_HO: npt.ArrayLike,
    q_start: npt.ArrayLike | None = None,
    *,
    workspace: WorkspaceBounds = UNBOUNDED,
    settings: PlanSettings | None = None,
    callback: ProgressCallback | None = None,
) -> Plan | PlanFailure:
    """Plan the fastest move of an object from pose to pose, from rest to rest, and check it between its knots.

    The search begins with the plan along the straight path. That plan is the result if the search finds no faster one that
    passes the check, or if it is stopped. Accelerations are linear between knots and all equations hold at the knots; a plan
    that exceeds a limit between them is slowed down as little as possible. Round fingertips roll on the object, and their
    contacts at the goal are free. The result is a local optimum, without a proof that no faster move exists.

    Args:
        task: a hand with an object, or an object between ideal fingers. All contacts are point or soft contacts with
            friction. Every finger has three joints or more, and four or more if its soft contact rolls, because it must not
            spin.
        p_HO: (2, 3) positions of O's origin in H at start and goal, m.
        R_HO: (2, 3, 3) orientations at start and goal, less than half a turn apart.
        q_start: (n,) posture near the start, rad; the neutral posture by default. Ideal fingers have none.
        workspace: bounds of the object's pose on its way.
        settings: number of intervals (default 40), tolerance, budget, and whether to compile the equations. The budget is
            checked between stages and once an iteration.
        callback: function called with the `Progress` at every stage and iteration; it returns False to stop.

    Returns:
        The plan, or the reason why there is none.

    Raises:
        InvalidInput: a task outside these limits, or a value out of range.
    """
    _check_task(task)
    settings = PlanSettings() if settings is None else settings
    intervals = fields.check_integer(settings.intervals or SEARCH_INTERVALS, "intervals", minimum=4, maximum=2000)
    p_HO, R_HO = check_poses(p_HO, R_HO, 2)
    path, q_start = StraightPath(p_HO[0], R_HO[0], p_HO[1], R_HO[1]), check_start_posture(task, q_start)
    check_workspace(workspace, p_HO)
    started, budget = time.perf_counter(), PlanningBudget(settings.budget, callback)
    separation = Separation(scene_of_task(task))
    along = plan_along(
        task if isinstance(task, IdealTask) else replace(task, collisions=None),
        path,
        q_start,
        settings=replace(settings, intervals=intervals, budget=budget.remaining),
        callback=budget.sub_callback(0.0, STRAIGHT_PATH_SHARE),
    )
    not_found = along if isinstance(along, PlanFailure) else PlanFailure(UNSOLVED, _NOT_FOUND)
    if isinstance(along, Plan):
        along = replace(along, task=task)
        inevitable = inevitable_collision(separation.scene, along)
        if inevitable is not None:
            return inevitable
        collision = separation.find_collision(along)
        if collision is not None:
            not_found = no_detour_failure(collision)
        elif workspace.contains(path):
            budget.add_plan(along)
    if not_found.kind == STOPPED or not budget.should_continue(EQUATIONS, STRAIGHT_PATH_SHARE):
        return budget.result(not_found)
    if isinstance(along, Plan):
        first: Trajectory | PlanFailure = along.at_even_times(intervals)
    else:
        first = guess_from_end_poses(task, path, q_start, intervals)
    if isinstance(first, PlanFailure):
        return first
    if isinstance(along, PlanFailure):
        not_found = no_other_path_failure(along)
    for _ in range(separation.search_count(budget.best)):
        move = object_move_program(task, first, workspace, separation=separation, compiled=settings.compiled)
        seconds = time.perf_counter() - started
        collision = find_faster_plan(move, budget, seconds, settings.tolerance, _contacts_on_faces, separation.find_collision)
        if collision is None or separation.last is None:
            break
        not_found, first = no_detour_failure(collision), separation.last.at_even_times(intervals)
    return budget.result(not_found)


def _contacts_on_faces(plan: Plan) -> bool:
    """Return whether no contact has rolled onto an edge, where the surface has no normal."""
    task = plan.task
    return isinstance(task, FingerTask) or tip_contacts.edge_contact(task, plan.knots.p_OC) is None


def _check_task(task: Task) -> None:
    """Raise InvalidInput unless the program can represent the task."""
    if isinstance(task, FingerTask):
        raise InvalidInput("task", "FingerTask", "a task with an object; plan_fingers plans fingers alone")
    if task.acceleration_limits.has_jerk:
        raise InvalidInput("acceleration_limits", "a limit of jerk", "limits of accelerations; plan_along limits jerk, too")
    for i, model in enumerate(task.contacts.models):
        if model is ContactModel.FRICTIONLESS or task.contacts.mu[i] <= 0.0:
            raise InvalidInput(f"contacts[{i}].model", model.value, "a point or soft contact with friction")
    if isinstance(task, GraspTask):
        _check_fingers(task)


def _check_fingers(task: GraspTask) -> None:
    """Raise InvalidInput unless the fingers have three joints or more, share none, and roll on known surfaces only."""
    shape = task.body.shape
    if task.is_rolling.any() and shape is not None:
        if not isinstance(shape, Sphere | Cylinder | Box | Superquadric):
            raise InvalidInput(
                "body.shape", type(shape).__name__, "a Sphere, Cylinder, Box or Superquadric if tips roll, or none"
            )
        if isinstance(shape, Superquadric) and (shape.exponents > 1.0).any():
            allowed = "at most 1 if tips roll: the surface has edges otherwise"
            raise InvalidInput("body.shape.exponents", shape.exponents, allowed)
    owner: dict[int, str] = {}
    for i, name in enumerate(task.fingers):
        joints = task.hand.finger(name).joints
        if len(joints) < 4 and task.is_rolling[i] and task.contacts.gamma[i] > 0.0:
            allowed = "fingers of at least four joints if their soft contacts roll, which must not spin"
            raise InvalidInput("fingers", name, allowed)
        if len(joints) < 3:
            raise InvalidInput("fingers", name, "fingers of at least three joints, which can move their tips in any direction")
        for joint in joints:
            if joint in owner:
                shared = f"{owner[joint]} and {name} share {task.hand.joints[joint].name}"
                raise InvalidInput("fingers", task.fingers, f"fingers that share no joint: {shared}")
            owner[joint] = name
