"""Planning over Zenoh: plans, progress, cancellation, and dead clients, servers and processes."""

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
from support.servers import TIMEOUT, get, server_process, wait_until
from support.service_requests import pinch

from graspforce.core.errors import ErrorReply, InvalidInput, NoServer, ServiceError
from graspforce.planning import FingersMove, FingerTask, Plan, PlanFailure, Progress
from graspforce.service import Client
from graspforce.service.wire.plan_records import read_answer, read_progress

# A client in a child process; it prints the stages of its plan.
PLAN_SCRIPT = """
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
def active_plan(address, id):
    """Run a plan that does not end by itself in a thread. Yield at its first plan; the yielded list gets its answer."""
    answers, begun = [], threading.Event()

    def ask():
        with Client(address, timeout=TIMEOUT) as client:
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
        assert begun.wait(TIMEOUT)
        yield answers
    finally:
        with contextlib.suppress(NoServer), Client(address, timeout=TIMEOUT) as client:
            client.cancel(id)
        thread.join(TIMEOUT)
        assert answers


# ── plans ─────────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
@pytest.mark.parametrize("kind", ["path", "free", "fingers"])
def test_service_returns_the_same_plan(server, kind, encoding):
    with Client(server.addresses[0], timeout=TIMEOUT, encoding=encoding) as client:
        assert_same_plan(client.plan(moves()[kind], budget=60.0), decoded_move(moves()[kind]).plan())


def test_plan_differs_from_a_local_one_by_rounding_of_normals_only(client):
    for kind in ("path", "free"):
        plan, mine = client.plan(moves()[kind], budget=60.0), moves()[kind].plan()
        assert plan.duration == pytest.approx(mine.duration, rel=1e-3)  # limits hold to 1e-3
        np.testing.assert_allclose(plan.knots.p_HO[[0, -1]], mine.knots.p_HO[[0, -1]], atol=1e-12)


def test_infeasible_move_is_an_answer(client):
    refused = client.plan(unreachable_move(), budget=60.0)
    assert isinstance(refused, PlanFailure)
    assert refused.to_dict() == decoded_move(unreachable_move()).plan().to_dict()


def test_progress_arrives_in_the_calling_thread_and_never_falls(client):
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


def test_tiny_budget_gives_a_stopped_failure(client):
    refused = client.plan(moves()["free"], budget=1e-6)
    assert refused.kind == "stopped"
    assert refused.reason == "The budget of 1e-06 s ended before there was a first plan."
    with pytest.raises(InvalidInput, match="budget"):
        client.plan(moves()["free"], budget=0.0)


# ── cancellation ──────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_callback_that_returns_false_gives_the_best_plan_so_far(client):
    plan = client.plan(slow_move(), budget=60.0, callback=lambda now: now.best is None)
    assert isinstance(plan, Plan)
    assert plan.stopped
    assert plan.check.verified


def test_any_client_can_cancel_by_id_repeatedly(server, client):
    with active_plan(server.addresses[0], "some-id") as answers:
        assert client.status().plans == 1
        for _ in range(20):
            client.cancel("unknown")
            client.cancel("some-id")
    assert answers[0].stopped
    wait_until(lambda: client.status().plans == 0)
    assert client.plan(moves()["path"], budget=60.0).found


def test_exception_of_the_callback_is_raised_and_ends_the_plan(client):
    def progress(now):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        client.plan(slow_move(), budget=60.0, callback=progress)
    wait_until(lambda: client.status().plans == 0)


def test_plan_of_a_killed_client_is_cancelled(server, client):
    with subprocess.Popen(
        [sys.executable, "-c", PLAN_SCRIPT, server.addresses[0], TESTS], stdout=subprocess.PIPE, text=True
    ) as child:
        try:
            assert child.stdout.readline()
            assert client.status().plans == 1
        finally:
            child.kill()
    wait_until(lambda: client.status().plans == 0)
    assert client.plan(moves()["path"], budget=60.0).found


# ── several plans ─────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_third_plan_waits_for_its_turn_while_other_requests_are_served(server, client):
    address = server.addresses[0]
    with active_plan(address, "first") as first, active_plan(address, "second") as second:
        waiting = client.plan(moves()["path"], budget=0.3)
        assert not waiting.found  # its budget ended before its turn
        assert client.solve(pinch()).found
        assert client.status().plans == 2
        with client.open_stream(GRASP) as stream:
            measured, motion = state(), desired()
            for _ in range(50):
                assert stream.step(measured, motion).tau.shape == (GRASP.hand.n,)
            stream_id = stream.id
        assert stream_id
    assert first[0].stopped
    assert second[0].stopped
    wait_until(lambda: client.status().plans == 0)


# ── other programs ────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_plain_zenoh_session_plans_in_json_and_follows_the_progress(raw):
    move = moves()["free"]
    progress = raw.declare_subscriber("graspforce/1/plans/mine/progress")
    ((ok, encoding, payload),) = get(raw, KEY, json.dumps({**move.to_dict(), "id": "mine", "sequence": 4, "budget": 60.0}))
    assert ok
    assert encoding == "application/json"
    record = json.loads(payload)
    assert (record.pop("id"), record.pop("sequence")) == ("mine", 4)
    assert record.pop("server_seconds") > 0.0
    assert record["plan"]["schema"] == "graspforce/plan/1"
    assert_same_plan(read_answer(move, {**record, "id": "mine"}), decoded_move(move).plan())
    sample = progress.try_recv()
    assert str(sample.encoding) == "application/json"
    assert read_progress(json.loads(sample.payload.to_bytes())).stage == "reach"
    progress.undeclare()


@pytest.mark.parametrize(
    ("key", "payload", "code", "field"),
    [
        (KEY, "", "invalid", "input"),
        (KEY, "{", "invalid", "input"),
        (KEY, "[]", "invalid", None),
        (KEY, "{}", "invalid", "method"),
        (KEY, '{"method": "magic"}', "invalid", "method"),
        (KEY, '{"method": "fingers", "postures": [[0], [1]]}', "invalid", "postures"),
        (KEY, json.dumps({**moves()["fingers"].to_dict(), "postures": [[0.0] * 12] * 2}), "invalid", None),
        (KEY, json.dumps({**moves()["path"].to_dict(), "budget": 1e9}), "invalid", "budget"),
        (KEY, json.dumps({"method": "x" * 200_000}), "too_large", None),
        ("hands/nobody/plan", "{}", "unknown", "hand"),
    ],
)
def test_invalid_requests_get_error_records(raw, key, payload, code, field):
    ((ok, _, reply),) = get(raw, key, payload)
    error = json.loads(reply)
    assert not ok
    assert error["error"] == code
    assert error["field"] == field or field is None


def test_id_of_a_plan_may_begin_with_the_name_of_its_client(raw, client):
    """`plans/arm-7/mine/cancel` stops the plan."""
    stages = []

    def callback(progress):
        stages.append(progress.stage)
        raw.put("graspforce/1/plans/arm-7/mine/cancel", b"")
        return True

    answer = client.plan(slow_move(), budget=60.0, callback=callback, id="arm-7/mine")
    assert answer.stopped if isinstance(answer, Plan) else answer.kind == "stopped"
    assert stages


def test_cancel_of_unknown_plans_has_no_effect(raw, client):
    for id in ("nobody", "x" * 1000, "a b", "ä"):
        for payload in (b"", b"\xff" * 100_000):
            raw.put(f"graspforce/1/plans/{id}/cancel", payload)
    raw.put("graspforce/1/plans/cancel", b"")
    assert client.plan(moves()["path"], budget=60.0).found


def test_unserved_hand_and_invalid_id_are_rejected(client):
    other = FingersMove(FingerTask(_other()), np.array([_other().neutral, _other().neutral + 0.05]))
    with pytest.raises(ErrorReply, match="must be one of four_finger"):
        client.plan(other)
    for id in ("", "a/b/c", "*", "x" * 65):
        with pytest.raises(InvalidInput, match="id = "):
            client.plan(moves()["path"], id=id)
        with pytest.raises(InvalidInput, match="id = "):
            client.cancel(id)


def _other():
    from support.hands import load

    return load("anthropomorphic15")


# ── ends of processes ─────────────────────────────────────────────────────────────────────────────────────────────────────────


def children(pid):
    """Return the ids of the child processes of a process (Linux)."""
    listed = Path(f"/proc/{pid}/task/{pid}/children")
    found = [listed] if listed.exists() else pytest.skip("this system does not list a process's children")
    every = [each for path in found[0].parent.parent.glob("*/children") for each in path.read_text().split()]
    return [int(each) for each in every]


def is_running(pid):
    """Return True if a process exists and is not a zombie."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


def test_killed_server_leaves_no_process_and_its_client_gets_no_server():
    with server_process(HAND) as (child, address), active_plan(address, "lost") as answers:
        processes = children(child.pid)
        assert processes
        child.send_signal(signal.SIGKILL)
        child.wait(TIMEOUT)
        wait_until(lambda: answers)
        wait_until(lambda: not any(is_running(pid) for pid in processes))
    assert isinstance(answers[0], NoServer)


def test_stopped_server_answers_with_the_best_plan_so_far():
    with server_process(HAND) as (child, address), active_plan(address, "ending") as answers:
        processes = children(child.pid)
        began = time.monotonic()
        child.send_signal(signal.SIGINT)
        assert child.wait(TIMEOUT) == 0
        assert time.monotonic() - began < TIMEOUT
        wait_until(lambda: answers)
        assert not any(is_running(pid) for pid in processes)
    assert isinstance(answers[0], Plan)
    assert answers[0].stopped


def test_answer_of_a_stopped_server_reaches_a_client_that_is_busy_until_the_server_has_ended():
    with server_process(HAND) as (child, address), Client(address, timeout=TIMEOUT) as client:

        def end_server(now):
            if now.best is not None and child.poll() is None:
                child.send_signal(signal.SIGINT)
                assert child.wait(TIMEOUT) == 0
            return True

        answer = client.plan(slow_move(), budget=60.0, callback=end_server)
        assert isinstance(answer, Plan)
        assert answer.stopped


def test_killed_planning_process_leaves_the_best_plan_so_far_and_is_replaced():
    with server_process(HAND) as (child, address):
        with active_plan(address, "shot") as answers:
            for pid in children(child.pid):
                os.kill(pid, signal.SIGKILL)
            wait_until(lambda: answers)
            assert answers[0].stopped
        with Client(address, timeout=TIMEOUT) as client:
            assert client.plan(moves()["path"], budget=60.0).found
