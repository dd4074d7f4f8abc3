"""What a squeeze holds: slip margins, least friction and the largest errors, computed from the forces alone.

The numbers are independent of the solver that found the squeeze. Guaranteed values use the bounds of `RobustSet`; values of
members of the set show how far they could be too careful.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.records import make_unchecked
from graspforce.force.problem import ForceProblem
from graspforce.force.robust_set import RobustSet
from graspforce.force.uncertainty import Uncertainty

SLIP_TOLERANCE = 1e-8  # force units: rounding of a certified squeeze
_LARGEST_FACTOR = 1e3
_FACTOR_ACCURACY = 1e-7  # relative
_LEAST_SHARE = 1e-12  # of the sum of sizes: a smaller normal force is rounding


@dataclass(frozen=True, eq=False, slots=True)
class WorstCase:
    """Slip margins and friction of a squeeze over a set of errors.

    Args:
        guaranteed: (N,) slip margin that every member keeps, N; inf without friction.
        reached: (N,) slip margin of the worst known member, N: a vertex of the wrenches, or one near the worst other errors.
        least_friction: (N,) μ₀: the contact does not slip for any μ ≥ μ₀; 0 without friction, inf if a normal force may vanish.
        slipping_friction: (N,) below this μ a known member slips; equal to μ₀ if the set is exact.
        exceeded: largest amount by which a member may exceed a limit of normal forces or torques, in units of its row; ≤ 0 if
            all are kept.
        forces: (N, m) scaled forces of the worst known member of each contact.
    """

    guaranteed: Array
    reached: Array
    least_friction: Array
    slipping_friction: Array
    exceeded: float
    forces: Array


@dataclass(frozen=True, eq=False, slots=True)
class SlippingMember:
    """A member of a set of errors in which a contact slips.

    Args:
        contact: index of the contact.
        friction: (N,) least friction about the modelled normals: its cones are inside all true cones.
        wrench: (6,) the wrench that the forces supply at the modelled places, about O, in O, N and N·m.
        forces: (k,) the contact forces, N and N·m.
    """

    contact: int
    friction: Array
    wrench: Array
    forces: Array


def worst_case(robust: RobustSet, f: Array) -> WorstCase:
    """Return slip margins and friction of a squeeze over all errors of its problem.

    Args:
        robust: the set.
        f: (k,) the squeeze, N and N·m.
    """
    program, contacts = robust.program, robust.nominal.contacts
    force = float(program.wrench_units[0])  # N
    x = program.variables(f)[: robust.columns]
    sizes, torques = robust.sizes(x), np.abs(robust.problem.torques(f))
    heads, tails = robust.friction_rows
    mu, place = contacts.mu[robust.rubbing], robust.rubbing
    every = x + robust.shifts  # (V, m)
    known = every if robust.is_exact else np.vstack([every, *(M @ x + b for M, b in robust.worst_members(x))])
    normal = every @ heads.T  # (V, c)
    across = np.linalg.norm(np.einsum("cam,vm->vca", tails, every), axis=2)
    margin = mu * normal - across
    seen_normal, seen_across = known @ heads.T, np.linalg.norm(np.einsum("cam,vm->vca", tails, known), axis=2)
    seen_margin = mu * seen_normal - seen_across
    both, alone = robust.reserve(mu[:, None] * heads, tails), robust.reserve(heads)
    tangential = robust.reserve(np.zeros_like(heads), tails)
    less = alone.at(sizes, torques)
    smallest = _LEAST_SHARE * float(sizes.sum())
    with np.errstate(divide="ignore", invalid="ignore"):
        needed = np.where(normal - less > smallest, (across + tangential.at(sizes, torques)) / (normal - less), np.inf)
        seen = np.where(seen_normal > smallest, seen_across / seen_normal, np.inf)
    tilt = np.broadcast_to(robust.uncertainty.normal_error, len(contacts))[place]
    result = {name: np.zeros(len(contacts)) for name in ("least_friction", "slipping_friction")}
    result["forces"] = np.tile(x, (len(contacts), 1))
    result["guaranteed"], result["reached"] = np.full((2, len(contacts)), np.inf)
    result["guaranteed"][place] = force * (margin.min(axis=0) - both.at(sizes, torques))
    result["reached"][place] = force * seen_margin.min(axis=0)
    result["least_friction"][place] = np.tan(np.minimum(np.arctan(needed.max(axis=0)) + tilt, 0.5 * np.pi))
    result["slipping_friction"][place] = np.tan(np.minimum(np.arctan(seen.max(axis=0)) + tilt, 0.5 * np.pi))
    result["forces"][place] = known[seen_margin.argmin(axis=0)]
    return WorstCase(**{name: arrays.freeze(value) for name, value in result.items()}, exceeded=_exceeded(robust, every, x, f))


def _exceeded(robust: RobustSet, every: Array, x: Array, f: Array) -> float:
    """Return the largest amount by which a row of the limits may be exceeded."""
    program, sizes, torques = robust.program, robust.sizes(x), np.abs(robust.problem.torques(f))
    kept = [limit is None or limit.kind != "level" for limit in program.limits[len(program.b) - 6 :]]
    rows, bounds = program.C[kept][:, : robust.columns], program.d[kept]
    parts = [np.zeros(1)]
    if len(rows):
        parts.append((rows @ every.T).max(axis=1) + robust.reserve(rows).at(sizes, torques) - bounds)
    equal = program.A[6:, : robust.columns]
    if len(equal):
        parts.append(np.abs(equal @ every.T - program.b[6:, None]).max(axis=1) + robust.reserve(equal).at(sizes, torques))
    return float(np.concatenate(parts).max()) if len(rows) or len(equal) else -np.inf


@dataclass(frozen=True, eq=False)
class RobustCertificate:
    """What a certified squeeze holds, computed from its forces.

    Args:
        problem: the problem with its uncertainty.
        f: (k,) the squeeze, N and N·m.
        cost_bound: lower bound on the objective of every squeeze that holds for the set.
    """

    problem: ForceProblem
    f: Array
    cost_bound: float

    @cached_property
    def robust_set(self) -> RobustSet:
        """The set of the problem's errors."""
        return RobustSet(self.problem)

    @cached_property
    def worst(self) -> WorstCase:
        """Slip margins and friction over the set."""
        return worst_case(self.robust_set, self.f)

    @property
    def uncertainty(self) -> Uncertainty:
        """The errors of the problem."""
        assert self.problem.uncertainty is not None  # a certificate exists only with it
        return self.problem.uncertainty

    @cached_property
    def is_exact(self) -> bool:
        """Whether the cost is the least one; otherwise it is between `cost_bound` and the objective."""
        return self.robust_set.is_exact

    @cached_property
    def least_friction(self) -> Array:
        """The (N,) friction μ₀ from which no contact slips, with all other errors."""
        return self.worst.least_friction

    @cached_property
    def slip_margin(self) -> Array:
        """The (N,) slip margin that every member of the set keeps, N; inf without friction."""
        return self.worst.guaranteed

    @cached_property
    def error_factor(self) -> tuple[float, float]:
        """The factors on all errors up to which no contact slips, and from which one does; inf if none was found.

        They are equal for exact sets, to 1e-7. This takes some tenths of a second.
        """
        holds = self._largest_factor(guaranteed=True)
        return holds, holds if self.is_exact else self._largest_factor(guaranteed=False)

    def slipping_member(self, factor: float) -> SlippingMember | None:
        """Return a member in which a contact slips, among errors multiplied by a factor.

        Args:
            factor: at least 0.

        Returns:
            The member; None if no known member slips.

        Raises:
            InvalidInput: a fraction would reach 1.
        """
        robust = RobustSet(_with_uncertainty(self.problem, self.uncertainty.times(factor)))
        worst = worst_case(robust, self.f)
        contact = int(np.argmin(worst.reached))
        if worst.reached[contact] >= 0.0:
            return None
        x = worst.forces[contact]
        forces = robust.program.forces(np.append(x, np.zeros(len(robust.program.q) - len(x))))
        wrench = self.problem.G @ forces
        return SlippingMember(contact, robust.nominal.contacts.mu, arrays.freeze(wrench), arrays.freeze(forces))

    @cached_property
    def statement(self) -> str:
        """The certificate in words."""
        friction = ", ".join(f"{mu:.4g}" for mu in self.least_friction)
        kind = "the least cost" if self.is_exact else f"a cost at most {100.0 * self._excess:.2g} % above the least one"
        return f"No slip for all mu ≥ ({friction}){self._errors_text()}, with {kind}."

    @property
    def _excess(self) -> float:
        """The relative difference of the cost and its lower bound."""
        cost = self.problem.cost(self.f)
        return (cost - self.cost_bound) / self.cost_bound if self.cost_bound > 0.0 else np.inf

    def _errors_text(self) -> str:
        """Return the errors other than those of friction, in words."""
        u, parts = self.uncertainty, []
        if u.mass_error:
            parts.append(f"of the mass up to {100.0 * u.mass_error:.3g} %")
        if u.centre_of_mass_error.any():
            parts.append(f"of the centre of mass up to ({', '.join(f'{1e3 * x:.3g}' for x in u.centre_of_mass_error)}) mm")
        if len(u.wrenches) or u.wrench_ellipsoid.size:
            parts.append("of the wrench within its set")
        if u.position_error.any():
            parts.append(f"of contact places up to {1e3 * u.position_error.max():.3g} mm")
        if u.normal_error.any():
            parts.append(f"of normals up to {np.degrees(u.normal_error.max()):.3g}°")
        if u.torque_error.any():
            parts.append(f"of torques up to {100.0 * u.torque_error.max():.3g} %")
        return f", errors {', '.join(parts)}" if parts else ""

    def _largest_factor(self, guaranteed: bool) -> float:
        """Return the largest factor on all errors without slip, by bisection; 0 if the squeeze slips without errors."""
        tolerance = SLIP_TOLERANCE * max(float(np.abs(self.f).max(initial=0.0)), 1e-300)

        def holds(factor: float) -> bool:
            try:
                robust = RobustSet(_with_uncertainty(self.problem, self.uncertainty.times(factor)))
            except InvalidInput:  # more than all friction, or no reaction
                return False
            worst = worst_case(robust, self.f)
            margins = worst.guaranteed if guaranteed else worst.reached
            return float(margins.min()) >= -tolerance

        low, high = 0.0, 1.0
        while holds(high):
            low, high = high, 2.0 * high
            if high > _LARGEST_FACTOR:
                return float("inf")
        while high - low > _FACTOR_ACCURACY * high:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if holds(middle) else (low, middle)
        return low

    def __str__(self) -> str:
        return self.statement

    def to_dict(self) -> JsonRecord:
        """Return the ``robust`` record of a solution: null for numbers without bound, and for factors not computed before."""
        factors = self.error_factor if "error_factor" in vars(self) else (np.nan, np.nan)
        return {
            "statement": self.statement,
            "exact": self.is_exact,
            "cost_bound": self.cost_bound,
            "slip_margin": _finite(self.slip_margin.tolist()),
            "least_friction": _finite(self.least_friction.tolist()),
            "error_factor": _finite(factors),
        }

    @classmethod
    def from_dict(cls, record: object, field: str = "robust") -> RobustCertificate:
        """Return the certificate of a ``robust`` record. It has no problem and no forces, only the numbers of its record.

        Args:
            record: as `to_dict` returns it.
            field: its path, for error messages.

        Raises:
            InvalidInput: a field is missing, unknown or has a value that is not allowed.
        """
        names = ["statement", "exact", "cost_bound", "slip_margin", "least_friction", "error_factor"]
        values = fields.check_record(record, field, required=names)
        certificate = make_unchecked(cls, cost_bound=arrays.check_number(values["cost_bound"], f"{field}.cost_bound"))
        numbers = {}
        for name in names[3:]:
            items = fields.check_sequence(values[name], f"{field}.{name}")
            numbers[name] = arrays.check_limits(items, f"{field}.{name}", len(items), np.inf)
        holds, slips = numbers.pop("error_factor").tolist()
        vars(certificate).update(  # the values of cached properties, which would need the problem
            statement=fields.check_text(values["statement"], f"{field}.statement"),
            is_exact=fields.check_boolean(values["exact"], f"{field}.exact"),
            error_factor=(holds, slips),
            **numbers,
        )
        return certificate


def _finite(values: Iterable[float]) -> list[float | None]:
    """Return numbers with None in place of infinite and missing ones."""
    return [value if np.isfinite(value) else None for value in values]


def _with_uncertainty(problem: ForceProblem, uncertainty: Uncertainty) -> ForceProblem:
    """Return the problem with other errors."""
    p = problem
    return ForceProblem(p.contacts, p.w, p.actuation, p.cone, p.objective, p.name, p.source, uncertainty)
