"""What happened, step by step, in frozen arrays; kept as a file; and the figures that judge it."""

from __future__ import annotations

import dataclasses
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from scipy.spatial.transform import Rotation

from graspforce.contact import friction
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput

_SCHEMA = "graspforce/recording/1"
_TEXT_FIELDS = ("hand", "fingers", "joints", "warnings")
_SLIP_TOLERANCE = 1e-6  # of the largest friction: a contact that has less left slides; a thousand times what the engine leaves
_STATIC_ARRAYS = ("torque_lower", "torque_upper")  # arrays that do not grow with the steps


@dataclass(frozen=True, eq=False)
class Recording:
    """A run of s steps of n motors and N contacts. Row i is what was so at t[i], and what acted in the step that began then.

    Attributes:
        hand: its name.
        fingers: N names.
        joints: n names, of the motors.
        warnings: (when, what): the controller's sentences, each at the first step of a row of steps that say it.
        t: (s,) s.
        q, v: (s, n) the true joint positions and rates, rad and rad/s.
        p_HO, R_HO, twist: (s, 3), (s, 3, 3), (s, 6) the object's true motion, in H.
        p_desired, R_desired, twist_desired: the same of the reference.
        tau_command, tau: (s, n) what was asked of the motors and what acted at the joints, N·m.
        torque_lower, torque_upper: (n,) the motors' limits, N·m.
        planned, planned_R_OC: (s, N, 4), (s, N, 3, 3) the controller's forces, padded, and their frames in O.
        planned_margin: (s, N) the slip margin that the controller believes in, N.
        touching: (s, N) 1 where the fingertip touches.
        f, p_OC, R_OC: (s, N, 4), (s, N, 3), (s, N, 3, 3) the plant's contact forces, padded, where, and their frames in O.
        mu, gamma: (s, N) the plant's friction.
        depth: (s, N) how far the engine let the surfaces sink into each other, m.
        held, saturated: (s,) 1 where the controller held its last forces, and where a motor was at its limit.
    """

    hand: str
    fingers: tuple[str, ...]
    joints: tuple[str, ...]
    warnings: tuple[tuple[float, str], ...]
    t: Array
    q: Array
    v: Array
    p_HO: Array
    R_HO: Array
    twist: Array
    p_desired: Array
    R_desired: Array
    twist_desired: Array
    tau_command: Array
    tau: Array
    torque_lower: Array
    torque_upper: Array
    planned: Array
    planned_R_OC: Array
    planned_margin: Array
    touching: Array
    f: Array
    p_OC: Array
    R_OC: Array
    mu: Array
    gamma: Array
    depth: Array
    held: Array
    saturated: Array

    @property
    def error(self) -> Array:
        """(s, 3) where the object is less where it should be, in H, m."""
        return np.asarray(self.p_HO - self.p_desired)

    @property
    def orientation_error(self) -> Array:
        """(s, 3) the rotation from the desired to the true attitude, in H, rad."""
        return np.asarray((Rotation.from_matrix(self.R_HO) * Rotation.from_matrix(self.R_desired).inv()).as_rotvec())

    @property
    def slip_margin(self) -> Array:
        """(s, N) the friction that the plant's forces leave, μ f_n − load, N."""
        return friction.slip_margin(self.f, self.mu, self.gamma)

    @property
    def violation(self) -> Array:
        """(s, N) how far the plant's forces are outside the plant's cones, N."""
        return friction.violation(self.f, self.mu, self.gamma)

    def since(self, start: float) -> Recording:
        """The steps from an instant on, without what came before."""
        kept = self.t >= start
        rows: dict[str, Any] = {
            name: freeze(getattr(self, name)[kept]) for name in _array_names() if name not in _STATIC_ARRAYS
        }
        return dataclasses.replace(self, warnings=tuple((t, text) for t, text in self.warnings if t >= start), **rows)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write it as a NumPy archive (.npz), compressed; any NumPy reads it."""
        words = {"schema": _SCHEMA, **{name: getattr(self, name) for name in _TEXT_FIELDS}}
        with Path(path).open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, words=np.array(json.dumps(words)), **_arrays(self))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Recording:
        """Read what `save` wrote.

        Raises:
            InvalidInput: the file is not there, or is no recording.
        """
        try:
            with Path(path).open("rb") as file, np.load(file, allow_pickle=False) as archive:
                words = json.loads(str(archive["words"]))
                arrays = {name: freeze(archive[name]) for name in _array_names()}
        except (OSError, EOFError, ValueError, KeyError, BadZipFile) as error:
            raise InvalidInput("path", str(path), f"a recording: {error}") from None
        if words.pop("schema", None) != _SCHEMA:
            raise InvalidInput("path", str(path), f"a recording of schema {_SCHEMA}")
        warnings = tuple((float(t), str(text)) for t, text in words["warnings"])
        return cls(words["hand"], tuple(words["fingers"]), tuple(words["joints"]), warnings, **arrays)


@dataclass(frozen=True, slots=True)
class RunMetrics:
    """The figures that judge a run.

    Attributes:
        position_error_rms, position_error_peak: the distance between where the object is and where it should be, m.
        orientation_error_rms, orientation_error_peak: likewise its attitude, rad.
        min_slip_margin: the least friction that the plant's contacts had left, N.
        min_planned_margin: the least that the controller planned for, N.
        force_error: RMS of the planned less the plant's contact forces (as vectors), as a part of the plant's RMS.
        outside: the most by which a contact force of the plant was outside its cone while that contact's planned margin was
            positive, N.
        max_torque_fraction: the largest torque, as a part of its motor's limit.
        lost: steps in which some fingertip did not touch.
        slid: steps in which some fingertip touched with no friction left: it slid. An engine keeps forces in its cones, so that
            sliding shows as a force on the edge, never as one outside.
        held, saturated: steps in which the controller held its last forces; in which a motor was at its limit.
    """

    position_error_rms: float
    position_error_peak: float
    orientation_error_rms: float
    orientation_error_peak: float
    min_slip_margin: float
    min_planned_margin: float
    force_error: float
    max_cone_violation: float
    max_torque_fraction: float
    lost_contact_steps: int
    slip_steps: int
    held: int
    saturated: int


def compute_metrics(recording: Recording) -> RunMetrics:
    """Judge a run, or a part of one: `Recording.since`."""
    away = np.linalg.norm(recording.error, axis=1)
    turned = np.linalg.norm(recording.orientation_error, axis=1)
    f_plant = np.einsum("sncj,snj->snc", recording.R_OC, recording.f[..., :3])  # N, in O
    planned = np.einsum("sncj,snj->snc", recording.planned_R_OC, recording.planned[..., :3])
    max_cone_violation = np.where(recording.planned_margin > 0.0, recording.violation, 0.0)
    bound = recording.mu * recording.f[..., 2]  # N
    margin = recording.slip_margin
    sliding = (recording.touching > 0.0) & (recording.mu > 0.0) & (margin <= _SLIP_TOLERANCE * bound)
    limit = np.where(recording.tau >= 0.0, recording.torque_upper, -recording.torque_lower)
    return RunMetrics(
        position_error_rms=_rms(away),
        position_error_peak=float(away.max()),
        orientation_error_rms=_rms(turned),
        orientation_error_peak=float(turned.max()),
        min_slip_margin=float(margin.min()),
        min_planned_margin=float(recording.planned_margin.min()),
        force_error=_rms(planned - f_plant) / max(_rms(f_plant), 1e-12),
        max_cone_violation=float(max_cone_violation.max()),
        max_torque_fraction=float((np.abs(recording.tau) / limit).max()),
        lost_contact_steps=int((recording.touching.min(axis=1) == 0.0).sum()),
        slip_steps=int(sliding.any(axis=1).sum()),
        held=int(recording.held.sum()),
        saturated=int(recording.saturated.sum()),
    )


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


def _array_names() -> list[str]:
    return [each.name for each in dataclasses.fields(Recording) if each.name not in _TEXT_FIELDS]


def _arrays(recording: Recording) -> dict[str, Any]:
    return {name: getattr(recording, name) for name in _array_names()}
