"""A simulated hand whose controller is at the other end of a stream: nothing changes by that, and losing it loses no object."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.hands import load
from support.local_server import LocalServer
from support.servers import ANY_LOCAL_PORT, TIMEOUT

from graspforce.cli.stream_controller import JointStreamController, PhaseStreamController, StreamController
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, ObjectController
from graspforce.control.joints.joint_controller import JointController
from graspforce.control.joints.joint_reference import minimum_jerk_reference
from graspforce.control.phases.phase_controller import PhaseController
from graspforce.core.errors import ServiceError
from graspforce.estimation.measurement import Measurement
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.search import find_grasp
from graspforce.service import (
    Client,
    JointStream,
    JointStreamSetup,
    PhaseStream,
    PhaseStreamSetup,
    Server,
    Watchdog,
    start_server_process,
)
from graspforce.service.client.command_stream import StreamLink
from graspforce.service.client.watchdog import CommandMonitor
from graspforce.service.wire.protocol import MSGPACK
from graspforce.simulation import Plant, build_scene, compute_metrics, linear_reference, simulate
from graspforce.simulation.cycle.plan_cycle import CycleMotion, plan_cycle
from graspforce.simulation.free_hand.free_plant import FreeHandPlant
from graspforce.simulation.free_hand.joint_run import run_joints
from tests.support.table_scenes import ball_scene

DT = 1e-3  # s
LOSS = 0.25  # s: a quarter of the motion's period, where the object is fastest


def settings(gravity_H):
    return ControlSettings(gravity_H=np.array(gravity_H), period=DT)


def plant_and_reference(grasp, gravity_H):
    """Out and back over 10 mm within a second."""
    travel = 0.01 * np.array(gravity_H) / -9.81  # m: upwards
    return Plant(build_scene(grasp, gravity_H=np.array(gravity_H))), linear_reference(
        BodyMotion(grasp.p_HO, grasp.R_HO), travel, 1.0
    )


def allegro():
    return three_finger_grasp(), PALM_UP


def four_finger():
    body = Body.solid(Sphere(0.03), 0.05)
    return find_grasp(load("four_finger"), body, ("finger_1", "finger_2", "finger_4"), friction=0.7), (0.0, 0.0, -9.81)


# ── the watchdog in the plant, on the plant's own clock ────────────────────────────────────────────────────────────────────


class Interrupted:
    """A controller whose commands do not come from LOSS until ``back``, s, and a watchdog, as in `Stream.step`."""

    def __init__(self, grasp, gravity_H, watchdog, back):
        hand = grasp.hand
        self.controller, self.back = ObjectController(grasp, settings(gravity_H)), back
        self.monitor = CommandMonitor(watchdog, 1.5 * DT, hand.torque_lower, hand.torque_upper)
        self.t = -DT  # the first question comes before the run

    def step(self, state, desired, external=None):
        if not LOSS <= self.t < self.back:
            self.last = self.controller.step(state, desired, external)
            self.monitor.accept(self.last.tau, self.t, self.t)
        output = self.monitor.torque(self.t, state.q, state.v)
        self.t += DT
        return replace(self.last, tau=output.tau)


# Fingers twice as long as Allegro's want joints four times as stiff to be as stiff at their tips.
@pytest.mark.parametrize(("case", "longer"), [(allegro, 1.0), (four_finger, 2.0)], ids=["allegro", "four_finger"])
def test_watchdog_holds_a_moving_object_until_commands_return(case, longer):
    """For a second and more, and to a server that wants it 5 mm away: it touches, in its cones, and moves by small steps."""
    grasp, gravity_H = case()
    dog, back = Watchdog(hold=1.5, stiffness=2.0 * longer**2, damping=0.04 * longer**2), LOSS + 1.25  # s
    plant, reference = plant_and_reference(grasp, gravity_H)
    run = simulate(plant, Interrupted(grasp, gravity_H, dog, back), reference, back + 0.4)
    metrics = compute_metrics(run)
    assert metrics.lost_contact_steps == 0
    assert run.slip_margin.min() > 0.0
    away = run.p_HO[round(LOSS / DT) : round(back / DT)]
    moved = np.linalg.norm(away - away[0], axis=1)
    assert moved[-1] == pytest.approx(moved[-100], abs=1e-5)  # it stands still
    # At v = 31 mm/s the joints' decay time of about D/K = 20 ms lets it go some millimetre; gravity pulls no further.
    assert 1e-4 < moved.max() < 3e-3
    # to the first resumed step and beyond, until the server's commands are met: a joint's way is at most ``step`` a period
    changes = np.abs(np.diff(run.tau_command, axis=0)).max(axis=1)
    assert changes[round(LOSS / DT) : round(back / DT) + 5].max() <= dog.step * (1.0 + 1e-9)
    assert (
        np.linalg.norm(run.position_error[-1]) < 5e-4
    )  # m, of the 5 mm and more: the integral forgets in some tenths of a second


def test_constant_torque_drops_a_moving_object():
    """What the watchdog's stiffness and damping are for, and that the test above can fail."""
    grasp, gravity_H = allegro()
    plant, reference = plant_and_reference(grasp, gravity_H)
    constant = Watchdog(hold=1.5, stiffness=0.0, damping=0.0)
    assert (
        compute_metrics(simulate(plant, Interrupted(grasp, gravity_H, constant, 2.0), reference, 1.25)).lost_contact_steps > 0
    )


# ── over Zenoh ─────────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("real_time", [False, True])
def test_remote_controller_equals_the_local_one(real_time):
    grasp, gravity_H = allegro()
    plant, reference = plant_and_reference(grasp, gravity_H)
    initial_forces = ObjectController(grasp, settings(gravity_H)).step(plant.reset(), BodyMotion(grasp.p_HO, grasp.R_HO)).f
    here = simulate(plant, ObjectController(grasp, settings(gravity_H)), reference, 0.1, initial_forces=initial_forces)
    with (
        Server([grasp.hand], listen=ANY_LOCAL_PORT) as server,
        Client(server.addresses[0], timeout=TIMEOUT) as client,
        client.open_stream(grasp, settings(gravity_H), validity=TIMEOUT) as stream,
    ):
        driver = StreamController(stream, real_time=real_time)
        there = simulate(plant, driver, reference, 0.1, initial_forces=initial_forces)
    assert driver.late == 0
    assert len(driver.round_trips) + driver.stale_steps == 100
    if real_time:  # a busy machine may well give an earlier state's command; the object follows all the same
        assert compute_metrics(there).position_error_peak < 1e-3
    else:
        assert driver.stale_steps == 0
        np.testing.assert_allclose(there.p_HO, here.p_HO, rtol=0, atol=1e-12)
        np.testing.assert_allclose(there.tau_command, here.tau_command, rtol=0, atol=1e-9)


def test_verbose_server_process_keeps_serving(monkeypatch):
    """Python, asked to, tells every import on standard error: megabytes before the first answer."""
    monkeypatch.setenv("PYTHONVERBOSE", "1")
    with start_server_process("four_finger") as chatty, Client(chatty.address, timeout=TIMEOUT) as client:
        assert client.hands() == ("four_finger",)


def test_failed_server_start_reports_the_reason():
    with (
        pytest.raises(ServiceError, match=r"ended with exit code 1: Error: hand = 'no_such_hand'"),
        start_server_process("no_such_hand"),
    ):
        pass


def test_object_is_held_while_a_killed_server_restarts():
    grasp, gravity_H = allegro()
    plant, reference = plant_and_reference(grasp, gravity_H)
    dog = Watchdog(hold=TIMEOUT)  # starting a process may take a busy machine longer than the default second
    commands = []
    with start_server_process(grasp.hand.name) as first, Client(first.address, timeout=TIMEOUT) as client:
        again = start_server_process(grasp.hand.name, first.address)
        with client.open_stream(grasp, settings(gravity_H), validity=0.2, watchdog=dog) as stream:

            def watch(plant, command):
                commands.append(command)
                if len(commands) == round(LOSS / DT):
                    first.process.kill()
                    first.process.wait()
                elif len(commands) == round((LOSS + 1.0) / DT):
                    again.__enter__()

            try:
                run = simulate(plant, StreamController(stream), reference, LOSS + 2.0, on_step=watch)
            finally:
                again.__exit__(None, None, None)
    late = np.array([command.late for command in commands])
    assert late[round(LOSS / DT) + 1 : round((LOSS + 1.0) / DT)].all()
    back = np.flatnonzero(late)[-1] + 1
    assert back < len(late) - 200, "it came back too late"
    metrics = compute_metrics(run)
    assert (metrics.lost_contact_steps, metrics.reused_force_steps) == (0, 0)
    assert run.slip_margin.min() > 0.0
    underway = late | np.array([command.resuming for command in commands])
    changes = np.abs(np.diff(run.tau_command, axis=0)).max(axis=1)
    assert changes[underway[1:]].max() <= dog.step * (1.0 + 1e-9)  # rounding
    assert np.linalg.norm(run.position_error[-50:], axis=1).max() < 1e-4  # m: it follows again


# ── the driver's time ──────────────────────────────────────────────────────────────────────────────────────────────────────


class Scripted:
    """A stream whose commands are late, of an earlier state, or its own, as a word says; keeps how long it was to wait."""

    def __init__(self, words):
        self.words, self.waits, self.sequence = list(words), [], 0
        self.setup = SimpleNamespace(settings=SimpleNamespace(period=DT), validity=0.05)

    def step(self, state, desired, external, *, wait):
        self.waits.append(wait)
        self.sequence += 1
        word = self.words[self.sequence - 1]
        return SimpleNamespace(late=word == "late", sequence=self.sequence - (word == "earlier"), age=2e-4 * self.sequence)


def test_lockstep_waits_for_commands_but_not_for_a_lost_server():
    stream = Scripted(["own", "earlier", "late", "late", "own", "own"])
    driver = StreamController(stream)
    for _ in stream.words:
        driver.step(None, None)
    assert stream.waits == [0.05, 0.05, 0.05, DT, DT, 0.05]
    assert driver.round_trips == pytest.approx([2e-4, 1e-3, 1.2e-3])
    assert (driver.stale_steps, driver.late) == (1, 2)


def test_real_time_sends_one_state_per_period_and_skips_missed_ones(monkeypatch):
    clock, sent = [5.0], []
    monkeypatch.setattr("time.monotonic", lambda: clock[0])
    monkeypatch.setattr("time.sleep", lambda seconds: clock.__setitem__(0, clock[0] + seconds))
    stream = Scripted(["own"] * 6)
    driver = StreamController(stream, real_time=True)
    for work in (0.2, 0.4, 3.5, 0.1, 0.3, 0.0):  # periods that the plant and the command took
        driver.step(None, None)
        sent.append(clock[0])
        clock[0] += work * DT
    np.testing.assert_allclose((np.array(sent) - 5.0) / DT, [0.0, 1.0, 2.0, 5.5, 6.5, 7.5], atol=1e-6)
    assert stream.waits == [DT] * 6


def test_free_hand_moves_the_same_with_the_law_in_a_service():
    hand = load("four_finger")
    controller, dt = JointController.with_frequency(hand, "pid", 3.0), 1e-3
    reference = minimum_jerk_reference(hand.neutral, hand.neutral + 0.2, 0.05)
    server = LocalServer()
    link = StreamLink(Watchdog(), MSGPACK, 20.0, server.query, server.connect)
    with JointStream("a", JointStreamSetup(controller, dt, validity=20.0), link) as stream:
        remote = run_joints(FreeHandPlant(hand), JointStreamController(stream), reference, 0.1)
    here = run_joints(FreeHandPlant(hand), controller, reference, 0.1)
    np.testing.assert_allclose(remote.tau, here.tau, rtol=0, atol=1e-9)
    assert remote.law == "pid"


def test_cycle_in_a_service_has_the_phases_of_the_stream():
    """The controller ends with the server's phase, and records the phases before."""
    scene = ball_scene()
    plan = plan_cycle(scene, None, CycleMotion(optimised=False))
    setup = PhaseStreamSetup(plan, validity=20.0)
    server = LocalServer(scene.grasp.hand)
    link = StreamLink(Watchdog(), MSGPACK, 20.0, server.query, server.connect)
    local = PhaseController(plan, setup.phases, setup.sensors, setup.settings)
    with PhaseStream("a", setup, link) as stream:
        controller = PhaseStreamController(stream)
        for k in range(30):
            command = controller.step(Measurement(1e-3 * k, plan.q_start))
            expected = local.step(Measurement(1e-3 * k, plan.q_start))
            np.testing.assert_allclose(command.tau, expected.tau, rtol=0, atol=1e-9)
        stream.stop("enough")
        while not controller.is_over:
            k += 1
            controller.step(Measurement(1e-3 * k, plan.q_start))
    assert [(record.phase, record.reason) for record in controller.records] == [("approach", "enough")]
    assert controller.phase == "stopped"
