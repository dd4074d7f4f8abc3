"""The limits of a server."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass

from graspforce.core import arrays
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.service.zenoh_session import MAX_MESSAGE_BYTES


@dataclass(frozen=True, slots=True)
class ServerLimits:
    """Limits on requests, streams and plans. The server refuses requests that exceed them, with the error code given below.

    Clients are Zenoh sessions (`graspforce.service.server.client_sessions`).

    Args:
        payload: bytes of a request (``too_large``).
        queue_bytes: bytes of all waiting requests (``overloaded``).
        budget: time until the work on a request must begin, if the request has no budget, s (``deadline``).
        contacts: contacts of a problem (``too_large``).
        matrix_entries: entries of a problem's dense constraint matrix (``too_large``).
        streams: open control streams (``overloaded``).
        client_streams: open control streams of a client (``overloaded``).
        realtime_states: states a second of all streams with the real-time priority of their period, by their periods; further
            streams have the priority of requests.
        plans: moves that are planned at the same time, each in a process of its own (``overloaded``).
        client_plans: active and waiting plans of a client (``overloaded``).
        waiting_plans: plans that wait for a process; clients take turns (``overloaded``).
        plan_memory: largest address space of a planning process, bytes (``too_large`` or ``internal``).
        plan_budget: largest budget of a plan, s (``invalid``).
        intervals: largest number of intervals of a plan (``invalid``).
        idle_timeout: time without states after which a stream is closed, s.
        stall_time: time of the work on one request after which the server counts as not healthy, s.
    """

    payload: int = MAX_MESSAGE_BYTES
    queue_bytes: int = 64 * 2**20
    budget: float = 10.0
    contacts: int = 500
    matrix_entries: int = 5_000_000
    streams: int = 64
    client_streams: int = 16
    realtime_states: int = 2000
    plans: int = 2
    client_plans: int = 2
    waiting_plans: int = 8
    plan_memory: int = 8 * 2**30
    plan_budget: float = 60.0
    intervals: int = 500
    idle_timeout: float = 10.0
    stall_time: float = 60.0


def read_limits(settings: Iterable[str]) -> ServerLimits:
    """Return the limits of texts ``NAME=VALUE``; the others have their defaults.

    Args:
        settings: the texts; whole numbers for counts and bytes.

    Raises:
        UnknownName: there is no such limit.
        InvalidInput: the value is not a positive number, or not a whole one.
    """
    defaults = {each.name: each.default for each in dataclasses.fields(ServerLimits)}
    given: dict[str, float] = {}
    for setting in settings:
        name, _, text = setting.partition("=")
        if name not in defaults:
            raise UnknownName("limit", name, defaults)
        try:
            number: float = int(text) if isinstance(defaults[name], int) else float(text)
        except ValueError:
            raise InvalidInput(name, text, "a whole number" if isinstance(defaults[name], int) else "a number") from None
        arrays.check_number(number, name, above=0.0)
        given[name] = number
    return ServerLimits(**given)  # type: ignore[arg-type]  # each value has the type of its default
