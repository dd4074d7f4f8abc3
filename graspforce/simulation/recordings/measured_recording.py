"""Recordings of simulations in which the controller knows measurements only: the truth, the estimate and the camera's poses."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from graspforce.contact.motion import BodyMotion
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.estimation.estimate import GraspEstimate
from graspforce.simulation.recordings.recording import Recording

_ESTIMATE, _CAMERA = "estimate_", "camera_"  # prefixes of the arrays' names in a file


class StateEstimate(Protocol):
    """The fields of an estimate that are recorded, such as those of a `GraspState`.

    A `graspforce.estimation.GraspEstimate` is recorded with its fused pose and covariance.
    """

    @property
    def q(self) -> Array: ...  # pragma: no cover
    @property
    def v(self) -> Array: ...  # pragma: no cover
    @property
    def object(self) -> BodyMotion: ...  # pragma: no cover


@dataclass(frozen=True, eq=False, slots=True)
class EstimateHistory:
    """Estimated states, one row for each control period.

    Attributes:
        t: (m,) time for which each estimate holds, s. It may be later than the measurement, by a delay that is predicted.
        q: (m, n) joint positions, rad.
        v: (m, n) joint rates, rad/s.
        p_HO: (m, 3) best known position of the object in H, m.
        R_HO: (m, 3, 3) best known orientation of the object in H.
        twist: (m, 6) twist of the object in H, m/s and rad/s.
        deviation: (m, 6) standard deviations of the pose along and about H's axes, m and rad; NaN if they are not estimated.
    """

    t: Array
    q: Array
    v: Array
    p_HO: Array
    R_HO: Array
    twist: Array
    deviation: Array

    @classmethod
    def stack(cls, rows: Sequence[tuple[float, StateEstimate]]) -> EstimateHistory:
        """Return estimates as arrays.

        Args:
            rows: time in s, and estimate, of at least one control period.
        """
        motions = [estimate.fused_pose if isinstance(estimate, GraspEstimate) else estimate.object for _, estimate in rows]
        return cls(
            t=freeze([estimate.t if isinstance(estimate, GraspEstimate) else t for t, estimate in rows]),
            q=freeze([estimate.q for _, estimate in rows]),
            v=freeze([estimate.v for _, estimate in rows]),
            p_HO=freeze([motion.p_HO for motion in motions]),
            R_HO=freeze([motion.R_HO for motion in motions]),
            twist=freeze([motion.twist for motion in motions]),
            deviation=freeze([_deviation(estimate) for _, estimate in rows]),
        )


def _deviation(estimate: StateEstimate) -> Array:
    """Return the standard deviations of the pose, (6,); NaN if they are not estimated."""
    if isinstance(estimate, GraspEstimate):
        return np.sqrt(np.diag(estimate.fused_covariance))
    return np.full(6, np.nan)


@dataclass(frozen=True, eq=False, slots=True)
class CameraHistory:
    """Poses of the camera that arrived, one row for each.

    Attributes:
        t_image: (m,) time of the image, s.
        t_arrival: (m,) time of the measurement that contained the pose, s.
        p_HO: (m, 3) measured position of the object in H, m.
        R_HO: (m, 3, 3) measured orientation of the object in H.
    """

    t_image: Array
    t_arrival: Array
    p_HO: Array
    R_HO: Array


@dataclass(frozen=True, eq=False)
class MeasuredRecording:
    """A simulation with measurements: what happened, and what the controller knew.

    Attributes:
        truth: true states, forces and commands of every step of the plant.
        estimate: the controller's estimates; None if it has none.
        camera: poses of the camera that arrived.
        sliding: (s, N) distance that each fingertip has slid on the object, m; see `sliding_displacement`.
        drop_time: time at which the object was lost, s; None if it was held to the end.
        controller_error: text of the exception that the controller raised after that; empty without one.
    """

    truth: Recording
    estimate: EstimateHistory | None
    camera: CameraHistory
    sliding: Array
    drop_time: float | None
    controller_error: str = ""

    @property
    def is_dropped(self) -> bool:
        """Whether the object was lost."""
        return self.drop_time is not None

    @property
    def motion_error(self) -> Array:
        """(s, 3) true minus desired displacement since t = 0, in H, m.

        A controller without a camera cannot know where the object was at first; this error does not contain it.
        """
        error = self.truth.position_error
        return np.asarray(error - error[0])

    @property
    def turn_error(self) -> Array:
        """(s,) angle between the true and the desired rotation since t = 0, rad."""
        r = self.truth
        turned = r.R_HO @ r.R_HO[0].T
        desired = r.R_desired @ r.R_desired[0].T
        return np.asarray((Rotation.from_matrix(turned) * Rotation.from_matrix(desired).inv()).magnitude())

    def true_rows(self) -> npt.NDArray[np.intp]:
        """Return the steps of the truth that are closest to the times of the estimates, (m,).

        Raises:
            InvalidInput: the controller had no estimate.
        """
        if self.estimate is None:
            raise InvalidInput("estimate", None, "recorded; this controller has no estimate")
        t = self.truth.t
        after = np.clip(np.searchsorted(t, self.estimate.t), 1, max(len(t) - 1, 1))
        is_before = self.estimate.t - t[after - 1] < t[np.minimum(after, len(t) - 1)] - self.estimate.t
        return np.minimum(after - is_before, len(t) - 1)

    def estimation_error(self) -> Array:
        """Return the estimated minus the true pose at the times of the estimates.

        Returns:
            (m, 6) in H: position, m, and rotation vector from the true to the estimated orientation, rad.

        Raises:
            InvalidInput: the controller had no estimate.
        """
        rows, estimate = self.true_rows(), self.estimate
        assert estimate is not None  # true_rows() checks it
        turned = Rotation.from_matrix(estimate.R_HO) * Rotation.from_matrix(self.truth.R_HO[rows]).inv()
        return np.asarray(np.hstack([estimate.p_HO - self.truth.p_HO[rows], turned.as_rotvec()]))

    def tracking_error(self) -> Array:
        """Return the best known minus the desired pose at the times of the estimates: the error that the controller can know.

        Returns:
            (m, 6) in H: position, m, and rotation vector from the desired to the estimated orientation, rad.

        Raises:
            InvalidInput: the controller had no estimate.
        """
        rows, estimate = self.true_rows(), self.estimate
        assert estimate is not None  # true_rows() checks it
        turned = Rotation.from_matrix(estimate.R_HO) * Rotation.from_matrix(self.truth.R_desired[rows]).inv()
        return np.asarray(np.hstack([estimate.p_HO - self.truth.p_desired[rows], turned.as_rotvec()]))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a compressed NumPy archive (.npz), which `load`, `Recording.load` and `numpy.load` read.

        Args:
            path: the file.
        """
        drop = np.nan if self.drop_time is None else self.drop_time
        more: dict[str, Any] = {"sliding": self.sliding, "drop_time": np.array(drop)}
        more["controller_error"] = np.array(self.controller_error)
        more.update({_CAMERA + each.name: getattr(self.camera, each.name) for each in dataclasses.fields(self.camera)})
        if self.estimate is not None:
            more.update(
                {_ESTIMATE + each.name: getattr(self.estimate, each.name) for each in dataclasses.fields(self.estimate)}
            )
        self.truth.save(path, more)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> MeasuredRecording:
        """Return a recording that `save` wrote.

        Args:
            path: the file.

        Raises:
            InvalidInput: the file is missing, or is not such a recording.
        """
        truth = Recording.load(path)
        try:
            with Path(path).open("rb") as file, np.load(file, allow_pickle=False) as archive:
                camera = CameraHistory(*(freeze(archive[_CAMERA + each.name]) for each in dataclasses.fields(CameraHistory)))
                estimate = None
                if _ESTIMATE + "t" in archive:
                    names = [each.name for each in dataclasses.fields(EstimateHistory)]
                    estimate = EstimateHistory(*(freeze(archive[_ESTIMATE + name]) for name in names))
                sliding, drop = freeze(archive["sliding"]), float(archive["drop_time"])
                controller_error = str(archive["controller_error"])
        except (OSError, EOFError, ValueError, KeyError, BadZipFile) as error:
            raise InvalidInput("path", str(path), f"a recording with measurements: {error}") from None
        return cls(truth, estimate, camera, sliding, None if np.isnan(drop) else drop, controller_error)
