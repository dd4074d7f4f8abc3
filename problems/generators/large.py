"""Problems with 500 contacts: a body that lies in a bed of pins, or that a soft gripper encloses."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from graspforce.core.arrays import Array
from graspforce.problems.derivations.records import Record
from graspforce.problems.generators.random_grasps import Generator, random_directions
from graspforce.problems.generators.records import contact_set, problem_record, rounded_contact, supplied_wrench

COUNT = 500  # contacts
_SEED = 37
_DIGITS = 5  # of positions and normals, to keep files short
_CASES = {"force": 1, "sum-normal": 1, "soft": 1, "smooth": 1, "overloaded": 1}
_MAX_NORMAL = 2.0  # N


def cases() -> Iterator[Record]:
    """Yield the records of the collection."""
    for k, (kind, count) in enumerate(_CASES.items()):
        for i in range(count):
            rng = np.random.default_rng([_SEED, k, i])
            records = _contacts(rng, kind)
            contacts = contact_set(records)
            objective = kind.replace("-", "_") if kind.endswith("normal") else "force"
            source, expected = f"{COUNT} seeded contacts on a rough ellipsoid. ", None
            if kind == "overloaded":
                w, expected = _overload(rng, records, 1.001 + 0.05 * i)
                source += "The load exceeds what the contacts supply along one direction, within their largest normal forces."
            else:
                f = np.zeros(contacts.size)
                f[contacts.normal_rows] = rng.uniform(0.1, 0.5 * _MAX_NORMAL, size=COUNT)
                w = supplied_wrench(records, f)
                source += "The wrench is that of random normal forces within all limits."
            yield problem_record(f"large/{kind}-{i + 1}", source, records, w, objective=objective, expected=expected)


def _contacts(rng: Generator, kind: str) -> list[Record]:
    """Return the records of contacts on an ellipsoid, with tilted normals."""
    axes = rng.uniform(0.05, 0.15, size=3)  # m
    records = []
    for direction in random_directions(rng, COUNT):
        n = -direction / axes
        n = n / np.linalg.norm(n) + 0.05 * rng.normal(size=3)
        more: Record = {} if kind == "smooth" else {"friction": round(float(rng.uniform(0.3, 0.9)), 3)}
        if kind == "smooth":
            more["model"] = "frictionless"
        if kind == "soft":
            more |= {"model": "soft", "torsional_friction": round(float(rng.uniform(0.002, 0.01)), 5)}
        position, normal = (_short(values) for values in (axes * direction, n / np.linalg.norm(n)))
        records.append(rounded_contact(position, normal, max_normal=_MAX_NORMAL, **more))
    return records


def _overload(rng: Generator, records: list[Record], factor: float) -> tuple[Array, Record]:
    """Return a load that no forces supply, and the proof.

    Along y, contact i supplies at most f_max h_i⁺ with h_i = n·y + μ ‖y_t‖ for a force direction y. The load has a factor
    above 1 on the sum. The proof has the multipliers y of equilibrium and h_i⁺ of the upper limits.

    Args:
        rng: random source.
        records: records of the contacts.
        factor: load over the largest supplied one.
    """
    y = random_directions(rng, 1)[0]
    contacts = contact_set(records)
    normals = contacts.R_OC[:, :, 2]
    along = normals @ y
    across = np.sqrt(np.maximum(1.0 - along**2, 0.0))
    largest = np.maximum(along + contacts.mu * across, 0.0)
    w = np.append(factor * float(_MAX_NORMAL * largest.sum()) * y, np.zeros(3))
    proof = {"y": [*y.tolist(), 0.0, 0.0, 0.0], "normal_upper": largest.tolist()}
    return w, {"status": "infeasible", "proof": proof, "tolerance": 1e-7}


def _short(values: Array) -> list[float]:
    return [float(f"{value:.{_DIGITS}g}") for value in values]
