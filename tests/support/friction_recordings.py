"""Recordings of free motions of a hand whose joints have friction."""

from __future__ import annotations

import numpy as np

from graspforce.hand.drives.joint_friction import JointFriction
from graspforce.hand.hand import Hand
from graspforce.hand.identification.joint_recording import JointRecording

RATE = 500.0  # Hz


def free_motion(hand: Hand, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return positions, rates and accelerations (s, n) of two superposed sines about the middle of each joint's range."""
    middle, amplitude = 0.5 * (hand.q_lower + hand.q_upper), 0.15 * (hand.q_upper - hand.q_lower)
    q, v, a = np.zeros((3, len(t), hand.n))
    q += middle
    for j in range(hand.n):
        for share, frequency in ((0.7, 0.31 + 0.013 * j), (0.3, 0.83 - 0.017 * j)):  # Hz
            omega, phase = 2.0 * np.pi * frequency, 0.7 * j
            q[:, j] += share * amplitude[j] * np.sin(omega * t + phase)
            v[:, j] += share * amplitude[j] * omega * np.cos(omega * t + phase)
            a[:, j] -= share * amplitude[j] * omega**2 * np.sin(omega * t + phase)
    return q, v, a


def friction_recording(
    hand: Hand,
    friction: JointFriction,
    duration: float = 10.0,
    encoder_noise: float = 0.0,
    torque_noise: float = 0.0,
    seed: int = 0,
) -> JointRecording:
    """Return a recording of `free_motion` with the torques of the rigid hand and its friction, sharp at zero."""
    rng, t = np.random.default_rng(seed), np.arange(round(duration * RATE)) / RATE
    q, v, a = free_motion(hand, t)
    level = friction.coulomb + friction.stribeck * np.exp(-np.square(v / friction.stribeck_velocity))
    tau = hand.inverse_dynamics_along(q, v, a) + level * np.sign(v) + friction.viscous * v
    q = q + encoder_noise * rng.standard_normal(q.shape)
    return JointRecording(t, q, tau + torque_noise * rng.standard_normal(tau.shape))
