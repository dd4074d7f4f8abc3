"""Problems with 3 to 1000 contacts on a rough sphere, feasible, without and with a hand, to measure how time grows."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from graspforce.problems.derivations.records import Record
from graspforce.problems.generators.random_grasps import interior_forces, random_contacts, random_hand
from graspforce.problems.generators.records import contact_set, problem_record, supplied_wrench

_SIZES = (3, 4, 5, 6, 8, 10, 15, 20, 30, 50, 75, 100, 150, 200, 300, 500, 750, 1000)
_LARGEST_HAND = 30  # contacts: above this, a dense Jacobian would fill the file with zeros
_SEED = 11


def cases() -> Iterator[Record]:
    """Yield the records of the collection."""
    for count in _SIZES:
        for i in range(4 if count <= 100 else 2):
            rng = np.random.default_rng([_SEED, count, i])
            records = random_contacts(rng, count)
            f = interior_forces(rng, contact_set(records), share=0.6)
            w = supplied_wrench(records, f)
            source = f"{count} seeded contacts on a rough sphere, with the wrench of random forces within all limits."
            yield problem_record(f"scaling/{count:04}-force-{i + 1}", source, records, w, objective="force")
            if count <= _LARGEST_HAND:
                hand = random_hand(rng, records, f)
                source += " Each contact has a finger with three joints."
                yield problem_record(f"scaling/{count:04}-torque-{i + 1}", source, records, w, hand=hand, objective="torque")
