"""Difficult problems: loads near the boundary, rank-deficient G, extreme units, low friction, idle contacts."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from graspforce.problems.derivations.records import Record
from graspforce.problems.generators import boundary
from graspforce.problems.generators.random_grasps import Generator, interior_forces, random_contacts, random_hand
from graspforce.problems.generators.records import contact_set, problem_record, rounded_contact, supplied_wrench

_SEED = 19
_CASES_PER_MARGIN = 6


def cases() -> Iterator[Record]:
    """Yield the records of the collection."""
    yield from boundary.near_boundary_cases("hard", True, _SEED, _CASES_PER_MARGIN)
    yield from _rank_deficient()
    yield from _scales()
    yield from _slippery()
    yield from _idle()


def _rank_deficient() -> Iterator[Record]:
    """Yield problems with rank G < 6 or repeated contacts: collinear, opposed, planar frictionless, duplicate, coincident."""
    for kind, make in (("line", _line), ("opposed", _opposed), ("flat", _flat), ("twins", _duplicated), ("place", _coincident)):
        for i in range(8):
            rng = np.random.default_rng([_SEED, 1, sum(kind.encode()), i])
            records = make(rng)
            f = interior_forces(rng, contact_set(records), share=0.7)
            source = f"Seeded contacts, {_DESCRIPTIONS[kind]}. The wrench is that of random forces within all limits."
            hand = random_hand(rng, records, f) if i % 2 else None
            objective = "torque" if i % 2 else "force"
            yield problem_record(
                f"hard/rank-{kind}-{i + 1}", source, records, supplied_wrench(records, f), hand=hand, objective=objective
            )


_DESCRIPTIONS = {
    "line": "all on one line, about which they supply no moment",
    "opposed": "two and opposed: they supply no moment about the line between them",
    "flat": "frictionless and in one plane: three of the six rows of G are zero",
    "twins": "each given twice, so that the two can share their force in any ratio",
    "place": "all at one point, about which they supply no moment",
}


def _line(rng: Generator) -> list[Record]:
    return [
        rounded_contact([x, 0.0, 0.0], [0.0, np.sin(a), np.cos(a)], friction=0.5, max_normal=30.0)
        for x, a in zip(rng.uniform(-0.05, 0.05, 4), rng.uniform(-np.pi, np.pi, 4), strict=True)
    ]


def _opposed(rng: Generator) -> list[Record]:
    half, mu = rng.uniform(0.01, 0.05), float(rng.uniform(0.2, 1.0))  # m, 1
    return [rounded_contact([0.0, -side * half, 0.0], [0.0, side, 0.0], friction=mu, max_normal=30.0) for side in (1.0, -1.0)]


def _flat(rng: Generator) -> list[Record]:
    angles = rng.uniform(-np.pi, np.pi, 6)
    return [
        rounded_contact([0.04 * np.cos(a), 0.03 * np.sin(a), 0.0], [-np.cos(a), -np.sin(a), 0.0], model="frictionless")
        for a in angles
    ]


def _duplicated(rng: Generator) -> list[Record]:
    return [record for record in random_contacts(rng, 3) for _ in range(2)]


def _coincident(rng: Generator) -> list[Record]:
    return [{**record, "position": [0.02, -0.01, 0.03]} for record in random_contacts(rng, 4)]


def _scales() -> Iterator[Record]:
    """Yield grasps with forces of 1e-4 to 1e6 N, radii of 1e-4 to 1e2 m, long and short levers, and a shifted origin."""
    for i in range(60):
        rng = np.random.default_rng([_SEED, 2, i])
        force = float(10 ** rng.uniform(-4, 6))  # N
        radius = float(10 ** rng.uniform(-4, 2))  # m
        lever = radius * float(10 ** rng.uniform(-2, 2))  # m/rad
        away = radius * float(10 ** rng.uniform(-1, 3)) * rng.normal(size=3)  # m
        records = random_contacts(rng, int(rng.integers(3, 7)), radius=radius, max_normal=100 * force)
        shifted = [
            rounded_contact(
                np.add(one["position"], away), one["normal"], friction=one["friction"], max_normal=one["max_normal"]
            )
            for one in records
        ]
        f = interior_forces(rng, contact_set(shifted), share=0.6, mean=force)
        hand = random_hand(rng, shifted, f, lever=lever, random_weights=True) if i % 3 else None
        source = (
            f"Seeded: mean force {force:.1e} N, object radius {radius:.1e} m, levers {lever:.1e} m, origin O off the centre."
        )
        objective = "torque" if i % 3 else "force"
        yield problem_record(
            f"hard/scales-{i + 1:02}", source, shifted, supplied_wrench(shifted, f), hand=hand, objective=objective
        )


def _slippery() -> Iterator[Record]:
    """Yield problems with μ of 1e-2 to 1e-6, at all contacts or at all but two."""
    for k, mu in enumerate((1e-2, 1e-3, 1e-4, 1e-5, 1e-6)):
        for i in range(8):
            rng = np.random.default_rng([_SEED, 3, k, i])
            records = random_contacts(rng, int(rng.integers(6, 10)), friction_range=(mu, 1.01 * mu))
            if i % 2:
                records = records[:-2] + random_contacts(rng, 2)
            f = interior_forces(rng, contact_set(records), share=0.6)
            source = f"Seeded contacts with μ about {mu:.0e}{', two of them with μ from 0.2 to 1' if i % 2 else ''}."
            yield problem_record(
                f"hard/slippery-{mu:.0e}-{i + 1}", source, records, supplied_wrench(records, f), objective="force"
            )


def _idle() -> Iterator[Record]:
    """Yield loads that three contacts carry from below, while the optimal force of the others is zero."""
    for i in range(40):
        rng = np.random.default_rng([_SEED, 4, i])
        angles = 2 * np.pi * (np.arange(3) / 3 + rng.uniform(0, 0.05, 3))
        tilt = rng.uniform(0.2, 0.6)  # rad, from the downward vertical
        below = [np.array([np.sin(tilt) * np.cos(a), np.sin(tilt) * np.sin(a), -np.cos(tilt)]) for a in angles]
        above = [np.array([x, y, 1.0]) / np.hypot(1.0, np.hypot(x, y)) for x, y in rng.uniform(-0.2, 0.2, (2 + i % 4, 2))]
        records = [rounded_contact(0.04 * d, -d, friction=0.9, max_normal=50.0) for d in (*below, *above)]
        w = [0.0, 0.0, float(rng.uniform(1, 10)), 0.0, 0.0, 0.0]
        objective = ("force", "sum_normal", "max_normal", "force")[i % 4]
        source = "Three fingertips below a ball carry its weight; the optimal force of those above it is zero."
        yield problem_record(f"hard/idle-{i + 1:02}", source, records, w, objective=objective)
