"""Soft contacts, which also carry a moment about the normal: alone, mixed with others, with small and large γ."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from graspforce.problems.derivations.records import Record
from graspforce.problems.generators.random_grasps import interior_forces, random_contacts, random_hand
from graspforce.problems.generators.records import contact_set, problem_record, supplied_wrench

_SEED = 13
_OBJECTIVES = ("force", "torque", "sum_normal", "max_normal", "margin")
_KINDS = {  # models, range of γ in m, contacts
    "soft": (("soft",), (0.002, 0.02), (2, 5)),
    "mixed": (("soft", "point", "frictionless"), (0.002, 0.02), (3, 8)),
    "slender": (("soft",), (1e-5, 1e-3), (3, 6)),
    "broad": (("soft",), (0.02, 0.1), (2, 5)),
}


def cases() -> Iterator[Record]:
    """Yield the records of the collection."""
    for k, (kind, (models, gamma_range, (fewest, most))) in enumerate(_KINDS.items()):
        for o, objective in enumerate(_OBJECTIVES):
            for i in range(10):
                rng = np.random.default_rng([_SEED, k, o, i])
                count = int(rng.integers(fewest, most + 1))
                records = random_contacts(rng, count, models=models, gamma_range=gamma_range)
                if objective == "margin" and not contact_set(records).mu.any():
                    records[0] = {**records[0], "model": "point", "friction": 0.5}
                f = interior_forces(rng, contact_set(records), share=0.7)
                hand = random_hand(rng, records, f, joint_range=(3, 4), random_weights=True) if objective == "torque" else None
                source = f"{count} seeded contacts ({', '.join(models)}), with the wrench of random forces within all limits."
                name = f"soft/{kind}-{objective.replace('_', '-')}-{i + 1}"
                yield problem_record(name, source, records, supplied_wrench(records, f), hand=hand, objective=objective)
