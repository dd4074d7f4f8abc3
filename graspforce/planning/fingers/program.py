"""A move of fingers alone as a minimum-time program, and the states of its solution."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import casadi as ca
import numpy as np

from graspforce.core.arrays import Array
from graspforce.geometry import Sphere
from graspforce.grasp.collision.obstacle import Obstacle
from graspforce.hand.hand import Hand
from graspforce.planning.fingers.clearances import TipClearances
from graspforce.planning.fingers.obstacles import obstacle_equations, obstacle_parameters, tip_distance_equations
from graspforce.planning.interpolation import Indices
from graspforce.planning.loads import with_torques
from graspforce.planning.nlp.equations import Equations, make_equations
from graspforce.planning.nlp.layout import KnotEquations, KnotLayout, Program, ProgramStructure
from graspforce.planning.nlp.machine_code import compile_equations
from graspforce.planning.nlp.symbolic_finger import symbolic_finger
from graspforce.planning.separation import MovingFrame, Separation, links_of_finger
from graspforce.planning.task import FingerTask
from graspforce.planning.trajectory import Trajectory

_STEP_WEIGHT = 1e-6  # of squared steps in acceleration beside T = 1
_REST_TOLERANCE = 1e-9  # rad: a joint that turns by less does not move
_MIN_RADIUS = 1e-4  # m: radius assumed for a tip without one
_END_TOLERANCE = 1e-6  # of a clearance: lack that the program accepts beside the lack at the ends
_MIN_DURATION = 1e-3  # lower bound of the duration, relative to the guess's

_Rows = tuple[Equations, list[Indices], Array, Array, Array]  # equations, variables, parameters, lower and upper bounds


@dataclass(frozen=True, eq=False, slots=True)
class FingersMoveProgram:
    """A minimum-time program of fingers alone.

    Args:
        task: the task.
        program: the program.
        guess: (K + 1, size) first guess of the variables at each knot.
        joints: joints of the hand that move; the coordinates y are theirs.
        joint_scale: scale of the coordinates, rad.
        time_scale: scale of time, s.
        posture: (n,) posture of the joints that do not move, rad.
    """

    task: FingerTask
    program: Program
    guess: Array
    joints: list[int]
    joint_scale: float
    time_scale: float
    posture: Array

    def trajectory(self, x: Array) -> Trajectory:
        """Return the states at the knots.

        Args:
            x: (K + 1, size) variables at each knot.
        """
        layout, M, n = self.program.structure.layout, len(x), len(self.posture)
        states = [np.tile(self.posture, (M, 1)), np.zeros((M, n)), np.zeros((M, n))]
        for k, kind in enumerate("yva"):
            states[k][:, self.joints] = x[:, layout.part(kind)] * self.joint_scale / self.time_scale**k
        times = self.time_scale * x[-1, layout.duration] * np.arange(M) / (M - 1)
        return with_torques(self.task, Trajectory.of_joints(times, *states))


def fingers_program(
    task: FingerTask, tips: TipClearances, knots: Trajectory, separation: Separation, compiled: bool
) -> FingersMoveProgram:
    """Return the program of the move from the first of some states to the last, with these as its first guess.

    Fingers whose joints are the same in both states do not move.

    Args:
        task: the task.
        tips: the clearances to keep.
        knots: K + 1 states, evenly spaced in time.
        separation: pairs of bodies to keep apart.
        compiled: True to compile the equations to machine code, if possible.
    """
    hand, K = task.hand, len(knots.times) - 1
    turn = np.abs(knots.q[-1] - knots.q[0])  # rad
    moving = [finger.name for finger in hand.fingers if turn[list(finger.joints)].max() > _REST_TOLERANCE]
    joints = sorted({joint for name in moving for joint in hand.finger(name).joints})
    layout, joint_scale, time_scale = KnotLayout(len(joints), 0), float(turn.max()), float(knots.times[-1])

    x = np.zeros((K + 1, layout.size))
    for k, (kind, states) in enumerate(zip("yva", (knots.q, knots.v, knots.a), strict=True)):
        x[:, layout.part(kind)] = states[:, joints] * time_scale**k / joint_scale
    x[:, layout.duration] = 1.0
    lower, upper = np.full(layout.size, -np.inf), np.full(layout.size, np.inf)
    lower[layout.duration] = _MIN_DURATION
    y = layout.part("y")
    lower[y], upper[y] = hand.q_lower[joints] / joint_scale, hand.q_upper[joints] / joint_scale
    acceleration = task.acceleration_limits.joints * time_scale**2 / joint_scale
    lower[layout.part("a")], upper[layout.part("a")] = -acceleration, acceleration

    equations, parameters, bounds = [], [], []
    places = {name: [joints.index(i) for i in hand.finger(name).joints] for name in moving}
    motor_rows = _motor_rows(task, layout, places, np.array([joint_scale, time_scale]), 1.0 / K)
    clearance_rows = _clearance_rows(tips, layout, places, joint_scale, knots.q[0], x)
    separation_rows = _separation_rows(hand, separation, layout, places, joint_scale, (knots.q, x))
    for e, used, numbers, least, most in (*motor_rows, *clearance_rows, *separation_rows):
        e = compile_equations(e) if compiled else e
        variables = tuple(int(i) for i in np.concatenate(used))
        equations.append(KnotEquations(e, variables, (False,) * len(least)))
        parameters.append(numbers)
        bounds.append((least, most))
    ends = tuple(range(2 * len(joints)))
    program = Program(
        structure=ProgramStructure(layout, K, tuple(equations), ends, ends),
        parameter_values=tuple(parameters),
        bounds=tuple(bounds),
        lower=lower,
        upper=upper,
        start=x[0, list(ends)],
        goal=x[-1, list(ends)],
        weights=np.zeros(layout.size),
        step_weight=2.0 * _STEP_WEIGHT,
    )
    return FingersMoveProgram(task, program, x, joints, joint_scale, time_scale, knots.q[0])


def _motor_rows(
    task: FingerTask, layout: KnotLayout, places: dict[str, list[int]], scales: Array, step: float
) -> Iterator[_Rows]:
    """Yield the rows of torques and speeds of each moving finger; ``scales`` of joints and time, ``step`` 1/K."""
    hand = task.hand
    for name, coordinates in places.items():
        joints = list(hand.finger(name).joints)
        limit, one = hand.torque_upper[joints], np.ones(len(joints))
        numbers = np.concatenate([scales, task.gravity_H, limit, hand.velocity_limit[joints], [step]])
        variables = [*(layout.part(kind)[coordinates] for kind in "yva"), np.array([layout.duration])]
        lower = np.concatenate([hand.torque_lower[joints] / limit, -one])
        yield _motor_equations(hand, name), variables, numbers, lower, np.concatenate([one, one])


def _clearance_rows(
    tips: TipClearances, layout: KnotLayout, places: dict[str, list[int]], joint_scale: float, q: Array, x: Array
) -> Iterator[_Rows]:
    """Yield the rows of distances between moving tips, and from obstacles and tips at rest in the posture q."""
    hand, y = tips.hand, layout.part("y")
    for one, other in combinations(places, 2):
        least = tips.radius(one) + tips.radius(other) + tips.clearance
        if least > 0.0:
            numbers = np.array([joint_scale, least])
            yield _kept_from_ends(tip_distance_equations(hand, one, other), [y[places[one]], y[places[other]]], numbers, x)
    at_rest = [name for name in tips.fingers if name not in places]
    spheres = [Obstacle(Sphere(tips.radius(name) or _MIN_RADIUS), hand.tip_pose(q, name)[0]) for name in at_rest]
    for name, coordinates in places.items():
        least = max(tips.radius(name) + tips.clearance, _MIN_RADIUS)
        for obstacle in (*tips.obstacles, *spheres):
            numbers = np.concatenate([[joint_scale, least], obstacle_parameters(obstacle)])
            yield _kept_from_ends(obstacle_equations(hand, name, type(obstacle.shape)), [y[coordinates]], numbers, x)


def _separation_rows(
    hand: Hand,
    separation: Separation,
    layout: KnotLayout,
    places: dict[str, list[int]],
    joint_scale: float,
    guess: tuple[Array, Array],
) -> Iterator[_Rows]:
    """Yield the rows of pairs of bodies that are kept apart, for a guess of postures and variables."""
    if separation.scene is None:
        return
    frames: dict[int, MovingFrame] = {}
    for name, coordinates in places.items():
        scales = np.full(len(coordinates), joint_scale)
        frames |= links_of_finger(hand, name, layout.part("y")[coordinates], scales)
    yield from separation.rows(hand, frames, separation.scene.poses(guess[0]), guess[1])


def _kept_from_ends(e: Equations, variables: list[Indices], numbers: Array, x: Array) -> _Rows:
    """Return the row of a clearance, g ≥ 1, or g ≥ its smallest value at the ends, where a tip may touch."""
    places = np.concatenate(variables)
    at_ends = [float(e.value(x[k, places], numbers)) for k in (0, -1)]
    return e, variables, numbers, np.array([min(1.0, *at_ends) - _END_TOLERANCE]), np.full(1, np.inf)


@lru_cache(maxsize=64)
def _motor_equations(hand: Hand, finger: str) -> Equations:
    """Return the torques and peak speeds of a finger, relative to their limits.

    Variables: y, v, a, T. Parameters: scales of joints and time, gravity_H, torque and speed limits, h/T.
    """
    model = symbolic_finger(hand, finger, hand.neutral)
    m = len(model.joints)
    y, v, a, T = *(ca.SX.sym(name, m) for name in "yva"), ca.SX.sym("T")
    joint, time, gravity = ca.SX.sym("joint"), ca.SX.sym("time"), ca.SX.sym("gravity", 3)
    torque_limit, speed_limit, step = ca.SX.sym("torque_limit", m), ca.SX.sym("speed_limit", m), ca.SX.sym("step")
    q, q_d, q_dd = joint * y, joint / time * v, joint / time**2 * a
    peak = (q_d + q_dd * step * T * time / 2.0) / speed_limit
    g = ca.vertcat(model.torque(q, q_d, q_dd, gravity) / torque_limit, peak)
    parameters = ca.vertcat(joint, time, gravity, torque_limit, speed_limit, step)
    return make_equations("moving", ca.vertcat(y, v, a, T), parameters, g)
