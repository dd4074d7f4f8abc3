"""``graspforce glove``: frames become a calibration, and lead hands."""

from __future__ import annotations

import io
import json
import os
import threading
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from support.control_requests import HAND
from support.gloves import calibration_of, operator_frames, pose_frames
from support.servers import ANY_LOCAL_PORT

from graspforce.cli import main, options
from graspforce.hand.collision import HandCollision
from graspforce.learning import GloveCalibration, PostureLibrary, SimulatedGlove
from graspforce.service import Server
from graspforce.simulation import Recording

JOINTS, LOWER, UPPER = ("a", "b", "c"), np.zeros(3), np.full(3, 1.5)


@pytest.fixture
def files(tmp_path):
    """Return the files of 40 postures, and of 10 frames in each."""
    rng = np.random.default_rng(0)
    q, glove = rng.uniform(LOWER, UPPER, (40, 3)), SimulatedGlove(LOWER, UPPER)
    PostureLibrary(JOINTS, q).save(tmp_path / "postures.csv")
    np.savetxt(tmp_path / "frames.csv", glove.readings(np.repeat(q, 10, axis=0), rng), delimiter=",")
    return [str(tmp_path / "postures.csv"), str(tmp_path / "frames.csv")]


def test_a_calibration_is_saved_and_its_errors_are_shown(files, tmp_path, capsys):
    file = tmp_path / "glove.json"
    assert main(["glove", "calibrate", *files, "--save", str(file)]) == 0
    assert "mean error" in capsys.readouterr().out
    readings = SimulatedGlove(LOWER, UPPER, noise=0.0).readings([[0.3, 0.6, 0.9]], np.random.default_rng(1))
    np.testing.assert_allclose(GloveCalibration.load(file).posture(readings[0]), [0.3, 0.6, 0.9], atol=np.radians(2.0))
    assert main(["glove", "calibrate", *files, "--save", str(file)]) == 1
    assert "--force" in capsys.readouterr().err


def test_errors_are_a_record(files, capsys):
    assert main(["glove", "calibrate", *files, "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert set(record["mean_error"]) == set(JOINTS)
    assert max(record["mean_error"].values()) < np.radians(2.0)


@pytest.mark.parametrize(
    ("text", "message"), [("1,2,3\n", "multiple of 40"), ("1,2,3\n1,x,3\n", "frame 2"), ("1,2,3\n1,2\n", "frame 2")]
)
def test_invalid_frames_are_refused(text, message, files, tmp_path, capsys):
    (tmp_path / "frames.csv").write_text(text)
    assert main(["glove", "calibrate", *files]) == 1
    assert message in capsys.readouterr().err


def test_postures_of_a_calibration_are_reachable(tmp_path, capsys):
    file = tmp_path / "postures.csv"
    assert main(["glove", "postures", HAND.name, str(file), "--count", "12", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"postures": 12, "file": str(file)}
    library, collision = PostureLibrary.load(file), HandCollision(HAND)
    assert (library.joints, len(library)) == (HAND.joint_names, 12)
    for q in library.q:
        assert ((HAND.q_lower <= q) & (q <= HAND.q_upper)).all()
        gaps = collision.link_gaps(q)
        assert not gaps or gaps[0].distance >= 0.0


@pytest.mark.parametrize("source", ["standard input", "pipe"])
def test_a_guided_sequence_calibrates_a_running_glove(files, source, tmp_path, capsys, monkeypatch):
    """The operator needs three frames to take a posture: they are random, and skipped."""
    rng, library = np.random.default_rng(2), PostureLibrary.load(files[0])
    glove, lines = SimulatedGlove(LOWER, UPPER), []
    for q in library.q:
        lines += glove.readings(np.vstack([rng.uniform(LOWER, UPPER, (3, 3)), np.tile(q, (10, 1))]), rng).tolist()
    text = "".join(",".join(map(str, line)) + "\n" for line in lines)
    frames, file = "-", tmp_path / "glove.json"
    if source == "pipe":
        frames = str(tmp_path / "glove")
        os.mkfifo(frames)
        threading.Thread(target=Path(frames).write_text, args=(text,), daemon=True).start()
    else:
        monkeypatch.setattr("sys.stdin", io.StringIO(text))
    guide = ["--guide", "--per-posture", "10", "--skip", "3", "--save", str(file)]
    assert main(["glove", "calibrate", files[0], frames, *guide]) == 0
    said = capsys.readouterr()
    assert "Posture 40 of 40: " in said.err
    assert max(GloveCalibration.load(file).mean_error) < np.radians(2.0)
    monkeypatch.setattr("sys.stdin", io.StringIO(text[: text.index("\n", len(text) // 2) + 1]))
    assert main(["glove", "calibrate", files[0], "-", *guide, "--force"]) == 1
    assert "frames for 40 postures" in capsys.readouterr().err


@pytest.fixture
def operator(tmp_path):
    """Return a function that writes frames and calibration, and returns their names."""

    def write(frames):
        calibration_of(HAND).save(tmp_path / "operator.json")
        np.savetxt(tmp_path / "operator.csv", frames, delimiter=",")
        return [str(tmp_path / "operator.csv"), str(tmp_path / "operator.json")]

    return write


def test_a_glove_leads_a_held_object_over_a_stream(operator, tmp_path, capsys):
    grasp_options = options.GraspOptions(HAND.name, "sphere:0.03", None, None, None, "0,0,-9.81", 0)
    grasp = grasp_options.search(Console(file=io.StringIO()))
    frames = pose_frames(grasp, [[0.0, 0.0, s] for s in np.linspace(0.0, 0.003, 18)], noise=0.001)
    with Server([HAND], listen=ANY_LOCAL_PORT) as server:
        command = ["glove", "stream", *operator(frames), "--hand", HAND.name, "--connect", server.addresses[0]]
        assert main([*command, "--save", str(tmp_path / "run.npz")]) == 0
    said = capsys.readouterr().out
    assert "round trip over Zenoh" in said
    recording = Recording.load(tmp_path / "run.npz")
    assert recording.t[-1] == pytest.approx(18 / 60.0, abs=2e-3)
    assert recording.p_desired[-1, 2] - recording.p_desired[0, 2] > 5e-4
    assert np.linalg.norm(recording.p_HO - recording.p_desired, axis=1).max() < 1e-3


def test_a_glove_leads_a_free_hand_over_a_stream(operator, capsys):
    goal = HAND.neutral + 0.2 * (HAND.q_upper - HAND.neutral)
    frames = operator_frames(HAND, [HAND.neutral + s * (goal - HAND.neutral) for s in np.linspace(0, 1, 20)])
    with Server([HAND], listen=ANY_LOCAL_PORT) as server:
        command = ["glove", "stream", *operator(frames), "--hand", HAND.name, "--free", "--connect", server.addresses[0]]
        assert main([*command, "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["frames"] == 20
    assert max(record["tracking_error"]) < np.radians(5.0)


def test_a_running_glove_leads_in_real_time(operator, capsys, monkeypatch):
    files = operator(operator_frames(HAND, [HAND.neutral] * 3))
    monkeypatch.setattr("sys.stdin", io.StringIO(Path(files[0]).read_text()))
    assert main(["glove", "stream", "-", files[1], "--hand", HAND.name, "--free", "--duration", "0.1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["frames"] >= 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--pairs", "finger_1"], "--pairs"),
        (["--pairs", "finger_1=tail"], "tail"),
        (["--gain", "0"], "--gain"),
        (["--glove-rate", "0"], "--glove-rate"),
        (["--duration", "0"], "--duration"),
        (["--model", "leap_right"], "--pairs"),
        (["--model", "leap_right", "--pairs", "finger_1=index,finger_2=middle,finger_3=thumb"], "calibration.joints"),
        (["--free", "--save", "x.npz"], "--free"),
    ],
)
def test_impossible_streams_are_refused(words, message, operator, capsys):
    files = operator(operator_frames(HAND, [HAND.neutral] * 3))
    assert main(["glove", "stream", *files, "--hand", HAND.name, *words]) == 1
    assert message in capsys.readouterr().err
