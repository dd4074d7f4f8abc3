"""Joint-space control laws: torques for a desired joint motion or for desired contact torques.

The laws are pure functions in the motor coordinates of `Hand`. They take frozen gains, measurements and memory, and return
torques and the next memory. Each law respects the torque limits and reports the torque without them.

- `pd_gravity`: tau = Kp (q_d − q) + Kv (v_d − v) + g(q)
- `computed_torque`: tau = M (a_d + Kv (v_d − v) + Kp (q_d − q)) + c(q, v) + g(q)
- `pid`, `pid_step`: tau = tau_u + Kp e + Ki ∫ e dt + Kd ė
- `force_step`: tau = tau_u + tau_d + Kp Δ + Ki ∫ Δ dt − Kv v, with Δ = tau_d − tau_f
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.records import set_fields

Limits = tuple[npt.ArrayLike, npt.ArrayLike]  # (n,) lower and (n,) upper torque limits, N·m


class Dynamics(Protocol):
    """Dynamics of a mechanism, as `Hand` computes them."""

    def gravity_torque(self, q: npt.ArrayLike, gravity_H: npt.ArrayLike) -> Array:
        """Return g(q), (n,), N·m."""

    def inverse_dynamics(self, q: npt.ArrayLike, v: npt.ArrayLike, a: npt.ArrayLike, gravity_H: npt.ArrayLike) -> Array:
        """Return M a + c(q, v) + g(q), (n,), N·m."""


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
        _set_gains(self, ("kp", "kv"), positive=True)


def pd_gravity(
    gains: PDGains,
    mechanism: Dynamics,
    measured: JointMotion,
    desired: JointMotion,
    gravity_H: npt.ArrayLike,
    limits: Limits | None = None,
) -> JointCommand:
    """Compute the torques that bring the joints to a posture: tau = Kp (q_d − q) + Kv (v_d − v) + g(q).

    For constant q_d the function V = ½ vᵀ M v + ½ (q_d − q)ᵀ Kp (q_d − q) decreases with V̇ = −vᵀ Kv v, so every posture converges
    to q_d. Where Kv² is much larger than 4 Kp M, inertia is negligible: the error of each joint decays as e^(−Kp/Kv t).

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
    return _command(gains.kp * error + gains.kv * error_rate + tau_g, limits)


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
    return _command(mechanism.inverse_dynamics(measured.q, measured.v, a, gravity_H), limits)


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
        _set_gains(self, ("kp", "ki", "kd"))

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
    constant = _feedforward(tau_u, shape) + arrays.check_array(integral, "integral", shape)
    command = _command(constant + gains.kp * e + gains.kd * e_rate, limits)
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
    command = _command(_feedforward(tau_u, shape) + memory.integral + increment + terms, limits)
    return command, PIDMemory(_accumulate_integral(memory.integral, increment, command), e)


# ── law for a desired contact torque ──────────────────────────────────────────────────────────────────────────────────────────


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
        _set_gains(self, ("kp", "ki", "kv"))


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
        limits: as in `pd_gravity`.

    Returns:
        The torques, and the integral for the next step in N·m. It does not wind up, as in `pid_step`.

    Raises:
        InvalidInput: a value is not finite, lengths differ, or `dt` is not positive.
    """
    shape, dt = gains.kp.shape, arrays.check_number(dt, "dt", above=0.0)
    tau_d, last = arrays.check_array(tau_desired, "tau_desired", shape), arrays.check_array(integral, "integral", shape)
    delta = tau_d - arrays.check_array(measured.tau, "measured.tau", shape)
    increment = gains.ki * delta * dt  # N·m
    terms = tau_d + gains.kp * delta - gains.kv * arrays.check_array(measured.v, "measured.v", shape)
    command = _command(_feedforward(tau_u, shape) + last + increment + terms, limits)
    return command, _accumulate_integral(last, increment, command)


# ── helpers ───────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def _set_gains(gains: PDGains | PIDGains | ForceGains, names: tuple[str, ...], positive: bool = False) -> None:
    """Check gains of equal lengths and store them as read-only arrays."""
    shape: tuple[int | None, ...] = (None,)
    for name in names:
        value = arrays.check_array(getattr(gains, name), name, shape)
        for i in np.flatnonzero(value <= 0.0 if positive else value < 0.0):
            raise InvalidInput(f"{name}[{i}]", float(value[i]), "greater than 0" if positive else "at least 0")
        set_fields(gains, **{name: value})
        shape = value.shape


def _errors(like: Array, measured: JointMotion, desired: JointMotion) -> tuple[Array, Array]:
    """Return q_d − q and v_d − v, of the same length as ``like``."""
    for name, motion in (("measured.q", measured), ("desired.q", desired)):
        arrays.check_array(motion.q, name, like.shape)
    return desired.q - measured.q, desired.v - measured.v


def _feedforward(tau_u: npt.ArrayLike | None, shape: tuple[int, ...]) -> Array:
    """Return the feedforward torques, zeros for None."""
    return np.zeros(shape) if tau_u is None else arrays.check_array(tau_u, "tau_u", shape)


def _command(tau: Array, limits: Limits | None) -> JointCommand:
    """Return the command for torques without limits."""
    if limits is None:
        return JointCommand(freeze(tau), freeze(tau))
    lower = arrays.check_limits(limits[0], "limits[0]", len(tau), -np.inf)
    upper = arrays.check_limits(limits[1], "limits[1]", len(tau), np.inf)
    for i in np.flatnonzero(lower > upper):
        raise InvalidInput(f"limits[0][{i}]", float(lower[i]), f"at most limits[1][{i}], which is {upper[i]:g}")
    return JointCommand(freeze(np.clip(tau, lower, upper)), freeze(tau))


def _accumulate_integral(integral: Array, increment: Array, command: JointCommand) -> Array:
    """Return the integral with the increment, less the part that pushes the torque beyond a limit."""
    excess = command.tau_unlimited - command.tau
    beyond = np.where(excess * increment > 0.0, np.sign(increment) * np.minimum(np.abs(excess), np.abs(increment)), 0.0)
    return freeze(integral + increment - beyond)
