"""The command `graspforce simulate`: what it says, what it leaves behind, and what it refuses."""

from __future__ import annotations

import io
import re
import sys
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from matplotlib import image
from rich.console import Console
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.servers import ANY_LOCAL_PORT

from graspforce import InvalidInput
from graspforce.cli import main, options, run_simulation
from graspforce.cli.run_simulation import SimulateOptions, SimulateOutput
from graspforce.contact.motion import BodyMotion
from graspforce.service import Server
from graspforce.simulation import (
    Plant,
    Recording,
    build_scene,
    make_renderer,
    missing_display_reason,
    open_viewer,
    plots,
)
from graspforce.simulation.rendering import renderer

SIMULATE_OPTIONS = SimulateOptions(
    grasp=options.GraspOptions("four_finger", "sphere:0.03", None, None, "finger_1,finger_2,finger_4", "0,0,-9.81", 0),
    reference="reach", travel=(0.0, 0.0, 0.002), period=0.2, duration=0.1, pushes=(),
)  # fmt: skip
NOTHING = SimulateOutput(view=False, video=None, frames=None, save=None, plots=None)


def test_the_command_holds_moves_and_leaves_everything_it_was_asked_for(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    options = ["--fingers", "finger_1,finger_2,finger_4", "--travel", "0,0,0.002", "--period", "0.2", "--duration", "0.1"]
    options += ["--push", "0.1,0,0,0.05,0.01", "--save", str(tmp_path / "new" / "run.npz"), "--plots", str(tmp_path / "plots")]
    options += ["--frames", str(tmp_path / "frames"), "--video", str(tmp_path / "film.gif")]
    assert main(["simulate", *options]) == 0
    said = capsys.readouterr().out
    assert "four_finger holds the sphere:0.03 (50 g, μ = 0.7) with finger_1, finger_2, finger_4" in said
    assert "forces outside their cones" in said
    recording = Recording.load(tmp_path / "new" / "run.npz")
    assert len(recording.t) == 100
    assert np.ptp(recording.p_desired[:, 2]) == pytest.approx(0.002, rel=1e-3)  # half a period: from end to end
    assert np.abs(recording.error[55:, 0]).max() > 1e-6  # m: it was pushed
    for name in ("error", "forces", "torques"):
        drawn = image.imread(tmp_path / "plots" / f"{name}.png")
        assert drawn.std() > 0.02
    frames = sorted((tmp_path / "frames").iterdir())
    assert [path.name for path in frames] == [f"{i:05d}.png" for i in range(4)]  # 0, 1, 2 and 3 thirtieths of a second
    assert (tmp_path / "film.gif").read_bytes()[:4] == b"GIF8"


def test_a_finger_that_lets_go_is_exit_code_1(monkeypatch):
    weak = replace(SIMULATE_OPTIONS, pushes=((0.0, 0.0, 40.0, 0.01, 0.05),))
    assert run_simulation.run(SIMULATE_OPTIONS, NOTHING, Console(file=io.StringIO()))
    heard = io.StringIO()
    assert not run_simulation.run(weak, NOTHING, Console(file=heard, width=100))
    assert "slips" in heard.getvalue()


def test_the_controller_may_run_in_a_service_of_its_own(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    options = ["--fingers", "finger_1,finger_2,finger_4", "--travel", "0,0,0.002", "--period", "0.2", "--duration", "0.05"]
    assert main(["simulate", "--serve", *options]) == 0
    said = capsys.readouterr().out
    assert "The controller runs in the service at tcp/127.0.0.1:" in said
    assert re.search(r"from a state to its command over Zenoh +│ \d+\.\d\d ms median, \d+\.\d\d ms at 99 %", said)
    assert re.search("steps with the watchdog's torque +│ [0-9]", said)


def test_a_service_that_is_not_there_or_does_not_serve_the_hand_is_said(capsys):
    options = ["--fingers", "finger_1,finger_2,finger_4", "--duration", "0.05"]
    assert main(["simulate", "--connect", "tcp/127.0.0.1:1", *options]) == 1
    assert "no server at tcp/127.0.0.1:1" in capsys.readouterr().err
    with Server(["dlr_hit2"], listen=ANY_LOCAL_PORT) as server:
        assert main(["simulate", "--connect", server.addresses[0], *options]) == 1
    assert "four_finger" in capsys.readouterr().err
    for asked, why in (("--object=moon", "object = 'moon'"), ("--hand=no_hand", "no_hand")):  # before a server is looked for
        assert main(["simulate", "--connect", "tcp/127.0.0.1:1", asked]) == 1
        assert why in capsys.readouterr().err
    assert main(["simulate", "--connect", "tcp/127.0.0.1:1", "--serve"]) == 1
    assert "left out with --serve" in capsys.readouterr().err
    assert main(["simulate", "--serve", "--pace", "slow"]) == 1
    assert "one of lockstep, real" in capsys.readouterr().err


def test_objects_are_named_or_described():
    body, friction = options.parse_object("box:0.03,0.04,0.05", 0.2, None)
    assert (body.mass, friction) == (0.2, 0.7)
    assert body.shape is not None
    np.testing.assert_array_equal(body.shape.edges, [0.03, 0.04, 0.05])
    body, friction = options.parse_object("small purple cube", None, None)
    assert body.mass == pytest.approx(0.03**3 * 700.0)  # wood
    assert friction == 0.5
    for name in ("small purple cubes", "sphere:", "sphere:1,2", "box:a,b,c"):
        with pytest.raises(InvalidInput, match="object"):
            options.parse_object(name, None, None)


@pytest.mark.parametrize(("kind", "moved"), [("still", 0.0), ("reach", 0.01), ("sine", 0.005), ("turn", 0.0)])
def test_references_begin_where_the_object_is_and_go_as_far_as_was_said(kind, moved):
    grasp = three_finger_grasp()
    follow = run_simulation.reference(replace(SIMULATE_OPTIONS, reference=kind, travel=(0.0, 0.01, 0.0), period=1.0), grasp)
    np.testing.assert_allclose(follow(0.0).p_HO, grasp.p_HO)
    at = follow(0.5 if kind == "reach" else 1.25)
    assert np.linalg.norm(at.p_HO - grasp.p_HO) == pytest.approx(moved)


def test_what_cannot_be_is_refused(capsys, monkeypatch):
    grasp = three_finger_grasp()
    with pytest.raises(InvalidInput, match="still, reach, sine, turn"):
        replace(SIMULATE_OPTIONS, reference="dance")
    with pytest.raises(InvalidInput, match="not zero"):
        run_simulation.reference(replace(SIMULATE_OPTIONS, reference="turn", travel=(0.0, 0.0, 0.0)), grasp)
    monkeypatch.setattr("graspforce.cli.options.find_grasp", None)  # what follows is refused before the search
    plain = ("--reference=dance", "--tips=cone", "--duration=0", "--period=-1", "--object=moon", "--object=sphere:-1")
    for asked in (*plain, "--travel=nan,0,0", "--push=1,0,0,-1,1", "--push=1,0,0,0,nan", "--pace=real"):
        assert main(["simulate", asked]) == 1
        assert re.match(rf"Error: (--)?{asked[2:].partition('=')[0]}\S* = ", capsys.readouterr().err)
    assert main(["simulate", "--reference=turn", "--travel=0,0,0"]) == 1
    assert "travel = [0.0, 0.0, 0.0]: must be a rotation vector that is not zero" in capsys.readouterr().err
    assert main(["simulate", "--gravity", "down"]) == 1
    assert "gravity = 'down': must be 3 numbers" in capsys.readouterr().err
    monkeypatch.setattr("graspforce.simulation.missing_display_reason", lambda: "it is dark")
    with pytest.raises(InvalidInput, match=r"no display \(it is dark\); --video"):
        run_simulation.run(SIMULATE_OPTIONS, replace(NOTHING, view=True), Console(file=io.StringIO()))
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert main(["simulate"]) == 1
    assert "pip install 'graspforce[sim]'" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--save", "--plots", "--frames", "--video"])
def test_where_nothing_can_be_written_is_refused_before_the_search(option, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("graspforce.cli.options.find_grasp", None)
    (tmp_path / "taken").write_text("a file")
    assert main(["simulate", option, str(tmp_path / "taken" / "new")]) == 1
    assert f"Error: {option} = " in capsys.readouterr().err


# ── pictures ───────────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.fixture(scope="module")
def plant() -> Plant:
    return Plant(build_scene(three_finger_grasp(), gravity_H=PALM_UP))


@pytest.mark.parametrize("opengl", [True, False])
def test_a_picture_shows_the_hand_and_the_object(plant, opengl, monkeypatch):
    """With OpenGL where the machine has it, and without: the object's blue and the tips' orange are in it."""
    if not opengl:
        monkeypatch.setattr(renderer, "_GL_BACKENDS", ("none",))
    drawing = make_renderer(plant, 320, 240)
    assert opengl or "no OpenGL here (none: No module named 'mujoco.none')" in drawing.description
    picture = drawing.render(plant).astype(int)
    assert picture.shape == (240, 320, 3)
    red, green, blue = picture.reshape(-1, 3).T
    assert ((blue > red + 30) & (green > red)).sum() > 100
    assert ((red > blue + 60) & (red > green + 30)).sum() > 20
    background = (picture.min(axis=2) > 230).mean()
    assert 0.3 < background < 0.98  # it fills the picture and does not burst it


def test_a_picture_is_the_same_after_another_artist_has_left(plant):
    """What one had in OpenGL is given back without harm to the next."""
    first = make_renderer(plant, 320, 240)
    before = first.render(plant)
    second = make_renderer(plant, 320, 240)
    del first
    np.testing.assert_array_equal(second.render(plant), before)


@pytest.mark.skipif(sys.platform != "linux", reason="DISPLAY is for X11 alone")
def test_a_display_that_is_not_there_is_told_before_the_viewer_ends_the_process(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert "DISPLAY" in missing_display_reason()
    monkeypatch.setenv("DISPLAY", ":4242")  # nobody is there
    assert ":4242" in missing_display_reason()


def test_the_viewer_shows_a_run_and_may_be_closed_in_the_middle(monkeypatch):
    """Where there is a display; `xvfb-run` makes one. Once only: MuJoCo opens no second viewer in a process."""
    if why := missing_display_reason():
        pytest.skip(why)
    shown = []

    class Closing:
        """A user who looks twice."""

        def __init__(self, plant: Plant) -> None:
            self.viewer = open_viewer(plant)
            assert self.viewer.is_running()
            assert self.viewer.opt.flags[mujoco.mjtVisFlag.mjVIS_CONTACTFORCE]

        def __enter__(self):
            return self

        def __exit__(self, *exception):
            self.viewer.close()

        def is_running(self) -> bool:
            return self.viewer.is_running()

        def sync(self) -> None:
            self.viewer.sync()
            shown.append(self.viewer.cam.type)
            if len(shown) == 2:
                self.viewer.close()

    monkeypatch.setattr("graspforce.simulation.open_viewer", Closing)
    assert run_simulation.run(replace(SIMULATE_OPTIONS, duration=0.1), replace(NOTHING, view=True), Console(file=io.StringIO()))
    assert shown == [mujoco.mjtCamera.mjCAMERA_FIXED] * 2


def test_a_moving_object_moves_in_the_picture(plant):
    drawing = make_renderer(plant, 320, 240)
    before = drawing.render(plant).astype(int)
    moved = Plant(plant.scene)
    moved.data.qpos[moved.scene.object_q_address] += 0.02  # m
    moved.step(np.zeros(moved.scene.grasp.hand.n))
    assert (np.abs(drawing.render(moved).astype(int) - before).max(axis=2) > 20).mean() > 0.005


def test_plots_are_drawn_of_a_recording_of_any_number_of_contacts(tmp_path):
    from graspforce.control import ControlSettings, ObjectController
    from graspforce.simulation import constant_reference, simulate

    grasp = three_finger_grasp()
    plant = Plant(build_scene(grasp, gravity_H=PALM_UP))
    controller = ObjectController(grasp, ControlSettings(gravity_H=np.array(PALM_UP)))
    recording = simulate(plant, controller, constant_reference(BodyMotion(grasp.p_HO, grasp.R_HO)), 0.01)
    one = replace(
        recording, fingers=("index",),
        **{name: getattr(recording, name)[:, :1] for name in ("f", "planned", "mu", "R_OC", "planned_R_OC")},
    )  # fmt: skip
    for path in (*plots.save_plots(recording, tmp_path / "three"), *plots.save_plots(one, tmp_path / "one")):
        assert image.imread(path).std() > 0.02
