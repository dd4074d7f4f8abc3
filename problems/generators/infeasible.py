"""Infeasible problems of every kind; those from `boundary` include their proof."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from graspforce.problems.derivations.records import Record, expected_infeasibility
from graspforce.problems.generators import boundary
from graspforce.problems.generators.random_grasps import (
    Generator,
    interior_forces,
    random_contacts,
    random_directions,
    random_hand,
)
from graspforce.problems.generators.records import contact_set, problem_record, round_numbers, rounded_contact, supplied_wrench

_SEED = 23


def cases() -> Iterator[Record]:
    """Yield the records of the collection."""
    yield from boundary.near_boundary_cases("infeasible", False, _SEED, 6)
    for i in range(25):
        yield _smooth_ball(np.random.default_rng([_SEED, 1, i]), i + 1)
        yield _pulling_load(np.random.default_rng([_SEED, 2, i]), i + 1)
        yield _weak_motors(np.random.default_rng([_SEED, 3, i]), i + 1)
        yield _twisting_load(np.random.default_rng([_SEED, 4, i]), i + 1)
        yield _unloaded_motor(np.random.default_rng([_SEED, 5, i]), i + 1)


def _smooth_ball(rng: Generator, i: int) -> Record:
    """Return frictionless contacts on a ball, which supply no moment about its centre: Gᵀ (0, m) = 0 to rounding."""
    n = random_directions(rng, int(rng.integers(3, 9)))
    records = [rounded_contact(-0.04 * one, one, model="frictionless", max_normal=20.0) for one in n]
    w = [*round_numbers(rng.normal(size=3)), *round_numbers(rng.normal(size=3) * 0.1)]
    return problem_record(
        f"infeasible/ball-{i:02}",
        "Frictionless contacts on a ball supply no moment about its centre, and the load needs one.",
        records,
        w,
        objective="force",
    )


def _pulling_load(rng: Generator, i: int) -> Record:
    """Return contacts that push up, with a load that needs a force downwards, beyond the reach of friction."""
    records = []
    for n in random_directions(rng, int(rng.integers(3, 7))):
        up = np.array([n[0], n[1], 2.0])
        records.append(rounded_contact(-0.04 * n, up, friction=0.3, max_normal=50.0))
    w = [0.0, 0.0, -float(rng.uniform(0.1, 5.0)), 0.0, 0.0, 0.0]
    # normals are within 27° of vertical and the friction angle is 17°: yᵀ G f ≤ 0 for y = −e_z and every f in the cones
    source = "The contacts can only push up, and the load needs a force downwards."
    return problem_record(
        f"infeasible/pulled-{i:02}",
        source,
        records,
        w,
        objective="force",
        expected=expected_infeasibility({"y": [0, 0, -1, 0, 0, 0]}),
    )


def _weak_motors(rng: Generator, i: int) -> Record:
    """Return a load that needs several times the torque limits."""
    records = random_contacts(rng, int(rng.integers(3, 6)))
    f = interior_forces(rng, contact_set(records), share=0.6)
    hand = random_hand(rng, records, f)
    w = 20.0 * supplied_wrench(records, f)
    return problem_record(
        f"infeasible/motors-{i:02}",
        "Twenty times a load for which the torque limits are chosen.",
        records,
        w,
        hand=hand,
        objective="torque",
    )


def _twisting_load(rng: Generator, i: int) -> Record:
    """Return two opposed soft contacts, with a moment above 2 γ N about the line between them."""
    gamma, most = float(rng.uniform(0.002, 0.01)), 20.0  # m, N
    soft = {"model": "soft", "friction": 0.5, "torsional_friction": gamma, "max_normal": most}
    records = [rounded_contact([0.0, -side * 0.02, 0.0], [0.0, side, 0.0], **soft) for side in (1.0, -1.0)]
    gamma = records[0]["torsional_friction"]
    moment = 2.0 * gamma * most * float(rng.uniform(1.001, 2.0))  # N·m
    proof = {"y": [0, 0, 0, 0, 1, 0], "normal_upper": [gamma, gamma]}
    source = "Two opposed soft contacts; the moment about the line between them exceeds 2 γ times the largest normal force."
    w = [0.0, 0.0, 0.0, 0.0, moment, 0.0]
    return problem_record(
        f"infeasible/twisted-{i:02}", source, records, w, objective="force", expected=expected_infeasibility(proof)
    )


def _unloaded_motor(rng: Generator, i: int) -> Record:
    """Return a problem with a joint that no contact loads, whose bias torque exceeds its limit."""
    records = random_contacts(rng, 3)
    f = interior_forces(rng, contact_set(records), share=0.6)
    hand = random_hand(rng, records, f)
    hand["jacobian"] = [[*row, 0.0] for row in hand["jacobian"]]
    bias, limit = float(rng.uniform(0.5, 2.0)), 0.4  # N·m
    hand["bias_torque"] = [*hand["bias_torque"], round_numbers(bias)]
    hand["torque_lower"], hand["torque_upper"] = [*hand["torque_lower"], -limit], [*hand["torque_upper"], limit]
    proof = {"torque_upper": [0.0] * (len(hand["bias_torque"]) - 1) + [1.0]}
    source = "The bias torque of a joint that no contact loads exceeds its torque limit."
    w = supplied_wrench(records, f)
    expected = expected_infeasibility(proof)
    return problem_record(f"infeasible/motor-{i:02}", source, records, w, hand=hand, objective="torque", expected=expected)
