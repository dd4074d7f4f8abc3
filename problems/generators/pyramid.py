"""Inner and outer friction pyramids of 3 to 32 facets, with every objective: quadratic and linear programs."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from graspforce.problems.derivations.records import Record
from graspforce.problems.generators.random_grasps import interior_forces, random_contacts, random_hand
from graspforce.problems.generators.records import contact_set, problem_record, supplied_wrench

_SEED = 17
_OBJECTIVES = ("force", "torque", "sum_normal", "max_normal", "margin")
_FACETS = (3, 4, 6, 8, 16, 32)


def cases() -> Iterator[Record]:
    """Yield the records of the collection."""
    for facets in _FACETS:
        for s, side in enumerate(("inner", "outer")):
            for o, objective in enumerate(_OBJECTIVES):
                for i in range(4):
                    rng = np.random.default_rng([_SEED, facets, s, o, i])
                    count = int(rng.integers(3, 9))
                    models = ("soft", "point") if i == 3 else ("point",)
                    records = random_contacts(rng, count, models=models)
                    # inner pyramids of m facets contain the circle of radius μ cos(π/m); a share of cos²(π/m) is well inside
                    share = 0.95 * math.cos(math.pi / facets) ** 2 if side == "inner" else 0.95
                    f = interior_forces(rng, contact_set(records), min(share, 0.6))
                    hand = random_hand(rng, records, f) if objective == "torque" else None
                    source = f"{count} seeded contacts, with the wrench of random forces within all limits."
                    name = f"pyramid/{side}-{facets}-{objective.replace('_', '-')}-{i + 1}"
                    w, cone = supplied_wrench(records, f), (side, facets)
                    yield problem_record(name, source, records, w, hand=hand, cone=cone, objective=objective)
