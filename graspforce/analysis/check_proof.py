"""Check proof files of graspforce in exact rational arithmetic: ``python check_proof.py PROOF.json ...``

This program needs Python's standard library only. It decides the statement of a proof file with fractions, without rounding.

Data: contact i at p with the frame R = (t1, t2, n), friction μ, γ, limits of f_n, and with a hand J, tau_u, limits and weights.
f stacks (f_n), (f_t1, f_t2, f_n) or (f_t1, f_t2, f_n, m_n) of each contact. G f is the wrench about the point of the
multipliers. Cones K: |f_t| ≤ μ f_n; with m_n: √(f_t²/μ² + m_n²/γ²) ≤ f_n; dual cones: √(μ² z_t² + γ² z_m²) ≤ z_n.

Optimal: with z = ∇cost(f₀) − Gᵀ y − E (nu_lower − nu_upper) − J (lambda_lower − lambda_upper) and z_n + d in the dual cones,

    cost(f) ≥ cost(f₀) − [yᵀ(G f₀ − w) + zᵀ f₀ + Σ multiplier · slack + Σ d · max_normal + max d · reach]

for every feasible f, by convexity of the cost. Infeasible: z without ∇cost; a positive value contradicts every feasible f.
"""

from __future__ import annotations

import hashlib
import json
import sys
from fractions import Fraction
from typing import Any


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
    require(isinstance(values, list) and len(values) == count, f"a list does not have {count} numbers")
    return [number(value) for value in values]


def limits(values: Any, count: int) -> list[Fraction | None]:
    """Return the exact values of limits; None for no limit."""
    given = iter(numbers([value for value in values if value is not None], count - values.count(None)))
    return [None if value is None else next(given) for value in values]


def dot(a: list[Fraction], b: list[Fraction]) -> Fraction:
    """Return the sum of products."""
    return sum((x * y for x, y in zip(a, b, strict=True) if x and y), Fraction(0))


def cross(a: list[Fraction], b: list[Fraction]) -> list[Fraction]:
    """Return the cross product."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


class Contact:
    """A contact, with its columns of G about a point."""

    def __init__(self, record: dict[str, Any], point: list[Fraction]) -> None:
        self.size = record["components"]
        require(self.size in (1, 3, 4), "a contact has 1, 3 or 4 components")
        frame = [numbers(row, 3) for row in record["frame"]]
        require(len(frame) == 3, "a frame has 3 rows")
        arm = [x - c for x, c in zip(numbers(record["position"], 3), point, strict=True)]
        axes = [[row[a] for row in frame] for a in range(3)]  # t1, t2, n
        self.columns = [[*axis, *cross(arm, axis)] for axis in (axes[2:] if self.size == 1 else axes)]
        if self.size == 4:
            self.columns.append([Fraction(0)] * 3 + axes[2])
        self.normal = 0 if self.size == 1 else 2
        self.mu = number(record["friction"]) if self.size > 1 else Fraction(0)
        self.gamma = number(record["torsional_friction"]) if self.size == 4 else Fraction(0)
        self.least = number(record["min_normal"])
        self.most = None if record["max_normal"] is None else number(record["max_normal"])
        require(min(self.mu, self.gamma, self.least, self.most or 0) >= 0, "friction and limits are not negative")

    def in_cone(self, f: list[Fraction], slack: Fraction) -> bool:
        """Return whether a force is within `slack` of the cone and the limits."""
        normal = f[self.normal]
        if normal < self.least - slack or (self.most is not None and normal > self.most + slack):
            return False  # least is not negative
        load = Fraction(0) if self.size == 1 else f[0] ** 2 + f[1] ** 2
        if self.size == 4:
            load += (self.mu / self.gamma * f[3]) ** 2 if self.gamma else 0
            if abs(f[3]) > (self.gamma * (normal + slack) if self.gamma else slack):
                return False
        room = self.mu * normal + slack
        return room >= 0 and load <= room**2

    def in_dual_cone(self, z: list[Fraction], distance: Fraction) -> bool:
        """Return whether z, moved by a distance along the normal, is in the dual cone."""
        normal = z[self.normal] + distance
        needed = self.mu**2 * (z[0] ** 2 + z[1] ** 2) if self.size > 1 else Fraction(0)
        needed += self.gamma**2 * z[3] ** 2 if self.size == 4 else Fraction(0)
        return normal >= 0 and needed <= normal**2


class Proof:
    """A proof file: data, multipliers and claim as fractions."""

    def __init__(self, record: dict[str, Any]) -> None:
        content = {name: value for name, value in record.items() if name != "digest"}
        text = json.dumps(content, sort_keys=True, separators=(",", ":"))
        require(record.get("digest") == hashlib.sha256(text.encode()).hexdigest(), "the checksum is another one")
        require(record["schema"] == "graspforce/proof/1", "the schema is another one")
        m = record["multipliers"]
        self.point, self.y = numbers(m["point"], 3), numbers(m["y"], 6)
        self.contacts = [Contact(contact, self.point) for contact in record["contacts"]]
        self.k, hand = sum(contact.size for contact in self.contacts), record["hand"] or {}
        self.bias = [number(x) for x in hand.get("bias_torque", [])]
        n, count = len(self.bias), len(self.contacts)
        require(count > 0, "there are no contacts")
        self.J = [numbers(row, n) for row in hand["jacobian"]] if hand else [[] for _ in range(self.k)]
        require(len(self.J) == self.k, "the Jacobian does not have a row for each component")
        self.lower, self.upper = limits(hand.get("torque_lower", []), n), limits(hand.get("torque_upper", []), n)
        self.weight = numbers(hand.get("torque_weight", []), n)
        require(all(weight >= 0 for weight in self.weight), "weights are not negative")
        sizes = (count, count, n, n, count)
        names = ("normal_lower", "normal_upper", "torque_lower", "torque_upper", "distance")
        values = [numbers(m[name], size) for name, size in zip(names, sizes, strict=True)]
        require(all(x >= 0 for part in values for x in part), "a multiplier is negative")
        self.nu_lower, self.nu_upper, self.lambda_lower, self.lambda_upper, self.distance = values
        w = numbers(record["wrench"], 6)
        self.w = [*w[:3], *(a - b for a, b in zip(w[3:], cross(self.point, w[:3]), strict=True))]
        self.claim, self.units, self.record = record["claim"], record["units"], record
        (self.reach,) = limits([self.claim["reach"]], 1)
        ends = [*(contact.most for contact in self.contacts), *self.lower, *self.upper]
        limited = zip([*self.nu_upper, *self.lambda_lower, *self.lambda_upper], ends, strict=True)
        require(not any(x for x, end in limited if end is None), "an absent limit has a multiplier")

    def split(self, values: list[Fraction]) -> list[list[Fraction]]:
        """Return the components of each contact."""
        rest = iter(values)
        return [[next(rest) for _ in range(contact.size)] for contact in self.contacts]

    def cone_multipliers(self, gradient: list[Fraction], torque_gradient: list[Fraction] | None) -> list[Fraction]:
        """Return z for the gradients of the cost by forces and torques, and check the dual cones."""
        z: list[Fraction] = []
        price = [b - a for a, b in zip(self.lambda_lower, self.lambda_upper, strict=True)]
        if torque_gradient is not None:
            price = [a + b for a, b in zip(price, torque_gradient, strict=True)]
        for i, contact in enumerate(self.contacts):
            own = []
            for c in range(contact.size):
                row = len(z) + c
                own.append(gradient[row] + dot(self.J[row], price) - dot(contact.columns[c], self.y))
            own[contact.normal] += self.nu_upper[i] - self.nu_lower[i]
            require(contact.in_dual_cone(own, self.distance[i]), f"z of contact {i} is outside the dual cone")
            z += own
        return z

    def open_cost(self) -> Fraction:
        """Return Σ d · max_normal + max d · reach."""
        cost, open_distance = Fraction(0), Fraction(0)
        for contact, distance in zip(self.contacts, self.distance, strict=True):
            if contact.most is None:
                open_distance = max(open_distance, distance)
            else:
                cost += distance * contact.most
        require(self.reach is not None or open_distance == 0, "the statement has no reach, and the proof needs one")
        return cost if self.reach is None else cost + open_distance * self.reach

    def check_optimal(self) -> None:
        """Decide the statement of an optimum."""
        f, objective = numbers(self.record["forces"], self.k), self.record["objective"]
        kind, gap = objective["type"], number(self.claim["gap"])
        violation, force = number(self.claim["violation"]), number(self.units["force"])
        require(kind in ("torque", "force", "sum_normal") and violation >= 0 and force > 0, "the objective is unknown")
        tau = [bias + dot([row[j] for row in self.J], f) for j, bias in enumerate(self.bias)]
        rho = Fraction(1) if kind == "force" else number(objective["force_weight"])
        length = number(objective["moment_length"])
        require(rho >= 0 and length > 0, "the weight of the forces is not negative")
        gradient = []
        for contact, own in zip(self.contacts, self.split(f), strict=True):
            for c, x in enumerate(own):
                linear = Fraction(1) if kind == "sum_normal" and c == contact.normal else Fraction(0)
                gradient.append(linear + (rho * x / length**2 if c == 3 else rho * x))
        z = self.cone_multipliers(
            gradient, [w * t for w, t in zip(self.weight, tau, strict=True)] if kind == "torque" else None
        )
        total = dot(z, f) + self.open_cost()
        error = [-x for x in self.w]
        for i, (contact, own) in enumerate(zip(self.contacts, self.split(f), strict=True)):
            for c, x in enumerate(own):
                error = [e + x * g for e, g in zip(error, contact.columns[c], strict=True)]
            normal = own[contact.normal]
            total += self.nu_lower[i] * (normal - contact.least)
            total += self.nu_upper[i] * (contact.most - normal) if contact.most is not None else 0
            require(contact.in_cone(own, violation * force), f"the force of contact {i} violates its limits by more")
        total += dot(self.y, error)
        length_unit = number(self.units["length"])
        sizes = [force] * 3 + [force * length_unit] * 3
        balanced = all(abs(e) <= violation * size for e, size in zip(error, sizes, strict=True))
        require(length_unit > 0 and balanced, "the wrench is another one")
        torque_units = numbers(self.units["torque"], len(tau))
        for j, (t, unit) in enumerate(zip(tau, torque_units, strict=True)):
            low, high, room = self.lower[j], self.upper[j], violation * unit
            require(unit > 0 and (low is None or t >= low - room), f"torque {j} is below its limit by more")
            require(high is None or t <= high + room, f"torque {j} is above its limit by more")
            total += self.lambda_lower[j] * (t - low) if low is not None else 0
            total += self.lambda_upper[j] * (high - t) if high is not None else 0
        require(total <= gap, "the gap is larger than stated")

    def check_infeasible(self) -> None:
        """Decide the statement that no forces satisfy the constraints."""
        self.cone_multipliers([Fraction(0)] * self.k, None)
        value = dot(self.y, self.w) - self.open_cost()
        for contact, below, above in zip(self.contacts, self.nu_lower, self.nu_upper, strict=True):
            value += below * contact.least - (above * contact.most if contact.most is not None else 0)
        for j, bias in enumerate(self.bias):
            low, high = self.lower[j], self.upper[j]
            value += self.lambda_lower[j] * (low - bias) if low is not None else 0
            value -= self.lambda_upper[j] * (high - bias) if high is not None else 0
        require(value > 0, "the value is not positive")


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
    failures = 0
    for path in paths:
        try:
            with open(path, encoding="utf-8") as file:
                record = json.load(file)
            print(f"{path}: proven {check(record)}, reach {record['claim']['reach']} N")
        except (ProofError, OSError, ValueError, RecursionError) as reason:
            failures += 1
            print(f"{path}: refused: {reason}")
    return 1 if failures or not paths else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
