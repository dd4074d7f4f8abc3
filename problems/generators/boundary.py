"""Problems whose distance to infeasibility is known, because a multiplier is drawn first and the load after it.

Draw y, and λ ≥ 0 for some joints. What they weigh of contact i's force is c_i = (Gᵀ y − J λ)_i, and over the friction cone with
f_n ≤ N it is greatest at

    f_i = N (μ c_t/‖c_t‖, 1)    with the value N (c_n + μ‖c_t‖),    where that is positive, and at f_i = 0 elsewhere.

With w* = G f and the limit of every joint with λ_j > 0 set to the torque of f, no force within the limits has a larger yᵀG f:
w* is on the edge of what can be held, y, λ and ν_i = c_n + μ‖c_t‖ prove it, and f = 0 is inside. So (1 − ε) w* can be held, by
(1 − ε) f and with next to nothing to spare, and (1 + ε) w* cannot.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from graspforce.contact.matrices import grasp_matrix
from graspforce.core.arrays import Array
from graspforce.problems.derivations.records import Record, expected_infeasibility
from graspforce.problems.generators.random_grasps import Generator, random_contacts
from graspforce.problems.generators.records import contact_set, problem_record, round_numbers

INSIDE_MARGINS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
# Outside by less than 1e-6, forces that miss by less than a certificate's 1e-8 hold the load: both answers would be right.
OUTSIDE_MARGINS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 3e-5, 3e-6)
_MAX_NORMAL = 20.0  # N, the largest normal force
_LEVER = 0.05  # m/rad
_SOURCE = "A multiplier drawn first, and on the edge that it proves a load: (1 − ε) of it can be held, (1 + ε) of it cannot"


@dataclass(frozen=True, eq=False, slots=True)
class BoundaryLoad:
    """Contacts, a hand or none, the load on the edge, and the multipliers that prove it one."""

    contacts: list[Record]
    hand: Record | None
    w: Array
    proof: Record


def draw_boundary_load(rng: Generator, with_hand: bool) -> BoundaryLoad:
    """Return a grasp of three to six contacts, and a load on the boundary of feasible loads."""
    count = int(rng.integers(3, 7))
    records = random_contacts(rng, count, max_normal=_MAX_NORMAL)
    contacts = contact_set(records)
    G = grasp_matrix(contacts)
    y = rng.normal(size=6) / [1, 1, 1, 0.05, 0.05, 0.05]
    c = G.T @ y
    J, joint_multipliers = np.zeros((contacts.size, 3 * count)), np.zeros(3 * count)
    if with_hand:
        for i in range(count):
            J[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = rng.normal(size=(3, 3)) * _LEVER
        J = np.array(round_numbers(J), dtype=np.float64)
        limited_joints = rng.random(3 * count) < 0.2
        joint_multipliers[limited_joints] = np.abs(rng.normal(size=int(limited_joints.sum()))) * 0.3 * np.abs(c).max() / _LEVER
        c = c - J @ joint_multipliers
    c = c.reshape(-1, 3)
    tangential = np.linalg.norm(c[:, :2], axis=1)
    value = c[:, 2] + contacts.mu * tangential
    f = np.zeros((count, 3))
    loaded = value > 0
    f[loaded, 2] = _MAX_NORMAL
    f[loaded, :2] = (_MAX_NORMAL * contacts.mu / tangential)[loaded, None] * c[loaded, :2]
    hand = None
    if with_hand:
        tau = J.T @ f.ravel()  # N·m
        tau_u = np.array(round_numbers(rng.normal(size=len(tau)) * 0.01), dtype=np.float64)  # N·m
        upper = tau_u + np.where(joint_multipliers > 0, tau, 1.5 * np.abs(tau) + 0.1)  # N·m
        lower = tau_u - 1.5 * np.abs(tau) - 0.1  # N·m
        hand = {"jacobian": round_numbers(J), "bias_torque": tau_u.tolist()}
        hand |= {"torque_lower": lower.tolist(), "torque_upper": upper.tolist()}
    proof = {"y": y, "normal_upper": np.maximum(value, 0.0), "torque_upper": joint_multipliers}
    return BoundaryLoad(records, hand, G @ f.ravel(), {name: array.tolist() for name, array in proof.items() if array.any()})


def boundary_loads(seed: int, each: int, margins: tuple[float, ...]) -> Iterator[tuple[str, BoundaryLoad, float]]:
    """(name, edge, ε): some for every margin in their order, without a hand and with one whose zero torques are allowed.

    Draws are passed over whose joint limit would be below the bias torque, which would forbid f = 0, and those whose y weighs
    fewer than two contacts, which leave next to no load.
    """
    rng = np.random.default_rng(seed)
    for margin in margins:
        for with_hand in (False, True):
            for i in range(each):
                load_case = draw_boundary_load(rng, with_hand)
                while not _is_usable(load_case):
                    load_case = draw_boundary_load(rng, with_hand)
                yield f"{margin:.0e}-{'hand' if with_hand else 'object'}-{i + 1}", load_case, margin


def _is_usable(load_case: BoundaryLoad) -> bool:
    hand = load_case.hand
    inside = hand is None or bool((np.array(hand["torque_upper"]) > np.array(hand["bias_torque"])).all())
    return inside and int(np.count_nonzero(load_case.proof.get("normal_upper", ()))) >= 2


def near_boundary_cases(collection: str, inside: bool, seed: int, each: int) -> Iterator[Record]:
    """Yield problems just inside or just outside the boundary, the latter with their proof."""
    for name, load_case, margin in boundary_loads(seed, each, INSIDE_MARGINS if inside else OUTSIDE_MARGINS):
        factor = 1.0 - margin if inside else 1.0 + margin
        words = f"{_SOURCE}; here ε = {margin:.0e}."
        expected = None if inside else expected_infeasibility(load_case.proof)
        yield problem_record(
            f"{collection}/near-{name}",
            words,
            load_case.contacts,
            factor * load_case.w,
            hand=load_case.hand,
            objective="force" if load_case.hand is None else "torque",
            expected=expected,
        )
