"""Gains from the sensors: stability margins and noise of the sampled loop with the joint filter.

Computed torque makes each direction of motion a double integrator, q̈ = a. The loop is

    encoder, late by m periods → joint filter → a = −(k_d v̂ + k_p q̂ + k_i Σ q̂ T) → hold of one period → q̈ = a,

with the Kalman filter of `graspforce.estimation.joints.joint_filter`, which predicts over the latency. Margins belong to the
loop that is opened at the acceleration command. Other dynamics, such as soft contacts and current loops, must fit into them.

Source: Åström and Wittenmark (1997), chapters 3 and 4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.records import set_fields
from graspforce.estimation.joints.joint_filter import JointFilter, JointFilterMemory
from graspforce.estimation.sensor_model import SensorModel
from graspforce.estimation.settings import EstimatorSettings

_SLOWEST, _RATE_RATIO = 1.0, 1.02  # rad/s, and ratio of the rates that the search distinguishes
_LOWEST_FREQUENCY, _FREQUENCIES = 0.02, 600  # rad/s, and number of frequencies up to the Nyquist frequency
_CONVERGED = 10**9  # updates after which the filter's gains are constant
_DOUBLINGS, _ROUNDING = 60, 1e-14  # of the sum over steps that gives the noise covariance


class LoopGains(NamedTuple):
    """Gains of a = −(kd v + kp q + ki ∫ q dt).

    Attributes:
        kp: 1/s².
        kd: 1/s.
        ki: 1/s³.
    """

    kp: float
    kd: float
    ki: float

    @classmethod
    def critically_damped(cls, rate: float, integral: float) -> LoopGains:
        """Return gains with a double pole, and an integral.

        Args:
            rate: of the double pole, rad/s.
            integral: approximate rate at which the integral removes an offset, 1/s.
        """
        return cls(rate**2, 2.0 * rate, integral * rate**2)


@dataclass(frozen=True, slots=True)
class LoopTargets:
    """Requirements on the loop.

    Args:
        phase_margin: least phase margin, degrees, in (0, 75).
        delay_margin: least additional delay that the loop tolerates, s.
        acceleration_noise: largest RMS of the acceleration command that sensor noise causes, rad/s². With a joint inertia of
            1e-3 kg·m², 15 rad/s² are 15 mN·m.
        largest_rate: largest rate of the double pole, rad/s. Contacts and gears are elastic; stay below half their frequency.
        integral: rate at which the integral removes an offset, 1/s; at most an eighth of the pole's rate is used.

    Raises:
        InvalidInput: a value is out of range; names the field and the allowed values.
    """

    phase_margin: float = 45.0
    delay_margin: float = 2e-3
    acceleration_noise: float = 15.0
    largest_rate: float = 120.0
    integral: float = 5.0

    def __post_init__(self) -> None:
        for name in ("phase_margin", "acceleration_noise", "largest_rate"):
            set_fields(self, **{name: arrays.check_number(getattr(self, name), name, above=0.0)})
        for name in ("delay_margin", "integral"):
            set_fields(self, **{name: arrays.check_number(getattr(self, name), name, minimum=0.0)})
        if self.phase_margin >= 75.0:
            raise InvalidInput("phase_margin", self.phase_margin, "less than 75; a double pole on a double integrator has 76")


@dataclass(frozen=True, slots=True)
class LoopMargins:
    """Stability margins and noise of a loop.

    Attributes:
        rate: rate of the double pole without filter, √kp, rad/s.
        crossover: highest frequency at which the loop's gain is 1, rad/s.
        phase_margin: least phase margin, degrees; 0 if the loop is unstable.
        delay_margin: additional delay at which the loop becomes unstable, s; 0 if it is unstable.
        acceleration_noise: RMS of the acceleration command that sensor noise causes, rad/s²; infinite if it is unstable.
        position_noise: RMS of the joint motion that sensor noise causes, rad; infinite if it is unstable.
        estimate_noise: RMS error of the joint positions that the joint filter estimates, rad.
    """

    rate: float
    crossover: float
    phase_margin: float
    delay_margin: float
    acceleration_noise: float
    position_noise: float
    estimate_noise: float

    def meets(self, targets: LoopTargets) -> bool:
        """Return whether the loop meets requirements.

        Args:
            targets: the requirements.
        """
        return (
            self.phase_margin >= targets.phase_margin
            and self.delay_margin >= targets.delay_margin
            and self.acceleration_noise <= targets.acceleration_noise
        )


def loop_margins(sensors: SensorModel, gains: LoopGains, period: float) -> LoopMargins:
    """Return stability margins and noise of the loop.

    Sensors that are slower than the controller give the loop their own period.

    Args:
        sensors: rate, latency and noise of the joints' sensors.
        gains: gains on position, rate and integral.
        period: time between two control steps, s, greater than 0.

    Raises:
        InvalidInput: a gain is not finite, or the period is not positive.
    """
    T = max(arrays.check_number(period, "period", above=0.0), 1.0 / sensors.rate)  # s
    checked = LoopGains(*(arrays.check_number(gain, f"gains.{name}") for name, gain in gains._asdict().items()))
    loop = _Loop(sensors, checked, T)
    rate = math.sqrt(max(checked.kp, 0.0))
    noise = loop.noise()
    if noise is None:
        return LoopMargins(rate, 0.0, 0.0, 0.0, math.inf, math.inf, loop.estimate_noise)
    return LoopMargins(rate, *loop.margins(), *noise, loop.estimate_noise)


def fastest_loop(
    sensors: SensorModel, period: float = 1e-3, targets: LoopTargets | None = None
) -> tuple[LoopGains, LoopMargins]:
    """Return the fastest critically damped gains that meet requirements, and their margins.

    Args:
        sensors: rate, latency and noise of the joints' sensors.
        period: time between two control steps, s, greater than 0.
        targets: requirements. Default: `LoopTargets()`.

    Raises:
        InvalidInput: no gains from 1 rad/s on meet the requirements; names what the slowest ones reach.
    """
    targets = targets or LoopTargets()

    def gains(rate: float) -> LoopGains:
        return LoopGains.critically_damped(rate, min(targets.integral, rate / 8.0))

    def margins(rate: float) -> LoopMargins:
        return loop_margins(sensors, gains(rate), period)

    high = targets.largest_rate
    if (best := margins(high)).meets(targets):
        return gains(high), best
    low = min(_SLOWEST, high)
    if not (best := margins(low)).meets(targets):
        reached = f"{best.phase_margin:.3g}° and {1e3 * best.delay_margin:.3g} ms at {best.acceleration_noise:.3g} rad/s² noise"
        allowed = f"a sensor whose loop at {low:g} rad/s meets {targets}; it has {reached}"
        raise InvalidInput("sensors", sensors, allowed)
    while high > _RATE_RATIO * low:  # margins fall with the rate
        middle = math.sqrt(low * high)
        found = margins(middle)
        if found.meets(targets):
            low, best = middle, found
        else:
            high = middle
    return gains(low), best


class _Loop:
    """State-space model of the loop: double integrator with delayed measurements, and joint filter with feedback.

    The controller's state is that of the filter, the sum of the estimated positions times T, and the last command.

    Args:
        sensors: sensors of the joints.
        gains: gains of the feedback.
        T: period, s.

    Attributes:
        estimate_noise: RMS error of the estimated positions, rad.
    """

    def __init__(self, sensors: SensorModel, gains: LoopGains, T: float) -> None:
        joint_filter = JointFilter(1, sensors, EstimatorSettings(), T)
        self._T, self._delay, outputs = T, joint_filter.delay, 2 if sensors.has_velocity else 1
        converged = JointFilterMemory(0.0, np.zeros((3, 1)), np.zeros((self._delay, 1)), _CONVERGED)
        self.estimate_noise = math.sqrt(joint_filter.covariance(converged)[0, 0])
        self._noise = np.array([sensors.encoder_variance, sensors.velocity_noise**2])[:outputs]
        transition, estimate = _filter_response(joint_filter, outputs, T)
        n = len(transition)
        feedback = np.array([-gains.kp, -gains.kd, 0.0]) @ estimate  # of state, measurement and last command
        self._C, self._D = np.concatenate([feedback[:n], [-gains.ki, feedback[-1]]]), feedback[n:-1]
        self._A, self._B = np.zeros((n + 2, n + 2)), np.zeros((n + 2, outputs))
        self._A[:n, :n], self._A[:n, n + 1], self._B[:n] = transition[:, :n], transition[:, -1], transition[:, n:-1]
        self._A[n, :n], self._A[n, n], self._A[n, n + 1] = T * estimate[0, :n], 1.0, T * estimate[0, -1]
        self._B[n] = T * estimate[0, n:-1]
        self._A[n + 1], self._B[n + 1] = self._C, self._D
        if gains.ki == 0.0:  # the sum does not act
            self._A, self._B, self._C = (np.delete(part, n, axis=0) for part in (self._A, self._B, self._C))
            self._A = np.delete(self._A, n, axis=1)

    def margins(self) -> tuple[float, float, float]:
        """Return the crossover in rad/s, the phase margin in degrees and the delay margin in s of a stable loop."""
        omega = np.geomspace(_LOWEST_FREQUENCY, math.pi / self._T, _FREQUENCIES)  # rad/s
        L = self._open_loop(np.exp(1j * omega * self._T))
        size, phase, x = np.log(np.abs(L)), np.unwrap(np.angle(L)), np.log(omega)
        crossings = np.flatnonzero(size[:-1] * size[1:] <= 0.0)
        if not len(crossings):
            return 0.0, 180.0, math.inf
        share = size[crossings] / (size[crossings] - size[crossings + 1])
        at = np.exp(x[crossings] + share * (x[crossings + 1] - x[crossings]))  # rad/s
        angle = (phase[crossings] + share * (phase[crossings + 1] - phase[crossings]) + math.pi) % (2.0 * math.pi)  # rad
        phase_margin = np.minimum(angle, 2.0 * math.pi - angle).min()
        return float(at.max()), math.degrees(phase_margin), float((angle / at).min())

    def noise(self) -> tuple[float, float] | None:
        """Return the RMS of command (rad/s²) and position (rad) that sensor noise causes; None if the loop is unstable."""
        T, m, outputs = self._T, self._delay, len(self._noise)
        size = 2 * (m + 1)  # position and rate, now and in the last m periods
        A, push = np.eye(size, k=-2), np.zeros(size)
        A[:2, :2], push[:2] = [[1.0, T], [0.0, 1.0]], [0.5 * T**2, T]
        measured = np.eye(size)[2 * m : 2 * m + outputs]
        closed = np.block([[A + np.outer(push, self._D @ measured), np.outer(push, self._C)], [self._B @ measured, self._A]])
        if np.abs(np.linalg.eigvals(closed)).max() >= 1.0:
            return None
        drive = np.vstack([np.outer(push, self._D), self._B]) * np.sqrt(self._noise)
        S, power = drive @ drive.T, closed
        for _ in range(_DOUBLINGS):  # S = Σ Aᵏ D Dᵀ Aᵏᵀ, with twice as many terms each time
            change = power @ S @ power.T
            S, power = S + change, power @ power
            if np.abs(change).max() <= _ROUNDING * np.abs(S).max():
                break
        command = np.concatenate([self._D @ measured, self._C])
        variance = float(command @ S @ command + np.square(self._D) @ self._noise)
        return math.sqrt(variance), math.sqrt(float(S[0, 0]))

    def _open_loop(self, z: npt.NDArray[np.complex128]) -> npt.NDArray[np.complex128]:
        """Return the transfer function of the loop, opened at the command, with the sign of negative feedback."""
        T = self._T
        plant = np.array([0.5 * T**2 * (z + 1.0) / (z - 1.0) ** 2, T / (z - 1.0)])[: len(self._noise)] * z**-self._delay
        resolvent = np.linalg.solve(z[:, None, None] * np.eye(len(self._A)) - self._A, self._B.astype(np.complex128)[None])
        controller = np.einsum("i,fij->jf", self._C, resolvent) + self._D[:, None]
        return np.asarray(-np.sum(plant * controller, axis=0))


def _filter_response(joint_filter: JointFilter, outputs: int, T: float) -> tuple[Array, Array]:
    """Return the converged filter as a linear map: of state, measurements and last command to next state and estimate."""
    m = joint_filter.delay
    n = 3 + m
    transition, estimate = np.zeros((n, n + outputs + 1)), np.zeros((3, n + outputs + 1))
    for i, unit in enumerate(np.eye(n + outputs + 1)):
        memory = JointFilterMemory(0.0, unit[:3, None], unit[3:n, None], _CONVERGED)
        rate = unit[n + 1 : n + 2] if outputs == 2 else None
        present, after = joint_filter.step(memory, T, unit[n : n + 1], rate, unit[-1:])
        transition[:, i] = np.concatenate([after.x[:, 0], after.commands[:, 0]])
        estimate[:, i] = present[:, 0]
    return transition, estimate
