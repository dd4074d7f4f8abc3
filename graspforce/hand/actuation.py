"""What a hand brings to a force problem: how contact forces load its motors, and what the motors can bear."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput


@dataclass(frozen=True, eq=False)
class Actuation:
    """The motor torques that contact forces need: tau = tau_u + Jᵀ f, with lower ≤ tau ≤ upper. Source: 001 (16).

    Args:
        J: (k, n) maps the n actuated joint rates to the hand's contact velocities, rows as the stacked forces, m/rad (a
            soft contact's moment row: 1).
        tau_u: (n,) motor torques without contact (inertia, Coriolis, gravity), N·m; zeros by default.
        lower: (n,) least motor torques, N·m; None, or None inside, for no limit.
        upper: (n,) largest motor torques, N·m; likewise.
        weight: (n,) the diagonal of W in the cost ½ tauᵀ W tau, ≥ 0; ones by default.

    Raises:
        InvalidInput: names the field as the problem file spells it.
    """

    J: Array
    tau_u: Array
    lower: Array
    upper: Array
    weight: Array

    def __init__(self, J: Any, tau_u: Any = None, lower: Any = None, upper: Any = None, weight: Any = None) -> None:
        def put(name: str, value: Array) -> None:
            object.__setattr__(self, name, value)

        put("J", arrays.check_array(J, "jacobian", (None, None)))
        n = self.J.shape[1]
        put("tau_u", arrays.check_array(np.zeros(n) if tau_u is None else tau_u, "bias_torque", (n,)))
        put("lower", arrays.check_limits(lower, "torque_lower", n, -math.inf))
        put("upper", arrays.check_limits(upper, "torque_upper", n, math.inf))
        put("weight", arrays.check_array(np.ones(n) if weight is None else weight, "torque_weight", (n,)))
        for i in np.flatnonzero(self.lower > self.upper):
            allowed = f"at most torque_upper[{i}], which is {self.upper[i]:g}"
            raise InvalidInput(f"torque_lower[{i}]", float(self.lower[i]), allowed)
        for i in np.flatnonzero(self.weight < 0):
            raise InvalidInput(f"torque_weight[{i}]", float(self.weight[i]), "at least 0")

    def replace(self, *, J: Any = None, tau_u: Any = None) -> Actuation:
        """The same hand in another posture: only what is given is checked, and its shape stays.

        Args:
            J: (k, n), m/rad.
            tau_u: (n,), N·m.
        """
        new = object.__new__(Actuation)
        vars(new).update(J=self.J, tau_u=self.tau_u, lower=self.lower, upper=self.upper, weight=self.weight)
        if J is not None:
            vars(new)["J"] = arrays.check_array(J, "jacobian", self.J.shape)
        if tau_u is not None:
            vars(new)["tau_u"] = arrays.check_array(tau_u, "bias_torque", self.tau_u.shape)
        return new

    @classmethod
    def from_dict(cls, record: Mapping[str, Any], field: str = "hand") -> Actuation:
        """From the ``hand`` record of a problem file. ``field`` is the record's own path, for errors."""
        optional = ["bias_torque", "torque_lower", "torque_upper", "torque_weight"]
        values = fields.check_record(record, field, required=["jacobian"], optional=optional)
        try:
            return cls(values["jacobian"], *(values.get(name) for name in optional))
        except InvalidInput as error:
            raise error.with_prefix(field) from None

    def to_dict(self) -> dict[str, Any]:
        """The ``hand`` record of a problem file; no limit is null."""
        return {
            "jacobian": self.J.tolist(),
            "bias_torque": self.tau_u.tolist(),
            "torque_lower": [x if math.isfinite(x) else None for x in self.lower.tolist()],
            "torque_upper": [x if math.isfinite(x) else None for x in self.upper.tolist()],
            "torque_weight": self.weight.tolist(),
        }
