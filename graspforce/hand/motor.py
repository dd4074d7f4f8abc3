"""Electric motors with gears: winding, back-EMF, bridge, current limit and friction.

At the joint, with rate v, a motor behind a gear of ratio N obeys

    L di/dt = u − R i − k N v,    tau = N k i − B v − friction,

where u is the mean voltage of the bridge over a PWM period, |u| ≤ supply. The rotor inertia belongs to the hand
(`Hand.rotor_inertia`).

Source: Mattar (2013), equation (26), with damping B + k_b k_i/R and drive k_i u/R; DLR-HIT II dual-platform study, section
III.A.2. Mattar has one constant for the torque, k_i, and one for the back-EMF, k_b. In SI units both are the same number k,
because electrical and mechanical power of the ideal rotor are equal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.records import set_fields
from graspforce.hand.hand import Hand

AmplifierMode = Literal["current", "voltage"]
AMPLIFIER_MODES: tuple[AmplifierMode, ...] = ("current", "voltage")

_FRICTION_FADE_RATE = 0.05  # rad/s: below it friction is proportional to the rate, so that a resting joint does not chatter


@dataclass(frozen=True, eq=False, slots=True)
class MotorResponse:
    """The response of n motors over one period.

    Attributes:
        tau: (n,) mean joint torques over the period, N·m; the impulse is exact.
        current: (n,) currents at the end of the period, A: the input of the next period.
        voltage: (n,) bridge voltages, V.
        saturated: (n,) +1 if the command needs a higher voltage than the bridge applied, −1 for a lower one, 0 otherwise.
        electric_power: (n,) mean power from the bridges, W; negative during regeneration.
        heat: (n,) mean power that heats the winding, W.
        friction: (n,) friction torques, N·m, in the direction of the rates; they reduce tau.
    """

    tau: Array
    current: Array
    voltage: Array
    saturated: Array
    electric_power: Array
    heat: Array
    friction: Array


@dataclass(frozen=True, eq=False, slots=True)
class MotorModel:
    """The n motors of a hand, in the order of its actuated joints.

    Every argument but `gear_ratio` and `amplifier` is one number for all motors, or (n,).

    Args:
        gear_ratio: (n,) N, turns of the motor per turn of the joint, > 0.
        torque_constant: k at the motor shaft, N·m/A and V·s/rad, > 0.
        resistance: R of the winding, Ω, > 0.
        supply: largest bridge voltage in both directions, V, > 0.
        current_limit: largest current in both directions, A, > 0; None for no limit.
        inductance: L of the winding, H, ≥ 0. With 0 the current follows the voltage at once.
        damping: B at the joint, N·m·s/rad, ≥ 0. Damping at the motor shaft counts N² times here.
        friction: Coulomb friction at the joint, N·m, ≥ 0; proportional to the rate below 0.05 rad/s.
        amplifier: "current": an inner loop measures the current and applies the voltage for the commanded torque, up to the
            supply. "voltage": no inner loop; the voltage gives the commanded torque at rest, and the back-EMF reduces it by
            k² N²/R per rate. A controller that ignores this damping lags.

    Raises:
        InvalidInput: names the field and what is allowed.
    """

    gear_ratio: Array
    torque_constant: Array
    resistance: Array
    supply: Array
    current_limit: Array
    inductance: Array
    damping: Array
    friction: Array
    amplifier: AmplifierMode

    def __init__(
        self,
        gear_ratio: npt.ArrayLike,
        torque_constant: npt.ArrayLike,
        resistance: npt.ArrayLike,
        supply: npt.ArrayLike,
        *,
        current_limit: npt.ArrayLike | None = None,
        inductance: npt.ArrayLike = 0.0,
        damping: npt.ArrayLike = 0.0,
        friction: npt.ArrayLike = 0.0,
        amplifier: AmplifierMode = "current",
    ) -> None:
        n = len(arrays.check_array(gear_ratio, "gear_ratio", (None,)))
        positive = {"gear_ratio": gear_ratio, "torque_constant": torque_constant, "resistance": resistance, "supply": supply}
        not_negative = {"inductance": inductance, "damping": damping, "friction": friction}
        checked = {name: arrays.check_array(_per_motor(value, n), name, (n,)) for name, value in positive.items()}
        checked["current_limit"] = arrays.check_limits(_per_motor(current_limit, n), "current_limit", n, np.inf)
        for name, values in checked.items():
            _check_sign(name, values, values <= 0.0, "greater than 0")
        for name, value in not_negative.items():
            checked[name] = arrays.check_array(_per_motor(value, n), name, (n,))
            _check_sign(name, checked[name], checked[name] < 0.0, "at least 0")
        set_fields(self, **checked, amplifier=fields.check_choice(amplifier, "amplifier", AMPLIFIER_MODES))

    @classmethod
    def for_hand(
        cls,
        hand: Hand,
        *,
        supply: float = 12.0,
        gear_ratio: float = 100.0,
        electrical_time_constant: float = 0.0,
        amplifier: AmplifierMode = "current",
    ) -> MotorModel:
        """Return motors that reach exactly the torque and rate limits of a hand.

        Hand descriptions give torques and rates but no windings. Here, at the largest rate and torque, the motor needs the
        whole supply: half of it against the back-EMF and half for the resistance. The joint depends only on the product of
        gear ratio and torque constant. There is no friction.

        Args:
            hand: its `torque_upper` sets the current limit, and its `velocity_limit` the end of full torque.
            supply: V, > 0.
            gear_ratio: N of every motor, > 0.
            electrical_time_constant: L/R, s, ≥ 0.
            amplifier: as in `MotorModel`.

        Raises:
            InvalidInput: names the argument and what is allowed.
        """
        supply = arrays.check_number(supply, "supply", above=0.0)
        ratio = arrays.check_number(gear_ratio, "gear_ratio", above=0.0)
        k = supply / 2 / (ratio * hand.velocity_limit)  # V·s/rad
        largest = hand.torque_upper / (ratio * k)  # A
        R = supply / 2 / largest  # Ω
        L = arrays.check_number(electrical_time_constant, "electrical_time_constant", minimum=0.0) * R  # H
        return cls(np.full(hand.n, ratio), k, R, supply, current_limit=largest, inductance=L, amplifier=amplifier)

    @property
    def n(self) -> int:
        """Number of motors."""
        return len(self.gear_ratio)

    def torque_range(self, v: npt.ArrayLike) -> tuple[Array, Array]:
        """Return the least and largest torques that the motors can sustain at joint rates: limits for a controller.

        They follow from the current limit and the supply, less friction.

        Args:
            v: (n,) joint rates, rad/s.

        Returns:
            Two arrays (n,), N·m.

        Raises:
            InvalidInput: not n finite numbers.
        """
        v = arrays.check_array(v, "v", (self.n,))
        emf, friction = self._emf(v), self._friction(v)
        ends = [np.clip(sign * self.resistance * self.current_limit + emf, -self.supply, self.supply) for sign in (-1, 1)]
        lower, upper = (self._constant * (u - emf) / self.resistance - friction for u in ends)
        return freeze(lower), freeze(upper)

    def step(self, current: npt.ArrayLike, command: npt.ArrayLike, v: npt.ArrayLike, dt: float) -> MotorResponse:
        """Return the response over one period, with constant voltage and rate, by the exact solution of the winding.

            i(t) = i∞ + (i₀ − i∞) e^(−t R/L),    i∞ = (u − k N v)/R

        The bridge keeps the current within its limit at the end of the period. The supply limit has priority: it can be too
        low for that if the joint is driven from outside. Without inductance the current is i∞ at once.

        A constant rate makes the damping of the voltage amplifier's back-EMF explicit. With joint inertia M, the loop is
        stable for dt (N k)²/R < 2 M.

        Args:
            current: (n,) currents at the start, A; zeros after power-on.
            command: (n,) commanded torques of the currents, N·m; friction reduces them.
            v: (n,) joint rates, rad/s.
            dt: period, s, > 0.

        Raises:
            InvalidInput: another shape, a value that is not finite, or dt ≤ 0.
        """
        shape, dt = (self.n,), arrays.check_number(dt, "dt", above=0.0)
        i0, v = arrays.check_array(current, "current", shape), arrays.check_array(v, "v", shape)
        R, emf = self.resistance, self._emf(v)
        i_command = arrays.check_array(command, "command", shape) / self._constant  # A

        x = np.full(self.n, np.inf)  # dt R/L
        np.divide(dt * R, self.inductance, out=x, where=self.inductance > 0.0)
        decay, rise = np.exp(-x), -np.expm1(-x)  # share of i₀ at the end, and of i∞

        def voltage_for(i_end: Array) -> Array:
            """Return the voltage that brings the current to i_end at the end of the period, V."""
            return np.asarray(R * (i_end - i0 * decay) / rise + emf)

        u_command = voltage_for(i_command) if self.amplifier == "current" else R * i_command
        u = np.clip(u_command, voltage_for(-self.current_limit), voltage_for(self.current_limit))
        u = np.clip(u, -self.supply, self.supply)

        i_steady = (u - emf) / R  # A, i∞
        transient = i0 - i_steady  # A
        share = rise / x  # mean of e^(−t R/L); 0 without inductance
        mean = i_steady + transient * share  # A
        square = i_steady**2 + 2 * i_steady * transient * share + transient**2 * -np.expm1(-2 * x) / (2 * x)  # A², mean of i²

        friction = self._friction(v)
        return MotorResponse(
            tau=freeze(self._constant * mean - friction),
            current=freeze(i_steady + transient * decay),
            voltage=freeze(u),
            saturated=freeze(np.sign(u_command - u)),
            electric_power=freeze(u * mean),
            heat=freeze(R * square),
            friction=freeze(friction),
        )

    @property
    def _constant(self) -> Array:
        """N k: joint torque per current, N·m/A, and back-EMF per joint rate, V·s/rad."""
        return self.gear_ratio * self.torque_constant

    def _emf(self, v: Array) -> Array:
        return self._constant * v

    def _friction(self, v: Array) -> Array:
        return self.damping * v + self.friction * np.clip(v / _FRICTION_FADE_RATE, -1.0, 1.0)


def _per_motor(value: npt.ArrayLike | None, n: int) -> object:
    """Return a list with one number for each of n motors; other values unchanged."""
    return [value] * n if np.ndim(value) == 0 else value  # type: ignore[arg-type]  # None has no dimensions


def _check_sign(name: str, values: Array, is_wrong: npt.NDArray[np.bool_], allowed: str) -> None:
    for i in np.flatnonzero(is_wrong):
        raise InvalidInput(f"{name}[{i}]", float(values[i]), allowed)
