"""Collision checks of motions: links against one another, against the object and against obstacles, between knots too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from graspforce.core.arrays import Array
from graspforce.grasp.collision.least_gap import FramePoses
from graspforce.grasp.collision.obstacle import Obstacle
from graspforce.grasp.collision.scene_collision import GapAlong, SceneCollision
from graspforce.hand.descriptions.contact_description import HELD_OBJECT
from graspforce.planning.check import times_between
from graspforce.planning.failure import COLLISION, UNSOLVED, PlanFailure
from graspforce.planning.plan import Plan
from graspforce.planning.task import GraspTask, IdealTask, Task

TOLERANCE = 1e-5  # m: largest lack of distance
SAMPLES_PER_INTERVAL = 8  # instants in an interval that are checked


def scene_of_task(task: Task, obstacles: Sequence[Obstacle] = ()) -> SceneCollision | None:
    """Return the collision geometry of a task; None for ideal fingers, and for a task without collision checks.

    Args:
        task: the task.
        obstacles: obstacles beside those of the task.
    """
    if isinstance(task, IdealTask) or task.collisions is None:
        return None
    settings = replace(task.collisions, obstacles=(*task.collisions.obstacles, *obstacles))
    if isinstance(task, GraspTask):
        return SceneCollision(task.hand, task.body.shape, task.fingers, settings)
    return SceneCollision(task.hand, settings=settings)


def inevitable_collision(scene: SceneCollision | None, plan: Plan) -> PlanFailure | None:
    """Return a collision of every motion between the ends of a plan, whatever the fingers do; None if there is none.

    That is a collision at the start, which is given, and one of the object at the goal with a body that no joint moves.

    Args:
        scene: the bodies; None for no check.
        plan: the plan.
    """
    if scene is None:
        return None
    ends = plan.knots.q[[0, -1]], plan.knots.p_HO[[0, -1]], plan.knots.R_HO[[0, -1]]
    start = path_collision(scene, np.zeros(1), ends[0][:1], (ends[1][:1], ends[2][:1]))
    return start or path_collision(scene.of_object_and_base(), np.array([0.0, 1.0]), ends[0], (ends[1], ends[2]))


def no_detour_failure(collision: PlanFailure) -> PlanFailure:
    """Return the failure of a search that found no motion without a collision.

    Args:
        collision: the collision of the best motion so far.
    """
    reason = f"No motion without collision was found, which does not prove that there is none. {collision.reason}"
    return replace(collision, kind=UNSOLVED, reason=reason)


def path_collision(scene: SceneCollision | None, s: Array, q: Array, poses: tuple[Array, Array] | None) -> PlanFailure | None:
    """Return the failure of a path on which two bodies come too near; None if there is none.

    Args:
        scene: the bodies; None for no check.
        s: (M,) path parameters.
        q: (M, n) postures there, rad.
        poses: positions (M, 3) of the object, m, and its axes (M, 3, 3) there; None without an object.
    """
    least = None if scene is None else scene.least_gap_along(q, *(poses or (None, None)))
    if least is None or least.lack <= TOLERANCE:
        return None
    at = float(s[least.instant])
    return _failure(least, {0.0: "At the start", 1.0: "At the goal"}.get(at, f"At s = {at:.3f}"), at)


def plan_collision(scene: SceneCollision | None, plan: Plan) -> PlanFailure | None:
    """Return the failure of a plan in which two bodies come too near, between its knots too; None if there is none.

    Args:
        scene: the bodies; None for no check.
        plan: the plan.
    """
    times = times_between(plan.knots.times, SAMPLES_PER_INTERVAL - 1)
    least = None if scene is None else least_gap_of_plan(scene, plan, times)
    if least is None or least.lack <= TOLERANCE:
        return None
    t = float(times[least.instant])
    return _failure(least, f"At {1e3 * t:.1f} ms", t / plan.duration)


def least_gap_of_plan(scene: SceneCollision, plan: Plan, times: Array | None = None) -> GapAlong | None:
    """Return the two bodies of a plan that come nearest to their required distance.

    Args:
        scene: the bodies.
        plan: the plan.
        times: (M,) instants to check, s; `SAMPLES_PER_INTERVAL` in each interval by default.
    """
    times = times_between(plan.knots.times, SAMPLES_PER_INTERVAL - 1) if times is None else times
    at = plan.at(times)
    poses = (at.p_HO, at.R_HO) if isinstance(plan.task, GraspTask) else (None, None)
    return scene.least_gap_along(at.q, *poses)


def poses_of_plan(scene: SceneCollision, plan: Plan) -> FramePoses:
    """Return the poses of a scene's frames at the instants of a plan that are checked.

    Args:
        scene: the bodies.
        plan: the plan.
    """
    at = plan.at(times_between(plan.knots.times, SAMPLES_PER_INTERVAL - 1))
    return scene.poses(at.q, *((at.p_HO, at.R_HO) if isinstance(plan.task, GraspTask) else (None, None)))


def _failure(least: GapAlong, when: str, s: float) -> PlanFailure:
    """Return the failure of two bodies that come too near."""
    gap, point = least.gap, np.mean(least.gap.points, axis=0)
    names = [name if name != HELD_OBJECT else "the object" for name in (gap.first, gap.second)]
    if gap.distance < 0.0:
        fault = f"overlap by {-1e3 * gap.distance:.2g} mm"
    else:
        fault = f"are {1e3 * gap.distance:.2g} mm apart, below {1e3 * least.required:.2g} mm"
    place = ", ".join(f"{1e3 * x:.1f}" for x in point)
    reason = f"{when}, {names[0]} and {names[1]} {fault}, at ({place}) mm in the hand's base frame."
    return PlanFailure(COLLISION, reason, s, links=(gap.first, gap.second), point=tuple(point.tolist()))
