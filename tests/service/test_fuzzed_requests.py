"""Mutated requests on all keys: each gets a reply that can be decoded, and no error record has the code ``internal``.

`python -m benchmarks.fuzz_service` is the long form.
"""

from __future__ import annotations

import copy

import pytest

from benchmarks import fuzz_service
from benchmarks.fuzz_service import FuzzTarget, Payload, code_of, fuzz, wire_examples
from graspforce.service.wire import protocol

SEED = 20261123
COUNT = 1400


@pytest.fixture(scope="module")
def target():
    return FuzzTarget()


def test_mutated_requests_never_get_internal_errors_or_silence(target):
    outcomes, failures = fuzz(target, SEED, COUNT)
    assert not failures
    assert sum(sum(row.values()) for row in outcomes.values()) == COUNT
    for kind, key, _ in wire_examples():
        row = outcomes[f"{key}/state" if kind == "state" else key]
        assert row["invalid"] > 0, key


@pytest.mark.parametrize(
    ("path", "value", "field"),
    [
        (("tolerance",), "x", "tolerance"),
        (("tolerance",), 1e300, "tolerance"),
        (("posture",), [1e300] * 12, "posture"),
        (("poses", 1), None, "poses[1]"),
        (("poses", 0, "position"), [1e308] * 3, "poses"),
        (("body",), None, "body"),
        (("contacts", 0), None, "contacts[0]"),
        (("gravity",), [[1.0]], "gravity"),
        (("intervals",), 1.5, "intervals"),
    ],
)
def test_invalid_move_gets_the_field_over_the_wire(target, path, value, field):
    [move] = [record for _, key, record in wire_examples() if key.endswith("/plan") and record.get("id") == "my-plan"][:1]
    changed = copy.deepcopy(move)
    inner = changed
    for step in path[:-1]:
        inner = inner[step]
    inner[path[-1]] = value
    reply = target.reply(
        Payload("query", f"hands/{fuzz_service.HAND}/plan", protocol.encode(changed, protocol.MSGPACK), protocol.MSGPACK)
    )
    record = protocol.decode(reply.payload, reply.encoding)
    assert code_of(reply) == "invalid", record
    assert record["field"].startswith(field)
