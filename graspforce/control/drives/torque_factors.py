"""Errors of the drives' torques as factors, learned from the motion of the object.

A drive with a wrong constant makes (1 − δ_j) tau_j instead of tau_j. While the contacts neither slip nor separate, this
accelerates the object by −Φ δ, Φ = S diag(tau), with the sensitivity S of `graspforce.control.drives.drive_margin`. The
integral ∫ e dt of the pose error opposes this acceleration, k_i ∫ e dt = Φ δ. An integral alone stays behind when the torques
change with the posture. So each step

- moves the integral along: k_i ∫ e dt changes by (Φ − Φ') δ from the last step, in which Φ was Φ';
- corrects δ by the smallest change that explains the integral, relative to the stated errors b of the drives:

      δ ← δ + B Φᵀ (Φ B Φᵀ + ε I)⁻¹ (k_i ∫ e dt − Φ δ),    B = diag(b²),    |δ_j| ≤ b_j.

At rest the integral works as without this estimate. Forces and set-points do not use δ, so guarantees do not depend on it.

Wrong torques also move the joints in the null space of the contacts, where only the posture's stiffness opposes them. There the
target of the posture moves by o, with ȯ = r N (q_d − q) and the projector N = I − A⁺A, so that the joints return to q_d.

Source: Slotine and Li (1987), with the gradient step replaced by a projection.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from graspforce.control.state import DesiredMotion, GraspMotion, object_motion
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.hand.hand import Hand

_LEVER = 0.03  # m: rotations count with the motion of a point at this distance
_POSTURE_RATE = 5.0  # r, 1/s
_DAMPING = 1e-3  # ε, part of the mean eigenvalue of Φ B Φᵀ


@dataclass(frozen=True, eq=False, slots=True)
class TorqueFactors:
    """Estimate of the drives' errors after a step.

    Attributes:
        errors: (n,) δ, missing parts of the torques.
        integral: (6,) integral of the pose error that they explain, in H, m·s and rad·s.
        posture: (n,) o, offset of the posture's target, rad.
    """

    errors: Array
    integral: Array
    posture: Array

    def to_dict(self) -> JsonRecord:
        """Return a plain record: `errors`, `integral` and `posture`."""
        return {name: getattr(self, name).tolist() for name in ("errors", "integral", "posture")}

    @classmethod
    def from_dict(cls, record: object, field: str = "torque_factors") -> TorqueFactors:
        """Read an estimate from a plain record.

        Args:
            record: as `to_dict` returns it.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, required=["errors", "integral", "posture"])
        errors = arrays.check_array(values["errors"], f"{field}.errors", (None,))
        integral = arrays.check_array(values["integral"], f"{field}.integral", (6,))
        return cls(errors, integral, arrays.check_array(values["posture"], f"{field}.posture", (len(errors),)))

    def shift(self, desired: DesiredMotion, q: Array) -> GraspMotion:
        """Return a desired motion whose posture is moved by the offset.

        Args:
            desired: the desired motion.
            q: (n,) posture if it has none, rad.

        Raises:
            InvalidInput: the estimate belongs to another number of motors.
        """
        if len(self.posture) != len(q):
            raise InvalidInput("memory.torque_factors.errors", self.errors, f"a list of {len(q)} numbers, one for each motor")
        if isinstance(desired, GraspMotion):
            return GraspMotion(desired.object, desired.q + self.posture, desired.v, desired.a)
        return GraspMotion(object_motion(desired), q + self.posture, _at_rest(len(q)), _at_rest(len(q)))


class TorqueFactorEstimator:
    """Estimator of the drives' errors of one hand, without memory of its own.

    Args:
        hand: the hand, whose drives state their errors.
        gain: (6,) k_i of each component, 1/s³.
        period: of the control, s.

    Attributes:
        is_active: whether a drive has an error and the controller an integral.
    """

    def __init__(self, hand: Hand, gain: Array, period: float) -> None:
        drives = hand.drives
        stiffness_error = np.where(drives.has_mode("position"), drives.values("stiffness_error"), 0.0)
        self._largest = drives.values("torque_error") + stiffness_error
        self._gain = gain
        self._scale = np.array([1.0] * 3 + [_LEVER] * 3)  # m/s² per component of the acceleration
        self._posture_gain, self._range = _POSTURE_RATE * period, 0.5 * (hand.q_upper - hand.q_lower)
        self.is_active = bool(self._largest.any() and gain.all())

    def step(
        self, factors: TorqueFactors | None, sensitivity: Array, tau: Array, integral: Array, drift: Array
    ) -> tuple[TorqueFactors, Array]:
        """Return the estimate after a step, and the integral of the pose error that moved along, (6,), m·s and rad·s.

        Args:
            factors: estimate after the last step; None before the first.
            sensitivity: (6, n) acceleration of the object in H per torque, m/s² and rad/s² per N·m.
            tau: (n,) torques of the step, N·m.
            integral: (6,) integral of the pose error in H after the step.
            drift: (n,) N (q_d − q), rad, as `null_space_part` returns it.
        """
        effect = sensitivity * tau  # Φ
        if factors is None:
            errors, posture = np.zeros(len(tau)), np.zeros(len(tau))
        else:
            errors, posture = factors.errors, factors.posture
            integral = integral + effect @ errors / self._gain - factors.integral
        residual = self._scale * (self._gain * integral - effect @ errors)
        scaled = self._scale[:, None] * effect * self._largest
        normal = scaled @ scaled.T
        damping = _DAMPING * float(np.trace(normal)) / len(normal)
        if damping > 0.0:
            change = scaled.T @ np.linalg.solve(normal + damping * np.eye(len(normal)), residual)
            errors = np.clip(errors + self._largest * change, -self._largest, self._largest)
        posture = np.clip(posture + self._posture_gain * drift, -self._range, self._range)
        return TorqueFactors(freeze(errors), freeze(effect @ errors / self._gain), freeze(posture)), freeze(integral)


def null_space_part(A: Array, posture_error: Array, rank_tolerance: float) -> Array:
    """Return N e, the part of a posture error that moves no contact, (n,), rad.

    Args:
        A: (r, n) map from joint rates to constrained velocities, m/rad.
        posture_error: (n,) e, rad.
        rank_tolerance: relative singular value of A that counts as zero.
    """
    return np.asarray(posture_error - np.linalg.pinv(A, rank_tolerance) @ (A @ posture_error))


@cache
def _at_rest(n: int) -> Array:
    """Return n zeros."""
    return freeze(np.zeros(n))
