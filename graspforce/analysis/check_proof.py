"""Check proof files of graspforce in exact rational arithmetic: ``python check_proof.py PROOF.json ...``

This program needs Python's standard library only. It decides the statement of a proof file with fractions, without rounding.

Data: contact i at p with the frame R = (t1, t2, n), friction μ, γ, limits of f_n; with a hand J, tau_u, limits and weights.
f stacks (f_n), (f_t1, f_t2, f_n) or (f_t1, f_t2, f_n, m_n) of each contact; G f is the wrench about the multipliers' point.
Cones K: |f_t| ≤ μ f_n; with m_n: √(f_t²/μ² + m_n²/γ²) ≤ f_n; dual cones: √(μ² z_t² + γ² z_m²) ≤ z_n. A polygon P makes it a
pyramid: f_t in f_n P and |m_n| ≤ γ f_n if the moment is separate, otherwise f_t in (f_n − |m_n|/γ) P.

Optimal: with z = ∇cost(f₀) − Gᵀ y − E (nu_lower − nu_upper) − J (lambda_lower − lambda_upper) and z_n + d in the dual cones,

    cost(f) ≥ cost(f₀) − [yᵀ(G f₀ − w) + zᵀ f₀ + Σ multiplier · slack + Σ d · max_normal + max d · reach]

for every feasible f, by convexity of the cost. For max f_n, the cost in z is Σ level · f_n with Σ level ≤ 1. Slip margin s:
f − (s/μ') e_n in K; then s Σ (z_n + d)/μ' ≤ [the same], without cost, for every feasible f with this margin.
Infeasible: z without ∇cost; a positive value contradicts every feasible f.
"""

from __future__ import annotations

import hashlib
import json
import sys
from fractions import Fraction
from pathlib import Path
from typing import Any

ZERO = Fraction(0)


class ProofError(Exception):
    """The proof does not prove its statement."""


def require(holds: bool, reason: str) -> None:
    """Refuse the proof with a reason unless a condition holds."""
    if not holds:
        raise ProofError(reason)


def number(value: Any) -> Fraction:
    """Return the exact value of a finite JSON number."""
    require(type(value) in (int, float), "a value is not a number")
    return Fraction(value)  # refuses NaN and infinity


def numbers(values: Any, count: int) -> list[Fraction]:
    """Return the exact values of a list of numbers."""
    return [number(value) for value, _ in zip(values, range(count), strict=True)]  # refuses another length


def limits(values: Any) -> list[Fraction | None]:
    """Return the exact values of limits; None for no limit."""
    return [None if value is None else number(value) for value in values]


def dot(a: list[Fraction], b: list[Fraction]) -> Fraction:
    """Return the sum of products."""
    return sum((x * y for x, y in zip(a, b, strict=True) if x and y), ZERO)


def cross(a: list[Fraction], b: list[Fraction]) -> list[Fraction]:
    """Return the cross product."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


class Contact:
    """A contact, with its columns of G about a point."""

    def __init__(self, record: dict[str, Any], point: list[Fraction], separate: bool) -> None:
        self.size, self.separate = record["components"], separate
        frame = [numbers(row, 3) for row in record["frame"]]
        arm = [x - c for x, c in zip(numbers(record["position"], 3), point, strict=True)]
        axes = [[row[a] for row in frame] for a in range(3)]  # t1, t2, n
        columns = [[*axis, *cross(arm, axis)] for axis in axes]
        self.columns = {1: columns[2:], 3: columns, 4: [*columns, [ZERO] * 3 + axes[2]]}[self.size]  # refuses other sizes
        self.normal = 0 if self.size == 1 else 2
        self.mu = number(record["friction"]) if self.size > 1 else ZERO
        self.gamma = number(record["torsional_friction"]) if self.size == 4 else ZERO
        self.least, self.most = number(record["min_normal"]), limits([record["max_normal"]])[0]
        require(min(self.mu, self.gamma, self.least, self.most or 0) >= 0, "friction and limits are not negative")
        polygon = [numbers(vertex, 2) for vertex in record["polygon"]] if self.size > 1 else []
        self.edges = list(zip(polygon, [*polygon[1:], *polygon[:1]], strict=True))
        self.facet = number(record["facet_friction"]) if self.edges else self.mu
        require(all(a[0] * b[1] > a[1] * b[0] for a, b in self.edges), "a polygon is not counterclockwise about zero")

    def in_cone(self, f: list[Fraction], slack: Fraction, margin: Fraction) -> bool:
        """Return whether a force is within `slack` of the limits and of the cone that is smaller by a slip margin."""
        normal = f[self.normal]
        if normal < self.least - slack or (self.most is not None and normal > self.most + slack):
            return False  # least is not negative
        moment = abs(f[3]) if self.size == 4 else ZERO
        normal -= margin / self.facet if margin and self.edges else 0
        if self.size == 4 and moment > (self.gamma * (normal + slack) if self.gamma else slack):
            return False
        if self.edges:
            normal -= moment / self.gamma if self.gamma and not self.separate else 0
            for a, b in self.edges:
                x, y = b[0] - a[0], b[1] - a[1]
                depth = x * (f[1] - normal * a[1]) - y * (f[0] - normal * a[0])
                if depth < 0 and depth**2 > slack**2 * (x**2 + y**2):
                    return False
            return normal >= -slack
        load = ZERO if self.size == 1 else f[0] ** 2 + f[1] ** 2
        load += (self.mu / self.gamma * moment) ** 2 if self.gamma else 0
        room = self.mu * normal - margin + slack
        return room >= 0 and load <= room**2

    def in_dual_cone(self, z: list[Fraction], distance: Fraction) -> bool:
        """Return whether z, moved by a distance along the normal, is in the dual cone."""
        normal, moment = z[self.normal] + distance, self.gamma * abs(z[3]) if self.size == 4 else ZERO
        if self.edges:
            least = min(z[0] * v[0] + z[1] * v[1] for v, _ in self.edges) + normal
            return least >= moment if self.separate else min(least, normal - moment) >= 0
        needed = self.mu**2 * (z[0] ** 2 + z[1] ** 2) if self.size > 1 else ZERO
        return normal >= 0 and needed + moment**2 <= normal**2


class Proof:
    """A proof file: data, multipliers and claim as fractions."""

    def __init__(self, record: dict[str, Any]) -> None:
        text = json.dumps({k: v for k, v in record.items() if k != "digest"}, sort_keys=True, separators=(",", ":"))
        require(record.get("digest") == hashlib.sha256(text.encode()).hexdigest(), "the checksum is another one")
        require(record["schema"] == "graspforce/proof/1", "the schema is another one")
        m, separate = record["multipliers"], record["separate_moment"] is True
        point, self.y = numbers(m["point"], 3), numbers(m["y"], 6)
        self.contacts = [Contact(contact, point, separate) for contact in record["contacts"]]
        self.k, hand = sum(contact.size for contact in self.contacts), record["hand"] or {}
        self.bias = [number(x) for x in hand.get("bias_torque", [])]
        n = len(self.bias)
        self.J = [numbers(row, n) for row in hand["jacobian"]] if hand else [[] for _ in range(self.k)]
        self.lower, self.upper = limits(hand.get("torque_lower", [])), limits(hand.get("torque_upper", []))
        self.weight = numbers(hand.get("torque_weight", []), n)
        require(all(weight >= 0 for weight in self.weight), "weights are not negative")
        names = ("normal_lower", "normal_upper", "torque_lower", "torque_upper", "distance", "level")
        values = [[number(x) for x in m[name]] for name in names]
        require(all(x >= 0 for part in values for x in part) and sum(values[5]) <= 1, "a multiplier is out of range")
        self.nu_lower, self.nu_upper, self.lambda_lower, self.lambda_upper, self.distance, self.level = values
        w, self.claim, self.units, self.record = numbers(record["wrench"], 6), record["claim"], record["units"], record
        self.w = [*w[:3], *(a - b for a, b in zip(w[3:], cross(point, w[:3]), strict=True))]
        (self.reach,) = limits([self.claim["reach"]])
        ends = [*(contact.most for contact in self.contacts), *self.lower, *self.upper]
        limited = zip([*self.nu_upper, *self.lambda_lower, *self.lambda_upper], ends, strict=True)
        require(not any(x for x, end in limited if end is None), "an absent limit has a multiplier")

    def split(self, values: list[Fraction]) -> list[list[Fraction]]:
        """Return the components of each contact."""
        rest = iter(values)
        return [[next(rest) for _ in contact.columns] for contact in self.contacts]

    def cone_multipliers(self, gradient: list[Fraction], torque_gradient: list[Fraction]) -> list[Fraction]:
        """Return z for the gradients of the cost by forces and torques, and check the dual cones."""
        z: list[Fraction] = []
        prices = zip(self.lambda_lower, self.lambda_upper, torque_gradient, strict=True)
        price = [own - lower + upper for lower, upper, own in prices]
        slopes = self.split([x + dot(row, price) for x, row in zip(gradient, self.J, strict=True)])
        for i, (contact, slope) in enumerate(zip(self.contacts, slopes, strict=True)):
            own = [x - dot(column, self.y) for x, column in zip(slope, contact.columns, strict=True)]
            own[contact.normal] += self.nu_upper[i] - self.nu_lower[i]
            require(contact.in_dual_cone(own, self.distance[i]), f"z of contact {i} is outside the dual cone")
            z += own
        return z

    def gradients(self, f: list[Fraction], tau: list[Fraction]) -> tuple[list[Fraction], list[Fraction]]:
        """Return the gradients of the cost by forces and by torques."""
        objective, gradient = self.record["objective"], []
        kind, length = objective["type"], number(objective["moment_length"])
        rho = Fraction(1) if kind == "force" else number(objective["force_weight"])
        known = kind in ("torque", "force", "sum_normal", "max_normal", *(["margin"] if rho == 0 else []))
        require(known and rho >= 0 and length > 0, "the objective is unknown")
        for i, (contact, own) in enumerate(zip(self.contacts, self.split(f), strict=True)):
            linear = {"sum_normal": Fraction(1), "max_normal": self.level[i]}.get(kind, ZERO)
            for c, x in enumerate(own):
                gradient.append((linear if c == contact.normal else 0) + (rho * x / length**2 if c == 3 else rho * x))
        return gradient, [w * t if kind == "torque" else ZERO for w, t in zip(self.weight, tau, strict=True)]

    def bound(self, f: list[Fraction], tau: list[Fraction], z: list[Fraction], error: list[Fraction]) -> Fraction:
        """Return yᵀ error + zᵀ f + Σ multiplier · slack + Σ d · max_normal + max d · reach."""
        pairs = list(zip(self.contacts, self.distance, strict=True))
        open_distance = max((d for contact, d in pairs if contact.most is None), default=ZERO)
        require(self.reach is not None or open_distance == 0, "the statement has no reach, and the proof needs one")
        total = dot(self.y, error) + dot(z, f) + open_distance * (self.reach or 0)
        total += sum(d * (contact.most or 0) for contact, d in pairs)
        for contact, own, below, above in zip(self.contacts, self.split(f), self.nu_lower, self.nu_upper, strict=True):
            total += below * (own[contact.normal] - contact.least)
            total += above * (contact.most - own[contact.normal]) if contact.most is not None else 0
        for t, low, high, below, above in zip(tau, self.lower, self.upper, self.lambda_lower, self.lambda_upper, strict=True):
            total += (below * (t - low) if low is not None else 0) + (above * (high - t) if high is not None else 0)
        return total

    def check_optimal(self) -> None:
        """Decide the statement of an optimum."""
        f, kind, gap = numbers(self.record["forces"], self.k), self.record["objective"]["type"], number(self.claim["gap"])
        violation, force, length = (number(x) for x in (self.claim["violation"], self.units["force"], self.units["length"]))
        require(violation >= 0 and force > 0 and length > 0, "violation and units are not negative")
        margin = number(self.claim["slip_margin"]) if kind == "margin" else ZERO
        tau = [bias + dot([row[j] for row in self.J], f) for j, bias in enumerate(self.bias)]
        z, error, shares, normals = self.cone_multipliers(*self.gradients(f, tau)), [-x for x in self.w], ZERO, []
        for i, (contact, own, price) in enumerate(zip(self.contacts, self.split(f), self.split(z), strict=True)):
            for c, x in enumerate(own):
                error = [e + x * g for e, g in zip(error, contact.columns[c], strict=True)]
            normals.append(own[contact.normal])
            shrinks = kind == "margin" and contact.mu > 0
            shares += (price[contact.normal] + self.distance[i]) / contact.facet if shrinks else 0
            require(contact.in_cone(own, violation * force, margin if shrinks else ZERO), f"force {i} violates its limits")
        sizes = [force] * 3 + [force * length] * 3
        require(all(abs(e) <= violation * size for e, size in zip(error, sizes, strict=True)), "the wrench is another one")
        for j, (t, unit) in enumerate(zip(tau, numbers(self.units["torque"], len(tau)), strict=True)):
            low, high, room = self.lower[j], self.upper[j], violation * unit
            within = (low is None or t >= low - room) and (high is None or t <= high + room)
            require(unit > 0 and within, f"torque {j} violates its limits by more")
        total = self.bound(f, tau, z, error) + (max(normals) - dot(self.level, normals) if kind == "max_normal" else 0)
        require(kind != "margin" or shares > 0, "no multiplier bounds the slip margin")
        require((total / shares - margin if kind == "margin" else total) <= gap, "the gap is larger than stated")

    def check_infeasible(self) -> None:
        """Decide the statement that no forces satisfy the constraints."""
        zero = [ZERO] * self.k
        z = self.cone_multipliers(zero, [ZERO] * len(self.bias))
        require(self.bound(zero, self.bias, z, [-x for x in self.w]) < 0, "the value is not positive")


def check(record: dict[str, Any]) -> str:
    """Return the proven status of the content of a proof file; raise `ProofError` if it does not prove its statement."""
    try:
        proof = Proof(record)
        status = proof.claim["status"]
        require(status in ("optimal", "infeasible"), "the status is unknown")
        proof.check_optimal() if status == "optimal" else proof.check_infeasible()
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, ArithmeticError) as error:
        raise ProofError(f"the file is not a proof ({type(error).__name__}: {error})") from None
    return str(status)


def main(paths: list[str]) -> int:
    """Check files and print the verdicts; return 0 if all statements are proven."""
    failures = not paths
    for path in paths:
        try:
            record = json.loads(Path(path).read_text(encoding="utf-8"))
            print(f"{path}: proven {check(record)}, reach {record['claim']['reach']} N")
        except (ProofError, OSError, ValueError, RecursionError) as reason:
            failures = True
            print(f"{path}: refused: {reason}")
    return int(failures)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
