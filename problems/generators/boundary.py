"""Problems with a known distance to infeasibility: multipliers are drawn first, and the load is computed from them.

Draw y, and λ ≥ 0 for some joints. Contact i then has the weight c_i = (Gᵀ y − J λ)_i. Over its friction cone with f_n ≤ N,
c_iᵀ f_i is largest at

    f_i = N (μ c_t/‖c_t‖, 1),    with the value N (c_n + μ‖c_t‖), if this value is positive, and at f_i = 0 otherwise.

Set w* = G f, and set the limit of each joint with λ_j > 0 to its torque under f. No force within the limits has a larger
yᵀ G f, so w* is on the boundary of the feasible loads. The multipliers y, λ and ν_i = max(0, c_n + μ‖c_t‖) prove it. f = 0 is
within all limits. Therefore (1 − ε) w* is feasible with the force (1 − ε) f, and (1 + ε) w* is infeasible.

(1 − ε) w* need not be in the interior of the feasible loads: with two loaded contacts, all multiples of w* can be on the
boundary of the wrenches that the cones supply. Such cases have a proof in ``expected.no_interior`` (`no_interior`).
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
# Below 1e-6, some forces miss the load by less than the certificate's tolerance of 1e-8: both verdicts would be correct.
OUTSIDE_MARGINS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 3e-5, 3e-6)
_MAX_NORMAL = 20.0  # N, the largest normal force
_LEVER = 0.05  # m/rad
_SOURCE = "Seeded multipliers prove that w* is on the boundary of the feasible loads: (1 − ε) w* is feasible, (1 + ε) w* is not"


@dataclass(frozen=True, eq=False, slots=True)
class BoundaryLoad:
    """A load on the boundary of feasible loads, with its proof.

    Args:
        contacts: records of the contacts.
        hand: record of the actuation; None without torque limits.
        w: (6,) the load, N and N·m.
        proof: record of the multipliers.
    """

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
    """Yield (name, load, ε): loads for each margin, in order, without and with a hand.

    A draw is skipped if a torque limit is below the bias torque, because f = 0 would be infeasible. It is also skipped if fewer
    than two contacts have a non-zero force, because the load would be almost zero.

    Args:
        seed: seed of the random source.
        each: number of loads for each margin, without and with a hand.
        margins: values of ε.
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
    """Yield problems just inside the boundary, or just outside it with their proof."""
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
