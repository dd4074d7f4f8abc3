"""Motors between a commanded torque and the joint: winding, back-EMF, gear, H-bridge, friction.

Seen from the joint, whose rate is v, one motor with a gear obeys

    L di/dt = u − R i − k N v,    tau = N k i − B v − friction,

u what the H-bridge applies on average over its PWM period, |u| ≤ supply. The rotor's inertia is not here: the hand has it
(`Hand.rotor_inertia`). Source: 000 (26), its damping read as B + k_b k_i/R and its drive as k_i u/R; 002, section III.A.2.

000 writes two constants, k_i for the torque and k_b for the back-EMF. In SI units they are one number k: otherwise the current
would give the rotor another power than it takes from the bridge.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.hand.hand import Hand

AMPLIFIER_MODES = ("current", "voltage")

_FRICTION_FADE_RATE = 0.05  # rad/s: below it dry friction fades to zero with the rate, so that a resting joint does not chatter


@dataclass(frozen=True, eq=False, slots=True)
class MotorResponse:
    """What the motors did in one step. All (n,).

    Attributes:
        tau: torques at the joints, means over the step (so that the impulse is exact), N·m.
        current: at the end of the step: give it to the next one, A.
        voltage: that the bridges applied, V.
        saturated: +1 where the command asked the bridge for more voltage than it could or might give, −1 for less, 0 elsewhere.
        electric: power taken from the bridges, mean over the step, W; negative where the motor feeds back.
        heat: of it, what heats the winding, W.
        friction: torque lost to friction, N·m; it opposes the rate.
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

    Args:
        gear_ratio: (n,) N, turns of the motor per turn of the joint, > 0.
        torque_constant: k, N·m/A at the motor's own shaft, and V·s/rad, > 0. This and all that follow: (n,), or one number
            for all.
        resistance: R of the winding, Ω, > 0.
        supply: the largest voltage that the bridge can apply, either way, V, > 0.
        current_limit: the largest current that the driver lets through, either way, A, > 0; none by default.
        inductance: L of the winding, H, ≥ 0; by default none: the current follows the voltage at once.
        damping: B at the joint, of shaft and gear together, N·m·s/rad, ≥ 0. One at the shaft counts N² times here.
        friction: dry friction at the joint, N·m, ≥ 0; below 0.05 rad/s it fades with the rate.
        drive: "current": a fast inner loop knows the current and the rate, and applies what brings the torque, as far as the
            supply reaches. "voltage": no such loop; the command sets the voltage that would bring the torque at rest, and
            back-EMF takes away k² N²/R per rate, as in 000 (26) and 002. A light finger feels little else: a law that does
            not reckon with it follows late.

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
    drive: str

    def __init__(
        self,
        gear_ratio: Any,
        torque_constant: Any,
        resistance: Any,
        supply: Any,
        *,
        current_limit: Any = None,
        inductance: Any = 0.0,
        damping: Any = 0.0,
        friction: Any = 0.0,
        drive: str = "current",
    ) -> None:
        n = len(arrays.check_array(gear_ratio, "gear_ratio", (None,)))

        def put(name: str, value: Any, positive: bool, missing: float = np.nan) -> None:
            each = [value] * n if np.ndim(value) == 0 else value
            checked = arrays.check_array(each, name, (n,)) if np.isnan(missing) else arrays.check_limits(each, name, n, missing)
            for i in np.flatnonzero(checked <= 0.0 if positive else checked < 0.0):
                raise InvalidInput(f"{name}[{i}]", float(checked[i]), "greater than 0" if positive else "at least 0")
            object.__setattr__(self, name, checked)

        put("gear_ratio", gear_ratio, True)
        put("torque_constant", torque_constant, True)
        put("resistance", resistance, True)
        put("supply", supply, True)
        put("current_limit", current_limit, True, missing=np.inf)
        put("inductance", inductance, False)
        put("damping", damping, False)
        put("friction", friction, False)
        object.__setattr__(self, "drive", fields.check_choice(drive, "drive", AMPLIFIER_MODES))

    @classmethod
    def for_hand(
        cls,
        hand: Hand,
        *,
        supply: float = 12.0,
        gear_ratio: float = 100.0,
        electrical_time_constant: float = 0.0,
        drive: str = "current",
    ) -> MotorModel:
        """Motors that give just what a hand's description says: its largest torque up to its largest rate, and no more.

        The descriptions, and the documents behind them, give torques and rates (002: ±0.5 N·m) but no windings. Chosen here:
        at the largest rate with the largest torque the whole supply is used, half of it against the back-EMF and half for
        the resistance. How N and k share their product changes nothing at the joint. No friction.

        Args:
            hand: its ``torque_upper`` becomes the current limit, its ``velocity_limit`` the end of full torque.
            supply: V.
            gear_ratio: N of every motor.
            electrical_time_constant: L/R, s.
            drive: as for `MotorModel`.
        """
        supply = arrays.check_number(supply, "supply", above=0.0)
        ratio = arrays.check_number(gear_ratio, "gear_ratio", above=0.0)
        k = supply / 2 / (ratio * hand.velocity_limit)  # V·s/rad
        most = hand.torque_upper / (ratio * k)  # A
        R = supply / 2 / most
        L = arrays.check_number(electrical_time_constant, "electric_time", minimum=0.0) * R
        return cls(np.full(hand.n, ratio), k, R, supply, current_limit=most, inductance=L, drive=drive)

    @property
    def n(self) -> int:
        """The number of motors."""
        return len(self.gear_ratio)

    def torque_range(self, v: Any) -> tuple[Array, Array]:
        """The least and the largest torques that the motors can hold at these rates, each (n,), N·m: limits for a law.

        What the current limit and the supply leave, less friction. ``v``: (n,), rad/s.
        """
        v = arrays.check_array(v, "v", (self.n,))
        emf, lost = self._emf(v), self._friction(v)
        ends = [np.clip(sign * self.resistance * self.current_limit + emf, -self.supply, self.supply) for sign in (-1, 1)]
        lower, upper = (self._constant * (u - emf) / self.resistance - lost for u in ends)
        return freeze(lower), freeze(upper)

    def step(self, current: Any, command: Any, v: Any, dt: float) -> MotorResponse:
        """One period of the driver: voltage and rate are held, the winding's equation is solved exactly.

            i(t) = i∞ + (i₀ − i∞) e^(−t R/L),    i∞ = (u − k N v)/R

        A bridge that has to choose keeps the current within its limit at the step's end; a supply that is too weak for that,
        against a joint driven too fast from outside, comes first. Without inductance the current jumps to i∞.

        Holding the rate makes the back-EMF's damping of the voltage drive explicit: with a joint inertia M the loop is stable
        while dt (N k)²/R < 2 M.

        Args:
            current: (n,) at the beginning, A; zeros for motors that were off.
            command: (n,) torques wanted from the current (friction comes off them), N·m.
            v: (n,) joint rates, rad/s.
            dt: s, > 0.

        Raises:
            InvalidInput: another shape, a value that is not finite, or a dt that is not positive.
        """
        shape, dt = (self.n,), arrays.check_number(dt, "dt", above=0.0)
        i0, v = arrays.check_array(current, "current", shape), arrays.check_array(v, "v", shape)
        R, emf = self.resistance, self._emf(v)
        i_command = arrays.check_array(command, "command", shape) / self._constant  # A

        x = np.full(self.n, np.inf)  # dt R/L
        np.divide(dt * R, self.inductance, out=x, where=self.inductance > 0.0)
        left, fade = np.exp(-x), -np.expm1(-x)  # of i₀ at the end; and of i∞

        def voltage_for(i_end: Array) -> Array:
            """The voltage that brings the current to i_end at the step's end, V."""
            return np.asarray(R * (i_end - i0 * left) / fade + emf)

        asked = voltage_for(i_command) if self.drive == "current" else R * i_command
        u = np.clip(asked, voltage_for(-self.current_limit), voltage_for(self.current_limit))
        u = np.clip(u, -self.supply, self.supply)

        i_end = (u - emf) / R  # A, i∞
        away = i0 - i_end
        share = fade / x  # the mean of e^(−t R/L); 0 where there is no inductance
        mean = i_end + away * share
        square = i_end**2 + 2 * i_end * away * share + away**2 * -np.expm1(-2 * x) / (2 * x)  # A², mean of i²
        after = i_end + away * left

        lost = self._friction(v)
        return MotorResponse(
            tau=freeze(self._constant * mean - lost),
            current=freeze(after),
            voltage=freeze(u),
            saturated=freeze(np.sign(asked - u)),
            electric_power=freeze(u * mean),
            heat=freeze(R * square),
            friction=freeze(lost),
        )

    @property
    def _constant(self) -> Array:
        """N k: joint torque per current, N·m/A, and back-EMF per joint rate, V·s/rad."""
        return self.gear_ratio * self.torque_constant

    def _emf(self, v: Array) -> Array:
        return self._constant * v

    def _friction(self, v: Array) -> Array:
        return self.damping * v + self.friction * np.clip(v / _FRICTION_FADE_RATE, -1.0, 1.0)
