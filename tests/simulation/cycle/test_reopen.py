"""After a failed close or squeeze the fingers open and close again, over the object where the touch has shown it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from graspforce.control.output_feedback import OutputFeedbackController
from graspforce.control.phases.cycle_plan import STOP_DECELERATION
from graspforce.control.phases.phase_controller import PhaseController
from graspforce.control.phases.phase_rules import NO_FORCES, PHASE_ORDER, WRONG_OBJECT
from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.control.settings import ControlSettings
from graspforce.core.errors import InvalidInput
from graspforce.estimation.sensor_model import SensorModel
from graspforce.grasp.grasp import Grasp
from graspforce.simulation.cycle.cycle_outcome import judge_cycle, phase_table
from graspforce.simulation.cycle.cycle_run import CycleRecording, TablePlant, run_cycle
from graspforce.simulation.cycle.plan_cycle import CycleMotion, plan_cycle
from graspforce.simulation.cycle.pose_errors import displaced_pose
from graspforce.simulation.worlds.world import World
from tests.support.table_scenes import ball_scene

OFFSET = (0.006, -0.004)  # m, of the ball from where the controller expects it
SETTINGS = PhaseSettings(close_speed=0.05)  # short tests
FAILED = ["close", "squeeze", "reopen"]


class WithoutForces(OutputFeedbackController):
    """A controller that finds no forces: it reports each step's forces as those of an earlier one."""

    def step(self, *arguments, **options):
        return replace(super().step(*arguments, **options), forces_reused=True)


def run_with(
    failures: int, settings: PhaseSettings = SETTINGS, stop_at: str = "", speed: float = 0.0, on_command=lambda command: None
) -> CycleRecording:
    """Return a cycle whose first object controllers find no forces.

    Args:
        failures: number of these controllers.
        settings: settings of the phases.
        stop_at: phase in which the cycle is stopped; empty for none.
        speed: of the base from which it is stopped there, m/s.
        on_command: called with each command.
    """
    scene, made = ball_scene(), []
    sensors = SensorModel()
    plan = plan_cycle(scene, settings, CycleMotion(move=(0.02, 0.0), optimised=False))
    control = ControlSettings.for_sensors(sensors, ControlSettings(gravity_H=scene.gravity_H)).settings

    def make(grasp: Grasp) -> OutputFeedbackController:
        made.append(grasp)
        return (WithoutForces if len(made) <= failures else OutputFeedbackController)(grasp, control, sensors)

    controller = PhaseController(plan, settings, sensors, make_controller=make)

    def on_step(plant, command):
        on_command(command)
        if command.phase == stop_at and np.linalg.norm(command.base.v) >= speed:
            controller.stop()

    table = TablePlant(scene, World(), displaced_pose(scene, OFFSET, 0.0), plan.q_start)
    return run_cycle(table, controller, scene, World(), on_step=on_step)


@pytest.fixture(scope="module")
def recording() -> CycleRecording:
    return run_with(1)


def test_second_attempt_completes_the_cycle(recording):
    names = [record.phase for record in recording.records]
    assert names == ["approach", *FAILED, *PHASE_ORDER[1:]]
    assert [record.phase for record in recording.records if record.is_aborted] == ["squeeze"]
    assert judge_cycle(recording).status == "done"
    assert any(row[-1] == f"aborted: {NO_FORCES}" for row in phase_table(recording).rows)


def test_base_moves_over_the_object(recording):
    """The touch shows the object's place to 2 mm, see `contact_error`; later the ball may roll when the fingers leave it."""
    squeeze, close = recording.steps_of("squeeze"), recording.steps_of("close")
    first_end = squeeze[recording.t[squeeze] <= recording.records[2].end][-1]
    second_start = close[recording.t[close] > recording.records[3].end][0]
    down, expected = recording.scene.down, ball_scene().grasp.p_HO
    before, after = recording.p_HO[[first_end, second_start]] - expected
    shift = recording.base[second_start]
    along = before - (before @ down) * down
    assert np.linalg.norm(along) > 5e-3
    np.testing.assert_allclose(shift, along, rtol=0, atol=2e-3)
    assert abs(shift @ down) < 1e-9  # m: along the table
    assert np.linalg.norm(after) < np.linalg.norm(before)


def test_fingers_leave_the_object_before_the_base_moves(recording):
    reopen = recording.steps_of("reopen")
    moving = reopen[np.abs(np.diff(recording.base[reopen], axis=0, prepend=recording.base[reopen[:1]])).max(axis=1) > 0.0]
    assert len(moving) > 100
    assert recording.f[moving].max() == 0.0


def test_cycle_stops_after_the_last_attempt():
    recording = run_with(2, replace(SETTINGS, attempts=2))
    assert [record.phase for record in recording.records] == ["approach", *FAILED, *FAILED[:2]]
    assert recording.message == f"squeeze: {NO_FORCES}"
    assert recording.table_force[-1] > 0.9 * recording.weight


def test_one_attempt_stops_at_the_first_failure():
    recording = run_with(1, replace(SETTINGS, attempts=1))
    assert [record.phase for record in recording.records] == ["approach", *FAILED[:2]]
    assert recording.message == f"squeeze: {NO_FORCES}"


def test_touch_that_does_not_fit_leads_to_another_close():
    """With a tolerance of a micrometre no touch fits. The base moves over the object all the same, to 2 mm: `contact_error`."""
    recording = run_with(0, replace(SETTINGS, fit_tolerance=1e-6, attempts=3))
    assert [record.phase for record in recording.records] == ["approach", *["close", "reopen"] * 2, "close"]
    assert recording.message == f"close: {WRONG_OBJECT}"
    close, down = recording.steps_of("close"), recording.scene.down
    first_end = close[recording.t[close] <= recording.records[1].end][-1]
    second_start = close[recording.t[close] > recording.records[2].end][0]
    error = recording.p_HO[first_end] - ball_scene().grasp.p_HO
    along = error - (error @ down) * down
    assert np.linalg.norm(along) > 4e-3
    np.testing.assert_allclose(recording.base[second_start], along, rtol=0, atol=2e-3)


def test_stop_is_final_while_attempts_are_left():
    recording = run_with(1, stop_at="squeeze")
    assert [record.phase for record in recording.records] == ["approach", *FAILED[:2]]
    assert recording.message.startswith("squeeze: stopped")


@pytest.mark.parametrize("attempts", [0, 11, 1.5])
def test_number_of_attempts_is_checked(attempts):
    with pytest.raises(InvalidInput, match="attempts"):
        PhaseSettings(attempts=attempts)


def test_stop_while_the_base_moves_over_the_object_brakes_it():
    """The velocity has no jump: the acceleration is that of the motion before the stop, and 1 m/s² after it."""
    bases = []
    recording = run_with(1, stop_at="reopen", speed=0.01, on_command=lambda command: bases.append(command.base))
    assert recording.message.startswith("reopen: stopped")
    p, v = np.array([base.p for base in bases]), np.array([base.v for base in bases])
    dt = 1e-3  # s
    largest = 1.001 * max(STOP_DECELERATION, max(float(np.linalg.norm(base.a)) for base in bases))  # m/s²
    assert np.linalg.norm(v, axis=1).max() >= 0.01
    assert np.linalg.norm(np.diff(v, axis=0), axis=1).max() <= largest * dt
    assert np.abs(np.diff(p, axis=0) - 0.5 * dt * (v[1:] + v[:-1])).max() < largest * dt**2
    assert not v[-1].any()
