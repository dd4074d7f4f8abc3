"""An object move as a minimum-time program: equations, bounds, a first guess, and the states of a solution."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from graspforce.core.arrays import Array
from graspforce.geometry import Cylinder, Sphere, Superquadric
from graspforce.planning.free.object_equations import (
    FIXED,
    ON_CYLINDER,
    ON_PLANE,
    ON_SPHERE,
    ON_SUPERQUADRIC,
    acceleration_equations,
    finger_equations,
    ideal_finger_equations,
    object_equations,
)
from graspforce.planning.free.variables import FingerVariables, MoveVariables
from graspforce.planning.free.workspace import UNBOUNDED, WorkspaceBounds
from graspforce.planning.interpolation import Indices
from graspforce.planning.loads import with_torques
from graspforce.planning.nlp import cayley
from graspforce.planning.nlp.equations import Equations
from graspforce.planning.nlp.layout import DEFAULT_BARRIER, KnotEquations, Program, ProgramStructure
from graspforce.planning.nlp.machine_code import compile_equations
from graspforce.planning.path.joint_path import contact_points, fixed_contact_points
from graspforce.planning.path.paths import ContactPoints, JointPoints, PosePoints
from graspforce.planning.separation import BARRIER, MovingFrame, Separation, SeparationRow, links_of_finger
from graspforce.planning.task import GraspTask, IdealTask, ObjectTask
from graspforce.planning.trajectory import Trajectory

_FORCE_WEIGHT = 1e-5  # of squared forces beside T = 1; it decides between forces that are equally fast
_STEP_WEIGHT = 1e-6  # of squared steps in acceleration beside T = 1
_SIDE_LIMIT = 0.5  # of n along a cylinder's axis: smaller on its side, larger on its ends
_MIN_DURATION = 1e-3  # lower bound of the duration, relative to the guess's

_Rows = tuple[Equations, list[Indices], list[Array], Array, Array]  # equations, variables, parameters, lower and upper bounds


@dataclass(frozen=True, eq=False, slots=True)
class ObjectMoveProgram:
    """A minimum-time program of an object move.

    Args:
        task: the task.
        program: the program.
        guess: (K + 1, size) first guess of the variables at each knot.
        variables: the meaning of the variables.
    """

    task: ObjectTask
    program: Program
    guess: Array
    variables: MoveVariables

    def trajectory(self, x: Array) -> Trajectory:
        """Return the states at the knots; the torques follow from the hand's own dynamics.

        Args:
            x: (K + 1, size) variables at each knot.
        """
        meaning = self.variables
        layout, scales, T, M = meaning.layout, meaning.scales, meaning.scales.time, len(x)
        y, v, a = (x[:, layout.part(kind)] for kind in "yva")
        rates = (r[:, 3:6] * scales.turn / T**k for k, r in enumerate((y, v, a)))
        C, omega, alpha = cayley.rotation_and_rates(*rates)
        p, R = meaning.p_0 + scales.length * y[:, :3], C @ meaning.R_0
        p_d, p_dd = scales.length / T * v[:, :3], scales.length / T**2 * a[:, :3]
        joints = self._joint_states(x)
        omega_O, alpha_O = ((w[:, None] @ R)[:, 0] for w in (omega, alpha))
        points = self._contact_points(PosePoints(p, p_d, p_dd, R, omega_O, alpha_O), joints)
        f_H = scales.force * x[:, meaning.forces].reshape(M, -1, 3)
        contacts = self.task.contacts
        padded = np.zeros((M, len(contacts), 4))
        padded[:, :, :3] = np.einsum("kij,kcjl,kci->kcl", R, points.R_OC, f_H)
        for i, places in enumerate(meaning.moments):
            if len(places):
                padded[:, i, 3] = scales.force * contacts.gamma[i] * x[:, places[3]]
        trajectory = Trajectory(
            times=T * x[-1, layout.duration] * np.arange(M) / (M - 1),
            q=joints.q,
            v=joints.q_s,
            a=joints.q_ss,
            tau=np.zeros((M, 0)),
            f=padded.reshape(M, -1)[:, contacts.columns],
            p_HO=p,
            R_HO=R,
            twist=np.hstack([p_d, omega]),
            acceleration=np.hstack([p_dd, alpha]),
            p_OC=points.p_OC,
            R_OC=points.R_OC,
            p_OC_d=points.p_OC_s,
        )
        return with_torques(self.task, trajectory)

    def _joint_states(self, x: Array) -> JointPoints:
        """Return q, q̇ and q̈ (K + 1, n)."""
        meaning, scales = self.variables, self.variables.scales
        n = len(meaning.posture)
        states = [np.tile(meaning.posture, (len(x), 1)), np.zeros((len(x), n)), np.zeros((len(x), n))]
        for finger in meaning.fingers:
            places, dependent_scales = finger.places(meaning.layout), finger.dependent_scales(scales)
            for k, ((independent, dependent), scale) in enumerate(zip(places, dependent_scales, strict=True)):
                states[k][:, list(finger.independent_joints)] = x[:, independent] * scales.joint / scales.time**k
                states[k][:, list(finger.dependent_joints)] = x[:, dependent] * scale
        return JointPoints(*states)

    def _contact_points(self, poses: PosePoints, joints: JointPoints) -> ContactPoints:
        """Return the contacts at the knots, with derivatives with respect to time."""
        if isinstance(self.task, IdealTask):
            return fixed_contact_points(self.task, len(poses.p))
        return contact_points(self.task, poses, joints)


def object_move_program(
    task: ObjectTask,
    knots: Trajectory,
    workspace: WorkspaceBounds = UNBOUNDED,
    *,
    separation: Separation | None = None,
    compiled: bool = False,
) -> ObjectMoveProgram:
    """Return the program of the move from the first of some states to the last, with these as its first guess.

    Args:
        task: the task: contacts with friction, fingers of at least three joints.
        knots: K + 1 states, evenly spaced in time.
        workspace: bounds of the object's pose on its way.
        separation: pairs of bodies to keep apart; none by default.
        compiled: True to compile the equations to machine code, if possible.
    """
    K, variables = len(knots.times) - 1, MoveVariables.choose(task, knots)
    layout = variables.layout
    r = cayley.parameters(knots.R_HO @ variables.R_0.T)
    x = _guess(task, variables, knots, r)
    lower, upper = _variable_bounds(task, variables, workspace, r)

    equations, parameters, bounds = [], [], []
    for e, used, numbers, least, most in _rows(task, variables, 1.0 / K):
        places = tuple(int(i) for i in np.concatenate(used))
        e = compile_equations(e) if compiled else e
        equations.append(KnotEquations(e, places, tuple((least == most).tolist())))
        parameters.append(np.concatenate(numbers))
        bounds.append((least, most))
    own = len(equations)
    if separation is not None and isinstance(task, GraspTask):
        for e, used, values, least, most in _separation_rows(task, variables, separation, knots, x):
            e = compile_equations(e) if compiled else e
            equations.append(KnotEquations(e, tuple(int(i) for i in np.concatenate(used)), (False,)))
            parameters.append(values)
            bounds.append((least, most))

    weights = np.zeros(layout.size)
    weights[variables.forces] = 2.0 * _FORCE_WEIGHT
    weights[[places[3] for places in variables.moments if len(places)]] = 2.0 * _FORCE_WEIGHT
    start, goal = variables.start_values, variables.goal_values
    program = Program(
        structure=ProgramStructure(layout, K, tuple(equations), start, goal),
        parameter_values=tuple(parameters),
        bounds=tuple(bounds),
        lower=lower,
        upper=upper,
        start=x[0, list(start)],
        goal=x[-1, list(goal)],
        weights=weights,
        step_weight=2.0 * _STEP_WEIGHT,
        barrier=BARRIER if len(equations) > own else DEFAULT_BARRIER,
    )
    return ObjectMoveProgram(task, program, x, variables)


def _guess(task: ObjectTask, variables: MoveVariables, knots: Trajectory, r: Array) -> Array:
    """Return the variables (K + 1, size) of some states whose orientations have the Cayley parameters r (K + 1, 3)."""
    layout, scales, T = variables.layout, variables.scales, variables.scales.time
    x = np.zeros((len(knots.times), layout.size))
    r_d, r_dd = cayley.parameter_rates(r, knots.twist[:, 3:], knots.acceleration[:, 3:])
    positions = (knots.p_HO - variables.p_0, knots.twist[:, :3], knots.acceleration[:, :3])
    for k, (kind, p, turn) in enumerate(zip("yva", positions, (r, r_d, r_dd), strict=True)):
        x[:, layout.part(kind)[:3]] = p * T**k / scales.length
        x[:, layout.part(kind)[3:6]] = turn * T**k / scales.turn
    x[:, layout.duration] = 1.0
    for i, finger in enumerate(variables.fingers):
        for k, states in enumerate((knots.q, knots.v, knots.a)):
            _insert_joints(variables, finger, k, states, x)
        if finger.is_rolling:
            x[:, finger.arm(layout)] = (knots.p_OC[:, None, i] @ knots.R_HO.swapaxes(1, 2))[:, 0] / scales.length
    f = task.contacts.pad(knots.f)
    axes = np.einsum("kij,kcjl->kcil", knots.R_HO, knots.R_OC)  # of the contacts, in H
    x[:, variables.forces] = np.einsum("kcil,kcl->kci", axes, f[:, :, :3]).reshape(len(x), -1) / scales.force
    for i, places in enumerate(variables.moments):
        if len(places):
            moment = f[:, i, 3] / (scales.force * task.contacts.gamma[i])
            x[:, places] = np.column_stack([moment[:, None] * axes[:, i, :, 2], moment])
    return x


def _variable_bounds(task: ObjectTask, variables: MoveVariables, workspace: WorkspaceBounds, r: Array) -> tuple[Array, Array]:
    """Return the lower and upper bounds (size,) of a knot's variables: joint limits, workspace and duration."""
    layout, scales = variables.layout, variables.scales
    lower, upper = np.full(layout.size, -np.inf), np.full(layout.size, np.inf)
    if isinstance(task, GraspTask):
        hand = task.hand
        for finger in variables.fingers:
            most = np.full(hand.n, task.acceleration_limits.joints)
            bounds = (hand.q_lower, hand.q_upper), (-hand.velocity_limit, hand.velocity_limit), (-most, most)
            for k, limits in enumerate(bounds):
                _insert_joints(variables, finger, k, limits[0], lower)
                _insert_joints(variables, finger, k, limits[1], upper)
    lower[layout.duration] = _MIN_DURATION
    y = layout.part("y")
    lower[y[:3]] = (workspace.lower - variables.p_0) / scales.length
    upper[y[:3]] = (workspace.upper - variables.p_0) / scales.length
    if workspace.turn < np.pi:
        beyond = np.tan(workspace.turn / 2.0)
        lower[y[3:6]] = (np.minimum(r[0], r[-1]) - beyond) / scales.turn
        upper[y[3:6]] = (np.maximum(r[0], r[-1]) + beyond) / scales.turn
    return lower, upper


def _insert_joints(variables: MoveVariables, finger: FingerVariables, k: int, values: Array, into: Array) -> None:
    """Scale the k-th derivatives (…, n) of a finger's joints and write them to their places in variables (…, size)."""
    scales, (independent, dependent) = variables.scales, finger.places(variables.layout)[k]
    into[..., independent] = values[..., list(finger.independent_joints)] / (scales.joint / scales.time**k)
    into[..., dependent] = values[..., list(finger.dependent_joints)] / finger.dependent_scales(scales)[k]


def _rows(task: ObjectTask, variables: MoveVariables, step: float) -> Iterator[_Rows]:
    """Yield the equations at every knot, the fingers' first and then the object's; ``step`` is 1/K."""
    contacts, force = task.contacts, variables.scales.force
    min_normal = np.maximum(contacts.min_normal, task.slip_margin / contacts.mu) / force
    max_normal = contacts.max_normal / force
    for i in range(len(contacts)):
        normal_and_cone = np.array([min_normal[i], 0.0]), np.array([max_normal[i], np.inf])
        if isinstance(task, IdealTask):
            yield _ideal_finger_rows(task, variables, i, normal_and_cone)
        else:
            yield _finger_rows(task, variables, i, normal_and_cone, step)
    yield _object_rows(task, variables)
    if min(task.acceleration_limits.object_limits) < np.inf:
        yield _acceleration_rows(task, variables)


def _ideal_finger_rows(task: IdealTask, variables: MoveVariables, i: int, bounds: tuple[Array, Array]) -> _Rows:
    """Return the rows of an ideal finger, with bounds of normal force and cone."""
    turn, forces = variables.layout.part("y")[3:6], variables.forces[3 * i : 3 * i + 3]
    n = variables.R_0 @ task.contacts.R_OC[i, :, 2]
    numbers = [variables.scales.parameter_values, n, np.array([task.contacts.mu[i], task.slip_margin])]
    moment = variables.moments[i]
    zeros = np.zeros(3 if len(moment) else 0)
    limits = tuple(np.concatenate([zeros, side]) for side in bounds)
    return ideal_finger_equations(len(moment) > 0), [turn, forces, moment], numbers, limits[0], limits[1]


def _finger_rows(task: GraspTask, variables: MoveVariables, i: int, bounds: tuple[Array, Array], step: float) -> _Rows:
    """Return the rows of a finger, with bounds of normal force and cone."""
    layout, R_0, hand, finger = variables.layout, variables.R_0, task.hand, variables.fingers[i]
    surface, axis, radius, ratio = _contact_surface(task, i)
    joints = list(hand.finger(task.fingers[i]).joints)
    limit, one = hand.torque_upper[joints], np.ones(len(joints))
    independent, dependent = zip(*finger.places(layout), strict=True)
    pose = [layout.part(kind)[:6] for kind in "yva"]
    forces, duration = variables.forces[3 * i : 3 * i + 3], np.array([layout.duration])
    numbers = [
        variables.scales.parameter_values,
        task.gravity_H,
        variables.p_0,
        R_0 @ task.tip_centres[i],
        R_0 @ axis,
        np.array([radius, ratio]),
        limit,
        hand.velocity_limit[joints],
        np.array([task.contacts.mu[i], task.slip_margin, step]),
    ]
    moment, shape = variables.moments[i], task.body.shape
    is_soft = len(moment) > 0
    if is_soft:
        numbers.append(task.contacts.gamma[[i]])
    rows = np.zeros(9 + 3 * is_soft + 2 * (is_soft and surface != FIXED))  # of the contact
    if surface == ON_SUPERQUADRIC and isinstance(shape, Superquadric):
        numbers += [R_0.T.ravel(), shape.axes, shape.exponents]  # R₀ by columns
    return (
        finger_equations(hand, task.fingers[i], finger.independent, surface, is_soft),
        [*pose, *independent, *dependent, forces, duration, finger.arm(layout), moment],
        numbers,
        np.concatenate([rows, hand.torque_lower[joints] / limit, -one, bounds[0]]),
        np.concatenate([rows, one, one, bounds[1]]),
    )


def _acceleration_rows(task: ObjectTask, variables: MoveVariables) -> _Rows:
    """Return the rows of the object's accelerations."""
    layout, scales = variables.layout, variables.scales
    linear, angular = task.acceleration_limits.object_limits
    # an infinite limit is no row of its own: the structure of the program does not depend on it
    relative_to = [limit if limit < np.inf else 1.0 for limit in (linear, angular)]
    numbers = [scales.parameter_values, np.array(relative_to)]
    upper = np.array([1.0 if limit < np.inf else np.inf for limit in (linear, angular)])
    places = [layout.part("y")[3:6], layout.part("v")[:6], layout.part("a")[:6]]
    return acceleration_equations(), places, numbers, np.full(2, -np.inf), upper


def _object_rows(task: ObjectTask, variables: MoveVariables) -> _Rows:
    """Return the rows of the object."""
    layout, R_0, body, contacts = variables.layout, variables.R_0, task.body, task.contacts
    turn, v, a = layout.part("y")[3:6], layout.part("v")[:6], layout.part("a")[:6]
    arms = [finger.arm(layout) for finger in variables.fingers]
    lever = max(float(np.linalg.norm(contacts.p_OC, axis=1).max()), 1e-3)  # m
    numbers = [
        variables.scales.parameter_values,
        task.gravity_H,
        np.array([body.mass]),
        R_0 @ body.p_OM,
        (R_0 @ body.inertia @ R_0.T).ravel(),
        (contacts.p_OC[~task.is_rolling] @ R_0.T).ravel(),
        np.array([lever]),
        contacts.gamma[contacts.gamma > 0.0],
    ]
    is_soft = tuple(len(places) > 0 for places in variables.moments)
    equations = object_equations(tuple(task.is_rolling.tolist()), is_soft)
    moments = [places[:3] for places in variables.moments]
    return equations, [turn, v, a, variables.forces, *arms, *moments], numbers, np.zeros(6), np.zeros(6)


def _separation_rows(
    task: GraspTask, variables: MoveVariables, separation: Separation, knots: Trajectory, x: Array
) -> Iterator[SeparationRow]:
    """Yield the rows of pairs of bodies that are kept apart."""
    if separation.scene is None:
        return
    layout, scales = variables.layout, variables.scales
    pose = np.concatenate([variables.p_0, [scales.length, scales.turn]])
    frames = {separation.scene.object_frame: MovingFrame("object", -1, layout.part("y")[:6], pose, variables.R_0)}
    for name, finger in zip(task.fingers, variables.fingers, strict=True):
        independent, dependent = finger.places(layout)[0]
        joints = task.hand.finger(name).joints
        place_of = dict(zip((*finger.independent_joints, *finger.dependent_joints), (*independent, *dependent), strict=True))
        scale = finger.dependent_scales(scales)[0]
        numbers = np.array([scale if joint in finger.dependent_joints else scales.joint for joint in joints])
        places = np.array([place_of[joint] for joint in joints], dtype=np.intp)
        frames |= links_of_finger(task.hand, name, places, numbers)
    guess = separation.scene.poses(knots.q, knots.p_HO, knots.R_HO)
    yield from separation.rows(task.hand, frames, guess, x)


def _contact_surface(task: GraspTask, i: int) -> tuple[str, Array, float, float]:
    """Return the surface under contact i, its normal or axis in O, the tip's radius r, and r over the surface's radius."""
    n, radius = task.contacts.R_OC[i, :, 2], float(task.tip_radii[i])
    if not task.is_rolling[i]:
        return FIXED, n, radius, 0.0
    c, shape = task.tip_centres[i], task.body.shape
    if isinstance(shape, Sphere):
        distance = float(np.linalg.norm(c))
        return ON_SPHERE, n, distance - shape.radius, distance / shape.radius - 1.0
    if isinstance(shape, Cylinder) and abs(n[2]) < _SIDE_LIMIT:
        distance = float(np.hypot(c[0], c[1]))
        return ON_CYLINDER, np.array([0.0, 0.0, 1.0]), distance - shape.radius, distance / shape.radius - 1.0
    return ON_SUPERQUADRIC if isinstance(shape, Superquadric) else ON_PLANE, n, radius, 0.0
