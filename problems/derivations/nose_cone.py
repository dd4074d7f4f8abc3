"""Contacts on the inside of a paraboloid: not symmetric, with idle contacts, and with a friction threshold for feasibility.

The problem is the grasping example of Lobo, Vandenberghe, Boyd and Lebret (1998). Contacts j = 1…n are at

    p = (0.3 + cos 2πj/n, sin 2πj/n, p_x² + p_y²),    with inward normals along (−2p_x, −2p_y, 1),

with μ = 0.3, and supply 1 N upwards. The answers have no closed form. Each is computed by two independent methods that agree:
an interior-point method for the cones, and linear or quadratic programs with cutting planes, added until no cut is violated.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from graspforce.contact.contact import Contact
from graspforce.problems.derivations.records import (
    Record,
    case_record,
    contact_record,
    expected_infeasibility,
    expected_optimum,
)

MU = 0.3
SUPPORT = (0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
AGREED = 1e-7  # relative: the two methods agree to 1e-8, and the numbers below have nine digits
NEAR_THRESHOLD = 1e-6  # relative: less accurate, because the feasible set is almost a single point

FORCE = {5: 0.329442670, 6: 0.265796051}  # ½‖f‖²
MAX_NORMAL = {5: 0.491088964, 6: 0.386307740}
SUM_NORMAL = {5: 1.473970218, 6: 1.363783067}
MARGIN = {5: 0.0245859665, 6: 0.0278041711}  # with normal forces up to MAX_NORMAL_LIMIT
MAX_NORMAL_LIMIT = 0.6  # N
PYRAMIDS = {
    ("inner", 4): 0.340750046,
    ("inner", 8): 0.346167557,
    ("inner", 16): 0.330732746,
    ("outer", 4): 0.240269871,
    ("outer", 8): 0.317901519,
    ("outer", 16): 0.323727727,
}
THRESHOLD = {5: 0.21559763787, 6: 0.09335676843}  # smallest feasible μ, by bisection with the second method
ABOVE_THRESHOLD = {5: (0.21562, 0.55559679), 6: (0.093366, 0.81366582)}  # μ just above the threshold, and the optimal ½‖f‖²
BELOW_THRESHOLD = {  # μ just below the threshold, and the wrench direction y that proves infeasibility
    5: (0.21558, (-1.059682, 0.0, 1e-5, 0.0, 0.707291, 0.0)),
    6: (0.093347, (-7.400697, 0.0, 1e-5, 0.0, 4.20756, 0.0)),
}
LIMIT = 0.4  # N·m: limit of each joint; its torque is 1 m times a normal force
LIMIT_PROOF = {
    "y": [-1.87282, 0.0, 1.0, 0.0, 1.36325, 0.0],
    "torque_upper": [0.23612, 0.95491, 0.95491, 0.23612, 0.06436],
}
ARM_LIMIT = 0.3  # N·m: limit of each joint of a three-joint finger
ARM_TORQUE = 0.225281073  # optimal ½‖tau‖² with those fingers
_AGREE = "Two independent methods agree on the optimum."


def cases() -> Iterator[Record]:
    """Yield the records of the collection."""
    for n in (5, 6):
        yield _nose_cone(f"{n}-force", _AGREE, n, expected_optimum(FORCE[n], tolerance=AGREED), "force")
        yield _nose_cone(
            f"{n}-max-normal",
            f"{_AGREE} Normal forces below the largest are not unique.",
            n,
            expected_optimum(MAX_NORMAL[n], tolerance=AGREED),
            "max_normal",
        )
        yield _nose_cone(f"{n}-sum-normal", _AGREE, n, expected_optimum(SUM_NORMAL[n], tolerance=AGREED), "sum_normal")
        derivation = f"Normal forces are limited to {MAX_NORMAL_LIMIT:g} N. {_AGREE}"
        yield _nose_cone(
            f"{n}-margin", derivation, n, expected_optimum(MARGIN[n], tolerance=AGREED), "margin", max_normal=MAX_NORMAL_LIMIT
        )
        yield from _threshold(n)
    for (side, facets), cost in PYRAMIDS.items():
        derivation = f"t₁ = n × e_x. {_AGREE} Pyramids are not nested: the optimum depends on their orientation, too."
        yield _nose_cone(
            f"5-{side}-{facets}", derivation, 5, expected_optimum(cost, tolerance=AGREED), "force", cone=(side, facets)
        )
    yield from _with_joints()


def _threshold(n: int) -> Iterator[Record]:
    """Yield a case just above and a case just below the smallest feasible μ."""
    mu, cost = ABOVE_THRESHOLD[n]
    derivation = f"The smallest feasible μ is {THRESHOLD[n]:.10g}; here μ is just above it. {_AGREE}"
    yield _nose_cone(f"{n}-friction-above", derivation, n, expected_optimum(cost, tolerance=NEAR_THRESHOLD), "force", mu=mu)
    mu, y = BELOW_THRESHOLD[n]
    derivation = f"The smallest feasible μ is {THRESHOLD[n]:.10g}; here μ is just below it."
    known = expected_infeasibility({"y": list(y)}, NEAR_THRESHOLD, friction_factor=THRESHOLD[n] / mu)
    yield _nose_cone(f"{n}-friction-below", derivation, n, known, "force", mu=mu)


def _with_joints() -> Iterator[Record]:
    contacts = _contacts(5, MU)
    weight, rho = 2.0, 0.5
    hand: Record = {"jacobian": np.eye(15).tolist(), "torque_weight": [weight] * 15}
    derivation = "With J = 1, the objective ½‖tau‖²_W + ½ρ‖f‖² is W + ρ times that of nose-cone/5-force."
    known = expected_optimum((weight + rho) * FORCE[5], tolerance=AGREED)
    yield _nose_cone("5-torque", derivation, 5, known, {"type": "torque", "force_weight": rho}, hand=hand)

    normals = np.zeros((15, 5))
    normals[np.arange(5) * 3 + 2, np.arange(5)] = 1.0
    hand = {"jacobian": normals.tolist(), "torque_upper": [LIMIT] * 5}
    derivation = f"tau = f_n · 1 m. The largest normal force is at least {MAX_NORMAL[5]:.9g} N (nose-cone/5-max-normal)."
    known = expected_infeasibility(LIMIT_PROOF, AGREED, torque_factor=MAX_NORMAL[5] / LIMIT)
    yield _nose_cone("5-torque-limit", derivation, 5, known, "torque", hand=hand)

    hand = {
        "jacobian": _arms(contacts).tolist(),
        "bias_torque": [0.1, -0.2, 0.05] * 5,
        "torque_lower": [-ARM_LIMIT] * 15,
        "torque_upper": [ARM_LIMIT] * 15,
    }
    derivation = (
        "Each finger has three joints with axes along x, y and z through (1.6 p_x, 1.6 p_y, p_z − 1). Two joints are at a "
        f"torque limit. {_AGREE}"
    )
    yield _nose_cone("5-torque-arms", derivation, 5, expected_optimum(ARM_TORQUE, tolerance=AGREED), "torque", hand=hand)


def _arms(contacts: list[Record]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the (15, 15) Jacobian from joint rates to the velocities of the contacts, in the contact frames."""
    jacobian = np.zeros((15, 15))
    for i, record in enumerate(contacts):
        frame = Contact.from_dict(record)
        x, y, z = frame.position
        lever = frame.position - np.array([1.6 * x, 1.6 * y, z - 1.0])  # m
        jacobian[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = frame.R_OC.T @ np.cross(np.eye(3), lever).T
    return jacobian


def _contacts(n: int, mu: float, **more: Any) -> list[Record]:
    contacts = []
    for j in range(1, n + 1):
        x, y = 0.3 + math.cos(2 * math.pi * j / n), math.sin(2 * math.pi * j / n)
        contacts.append(contact_record((x, y, x * x + y * y), (-2 * x, -2 * y, 1.0), friction=mu, **more))
    return contacts


def _nose_cone(
    name: str,
    derivation: str,
    n: int,
    expected: Record,
    objective: str | Record,
    *,
    mu: float = MU,
    cone: tuple[str, int] | None = None,
    hand: Record | None = None,
    **more: Any,
) -> Record:
    source = f"Nose cone with {n} contacts (Lobo et al. 1998). {derivation}"
    contacts = _contacts(n, mu, **more)
    return case_record(f"nose-cone/{name}", source, contacts, SUPPORT, expected, objective=objective, cone=cone, hand=hand)
