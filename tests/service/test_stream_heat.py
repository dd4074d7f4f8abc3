"""Temperatures of windings in the commands of streams."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from support.control_requests import CODECS, GRASP, HAND, SETTINGS, setup, stream_state

from graspforce.hand.descriptions.drive_description import ThermalDescription
from graspforce.hand.drives.drive import Drive
from graspforce.hand.heat import ThermalModel
from graspforce.service import StreamSetup
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.wire import protocol
from graspforce.service.wire.command_records import RemoteCommand, read_command

THERMAL = ThermalDescription(
    winding_resistance=8.0, winding_time_constant=6.0, housing_resistance=30.0, housing_time_constant=400.0,
    largest_temperature=100.0, source="invented",
)  # fmt: skip
WARM = replace(GRASP, hand=HAND.with_drives(Drive("current", torque_constant=0.8, resistance=5.0, thermal=THERMAL)))


def commands(stream: ServerStream, codec: str, times: list[float]) -> list[RemoteCommand]:
    """Return the commands for one state at several times."""
    answers = []
    for i, t in enumerate(times):
        record = {**stream_state(i).to_dict(), "time": t}
        reply = stream.command(protocol.encode(record, codec), codec)
        answers.append(read_command(WARM, protocol.decode(reply.payload, codec)))
    return answers


@CODECS
def test_windings_warm_up_with_the_torques_of_the_commands(codec: str) -> None:
    answers = commands(ServerStream("a", StreamSetup(WARM, SETTINGS)), codec, [0.0, 0.2, 0.4])
    model = ThermalModel(WARM.hand.drives)
    expected = model.at_rest()
    np.testing.assert_allclose(answers[0].winding_temperature, expected.winding)
    for before, answer in pairwise(answers):
        expected = model.step(expected, model.currents(before.tau), 0.2)
        np.testing.assert_allclose(answer.winding_temperature, expected.winding, rtol=1e-12)
    assert answers[-1].winding_temperature.max() > 25.01  # °C


@CODECS
def test_commands_have_no_temperatures_without_thermal_data(codec: str) -> None:
    (answer,) = commands(ServerStream("a", setup(memory=None)), codec, [0.0])
    assert answer.winding_temperature is None
