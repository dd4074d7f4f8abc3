"""Repeated solution of a robust force problem by the nominal solver, for control.

A vertex v of the wrenches shifts the force of contact i by β_iv, so that f_i must be in all cones K − β_iv. With one vertex for
each contact, f_i = a_i + f_i', a_i = −β_iv, gives a nominal problem for f' with the wrench w − G a and the bias torques
tau_u + Jᵀ a. Its optimum is a lower bound. If it keeps the cones of all other vertices too, it is the optimum of the robust
problem. Otherwise the violated vertices are chosen, and the problem is solved again, from the last solution.
"""

from __future__ import annotations

import contextlib
import dataclasses
import time
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from graspforce.contact.contact import ContactSet
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import UnsupportedProblem
from graspforce.core.records import make_unchecked
from graspforce.force.backends.protocol import Backend, Session, SolverSettings
from graspforce.force.multipliers import Multipliers
from graspforce.force.problem import ForceProblem
from graspforce.force.problem_options import Objective
from graspforce.force.robust_program import STRICT, solve_robust
from graspforce.force.robust_set import RobustSet, wrench_maps
from graspforce.force.scale import scale
from graspforce.force.solution import Solution
from graspforce.force.status import Status
from graspforce.hand.actuation import Actuation

_MAX_CHOICES = 8  # of vertices in one solve, before the general program is solved
_EMPTY = np.zeros(0)
_NEAR_LIMIT = 1e-6  # of a torque limit's size: a torque this close to it counts as limited


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ShiftedSolution(Solution):
    """A robust squeeze whose certificate is that of the nominal problem with shifted forces, decoded on first access.

    Args:
        shifted: the solution of the shifted problem.
    """

    shifted: Solution = dataclasses.field(repr=False)
    status = Status.OPTIMAL
    infeasibility = None
    is_final = True
    certificate = cached_property(lambda self: self.shifted.certificate)
    multipliers = cached_property(lambda self: _squeeze_multipliers(self.original_problem, self.shifted))
    cost_bound = cached_property(lambda self: _cost_bound(self.original_problem, self.f, self.shifted))

    def __reduce__(self) -> tuple[Any, ...]:
        """Return a plain `Solution` for copies and other processes."""
        return Solution, tuple(getattr(self, field.name) for field in dataclasses.fields(Solution))


def _squeeze_multipliers(problem: ForceProblem, shifted: Solution) -> Multipliers:
    """Return the multipliers of a shifted problem, for the motors of the problem."""
    n = 0 if problem.actuation is None else len(problem.actuation.tau_u)
    m = shifted.multipliers
    assert m is not None  # an optimum has multipliers
    return dataclasses.replace(m, torque_lower=m.torque_lower[:n], torque_upper=m.torque_upper[:n])


def _cost_bound(problem: ForceProblem, f: Array, shifted: Solution) -> float:
    """Return a lower bound on the objective: that of the shifted problem, which has fewer constraints."""
    return problem.cost(f) - (shifted.objective_gap or 0.0) * abs(shifted.objective or 0.0)


class ShiftedProblem:
    """The nominal problem of shifted forces, for one grasp with changing wrench, Jacobian and bias torques.

    Args:
        problem: a problem for which `is_supported` holds.
    """

    def __init__(self, problem: ForceProblem) -> None:
        assert problem.uncertainty is not None  # the caller's duty
        robust = RobustSet(problem)
        contacts, size = robust.nominal.contacts, problem.size
        self.is_supplied, self._contacts, self._G = robust.is_supplied, contacts, problem.G
        maps, further = wrench_maps(problem.uncertainty)
        self._beta, self._further = (robust.reaction @ maps).reshape(-1, 6), (further @ robust.reaction.T).ravel()
        force = float(scale(robust.nominal).force)  # N
        self._margin, self._tolerance = problem.uncertainty.slip_margin, 0.5 * STRICT * force
        rubs = contacts.mu > 0.0
        self._offset = np.zeros(size)
        self._offset[contacts.normal_rows[rubs]] = (self._margin + STRICT * force) / contacts.mu[rubs]
        owners = contacts.columns // 4
        self._places = np.arange(size), np.where(rubs[owners], owners, -1)  # of each component, and its contact with friction
        self._vertex = np.zeros(len(contacts) + 1, dtype=np.intp)  # of each contact, and of all without friction
        padded = np.full((4, len(contacts)), size)
        padded[contacts.columns % 4, owners] = np.arange(size)
        self._padded = padded  # rows of the components in the forces with a zero behind them
        self._lever = np.divide(contacts.mu, contacts.gamma, out=np.zeros(len(contacts)), where=contacts.gamma > 0.0)  # 1/m
        self._mu = np.where(rubs, contacts.mu, 0.0)
        self._slack = np.where(rubs, -self._margin, np.inf)
        limited = np.isfinite(contacts.max_normal) | (contacts.min_normal > 0.0) | ~rubs
        self._limits_normals = bool(limited.any())
        self._extra = _force_rows(problem)
        self._session: Session | None = None
        self._limits = np.zeros((2, 0))  # of the torques of the session's problem, N·m

    def solve(self, problem: ForceProblem, settings: SolverSettings, backend: Backend) -> tuple[Array, Solution] | None:
        """Return the squeeze and the certified solution of the shifted problem.

        Args:
            problem: the problem with its present wrench, Jacobian and bias torques.
            settings: tolerance and limits of the solver.
            backend: the solver.

        Returns:
            The squeeze and the solution; None if no forces exist, or if no choice of vertices settles.

        Raises:
            UnsupportedProblem: the backend does not support the shifted problem.
        """
        shifts = (self._beta @ problem.w + self._further).reshape(-1, problem.size)  # (V, k)
        component, owner = self._places
        for _ in range(_MAX_CHOICES):
            a = self._offset - np.where(owner >= 0, shifts[self._vertex[owner], component], 0.0)
            solution = self._solve_shifted(problem, settings, backend, shifts, a)
            if solution is None or not (solution.is_final and solution.found):
                return None
            f = a + solution.f
            every = np.zeros((len(shifts), problem.size + 1))
            every[:, :-1] = f + shifts
            margins = self._slip_margins(every)
            worst = margins.argmin(axis=0)
            slips = margins.min(axis=0) < -self._tolerance
            if not slips.any():
                return f, solution
            self._vertex[:-1] = np.where(slips, worst, self._vertex[:-1])
        return None

    def _solve_shifted(
        self, problem: ForceProblem, settings: SolverSettings, backend: Backend, shifts: Array, a: Array
    ) -> Solution | None:
        """Return the solution for forces shifted by a, within limits for all vertices; None if these leave no room."""
        changes: dict[str, Array] = {"w": problem.w - self._G @ a}
        n = 0
        if problem.actuation is not None:
            J, n = problem.actuation.J, len(problem.actuation.tau_u)
            changes["J"], changes["tau_u"] = J, problem.actuation.tau_u + a @ J
        if self._extra is not None:
            changes["tau_u"] = np.concatenate([changes.get("tau_u", _EMPTY), a @ self._extra])
            changes["J"] = np.hstack([changes["J"], self._extra]) if n else self._extra
        if self._limits_normals:
            moved, kept = shifts[:, self._contacts.normal_rows], a[self._contacts.normal_rows]
            low = np.maximum(self._contacts.min_normal - moved.min(axis=0) - kept, 0.0)
            high = self._contacts.max_normal - moved.max(axis=0) - kept
            if (low > high).any():
                return None
            changes["normal_limits"] = np.array([low, high])
        limits = self._torque_limits(problem, shifts)
        if (limits[0] > limits[1]).any():
            return None
        if self._session is not None:
            solution = self._session.solve(**changes)
            if np.array_equal(limits, self._limits) or not solution.found or self._is_free(limits, solution.torques[:n]):
                return solution
        self._session, self._limits = backend.start_session(self._shifted(problem, changes, limits), settings), limits
        return self._session.solve()

    def _is_free(self, limits: Array, tau: Array) -> bool:
        """Return whether torques are within the limits and away from the session's, so that both have the same optimum."""
        near = _NEAR_LIMIT * np.where(np.isfinite(self._limits), np.abs(self._limits), 0.0)
        away = (tau > self._limits[0] + near[0]) & (tau < self._limits[1] - near[1])
        return bool((away & (tau > limits[0]) & (tau < limits[1])).all())

    def _torque_limits(self, problem: ForceProblem, shifts: Array) -> Array:
        """Return (2, n) limits of the torques that leave room for the reaction of all vertices, N·m."""
        if problem.actuation is None:
            return np.zeros((2, 0))
        moved = shifts @ problem.actuation.J
        return np.array([problem.actuation.lower - moved.min(axis=0), problem.actuation.upper - moved.max(axis=0)])

    def _shifted(self, problem: ForceProblem, changes: dict[str, Array], limits: Array) -> ForceProblem:
        """Return the shifted problem."""
        c, objective = self._contacts, problem.objective
        low, high = changes.get("normal_limits", np.array([c.min_normal, c.max_normal]))
        contacts = ContactSet(c.p_OC, c.R_OC, c.models, c.mu, c.gamma, arrays.freeze(low), arrays.freeze(high))
        actuation = None
        if "J" in changes:
            extra = 0 if self._extra is None else problem.size
            lower, upper = limits.tolist()
            weight = np.zeros(len(lower))
            if objective.type == "torque" and problem.actuation is not None:
                weight = problem.actuation.weight
            actuation = Actuation(
                changes["J"],
                changes["tau_u"],
                [x if np.isfinite(x) else None for x in lower] + [None] * extra,
                [x if np.isfinite(x) else None for x in upper] + [None] * extra,
                np.concatenate([weight, np.ones(extra)]),
            )
        kind = Objective("sum_normal" if objective.type == "sum_normal" else "torque")
        return ForceProblem(contacts, changes["w"], actuation, problem.cone, kind)

    def _slip_margins(self, every: Array) -> Array:
        """Return (V, N) slip margins less the required one, inf without friction."""
        t1, t2, n, moment = every[:, self._padded].transpose(1, 0, 2)
        squares = t1 * t1 + t2 * t2
        if self._lever.any():
            squares += (self._lever * moment) ** 2
        return np.asarray(self._mu * n - np.sqrt(squares) + self._slack)


def _force_rows(problem: ForceProblem) -> Array | None:
    """Return (k, k) √ρ of ½ρ‖f‖² as the lever arms of one more motor for each component; None without that cost."""
    objective = problem.objective
    rho = 1.0 if objective.type == "force" else objective.force_weight
    return None if rho == 0.0 or objective.type == "sum_normal" else np.diag(np.sqrt(rho * problem.force_weights))


class RobustSession:
    """A robust force problem that is solved repeatedly with changed values. Use one in each thread.

    Args:
        problem: the first problem, with an uncertainty.
        settings: tolerance and limits of every solve.
        backend: the solver of shifted problems.
    """

    def __init__(self, problem: ForceProblem, settings: SolverSettings, backend: Backend) -> None:
        self.problem = problem
        self._settings, self._backend = settings, backend
        self._shifted: ShiftedProblem | None = None

    def solve(
        self,
        w: npt.ArrayLike | None = None,
        J: npt.ArrayLike | None = None,
        tau_u: npt.ArrayLike | None = None,
        mu: npt.ArrayLike | None = None,
        p: npt.ArrayLike | None = None,
        R: npt.ArrayLike | None = None,
        normal_limits: npt.ArrayLike | None = None,
    ) -> Solution:
        """Return the certified squeeze for changed values, as `Session.solve`."""
        start = time.perf_counter()
        changed = self.problem.replace(w=w, J=J, tau_u=tau_u, mu=mu, p=p, R=R, normal_limits=normal_limits)
        if self._shifted is None or not all(value is None for value in (mu, p, R, normal_limits)):
            self._shifted = ShiftedProblem(changed) if is_supported(changed) else None
        self.problem = changed
        found = None
        if self._shifted is not None and self._shifted.is_supplied:
            with contextlib.suppress(UnsupportedProblem):
                found = self._shifted.solve(changed, self._settings, self._backend)
        if found is None:
            return solve_robust(changed, self._settings)
        f, shifted = found
        f.setflags(write=False)
        return make_unchecked(
            ShiftedSolution,
            problem=changed,
            f=f,
            shifted=shifted,
            backend=shifted.backend,
            iterations=shifted.iterations,
            seconds=time.perf_counter() - start,
        )


def is_supported(problem: ForceProblem) -> bool:
    """Return whether the shifted problem represents a robust problem: exact cones and errors, and a cost of one term.

    Args:
        problem: the problem with its uncertainty.
    """
    return (
        RobustSet(problem).is_exact
        and problem.cone.type == "exact"
        and problem.objective.type in ("torque", "force", "sum_normal")
    )
