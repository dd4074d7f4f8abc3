"""The command `graspforce simulate`: what it says, what it leaves behind, and what it refuses."""

from __future__ import annotations

import io
import re
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from matplotlib import image
from PIL import Image as PillowImage
from rich.console import Console
from scipy.spatial.transform import Rotation
from support.allegro_grasp import three_finger_grasp
from support.meshes import box_mesh
from support.servers import ANY_LOCAL_PORT

from graspforce import InvalidInput
from graspforce.cli import main, options, run_simulation
from graspforce.cli.reference_motion import make_reference
from graspforce.cli.run_simulation import SimulateOutput
from graspforce.cli.simulate_options import SimulateOptions
from graspforce.core.errors import ModelError
from graspforce.service import Server
from graspforce.simulation import Plant, Recording
from graspforce.simulation.rendering import DisplayModel, Viewer, missing_display_reason

SIMULATE_OPTIONS = SimulateOptions(
    grasp=options.GraspOptions("four_finger", "sphere:0.03", None, None, "finger_1,finger_2,finger_4", "0,0,-9.81", 0),
    reference="reach", travel=(0.0, 0.0, 0.002), period=0.2, duration=0.1, pushes=(),
)  # fmt: skip
NOTHING = SimulateOutput(view=None, video=None, frames=None, save=None, plots=None)


def test_command_simulates_and_writes_all_outputs(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    options = ["--fingers", "finger_1,finger_2,finger_4", "--travel", "0,0,0.002", "--period", "0.2", "--duration", "0.1"]
    options += ["--push", "0.1,0,0,0.05,0.01", "--save", str(tmp_path / "new" / "run.npz"), "--plots", str(tmp_path / "plots")]
    options += ["--frames", str(tmp_path / "frames"), "--video", str(tmp_path / "film.gif")]
    assert main(["simulate", *options]) == 0
    said = capsys.readouterr().out
    assert "four_finger holds the sphere:0.03 (50 g, μ = 0.7) with finger_1, finger_2, finger_4" in said
    assert "forces outside their friction cones" in said
    recording = Recording.load(tmp_path / "new" / "run.npz")
    assert len(recording.t) == 100
    assert np.ptp(recording.p_desired[:, 2]) == pytest.approx(0.002, rel=1e-3)  # half a period: from end to end
    assert np.abs(recording.position_error[55:, 0]).max() > 1e-6  # m: it was pushed
    for name in ("error", "forces", "torques"):
        drawn = image.imread(tmp_path / "plots" / f"{name}.png")
        assert drawn.std() > 0.02
    frames = sorted((tmp_path / "frames").iterdir())
    assert [path.name for path in frames] == [f"{i:05d}.png" for i in range(4)]  # 0, 1, 2 and 3 thirtieths of a second
    assert (tmp_path / "film.gif").read_bytes()[:4] == b"GIF8"
    with PillowImage.open(frames[-1]) as frame, PillowImage.open(tmp_path / "film.gif") as film:
        assert frame.size == (1280, 720)
        assert (film.size, film.n_frames, film.info["loop"]) == ((640, 360), 2, 0)  # 15 frames a second, endless


def test_lost_contact_exits_with_1(monkeypatch):
    weak = replace(SIMULATE_OPTIONS, pushes=((0.0, 0.0, 40.0, 0.01, 0.05),))
    assert run_simulation.run(SIMULATE_OPTIONS, NOTHING, Console(file=io.StringIO()))
    heard = io.StringIO()
    assert not run_simulation.run(weak, NOTHING, Console(file=heard, width=100))
    assert "slips" in heard.getvalue()


def test_controller_can_run_in_a_service(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    options = ["--fingers", "finger_1,finger_2,finger_4", "--travel", "0,0,0.002", "--period", "0.2", "--duration", "0.05"]
    assert main(["simulate", "--serve", *options]) == 0
    said = capsys.readouterr().out
    assert "The controller runs in the service at tcp/127.0.0.1:" in said
    assert re.search(r"round trip over Zenoh, state to command +│ \d+\.\d\d ms median, \d+\.\d\d ms at 99 %", said)
    assert re.search("steps with the watchdog's torque +│ [0-9]", said)


def test_missing_service_or_hand_is_reported(capsys):
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
    assert "given without --serve" in capsys.readouterr().err
    assert main(["simulate", "--serve", "--pace", "slow"]) == 1
    assert "one of lockstep, real" in capsys.readouterr().err


def test_objects_are_parsed_by_name_or_shape():
    body, friction = options.parse_object("box:0.03,0.04,0.05", 0.2, None)
    assert (body.mass, friction) == (0.2, 0.7)
    assert body.shape is not None
    np.testing.assert_array_equal(body.shape.edges, [0.03, 0.04, 0.05])
    body, friction = options.parse_object("small purple cube", None, None)
    assert body.mass == pytest.approx(0.03**3 * 700.0)  # wood
    assert friction == 0.5
    body, _ = options.parse_object("superquadric:0.03,0.02,0.04,0.7,0.9", None, None)
    np.testing.assert_array_equal(body.shape.axes, [0.03, 0.02, 0.04])
    np.testing.assert_array_equal(body.shape.exponents, [0.7, 0.9])
    for name in ("small purple cubes", "sphere:", "sphere:1,2", "box:a,b,c", "superquadric:1,2,3", "superquadric:1,1,1,1,3"):
        with pytest.raises(InvalidInput, match="object"):
            options.parse_object(name, None, None)


def test_a_mesh_is_read_in_the_unit_of_its_file(tmp_path):
    pytest.importorskip("trimesh")
    vertices, faces = box_mesh([50.0, 40.0, 60.0], centre=(5.0, 0.0, 0.0))
    lines = [f"v {x} {y} {z}" for x, y, z in vertices] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    file = tmp_path / "part.obj"
    file.write_text("\n".join(lines))
    body, friction = options.parse_object(f"mesh:{file},0.001", None, 0.4)
    assert (body.mass, friction) == (0.05, 0.4)
    np.testing.assert_allclose(body.p_OM, [0.005, 0.0, 0.0], atol=1e-12)
    assert body.shape.volume == pytest.approx(0.05 * 0.04 * 0.06)
    assert options.parse_object(f"mesh:{file}", None, None)[0].shape.volume == pytest.approx(50.0 * 40.0 * 60.0)
    with pytest.raises(ModelError, match=r"none\.stl"):
        options.parse_object("mesh:none.stl,0.001", None, None)


@pytest.mark.parametrize(("kind", "moved"), [("still", 0.0), ("reach", 0.01), ("sine", 0.005), ("turn", 0.0)])
def test_references_start_at_the_object_and_cover_the_travel(kind, moved):
    grasp = three_finger_grasp()
    follow = make_reference(replace(SIMULATE_OPTIONS, reference=kind, travel=(0.0, 0.01, 0.0), period=1.0), grasp)
    np.testing.assert_allclose(follow(0.0).p_HO, grasp.p_HO)
    at = follow(0.5 if kind == "reach" else 1.25)
    assert np.linalg.norm(at.p_HO - grasp.p_HO) == pytest.approx(moved)


def test_turn_adds_a_rotation_with_its_own_period():
    grasp = three_finger_grasp()
    options = replace(SIMULATE_OPTIONS, travel=(0.0, 0.01, 0.0), period=1.0, turn=(0.0, 0.0, 0.3), turn_period=0.5)
    follow = make_reference(options, grasp)
    quarter, half = follow(0.25), follow(0.5)
    turned = Rotation.from_matrix(quarter.R_HO @ grasp.R_HO.T).as_rotvec()
    np.testing.assert_allclose(turned, [0.0, 0.0, 0.3], atol=1e-12)
    np.testing.assert_allclose(half.p_HO - grasp.p_HO, [0.0, 0.01, 0.0], atol=1e-12)
    np.testing.assert_allclose(half.R_HO, grasp.R_HO, atol=1e-12)
    with pytest.raises(InvalidInput, match="zero with --reference turn"):
        replace(options, reference="turn")


def test_impossible_options_are_rejected(capsys, monkeypatch):
    grasp = three_finger_grasp()
    with pytest.raises(InvalidInput, match="still, reach, sine, turn"):
        replace(SIMULATE_OPTIONS, reference="dance")
    with pytest.raises(InvalidInput, match="not zero"):
        make_reference(replace(SIMULATE_OPTIONS, reference="turn", travel=(0.0, 0.0, 0.0)), grasp)
    monkeypatch.setattr("graspforce.cli.options.find_grasp", None)  # what follows is refused before the search
    plain = ("--reference=dance", "--tips=cone", "--duration=0", "--period=-1", "--object=moon", "--object=sphere:-1")
    for asked in (*plain, "--travel=nan,0,0", "--push=1,0,0,-1,1", "--push=1,0,0,0,nan", "--pace=real"):
        assert main(["simulate", asked]) == 1
        assert re.match(rf"Error: (--)?{asked[2:].partition('=')[0]}\S* = ", capsys.readouterr().err)
    assert main(["simulate", "--reference=turn", "--travel=0,0,0"]) == 1
    assert "travel = [0.0, 0.0, 0.0]: must be a rotation vector that is not zero" in capsys.readouterr().err
    assert main(["simulate", "--gravity", "down"]) == 1
    assert "gravity = 'down': must be 3 numbers" in capsys.readouterr().err
    monkeypatch.setattr("graspforce.cli.run_simulation.missing_display_reason", lambda: "it is dark")
    with pytest.raises(InvalidInput, match=r"no display \(it is dark\); use --video"):
        replace(NOTHING, view="window")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert main(["simulate"]) == 1
    assert 'pip install "graspforce[sim]"' in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--save", "--plots", "--frames", "--video"])
def test_unwritable_output_is_rejected_before_the_search(option, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("graspforce.cli.options.find_grasp", None)
    (tmp_path / "taken").write_text("a file")
    assert main(["simulate", option, str(tmp_path / "taken" / "new")]) == 1
    assert f"Error: {option} = " in capsys.readouterr().err


# ── viewer ────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_closing_the_viewer_does_not_end_the_run_early(monkeypatch):
    """Needs a display; `xvfb-run` makes one. MuJoCo opens one viewer per process only."""
    if why := missing_display_reason():
        pytest.skip(why)
    shown = []

    class ClosingViewer(Viewer):
        """A user who closes the window after two images."""

        def __init__(self, display: DisplayModel) -> None:
            super().__init__(display)
            assert self.is_running()

        def show(self, plant: Plant) -> None:
            super().show(plant)
            assert self.handle.user_scn.ngeom >= 2 * len(plant.scene.grasp.fingers)  # arrows and cones
            shown.append(self.handle.cam.type)
            if len(shown) == 2:
                self.close()

    monkeypatch.setattr("graspforce.cli.step_callbacks.Viewer", ClosingViewer)
    assert run_simulation.run(
        replace(SIMULATE_OPTIONS, duration=0.1), replace(NOTHING, view="window"), Console(file=io.StringIO())
    )
    assert shown == [mujoco.mjtCamera.mjCAMERA_FIXED] * 2


def test_power_grasp_is_held_and_motions_that_it_does_not_allow_are_refused(capsys):
    command = ["simulate", "--hand", "dlr_hit2", "--object", "sphere:0.03", "--friction", "0.6", "--class", "power"]
    assert main([*command, "--reference", "still", "--duration", "0.02"]) == 0
    assert "dlr_hit2 holds the sphere:0.03 (50 g, μ = 0.6) with palm" in capsys.readouterr().out
    assert main([*command, "--duration", "0.02"]) == 0
    assert "The object is held still" in capsys.readouterr().out
    assert main([*command, "--reference", "reach", "--travel", "0,0,0.01"]) == 1
    assert "--reference = 'reach': must be still: the contacts with palm" in capsys.readouterr().err
    assert main([*command, "--reference", "still", "--serve"]) == 1
    assert "--class = 'power': must be a class of fingertips with a service" in capsys.readouterr().err
    assert main([*command, "--fingers", "thumb,index", "--reference", "still"]) == 1
    assert "--fingers = 'thumb,index': must be absent for the class power" in capsys.readouterr().err
    assert main([*command, "--campaign", "2"]) == 1
    assert "--class = 'power': must be absent with --campaign" in capsys.readouterr().err
