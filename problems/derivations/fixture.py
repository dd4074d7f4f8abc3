"""Frictionless locators and clamps (form closure), and a squeezed block on a table.

The block fills 0 ≤ x ≤ 120 mm, 0 ≤ y ≤ 80 mm, 0 ≤ z ≤ 40 mm. It rests in a 3-2-1 fixture: three locators below, two at the side
y = 0, and one at the side x = 0. A clamp presses along (−1, −1, −2)/√6 at (70, 60, 40) mm. For a clamp force c = √6 k and the
weight W at the centre, statics determines the locator forces:

    f_x = k,    f_y = (2k/3, k/3),    f_z = ((k + W)/4, (k + W)/4, (3k + W)/2)

All are positive, so the fixture has form closure. Prattichizzo and Trinkle (2008) test form closure by: maximise d subject to
G_n f = 0, f ≥ d.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from graspforce.problems.derivations.records import (
    Record,
    case_record,
    contact_record,
    expected_infeasibility,
    expected_optimum,
)

WEIGHT = 10.0  # N
CUTTING_FORCE = 50.0  # N: force of a tool along +x, in line with the x locator
_LOCATORS = (
    ((0.0, 0.04, 0.02), (1.0, 0.0, 0.0)),
    ((0.03, 0.0, 0.02), (0.0, 1.0, 0.0)),
    ((0.09, 0.0, 0.02), (0.0, 1.0, 0.0)),
    ((0.02, 0.02, 0.0), (0.0, 0.0, 1.0)),
    ((0.1, 0.02, 0.0), (0.0, 0.0, 1.0)),
    ((0.06, 0.06, 0.0), (0.0, 0.0, 1.0)),
)
_CLAMP = ((0.07, 0.06, 0.04), (-1.0, -1.0, -2.0))
_CENTRE = (0.06, 0.04, 0.02)  # m
_BLOCK = "A block in a frictionless 3-2-1 fixture."


def cases() -> Iterator[Record]:
    """Yield the records of the collection."""
    clamp_force = 200.0  # N
    yield _fixture(
        "clamped",
        "At the clamp's lower limit c = √6 k, the locator forces are k, 2k/3, k/3, (k + W)/4 twice, and (3k + W)/2.",
        expected_optimum(clamp_force + 4 * clamp_force / math.sqrt(6) + WEIGHT, _forces(clamp_force / math.sqrt(6), 0.0)),
        _wrench(0.0),
        clamp={"min_normal": clamp_force},
    )
    yield _fixture(
        "cutting",
        "The tool force F along +x leaves k − F at the x locator, so the smallest clamp force is √6 F.",
        expected_optimum(math.sqrt(6) * CUTTING_FORCE + 3 * CUTTING_FORCE + WEIGHT, _forces(CUTTING_FORCE, CUTTING_FORCE)),
        _wrench(CUTTING_FORCE),
        clamp={},
    )
    most = 100.0  # N
    yield _fixture(
        "clamp-limit",
        "The tool force needs a clamp force of √6 F = 122.5 N. Only the clamp pushes along −x, with at most 100/√6 N.",
        expected_infeasibility({"y": [-1, 0, 0, 0, 0, 0], "normal_upper": [0, 0, 0, 0, 0, 0, 1 / math.sqrt(6)]}),
        _wrench(CUTTING_FORCE),
        clamp={"max_normal": most},
    )
    yield _fixture(
        "unclamped",
        "The tool pulls the block off the x locator, and no contact pushes along −x.",
        expected_infeasibility({"y": [-1, 0, 0, 0, 0, 0]}),
        _wrench(CUTTING_FORCE),
        clamp=None,
    )
    yield from _cube()
    yield _table()


def _forces(k: float, pull: float) -> list[float]:
    """Return the normal forces in contact order, the clamp last, N."""
    quarter = (k + WEIGHT) / 4
    return [k - pull, 2 * k / 3, k / 3, quarter, quarter, (3 * k + WEIGHT) / 2, math.sqrt(6) * k]


def _wrench(pull: float) -> tuple[float, ...]:
    """Return the wrench that balances the weight at the centre and a tool force along x through (0, 40, 20) mm."""
    x, y, z = _CENTRE
    return (-pull, 0.0, WEIGHT, y * WEIGHT, -x * WEIGHT - z * pull, y * pull)


def _fixture(name: str, derivation: str, expected: Record, wrench: tuple[float, ...], clamp: dict[str, Any] | None) -> Record:
    contacts = [contact_record(p, n, model="frictionless") for p, n in _LOCATORS]
    if clamp is not None:
        contacts.append(contact_record(*_CLAMP, model="frictionless", **clamp))
    return case_record(f"fixture/{name}", f"{_BLOCK} {derivation}", contacts, wrench, expected, objective="sum_normal")


def _cube() -> Iterator[Record]:
    """Yield cases of a cube with 1 m edges between opposite frictionless contacts of at least 1 N."""
    offset, moment = 0.3, 1.2  # m, N·m
    contacts, normals = [], []
    for axis in range(3):
        for side in (1.0, -1.0):  # sign of the normal; the contact is on the opposite face
            for s in (1.0, -1.0):
                p, n = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
                p[axis], p[(axis + 1) % 3], n[axis] = -0.5 * side, s * offset, side
                contacts.append(contact_record(p, n, model="frictionless", min_normal=1.0))
                helps = axis == 0 and s == -side  # −y f_x > 0
                normals.append(1.0 + moment / (2 * offset) if helps else 1.0)
    derivation = "A cube between twelve frictionless contacts, two on each face, of at least 1 N each. Opposite pairs balance."
    turn = (0.0, 0.0, 0.0, 0.0, 0.0, moment)
    none = (0.0,) * 6
    yield case_record(
        "fixture/cube-closure", derivation, contacts, none, expected_optimum(12.0, [1.0] * 12), objective="sum_normal"
    )
    derivation += f" A force of 1 N makes at most {offset:g} N·m about z, so a moment M adds M/{offset:g} N to the sum."
    yield case_record(
        "fixture/cube-moment",
        derivation,
        contacts,
        turn,
        expected_optimum(12.0 + moment / offset, normals),
        objective="sum_normal",
    )
    six = []
    for axis in range(3):
        for side in (1.0, -1.0):
            p, n = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
            p[axis], n[axis] = -0.5 * side, side
            six.append(contact_record(p, n, model="frictionless", min_normal=1.0))
    derivation = "A cube between six frictionless contacts at its face centres. They supply no moment: Gᵀ e_mz = 0."
    yield case_record(
        "fixture/cube-six", derivation, six, turn, expected_infeasibility({"y": [0, 0, 0, 0, 0, 1]}), objective="sum_normal"
    )


def _table() -> Record:
    """Return a case with two contact models: a frictionless table below, and contacts with friction on two sides."""
    weight, mu = 8.0, 0.5
    t = weight / (3 + 1 / mu**2)  # N: friction force at each side
    table, normal = weight - 2 * t, t / mu  # N
    contacts = [
        contact_record((0.0, 0.0, -0.03), (0.0, 0.0, 1.0), model="frictionless"),
        contact_record((-0.02, 0.0, 0.0), (1.0, 0.0, 0.0), friction=mu),
        contact_record((0.02, 0.0, 0.0), (-1.0, 0.0, 0.0), friction=mu),
    ]
    derivation = (
        "A block of weight W on a frictionless table, squeezed from two sides. By symmetry, each side carries t by friction "
        "with f_n = t/μ, and the table carries W − 2t. ½‖f‖² is smallest at t = W/(3 + 1/μ²)."
    )
    known = expected_optimum(0.5 * table**2 + t**2 * (1 + 1 / mu**2), [table, normal, normal])
    return case_record("fixture/table", derivation, contacts, (0, 0, weight, 0, 0, 0), known, objective="force")
