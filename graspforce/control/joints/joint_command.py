"""Joint motions and torques, and the limits and integrals that the joint laws share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.records import set_fields

Limits = tuple[npt.ArrayLike, npt.ArrayLike]  # (n,) lower and (n,) upper torque limits, N·m


@dataclass(frozen=True, eq=False, slots=True)
class JointMotion:
    """Measured or desired motion of n joints.

    Args:
        q: (n,) positions, rad.
        v: (n,) rates, rad/s; zeros by default.
        a: (n,) accelerations, rad/s²; zeros by default. The laws use desired accelerations only.

    Raises:
        InvalidInput: a value is not finite, or the lengths differ.
    """

    q: Array
    v: Array
    a: Array

    def __init__(self, q: npt.ArrayLike, v: npt.ArrayLike | None = None, a: npt.ArrayLike | None = None) -> None:
        q = arrays.check_array(q, "q", (None,))
        zeros = np.zeros(len(q))
        rates = {name: zeros if value is None else value for name, value in (("v", v), ("a", a))}
        set_fields(self, q=q, **{name: arrays.check_array(value, name, q.shape) for name, value in rates.items()})


@dataclass(frozen=True, eq=False, slots=True)
class JointCommand:
    """Torques of a joint law.

    Attributes:
        tau: (n,) torques within the limits, N·m.
        tau_unlimited: (n,) torques of the law without limits, N·m.
    """

    tau: Array
    tau_unlimited: Array

    @property
    def saturated(self) -> Array:
        """(n,) +1 for a torque at its upper limit, −1 at its lower limit, otherwise 0."""
        return np.sign(self.tau_unlimited - self.tau)


def set_gains(gains: object, names: tuple[str, ...], positive: bool = False) -> None:
    """Check the gains of a frozen record and store them as read-only arrays.

    Args:
        gains: the record under construction.
        names: its fields, (n,) each.
        positive: whether the gains must be greater than 0; otherwise at least 0.

    Raises:
        InvalidInput: a gain is out of range, or lengths differ.
    """
    shape: tuple[int | None, ...] = (None,)
    for name in names:
        value = arrays.check_array(getattr(gains, name), name, shape)
        for i in np.flatnonzero(value <= 0.0 if positive else value < 0.0):
            raise InvalidInput(f"{name}[{i}]", float(value[i]), "greater than 0" if positive else "at least 0")
        set_fields(gains, **{name: value})
        shape = value.shape


def check_feedforward(tau_u: npt.ArrayLike | None, shape: tuple[int, ...]) -> Array:
    """Return the feedforward torques, zeros for None.

    Args:
        tau_u: torques, N·m.
        shape: (n,)

    Raises:
        InvalidInput: a value is not finite, or the shape differs.
    """
    return np.zeros(shape) if tau_u is None else arrays.check_array(tau_u, "tau_u", shape)


def limit_torques(tau: Array, limits: Limits | None) -> JointCommand:
    """Return the command for the torques of a law.

    Args:
        tau: (n,) torques without limits, N·m.
        limits: lower and upper torques, N·m; None for none.

    Raises:
        InvalidInput: a lower limit exceeds the upper one, or lengths differ.
    """
    if limits is None:
        return JointCommand(freeze(tau), freeze(tau))
    lower = arrays.check_limits(limits[0], "limits[0]", len(tau), -np.inf)
    upper = arrays.check_limits(limits[1], "limits[1]", len(tau), np.inf)
    for i in np.flatnonzero(lower > upper):
        raise InvalidInput(f"limits[0][{i}]", float(lower[i]), f"at most limits[1][{i}], which is {upper[i]:g}")
    return JointCommand(freeze(np.clip(tau, lower, upper)), freeze(tau))


def accumulate_integral(integral: Array, increment: Array, command: JointCommand) -> Array:
    """Return the integral with the increment, less the part that pushes the torque beyond a limit.

    Args:
        integral: (n,) integral term, N·m.
        increment: (n,) its increment in this step, N·m.
        command: torques with the whole increment.
    """
    excess = command.tau_unlimited - command.tau
    beyond = np.where(excess * increment > 0.0, np.sign(increment) * np.minimum(np.abs(excess), np.abs(increment)), 0.0)
    return freeze(integral + increment - beyond)
