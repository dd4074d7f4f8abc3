"""Aborts of a grasp cycle: each one triggers the safe stop of its phase."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from graspforce.control.joints.joint_trajectory import JointTrajectory
from graspforce.control.phases.phase_controller import PhaseController
from graspforce.control.phases.phase_rules import NO_CONTACT, NO_FORCES, PAUSED, PHASE_RULES, TIME_LIMIT
from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.estimation.measurement import Measurement
from graspforce.grasp.body import Body
from graspforce.simulation.cycle.cycle_run import CycleRecording, TablePlant, run_cycle
from graspforce.simulation.cycle.plan_cycle import CycleMotion, plan_cycle
from graspforce.simulation.cycle.pose_errors import displaced_pose
from graspforce.simulation.cycle.table_scene import TableScene
from graspforce.simulation.worlds.world import World
from tests.support.table_scenes import ball_scene

SETTINGS = PhaseSettings(close_speed=0.05)  # short tests
MOTION = CycleMotion(move=(0.02, 0.0), optimised=False)


def run(scene: TableScene, offset: tuple[float, float] = (0.0, 0.0), stop_at: str = "") -> CycleRecording:
    plan = plan_cycle(scene, SETTINGS, MOTION)
    controller = PhaseController(plan, SETTINGS)

    def on_step(plant, command):
        if command.phase == stop_at:
            controller.stop()

    table = TablePlant(scene, World(), displaced_pose(scene, offset, 0.0), plan.q_start)
    return run_cycle(table, controller, scene, World(), on_step=on_step)


def test_close_without_an_object_keeps_the_posture():
    recording = run(ball_scene(), (0.3, 0.0))
    assert recording.message == f"close: {NO_CONTACT}"
    stopped = recording.steps_of("stopped")
    assert PHASE_RULES["close"].safe_stop == "hold joints"
    assert np.ptp(recording.q[stopped[100:]], axis=0).max() < 0.01  # rad
    assert recording.f.max() == 0.0


def test_squeeze_of_an_object_that_is_too_heavy_leaves_it_on_the_table():
    scene = ball_scene()
    light = plan_cycle(scene, SETTINGS, MOTION)
    heavy = Body.solid(scene.grasp.body.shape, 4.0)
    told = replace(scene, grasp=replace(scene.grasp, body=heavy))
    controller = PhaseController(replace(light, grasp=told.grasp), SETTINGS)
    table = TablePlant(scene, World(), displaced_pose(scene, (0.0, 0.0), 0.0), light.q_start)
    recording = run_cycle(table, controller, scene, World())
    assert recording.message == f"squeeze: {NO_FORCES}"
    stopped = recording.steps_of("stopped")
    assert recording.table_force[stopped[-1]] > 0.9 * recording.weight
    assert recording.f[stopped[100:], :, 2].max() < 2.0 * SETTINGS.touch_force


def test_stop_while_the_object_is_carried_holds_it():
    recording = run(ball_scene(), stop_at="move")
    assert recording.message.startswith("move: ")
    stopped = recording.steps_of("stopped")
    assert recording.table_force[stopped].max() == 0.0
    assert np.linalg.norm(recording.p_HO[stopped[-1]] - recording.p_HO[stopped[0]]) < 1e-3  # m
    assert np.ptp(recording.base[stopped[-100:]], axis=0).max() == 0.0


def test_pause_of_the_measurements_stops_the_cycle():
    """A controller that continues after a pause would jump along its references."""
    plan = plan_cycle(ball_scene(), SETTINGS, MOTION)
    controller = PhaseController(plan, SETTINGS)
    for k in range(200):
        controller.step(Measurement(1e-3 * k, plan.q_start))
    command = controller.step(Measurement(0.2 + SETTINGS.loss_time, plan.q_start))
    assert (command.phase, command.message) == ("stopped", f"approach: {PAUSED}")
    assert controller.records[-1].is_aborted


def test_phase_that_takes_too_long_stops():
    late, scene = PHASE_RULES["approach"].time_limit + 0.1, ball_scene()
    plan = plan_cycle(scene, SETTINGS, MOTION)
    slow = JointTrajectory.between(plan.q_start, plan.q_pregrasp, late - 0.6)  # s; the joints do not follow
    controller = PhaseController(replace(plan, approach=slow), replace(SETTINGS, loss_time=2.0 * late))
    controller.step(Measurement(0.0, plan.q_start))
    assert controller.phase == "approach"
    controller.step(Measurement(late, plan.q_start))
    assert controller.phase == "stopped"
    assert controller.records[-1].reason == TIME_LIMIT
    for k in range(1, 300):
        command = controller.step(Measurement(late + 1e-3 * k, plan.q_start))
    assert command.message == f"approach: {TIME_LIMIT}"
    gravity = scene.grasp.hand.gravity_torque(plan.q_start, plan.gravity_H)
    assert np.abs(command.tau - gravity).max() < 5e-3  # N·m: the joints that do not move get the torques of their weight
