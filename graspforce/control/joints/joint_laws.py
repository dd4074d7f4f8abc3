"""Joint-space control laws: torques for a desired motion or position of the joints.

The laws are pure functions in the motor coordinates of `Hand`. They take frozen gains, measurements and memory, and return
torques and the next memory. Each law respects the torque limits and reports the torque without them.

- `pd_gravity`: tau = Kp (q_d − q) + Kv (v_d − v) + g(q)
- `computed_torque`: tau = M (a_d + Kv (v_d − v) + Kp (q_d − q)) + c(q, v) + g(q)
- `pid`, `pid_step`: tau = tau_u + Kp e + Ki ∫ e dt + Kd ė

`graspforce.control.joints.force_loop` has the law for desired contact torques.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from graspforce.control.joints.joint_command import (
    JointCommand,
    JointMotion,
    Limits,
    accumulate_integral,
    check_feedforward,
    limit_torques,
    set_gains,
)
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput


class Dynamics(Protocol):
    """Dynamics of a mechanism, as `Hand` computes them."""

    def gravity_torque(self, q: npt.ArrayLike, gravity_H: npt.ArrayLike) -> Array:
        """Return g(q), (n,), N·m."""

    def inverse_dynamics(self, q: npt.ArrayLike, v: npt.ArrayLike, a: npt.ArrayLike, gravity_H: npt.ArrayLike) -> Array:
        """Return M a + c(q, v) + g(q), (n,), N·m."""


# ── laws for a desired motion, with a model ───────────────────────────────────────────────────────────────────────────────────


@dataclass(frozen=True, eq=False, slots=True)
class PDGains:
    """Gains of a law without integral.

    Args:
        kp: (n,) greater than 0; N·m/rad in `pd_gravity`, 1/s² in `computed_torque`.
        kv: (n,) greater than 0; N·m·s/rad in `pd_gravity`, 1/s in `computed_torque`.

    Raises:
        InvalidInput: a gain is out of range; names the gain and the allowed values.
    """

    kp: Array
    kv: Array

    def __post_init__(self) -> None:
        set_gains(self, ("kp", "kv"), positive=True)


def pd_gravity(
    gains: PDGains,
    mechanism: Dynamics,
    measured: JointMotion,
    desired: JointMotion,
    gravity_H: npt.ArrayLike,
    limits: Limits | None = None,
) -> JointCommand:
    """Compute the torques that bring the joints to a posture: tau = Kp (q_d − q) + Kv (v_d − v) + g(q).

    For constant q_d the function V = ½ vᵀ M v + ½ (q_d − q)ᵀ Kp (q_d − q) decreases with V̇ = −vᵀ Kv v: every posture
    converges to q_d. Where Kv² is much larger than 4 Kp M, inertia is negligible, and the error of each joint decays as
    e^(−Kp/Kv t).

    Source: Digital-twin hand study, eq. (19). Its Lyapunov function, eq. (21), lacks the second term of V.

    Args:
        gains: gains in N·m/rad and N·m·s/rad.
        mechanism: the hand.
        measured: measured positions and rates.
        desired: desired positions and rates; the acceleration is not used.
        gravity_H: (3,) acceleration of gravity in H, m/s².
        limits: lower and upper torques, such as ``(hand.torque_lower, hand.torque_upper)``; none by default.

    Raises:
        InvalidInput: a value is not finite, or lengths differ.
    """
    error, error_rate = _errors(gains.kp, measured, desired)
    tau_g = mechanism.gravity_torque(measured.q, gravity_H)
    return limit_torques(gains.kp * error + gains.kv * error_rate + tau_g, limits)


def computed_torque(
    gains: PDGains,
    mechanism: Dynamics,
    measured: JointMotion,
    desired: JointMotion,
    gravity_H: npt.ArrayLike,
    limits: Limits | None = None,
) -> JointCommand:
    """Compute the torques that follow a joint motion: inverse dynamics of a = a_d + Kv (v_d − v) + Kp (q_d − q).

    With an exact model and no active limit, the error of every joint satisfies ë + Kv ė + Kp e = 0.

    Source: DLR-HIT II dual-platform study, section III.A.2.

    Args:
        gains: gains in 1/s² and 1/s; kv = 2 √kp is critical damping.
        mechanism: the hand.
        measured: measured positions and rates.
        desired: desired positions, rates and accelerations.
        gravity_H: (3,) acceleration of gravity in H, m/s².
        limits: as in `pd_gravity`; the source limits the torque to ±0.5 N·m.

    Raises:
        InvalidInput: a value is not finite, or lengths differ.
    """
    error, error_rate = _errors(gains.kp, measured, desired)
    a = desired.a + gains.kv * error_rate + gains.kp * error  # rad/s²
    return limit_torques(mechanism.inverse_dynamics(measured.q, measured.v, a, gravity_H), limits)


# ── laws for a desired position, without a model ──────────────────────────────────────────────────────────────────────────────


@dataclass(frozen=True, eq=False, slots=True)
class PIDGains:
    """Gains of the three terms of a PID law.

    Mattar (2013) writes them per step of length dt: K_p = kp, K_ip = ki dt, K_d = kd/dt.

    Args:
        kp: (n,) proportional gains, N·m/rad, at least 0.
        ki: (n,) integral gains, N·m/(rad·s), at least 0.
        kd: (n,) derivative gains, N·m·s/rad, at least 0.

    Raises:
        InvalidInput: a gain is out of range; names the gain and the allowed values.
    """

    kp: Array
    ki: Array
    kd: Array

    def __post_init__(self) -> None:
        set_gains(self, ("kp", "ki", "kd"))

    @classmethod
    def from_times(cls, k: npt.ArrayLike, tau_i: npt.ArrayLike, tau_d: npt.ArrayLike) -> PIDGains:
        """Return the gains of the form k (e + 1/τ_i ∫ e dt + τ_d ė), eq. (24) of Mattar (2013).

        Args:
            k: (n,) gains, N·m/rad.
            tau_i: (n,) integral times, s, greater than 0.
            tau_d: (n,) derivative times, s.

        Raises:
            InvalidInput: a value is out of range, or lengths differ.
        """
        k = arrays.check_array(k, "k", (None,))
        tau_i, tau_d = arrays.check_array(tau_i, "tau_i", k.shape), arrays.check_array(tau_d, "tau_d", k.shape)
        if (tau_i <= 0.0).any():
            raise InvalidInput("tau_i", tau_i, "greater than 0")
        return cls(k, k / tau_i, k * tau_d)


@dataclass(frozen=True, eq=False, slots=True)
class PIDMemory:
    """Memory of the sampled PID law.

    The integral is stored as a torque, so it does not jump when the gain changes.

    Attributes:
        integral: (n,) integral term, N·m.
        error: (n,) error of the last step, rad.
    """

    integral: Array
    error: Array

    @classmethod
    def initial(cls, error: npt.ArrayLike) -> PIDMemory:
        """Return the memory before the first step: no integral, and no jump of the derivative term.

        Args:
            error: (n,) error at the start, rad.

        Raises:
            InvalidInput: a value is not finite.
        """
        error = arrays.check_array(error, "error", (None,))
        return cls(freeze(np.zeros_like(error)), error)


def pid(
    gains: PIDGains,
    integral: npt.ArrayLike,
    error: npt.ArrayLike,
    error_rate: npt.ArrayLike,
    tau_u: npt.ArrayLike | None = None,
    limits: Limits | None = None,
) -> tuple[JointCommand, Array]:
    """Compute the PID law in continuous time, for an integrator of differential equations.

    Source: Mattar (2013), eq. (24).

    Args:
        gains: gains of the three terms.
        integral: (n,) integral term, N·m.
        error: (n,) e = q_d − q, rad.
        error_rate: (n,) ė, rad/s.
        tau_u: (n,) feedforward torques, such as gravity's, N·m; zeros by default.
        limits: as in `pd_gravity`; they limit the whole torque.

    Returns:
        The torques, and the rate of the integral term in N·m/s: ki e, or 0 where that would push further beyond a limit.

    Raises:
        InvalidInput: a value is not finite, or lengths differ.
    """
    shape = gains.kp.shape
    e, e_rate = arrays.check_array(error, "error", shape), arrays.check_array(error_rate, "error_rate", shape)
    constant = check_feedforward(tau_u, shape) + arrays.check_array(integral, "integral", shape)
    command = limit_torques(constant + gains.kp * e + gains.kd * e_rate, limits)
    rate = gains.ki * e
    return command, freeze(np.where(command.saturated * rate > 0.0, 0.0, rate))


def pid_step(
    gains: PIDGains,
    memory: PIDMemory,
    error: npt.ArrayLike,
    dt: float,
    tau_u: npt.ArrayLike | None = None,
    limits: Limits | None = None,
) -> tuple[JointCommand, PIDMemory]:
    """Compute one step of the sampled PID law: sums for the integral, backward differences for the derivative.

        U(z) = (K_p + K_ip/(1 − z⁻¹) + K_d (1 − z⁻¹)) E(z)

    It differs from `pid` by terms of first order in dt. The integral does not wind up: it grows towards a limit only until the
    torque reaches it.

    Source: Mattar (2013), eq. (25).

    Args:
        gains: gains of the three terms.
        memory: memory of the last step; `PIDMemory.initial` before the first.
        error: (n,) e = q_d − q, rad.
        dt: time between steps, s, greater than 0.
        tau_u: (n,) feedforward torques, N·m; zeros by default.
        limits: as in `pd_gravity`; they limit the whole torque.

    Raises:
        InvalidInput: a value is not finite, lengths differ, or `dt` is not positive.
    """
    shape, dt = gains.kp.shape, arrays.check_number(dt, "dt", above=0.0)
    e = arrays.check_array(error, "error", shape)
    increment = gains.ki * e * dt  # N·m
    terms = gains.kp * e + gains.kd * (e - memory.error) / dt
    command = limit_torques(check_feedforward(tau_u, shape) + memory.integral + increment + terms, limits)
    return command, PIDMemory(accumulate_integral(memory.integral, increment, command), e)


def _errors(like: Array, measured: JointMotion, desired: JointMotion) -> tuple[Array, Array]:
    """Return q_d − q and v_d − v, of the same length as ``like``."""
    for name, motion in (("measured.q", measured), ("desired.q", desired)):
        arrays.check_array(motion.q, name, like.shape)
    return desired.q - measured.q, desired.v - measured.v
