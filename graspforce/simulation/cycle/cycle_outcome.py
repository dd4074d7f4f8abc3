"""The outcome of a grasp cycle, judged by the true motion and the true forces."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from graspforce.core import fields
from graspforce.core.arrays import Array
from graspforce.core.json_text import JsonRecord
from graspforce.core.text_table import Table
from graspforce.geometry import Sphere, Superquadric
from graspforce.simulation.cycle.cycle_run import CycleRecording

LIFT_SHARE = 0.9  # of the lift height that the object must reach
PLACE_ERROR = 0.015  # m, along the table, between the object and its goal
TILT = math.radians(15.0)  # of the object at the end
_SETTLED = 0.05  # s after the start: the object rests on the table
_STANDING_LOAD = 0.9  # of the weight that the table carries at the end
_LAST_TIME = 0.1  # s at the end over which that load is averaged: a standing object may still rock


@dataclass(frozen=True, slots=True)
class CycleOutcome:
    """Outcome of a cycle.

    Attributes:
        status: "done", or the first of "stopped", "not lifted", "dropped", "not placed", "not released" that is true.
        message: reason of the controller's stop; empty for none.
        phase: last phase that ended, or the phase of the abort.
        moved_before_squeeze: displacement of the object from its start until the squeeze, m; NaN without a squeeze.
        turned_before_squeeze: its rotation, rad.
        peak_force: largest true normal force of a fingertip, N.
        peak_planned: largest planned normal force, N.
        least_margin: least true slip margin μ f_n − ‖f_t‖ of the fingers in lift and move, N; NaN without them.
        lift_height: largest height of the object above its start, m.
        place_error: distance of the object from its goal at the end, along the table, m.
        tilt: angle between the object's vertical axis at the start and at the end, rad; NaN for balls and superquadrics, which
            roll.
        duration: simulated time, s.
    """

    status: str
    message: str
    phase: str
    moved_before_squeeze: float
    turned_before_squeeze: float
    peak_force: float
    peak_planned: float
    least_margin: float
    lift_height: float
    place_error: float
    tilt: float
    duration: float

    @property
    def is_success(self) -> bool:
        """Whether the object was lifted, moved, placed and released."""
        return self.status == "done"

    @property
    def peak_ratio(self) -> float:
        """Largest true normal force divided by the largest planned one; NaN without planned forces."""
        return self.peak_force / self.peak_planned if self.peak_planned > 0.0 else float("nan")

    def to_dict(self) -> JsonRecord:
        """Return a plain record; NaN as null."""
        return {name: None if isinstance(x, float) and math.isnan(x) else x for name, x in asdict(self).items()}

    @classmethod
    def from_dict(cls, record: JsonRecord, field: str = "outcome") -> CycleOutcome:
        """Read an outcome from a plain record.

        Args:
            record: as `to_dict` returns it.
            field: path of the record, for errors.

        Raises:
            InvalidInput: a field is missing or unknown; names it with its path.
        """
        values = fields.check_record(record, field, required=list(cls.__dataclass_fields__))
        given: dict[str, Any] = {name: float("nan") if x is None else x for name, x in values.items()}
        return cls(**given)


def judge_cycle(recording: CycleRecording) -> CycleOutcome:
    """Return the outcome of a cycle.

    Args:
        recording: the recording.
    """
    up = -recording.scene.down
    place = recording.p_HO + recording.base  # m, relative to the table, in the axes of H
    height = (place - place[0]) @ up
    start = min(int(np.searchsorted(recording.t, _SETTLED)), len(recording.t) - 1)
    squeeze, held = recording.steps_of("squeeze"), recording.steps_of("lift", "move")
    moved = turned = float("nan")
    if len(squeeze):
        moved = float(np.linalg.norm(place[squeeze[0]] - place[start]))
        turned = _angle(recording.R_HO[start], recording.R_HO[squeeze[0]])
    margin = recording.mu * recording.f[held, :, 2] - np.linalg.norm(recording.f[held, :, :2], axis=2)
    shift = place[-1] - place[start] - _planned_move(recording)
    place_error = float(np.linalg.norm(shift - (shift @ up) * up))
    is_round = isinstance(recording.scene.grasp.body.shape, Sphere | Superquadric)
    down_O = recording.R_HO[start].T @ -up
    tilt = math.acos(min(1.0, max(-1.0, float((recording.R_HO[-1] @ down_O) @ -up))))
    peak_planned = float(recording.f_planned.max())
    outcome = CycleOutcome(
        status="done",
        message=recording.message,
        phase=recording.records[-1].phase if recording.records else recording.phase[-1],
        moved_before_squeeze=moved,
        turned_before_squeeze=turned,
        peak_force=float(recording.f[:, :, 2].max()),
        peak_planned=peak_planned,
        least_margin=float(margin.min()) if len(held) else float("nan"),
        lift_height=float(height.max()),
        place_error=place_error,
        tilt=float("nan") if is_round else tilt,
        duration=float(recording.t[-1]),
    )
    return _with_status(outcome, recording, height)


def _with_status(outcome: CycleOutcome, recording: CycleRecording, height: Array) -> CycleOutcome:
    """Return the outcome with its status."""
    target = LIFT_SHARE * float(np.linalg.norm(recording.lift))
    carried = recording.steps_of("move")
    status = "done"
    if recording.message:
        status = "stopped"
    elif outcome.lift_height < target:
        status = "not lifted"
    elif len(carried) and float(height[carried].min()) < 0.5 * target:
        status = "dropped"
    elif outcome.place_error > PLACE_ERROR or outcome.tilt > TILT:
        status = "not placed"
    elif _last_load(recording) < _STANDING_LOAD * recording.weight or recording.f[-1].any():
        status = "not released"
    return replace(outcome, status=status)


def _last_load(recording: CycleRecording) -> float:
    """Return the mean force of the table at the end, N."""
    return float(recording.table_force[recording.t > recording.t[-1] - _LAST_TIME].mean())


def phase_table(recording: CycleRecording) -> Table:
    """Return the table of the phases: duration, forces, motion of the object, margin, load of the table at the end, exit.

    Args:
        recording: the recording.
    """
    rows = []
    place = recording.p_HO + recording.base
    for record in recording.records:
        k = recording.steps_of(record.phase)
        k = k[(recording.t[k] >= record.start) & (recording.t[k] <= record.end)]
        if not len(k):
            continue
        margin = recording.slip_margin[k]
        travel = 1e3 * float(np.linalg.norm(place[k[-1]] - place[k[0]]))
        rows.append(
            (
                record.phase,
                f"{record.end - record.start:.2f}",
                f"{recording.f[k, :, 2].max():.2f}",
                f"{recording.f_planned[k].max():.2f}",
                f"{travel:.2f}",
                "" if np.isnan(margin).all() else f"{np.nanmin(margin):.2f}",
                f"{recording.table_force[k[-1]]:.2f}",
                f"aborted: {record.reason}" if record.is_aborted else record.reason,
            )
        )
    header = ("phase", "s", "peak N", "planned", "object mm", "margin", "table N", "ends with")
    return Table(header, tuple(rows), f"Cycle of {recording.scene.grasp.hand.name}")


def _planned_move(recording: CycleRecording) -> Array:
    """Return the displacement of the base along the table since the start of the lift, (3,), m; zero without a lift."""
    down, lift = recording.scene.down, recording.steps_of("lift")
    way = recording.base[-1] - recording.base[lift[0]] if len(lift) else np.zeros(3)
    return np.asarray(way - (way @ down) * down)


def _angle(R: Array, other: Array) -> float:
    """Return the angle between two orientations, rad."""
    return math.acos(min(1.0, max(-1.0, 0.5 * (float(np.trace(R.T @ other)) - 1.0))))
