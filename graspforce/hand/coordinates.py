"""The actuated coordinates of a hand: which joints have motors, how the others follow, and what limits them all.

Takes a description with its URDF and says, in the order of Pinocchio's joints, q_full = T q + q0. Every contradiction between
the two files is found here, and the error names both.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import ModelError, UnknownName
from graspforce.hand.description import Coupling, HandSource, MotorDescription, motor_matches
from graspforce.hand.urdf import Urdf


@dataclass(frozen=True, slots=True)
class Finger:
    """A finger: its name, the indices of the actuated joints that move its tip (base first), tip frame, tip radius, m."""

    name: str
    joints: tuple[int, ...]
    tip: str
    tip_radius: float | None


@dataclass(frozen=True, slots=True)
class JointInfo:
    """An actuated joint.

    Attributes:
        name: as in the URDF; of a coupled group, the leader's.
        finger: the first finger that it moves.
        lower, upper: position limits, rad, narrowed by the limits of what follows it.
        velocity: largest rate, rad/s.
        torque: largest motor torque at the joint, either way, N·m.
        rotor_inertia: the rotor's inertia as the joint feels it, kg·m².
        source: where the motor's numbers come from.
    """

    name: str
    finger: str
    lower: float
    upper: float
    velocity: float
    torque: float
    rotor_inertia: float
    source: str


@dataclass(frozen=True, eq=False)
class JointCoordinates:
    """The actuated coordinates of a hand, and how the full ones follow.

    Attributes:
        fingers: the fingers in the file's order.
        joints: the n actuated joints, ordered by finger and from base to tip.
        full_joints: the moving joints of the URDF, in Pinocchio's order.
        T, q0: (n_full, n) and (n_full,): q_full = T q + q0, rows as `full_joints`.
        neutral: (n,) the posture from which searches start, rad.
        torque_weight: (n,) the diagonal of W in the default cost ½ tauᵀ W tau.
    """

    fingers: tuple[Finger, ...]
    joints: tuple[JointInfo, ...]
    full_joints: tuple[str, ...]
    T: Array
    q0: Array
    neutral: Array
    torque_weight: Array

    @property
    def n(self) -> int:
        """The number of actuated coordinates."""
        return len(self.joints)

    @cached_property
    def q_lower(self) -> Array:
        """(n,) least joint positions, rad; followers' limits included."""
        return freeze([joint.lower for joint in self.joints])

    @cached_property
    def q_upper(self) -> Array:
        """(n,) largest joint positions, rad; followers' limits included."""
        return freeze([joint.upper for joint in self.joints])

    @cached_property
    def torque_lower(self) -> Array:
        """(n,) least motor torques, N·m."""
        return freeze([-joint.torque for joint in self.joints])

    @cached_property
    def torque_upper(self) -> Array:
        """(n,) largest motor torques, N·m."""
        return freeze([joint.torque for joint in self.joints])

    @cached_property
    def velocity_limit(self) -> Array:
        """(n,) largest joint rates, rad/s."""
        return freeze([joint.velocity for joint in self.joints])

    @cached_property
    def rotor_inertia(self) -> Array:
        """(n,) the rotors' inertias as the joints feel them, kg·m²: D's diagonal."""
        return freeze([joint.rotor_inertia for joint in self.joints])

    def finger(self, name: str) -> Finger:
        """The finger of that name.

        Raises:
            UnknownName: no such finger; lists the fingers.
        """
        for finger in self.fingers:
            if finger.name == name:
                return finger
        raise UnknownName("finger", name, [finger.name for finger in self.fingers])


def resolve_coordinates(files: HandSource, full: tuple[str, ...]) -> JointCoordinates:
    """A hand's actuated coordinates, and how the full ones follow them.

    Args:
        files: the description and the URDF.
        full: the moving joints in the order of the full coordinates.

    Raises:
        ModelError: the description names what the URDF does not have, leaves a joint without motor, coupling or lock, gives one
            twice, or asks for what the joints cannot do.
    """
    model = files.urdf
    described, place = files.description, f"{files.path} and its URDF {files.urdf_path.name}"
    _check_joint_types(model, full, place)
    couplings_by_follower = _couplings_by_follower(files, model, place)
    locked = {lock.joint: lock.position for lock in described.locked}
    _check_joints_exist([*locked], model, "locks", place)

    chains: dict[str, list[str]] = {}  # finger → its actuated joints, base first
    actuated: dict[str, str] = {}  # joint → the first finger that it moves, in the order of the coordinates
    for finger in described.fingers:
        if finger.name in chains:
            raise ModelError(f"{files.path}: two fingers are named {finger.name}")
        if finger.tip not in model.links:
            raise ModelError(f"{place}: the tip of finger {finger.name} is {finger.tip}, but the URDF has no such link")
        moving = [joint.name for joint in model.chain(finger.tip) if joint.is_moving and joint.name not in locked]
        chains[finger.name] = list(
            dict.fromkeys(couplings_by_follower[name].leader if name in couplings_by_follower else name for name in moving)
        )
        if not chains[finger.name]:
            raise ModelError(f"{place}: no joint moves the tip {finger.tip} of finger {finger.name}")
        for name in chains[finger.name]:
            actuated.setdefault(name, finger.name)

    index = {name: i for i, name in enumerate(actuated)}
    T, q0 = np.zeros((len(full), len(index))), np.zeros(len(full))
    for row, name in enumerate(full):
        if name in locked:
            q0[row] = locked[name]
        elif name in couplings_by_follower and couplings_by_follower[name].leader in index:
            T[row, index[couplings_by_follower[name].leader]], q0[row] = (
                couplings_by_follower[name].ratio,
                couplings_by_follower[name].offset,
            )
        elif name in index:
            T[row, index[name]] = 1.0
        else:
            raise ModelError(f"{place}: joint {name} moves no finger's tip; name a finger that it moves, or lock it")

    ranges = {name: _position_range(name, T[:, i], q0, full, model, place) for name, i in index.items()}
    motors = {name: _motor(name, files) for name in index}
    unused = [*described.neutral.keys() - index.keys()]
    if unused:
        raise ModelError(f"{place}: the neutral posture names {unused[0]}, which is no actuated joint of {', '.join(index)}")
    neutral = [min(max(described.neutral.get(name, 0.0), ranges[name][0]), ranges[name][1]) for name in index]
    for name, value in described.neutral.items():
        if not ranges[name][0] <= value <= ranges[name][1]:
            raise ModelError(f"{place}: the neutral {name} = {value:g} rad is outside its limits {_interval(*ranges[name])}")
    joints = tuple(
        JointInfo(
            name=name,
            finger=finger,
            lower=ranges[name][0],
            upper=ranges[name][1],
            velocity=motors[name].velocity,
            torque=motors[name].torque,
            rotor_inertia=motors[name].rotor_inertia * motors[name].gear_ratio ** 2,
            source=motors[name].source,
        )
        for name, finger in actuated.items()
    )
    weights = [1.0 if described.torque_weight == "unit" else joint.torque**-2 for joint in joints]
    fingers = tuple(
        Finger(finger.name, tuple(index[name] for name in chains[finger.name]), finger.tip, finger.tip_radius)
        for finger in described.fingers
    )
    return JointCoordinates(fingers, joints, full, freeze(T), freeze(q0), freeze(neutral), freeze(weights))


def _check_joint_types(model: Urdf, full: tuple[str, ...], place: str) -> None:
    for name in full:
        if model.joints[name].type not in ("revolute", "prismatic"):
            raise ModelError(
                f"{place}: joint {name} is {model.joints[name].type}; a hand's joints are revolute or prismatic, with limits"
            )


def _couplings_by_follower(files: HandSource, model: Urdf, place: str) -> dict[str, Coupling]:
    """follower → its coupling. A URDF's mimic joint must be in the description, with the same numbers."""
    couplings = files.description.couplings
    couplings_by_follower = {coupling.follower: coupling for coupling in couplings}
    _check_joints_exist([name for c in couplings for name in (c.follower, c.leader)], model, "couples", place)
    for coupling in couplings:
        if [c.follower for c in couplings].count(coupling.follower) > 1:
            raise ModelError(f"{files.path}: joint {coupling.follower} follows two leaders")
        if coupling.leader in couplings_by_follower:
            raise ModelError(
                f"{files.path}: {coupling.follower} follows {coupling.leader}, itself a follower; name the motor's joint"
            )
        for lock in files.description.locked:
            if lock.joint in (coupling.follower, coupling.leader):
                raise ModelError(
                    f"{files.path}: joint {lock.joint} is both locked and coupled; lock the follower too, or neither"
                )
    for joint in model.joints.values():
        if joint.mimic is None:
            continue
        said = couplings_by_follower.get(joint.name)
        if said is None:
            raise ModelError(
                f"{place}: the URDF makes {joint.name} mimic {joint.mimic.leader} (× {joint.mimic.multiplier:g} + "
                f"{joint.mimic.offset:g}), the description does not couple it; add it to couplings"
            )
        if (said.leader, said.ratio, said.offset) != (joint.mimic.leader, joint.mimic.multiplier, joint.mimic.offset):
            raise ModelError(
                f"{place}: {joint.name} follows {said.leader} × {said.ratio:g} + {said.offset:g} in the description, "
                f"but {joint.mimic.leader} × {joint.mimic.multiplier:g} + {joint.mimic.offset:g} in the URDF"
            )
    return couplings_by_follower


def _check_joints_exist(names: list[str], model: Urdf, does: str, place: str) -> None:
    moving = [joint.name for joint in model.joints.values() if joint.is_moving]
    for name in names:
        if name not in moving:
            raise ModelError(
                f"{place}: the description {does} the joint {name}; the URDF's moving joints are {', '.join(moving)}"
            )


def _position_range(name: str, column: Array, q0: Array, full: tuple[str, ...], model: Urdf, place: str) -> tuple[float, float]:
    """The positions at which the joint and all that follow it are within their own limits, rad."""
    lower, upper = -np.inf, np.inf
    for row in np.flatnonzero(column):
        joint = model.joints[full[row]]
        if joint.lower is None or joint.upper is None or joint.lower >= joint.upper:
            raise ModelError(
                f"{place}: joint {joint.name} needs a lower limit below its upper one, not {joint.lower} and {joint.upper}"
            )
        ends = sorted(((joint.lower - q0[row]) / column[row], (joint.upper - q0[row]) / column[row]))
        lower, upper = max(lower, ends[0]), min(upper, ends[1])
    if lower >= upper:
        raise ModelError(
            f"{place}: the limits of the joints that move with {name} leave it no range: {_interval(lower, upper)}"
        )
    return float(lower), float(upper)


def _motor(name: str, files: HandSource) -> MotorDescription:
    found = [motor for motor in files.description.motors if motor_matches(motor, name)]
    if len(found) != 1:
        raise ModelError(f"{files.path}: joint {name} must match the joints of exactly one motor, not of {len(found)}")
    return found[0]


def _interval(lower: float, upper: float) -> str:
    return f"[{lower:g}, {upper:g}] rad"
