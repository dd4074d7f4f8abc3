"""Bytes in, bytes out: what the service answers, without a network. Every error becomes a reply."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import graspforce
from graspforce import arrays, fields
from graspforce.contact import ContactSet
from graspforce.errors import BackendError, InvalidInput, Refused, UnknownName
from graspforce.hand import Hand
from graspforce.problem import ForceProblem
from graspforce.service import wire
from graspforce.service.meter import Meter
from graspforce.service.records import DistributeRequest, ServerStatus
from graspforce.solution import Solution
from graspforce.solve import solve
from graspforce.service.wire import Envelope

log = logging.getLogger("graspforce.service")

_TIME_TO_EXPLAIN = 0.1  # s: with less left, what would make an infeasible problem feasible is not worked out


@dataclass(frozen=True, slots=True)
class Limits:
    """What a server will work on. Beyond: the error ``too_large``.

    Args:
        payload: bytes of a request.
        contacts: contacts of a problem.
        numbers: entries of the problem's dense constraint matrix; 5 million take about a quarter of a second and 100 MB.
    """

    payload: int = 8 * 2**20
    contacts: int = 500
    numbers: int = 5_000_000


@dataclass(frozen=True, slots=True)
class Reply:
    """An answer as it goes out.

    Args:
        ok: a record; otherwise an error record.
        payload: its bytes.
        encoding: their Zenoh encoding.
    """

    ok: bool
    payload: bytes
    encoding: str


class Handler:
    """Answers requests, from any thread.

    Args:
        hands: the hands to serve.
        server: the server's id, for its status.
        queued: says how many requests wait, for its status.
        limits: what is too large.
    """

    def __init__(
        self,
        hands: Sequence[Hand] = (),
        *,
        server: str = "",
        queued: Callable[[], int] = lambda: 0,
        limits: Limits = Limits(),
    ) -> None:
        self.hands = {hand.name: hand for hand in hands}
        self._server, self._queued, self._limits = server, queued, limits
        self._meter = Meter()
        self._start = time.perf_counter()
        # A key's task, and whether it can take long.
        self._tasks: dict[str, Callable[[Any, _Budget], dict[str, Any]]] = {"solve": self._solve, "status": self._status}
        for name, hand in self.hands.items():
            key = wire.hand_key(name)
            self._tasks[key] = lambda record, budget, hand=hand: self._describe(hand, record)
            self._tasks[f"{key}/distribute"] = lambda record, budget, hand=hand: self._distribute(hand, record, budget)

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys that are served, below the prefix."""
        return tuple(self._tasks)

    def answer(self, key: str, payload: bytes, encoding: str | None = None, received: float | None = None) -> Reply:
        """The reply to a request, whatever it holds.

        Args:
            key: what is asked, below the prefix.
            payload: the request.
            encoding: its Zenoh encoding; None for JSON.
            received: when it came, on the clock `time.perf_counter`; None for now.
        """
        received = time.perf_counter() if received is None else received
        answer_in, sequence = wire.JSON, None
        try:
            answer_in = wire.codec(encoding)
            if len(payload) > self._limits.payload:
                raise Refused("too_large", f"the payload has {len(payload)} bytes: at most {self._limits.payload} are allowed")
            sequence = wire.sequence_of(payload, answer_in)
            task = self._task(key)
            request = wire.decode(payload, answer_in) if payload or key == "solve" else {}
            envelope, record = Envelope.split(request)
            result = task(record, _Budget(envelope, received))
        except Exception as error:
            return self._failed(key, error, answer_in, sequence, received)
    

    def refuse(self, key: str, payload: bytes, encoding: str | None, code: str, message: str) -> Reply:
        """The reply to a request that nobody will work on, quickly made.

        Args:
            key, payload, encoding: as in `answer`.
            code: "overloaded" or another refusal.
            message: why.
        """
