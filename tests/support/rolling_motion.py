"""Fingers that roll with a moving object without slip, integrated to rounding: the oracle of the estimator's tests."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from graspforce.contact.kinematics import rolling_contacts_reference
from graspforce.contact.motion import BodyMotion
from graspforce.core.arrays import Array
from graspforce.grasp.grasp import Grasp


class RollingSample(NamedTuple):
    """Hand and object at one instant: time, joint positions and rates, and the object's pose and twist."""

    t: float
    q: Array
    v: Array
    object: BodyMotion


def smooth_motion(grasp: Grasp, travel: Array, turn: Array, frequency: float) -> Callable[[float], BodyMotion]:
    """Return a motion to and fro: p₀ + d (1 − cos ωt)/2 with a rotation by the same share of `turn` about H's axes."""
    omega = 2.0 * np.pi * frequency

    def at(t: float) -> BodyMotion:
        share, rate = (1.0 - np.cos(omega * t)) / 2.0, omega * np.sin(omega * t) / 2.0
        R = Rotation.from_rotvec(share * turn).as_matrix() @ grasp.R_HO
        return BodyMotion(grasp.p_HO + share * travel, R, np.concatenate([rate * travel, rate * turn]))

    return at


def rolling_samples(grasp: Grasp, motion: Callable[[float], BodyMotion], duration: float, period: float) -> list[RollingSample]:
    """Return the hand at every period while its fingers roll with the object: A v = B V with the least rates, by RK4."""
    hand, contacts = grasp.hand, grasp.contacts
    radii = np.array([hand.finger(name).tip_radius or 0.0 for name in grasp.fingers])
    frames = [hand.frame_id(name) for name in grasp.fingers]
    R_last = contacts.R_OC

    def rates(q: Array, t: float) -> Array:
        nonlocal R_last
        body = motion(t)
        tips = hand.model.tip_motion(q, np.zeros(hand.n), frames)
        rolling = rolling_contacts_reference(tips, radii, body, grasp.body.shape, contacts, R_last)
        R_last = rolling.R_OC
        twist_O = (body.twist.reshape(2, 3) @ body.R_HO).ravel()
        return np.asarray(np.linalg.lstsq(rolling.A, rolling.B @ twist_O, rcond=1e-10)[0])

    q, samples = np.array(grasp.q), []
    for k in range(round(duration / period) + 1):
        t = k * period
        k1 = rates(q, t)
        samples.append(RollingSample(t, q, k1, motion(t)))
        k2 = rates(q + period / 2 * k1, t + period / 2)
        k3 = rates(q + period / 2 * k2, t + period / 2)
        k4 = rates(q + period * k3, t + period)
        q = q + period / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return samples


def pose_errors(found: BodyMotion, true: BodyMotion) -> tuple[float, float]:
    """Return the distance, m, and the angle, rad, between two poses."""
    turn = Rotation.from_matrix(found.R_HO @ true.R_HO.T).magnitude()
    return float(np.linalg.norm(found.p_HO - true.p_HO)), float(turn)
