"""A held object's move as a minimum-time program: scaled variables, numbers, bounds, a first guess, and the way back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from graspforce.core.arrays import Array
from graspforce.geometry import Cylinder, Sphere
from graspforce.hand.hand import Hand
from graspforce.planning.free.object_equations import (
    FIXED,
    ON_CYLINDER,
    ON_PLANE,
    ON_SPHERE,
    VariableScales,
    choose_free_joints,
    finger_equations,
    ideal_finger_equations,
    object_equations,
)
from graspforce.planning.interpolation import Indices
from graspforce.planning.loads import with_torques
from graspforce.planning.nlp import cayley
from graspforce.planning.nlp.equations import Equations
from graspforce.planning.nlp.machine_code import compile_equations
from graspforce.planning.nlp.transcription import KnotEquations, KnotLayout, Program, ProgramStructure
from graspforce.planning.path.joint_path import contact_points
from graspforce.planning.path.paths import JointPoints, PosePoints
from graspforce.planning.plan import Trajectory
from graspforce.planning.task import Task

_FORCE_WEIGHT = (
    1e-5  # the weight of squared forces beside T = 1: motors have directions in which nothing else tells forces apart
)
_STEP_WEIGHT = 1e-6  # likewise of the accelerations' steps
_FINGER_LENGTH = 0.05  # m: how far from their joints fingertips are, about
_SIDE_LIMIT = 0.5  # of n along a cylinder's axis: less on its side, where it has none, more on its ends, where it is all
_MIN_DURATION = 1e-3  # the shortest duration that is looked at, of the guess's


@dataclass(frozen=True, eq=False, slots=True)
class WorkspaceBounds:
    """Where the object may be on its way.

    Args:
        lower, upper: (3,) bounds of its origin in H, m.
        turn: how far it may turn about each axis beyond what start and goal ask for, rad.
    """

    lower: Array
    upper: Array
    turn: float


UNBOUNDED = WorkspaceBounds(np.full(3, -np.inf), np.full(3, np.inf), np.inf)


@dataclass(frozen=True, eq=False, slots=True)
class _Finger:
    """A finger's joints and where their variables are.

    Args:
        own: which joints of the hand move as they like.
        free: the same among the finger's joints.
        led: which its tip leads.
        coordinates: in y, of the first.
        rolls: whether its contact does.
        at: where q, q̇, q̈ of the others begin: in z, one after the other; in y where the contact rolls.
        arm: in z, where x begins; where the contact rolls.
    """

    own: tuple[int, ...]
    free: tuple[int, ...]
    dependent: tuple[int, ...]
    coordinates: tuple[int, ...]
    is_rolling: bool
    at: int
    arm: int

    @classmethod
    def of(cls, hand: Hand, name: str, q: Array, y: int) -> _Finger:
        """Which joints move as they like; the rest of the layout is not known yet."""
        joints = hand.finger(name).joints
        J = hand.point_jacobian(q, name, hand.tip_pose(q, name)[0])[:3][:, list(joints)]
        free = choose_free_joints(J, len(joints) - 3)
        dependent = tuple(i for i in range(len(joints)) if i not in free)
        own, dependent = tuple(joints[i] for i in free), tuple(joints[i] for i in dependent)
        return cls(own, free, dependent, tuple(range(y, y + len(free))), False, 0, 0)

    def places(self, layout: KnotLayout) -> list[tuple[Indices, Indices]]:
        """For q, q̇ and q̈: where they are in a knot's vector, of the free joints and of the others."""
        m = len(self.dependent)
        if self.is_rolling:
            dependent = [layout.part(kind)[self.at : self.at + m] for kind in "yva"]
        else:
            dependent = [layout.z(range(self.at + k * m, self.at + (k + 1) * m)) for k in range(3)]
        return [(layout.part(kind)[list(self.coordinates)], dependent[k]) for k, kind in enumerate("yva")]

    def scales(self, units: VariableScales) -> list[float]:
        """Of q, q̇ and q̈ of the joints that its tip leads, rad, rad/s, rad/s²."""
        return [units.joint / units.time**k if k or self.is_rolling else 1.0 for k in range(3)]


@dataclass(frozen=True, eq=False, slots=True)
class ObjectMoveProgram:
    """A move as a program, and what its variables mean.

    Args:
        task: what moves.
        program: the program.
        guess: (K + 1, size) where its solution may begin.
    """

    task: Task
    program: Program
    guess: Array
    units: VariableScales
    p_0: Array
    R_0: Array
    fingers: tuple[_Finger, ...]
    forces: Indices
    posture: Array

    def trajectory(self, x: Array) -> Trajectory:
        """States at the knots from the program's variables; torques by the hand's own dynamics."""
        task, units, layout, T = self.task, self.units, self.program.structure.layout, self.units.time
        y, v, a = (x[:, layout.part(kind)] for kind in "yva")
        scale = units.turn / T ** np.arange(3)
        C, omega, alpha = cayley.rotation_and_rates(*(each[:, 3:6] * by for each, by in zip((y, v, a), scale, strict=True)))
        p, R = self.p_0 + units.length * y[:, :3], C @ self.R_0
        twist = np.hstack([units.length / T * v[:, :3], omega])
        acceleration = np.hstack([units.length / T**2 * a[:, :3], alpha])
        states = [np.tile(self.posture, (len(x), 1)), np.zeros((len(x), task.joints)), np.zeros((len(x), task.joints))]
        for finger in self.fingers:
            for k, ((free, dependent), dependent_scale) in enumerate(
                zip(finger.places(layout), finger.scales(units), strict=True)
            ):
                states[k][:, list(finger.own)] = x[:, free] * units.joint / T**k
                states[k][:, list(finger.dependent)] = x[:, dependent] * dependent_scale
        q, q_d, q_dd = states
        poses = PosePoints(p, twist[:, :3], acceleration[:, :3], R, (omega[:, None] @ R)[:, 0], (alpha[:, None] @ R)[:, 0])
        touch = contact_points(task, poses, JointPoints(q, q_d, q_dd) if self.fingers else None)
        f_H = units.force * x[:, self.forces].reshape(len(x), -1, 3)
        f = np.einsum("kij,kcjl,kci->kcl", R, touch.R_OC, f_H).reshape(len(x), -1)
        times = T * x[-1, layout.duration] * np.arange(len(x)) / (len(x) - 1)
        none, places = np.zeros((len(x), 0)), (touch.p_OC, touch.R_OC, touch.p_OC_s)
        return with_torques(task, Trajectory(times, q, q_d, q_dd, none, f, p, R, twist, acceleration, *places))


def object_move_program(
    task: Task, knots: Trajectory, workspace: WorkspaceBounds = UNBOUNDED, *, compiled: bool = False
) -> ObjectMoveProgram:
    """The program of the move from the first of some states to the last, with these as its first guess.

    Args:
        task: point contacts with friction; fingers of at least three joints.
        knots: K + 1 states, evenly in time.
        room: where the object may be.
        compiled: whether to translate the equations to machine code, where that can be done.
    """
    hand, contacts, body = task.hand, task.contacts, task.body
    assert contacts is not None
    assert body is not None
    K, count = len(knots.times) - 1, len(contacts)
    p_0, R_0 = (knots.p_HO[0] + knots.p_HO[-1]) / 2.0, knots.R_HO[K // 2]
    r = cayley.parameters(knots.R_HO @ R_0.T)
    units = _units(knots, r, float(np.linalg.norm(contacts.p_OC, axis=1).max()))

    fingers: list[_Finger] = []
    own, algebraic = 6, 0
    if hand is not None:
        for name in task.fingers:
            fingers.append(_Finger.of(hand, name, knots.q[0], own))
            own += len(fingers[-1].own)
    coordinates = own
    for i, finger in enumerate(fingers):
        m = len(finger.dependent)
        if task.is_rolling[i]:
            fingers[i] = replace(finger, is_rolling=True, at=coordinates, arm=algebraic)
            coordinates, algebraic = coordinates + m, algebraic + 3
        else:
            fingers[i] = replace(finger, at=algebraic)
            algebraic += 3 * m
    layout = KnotLayout(coordinates, algebraic + 3 * count, coordinates - own)
    forces = layout.z(range(algebraic, algebraic + 3 * count))
    posture = knots.q[0] if hand is not None else np.zeros(0)

    x = np.zeros((K + 1, layout.size))
    lower, upper = np.full(layout.size, -np.inf), np.full(layout.size, np.inf)
    _insert_object(layout, units, knots, p_0, r, x)
    for finger in fingers:
        assert hand is not None
        _insert_finger(hand, layout, units, finger, knots, (x, lower, upper))
    for i, finger in enumerate(fingers):
        if finger.is_rolling:
            arms = (knots.p_OC[:, None, i] @ knots.R_HO.swapaxes(1, 2))[:, 0]  # m
            x[:, layout.z(range(finger.arm, finger.arm + 3))] = arms / units.length
    f_H = np.einsum("kij,kcjl,kcl->kci", knots.R_HO, knots.R_OC, knots.f.reshape(K + 1, count, 3))
    x[:, forces] = f_H.reshape(K + 1, -1) / units.force
    lower[layout.duration] = _MIN_DURATION
    _insert_workspace(layout, units, workspace, p_0, r, (lower, upper))

    weights = np.zeros(layout.size)
    weights[forces] = 2.0 * _FORCE_WEIGHT
    resting = range(coordinates, coordinates + own)  # what rolls is at rest when all else is
    start, goal = (*range(coordinates), *resting), (*range(6), *resting)
    placed, numbers, bounds = zip(*_all_equations(task, layout, units, p_0, R_0, fingers, forces, 1.0 / K), strict=True)
    if compiled:
        placed = tuple(replace(each, equations=compile_equations(each.equations)) for each in placed)
    program = Program(
        ProgramStructure(layout, K, placed, start, goal),
        numbers,
        bounds,
        lower,
        upper,
        x[0, list(start)],
        x[-1, list(goal)],
        weights,
        2.0 * _STEP_WEIGHT,
    )
    return ObjectMoveProgram(task, program, x, units, p_0, R_0, tuple(fingers), forces, posture)


def _units(knots: Trajectory, r: Array, arm: float) -> VariableScales:
    """Such that scaled variables are of order one."""
    way = float(np.linalg.norm(knots.p_HO[-1] - knots.p_HO[0]))
    size = max(way, 2.0 * arm * float(np.linalg.norm(r[-1] - r[0])), 1e-4)  # m
    force = max(float(np.abs(knots.f).max()), 1e-6)
    return VariableScales(size, 0.5 * size / max(arm, size), float(knots.times[-1]), size / _FINGER_LENGTH, force)


def _insert_object(layout: KnotLayout, units: VariableScales, knots: Trajectory, p_0: Array, r: Array, x: Array) -> None:
    T = units.time
    r_d, r_dd = cayley.rates(r, knots.twist[:, 3:], knots.acceleration[:, 3:])
    places = (knots.p_HO - p_0, knots.twist[:, :3], knots.acceleration[:, :3])
    for k, (kind, p, turn) in enumerate(zip("yva", places, (r, r_d, r_dd), strict=True)):
        x[:, layout.part(kind)[:3]] = p * T**k / units.length
        x[:, layout.part(kind)[3:6]] = turn * T**k / units.turn
    x[:, layout.duration] = 1.0


def _insert_finger(
    hand: Hand, layout: KnotLayout, units: VariableScales, finger: _Finger, knots: Trajectory, into: tuple[Array, Array, Array]
) -> None:
    """A finger's joints into the guess, and their limits into the bounds."""
    limits = (
        (hand.q_lower, hand.q_upper),
        (-hand.velocity_limit, hand.velocity_limit),
        (np.full(hand.n, -np.inf), np.full(hand.n, np.inf)),
    )
    for k, (states, places) in enumerate(zip((knots.q, knots.v, knots.a), finger.places(layout), strict=True)):
        own, dependent = (
            (finger.own, places[0], units.joint / units.time**k),
            (finger.dependent, places[1], finger.scales(units)[k]),
        )
        for joints, at, unit in (own, dependent):
            for values, target in zip((states, *limits[k]), into, strict=True):
                target[..., at] = values[..., list(joints)] / unit


def _insert_workspace(
    layout: KnotLayout, units: VariableScales, workspace: WorkspaceBounds, p_0: Array, r: Array, into: tuple[Array, Array]
) -> None:
    lower, upper = into
    at = layout.part("y")
    lower[at[:3]], upper[at[:3]] = (workspace.lower - p_0) / units.length, (workspace.upper - p_0) / units.length
    if workspace.turn < np.pi:
        beyond = np.tan(workspace.turn / 2.0)
        lower[at[3:6]] = (np.minimum(r[0], r[-1]) - beyond) / units.turn
        upper[at[3:6]] = (np.maximum(r[0], r[-1]) + beyond) / units.turn


def _all_equations(
    task: Task,
    layout: KnotLayout,
    units: VariableScales,
    p_0: Array,
    R_0: Array,
    fingers: list[_Finger],
    forces: Indices,
    part: float,
) -> list[tuple[KnotEquations, Array, tuple[Array, Array]]]:
    """What holds at every knot: each finger's equations, then the object's; with numbers and bounds."""
    hand, contacts, body = task.hand, task.contacts, task.body
    assert contacts is not None
    assert body is not None
    all_of: list[tuple[KnotEquations, Array, tuple[Array, Array]]] = []

    def add(e: Equations, variables: list[Any], numbers: list[Any], lowest: list[Any], highest: list[Any]) -> None:
        lower, upper = np.concatenate(lowest), np.concatenate(highest)
        where = tuple(int(i) for i in np.concatenate(variables))
        all_of.append((KnotEquations(e, where, tuple((lower == upper).tolist())), np.concatenate(numbers), (lower, upper)))

    given = np.array(units.numbers)
    pose = [layout.part(kind)[:6] for kind in "yva"]
    normals = contacts.R_OC[:, :, 2] @ R_0.T
    arms = [layout.z(range(finger.arm, finger.arm + 3 * finger.is_rolling)) for finger in fingers]
    least = np.maximum(contacts.min_normal, task.slip_margin / contacts.mu) / units.force
    most = contacts.max_normal / units.force
    for i in range(len(contacts)):
        own, rough = forces[3 * i : 3 * i + 3], [contacts.mu[i], task.slip_margin]
        pressing = [[least[i], 0.0]], [[most[i], np.inf]]
        if hand is None:
            add(ideal_finger_equations(), [pose[0][3:], own], [given, normals[i], rough], *pressing)
            continue
        name, finger = task.fingers[i], fingers[i]
        surface, axis, radius, ratio = _surface(task, i)
        joints = list(hand.finger(name).joints)
        limit, fastest, zero, one = hand.torque_upper[joints], hand.velocity_limit[joints], np.zeros(9), np.ones(len(joints))
        places = finger.places(layout)
        add(
            finger_equations(hand, name, finger.free, surface),
            [*pose, *(free for free, _ in places), *(dependent for _, dependent in places), own, [layout.duration], arms[i]],
            [
                given,
                task.gravity_H,
                p_0,
                R_0 @ task.tip_centres[i],
                R_0 @ axis,
                [radius, ratio],
                limit,
                fastest,
                rough,
                [part],
            ],
            [zero, hand.torque_lower[joints] / limit, -one, *pressing[0]],
            [zero, one, one, *pressing[1]],
        )
    inertia = R_0 @ body.inertia @ R_0.T
    stays = contacts.p_OC[~task.is_rolling] @ R_0.T
    lever = [max(float(np.linalg.norm(contacts.p_OC, axis=1).max()), 1e-3)]
    add(
        object_equations(tuple(task.is_rolling.tolist())),
        [pose[0][3:], pose[1], pose[2], forces, *arms],
        [given, task.gravity_H, [body.mass], R_0 @ body.p_OM, inertia.ravel(), stays.ravel(), lever],
        [np.zeros(6)],
        [np.zeros(6)],
    )
    return all_of


def _surface(task: Task, i: int) -> tuple[str, Array, float, float]:
    """How contact i moves, its normal or its surface's axis in O, r, and r/ρ with ρ the surface's radius."""
    contacts, body = task.contacts, task.body
    assert contacts is not None
    assert body is not None
    n, radius = contacts.R_OC[i, :, 2], float(task.tip_radii[i])
    if not task.is_rolling[i]:
        return FIXED, n, radius, 0.0
    c, shape = task.tip_centres[i], body.shape
    if isinstance(shape, Sphere):
        far = float(np.linalg.norm(c))
        return ON_SPHERE, n, far - shape.radius, far / shape.radius - 1.0
    if isinstance(shape, Cylinder) and abs(n[2]) < _SIDE_LIMIT:
        far = float(np.hypot(c[0], c[1]))
        return ON_CYLINDER, np.array([0.0, 0.0, 1.0]), far - shape.radius, far / shape.radius - 1.0
    return ON_PLANE, n, radius, 0.0
