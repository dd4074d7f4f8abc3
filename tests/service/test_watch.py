"""Twins of recorded streams: `graspforce watch` reports weak motors of the plant behind a stream."""

from __future__ import annotations

import json
import threading
from pathlib import Path

import numpy as np
import pytest
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.servers import ANY_LOCAL_PORT, TIMEOUT

from graspforce.cli import main
from graspforce.cli.console import ERROR, SUCCESS
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings
from graspforce.service import Client, Server, StreamSetup, StreamState
from graspforce.service.recording.exchange import REQUEST, STATE, Exchange, Header, recorded_hand, this_machine, this_version
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.wire import protocol
from graspforce.simulation.plants.plant_options import PlantOptions
from graspforce.simulation.plants.urdf_plant import UrdfPlant

pytest.importorskip("foxglove")
pytest.importorskip("mcap")
DT, CODEC = 2e-3, protocol.MSGPACK


def record_run(path: Path, gain: float, duration: float) -> None:
    """Write the recording of a stream whose plant makes `gain` of the commanded torques."""
    from graspforce.service.recording.recording_writer import RecordingWriter

    grasp, gravity = three_finger_grasp(), np.array(PALM_UP, dtype=float)
    setup = StreamSetup(grasp, ControlSettings(gravity_H=gravity, period=DT))
    plant, stream = UrdfPlant(grasp, PlantOptions(gravity_H=gravity, torque_gain=gain, dt=DT)), ServerStream("a", setup)
    header = Header(0, this_version(), this_machine(), (recorded_hand(grasp.hand),), {})
    opened = {"stream": "a", "opened": True, "idle": 10.0, "joints": list(grasp.hand.joint_names)}
    request, reply = protocol.encode(setup.to_dict(), CODEC), protocol.encode(opened, CODEC)
    state, target = plant.reset(), BodyMotion(grasp.p_HO, grasp.R_HO)
    with path.open("wb") as file, RecordingWriter(file, header) as writer:
        writer.write(Exchange(REQUEST, "streams/a", 0.0, 0.0, request, CODEC, True, reply, CODEC))
        for k in range(round(duration / DT)):
            t, payload = k * DT, StreamState(k, k * DT, state, target).encode(CODEC)
            answer = stream.command(payload, CODEC, t)
            writer.write(Exchange(STATE, "a", t, t, payload, CODEC, answer.ok, answer.payload, CODEC))
            state = plant.step(np.frombuffer(protocol.decode(answer.payload, CODEC)["torque"]))


def test_watch_reports_weak_motors_only(tmp_path, capsys):
    for gain, code in ((0.8, ERROR), (1.0, SUCCESS)):
        path = tmp_path / f"{gain}.mcap"
        record_run(path, gain, 0.6)
        assert main(["watch", str(path), "--window", "0.3", "--json"]) == code
        stream = json.loads(capsys.readouterr().out)["streams"]["a"]
        assert stream["states"] == 300
        assert stream["last"]["share"] == pytest.approx(gain, abs=0.02)
        assert (stream["first_drift"] is None) == (gain == 1.0)
    assert main(["watch", str(tmp_path / "0.8.mcap"), "--window", "0.3"]) == ERROR
    shown = capsys.readouterr().out
    assert "Drift after 0." in shown
    assert "the motors make 0.8" in shown
    assert main(["watch", str(path)]) == SUCCESS
    assert "too few" in capsys.readouterr().out


@pytest.mark.parametrize(("gain", "code"), [(0.8, ERROR), (1.0, SUCCESS)])
def test_watch_reports_weak_motors_of_a_running_stream_only(gain, code, capsys):
    """The driver steps the plant as fast as the server answers; the command watches it from beside."""
    grasp, gravity = three_finger_grasp(), np.array(PALM_UP, dtype=float)
    plant = UrdfPlant(grasp, PlantOptions(gravity_H=gravity, torque_gain=gain, dt=DT))
    target, results, window = BodyMotion(grasp.p_HO, grasp.R_HO), [], "0.1"
    with Server([grasp.hand], listen=ANY_LOCAL_PORT) as server, Client(server.addresses[0], timeout=TIMEOUT) as client:
        options = ["watch", "--connect", server.addresses[0], "--window", window, "--duration", "3", "--json"]
        with client.open_stream(grasp, ControlSettings(gravity_H=gravity, period=DT), validity=TIMEOUT) as stream:
            thread = threading.Thread(target=lambda: results.append(main(options)), daemon=True)
            thread.start()
            state = plant.reset()
            while thread.is_alive():
                command = stream.step(state, target, wait=TIMEOUT)
                state = plant.step(command.tau)
    [found] = json.loads(capsys.readouterr().out)["streams"].values()
    assert results == [code]
    assert found["states"] > 50
    assert found["last"]["share"] == pytest.approx(gain, abs=0.05)
    assert (found["first_drift"] is None) == (gain == 1.0)


def test_watch_names_the_stream_that_is_missing(capsys):
    with Server(["four_finger"], listen=ANY_LOCAL_PORT) as server:
        assert main(["watch", "--connect", server.addresses[0]]) == ERROR
        assert "none is open" in capsys.readouterr().err
        assert main(["watch", "--connect", server.addresses[0], "--stream", "x"]) == ERROR
        assert "stream = 'x'" in capsys.readouterr().err
