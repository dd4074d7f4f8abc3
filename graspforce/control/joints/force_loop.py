"""Force control with joint torque sensors: torques for desired contact torques.

- `force_step`: tau = tau_u + tau_d + Kp Δ + Ki ∫ Δ dt − Kv v, with Δ = tau_d − tau_f
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy.typing as npt

from graspforce.control.joints.joint_command import (
    JointCommand,
    Limits,
    accumulate_integral,
    check_feedforward,
    limit_torques,
    set_gains,
)
from graspforce.core import arrays
from graspforce.core.arrays import Array


@dataclass(frozen=True, eq=False, slots=True)
class ForceGains:
    """Gains of the force loop.

    Args:
        kp: (n,) proportional gains, without unit, at least 0.
        ki: (n,) integral gains, 1/s, at least 0.
        kv: (n,) damping, N·m·s/rad, at least 0.

    Raises:
        InvalidInput: a gain is out of range; names the gain and the allowed values.
    """

    kp: Array
    ki: Array
    kv: Array

    def __post_init__(self) -> None:
        set_gains(self, ("kp", "ki", "kv"))


class TorqueReading(NamedTuple):
    """Measured state of the joints under load.

    Attributes:
        tau: (n,) measured contact torques tau_f = Jᵀ f, N·m.
        v: (n,) joint rates, rad/s.
    """

    tau: npt.ArrayLike
    v: npt.ArrayLike


def force_step(
    gains: ForceGains,
    integral: npt.ArrayLike,
    tau_desired: npt.ArrayLike,
    measured: TorqueReading,
    dt: float,
    tau_u: npt.ArrayLike | None = None,
    limits: Limits | None = None,
) -> tuple[JointCommand, Array]:
    """Compute one step of fingertip force control with joint torque sensors.

        tau = tau_u + tau_d + Kp Δ + Ki ∫ Δ dt − Kv v,   Δ = tau_d − tau_f

    Contact forces f load the joints with Jᵀ f, so desired forces give tau_d = Jᵀ f_d. Against a spring of stiffness δ at the
    joint, with motor inertia J and damping B, the response is

        tau_f / tau_d = δ (1 + Kp) / (J s² + (B + Kv) s + δ (1 + Kp))

    Its static gain is 1. An unmodelled torque leaves 1/(1 + Kp) of itself as the error, and the integral removes that.

    Source: Mattar (2013), eqs. (31)–(38). Its eqs. (33)–(35) leave the load out of the motor's balance, and the static gain of
    its eq. (37) is 1/k_i. With tau_d fed forward the load may be included: the response is the same with k_ps = 1 + Kp.

    Args:
        gains: gains of the loop.
        integral: (n,) integral that the last step returned, N·m; zeros before the first.
        tau_desired: (n,) tau_d = Jᵀ f_d, N·m.
        measured: measured contact torques and joint rates.
        dt: time between steps, s, greater than 0.
        tau_u: (n,) torques that the hand needs without contact, N·m; zeros by default.
        limits: lower and upper torques, N·m; none by default.

    Returns:
        The torques, and the integral for the next step in N·m. The integral does not wind up at a limit.

    Raises:
        InvalidInput: a value is not finite, lengths differ, or `dt` is not positive.
    """
    shape, dt = gains.kp.shape, arrays.check_number(dt, "dt", above=0.0)
    tau_d, last = arrays.check_array(tau_desired, "tau_desired", shape), arrays.check_array(integral, "integral", shape)
    delta = tau_d - arrays.check_array(measured.tau, "measured.tau", shape)
    increment = gains.ki * delta * dt  # N·m
    terms = tau_d + gains.kp * delta - gains.kv * arrays.check_array(measured.v, "measured.v", shape)
    command = limit_torques(check_feedforward(tau_u, shape) + last + increment + terms, limits)
    return command, accumulate_integral(last, increment, command)
