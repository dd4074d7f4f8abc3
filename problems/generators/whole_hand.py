"""Whole-hand grasps: several contacts on one finger, on inner links and the palm, and joints that all fingers share.

A contact on a link feels only the joints before that link. A contact on the palm feels none. A shared joint, such as a wrist or
a coupled spread, moves every finger, so that the problem does not separate into fingers.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from graspforce.core.arrays import Array
from graspforce.problems.derivations.records import Record
from graspforce.problems.generators.random_grasps import Generator, interior_forces, random_contacts
from graspforce.problems.generators.records import contact_set, problem_record, round_numbers, supplied_wrench

_SEED = 29
_CASES = 25  # of each kind
_LEVER = 0.04  # m/rad
_KINDS = {  # shared joints, contacts on the palm
    "inner": (0, 0),
    "palm": (0, 1),
    "shared": (1, 0),
    "shared-palm": (2, 2),
}


def cases() -> Iterator[Record]:
    """Yield the records of the collection."""
    for k, (kind, (shared, palm)) in enumerate(_KINDS.items()):
        for i in range(_CASES):
            rng = np.random.default_rng([_SEED, k, i])
            links = [_touched_links(rng) for _ in range(int(rng.integers(2, 5)))]
            count = palm + sum(map(len, links))
            models = ("point", "soft") if i % 5 == 4 else ("point",)
            records = random_contacts(rng, count, models=models, friction_range=(0.3, 1.0))
            f = interior_forces(rng, contact_set(records), share=0.7)
            hand = _hand(rng, records, links, shared, f)
            objective = ("torque", "torque", "force", "sum_normal", "max_normal")[i % 5]
            source = f"Seeded: {len(links)} fingers with {count - palm} contacts on their links, {palm} on the palm, "
            source += f"{shared} joints that all fingers share. The wrench is that of random forces within all limits."
            name = f"whole-hand/{kind}-{i + 1:02}"
            yield problem_record(name, source, records, supplied_wrench(records, f), hand=hand, objective=objective)


def _touched_links(rng: Generator) -> tuple[int, ...]:
    """Return the numbers of joints before each touched link of a finger with three joints, at least one link."""
    touched = rng.random(3) < 0.6
    return tuple(int(link) + 1 for link in np.flatnonzero(touched)) or (3,)


def _hand(rng: Generator, records: list[Record], links: list[tuple[int, ...]], shared: int, f: Array) -> Record:
    """Return the record of a hand with three joints a finger; contacts of the fingers come first, those of the palm last."""
    contacts = contact_set(records)
    J = np.zeros((contacts.size, shared + 3 * len(links)))
    place = [(finger, joints) for finger, touched in enumerate(links) for joints in touched]
    for row, column in enumerate(contacts.columns):
        i = int(column) // 4
        if i < len(place):
            finger, joints = place[i]
            first = shared + 3 * finger
            unit = _LEVER if column % 4 != 3 else 1.0  # m/rad, rad/rad
            J[row, :shared] = rng.normal(size=shared) * unit
            J[row, first : first + joints] = rng.normal(size=joints) * unit
    J = np.array(round_numbers(J), dtype=np.float64)
    tau_u = rng.normal(size=J.shape[1]) * 0.02  # N·m
    most = np.abs(tau_u + J.T @ f) * rng.uniform(1.1, 1.6, size=J.shape[1]) + 0.05
    record: Record = {"jacobian": round_numbers(J), "bias_torque": round_numbers(tau_u)}
    return record | {"torque_lower": round_numbers(-most), "torque_upper": round_numbers(most)}
