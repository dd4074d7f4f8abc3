"""The controller of a hand without an object: one joint-space law with its gains and memory.

The default gains follow from one natural frequency ω for all joints, with the inertia M_ii of each joint in a posture:

- ``computed_torque``: Kp = ω², Kv = 2 ω: critical damping,
- ``pd_gravity``: Kp = ω² M_ii, Kv = 2 ω M_ii,
- ``pid``: Kp = 3 ω² M_ii, Ki = ω³ M_ii, Kd = 3 ω M_ii: a triple pole at −ω.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from graspforce.control.joints.joint_command import JointCommand, JointMotion, Limits
from graspforce.control.joints.joint_laws import PDGains, PIDGains, PIDMemory, computed_torque, pd_gravity, pid_step
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.records import set_fields
from graspforce.hand.hand import GRAVITY_PALM_UP, Hand

JointLaw = Literal["pd_gravity", "computed_torque", "pid"]
_HIGHEST_FREQUENCY = 1e4  # Hz: no control loop is faster
JOINT_LAWS: tuple[JointLaw, ...] = get_args(JointLaw)


@dataclass(frozen=True, eq=False, slots=True)
class JointController:
    """A joint-space law for a hand, its gains and the hand's torque limits. Its step is a pure function.

    Args:
        hand: the hand.
        law: ``"pd_gravity"``, ``"computed_torque"`` or ``"pid"``; see `graspforce.control.joints.joint_laws`.
        gains: `PIDGains` for ``"pid"``, otherwise `PDGains`.
        gravity_H: (3,) acceleration of gravity in H, m/s²; ``"pid"`` does not use it.

    Raises:
        InvalidInput: the law is unknown, or the gains are of another law or number of joints.
    """

    hand: Hand
    law: JointLaw
    gains: PDGains | PIDGains
    gravity_H: npt.ArrayLike = GRAVITY_PALM_UP

    def __post_init__(self) -> None:
        fields.check_choice(self.law, "law", JOINT_LAWS)
        kind = PIDGains if self.law == "pid" else PDGains
        if not isinstance(self.gains, kind):
            raise InvalidInput("gains", self.gains, f"{kind.__name__}, the gains of {self.law}")
        arrays.check_array(self.gains.kp, "gains.kp", (self.hand.n,))
        set_fields(self, gravity_H=arrays.check_array(self.gravity_H, "gravity_H", (3,)))

    @classmethod
    def with_frequency(
        cls, hand: Hand, law: JointLaw, frequency: float, gravity_H: npt.ArrayLike = GRAVITY_PALM_UP
    ) -> JointController:
        """Return a controller whose gains place all poles at one natural frequency, for the inertia in the neutral posture.

        Args:
            hand: the hand.
            law: as above.
            frequency: natural frequency, Hz, > 0 and at most 10,000.
            gravity_H: as above.

        Raises:
            InvalidInput: an argument is not allowed.
        """
        if arrays.check_number(frequency, "frequency", above=0.0) > _HIGHEST_FREQUENCY:
            raise InvalidInput("frequency", frequency, f"at most {_HIGHEST_FREQUENCY:g} Hz")
        omega = 2.0 * np.pi * frequency  # rad/s
        ones = np.ones(hand.n)
        inertia = np.diag(hand.mass_matrix(hand.neutral))  # kg·m²
        if fields.check_choice(law, "law", JOINT_LAWS) == "computed_torque":
            return cls(hand, law, PDGains(omega**2 * ones, 2.0 * omega * ones), gravity_H)
        if law == "pd_gravity":
            return cls(hand, law, PDGains(omega**2 * inertia, 2.0 * omega * inertia), gravity_H)
        return cls(hand, law, PIDGains(3.0 * omega**2 * inertia, omega**3 * inertia, 3.0 * omega * inertia), gravity_H)

    @property
    def limits(self) -> Limits:
        """Lower and upper motor torques, N·m."""
        return self.hand.torque_lower, self.hand.torque_upper

    def step(
        self, measured: JointMotion, desired: JointMotion, dt: float, memory: PIDMemory | None = None
    ) -> tuple[JointCommand, PIDMemory]:
        """Compute the torques of one period.

        Args:
            measured: measured positions and rates.
            desired: desired positions, rates and accelerations.
            dt: length of the period, s, > 0.
            memory: memory of the last step; None before the first.

        Raises:
            InvalidInput: a value is not finite, or lengths differ.
        """
        error: Array = freeze(desired.q - measured.q)
        if isinstance(self.gains, PIDGains):
            memory = PIDMemory.initial(error) if memory is None else memory
            return pid_step(self.gains, memory, error, dt, limits=self.limits)
        law = computed_torque if self.law == "computed_torque" else pd_gravity
        command = law(self.gains, self.hand, measured, desired, self.gravity_H, self.limits)
        return command, PIDMemory.initial(error)
