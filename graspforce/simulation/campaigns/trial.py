"""One trial of a campaign: a random world, the controller in it, and a controller with full knowledge of it."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Literal

from graspforce.control.settings import ControlSettings
from graspforce.core import arrays, fields
from graspforce.core.errors import GraspForceError, InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import set_fields
from graspforce.estimation.sensor_model import SensorModel
from graspforce.grasp.grasp import Grasp
from graspforce.simulation.campaigns.outcome import FailureWatch, OutcomeLimits, RunOutcome, judge_run
from graspforce.simulation.loops.comparison_controllers import ExactController, exact_settings
from graspforce.simulation.loops.measured_loop import MeasuredController, simulate_measured
from graspforce.simulation.loops.reference import Reference
from graspforce.simulation.plants.plant_interface import PlantInterface
from graspforce.simulation.recordings.recording_builder import ControllerCommand
from graspforce.simulation.worlds.world import MAX_SEED, World
from graspforce.simulation.worlds.world_plants import PLANT_NAMES, PlantName, make_world_plant

ControllerFactory = Callable[[Grasp, ControlSettings, SensorModel], MeasuredController]
Comparison = Literal["always", "failures", "never"]

COMPARISONS: tuple[Comparison, ...] = ("always", "failures", "never")

_GRACE = 0.5  # s: a failed run goes on, because a graver failure may follow


@dataclass(frozen=True, eq=False, slots=True)
class CampaignSetup:
    """What the trials of a campaign have in common. It is sent to worker processes: functions must be importable by name.

    A run of the controller ends 0.5 s after it has failed, one of the controller with full knowledge at once.

    Args:
        grasps: label and grasp that the controller is told, such as ("allegro_right sphere:0.03", grasp).
        controller: makes the controller from the grasp, the settings and the sensors' model of the world.
        reference: makes the desired motion of a grasp.
        duration: simulated time of a run, s.
        settings: settings of the controllers; their period is that of the world's sensors.
        draw: makes the world of a seed, for a hand with a least torque limit in N·m.
        plant: plant of the runs, "links" or "urdf".
        limits: limits between a held object and a failure.
        comparison: worlds in which a controller with full knowledge runs too: "always", "failures" of the controller, "never".
        wall_limit: wall-clock time of a run after which it counts as an error, s.

    Raises:
        InvalidInput: names the field and the allowed values.
    """

    grasps: tuple[tuple[str, Grasp], ...]
    controller: ControllerFactory
    reference: Callable[[Grasp], Reference]
    duration: float
    settings: ControlSettings
    draw: Callable[[int, float], World] = World.real
    plant: PlantName = "links"
    limits: OutcomeLimits = field(default_factory=OutcomeLimits)
    comparison: Comparison = "failures"
    wall_limit: float = 600.0

    def __post_init__(self) -> None:
        if not self.grasps or len({label for label, _ in self.grasps}) != len(self.grasps):
            raise InvalidInput("grasps", [label for label, _ in self.grasps], "at least one grasp, each with its own label")
        for name in ("duration", "wall_limit"):
            set_fields(self, **{name: arrays.check_number(getattr(self, name), name, above=0.0)})
        fields.check_choice(self.plant, "plant", PLANT_NAMES)
        fields.check_choice(self.comparison, "comparison", COMPARISONS)


@dataclass(frozen=True, slots=True)
class TrialRecord:
    """A trial of a campaign.

    Attributes:
        grasp: label of the grasp.
        seed: seed of the world.
        world: the world.
        controller: outcome of the controller.
        exact: outcome of the controller with full knowledge; None if it did not run.
        seconds: wall-clock time of the trial, s.
    """

    grasp: str
    seed: int
    world: World
    controller: RunOutcome
    exact: RunOutcome | None
    seconds: float

    def to_dict(self) -> JsonRecord:
        """Return a plain record of all fields."""
        return {
            "grasp": self.grasp,
            "seed": self.seed,
            "world": self.world.to_dict(),
            "controller": self.controller.to_dict(),
            "exact": None if self.exact is None else self.exact.to_dict(),
            "seconds": self.seconds,
        }

    @classmethod
    def from_dict(cls, record: object, field: str = "trial") -> TrialRecord:
        """Read a trial from a plain record.

        Args:
            record: as `to_dict` returns it.
            field: path of the record, for error messages.

        Raises:
            InvalidInput: a field is missing, unknown or out of range; names it with its path.
        """
        names = ["grasp", "seed", "world", "controller", "exact", "seconds"]
        values = fields.check_record(record, field, required=names)
        exact = values["exact"]
        return cls(
            grasp=fields.check_text(values["grasp"], f"{field}.grasp"),
            seed=fields.check_integer(values["seed"], f"{field}.seed", minimum=0, maximum=MAX_SEED),
            world=World.from_dict(values["world"], f"{field}.world"),
            controller=RunOutcome.from_dict(values["controller"], f"{field}.controller"),
            exact=None if exact is None else RunOutcome.from_dict(exact, f"{field}.exact"),
            seconds=arrays.check_number(values["seconds"], f"{field}.seconds", minimum=0.0),
        )


def run_trial(setup: CampaignSetup, label: str, seed: int) -> TrialRecord:
    """Draw a world and run it. An exception in a run is an outcome of that run.

    Args:
        setup: the campaign.
        label: label of one of its grasps.
        seed: seed of the world.
    """
    start = time.monotonic()
    grasp = dict(setup.grasps)[label]
    world = setup.draw(seed, float(grasp.hand.torque_upper.min()))

    def make(_: PlantInterface, told: Grasp, settings: ControlSettings) -> MeasuredController:
        return _WithoutEstimate(setup.controller(told, settings, world.sensors))

    outcome = _run(setup, grasp, world, make, _GRACE)
    exact = None
    if setup.comparison == "always" or (setup.comparison == "failures" and not outcome.is_held):
        exact = _run_exact(setup, grasp, world)
    return TrialRecord(label, seed, world, outcome, exact, time.monotonic() - start)


def _run_exact(setup: CampaignSetup, grasp: Grasp, world: World) -> RunOutcome:
    """Return the outcome of a controller with full knowledge; of soft pads, the better of both ways to control them."""
    outcome = _run(setup, grasp, world, partial(_make_exact, world), 0.0)
    if outcome.is_held or world.pad_torsion == 0.0:
        return outcome
    other = _run(setup, grasp, world, partial(_make_exact, world, plan_spin=False), 0.0)
    return other if other.is_held else outcome


def _make_exact(
    world: World, plant: PlantInterface, grasp: Grasp, settings: ControlSettings, plan_spin: bool | None = None
) -> MeasuredController:
    """Return a controller with full knowledge of a world."""
    known = world.plant_options(grasp, settings.gravity_H)
    return ExactController(grasp, known, exact_settings(settings, world, grasp), plant, plan_spin=plan_spin)


def _run(
    setup: CampaignSetup,
    grasp: Grasp,
    world: World,
    make: Callable[[PlantInterface, Grasp, ControlSettings], MeasuredController],
    grace: float,
) -> RunOutcome:
    """Return the outcome of one controller in a world. The run ends a grace time in s after a failure."""
    gravity_H = setup.settings.gravity_H
    try:
        plant: PlantInterface = make_world_plant(world, grasp, gravity_H, setup.plant)
    except GraspForceError as error:
        return RunOutcome("not started", message=str(error))
    try:
        settings = dataclasses.replace(setup.settings, period=1.0 / world.sensors.rate)
        controller = make(plant, grasp, settings)
        watch = _RunWatch(FailureWatch(plant, setup.limits, grace), setup.wall_limit)
        recording = simulate_measured(plant, controller, setup.reference(grasp), setup.duration, world, on_step=watch.check)
        return judge_run(recording, setup.limits)
    except Exception as error:  # the campaign goes on, and reports the error with its seed
        return RunOutcome("error", "error", message=f"{type(error).__name__}: {error}")


class _WithoutEstimate:
    """A controller whose estimates are not recorded: their covariances take time, and the outcome does not use them.

    Args:
        controller: the controller.
    """

    estimate = None

    def __init__(self, controller: MeasuredController) -> None:
        self.step, self.reset = controller.step, controller.reset


class _RunWatch:
    """Ends a run that has failed or takes too long.

    Args:
        failure: detects the failure.
        limit: wall-clock time, s.
    """

    def __init__(self, failure: FailureWatch, limit: float) -> None:
        self._failure, self._limit, self._end = failure, limit, time.monotonic() + limit

    def check(self, plant: PlantInterface, command: ControllerCommand) -> bool:
        """Return whether the run goes on; raise TimeoutError after the limit."""
        if time.monotonic() > self._end:
            raise TimeoutError(f"the run took longer than {self._limit:g} s")
        return not self._failure.is_over(plant, command)
