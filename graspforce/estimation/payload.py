"""Mass, centre of mass and external wrench of a held object, from the contact forces and the object's motion.

Newton–Euler is linear in the mass m and the first moment h = m c, with the centre of mass c. With α = p̈ − g, all in O,

    force  = α m + (ω̇ × + ω × ω ×) h,
    moment = h × α + (I ω̇ + ω × I ω) m/m₀.

The inertia I about O's origin is that of the given body, in proportion to the mass. The contacts supply this wrench
less the external one: w = Φ θ − w_e with θ = (m, h). Recursive least squares with exponential forgetting gives θ
(Ljung, 1999). The weight is the inverse covariance R of the contact wrench, and the prior is the given body. The
external wrench is the remainder.

A constant external force along gravity is weight: both have the same effect until the hand turns. A sudden change of
the wrench counts as external at first, and as payload after `adaption_time`. The first moment along gravity shows when
the object turns.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.special import chdtri

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields, unchecked_constructor
from graspforce.core.settings_record import SettingsRecord
from graspforce.geometry.vectors import skew
from graspforce.grasp.body import Body

_BLOCK = 8  # periods that are averaged before an update, by default
_AFTER_CHANGE = 0.01  # weight of the past after a change of the payload


@dataclass(frozen=True, slots=True)
class PayloadSettings(SettingsRecord):
    """Settings of the estimator of the payload.

    Args:
        memory_time: time constant with which the past is forgotten, s.
        mass_ratio: standard deviation of the mass before any measurement, relative to the given body's.
        centre_error: standard deviation of each coordinate of the centre of mass before any measurement, m.
        external_window: time constant of the external wrench, s.
        external_force: standard deviation of the changes of the external force that are not noise, N. It bounds how far slow
            changes of the external wrench disturb the mass.
        attitude_error: largest error of the object's orientation, rad. Smaller turns count as none: errors of the orientation
            turn gravity and the measured wrench alike, and would seem to show the first moment along gravity.
        false_alarm: probability with which noise counts as a sudden change of the wrench in one update.
        adaption_time: time after which a sudden change counts as payload, s.

    Raises:
        InvalidInput: a value is out of range; names the field and the allowed values.
    """

    RECORD: ClassVar[str] = "payload"

    memory_time: float = 1.0
    mass_ratio: float = 1.0
    centre_error: float = 0.02
    external_window: float = 0.02
    external_force: float = 0.01
    attitude_error: float = 0.1
    false_alarm: float = 1e-6
    adaption_time: float = 0.4

    def __post_init__(self) -> None:
        for each in dataclasses.fields(self):
            value = arrays.check_number(getattr(self, each.name), each.name, above=0.0)
            set_fields(self, **{each.name: value})
        if self.false_alarm >= 1.0:
            raise InvalidInput("false_alarm", self.false_alarm, "less than 1")


@dataclass(frozen=True, eq=False, slots=True)
class PayloadEstimate:
    """Mass, centre of mass and external wrench of a held object.

    Attributes:
        mass: kg.
        p_OM: (3,) centre of mass in O, m.
        covariance: (4, 4) covariance of the mass and the first moment h = m c, in kg and kg·m.
        external: (6,) external wrench on the object besides gravity, about O's origin, in O, N and N·m.
        external_covariance: (6, 6) its covariance, N² to (N·m)².
        is_disturbed: whether the wrench changed suddenly; mass and centre of mass are then kept.
    """

    mass: float
    p_OM: Array
    covariance: Array
    external: Array
    external_covariance: Array
    is_disturbed: bool

    @property
    def mass_deviation(self) -> float:
        """Standard deviation of the mass, kg."""
        return math.sqrt(self.covariance[0, 0])

    @property
    def centre_covariance(self) -> Array:
        """(3, 3) covariance of the centre of mass c = h/m, to first order, m²."""
        change = np.hstack([-self.p_OM[:, None], np.eye(3)]) / self.mass  # dc = (dh − c dm)/m
        return np.asarray(change @ self.covariance @ change.T)

    def to_dict(self) -> JsonRecord:
        """Return the record of the estimate."""
        record = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        arrays_of = ("p_OM", "covariance", "external", "external_covariance")
        named = {**record, **{name: record[name].tolist() for name in arrays_of}}
        named["centre_of_mass"] = named.pop("p_OM")
        return named


class PayloadInputs(NamedTuple):
    """Inputs of one period.

    Attributes:
        w: (6,) wrench of the contacts on the object about O's origin, in O, N and N·m.
        covariances: (6, 6) covariances of its noise, independent between periods, and of its constant error. They are used in
            periods for which `needs_covariances` is true.
        rates: (3, 3) rows p̈_O − g, m/s², ω̇, rad/s², and ω, rad/s, in O's axes. Noise of the accelerations biases the estimate:
            pass those of the desired motion.
    """

    w: Array
    covariances: tuple[Array, Array] | None
    rates: Array


class PayloadMemory(NamedTuple):
    """State of the estimator between two periods.

    Attributes:
        periods: number of periods in the present block.
        sums: (15,) sums of w and of the rates over the block.
        information: (4, 4) Σ Φᵀ R⁻¹ Φ of the past, with forgetting.
        score: (4,) Σ Φᵀ R⁻¹ w.
        gain: (4, 6) Σ Φᵀ R⁻¹.
        noise: (4, 4) Σ Φᵀ R⁻¹ R_noise R⁻¹ Φ, with the squares of the forgetting.
        direction: (3,) unit vector along α to which smaller turns are referred, in O; zero before the first block.
        residual: (6,) Φ θ − w over the external window, N and N·m.
        slow: (6,) the same over the memory time.
        disturbed: time since the begin of a sudden change, s; zero without one.
        updates: blocks since the start.
        estimate: the present estimate.
    """

    periods: int
    sums: Array
    information: Array
    score: Array
    gain: Array
    noise: Array
    direction: Array
    residual: Array
    slow: Array
    disturbed: float
    updates: int
    estimate: PayloadEstimate


class PayloadEstimator:
    """Estimator of the payload. Call `step` once every period.

    Args:
        body: the given body: prior of mass and centre of mass, and inertia.
        period: time between two steps, s.
        settings: memory, prior and thresholds.
        block: number of periods that are averaged before an update.
    """

    def __init__(self, body: Body, period: float, settings: PayloadSettings | None = None, block: int = _BLOCK) -> None:
        self.settings = settings = PayloadSettings() if settings is None else settings
        self._periods, self._block = block, block * period  # s
        self._kept = math.exp(-self._block / settings.memory_time)
        self._external_gain = -math.expm1(-self._block / settings.external_window)
        self._theta = np.append(body.mass, body.mass * body.p_OM)
        deviations = np.array([settings.mass_ratio * body.mass, *[settings.centre_error * body.mass] * 3])
        self._prior = np.diag(deviations**-2)
        lever = skew(body.p_OM)
        self._inertia = (body.inertia - body.mass * lever @ lever) / body.mass  # m², about O's origin, for each kilogram
        self._threshold = float(chdtri(6, settings.false_alarm))
        arm = 0.03  # m: of external forces, which then have this moment
        self._unmodelled = np.diag(np.repeat([settings.external_force**2, (arm * settings.external_force) ** 2], 3))

    def initial_memory(self) -> PayloadMemory:
        """Return the memory before the first step."""
        zero = np.zeros(6)
        covariance = np.linalg.inv(self._prior)
        unknown = freeze(np.diag(np.full(6, math.inf)))
        estimate = PayloadEstimate(
            float(self._theta[0]), freeze(self._theta[1:] / self._theta[0]), freeze(covariance), freeze(zero), unknown, False
        )
        sums, matrix = np.zeros(15), np.zeros((4, 4))
        return PayloadMemory(0, sums, matrix, np.zeros(4), np.zeros((4, 6)), matrix, zero[:3], zero, zero, 0.0, 0, estimate)

    def needs_covariances(self, memory: PayloadMemory) -> bool:
        """Return whether the next step uses the covariances of the contact wrench.

        Args:
            memory: memory after the last period.
        """
        return memory.periods + 1 >= self._periods

    def step(self, memory: PayloadMemory, inputs: PayloadInputs) -> tuple[PayloadEstimate, PayloadMemory]:
        """Return the payload after a period, and the memory for the next one. The estimate changes every eighth period.

        Args:
            memory: memory after the last period; `initial_memory` before the first.
            inputs: contact wrench and motion of the period.
        """
        sums = memory.sums + np.concatenate((inputs.w, inputs.rates.ravel()))
        periods = memory.periods + 1
        if periods < self._periods:
            return memory.estimate, memory._replace(periods=periods, sums=sums)
        memory = self._updated(memory, sums / periods, inputs)
        return memory.estimate, memory

    # ── implementation ─────────────────────────────────────────────────────────────────────────────────────────────────────

    def _regressor(self, rates: Array) -> Array:
        """Return Φ (6, 4)."""
        alpha, omega_rate, omega = rates
        turning = skew(omega)  # turning @ x = ω × x
        regressor = np.empty((6, 4))
        regressor[:3, 0] = alpha
        regressor[:3, 1:] = skew(omega_rate) + turning @ turning
        regressor[3:, 0] = self._inertia @ omega_rate + turning @ (self._inertia @ omega)
        regressor[3:, 1:] = skew(-alpha)  # h × α
        return regressor

    def _updated(self, memory: PayloadMemory, mean: Array, inputs: PayloadInputs) -> PayloadMemory:
        """Return the memory after a block with the mean w and rates."""
        mean, direction = self._without_small_turns(mean.reshape(5, 3), memory.direction)
        w, regressor = mean[:2].ravel(), self._regressor(mean[2:])
        assert inputs.covariances is not None  # `needs_covariances`
        noise, bias = inputs.covariances[0] / self._periods, inputs.covariances[1] + self._unmodelled
        theta = np.append(memory.estimate.mass, memory.estimate.mass * memory.estimate.p_OM)
        residual = regressor @ theta - w
        disturbed = self._disturbed_time(memory, residual, noise, regressor)
        if disturbed > self.settings.adaption_time:  # the change is payload: forget the past
            memory, disturbed = _forgotten(memory), 0.0
        information, score, gain, spread = memory.information, memory.score, memory.gain, memory.noise
        if disturbed == 0.0:
            weights, kept = np.linalg.inv(noise + bias), self._kept
            weighted = regressor.T @ weights  # (4, 6): Φᵀ R⁻¹
            information = kept * information + weighted @ regressor
            score, gain = kept * score + weighted @ w, kept * gain + weighted
            spread = kept**2 * spread + weighted @ noise @ weighted.T
        P = np.linalg.inv(information + self._prior)
        theta = P @ (score + self._prior @ self._theta)
        covariance = P @ (spread + gain @ bias @ gain.T + self._prior) @ P
        g = self._external_gain
        external = memory.residual + max(g, 1.0 / (memory.updates + 1)) * (regressor @ theta - w - memory.residual)
        slow = memory.slow
        if disturbed == 0.0:
            slow = slow + max(1.0 - self._kept, 1.0 / (memory.updates + 1)) * (regressor @ theta - w - slow)
        of_external = g / (2.0 - g) * noise + inputs.covariances[1] + regressor @ covariance @ regressor.T
        mass = max(float(theta[0]), 1e-3 * float(self._theta[0]))
        estimate = make_estimate(
            mass, freeze(theta[1:] / mass), freeze(covariance), freeze(external), freeze(of_external), disturbed > 0.0
        )
        zero = np.zeros(15)
        return PayloadMemory(
            0, zero, information, score, gain, spread, direction, external, slow, disturbed, memory.updates + 1, estimate
        )

    def _without_small_turns(self, rows: Array, direction: Array) -> tuple[Array, Array]:
        """Return vectors (5, 3), of which the third is α, turned so that α has a known direction, and that direction.

        Args:
            rows: force, moment, α, ω̇ and ω, in O.
            direction: (3,) direction of earlier blocks. α keeps its own direction if the angle between the two is large.
        """
        alpha = rows[2]
        u = alpha / max(float(np.linalg.norm(alpha)), 1e-9)
        axis = np.cross(u, direction)  # times the sine of the angle
        cosine = float(u @ direction)
        if cosine <= 0.0 or axis @ axis > self.settings.attitude_error**2:
            return rows, u
        S = skew(axis)
        return np.asarray(rows @ (np.eye(3) + S + S @ S / (1.0 + cosine)).T), direction

    def _disturbed_time(self, memory: PayloadMemory, residual: Array, noise: Array, regressor: Array) -> float:
        """Return the time since the begin of a sudden change of the wrench, s; zero without one."""
        difference = residual - memory.slow
        expected = noise + self._unmodelled + regressor @ memory.estimate.covariance @ regressor.T
        statistic = float(difference @ np.linalg.solve(expected, difference))
        return memory.disturbed + self._block if statistic > self._threshold else 0.0


def _forgotten(memory: PayloadMemory) -> PayloadMemory:
    """Return the memory with little weight on the past."""
    return memory._replace(
        information=_AFTER_CHANGE * memory.information,
        score=_AFTER_CHANGE * memory.score,
        gain=_AFTER_CHANGE * memory.gain,
        noise=_AFTER_CHANGE**2 * memory.noise,
        slow=np.zeros(6),
        updates=0,
    )


make_estimate = unchecked_constructor(PayloadEstimate)
