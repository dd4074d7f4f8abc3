"""Joints that move every finger, such as a wrist: the search keeps them at one position.

A common joint moves the palm, all contacts and the object as one rigid body. It changes neither the contact geometry nor, for
a given load, the contact forces: its torque is the moment of the load about its axis.
"""

from __future__ import annotations

import numpy as np

from graspforce.core.arrays import Array, freeze
from graspforce.hand.hand import Hand


def without_common_joints(hand: Hand, q: Array) -> Hand:
    """Return the hand with its common joints locked.

    Args:
        hand: the hand.
        q: (n,) posture in which they are locked, rad.
    """
    return (
        hand.with_locked_joints({hand.joints[j].name: float(q[j]) for j in hand.common_joints}) if hand.common_joints else hand
    )


def own_joints(hand: Hand) -> list[int]:
    """Return the indices of the joints that are not common to all fingers."""
    return [j for j in range(hand.n) if j not in hand.common_joints]


def whole_posture(hand: Hand, q: Array, q_own: Array) -> Array:
    """Return a posture of a hand with common joints from a posture without them.

    Args:
        hand: the hand with its common joints.
        q: (n,) posture with the positions of the common joints, rad.
        q_own: positions of the other joints, rad.
    """
    posture = np.array(q)
    posture[own_joints(hand)] = q_own
    return freeze(posture)
