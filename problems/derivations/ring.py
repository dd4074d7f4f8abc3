"""n contacts evenly spaced around a vertical axis, or a sphere on three fingertips: closed forms by symmetry.

A rotation of the ring by 2π/n, or a reflection, maps feasible forces to feasible forces of equal cost. By convexity, the mean
over all these maps is feasible and costs no more. Therefore an optimum with equal forces at all contacts exists; if the cost is
strictly convex, it is unique. For a ring with weight W, f_t = W/n upwards and f_n = f_t/μ.
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

RADIUS = 0.05  # m
_BORNE = "By symmetry, each contact carries W/n by friction, so f_n ≥ W/(nμ)."


def cases() -> Iterator[Record]:
    """Yield the records of the collection."""
    for count, mu, weight in ((3, 0.5, 1.0), (4, 0.4, 2.943), (5, 0.8, 2.0), (8, 0.25, 20.0), (64, 0.6, 100.0)):
        yield _weight_case(f"{count}-force", count, mu, weight)
    yield _weight_case("3-slippery", 3, 1e-3, 1.0)
    yield _weight_case("3-millinewton", 3, 0.5, 1e-3, radius=5e-4)
    yield _weight_case("4-meganewton", 4, 0.4, 1e6, radius=2.0)
    normal = 1.0 / (3 * 0.5)
    yield _ring(
        "3-max-normal", _BORNE, 3, 0.5, (0, 0, 1, 0, 0, 0), expected_optimum(normal, [normal] * 3), objective="max_normal"
    )
    known = expected_optimum(3 * normal, [normal] * 3)
    yield _ring("3-sum-normal", f"{_BORNE} The smallest sum is W/μ.", 3, 0.5, (0, 0, 1, 0, 0, 0), known, objective="sum_normal")
    most, mu, weight = 4.0, 0.4, 2.943
    derivation = f"By symmetry, each contact carries W/n. With all normal forces at their limit, s = μ·{most:g} − W/n."
    known = expected_optimum(mu * most - weight / 4, [most] * 4)
    yield _ring("4-margin", derivation, 4, mu, (0, 0, weight, 0, 0, 0), known, objective="margin", max_normal=most)
    yield from _torsion()
    yield from _pyramids()
    yield from _bounded()
    lever, rho = 0.04, 1e-5  # m, (N·m/N)²
    hand = {"jacobian": [[lever if row == 3 * j + 2 else 0.0 for j in range(3)] for row in range(9)]}
    derivation = f"{_BORNE} Each contact has one joint, tau = {lever:g} m · f_n. ½‖tau‖² and ½ρ‖f‖² both increase with f_n."
    cost = 1.5 * (lever * normal) ** 2 + rho / 6 * (1 + 4)
    aim = {"type": "torque", "force_weight": rho}
    yield _ring(
        "3-torque", derivation, 3, 0.5, (0, 0, 1, 0, 0, 0), expected_optimum(cost, [normal] * 3), objective=aim, hand=hand
    )
    yield from _sphere()


def _torsion() -> Iterator[Record]:
    mu, moment, weight = 0.5, 0.2, 3.0  # 1, N·m, N
    for name, load in (("3-moment", 0.0), ("3-load-moment", weight)):
        tangential = math.hypot(load / 3, moment / (3 * RADIUS))  # N
        derivation = (
            "By symmetry, the friction force of each contact is W/n upwards and M/(nr) around the axis, and f_n = f_t/μ."
        )
        known = expected_optimum(1.5 * tangential**2 * (1 + 1 / mu**2), [tangential / mu] * 3)
        yield _ring(name, derivation, 3, mu, (0, 0, load, 0, 0, moment), known, objective="force")


def _pyramids() -> Iterator[Record]:
    """Yield cases with the load perpendicular to a facet (default tangents) or towards a corner (tangents turned by 45°)."""
    mu, weight, count = 0.5, 1.0, 3
    corner = [[-math.sqrt(0.5) * y, math.sqrt(0.5) * x, math.sqrt(0.5)] for x, y in _circle(count)]
    for name, cone, coefficient, tangents, direction in (
        ("3-inner-8", ("inner", 8), mu * math.cos(math.pi / 8), None, "perpendicular to a facet: μ' = μ cos(π/8)"),
        ("3-outer-8", ("outer", 8), mu, None, "perpendicular to a facet: μ' = μ"),
        ("3-inner-4-turned", ("inner", 4), mu, corner, "towards a corner: μ' = μ"),
        ("3-outer-4-turned", ("outer", 4), mu / math.cos(math.pi / 4), corner, "towards a corner: μ' = μ/cos(π/4)"),
    ):
        derivation = f"By symmetry, each contact carries W/n by friction. The load is {direction}, and f_n = W/(nμ')."
        normal = weight / count / coefficient
        known = expected_optimum(weight**2 / (2 * count) * (1 + 1 / coefficient**2), [normal] * count)
        wrench = (0, 0, weight, 0, 0, 0)
        yield _ring(name, derivation, count, mu, wrench, known, objective="force", cone=cone, tangents=tangents)


def _bounded() -> Iterator[Record]:
    least, mu = 5.0, 0.4  # N
    for name, weight in (("4-squeeze", 0.0), ("4-min-normal", 2.943)):
        derivation = f"Friction needs only W/(nμ) < {least:g} N, so each normal force is at its lower limit."
        known = expected_optimum(2 * (least**2 + (weight / 4) ** 2), [least] * 4)
        yield _ring(name, derivation, 4, mu, (0, 0, weight, 0, 0, 0), known, objective="force", min_normal=least)
    most, weight = 1.5, 2.943  # N
    derivation = (
        "Friction carries at most nμ·max_normal < W. Proof: y = e_z with the multiplier μ of each limit. "
        "Friction larger by a factor of W/(nμ·max_normal) makes the problem feasible."
    )
    known = expected_infeasibility(
        {"y": [0, 0, 1, 0, 0, 0], "normal_upper": [mu] * 4}, friction_factor=weight / (4 * mu * most)
    )
    yield _ring("4-capped", derivation, 4, mu, (0, 0, weight, 0, 0, 0), known, objective="force", max_normal=most)
    derivation = "Frictionless contacts with horizontal normals supply no vertical force: Gᵀ e_z = 0."
    known = expected_infeasibility({"y": [0, 0, 1, 0, 0, 0]})
    yield _ring("4-frictionless", derivation, 4, None, (0, 0, weight, 0, 0, 0), known, objective="force", model="frictionless")


def _sphere() -> Iterator[Record]:
    """Yield cases of a sphere with radius 0.1 m and density 1000 kg/m³ on three contacts 30° from its lowest point."""
    radius, angle = 0.1, math.radians(30)
    weight = 1000 * 4 / 3 * math.pi * radius**3 * 9.81  # N: 41.0920
    c, s = math.cos(angle), math.sin(angle)
    third = weight / 3  # N
    slippery, rough = 0.3, 0.8
    edge = third / (c + slippery * s)
    for name, mu, cost, normal, derivation in (
        ("sphere-rough", rough, 1.5 * third**2, third * c, "μ > tan 30°: the forces are vertical, W/3 each."),
        (
            "sphere-slippery",
            slippery,
            1.5 * edge**2 * (1 + slippery**2),
            edge,
            "μ < tan 30°: each force is on the edge of its cone, f_n (cos 30° + μ sin 30°) = W/3.",
        ),
        ("sphere-frictionless", None, 1.5 * (third / c) ** 2, third / c, "f_n cos 30° = W/3."),
    ):
        kind: dict[str, Any] = {"model": "frictionless"} if mu is None else {"friction": mu}
        points = [(radius * s * x, radius * s * y, -radius * c) for x, y in _circle(3)]
        contacts = [contact_record(p, [-a for a in p], **kind) for p in points]
        what = (
            "A sphere, 0.1 m in radius, 1000 kg/m³ (W = 41.0920 N at 9.81 m/s²), on three contacts 30° from its lowest point."
        )
        known = expected_optimum(cost, [normal] * 3)
        yield case_record(f"ring/{name}", f"{what} {derivation}", contacts, (0, 0, weight, 0, 0, 0), known, objective="force")


def _weight_case(name: str, count: int, mu: float, weight: float, radius: float = RADIUS) -> Record:
    derivation = f"{_BORNE} The smallest ½‖f‖² is W²(1 + 1/μ²)/(2n)."
    known = expected_optimum(weight**2 * (1 + 1 / mu**2) / (2 * count), [weight / (count * mu)] * count)
    return _ring(name, derivation, count, mu, (0, 0, weight, 0, 0, 0), known, objective="force", radius=radius)


def _circle(count: int) -> list[tuple[float, float]]:
    return [(math.cos(2 * math.pi * i / count), math.sin(2 * math.pi * i / count)) for i in range(count)]


def _ring(
    name: str,
    derivation: str,
    count: int,
    mu: float | None,
    wrench: tuple[float, ...],
    expected: Record,
    *,
    objective: str | Record,
    radius: float = RADIUS,
    cone: tuple[str, int] | None = None,
    hand: Record | None = None,
    tangents: list[list[float]] | None = None,
    **more: Any,
) -> Record:
    contacts = []
    for i, (x, y) in enumerate(_circle(count)):
        own: dict[str, Any] = {} if mu is None else {"friction": mu}
        if tangents is not None:
            own["tangent"] = tangents[i]
        contacts.append(contact_record((radius * x, radius * y, 0.0), (-x, -y, 0.0), **own, **more))
    source = f"{count} contacts evenly spaced around a vertical axis. {derivation}"
    return case_record(f"ring/{name}", source, contacts, wrench, expected, objective=objective, cone=cone, hand=hand)
