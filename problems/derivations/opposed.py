"""Two opposed contacts: the smallest grasp, with one redundant equilibrium equation.

The contacts are at (0, ∓2 m, 0), with normals (0, ±1, 0). Moment balance about x and z makes the tangential forces equal. Force
balance along y makes the normal forces equal. Point contacts here resist no moment about y.
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

MU = 0.1
LOAD = 10.0  # N, along −z on the object
GAMMA = 0.01  # m
SUPPORT = (0.0, 0.0, LOAD, 0.0, 0.0, 0.0)
FRICTION_FORCE = LOAD / 2  # N: friction force at each contact
NORMAL = FRICTION_FORCE / MU  # N
LEVER = 0.05  # m: each contact has one joint, with torque LEVER · f_n

_BORNE = f"Each contact carries {FRICTION_FORCE:g} N by friction, so its normal force N is at least {NORMAL:g} N."
_ONE_JOINT = f"Each contact has one joint, tau = tau_u + {LEVER:g} m · N. Equilibrium makes both N equal."


def cases() -> Iterator[Record]:
    """Yield the records of the collection."""
    yield _opposed(
        "force",
        f"{_BORNE} The smallest ½‖f‖² is {FRICTION_FORCE:g}² + {NORMAL:g}².",
        expected_optimum(FRICTION_FORCE**2 + NORMAL**2, [NORMAL] * 2),
    )
    yield _opposed("max-normal", f"{_BORNE} The largest ‖f‖ is then √2525 N.", expected_optimum(NORMAL, [NORMAL] * 2))
    yield _opposed("sum-normal", f"{_BORNE}", expected_optimum(2 * NORMAL, [NORMAL] * 2))
    most = 60.0  # N
    margin = MU * most - FRICTION_FORCE
    derivation = f"The normal forces are equal, so both reach the limit of {most:g} N. The friction reserve is s = "
    derivation += f"μ·{most:g} − {FRICTION_FORCE:g}."
    yield _opposed("margin", derivation, expected_optimum(margin, [most] * 2), max_normal=most)
    yield from _pyramids()
    yield from _with_joints()
    yield from _soft()
    least = 40.0  # N
    derivation = (
        f"{_BORNE} N is limited to {least:g} N. Proof: y = e_z with the multiplier μ of each limit gives "
        f"{LOAD:g} > 2·μ·{least:g}. Friction larger by a factor of {NORMAL / least:g} makes the problem feasible."
    )
    proof = {"y": [0, 0, 1, 0, 0, 0], "normal_upper": [MU, MU]}
    yield _opposed(
        "capped", derivation, expected_infeasibility(proof, friction_factor=NORMAL / least), objective="force", max_normal=least
    )
    derivation = "These point contacts resist no moment about y: Gᵀ e_my = 0, whatever the friction."
    turn = (0.0, 0.0, 0.0, 0.0, 0.5, 0.0)
    yield _opposed(
        "point-moment", derivation, expected_infeasibility({"y": [0, 0, 0, 0, 1, 0]}), objective="force", wrench=turn
    )


def _pyramids() -> Iterator[Record]:
    """Yield cases with the load along ±t₁, perpendicular to a facet of the pyramid."""
    for side, facets in (("inner", 8), ("outer", 8), ("inner", 4)):
        coefficient = MU * math.cos(math.pi / facets) if side == "inner" else MU
        normal = FRICTION_FORCE / coefficient
        derivation = f"The load is along ±t₁, perpendicular to a facet, so N = {FRICTION_FORCE:g}/μ', where μ' is the "
        derivation += f"friction coefficient of a facet of the {side} pyramid."
        known = expected_optimum((FRICTION_FORCE**2 + normal**2), [normal] * 2)
        yield _opposed(f"force-{side}-{facets}", derivation, known, objective="force", cone=(side, facets))


def _with_joints() -> Iterator[Record]:
    yield _opposed(
        "torque",
        f"{_BORNE} {_ONE_JOINT} The smallest ½‖tau‖² is ½·2·({LEVER:g}·{NORMAL:g})².",
        expected_optimum((LEVER * NORMAL) ** 2, [NORMAL] * 2),
        hand=_joints(),
    )
    yield _opposed(
        "torque-bias",
        f"{_ONE_JOINT} ½((N/20 − 4)² + (N/20 − 3)²) is smallest at N = 70 N, more than friction needs.",
        expected_optimum(0.25, [70.0, 70.0]),
        objective="torque",
        hand=_joints(bias_torque=[-4.0, -3.0]),
    )
    yield _opposed(
        "torque-weight",
        f"{_ONE_JOINT} ½((N/20 − 4)² + 4(N/20 − 3)²) is smallest at N = 64 N, more than friction needs.",
        expected_optimum(0.4, [64.0, 64.0]),
        objective="torque",
        hand=_joints(bias_torque=[-4.0, -3.0], torque_weight=[1.0, 4.0]),
    )
    rho = 1e-4  # (N·m/N)²
    yield _opposed(
        "torque-force-weight",
        f"{_BORNE} {_ONE_JOINT} ½‖tau‖² and ½ρ‖f‖² both increase with N.",
        expected_optimum((LEVER * NORMAL) ** 2 + rho * (FRICTION_FORCE**2 + NORMAL**2), [NORMAL] * 2),
        objective={"type": "torque", "force_weight": rho},
        hand=_joints(),
    )
    upper = 2.0  # N·m
    derivation = (
        f"{_BORNE} {_ONE_JOINT} A torque limit of {upper:g} N·m allows at most N = {upper / LEVER:g} N. Torque limits or "
        f"friction larger by a factor of {LEVER * NORMAL / upper:g} make the problem feasible."
    )
    proof = {"y": [0, 0, 1, 0, 0, 0], "torque_upper": [MU / LEVER] * 2}
    factor = LEVER * NORMAL / upper
    known = expected_infeasibility(proof, friction_factor=factor, torque_factor=factor)
    yield _opposed("torque-limit", derivation, known, objective="torque", hand=_joints(torque_upper=[upper] * 2))


def _soft() -> Iterator[Record]:
    moment = 0.5  # N·m
    normal = moment / 2 / GAMMA
    soft: dict[str, Any] = {"model": "soft", "torsional_friction": GAMMA}
    yield _opposed(
        "soft-moment",
        f"Each soft contact carries half the moment, M/2 = {moment / 2:g} N·m, so N = M/(2γ). f includes these moments.",
        expected_optimum(normal**2 + (moment / 2) ** 2, [normal] * 2),
        objective="force",
        wrench=(0.0, 0.0, 0.0, 0.0, moment, 0.0),
        **soft,
    )
    moment = 0.3  # N·m
    both = (0.0, 0.0, LOAD, 0.0, moment, 0.0)
    push, twist, facets = NORMAL, moment / 2 / GAMMA, 64
    laws: tuple[tuple[str, tuple[str, int] | None, float, str], ...] = (
        ("exact", None, math.hypot(push, twist), "N² = (f_t/μ)² + (m_n/γ)²"),
        ("inner-64", ("inner", facets), push / math.cos(math.pi / facets) + twist, "N = f_t/(μ cos π/64) + m_n/γ"),
        ("outer-64", ("outer", facets), max(push, twist), "N = max(f_t/μ, m_n/γ)"),
    )
    for name, cone, normal, law in laws:
        derivation = f"Each soft contact carries half the load and half the moment: {law}, with f_t = {FRICTION_FORCE:g} N "
        derivation += f"along ±t₁ and m_n = {moment / 2:g} N·m."
        known = expected_optimum(normal, [normal] * 2)
        yield _opposed(f"soft-load-moment-{name}", derivation, known, objective="max_normal", wrench=both, cone=cone, **soft)


def _joints(**more: list[float]) -> Record:
    """Return the record of a hand with one joint for each contact, whose torque is LEVER · f_n."""
    jacobian = [[0.0, 0.0] for _ in range(6)]
    jacobian[2][0] = jacobian[5][1] = LEVER
    return {"jacobian": jacobian, **more}


def _opposed(
    name: str,
    derivation: str,
    expected: Record,
    *,
    objective: str | Record | None = None,
    wrench: tuple[float, ...] = SUPPORT,
    cone: tuple[str, int] | None = None,
    hand: Record | None = None,
    **more: Any,
) -> Record:
    contacts = [contact_record((0.0, -s * 2.0, 0.0), (0.0, s * 1.0, 0.0), friction=MU, **more) for s in (1, -1)]
    kind = objective or name.replace("-", "_")
    return case_record(
        f"opposed/{name}",
        f"Two opposed contacts. {derivation}",
        contacts,
        wrench,
        expected,
        objective=kind,
        cone=cone,
        hand=hand,
    )
