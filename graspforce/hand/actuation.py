"""Actuation: how contact forces load a hand's motors, and the limits of the motors."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import make_unchecked, set_fields

Limits = npt.ArrayLike | list[float | None] | tuple[float | None, ...] | None  # None stands for no limit


@dataclass(frozen=True, eq=False)
class Actuation:
    """The motor torques of stacked contact forces f: tau = tau_u + Jᵀ f, with lower ≤ tau ≤ upper.

    Source: Al-Gallaf, equation (16); Murray, Li and Sastry (1994), chapter 5.

    Args:
        J: (k, n) maps the n actuated joint rates to the hand's contact velocities, in the rows of f, m/rad. The row of a soft
            contact's moment has the unit 1.
        tau_u: (n,) motor torques without contact (inertia, Coriolis, gravity), N·m; zeros by default.
        lower: (n,) least motor torques, N·m; None, also for single entries, for no limit.
        upper: (n,) largest motor torques, N·m; None as in `lower`.
        weight: (n,) diagonal of W in the cost ½ tauᵀ W tau, ≥ 0; ones by default.

    Raises:
        InvalidInput: names the field as in the problem file, and what is allowed.
    """

    J: Array
    tau_u: Array
    lower: Array
    upper: Array
    weight: Array

    def __init__(
        self,
        J: npt.ArrayLike,
        tau_u: npt.ArrayLike | None = None,
        lower: Limits = None,
        upper: Limits = None,
        weight: npt.ArrayLike | None = None,
    ) -> None:
        set_fields(self, J=arrays.check_array(J, "jacobian", (None, None)))
        n = self.J.shape[1]
        set_fields(
            self,
            tau_u=arrays.check_array(np.zeros(n) if tau_u is None else tau_u, "bias_torque", (n,)),
            lower=arrays.check_limits(lower, "torque_lower", n, -math.inf),
            upper=arrays.check_limits(upper, "torque_upper", n, math.inf),
            weight=arrays.check_array(np.ones(n) if weight is None else weight, "torque_weight", (n,)),
        )
        for i in np.flatnonzero(self.lower > self.upper):
            allowed = f"at most torque_upper[{i}], which is {self.upper[i]:g}"
            raise InvalidInput(f"torque_lower[{i}]", float(self.lower[i]), allowed)
        for i in np.flatnonzero(self.weight < 0):
            raise InvalidInput(f"torque_weight[{i}]", float(self.weight[i]), "at least 0")

    def replace(self, *, J: npt.ArrayLike | None = None, tau_u: npt.ArrayLike | None = None) -> Actuation:
        """Return the actuation of the same hand in another state. Limits and weight are not checked again.

        Args:
            J: (k, n) the new Jacobian, m/rad; unchanged by default.
            tau_u: (n,) the new torques without contact, N·m; unchanged by default.

        Raises:
            InvalidInput: another shape, or not finite.
        """
        return make_unchecked(
            Actuation,
            J=self.J if J is None else arrays.check_array(J, "jacobian", self.J.shape),
            tau_u=self.tau_u if tau_u is None else arrays.check_array(tau_u, "bias_torque", self.tau_u.shape),
            lower=self.lower,
            upper=self.upper,
            weight=self.weight,
        )

    @classmethod
    def from_dict(cls, record: object, field: str = "hand") -> Actuation:
        """Return the actuation of the `hand` record of a problem file.

        Args:
            record: mapping with `jacobian`, and optional `bias_torque`, `torque_lower`, `torque_upper`, `torque_weight`.
            field: path of the record, for error messages.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        optional = ["bias_torque", "torque_lower", "torque_upper", "torque_weight"]
        values = fields.check_record(record, field, required=["jacobian"], optional=optional)
        try:
            return cls(values["jacobian"], *(values.get(name) for name in optional))
        except InvalidInput as error:
            raise error.with_prefix(field) from None

    def to_dict(self) -> JsonRecord:
        """Return the `hand` record of a problem file. None stands for no limit."""
        return {
            "jacobian": self.J.tolist(),
            "bias_torque": self.tau_u.tolist(),
            "torque_lower": [x if math.isfinite(x) else None for x in self.lower.tolist()],
            "torque_upper": [x if math.isfinite(x) else None for x in self.upper.tolist()],
            "torque_weight": self.weight.tolist(),
        }
