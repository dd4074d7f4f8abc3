"""The service's whole logic, without a network: every request gets one reply, and every error says what was wrong."""

from __future__ import annotations

import json
import logging
import random
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.invalid_problems import assert_names
from support.service_requests import BAD_RECORDS, PINCH_OBJECTIVE, distribute_request, infeasible_pinch, pinch

import graspforce as gf
from graspforce.core.errors import BackendError, InvalidInput, ModelError
from graspforce.hand.hand import Hand
from graspforce.service import RequestHandler, ServerLimits, make_force_problem
from graspforce.service.server import request_handler
from graspforce.service.wire import protocol
from graspforce.service.wire.protocol import JSON, MSGPACK

CODECS = pytest.mark.parametrize("codec", [JSON, MSGPACK])
HAND = Hand.load("four_finger")
HANDLER = RequestHandler([HAND], server="here", queue_length=lambda: 3)
DISTRIBUTE = "hands/four_finger/distribute"


def ask(key, record, codec=MSGPACK, *, of=HANDLER, received=None):
    """(ok, record) of a reply, which must come in the codec of its question."""
    payload = record if isinstance(record, bytes) else as_sent(record, codec)
    reply = of.answer(key, payload, codec, received)
    assert reply.encoding == codec
    return reply.ok, protocol.decode(reply.payload, codec)


def as_sent(record, codec):
    """A record as a stranger's program sends it: Python's own JSON writes NaN, and whole numbers of any size."""
    return json.dumps(record).encode() if codec == JSON else protocol.encode(record, codec)


def code_of(key, record, **more):
    ok, error = ask(key, record, **more)
    assert not ok
    assert set(error) <= {"error", "message", "field", "sequence"}
    return error["error"]


# ── answers ────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@CODECS
def test_solve_is_solve(codec):
    ok, record = ask("solve", {**pinch(), "sequence": 41, "budget": 30.0, "backend": "clarabel"}, codec)
    assert ok
    assert record.pop("sequence") == 41
    assert 0.0 < record.pop("server_seconds") < 30.0
    solution = gf.Solution.from_dict(record)
    assert solution.status is gf.Status.OPTIMAL
    assert solution.certificate.verified
    assert solution.backend == "clarabel"
    assert solution.objective == pytest.approx(PINCH_OBJECTIVE, rel=1e-7)  # the certificate's tolerance with room


def test_no_encoding_is_json():
    reply = HANDLER.answer("solve", as_sent(pinch(), JSON))
    assert (reply.ok, reply.encoding) == (True, JSON)
    assert "sequence" not in protocol.decode(reply.payload, JSON)


def test_an_infeasible_problem_is_an_answer():
    ok, record = ask("solve", infeasible_pinch())
    assert ok
    assert record["status"] == "infeasible"
    assert record["infeasibility"]["friction_factor"] == pytest.approx(2.1, rel=1e-5)  # bisection to 1e-6


def test_a_hand_says_what_it_is():
    ok, record = ask("hands/four_finger", b"")
    assert ok
    assert {name: record[name] for name in HAND.describe()} == protocol.decode(
        protocol.encode(HAND.describe(), MSGPACK), MSGPACK
    )


@CODECS
def test_distribute_holds_the_object_within_the_motors_limits(codec):
    request = distribute_request(HAND)
    ok, record = ask(DISTRIBUTE, request.to_dict(), codec)
    assert ok
    del record["server_seconds"]
    solution = gf.Solution.from_dict(record)
    assert solution.status is gf.Status.OPTIMAL
    force = solution.forces_object  # N, in O
    moment = np.cross([contact.position for contact in request.contacts], force)  # N·m
    np.testing.assert_allclose(force.sum(axis=0), request.w[:3], atol=1e-7)  # N: 1e-8 of the problem's forces, with room
    np.testing.assert_allclose(moment.sum(axis=0), request.w[3:], atol=1e-8)  # N·m: the same on levers of cm
    # virtual work, a second way to the torques: tau = tau_u + Σ (∂p_i/∂q)ᵀ f_i, in H
    tau = HAND.inverse_dynamics(request.q, np.zeros(HAND.n), np.zeros(HAND.n))
    for finger, contact, f in zip(request.fingers, request.contacts, force, strict=True):
        p_H = request.p_HO + request.R_HO @ contact.position
        tau = tau + HAND.point_jacobian(request.q, finger, p_H)[:3].T @ (request.R_HO @ f)
    np.testing.assert_allclose(solution.torques, tau, atol=1e-12)  # rounding
    assert (np.abs(solution.torques) <= HAND.torque_upper + 1e-9).all()
    assert (solution.slip_margin >= -1e-7).all()


def test_gravity_and_motion_reach_the_motors():
    record = {
        **distribute_request(HAND).to_dict(),
        "gravity": [0.0, 9.81, 0.0],
        "velocity": [0.5] * HAND.n,
        "acceleration": [2.0] * HAND.n,
    }
    problem = make_force_problem(HAND, gf.service.DistributeRequest.from_dict(record))
    moved = HAND.inverse_dynamics(HAND.neutral, np.full(HAND.n, 0.5), np.full(HAND.n, 2.0), (0.0, 9.81, 0.0))
    np.testing.assert_allclose(problem.actuation.tau_u, moved, atol=1e-15)
    assert np.abs(moved - HAND.inverse_dynamics(HAND.neutral, np.zeros(HAND.n), np.zeros(HAND.n))).max() > 1e-3


def test_status_counts_what_was_asked():
    counted = RequestHandler([HAND], server="me", queue_length=lambda: 7)
    for record in (pinch(), pinch(), pinch(name=3)):
        ask("solve", record, of=counted)
    ask("nowhere", b"", of=counted)
    counted.refuse("solve", b"", None, "overloaded", "later")
    ok, status = ask("status", b"", of=counted)
    assert ok
    assert status["counts"] == {"other": {"unknown": 1}, "solve": {"ok": 2, "invalid": 1, "overloaded": 1}}
    assert (status["server"], status["queue"], status["hands"]) == ("me", 7, ["four_finger"])
    assert status["version"] == gf.__version__
    latency = status["latency"]
    assert latency["count"] == 4
    assert 0.0 < latency["p50"] <= latency["p99"] <= latency["max"] < status["uptime"]


# ── errors ─────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@CODECS
@pytest.mark.parametrize("record", [record for _, record in BAD_RECORDS], ids=[name for name, _ in BAD_RECORDS])
def test_bad_input_gets_the_text_that_python_gives(record, codec):
    if codec == MSGPACK and "10000000" in str(record):
        pytest.skip("MessagePack has no whole number of that size")
    with pytest.raises(InvalidInput) as caught:
        gf.ForceProblem.from_dict(record)
    ok, error = ask("solve", record if not isinstance(record, dict) else {**record, "sequence": 9}, codec)
    assert not ok
    expected = {"error": caught.value.code, "message": str(caught.value), "field": caught.value.field or None}
    assert error == (expected if not isinstance(record, dict) else {**expected, "sequence": 9})


@CODECS
@pytest.mark.parametrize(
    ("key", "change", "field", "allowed"),
    [
        (DISTRIBUTE, {"posture": [0.1] * 11}, "posture", "a list of 12 numbers, not 11"),
        (DISTRIBUTE, {"velocity": [0.1]}, "velocity", "a list of 12 numbers, not 1"),
        (DISTRIBUTE, {"acceleration": []}, "acceleration", "a list of 12 numbers, not 0"),
        (DISTRIBUTE, {"wrench": None}, "wrench", "a list of 6 numbers"),
        (DISTRIBUTE, {"gravity": [0.0]}, "gravity", "a list of 3 numbers, not 1"),
        (DISTRIBUTE, {"mass": 1}, "mass", "absent: the known fields are posture, object, contacts, wrench"),
        (DISTRIBUTE, {"sequence": -4}, "sequence", "an integer from 0"),
        (DISTRIBUTE, {"budget": 0}, "budget", "greater than 0"),
        ("status", {"wrench": 1}, "wrench", "absent"),
        ("hands/four_finger", {"wrench": 1}, "wrench", "absent"),
    ],
)
def test_every_bad_field_is_named(key, change, field, allowed, codec):
    record = {**distribute_request(HAND).to_dict(), **change} if key == DISTRIBUTE else change
    ok, error = ask(key, record, codec)
    assert not ok
    assert (error["error"], error["field"]) == ("invalid", field)
    assert_names(error["message"], field, allowed)


@pytest.mark.parametrize(
    ("key", "record", "field", "listed"),
    [
        ("hands/none", {}, "hand", "four_finger"),
        ("hands/none/distribute", {}, "hand", "four_finger"),
        ("sovle", {}, "key", "solve, status, hands/four_finger, hands/four_finger/distribute"),
        ("hands/four_finger/dance", {}, "hand", "four_finger"),
        ("solve", {**pinch(), "backend": "abacus"}, "backend", "clarabel, proxqp"),
    ],
)
def test_an_unknown_name_is_told_those_that_are_known(key, record, field, listed):
    ok, error = ask(key, record)
    assert not ok
    assert (error["error"], error["field"]) == ("unknown", field)
    assert listed in error["message"]


def test_an_unknown_finger_is_told_the_fingers():
    record = distribute_request(HAND).to_dict()
    record["contacts"][2]["finger"] = "thumb"
    ok, error = ask(DISTRIBUTE, record)
    assert not ok
    assert (error["error"], error["field"]) == ("unknown", "contacts[2].finger")
    assert all(finger.name in error["message"] for finger in HAND.fingers)


def test_another_encoding_is_answered_in_json():
    reply = HANDLER.answer("solve", b"<problem/>", "application/xml")
    error = protocol.decode(reply.payload, JSON)
    assert (reply.ok, reply.encoding, error["error"], error["field"]) == (False, JSON, "invalid", "encoding")


@pytest.mark.parametrize(
    ("limits", "record"),
    [
        (ServerLimits(payload=100), pinch()),
        (ServerLimits(contacts=1), pinch()),
        (ServerLimits(matrix_entries=6 * (6 + 6 + 4) - 1), pinch()),  # 6 force components under 6 + 6 + 4 rows
        (ServerLimits(matrix_entries=6 * (6 + 2 * 33 + 4) - 1), pinch(cone={"type": "pyramid", "facets": 32})),
    ],
)
def test_what_is_too_large_is_refused(limits, record):
    assert code_of("solve", record, of=RequestHandler(limits=limits)) == "too_large"


def test_what_is_just_not_too_large_is_solved():
    size = len(as_sent(pinch(), MSGPACK))
    ok, _ = ask(
        "solve", pinch(), of=RequestHandler(limits=ServerLimits(payload=size, contacts=2, matrix_entries=6 * (6 + 6 + 4)))
    )
    assert ok


def test_very_many_contacts_are_refused_before_they_are_read():
    assert code_of("solve", pinch(contacts=[None] * 501)) == "too_large"
    assert code_of(DISTRIBUTE, {"contacts": [None] * 501}) == "too_large"


def test_a_request_that_waited_out_its_budget_is_not_worked_on(monkeypatch):
    monkeypatch.setattr(request_handler, "solve", lambda *a, **k: pytest.fail("worked on"))
    ok, error = ask("solve", {**pinch(), "budget": 0.5, "sequence": 3}, received=time.perf_counter() - 0.6)
    assert not ok
    assert (error["error"], error["sequence"]) == ("deadline", 3)
    assert "budget of 0.5 s" in error["message"]


def test_an_answer_that_comes_too_late_is_refused(monkeypatch):
    monkeypatch.setattr(request_handler, "solve", lambda problem, backend, explain: time.sleep(0.03) or gf.solve(problem))
    assert code_of("solve", {**pinch(), "budget": 0.02}) == "deadline"


def test_with_little_time_the_remedies_are_left_out():
    received = time.perf_counter() - 10.0
    ok, record = ask("solve", {**infeasible_pinch(), "budget": 10.0 + request_handler._SEND_TIME * 0.9}, received=received)
    assert ok
    assert record["infeasibility"]["verified"]
    assert record["infeasibility"]["friction_factor"] is None
    ok, record = ask("solve", {**infeasible_pinch(), "budget": 1000.0}, received=received)
    assert ok
    assert record["infeasibility"]["friction_factor"] is not None


@pytest.mark.parametrize(("budget", "most"), [(5.3, 0.2), (None, 1.0), (1000.0, 1.0), (5.05, 0.0)])
def test_remedies_end_in_time_for_the_proof_to_be_sent_and_keep_nobody_waiting_for_long(budget, most, monkeypatch):
    """Received five seconds ago: what is left of the budget, less a tenth of a second, and never more than one."""
    asked = []
    monkeypatch.setattr(request_handler, "solve", lambda problem, backend, explain: asked.append(explain) or gf.solve(problem))
    request = infeasible_pinch() if budget is None else {**infeasible_pinch(), "budget": budget}
    ask("solve", request, received=time.perf_counter() - 5.0)
    assert asked[0] <= most
    assert asked[0] == most or budget == 5.3  # some of that budget went on reading


def test_remedies_that_would_take_long_are_left_out_whatever_the_time():
    """Ten contacts of 1024 facets: the proof comes, what would help does not."""
    record = infeasible_pinch()
    record["contacts"] *= 5
    for contact in record["contacts"]:
        contact["max_normal"] = contact["max_normal"] / 5
    record["cone"] = {"type": "pyramid", "facets": 1024}
    ok, answer = ask("solve", {**record, "budget": 1000.0})
    assert ok
    assert answer["infeasibility"]["verified"]
    assert answer["infeasibility"]["friction_factor"] is None


def test_a_fault_of_our_own_is_logged_and_not_shown(monkeypatch, caplog):
    def fail(*arguments, **keywords):
        raise ZeroDivisionError("at /home/secret/place.py")

    monkeypatch.setattr(request_handler, "solve", fail)
    with caplog.at_level(logging.ERROR):
        ok, error = ask("solve", {**pinch(), "sequence": 8})
    assert not ok
    assert (error["error"], error["field"], error["sequence"]) == ("internal", None, 8)
    assert "secret" not in error["message"]
    assert "Traceback" not in error["message"]
    assert "at /home/secret/place.py" in caplog.text


@pytest.mark.parametrize(
    ("raised", "code", "field"),
    [(BackendError("takes no cones"), "invalid", "backend"), (ModelError("two leaders"), "internal", None)],
)
def test_what_a_solver_or_model_says_is_passed_on(monkeypatch, raised, code, field):
    def fail(*arguments, **keywords):
        raise raised

    monkeypatch.setattr(request_handler, "solve", fail)
    ok, error = ask("solve", pinch())
    assert not ok
    assert error == {"error": code, "message": str(raised), "field": field}


@CODECS
def test_a_refusal_repeats_the_sequence_where_it_can(codec):
    for payload, sequence in ((as_sent({**pinch(), "sequence": 77}, codec), 77), (b"\xc1", None), (b" " * 10**5, None)):
        reply = HANDLER.refuse("solve", payload, codec, "overloaded", "later")
        error = protocol.decode(reply.payload, codec)
        assert not reply.ok
        assert (error["error"], error["message"], error.get("sequence")) == ("overloaded", "later", sequence)


# ── nothing gets through ───────────────────────────────────────────────────────────────────────────────────────────────────

KEYS = st.sampled_from(HANDLER.keys) | st.text(max_size=20)
ENCODINGS = st.sampled_from([None, JSON, MSGPACK, "application/json;x", "text/plain"]) | st.text(max_size=20)


def survives(key, payload, encoding):
    """The code of a reply that must be a reply, and never the fault of the server."""
    reply = HANDLER.answer(key, payload, encoding)
    record = protocol.decode(reply.payload, reply.encoding)
    assert reply.ok == ("error" not in record)
    if not reply.ok:
        assert record["error"] in ("invalid", "unknown", "too_large"), record
        assert isinstance(record["message"], str)
    return reply.ok


@given(key=KEYS, payload=st.binary(max_size=200), encoding=ENCODINGS)
def test_random_bytes_get_a_reply(key, payload, encoding):
    survives(key, payload, encoding)


@CODECS
def test_every_truncation_gets_an_error(codec):
    for key, record in (("solve", pinch()), (DISTRIBUTE, distribute_request(HAND).to_dict())):
        payload = as_sent(record, codec)
        for end in range(0, len(payload), 1 if len(payload) < 500 else 7):
            assert not survives(key, payload[:end], codec)


@CODECS
def test_mutated_requests_get_a_reply(codec):
    chance = random.Random(20240613)
    originals = [("solve", as_sent(pinch(), codec)), (DISTRIBUTE, as_sent(distribute_request(HAND).to_dict(), codec))]
    outcomes = []
    for _ in range(400):
        key, payload = chance.choice(originals)
        mutated = bytearray(payload)
        for _ in range(chance.randint(1, 4)):
            place = chance.randrange(len(mutated))
            kind = chance.randrange(4)
            if kind == 0:
                mutated[place] = chance.randrange(256)
            elif kind == 1:
                mutated[place] ^= 1 << chance.randrange(8)
            elif kind == 2:
                del mutated[place : place + chance.randint(1, 9)]
            else:
                mutated[place:place] = mutated[place : place + chance.randint(1, 9)]
            if not mutated:
                break
        outcomes.append(survives(key, bytes(mutated), codec))
    assert {True, False} == set(outcomes)  # some changes leave a problem, others leave none


ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.binary(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=12,
)
PATHS = st.sampled_from(
    [(name,) for name in ("schema", "contacts", "wrench", "hand", "cone", "objective", "name", "budget", "sequence", "backend")]
    + [("contacts", 0, name) for name in ("position", "normal", "tangent", "friction", "model", "min_normal", "max_normal")]
    + [("contacts", 1), ("wrench", 2), ("contacts", 0, "position", 1), ("contacts", 1, "normal", 0)]
)


@settings(max_examples=200)
@given(path=PATHS, value=ANYTHING, codec=st.sampled_from([JSON, MSGPACK]))
def test_anything_in_any_field_gets_a_reply(path, value, codec):
    record = pinch()
    inner = record
    for step in path[:-1]:
        inner = inner[step]
    inner[path[-1]] = value
    try:
        payload = as_sent(record, codec)
    except (InvalidInput, TypeError):  # what this codec has no word for
        return
    survives("solve", payload, codec)


@settings(max_examples=60)
@given(numbers=st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=12, max_size=12))
def test_numbers_of_any_size_get_a_reply(numbers):
    record = pinch(wrench=numbers[:6])
    record["contacts"][0]["position"] = numbers[6:9]
    record["contacts"][1]["normal"] = numbers[9:12]
    survives("solve", as_sent(record, MSGPACK), MSGPACK)


@CODECS
@pytest.mark.parametrize("depth", [50, 900, 100_000])
def test_deep_nesting_gets_an_error(depth, codec):
    deep = b"[" * depth + b"]" * depth if codec == JSON else b"\x91" * depth + b"\x90"
    name = b'{"schema": ' if codec == JSON else b"\x81\xa6schema"
    assert not survives("solve", deep, codec)
    assert not survives("solve", name + deep + (b"}" if codec == JSON else b""), codec)


def test_extension_types_and_bytes_are_bad_input():
    for value in (b"abc", memoryview(b"abc")):
        assert code_of("solve", pinch(wrench=value)) == "invalid"
    timestamp = b"\x81\xa6wrench\xd6\xff\x00\x00\x00\x01"
    extension = b"\x81\xa6wrench\xd4\x05\x00"
    whole_number_key = b"\x81\x07\x07"
    for payload in (timestamp, extension, whole_number_key):
        assert code_of("solve", payload) == "invalid"


def test_a_lone_surrogate_in_a_name_is_bad_input():
    ok, error = ask("solve", b'{"\\ud800": 1}', JSON)
    assert not ok
    assert error["error"] == "invalid"
    assert "ud800" in error["field"]
