"""Repeated solution of a robust force problem by the nominal solver, for control.

A vertex v of the wrenches shifts the force of contact i by β_iv, so that f_i must be in all cones K − β_iv. For one vertex of
each contact, f_i = a_i + f_i', a_i = −β_iv, gives a nominal problem for f' with the wrench w − G a and the bias torques
tau_u + Jᵀ a. Two such cones meet in a plane, so that a half-space for each contact represents a second vertex
(``csrc/kernel/shifted.c``). If the optimum keeps the cones of all vertices, and its multipliers are those of the two cones, it
is the optimum of the robust problem. Otherwise other vertices are chosen, and the problem is solved again, from the last
solution.
"""

from __future__ import annotations

import contextlib
import dataclasses
import time
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import numpy.typing as npt

from graspforce.contact.contact import ContactSet
from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import UnsupportedProblem
from graspforce.core.records import copy_unchecked, make_unchecked
from graspforce.force.backends import compiled_kernel
from graspforce.force.backends.protocol import Backend, SolverSettings
from graspforce.force.error_vertices import wrench_maps
from graspforce.force.multipliers import Multipliers
from graspforce.force.problem import ForceProblem
from graspforce.force.problem_options import Objective
from graspforce.force.robust_program import STRICT, solve_robust
from graspforce.force.robust_set import RobustSet
from graspforce.force.scale import scale
from graspforce.force.solution import LazySolution, Solution
from graspforce.force.status import Status
from graspforce.hand.actuation import Actuation

if TYPE_CHECKING:
    from graspforce.force.backends.structured import KernelResult, KernelSession

_MAX_CHOICES = 8  # of vertices in one solve, before the general program is solved
_LIMITED_STEPS = 50
_SOLVED, _FAILED, _LIMITS = 0, 2, 3  # outcomes of check_shifted
_NONE = -1.0  # no vertex
_EMPTY = np.zeros(0)


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
        contacts, size, count = robust.nominal.contacts, problem.size, len(problem.contacts)
        self.is_supplied, self._contacts = robust.is_supplied, contacts
        maps, further = wrench_maps(problem.uncertainty)
        force = float(scale(robust.nominal).force)  # N
        required = problem.uncertainty.slip_margin
        self._margin = required + 0.5 * STRICT * force  # N: kept after rounding
        rubs = contacts.mu > 0.0
        offset = np.zeros(size)
        offset[contacts.normal_rows[rubs]] = (required + STRICT * force) / contacts.mu[rubs]
        limited = np.isfinite(contacts.max_normal) | (contacts.min_normal > 0.0) | ~rubs
        self._limits_normals, self._root = bool(limited.any()), _force_roots(problem)
        self._pair = np.zeros((count, 3))
        self._data = (
            np.ascontiguousarray(robust.reaction @ maps),
            np.ascontiguousarray(further @ robust.reaction.T),
            np.ascontiguousarray(problem.G),
            offset,
            _cone_form(contacts),
            (contacts.columns // 4).astype(np.float64),
            self._root,
            np.array([contacts.min_normal, contacts.max_normal]),
        )
        n = 0 if problem.actuation is None else len(problem.actuation.tau_u)
        self._motors, width = n, n + len(self._root) + count
        sizes = ((len(maps), size), size, 6, (size, width), width, (2, n), (2, count), count)
        self._numbers = tuple(np.zeros(each) for each in sizes)
        self._session: KernelSession | None = None
        self._nominal = problem  # of the session
        self._limited_steps = 0  # solves that renew the torque limits at once, since they were active before
        self._limits = np.zeros((2, 0))  # of the torques of the session's problem, N·m

    def solve(self, problem: ForceProblem, settings: SolverSettings, backend: Backend) -> tuple[Array, Solution] | None:
        """Return the squeeze and the certified solution of the shifted problem.

        Args:
            problem: the problem with its present wrench, Jacobian and bias torques.
            settings: tolerance and limits of the solver.
            backend: the structured kernel.

        Returns:
            The squeeze and the solution; None if no forces exist, or if more than two vertices limit a contact.

        Raises:
            UnsupportedProblem: the kernel does not support the shifted problem.
        """
        actuation, contacts = problem.actuation, self._contacts
        hand = (_EMPTY, _EMPTY, _EMPTY, _EMPTY)
        if actuation is not None:
            hand = (actuation.J, actuation.tau_u, actuation.lower, actuation.upper)
        f = np.empty(problem.size)
        self._pair[:, 2] = _NONE
        self._limited_steps -= 1
        renewed = self._limited_steps > 0  # limits of the torques
        for _ in range(_MAX_CHOICES):
            if not compiled_kernel.shift_problem(*self._data, *self._numbers, self._pair, problem.w, *hand):
                return None
            solution = self._solve_shifted(problem, settings, backend, renewed)
            if not isinstance(solution, LazySolution):  # infeasible, or not certified at once
                if not (self._pair[:, 0] != self._pair[:, 1]).any():
                    return None
                self._pair[:, 1], self._pair[:, 2] = self._pair[:, 0], _NONE  # the half-spaces may be the reason
                continue
            data = cast("KernelResult", solution.data)
            eta, tau = data.part("lambda_lower")[-len(contacts) :], data.part("tau")
            room, tau = tau[-len(contacts) :], tau[: self._motors]
            parts = (data.part("f"), data.part("z"), eta, room, tau, self._limits, contacts.mu, contacts.gamma, f)
            outcome = compiled_kernel.check_shifted(*self._data, *self._numbers, self._pair, self._margin, *parts)
            if outcome == _SOLVED:
                return f, solution
            if outcome == _FAILED:
                return None
            if outcome == _LIMITS:
                renewed, self._limited_steps = True, _LIMITED_STEPS
        return None

    def _solve_shifted(self, problem: ForceProblem, settings: SolverSettings, backend: Backend, renewed: bool) -> Solution:
        """Return the solution of the shifted problem, with the torque limits of the session unless they must be renewed."""
        _, _, w, J, tau_u, limits, normal_limits, _ = self._numbers
        if self._session is not None and not renewed:
            solution = self._session.solve(w=w, J=J, tau_u=tau_u, normal_limits=normal_limits if self._limits_normals else None)
            if solution.found:
                return solution  # check_shifted compares the limits
        self._limits = limits.copy()
        if self._session is None or not self._session.load(self._with_new_numbers()):
            self._nominal = self._shifted(problem)
            self._session = cast("KernelSession", backend.start_session(self._nominal, settings))
        return self._session.solve()

    def _with_new_numbers(self) -> ForceProblem:
        """Return the nominal problem of the session with the present numbers, without validation."""
        _, _, w, J, tau_u, limits, normal, _ = self._numbers
        old, n = self._nominal, self._motors
        assert old.actuation is not None  # there is at least the motor of each contact
        lower, upper = old.actuation.lower.copy(), old.actuation.upper.copy()
        lower[:n], upper[:n] = limits
        numbers = {"J": J.copy(), "tau_u": tau_u.copy(), "lower": lower, "upper": upper, "weight": old.actuation.weight}
        contacts = old.contacts
        if self._limits_normals:
            low, high = normal.copy()
            contacts = copy_unchecked(contacts, min_normal=low, max_normal=high)
        problem = copy_unchecked(old, w=w.copy(), contacts=contacts, actuation=make_unchecked(Actuation, **numbers))
        vars(problem).pop("w_centred", None)
        return problem

    def _shifted(self, problem: ForceProblem) -> ForceProblem:
        """Return the shifted problem."""
        c, objective = self._contacts, problem.objective
        _, _, w, J, tau_u, limits, normal, _ = self._numbers
        if not self._limits_normals:  # the cones imply them
            normal = np.array([c.min_normal, c.max_normal])
        contacts = ContactSet(c.p_OC, c.R_OC, c.models, c.mu, c.gamma, *(arrays.freeze(row) for row in normal))
        weighted, count = len(self._root), len(c)
        weight = np.zeros(self._motors)
        if objective.type == "torque" and problem.actuation is not None:
            weight = problem.actuation.weight
        lower, upper = ([x if np.isfinite(x) else None for x in row] for row in limits.tolist())
        actuation = Actuation(
            J,
            tau_u,
            [*lower, *[None] * weighted, *[0.0] * count],
            [*upper, *[None] * (weighted + count)],
            np.concatenate([weight, np.ones(weighted), np.zeros(count)]),
        )
        kind = Objective("sum_normal" if objective.type == "sum_normal" else "torque")
        return ForceProblem(contacts, w, actuation, problem.cone, kind)


def _cone_form(contacts: ContactSet) -> Array:
    """Return (k,) the diagonal of μ² f_n² − ‖f_t‖² − (μ m_n/γ)²; zeros for contacts without friction."""
    mu, gamma = contacts.mu, contacts.gamma
    lever = np.divide(mu, gamma, out=np.zeros(len(mu)), where=gamma > 0.0)  # 1/m
    rows = np.stack([-np.ones(len(mu)), -np.ones(len(mu)), mu**2, -(lever**2)], axis=1) * (mu > 0.0)[:, None]
    return np.ascontiguousarray(rows.ravel()[contacts.columns])


def _force_roots(problem: ForceProblem) -> Array:
    """Return (k,) √ρ of ½ρ‖f‖²: lever arms of one more motor for each component; empty without that cost."""
    objective = problem.objective
    rho = 1.0 if objective.type == "force" else objective.force_weight
    return _EMPTY if rho == 0.0 or objective.type == "sum_normal" else np.sqrt(rho * problem.force_weights)


class RobustSession:
    """A robust force problem that is solved repeatedly with changed values. Use one in each thread.

    Args:
        problem: the first problem, with an uncertainty.
        settings: tolerance and limits of every solve.
        backend: the solver of shifted problems; only the structured kernel has a fast path.
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
