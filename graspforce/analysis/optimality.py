"""The optimality conditions of a force problem at an optimum with a known active set, and their Jacobian.

With the constraints that the optimum uses as equations, the optimum solves a smooth system F(x, θ) = 0:

    ∇cost(f) − Gᵀ y + Aᵀ α = 0,     G f = w,     a_j(f) = 0 for each active limit,

with x = (f, y, α) and the data θ. An active limit is a friction cone g(f) = √(‖f_t‖²/μ² + m_n²/γ²) − f_n, a normal force at a
limit, a motor torque at a limit, or a component that is zero at the apex of its cone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.contact import friction
from graspforce.core.arrays import Array
from graspforce.force.certificate import cost_gradient, multiplier_gradient
from graspforce.force.degeneracy import NO_SOLUTION, NOT_UNIQUE, undecided_cone, undecided_limit
from graspforce.force.multipliers import Multipliers
from graspforce.force.problem import ForceProblem
from graspforce.force.scale import scale
from graspforce.force.solution import Solution

# A limit whose slack and multiplier are both below this fraction of their units may be active or not. Interior-point methods
# end with slack · multiplier of 1e-9 and less, which makes both some 3e-5 at a degenerate optimum.
_UNDECIDED = 1e-4
_NEWTON_STEPS = 8
_CONVERGED = 1e-15  # of the conditions, relative to their terms: no further step
_RESIDUAL = 1e-9  # of the conditions after Newton's method, relative to their terms
_LARGEST_CONDITION = 1e11  # of the scaled Jacobian; beyond it the optimum is not unique, or its limits depend on each other


@dataclass(frozen=True, slots=True)
class ActiveLimit:
    """A limit that holds as an equation.

    Args:
        kind: "cone", "normal", "torque" or "zero".
        index: index of the contact, of the joint, or for "zero" of the stacked component.
        side: −1 at a lower limit, +1 at an upper one; 0 otherwise.
    """

    kind: str
    index: int
    side: int = 0


@dataclass(frozen=True, eq=False, slots=True)
class Optimum:
    """An optimum, refined by Newton's method, and the factors of its conditions.

    Args:
        problem: the force problem.
        f: (k,) forces, N and N·m.
        y: (6,) multipliers of equilibrium about the contacts' centroid.
        alpha: multipliers of the active limits.
        active: the active limits.
        jacobian: ∂F/∂x, symmetric.
        undecided: reasons why the active set or the optimum is not unique; empty if derivatives exist.
    """

    problem: ForceProblem
    f: Array
    y: Array
    alpha: Array
    active: tuple[ActiveLimit, ...]
    jacobian: Array
    undecided: tuple[str, ...]


def find_optimum(solution: Solution) -> Optimum:
    """Return the refined optimum of a certified solution, with its active set.

    Args:
        solution: a solution with forces and multipliers, of the objective "torque", "force" or "sum_normal" with exact cones.
    """
    problem, multipliers = solution.original_problem, solution.multipliers
    assert multipliers is not None  # checked by the caller
    m = multipliers.about(problem.contacts.centroid)
    active, alpha, undecided = _active_limits(problem, solution.f, m)
    f, y = solution.f.copy(), m.y.copy()
    start = (f, y, alpha)
    size, k, root = _unit_sizes(problem, active), len(f), float(np.sqrt(scale(problem).cost))
    for _ in range(_NEWTON_STEPS):
        scaled = size[:, None] * conditions_jacobian(problem, f, alpha, active) * size
        residual = size * _conditions(problem, f, y, alpha, active)
        if undecided or np.abs(residual).max() <= _CONVERGED * root:
            break
        step = -size * np.linalg.lstsq(scaled, residual, rcond=1e-14)[0]
        f, y, alpha = f + step[:k], y + step[k : k + 6], alpha + step[k + 6 :]
    jacobian = scaled / size[:, None] / size
    worst = float(np.abs(residual).max()) / root
    if not undecided and not np.isfinite(worst):
        undecided = (NO_SOLUTION,)
    if not undecided and np.linalg.cond(scaled) > _LARGEST_CONDITION:
        undecided = (NOT_UNIQUE,)
    if not undecided and (worst > _RESIDUAL or _leaves_limits(problem, f, alpha, active)):
        undecided = (NO_SOLUTION,)
    if undecided:  # Newton's method may have diverged
        f, y, alpha = start
        jacobian = conditions_jacobian(problem, f, alpha, active)
    return Optimum(problem, f, y, alpha, active, jacobian, undecided)


def _unit_sizes(problem: ForceProblem, active: tuple[ActiveLimit, ...]) -> Array:
    """Return the sizes of x by which F and its Jacobian become dimensionless: S ∂F/∂x S."""
    unit = scale(problem)
    root = float(np.sqrt(unit.cost))  # of the cost, so that S ∂²cost S is of order one
    forces = unit.force * problem.component_units / root
    lengths = np.array([1.0, 1.0, 1.0, unit.length, unit.length, unit.length])
    limits = [1.0 / float(unit.torque[a.index]) if a.kind == "torque" else 1.0 / unit.force for a in active]
    units = [problem.component_units[a.index] if a.kind == "zero" else 1.0 for a in active]
    return np.concatenate([forces, root / (unit.force * lengths), root * np.array(limits) / np.array(units)])


def _active_limits(problem: ForceProblem, f: Array, m: Multipliers) -> tuple[tuple[ActiveLimit, ...], Array, tuple[str, ...]]:
    """Return the active limits, their multipliers, and the limits that may be active or not."""
    contacts, found = problem.contacts, _ActiveSet(problem)
    rough = (contacts.mu > 0.0) | (contacts.gamma > 0.0)
    implied = rough & (contacts.min_normal == 0.0)  # f_n ≥ 0 follows from the cone
    z = cost_gradient(problem, f, m) - multiplier_gradient(problem, m)
    z[contacts.normal_rows] += np.where(implied, m.normal_lower, 0.0)
    for row in np.flatnonzero(~contacts.transmissible):
        found.add(ActiveLimit("zero", int(row)), float(-z[row]))
    padded_f, padded_z = contacts.pad(f), contacts.pad(z)
    for contact in np.flatnonzero(rough).tolist():
        found.add_cone(contact, padded_f[contact], padded_z[contact])
    below = np.where(implied, np.inf, padded_f[:, friction.F_N] - contacts.min_normal)
    lower = np.where(implied, 0.0, m.normal_lower + np.where(rough, 0.0, padded_z[:, friction.F_N]))
    above = contacts.max_normal - padded_f[:, friction.F_N]
    for i in range(len(contacts)):
        found.add_interval("normal", i, (below[i], above[i]), (lower[i], m.normal_upper[i]), found.unit.force)
    if problem.actuation is not None:
        tau, a = problem.torques(f), problem.actuation
        for j, size in enumerate(found.unit.torque.tolist()):
            slack = (tau[j] - a.lower[j], a.upper[j] - tau[j])
            found.add_interval("torque", j, slack, (m.torque_lower[j], m.torque_upper[j]), size)
    return tuple(found.limits), np.array(found.multipliers), tuple(found.undecided)


class _ActiveSet:
    """The active limits under construction, their multipliers in Aᵀ α, and the limits that may be active or not."""

    def __init__(self, problem: ForceProblem) -> None:
        self.problem = problem
        self.unit = scale(problem)
        self.limits: list[ActiveLimit] = []
        self.multipliers: list[float] = []
        self.undecided: list[str] = []

    def add(self, limit: ActiveLimit, multiplier: float) -> None:
        """Add an active limit."""
        self.limits.append(limit)
        self.multipliers.append(multiplier)

    def add_interval(
        self, kind: str, index: int, slack: tuple[float, float], multiplier: tuple[float, float], unit: float
    ) -> None:
        """Add the active side of a lower and an upper limit, whose slack has a unit, or name it as undecided."""
        if slack[0] + slack[1] <= 0.0:  # equal limits
            self.add(ActiveLimit(kind, index, 1), multiplier[1] - multiplier[0])
            return
        for side in (0, 1):
            room, price = slack[side] / unit, multiplier[side] * unit / self.unit.cost
            if max(room, price) < _UNDECIDED:
                self.undecided.append(undecided_limit(("lower", "upper")[side], kind, index))
            elif price > room:
                self.add(ActiveLimit(kind, index, (-1, 1)[side]), (-multiplier[0], multiplier[1])[side])

    def add_cone(self, i: int, f: Array, z: Array) -> None:
        """Add the cone of contact i if its force is on the surface, or its components if it is at the apex."""
        mu, gamma = float(self.problem.contacts.mu[i]), float(self.problem.contacts.gamma[i])
        force, unit_price = self.unit.force, self.unit.cost / self.unit.force
        room = (f[friction.F_N] - _used(f, mu, gamma)) / force
        normal, price = f[friction.F_N] / force, z[friction.F_N] / unit_price
        inside_dual = price - float(np.hypot(mu * np.hypot(z[0], z[1]), gamma * z[friction.M_N])) / unit_price
        if room > price and room > _UNDECIDED:
            return
        if normal < _UNDECIDED and inside_dual > max(_UNDECIDED, normal):
            for row, column in _component_rows(self.problem, i):
                self.add(ActiveLimit("zero", row), float(-z[column]))
        elif normal >= _UNDECIDED and price > _UNDECIDED and mu > 0.0:
            self.add(ActiveLimit("cone", i), float(z[friction.F_N]))
        else:
            self.undecided.append(undecided_cone(i))


def _component_rows(problem: ForceProblem, i: int) -> list[tuple[int, int]]:
    """Return (stacked row, padded column) of the components of contact i that friction can transmit."""
    columns = problem.contacts.columns
    return [(int(row), int(columns[row]) % 4) for row in np.flatnonzero((columns // 4 == i) & problem.contacts.transmissible)]


def _used(f: Array, mu: float, gamma: float) -> float:
    """Return √(‖f_t‖²/μ² + m_n²/γ²), N."""
    torsion = f[friction.M_N] / gamma if gamma > 0.0 else 0.0
    return float(np.hypot(np.hypot(f[0], f[1]) / mu if mu > 0.0 else 0.0, torsion))


def cone_derivatives(problem: ForceProblem, i: int, f: Array) -> tuple[list[int], Array, Array, float, Array]:
    """Return the derivatives of g(f) = √(‖f_t‖²/μ² + m_n²/γ²) − f_n of contact i.

    Args:
        problem: the force problem.
        i: index of the contact.
        f: (k,) stacked forces.

    Returns:
        The stacked rows of the contact, ∇g, ∇²g, ∂g/∂μ and ∂∇g/∂μ over these rows.
    """
    pairs = _component_rows(problem, i)
    rows, columns = [row for row, _ in pairs], np.array([c for _, c in pairs])
    mu, gamma = float(problem.contacts.mu[i]), float(problem.contacts.gamma[i])
    is_normal, is_tangential = columns == friction.F_N, columns < friction.F_N
    size = np.where(is_tangential, mu, np.where(is_normal, 1.0, gamma))
    v = np.where(is_normal, 0.0, f[rows] / size)
    r = float(np.linalg.norm(v))
    along = v / r
    gradient = along / size - is_normal
    curvature = (np.diag(np.where(is_normal, 0.0, 1.0)) - np.outer(along, along)) / r / np.outer(size, size)
    v_mu = np.where(is_tangential, -v / mu, 0.0)
    g_mu = float(along @ v_mu)
    gradient_mu = (v_mu - along * g_mu) / (r * size) - np.where(is_tangential, along / (size * mu), 0.0)
    return rows, gradient, curvature, g_mu, gradient_mu


def limit_rows(problem: ForceProblem, f: Array, active: tuple[ActiveLimit, ...]) -> Array:
    """Return the gradients of the active limits over f, one row each.

    Args:
        problem: the force problem.
        f: (k,) stacked forces.
        active: the active limits.
    """
    A = np.zeros((len(active), problem.size))
    for row, limit in zip(A, active, strict=True):
        if limit.kind == "cone":
            rows, gradient, *_ = cone_derivatives(problem, limit.index, f)
            row[rows] = gradient
        elif limit.kind == "normal":
            row[problem.contacts.normal_rows[limit.index]] = 1.0
        elif limit.kind == "torque":
            assert problem.actuation is not None  # it has torque limits
            row[:] = problem.actuation.J[:, limit.index]
        else:
            row[limit.index] = 1.0
    return A


def _limit_values(problem: ForceProblem, f: Array, active: tuple[ActiveLimit, ...]) -> Array:
    """Return a_j(f) of the active limits, zero at the optimum."""
    contacts, values = problem.contacts, []
    padded = contacts.pad(f)
    tau = problem.torques(f)
    for limit in active:
        i = limit.index
        if limit.kind == "cone":
            used = _used(padded[i], float(contacts.mu[i]), float(contacts.gamma[i]))
            values.append(used - float(padded[i, friction.F_N]))
        elif limit.kind == "normal":
            bound = contacts.max_normal if limit.side > 0 else contacts.min_normal
            values.append(float(padded[i, friction.F_N] - bound[i]))
        elif limit.kind == "torque":
            assert problem.actuation is not None  # it has torque limits
            bound = problem.actuation.upper if limit.side > 0 else problem.actuation.lower
            values.append(float(tau[i] - bound[i]))
        else:
            values.append(float(f[i]))
    return np.array(values)


def _conditions(problem: ForceProblem, f: Array, y: Array, alpha: Array, active: tuple[ActiveLimit, ...]) -> Array:
    """Return F(x): stationarity, equilibrium and active limits, with the sign of the symmetric Jacobian."""
    none = Multipliers(*(np.zeros(0),) * 6)
    stationarity = cost_gradient(problem, f, none) - problem.G_centred.T @ y + limit_rows(problem, f, active).T @ alpha
    balance = problem.w_centred - problem.G_centred @ f
    return np.concatenate([stationarity, balance, _limit_values(problem, f, active)])


def conditions_jacobian(problem: ForceProblem, f: Array, alpha: Array, active: tuple[ActiveLimit, ...]) -> Array:
    """Return ∂F/∂x, symmetric.

    Args:
        problem: the force problem.
        f: (k,) stacked forces.
        alpha: multipliers of the active limits.
        active: the active limits.
    """
    H = cost_hessian(problem)
    for limit, value in zip(active, alpha.tolist(), strict=True):
        if limit.kind == "cone":
            rows, _, curvature, *_ = cone_derivatives(problem, limit.index, f)
            H[np.ix_(rows, rows)] += value * curvature
    A = np.vstack([-problem.G_centred, limit_rows(problem, f, active)])
    return np.block([[H, A.T], [A, np.zeros((len(A), len(A)))]])


def cost_hessian(problem: ForceProblem) -> Array:
    """Return (k, k) ∇²cost.

    Args:
        problem: a force problem with the objective "torque", "force" or "sum_normal".
    """
    kind, objective = problem.objective.type, problem.objective
    if kind == "sum_normal":
        return np.zeros((problem.size, problem.size))
    if kind == "force":
        return np.diag(problem.force_weights)
    assert problem.actuation is not None  # validated by ForceProblem
    J, weight = problem.actuation.J, problem.actuation.weight
    return np.asarray((J * weight) @ J.T + objective.force_weight * np.diag(problem.force_weights))


def _leaves_limits(problem: ForceProblem, f: Array, alpha: Array, active: tuple[ActiveLimit, ...]) -> bool:
    """Return whether the refined optimum breaks a limit, or a cone's multiplier has the wrong sign."""
    unit = scale(problem)
    padded = problem.contacts.pad(f)
    outside = float(friction.violation(padded, problem.contacts.mu, problem.contacts.gamma).max()) / unit.force
    wrong = any(a.kind == "cone" and value <= 0.0 for a, value in zip(active, alpha.tolist(), strict=True))
    return wrong or outside > 1e-6
