"""The minimum-time planner of fingers alone, from posture to posture, for pre-shaping and regrasping."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.grasp.collision.obstacle import Obstacle, check_obstacles
from graspforce.planning.check import times_between
from graspforce.planning.collisions import SAMPLES_PER_INTERVAL, no_detour_failure, path_collision, scene_of_task
from graspforce.planning.failure import UNREACHABLE, UNSOLVED, PlanFailure
from graspforce.planning.fingers import clearances
from graspforce.planning.fingers.clearances import TipClearances
from graspforce.planning.fingers.program import fingers_program
from graspforce.planning.given_points import check_posture, check_postures
from graspforce.planning.path.paths import JointPath
from graspforce.planning.path.plan_along import plan_fingers_along
from graspforce.planning.plan import Plan
from graspforce.planning.progress import EQUATIONS, STRAIGHT_PATH_SHARE, PlanningBudget, ProgressCallback
from graspforce.planning.search import find_faster_plan
from graspforce.planning.separation import Separation
from graspforce.planning.settings import SEARCH_INTERVALS, PlanSettings
from graspforce.planning.task import FingerTask

_NOT_FOUND = "No motion with these clearances was found, although start and goal have them."


def plan_fingers(
    task: FingerTask,
    q_start: npt.ArrayLike,
    q_goal: npt.ArrayLike,
    *,
    clearance: float = 0.0,
    obstacles: Sequence[Obstacle] = (),
    settings: PlanSettings | None = None,
    callback: ProgressCallback | None = None,
) -> Plan | PlanFailure:
    """Plan the fastest move of fingers alone from posture to posture, from rest to rest, and check it between its knots.

    The search begins with the straight line between both postures. That line is the result if it keeps the clearances and
    the search finds no faster move that passes the check. Fingers whose joints are the same in both postures do not move.
    With limits of jerk there is no search: the result is the straight line, or the reason why it cannot be followed.

    Args:
        task: the hand.
        q_start: (n,) posture at the start, rad.
        q_goal: (n,) posture at the goal, rad.
        clearance: smallest distance between the spheres of two tips, and between a tip's sphere and an obstacle, m.
        obstacles: obstacles for the tips and links, beside those of the task.
        settings: as `plan_free`.
        callback: as `plan_free`.

    Returns:
        The plan, or the reason why there is none.

    Raises:
        InvalidInput: a value out of range, a posture beyond the joint limits, or the same posture twice.
    """
    if not isinstance(task, FingerTask):
        raise InvalidInput("task", type(task).__name__, "a FingerTask; plan_free plans a move of an object")
    if task.acceleration_limits.has_jerk:
        ends = np.array([check_posture(task.hand, q, name) for name, q in (("q_start", q_start), ("q_goal", q_goal))])
        return plan_fingers_through(task, ends, clearance, obstacles, settings=settings, callback=callback)
    hand, settings = task.hand, PlanSettings() if settings is None else settings
    q_start, q_goal = check_posture(hand, q_start, "q_start"), check_posture(hand, q_goal, "q_goal")
    intervals = fields.check_integer(settings.intervals or SEARCH_INTERVALS, "intervals", minimum=4, maximum=2000)
    started, budget = time.perf_counter(), PlanningBudget(settings.budget, callback)
    tips = TipClearances(hand, arrays.check_number(clearance, "clearance", minimum=0.0), check_obstacles(obstacles))
    lacking = _clearance_failure(tips, {"start": (0.0, q_start), "goal": (1.0, q_goal)})
    if lacking is not None:
        return lacking
    scene = scene_of_task(task, tips.obstacles)
    separation = Separation(scene)
    straight = plan_fingers_along(
        replace(task, collisions=None),
        JointPath.through([q_start, q_goal]),
        settings=replace(settings, intervals=intervals, budget=budget.remaining),
        callback=budget.sub_callback(0.0, STRAIGHT_PATH_SHARE),
    )
    if isinstance(straight, PlanFailure):
        return budget.result(straight)
    collision = path_collision(scene, np.array([0.0, 1.0]), np.array([q_start, q_goal]), None)
    if collision is not None:
        return collision
    straight, not_found = replace(straight, task=task), PlanFailure(UNSOLVED, _NOT_FOUND)
    collision = separation.find_collision(straight)
    if collision is not None:
        not_found = no_detour_failure(collision)
    elif tips.is_kept(straight):
        budget.add_plan(straight)
    if not budget.should_continue(EQUATIONS, STRAIGHT_PATH_SHARE):
        return budget.result(not_found)
    knots = straight.at_even_times(intervals)
    for _ in range(separation.search_count(budget.best)):
        move = fingers_program(task, tips, knots, separation, settings.compiled)
        seconds = time.perf_counter() - started
        collision = find_faster_plan(move, budget, seconds, settings.tolerance, tips.is_kept, separation.find_collision)
        if collision is None or separation.last is None:
            break
        not_found, knots = no_detour_failure(collision), separation.last.at_even_times(intervals)
    return budget.result(not_found)


def plan_fingers_through(
    task: FingerTask,
    postures: npt.ArrayLike,
    clearance: float = 0.0,
    obstacles: Sequence[Obstacle] = (),
    *,
    settings: PlanSettings | None = None,
    callback: ProgressCallback | None = None,
) -> Plan | PlanFailure:
    """Plan the fastest move of fingers alone along the spline through postures, from rest to rest, without a stop between.

    Args:
        task: the hand.
        postures: (M, n) postures, start first and goal last, rad.
        clearance: as `plan_fingers`.
        obstacles: as `plan_fingers`.
        settings: as `plan_fingers_along`.
        callback: as `plan_fingers_along`.

    Returns:
        The plan, or the reason why there is none. The spline is given: a clearance that it lacks ends the planning, which does
        not prove that another motion through the postures lacks it, too.

    Raises:
        InvalidInput: a value out of range, a posture beyond the joint limits, or equal postures in a row.
    """
    hand, postures = task.hand, check_postures(task.hand, postures, "postures")
    tips = TipClearances(hand, arrays.check_number(clearance, "clearance", minimum=0.0), check_obstacles(obstacles))
    names = {len(postures) - 1: "goal", 0: "start"}
    places = {names.get(i, f"posture {i}"): (i / (len(postures) - 1), q) for i, q in enumerate(postures)}
    lacking = _clearance_failure(tips, places)
    if lacking is not None:
        return lacking
    if task.collisions is not None and tips.obstacles:
        around = (*task.collisions.obstacles, *tips.obstacles)
        task = replace(task, collisions=replace(task.collisions, obstacles=around))
    plan = plan_fingers_along(task, JointPath.through(postures), settings=settings, callback=callback)
    if isinstance(plan, PlanFailure) or tips.is_kept(plan):
        return plan
    t = times_between(plan.knots.times, SAMPLES_PER_INTERVAL - 1)
    lack, words = tips.largest_lack(plan.at(t).q)
    reason = f"Between the postures, the clearance {words} is too small by {1e3 * lack:.2g} mm; other via postures may keep it."
    return PlanFailure(UNSOLVED, reason)


def _clearance_failure(tips: TipClearances, places: Mapping[str, tuple[float, Array]]) -> PlanFailure | None:
    """Return the failure of a given posture that lacks a clearance; None if all have them.

    Args:
        tips: the clearances.
        places: for each posture its name, its place on the path, and the joints (n,), rad.
    """
    for where, (s, q) in places.items():
        lack, words = tips.largest_lack(q[None])
        if lack > clearances.TOLERANCE:
            at = f"the {where}" if where in ("start", "goal") else where
            return PlanFailure(UNREACHABLE, f"At {at}, the clearance {words} is too small by {1e3 * lack:.2g} mm.", s)
    return None
