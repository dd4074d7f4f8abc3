"""Control law and memory of a grasp whose contacts may change.

A change needs other laws: one with the contacts that join, and one without the contacts that let go. Their construction and
first step take longer than a control period. `GraspControl.prepare` makes them ahead, and later steps only swap the laws.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graspforce.contact.motion import BodyMotion
from graspforce.control.changed_grasp import begin_change, finish_release
from graspforce.control.command import Command
from graspforce.control.contacts.contact_change import ContactChange, ForceRamp
from graspforce.control.contacts.contact_conditions import ContactConditions
from graspforce.control.memory import ControlMemory
from graspforce.control.object_control_law import ObjectControlLaw
from graspforce.control.settings import ControlSettings
from graspforce.control.state import DesiredMotion, GraspState
from graspforce.core.records import unchecked_constructor
from graspforce.grasp.grasp import Grasp


@dataclass(frozen=True, eq=False, slots=True)
class PreparedChange:
    """A change of contacts, and the laws that it needs.

    Attributes:
        change: the change.
        joined: law with the contacts that join; None if none joins.
        released: law without the contacts that let go; None if none lets go.
    """

    change: ContactChange
    joined: ObjectControlLaw | None
    released: ObjectControlLaw | None


@dataclass(frozen=True, eq=False, slots=True)
class GraspControl:
    """Control law and memory after a step. Each method returns the next record.

    Args:
        law: control law of the present contacts.
        memory: memory after the last step.
        released: law without the contacts that let go; None if none lets go, or if it is not prepared.
    """

    law: ObjectControlLaw
    memory: ControlMemory
    released: ObjectControlLaw | None = None

    @classmethod
    def start(
        cls,
        grasp: Grasp,
        settings: ControlSettings,
        memory: ControlMemory | None = None,
        law_type: type[ObjectControlLaw] = ObjectControlLaw,
    ) -> GraspControl:
        """Return the control of a grasp before its first step.

        Args:
            grasp: hand, object and contacts.
            settings: settings of the controller.
            memory: memory of an earlier step to continue from; None for a new start.
            law_type: type of its control laws, also after changes of contacts.
        """
        law = law_type(grasp, settings)
        if memory is None:
            return cls(law, law.initial_memory())
        rest = GraspState(grasp.q, np.zeros(grasp.hand.n), BodyMotion(grasp.p_HO, grasp.R_HO))
        return cls(law, memory, _prepare_released(law, grasp, memory, rest))

    @property
    def grasp(self) -> Grasp:
        """The present grasp."""
        return self.law.grasp

    @property
    def is_changing(self) -> bool:
        """Whether contacts let go or join."""
        return self.memory.ramp is not None

    def check(self, change: ContactChange) -> None:
        """Check that a change can begin.

        Args:
            change: the change.

        Raises:
            InvalidInput: another change is in progress, a finger that joins has a contact, or no contact would be left.
            UnknownName: no such finger, or a finger that lets go has no contact.
        """
        change.check(self.grasp, self.memory.ramp is not None)

    def prepare(self, change: ContactChange, state: GraspState) -> PreparedChange:
        """Return a change with its laws, each after a first step. This takes the time of some control periods.

        Args:
            change: the change.
            state: measured state.

        Raises:
            InvalidInput: as in `check`.
            UnknownName: as in `check`.
        """
        grasp, memory = begin_change(self.grasp, self.memory, state, change)
        joined = None
        if grasp is not self.grasp:
            joined = _practised(_law_like(self.law, grasp), memory, state)
        return PreparedChange(change, joined, _prepare_released(self.law, grasp, memory, state))

    def begin(self, prepared: PreparedChange, state: GraspState) -> GraspControl:
        """Return the control at the begin of a change.

        Args:
            prepared: the change, from `prepare`.
            state: measured state; the fingertips that join are at their contacts.

        Raises:
            InvalidInput: as in `check`.
            UnknownName: as in `check`.
        """
        grasp, memory = begin_change(self.grasp, self._memory_with_margin(), state, prepared.change)
        law = self.law if prepared.joined is None else prepared.joined.with_grasp(grasp)
        return GraspControl(law, memory, prepared.released)

    def step(
        self,
        state: GraspState,
        desired: DesiredMotion,
        external: npt.ArrayLike | None = None,
        conditions: ContactConditions | None = None,
    ) -> tuple[Command, GraspControl]:
        """Compute the command for the next period, and the control after it with the same contacts.

        Args:
            state: as in `ObjectController.step`.
            desired: as in `ObjectController.step`.
            external: as in `ObjectController.step`.
            conditions: of the contacts in this step; as modelled by default.

        Raises:
            InvalidInput: as in `ObjectController.step`.
            UnknownName: as in `ObjectController.step`.
        """
        command, memory = self.law.step(self.memory, state, desired, external, conditions)
        return command, _make_control(self.law, memory, self.released)

    def without_released(self, state: GraspState) -> GraspControl:
        """Return the control without the contacts that have let go; itself if none has.

        Args:
            state: measured state of the last step.
        """
        ramp = self.memory.ramp
        if ramp is None or not ramp.is_released:
            return self
        grasp, memory = finish_release(self.grasp, self._memory_with_margin(), state)
        law = _law_like(self.law, grasp) if self.released is None else self.released.with_grasp(grasp)
        return GraspControl(law, memory)

    def _memory_with_margin(self) -> ControlMemory:
        """Return the memory with the slip margin of the last step: the law of other contacts continues from there."""
        memory = self.memory
        if memory.margin is not None or memory.f is None:
            return memory
        return dataclasses.replace(memory, margin=self.law.force_solver.margin)


_make_control = unchecked_constructor(GraspControl)  # faster than dataclasses.replace


def _law_like(law: ObjectControlLaw, grasp: Grasp) -> ObjectControlLaw:
    """Return a law of the same type and settings for another grasp."""
    return type(law)(grasp, law.settings)


def _prepare_released(law: ObjectControlLaw, grasp: Grasp, memory: ControlMemory, state: GraspState) -> ObjectControlLaw | None:
    """Return the law without the contacts that let go, after a first step; None if none lets go."""
    ramp: ForceRamp | None = memory.ramp
    if ramp is None or not ramp.releasing.any():
        return None
    rest, memory = finish_release(grasp, memory, state)
    return _practised(_law_like(law, rest), memory, state)


def _practised(law: ObjectControlLaw, memory: ControlMemory, state: GraspState) -> ObjectControlLaw:
    """Return a law after a step at rest, which starts its solvers."""
    law.step(memory, state, BodyMotion(state.object.p_HO, state.object.R_HO))
    return law
