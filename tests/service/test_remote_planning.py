"""Planning over real Zenoh: the same plans, followed and cancelled from anywhere, whoever dies on the way."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from support.control_requests import GRASP, desired, state
from support.plan_requests import HAND, assert_same_plan, decoded_move, moves, slow_move, unreachable_move
from support.servers import PATIENCE, get, server_process, wait_until
from support.service_requests import pinch

from graspforce.core.errors import ErrorReply, InvalidInput, NoServer, RequestRefused, ServiceError
from graspforce.planning import Plan, PlanFailure, Progress, Task
from graspforce.planning.moves import FingersMove
from graspforce.service import Client
from graspforce.service.wire.plan_records import read_answer, read_progress, write_move

# A client of its own, which says when its plan is on the way.
ASK = """
import sys
sys.path.insert(0, sys.argv[2])
from support.plan_requests import slow_move
from graspforce.service import Client
with Client(sys.argv[1], timeout=20.0) as client:
    client.plan(slow_move(), budget=60.0, callback=lambda now: print(now.stage, flush=True) is None)
"""
TESTS = str(Path(__file__).parents[1])
KEY = f"hands/{HAND}/plan"


@contextlib.contextmanager
def under_way(address, id):
    """A plan that does not end by itself, in a thread; yields when it has a first plan. Its answer is appended at the end."""
    answers, begun = [], threading.Event()

    def ask():
        with Client(address, timeout=PATIENCE) as client:
            try:
                answers.append(client.plan(slow_move(), budget=60.0, id=id, callback=progress))
            except ServiceError as error:
                answers.append(error)

    def progress(now):
        if now.best is not None:
            begun.set()
        return True

    thread = threading.Thread(target=ask)
    thread.start()
    try:
        assert begun.wait(PATIENCE)
        yield answers
    finally:
        with contextlib.suppress(NoServer), Client(address, timeout=PATIENCE) as client:
            client.cancel(id)
        thread.join(PATIENCE)
        assert answers


# ── plans ─────────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
@pytest.mark.parametrize("kind", ["path", "free", "fingers"])
def test_a_plan_of_the_service_is_the_plan(server, kind, encoding):
    with Client(server.addresses[0], timeout=PATIENCE, encoding=encoding) as client:
        assert_same_plan(client.plan(moves()[kind], budget=60.0), decoded_move(moves()[kind]).plan())


def test_what_the_move_s_own_plan_says_differs_by_the_last_digit_of_a_normal_at_most(client):
    for kind in ("path", "free"):
        plan, mine = client.plan(moves()[kind], budget=60.0), moves()[kind].plan()
        assert plan.duration == pytest.approx(mine.duration, rel=1e-3)  # limits are kept to a part of 1e-3
        np.testing.assert_allclose(plan.knots.p_HO[[0, -1]], mine.knots.p_HO[[0, -1]], atol=1e-12)


def test_a_move_that_cannot_be_is_an_answer(client):
    refused = client.plan(unreachable_move(), budget=60.0)
    assert isinstance(refused, PlanFailure)
    assert refused.to_dict() == decoded_move(unreachable_move()).plan().to_dict()


def test_progress_comes_to_the_asker_s_own_thread_and_never_falls(client):
    seen: list[Progress] = []
    threads = set()

    def progress(now):
        seen.append(now)
        threads.add(threading.get_ident())
        return True

    plan = client.plan(moves()["free"], budget=60.0, callback=progress)
    assert threads == {threading.get_ident()}
    assert seen
    for before, after in itertools.pairwise(seen):
        assert before.fraction <= after.fraction
        assert before.seconds <= after.seconds
    assert plan.duration <= seen[-1].best


def test_without_time_there_is_no_plan_and_no_hurry(client):
    refused = client.plan(moves()["free"], budget=1e-6)
    assert refused.kind == "stopped"
    assert refused.reason == "The budget of 1e-06 s ended before there was a first plan."
    with pytest.raises(InvalidInput, match="budget"):
        client.plan(moves()["free"], budget=0.0)


# ── cancelled ─────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_told_to_stop_the_best_plan_so_far_is_the_answer(client):
    plan = client.plan(slow_move(), budget=60.0, callback=lambda now: now.best is None)
    assert isinstance(plan, Plan)
    assert plan.stopped
    assert plan.check.verified


def test_anybody_may_cancel_by_the_id_as_often_as_they_like(server, client):
    with under_way(server.addresses[0], "some-id") as answers:
        assert client.status().plans == 1
        for _ in range(20):
            client.cancel("nobody-s")
            client.cancel("some-id")
    assert answers[0].stopped
    wait_until(lambda: client.status().plans == 0)
    assert client.plan(moves()["path"], budget=60.0).found


def test_what_the_progress_callback_raises_is_raised_and_the_plan_is_no_longer_under_way(client):
    def progress(now):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        client.plan(slow_move(), budget=60.0, callback=progress)
    wait_until(lambda: client.status().plans == 0)


def test_a_client_that_is_killed_is_planned_for_no_more(server, client):
    with subprocess.Popen([sys.executable, "-c", ASK, server.addresses[0], TESTS], stdout=subprocess.PIPE, text=True) as child:
        try:
            assert child.stdout.readline()
            assert client.status().plans == 1
        finally:
            child.kill()
    wait_until(lambda: client.status().plans == 0)
    assert client.plan(moves()["path"], budget=60.0).found


# ── many ──────────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_two_at_once_and_an_honest_word_to_a_third_while_all_else_is_served(server, client):
    address = server.addresses[0]
    with under_way(address, "first") as first, under_way(address, "second") as second:
        with pytest.raises(RequestRefused, match="2 plans are active") as refused:
            client.plan(moves()["path"], budget=60.0)
        assert refused.value.code == "overloaded"
        assert client.solve(pinch()).found
        assert client.status().plans == 2
        with client.open_stream(GRASP) as stream:
            seen, wanted = state(), desired()
            for _ in range(50):
                assert stream.step(seen, wanted).tau.shape == (GRASP.hand.n,)
            stream_id = stream.id
        assert stream_id
    assert first[0].stopped
    assert second[0].stopped
    wait_until(lambda: client.status().plans == 0)


# ── other programs ────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_a_program_with_any_zenoh_asks_in_json_and_follows_the_plan_by_its_id(raw):
    move = moves()["free"]
    heard = raw.declare_subscriber("graspforce/1/plans/mine/progress")
    ((ok, encoding, payload),) = get(raw, KEY, json.dumps({**write_move(move), "id": "mine", "sequence": 4, "budget": 60.0}))
    assert ok
    assert encoding == "application/json"
    record = json.loads(payload)
    assert (record.pop("id"), record.pop("sequence")) == ("mine", 4)
    assert record.pop("server_seconds") > 0.0
    assert record["plan"]["schema"] == "graspforce/plan/1"
    assert_same_plan(read_answer(move, {**record, "id": "mine"}), decoded_move(move).plan())
    sample = heard.try_recv()
    assert str(sample.encoding) == "application/json"
    assert read_progress(json.loads(sample.payload.to_bytes())).stage == "reach"
    heard.undeclare()


@pytest.mark.parametrize(
    ("key", "payload", "code", "field"),
    [
        (KEY, "", "invalid", "input"),
        (KEY, "{", "invalid", "input"),
        (KEY, "[]", "invalid", None),
        (KEY, "{}", "invalid", "method"),
        (KEY, '{"method": "magic"}', "invalid", "method"),
        (KEY, '{"method": "fingers", "postures": [[0], [1]]}', "invalid", "postures"),
        (KEY, json.dumps({**write_move(moves()["fingers"]), "postures": [[0.0] * 12] * 2}), "invalid", None),
        (KEY, json.dumps({**write_move(moves()["path"]), "budget": 1e9}), "invalid", "budget"),
        (KEY, json.dumps({"method": "x" * 200_000}), "too_large", None),
        ("hands/nobody/plan", "{}", "unknown", "hand"),
    ],
)
def test_bad_requests_are_answered_with_error_records(raw, key, payload, code, field):
    ((ok, _, said),) = get(raw, key, payload)
    error = json.loads(said)
    assert not ok
    assert error["error"] == code
    assert error["field"] == field or field is None


def test_cancels_of_nothing_in_any_form_leave_the_server_as_it_is(raw, client):
    for id in ("nobody", "x" * 1000, "a b", "ä"):
        for payload in (b"", b"\xff" * 100_000):
            raw.put(f"graspforce/1/plans/{id}/cancel", payload)
    raw.put("graspforce/1/plans/cancel", b"")
    assert client.plan(moves()["path"], budget=60.0).found


def test_a_hand_that_is_not_served_and_an_id_that_can_be_none_are_refused(client):
    other = FingersMove(Task(_other()), np.array([_other().neutral, _other().neutral + 0.05]))
    with pytest.raises(ErrorReply, match="must be one of four_finger"):
        client.plan(other)
    for id in ("", "a/b", "*", "x" * 65):
        with pytest.raises(InvalidInput, match="id = "):
            client.plan(moves()["path"], id=id)
        with pytest.raises(InvalidInput, match="id = "):
            client.cancel(id)


def _other():
    from support.hands import load

    return load("anthropomorphic15")


# ── ends ──────────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def children(pid):
    """The processes that a process has started; Linux says so."""
    listed = Path(f"/proc/{pid}/task/{pid}/children")
    found = [listed] if listed.exists() else pytest.skip("this system does not list a process's children")
    every = [each for path in found[0].parent.parent.glob("*/children") for each in path.read_text().split()]
    return [int(each) for each in every]


def runs(pid):
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


def test_a_server_that_is_killed_leaves_no_process_behind_and_its_client_knows_at_once():
    with server_process(HAND) as (child, address), under_way(address, "lost") as answers:
        planners = children(child.pid)
        assert planners
        child.send_signal(signal.SIGKILL)
        child.wait(PATIENCE)
        wait_until(lambda: answers)
        wait_until(lambda: not any(runs(pid) for pid in planners))
    assert isinstance(answers[0], NoServer)


def test_a_server_that_is_told_to_stop_answers_with_the_best_plan_so_far_first():
    with server_process(HAND) as (child, address), under_way(address, "ending") as answers:
        planners = children(child.pid)
        began = time.monotonic()
        child.send_signal(signal.SIGINT)
        assert child.wait(PATIENCE) == 0
        assert time.monotonic() - began < PATIENCE
        wait_until(lambda: answers)
        assert not any(runs(pid) for pid in planners)
    assert isinstance(answers[0], Plan)
    assert answers[0].stopped


def test_a_planning_process_that_is_killed_leaves_the_best_plan_so_far_and_another_takes_its_place():
    with server_process(HAND) as (child, address):
        with under_way(address, "shot") as answers:
            for pid in children(child.pid):
                os.kill(pid, signal.SIGKILL)
            wait_until(lambda: answers)
            assert answers[0].stopped
        with Client(address, timeout=PATIENCE) as client:
            assert client.plan(moves()["path"], budget=60.0).found
