"""Resolution of a description and a URDF to the actuated coordinates of a hand.

Contradictions between the two files raise a ModelError that names both.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput, ModelError
from graspforce.hand.descriptions.description import (
    Coupling,
    HandDescription,
    HandSource,
    MotorDescription,
    TorqueWeight,
    motor_matches,
)
from graspforce.hand.descriptions.urdf import Urdf, UrdfJoint
from graspforce.hand.drives.drive import Drives, resolve_drives
from graspforce.hand.drives.joint_friction import resolve_friction
from graspforce.hand.drives.tendon import resolve_tendons
from graspforce.hand.kinematics.coordinates import Finger, JointCoordinates, JointInfo


def resolve_coordinates(files: HandSource, full: tuple[str, ...]) -> JointCoordinates:
    """Return the actuated coordinates of a hand.

    Args:
        files: the description and the URDF.
        full: names of the moving joints, in the order of the full coordinates.

    Raises:
        ModelError: the description and the URDF contradict each other, or a joint has no motor, coupling or lock.
    """
    resolver = _Resolver(files, full)
    chains = resolver.finger_chains()
    first_finger: dict[str, str] = {}
    for finger_name, chain in chains.items():
        for name in chain:
            first_finger.setdefault(name, finger_name)
    index = {name: i for i, name in enumerate(first_finger)}
    T, q0 = resolver.full_map(index)
    ranges = {name: resolver.position_range(name, T[:, i], q0) for name, i in index.items()}
    described = files.description
    motors = {name: resolver.motor(name) for name in index}
    drives = resolve_drives(described.drives, {name: motor.gear_ratio for name, motor in motors.items()}, str(files.path))
    joints = []
    for (name, finger_name), drive in zip(first_finger.items(), drives.joints, strict=True):
        motor = motors[name]
        joints.append(
            JointInfo(
                name=name,
                finger=finger_name,
                lower=ranges[name][0],
                upper=ranges[name][1],
                velocity=motor.velocity,
                torque=min(motor.torque, drive.largest_torque),
                rotor_inertia=motor.rotor_inertia * motor.gear_ratio**2,
                source=motor.source,
                is_prismatic=files.urdf.joints[name].type == "prismatic",
                holding_torque=motor.holding_torque,
            )
        )
    return JointCoordinates(
        fingers=tuple(
            Finger(
                finger.name,
                tuple(index[name] for name in chains[finger.name]),
                finger.tip,
                finger.tip_radius,
                None if finger.pad is None else finger.pad.torsional_friction,
            )
            for finger in described.fingers
        ),
        joints=tuple(joints),
        full_joints=full,
        T=freeze(T),
        q0=freeze(q0),
        neutral=freeze(resolver.neutral(ranges)),
        torque_weight=_checked_weight(described.torque_weight, joints, drives, str(files.path)),
        friction=resolve_friction(
            described.friction,
            {joint.name: (joint.torque, joint.velocity) for joint in joints},
            {name: resolver.moved_joints(T[:, i]) for name, i in index.items()},
            str(files.path),
        ),
        drives=drives,
        tendons=resolve_tendons(described.tendons, described.couplings, str(files.path)),
    )


def torque_weight(kind: TorqueWeight, joints: Sequence[JointInfo], drives: Drives) -> Array:
    """Return (n,) the diagonal of W in the cost ½ tauᵀ W tau.

    The copper loss of a motor is R i² with tau = k i, hence W = R/k².

    Args:
        kind: as in a hand's description.
        joints: the n actuated joints.
        drives: their drives.

    Raises:
        InvalidInput: the copper loss needs the resistance and the torque constant of each drive.
    """
    if kind == "unit":
        return freeze(np.ones(len(joints)))
    if kind == "utilisation":
        return freeze([joint.torque**-2 for joint in joints])
    weight = drives.values("resistance") / drives.values("torque_constant") ** 2  # W/(N·m)²
    for joint, value in zip(joints, weight.tolist(), strict=True):
        if not value > 0.0:
            raise InvalidInput("torque_weight", kind, f"used with a resistance and a torque constant; {joint.name} lacks one")
    return freeze(weight)


def _checked_weight(kind: TorqueWeight, joints: Sequence[JointInfo], drives: Drives, file: str) -> Array:
    """Return the weight of a description; its errors name the file."""
    try:
        return torque_weight(kind, joints, drives)
    except InvalidInput as error:
        raise ModelError(f"{file}: {error}") from None


class _Resolver:
    """The facts of a description and a URDF, checked against each other."""

    def __init__(self, files: HandSource, full: tuple[str, ...]) -> None:
        self._description: HandDescription = files.description
        self._model: Urdf = files.urdf
        self._full = full
        self._file = str(files.path)
        self._both = f"{files.path} and its URDF {files.urdf_path.name}"
        for name in full:
            if self._model.joints[name].type not in ("revolute", "prismatic"):
                kind = self._model.joints[name].type
                raise ModelError(f"{self._both}: joint {name} is {kind}; it must be revolute or prismatic, with limits")
        self._couplings = self._couplings_by_follower()
        self._locked = {lock.joint: lock.position for lock in self._description.locked}
        self._check_joints_exist("locked", self._locked)

    def finger_chains(self) -> dict[str, list[str]]:
        """Return the actuated joints of each finger, base first."""
        chains: dict[str, list[str]] = {}
        for finger in self._description.fingers:
            if finger.name in chains:
                raise ModelError(f"{self._file}: two fingers are named {finger.name}")
            if finger.tip not in self._model.links:
                raise ModelError(f"{self._both}: the tip of finger {finger.name} is {finger.tip}, which is no link of the URDF")
            moving = [joint.name for joint in self._model.chain(finger.tip) if joint.is_moving]
            leaders = [
                self._couplings[name].leader if name in self._couplings else name for name in moving if name not in self._locked
            ]
            chains[finger.name] = list(dict.fromkeys(leaders))
            if not leaders:
                raise ModelError(f"{self._both}: no joint moves the tip {finger.tip} of finger {finger.name}")
        return chains

    def full_map(self, index: dict[str, int]) -> tuple[Array, Array]:
        """Return T (n_full, n) and q0 (n_full,) for actuated joints with their indices."""
        T, q0 = np.zeros((len(self._full), len(index))), np.zeros(len(self._full))
        for row, name in enumerate(self._full):
            coupling = self._couplings.get(name)
            if name in self._locked:
                q0[row] = self._locked[name]
            elif coupling is not None and coupling.leader in index:
                T[row, index[coupling.leader]], q0[row] = coupling.ratio, coupling.offset
            elif name in index:
                T[row, index[name]] = 1.0
            else:
                raise ModelError(f"{self._both}: joint {name} moves no finger's tip; add a finger with it, or lock it")
        return T, q0

    def position_range(self, name: str, column: Array, q0: Array) -> tuple[float, float]:
        """Return the positions of an actuated joint at which it and its followers are within their limits, rad."""
        lower, upper = -np.inf, np.inf
        for row in np.flatnonzero(column):
            joint = self._model.joints[self._full[row]]
            if joint.lower is None or joint.upper is None or joint.lower >= joint.upper:
                limits = f"not {joint.lower} and {joint.upper}"
                raise ModelError(f"{self._both}: joint {joint.name} needs a lower limit below its upper limit, {limits}")
            ends = sorted(((joint.lower - q0[row]) / column[row], (joint.upper - q0[row]) / column[row]))
            lower, upper = max(lower, ends[0]), min(upper, ends[1])
        if lower >= upper:
            interval = _interval(lower, upper, self._unit(name))
            raise ModelError(f"{self._both}: the limits of {name} and its followers leave no range: {interval}")
        return float(lower), float(upper)

    def moved_joints(self, column: Array) -> list[tuple[UrdfJoint, float]]:
        """Return the URDF joints that an actuated joint moves, with their ratios."""
        return [(self._model.joints[self._full[row]], float(column[row])) for row in np.flatnonzero(column)]

    def motor(self, name: str) -> MotorDescription:
        """Return the motor of an actuated joint."""
        found = [motor for motor in self._description.motors if motor_matches(motor, name)]
        if len(found) != 1:
            raise ModelError(f"{self._file}: joint {name} must match the joints of exactly one motor, not of {len(found)}")
        return found[0]

    def neutral(self, ranges: dict[str, tuple[float, float]]) -> list[float]:
        """Return the neutral posture of joints with their position ranges, rad."""
        given = self._description.neutral
        for name, value in given.items():
            if name not in ranges:
                joints = ", ".join(ranges)
                raise ModelError(
                    f"{self._both}: the neutral posture has {name}, which is no actuated joint; these are {joints}"
                )
            if not ranges[name][0] <= value <= ranges[name][1]:
                unit = self._unit(name)
                limits = _interval(*ranges[name], unit)
                raise ModelError(f"{self._both}: the neutral {name} = {value:g} {unit} is outside its limits {limits}")
        return [min(max(given.get(name, 0.0), lower), upper) for name, (lower, upper) in ranges.items()]

    def _couplings_by_follower(self) -> dict[str, Coupling]:
        """Return the couplings by follower. A mimic joint of the URDF must be coupled with the same numbers."""
        couplings = self._description.couplings
        by_follower = {coupling.follower: coupling for coupling in couplings}
        self._check_joints_exist("coupled", [name for c in couplings for name in (c.follower, c.leader)])
        followers = [coupling.follower for coupling in couplings]
        locked = [lock.joint for lock in self._description.locked]
        for coupling in couplings:
            if followers.count(coupling.follower) > 1:
                raise ModelError(f"{self._file}: joint {coupling.follower} follows two leaders")
            if coupling.leader in by_follower:
                raise ModelError(
                    f"{self._file}: {coupling.follower} follows {coupling.leader}, which is itself a follower; "
                    "give the joint with the motor as leader"
                )
            for name in (coupling.follower, coupling.leader):
                if name in locked:
                    raise ModelError(
                        f"{self._file}: joint {name} is both locked and coupled; lock its followers too, or neither"
                    )
        for joint in self._model.joints.values():
            if joint.mimic is None:
                continue
            urdf = (joint.mimic.leader, joint.mimic.multiplier, joint.mimic.offset)
            own = by_follower.get(joint.name)
            if own is None:
                raise ModelError(
                    f"{self._both}: in the URDF {joint.name} mimics {_coupling_text(*urdf)}; add it to the couplings"
                )
            if (own.leader, own.ratio, own.offset) != urdf:
                raise ModelError(
                    f"{self._both}: {joint.name} follows {_coupling_text(own.leader, own.ratio, own.offset)} in the "
                    f"description, but {_coupling_text(*urdf)} in the URDF"
                )
        return by_follower

    def _unit(self, joint: str) -> str:
        """Return the unit of a joint's positions."""
        return "m" if self._model.joints[joint].type == "prismatic" else "rad"

    def _check_joints_exist(self, state: str, names: Iterable[str]) -> None:
        """Check that joints which the description locks or couples are moving joints of the URDF."""
        moving = [joint.name for joint in self._model.joints.values() if joint.is_moving]
        for name in names:
            if name not in moving:
                joints = ", ".join(moving)
                raise ModelError(f"{self._both}: the {state} joint {name} is no moving joint of the URDF; these are {joints}")


def _coupling_text(leader: str, ratio: float, offset: float) -> str:
    return f"{leader} × {ratio:g} + {offset:g}"


def _interval(lower: float, upper: float, unit: str) -> str:
    return f"[{lower:g}, {upper:g}] {unit}"
