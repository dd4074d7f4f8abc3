"""Derivatives of optimal forces, torques and objective with respect to the data of a force problem.

The optimum solves F(x, θ) = 0 (`optimality`), so that ∂x/∂θ = −(∂F/∂x)⁻¹ ∂F/∂θ wherever the active set does not change. Where
a limit may be active or not, or the optimum is not unique, the derivatives do not exist or are one-sided: such optima are
flagged.
Sources: Fiacco (1983); Amos and Kolter (2017).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt

from graspforce.analysis.optimality import Optimum, cone_derivatives, find_optimum
from graspforce.contact import friction
from graspforce.contact.contact import ContactModel
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput, UnsupportedProblem
from graspforce.force.certificate import cost_gradient
from graspforce.force.multipliers import Multipliers
from graspforce.force.problem import ForceProblem
from graspforce.force.solution import Solution

OBJECTIVES = ("torque", "force", "sum_normal")
DegenerateOptima = Literal["error", "least_squares"]
_CONTACT_DATA = ("w", "mu", "p", "rotation")
_MOTOR_DATA = ("tau_u", "torque_lower", "torque_upper", "J")
_RANK = 1e-9  # singular values of a degenerate optimum's scaled Jacobian that count as zero, relative to the largest


@dataclass(frozen=True, eq=False, slots=True)
class OptimumChange:
    """First-order change of an optimum.

    Args:
        f: (k,) change of the forces, N and N·m.
        tau: (n,) change of the motor torques, N·m.
        objective: change of the objective.
    """

    f: Array
    tau: Array
    objective: float


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Derivatives of an optimum with respect to the data θ of its problem.

    The data are: ``w`` (6,) the wrench; ``mu`` (N,) friction; ``p`` (N, 3) contact positions in O; ``rotation`` (N, 3) rotation
    vectors of the contact frames in O, which turn the normal by φ × n; and with a hand ``tau_u``, ``torque_lower``,
    ``torque_upper`` (n,) and ``J`` (k, n). Each derivative keeps all other data, so that moved contacts keep their J.

    Args:
        optimum: the refined optimum with its active limits.
        on_degenerate: "error", or "least_squares" for products at degenerate optima too.
    """

    optimum: Optimum
    on_degenerate: DegenerateOptima = "error"

    @property
    def degenerate(self) -> tuple[str, ...]:
        """The reasons why derivatives do not exist; empty if they do."""
        return self.optimum.undecided

    @cached_property
    def data(self) -> tuple[str, ...]:
        """The names of the data."""
        return _CONTACT_DATA if self.optimum.problem.actuation is None else (*_CONTACT_DATA, *_MOTOR_DATA)

    @cached_property
    def f(self) -> Mapping[str, Array]:
        """∂f/∂θ by name of the data, (k, …shape of the data).

        Raises:
            InvalidInput: the optimum is degenerate.
        """
        k = self.optimum.problem.size
        return {name: self._solved[name][:k].reshape(k, *self._shape(name)) for name in self.data}

    @cached_property
    def tau(self) -> Mapping[str, Array]:
        """∂tau/∂θ by name of the data, (n, …shape of the data). Errors as `f`."""
        return {name: matrix.reshape(len(matrix), *self._shape(name)) for name, matrix in self._torques.items()}

    @cached_property
    def objective(self) -> Mapping[str, Array]:
        """∂objective/∂θ by name of the data, in the shape of the data. Errors as `f`."""
        return {name: row.reshape(self._shape(name)) for name, row in self._objectives.items()}

    def forward(self, changes: Mapping[str, npt.ArrayLike]) -> OptimumChange:
        """Return the first-order change of the optimum for changed data.

        Args:
            changes: change of the data by name, each in its shape.

        Raises:
            InvalidInput: an unknown name, another shape, or a degenerate optimum.
        """
        problem = self.optimum.problem
        f, tau, objective = np.zeros(problem.size), np.zeros(len(problem.torques(self.optimum.f))), 0.0
        for name, value in changes.items():
            if name not in self.data:
                raise InvalidInput("changes", name, f"one of {', '.join(self.data)}")
            change = arrays.check_array(value, name, self._shape(name)).ravel()
            f += self._solved[name][: problem.size] @ change
            tau += self._torques[name] @ change
            objective += float(self._objectives[name] @ change)
        return OptimumChange(f, tau, objective)

    def adjoint(
        self, f: npt.ArrayLike | None = None, tau: npt.ArrayLike | None = None, objective: float = 0.0
    ) -> dict[str, Array]:
        """Return the gradient of a function of the optimum with respect to all data: one linear solve.

        Args:
            f: (k,) gradient of the function with respect to the forces; zero by default.
            tau: (n,) gradient with respect to the motor torques; zero by default.
            objective: derivative with respect to the objective.

        Returns:
            The gradient by name of the data, in the shape of the data.

        Raises:
            InvalidInput: another shape, or a degenerate optimum.
        """
        self.check_regular()
        problem, optimum = self.optimum.problem, self.optimum
        n = len(problem.torques(optimum.f))
        f_bar = np.zeros(problem.size) if f is None else arrays.check_array(f, "f", (problem.size,))
        tau_bar = np.zeros(n) if tau is None else arrays.check_array(tau, "tau", (n,))
        x_bar = np.zeros(len(optimum.jacobian))
        x_bar[: problem.size] = f_bar + objective * self._cost_gradient
        if problem.actuation is not None:
            x_bar[: problem.size] += problem.actuation.J @ tau_bar
        price = self._scaled_solve(x_bar)  # the Jacobian is symmetric
        result = {}
        for name, B in self._residuals.items():
            direct = tau_bar @ self._direct_torques(name) + objective * self._direct_cost(name)
            result[name] = arrays.freeze((direct - price @ B).reshape(self._shape(name)))
        return result

    def check_regular(self) -> None:
        """Raise an error for a degenerate optimum, unless products at degenerate optima are allowed.

        Raises:
            InvalidInput: the optimum is degenerate.
        """
        if self.degenerate and self.on_degenerate == "error":
            raise InvalidInput("solution", self.degenerate[0], "a regular optimum: its derivatives do not exist")

    def _shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of a block of data."""
        problem = self.optimum.problem
        N = len(problem.contacts)
        n = len(problem.torques(self.optimum.f))
        shapes = {"w": (6,), "mu": (N,), "p": (N, 3), "rotation": (N, 3), "J": (problem.size, n)}
        return shapes.get(name, (n,))

    @cached_property
    def _balance(self) -> Array:
        """Sizes that equilibrate the Jacobian: S K S has rows of about the same length."""
        K = np.abs(self.optimum.jacobian)
        size = np.ones(len(K))
        for _ in range(4):
            largest = (size[:, None] * K * size).max(axis=1)
            size /= np.sqrt(np.where(largest > 0.0, largest, 1.0))
        return size

    def _scaled_solve(self, right: Array) -> Array:
        """Return (∂F/∂x)⁻¹ right."""
        S, K = self._balance, self.optimum.jacobian
        scaled = S if right.ndim == 1 else S[:, None]
        if self.degenerate:
            return np.asarray(scaled * np.linalg.lstsq(S[:, None] * K * S, scaled * right, rcond=_RANK)[0])
        return np.asarray(scaled * np.linalg.solve(S[:, None] * K * S, scaled * right))

    @cached_property
    def _solved(self) -> dict[str, Array]:
        """∂x/∂θ by name, with θ flattened."""
        self.check_regular()
        return {name: -self._scaled_solve(B) for name, B in self._residuals.items()}

    @cached_property
    def _torques(self) -> dict[str, Array]:
        """∂tau/∂θ by name, with θ flattened."""
        problem = self.optimum.problem
        J = np.zeros((problem.size, 0)) if problem.actuation is None else problem.actuation.J
        return {name: J.T @ x[: problem.size] + self._direct_torques(name) for name, x in self._solved.items()}

    @cached_property
    def _objectives(self) -> dict[str, Array]:
        """∂objective/∂θ by name, with θ flattened."""
        k = self.optimum.problem.size
        return {name: self._cost_gradient @ x[:k] + self._direct_cost(name) for name, x in self._solved.items()}

    @cached_property
    def _cost_gradient(self) -> Array:
        """(k,) ∇cost at the optimum."""
        return cost_gradient(self.optimum.problem, self.optimum.f, Multipliers(*(np.zeros(0),) * 6))

    def _direct_torques(self, name: str) -> Array:
        """Return ∂tau/∂θ at fixed forces."""
        n, size = len(self.optimum.problem.torques(self.optimum.f)), int(np.prod(self._shape(name)))
        if name == "tau_u":
            return np.eye(n)
        if name == "J":
            return np.asarray(np.einsum("c,jl->jcl", self.optimum.f, np.eye(n)).reshape(n, size))
        return np.zeros((n, size))

    def _direct_cost(self, name: str) -> Array:
        """Return ∂cost/∂θ at fixed forces."""
        problem = self.optimum.problem
        if name not in ("tau_u", "J") or problem.objective.type != "torque":
            return np.zeros(int(np.prod(self._shape(name))))
        assert problem.actuation is not None  # the objective has torques
        return np.asarray((problem.actuation.weight * problem.torques(self.optimum.f)) @ self._direct_torques(name))

    @cached_property
    def _residuals(self) -> dict[str, Array]:
        """∂F/∂θ by name, with θ flattened."""
        makers = {
            "w": _wrench_residual,
            "mu": _friction_residual,
            "p": _position_residual,
            "rotation": _rotation_residual,
            "tau_u": _bias_residual,
            "J": _jacobian_residual,
        }
        result = {name: maker(self.optimum) for name, maker in makers.items() if name in self.data}
        if "torque_lower" in self.data:
            result["torque_lower"] = _torque_limit_residual(self.optimum, -1)
            result["torque_upper"] = _torque_limit_residual(self.optimum, 1)
        return result


def sensitivities(solution: Solution, *, degenerate: DegenerateOptima = "error") -> Sensitivities:
    """Return the derivatives of a solution with respect to the data of its problem.

    Args:
        solution: an optimal solution of the objective "torque", "force" or "sum_normal" with exact cones.
        degenerate: "error", or "least_squares" for directions at optima without derivatives: limits that may be active or not
            are left free, and dependent conditions hold in the sense of least squares.

    Returns:
        The derivatives. If `Sensitivities.degenerate` is not empty, they do not exist.

    Raises:
        InvalidInput: a solution without certified forces, or without multipliers.
        UnsupportedProblem: another objective, pyramids, or an uncertainty.
    """
    if not solution.found or solution.multipliers is None:
        raise InvalidInput("solution", solution.status.value, "one with certified forces and multipliers")
    problem = solution.original_problem
    if problem.uncertainty is not None:
        raise UnsupportedProblem("sensitivities support exact data, not an uncertainty")
    if problem.objective.type not in OBJECTIVES or problem.cone.type != "exact":
        allowed = f"exact cones and the objectives {', '.join(OBJECTIVES)}"
        raise UnsupportedProblem(f"sensitivities support {allowed}, not {problem.cone.type} and {problem.objective.type}")
    return Sensitivities(find_optimum(solution), degenerate)


def _empty(optimum: Optimum, count: int) -> tuple[Array, Array, Array, Array]:
    """Return ∂F/∂θ of zeros, and views of its rows: stationarity, equilibrium, limits."""
    k = optimum.problem.size
    B = np.zeros((len(optimum.jacobian), count))
    return B, B[:k], B[k : k + 6], B[k + 6 :]


def _wrench_residual(optimum: Optimum) -> Array:
    """Return ∂F/∂w: the moment is about the contacts' centroid."""
    B, _, balance, _ = _empty(optimum, 6)
    balance[:] = np.eye(6)
    balance[3:, :3] = -_cross_matrix(optimum.problem.contacts.centroid)
    return B


def _friction_residual(optimum: Optimum) -> Array:
    """Return ∂F/∂μ."""
    B, stationarity, _, limits = _empty(optimum, len(optimum.problem.contacts))
    for row, (limit, alpha) in enumerate(zip(optimum.active, optimum.alpha.tolist(), strict=True)):
        if limit.kind == "cone" and optimum.problem.contacts.mu[limit.index] > 0.0:
            rows, _, _, g_mu, gradient_mu = cone_derivatives(optimum.problem, limit.index, optimum.f)
            limits[row, limit.index] = g_mu
            stationarity[rows, limit.index] += alpha * gradient_mu
    return B


def _position_residual(optimum: Optimum) -> Array:
    """Return ∂F/∂p: G f gains δp × R f, and Gᵀ y gains Rᵀ (y_m × δp)."""
    contacts = optimum.problem.contacts
    B, stationarity, balance, _ = _empty(optimum, 3 * len(contacts))
    moment = _cross_matrix(optimum.y[3:])
    for i, (rows, axes) in enumerate(_force_axes(optimum.problem)):
        column = slice(3 * i, 3 * i + 3)
        balance[3:, column] = _cross_matrix(axes @ optimum.f[rows])
        stationarity[rows, column] = -axes.T @ moment
    return B


def _rotation_residual(optimum: Optimum) -> Array:
    """Return ∂F/∂φ: each axis e of a contact frame gains φ × e."""
    problem = optimum.problem
    contacts = problem.contacts
    B, stationarity, balance, _ = _empty(optimum, 3 * len(contacts))
    arms = contacts.p_OC - contacts.centroid
    for i, (rows, axes) in enumerate(_force_axes(problem)):
        column = slice(3 * i, 3 * i + 3)
        force = -_cross_matrix(axes @ optimum.f[rows])  # of φ × force
        balance[:3, column] = -force
        balance[3:, column] = -_cross_matrix(arms[i]) @ force
        price = optimum.y[:3] + np.cross(optimum.y[3:], arms[i])
        stationarity[rows, column] = -axes.T @ _cross_matrix(price)  # (φ × e)·price = e·(price × φ)
        if contacts.models[i] is ContactModel.SOFT:
            row, normal = rows[-1] + 1, contacts.R_OC[i, :, 2]
            balance[3:, column] += _cross_matrix(normal * optimum.f[row])
            stationarity[row, column] = -normal @ _cross_matrix(optimum.y[3:])
    return B


def _bias_residual(optimum: Optimum) -> Array:
    """Return ∂F/∂tau_u."""
    problem = optimum.problem
    assert problem.actuation is not None  # it has torques
    B, stationarity, _, limits = _empty(optimum, len(problem.actuation.tau_u))
    if problem.objective.type == "torque":
        stationarity[:] = problem.actuation.J * problem.actuation.weight
    for row, limit in enumerate(optimum.active):
        if limit.kind == "torque":
            limits[row, limit.index] = 1.0
    return B


def _torque_limit_residual(optimum: Optimum, side: int) -> Array:
    """Return ∂F/∂ of the lower (−1) or upper (+1) torque limits."""
    assert optimum.problem.actuation is not None  # it has torques
    B, _, _, limits = _empty(optimum, len(optimum.problem.actuation.tau_u))
    for row, limit in enumerate(optimum.active):
        if limit.kind == "torque" and limit.side == side:
            limits[row, limit.index] = -1.0
    return B


def _jacobian_residual(optimum: Optimum) -> Array:
    """Return ∂F/∂J: J (W tau + α) changes by δJ (W tau + α) + J W δJᵀ f, and a torque at a limit by δJᵀ f."""
    problem = optimum.problem
    assert problem.actuation is not None  # it has torques
    k, n = problem.actuation.J.shape
    B, stationarity, _, limits = _empty(optimum, k * n)
    price = np.zeros(n)
    if problem.objective.type == "torque":
        price += problem.actuation.weight * problem.torques(optimum.f)
        coupled = np.einsum("cj,d->cdj", problem.actuation.J * problem.actuation.weight, optimum.f)
        stationarity[:] = coupled.reshape(k, k * n)
    for row, (limit, alpha) in enumerate(zip(optimum.active, optimum.alpha.tolist(), strict=True)):
        if limit.kind == "torque":
            price[limit.index] += alpha
            limits[row, limit.index :: n] = optimum.f
    stationarity += np.kron(np.eye(k), price)
    return B


def _force_axes(problem: ForceProblem) -> list[tuple[list[int], Array]]:
    """Return for each contact the stacked rows of its force components and their axes in O, (3, c)."""
    contacts, result = problem.contacts, []
    for i in range(len(contacts)):
        rows = [int(row) for row in np.flatnonzero(contacts.columns // 4 == i) if contacts.columns[row] % 4 != friction.M_N]
        result.append((rows, contacts.R_OC[i][:, contacts.columns[rows] % 4]))
    return result


def _cross_matrix(a: Array) -> Array:
    """Return the matrix of a × b."""
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])
