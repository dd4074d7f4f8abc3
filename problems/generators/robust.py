"""Robust problems: forces that hold for all errors of friction, load, and contact normals, with a slip margin.

Only errors that the program of the squeeze covers exactly occur, so that each case has one optimum. Contacts surround the
object, so that squeezes hold all loads within the errors.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from graspforce.core.arrays import Array
from graspforce.problems.derivations.records import Record
from graspforce.problems.generators.random_grasps import Generator
from graspforce.problems.generators.records import contact_set, problem_record, round_numbers, rounded_contact

_SEED = 31
_CASES = 40  # of each kind
_LEVER = 0.05  # m/rad
_MAX_NORMAL = 200.0  # N
_OBJECTIVES = ("torque", "force", "torque", "sum_normal", "max_normal")
_PYRAMID = ("inner", 8)  # of each fourth case
_KINDS = ("friction", "mass", "centre", "wrenches", "normals", "all")


def cases() -> Iterator[Record]:
    """Yield the records of the collection."""
    for k, kind in enumerate(_KINDS):
        for i in range(_CASES):
            rng = np.random.default_rng([_SEED, k, i])
            is_soft = i % 5 == 4 and kind not in ("normals", "all")
            records = _surrounding_contacts(rng, 4 + i % 4, is_soft)
            w = np.append(rng.normal(size=3), rng.normal(size=3) * 0.01) * rng.uniform(0.5, 3.0)  # N, N·m
            objective = _OBJECTIVES[i % 5]
            hand = _hand(rng, records) if objective == "torque" else None
            errors = _errors(rng, kind, w)
            record = problem_record(
                f"robust/{kind}-{i + 1:02}",
                f"Seeded: {len(records)} contacts around an object. The forces hold for {_ERRORS[kind]}.",
                records,
                round_numbers(w),
                hand=hand,
                cone=_PYRAMID if i % 4 == 3 else None,
                objective=objective,
            )
            yield {**record, "uncertainty": round_numbers_of(errors)}


_ERRORS = {
    "friction": "a part of the friction",
    "mass": "a mass between two limits",
    "centre": "a centre of mass in a box, with a slip margin",
    "wrenches": "all wrenches between some given ones",
    "normals": "tilted contact normals",
    "all": "less friction, other masses and centres of mass, and tilted normals",
}


def round_numbers_of(record: Record) -> Record:
    """Return a record with rounded numbers."""
    return {key: round_numbers(value) for key, value in record.items()}


def _surrounding_contacts(rng: Generator, count: int, is_soft: bool) -> list[Record]:
    """Return the records of contacts on all sides of a ball: a spiral of equal areas, turned and disturbed."""
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    heights = 1.0 - 2.0 * (np.arange(count) + 0.5) / count
    angles = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    across = np.sqrt(1.0 - heights**2)
    spiral = np.stack([across * np.cos(angles), across * np.sin(angles), heights], axis=1) @ turn.T
    radius = rng.uniform(0.02, 0.06)  # m
    records = []
    for direction in spiral + 0.1 * rng.normal(size=(count, 3)):
        n = -direction / np.linalg.norm(direction)
        more = {"model": "soft", "torsional_friction": float(rng.uniform(0.003, 0.01))} if is_soft else {}
        friction = float(rng.uniform(0.6, 1.0))
        position = radius * (-n + 0.05 * rng.normal(size=3))
        records.append(rounded_contact(position, n, friction=friction, max_normal=_MAX_NORMAL, **more))
    return records


def _hand(rng: Generator, records: list[Record]) -> Record:
    """Return the record of a hand with a finger of three strong joints for each contact."""
    contacts = contact_set(records)
    J = np.zeros((contacts.size, 3 * len(contacts)))
    for row, column in enumerate(contacts.columns):
        finger = int(column) // 4
        unit = _LEVER if column % 4 != 3 else 1.0  # m/rad, rad/rad
        J[row, 3 * finger : 3 * finger + 3] = rng.normal(size=3) * unit
    most = np.full(J.shape[1], 10.0 * _LEVER * float(rng.uniform(4.0, 8.0)))  # N·m
    record: Record = {"jacobian": round_numbers(J), "bias_torque": round_numbers(rng.normal(size=J.shape[1]) * 0.02)}
    return record | {"torque_lower": round_numbers(-most), "torque_upper": round_numbers(most)}


def _errors(rng: Generator, kind: str, w: Array) -> Record:
    """Return the record of the errors of a kind."""
    size = float(np.linalg.norm(w[:3]))  # N
    friction, mass = float(rng.uniform(0.05, 0.3)), float(rng.uniform(0.1, 0.5))
    centre, tilt = rng.uniform(0.001, 0.005, size=3), float(rng.uniform(0.01, 0.08))  # m, rad
    more = rng.normal(size=(int(rng.integers(2, 7)), 6)) * np.array([0.3, 0.3, 0.3, 0.003, 0.003, 0.003]) * size
    kinds: dict[str, Record] = {
        "friction": {"friction_error": friction},
        "mass": {"mass_error": mass, "friction_error": 0.1},
        "centre": {"centre_of_mass_error": centre, "slip_margin": 0.05 * size},
        "wrenches": {"wrenches": more},
        "normals": {"normal_error": tilt},
        "all": {"friction_error": 0.1, "mass_error": 0.2, "centre_of_mass_error": centre, "normal_error": tilt},
    }
    return kinds[kind]
