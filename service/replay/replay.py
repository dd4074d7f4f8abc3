"""Replay of a recording: every request is answered and every state stepped again, and the replies are compared.

Streams are stepped one after another with the recorded times of arrival, on which only the checks of plausible states depend.
A change of contacts, which another thread prepares, begins with the state with which it began in the recording.
"""

from __future__ import annotations

import threading
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from threadpoolctl import threadpool_limits

from graspforce.core.errors import GraspForceError, InvalidInput
from graspforce.hand.hand import Hand
from graspforce.service.recording.exchange import OTHER, STATE, Exchange, fingerprint, this_machine, this_version
from graspforce.service.recording.recording_reader import ServerRecording
from graspforce.service.replay.differences import Difference, find_differences
from graspforce.service.replay.held_changes import HeldChanges
from graspforce.service.replay.report import ReplayReport, SourceResult
from graspforce.service.server.deadline import Deadline
from graspforce.service.server.limits import ServerLimits
from graspforce.service.server.request_handler import RequestHandler
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.wire import protocol
from graspforce.service.wire.reply import Reply
from graspforce.service.wire.stream_setups import read_setup

_STREAMS = "streams/"
_TIMED_KEYS = ("quality", "explain", "solve", "distribute")  # last parts of keys whose numbers may not fit into their time
_PLAN_TASKS = ("plan", "grasp", "regrasp")
_LOAD_CODES = ("overloaded", "deadline", "closing", "forbidden")  # refusals that depend on load and clients
_OPENING_FIELDS = ("stream", "idle", "joints")  # of the reply to an opening: the others are random or count
_MAX_WAIT = 90.0  # s, for a plan
_NO_TIME = "some numbers did not fit into their time"
_BUDGET = "stopped at the end of its budget"
_LOAD, _STATUS, _CLOSE = "refused by load or ownership", "depends on the server's history", "closes a stream: counts"
_GAP, _UNKNOWN, _CONTENTS = "after dropped states", "the opening of its stream is missing", "contents were not recorded"


def load_hands(recording: ServerRecording, files: Sequence[str] = ()) -> dict[str, Hand]:
    """Return the hands of a recording by name.

    Args:
        recording: the recording.
        files: names or description files of hands that replace those with the same name.

    Raises:
        UnknownName: a hand is not found: give its description file.
        ModelError: a hand cannot be read.
    """
    given = {hand.name: hand for hand in map(Hand.load, files)}
    return {each.name: given.get(each.name) or Hand.load(each.file) for each in recording.hands}


class Replay:
    """A replay of one recording.

    Args:
        recording: the recording.
        hands: its hands by name.
        on_exchange: called after each exchange with the number of exchanges so far.
    """

    def __init__(
        self, recording: ServerRecording, hands: Mapping[str, Hand], on_exchange: Callable[[int], None] = lambda count: None
    ) -> None:
        self._recording, self._hands, self._on_exchange = recording, dict(hands), on_exchange
        self._handler = RequestHandler(list(hands.values()), limits=ServerLimits(**recording.limits))  # type: ignore[arg-type]
        self._streams: dict[str, tuple[ServerStream, HeldChanges]] = {}
        self._change_numbers: dict[str, int] = {}
        self._gaps: set[str] = set()
        self._results: defaultdict[str, SourceResult] = defaultdict(SourceResult)

    def run(self) -> ReplayReport:
        """Answer everything again, and return the differences."""
        with threadpool_limits(1):  # as in the server: other numbers of threads round differently
            try:
                for number, exchange in enumerate(self._recording.exchanges(), start=1):
                    self._replay(exchange)
                    self._on_exchange(number)
            finally:
                self._handler.plans.close(Deadline(0.0))
        return ReplayReport(dict(self._results), dict(self._recording.dropped), tuple(self._notes()))

    def _replay(self, exchange: Exchange) -> None:
        """Replay one exchange."""
        if exchange.kind == STATE:
            self._step(exchange)
            return
        result, key = self._results[f"requests/{exchange.key}"], exchange.key
        if key == OTHER:
            result.explain(_CONTENTS)
        elif key == "status" and exchange.ok:
            result.explain(_STATUS)
        elif not exchange.ok and _error_code(exchange) in _LOAD_CODES:
            result.explain(_LOAD)
        elif key.startswith(_STREAMS) and exchange.ok:
            self._open(exchange, result)
        else:
            self._compare(result, exchange, self._answer(exchange))

    def _answer(self, exchange: Exchange) -> Reply:
        """Return the reply to a request."""
        if exchange.key.rpartition("/")[2] not in _PLAN_TASKS or exchange.key not in self._handler.plan_keys:
            return self._handler.answer(exchange.key, exchange.payload, exchange.encoding)
        replies: list[Reply] = []
        done = threading.Event()

        def answer(reply: Reply) -> None:
            replies.append(reply)
            done.set()

        self._handler.plans.begin(exchange.key, exchange.payload, exchange.encoding, answer)
        done.wait(_MAX_WAIT)
        return replies[0] if replies else Reply(False, b"{}", protocol.JSON)

    def _open(self, exchange: Exchange, result: SourceResult) -> None:
        """Open a stream again, or close it."""
        id = exchange.key.removeprefix(_STREAMS)
        request = protocol.decode(exchange.payload, protocol.select_codec(exchange.encoding))
        _, record = protocol.Envelope.split(request)
        recorded = _decode(exchange.reply, exchange.reply_encoding)
        if isinstance(record, dict) and "close" in record:
            self._streams.pop(id, None)
            result.explain(_CLOSE)
            return
        try:
            setup = read_setup(self._hands, record)
            if recorded.get("opened") is True:
                changes = HeldChanges()
                self._streams[id] = ServerStream(id, setup, changes=changes), changes
                self._change_numbers[id] = getattr(setup, "change_number", 0)
                self._gaps.discard(id)
        except GraspForceError as error:
            self._streams.pop(id, None)
            result.add([Difference("", "an opened stream", str(error), float("inf"))])
            return
        now = {"stream": id, "idle": self._handler.streams.idle_timeout, "joints": list(setup.hand.joint_names)}
        result.add(list(find_differences({name: recorded.get(name) for name in _OPENING_FIELDS}, now)))

    def _step(self, exchange: Exchange) -> None:
        """Step a stream again."""
        result, id = self._results[exchange.source], exchange.key
        if exchange.dropped:
            self._gaps.add(id)
        if id not in self._streams:
            result.explain(_UNKNOWN)
            return
        if id in self._gaps:
            result.explain(_GAP)
            return
        stream, changes = self._streams[id]
        recorded = _decode(exchange.reply, exchange.reply_encoding)
        change = recorded.get("contact_change")
        number = change["number"] if isinstance(change, dict) else self._change_numbers.get(id, 0)
        is_refused = not exchange.ok and str(recorded.get("field")).startswith("contacts")
        if number != self._change_numbers.get(id, 0) or is_refused:
            self._change_numbers[id] = number
            changes.release()
        reply = stream.command(exchange.payload, exchange.encoding, exchange.received)
        changes.hold()
        self._compare(result, exchange, reply)

    def _compare(self, result: SourceResult, exchange: Exchange, reply: Reply) -> None:
        """Compare a recorded reply with a new one."""
        recorded, now = _decode(exchange.reply, exchange.reply_encoding), _decode(reply.payload, reply.encoding)
        found = list(find_differences(recorded, now))
        task = "" if exchange.kind == STATE else exchange.key.rpartition("/")[2]
        if task in _PLAN_TASKS and "id" not in _decode(exchange.payload, exchange.encoding or protocol.JSON):
            found = [each for each in found if each.path != "id"]  # a random one of the server
        if found and task in _TIMED_KEYS and all(each.is_missing for each in found):
            result.explain(_NO_TIME)
        elif found and task in _PLAN_TASKS and any((each.get("plan") or {}).get("stopped") for each in (recorded, now)):
            result.explain(_BUDGET)
        else:
            result.add(found)

    def _notes(self) -> list[str]:
        """Return what may explain differences."""
        recording, notes = self._recording, []
        if recording.version != this_version():
            notes.append(f"recorded by version {recording.version}; this is {this_version()}")
        if recording.machine != this_machine():
            notes.append(f"recorded on {recording.machine}; this is {this_machine()}: last digits may differ")
        for each in recording.hands:
            if fingerprint(self._hands[each.name]) != each.fingerprint:
                notes.append(f"the hand {each.name} has changed since the recording")
        if not recording.is_complete:
            notes.append("the recording has no end: its last exchanges are missing")
        return notes


def _decode(payload: bytes, encoding: str) -> dict[str, Any]:
    """Return a reply; an empty record for one that cannot be read."""
    try:
        record = protocol.decode(payload, protocol.select_codec(encoding))
    except InvalidInput:
        return {}
    return record if isinstance(record, dict) else {"": record}


def _error_code(exchange: Exchange) -> str:
    """Return the code of an error record."""
    return str(_decode(exchange.reply, exchange.reply_encoding).get("error"))
