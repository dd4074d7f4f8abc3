"""Postures with a fingertip at given places, near given postures: for many places at once, and along a path of the tip.

Each step of the damped Newton method d = Jᵀ (J Jᵀ + λ 1)⁻¹ e, with e = p* − p, is clipped to the joint limits.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from graspforce.core.arrays import Array
from graspforce.hand.hand import Hand

REACHED = 1e-6  # m: distance of a tip from its place that counts as none
_ITERATIONS = 12
_DAMPING = 1e-6  # λ, of the mean diagonal of J Jᵀ


def reach_places(hand: Hand, finger: str, q: Array, places_H: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Return postures near given ones in which the tip of a finger is at given places, and whether they reach them.

    Args:
        hand: the hand.
        finger: name of the finger; the other joints stay.
        q: (K, n) postures to start from, rad.
        places_H: (K, 3) places of the tip frame's origin in H, m.
    """
    joints = list(hand.finger(finger).joints)
    lower, upper = hand.q_lower[joints], hand.q_upper[joints]
    q = np.array(q)
    for _ in range(_ITERATIONS):
        p, J = hand.tips_along(q, [finger])
        error, J_finger = places_H - p[:, 0], J[:, 0][:, :, joints]
        if np.abs(error).max(initial=0.0) < REACHED / 10.0:
            break
        K = J_finger @ J_finger.swapaxes(1, 2)
        damping = _DAMPING * np.trace(K, axis1=1, axis2=2)[:, None, None] / 3.0 + 1e-12
        step = np.linalg.solve(K + damping * np.eye(3), error[..., None])
        q[:, joints] = np.clip(q[:, joints] + (J_finger.swapaxes(1, 2) @ step)[..., 0], lower, upper)
    error = places_H - hand.tips_along(q, [finger])[0][:, 0]
    return q, np.linalg.norm(error, axis=1) < REACHED


def follow_tip(hand: Hand, finger: str, q: Array, places_H: Array) -> Array | None:
    """Return postures in which the tip of a finger goes through places one after the other; None if it cannot.

    Args:
        hand: the hand.
        finger: name of the finger; the other joints stay.
        q: (n,) posture at the first place, rad.
        places_H: (K, 3) places of the tip frame's origin in H, m.

    Returns:
        (K, n) postures; the first is q.
    """
    postures = [np.array(q)]
    for place in places_H[1:]:
        following, reached = reach_places(hand, finger, postures[-1][None], place[None])
        if not reached[0]:
            return None
        postures.append(following[0])
    return np.array(postures)
