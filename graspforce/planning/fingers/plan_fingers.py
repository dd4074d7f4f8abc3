"""The fastest move of fingers alone from posture to posture, their tips kept apart: pre-shaping, letting go to regrasp."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from typing import Any

import casadi as ca
import numpy as np

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Sphere
from graspforce.hand.hand import Hand
from graspforce.planning.check import TOLERANCE, interpolation_nodes, sample_intervals
from graspforce.planning.failure import UNREACHABLE, UNSOLVED, PlanFailure
from graspforce.planning.fingers.obstacles import Obstacle, obstacle_equations, tip_distance_equations
from graspforce.planning.free.guess import guess_from_plan
from graspforce.planning.interpolation import Indices
from graspforce.planning.loads import with_torques
from graspforce.planning.nlp.equations import Equations, equations
from graspforce.planning.nlp.machine_code import compile_equations
from graspforce.planning.nlp.symbolic_finger import symbolic_finger
from graspforce.planning.nlp.transcription import KnotEquations, KnotLayout, Program, ProgramStructure
from graspforce.planning.path.paths import JointPath
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

_STEP_WEIGHT = 1e-6  # the weight of the accelerations' squared steps beside T = 1
_REST_TOLERANCE = 1e-9  # rad: a joint that turns less does not move
_MIN_RADIUS = 1e-4  # m: the radius of a tip that has none
_END_TOLERANCE = 1e-6  # of a least distance: what the program's clearances may lack beside those at the ends
_CLEARANCE_TOLERANCE = 1e-5  # m: what a clearance may lack between knots
_NOT_FOUND = "No motion was found that keeps the fingertips apart, although they are at both ends."


def plan_fingers(
    task: Task,
    q_start: Any,
    q_goal: Any,
    *,
    clearance: float = 0.0,
    obstacles: Sequence[Obstacle] = (),
    intervals: int = 40,
    budget: float = DEFAULT_BUDGET,
    callback: ProgressCallback | None = None,
    compiled: bool = False,
    tolerance: float = TOLERANCE,
) -> Plan | PlanFailure:
    """The fastest move from posture to posture from rest to rest, checked between its knots; or why there is none.

    Fingers whose joints all stay where they are stand still throughout. The straight line between both postures is where the
    search begins, and what is handed out where nothing faster is found that passes the check.

    Args:
        task: a hand without an object.
        q_start, q_goal: (n,) postures, rad.
        apart: the least distance between the balls of two fingers' tips, and between them and obstacles, m.
        obstacles: what the tips must keep away from.
        intervals, budget, watch, compiled, tolerance: as for `plan_free`.

    Raises:
        InvalidInput: a task with an object, or the same posture twice.
    """
    hand = task.hand
    if hand is None or task.body is not None:
        raise InvalidInput("task", "an object", "a hand without an object; an object goes with plan_free")
    q_start = arrays.check_array(q_start, "q_start", (hand.n,))
    q_goal = arrays.check_array(q_goal, "q_goal", (hand.n,))
    fields.check_integer(intervals, "intervals", minimum=4, maximum=2000)
    started, planning_budget = time.perf_counter(), PlanningBudget(budget, callback)
    tips = _TipClearances(hand, arrays.check_number(clearance, "apart", minimum=0.0), tuple(obstacles))
    for where, q in (("start", q_start), ("goal", q_goal)):
        missing, word = tips.worst(q[None])
        if missing > _CLEARANCE_TOLERANCE:
            return PlanFailure(UNREACHABLE, f"At the {where}, {word} by {1e3 * missing:.2g} mm too little.", float(q is q_goal))
    path, watched = JointPath.through([q_start, q_goal]), planning_budget.sub_callback(0.0, STRAIGHT_PATH_SHARE)
    along = plan_along(task, path, intervals=intervals, budget=planning_budget.remaining, callback=watched, tolerance=tolerance)
    if isinstance(along, PlanFailure):
        return planning_budget.result(along)
    none = PlanFailure(UNSOLVED, _NOT_FOUND)
    if tips.clear(along):
        planning_budget.add_plan(along)
    if not planning_budget.should_continue(EQUATIONS, STRAIGHT_PATH_SHARE):
        return planning_budget.result(none)
    move = _fingers_program(task, tips, guess_from_plan(along, intervals), compiled)
    find_faster_plan(move, planning_budget, time.perf_counter() - started, tolerance, tips.clear)
    return planning_budget.result(none)


@dataclass(frozen=True, eq=False, slots=True)
class _TipClearances:
    """The clearances between fingertips' balls, and to obstacles."""

    hand: Hand
    clearance: float
    obstacles: tuple[Obstacle, ...]

    @property
    def fingers(self) -> tuple[str, ...]:
        return tuple(finger.name for finger in self.hand.fingers)

    def radius(self, name: str) -> float:
        return self.hand.finger(name).tip_radius or 0.0

    def worst(self, q: Array) -> tuple[float, str]:
        """What the least clearance lacks in postures (M, n), m, and whose it is."""
        return self._worst(self.hand.tips_along(q, self.fingers)[0])

    def clear(self, plan: Plan) -> bool:
        """Whether the clearances are kept throughout."""
        p, _ = self.hand.tips_along(plan.at(interpolation_nodes(plan.knots.times)).q, self.fingers)
        return self._worst(sample_intervals(p))[0] <= _CLEARANCE_TOLERANCE

    def _worst(self, p: Array) -> tuple[float, str]:
        """Likewise of the tips' middles (M, F, 3), m."""
        lacks, words = [-np.inf], [""]
        for (i, one), (j, other) in combinations(enumerate(self.fingers), 2):
            least = self.radius(one) + self.radius(other) + self.clearance
            lacks.append(least - float(np.linalg.norm(p[:, i] - p[:, j], axis=1).min()))
            words.append(f"the tips of {one} and {other} are apart")
        for i, name in enumerate(self.fingers):
            for k, obstacle in enumerate(self.obstacles):
                lacks.append(self.radius(name) + self.clearance - float(obstacle.distance(p[:, i]).min()))
                words.append(f"the tip of {name} is clear of obstacles[{k}]")
        at = int(np.argmax(lacks))
        return lacks[at], words[at]


@lru_cache(maxsize=64)
def _motor_equations(hand: Hand, finger: str) -> Equations:
    """A finger's torques and rates over their limits. Variables: y, v, a, T. Numbers: units, gravity_H, limits, h/T."""
    model = symbolic_finger(hand, finger, hand.neutral)
    m = len(model.joints)
    y, v, a, T = *(ca.SX.sym(name, m) for name in "yva"), ca.SX.sym("T")
    joint, unit, gravity = ca.SX.sym("joint"), ca.SX.sym("time"), ca.SX.sym("gravity", 3)
    limit, fastest, part = ca.SX.sym("limit", m), ca.SX.sym("fastest", m), ca.SX.sym("part")
    q, q_d, q_dd = joint * y, joint / unit * v, joint / unit**2 * a
    peak = (q_d + q_dd * part * T * unit / 2.0) / fastest
    g = ca.vertcat(model.torque(q, q_d, q_dd, gravity) / limit, peak)
    return equations("moving", ca.vertcat(y, v, a, T), ca.vertcat(joint, unit, gravity, limit, fastest, part), g)


@dataclass(frozen=True, eq=False, slots=True)
class _FingersMoveProgram:
    """A move as a program, and what its variables mean."""

    task: Task
    program: Program
    guess: Array
    joints: list[int]
    joint: float
    time: float
    posture: Array

    def trajectory(self, x: Array) -> Trajectory:
        layout, M = self.program.structure.layout, len(x)
        states = [np.tile(self.posture, (M, 1)), np.zeros((M, len(self.posture))), np.zeros((M, len(self.posture)))]
        for k, kind in enumerate("yva"):
            states[k][:, self.joints] = x[:, layout.part(kind)] * self.joint / self.time**k
        times = self.time * x[-1, layout.duration] * np.arange(M) / (M - 1)
        none = np.zeros((M, 0))
        q, v, a = states
        return with_torques(self.task, Trajectory(times, q, v, a, none, none, *_NO_OBJECT))


_NO_OBJECT = [np.zeros((0, *shape)) for shape in ((3,), (3, 3), (6,), (6,), (0, 3), (0, 3, 3), (0, 3))]


def _fingers_program(task: Task, tips: _TipClearances, knots: Trajectory, compiled: bool) -> _FingersMoveProgram:
    hand, K = tips.hand, len(knots.times) - 1
    turned = np.abs(knots.q[-1] - knots.q[0])
    moving = [finger.name for finger in hand.fingers if turned[list(finger.joints)].max() > _REST_TOLERANCE]
    joints = sorted({joint for name in moving for joint in hand.finger(name).joints})
    layout, joint, unit = KnotLayout(len(joints), 0), float(turned.max()), float(knots.times[-1])

    x = np.zeros((K + 1, layout.size))
    for k, (kind, states) in enumerate(zip("yva", (knots.q, knots.v, knots.a), strict=True)):
        x[:, layout.part(kind)] = states[:, joints] * unit**k / joint
    x[:, layout.duration] = 1.0

    def of(name: str) -> list[int]:
        return [joints.index(i) for i in hand.finger(name).joints]

    rows: list[tuple[KnotEquations, Array, tuple[Array, Array]]] = []

    def add(e: Equations, variables: list[Indices], numbers: list[Any], lower: Array, upper: Array) -> None:
        e = compile_equations(e) if compiled else e
        where = tuple(int(i) for i in np.concatenate(variables))
        rows.append((KnotEquations(e, where, (False,) * len(lower)), np.concatenate(numbers), (lower, upper)))

    def keep(e: Equations, variables: list[Indices], numbers: list[Any]) -> None:
        """≥ 1, or what the ends leave, which are given: there a tip may touch, to rounding and to how blunt edges are."""
        at_ends = [float(e.value(x[k, np.concatenate(variables)], np.concatenate(numbers))) for k in (0, -1)]
        add(e, variables, numbers, np.array([min(1.0, *at_ends) - _END_TOLERANCE]), np.full(1, np.inf))

    for name in moving:
        own, at = list(hand.finger(name).joints), of(name)
        limit, one = hand.torque_upper[own], np.ones(len(own))
        numbers = [[joint, unit], task.gravity_H, limit, hand.velocity_limit[own], [1.0 / K]]
        variables = [layout.y(at), layout.v(at), layout.a(at), np.array([layout.duration])]
        lower = np.concatenate([hand.torque_lower[own] / limit, -one])
        add(_motor_equations(hand, name), variables, numbers, lower, np.concatenate([one, one]))
    still = [name for name in tips.fingers if name not in moving]
    tips_at_rest = [(name, hand.tip_pose(knots.q[0], name)[0]) for name in still]
    in_the_way = [*tips.obstacles, *(Obstacle(Sphere(tips.radius(name) or _MIN_RADIUS), p) for name, p in tips_at_rest)]
    for one_name, other in combinations(moving, 2):
        least = tips.radius(one_name) + tips.radius(other) + tips.clearance
        if least > 0.0:
            keep(tip_distance_equations(hand, one_name, other), [layout.y(of(one_name)), layout.y(of(other))], [[joint, least]])
    for name in moving:
        for obstacle in in_the_way:
            least = max(tips.radius(name) + tips.clearance, _MIN_RADIUS)
            numbers = [[joint, least], obstacle.numbers]
            keep(obstacle_equations(hand, name, type(obstacle.shape)), [layout.y(of(name))], numbers)

    lower, upper = np.full(layout.size, -np.inf), np.full(layout.size, np.inf)
    lower[layout.duration] = 1e-3
    lower[layout.part("y")], upper[layout.part("y")] = hand.q_lower[joints] / joint, hand.q_upper[joints] / joint
    ends = tuple(range(2 * len(joints)))
    placed, given, bounds = zip(*rows, strict=True)
    structure = ProgramStructure(layout, K, placed, ends, ends)
    program = Program(
        structure, given, bounds, lower, upper, x[0, list(ends)], x[-1, list(ends)], np.zeros(layout.size), 2.0 * _STEP_WEIGHT
    )
    return _FingersMoveProgram(task, program, x, joints, joint, unit, knots.q[0])
