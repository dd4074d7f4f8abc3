"""The outcome of a run in a world: held or not, the first sign of trouble, and the figures that judge it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from graspforce.control.state import GraspState
from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.simulation.plants.plant_interface import PlantInterface
from graspforce.simulation.recordings.measured_recording import MeasuredRecording
from graspforce.simulation.recordings.recording_builder import ControllerCommand
from graspforce.simulation.recordings.sliding import SlidingMeter

Result = Literal["held", "dropped", "lost contact", "slipped", "no forces", "off target", "not started", "error"]
Sign = Literal["none", "slip", "contact lost", "no forces", "torque limit", "error"]

RESULTS: tuple[Result, ...] = (
    "held", "dropped", "lost contact", "slipped", "no forces", "off target", "not started", "error",
)  # fmt: skip
SIGNS: tuple[Sign, ...] = ("none", "slip", "contact lost", "no forces", "torque limit", "error")

_CHECK_STEPS = 50  # between two looks at the limits during a run
_CERTAIN = 1.05  # of a limit: the watch does not count the first step, the judge does


@dataclass(frozen=True, slots=True)
class OutcomeLimits:
    """Limits between a held object and a failure.

    Args:
        sliding: distance that a fingertip may slide on the object, m.
        absence: time that a fingertip may be without contact, or the controller without certified forces, s.
        distance: error of the object's displacement from its start at the end of the run, m.
        sign_time: time for which contact, forces or torque must be missing to count as the first sign of a failure, s. A
            fingertip that has been without contact for this time at the end of the run is a failure.

    Raises:
        InvalidInput: a limit is not above 0.
    """

    sliding: float = 1e-3
    absence: float = 0.1
    distance: float = 5e-3
    sign_time: float = 0.02

    def __post_init__(self) -> None:
        for each in dataclasses.fields(self):
            set_fields(self, **{each.name: arrays.check_number(getattr(self, each.name), each.name, above=0.0)})


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """Outcome of a run.

    Attributes:
        result: "held", or the gravest failure: "dropped", "lost contact", "slipped", "no forces", "off target" (in this
            order), "not started" if the grasp cannot hold its told weight, or "error" for an exception.
        sign: first sign of trouble; "none" for held objects.
        t: time of that sign, s; None without a sign.
        sliding: largest distance that a fingertip slid on the object while it was held, m.
        motion_rms: RMS error of the object's displacement from its start while it was held, m.
        motion_peak: the same, largest value.
        turn_peak: largest error of its rotation from the start while it was held, rad.
        peak_force: largest normal force, N.
        message: text of an exception, also of one after a drop; empty otherwise.
    """

    result: Result
    sign: Sign = "none"
    t: float | None = None
    sliding: float | None = None
    motion_rms: float | None = None
    motion_peak: float | None = None
    turn_peak: float | None = None
    peak_force: float | None = None
    message: str = ""

    @property
    def is_held(self) -> bool:
        """Whether the object was held to the end without a failure."""
        return self.result == "held"

    def to_dict(self) -> JsonRecord:
        """Return a plain record of all fields."""
        return dataclasses.asdict(self)

    @classmethod
    def from_dict(cls, record: object, field: str = "outcome") -> RunOutcome:
        """Read an outcome from a plain record.

        Args:
            record: as `to_dict` returns it.
            field: path of the record, for error messages.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        values = fields.check_record(record, field, required=[each.name for each in dataclasses.fields(cls)])
        fields.check_choice(values["result"], f"{field}.result", RESULTS)
        fields.check_choice(values["sign"], f"{field}.sign", SIGNS)
        fields.check_text(values["message"], f"{field}.message")
        for name in ("t", "sliding", "motion_rms", "motion_peak", "turn_peak", "peak_force"):
            if values[name] is not None:
                values[name] = arrays.check_number(values[name], f"{field}.{name}", minimum=0.0)
        return cls(**values)


class FailureWatch:
    """Detects during a run that it has failed, by the limits of `judge_run`.

    Args:
        plant: the plant, before its first step.
        limits: limits between a held object and a failure.
        grace: time for which the run goes on after a failure, which may be followed by a graver one, s.
    """

    def __init__(self, plant: PlantInterface, limits: OutcomeLimits, grace: float) -> None:
        self._limits, self._grace = limits, grace
        self._meter = SlidingMeter(plant.grasp, plant.dt)
        self._state: GraspState | None = None  # at the begin of the step
        self._absent = np.zeros(len(plant.grasp.fingers) + 1)  # s: each contact, then the forces
        self._steps, self._end = 0, math.inf

    def is_over(self, plant: PlantInterface, command: ControllerCommand) -> bool:
        """Return whether the run can end after this step.

        Args:
            plant: the plant after the step.
            command: the command of the step.
        """
        contacts = plant.true_contacts()
        missing = np.append(~contacts.touching, command.forces_reused)
        self._absent = (self._absent + plant.dt) * missing
        if self._state is not None:
            self._meter.add(self._state, contacts)
        self._state = plant.state()
        self._steps += 1
        if self._end == math.inf and self._steps % _CHECK_STEPS == 0:
            slides = self._meter.distances().max() > _CERTAIN * self._limits.sliding
            if slides or self._absent.max() > _CERTAIN * self._limits.absence:
                self._end = plant.t + self._grace
        return plant.t >= self._end


def judge_run(recording: MeasuredRecording, limits: OutcomeLimits | None = None) -> RunOutcome:
    """Return the outcome of a run, judged by the truth that the controller does not see.

    Args:
        recording: the run.
        limits: limits between a held object and a failure.
    """
    limits = limits or OutcomeLimits()
    r, drop_time = recording.truth, recording.drop_time
    held = r.t < drop_time if drop_time is not None else np.ones(len(r.t), dtype=np.bool_)
    held[0] = True  # figures of at least one step
    dt = r.t[1] - r.t[0] if len(r.t) > 1 else 1.0  # s
    reused = r.forces_reused > 0.0
    motion = np.linalg.norm(recording.motion_error, axis=1)
    apart = _run_lengths(r.touching == 0.0) * dt  # s

    result: Result = "held"
    if recording.is_dropped:
        result = "dropped"
    elif apart.max() > limits.absence or apart[-1].max() > limits.sign_time:
        result = "lost contact"
    elif recording.sliding.max() > limits.sliding:
        result = "slipped"
    elif _longest(reused[:, None], dt) > limits.absence:
        result = "no forces"
    elif motion[-1] > limits.distance:
        result = "off target"

    sign: Sign = "none"
    t = None
    if result != "held":
        t, sign = min(_signs(recording, limits, dt), default=(drop_time, "none"))
    return RunOutcome(
        result=result,
        sign=sign,
        t=t,
        sliding=float(recording.sliding[held].max()),
        motion_rms=float(np.sqrt(np.mean(motion[held] ** 2))),
        motion_peak=float(motion[held].max()),
        turn_peak=float(recording.turn_error[held].max()),
        peak_force=float(r.f[held, :, 2].max()),
        message=recording.controller_error,
    )


def _signs(recording: MeasuredRecording, limits: OutcomeLimits, dt: float) -> Iterator[tuple[float, Sign]]:
    """Generate the begin of each kind of trouble, s, with its name."""
    r, steps = recording.truth, max(round(limits.sign_time / dt), 1)
    slides = np.flatnonzero((recording.sliding > limits.sliding).any(axis=1))
    if len(slides):
        yield float(r.t[slides[0]]), "slip"
    flags: tuple[tuple[npt.NDArray[np.bool_], Sign], ...] = (
        (r.touching == 0.0, "contact lost"),
        (r.forces_reused[:, None] > 0.0, "no forces"),
        (r.saturated[:, None] > 0.0, "torque limit"),
    )
    for flag, sign in flags:
        lengths = _run_lengths(flag)
        rows = np.flatnonzero((lengths >= steps).any(axis=1))
        if len(rows):
            yield float(r.t[rows[0] - steps + 1]), sign


def _longest(flags: npt.NDArray[np.bool_], dt: float) -> float:
    """Return the longest time for which a column of flags is true without interruption, s."""
    return float(_run_lengths(flags).max() * dt)


def _run_lengths(flags: npt.NDArray[np.bool_]) -> Array:
    """Return for each row and column how many rows in succession have been true, this one included."""
    lengths = np.zeros(flags.shape)
    count = np.zeros(flags.shape[1])
    for i, row in enumerate(flags):
        count = (count + 1.0) * row
        lengths[i] = count
    return lengths
