"""Plans of grasp cycles in a table scene: postures around the grasp, and the approach between them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from graspforce.control.joints.joint_trajectory import JointTrajectory
from graspforce.control.phases.cycle_plan import CyclePlan
from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.control.phases.tip_motion import opened_posture
from graspforce.control.settings import ControlSettings
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Box, Cylinder, Sphere
from graspforce.geometry.vectors import table_axes
from graspforce.grasp.body import Body
from graspforce.grasp.collision.obstacle import Obstacle
from graspforce.grasp.collision.scene_collision import SceneCollision
from graspforce.grasp.collision.settings import CollisionSettings
from graspforce.hand.hand import Hand
from graspforce.planning.failure import PlanFailure
from graspforce.planning.moves.fingers_move import FingersMove
from graspforce.planning.task import FingerTask
from graspforce.simulation.cycle.cycle_checks import check_size, check_weight
from graspforce.simulation.cycle.pose_errors import count_missed_faces, extreme_poses
from graspforce.simulation.cycle.table_scene import TableScene, find_table_grasp, hand_clearance

SeedCallback = Callable[[int, str], None]

_MORE_TRIES = 8  # after the first grasp that allows a cycle
_TRIES = ((1.0, 8), (0.4, 16))  # least distances of contacts from edges over the tip radius, and seeds that are tried with each
_OPEN_DISTANCE = 0.05  # m: distance of the fingertips from the contacts in the start posture
_LEAST_CLEARANCE = 0.0005  # m, of links, palm, object and table
_STANDOFF_SHARES = (1.0, 1.25, 1.5, 0.85, 0.7)  # of the stand-off distance, that are tried in turn
_STARTS, _START_SPREAD = 40, 0.15  # random start postures that are tried, and their spread as a part of each joint's range
_LEAST_WAY = 0.03  # of its range: way of the joint that moves furthest in the approach
_CHECKED_POSTURES = 20  # of an optimised approach
_JOINT_SPEED = 0.5  # rad/s: mean rate of the fastest joint in the approach
_LEAST_TIME = 0.8  # s, of the approach
_LIFT = 0.05  # m


@dataclass(frozen=True, slots=True)
class CycleMotion:
    """Motion of the hand in a cycle.

    Args:
        lift: height of the lift, m.
        move: (2,) displacement along the table, m.
        optimised: whether the approach is planned by `FingersMove`; otherwise it is a straight line of the joints.
    """

    lift: float = _LIFT
    move: tuple[float, float] = (0.05, 0.0)
    optimised: bool = True


def plan_cycle(scene: TableScene, settings: PhaseSettings | None = None, motion: CycleMotion | None = None) -> CyclePlan:
    """Return the plan of a cycle in a table scene.

    Args:
        scene: the scene.
        settings: settings of the phases; the stand-off distance counts.
        motion: motion of the hand.

    Raises:
        InvalidInput: a finger cannot leave its contact along the normal, or a posture touches the table.
    """
    settings, motion, grasp = settings or PhaseSettings(), motion or CycleMotion(), scene.grasp
    q_pregrasp, standoff = _pregrasp(scene, settings.standoff)
    q_start = _start_posture(scene, q_pregrasp)
    approach = _approach(scene, q_start, q_pregrasp, motion.optimised)
    return CyclePlan(
        grasp=grasp,
        gravity_H=scene.gravity_H,
        q_pregrasp=q_pregrasp,
        standoff=standoff,
        approach=approach,
        lift=-motion.lift * scene.down,
        move=np.asarray(motion.move) @ table_axes(scene.down),
    )


def _pregrasp(scene: TableScene, distance: float) -> tuple[Array, Array]:
    """Return a pre-grasp posture in which nothing touches, and its stand-off distances (N,), m."""
    gap = -np.inf
    for share in _STANDOFF_SHARES:
        q, standoff = opened_posture(scene.grasp, share * distance)
        gap = max(gap, _least_gap(scene, q))
        if gap >= _LEAST_CLEARANCE and standoff.min() >= min(_STANDOFF_SHARES) * distance:
            return q, standoff
    raise InvalidInput("scene", f"pre-grasp postures with a gap of {1e3 * gap:.1f} mm at most", "a grasp with room around it")


def _start_posture(scene: TableScene, q_pregrasp: Array) -> Array:
    """Return a posture that is further open than the pre-grasp posture; nothing touches on the straight way between them.

    The fingertips are 50 mm off their contacts, or as far as they reach; if something touches, a random posture is taken.
    """
    hand = scene.grasp.hand
    rng = np.random.default_rng(0)
    spread = _START_SPREAD * (hand.q_upper - hand.q_lower)
    candidates = [opened_posture(scene.grasp, _OPEN_DISTANCE)[0]]
    candidates += [
        np.clip(q_pregrasp + spread * rng.uniform(-1.0, 1.0, hand.n), hand.q_lower, hand.q_upper) for _ in range(_STARTS)
    ]
    for q in candidates:
        way = [q_pregrasp + share * (q - q_pregrasp) for share in np.linspace(0.2, 1.0, 5)]
        is_far = (np.abs(q - q_pregrasp) > _LEAST_WAY * (hand.q_upper - hand.q_lower)).any()
        if is_far and min(_least_gap(scene, each) for each in way) >= _LEAST_CLEARANCE:
            return np.asarray(q)
    raise InvalidInput("scene", "a pre-grasp posture from which the fingers cannot move away", "a grasp with room around it")


def _least_gap(scene: TableScene, q: Array) -> float:
    """Return the least distance of links, palm, object and table in a posture, m; negative for an overlap.

    The object is at its expected pose, and displaced and turned by the largest error of that pose.
    """
    grasp, poses = scene.grasp, extreme_poses(scene)
    rows = np.repeat(q[None], len(poses), axis=0)
    collision = SceneCollision(grasp.hand, grasp.body.shape)
    gap = collision.least_gap_along(rows, np.array([p for p, _ in poses]), np.array([R for _, R in poses]))
    return min(hand_clearance(scene, q), np.inf if gap is None else gap.gap.distance)


def _approach(scene: TableScene, q_start: Array, q_goal: Array, optimised: bool) -> JointTrajectory:
    """Return the motion to the pre-grasp posture: the optimised one if nothing touches, otherwise a straight line."""
    duration = max(float(np.abs(q_goal - q_start).max()) / _JOINT_SPEED, _LEAST_TIME)
    if optimised:
        task = FingerTask(scene.grasp.hand, scene.gravity_H, CollisionSettings(obstacles=_obstacles(scene)))
        plan = FingersMove(task, np.array([q_start, q_goal])).plan(budget=10.0)
        if not isinstance(plan, PlanFailure):
            knots, scale = plan.knots, max(duration / plan.duration, 1.0)
            motion = JointTrajectory(scale * knots.times, knots.q, knots.v / scale, knots.a / scale**2)
            checked = (motion(t).q for t in np.linspace(0.0, motion.duration, _CHECKED_POSTURES))
            if all(_least_gap(scene, q) >= _LEAST_CLEARANCE for q in checked):  # also of an object that is displaced
                return motion
    return JointTrajectory.between(q_start, q_goal, duration)


def _obstacles(scene: TableScene) -> tuple[Obstacle, ...]:
    """Return the table, and the object if it is a sphere, a cylinder or a box."""
    shape, grasp = scene.grasp.body.shape, scene.grasp
    if isinstance(shape, Sphere | Cylinder | Box):
        return (scene.table, Obstacle(shape, grasp.p_HO, grasp.R_HO))
    return (scene.table,)


def find_cycle(
    hand: Hand,
    body: Body,
    fingers: Sequence[str] | None = None,
    *,
    friction: float = 0.6,
    seed: int = 0,
    settings: PhaseSettings | None = None,
    motion: CycleMotion | None = None,
    control: ControlSettings | None = None,
    on_seed: SeedCallback = lambda seed, message: None,
) -> tuple[TableScene, CyclePlan]:
    """Find a grasp of an object on a table, and plan its cycle, with seeds of `find_grasp` in turn.

    Contacts are at least a tip radius from the edges of the object's faces for 8 seeds, then 40 % of it for 16 seeds. The
    result is the first grasp that allows a cycle and whose fingers touch their faces also if the object is displaced by 10 mm
    and turned by 10°. After the first grasp that allows a cycle, 8 more seeds are tried. If none meets this, the result is
    the grasp that misses faces at the fewest of these poses.

    Args:
        hand: the hand.
        body: the object.
        fingers: as in `find_grasp`.
        friction: coefficient of friction.
        seed: first seed.
        settings: settings of the phases.
        motion: motion of the hand.
        control: settings of the object controller, whose gravity does not count: the grasp must hold the largest weight with
            the least friction that they assume. Default: `ControlSettings()`.
        on_seed: called with each seed, and what its grasp lacks; with an empty text if it lacks nothing.

    Raises:
        InvalidInput: the object is too wide for the hand, or no grasp of these seeds allows a cycle; gives the fault of the
            last one.
    """
    check_size(hand, body, friction)
    travel = (settings or PhaseSettings()).largest_travel  # m
    fault, best, fewest, more = "", None, math.inf, _MORE_TRIES
    tries = [(seed + k, ratio) for ratio, count in _TRIES for k in range(count)]
    for each, ratio in tries:
        try:
            scene = find_table_grasp(hand, body, fingers, friction=friction, seed=each, edge_ratio=ratio)
            check_weight(scene.grasp, replace(control or ControlSettings(), gravity_H=scene.gravity_H))
            plan = plan_cycle(scene, settings, motion)
        except InvalidInput as error:
            fault = str(error)
            on_seed(each, fault)
        else:
            missed = count_missed_faces(scene, plan.standoff, travel)
            on_seed(each, f"fingers miss their faces at {missed} extreme poses of the object" if missed else "")
            if missed < fewest:
                best, fewest = (scene, plan), missed
        more -= best is not None
        if fewest == 0 or more < 0:
            break
    if best is not None:
        return best
    name = type(body.shape).__name__
    allowed = f"an object that {hand.name} can pick from a table; the last of {len(tries)} grasps: {fault}"
    raise InvalidInput("body", name, allowed)
