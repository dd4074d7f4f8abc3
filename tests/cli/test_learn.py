"""``graspforce learn``: synergies with their film, and labels of recordings of simulations and servers."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image as PillowImage
from support.control_requests import GRASP, HAND
from support.gloves import calibration_of, operator_frames
from support.servers import ANY_LOCAL_PORT

from graspforce.cli import main
from graspforce.control.joints.joint_command import JointMotion
from graspforce.control.joints.joint_controller import JointController
from graspforce.learning import PostureLibrary, load_labels
from graspforce.service import Client, JointStreamSetup, Server
from graspforce.service.recording.exchange import STATE, End, Header, this_machine, this_version
from graspforce.service.recording.recording_reader import ServerRecording
from graspforce.service.recording.recording_writer import RecordingWriter
from graspforce.simulation import Recording

FILM = ["--duration", "0.5", "--fps", "4", "--film-size", "320x184", "--components", "1"]
RATE = 50.0  # Hz, of the recorded stream
STEPS = 100


@pytest.fixture
def library(tmp_path):
    rng = np.random.default_rng(0)
    closing = HAND.q_upper - HAND.neutral
    q = HAND.neutral + 0.3 * rng.uniform(size=(20, 1)) * closing + 0.01 * rng.normal(size=(20, HAND.n))
    PostureLibrary(HAND.joint_names, np.clip(q, HAND.q_lower, HAND.q_upper)).save(tmp_path / "postures.csv")
    return str(tmp_path / "postures.csv")


def test_synergies_are_shown_and_filmed(library, tmp_path, capsys):
    files = ["--video", str(tmp_path / "film.webp"), "--frames", str(tmp_path / "frames"), "--plots", str(tmp_path / "plots")]
    assert main(["learn", "synergies", library, "--hand", HAND.name, *FILM, *files]) == 0
    assert "20 postures of 12 joints" in capsys.readouterr().out
    frames = [np.asarray(PillowImage.open(path)) for path in sorted((tmp_path / "frames").iterdir())]
    assert len(frames) == 2
    assert (frames[0] != frames[1]).any()
    with PillowImage.open(tmp_path / "film.webp") as film:
        assert film.n_frames == 2
    assert {path.name for path in (tmp_path / "plots").iterdir()} == {"variance.png", "errors.png", "postures.png"}


def test_synergies_are_a_record(library, capsys):
    assert main(["learn", "synergies", library, "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["postures"] == 20
    assert record["cumulative_variance"][0] > 0.9


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--video", "film.webp"], "--hand"),
        (["--components", "0"], "--components"),
        (["--span", "0"], "--span"),
        (["--hand", "leap_right"], "joints"),
    ],
)
def test_impossible_synergies_are_refused(words, message, library, capsys):
    assert main(["learn", "synergies", library, *words]) == 1
    assert message in capsys.readouterr().err


def test_frames_of_a_glove_become_a_library(tmp_path):
    calibration_of(HAND).save(tmp_path / "glove.json")
    ends = np.array([HAND.neutral, HAND.neutral + 0.2 * (HAND.q_upper - HAND.neutral)])
    np.savetxt(tmp_path / "frames.csv", operator_frames(HAND, np.repeat(ends, 30, axis=0), noise=0.0), delimiter=",")
    files = [str(tmp_path / name) for name in ("frames.csv", "postures.csv")]
    assert main(["learn", "collect", *files, "--calibration", str(tmp_path / "glove.json"), "--glove-rate", "30"]) == 0
    np.testing.assert_allclose(PostureLibrary.load(files[1]).q, ends, atol=np.radians(1.0))


def test_a_simulated_run_is_labelled(tmp_path, capsys):
    run = str(tmp_path / "run.npz")
    command = ["simulate", "--hand", HAND.name, "--fingers", ",".join(GRASP.fingers), "--reference", "still"]
    assert main([*command, "--duration", "0.1", "--save", run]) == 0
    capsys.readouterr()
    assert main(["learn", "label", run, "--save", str(tmp_path / "labels.csv")]) == 0
    assert "Order: no finger moves" in capsys.readouterr().out
    labels = load_labels(tmp_path / "labels.csv")
    assert {each.finger for each in labels} == {finger.name for finger in HAND.fingers}
    assert {each.text for each in labels} == {"rest"}
    assert main(["learn", "collect", run, str(tmp_path / "run.csv"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["postures"] == 1
    library = PostureLibrary.load(tmp_path / "run.csv")
    assert (library.joints, len(library)) == (HAND.joint_names, 1)  # the hand rests
    assert main(["learn", "label", run, "--record", str(tmp_path / "out.mcap")]) == 1
    assert "--record" in capsys.readouterr().err


def test_recordings_with_the_same_order_of_motions_are_found(tmp_path, capsys):
    """Recordings of one run whose fingers close in an order; the posture is all that labels depend on."""
    run = str(tmp_path / "run.npz")
    command = ["simulate", "--hand", HAND.name, "--fingers", ",".join(GRASP.fingers), "--reference", "still"]
    assert main([*command, "--duration", "0.9", "--save", run]) == 0
    still = Recording.load(run)
    names = [finger.name for finger in HAND.fingers[:3]]
    for name, order in (("same", (0, 1, 2)), ("asked", (0, 1, 2)), ("reversed", (2, 1, 0)), ("one", (0,))):
        q = np.array(still.q)
        for k, i in enumerate(order):
            bending = np.clip((still.t - 0.3 * k) / 0.25, 0.0, 1.0)
            q[:, list(HAND.finger(names[i]).joints)[1:]] += 0.3 * bending[:, None]
        dataclasses.replace(still, q=q).save(tmp_path / f"{name}.npz")
    files = [str(tmp_path / f"{name}.npz") for name in ("asked", "reversed", "run", "one", "same")]
    capsys.readouterr()
    assert main(["learn", "similar", *files, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["similar"]
    assert Path(found[0]["name"]).stem == "same"
    assert found[0]["similarity"] == pytest.approx(1.0)
    assert {Path(each["name"]).stem for each in found} == {"same", "reversed", "one"}
    assert main(["learn", "similar", run, files[0]]) == 1
    assert "a finger moves" in capsys.readouterr().err


def with_steady_times(source: Path, target: Path) -> None:
    """Write a recording whose states arrived at a steady rate, whatever the speed of this machine."""
    recording = ServerRecording.open(source)
    header = Header(recording.clock, this_version(), this_machine(), recording.hands, recording.limits)
    with target.open("wb") as file, RecordingWriter(file, header) as writer:
        count = 0
        for each in recording.exchanges():
            each.received = each.sent = count / RATE
            count += each.kind == STATE
            writer.write(each)
        writer.end(End(count, {}))


def test_a_recording_of_a_server_gets_labels(tmp_path, capsys):
    """A stream of joints in which the first finger rests, closes and rests; the labelled copy replays as the recording."""
    pytest.importorskip("foxglove")
    reader = pytest.importorskip("mcap.reader")
    raw, day, labelled = (tmp_path / name for name in ("raw.mcap", "day.mcap", "labelled.mcap"))
    first = HAND.fingers[0]
    setup = JointStreamSetup(JointController.with_frequency(HAND, "pd_gravity", 3.0), 1.0 / RATE, validity=10.0)
    with (
        Server([HAND.name], listen=ANY_LOCAL_PORT, record=raw) as server,
        Client(server.addresses[0]) as client,
        client.open_joint_stream(setup) as stream,
    ):
        for k in range(STEPS):
            q = np.array(HAND.neutral)
            q[list(first.joints)[1:]] += 0.3 * np.clip(3.0 * k / STEPS - 1.0, 0.0, 1.0)
            stream.step(JointMotion(q), JointMotion(q), wait=10.0)
    server._recorder.wait()
    with_steady_times(raw, day)
    assert main(["learn", "label", str(day), "--record", str(labelled), "--json"]) == 0
    (labels,) = json.loads(capsys.readouterr().out)["streams"].values()
    motions = [each["name"].split()[0] for each in labels if each["finger"] == first.name]
    assert motions == ["rest", "close", "rest"]
    with labelled.open("rb") as file:
        every = list(reader.make_reader(file, validate_crcs=True).iter_messages())
    topic = next(channel.topic for _, channel, _ in every if channel.topic.endswith("/actions"))
    written = [json.loads(message.data) for _, channel, message in every if channel.topic == topic]
    assert [each["finger"] for each in written] == [each["finger"] for each in labels]
    assert main(["replay", str(labelled)]) == 0
    assert main(["learn", "collect", str(day), str(tmp_path / "day.csv"), "--every", "0.1"]) == 0
    bent = PostureLibrary.load(tmp_path / "day.csv").q[:, list(first.joints)[-1]] - HAND.neutral[list(first.joints)[-1]]
    assert 5 < len(bent) < STEPS / RATE / 0.1  # without the rests
    assert (np.diff(bent) > 0.02).all()
    assert bent[-1] == pytest.approx(0.3, abs=0.03)
    capsys.readouterr()
    assert main(["learn", "label", str(day), "--record", str(day), "--force"]) == 1
    assert "another file" in capsys.readouterr().err
