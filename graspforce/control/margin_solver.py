"""Contact forces with the largest slip margin that the limits allow, up to the margin of the settings.

A slip margin s is exact: the shift f_n' = f_n − s/μ turns ‖f_t‖ ≤ μ f_n − s into the usual cone ‖f_t‖ ≤ μ f_n', with
w' = w − G n s/μ and tau_u' = tau_u + Jᵀ n s/μ. So the usual solver finds and certifies the forces of least torque.

If the margin of the settings is infeasible, one more cone program gives the largest feasible margin s*. The forces of least
torque with 0.999 s* are then certified like all others: s* itself would leave them no choice, and the solver no interior.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum, auto
from typing import NamedTuple

import numpy as np

from graspforce.contact.contact import ContactSet
from graspforce.control.settings import ControlSettings
from graspforce.control.step_data import StepTargets
from graspforce.control.worst_cases import least_friction, weight_margin
from graspforce.core.arrays import Array, freeze
from graspforce.force.largest_margin import LargestMargin
from graspforce.force.problem import ForceProblem
from graspforce.force.problem_options import Objective
from graspforce.force.solution import Solution
from graspforce.force.solver import Solver
from graspforce.grasp.grasp import Grasp
from graspforce.hand.actuation import Actuation

MARGIN_FACTOR = 0.999  # of the largest feasible margin
_FACTORS = (MARGIN_FACTOR, 0.9, 0.0)  # the smaller ones if the solver fails close to the largest margin
_EQUAL = 1e-6  # relative: a largest margin this close to the wanted one may allow it


class MarginResult(NamedTuple):
    """Contact forces of one step.

    Attributes:
        solution: solution of the shifted problem; of the problem without margin if no forces exist.
        f: (k,) contact forces, N and N·m; None without a certified solution.
        margin: slip margin that the forces keep, N.
        warning: message if it is less than the margin of the settings, otherwise empty.
    """

    solution: Solution
    f: Array | None
    margin: float
    warning: str


@dataclass(frozen=True, eq=False, slots=True)
class _Level:
    """A slip margin, and the numbers of the shifted problem.

    Attributes:
        margin: slip margin s, N.
        mu: (N,) friction that the forces use.
        shift: (N,) s/μ of each normal force, N.
        force_offset: (k,) the shift in the rows of f, N.
        normal_limits: (2, N) limits of the shifted normal forces, N.
        is_feasible: whether these limits leave room.
    """

    margin: float
    mu: Array
    shift: Array
    force_offset: Array
    normal_limits: Array
    is_feasible: bool

    @classmethod
    def from_contacts(cls, contacts: ContactSet, mu: Array, margin: float) -> _Level:
        """Return the level of a margin.

        Args:
            contacts: the contacts.
            mu: (N,) friction that the forces may use.
            margin: slip margin, N.
        """
        shift = np.divide(margin, mu, out=np.zeros(len(mu)), where=mu > 0.0)  # N
        force_offset = np.zeros(contacts.size)  # N
        force_offset[contacts.normal_rows] = shift
        lower, upper = np.maximum(contacts.min_normal - shift, 0.0), contacts.max_normal - shift
        return cls(margin, mu, shift, force_offset, np.array([lower, upper]), bool((upper >= lower).all()))


class _Outcome(Enum):
    """Outcome of the last step, which decides what the next step tries first. It affects speed only."""

    FULL = auto()  # the margin of the settings is kept
    REDUCED = auto()  # the largest feasible margin is kept
    NONE = auto()  # no forces exist


class MarginSolver:
    """Force solver of a grasp with the largest feasible slip margin, at most that of the settings.

    It tries the margin of the settings, then the largest feasible one with the friction reserve, then the largest one with all
    the modelled friction. A step after one without forces tries first whether any forces exist. Use one solver in each thread.

    Args:
        grasp: hand, object and contacts.
        settings: settings of the controller.
    """

    def __init__(self, grasp: Grasp, settings: ControlSettings) -> None:
        contacts = grasp.contacts
        if settings.friction_error > 0.0:
            contacts = dataclasses.replace(contacts, gamma=freeze(contacts.gamma * (1.0 - settings.friction_error)))
        least = least_friction(contacts.mu, settings)
        margin = settings.slip_margin + weight_margin(grasp, settings, least)  # N
        self._contacts, self._hand, self._force_weight = contacts, grasp.hand, settings.force_weight
        self._limits = np.array([contacts.min_normal, contacts.max_normal])  # N
        self._wanted = _Level.from_contacts(contacts, freeze(least * (1.0 - settings.friction_reserve)), margin)
        self._bare = _Level.from_contacts(contacts, contacts.mu, 0.0)  # neither margin nor reserve nor errors
        self._loaded = self._wanted  # the level of the solver's problem
        self._solver: Solver | None = None
        self._largest: LargestMargin | None = None
        self._last = _Outcome.FULL

    def solve(self, targets: StepTargets, tau_u: Array) -> MarginResult:
        """Return certified forces of least torque.

        Args:
            targets: targets of this step.
            tau_u: (n,) torques without contact forces, N·m.
        """
        if self._last is _Outcome.NONE:
            solution, f = self._solve_level(self._bare, targets, tau_u)
            if f is None:
                return MarginResult(solution, None, 0.0, "")
        for level, kept in self._levels(targets, tau_u):
            if not level.is_feasible:
                continue
            solution, f = self._solve_level(level, targets, tau_u)
            if f is not None:
                self._last = _Outcome.REDUCED if kept else _Outcome.FULL
                return MarginResult(solution, f, level.margin, kept and f"the full slip margin is infeasible: {kept}")
        self._last = _Outcome.NONE
        return MarginResult(solution, None, 0.0, "")

    def _levels(self, targets: StepTargets, tau_u: Array) -> Iterator[tuple[_Level, str]]:
        """Yield the levels to try, and what they keep of the margin if it is not all of it."""
        wanted, bare = self._wanted, self._bare
        if self._last is _Outcome.FULL or wanted.margin == 0.0:
            yield wanted, ""
        with_reserve, without = (wanted.mu, ""), (bare.mu, ", without the friction reserve")
        same = np.array_equal(wanted.mu, bare.mu)
        for mu, note in () if wanted.margin == 0.0 else (with_reserve,) if same else (with_reserve, without):
            largest = self._find_largest(mu, targets, tau_u)
            if largest is None:
                continue
            if not note and self._last is not _Outcome.FULL and largest >= wanted.margin * (1.0 - _EQUAL):
                yield wanted, ""
            for factor in _FACTORS:
                margin = factor * min(largest, wanted.margin)
                yield _Level.from_contacts(self._contacts, mu, margin), f"the largest is kept, {margin:.3g} N{note}"
        yield bare, "none of it is kept; the forces use all the friction"

    def _find_largest(self, mu: Array, targets: StepTargets, tau_u: Array) -> float | None:
        """Return the largest feasible margin, N; None if no forces exist."""
        if self._largest is None:
            self._largest = LargestMargin(self._problem(self._bare, targets, targets.w, tau_u), self._wanted.margin)
        return self._largest.solve(targets.w, targets.J, tau_u, targets.p_OC, targets.R_OC, mu, self._limits)

    def _solve_level(self, level: _Level, targets: StepTargets, tau_u: Array) -> tuple[Solution, Array | None]:
        """Return the certified solution of a level's shifted problem, and the contact forces (k,); None without one."""
        w, tau_u = targets.apply_slip_margin(tau_u, level.shift) if level.margin > 0.0 else (targets.w, tau_u)
        if self._solver is None:
            self._solver, self._loaded = Solver(self._problem(level, targets, w, tau_u), explain=False), level
        mu, limits = (None, None) if level is self._loaded else (level.mu, level.normal_limits)
        self._loaded = level
        solution = self._solver.solve(
            w=w, J=targets.J, tau_u=tau_u, mu=mu, p=targets.p_OC, R=targets.R_OC, normal_limits=limits
        )
        if not solution.found:
            return solution, None
        f = solution.f + level.force_offset
        f.setflags(write=False)  # the command and the next memory share it
        return solution, f

    def _problem(self, level: _Level, targets: StepTargets, w: Array, tau_u: Array) -> ForceProblem:
        """Return the force problem of a level at the contacts of the grasp."""
        hand, (lower, upper) = self._hand, level.normal_limits
        contacts = dataclasses.replace(self._contacts, mu=level.mu, min_normal=freeze(lower), max_normal=freeze(upper))
        actuation = Actuation(targets.J, tau_u, hand.torque_lower, hand.torque_upper, hand.torque_weight)
        return ForceProblem(contacts, w, actuation, objective=Objective("torque", self._force_weight))
