"""Contact forces of a step: friction and fingers of the step, then the margin solver."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from graspforce.control.contacts.contact_change import ForceRamp
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
    """

    friction: Array | None
    reflex: ReflexMemory | None
    lost: LostDrives | None
    ramp: ForceRamp | None = None


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
        ramp = memory.ramp
        if ramp is not None:
            ramp = ramp.step(self._normal_forces(memory), self._settings.period, self._solver.full_limit)
        nominal = _NOMINAL if ramp is None else ContactPlan(None, None, None, ramp)
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
        reflex = self._reflex.step(memory.reflex, conditions.slipping, friction[0], memory.f)
        if reflex is not None:
            friction = friction / (1.0 + reflex.level)
        lost = self._find_lost(conditions.lost)
        return ContactPlan(None if friction is self._solver.least else friction, reflex, lost, ramp)

    def solve(self, plan: ContactPlan, targets: StepTargets, tau_u: Array) -> MarginResult:
        """Return certified forces of least torque with the largest margin, at most that of the settings.

        While a finger lets go, forces without any margin count as none: the other fingers alone do not hold the object.

        Args:
            plan: friction and fingers of the step.
            targets: targets of the step.
            tau_u: (n,) torques without contact forces, N·m.
        """
        idle = None if plan.lost is None else plan.lost.contacts
        if plan.ramp is None:
            return self._solver.solve(targets, tau_u, plan.friction, idle)
        idle = plan.ramp.idle if idle is None else idle | plan.ramp.idle
        forces = self._solver.solve(targets, tau_u, plan.friction, idle, plan.ramp.limit)
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
