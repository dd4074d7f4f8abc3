"""A grasp cycle in the ideal world: the laws of each phase, by the true forces of the plant."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from graspforce.control.phases.phase_controller import PhaseController
from graspforce.control.phases.phase_rules import PHASE_ORDER
from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.control.phases.phase_step import PhaseCommand
from graspforce.simulation.cycle.cycle_outcome import judge_cycle, phase_table
from graspforce.simulation.cycle.cycle_run import CycleRecording, TablePlant, run_cycle
from graspforce.simulation.cycle.plan_cycle import CycleMotion, plan_cycle
from graspforce.simulation.cycle.pose_errors import displaced_pose
from graspforce.simulation.worlds.world import World
from tests.support.table_scenes import MASS, ball_scene

OFFSET = (0.004, -0.003)  # m, of the ball from where the controller expects it
SETTINGS = PhaseSettings(close_speed=0.04)  # a short test
WEIGHT = 9.80665 * MASS  # N


def run(**options) -> CycleRecording:
    """Return a cycle; with options of `run_cycle`."""
    scene, world = ball_scene(), World()
    plan = plan_cycle(scene, SETTINGS, CycleMotion(move=(0.02, 0.0), optimised=False))
    table = TablePlant(scene, world, displaced_pose(scene, OFFSET, 0.0), plan.q_start)
    return run_cycle(table, PhaseController(plan, SETTINGS), scene, world, **options)


@pytest.fixture(scope="module")
def cycle() -> tuple[CycleRecording, list[PhaseCommand]]:
    """Return the recording of a cycle, and its commands."""
    commands: list[PhaseCommand] = []
    return run(on_step=lambda plant, command: commands.append(command)), commands


@pytest.fixture(scope="module")
def recording(cycle) -> CycleRecording:
    return cycle[0]


def mean_over(values: np.ndarray, steps: int = 20) -> np.ndarray:
    return np.convolve(values, np.full(steps, 1.0 / steps), mode="valid")


def test_every_phase_ends_by_its_exit_condition(recording):
    assert [record.phase for record in recording.records] == list(PHASE_ORDER)
    assert not any(record.is_aborted for record in recording.records)


def test_truth_confirms_lift_place_and_release(recording):
    outcome = judge_cycle(recording)
    assert outcome.status == "done"
    assert outcome.lift_height == pytest.approx(0.05, abs=2e-3)
    assert outcome.place_error < 3e-3


@pytest.mark.parametrize(("share", "status"), [(1.0, "done"), (0.8, "not released")])
def test_object_that_rocks_on_the_table_is_released_if_the_mean_load_is_its_weight(recording, share, status):
    rocking = np.resize([0.0, 2.0], len(recording.t)) * share * recording.weight  # N
    assert judge_cycle(replace(recording, table_force=rocking)).status == status


def test_fingers_that_touch_early_push_no_more_than_the_touch_force(recording):
    """The impulse of a finger is at most that of the touch force, and the momentum m v of its tip at two impacts.

    The mass of a tip along its normal is 1/(n · J M⁻¹ Jᵀ n).
    """
    close, grasp = recording.steps_of("close"), recording.scene.grasp
    J = grasp.hand.contact_jacobian(grasp.q, grasp.fingers, grasp.contacts, grasp.p_HO, grasp.R_HO)[grasp.contacts.normal_rows]
    mass = 1.0 / np.diag(J @ np.linalg.solve(grasp.hand.mass_matrix(grasp.q), J.T))  # kg
    for i, first in enumerate(recording.first_touch):
        impulse = 1e-3 * recording.f[close, i, 2].sum()  # N·s
        push = SETTINGS.touch_force * (recording.t[close[-1]] - first)
        assert impulse < 1.05 * push + 2.0 * mass[i] * SETTINGS.close_speed


def test_object_stays_until_the_squeeze(recording):
    assert judge_cycle(recording).moved_before_squeeze < 3e-3


def test_touch_finds_the_ball(recording):
    record = next(each for each in recording.records if each.phase == "close")
    squeeze = recording.steps_of("squeeze")[0]
    assert np.linalg.norm(record.grasp.p_HO - recording.p_HO[squeeze]) < 2e-3


def test_forces_rise_to_the_planned_ones_and_not_above(recording):
    outcome = judge_cycle(recording)
    assert outcome.peak_ratio < 1.5
    squeeze = recording.steps_of("squeeze")
    assert np.abs(recording.f[squeeze[-1], :, 2] - recording.f_planned[squeeze[-1]]).max() < 0.3


def test_table_carries_no_more_than_the_weight(recording):
    """Neither the squeeze nor the place presses the object against the table, so that the forces are the planned ones.

    The tolerance of 0.3 N is for friction at table and fingertips, which leaves internal forces.
    """
    for phase in ("squeeze", "place"):
        assert mean_over(recording.table_force[recording.steps_of(phase)]).max() < 1.3 * WEIGHT


def test_weight_goes_from_the_table_to_the_fingers_and_back(recording):
    squeeze, place = recording.steps_of("squeeze"), recording.steps_of("place")
    lift, release = recording.steps_of("lift"), recording.steps_of("release")
    assert recording.table_force[squeeze[:40]].mean() > 0.8 * WEIGHT  # single values scatter while the fingers arrive
    assert recording.table_force[lift[len(lift) // 2 :]].max() == 0.0
    assert recording.table_force[place[-1]] > 0.8 * WEIGHT
    assert recording.table_force[release[-1]] == pytest.approx(WEIGHT, rel=0.02)


def test_table_and_fingers_carry_the_weight_together(recording):
    """Newton's law of the ball, whose acceleration is small beside gravity while the base rests."""
    k = recording.steps_of("squeeze")
    contacts = recording.contact_force_H[k]  # N
    up = -recording.scene.down
    assert np.abs(mean_over(contacts @ up + recording.table_force[k]) - WEIGHT).max() < 0.05 * WEIGHT


def test_forces_keep_inside_their_cones_while_the_object_is_carried(recording):
    assert judge_cycle(recording).least_margin > 0.0


def test_phase_table_has_a_row_for_each_phase(recording):
    text = str(phase_table(recording))
    assert all(name in text for name in PHASE_ORDER)


def test_signs_of_contact_end_with_the_release(cycle):
    _, commands = cycle
    before = [each for each in commands if each.phase in ("squeeze", "lift", "move", "place")]
    after = [each for each in commands if each.phase in ("release", "retract", "done")]
    assert all(all(each.touching) for each in before)
    assert not any(any(each.touching) for each in after)


def test_ended_simulation_names_its_time_and_cause():
    steps = iter(range(1000))
    by_callback = run(on_step=lambda plant, command: next(steps) < 19)
    assert by_callback.message == "approach: the callback ended the simulation after 0.02 s"
    assert len(by_callback.t) == 20
    assert run(duration=0.03).message == "approach: the simulation ended after 0.03 s"


def test_run_shorter_than_the_settling_of_the_object_is_judged():
    outcome = judge_cycle(run(duration=0.01))
    assert outcome.status == "stopped"
    assert outcome.place_error == pytest.approx(0.0, abs=1e-3)
