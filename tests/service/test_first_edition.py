"""Records of the first edition of graspforce are still read, and written as they were.

`first_edition.json` has the JSON of each record as version 0.1 of graspforce wrote it, for the objects of `support`.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import plan_requests
from support.control_requests import GRASP, HAND, HANDS, memory, request, setup, stream_state
from support.service_requests import distribute_request

from graspforce.planning import CollisionSettings, Plan, PlanFailure, move_from_dict
from graspforce.service import ControlRequest, DistributeRequest, StreamSetup, StreamState
from graspforce.service.wire import protocol
from graspforce.service.wire.command_records import read_command
from graspforce.service.wire.plan_records import read_answer, write_answer

RECORDS = json.loads((Path(__file__).parent / "first_edition.json").read_text())


def on_the_wire(record):
    """Return a record as its JSON arrives."""
    return protocol.decode(protocol.encode(record, protocol.JSON), protocol.JSON)


def assert_close(ours, theirs):
    """Check that two records have the same structure, and numbers that agree to rounding."""
    assert type(ours) is type(theirs)
    if isinstance(ours, dict):
        assert list(ours) == list(theirs)
        for name in ours:
            assert_close(ours[name], theirs[name])
    elif isinstance(ours, list):
        assert len(ours) == len(theirs)
        for one, other in zip(ours, theirs, strict=True):
            assert_close(one, other)
    elif isinstance(ours, float):
        assert ours == pytest.approx(theirs, rel=1e-9, abs=1e-9)  # inverse kinematics differs by rounding between machines
    else:
        assert ours == theirs


def memory_of_first_edition():
    """Return a memory as the first edition had it: without spins of pads, and without errors of drives."""
    return replace(memory(), spin=None, torque_factors=None)


@pytest.mark.parametrize(
    ("name", "ours", "read"),
    [
        ("stream_state", stream_state, lambda record: StreamState.from_dict(HAND, record)),
        ("stream_setup", lambda: setup(memory=memory_of_first_edition()), lambda record: StreamSetup.from_dict(HANDS, record)),
        (
            "control_request",
            lambda: request(memory=memory_of_first_edition()),
            lambda record: ControlRequest.from_dict(HAND, record),
        ),
        ("distribute_request", lambda: distribute_request(plan_requests.hand()), DistributeRequest.from_dict),
    ],
)
def test_requests_are_written_and_read_as_in_the_first_edition(name, ours, read):
    assert_close(on_the_wire(ours().to_dict()), RECORDS[name])
    assert_close(on_the_wire(read(RECORDS[name]).to_dict()), RECORDS[name])


def default_move(kind):
    """Return a move with the default collision settings, for which the first edition had no field."""
    move = plan_requests.moves()[kind]
    return replace(move, task=replace(move.task, collisions=CollisionSettings()))


@pytest.mark.parametrize("kind", list(RECORDS["moves"]))
def test_moves_are_written_and_read_as_in_the_first_edition(kind):
    record = RECORDS["moves"][kind]
    assert_close(on_the_wire(default_move(kind).to_dict()), record)
    assert_close(on_the_wire(move_from_dict(record, plan_requests.hand()).to_dict()), record)


def test_commands_of_the_first_edition_are_read():
    streamed, answered = (read_command(GRASP, RECORDS[name]) for name in ("stream_command", "control_answer"))
    for command, name in ((streamed, "stream_command"), (answered, "control_answer")):
        np.testing.assert_array_equal(command.tau, RECORDS[name]["torque"])
        np.testing.assert_array_equal(command.memory.integral, RECORDS[name]["memory"]["integral"])
    assert streamed.sequence == 0
    assert answered.solution.certificate.verified


def test_plan_answers_of_the_first_edition_are_read():
    path = plan_requests.moves()["path"]
    plan = read_answer(replace(path, intervals=4), RECORDS["plan_answers"]["path"])
    assert isinstance(plan, Plan)
    assert_close(on_the_wire(write_answer("me", plan)), RECORDS["plan_answers"]["path"])
    failure = read_answer(plan_requests.unreachable_move(), RECORDS["plan_answers"]["unreachable"])
    assert isinstance(failure, PlanFailure)
    assert_close(on_the_wire(write_answer("me", failure)), RECORDS["plan_answers"]["unreachable"])
