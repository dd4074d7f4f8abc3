"""Errors of the drives' torques as factors, learned from the motion of the object.

A drive with a wrong constant makes (1 − δ_j) tau_j instead of tau_j. While the contacts neither slip nor separate, this
accelerates the object by −Φ δ, Φ = S diag(tau), with the sensitivity S of `graspforce.control.drives.drive_margin`. The
integral ∫ e dt of the pose error opposes this acceleration, k_i ∫ e dt = Φ δ. An integral alone stays behind when the torques
change with the posture. So each step

- moves the integral along: k_i ∫ e dt changes by (Φ − Φ') δ from the last step, in which Φ was Φ';
- corrects δ by the smallest change that explains the integral, relative to the stated errors b of the drives:

      δ ← δ + B Φᵀ (Φ B Φᵀ + ε I)⁻¹ (k_i ∫ e dt − Φ δ),    B = diag(b²),    |δ_j| ≤ b_j.

At rest the integral works as without this estimate. Forces and set-points do not use δ, so guarantees do not depend on it.

Source: Slotine and Li (1987), with the gradient step replaced by a projection.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.json_text import JsonRecord
from graspforce.hand.drives.drive import Drives

_LEVER = 0.03  # m: rotations count with the motion of a point at this distance
_DAMPING = 1e-3  # ε, part of the mean eigenvalue of Φ B Φᵀ


@dataclass(frozen=True, eq=False, slots=True)
class TorqueFactors:
    """Estimate of the drives' errors after a step.

    Attributes:
        errors: (n,) δ, missing parts of the torques.
        integral: (6,) integral of the pose error that they explain, in H, m·s and rad·s.
    """

    errors: Array
    integral: Array

    def to_dict(self) -> JsonRecord:
        """Return a plain record: `errors` and `integral`."""
        return {"errors": self.errors.tolist(), "integral": self.integral.tolist()}

    @classmethod
    def from_dict(cls, record: object, field: str = "torque_factors") -> TorqueFactors:
        """Read an estimate from a plain record.

        Args:
            record: as `to_dict` returns it.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, required=["errors", "integral"])
        errors = arrays.check_array(values["errors"], f"{field}.errors", (None,))
        return cls(errors, arrays.check_array(values["integral"], f"{field}.integral", (6,)))


class TorqueFactorEstimator:
    """Estimator of the drives' errors of one hand, without memory of its own.

    Args:
        drives: the drives, with the errors that they state.
        gain: (6,) k_i of each component, 1/s³.

    Attributes:
        is_active: whether a drive has an error and the controller an integral.
    """

    def __init__(self, drives: Drives, gain: Array) -> None:
        stiffness_error = np.where(drives.has_mode("position"), drives.values("stiffness_error"), 0.0)
        self._largest = drives.values("torque_error") + stiffness_error
        self._gain = gain
        self._scale = np.array([1.0] * 3 + [_LEVER] * 3)  # m/s² per component of the acceleration
        self.is_active = bool(self._largest.any() and gain.all())

    def step(
        self, factors: TorqueFactors | None, sensitivity: Array, tau: Array, integral: Array
    ) -> tuple[TorqueFactors, Array]:
        """Return the estimate after a step, and the integral of the pose error that moved along, (6,), m·s and rad·s.

        Args:
            factors: estimate after the last step; None before the first.
            sensitivity: (6, n) acceleration of the object in H per torque, m/s² and rad/s² per N·m.
            tau: (n,) torques of the step, N·m.
            integral: (6,) integral of the pose error in H after the step.
        """
        effect = sensitivity * tau  # Φ
        if factors is None:
            errors = np.zeros(len(tau))
        else:
            errors = factors.errors
            integral = integral + effect @ errors / self._gain - factors.integral
        residual = self._scale * (self._gain * integral - effect @ errors)
        scaled = self._scale[:, None] * effect * self._largest
        normal = scaled @ scaled.T
        damping = _DAMPING * float(np.trace(normal)) / len(normal)
        if damping > 0.0:
            change = scaled.T @ np.linalg.solve(normal + damping * np.eye(len(normal)), residual)
            errors = np.clip(errors + self._largest * change, -self._largest, self._largest)
        return TorqueFactors(freeze(errors), freeze(effect @ errors / self._gain)), freeze(integral)
