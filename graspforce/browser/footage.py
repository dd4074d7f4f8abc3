"""What a playback shows: the states of a recording or a plan, with their numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from graspforce.browser.charts import ERROR, MARGINS, SPEED, TEMPERATURE, TORQUE
from graspforce.browser.readings import Readings, torque_use
from graspforce.contact import friction
from graspforce.contact.motion import BodyMotion
from graspforce.core.arrays import Array
from graspforce.learning.actions.labels import MotionLabel, labels_at
from graspforce.planning.plan import Plan
from graspforce.simulation.plants.scene import Scene
from graspforce.simulation.recordings.recording import Recording
from graspforce.simulation.rendering.marks import RecordedContacts, SceneState, recorded_state, scene_state

_PLANNED_RATE = 2000  # instants of a plan per second, so that slow motion is smooth
_FEWEST = 50  # instants of a plan
_WARNING_TIME = 1.0  # s, for which a warning is shown


@dataclass(frozen=True, eq=False, slots=True)
class Footage:
    """States over time.

    Args:
        title: of the page.
        t: (M,) times, s, increasing from 0.
        readings: the numbers at these times.
        charts: names of the charts.
        state: returns the state of a row.
        desired: returns desired position, m, and orientation of the object in H, of a row; None without.
        warnings: times, s, and texts.
        labels: motions of the fingers.
    """

    title: str
    t: Array
    readings: tuple[Readings, ...]
    charts: tuple[str, ...]
    state: Callable[[int], SceneState]
    desired: Callable[[int], tuple[Array, Array]] | None = None
    warnings: tuple[tuple[float, str], ...] = ()
    labels: tuple[MotionLabel, ...] = ()

    def status(self, row: int) -> str:
        """Return the text of a row: its time, an error or a speed, the motions of the fingers, and the last warning.

        Args:
            row: index of the time.
        """
        now = self.readings[row]
        number = f"speed {now.speed:.0f} mm/s" if ERROR not in self.charts else f"position error {now.position_error:.3f} mm"
        warnings = [text for t, text in self.warnings if 0.0 <= now.t - t < _WARNING_TIME]
        motions = "".join(f"  \n{name}: {label.text}" for name, label in labels_at(self.labels, now.t).items())
        return f"t = {now.t:.3f} s, {number}{motions}" + (f"  \n⚠ {warnings[-1]}" if warnings else "")


def recorded_footage(scene: Scene, recording: Recording) -> Footage:
    """Return the footage of a recording.

    Args:
        scene: scene of the recorded grasp.
        recording: the recording.
    """
    hand = scene.grasp.hand
    return Footage(
        f"{recording.hand}, {recording.t[-1]:.2f} s",
        recording.t,
        Readings.of_recording(recording, hand),
        (MARGINS, TORQUE, ERROR, *((TEMPERATURE,) if hand.drives.has_thermal_data else ())),
        lambda row: recorded_state(scene, recording, row),
        lambda row: (recording.p_desired[row], recording.R_desired[row]),
        tuple(recording.warnings),
        recording.motion_labels(hand),
    )


def planned_footage(scene: Scene, plan: Plan) -> Footage:
    """Return the footage of a plan: its motion, and the planned forces with the friction of the grasp.

    Args:
        scene: scene of the grasp in which the plan starts.
        plan: the plan.
    """
    grasp = scene.grasp
    at = plan.at_even_times(max(round(_PLANNED_RATE * plan.duration), _FEWEST))
    contacts, hand = grasp.contacts, grasp.hand
    forces = contacts.pad(at.f)
    margins = friction.slip_margin(forces, contacts.mu, contacts.gamma)
    uses = torque_use(at.tau, hand.torque_lower, hand.torque_upper)
    speeds = 1e3 * np.linalg.norm(at.twist[:, :3], axis=1)  # mm/s
    readings = tuple(Readings(float(t), margins[i], uses[i], np.nan, speed=float(speeds[i])) for i, t in enumerate(at.times))

    touching = np.ones(len(grasp.fingers), dtype=bool)

    def state(row: int) -> SceneState:
        motion = BodyMotion(at.p_HO[row], at.R_HO[row], at.twist[row])
        known = RecordedContacts(touching, forces[row], at.p_OC[row], at.R_OC[row], contacts.mu, contacts.gamma)
        return scene_state(scene, float(at.times[row]), at.q[row], motion, known)

    title = f"{hand.name}: planned move of {1e3 * plan.duration:.1f} ms"
    return Footage(title, at.times, readings, (MARGINS, TORQUE, SPEED), state)
