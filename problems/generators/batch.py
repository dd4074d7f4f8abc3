"""Batches of ten thousand small problems with the same contacts and hand, and other loads.

The first `CASES` members of each batch are cases of the library. Loads are multiples of `UNITS`, so that they are stored in two
bytes a number.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graspforce.problems.derivations.records import Record
from graspforce.problems.generators.records import problem_record, round_numbers, rounded_contact

COUNT = 10_000  # problems of a batch
CASES = 350  # of each batch in the library
UNITS = np.array([2.0**-10] * 3 + [2.0**-14] * 3)  # N, N·m
KINDS = ("force", "torque", "pyramid", "limits")
_SEED = 41
_RADIUS = 0.03  # m
_LEVER = 0.05  # m/rad
_SOURCES = {
    "force": "Three fingertips around a ball.",
    "torque": "Three fingers with three joints each around a ball, with torque limits.",
    "pyramid": "Four fingertips around a ball, inner pyramids of eight facets.",
    "limits": "Three fingertips around a ball, with normal forces of at most 8 N: the greatest loads cannot be held.",
}
_LARGEST = {"force": 10.0, "torque": 2.0, "pyramid": 10.0, "limits": 12.0}  # N: of the loads


@dataclass(frozen=True, eq=False, slots=True)
class BatchSource:
    """A batch without answers.

    Args:
        record: record of a problem, with the load of the first member.
        loads: (10000, 6) loads in `UNITS`.
    """

    record: Record
    loads: npt.NDArray[np.int16]


def cases() -> Iterator[Record]:
    """Yield the records of the first members of each batch."""
    for kind in KINDS:
        batch = make_batch(kind)
        for i in range(CASES):
            yield {**batch.record, "name": f"batch/{kind}-{i:03}", "wrench": (batch.loads[i] * UNITS).tolist()}


def make_batch(kind: str) -> BatchSource:
    """Return a batch.

    Args:
        kind: one of `KINDS`.
    """
    rng = np.random.default_rng([_SEED, KINDS.index(kind)])
    count = 4 if kind == "pyramid" else 3
    more = {"max_normal": 8} if kind == "limits" else {}
    contacts = []
    for angle in 2 * np.pi * np.arange(count) / count + rng.uniform(-0.2, 0.2, size=count):
        outwards = np.array([np.cos(angle), np.sin(angle), rng.uniform(-0.1, 0.1)])
        outwards /= np.linalg.norm(outwards)
        contacts.append(rounded_contact(_RADIUS * outwards, -outwards, friction=0.6, **more))
    sizes = _LARGEST[kind] * rng.uniform(0.1, 1.0, COUNT)
    directions = rng.normal(size=(COUNT, 3))
    forces = directions / np.linalg.norm(directions, axis=1)[:, None] * sizes[:, None]  # N
    centres = 0.1 * _RADIUS * rng.normal(size=(COUNT, 3))  # m
    loads = np.rint(np.hstack([forces, np.cross(centres, forces)]) / UNITS).astype(np.int16)
    record = problem_record(
        f"batch/{kind}-000",
        f"{_SOURCES[kind]} Loads of random masses and centres of mass, in random directions.",
        contacts,
        loads[0] * UNITS,
        hand=_hand(rng) if kind == "torque" else None,
        cone=("inner", 8) if kind == "pyramid" else None,
        objective="torque" if kind == "torque" else "force",
    )
    return BatchSource(record, loads)


def _hand(rng: np.random.Generator) -> Record:
    """Return the record of a hand with three joints a finger."""
    J = np.zeros((9, 9))
    for finger in range(3):
        own = slice(3 * finger, 3 * finger + 3)
        J[own, own] = _LEVER * np.linalg.qr(rng.normal(size=(3, 3)))[0]
    limits = {"torque_lower": [-0.6] * 9, "torque_upper": [0.6] * 9}  # N·m
    return {"jacobian": round_numbers(J), "bias_torque": round_numbers(0.02 * rng.normal(size=9)), **limits}
