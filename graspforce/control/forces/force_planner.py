"""Contact forces of a step: friction and fingers of the step, then the margin solver.

The slip margin of other contacts may differ: it covers the errors of the drives, of the mass and of the friction. After a
change of contacts it therefore moves at a bounded rate, |ds/dt| ≤ 2 N/s, from the last margin to the new one.

While a finger lets go, the margin may become infeasible. It then falls at the same rate towards the largest margin of the
other fingers, and the force of the finger waits as long. While a finger joins, the margin waits where it cannot rise, or falls
at this rate.

Where a small step of the ramp moves a force by more than 2 r Δt, with the rate r of the ramp, a part of the step is taken.
Changes of the forces that the state causes do not count.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from graspforce.control.contacts.contact_change import FORCE_RATE, ForceRamp
from graspforce.control.contacts.contact_conditions import ContactConditions
from graspforce.control.contacts.lost_drives import LostDrives
from graspforce.control.contacts.slip_reflex import ReflexMemory, SlipReflex
from graspforce.control.forces.margin_solver import MarginResult, MarginSolver
from graspforce.control.memory import ControlMemory
from graspforce.control.settings import ControlSettings
from graspforce.control.step_data import StepTargets
from graspforce.core.arrays import Array
from graspforce.force.error_vertices import tilted_friction
from graspforce.grasp.grasp import Grasp


class ContactPlan(NamedTuple):
    """Friction and fingers of one step.

    Attributes:
        friction: (2, N) friction coefficients and torsional friction lengths, m; None for those of the settings.
        reflex: memory of the reflex after the step; None if no contact is squeezed.
        lost: contacts and motors of fingers whose drives are off; None if all are on.
        ramp: limits of the forces of contacts that change; None if none changes.
        margin: slip margin of the step, N, after a change of contacts; None for that of the settings.
        without_precaution: the plan without precaution, for a step whose limits leave no room for it; None without precaution.
    """

    friction: Array | None
    reflex: ReflexMemory | None
    lost: LostDrives | None
    ramp: ForceRamp | None = None
    margin: float | None = None
    without_precaution: ContactPlan | None = None


_MARGIN_RATE = 2.0  # N/s
_SAME_MARGIN = 1e-9  # N
_MOST_CHANGE = 2.0  # of a force in a step, relative to that of the ramp's rate
_LEAST_SHARE = 0.1  # of a step of a ramp that is divided
_DIVISIONS = 2  # of a step
_STEEP = 5.0  # change of a force, relative to that of the limits: the margin is then near its largest value
_MARGIN_SHARES = (1.0, 0.3, 0.1, 0.03, 0.01)  # of the largest change of the margin, tried in this order
_AS_MODELLED = ContactConditions()
_NOMINAL = ContactPlan(None, None, None)


class ForcePlanner:
    """Plan of the contact forces of one grasp, without memory of its own.

    Args:
        grasp: hand, object and contacts.
        settings: settings of the controller.
        drive_margin: slip margin for the errors of the drives, N.
    """

    def __init__(self, grasp: Grasp, settings: ControlSettings, drive_margin: float = 0.0) -> None:
        self._grasp, self._settings = grasp, settings
        self._solver = MarginSolver(grasp, settings, drive_margin)
        self._reflex = SlipReflex(grasp.contacts, settings, self._solver.margin)
        self._lost: LostDrives | None = None  # of the last step

    @property
    def solver(self) -> MarginSolver:
        """The solver of the contact forces."""
        return self._solver

    def plan_contacts(self, memory: ControlMemory, conditions: ContactConditions | None) -> ContactPlan:
        """Return friction and fingers of a step.

        Args:
            memory: memory after the last step.
            conditions: of the contacts in this step; None for as modelled.

        Raises:
            InvalidInput: the conditions have another number of contacts.
            UnknownName: a lost finger is not one of the grasp.
        """
        ramp = self._next_ramp(memory)
        margin = self._next_margin(memory.margin, ramp)
        nominal = _NOMINAL if ramp is None and margin is None else ContactPlan(None, None, None, ramp, margin)
        if conditions is None and memory.reflex is None:
            return nominal
        conditions = conditions or _AS_MODELLED
        conditions.check(self._grasp)
        if memory.reflex is None and not conditions.affects_forces:
            return nominal
        modelled, friction = self._grasp.contacts, self._solver.least
        if conditions.friction is not None:
            mu = np.where(modelled.mu > 0.0, conditions.friction, 0.0)
            gamma = np.divide(modelled.gamma * mu, modelled.mu, out=np.zeros(len(mu)), where=modelled.mu > 0.0)  # m
            friction = np.array(tilted_friction(mu, gamma, np.array([self._settings.contact_error])))
        due = conditions.is_precaution_due
        reflex = self._reflex.step(memory.reflex, conditions.slipping, friction[0], memory.f, due)
        plan = ContactPlan(None, None, self._find_lost(conditions.lost), ramp, margin)
        if reflex is None or reflex.precaution is None:
            return self._with_reflex(plan, friction, reflex)
        without = self._with_reflex(plan, friction, reflex.without_precaution)
        return self._with_reflex(plan, friction, reflex)._replace(without_precaution=without)

    def _with_reflex(self, plan: ContactPlan, friction: Array, reflex: ReflexMemory | None) -> ContactPlan:
        """Return a plan with a reflex, from the friction (2, N) without it."""
        if reflex is not None:
            friction = friction / (1.0 + reflex.squeeze)
        return plan._replace(friction=None if friction is self._solver.least else friction, reflex=reflex)

    def solve(
        self, plan: ContactPlan, memory: ControlMemory, targets: StepTargets, tau_u: Array
    ) -> tuple[ContactPlan, MarginResult]:
        """Return certified forces of least torque with the largest margin, at most that of the settings, and their plan.

        While a finger lets go, forces without any margin count as none: the other fingers alone do not hold the object.

        Args:
            plan: friction and fingers of the step.
            memory: memory after the last step.
            targets: targets of the step.
            tau_u: (n,) torques without contact forces, N·m.

        Returns:
            The plan, with a smaller step of its ramp if forces or margin would change too fast otherwise; and the forces.
        """
        forces = self._solve(plan, targets, tau_u)
        if plan.without_precaution is not None and (forces.f is None or forces.warning):
            plan = plan.without_precaution
            forces = self._solve(plan, targets, tau_u)
        if memory.f is None or forces.f is None:
            return plan, forces
        if plan.ramp is None or memory.ramp is None:
            is_moving = plan.ramp is None and memory.ramp is None and plan.margin is not None and forces.margin >= plan.margin
            return self._divide_step(plan, forces, memory, targets, tau_u) if is_moving else (plan, forces)
        if plan.margin is not None and memory.margin is not None:
            is_releasing = _is_releasing(plan.ramp)
            enough = max(memory.margin - self._margin_change, 0.0) if is_releasing else min(plan.margin, memory.margin)  # N
            if forces.margin < enough:
                return self._keep_margin(plan, forces, memory, targets, tau_u)
            change = float(np.abs(forces.f - memory.f).max())  # N
            steep = max(self._largest_change(plan.ramp) / _MOST_CHANGE, _STEEP * (plan.ramp.change or 0.0))  # N
            if is_releasing and change > steep:
                plan, forces = self._lower_margin(plan, (plan, forces), memory, targets, tau_u, change)
        return self._divide_step(plan, forces, memory, targets, tau_u)

    def _keep_margin(
        self, plan: ContactPlan, forces: MarginResult, memory: ControlMemory, targets: StepTargets, tau_u: Array
    ) -> tuple[ContactPlan, MarginResult]:
        """Return plan and forces of a step whose margin would fall too fast.

        A finger that joins goes on with the last margin if it is feasible. Otherwise the ramp waits, and the margin falls, by
        less where forces would change too much: near the largest margin they change with the root of its distance.
        """
        ramp, last, margin = memory.ramp, memory.f, memory.margin
        if ramp is None or last is None or margin is None:
            return plan, forces
        if not _is_releasing(plan.ramp):
            going = plan._replace(margin=margin)
            kept = self._solve(going, targets, tau_u)
            if kept.f is not None and kept.margin >= margin:
                return self._divide_step(going, kept, memory, targets, tau_u)
        return self._lower_margin(plan._replace(ramp=ramp), (plan, forces), memory, targets, tau_u)

    def _lower_margin(
        self,
        plan: ContactPlan,
        found: tuple[ContactPlan, MarginResult],
        memory: ControlMemory,
        targets: StepTargets,
        tau_u: Array,
        least: float = np.inf,
    ) -> tuple[ContactPlan, MarginResult]:
        """Return the plan with a lower margin whose forces change least from the last ones, and these forces.

        Args:
            plan: the plan.
            found: plan and forces to return otherwise.
            memory: memory after the last step.
            targets: targets of the step.
            tau_u: (n,) torques without contact forces, N·m.
            least: change of the forces that were found, N; infinite for a margin that was lost.
        """
        last, margin, lost = memory.f, memory.margin, not np.isfinite(least)
        if last is None or margin is None:
            return found
        for share in _MARGIN_SHARES:
            lower = max(margin - share * self._margin_change, 0.0)  # N
            if lost and lower <= found[1].margin:
                continue
            lowered = plan._replace(margin=lower)
            forces = self._solve(lowered, targets, tau_u)
            if forces.f is None or forces.margin < lower * (1.0 - _SAME_MARGIN):
                break
            change = float(np.abs(forces.f - last).max())  # N
            if change < least:
                least, found, lost = change, (lowered, forces), False
            if change <= self._largest_change(plan.ramp) / _MOST_CHANGE:
                break
        return found

    def _divide_step(
        self, plan: ContactPlan, forces: MarginResult, memory: ControlMemory, targets: StepTargets, tau_u: Array
    ) -> tuple[ContactPlan, MarginResult]:
        """Return plan and forces of a part of the step, in which no force changes too much; of all of it if none does.

        What the state alone changes does not count: noise of an estimated state moves the forces more than the ramp.
        """
        ramp, last, share = memory.ramp, memory.f, 1.0
        if last is None:
            return plan, forces
        largest, rise = self._largest_change(ramp), 0.0  # N
        if plan.margin is not None and memory.margin is not None:
            rise = plan.margin - memory.margin  # N
        if forces.f is not None and float(np.abs(forces.f - last).max()) > largest:
            held = self._solve(plan._replace(ramp=ramp, margin=memory.margin), targets, tau_u)
            last = last if held.f is None else held.f
        for _ in range(_DIVISIONS):
            change = 0.0 if forces.f is None else float(np.abs(forces.f - last).max())  # N
            if change <= largest:
                break
            share *= max(largest / change, _LEAST_SHARE)
            margin = plan.margin if memory.margin is None else memory.margin + share * rise
            smaller = plan._replace(ramp=self._next_ramp(memory, share), margin=margin)
            part = self._solve(smaller, targets, tau_u)
            if part.f is None or part.margin < min(forces.margin, np.inf if margin is None else margin):
                break
            plan, forces = smaller, part
        return plan, forces

    def _largest_change(self, ramp: ForceRamp | None) -> float:
        """Return the largest change of a force in a step with a ramp, or after one, N."""
        return _MOST_CHANGE * (FORCE_RATE if ramp is None else ramp.rate) * self._settings.period

    def _solve(self, plan: ContactPlan, targets: StepTargets, tau_u: Array) -> MarginResult:
        """Return the forces of a plan; none if they keep no margin while a finger lets go."""
        idle = None if plan.lost is None else plan.lost.contacts
        if plan.ramp is None:
            return self._solver.solve(targets, tau_u, plan.friction, idle, margin=plan.margin)
        idle = plan.ramp.idle if idle is None else idle | plan.ramp.idle
        forces = self._solver.solve(targets, tau_u, plan.friction, idle, plan.ramp.limit, plan.margin)
        is_release = plan.lost is None and plan.ramp.normal_force is not None and plan.ramp.releasing.any()
        return forces._replace(f=None, warning="") if is_release and forces.warning and forces.margin == 0.0 else forces

    def find_emergency_forces(self, plan: ContactPlan, memory: ControlMemory, targets: StepTargets, tau_u: Array) -> Array:
        """Return the forces of a step without certified ones, (k,), N and N·m.

        They are those of the last step, or after the loss of a finger those with the nearest wrench.

        Args:
            plan: friction and fingers of the step.
            memory: memory after the last step.
            targets: targets of the step.
            tau_u: (n,) torques without contact forces, N·m.
        """
        last = np.zeros(self._grasp.contacts.size) if memory.f is None else memory.f
        if plan.lost is None:
            return last
        nearest = self._solver.find_nearest(targets, tau_u, plan.friction, plan.lost.contacts)
        return np.zeros_like(last) if nearest is None else nearest

    def kept_margin(self, plan: ContactPlan, forces: MarginResult) -> float | None:
        """Return the slip margin to remember after a step, N; None if it is that of the settings and no contact changes.

        Args:
            plan: friction and fingers of the step.
            forces: its forces.
        """
        if plan.ramp is None and plan.margin is None:
            return None
        kept = plan.margin if forces.f is None else forces.margin
        is_settled = kept is None or abs(kept - self._solver.margin) <= _SAME_MARGIN
        return None if plan.ramp is None and is_settled else kept

    def _next_ramp(self, memory: ControlMemory, share: float = 1.0) -> ForceRamp | None:
        """Return the ramp of a step after a share of its change; None if nothing changes."""
        if memory.ramp is None:
            return None
        return memory.ramp.step(self._normal_forces(memory), self._settings.period, self._solver.full_limit, share)

    def _next_margin(self, last: float | None, ramp: ForceRamp | None) -> float | None:
        """Return the slip margin of a step after one with another margin, N; None for that of the settings.

        It does not rise while a finger lets go.
        """
        if last is None:
            return None
        rise = 0.0 if _is_releasing(ramp) else self._margin_change  # N
        return last + min(max(self._solver.margin - last, -self._margin_change), rise)

    @property
    def _margin_change(self) -> float:
        """Largest change of the slip margin in a step, N."""
        return _MARGIN_RATE * self._settings.period

    def _normal_forces(self, memory: ControlMemory) -> Array | None:
        """Return the planned normal forces of the last step, (N,), N; None before the first."""
        return None if memory.f is None else np.asarray(memory.f[self._grasp.contacts.normal_rows])

    def _find_lost(self, fingers: tuple[str, ...]) -> LostDrives | None:
        """Return the contacts and motors of fingers whose drives are off; None if all are on."""
        if not fingers:
            return None
        if self._lost is None or self._lost.fingers != fingers:
            self._lost = LostDrives.of(self._grasp, fingers)
        return self._lost


def _is_releasing(ramp: ForceRamp | None) -> bool:
    """Return whether a contact is to let go."""
    return ramp is not None and not ramp.blocked and bool(ramp.releasing.any())
