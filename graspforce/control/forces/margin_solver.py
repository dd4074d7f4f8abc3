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
from graspforce.control.contacts.contact_conditions import Mask
from graspforce.control.forces.structural_forces import structural_forces
from graspforce.control.forces.worst_cases import friction_margin, least_friction, weight_margin
from graspforce.control.settings import ControlSettings
from graspforce.control.step_data import StepTargets
from graspforce.core.arrays import Array, freeze
from graspforce.force.largest_margin import LargestMargin
from graspforce.force.nearest_forces import NearestForces
from graspforce.force.problem import ForceProblem
from graspforce.force.problem_options import Objective
from graspforce.force.solution import Solution
from graspforce.force.solver import Solver
from graspforce.force.status import Status
from graspforce.grasp.grasp import Grasp
from graspforce.hand.actuation import Actuation

MARGIN_FACTOR = 0.999  # of the largest feasible margin
_FACTORS = (MARGIN_FACTOR, 0.9, 0.0)  # the smaller ones if the solver fails close to the largest margin
_AS_NEAR = 0.02  # of the required force: a larger distance by a slip margin counts as the same
_RAMPED_SHARE = 0.5  # of a ramped contact's limit: most of the normal force that its slip margin takes
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
class ContactLimits:
    """Friction and normal forces that the contacts of a step may use.

    Attributes:
        friction: (2, N) friction coefficients, less the friction reserve, and torsional friction lengths, m.
        normal: (2, N) smallest and largest normal forces, N.
        ramped: (N,) contacts whose limit is that of a ramp. They keep a margin only as far as it allows. None for none.
    """

    friction: Array
    normal: Array
    ramped: Mask | None = None

    @property
    def without_ramped(self) -> ContactLimits:
        """The limits without force at ramped contacts: the others alone bound the largest margin."""
        if self.ramped is None:
            return self
        return ContactLimits(np.where(self.ramped, 0.0, self.friction), np.where(self.ramped, 0.0, self.normal))


@dataclass(frozen=True, eq=False, slots=True)
class _Level:
    """A slip margin, and the numbers of the shifted problem.

    Attributes:
        margin: slip margin s, N.
        limits: of the contacts.
        shift: (N,) s/μ of each normal force, N.
        force_offset: (k,) the shift in the rows of f, N.
        normal_limits: (2, N) limits of the shifted normal forces, N.
        is_feasible: whether these limits leave room.
    """

    margin: float
    limits: ContactLimits
    shift: Array
    force_offset: Array
    normal_limits: Array
    is_feasible: bool

    @classmethod
    def of(cls, contacts: ContactSet, limits: ContactLimits, margin: float) -> _Level:
        """Return the level of a margin.

        Args:
            contacts: the contacts.
            limits: of the contacts.
            margin: slip margin, N.
        """
        mu = limits.friction[0]
        shift = np.divide(margin, mu, out=np.zeros(len(mu)), where=mu > 0.0)  # N
        if limits.ramped is not None:
            shift = np.where(limits.ramped, np.minimum(shift, _RAMPED_SHARE * limits.normal[1]), shift)
        force_offset = np.zeros(contacts.size)  # N
        force_offset[contacts.normal_rows] = shift
        lower, upper = np.maximum(limits.normal[0] - shift, 0.0), limits.normal[1] - shift
        return cls(margin, limits, shift, force_offset, np.array([lower, upper]), bool((upper >= lower).all()))


def _allows_less(level: _Level, bare: _Level) -> bool:
    """Return whether the limits of a level are within those of another one."""
    (lower, upper), (least, most) = level.limits.normal, bare.limits.normal
    friction = bool((level.limits.friction <= bare.limits.friction).all())
    return friction and bool((lower >= least).all() and (upper <= most).all())


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
        drive_margin: slip margin for the errors of the drives, N.

    Attributes:
        margin: slip margin of the settings, with those for the error of the mass, for joint friction and for the drives, N.
        least: (2, N) friction coefficients and torsional friction lengths for all errors of the settings.
        full_limit: (N,) smallest limits of a ramp with which contacts keep the margin of the settings, N.
    """

    def __init__(self, grasp: Grasp, settings: ControlSettings, drive_margin: float = 0.0) -> None:
        self._contacts, self._hand, self._settings = grasp.contacts, grasp.hand, settings
        contacts = grasp.contacts
        self._structure = structural_forces(grasp)
        self.least = least_friction(contacts, settings)
        errors = weight_margin(grasp, settings, self.least[0]) + friction_margin(grasp, settings) + drive_margin
        self.margin = settings.slip_margin + errors
        self._modelled = np.array([contacts.mu, contacts.gamma])
        self._normal = np.array([contacts.min_normal, contacts.max_normal])  # N
        self._nominal = _Level.of(contacts, self._with_reserve(self.least, None), self.margin)
        self.full_limit = freeze(np.minimum(self._nominal.shift / _RAMPED_SHARE, self._normal[1]))
        # neither margin nor reserve nor errors
        self._bare = _Level.of(contacts, self._contact_limits(self._modelled, None), 0.0)
        self._loaded = self._nominal  # the level of the solver's problem
        self._solver: Solver | None = None
        self._largest: LargestMargin | None = None
        self._nearest: NearestForces | None = None
        self._last = _Outcome.FULL

    @property
    def limits(self) -> tuple[ContactLimits, ContactLimits]:
        """Limits of the contacts with the friction reserve and all errors of the settings, and without them."""
        return self._nominal.limits, self._bare.limits

    @property
    def has_plain_problem(self) -> bool:
        """Whether the structure of the hand carries no forces, and the margin of the settings leaves room for forces."""
        return self._structure.shape[1] == 0 and self._nominal.is_feasible

    @property
    def full_force_offset(self) -> Array:
        """(k,) shift of the normal forces for the margin of the settings, in the rows of f, N."""
        return self._nominal.force_offset

    def full_problem(self, targets: StepTargets, tau_u: Array) -> ForceProblem:
        """Return the problem whose cones keep the margin of the settings.

        Args:
            targets: targets of the step.
            tau_u: (n,) torques without contact forces, N·m.
        """
        w, shifted = targets.apply_slip_margin(tau_u, self._nominal.shift)
        return self._problem(self._nominal, targets, w, shifted).replace(p=targets.p_OC, R=targets.R_OC)

    def solve(
        self,
        targets: StepTargets,
        tau_u: Array,
        friction: Array | None = None,
        idle: Mask | None = None,
        ramp: Array | None = None,
        margin: float | None = None,
    ) -> MarginResult:
        """Return certified forces of least torque.

        Args:
            targets: targets of this step.
            tau_u: (n,) torques without contact forces, N·m.
            friction: (2, N) friction coefficients, before the reserve, and torsional friction lengths, m. Default: `least`.
            idle: (N,) contacts without force. Default: none.
            ramp: (N,) upper limits of the normal forces beside those of the contacts, N. Default: none.
            margin: slip margin, N, ≥ 0. Default: that of the settings.
        """
        wanted, bare = self._nominal, self._bare
        if any(given is not None for given in (friction, idle, ramp, margin)):
            limits = self._with_reserve(self.least if friction is None else friction, idle, ramp)
            wanted = _Level.of(self._contacts, limits, self.margin if margin is None else margin)
        if idle is not None or ramp is not None:
            bare = _Level.of(self._contacts, self._contact_limits(self._modelled, idle, ramp), 0.0)
        # the largest margin does not count ramped contacts, which may make the full one feasible
        if (self._last is _Outcome.FULL or ramp is not None) and wanted.is_feasible:
            solution, f = self._solve_level(wanted, targets, tau_u)
            if f is not None:
                self._last = _Outcome.FULL
                return MarginResult(solution, f, wanted.margin, "")
            if _allows_less(wanted, bare):  # then no smaller margin is feasible either, and one solve shows it
                solution, f = self._solve_level(bare, targets, tau_u)
                if f is None and solution.status is Status.INFEASIBLE:
                    self._last = _Outcome.NONE
                    return MarginResult(solution, None, 0.0, "")
        elif self._last is _Outcome.NONE:
            solution, f = self._solve_level(bare, targets, tau_u)
            if f is None:
                return MarginResult(solution, None, 0.0, "")
        for level, kept in self._reduced_levels(wanted, bare, targets, tau_u):
            if not level.is_feasible:
                continue
            solution, f = self._solve_level(level, targets, tau_u)
            if f is not None:
                self._last = _Outcome.REDUCED if kept else _Outcome.FULL
                return MarginResult(solution, f, level.margin, kept and f"the full slip margin is infeasible: {kept}")
        self._last = _Outcome.NONE
        return MarginResult(solution, None, 0.0, "")

    def find_nearest(
        self, targets: StepTargets, tau_u: Array, friction: Array | None = None, idle: Mask | None = None
    ) -> Array | None:
        """Return forces whose wrench is nearest to the required one, (k,), N and N·m; None if no forces are allowed.

        They keep the slip margin if this does not move their wrench away. They have no certificate.

        Args:
            targets: as in `solve`.
            tau_u: as in `solve`.
            friction: as in `solve`.
            idle: as in `solve`.
        """
        limits = self._with_reserve(self.least if friction is None else friction, idle)
        if self._nearest is None:
            self._nearest = NearestForces(self._problem(self._bare, targets, targets.w, tau_u))
        geometry = targets.p_OC, targets.R_OC, limits.friction
        J = self._with_structure(targets.J)
        plain = self._nearest.solve(targets.w, J, self._with_structure_torques(tau_u), *geometry, limits.normal)
        level = _Level.of(self._contacts, limits, self.margin)
        if plain is None or self.margin == 0.0 or not level.is_feasible:
            return None if plain is None else plain[0]
        w, tau = targets.apply_slip_margin(tau_u, level.shift)
        tau = self._with_structure_torques(tau, level.force_offset)
        squeezed = self._nearest.solve(w, J, tau, *geometry, level.normal_limits)
        tolerance = _AS_NEAR * float(np.linalg.norm(targets.w[:3]))  # N
        if squeezed is None or squeezed[1] > plain[1] + tolerance:
            return plain[0]
        return np.asarray(squeezed[0] + level.force_offset)

    def _with_reserve(self, friction: Array, idle: Mask | None, ramp: Array | None = None) -> ContactLimits:
        """Return the limits of contacts with some friction, (2, N), less the friction reserve."""
        usable = np.array([friction[0] * (1.0 - self._settings.friction_reserve), friction[1]])
        return self._contact_limits(usable, idle, ramp)

    def _contact_limits(self, friction: Array, idle: Mask | None, ramp: Array | None = None) -> ContactLimits:
        """Return the limits of contacts with some friction, (2, N); those of idle contacts are zero."""
        normal, ramped = self._normal, None
        if ramp is not None:
            normal, ramped = np.minimum(normal, ramp), np.isfinite(ramp)
        if idle is None:
            return ContactLimits(friction, normal, ramped)
        return ContactLimits(np.where(idle, 0.0, friction), np.where(idle, 0.0, normal), ramped)

    def _reduced_levels(self, wanted: _Level, bare: _Level, targets: StepTargets, tau_u: Array) -> Iterator[tuple[_Level, str]]:
        """Yield the levels to try after the first solve, and what they keep of the margin if it is not all of it."""
        if wanted.margin == 0.0 and self._last is not _Outcome.FULL:
            yield wanted, ""
        with_reserve, without = (wanted.limits, ""), (bare.limits, ", without the friction reserve")
        same = np.array_equal(wanted.limits.friction, bare.limits.friction)
        for limits, note in () if wanted.margin == 0.0 else (with_reserve,) if same else (with_reserve, without):
            largest = self._find_largest(limits.without_ramped, targets, tau_u)
            if largest is None:
                continue
            if not note and self._last is not _Outcome.FULL and largest >= wanted.margin * (1.0 - _EQUAL):
                yield wanted, ""
            for factor in _FACTORS:
                margin = factor * min(largest, wanted.margin)
                yield _Level.of(self._contacts, limits, margin), f"the largest is kept, {margin:.3g} N{note}"
        yield bare, "none of it is kept; the forces use all the friction"

    def _find_largest(self, limits: ContactLimits, targets: StepTargets, tau_u: Array) -> float | None:
        """Return the largest feasible margin, N; None if no forces exist."""
        if self._largest is None:
            self._largest = LargestMargin(self._problem(self._bare, targets, targets.w, tau_u), self.margin)
        J, tau_u = self._with_structure(targets.J), self._with_structure_torques(tau_u)
        return self._largest.solve(targets.w, J, tau_u, targets.p_OC, targets.R_OC, limits.friction, limits.normal)

    def _solve_level(self, level: _Level, targets: StepTargets, tau_u: Array) -> tuple[Solution, Array | None]:
        """Return the certified solution of a level's shifted problem, and the contact forces (k,); None without one."""
        w, tau_u = targets.apply_slip_margin(tau_u, level.shift) if level.margin > 0.0 else (targets.w, tau_u)
        if self._solver is None:
            self._solver, self._loaded = Solver(self._problem(level, targets, w, tau_u), explain=False), level
        mu, limits = (None, None) if level is self._loaded else (level.limits.friction, level.normal_limits)
        self._loaded = level
        J, tau_u = self._with_structure(targets.J), self._with_structure_torques(tau_u, level.force_offset)
        solution = self._solver.solve(w=w, J=J, tau_u=tau_u, mu=mu, p=targets.p_OC, R=targets.R_OC, normal_limits=limits)
        if not solution.found:
            return solution, None
        f = solution.f + level.force_offset
        f.setflags(write=False)  # the command and the next memory share it
        return solution, f

    def _with_structure(self, J: Array) -> Array:
        """Return J with the structural forces as joints without motor, which keep these forces at zero."""
        return J if self._structure.shape[1] == 0 else np.hstack([J, self._structure])

    def _with_structure_torques(self, tau_u: Array, force_offset: Array | None = None) -> Array:
        """Return tau_u with the torques of these joints from the shift of the normal forces, (k,), N."""
        if self._structure.shape[1] == 0:
            return tau_u
        return np.append(tau_u, np.zeros(self._structure.shape[1]) if force_offset is None else force_offset @ self._structure)

    def _problem(self, level: _Level, targets: StepTargets, w: Array, tau_u: Array) -> ForceProblem:
        """Return the force problem of a level at the contacts of the grasp."""
        hand, (mu, gamma), (lower, upper) = self._hand, map(freeze, level.limits.friction), map(freeze, level.normal_limits)
        contacts = dataclasses.replace(self._contacts, mu=mu, gamma=gamma, min_normal=lower, max_normal=upper)
        J, tau_u = self._with_structure(targets.J), self._with_structure_torques(tau_u, level.force_offset)
        none = np.zeros(self._structure.shape[1])
        limits = (np.append(limit, none) for limit in (hand.torque_lower, hand.torque_upper, hand.force_weight))
        actuation = Actuation(J, tau_u, *limits)
        return ForceProblem(contacts, w, actuation, objective=Objective("torque", self._settings.force_weight))
