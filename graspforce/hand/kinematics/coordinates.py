"""The actuated coordinates of a hand: its joints with motors, their limits, and the map to all joints.

In the order of Pinocchio's joints, q_full = T q + q0. `resolution` makes them from a description and its URDF.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import UnknownName
from graspforce.hand.drives.drive import Drives
from graspforce.hand.drives.joint_friction import JointFriction
from graspforce.hand.drives.tendon import Tendon

_HELD_WEIGHT = 0.01  # of a joint whose gear holds the load: less would allow large contact forces to save little current


@dataclass(frozen=True, slots=True)
class Finger:
    """A finger.

    Attributes:
        name: as in the description.
        joints: indices of the actuated joints that move its tip, base first.
        tip: name of the URDF link whose frame is the tip frame.
        tip_radius: radius of a spherical tip about that frame's origin, m; None for a tip of another shape.
        torsional_friction: torsional friction length γ of a soft pad, m; None for a tip without one.
    """

    name: str
    joints: tuple[int, ...]
    tip: str
    tip_radius: float | None
    torsional_friction: float | None = None


@dataclass(frozen=True, slots=True)
class JointInfo:
    """An actuated joint. A prismatic joint has m, m/s, N and kg in place of rad, rad/s, N·m and kg·m².

    Attributes:
        name: as in the URDF; the leader's name for coupled joints.
        finger: the first finger that it moves.
        lower: least position, rad, with the limits of its followers.
        upper: largest position, rad, with the limits of its followers.
        velocity: largest rate, rad/s.
        torque: largest motor torque at the joint in both directions, N·m; at most that of the drive's current limit.
        rotor_inertia: rotor inertia at the joint, kg·m².
        source: where the motor's numbers come from.
        is_prismatic: whether the joint slides.
        holding_torque: largest torque that its gear holds at rest without current, N·m; None if the joint can drive it back.
    """

    name: str
    finger: str
    lower: float
    upper: float
    velocity: float
    torque: float
    rotor_inertia: float
    source: str
    is_prismatic: bool = False
    holding_torque: float | None = None

    @property
    def position_unit(self) -> str:
        """Unit of its positions: rad, or m for a prismatic joint."""
        return "m" if self.is_prismatic else "rad"

    @property
    def torque_unit(self) -> str:
        """Unit of its torques: N·m, or N for a prismatic joint."""
        return "N" if self.is_prismatic else "N·m"


@dataclass(frozen=True, eq=False)
class JointCoordinates:
    """The actuated coordinates of a hand, and their map to all joints, q_full = T q + q0.

    Attributes:
        fingers: the fingers in the order of the description.
        joints: the n actuated joints, by finger and from base to tip.
        full_joints: names of the moving joints of the URDF, in Pinocchio's order.
        T: (n_full, n) rates of all joints per rate of the actuated joints.
        q0: (n_full,) positions of all joints at q = 0, rad.
        neutral: (n,) neutral posture, rad: the start of searches.
        torque_weight: (n,) diagonal of W in the default cost ½ tauᵀ W tau.
        friction: friction of the joints; zeros where it is unknown.
        tendons: motors that drive two joints, of which one can stop.
        drives: what the actuators of the joints take; ideal torque drives where nothing is known.
    """

    fingers: tuple[Finger, ...]
    joints: tuple[JointInfo, ...]
    full_joints: tuple[str, ...]
    T: Array
    q0: Array
    neutral: Array
    torque_weight: Array
    friction: JointFriction
    drives: Drives
    tendons: tuple[Tendon, ...]

    @property
    def n(self) -> int:
        """Number of actuated joints."""
        return len(self.joints)

    @property
    def position_units(self) -> tuple[str, ...]:
        """Units of the joints' positions, each once."""
        return tuple(dict.fromkeys(joint.position_unit for joint in self.joints))

    @property
    def torque_units(self) -> tuple[str, ...]:
        """Units of the joints' torques, each once."""
        return tuple(dict.fromkeys(joint.torque_unit for joint in self.joints))

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the n actuated joints, in the order of torques and positions."""
        return tuple(joint.name for joint in self.joints)

    @cached_property
    def q_lower(self) -> Array:
        """(n,) least joint positions, rad, with the limits of followers."""
        return freeze([joint.lower for joint in self.joints])

    @cached_property
    def q_upper(self) -> Array:
        """(n,) largest joint positions, rad, with the limits of followers."""
        return freeze([joint.upper for joint in self.joints])

    @cached_property
    def torque_lower(self) -> Array:
        """(n,) least motor torques, N·m."""
        return freeze([-joint.torque for joint in self.joints])

    @cached_property
    def torque_upper(self) -> Array:
        """(n,) largest motor torques, N·m: those of the motors, and at most the thresholds of closed breakaways.

        The first joint of a breakaway gets the motor's torque less the part that bends the second joint. If the contact presses
        that joint back, as the contact of a fingertip does, it gets at most the motor's torque, and the clutch stays closed.
        """
        threshold = {each.joints[0]: each.threshold for each in self.tendons if each.threshold is not None}
        return freeze([min(joint.torque, threshold.get(joint.name, joint.torque)) for joint in self.joints])

    @cached_property
    def rest_torque_limit(self) -> Array:
        """(n,) largest torques at rest, N·m: those of the motors, or of gears that hold the load."""
        return freeze([joint.torque if joint.holding_torque is None else joint.holding_torque for joint in self.joints])

    @cached_property
    def rest_torque_weight(self) -> Array:
        """(n,) `force_weight` at rest: a hundredth for gears that hold the load, to bound contact forces that need no current.

        If all gears hold the load, nothing costs current, and the weights are those of motion.
        """
        holds = np.array([joint.holding_torque is not None for joint in self.joints])
        return freeze(np.where(holds & ~holds.all(), _HELD_WEIGHT, 1.0) * self.force_weight)

    @cached_property
    def velocity_limit(self) -> Array:
        """(n,) largest joint rates, rad/s."""
        return freeze([joint.velocity for joint in self.joints])

    @cached_property
    def rotor_inertia(self) -> Array:
        """(n,) rotor inertias at the joints, kg·m²: the diagonal of D."""
        return freeze([joint.rotor_inertia for joint in self.joints])

    @cached_property
    def common_joints(self) -> tuple[int, ...]:
        """Indices of the joints that move the palm with every finger, such as a wrist; empty for a hand with one finger.

        A motor that moves a joint of each finger, such as that of two jaws, is none of them.
        """
        shared = set.intersection(*(set(finger.joints) for finger in self.fingers if finger.joints))
        single = [j for j in sorted(shared) if np.count_nonzero(self.T[:, j]) == 1]  # no followers
        return tuple(single) if len(self.fingers) > 1 else ()

    @cached_property
    def force_weight(self) -> Array:
        """(n,) `torque_weight` for force problems: zero for common joints, because the load alone determines their torques.

        Their constant cost would exceed that of the fingers, and the solver's relative tolerance would be coarse for these.
        """
        weight = np.array(self.torque_weight)
        weight[list(self.common_joints)] = 0.0
        return freeze(weight)

    def finger(self, name: str) -> Finger:
        """Return the finger of a name.

        Args:
            name: the finger's name.

        Raises:
            UnknownName: no such finger; lists the fingers.
        """
        for finger in self.fingers:
            if finger.name == name:
                return finger
        raise UnknownName("finger", name, [finger.name for finger in self.fingers])
