"""Spin of soft pads on the object, and the acceleration that takes it back.

Where a finger cannot follow the object's rotation about a contact normal, its pad spins. The constraints of the contacts are
accelerations, so they would keep the spin that was lost, and the finger would stay away from its posture until its links meet
something. The spin angle φ is therefore taken back as a critically damped motion, φ̈ = −2 k φ̇ − k² φ, wherever the finger can
follow again.

φ is the sum of the fingertip's rotations relative to the object about n, from step to step.
"""

from __future__ import annotations

import numpy as np

from graspforce.contact.kinematics import TipContactState
from graspforce.core.arrays import Array, freeze

_RETURN_RATE = 10.0  # rad/s: k, slower than the posture's motion, so that noise of the rates has little effect
_GAINS = freeze([_RETURN_RATE**2, 2.0 * _RETURN_RATE])  # 1/s² and 1/s


def spin_acceleration(spin: Array) -> Array:
    """Return the accelerations that take the spin back, (N,), rad/s².

    Args:
        spin: (N, 2) spin angle φ and its rate of each contact, rad and rad/s.
    """
    return np.asarray(spin @ -_GAINS)


def next_spin(spin: Array | None, before: TipContactState | None, now: TipContactState, R_OC: Array, period: float) -> Array:
    """Return spin angles and rates after a period, (N, 2), rad and rad/s.

    Args:
        spin: (N, 2) angles and rates before; None at the start.
        before: fingertips on the object then; None at the start.
        now: fingertips on the object.
        R_OC: (N, 3, 3) contact frames in O.
        period: s.
    """
    if spin is None or before is None:
        return freeze(np.zeros((len(R_OC), 2)))
    turn = now.R_OF @ before.R_OF.transpose(0, 2, 1)  # of each fingertip, in O
    axis = 0.5 * (turn[:, [2, 0, 1], [1, 2, 0]] - turn[:, [1, 2, 0], [2, 0, 1]])  # sin(angle) times its axis
    angle = np.arcsin(np.clip((axis * R_OC[:, :, 2]).sum(axis=1), -1.0, 1.0))  # rad
    return freeze(np.stack([spin[:, 0] + angle, angle / period], axis=1))
