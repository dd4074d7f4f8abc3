"""Joint torques from measured motor currents.

A current i makes the torque m = k i before the losses of the gear, with k = K_t n. A gear of efficiency η passes η m to the
joint while the motor drives it, and m/η_b while the joint drives the motor. Near rest the direction is unknown:

    tau = c m − friction(v),   c = (η + 1/η_b)/2 − tanh(v sign(m)/ε) (1/η_b − η)/2,

where friction(v) is the known joint friction. The error has two parts: the noise of the currents, and constant errors. Those
are the error of the torque constant, the unknown direction of the gear at rest, and friction at rest, up to its Coulomb torque.
The last and the first count as uniformly distributed, with a standard deviation of their bound over √3. The direction of the
gear is one of two, with a standard deviation of half their distance.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.estimation.contact_forces import ForceModelErrors
from graspforce.hand.drives.drive import DIRECTION_RATE
from graspforce.hand.drives.joint_friction import SMOOTHING_RATE
from graspforce.hand.hand import Hand

_UNIFORM = 1.0 / math.sqrt(3.0)  # standard deviation of a uniform error per bound


class CurrentNoise(NamedTuple):
    """Errors of joint torques from currents, as standard deviations. Each is the largest of all joints.

    Attributes:
        noise: independent between periods, N·m.
        bias: constant, N·m.
        scale: constant, relative to the torque.
    """

    noise: float
    bias: float
    scale: float

    def added_to(self, errors: ForceModelErrors) -> ForceModelErrors:
        """Return errors of the force model with those of the currents.

        Args:
            errors: the other errors.
        """
        bias, scale = math.hypot(errors.torque_bias, self.bias), math.hypot(errors.torque_scale, self.scale)
        return dataclasses.replace(errors, torque_bias=bias, torque_scale=scale)


class CurrentTorques:
    """Joint torques of a hand from the currents of its motors.

    Args:
        hand: the hand with its drives and joint friction.

    Raises:
        InvalidInput: the torque constant of a drive is unknown; names the joints.
    """

    def __init__(self, hand: Hand) -> None:
        drives = hand.drives
        constants = drives.values("torque_constant")
        if np.isnan(constants).any():
            unknown = ", ".join(joint.name for joint, k in zip(hand.joints, constants, strict=True) if np.isnan(k))
            allowed = f"None for a hand whose drives state no torque constant: {unknown}"
            raise InvalidInput("sensors.current_noise", "a number", allowed)
        self._constants, self._friction = constants, hand.friction
        self._gain, self._loss = drives.gear_gain, drives.gear_loss  # joint torque per motor torque
        self._torque_error = drives.values("torque_error")

    def torques(self, current: Array, v: Array) -> Array:
        """Return the joint torques without joint friction, (n,), N·m.

        Args:
            current: (n,) measured currents, A.
            v: (n,) joint rates, rad/s.
        """
        motor = self._constants * current  # N·m
        return np.asarray(motor * self._factor(motor, v) - self._friction.torque_unchecked(v, SMOOTHING_RATE))

    def currents(self, tau: Array, v: Array) -> Array:
        """Return the currents that make joint torques, (n,), A.

        Args:
            tau: (n,) joint torques with those that overcome joint friction, N·m.
            v: (n,) joint rates, rad/s.
        """
        return np.asarray(tau / self._factor(tau, v) / self._constants)

    def _factor(self, torque: Array, v: Array) -> Array:
        """Return the joint torques per motor torque, (n,), for torques of either kind."""
        return np.asarray(self._gain - self._loss * np.tanh(np.sign(torque) * v / DIRECTION_RATE))

    def noise(self, current_noise: float) -> CurrentNoise:
        """Return the errors of the torques.

        Args:
            current_noise: standard deviation of a measured current, A.
        """
        largest = self._gain + self._loss  # joint torque per motor torque
        friction = self._friction.coulomb + self._friction.stribeck  # N·m, at rest
        scale = np.hypot(_UNIFORM * self._torque_error, self._loss / (self._gain - self._loss))
        return CurrentNoise(
            float((self._constants * largest).max()) * current_noise,
            _UNIFORM * float(friction.max()),
            float(scale.max()),
        )
