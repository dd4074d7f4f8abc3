"""Locks of actuated joints: the coordinates of the same hand with fewer motors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from graspforce.core.arrays import freeze
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.hand.drives.drive import Drives
from graspforce.hand.drives.joint_friction import JointFriction
from graspforce.hand.kinematics.coordinates import JointCoordinates


def lock_joints(coordinates: JointCoordinates, positions: Mapping[str, float]) -> JointCoordinates:
    """Return coordinates without some joints, which keep their positions: q0 gets T q of these joints.

    Args:
        coordinates: the coordinates.
        positions: position of each locked joint by name, rad.

    Raises:
        UnknownName: no actuated joint has that name; lists the joints.
        InvalidInput: a position is outside the joint's limits, or a finger keeps no joint.
    """
    names = [joint.name for joint in coordinates.joints]
    q = np.zeros(coordinates.n)
    for name, position in positions.items():
        if name not in names:
            raise UnknownName("joint", name, names)
        joint = coordinates.joints[names.index(name)]
        if not joint.lower <= position <= joint.upper:
            raise InvalidInput(f"positions.{name}", position, f"within [{joint.lower:g}, {joint.upper:g}] rad")
        q[names.index(name)] = position
    kept = [i for i, name in enumerate(names) if name not in positions]
    index = {old: new for new, old in enumerate(kept)}
    fingers = tuple(
        replace(finger, joints=tuple(index[j] for j in finger.joints if j in index)) for finger in coordinates.fingers
    )
    for finger in fingers:
        if not finger.joints:
            raise InvalidInput("positions", list(positions), f"joints of which finger {finger.name} keeps at least one")
    friction = coordinates.friction
    return JointCoordinates(
        fingers=fingers,
        joints=tuple(coordinates.joints[i] for i in kept),
        full_joints=coordinates.full_joints,
        T=freeze(coordinates.T[:, kept]),
        q0=freeze(coordinates.q0 + coordinates.T @ q),
        neutral=freeze(coordinates.neutral[kept]),
        torque_weight=freeze(coordinates.torque_weight[kept]),
        friction=JointFriction(
            friction.coulomb[kept],
            friction.stribeck[kept],
            friction.stribeck_velocity[kept],
            friction.viscous[kept],
            [friction.sources[i] for i in kept],
        ),
        drives=Drives(tuple(coordinates.drives.joints[i] for i in kept)),
        tendons=tuple(tendon for tendon in coordinates.tendons if tendon.joints[0] not in positions),
    )
