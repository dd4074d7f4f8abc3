"""What the view shows of streams of phases and of joint-space laws."""

from __future__ import annotations

import io
import threading

import numpy as np
import pytest
from rich.console import Console
from support.control_requests import HAND
from support.headless_browser import CHROMIUM, HeadlessBrowser
from support.servers import ANY_LOCAL_PORT, TIMEOUT
from support.table_scenes import ball_scene

from graspforce.browser import ViewAddress
from graspforce.cli import run_stream_view
from graspforce.cli.shown_streams import ShownJoints, ShownPhases, shown_stream
from graspforce.control import ControlSettings
from graspforce.control.joints.force_controller import ForceController
from graspforce.control.joints.force_loop import ForceGains
from graspforce.control.joints.joint_command import JointMotion
from graspforce.control.joints.joint_controller import JointController
from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.estimation import Measurement, SensorModel
from graspforce.estimation.measurement import PoseMeasurement
from graspforce.service import Client, JointStreamSetup, PhaseStreamSetup, Server
from graspforce.service.client.stream_monitor import JointStreamStep, PhaseStreamStep
from graspforce.service.wire.joint_records import JointCommandRecord, JointState
from graspforce.service.wire.phase_records import BaseMotionRecord, PhaseCommandRecord, PhaseState
from graspforce.simulation.cycle.plan_cycle import CycleMotion, plan_cycle

pytest.importorskip("viser")
PHASES = PhaseSettings(close_speed=0.05)
SETUP = PhaseStreamSetup(
    plan_cycle(ball_scene(), PHASES, CycleMotion(optimised=False)), PHASES, SensorModel(tip_force_noise=0.02), ControlSettings()
)
GRASP = SETUP.plan.grasp


def phase_step(phase: str, base: tuple[float, float, float], tips: np.ndarray | None = None, pose=None) -> PhaseStreamStep:
    """Return a step in a phase, with the base at a displacement; each finger that holds presses with 2 N."""
    zero = [0.0] * 3
    holds = phase in ("squeeze", "lift", "move", "place", "stopped")
    measured = Measurement(0.5, GRASP.q, tip_wrench=tips, object=pose)
    n, count = GRASP.hand.n, len(GRASP.fingers)
    command = PhaseCommandRecord(
        torque=[0.1] * n,
        phase=phase,
        base=BaseMotionRecord(list(base), zero, zero),
        touching=["force" if holds else ""] * count,
        normal_force=[2.0 if holds else 0.0] * count,
        message="stopped" if phase == "stopped" else "",
        t=0.5,
        posture=GRASP.q.tolist(),
        velocity=zero,
        slip_margin=0.4 if holds else None,
        server_seconds=1e-3,
    )
    return PhaseStreamStep(PhaseState(1, 0.5, measured), command)


def test_the_object_of_a_cycle_lies_still_until_the_lift_and_after_the_placing():
    """The picture is in the frame of the hand's base, which moves: an object that lies still moves the opposite way."""
    shown, places = ShownPhases(SETUP), {}
    steps = [
        ("approach", (0.0, 0.0, 0.0)), ("squeeze", (0.0, 0.0, 0.0)), ("lift", (0.02, 0.0, 0.0)), ("move", (0.02, 0.05, 0.0)),
        ("place", (0.0, 0.05, 0.0)), ("release", (0.0, 0.05, 0.01)), ("retract", (0.0, 0.05, 0.03)),
    ]  # fmt: skip
    for phase, base in steps:
        state, desired, readings = shown.show(phase_step(phase, base))
        address = shown.display.scene.object_q_address
        places[phase] = state.qpos[address : address + 3]
        assert desired is None
        assert readings.phase == phase
    for phase in ("approach", "squeeze", "lift", "move", "place"):
        np.testing.assert_allclose(places[phase], GRASP.p_HO, atol=1e-12)
    np.testing.assert_allclose(places["release"], GRASP.p_HO - [0.0, 0.0, 0.01], atol=1e-12)
    np.testing.assert_allclose(places["retract"], GRASP.p_HO - [0.0, 0.0, 0.03], atol=1e-12)


def test_a_view_that_opens_after_the_placing_shows_the_object_at_the_goal():
    state, _, _ = ShownPhases(SETUP).show(phase_step("retract", tuple(SETUP.plan.move)))
    address = ShownPhases(SETUP).display.scene.object_q_address
    np.testing.assert_allclose(state.qpos[address : address + 3], GRASP.p_HO, atol=1e-12)


def test_a_measured_object_is_shown_where_it_was_measured():
    seen = PoseMeasurement(0.5, GRASP.p_HO + np.array([0.001, 0.002, 0.003]), GRASP.R_HO)
    shown = ShownPhases(SETUP)
    state, _, _ = shown.show(phase_step("approach", (0.0, 0.0, 0.0), pose=seen))
    address = shown.display.scene.object_q_address
    np.testing.assert_allclose(state.qpos[address : address + 3], seen.p_HO, atol=1e-12)


def test_arrows_of_a_cycle_are_measured_forces_or_planned_normal_forces():
    shown, normals = ShownPhases(SETUP), GRASP.R_HO @ GRASP.contacts.R_OC
    planned, _, readings = shown.show(phase_step("lift", (0.0, 0.0, 0.0)))
    for mark, axes in zip(planned.contacts, normals, strict=True):
        assert mark.touching
        assert mark.f_n == pytest.approx(2.0)
        np.testing.assert_allclose(mark.arrow / np.linalg.norm(mark.arrow), axes[:, 2], atol=1e-12)
    np.testing.assert_array_equal(readings.slip_margin, [0.4])
    tips = np.zeros((len(normals), 6))
    tips[:, :3] = normals[:, :, 2] * 3.0 + normals[:, :, 0] * 0.9  # μ = 0.6: half of the friction is in use
    measured, _, readings = shown.show(phase_step("lift", (0.0, 0.0, 0.0), tips))
    for mark in measured.contacts:
        assert mark.f_n == pytest.approx(3.0)
        assert mark.use == pytest.approx(0.5)
    np.testing.assert_allclose(readings.normal_force, 3.0)
    np.testing.assert_allclose(readings.slip_margin, [0.9])


def test_fingers_of_a_cycle_have_no_arrows_before_they_touch():
    state, _, readings = ShownPhases(SETUP).show(phase_step("approach", (0.0, 0.0, 0.0)))
    assert not any(mark.touching for mark in state.contacts)
    np.testing.assert_array_equal(readings.normal_force, 0.0)
    assert readings.text == "t = 0.50 s, approach"


def test_a_stream_of_joints_shows_the_largest_joint_error_or_torque_error():
    ones = np.ones(HAND.n)
    error = np.zeros(HAND.n)
    error[3] = np.radians(5.0)
    command = JointCommandRecord([0.0] * HAND.n, [0.0] * HAND.n, [0.0] * HAND.n, server_seconds=2e-4)
    measured = JointMotion(HAND.neutral)
    law = JointStreamSetup(JointController.with_frequency(HAND, "pid", 3.0))
    shown = shown_stream(law)
    assert isinstance(shown, ShownJoints)
    state, desired, readings = shown.show(
        JointStreamStep(JointState(1, 2.5, measured, JointMotion(HAND.neutral + error)), command), 1.5
    )
    assert desired is None
    assert state.contacts == ()
    assert readings.text == "t = 1.00 s, joint error 5.00°"
    assert readings.step_time == pytest.approx(0.2)
    force = shown_stream(JointStreamSetup(ForceController(HAND, ForceGains(0.5 * ones, 20.0 * ones, 0.01 * ones))))
    _, _, readings = force.show(JointStreamStep(JointState(1, 1.5, measured, None, 0.1 * ones, 0.3 * ones), command), 1.5)
    assert readings.text == "t = 0.00 s, torque error 0.2000 N·m"


def _drive_phases(client: Client, ended: threading.Event, ids: list[str]) -> None:
    """Follow the approach of the plan, again and again while the cycle is in its first phases."""
    with client.open_phase_stream(PhaseStreamSetup(SETUP.plan, PHASES, SETUP.sensors, SETUP.settings, TIMEOUT)) as stream:
        ids.append(stream.id)
        k, tips = 0, np.zeros((len(GRASP.fingers), 6))
        while not ended.wait(2e-3):
            t, approach = 1e-3 * k, SETUP.plan.approach
            stream.step(Measurement(t, approach(min(t, approach.duration)).q, tip_wrench=tips), wait=TIMEOUT)
            k += 1


def _drive_joints(client: Client, ended: threading.Event, ids: list[str]) -> None:
    """Ask for a posture that swings about the neutral one."""
    hand = GRASP.hand
    setup = JointStreamSetup(JointController.with_frequency(hand, "computed_torque", 3.0), validity=TIMEOUT)
    with client.open_joint_stream(setup) as stream:
        ids.append(stream.id)
        k = 0
        while not ended.wait(2e-3):
            swing = 0.2 * np.sin(0.01 * k)
            stream.step(JointMotion(hand.neutral + swing), JointMotion(hand.neutral + 1.1 * swing), wait=TIMEOUT)
            k += 1


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
@pytest.mark.parametrize(
    ("drive", "chart", "number"),
    [(_drive_phases, "least slip margin, N", "t ="), (_drive_joints, "largest joint error, °", "joint error")],
    ids=["phases", "joints"],
)
def test_a_page_follows_a_stream_of_phases_and_one_of_joints(drive, chart, number):
    ids: list[str] = []
    ended, text = threading.Event(), io.StringIO()
    with Server([GRASP.hand], listen=ANY_LOCAL_PORT) as server, Client(server.addresses[0], timeout=TIMEOUT) as client:
        driver = threading.Thread(target=drive, args=(client, ended, ids), daemon=True)
        driver.start()
        HeadlessBrowser.wait(lambda: ids)
        options = run_stream_view.StreamViewOptions(server.addresses[0], ids[0], (), ViewAddress(port=8481))
        viewer = threading.Thread(target=run_stream_view.run, args=(options, Console(file=text, width=200), 600.0), daemon=True)
        viewer.start()
        HeadlessBrowser.wait(lambda: "http://" in text.getvalue())
        browser = HeadlessBrowser("http://" + text.getvalue().split("http://")[1].split()[0], 1000, 800)
        try:
            browser.wait(lambda: chart in browser.text() and number in browser.text())
            browser.wait(lambda: browser.image()[:, :600].min() < 120)  # the hand is drawn
            first = browser.number_after(number)
            browser.wait(lambda: browser.number_after(number) != first)
        finally:
            browser.close()
            ended.set()
            driver.join(TIMEOUT)
            viewer.join(TIMEOUT)
    assert not driver.is_alive()
    assert not viewer.is_alive()
