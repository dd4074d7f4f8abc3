"""The closed loop in a world: measure with errors, control from measurements, delay the torques, step, record."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from graspforce.contact.motion import BodyMotion
from graspforce.control.contacts.lost_drives import LostDrives
from graspforce.control.state import DesiredMotion, GraspState, object_motion
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.estimation.measurement import Measurement
from graspforce.grasp.grasp import Grasp
from graspforce.simulation.loops.reference import Reference
from graspforce.simulation.plants.driven_plant import step_plant
from graspforce.simulation.plants.plant_interface import PlantInterface
from graspforce.simulation.recordings.measured_recording import CameraHistory, EstimateHistory, MeasuredRecording, StateEstimate
from graspforce.simulation.recordings.recording_builder import ControllerCommand, RecordingBuilder
from graspforce.simulation.recordings.sliding import sliding_displacement
from graspforce.simulation.sensors.measurement_reader import MeasurementReader
from graspforce.simulation.worlds.world import World

PlantT = TypeVar("PlantT", bound=PlantInterface)

_LOST_TIME = 0.05  # s: an object without any contact for longer is lost
_LOST_DISTANCE = 0.05  # m: an object farther from its reference is lost
_TIME_AFTER_DROP = 0.2  # s, simulated and recorded after the object is lost
_PERIOD_TOLERANCE = 1e-6  # relative


class MeasuredController(Protocol):
    """A controller that knows measurements only, such as `graspforce.control.OutputFeedbackController`."""

    def step(self, measurement: Measurement, desired: DesiredMotion, *, lost: Sequence[str] = ()) -> ControllerCommand:
        """Return the command of a control period.

        Args:
            measurement: the newest measurement.
            desired: the desired motion at the time of the measurement.
            lost: names of fingers whose drives are off at that time.
        """
        ...  # pragma: no cover

    def reset(self) -> None:
        """Forget all measurements and commands."""
        ...  # pragma: no cover

    @property
    def estimate(self) -> StateEstimate | None:
        """The estimate of the last step; None if the controller makes none."""
        ...  # pragma: no cover


def simulate_measured(
    plant: PlantT,
    controller: MeasuredController,
    reference: Reference,
    duration: float,
    world: World,
    *,
    initial_forces: npt.ArrayLike | None = None,
    on_step: Callable[[PlantT, ControllerCommand], bool | None] | None = None,
) -> MeasuredRecording:
    """Simulate the closed loop of a controller that knows measurements only.

    The controller is called at `world.sensors.rate`. Its torques act `world.sensors.latency` after the measurement, rounded to
    whole steps; until then those of its command at rest do. The run ends 0.2 s after the object is lost: when no fingertip has
    touched it for 50 ms, or when it is 50 mm from its reference. If the controller raises an exception while no fingertip
    touches the object, the run ends there; any other exception is raised. The motors of a finger in `world.drive_losses` have
    no torque from the first step at its time on.

    Args:
        plant: a plant of the same world; it is reset.
        controller: the controller; it is reset.
        reference: desired motion as a function of time in s.
        duration: simulated time, s.
        world: sensors, delay and seed.
        initial_forces: (k,) contact forces at t = 0, N and N·m. Default: the forces of the controller's command at rest.
        on_step: called after each step; if it returns False, the run ends. An exception that it raises ends the run, too.

    Returns:
        The recording of all steps.

    Raises:
        InvalidInput: the duration is shorter than a step, or the sensors' period is not a whole number of steps.
        UnknownName: a finger that loses its drives is not one of the grasp.
    """
    grasp, dt = plant.grasp, plant.dt
    steps = round(arrays.check_number(duration, "duration", above=0.0) / dt)
    if steps < 1:
        raise InvalidInput("duration", duration, f"at least one step, {dt:g} s")
    period, delay = _period_steps(world, dt), round(world.sensors.latency / dt)
    losses = _DriveLosses(world, grasp, dt)
    plant.reset(initial_forces)
    controller.reset()
    command = controller.step(MeasurementReader(world, grasp).read(plant), BodyMotion(grasp.p_HO, grasp.R_HO))
    if initial_forces is None and not command.forces_reused:
        padded = command.contacts.pad(np.asarray(command.f))
        initial_forces = padded.ravel()[grasp.contacts.columns]  # the controller may know other contact models
    controller.reset()
    state, active = plant.reset(initial_forces), command
    reader, builder, drop = MeasurementReader(world, grasp), RecordingBuilder(), _DropMonitor()
    estimates: list[tuple[float, StateEstimate]] = []
    controller_error = ""
    pending: deque[tuple[int, ControllerCommand]] = deque()  # step at which a command begins to act, and the command
    for k in range(steps):
        t = k * dt
        desired = reference(t)
        reader.observe(plant)
        if k % period == 0:
            try:
                command = controller.step(reader.read(plant), desired, lost=losses.fingers_at(k))
            except Exception as error:
                if not drop.end_without_contact(plant):
                    raise
                controller_error = f"{type(error).__name__}: {error}"
                break
            pending.append((k + delay, command))
            if controller.estimate is not None:
                estimates.append((t, controller.estimate))
        while pending and pending[0][0] <= k:
            active = pending.popleft()[1]
        builder.add_inputs(t, state, object_motion(desired), command)
        state = step_plant(plant, active, losses.powered_joints(k))
        builder.add_results(plant)
        if on_step is not None and on_step(plant, command) is False:
            break
        if drop.is_over(plant, state, object_motion(desired)):
            break
    truth = builder.finish(grasp)
    return MeasuredRecording(
        truth=truth,
        estimate=EstimateHistory.stack(estimates) if estimates else None,
        camera=_camera_history(reader),
        sliding=sliding_displacement(truth, grasp),
        drop_time=drop.time,
        controller_error=controller_error,
    )


def _period_steps(world: World, dt: float) -> int:
    """Return the control period in steps."""
    ratio = 1.0 / (world.sensors.rate * dt)
    steps = round(ratio)
    if steps < 1 or abs(ratio - steps) > _PERIOD_TOLERANCE * steps:
        raise InvalidInput("world.sensors.rate", world.sensors.rate, f"{1.0 / dt:g} Hz divided by a whole number")
    return steps


def _camera_history(reader: MeasurementReader) -> CameraHistory:
    """Return the poses that arrived as arrays; they may be none."""
    poses = reader.poses
    return CameraHistory(
        t_image=freeze([t for t, _, _ in poses]),
        t_arrival=freeze([t for _, t, _ in poses]),
        p_HO=freeze(np.array([pose.p_HO for _, _, pose in poses]).reshape(-1, 3)),
        R_HO=freeze(np.array([pose.R_HO for _, _, pose in poses]).reshape(-1, 3, 3)),
    )


class _DriveLosses:
    """Fingers whose drives are off, by step.

    Args:
        world: the world.
        grasp: the grasp.
        dt: length of a step, s.

    Raises:
        UnknownName: a finger is not one of the grasp.
    """

    def __init__(self, world: World, grasp: Grasp, dt: float) -> None:
        for i, (finger, _) in enumerate(world.drive_losses):
            if finger not in grasp.fingers:
                raise UnknownName(f"world.drive_losses[{i}][0]", finger, grasp.fingers)
        self._grasp, self._steps = grasp, [(finger, math.ceil(t / dt - _PERIOD_TOLERANCE)) for finger, t in world.drive_losses]
        self._drives: LostDrives | None = None

    def fingers_at(self, k: int) -> tuple[str, ...]:
        """Return the names of the fingers whose drives are off in step k."""
        return tuple(finger for finger, first in self._steps if k >= first)

    def powered_joints(self, k: int) -> Array | None:
        """Return (n,) 0 for motors without drive in step k, and 1 for others; None if all have one.

        Args:
            k: number of the step.
        """
        fingers = self.fingers_at(k)
        if not fingers:
            return None
        if self._drives is None or self._drives.fingers != fingers:
            self._drives = LostDrives.of(self._grasp, fingers)
        return self._drives.without_torques(np.ones(self._grasp.hand.n))


class _DropMonitor:
    """Detects when the object is lost.

    Attributes:
        time: time at which it was lost, s; None while it is held.
    """

    def __init__(self) -> None:
        self.time: float | None = None
        self._last_contact = 0.0  # s

    def is_over(self, plant: PlantInterface, state: GraspState, desired: BodyMotion) -> bool:
        """Return whether the run ends after this step."""
        if plant.true_contacts().touching.any():
            self._last_contact = plant.t
        distance = math.dist(state.object.p_HO.tolist(), desired.p_HO.tolist())
        if self.time is None and plant.t - self._last_contact > _LOST_TIME:
            self.time = self._last_contact
        elif self.time is None and distance > _LOST_DISTANCE:
            self.time = plant.t
        return self.time is not None and plant.t > self.time + _TIME_AFTER_DROP

    def end_without_contact(self, plant: PlantInterface) -> bool:
        """Count the object as lost if no fingertip touches it now, and return whether it is lost."""
        if self.time is None and not plant.true_contacts().touching.any():
            self.time = self._last_contact
        return self.time is not None
