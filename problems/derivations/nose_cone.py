"""Contacts on the inside of a paraboloid: no symmetry helps, some contacts end up idle, and friction decides whether it holds.

Lobo, Vandenberghe, Boyd and Lebret (1998), Applications of second-order cone programming, section on grasping. Contacts
j = 1…n at p = (0.3 + cos 2πj/n, sin 2πj/n, p_x² + p_y²), inward normal along (−2p_x, −2p_y, 1), μ = 0.3, one newton upwards.
Numbers without a closed form are those on which two methods agree that share nothing: an interior-point method for the cones,
and linear or quadratic programs with cuts added from outside until nothing is cut off.
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
AGREED = 1e-7  # relative: two methods agree to 1e-8 and the numbers below have nine digits
NEAR_THRESHOLD = 1e-6  # relative: less is known where the feasible set is all but a point

FORCE = {5: 0.329442670, 6: 0.265796051}  # ½‖f‖²
MAX_NORMAL = {5: 0.491088964, 6: 0.386307740}
SUM_NORMAL = {5: 1.473970218, 6: 1.363783067}
MARGIN = {5: 0.0245859665, 6: 0.0278041711}  # with normal forces up to MOST
MAX_NORMAL_LIMIT = 0.6  # N
PYRAMIDS = {
    ("inner", 4): 0.340750046,
    ("inner", 8): 0.346167557,
    ("inner", 16): 0.330732746,
    ("outer", 4): 0.240269871,
    ("outer", 8): 0.317901519,
    ("outer", 16): 0.323727727,
}
THRESHOLD = {5: 0.21559763787, 6: 0.09335676843}  # the least μ that holds, by bisection with the second method
ABOVE_THRESHOLD = {5: (0.21562, 0.55559679), 6: (0.093366, 0.81366582)}  # a μ just above, and ½‖f‖² there
BELOW_THRESHOLD = {  # a μ just below, and the wrench direction that proves it
    5: (0.21558, (-1.059682, 0.0, 1e-5, 0.0, 0.707291, 0.0)),
    6: (0.093347, (-7.400697, 0.0, 1e-5, 0.0, 4.20756, 0.0)),
}
LIMIT = 0.4  # N·m on each joint whose torque is 1 m times a normal force
LIMIT_PROOF = {
    "y": [-1.87282, 0.0, 1.0, 0.0, 1.36325, 0.0],
    "torque_upper": [0.23612, 0.95491, 0.95491, 0.23612, 0.06436],
}
ARM_LIMIT = 0.3  # N·m on each joint of a three-joint finger
ARM_TORQUE = 0.225281073  # ½‖tau‖² with those fingers
_AGREE = "Two methods that share nothing agree on the optimum."


def cases() -> Iterator[Record]:
    """Yield the records of the collection."""
    for n in (5, 6):
        yield _nose_cone(f"{n}-force", _AGREE, n, expected_optimum(FORCE[n], tolerance=AGREED), "force")
        yield _nose_cone(
            f"{n}-max-normal",
            f"{_AGREE} Other normal forces below the largest are as good.",
            n,
            expected_optimum(MAX_NORMAL[n], tolerance=AGREED),
            "max_normal",
        )
        yield _nose_cone(f"{n}-sum-normal", _AGREE, n, expected_optimum(SUM_NORMAL[n], tolerance=AGREED), "sum_normal")
        derivation = f"Normal forces up to {MAX_NORMAL_LIMIT:g} N. {_AGREE}"
        yield _nose_cone(
            f"{n}-margin", derivation, n, expected_optimum(MARGIN[n], tolerance=AGREED), "margin", max_normal=MAX_NORMAL_LIMIT
        )
        yield from _threshold(n)
    for (side, facets), cost in PYRAMIDS.items():
        derivation = f"t₁ = n × e_x. {_AGREE} Pyramids are not nested: where the facets lie matters as much as their number."
        yield _nose_cone(
            f"5-{side}-{facets}", derivation, 5, expected_optimum(cost, tolerance=AGREED), "force", cone=(side, facets)
        )
    yield from _with_joints()


def _threshold(n: int) -> Iterator[Record]:
    """Just above and just below the least μ that holds."""
    mu, cost = ABOVE_THRESHOLD[n]
    derivation = f"The least μ that holds is {THRESHOLD[n]:.10g}; this is just above it. {_AGREE}"
    yield _nose_cone(f"{n}-friction-above", derivation, n, expected_optimum(cost, tolerance=NEAR_THRESHOLD), "force", mu=mu)
    mu, y = BELOW_THRESHOLD[n]
    derivation = f"The least μ that holds is {THRESHOLD[n]:.10g}; this is just below it."
    known = expected_infeasibility({"y": list(y)}, NEAR_THRESHOLD, friction_factor=THRESHOLD[n] / mu)
    yield _nose_cone(f"{n}-friction-below", derivation, n, known, "force", mu=mu)


def _with_joints() -> Iterator[Record]:
    contacts = _contacts(5, MU)
    weight, rho = 2.0, 0.5
    hand: Record = {"jacobian": np.eye(15).tolist(), "torque_weight": [weight] * 15}
    derivation = "J = 1 makes ½‖tau‖²_W + ½ρ‖f‖² the cost of 5-force times W + ρ."
    known = expected_optimum((weight + rho) * FORCE[5], tolerance=AGREED)
    yield _nose_cone("5-torque", derivation, 5, known, {"type": "torque", "force_weight": rho}, hand=hand)

    normals = np.zeros((15, 5))
    normals[np.arange(5) * 3 + 2, np.arange(5)] = 1.0
    hand = {"jacobian": normals.tolist(), "torque_upper": [LIMIT] * 5}
    derivation = f"tau = f_n · 1 m, and no normal forces below {MAX_NORMAL[5]:.9g} N hold (5-max-normal)."
    known = expected_infeasibility(LIMIT_PROOF, AGREED, torque_factor=MAX_NORMAL[5] / LIMIT)
    yield _nose_cone("5-torque-limit", derivation, 5, known, "torque", hand=hand)

    hand = {
        "jacobian": _arms(contacts).tolist(),
        "bias_torque": [0.1, -0.2, 0.05] * 5,
        "torque_lower": [-ARM_LIMIT] * 15,
        "torque_upper": [ARM_LIMIT] * 15,
    }
    derivation = (
        "Every finger has three joints whose axes x, y, z meet at (1.6 p_x, 1.6 p_y, p_z − 1); a limit on two of them is "
        f"reached. {_AGREE}"
    )
    yield _nose_cone("5-torque-arms", derivation, 5, expected_optimum(ARM_TORQUE, tolerance=AGREED), "torque", hand=hand)


def _arms(contacts: list[Record]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """(15, 15): each finger's joint rates to its contact's velocity, in the contact frame."""
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
