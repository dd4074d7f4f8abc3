"""Identification of joint friction from a recorded motion without contact.

For each joint, the torque that the rigid hand does not explain is fitted by

    tau − (M(q) a + h(q, v)) = c sign v + b v + o,

by least squares over all samples at rates beyond a threshold. The offset o takes errors of gravity and of the torque sensor.
Positions and torques pass through the same smoothing filter, so its delay and its bandwidth cancel.

Source: Armstrong-Hélouvry, Dupont and Canudas de Wit (1994), section 4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.signal import savgol_filter
from scipy.stats import t as student

from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.core.text_table import Table
from graspforce.hand.drives.joint_friction import JointFriction
from graspforce.hand.hand import GRAVITY_PALM_UP, Hand
from graspforce.hand.identification.joint_recording import JointRecording

_POLYNOMIAL = 3  # degree of the smoothing filter
_UNEVENNESS = 0.2  # largest deviation of a sampling period from the median that needs no interpolation, relative
_LEAST_SHARE = 0.05  # of the samples, which must move in each direction
_LEAST_SPREAD = 1.2  # ratio of the fast to the slow rates from which viscous friction can be told from Coulomb friction


@dataclass(frozen=True, slots=True)
class IdentificationSettings:
    """Settings of the identification.

    Args:
        slowest_rate: samples with smaller rates are ignored, rad/s, greater than 0. Stribeck friction and the reversal of the
            motion disturb them.
        window: length of the smoothing filter, s, greater than 0.
        blocks: number of blocks of time, at least 5. Their spread gives the confidence, also for noise that has a memory.
        gravity_H: (3,) acceleration of gravity in H, m/s².

    Raises:
        InvalidInput: a value is out of range; names the field and the allowed values.
    """

    slowest_rate: float = 0.05
    window: float = 0.05
    blocks: int = 20
    gravity_H: tuple[float, float, float] = GRAVITY_PALM_UP

    def __post_init__(self) -> None:
        for name in ("slowest_rate", "window"):
            set_fields(self, **{name: arrays.check_number(getattr(self, name), name, above=0.0)})
        if self.blocks < 5:
            raise InvalidInput("blocks", self.blocks, "at least 5")
        gravity = arrays.check_array(self.gravity_H, "gravity_H", (3,))
        set_fields(self, gravity_H=tuple(gravity.tolist()))


@dataclass(frozen=True, eq=False, slots=True)
class IdentifiedFriction:
    """Friction of n joints with 95 % confidence intervals.

    Attributes:
        joints: names of the joints.
        coulomb: (n,) Coulomb friction, N·m; NaN for joints that did not move enough in both directions.
        coulomb_error: (n,) half width of its 95 % confidence interval, N·m.
        viscous: (n,) viscous friction, N·m·s/rad; NaN likewise, and for joints that moved at one speed only.
        viscous_error: (n,) half width of its 95 % confidence interval, N·m·s/rad.
        offset: (n,) constant torque that the model of the hand lacks, N·m.
        residual: (n,) RMS of the torque that remains unexplained, N·m.
        samples: (n,) number of samples used.
    """

    joints: tuple[str, ...]
    coulomb: Array
    coulomb_error: Array
    viscous: Array
    viscous_error: Array
    offset: Array
    residual: Array
    samples: npt.NDArray[np.intp]

    @property
    def is_identified(self) -> npt.NDArray[np.bool_]:
        """(n,) whether the Coulomb friction of a joint was identified."""
        return np.isfinite(self.coulomb)

    def friction(self, source: str = "identified") -> JointFriction:
        """Return the friction as a model. Joints that were not identified have none and no source.

        Args:
            source: source of the numbers.
        """
        coulomb, viscous = (np.maximum(np.nan_to_num(value), 0.0) for value in (self.coulomb, self.viscous))
        return JointFriction(coulomb, viscous=viscous, sources=[source if found else "" for found in self.is_identified])

    def description(self, source: str) -> list[JsonRecord]:
        """Return the entries of the field `friction` in a hand's description, one for each identified joint.

        Args:
            source: source of the numbers, such as the date of the recording.
        """
        friction = self.friction(source)
        return [
            {
                "joints": [name],
                "coulomb": float(f"{friction.coulomb[i]:.3g}"),
                "viscous": float(f"{friction.viscous[i]:.3g}"),
                "source": source,
            }
            for i, name in enumerate(self.joints)
            if self.is_identified[i]
        ]

    def to_dict(self) -> JsonRecord:
        """Return a plain record; null stands for values that were not identified."""
        names = ("coulomb", "coulomb_error", "viscous", "viscous_error", "offset", "residual")
        rows = {name: [x if np.isfinite(x) else None for x in getattr(self, name).tolist()] for name in names}
        return {"joints": list(self.joints), **rows, "samples": self.samples.tolist()}

    def __str__(self) -> str:
        return str(self.table())

    def table(self) -> Table:
        """Return a table with a row for each joint."""
        columns = (self.coulomb, self.coulomb_error, self.viscous, self.viscous_error, self.offset, self.residual)
        rows = [
            (name, *(f"{column[i]:.4f}" if np.isfinite(column[i]) else "–" for column in columns), str(self.samples[i]))
            for i, name in enumerate(self.joints)
        ]
        header = ("joint", "Coulomb N·m", "±", "viscous N·m·s/rad", "±", "offset N·m", "residual N·m", "samples")
        return Table(header, tuple(rows), "Joint friction with 95 % confidence intervals")


def identify_friction(
    hand: Hand, recording: JointRecording, settings: IdentificationSettings | None = None
) -> IdentifiedFriction:
    """Identify Coulomb and viscous friction of every joint that moved.

    The hand moves freely during the recording: no contacts, and every joint to and fro at several speeds.

    Args:
        hand: the hand.
        recording: positions and torques of its actuated joints.
        settings: threshold, filter and gravity. Default: `IdentificationSettings()`, palm up.

    Raises:
        InvalidInput: the recording has another number of joints, or is too short for the filter.
    """
    settings = settings or IdentificationSettings()
    if recording.n != hand.n:
        raise InvalidInput("recording.q", recording.n, f"the positions of {hand.n} joints, one for each motor of {hand.name}")
    q, v, a, tau = _smoothed(recording, settings)
    unexplained = tau - hand.inverse_dynamics_along(q, v, a, settings.gravity_H)  # N·m
    fits = [_fit_joint(v[:, j], unexplained[:, j], settings) for j in range(hand.n)]
    coulomb, coulomb_error, viscous, viscous_error, offset, residual, samples = np.array(fits).T
    return IdentifiedFriction(
        joints=tuple(joint.name for joint in hand.joints),
        coulomb=freeze(coulomb),
        coulomb_error=freeze(coulomb_error),
        viscous=freeze(viscous),
        viscous_error=freeze(viscous_error),
        offset=freeze(offset),
        residual=freeze(residual),
        samples=samples.astype(np.intp),
    )


def _smoothed(recording: JointRecording, settings: IdentificationSettings) -> tuple[Array, Array, Array, Array]:
    """Return positions, rates, accelerations and torques (s, n) behind the same smoothing filter."""
    t, q, tau, v = recording.t, recording.q, recording.tau, recording.v
    steps = np.diff(t)  # s
    T = float(np.median(steps))
    if np.abs(steps - T).max() > _UNEVENNESS * T:
        even = np.arange(t[0], t[-1], T)
        q, tau = (np.column_stack([np.interp(even, t, column) for column in x.T]) for x in (q, tau))
        v = None if v is None else np.column_stack([np.interp(even, t, column) for column in v.T])
    length = max(round(settings.window / T) | 1, _POLYNOMIAL + 2)  # samples, odd
    length += 1 - length % 2
    if 4 * length > len(q):
        allowed = f"at least four times the filter's window of {settings.window:g} s; sample faster, or move for longer"
        raise InvalidInput("recording.t", f"{len(q)} samples of {T:g} s", allowed)

    def smooth(x: Array, derivative: int = 0) -> Array:
        filtered = savgol_filter(x, length, _POLYNOMIAL, deriv=derivative, delta=T, axis=0)
        return np.asarray(filtered[length:-length])  # without the ends, where the filter extrapolates

    rate, acceleration = (smooth(q, 1), smooth(q, 2)) if v is None else (smooth(v), smooth(v, 1))
    return smooth(q), rate, acceleration, smooth(tau)


def _fit_joint(v: Array, torque: Array, settings: IdentificationSettings) -> tuple[float, ...]:
    """Return c, its error, b, its error, o, the RMS residual and the number of samples of one joint."""
    used = np.flatnonzero(np.abs(v) >= settings.slowest_rate)
    speed, count = np.abs(v[used]), len(used)
    shares = [np.count_nonzero(v[used] > 0.0) / len(v), np.count_nonzero(v[used] < 0.0) / len(v)]
    if min(shares) < _LEAST_SHARE or count < 2 * settings.blocks:
        return (np.nan,) * 6 + (float(count),)
    has_speeds = np.quantile(speed, 0.9) > _LEAST_SPREAD * np.quantile(speed, 0.1)
    columns = [np.sign(v[used]), np.ones(count), *([v[used]] if has_speeds else [])]
    X, y = np.column_stack(columns), torque[used]
    # Normal equations by blocks of time, so that leaving out one block is a subtraction.
    block = (used * settings.blocks) // len(v)
    XX = np.array([X[block == k].T @ X[block == k] for k in range(settings.blocks)])
    Xy = np.array([X[block == k].T @ y[block == k] for k in range(settings.blocks)])
    best = np.linalg.lstsq(XX.sum(axis=0), Xy.sum(axis=0), rcond=None)[0]
    parts = [
        np.linalg.lstsq(XX.sum(axis=0) - XX[k], Xy.sum(axis=0) - Xy[k], rcond=None)[0]
        for k in range(settings.blocks)
        if XX[k].any()
    ]
    m = len(parts)
    deviation = np.array(parts) - np.mean(parts, axis=0)
    error = float(student.ppf(0.975, m - 1)) * np.sqrt((m - 1) / m * np.square(deviation).sum(axis=0))
    residual = float(np.sqrt(np.mean(np.square(y - X @ best))))
    viscous = (float(best[2]), float(error[2])) if has_speeds else (np.nan, np.nan)
    return float(best[0]), float(error[0]), *viscous, float(best[1]), residual, float(count)
