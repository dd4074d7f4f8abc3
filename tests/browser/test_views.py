"""The views in a browser: meshes, readings, steering, and the pages themselves in a headless Chromium."""

from __future__ import annotations

import dataclasses
import io
import threading
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.headless_browser import CHROMIUM, HeadlessBrowser
from support.simulated_runs import SETTINGS, start_of

from graspforce import Hand, InvalidInput, ObjectController
from graspforce.browser import LiveView, Playback, Readings, ViewAddress
from graspforce.browser.readings import torque_use, winding_temperatures
from graspforce.browser.steering import SteeredController, SteeredReference, left_jacobian
from graspforce.cli import run_stream_view, run_view
from graspforce.cli.live_view import LiveRun
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings
from graspforce.geometry.rotations import rotation_exp
from graspforce.hand.heat import ThermalModel
from graspforce.planning import PathMove, Plan, tracking
from graspforce.service import Client, Server
from graspforce.simulation import (
    Plant,
    Recording,
    build_scene,
    constant_reference,
    linear_reference,
    simulate,
    sine_reference,
)
from graspforce.simulation.rendering import DisplayModel, capture_state
from graspforce.simulation.rendering.marks import recorded_state
from graspforce.simulation.rendering.part_meshes import part_meshes

pytest.importorskip("viser")
GRASP = three_finger_grasp()
SCENE = build_scene(GRASP, gravity_H=PALM_UP)
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")


@pytest.fixture(scope="module")
def recording() -> Recording:
    motion = linear_reference(start_of(GRASP), [0.0, 0.005, 0.004], 0.2)
    return simulate(Plant(SCENE), ObjectController(GRASP, SETTINGS), motion, 0.2)


# ── meshes, recordings, readings ───────────────────────────────────────────────────────────────────────────────────────────


def test_meshes_cover_the_visible_parts_of_the_hand_and_the_object() -> None:
    """The object is a ball: all its vertices are on its surface, and its triangles face outwards."""
    parts = part_meshes(DisplayModel(SCENE))
    assert len({part.name for part in parts}) == len(parts)
    assert len({part.body for part in parts}) > GRASP.hand.n
    ball = [part for part in parts if part.is_object]
    assert len(ball) == 2  # two colours of squares
    for part in ball:
        np.testing.assert_allclose(np.linalg.norm(part.vertices, axis=1), 0.03, atol=1e-5)
        corners = part.vertices[part.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert (np.einsum("ni,ni->n", normals, corners.mean(axis=1)) > 0.0).all()
    area = sum(
        np.linalg.norm(
            np.cross(*(part.vertices[part.faces][:, k] - part.vertices[part.faces][:, 0] for k in (1, 2))), axis=1
        ).sum()
        / 2
        for part in ball
    )
    assert area == pytest.approx(4.0 * np.pi * 0.03**2, rel=0.02)  # of a ball with 36 × 18 divisions


def test_a_recorded_state_is_that_of_the_plant(recording: Recording) -> None:
    """Row i of a recording has the state before step i and the forces in it."""
    plant, states = Plant(SCENE), []
    motion = linear_reference(start_of(GRASP), [0.0, 0.005, 0.004], 0.2)
    simulate(
        plant, ObjectController(GRASP, SETTINGS), motion, 0.2, on_step=lambda plant, _: states.append(capture_state(plant))
    )
    shown = recorded_state(SCENE, recording, 100)
    np.testing.assert_allclose(shown.qpos, states[99].qpos, atol=1e-12)  # after step 99
    for mark, expected in zip(shown.contacts, states[100].contacts, strict=True):
        assert mark.finger == expected.finger
        assert mark.use == pytest.approx(expected.use, abs=1e-9)
        assert mark.f_n == pytest.approx(expected.f_n, abs=1e-9)


def test_a_recording_keeps_its_grasp(recording: Recording, tmp_path) -> None:
    recording.save(tmp_path / "run.npz")
    assert Recording.load(tmp_path / "run.npz").grasp == GRASP.to_dict()


def test_torque_use_is_relative_to_the_limit_in_the_same_direction() -> None:
    use = torque_use(
        np.array([0.5, -0.5, 0.0, 3.0, 1.0]), np.array([-1, -2, -1, -np.inf, 0.0]), np.array([1, 1, 1, np.inf, 0.0])
    )
    np.testing.assert_array_equal(use, [0.5, 0.25, 0.0, 0.0, 1.0])


def test_readings_of_a_recording_are_its_margins_and_errors(recording: Recording) -> None:
    readings = Readings.of_recording(recording)
    np.testing.assert_array_equal([each.slip_margin for each in readings], recording.slip_margin)
    assert max(each.position_error for each in readings) == pytest.approx(
        1e3 * np.linalg.norm(recording.position_error, axis=1).max()
    )


def test_on_step_ends_a_run_by_returning_false() -> None:
    run = simulate(
        Plant(SCENE), ObjectController(GRASP, SETTINGS), constant_reference(start_of(GRASP)), 0.1,
        on_step=lambda plant, _: plant.t < 0.0295,
    )  # fmt: skip
    assert len(run.t) == 30


# ── steering ───────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_the_left_jacobian_maps_rates_of_rotation_vectors_to_angular_velocities() -> None:
    rng, h = np.random.default_rng(3), 1e-6
    for scale in (0.0, 1e-5, 0.3, 2.0):
        r, rate = scale * rng.normal(size=3), rng.normal(size=3)
        change = np.asarray(rotation_exp(r + h * rate)) @ np.asarray(rotation_exp(r - h * rate)).T / (2.0 * h)
        omega = 0.5 * np.array([change[2, 1] - change[1, 2], change[0, 2] - change[2, 0], change[1, 0] - change[0, 1]])
        np.testing.assert_allclose(left_jacobian(r) @ rate, omega, atol=1e-8)


def test_a_steered_motion_reaches_the_sliders_and_has_the_twist_of_its_pose() -> None:
    view = SimpleNamespace(offset=np.zeros(6), slip_margin=None)
    steered, dt = SteeredReference(linear_reference(start_of(GRASP), [0.0, 0.004, 0.0], 0.5), view), 1e-3
    motions: list[BodyMotion] = []
    for k in range(3000):
        if k == 100:
            view.offset = np.array([0.004, 0.0, -0.002, 0.1, -0.05, 0.2])
        motions.append(steered(k * dt))
    end = motions[-1]
    plain = linear_reference(start_of(GRASP), [0.0, 0.004, 0.0], 0.5)(2.999)
    np.testing.assert_allclose(end.p_HO - plain.p_HO, view.offset[:3], atol=1e-6)
    np.testing.assert_allclose(end.R_HO, np.asarray(rotation_exp(view.offset[3:])) @ plain.R_HO, atol=1e-5)
    for before, after in zip(motions[150:600:30], motions[151:601:30], strict=True):
        np.testing.assert_allclose((after.p_HO - before.p_HO) / dt, after.twist[:3], atol=2e-4)  # first order in dt
        turn = after.R_HO @ before.R_HO.T
        omega = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / dt
        np.testing.assert_allclose(omega, after.twist[3:], atol=2e-3)


def test_the_squeeze_follows_the_slider_without_a_step_of_the_torques() -> None:
    view = SimpleNamespace(offset=np.zeros(6), slip_margin=0.5)
    controller = SteeredController(ObjectController(GRASP, SETTINGS), view)
    torques, margins = [], []

    def on_step(plant: Plant, command) -> None:
        torques.append(command.tau)
        margins.append(command.slip_margin.min())
        view.slip_margin = 1.0 if plant.t > 0.02 else 0.5

    simulate(Plant(SCENE), controller, constant_reference(start_of(GRASP)), 0.2, on_step=on_step)
    assert 0.5 - 1e-9 <= margins[10] < 0.75  # at least the wanted one; the friction reserve adds to it
    assert 1.0 - 1e-9 <= margins[-1] < 1.5
    assert np.abs(np.diff(torques[5:], axis=0)).max() < 0.01  # N·m a period, as in streams


# ── pages ──────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@needs_chromium
def test_a_recording_is_shown_scrubbed_and_played(recording: Recording) -> None:
    playback = Playback(SCENE, recording, ViewAddress(port=8431))
    thread = threading.Thread(target=playback.run, args=(600.0,), daemon=True)
    thread.start()
    browser = HeadlessBrowser(playback.url, 1000, 800)
    try:
        browser.wait(lambda: "slip margin, N" in browser.text())
        browser.wait(lambda: browser.image()[:, :600].min() < 120)  # the hand is drawn
        before = browser.image()[:, :600].astype(int)
        assert browser.number_after("t =") == 0.0
        playback._timeline.value = 0.1
        browser.wait(lambda: browser.number_after("t =") == pytest.approx(0.1, abs=2e-3))
        browser.wait(lambda: (np.abs(browser.image()[:, :600] - before).max(axis=2) > 20).sum() > 200)  # the ball moved
        browser.click("Play")
        browser.wait(lambda: "Hold" in browser.text())
        moved = browser.number_after("t =")
        browser.wait(lambda: browser.number_after("t =") != moved)
    finally:
        browser.close()
        playback.close()


@needs_chromium
def test_the_live_page_pauses_and_stops_a_run() -> None:
    plant = Plant(SCENE)
    view = LiveView(DisplayModel(SCENE), "Allegro", 0.5, ViewAddress(port=8441))
    browser = HeadlessBrowser(view.url, 1000, 800)
    try:
        browser.wait(lambda: "Desired pose" in browser.text())
        controller = ObjectController(GRASP, SETTINGS)
        command = controller.step(plant.reset(), start_of(GRASP))
        view.show(capture_state(plant), Readings.of_command(1.25, command, GRASP.hand, 0.3))
        browser.wait(lambda: "t = 1.25 s" in browser.text())
        browser.click("Pause")
        browser.wait(lambda: "Continue" in browser.text())
        waiting = threading.Thread(target=view.wait_while_paused, daemon=True)
        waiting.start()
        waiting.join(0.3)
        assert waiting.is_alive()
        browser.click("Continue")
        waiting.join(10.0)
        assert not waiting.is_alive()
        assert not view.is_stopped
        browser.click("Stop")
        browser.wait(lambda: view.is_stopped)
        np.testing.assert_array_equal(view.offset, np.zeros(6))
    finally:
        browser.close()
        view.close()


def moving_recording(recording: Recording) -> Recording:
    """Return the recording with a thumb that bends at 30 °/s."""
    q = np.array(recording.q)
    q[:, list(GRASP.hand.finger("thumb").joints)[2:]] += np.radians(30.0) * recording.t[:, None]
    return dataclasses.replace(recording, q=q)


def test_a_played_recording_shows_the_motions_of_the_fingers(recording: Recording) -> None:
    playback = Playback(SCENE, moving_recording(recording), ViewAddress(port=8461))
    try:
        assert "thumb: close" in playback.status
        assert "index: " in playback.status
    finally:
        playback.close()


def test_a_running_simulation_shows_the_motions_of_the_fingers() -> None:
    """The thumb of a stand-in for the plant bends at 30 °/s, until the page shows its motion."""
    view, plant, shown = LiveView(DisplayModel(SCENE), "Allegro", None, ViewAddress(port=8471)), Plant(SCENE), []
    still = plant.reset()
    command = ObjectController(GRASP, SETTINGS).step(still, BodyMotion(GRASP.p_HO, GRASP.R_HO))
    bending = np.zeros(GRASP.hand.n)
    bending[list(GRASP.hand.finger("thumb").joints)[2:]] = np.radians(30.0)

    def show(state, readings) -> None:
        shown.append(readings)
        view.show(state, readings)

    run = LiveRun(SimpleNamespace(show=show, wait_while_paused=lambda: None, is_stopped=False))
    parts = {name: getattr(plant, name) for name in ("scene", "true_contacts", "object_motion", "data")}
    try:
        for k in range(5000):
            state = dataclasses.replace(still, q=still.q + 1e-3 * k * bending)
            run.follow(SimpleNamespace(t=1e-3 * k, state=lambda state=state: state, **parts), command)
            if shown[-1].motions:
                break
        assert shown[0].motions == {}
        assert set(shown[-1].motions) == set(GRASP.fingers)
        assert shown[-1].motions["thumb"].startswith("close")
        assert shown[-1].motion_text.count("rest") == len(GRASP.fingers) - 1
    finally:
        view.close()


@needs_chromium
def test_a_plan_is_shown_scrubbed_and_played_slowly() -> None:
    task = dataclasses.replace(tracking.object_task(GRASP, SETTINGS), collisions=None)
    p_HO, R_HO = GRASP.p_HO + np.array([[0.0, 0.0, 0.0], [0.0, 0.005, 0.004]]), np.array([GRASP.R_HO] * 2)
    plan = PathMove(task, p_HO, R_HO, "straight", q_start=GRASP.q).plan(budget=30.0)
    assert isinstance(plan, Plan)
    playback = Playback(SCENE, plan, ViewAddress(port=8461))
    thread = threading.Thread(target=playback.run, args=(600.0,), daemon=True)
    thread.start()
    browser = HeadlessBrowser(playback.url, 1000, 800)
    try:
        browser.wait(lambda: "speed of the object, mm/s" in browser.text())
        browser.wait(lambda: browser.image()[:, :600].min() < 120)  # the hand is drawn
        before = browser.image()[:, :600].astype(int)
        assert browser.number_after("speed") == 0.0
        playback._timeline.value = 0.5 * plan.duration
        browser.wait(lambda: browser.number_after("t =") == pytest.approx(0.5 * plan.duration, abs=2e-3))
        assert browser.number_after("speed") > 10.0  # mm/s
        browser.wait(lambda: (np.abs(browser.image()[:, :600] - before).max(axis=2) > 20).sum() > 200)  # the ball moved
        browser.click("Play")
        browser.wait(lambda: "Hold" in browser.text())
    finally:
        browser.close()
        playback.close()


@needs_chromium
def test_a_running_stream_is_shown_paused_and_gone_back_through() -> None:
    """A driver in one thread and the view in another; the view reads the stream as a monitor."""
    url, ended = [], threading.Event()
    with Server([GRASP.hand], listen="tcp/127.0.0.1:0") as server, Client(server.addresses[0], timeout=30.0) as client:

        def drive() -> None:
            settings = ControlSettings(gravity_H=PALM_UP)
            with client.open_stream(GRASP, settings, validity=30.0) as stream:
                url.append(stream.id)
                plant, motion = Plant(SCENE), sine_reference(start_of(GRASP), [0.0, 0.004, 0.0], 1.0)
                state = plant.reset()
                while not ended.wait(1e-3):
                    state = plant.step(stream.step(state, motion(plant.t), wait=30.0).tau)

        driver = threading.Thread(target=drive, daemon=True)
        driver.start()
        HeadlessBrowser.wait(lambda: url)
        options = run_stream_view.StreamViewOptions(server.addresses[0], url[0], (), ViewAddress(port=8471))
        text = io.StringIO()
        viewer = threading.Thread(target=run_stream_view.run, args=(options, Console(file=text, width=200), 600.0), daemon=True)
        viewer.start()
        HeadlessBrowser.wait(lambda: "http://" in text.getvalue())
        browser = HeadlessBrowser("http://" + text.getvalue().split("http://")[1].split()[0], 1000, 800)
        try:
            browser.wait(lambda: "position error" in browser.text())
            browser.wait(lambda: browser.image()[:, :600].min() < 120)
            first = browser.number_after("t =")
            browser.wait(lambda: browser.number_after("t =") > first + 0.5)
            browser.click("Pause")
            browser.wait(lambda: "Follow" in browser.text())
            browser.wait(lambda: browser.number_after("t =") == browser.number_after("t ="))
            held = browser.number_after("t =")
            browser.set_number("back, s", 0.4)
            browser.wait(lambda: held - 0.9 < browser.number_after("t =") < held - 0.2)
            browser.click("Follow")
            browser.wait(lambda: browser.number_after("t =") > held)
        finally:
            browser.close()
            ended.set()
            driver.join(120.0)
            viewer.join(120.0)  # it ends with the stream
    assert not driver.is_alive()
    assert not viewer.is_alive()


def test_the_command_shows_a_recording_with_its_grasp_only(recording: Recording, tmp_path) -> None:
    from dataclasses import replace

    recording.save(tmp_path / "run.npz")
    replace(recording, grasp=None).save(tmp_path / "bare.npz")
    text = io.StringIO()
    address = ViewAddress(port=8451)
    run_view.run(run_view.ViewOptions(tmp_path / "run.npz", PALM_UP, address, False), Console(file=text), duration=0.1)
    assert "View: http://127.0.0.1:" in text.getvalue()
    (tmp_path / "words.npz").write_text("no archive")
    with pytest.raises(InvalidInput, match="no archive of NumPy"):
        Recording.load(tmp_path / "words.npz")
    with pytest.raises(InvalidInput, match="with its grasp"):
        run_view.run(run_view.ViewOptions(tmp_path / "bare.npz", PALM_UP, address, False), Console(file=text), duration=0.1)
    with pytest.raises(InvalidInput, match="port"):
        ViewAddress(port=0)


def test_the_load_of_a_recording_at_rest_is_the_mass_of_the_object(recording: Recording) -> None:
    """Contacts carry the weight: their force is m g upwards, and they carry the mass of the object."""
    still = simulate(Plant(SCENE), ObjectController(GRASP, SETTINGS), constant_reference(start_of(GRASP)), 0.3)
    load = recorded_state(SCENE, still, -1).load
    assert load is not None
    assert load.carried == pytest.approx(GRASP.body.mass, rel=1e-3)
    assert load.force == pytest.approx(GRASP.body.mass * np.linalg.norm(PALM_UP), rel=1e-3)
    assert load.moment < 1e-5  # N·m, about the centre of mass
    np.testing.assert_allclose(load.arrow / np.linalg.norm(load.arrow), -np.array(PALM_UP) / np.linalg.norm(PALM_UP), atol=1e-3)
    assert f"load {1e3 * GRASP.body.mass:.0f} g" in load.text
    lost = dataclasses.replace(still, touching=np.zeros_like(still.touching))
    assert recorded_state(SCENE, lost, -1).load is None


def test_windings_of_a_recording_warm_up_as_the_thermal_model_says() -> None:
    hand = Hand.load("leap_right")
    t = np.arange(5000) * 1e-3
    tau = np.full((len(t), hand.n), 0.2)  # N·m
    model = ThermalModel.for_hand(hand)
    end = model.step(model.at_rest(), model.currents(tau[0]), 1.0)
    for _ in range(3):
        end = model.step(end, model.currents(tau[0]), 1.0)
    temperatures = winding_temperatures(hand, t, tau)
    np.testing.assert_array_equal(temperatures[0], model.at_rest().winding)
    np.testing.assert_allclose(temperatures[4000] - temperatures[0], end.winding - temperatures[0], rtol=0.02)
    assert (np.diff(temperatures, axis=0) >= 0.0).all()
