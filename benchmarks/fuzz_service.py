"""Fuzzing of the service in this process: `python -m benchmarks.fuzz_service`.

The requests of ``docs/wire.md`` are mutated: fields removed, added and replaced, lists repeated, numbers scaled, bytes changed.
Some keys are unknown, or ask for schemas, and some plans are cancelled.
Each goes to the request handler, a stream or the planning code, in JSON or MessagePack. The law: each payload gets one reply,
which can be decoded, and no error record has the code ``internal``.

Requests are sent in pieces of ten thousand, each with a seed of its own. A run continues the file of finished pieces.
"""

from __future__ import annotations

import copy
import json
import logging
import math
import queue
import random
import re
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from benchmarks import report_page
from benchmarks.task_records import Record, Task, run_tasks
from graspforce.hand.hand import Hand
from graspforce.service import RequestHandler, ServerLimits
from graspforce.service.server.plan_registry import PlanRegistry
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.wire import protocol
from graspforce.service.wire.reply import Reply
from graspforce.service.workers.jobs import PlanningJob, WorkerMessage
from graspforce.service.workers.planning_process import run_job
from graspforce.service.workers.planning_worker import PlanningWorker

HAND = "four_finger"
WIRE_PAGE = Path(__file__).parent.parent / "docs" / "wire.md"
RECORDS = Path(__file__).parent / "results" / "records" / "fuzz_service.jsonl"
PIECE = 10_000  # requests
CODECS = (protocol.JSON, protocol.MSGPACK)
_EXAMPLE = re.compile(r"<!-- (query|state) (\S+) -->\n```json\n(.*?)```", re.DOTALL)
_REPLY_TIMEOUT = 120.0  # s
_MAX_SHOWN = 20  # failures
_MAX_BYTE_EDITS = 4
_GRASP_PERIOD = 350  # requests, of which one is for a grasp, because a search takes a second
_KEY_SHARE = 0.05  # of the requests have odd keys
_BYTE_SHARE = 0.2  # of the mutations change bytes, the others fields
_VALUES: tuple[Any, ...] = (
    *(None, True, False, "", "x", "\x1b[2J\x00", "ä" * 300, [], {}, [[]], [None], {"a": 1}, [[[]]], [{}]),
    *(
        0,
        1,
        -1,
        2,
        7,
        0.5,
        -0.5,
        1e-300,
        1e-9,
        1e9,
        1e155,
        1e300,
        -1e300,
        1e308,
        2**31,
        2**53,
        2**63 - 1,
        2**63,
        2**64 - 1,
        -(2**63),
    ),
    *(
        float("nan"),
        float("inf"),
        float("-inf"),
        [0.0],
        [0.0] * 3,
        [1e308] * 3,
        [[0.0] * 3] * 3,
        [[1, 0, 0], [0, 1, 0], [0, 0, -1]],
        [[0.0], 0.0],  # ragged
        [[0.0], [0.0, 0.0]],
        [True, [True]],
    ),
    *("sphere", "box", "finger_1", "straight", "spline", "free", "fingers", "path", "soft", "frictionless"),
)

_FACTORS = (0.0, -1.0, 1e-12, 1.001, 10.0, 1e6, 1e155, 1e300)


class Payload(NamedTuple):
    """A request to send.

    Attributes:
        kind: "query" or "state".
        key: its key after the prefix.
        payload: encoded record.
        codec: its encoding.
    """

    kind: str
    key: str
    payload: bytes
    codec: str


class InProcessPlanner(PlanningWorker):
    """A planning worker without a process: it plans in the caller's thread, and stops at the first chance."""

    def plan(
        self, job: PlanningJob, hand: Hand, progress: Callable[[Reply], None], on_timeout: Callable[[WorkerMessage], None]
    ) -> WorkerMessage:
        """Run a job; its messages must be decodable."""
        return run_job(job, hand, lambda message: _decode(message.reply), lambda: True)


class FuzzTarget:
    """The service without network and processes: every payload gets a reply."""

    def __init__(self) -> None:
        hand = Hand.load(HAND)
        self._handler = RequestHandler([hand], limits=ServerLimits(plans=0))
        self._plans = PlanRegistry(
            {HAND: hand},
            workers=[InProcessPlanner()],
            limits=ServerLimits(intervals=50),
            publish=lambda id, reply: None,
            count=lambda key, outcome: None,
        )

    def reply(self, request: Payload) -> Reply:
        """Return the reply to a payload."""
        if request.kind == "state":
            return self._open_stream(request.key).command(request.payload, request.codec)
        if request.kind == "cancel":
            is_active = self._plans.cancel(request.payload.decode(errors="surrogateescape"))
            return Reply(True, protocol.encode({"cancelled": is_active}, request.codec), request.codec)
        if request.key not in self._handler.plan_keys:
            return self._handler.answer(request.key, request.payload, request.codec)
        replies: queue.SimpleQueue[Reply] = queue.SimpleQueue()
        self._plans.begin(request.key, request.payload, request.codec, replies.put)
        return replies.get(timeout=_REPLY_TIMEOUT)

    def _open_stream(self, key: str) -> ServerStream:
        """Return a stream of ``docs/wire.md``, which is opened unless it is open."""
        streams, id = self._handler.streams, key.removeprefix("streams/")
        try:
            return streams[id]
        except KeyError:
            if len(streams) >= ServerLimits().client_streams:  # another one would be refused
                streams.close_of(b"")
            [setup] = [each for each in wire_examples() if each[:2] == ("query", key) and "close" not in each[2]]
            assert self._handler.answer(key, json.dumps(setup[2]).encode()).ok
            return streams[id]


def code_of(reply: Reply) -> str:
    """Return "ok" for a record and the code of an error record.

    Raises:
        InvalidInput: the reply cannot be decoded.
    """
    record = _decode(reply)
    return "ok" if reply.ok else str(record["error"])


@cache
def wire_examples() -> tuple[tuple[str, str, Any], ...]:
    """Return kind, key and record of requests: those of ``docs/wire.md``, other moves, and states with conditions."""
    found = [(kind, key, json.loads(text)) for kind, key, text in _EXAMPLE.findall(WIRE_PAGE.read_text())]
    [path] = [record for _, key, record in found if key.endswith("/plan")]
    start = path["posture"]
    goal = [*start[:-1], start[-1] + 0.05]
    wall = {"shape": {"type": "box", "edges": [0.1, 0.1, 0.01]}, **path["poses"][0], "position": [0.0, 0.0, 0.3]}
    moves = [
        {**path, "method": "free", "room": {"lower": [-1, -1, -1], "upper": [1, 1, 1], "turn": 1.0}, "intervals": 4},
        {
            **path,
            "way": "spline",
            "tolerance": 1e-3,
            "torque": [0.5] * 12,
            "lower": [-0.7, -0.1, -0.1] * 4,
            "upper": [0.7] * 12,
        },
        {"method": "fingers", "postures": [start, goal], "apart": 1e-3, "obstacles": [wall], "intervals": 4},
        {"method": "fingers", "postures": [start, goal, start], "intervals": 4, "collisions": {"margin": 2e-3}},
    ]
    del moves[0]["way"]
    conditions = {"slipping": [True] + [False] * 3, "friction": [0.5] * 4, "lost": ["finger_4"], "touching": [True] * 4}
    objects = {"streams/my-stream", "streams/my-measurements"}
    states = [(key, record) for kind, key, record in found if kind == "state" and key in objects]
    return (
        *(*found, *(("query", f"hands/{HAND}/plan", move) for move in moves)),
        *(("state", key, {**record, "conditions": conditions}) for key, record in states),
    )


def mutated_payloads(seed: int, count: int) -> Iterator[Payload]:
    """Yield requests with random changes, and some without.

    Args:
        seed: seed of the random numbers.
        count: number of requests.
    """
    chance = random.Random(seed)
    light = [each for each in wire_examples() if not each[1].endswith("/grasp")]
    heavy = [each for each in wire_examples() if each not in light]
    for k in range(count):
        kind, key, record = chance.choice(heavy if k % _GRASP_PERIOD == _GRASP_PERIOD - 1 else light)
        codec = chance.choice(CODECS)
        if chance.random() < _KEY_SHARE:
            yield Payload(*_odd_key(chance), _encode(record, codec), codec)
            continue
        if chance.random() < _BYTE_SHARE:
            yield Payload(kind, key, mutate_bytes(_encode(record, codec), chance), codec)
            continue
        changed = copy.deepcopy(record)
        for _ in range(chance.randint(0, 3)):
            changed = mutate_record(changed, chance)
        yield Payload(kind, key, _encode(changed, codec), codec)


def _odd_key(chance: random.Random) -> tuple[str, str]:
    """Return kind and key of a request with an odd key: unknown, of a schema, of another version, or a cancellation."""
    if chance.random() < 0.2:
        return "cancel", "plans/cancel"
    others = ["schema/solution", "schema/**", "graspforce/2/solve", "status"]
    known = chance.choice([*others, *(key for _, key, _ in wire_examples())])
    place = chance.randrange(len(known))
    odd = chance.choice(["", "x", "/", "//", "*", "\x1b[2J", "ä" * 80, "\x00", "state"])
    return "query", known[:place] + odd + known[place + chance.randint(0, 2) :]


def mutate_record(record: Any, chance: random.Random) -> Any:
    """Return a record with one change at a random place. The record is changed in place unless it is the place itself."""
    places = list(_places(record))
    if not places or chance.random() < 0.01:
        return copy.deepcopy(chance.choice(_VALUES))
    holder, name = chance.choice(places)
    kind = chance.randrange(6)
    if kind == 0:
        del holder[name]
    elif kind == 1 and isinstance(holder, dict):
        holder[chance.choice(["x", "\x1b[31m", "", "y" * 200, "id", "position", "shape", "poses"])] = holder[name]
    elif kind == 1:
        holder[name:name] = [copy.deepcopy(holder[name])] * chance.randint(1, 5)
    elif kind == 2:
        other, place = chance.choice(places)
        holder[name] = copy.deepcopy(other[place])
    elif kind == 3:
        holder[name] = _scale_numbers(holder[name], chance.choice(_FACTORS))
    else:
        holder[name] = copy.deepcopy(chance.choice(_VALUES))
    return record


def mutate_bytes(payload: bytes, chance: random.Random) -> bytes:
    """Return a payload with a few bytes changed, removed or repeated."""
    changed = bytearray(payload)
    for _ in range(chance.randint(1, _MAX_BYTE_EDITS)):
        if not changed:
            break
        place, kind = chance.randrange(len(changed)), chance.randrange(4)
        if kind == 0:
            changed[place] = chance.randrange(256)
        elif kind == 1:
            changed[place] ^= 1 << chance.randrange(8)
        elif kind == 2:
            del changed[place : place + chance.randint(1, 9)]
        else:
            changed[place:place] = changed[place : place + chance.randint(1, 9)]
    return bytes(changed)


def fuzz(target: FuzzTarget, seed: int, count: int) -> tuple[dict[str, Counter[str]], list[tuple[Payload, str]]]:
    """Send mutated requests and return the number of replies by key and code, and the requests that break the law.

    Args:
        target: the service.
        seed: seed of the random numbers.
        count: number of requests.
    """
    outcomes: dict[str, Counter[str]] = {}
    failures: list[tuple[Payload, str]] = []
    for request in mutated_payloads(seed, count):
        try:
            reply = target.reply(request)
            code, text = code_of(reply), reply.payload.decode(errors="replace")
        except Exception as error:
            code, text = "none", repr(error)
        known = {key for _, key, _ in wire_examples()}
        name = f"{request.key}/state" if request.kind == "state" else request.key if request.key in known else "odd keys"
        outcomes.setdefault(name, Counter())[code] += 1
        if code in ("internal", "none"):
            failures.append((request, text))
    return outcomes, failures


def _places(record: Any) -> Iterator[tuple[Any, Any]]:
    """Yield each list or mapping inside a record with each of its indices or names."""
    items = record.items() if isinstance(record, dict) else enumerate(record) if isinstance(record, list) else ()
    for name, value in items:
        yield record, name
        yield from _places(value)


def _scale_numbers(value: Any, factor: float) -> Any:
    """Return a value with all numbers in it multiplied by a factor."""
    if isinstance(value, dict):
        return {name: _scale_numbers(item, factor) for name, item in value.items()}
    if isinstance(value, list):
        return [_scale_numbers(item, factor) for item in value]
    return float(value) * factor if isinstance(value, int | float) else value


def _decode(reply: Reply) -> Any:
    """Return the record of a reply."""
    return protocol.decode(reply.payload, reply.encoding)


def _encode(record: Any, codec: str) -> bytes:
    """Return a payload as a foreign program may write it: JSON with NaN, and MessagePack without large integers."""
    if codec == protocol.JSON:
        return json.dumps(record).encode()
    return msgspec.msgpack.encode(record)


@cache
def _own_target() -> FuzzTarget:
    """Return the service of this process."""
    return FuzzTarget()


def run_piece(task: Task) -> Record:
    """Return the replies to a piece of the requests, and the texts of those that break the law.

    Args:
        task: seed of its random numbers, and number of requests.
    """
    logging.disable(logging.CRITICAL)
    seed, count = task
    outcomes, failures = fuzz(_own_target(), seed, count)
    shown = [f"{request.key} ({request.codec}): {text[:300]}; {request.payload[:2000]!r}" for request, text in failures]
    return {"outcomes": outcomes, "failures": shown}


def main() -> None:
    """Send the requests, print the table of replies, and end with 1 if a request broke the law."""
    parser = report_page.parser("fuzz_service", __doc__)
    parser.add_argument("--count", type=int, default=1_000_000, help="number of requests")
    parser.add_argument("--seed", type=int, default=1, help="seed of the first piece")
    parser.add_argument("--records", type=Path, default=RECORDS, help="file of the finished pieces, which is continued")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--budget", type=float, default=math.inf, help="time after which no further piece is started, s")
    options = parser.parse_args()
    pieces = [(options.seed + k, PIECE) for k in range(-(-options.count // PIECE))]
    results = run_tasks(run_piece, pieces, options.records, options.workers, options.budget).values()
    outcomes: dict[str, Counter[str]] = {}
    for result in results:
        for key, counts in result["outcomes"].items():
            outcomes.setdefault(key, Counter()).update(counts)
    codes = sorted({code for row in outcomes.values() for code in row})
    rows = [[key, *(str(row[code]) for code in codes)] for key, row in sorted(outcomes.items())]
    failures = [text for result in results for text in result["failures"]]
    sent = sum(sum(row.values()) for row in outcomes.values())
    counts = f"{sent} requests of {options.count}, {len(failures)} against the law"
    print(counts, *failures[:_MAX_SHOWN], sep="\n")
    report_page.publish("Fuzzed requests", __doc__, ("key", *codes), rows, options.save, counts, width=140)
    raise SystemExit(1 if failures else 0)


if __name__ == "__main__":
    main()
