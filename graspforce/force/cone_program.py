"""A force problem as a cone program in standard form, in units of its own, for general solvers.

    minimise   ½ xᵀ P x + qᵀ x
    subject to A x = b,   C x ≤ d,   (r − S x) in second-order cones, one after another

x holds the force components that can be nonzero, divided by a force unit (moments by force times length). For the objectives
"max_normal" and "margin" the last variable is the level t or s. Every row is divided by its own unit, so that a solver's
absolute tolerances mean the same for every problem. `ConicProgram.forces` and `ConicProgram.multipliers` return to SI units.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from graspforce.contact import friction
from graspforce.contact.contact import ContactSet
from graspforce.core.arrays import Array
from graspforce.force.multipliers import Multipliers
from graspforce.force.problem import ForceProblem
from graspforce.force.scale import joint_lever_arms, scale
from graspforce.force.status import Status

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False, slots=True)
class LimitRow:
    """The limit that one scaled linear row states.

    Args:
        kind: "normal", "torque" or "level": the kind of limit.
        index: index of the contact or joint.
        sign: +1 for a lower limit, −1 for an upper limit, 0 for equal limits (an equality row).
        unit: unit of the row, N or N·m.
    """

    kind: str
    index: int
    sign: int
    unit: float


@dataclass(frozen=True, eq=False, slots=True)
class ConicProgram:
    """The standard form of a force problem, and the units to return from it.

    Args:
        P: (m, m) Hessian of the cost.
        q: (m,) gradient of the cost at zero.
        A: (e, m) equality rows: six of equilibrium, then pairs of equal limits.
        b: (e,) right sides of A.
        C: (i, m) inequality rows.
        d: (i,) right sides of C.
        S: (c, m) rows of the second-order cones.
        r: (c,) right sides of S.
        cones: dimension of each second-order cone.
        limits: the limits of the rows of A from the seventh on, then of the rows of C; None for a facet of a friction cone.
        problem: the force problem.
        component_indices: (m or m − 1,) indices of the stacked components that x holds.
        units: (k,) unit of each stacked component, N or N·m.
        wrench_units: (6,) units of the equilibrium rows, N and N·m.
        cost_unit: unit of the cost.
    """

    P: Array
    q: Array
    A: Array
    b: Array
    C: Array
    d: Array
    S: Array
    r: Array
    cones: tuple[int, ...]
    limits: tuple[LimitRow | None, ...]
    problem: ForceProblem
    component_indices: Indices
    units: Array
    wrench_units: Array
    cost_unit: float

    def forces(self, x: Array) -> Array:
        """Return (k,) the stacked contact forces, N and N·m.

        Args:
            x: (m,) the variables of the program.
        """
        f = np.zeros(self.problem.size)
        f[self.component_indices] = x[: len(self.component_indices)] * self.units[self.component_indices]
        return f

    def variables(self, f: Array) -> Array:
        """Return (m,) the variables of stacked contact forces, a start for a solver.

        Args:
            f: (k,) stacked contact forces, N and N·m.
        """
        x = f[self.component_indices] / self.units[self.component_indices]
        if len(x) == len(self.q):
            return np.asarray(x)
        return np.append(x, self.problem.cost(f) / self.units[self.problem.contacts.normal_rows[0]])  # the level t or s

    def multipliers(self, y: Array, z: Array) -> Multipliers:
        """Return the multipliers in SI units, about the contacts' centroid.

        Args:
            y: (e,) multipliers of A x = b, with the sign of the stationarity P x + q = Aᵀ y − Cᵀ z + ….
            z: (i,) multipliers of C x ≤ d, ≥ 0.
        """
        contacts, actuation = self.problem.contacts, self.problem.actuation
        n = 0 if actuation is None else actuation.J.shape[1]
        normal, torque, level = np.zeros((2, len(contacts))), np.zeros((2, n)), np.zeros(len(contacts))
        for limit, scaled in zip(self.limits, [*y[6:], *z], strict=True):
            if limit is None:
                continue
            value = float(scaled) * self.cost_unit / limit.unit
            if limit.kind == "level":
                level[limit.index] = value
                continue
            both = normal if limit.kind == "normal" else torque
            upper = limit.sign < 0 or (limit.sign == 0 and value < 0)
            both[int(upper), limit.index] = abs(value) if limit.sign == 0 else value
        equilibrium = y[:6] * self.cost_unit / self.wrench_units
        return Multipliers(equilibrium, normal[0], normal[1], torque[0], torque[1], level, contacts.centroid)


@dataclass(frozen=True, eq=False, slots=True)
class ConicResult:
    """Result of a solver for cone programs, as the solver reports it.

    Args:
        status: optimal if x is finite, infeasible if the solver claims it (y and z are then a ray of the dual), or failed.
        converged: the solver reports convergence; otherwise x, y and z are its last iterate.
        x: (m,) the variables.
        y: (e,) multipliers of A x = b.
        z: (i,) multipliers of C x ≤ d, ≥ 0.
        iterations: iterations of the solver.
    """

    status: Status
    converged: bool
    x: Array
    y: Array
    z: Array
    iterations: int


class ConicSolver(Protocol):
    """A function that solves cone programs."""

    def __call__(self, program: ConicProgram, time_limit: float | None = None) -> ConicResult:
        """Return the result of a program.

        Args:
            program: the program.
            time_limit: time after which the solver stops, s, > 0; the result is then not converged.
        """


def conic_program(problem: ForceProblem) -> ConicProgram:
    """Return the standard form of a force problem.

    Components that a zero friction coefficient forces to zero are left out. A contact whose largest normal force is zero
    keeps its normal component only: its cone has no interior, which interior-point methods need.

    Args:
        problem: the force problem.
    """
    contacts, kind = problem.contacts, problem.objective.type
    unit = scale(problem)
    force, length = float(unit.force), unit.length  # N, m
    units = force * problem.component_units  # N, N·m
    component_indices = np.flatnonzero(contacts.transmissible)
    extra = int(kind in ("max_normal", "margin"))
    size = len(component_indices) + extra
    wrench_units = force * np.array([1.0, 1.0, 1.0, length, length, length])  # N, N·m

    P, q, cost_unit = _cost(problem, units, component_indices, size)
    rows = _RowBuilder(size)
    G, w = problem.G_centred, problem.w_centred
    balance = np.zeros((6, size))
    balance[:, : len(component_indices)] = G[:, component_indices] * units[component_indices] / wrench_units[:, None]
    for row in balance:
        rows.add_equality(row)
    _add_normal_limits(rows, problem, component_indices, force)
    _add_torque_limits(rows, problem, units, component_indices, joint_lever_arms(problem) > 0)
    _add_cones(rows, problem, units, component_indices, force)
    if kind == "max_normal":
        for i, column in _normal_columns(contacts, component_indices):
            rows.add_upper_bound(_row(size, {column: 1.0, size - 1: -1.0}), 0.0, LimitRow("level", i, 1, force))
    if kind == "margin":
        rows.add_upper_bound(_row(size, {size - 1: -1.0}), 0.0, None)
    b = np.concatenate([w / wrench_units, rows.equal_values])
    return ConicProgram(
        P=P,
        q=q,
        A=np.array(rows.equalities),
        b=b,
        C=np.array(rows.inequalities).reshape(-1, size),
        d=np.array(rows.bounds, dtype=np.float64),
        S=np.array(rows.cone_rows).reshape(-1, size),
        r=np.zeros(len(rows.cone_rows)),
        cones=tuple(rows.cones),
        limits=(*rows.equal_limits, *rows.limits),
        problem=problem,
        component_indices=component_indices,
        units=units,
        wrench_units=wrench_units,
        cost_unit=cost_unit,
    )


class _RowBuilder:
    """The rows of a program under construction."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.equalities: list[Array] = []
        self.equal_values: list[float] = []
        self.equal_limits: list[LimitRow] = []
        self.inequalities: list[Array] = []
        self.bounds: list[float] = []
        self.limits: list[LimitRow | None] = []
        self.cone_rows: list[Array] = []
        self.cones: list[int] = []

    def add_equality(self, row: Array, value: float | None = None, limit: LimitRow | None = None) -> None:
        """Add row·x = value; without a value the caller knows the right side."""
        self.equalities.append(row)
        if limit is not None and value is not None:
            self.equal_values.append(value)
            self.equal_limits.append(limit)

    def add_upper_bound(self, row: Array, bound: float, limit: LimitRow | None) -> None:
        """Add row·x ≤ bound."""
        self.inequalities.append(row)
        self.bounds.append(bound)
        self.limits.append(limit)

    def add_interval(self, row: Array, lower: float, upper: float, kind: str, index: int, unit: float) -> None:
        """Add lower ≤ row·x ≤ upper: one equality if the limits are equal. Rows with a large limit are divided by it."""
        if lower == upper:
            self.add_equality(row, lower, LimitRow(kind, index, 0, unit))
            return
        for sign, bound in ((1, lower), (-1, upper)):
            if np.isfinite(bound):
                size = max(1.0, abs(bound))
                self.add_upper_bound(-sign * row / size, -sign * bound / size, LimitRow(kind, index, sign, unit * size))


def _cost(problem: ForceProblem, units: Array, component_indices: Indices, size: int) -> tuple[Array, Array, float]:
    """Return P, q and the unit of the cost: the mean of the Hessian's diagonal, or the largest linear term."""
    contacts, actuation, kind = problem.contacts, problem.actuation, problem.objective.type
    P, q, m = np.zeros((size, size)), np.zeros(size), len(component_indices)
    u, force_weights = units[component_indices], problem.force_weights[component_indices]
    if kind == "force":
        P[:m, :m] = np.diag(force_weights * u**2)
    elif kind == "torque":
        assert actuation is not None  # validated by ForceProblem
        lever = actuation.J[component_indices] * u[:, None]  # N·m
        P[:m, :m] = (lever * actuation.weight) @ lever.T + problem.objective.force_weight * np.diag(force_weights * u**2)
        q[:m] = lever @ (actuation.weight * actuation.tau_u)
    elif kind == "sum_normal":
        for _, column in _normal_columns(contacts, component_indices):
            q[column] = u[column]
    else:
        q[-1] = units[0] if kind == "max_normal" else -units[0]
    cost_unit = float(np.trace(P)) / size or float(np.abs(q).max(initial=0.0)) or 1.0
    return P / cost_unit, q / cost_unit, cost_unit


def _normal_columns(contacts: ContactSet, component_indices: Indices) -> list[tuple[int, int]]:
    """Return the pairs (contact, column of its normal force in x) of the contacts with a variable."""
    return [
        (int(contacts.columns[row] // 4), column)
        for column, row in enumerate(component_indices)
        if contacts.columns[row] % 4 == friction.F_N
    ]


def _row(size: int, entries: dict[int, float]) -> Array:
    """Return a row with the given entries by column, and zeros."""
    row = np.zeros(size)
    for column, value in entries.items():
        row[column] = value
    return row


def _add_normal_limits(rows: _RowBuilder, problem: ForceProblem, component_indices: Indices, force: float) -> None:
    """Add min ≤ f_n ≤ max, without f_n ≥ 0 where a friction cone implies it."""
    contacts = problem.contacts
    for i, column in _normal_columns(contacts, component_indices):
        lower, upper = contacts.min_normal[i] / force, contacts.max_normal[i] / force
        if lower == 0.0 < upper and (contacts.mu[i] > 0 or contacts.gamma[i] > 0):
            lower = -np.inf
        rows.add_interval(_row(rows.size, {column: 1.0}), lower, upper, "normal", i, force)


def _add_torque_limits(
    rows: _RowBuilder,
    problem: ForceProblem,
    units: Array,
    component_indices: Indices,
    loaded: np.ndarray[tuple[int], np.dtype[np.bool_]],
) -> None:
    """Add lower − tau_u ≤ Jᵀ f ≤ upper − tau_u, with each joint's row divided by its norm."""
    actuation = problem.actuation
    if actuation is None:
        return
    lever = np.zeros((len(actuation.tau_u), rows.size))
    lever[loaded, : len(component_indices)] = (
        actuation.J[np.ix_(component_indices, loaded)] * units[component_indices][:, None]
    ).T  # N·m
    lengths = np.sqrt((lever**2).sum(axis=1))  # N·m
    longest = float(lengths.max(initial=0.0))
    # a joint without load: its bias torque is the unit
    own = np.where(loaded, lengths, np.maximum(np.abs(actuation.tau_u), longest))  # N·m
    own[own == 0.0] = 1.0
    lever /= own[:, None]
    lower, upper = (actuation.lower - actuation.tau_u) / own, (actuation.upper - actuation.tau_u) / own
    for j, row in enumerate(lever):
        rows.add_interval(row, float(lower[j]), float(upper[j]), "torque", j, float(own[j]))


def _add_cones(
    rows: _RowBuilder,
    problem: ForceProblem,
    units: Array,
    component_indices: Indices,
    force: float,
) -> None:
    """Add the friction cones; for "margin" ‖f_t‖ ≤ μ f_n − s."""
    contacts, cone = problem.contacts, problem.cone
    column_of = {int(contacts.columns[row]): column for column, row in enumerate(component_indices)}
    margin = problem.objective.type == "margin"
    for i, normal in _normal_columns(contacts, component_indices):
        mu, gamma = float(contacts.mu[i]), float(contacts.gamma[i])
        mu_facet = mu if cone.type == "exact" else float(friction.pyramid_friction(np.asarray(mu), cone.facets, cone.side))
        t1, t2, moment = (column_of.get(4 * i + c) for c in (friction.F_T1, friction.F_T2, friction.M_N))
        if t1 is None or t2 is None:
            if moment is not None:  # no tangential friction: |m_n| ≤ γ f_n
                lever = units[component_indices[moment]] / (gamma * force)  # 1
                for sign in (1.0, -1.0):
                    rows.add_upper_bound(_row(rows.size, {moment: sign * lever, normal: -1.0}), 0.0, None)
            if margin and mu > 0:  # a contact without tangential variables: s ≤ μ f_n
                rows.add_upper_bound(_row(rows.size, {normal: -mu_facet, rows.size - 1: 1.0}), 0.0, None)
            continue
        if cone.type == "exact":
            cone_head = {normal: -mu, rows.size - 1: 1.0} if margin else {normal: -mu}
            block = [_row(rows.size, cone_head), _row(rows.size, {t1: -1.0}), _row(rows.size, {t2: -1.0})]
            if moment is not None:
                block.append(_row(rows.size, {moment: -mu * units[component_indices[moment]] / (gamma * force)}))
            rows.cone_rows += block
            rows.cones.append(len(block))
            continue
        for a in friction.pyramid_facets(cone.facets, cone.side, gamma):
            entries = {t1: a[0], t2: a[1], normal: -mu_facet}
            if moment is not None:
                entries[moment] = a[2] * mu_facet * units[component_indices[moment]] / (gamma * force)
            if margin:
                entries[rows.size - 1] = 1.0
            rows.add_upper_bound(_row(rows.size, entries), 0.0, None)
