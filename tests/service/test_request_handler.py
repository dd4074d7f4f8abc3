"""Answers to requests, without a network: each request gets one reply, and each error names its cause."""

from __future__ import annotations

import json
import logging

import numpy as np
import pytest
from support import control_requests
from support.invalid_problems import assert_names
from support.request_handler import CODECS, DISTRIBUTE, HAND, HANDLER, ask, foreign_payload
from support.service_requests import BAD_RECORDS, HALF_WIDTH, PINCH_OBJECTIVE, distribute_request, infeasible_pinch, pinch

import graspforce as gf
from graspforce.core.errors import BackendError, InvalidInput, ModelError
from graspforce.service import RequestHandler, make_force_problem
from graspforce.service.server import request_handler
from graspforce.service.server.server_load import ServerLoad
from graspforce.service.wire import protocol
from graspforce.service.wire.protocol import JSON, MSGPACK


@CODECS
def test_solve_request_returns_the_solution_of_solve(codec):
    ok, record = ask("solve", {**pinch(), "sequence": 41, "budget": 30.0, "backend": "clarabel"}, codec)
    assert ok
    assert record.pop("sequence") == 41
    assert 0.0 < record.pop("server_seconds") < 30.0
    solution = gf.Solution.from_dict(record)
    assert solution.status is gf.Status.OPTIMAL
    assert solution.certificate.verified
    assert solution.backend == "clarabel"
    assert solution.objective == pytest.approx(PINCH_OBJECTIVE, rel=1e-7)  # the certificate's tolerance with room


def test_missing_encoding_means_json():
    reply = HANDLER.answer("solve", foreign_payload(pinch(), JSON))
    assert (reply.ok, reply.encoding) == (True, JSON)
    assert "sequence" not in protocol.decode(reply.payload, JSON)


@CODECS
def test_solve_and_distribute_take_uncertain_data(codec):
    problem = gf.problems.load("ring/3-force").problem.to_dict()
    ok, record = ask("solve", {**problem, "uncertainty": {"friction_error": 0.2, "mass_error": 0.1}}, codec)
    assert ok
    record.pop("server_seconds")
    assert record["objective"] == pytest.approx((1.0 + (1.1 / 0.4) ** 2) / 6.0, rel=1e-6)
    assert gf.Solution.from_dict(record).robust.statement.startswith("No slip for all mu ≥ (0.4, 0.4, 0.4)")
    request = {**distribute_request(HAND).to_dict(), "uncertainty": {"friction_error": 0.2}}
    ok, record = ask(DISTRIBUTE, request, codec)
    assert ok
    assert max(record["robust"]["least_friction"]) <= 0.8 * request["contacts"][0]["friction"] * (1.0 + 1e-6)
    request["uncertainty"] = {"friction_error": 2.0}
    ok, error = ask(DISTRIBUTE, request, codec)
    assert (ok, error["field"]) == (False, "uncertainty.friction_error")


def test_infeasible_problem_is_an_answer():
    ok, record = ask("solve", infeasible_pinch())
    assert ok
    assert record["status"] == "infeasible"
    assert record["infeasibility"]["friction_factor"] == pytest.approx(2.1, rel=1e-5)  # bisection to 1e-6


def test_hand_request_returns_its_description():
    ok, record = ask("hands/four_finger", b"")
    assert ok
    assert {name: record[name] for name in HAND.describe()} == protocol.decode(
        protocol.encode(HAND.describe(), MSGPACK), MSGPACK
    )


@CODECS
def test_distribute_balances_the_wrench_within_torque_limits(codec):
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
    # torques by virtual work: tau = tau_u + Σ (∂p_i/∂q)ᵀ f_i, in H
    tau = HAND.inverse_dynamics(request.q, np.zeros(HAND.n), np.zeros(HAND.n))
    for finger, contact, f in zip(request.fingers, request.contacts, force, strict=True):
        p_H = request.p_HO + request.R_HO @ contact.position
        tau = tau + HAND.point_jacobian(request.q, finger, p_H)[:3].T @ (request.R_HO @ f)
    np.testing.assert_allclose(solution.torques, tau, atol=1e-12)  # rounding
    assert (np.abs(solution.torques) <= HAND.torque_upper + 1e-9).all()
    assert (solution.slip_margin >= -1e-7).all()


def test_hand_gives_its_frames_at_a_posture():
    q = 0.3 * HAND.q_lower + 0.7 * HAND.q_upper
    ok, record = ask("hands/four_finger", {"posture": q.tolist()})
    assert ok
    assert {name: record[name] for name in HAND.describe(q)} == json.loads(json.dumps(HAND.describe(q)))
    assert record["posture"] == q.tolist()
    ok, error = ask("hands/four_finger", {"posture": [0.0]})
    assert (ok, error["field"]) == (False, "posture")


def test_gravity_and_motion_enter_the_torques():
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


def test_status_counts_requests_by_outcome():
    counted = RequestHandler([HAND], server="me", load=lambda: ServerLoad(waiting=7))
    for record in (pinch(), pinch(), pinch(name=3)):
        ask("solve", record, handler=counted)
    ask("nowhere", b"", handler=counted)
    counted.refuse("solve", b"", None, "overloaded", "later")
    ok, status = ask("status", b"", handler=counted)
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
def test_invalid_input_gets_the_message_of_python(record, codec):
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
def test_invalid_field_is_named(key, change, field, allowed, codec):
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
        ("sovle", {}, "key", "solve, quality, explain, status, hands/four_finger, hands/four_finger/distribute"),
        ("hands/four_finger/dance", {}, "hand", "four_finger"),
        ("solve", {**pinch(), "backend": "abacus"}, "backend", "clarabel, proxqp"),
    ],
)
def test_unknown_name_lists_the_known_ones(key, record, field, listed):
    ok, error = ask(key, record)
    assert not ok
    assert (error["error"], error["field"]) == ("unknown", field)
    assert listed in error["message"]


def test_unknown_finger_lists_the_fingers():
    record = distribute_request(HAND).to_dict()
    record["contacts"][2]["finger"] = "thumb"
    ok, error = ask(DISTRIBUTE, record)
    assert not ok
    assert (error["error"], error["field"]) == ("unknown", "contacts[2].finger")
    assert all(finger.name in error["message"] for finger in HAND.fingers)


def test_unknown_encoding_is_answered_in_json():
    reply = HANDLER.answer("solve", b"<problem/>", "application/xml")
    error = protocol.decode(reply.payload, JSON)
    assert (reply.ok, reply.encoding, error["error"], error["field"]) == (False, JSON, "invalid", "encoding")


def test_unexpected_exception_is_logged_and_not_shown(monkeypatch, caplog):
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
def test_solver_and_model_errors_are_passed_on(monkeypatch, raised, code, field):
    def fail(*arguments, **keywords):
        raise raised

    monkeypatch.setattr(request_handler, "solve", fail)
    ok, error = ask("solve", pinch())
    assert not ok
    assert error == {"error": code, "message": str(raised), "field": field}


@CODECS
def test_refusal_repeats_the_sequence_if_readable(codec):
    for payload, sequence in ((foreign_payload({**pinch(), "sequence": 77}, codec), 77), (b"\xc1", None), (b" " * 10**5, None)):
        reply = HANDLER.refuse("solve", payload, codec, "overloaded", "later")
        error = protocol.decode(reply.payload, codec)
        assert not reply.ok
        assert (error["error"], error["message"], error.get("sequence")) == ("overloaded", "later", sequence)


def test_replies_with_torques_name_the_joints_in_their_order():
    """Of `distribute`, of `control`, and to the request that opens a stream."""
    names = [joint.name for joint in control_requests.HAND.joints]
    handler = RequestHandler([control_requests.HAND])
    opened = handler.answer("streams/a", protocol.encode(control_requests.setup().to_dict(), protocol.JSON), protocol.JSON)
    assert protocol.decode(opened.payload, protocol.JSON)["joints"] == names
    payload = protocol.encode(control_requests.request().to_dict(), protocol.JSON)
    answered = handler.answer(control_requests.CONTROL, payload, protocol.JSON)
    record = protocol.decode(answered.payload, protocol.JSON)
    assert record["joints"] == names
    assert len(record["torque"]) == len(names)


def test_quality_of_a_request_with_a_shape_has_regions():
    record = {**pinch(), "shape": {"type": "box", "edges": [2.0 * HALF_WIDTH, 0.06, 0.06]}}
    ok, reply = ask("quality", record)
    assert ok
    assert [region["ends"] for region in reply["closure_regions"]] == [["lost"] * 8] * 2  # two point contacts: no closure
    assert len(reply["payload_regions"]) == 2
    ok, error = ask("quality", {**pinch(), "shape": {"type": "box", "edges": [3.0 * HALF_WIDTH, 0.06, 0.06]}})
    assert not ok
    assert error["field"] == "contacts[0].position"
