"""Minimum time along a path as one cone program, and its solution.

    minimise   Σ 2 Δᵢ/(√bᵢ + √bᵢ₊₁)                      the time, exact where a is constant between knots
    subject to bᵢ₊₁ − bᵢ = Δᵢ (aᵢ + aᵢ₊₁)                 b' = 2a, a linear between knots
               b = 0 at both ends,  b ≤ cap              rest to rest, joint speeds
               G f = w₀ + w_b b + w_a a                  the object, at every knot
               load ≤ μ f_n − margin,  min ≤ f_n ≤ max   exact friction cones with what is kept back, normal forces
               lower ≤ tau₀ + tau_b b + tau_a a + Jᵀ f ≤ upper

The pseudo-inverses of G and its null spaces at the knots take G f = w and most of the forces out of the program:
f = G⁺ w + N λ. The time is made of second-order cones: cᵢ² ≤ bᵢ and
(cᵢ + cᵢ₊₁) dᵢ ≥ 1. With ``rule`` "left" a is constant between knots instead, bᵢ₊₁ − bᵢ = 2 Δᵢ aᵢ, which is of first order and
what TOPP-RA does. Verscheure et al. (2009); Lobo et al., Applications of second-order cone programming (1998).
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import sparse

from graspforce.contact.matrices import RANK_TOLERANCE, characteristic_length
from graspforce.core import fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.force.backends.clarabel import ConeSizes, solve_sparse
from graspforce.planning.path.dynamics import PathDynamics

Indices = np.ndarray[Any, np.dtype[np.intp]]

_TOLERANCE = 1e-8  # of the cone solver; the plan is checked by itself
_SCALE_RANGE = (
    0.01,
    100.0,
)  # where b, in its unit and the knots', is well scaled; elsewhere the program is solved again in b's own
_SCALINGS = 4
_ZERO_TOLERANCE = 1e-9  # of the largest: a coefficient that only rounding made
_MIDPOINT_RISE = 0.25  # of Δ (aᵢ − aᵢ₊₁): how far b's parabola rises above its chord in the middle between knots


@dataclass(frozen=True, eq=False, slots=True)
class LimitMargins:
    """What to keep back from each limit at each knot, so that what lies between knots stays inside too.

    Args:
        slip, normal: (K, N) of friction and of both normal-force limits, N.
        torque: (K, n) of both torque limits, N·m.
        speed: (K,) of b's cap, as a part of it.
    """

    slip: Array
    normal: Array
    torque: Array
    speed: Array

    @classmethod
    def none(cls, dynamics: PathDynamics, slip_margin: float = 0.0) -> LimitMargins:
        """The wanted slip margin, and nothing else."""
        (K, n), N = dynamics.tau_0.shape, 0 if dynamics.contacts is None else len(dynamics.contacts)
        return cls(np.full((K, N), slip_margin), np.zeros((K, N)), np.zeros((K, n)), np.zeros(K))


@dataclass(frozen=True, eq=False, slots=True)
class PathSolution:
    """The program's answer.

    Args:
        b, a: (K,) ṡ² and s̈ at the knots, 1/s².
        f: (K, k) contact forces, N and N·m.
        duration: of the program, s.
        gap: by what part of itself the duration could still fall, as the multipliers say, with what they leave over.
        iterations: of the solver.
        seconds: that the solver took, s.
    """

    b: Array
    a: Array
    f: Array
    duration: float
    optimality_gap: float
    iterations: int
    seconds: float


def solve(
    dynamics: PathDynamics, margins: LimitMargins, discretisation: str = "trapezoid", seconds: float = np.inf
) -> PathSolution | None:
    """The fastest motion along the path, or None where the solver found none: no verdict that there is none.

    Args:
        dynamics: the equations at the knots.
        reserve: what to keep back from the limits.
        rule: "trapezoid" (second order), or "left" (first order).
        seconds: after which each attempt of the solver ends.

    Raises:
        InvalidInput: nothing limits the motion.
    """
    fields.check_choice(discretisation, "rule", ("trapezoid", "left"))
    forces = _ForceMap.of(dynamics)
    b_unit, force_unit = _units(dynamics)
    taken = 0.0
    found: PathSolution | None = None
    for _ in range(_SCALINGS):
        found = _solved(dynamics, margins, discretisation, forces, b_unit, force_unit, seconds)
        if found is None:
            return None
        taken += found.seconds
        reached = float((found.b / np.maximum(_profile(dynamics.s), 1e-300))[1:-1].max()) / b_unit
        if _SCALE_RANGE[0] <= reached <= _SCALE_RANGE[1]:
            break
        b_unit *= reached
    assert found is not None  # _SCALINGS is not zero
    return replace(found, seconds=taken)


def _solved(
    dynamics: PathDynamics,
    margins: LimitMargins,
    discretisation: str,
    forces: _ForceMap,
    b_unit: float,
    force_unit: float,
    limit: float,
) -> PathSolution | None:
    """The program's answer in given units of b, 1/s², and of forces, N."""
    K, d = len(dynamics.s), forces.null.shape[2]
    steps = np.diff(dynamics.s)
    # x = (b, a, λ knot by knot, c, d): each divided by its unit
    rows = _ProgramRows(dynamics.s, d, b_unit, force_unit)

    _add_motion(rows, steps, discretisation)
    forces_rows = forces.unreachable
    if forces_rows is not None:
        rows.at_knots("equal", *forces_rows, None)
    _add_speed_limits(rows, dynamics, margins, steps)
    _add_torques(rows, dynamics, margins, forces)
    cone_sizes = _add_contacts(rows, dynamics, margins, forces) if dynamics.contacts is not None else ()
    _add_time(rows)

    A, right, cones = rows.stacked(cone_sizes)
    cost = np.zeros(rows.size)
    speed = np.sqrt(rows.profile)
    cost[rows.d :] = 2.0 * steps / (speed[:-1] + speed[1:])
    start = time.perf_counter()
    none = sparse.csc_matrix((rows.size, rows.size))
    answer = solve_sparse(none, cost, A, right, cones, _TOLERANCE, refine=False, seconds=limit)
    if not answer.converged:
        answer = solve_sparse(none, cost, A, right, cones, _TOLERANCE, seconds=limit)
    seconds = time.perf_counter() - start
    if not answer.converged:
        return None
    duration = float(cost @ answer.x)
    left_over = cost + answer.z @ A  # zero, but for the solver's tolerance
    optimality_gap = (abs(duration + float(right @ answer.z)) + float(np.abs(left_over) @ np.abs(answer.x))) / duration
    b, a = np.maximum(answer.x[:K], 0.0) * rows.of_b, answer.x[K : 2 * K] * b_unit
    b[[0, -1]] = 0.0
    lam = answer.x[2 * K : rows.c].reshape(K, d) * force_unit
    return PathSolution(b, a, forces.at(b, a, lam), duration / np.sqrt(b_unit), optimality_gap, answer.iterations, seconds)


def unreachable_wrench(dynamics: PathDynamics) -> Array | None:
    """The unit wrench (6,), N and N·m, that leaving the start or reaching the goal needs and no forces here make; or None."""
    if dynamics.contacts is None or _ForceMap.of(dynamics).unreachable is None:
        return None
    length = characteristic_length(dynamics.contacts)
    unit = np.array([1.0, 1.0, 1.0, length, length, length])
    G = dynamics.G[[0, -1]][:, :, dynamics.contacts.transmissible] / unit[:, None]
    needed = dynamics.w_a[[0, -1]] / unit
    made = G @ np.linalg.pinv(G, rcond=RANK_TOLERANCE) @ needed[:, :, None]
    missed = needed - made[:, :, 0]
    sizes = np.linalg.norm(missed, axis=1)
    if sizes.max() <= _ZERO_TOLERANCE * np.linalg.norm(needed, axis=1).max():
        return None
    direction = missed[int(sizes.argmax())] * unit
    return np.asarray(direction / np.linalg.norm(direction))


@dataclass(frozen=True, eq=False, slots=True)
class _ForceMap:
    """f = f_0 + f_b b + f_a a + N λ, which supplies w wherever the contacts can.

    Args:
        f_0, f_b, f_a: (K, k).
        null: N (K, k, d); a column is zero where G has a higher rank than elsewhere.
        unreachable: where some wrench directions are out of the contacts' reach, their (0, b, a) coefficients (K, r), which
            must add to zero.
    """

    f_0: Array
    f_b: Array
    f_a: Array
    null: Array
    unreachable: tuple[Array, Array, Array] | None

    @classmethod
    def of(cls, dynamics: PathDynamics) -> _ForceMap:
        K, k = dynamics.J.shape[:2]
        contacts = dynamics.contacts
        if contacts is None:
            none = np.zeros((K, 0))
            return cls(none, none, none, np.zeros((K, 0, 0)), None)
        length = characteristic_length(contacts)
        unit = np.array([1.0, 1.0, 1.0, length, length, length])  # N for a moment: N·m over m
        kept = np.flatnonzero(contacts.transmissible)
        u, sigma, v = np.linalg.svd(dynamics.G[:, :, kept] / unit[:, None])
        there = np.zeros((K, max(6, len(kept))), dtype=bool)  # which directions G makes at each knot
        there[:, : sigma.shape[1]] = sigma > RANK_TOLERANCE * sigma[:, :1]
        rank, least = int(there.sum(axis=1).max()), int(there.sum(axis=1).min())
        scale = np.where(there[:, :rank], 1.0 / np.where(there[:, :rank], sigma[:, :rank], 1.0), 0.0)
        inverse, null = np.zeros((K, k, 6)), np.zeros((K, k, len(kept) - least))
        inverse[:, kept] = (v[:, :rank].swapaxes(1, 2) * scale[:, None]) @ u[:, :, :rank].swapaxes(1, 2) / unit
        null[:, kept] = np.where(there[:, least : len(kept), None], 0.0, v[:, least:]).swapaxes(1, 2)
        ws = (dynamics.w_0, dynamics.w_b, dynamics.w_a)
        outside = np.where(there[:, None, least:6], 0.0, u[:, :, least:])
        missed = [((w / unit)[:, None] @ outside)[:, 0] for w in ws]  # N
        largest = [float(np.abs(w / unit).max()) for w in ws]
        met = all(float(np.abs(m).max(initial=0.0)) <= _ZERO_TOLERANCE * most for m, most in zip(missed, largest, strict=True))
        unreachable = None if met else (missed[0], missed[1], missed[2])
        f_0, f_b, f_a = ((inverse @ w[:, :, None])[:, :, 0] for w in ws)
        return cls(f_0, f_b, f_a, null, unreachable)

    def at(self, b: Array, a: Array, lam: Array) -> Array:
        """(K, k)."""
        free = (self.null @ lam[:, :, None])[:, :, 0]
        return np.asarray(self.f_0 + self.f_b * b[:, None] + self.f_a * a[:, None] + free)


class _ProgramRows:
    """The rows of the program under construction, each held as value − A x in a cone; array operations only."""

    def __init__(self, s: Array, d: int, b_unit: float, force_unit: float) -> None:
        K = len(s)
        self.K, self.b_unit, self.force_unit = K, b_unit, force_unit
        self.profile = _profile(s)
        self.of_b = b_unit * np.where(self.profile > 0.0, self.profile, 1.0)  # each knot's own unit of b, 1/s²
        self.lam = 2 * K + d * np.arange(K)[:, None] + np.arange(d)  # where each knot's λ stand
        self.c = 2 * K + K * d
        self.d = self.c + K - 2
        self.size = self.d + K - 1
        self._parts: dict[str, list[tuple[sparse.coo_matrix, Array]]] = {"equal": [], "least": [], "cone": []}

    def add(self, kind: str, row: Indices, column: Indices, value: Array, right: Array) -> None:
        """Rows by their entries."""
        entries = (np.ravel(value), (np.ravel(row), np.ravel(column)))
        self._parts[kind].append((sparse.coo_matrix(entries, shape=(len(right), self.size)), right))

    def at_knots(self, kind: str, zero: Array, per_b: Array, per_a: Array, per_lam: Array | None) -> None:
        """zero + per_b b + per_a a + per_lam λ in the cone, r rows a knot: (K, r) each, per_lam (K, r, d)."""
        K, r = zero.shape
        row = np.arange(K * r).reshape(K, r)
        knot = np.broadcast_to(np.arange(K)[:, None], (K, r))
        rows, columns, values = [row, row], [knot, knot + K], [-self.of_b[:, None] * per_b, -self.b_unit * per_a]
        if per_lam is not None and per_lam.size:
            shape = per_lam.shape
            rows.append(np.broadcast_to(row[:, :, None], shape))
            columns.append(np.broadcast_to(self.lam[:, None], shape))
            values.append(-self.force_unit * per_lam)
        flat = [np.concatenate([np.ravel(each) for each in part]) for part in (rows, columns, values)]
        there = flat[2] != 0.0
        self.add(kind, flat[0][there], flat[1][there], flat[2][there], zero.ravel())

    def stacked(self, force_cones: tuple[int, ...]) -> tuple[sparse.csc_matrix, Array, ConeSizes]:
        """All rows, in the order in which Clarabel wants the cones."""
        parts = [part for kind in ("equal", "least", "cone") for part in self._parts[kind]]
        A = sparse.vstack([matrix for matrix, _ in parts], format="csc")
        count = {kind: sum(len(right) for _, right in found) for kind, found in self._parts.items()}
        time_cones = (count["cone"] - sum(force_cones)) // 3
        cones = ConeSizes(count["equal"], count["least"], force_cones + (3,) * time_cones)
        return A, np.concatenate([right for _, right in parts]), cones


def _profile(s: Array) -> Array:
    """(K,) what b goes by where a is constant but for its sign halfway, of order 1: the knots' own units of b."""
    profile = 4.0 * s * (1.0 - s)
    profile[[0, -1]] = 0.0
    return np.asarray(profile)


def _units(dynamics: PathDynamics) -> tuple[float, float]:
    """What b and a, 1/s², and forces, N, are divided by: the largest b for which no single term exceeds its limit."""
    half = (dynamics.upper - dynamics.lower) / 2.0  # N·m
    terms = [np.abs(tau) / half for tau in (dynamics.tau_a, dynamics.tau_b)]  # s²
    force = 1.0  # N
    if dynamics.contacts is not None:
        limits = dynamics.contacts.max_normal[np.isfinite(dynamics.contacts.max_normal)]
        levers = np.sqrt((dynamics.J**2).mean(axis=(0, 1)))  # m, of each joint
        strengths = [*limits[limits > 0], *(half[levers > 0] / levers[levers > 0])]  # N
        if not strengths:
            raise InvalidInput("max_normal", None, "given at some contact: without a hand nothing else bounds the forces")
        force = float(np.median(strengths))
        length = characteristic_length(dynamics.contacts)
        unit = np.array([1.0, 1.0, 1.0, length, length, length])
        terms += [np.abs(w) / unit / force for w in (dynamics.w_a, dynamics.w_b)]  # s²
    terms.append(1.0 / dynamics.b_max)
    largest = max(float(term.max(initial=0.0)) for term in terms)
    if largest == 0.0:
        raise InvalidInput("path", "no motion", "a path along which something moves, with limits that bound it")
    return 1.0 / largest, force


def _add_motion(rows: _ProgramRows, steps: Array, discretisation: str) -> None:
    """b = 0 at both ends, and b' = 2a between."""
    K = rows.K
    i = np.arange(K - 1)
    ends = np.array([0, K - 1])
    rows.add("equal", np.arange(2), ends, np.ones(2), np.zeros(2))
    left, right = (steps, steps) if discretisation == "trapezoid" else (2.0 * steps, 0.0 * steps)
    columns = np.stack([i + 1, i, K + i, K + i + 1])
    b = rows.of_b / rows.b_unit
    unit = np.maximum(b[1:], b[:-1])
    values = np.stack([b[1:], -b[:-1], -left, -right]) / unit
    rows.add("equal", np.tile(i, (4, 1)), columns, values, np.zeros(K - 1))


def _add_speed_limits(rows: _ProgramRows, dynamics: PathDynamics, margins: LimitMargins, steps: Array) -> None:
    """b ≤ cap at the knots, and in the middle between them, where b is (bᵢ + bᵢ₊₁)/2 + Δ (aᵢ − aᵢ₊₁)/4."""
    K = rows.K
    at = np.flatnonzero(np.isfinite(dynamics.b_max[1:-1])) + 1
    b_max = dynamics.b_max * (1.0 - margins.speed) / rows.of_b
    rows.add("least", np.arange(len(at)), at, 1.0 / b_max[at], np.ones(len(at)))
    i = np.flatnonzero(np.isfinite(dynamics.b_max_between))
    share = np.maximum(margins.speed[i], margins.speed[i + 1])
    b_max = dynamics.b_max_between[i] * (1.0 - share) / rows.b_unit
    b, rise = rows.of_b / rows.b_unit, _MIDPOINT_RISE * steps[i]
    values = np.stack([b[i] / 2.0, b[i + 1] / 2.0, rise, -rise]) / b_max
    rows.add("least", np.tile(np.arange(len(i)), (4, 1)), np.stack([i, i + 1, K + i, K + i + 1]), values, np.ones(len(i)))


def _add_torques(rows: _ProgramRows, dynamics: PathDynamics, margins: LimitMargins, forces: _ForceMap) -> None:
    """Both torque limits of every joint that anything loads, each over its half range."""
    loads = [
        tau + np.einsum("ikn,ik->in", dynamics.J, f)
        for tau, f in ((dynamics.tau_0, forces.f_0), (dynamics.tau_b, forces.f_b), (dynamics.tau_a, forces.f_a))
    ]
    per_lam = dynamics.J.swapaxes(1, 2) @ forces.null
    varies = [np.abs(term).max(axis=0, initial=0.0) for term in (loads[1], loads[2], per_lam.max(axis=2, initial=0.0))]
    moved = np.flatnonzero(np.maximum.reduce(varies) > 0.0)
    half = ((dynamics.upper - dynamics.lower) / 2.0)[moved]  # N·m
    zero, per_b, per_a = (load[:, moved] / half for load in loads)
    per_lam = per_lam[:, moved] / half[:, None]
    kept = margins.torque[:, moved]
    rows.at_knots("least", (dynamics.upper[moved] - kept) / half - zero, -per_b, -per_a, -per_lam)
    rows.at_knots("least", zero - (dynamics.lower[moved] + kept) / half, per_b, per_a, per_lam)


def _add_contacts(rows: _ProgramRows, dynamics: PathDynamics, margins: LimitMargins, forces: _ForceMap) -> tuple[int, ...]:
    """Normal-force limits and friction cones; returns the cones' dimensions."""
    contacts = dynamics.contacts
    assert contacts is not None
    unit, normal = rows.force_unit, contacts.normal_rows
    held = [np.flatnonzero((contacts.min_normal > 0) | (contacts.mu == 0.0)), np.flatnonzero(np.isfinite(contacts.max_normal))]
    for sign, chosen, limit in ((1.0, held[0], contacts.min_normal), (-1.0, held[1], contacts.max_normal)):
        select = np.zeros((len(chosen), contacts.size))
        select[np.arange(len(chosen)), normal[chosen]] = sign / unit
        kept = (sign * limit[chosen] + margins.normal[:, chosen]) / unit
        _add_force_rows(rows, "least", select, forces, -kept)
    twisting = np.flatnonzero((contacts.mu == 0.0) & (contacts.gamma > 0.0))  # a moment alone: |m_n| ≤ γ f_n
    for sign in (1.0, -1.0):
        select = np.zeros((len(twisting), contacts.size))
        select[np.arange(len(twisting)), normal[twisting]] = 1.0 / unit
        select[np.arange(len(twisting)), normal[twisting] + 1] = sign / (contacts.gamma[twisting] * unit)
        _add_force_rows(rows, "least", select, forces, np.zeros((rows.K, len(twisting))))
    blocks, sizes, slip_margins = [], [], []
    for i in np.flatnonzero(contacts.mu > 0.0):
        n, twist = normal[i], contacts.gamma[i] > 0.0
        block = np.zeros((4 if twist else 3, contacts.size))
        block[[0, 1, 2], [n, n - 2, n - 1]] = np.array([contacts.mu[i], 1.0, 1.0]) / unit
        if twist:
            block[3, n + 1] = contacts.mu[i] / (contacts.gamma[i] * unit)
        blocks.append(block)
        sizes.append(len(block))
        slip_margins.append(np.column_stack([margins.slip[:, i] / unit, np.zeros((rows.K, len(block) - 1))]))
    if blocks:
        _add_force_rows(rows, "cone", np.vstack(blocks), forces, -np.hstack(slip_margins))
    return tuple(sizes) * rows.K


def _add_force_rows(rows: _ProgramRows, kind: str, select: Array, forces: _ForceMap, zero: Array) -> None:
    """select f + zero in the cone, at every knot."""
    if len(select):
        rows.at_knots(kind, zero + forces.f_0 @ select.T, forces.f_b @ select.T, forces.f_a @ select.T, select @ forces.null)


def _add_time(rows: _ProgramRows) -> None:
    """cᵢ² ≤ bᵢ as ‖(2c, b − 1)‖ ≤ b + 1, and (cᵢ + cᵢ₊₁) dᵢ ≥ 1 as ‖(2, c + c⁺ − d)‖ ≤ c + c⁺ + d, in knots' own units.

    At rest b and c are zero, so the ends have no c: their cones would have no inside.
    """
    K, size = rows.K, np.sqrt(rows.profile)
    i, inner = np.arange(K - 2), np.arange(1, K - 1)
    one = np.ones(K - 2)
    rows.add(
        "cone",
        np.concatenate([3 * i, 3 * i + 1, 3 * i + 2]),
        np.concatenate([inner, rows.c + i, inner]),
        np.concatenate([-one, -2.0 * one, -one]),
        np.tile([1.0, 0.0, -1.0], K - 2),
    )
    unit = size[:-1] + size[1:]  # of c + c⁺, and over 1 of d
    j = np.arange(K - 1)
    left, right, every = j[1:], j[:-1], np.ones(K - 1)  # intervals that have a c on that side
    before, after = size[:-1][left] / unit[left], size[1:][right] / unit[right]
    rows.add(
        "cone",
        np.concatenate([3 * left, 3 * right, 3 * j, 3 * left + 2, 3 * right + 2, 3 * j + 2]),
        np.concatenate([rows.c + left - 1, rows.c + right, rows.d + j] * 2),
        np.concatenate([-before, -after, -every, -before, -after, every]),
        np.tile([0.0, 2.0, 0.0], K - 1),
    )
