"""The force loop of a hand whose joints measure their torques: contact torques follow desired ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graspforce.control.joints.force_loop import ForceGains, TorqueReading, force_step
from graspforce.control.joints.joint_command import JointCommand, JointMotion
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.records import set_fields
from graspforce.hand.hand import GRAVITY_PALM_UP, Hand


@dataclass(frozen=True, eq=False, slots=True)
class ForceController:
    """The force loop of `force_step` with gravity compensation, for a hand. Its step is a pure function.

    Args:
        hand: the hand.
        gains: gains of the loop.
        gravity_H: (3,) acceleration of gravity in H, m/s².

    Raises:
        InvalidInput: the gains are of another number of joints, or gravity is not finite.
    """

    hand: Hand
    gains: ForceGains
    gravity_H: npt.ArrayLike = GRAVITY_PALM_UP

    def __post_init__(self) -> None:
        arrays.check_array(self.gains.kp, "gains.kp", (self.hand.n,))
        set_fields(self, gravity_H=arrays.check_array(self.gravity_H, "gravity_H", (3,)))

    def step(
        self,
        measured: JointMotion,
        tau_measured: npt.ArrayLike,
        tau_desired: npt.ArrayLike,
        dt: float,
        integral: Array | None = None,
    ) -> tuple[JointCommand, Array]:
        """Compute the torques of one period.

        Args:
            measured: measured positions and rates.
            tau_measured: (n,) measured contact torques Jᵀ f, N·m.
            tau_desired: (n,) desired contact torques Jᵀ f_d, N·m.
            dt: length of the period, s, > 0.
            integral: (n,) integral of the last step, N·m; None before the first.

        Returns:
            The torques, and the integral for the next step.

        Raises:
            InvalidInput: a value is not finite, or lengths differ.
        """
        hand = self.hand
        last = freeze(np.zeros(hand.n)) if integral is None else integral
        tau_g = hand.gravity_torque(arrays.check_array(measured.q, "measured.q", (hand.n,)), self.gravity_H)
        reading, limits = TorqueReading(tau_measured, measured.v), (hand.torque_lower, hand.torque_upper)
        return force_step(self.gains, last, tau_desired, reading, dt, tau_g, limits)
