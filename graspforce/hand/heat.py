"""Heat of a hand's motors: temperatures from currents, torque limits that fall with them, and how long a load can be held.

Each motor has a winding and a housing, in heat exchange with each other and with the ambient air (index a):

    C_w dT_w/dt = R(T_w) i² − (T_w − T_h)/R_wh,        R(T) = R_25 (1 + α (T − 25 °C)),
    C_h dT_h/dt = (T_w − T_h)/R_wh − (T_h − T_a)/R_ha,

with C_w = τ_w/R_wh and C_h = τ_h/R_ha for the time constants that manufacturers state. The copper of the winding has
α = 0.00393 1/K.

Source: Mellor, Roberts and Turner (1991), reduced to the two bodies of data sheets.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm
from scipy.optimize import brentq

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.hand.drives.drive import WINDING_REFERENCE, Drives
from graspforce.hand.hand import Hand

COPPER = 0.00393  # 1/K, temperature coefficient of the resistance of copper
AMBIENT = 25.0  # °C
_REPORT_STEP = 0.1  # s, of the temperatures in a report
_LONGEST_TIME = 1e7  # s; loads that reach the limit later are held forever


@dataclass(frozen=True, eq=False, slots=True)
class MotorTemperatures:
    """Temperatures of n motors.

    Attributes:
        winding: (n,) °C.
        housing: (n,) °C.
    """

    winding: Array
    housing: Array


class HeatReport(NamedTuple):
    """Heat of a hand's motors after a time, and how long they can go on.

    Attributes:
        temperatures: of the motors at the end.
        hold_times: (n,) time for which each motor can bear its recent torques, s; infinite if forever.
        finger: finger whose motors reach their limits first; None if none does.
    """

    temperatures: MotorTemperatures
    hold_times: Array
    finger: str | None


class ThermalModel:
    """Thermal model of the motors of a hand.

    Args:
        drives: drives with torque constant, resistance and thermal data.
        ambient: temperature of the air, °C.

    Attributes:
        largest: (n,) largest permissible temperatures of the windings, °C.

    Raises:
        InvalidInput: a drive lacks the torque constant, the resistance or the thermal data.
    """

    def __init__(self, drives: Drives, ambient: float = AMBIENT) -> None:
        self._ambient = arrays.check_number(ambient, "ambient")
        for i, drive in enumerate(drives.joints):
            for name in ("torque_constant", "resistance", "thermal"):
                if getattr(drive, name) is None:
                    raise InvalidInput(f"drives[{i}].{name}", None, "given: the thermal model needs it")
        thermal = [drive.thermal for drive in drives.joints if drive.thermal is not None]
        self._R_wh = np.array([each.winding_resistance for each in thermal])  # K/W
        self._R_ha = np.array([each.housing_resistance for each in thermal])  # K/W
        self._C_w = np.array([each.winding_time_constant for each in thermal]) / self._R_wh  # J/K
        self._C_h = np.array([each.housing_time_constant for each in thermal]) / self._R_ha  # J/K
        self.largest = freeze([each.largest_temperature for each in thermal])
        self._k, self._R25 = drives.values("torque_constant"), drives.values("resistance")
        self._current_per_torque = 1.0 / (drives.gear_gain * self._k)  # A/(N·m), of a joint at rest
        self._last: tuple[float, Array] | None = None  # period and transition matrices of the last step

    @classmethod
    def for_hand(cls, hand: Hand, ambient: float = AMBIENT) -> ThermalModel:
        """Return the model of a hand's motors.

        Args:
            hand: the hand.
            ambient: temperature of the air, °C.

        Raises:
            InvalidInput: as in `ThermalModel`.
        """
        return cls(hand.drives, ambient)

    def with_reserve(self, reserve: float) -> ThermalModel:
        """Return the model with smaller permissible temperatures.

        Args:
            reserve: part of the temperature range over the air that is kept free, in [0, 1).

        Raises:
            InvalidInput: not in [0, 1).
        """
        if not 0.0 <= arrays.check_number(reserve, "reserve") < 1.0:
            raise InvalidInput("reserve", reserve, "at least 0 and less than 1")
        model = copy.copy(self)
        model.largest = freeze(self.largest - reserve * (self.largest - self._ambient))
        return model

    def at_rest(self) -> MotorTemperatures:
        """Return the temperatures of motors that have not been used: that of the air."""
        ambient = freeze(np.full(len(self._k), self._ambient))
        return MotorTemperatures(ambient, ambient)

    def currents(self, tau: npt.ArrayLike) -> Array:
        """Return the currents that hold joint torques at rest, (n,), A.

        Args:
            tau: (n,) joint torques, N·m.
        """
        return np.asarray(self._current_per_torque * arrays.check_array(tau, "tau", self._k.shape))

    def heat(self, current: npt.ArrayLike, winding: npt.ArrayLike) -> Array:
        """Return the heat R(T) i² of the windings, (n,), W.

        Args:
            current: (n,) motor currents, A.
            winding: (n,) temperatures of the windings, °C.
        """
        current, winding = (arrays.check_array(value, "current", self._k.shape) for value in (current, winding))
        return np.asarray(self._R25 * (1.0 + COPPER * (winding - WINDING_REFERENCE)) * current * current)

    def step(self, temperatures: MotorTemperatures, current: npt.ArrayLike, dt: float) -> MotorTemperatures:
        """Return the temperatures after a period of constant currents, with the heat of its begin.

        The two linear equations are integrated exactly.

        Args:
            temperatures: at the begin of the period.
            current: (n,) motor currents, A; root mean squares if they change within the period.
            dt: length of the period, s. Keep it below a tenth of the windings' time constants.

        Raises:
            InvalidInput: currents of another number, or dt ≤ 0.
        """
        dt = arrays.check_number(dt, "dt", above=0.0)
        if self._last is None or self._last[0] != dt:
            self._last = dt, self._transition(dt)
        heat = self.heat(current, temperatures.winding)  # W
        x = np.stack([temperatures.winding - self._ambient, temperatures.housing - self._ambient, heat], axis=1)
        x = np.einsum("nij,nj->ni", self._last[1], x)
        return MotorTemperatures(freeze(self._ambient + x[:, 0]), freeze(self._ambient + x[:, 1]))

    def torque_limits(self, temperatures: MotorTemperatures) -> Array:
        """Return the largest torques that never overheat a winding while the housing keeps its temperature, (n,), N·m.

        With the heat P ≤ (T_max − T_h)/R_wh the winding approaches a temperature below T_max. The limit falls as the housing
        warms up, down to the torque that can be held forever.

        Args:
            temperatures: of the motors.
        """
        room = np.maximum(self.largest - temperatures.housing, 0.0)  # K
        resistance = self._R25 * (1.0 + COPPER * (self.largest - WINDING_REFERENCE))  # Ω at the largest temperature
        return np.asarray(np.sqrt(room / (self._R_wh * resistance)) / self._current_per_torque)

    def continuous_torques(self) -> Array:
        """Return the torques that can be held forever, (n,), N·m."""
        resistance = self._R25 * (1.0 + COPPER * (self.largest - WINDING_REFERENCE))  # Ω
        room = np.maximum(self.largest - self._ambient, 0.0)  # K
        return np.asarray(np.sqrt(room / ((self._R_wh + self._R_ha) * resistance)) / self._current_per_torque)

    def hold_times(self, temperatures: MotorTemperatures, tau: npt.ArrayLike) -> Array:
        """Return the times until the windings reach their largest temperatures under constant torques, (n,), s.

        The time is infinite for torques that can be held forever, and zero for windings that are too hot.

        Args:
            temperatures: of the motors now.
            tau: (n,) joint torques, N·m.
        """
        current = self.currents(tau)
        return np.array([self._hold_time(i, temperatures, float(current[i])) for i in range(len(current))])

    def torque_weight(self, temperatures: MotorTemperatures) -> Array:
        """Return a diagonal of W that moves load from hot motors to cool ones, (n,), W/(N·m)².

        It is the copper loss per squared torque, divided by the squared part of the temperature range that is left,
        ((T_max − T_w)/(T_max − T_a))². A cold hand has the weight of the copper loss.

        Args:
            temperatures: of the motors.
        """
        left = (self.largest - temperatures.winding) / (self.largest - self._ambient)
        resistance = self._R25 * (1.0 + COPPER * (temperatures.winding - WINDING_REFERENCE))  # Ω
        return np.asarray(resistance * self._current_per_torque**2 / np.square(np.maximum(left, 0.05)))

    def _transition(self, dt: float) -> Array:
        """Return (n, 2, 3) the map from temperatures over the air and heat to the temperatures after dt."""
        winding_rate, housing_rate = 1.0 / (self._R_wh * self._C_w), 1.0 / (self._R_wh * self._C_h)  # 1/s
        rates = np.zeros((len(self._k), 3, 3))  # of (T_w − T_a, T_h − T_a, heat)
        rates[:, 0, 0], rates[:, 0, 1], rates[:, 0, 2] = -winding_rate, winding_rate, 1.0 / self._C_w
        rates[:, 1, 0], rates[:, 1, 1] = housing_rate, -housing_rate - 1.0 / (self._R_ha * self._C_h)
        return np.asarray(expm(dt * rates))[:, :2]

    def _hold_time(self, i: int, temperatures: MotorTemperatures, current: float) -> float:
        """Return the time until winding i reaches its largest temperature under a constant current, s."""
        largest, ambient = float(self.largest[i]), self._ambient
        if temperatures.winding[i] >= largest:
            return 0.0
        P25 = float(self._R25[i]) * current * current  # W at 25 °C
        C_w, C_h, R_wh, R_ha = (float(each[i]) for each in (self._C_w, self._C_h, self._R_wh, self._R_ha))
        heat = P25 * (1.0 + COPPER * (ambient - WINDING_REFERENCE))  # W at the temperature of the air
        rates = np.zeros((3, 3))  # of (T_w − T_a, T_h − T_a, 1); the heat is linear in T_w
        rates[0] = [(P25 * COPPER - 1.0 / R_wh) / C_w, 1.0 / (R_wh * C_w), heat / C_w]
        rates[1] = [1.0 / (R_wh * C_h), -(1.0 / R_wh + 1.0 / R_ha) / C_h, 0.0]
        start = np.array([temperatures.winding[i] - ambient, temperatures.housing[i] - ambient, 1.0])

        def excess(t: float) -> float:
            return float((expm(t * rates) @ start)[0]) + ambient - largest

        end = R_wh * C_w
        while excess(end) < 0.0:
            end *= 2.0
            if end > _LONGEST_TIME:
                return math.inf
        return float(brentq(excess, 0.0, end, xtol=1e-6))


def hottest_finger(hand: Hand, hold_times: Array, fingers: Sequence[str]) -> str | None:
    """Return the finger whose motors overheat first; None if all can hold their loads forever.

    Args:
        hand: the hand.
        hold_times: (n,) as `ThermalModel.hold_times` returns them, s.
        fingers: names of the fingers to compare.
    """
    by_finger = {name: float(hold_times[list(hand.finger(name).joints)].min()) for name in fingers}
    finger = min(by_finger, key=by_finger.__getitem__)
    return finger if np.isfinite(by_finger[finger]) else None


def report_heat(
    hand: Hand, t: npt.ArrayLike, tau: npt.ArrayLike, fingers: Sequence[str], ambient: float = AMBIENT
) -> HeatReport | None:
    """Return the heat of a hand's motors after given torques; None if a drive lacks thermal data.

    The motors begin at the temperature of the air. The hold times are those of the torques of the last second, in root mean
    squares, at the temperatures of the end.

    Args:
        hand: the hand.
        t: (k,) begin of each step, s, with equal steps.
        tau: (k, n) joint torques, N·m.
        fingers: names of the fingers in contact.
        ambient: temperature of the air, °C.

    Raises:
        InvalidInput: no step, or another number of torques.
    """
    if not hand.drives.has_thermal_data:
        return None
    t = arrays.check_array(t, "t", (None,))
    if len(t) == 0:
        raise InvalidInput("t", [], "at least one step")
    tau = arrays.check_array(tau, "tau", (len(t), hand.n))
    dt = float(t[1] - t[0]) if len(t) > 1 else _REPORT_STEP
    count = max(round(_REPORT_STEP / dt), 1)
    model = ThermalModel(hand.drives, ambient)
    temperatures = model.at_rest()
    for start in range(0, len(t), count):
        part = tau[start : start + count]
        temperatures = model.step(temperatures, model.currents(_root_mean_square(part)), len(part) * dt)
    times = freeze(model.hold_times(temperatures, _root_mean_square(tau[-max(round(1.0 / dt), 1) :])))
    return HeatReport(temperatures, times, hottest_finger(hand, times, fingers))


def _root_mean_square(values: Array) -> Array:
    """Return the root mean square of each column."""
    return np.asarray(np.sqrt(np.mean(np.square(values), axis=0)))
