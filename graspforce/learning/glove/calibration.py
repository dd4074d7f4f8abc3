"""Calibration of a glove: joint positions from sensor readings, fitted to paired postures.

Two regressions are compared by cross-validation, each over a grid of its parameters, and the better one is kept:

    linear   q = c + B s
    kernel   q = c + B s + Σ_j α_j exp(−γ ‖s − s_j‖²)

The linear part is a ridge regression. All sensors may act on each joint, so that cross-talk between sensors is removed.
Readings are divided by their standard deviations first. Sources: Hastie, Tibshirani and Friedman (2009); HANDLE project,
Parameterizing and creating new actions (undated), section 2.3, for the linear form and the sequence of postures.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, fields, json_text
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.core.optional_libraries import optional_imports
from graspforce.core.records import set_fields
from graspforce.core.whole_file import write_text
from graspforce.learning.glove.frames import load_frames

SCHEMA = "graspforce/glove_calibration/1"
METHODS = ("linear", "kernel")
_FOLDS = 5
_RIDGES = (1e-6, 1e-4, 1e-3, 1e-2, 1e-1, 1.0)  # times the number of pairs
_WIDTHS = (0.01, 0.03, 0.1)  # γ, times 1/m for m sensors of unit variance
_CONSTANT = 1e-12  # standard deviation of a sensor that does not react, in the unit of its readings


@dataclass(frozen=True, eq=False, slots=True)
class GloveCalibration:
    """The fitted map from readings to joint positions.

    Args:
        joints: names of the n joints.
        method: "linear" or "kernel".
        centre: (m,) mean reading of each sensor.
        scale: (m,) standard deviation of each sensor's readings, > 0.
        constant: (n,) c, rad.
        slope: (n, m) B, rad per standard deviation.
        places: (N, m) scaled readings s_j of the kernel; (0, m) without kernel.
        weights: (N, n) α, rad.
        width: γ, ≥ 0.
        rms: (n,) root mean square error of each joint in cross-validation, rad.
        mean_error: (n,) mean magnitude of the error of each joint in cross-validation, rad.

    Raises:
        InvalidInput: names the field and what is allowed.
    """

    joints: tuple[str, ...]
    method: str
    centre: Array
    scale: Array
    constant: Array
    slope: Array
    places: Array
    weights: Array
    width: float
    rms: Array
    mean_error: Array

    def __post_init__(self) -> None:
        joints = tuple(fields.check_text(name, "joints") for name in self.joints)
        n, centre = len(joints), arrays.check_array(self.centre, "centre", (None,))
        m, N = len(centre), np.shape(self.places)[0] if np.ndim(self.places) else 0
        places = np.reshape(np.asarray(self.places, dtype=np.float64), (N, m)) if N == 0 else self.places
        weights = np.reshape(np.asarray(self.weights, dtype=np.float64), (N, n)) if N == 0 else self.weights
        set_fields(
            self,
            joints=joints,
            method=fields.check_choice(self.method, "method", METHODS),
            centre=centre,
            scale=arrays.check_array(self.scale, "scale", (m,), above=0.0),
            constant=arrays.check_array(self.constant, "constant", (n,)),
            slope=arrays.check_array(self.slope, "slope", (n, m)),
            places=arrays.check_array(places, "places", (N, m)),
            weights=arrays.check_array(weights, "weights", (N, n)),
            width=arrays.check_number(self.width, "width", minimum=0.0),
            rms=arrays.check_array(self.rms, "rms", (n,), minimum=0.0),
            mean_error=arrays.check_array(self.mean_error, "mean_error", (n,), minimum=0.0),
        )

    def posture(self, reading: npt.ArrayLike) -> Array:
        """Return the joint positions of one frame, (n,), rad; joint limits are not applied.

        Args:
            reading: (m,) readings of the sensors.

        Raises:
            InvalidInput: not as many finite numbers as sensors.
        """
        return freeze(self.postures(arrays.check_array(reading, "reading", (len(self.centre),))[None])[0])

    def postures(self, readings: npt.ArrayLike) -> Array:
        """Return the joint positions of several frames, (T, n), rad.

        Args:
            readings: (T, m) readings of the sensors.

        Raises:
            InvalidInput: another shape, or numbers that are not finite.
        """
        s = (arrays.check_array(readings, "readings", (None, len(self.centre))) - self.centre) / self.scale
        q = self.constant + s @ self.slope.T
        if len(self.places):
            q = q + _kernel(s, self.places, self.width) @ self.weights
        return freeze(q)

    def drift(self, readings: npt.ArrayLike, q: npt.ArrayLike, factor: float = 4.0) -> GloveDrift:
        """Compare readings of a known posture, such as the flat hand, with the calibration.

        Args:
            readings: (T, m) readings while the posture is kept.
            q: (n,) the posture, rad.
            factor: errors above this factor times a joint's RMS error in cross-validation count as drift, > 0.

        Raises:
            InvalidInput: an argument is not allowed.
        """
        factor = arrays.check_number(factor, "factor", above=0.0)
        q = arrays.check_array(q, "q", (len(self.joints),))
        found = self.postures(readings)
        if not len(found):
            raise InvalidInput("readings", readings, "at least one frame")
        error = found.mean(axis=0) - q
        drifted = np.abs(error) > factor * self.rms
        names = tuple(name for name, one in zip(self.joints, drifted.tolist(), strict=True) if one)
        return GloveDrift(names, freeze(error))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the calibration as JSON.

        Args:
            path: the file.

        Raises:
            OSError: the file cannot be written.
        """
        record: dict[str, Any] = {"schema": SCHEMA, "joints": list(self.joints), "method": self.method, "width": self.width}
        record.update({name: getattr(self, name).tolist() for name in _ARRAYS})
        write_text(path, json.dumps(record) + "\n")

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> GloveCalibration:
        """Read a calibration.

        Args:
            path: the file.

        Raises:
            InvalidInput: not such a file.
            OSError: the file cannot be read.
        """
        record = fields.check_record(json_text.read(path), "", required=["schema", "joints", "method", "width", *_ARRAYS])
        if record.pop("schema") != SCHEMA:
            raise InvalidInput("schema", str(path), SCHEMA)
        return cls(**{**record, "joints": tuple(fields.check_sequence(record["joints"], "joints"))})


_ARRAYS = ("centre", "scale", "constant", "slope", "places", "weights", "rms", "mean_error")


@dataclass(frozen=True, eq=False, slots=True)
class GloveDrift:
    """Difference of a glove from its calibration in a known posture.

    Attributes:
        joints: names of the joints whose error exceeds the limit.
        error: (n,) mean error of each joint, rad.
    """

    joints: tuple[str, ...]
    error: Array


def calibrate_glove(
    readings: npt.ArrayLike, joints: tuple[str, ...], q: npt.ArrayLike, method: str | None = None
) -> GloveCalibration:
    """Fit joint positions to the readings of a glove.

    Args:
        readings: (N, m) readings of the sensors in N postures, averaged over some time each, N ≥ 10. Sensors that do not react
            have no effect.
        joints: names of the n joints.
        q: (N, n) joint positions in the postures, rad.
        method: "linear" or "kernel"; by default the one with the smaller error in cross-validation.

    Raises:
        InvalidInput: an argument is not allowed.
        MissingLibrary: scikit-learn is not installed.
    """
    s = arrays.check_array(readings, "readings", (None, None))
    targets = arrays.check_array(q, "q", (len(s), len(joints)))
    if len(s) < 2 * _FOLDS:
        raise InvalidInput("readings", f"{len(s)} postures", f"at least {2 * _FOLDS} postures")
    methods = METHODS if method is None else (fields.check_choice(method, "method", METHODS),)
    scale = np.where(s.std(axis=0) > _CONSTANT, s.std(axis=0), 1.0)
    scaled = (s - s.mean(axis=0)) / scale
    best: tuple[float, str, float, float, Array] | None = None
    for each in methods:
        for ridge in _RIDGES:
            for width in _WIDTHS if each == "kernel" else (0.0,):
                gamma = width / s.shape[1]
                errors = _cross_validated(scaled, targets, ridge, gamma)
                cost = float(np.square(errors).mean())
                if best is None or cost < best[0]:
                    best = (cost, each, ridge, gamma, errors)
    if best is None:  # not reached: there is at least one method
        raise InvalidInput("method", method, "a method")
    _, chosen, ridge, gamma, errors = best
    constant, slope, weights = _fit(scaled, targets, ridge, gamma)
    return GloveCalibration(
        joints=tuple(joints),
        method=chosen,
        centre=freeze(s.mean(axis=0)),
        scale=freeze(scale),
        constant=freeze(constant),
        slope=freeze(slope),
        places=freeze(scaled) if gamma else freeze(np.zeros((0, s.shape[1]))),
        weights=freeze(weights),
        width=gamma,
        rms=freeze(np.sqrt(np.square(errors).mean(axis=0))),
        mean_error=freeze(np.abs(errors).mean(axis=0)),
    )


def mean_readings(path: str | os.PathLike[str], postures: int) -> Array:
    """Return the mean readings (N, m) of postures that were recorded one after the other, with equally many frames each.

    Args:
        path: text file with a line of numbers for each frame, separated by commas.
        postures: number of postures N, ≥ 1.

    Raises:
        InvalidInput: not such a file, or a number of frames that is no multiple of the number of postures.
        OSError: the file cannot be read.
    """
    readings = load_frames(path)
    if len(readings) % postures:
        raise InvalidInput("frames", f"{len(readings)} frames", f"a multiple of {postures}, the number of postures")
    return freeze(readings.reshape(postures, -1, readings.shape[1]).mean(axis=1))


def _cross_validated(s: Array, q: Array, ridge: float, gamma: float) -> Array:
    """Return the errors (N, n) of all postures, each from a fit without its fold."""
    with optional_imports():
        from sklearn.model_selection import KFold
    errors = np.empty_like(q)
    for train, test in KFold(_FOLDS, shuffle=True, random_state=0).split(s):
        constant, slope, weights = _fit(s[train], q[train], ridge, gamma)
        predicted = constant + s[test] @ slope.T
        if gamma:
            predicted = predicted + _kernel(s[test], s[train], gamma) @ weights
        errors[test] = predicted - q[test]
    return errors


def _fit(s: Array, q: Array, ridge: float, gamma: float) -> tuple[Array, Array, Array]:
    """Return constant (n,), slope (n, m) and kernel weights (N or 0, n): a ridge regression, and one of its residuals."""
    from sklearn.kernel_ridge import KernelRidge
    from sklearn.linear_model import Ridge

    linear = Ridge(alpha=ridge * len(s) if not gamma else 1e-3 * len(s)).fit(s, q)
    slope = np.reshape(linear.coef_, (q.shape[1], s.shape[1]))
    constant = np.reshape(linear.intercept_, (q.shape[1],))
    if not gamma:
        return constant, slope, np.zeros((0, q.shape[1]))
    rest = q - constant - s @ slope.T
    kernel = KernelRidge(alpha=max(ridge, 1e-4), kernel="rbf", gamma=gamma).fit(s, rest)
    return constant, slope, np.asarray(kernel.dual_coef_)


def _kernel(a: Array, b: Array, gamma: float) -> Array:
    """Return exp(−γ ‖a_i − b_j‖²), (A, B)."""
    square = np.square(a).sum(axis=1)[:, None] + np.square(b).sum(axis=1) - 2.0 * a @ b.T
    return np.asarray(np.exp(-gamma * np.maximum(square, 0.0)))
