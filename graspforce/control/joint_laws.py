"""Joint-space laws: the torques that bring a hand's joints to a wanted motion, or its contact torques to wanted ones.

Pure functions in the motor coordinates of `Hand`: frozen gains, states and memory in; torques and the next memory out. Each law
knows what the motors can give and says where it asked for more:

    pd_gravity        tau = Kp (q_d − q) + Kv (v_d − v) + g(q)                       003 (19)
    computed_torque   tau = M (a_d + Kv (v_d − v) + Kp (q_d − q)) + c(q, v) + g(q)   002
    pid, pid_step     tau = tau_u + Kp e + Ki ∫ e dt + Kd ė                          000 (24), (25)
    force_step        tau = tau_u + tau_d + Kp Δ + Ki ∫ Δ dt − Kv v,  Δ = tau_d − tau_f    000 (34)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput

Limits = tuple[Any, Any]  # (n,) least and (n,) largest torque, N·m


class Dynamics(Protocol):
    """What the laws need to know of the mechanism; `Hand` has it."""

    def gravity_torque(self, q: Any, gravity_H: Any) -> Array:
        """g(q), (n,), N·m."""

    def inverse_dynamics(self, q: Any, v: Any, a: Any, gravity_H: Any) -> Array:
        """M a + c(q, v) + g(q), (n,), N·m."""


@dataclass(frozen=True, eq=False, slots=True)
class JointMotion:
    """Where n joints are, or should be, and how they move.

    Args:
        q: (n,) positions, rad.
        v: (n,) rates, rad/s; at rest by default.
        a: (n,) accelerations, rad/s²; zeros by default. No law reads a measured one.

    Raises:
        InvalidInput: not finite, or another shape.
    """

    q: Array
    v: Array
    a: Array

    def __init__(self, q: Any, v: Any = None, a: Any = None) -> None:
        q = arrays.check_array(q, "q", (None,))
        object.__setattr__(self, "q", q)
        for name, value in (("v", v), ("a", a)):
            object.__setattr__(self, name, arrays.check_array(np.zeros(len(q)) if value is None else value, name, q.shape))


@dataclass(frozen=True, eq=False, slots=True)
class JointCommand:
    """What a law gives: ``tau`` (n,), within the limits, and ``wanted`` (n,), what it would give without them, N·m."""

    tau: Array
    wanted: Array

    @property
    def saturated(self) -> Array:
        """(n,) +1 where more torque is wanted than the limits allow, −1 where less, 0 elsewhere."""
        return np.sign(self.wanted - self.tau)


# ── to a wanted motion, the mechanism known ───────────────────────────────────────────────────────────────────────────────────


@dataclass(frozen=True, eq=False, slots=True)
class PDGains:
    """Gains of a law without memory.

    Args:
        kp: (n,) > 0; N·m/rad in `pd_gravity`, 1/s² in `computed_torque`.
        kv: (n,) > 0; N·m·s/rad in `pd_gravity`, 1/s in `computed_torque`.

    Raises:
        InvalidInput: names the field and what is allowed.
    """

    kp: Array
    kv: Array

    def __post_init__(self) -> None:
        _set_gains(self, ("kp", "kv"), positive=True)


def pd_gravity(
    gains: PDGains,
    mechanism: Dynamics,
    now: JointMotion,
    wanted: JointMotion,
    gravity_H: Any,
    limits: Limits | None = None,
) -> JointCommand:
    """To a resting posture: tau = Kp (q_d − q) + Kv (v_d − v) + g(q). Source: 003 (19).

    At a fixed q_d, V = ½ vᵀ M v + ½ (q_d − q)ᵀ Kp (q_d − q) falls at V̇ = −vᵀ Kv v, so every posture leads to q_d (003's own
    (21) leaves the second term out, and does not fall). Where Kv² is much larger than 4 Kp M, the inertia hardly counts: the
    error fades as e^(−Kp/Kv t), joint by joint, whatever the hand weighs.

    Args:
        gains: N·m/rad and N·m·s/rad.
        mechanism: the hand.
        now, wanted: the motion measured and the motion to follow; the wanted acceleration plays no part.
        gravity_H: (3,) the acceleration of gravity in H, m/s².
        limits: least and largest torques, such as ``(hand.torque_lower, hand.torque_upper)``; none by default.

    Raises:
        InvalidInput: shapes that do not agree, or a value that is not finite.
    """
    error, error_rate = _errors(gains.kp, now, wanted)
    tau_g = mechanism.gravity_torque(now.q, gravity_H)
    return _command(gains.kp * error + gains.kv * error_rate + tau_g, limits)


def computed_torque(
    gains: PDGains,
    mechanism: Dynamics,
    now: JointMotion,
    wanted: JointMotion,
    gravity_H: Any,
    limits: Limits | None = None,
) -> JointCommand:
    """Along a path: the inverse dynamics of a = a_d + Kv (v_d − v) + Kp (q_d − q). Source: 002, section III.A.2.

    With the mechanism known and the limits not met, the error of every joint obeys ë + Kv ė + Kp e = 0 by itself.

    Args:
        gains: 1/s² and 1/s; kv = 2 √kp damps critically.
        mechanism, now, wanted, gravity_H, limits: as in `pd_gravity`; 002 limits the torque to ±0.5 N·m.

    Raises:
        InvalidInput: shapes that do not agree, or a value that is not finite.
    """
    error, error_rate = _errors(gains.kp, now, wanted)
    a = wanted.a + gains.kv * error_rate + gains.kp * error  # rad/s²
    return _command(mechanism.inverse_dynamics(now.q, now.v, a, gravity_H), limits)


# ── to a wanted position, the mechanism unknown ───────────────────────────────────────────────────────────────────────────────


@dataclass(frozen=True, eq=False, slots=True)
class PIDGains:
    """Gains of the three terms: kp (n,) N·m/rad, ki (n,) N·m/(rad·s), kd (n,) N·m·s/rad, all ≥ 0.

    000 (25) takes them per step of length dt: K_p = kp, K_ip = ki dt, K_d = kd/dt.
    """

    kp: Array
    ki: Array
    kd: Array

    def __post_init__(self) -> None:
        _set_gains(self, ("kp", "ki", "kd"))

    @classmethod
    def from_times(cls, k: Any, tau_i: Any, tau_d: Any) -> PIDGains:
        """As 000 (24) writes them: k (e + 1/τ_i ∫ e dt + τ_d ė).

        Args:
            k: (n,) N·m/rad.
            tau_i: (n,) integral times, s, > 0.
            tau_d: (n,) derivative times, s.
        """
        k = arrays.check_array(k, "k", (None,))
        tau_i, tau_d = arrays.check_array(tau_i, "tau_i", k.shape), arrays.check_array(tau_d, "tau_d", k.shape)
        if (tau_i <= 0.0).any():
            raise InvalidInput("tau_i", tau_i, "greater than 0")
        return cls(k, k / tau_i, k * tau_d)


@dataclass(frozen=True, eq=False, slots=True)
class PIDMemory:
    """What the sampled law keeps: ``integral`` (n,), its integral term, N·m, and ``error`` (n,), the last error, rad.

    Kept as a torque, the integral does not jump when its gain is changed.
    """

    integral: Array
    error: Array

    @classmethod
    def initial(cls, error: Any) -> PIDMemory:
        """Nothing gathered yet, and no kick from the first difference: ``error`` (n,) is where the joints begin, rad."""
        error = arrays.check_array(error, "error", (None,))
        return cls(freeze(np.zeros_like(error)), error)


def pid(
    gains: PIDGains, integral: Any, error: Any, error_rate: Any, tau_u: Any = None, limits: Limits | None = None
) -> tuple[JointCommand, Array]:
    """The law in continuous time, for an integrator of differential equations. Source: 000 (24).

    Args:
        gains: of the three terms.
        integral: (n,) the integral term so far, N·m.
        error: (n,) e = q_d − q, rad.
        error_rate: (n,) ė, rad/s.
        tau_u: (n,) torques known beforehand, such as gravity's, N·m; zeros by default.
        limits: as in `pd_gravity`; they hold for the whole torque.

    Returns:
        The torques, and the rate of the integral term, N·m/s: ki e, or 0 where that would push further beyond a limit.

    Raises:
        InvalidInput: shapes that do not agree, or a value that is not finite.
    """
    shape = gains.kp.shape
    e, e_rate = arrays.check_array(error, "error", shape), arrays.check_array(error_rate, "error_rate", shape)
    known = _feedforward(tau_u, shape) + arrays.check_array(integral, "integral", shape)
    command = _command(known + gains.kp * e + gains.kd * e_rate, limits)
    rate = gains.ki * e
    return command, freeze(np.where(command.saturated * rate > 0.0, 0.0, rate))


def pid_step(
    gains: PIDGains, memory: PIDMemory, error: Any, dt: float, tau_u: Any = None, limits: Limits | None = None
) -> tuple[JointCommand, PIDMemory]:
    """The law once every dt: sums for the integral, backward differences for the derivative. Source: 000 (25).

    U(z) = (K_p + K_ip/(1 − z⁻¹) + K_d (1 − z⁻¹)) E(z); it differs from `pid` by terms of first order in dt. The integral grows
    towards a limit only until the torque meets it (no wind-up): a torque leaves its limit as soon as the other terms let it.

    Args:
        gains: of the three terms.
        memory: what the last step returned; `PIDMemory.initial` before the first.
        error: (n,) e = q_d − q, rad.
        dt: the time between steps, s, > 0.
        tau_u, limits: as in `pid`.

    Raises:
        InvalidInput: shapes that do not agree, a value that is not finite, or a dt that is not positive.
    """
    shape, dt = gains.kp.shape, arrays.check_number(dt, "dt", above=0.0)
    e = arrays.check_array(error, "error", shape)
    gain = gains.ki * e * dt  # N·m, of the integral in this step
    terms = gains.kp * e + gains.kd * (e - memory.error) / dt
    command = _command(_feedforward(tau_u, shape) + memory.integral + gain + terms, limits)
    return command, PIDMemory(_accumulate_integral(memory.integral, gain, command), e)


# ── to a wanted contact torque ────────────────────────────────────────────────────────────────────────────────────────────────


@dataclass(frozen=True, eq=False, slots=True)
class ForceGains:
    """Gains of the force loop: kp (n,) a pure number, ki (n,) 1/s, kv (n,) N·m·s/rad, all ≥ 0."""

    kp: Array
    ki: Array
    kv: Array

    def __post_init__(self) -> None:
        _set_gains(self, ("kp", "ki", "kv"))


def force_step(
    gains: ForceGains,
    integral: Any,
    wanted: Any,
    tau_measured: Any,
    v: Any,
    dt: float,
    tau_u: Any = None,
    limits: Limits | None = None,
) -> tuple[JointCommand, Array]:
    """Fingertip forces by torque sensors in the joints: tau = tau_u + tau_d + Kp Δ + Ki ∫ Δ dt − Kv v, Δ = tau_d − tau_f.

    Contact forces f load the joints with Jᵀ f, so that wanted forces come as tau_d = Jᵀ f_d. Against a spring of stiffness δ at
    the joint, 000 (33)–(35) leave the load out of the actuator's balance; with tau_d fed forward the load may be in it, and the
    same response follows, k_ps being 1 + Kp:

        tau_f / tau_d = δ (1 + Kp) / (J s² + (B + Kv) s + δ (1 + Kp))

    It ends at 1, where (37) as printed ends at 1/k_i. A torque that the model does not know leaves 1/(1 + Kp) of itself as the
    error; the integral takes that away. Source: 000 (31)–(38).

    Args:
        gains: of the loop.
        integral: (n,) what the last step returned, N·m; zeros before the first.
        wanted: (n,) tau_d = Jᵀ f_d, N·m.
        sensed: (n,) tau_f = Jᵀ f, N·m.
        v: (n,) joint rates, rad/s.
        dt: the time between steps, s, > 0.
        tau_u: (n,) what the hand needs without contact, N·m; zeros by default.
        limits: as in `pd_gravity`.

    Returns:
        The torques, and the integral for the next step, N·m; it does not wind up, as in `pid_step`.

    Raises:
        InvalidInput: shapes that do not agree, a value that is not finite, or a dt that is not positive.
    """
    shape, dt = gains.kp.shape, arrays.check_number(dt, "dt", above=0.0)
    wanted, before = arrays.check_array(wanted, "wanted", shape), arrays.check_array(integral, "integral", shape)
    delta = wanted - arrays.check_array(tau_measured, "sensed", shape)
    gain = gains.ki * delta * dt  # N·m
    terms = wanted + gains.kp * delta - gains.kv * arrays.check_array(v, "v", shape)
    command = _command(_feedforward(tau_u, shape) + before + gain + terms, limits)
    return command, _accumulate_integral(before, gain, command)


# ── inside ────────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def _set_gains(gains: PDGains | PIDGains | ForceGains, names: tuple[str, ...], positive: bool = False) -> None:
    shape: tuple[int | None, ...] = (None,)
    for name in names:
        value = arrays.check_array(getattr(gains, name), name, shape)
        for i in np.flatnonzero(value <= 0.0 if positive else value < 0.0):
            raise InvalidInput(f"{name}[{i}]", float(value[i]), "greater than 0" if positive else "at least 0")
        object.__setattr__(gains, name, value)
        shape = value.shape


def _errors(like: Array, now: JointMotion, wanted: JointMotion) -> tuple[Array, Array]:
    """q_d − q and v_d − v, for as many joints as there are gains."""
    for name, motion in (("now.q", now), ("wanted.q", wanted)):
        arrays.check_array(motion.q, name, like.shape)
    return wanted.q - now.q, wanted.v - now.v


def _feedforward(tau_u: Any, shape: tuple[int, ...]) -> Array:
    return np.zeros(shape) if tau_u is None else arrays.check_array(tau_u, "tau_u", shape)


def _command(wanted: Array, limits: Limits | None) -> JointCommand:
    if limits is None:
        return JointCommand(freeze(wanted), freeze(wanted))
    lower = arrays.check_limits(limits[0], "limits[0]", len(wanted), -np.inf)
    upper = arrays.check_limits(limits[1], "limits[1]", len(wanted), np.inf)
    for i in np.flatnonzero(lower > upper):
        raise InvalidInput(f"limits[0][{i}]", float(lower[i]), f"at most limits[1][{i}], which is {upper[i]:g}")
    return JointCommand(freeze(np.clip(wanted, lower, upper)), freeze(wanted))


def _accumulate_integral(integral: Array, gain: Array, command: JointCommand) -> Array:
    """The integral after a step: of its gain, the part that pushes the torque beyond a limit is left out."""
    excess = command.wanted - command.tau
    beyond = np.where(excess * gain > 0.0, np.sign(gain) * np.minimum(np.abs(excess), np.abs(gain)), 0.0)
    return freeze(integral + gain - beyond)
