"""Filter of the joints: positions, rates and disturbances from encoders and commanded accelerations.

Each joint is modelled as

    q̈ = a + d + w_a,    ḋ = w_d,

with the commanded acceleration a, the acceleration d of disturbances such as friction, and white noise w. The measured position
is q + n. All joints have the same noise and the same period, so one Kalman filter (Kalman, 1960) with a table of gains serves
them all: the gains follow the covariance from the start to its limit, and are constant from there on. A bandwidth of about
(S_a/(σ² T))^(1/4) rad/s results, with the spectral density S_a of w_a, the encoder's standard deviation σ and the period T.

With a latency of m periods, the filter follows the joints of m periods ago. The commands since then predict the present.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from graspforce.core.arrays import Array, freeze
from graspforce.core.compiled import native
from graspforce.core.errors import InvalidInput
from graspforce.core.records import unchecked_constructor
from graspforce.estimation.joints.joint_start import UPDATES, StartSmoother
from graspforce.estimation.sensor_model import SensorModel
from graspforce.estimation.settings import EstimatorSettings

_LEAST_POSITION_NOISE = 1e-7  # rad; a noise of zero would make the gains singular
_LEAST_RATE_NOISE = 1e-5  # rad/s
_MAX_GAINS = 4000  # gains from the start to the limit, at most
_CONVERGENCE = 1e-6  # relative change of the covariance in a step that counts as converged
_MAX_GAP = 0.1  # s: after a longer gap between measurements, the filter starts anew
_DISTURBANCE_ERROR = 10.0  # rad/s²: standard deviation of d at the start


@dataclass(frozen=True, eq=False, slots=True)
class JointFilterMemory:
    """State of the filter after a measurement.

    Attributes:
        t: time of the measurement, s.
        x: (3, n) estimated positions in rad, rates in rad/s, and accelerations of disturbances in rad/s², at that time.
        commands: (m, n) commanded accelerations that are not yet measurable, the oldest first, rad/s²; m is the latency.
        updates: measurements since the start.
        start: (n,) estimated positions at the first measurement, rad; the first updates improve it. None if it is not known.
    """

    t: float
    x: Array
    commands: Array
    updates: int
    start: Array | None = None


_make_memory = unchecked_constructor(JointFilterMemory)


class JointFilter:
    """Kalman filter of the joints of a hand.

    Args:
        n: number of joints.
        sensors: noise and latency of the encoders.
        settings: process noise.
        period: time between two measurements, s.
        acceleration_limits: (n,) largest accelerations that the motors can cause, rad/s². Larger commands are cut off: the
            joints cannot follow them. Default: no limits.

    Raises:
        InvalidInput: the latency is longer than 1000 periods.
    """

    def __init__(
        self,
        n: int,
        sensors: SensorModel,
        settings: EstimatorSettings,
        period: float,
        acceleration_limits: Array | None = None,
    ) -> None:
        self._n, self._period = n, period
        self._limits = np.full(n, np.inf) if acceleration_limits is None else acceleration_limits
        self.delay = sensors.latency_periods(period)
        self._settings, self._sensors = settings, sensors
        self._F = np.array([[1.0, period, 0.5 * period**2], [0.0, 1.0, period], [0.0, 0.0, 1.0]])
        self._g = np.array([0.5 * period**2, period, 0.0])  # response to the command
        self._Q = _process_noise(settings.acceleration_noise**2, settings.disturbance_noise**2, period)
        position_variance = max(sensors.encoder_variance, _LEAST_POSITION_NOISE**2)
        self._tables = {False: self._table(np.array([position_variance]))}
        if sensors.has_velocity:
            variances = np.array([position_variance, max(sensors.velocity_noise, _LEAST_RATE_NOISE) ** 2])
            self._tables[True] = self._table(variances)
        self._prediction = self._prediction_matrix()

    def initial_memory(self, t: float, q: Array, v: Array | None = None) -> JointFilterMemory:
        """Return the memory after the first measurement.

        Args:
            t: time of the measurement, s.
            q: (n,) measured positions, rad.
            v: (n,) measured rates, rad/s; None for a hand at rest.
        """
        x = np.zeros((3, self._n))
        x[0] = q
        if v is not None:
            x[1] = v
        x = freeze(x)
        return JointFilterMemory(t, x, freeze(np.zeros((self.delay, self._n))), 0, x[0])

    def step(
        self, memory: JointFilterMemory, t: float, q: Array, v: Array | None, acceleration: Array | None
    ) -> tuple[Array, JointFilterMemory]:
        """Return the present state of the joints, and the memory after a measurement.

        Args:
            memory: memory after the last measurement.
            t: time of the measurement, s.
            q: (n,) measured positions, rad.
            v: (n,) measured rates, rad/s; used if the sensor model has velocities.
            acceleration: (n,) acceleration commanded since the last step, rad/s²; None if there was none.

        Returns:
            (3, n) positions in rad, rates in rad/s and accelerations of disturbances in rad/s², and the memory.

        Raises:
            InvalidInput: the measurement is earlier than the last one.
        """
        gap = t - memory.t  # s
        if gap < 0.0:
            raise InvalidInput("measurement.t", t, f"not earlier than the last measurement, {memory.t:g} s")
        if gap == 0.0:
            return self.present(memory), memory
        if gap > _MAX_GAP:
            memory = replace(self.initial_memory(t, q, v), start=None)
            return self.present(memory), memory
        x, missed = memory.x, round(gap / self._period) - 1
        if missed > 0:
            x = self._coast(x, memory.commands[0] if self.delay > 0 else self._limited(acceleration), missed)
        has_rates = v is not None and True in self._tables
        table = self._tables[has_rates]
        gains, start = table.gains, memory.start
        if start is not None and memory.updates < UPDATES and missed == 0:
            start = self._improved_start(start, table.start.gains[memory.updates], memory, acceleration, (q, v))
        update = self._update_reference if native is None else self._update
        gain = gains[min(memory.updates, len(gains) - 1)]
        x, commands, present = update(gain, x, memory.commands, acceleration, q, v if has_rates else None)
        for array in (x, commands, present):
            array.setflags(write=False)
        return present, _make_memory(t, x, commands, memory.updates + 1, start)

    def present(self, memory: JointFilterMemory) -> Array:
        """Return the present state (3, n), predicted over the latency: positions in rad, rates and disturbances.

        Args:
            memory: memory after the last measurement.
        """
        if self._prediction is None:
            return memory.x
        return np.asarray(self._prediction.dot(np.concatenate([memory.x, memory.commands])))

    def covariance(self, memory: JointFilterMemory) -> Array:
        """Return the (3, 3) covariance of the estimated position, rate and disturbance, the same for every joint.

        Args:
            memory: memory after the last measurement.
        """
        covariances = self._tables[True in self._tables].covariances
        P = covariances[min(memory.updates, len(covariances) - 1)]
        for _ in range(self.delay):
            P = self._F @ P @ self._F.T + self._Q
        return np.asarray(P)

    def start_variance(self, memory: JointFilterMemory) -> float:
        """Return the variance of the positions at the first measurement, rad².

        Args:
            memory: memory after a measurement. Measured rates count if the sensor model has them.
        """
        return float(self._tables[True in self._tables].start.variances[min(memory.updates, UPDATES)])

    # ── implementation ─────────────────────────────────────────────────────────────────────────────────────────────────────

    def _improved_start(
        self,
        start: Array,
        gain: Array,
        memory: JointFilterMemory,
        acceleration: Array | None,
        measured: tuple[Array, Array | None],
    ) -> Array:
        """Return the (n,) positions at the start after a measurement of positions and rates.

        Args:
            start: (n,) positions before.
            gain: response to the innovations of positions, or of positions and rates.
            memory: memory after the last measurement.
            acceleration: (n,) last command, rad/s².
            measured: positions, rad, and rates, rad/s.
        """
        applied = memory.commands[0] if self.delay > 0 else self._limited(acceleration)
        expected = self._F @ memory.x + self._g[:, None] * applied
        for i, weight in enumerate(gain.tolist()):
            start = start + weight * (measured[i] - expected[i])
        return freeze(start)

    def _table(self, variances: Array) -> _GainTable:
        """Return the gains for measured positions, or positions and rates, with noise of given variances."""
        F, H, R = self._F, np.eye(3)[: len(variances)], np.diag(variances)
        P = np.diag([variances[0], self._settings.initial_rate_error**2, _DISTURBANCE_ERROR**2])
        gains: list[Array] = []
        covariances = [P]
        while len(gains) < _MAX_GAINS:
            before = F @ P @ F.T + self._Q
            K = np.linalg.solve(H @ before @ H.T + R, H @ before).T
            kept = np.eye(3) - K @ H
            after = kept @ before @ kept.T + K @ R @ K.T
            response = [kept @ F, kept @ self._g[:, None], K]  # to the state, the command and the measurement
            gains.append(np.ascontiguousarray(np.hstack(response)))
            covariances.append(after)
            if np.allclose(after, P, rtol=_CONVERGENCE, atol=0.0):
                break
            P = after
        return _GainTable(gains, covariances, StartSmoother(F, self._Q, R, covariances[0]))

    def _prediction_matrix(self) -> Array | None:
        """Return the (3, 3 + m) response of the present state to the delayed state and the commands since; None if m = 0."""
        if self.delay == 0:
            return None
        columns, power = [], np.eye(3)
        for _ in range(self.delay):
            columns.append(power @ self._g)
            power = self._F @ power
        return np.ascontiguousarray(np.hstack([power, np.array(columns[::-1]).T]))

    def _limited(self, acceleration: Array | None) -> Array:
        """Return a command within the limits; zeros if there is none."""
        if acceleration is None:
            return np.zeros(self._n)
        return np.minimum(np.maximum(acceleration, -self._limits), self._limits)

    def _coast(self, x: Array, applied: Array, periods: int) -> Array:
        """Return the state after periods without a measurement, with a constant command."""
        for _ in range(periods):
            x = self._F @ x + self._g[:, None] * applied
        return x

    def _update(
        self, gain: Array, x: Array, commands: Array, acceleration: Array | None, q: Array, v: Array | None
    ) -> tuple[Array, Array, Array]:
        """Return the same as `_update_reference`, by compiled code."""
        after = present = np.empty((3, self._n))
        next_commands = commands
        if self.delay > 0:
            next_commands, present = np.empty(commands.shape), np.empty((3, self._n))
        native.filter_joints(
            gains=gain,
            x=x,
            commands=commands,
            acceleration=None if acceleration is None else np.ascontiguousarray(acceleration, np.float64),
            limits=self._limits,
            q=q,
            v=v,
            prediction=self._prediction,
            next=after,
            next_commands=next_commands,
            present=present,
        )
        return after, next_commands, present

    def _update_reference(
        self, gain: Array, x: Array, commands: Array, acceleration: Array | None, q: Array, v: Array | None
    ) -> tuple[Array, Array, Array]:
        """Return the state (3, n) after a measurement, the commands (m, n) with the last one, and the present state (3, n).

        Args:
            gain: response of the state to the last state, the command and the measurements.
            x: (3, n) last state.
            commands: (m, n) commands that do not act on the measurement yet, the oldest first, rad/s².
            acceleration: (n,) last command, rad/s²; None if there was none.
            q: (n,) measured positions, rad.
            v: (n,) measured rates, rad/s; None if not measured.
        """
        shifted = np.concatenate([commands, self._limited(acceleration)[None]])
        measured = [q] if v is None else [q, v]
        after, commands = np.asarray(gain.dot(np.array([*x, shifted[0], *measured]))), shifted[1:]
        if self._prediction is None:
            return after, commands, after
        return after, commands, np.asarray(self._prediction.dot(np.concatenate([after, commands])))


@dataclass(frozen=True, eq=False, slots=True)
class _GainTable:
    """Gains and covariances of the updates, from the start to their limits.

    Attributes:
        gains: (3, 5 or 6) response of the state to the last state, the command, and the measurements, for each update.
        covariances: (3, 3) covariance before the first update, and after each.
        start: gains of the positions at the start.
    """

    gains: list[Array]
    covariances: list[Array]
    start: StartSmoother


def _process_noise(acceleration: float, disturbance: float, T: float) -> Array:
    """Return the covariance (3, 3) of the process noise in a period.

    Args:
        acceleration: spectral density of w_a, (rad/s²)²/Hz.
        disturbance: spectral density of w_d, (rad/s³)²/Hz.
        T: period, s.
    """
    white = np.array([[T**3 / 3, T**2 / 2, 0.0], [T**2 / 2, T, 0.0], [0.0, 0.0, 0.0]])
    walk = np.array([[T**5 / 20, T**4 / 8, T**3 / 6], [T**4 / 8, T**3 / 3, T**2 / 2], [T**3 / 6, T**2 / 2, T]])
    return acceleration * white + disturbance * walk
