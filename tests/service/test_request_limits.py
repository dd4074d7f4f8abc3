"""Limits of size and time of requests."""

from __future__ import annotations

import time

import pytest
from support.request_handler import DISTRIBUTE, ask, error_code, foreign_payload
from support.service_requests import infeasible_pinch, pinch

import graspforce as gf
from graspforce.service import RequestHandler, ServerLimits
from graspforce.service.server import request_handler
from graspforce.service.wire.protocol import MSGPACK


@pytest.mark.parametrize(
    ("limits", "record"),
    [
        (ServerLimits(payload=100), pinch()),
        (ServerLimits(contacts=1), pinch()),
        (ServerLimits(matrix_entries=6 * (6 + 6 + 4) - 1), pinch()),  # 6 force components under 6 + 6 + 4 rows
        (ServerLimits(matrix_entries=6 * (6 + 2 * 33 + 4) - 1), pinch(cone={"type": "pyramid", "facets": 32})),
    ],
)
def test_too_large_request_is_refused(limits, record):
    assert error_code("solve", record, handler=RequestHandler(limits=limits)) == "too_large"


def test_request_at_the_limits_is_solved():
    size = len(foreign_payload(pinch(), MSGPACK))
    ok, _ = ask(
        "solve", pinch(), handler=RequestHandler(limits=ServerLimits(payload=size, contacts=2, matrix_entries=6 * (6 + 6 + 4)))
    )
    assert ok


def test_too_many_contacts_are_refused_before_they_are_read():
    assert error_code("solve", pinch(contacts=[None] * 501)) == "too_large"
    assert error_code(DISTRIBUTE, {"contacts": [None] * 501}) == "too_large"


def test_request_past_its_deadline_is_not_solved(monkeypatch):
    monkeypatch.setattr(request_handler, "solve", lambda *a, **k: pytest.fail("solved"))
    ok, error = ask("solve", {**pinch(), "budget": 0.5, "sequence": 3}, received=time.perf_counter() - 0.6)
    assert not ok
    assert (error["error"], error["sequence"]) == ("deadline", 3)
    assert "budget of 0.5 s" in error["message"]


def test_answer_past_its_deadline_is_refused(monkeypatch):
    monkeypatch.setattr(request_handler, "solve", lambda problem, backend, **limits: time.sleep(0.03) or gf.solve(problem))
    assert error_code("solve", {**pinch(), "budget": 0.02}) == "deadline"


def test_explanation_is_omitted_if_time_is_short():
    received = time.perf_counter() - 10.0
    ok, record = ask("solve", {**infeasible_pinch(), "budget": 10.0 + request_handler._SEND_TIME * 0.9}, received=received)
    assert ok
    assert record["infeasibility"]["verified"]
    assert record["infeasibility"]["friction_factor"] is None
    ok, record = ask("solve", {**infeasible_pinch(), "budget": 1000.0}, received=received)
    assert ok
    assert record["infeasibility"]["friction_factor"] is not None


@pytest.mark.parametrize(("budget", "most"), [(5.3, 0.2), (None, 1.0), (1000.0, 1.0), (5.05, 0.0)])
def test_explanation_time_leaves_time_to_send_and_is_limited(budget, most, monkeypatch):
    """The request arrived 5 s ago. The time is the rest of the budget less 0.1 s, and at most 1 s."""
    explain_times = []
    monkeypatch.setattr(
        request_handler,
        "solve",
        lambda problem, backend, explain_seconds, deadline: explain_times.append(explain_seconds) or gf.solve(problem),
    )
    request = infeasible_pinch() if budget is None else {**infeasible_pinch(), "budget": budget}
    ask("solve", request, received=time.perf_counter() - 5.0)
    assert explain_times[0] <= most
    assert explain_times[0] == most or budget == 5.3  # decoding takes some of that budget


def test_explanation_of_a_large_problem_is_omitted():
    """Ten contacts with 1024 facets each: the answer has the proof without the explanation."""
    record = infeasible_pinch()
    record["contacts"] *= 5
    for contact in record["contacts"]:
        contact["max_normal"] = contact["max_normal"] / 5
    record["cone"] = {"type": "pyramid", "facets": 1024}
    ok, answer = ask("solve", {**record, "budget": 1000.0})
    assert ok
    assert answer["infeasibility"]["verified"]
    assert answer["infeasibility"]["friction_factor"] is None
