"""The commands of ``graspforce glove``: a guided calibration, and a glove that leads a simulated hand over streams."""

from __future__ import annotations

import stat
import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np
from rich.console import Console

from graspforce.cli.console import progress_console
from graspforce.cli.interruption import Interruption
from graspforce.cli.json_output import put_result
from graspforce.cli.run_free import joint_stepper
from graspforce.cli.run_simulation import ServiceOptions, SimulateOutput
from graspforce.cli.run_simulation import run as run_simulation
from graspforce.cli.simulate_options import SimulateOptions
from graspforce.cli.tables import make_table
from graspforce.control.joints.joint_controller import JointController
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput
from graspforce.grasp.grasp import Grasp
from graspforce.grasp.search import travel_limits
from graspforce.hand.collision import HandCollision
from graspforce.hand.hand import Hand
from graspforce.learning.glove.calibration import GloveCalibration
from graspforce.learning.glove.frames import GloveFrames, LiveFrames, RecordedFrames, guided_readings, load_frames
from graspforce.learning.glove.glove_inputs import (
    GloveApproach,
    GloveHold,
    GloveOperator,
    GloveReference,
    neutral_correspondence,
)
from graspforce.learning.glove.teleoperation import TeleoperationLimits
from graspforce.learning.posture_library import PostureLibrary
from graspforce.simulation import Reference
from graspforce.simulation.free_hand.free_plant import FreeHandPlant
from graspforce.simulation.free_hand.joint_run import run_joints
from graspforce.simulation.plants.engine_settings import EngineSettings

LIVE_DURATION = 10.0  # s, without --duration
STANDARD_INPUT = "-"
_FREQUENCY = 10.0  # Hz, of the law of a hand without an object
_LEAST_TRAVEL = 1e-3  # m
_TRIES = 200  # random postures for each that is kept
_FIRST_JOINTS = 3  # joints that the guide names for each posture at least
_CHANGE = np.radians(10.0)  # rad: joints that move more than this from the posture before are named


@dataclass(frozen=True, slots=True)
class GloveOptions:
    """The glove of a command.

    Args:
        frames: file or device of the frames; - for standard input.
        calibration: file of the calibration.
        model: hand whose joints the calibration has; None for the hand that is led.
        pairs: ``FINGER=MODEL_FINGER,…``; None for the common names.
        glove_rate: frames per second of a file, Hz.
        largest_travel: largest displacement of a held object, m; its grasp may allow less.
        gain: object displacement over that of the fingertips.

    Raises:
        InvalidInput: names the option and the allowed values.
    """

    frames: str
    calibration: Path
    model: str | None = None
    pairs: str | None = None
    glove_rate: float = 60.0
    largest_travel: float = 0.005
    gain: float = 1.0

    def __post_init__(self) -> None:
        for name in ("glove_rate", "largest_travel", "gain"):
            arrays.check_number(getattr(self, name), f"--{name.replace('_', '-')}", above=0.0)

    def operator(self, hand: Hand) -> GloveOperator:
        """Return the operator that leads a hand.

        Args:
            hand: the hand.

        Raises:
            InvalidInput: the calibration or the fingers do not suit the hands.
            UnknownName: a hand or a finger is not found.
            OSError: the calibration cannot be read.
        """
        model = hand if self.model is None else Hand.load(self.model)
        correspondence = neutral_correspondence(model, hand, self._fingers(model, hand))
        return GloveOperator(GloveCalibration.load(self.calibration), model, correspondence)

    def _fingers(self, model: Hand, hand: Hand) -> Mapping[str, str]:
        """Return the model's finger for each finger that follows."""
        if self.pairs is None:
            own = {finger.name for finger in model.fingers}
            common = {finger.name: finger.name for finger in hand.fingers if finger.name in own}
            if not common:
                allowed = f"given, because no finger of {hand.name} has the name of one of {model.name}"
                raise InvalidInput("--pairs", self.pairs, allowed)
            return common
        fingers = {}
        for part in self.pairs.split(","):
            name, separator, source = part.partition("=")
            if not separator:
                raise InvalidInput("--pairs", self.pairs, "FINGER=MODEL_FINGER, separated by commas")
            fingers[name] = source
        return fingers


def calibration_postures(hand: Hand, count: int, seed: int) -> PostureLibrary:
    """Return postures for a calibration: neutral, then random ones whose links do not touch.

    Args:
        hand: the hand.
        count: number of postures, ≥ 10.
        seed: seed of the postures.

    Raises:
        InvalidInput: fewer than ten postures, or none without collisions was found.
    """
    if count < 10:
        raise InvalidInput("--count", count, "at least 10")
    rng, collision = np.random.default_rng(seed), HandCollision(hand)
    kept = [np.array(hand.neutral)]
    for _ in range(_TRIES * count):
        q = rng.uniform(hand.q_lower, hand.q_upper)
        gaps = collision.link_gaps(q)
        if not gaps or gaps[0].distance >= 0.0:
            kept.append(q)
        if len(kept) == count:
            return PostureLibrary(hand.joint_names, freeze(np.array(kept)))
    raise InvalidInput("--count", count, f"at most {len(kept)}: the links touch in other random postures")


def guided(library: PostureLibrary, frames: str, per_posture: int, skipped: int, console: Console) -> Array:
    """Show one posture after the other, and return the mean readings (N, m) of a running glove in them.

    Args:
        library: the postures.
        frames: device of the frames; - for standard input.
        per_posture: number of frames to average in each.
        skipped: number of frames to skip before each, while the operator takes the posture.
        console: shows the postures.

    Raises:
        InvalidInput: a line is not a frame, or the frames end too early.
        OSError: the device cannot be read.
    """
    if per_posture < 1:
        raise InvalidInput("--per-posture", per_posture, "at least 1")
    if skipped < 0:
        raise InvalidInput("--skip", skipped, "at least 0")
    found = []
    with _opened(frames) as lines:
        means = guided_readings(lines, len(library), per_posture, skipped)
        for k in range(len(library)):
            console.print(f"Posture {k + 1} of {len(library)}: {_described(library, k)}", soft_wrap=True)
            found.append(next(means))
    return freeze(np.array(found))


def _described(library: PostureLibrary, k: int) -> str:
    """Return the joints that move to a posture from the one before, the largest motion first."""
    change = np.abs(library.q[k] - library.q[k - 1]) if k else np.full(len(library.joints), np.inf)
    order = np.argsort(-change, kind="stable")
    count = max(_FIRST_JOINTS, int((change > _CHANGE).sum()))
    return ", ".join(f"{library.joints[j]} {np.degrees(library.q[k, j]):.0f}°" for j in order[:count])


def hold(
    glove: GloveOptions,
    options: SimulateOptions,
    output: SimulateOutput,
    console: Console,
    service: ServiceOptions | None,
) -> bool:
    """Let a held object follow the glove in simulation; the controller certifies the forces.

    Args:
        glove: the glove.
        options: the simulation; its duration is that of recorded frames if it is infinite.
        output: files and windows.
        console: shows progress and results.
        service: where the controller runs; None for this process.

    Returns:
        Whether all fingertips kept contact and none slipped.

    Raises:
        InvalidInput: an option is impossible, or no grasp was found.
        ServiceError: the service is missing or does not serve the hand.
    """
    operator = glove.operator(options.grasp.hand)
    with _source(glove, operator) as frames:

        def reference_of(_: SimulateOptions, grasp: Grasp) -> Reference:
            largest = min(limit.distance for limit in travel_limits(grasp, glove.largest_travel))
            limits = TeleoperationLimits(travel=max(largest, _LEAST_TRAVEL))
            console.print(f"The glove moves the object by {1e3 * limits.travel:.1f} mm at most.")
            return GloveReference(GloveHold(grasp, operator, limits, glove.gain), frames, EngineSettings().dt)

        return run_simulation(options, output, console, service, reference_of)


def approach(
    glove: GloveOptions, hand: Hand, duration: float, gravity_H: Array, console: Console, service: ServiceOptions | None
) -> None:
    """Let a hand without an object follow the glove in simulation.

    Args:
        glove: the glove.
        hand: the hand.
        duration: simulated time, s.
        gravity_H: (3,) acceleration of gravity in H, m/s².
        console: shows progress and results.
        service: where the law runs; None for this process.

    Raises:
        InvalidInput: an option is impossible.
        ServiceError: the service is missing or does not serve the hand.
    """
    operator = glove.operator(hand)
    plant = FreeHandPlant(hand, gravity_H=gravity_H)
    controller = JointController.with_frequency(hand, "computed_torque", _FREQUENCY, gravity_H)
    with _source(glove, operator) as frames, ExitStack() as stack:
        stepper = joint_stepper(controller, plant.dt, service, console, stack)
        reference = GloveReference(GloveApproach(hand, operator), frames, plant.dt)
        stack.enter_context(progress_console().status(f"Simulating {duration:g} s"))
        interruption = stack.enter_context(Interruption())
        run = run_joints(plant, stepper, reference, duration, lambda _: not interruption.is_requested)
    errors = np.degrees(np.sqrt(np.square(run.q - run.q_desired).mean(axis=0)))
    travel = np.degrees(np.ptp(run.q, axis=0))
    columns = [
        ("joint", list(run.joints)),
        ("travel", [f"{x:.1f}°" for x in travel]),
        ("tracking error, RMS", [f"{x:.2f}°" for x in errors]),
    ]
    console.print(f"{hand.name} follows {reference.taken} frames of the glove in {run.t[-1] + plant.dt:.3g} s.")
    console.print(make_table(columns))
    put_result(console, {"hand": hand.name, "frames": reference.taken, "tracking_error": np.radians(errors)})


def stream_duration(glove: GloveOptions, duration: float | None) -> float:
    """Return the simulated time, s: by default that of recorded frames, and 10 s with a running glove.

    Args:
        glove: the glove.
        duration: of the option; None for the default.

    Raises:
        InvalidInput: not positive, or the file has no frames.
        OSError: the file cannot be read.
    """
    if duration is not None:
        return arrays.check_number(duration, "--duration", above=0.0)
    return LIVE_DURATION if _is_live(glove.frames) else len(load_frames(glove.frames)) / glove.glove_rate


@contextmanager
def _source(glove: GloveOptions, operator: GloveOperator) -> Iterator[GloveFrames]:
    """Return the frames: those of a file at their rate, those of a device or of standard input as they arrive."""
    sensors = len(operator.calibration.centre)
    if not _is_live(glove.frames):
        yield RecordedFrames(load_frames(glove.frames, sensors), glove.glove_rate)
        return
    with _opened(glove.frames) as lines:
        yield LiveFrames(lines, sensors)


def _is_live(frames: str) -> bool:
    """Return whether frames arrive while they are read: standard input, a pipe or a device."""
    return frames == STANDARD_INPUT or not stat.S_ISREG(Path(frames).stat().st_mode)


@contextmanager
def _opened(frames: str) -> Iterator[TextIO]:
    """Open a file or a device of frames, or return standard input."""
    if frames == STANDARD_INPUT:
        yield sys.stdin
        return
    with Path(frames).open(encoding="utf-8", errors="replace") as lines:
        yield lines
