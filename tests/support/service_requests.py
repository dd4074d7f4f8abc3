"""Requests for the tests of the service: a pinch with a known solution, a distribute request, and invalid records."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from graspforce.contact.contact import Contact
from graspforce.hand.hand import Hand
from graspforce.service import DistributeRequest
from support import invalid_problems

MU, WEIGHT, HALF_WIDTH = 0.4, 1.7, 0.021  # –, N, m

PINCH: dict[str, Any] = {
    "schema": "graspforce/problem/1",
    "contacts": [
        {"position": [-HALF_WIDTH, 0.0, 0.0], "normal": [1, 0, 0], "friction": MU},
        {"position": [HALF_WIDTH, 0.0, 0.0], "normal": [-1, 0, 0], "friction": MU},
    ],
    "wrench": [0.0, 0.0, WEIGHT, 0.0, 0.0, 0.0],
}
"""Two fingers hold a weight: each carries half of it by friction, with f_n = WEIGHT/(2 MU)."""

PINCH_NORMAL = WEIGHT / (2.0 * MU)  # N
PINCH_OBJECTIVE = PINCH_NORMAL**2 + (WEIGHT / 2.0) ** 2  # N², ½‖f‖² of the two contacts


def pinch(**changes: Any) -> dict[str, Any]:
    """Return the pinch with changed fields."""
    return {**copy.deepcopy(PINCH), **changes}


def infeasible_pinch() -> dict[str, Any]:
    """Return the pinch with a normal force limit that is too small by a factor of 2.1."""
    record = pinch()
    for contact in record["contacts"]:
        contact["max_normal"] = PINCH_NORMAL / 2.1
    return record


# Names and records that are not force problems: those of `invalid_problems`, and some that only other programs send.
BAD_RECORDS: list[tuple[str, Any]] = [
    *((fault.name, record) for fault, record in invalid_problems.invalid_records()),
    ("a list", [1, 2]),
    ("a number", 7.5),
    ("null", None),
    ("empty", {}),
    ("a huge integer", pinch(wrench=[10**400, 0, 0, 0, 0, 0])),
    ("lists in a vector", pinch(wrench=[0, 0, 1, 0, [], {}])),
    ("deep lists", pinch(wrench=[[[[[[0.5]]]]]])),
    ("long text", pinch(schema="x" * 5000)),
    ("long name", pinch(**{"y" * 300: 1})),
    ("letters beyond ASCII", pinch(μ="größer")),
]


def distribute_request(hand: Hand, weight: float = 0.3) -> DistributeRequest:
    """Return the request for a hand at rest that holds a weight with all fingertips, with a rotated object frame."""
    q = hand.neutral
    R_HO = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix()
    tips = np.array([hand.tip_pose(q, finger.name)[0] for finger in hand.fingers])  # m, in H
    p_HO = tips.mean(axis=0)  # m
    outward = tips - p_HO
    outward[:, 2] = 0.0  # the normals are horizontal in H
    contacts = tuple(
        Contact(R_HO.T @ (tip - p_HO), R_HO.T @ -out, friction=0.7, max_normal=8.0)
        for tip, out in zip(tips, outward, strict=True)
    )
    w = np.concatenate([R_HO.T @ np.array([0.0, 0.0, weight]), np.zeros(3)])  # N, N·m, in O
    return DistributeRequest(q, contacts, tuple(finger.name for finger in hand.fingers), p_HO, R_HO, w)
