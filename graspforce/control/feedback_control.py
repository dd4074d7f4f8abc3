"""Estimator, control law and memory of a grasp whose contacts may change, from measurements.

It is to `OutputFeedbackLaw` as `GraspControl` is to `ObjectControlLaw`: the laws of a change are prepared ahead, and later
steps only swap them. A change begins and ends at the estimated state of the last step.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy.typing as npt

from graspforce.control.contacts.contact_change import ContactChange
from graspforce.control.contacts.contact_conditions import ContactConditions
from graspforce.control.grasp_control import GraspControl, PreparedChange
from graspforce.control.memory import ControlMemory
from graspforce.control.object_control_law import ObjectControlLaw
from graspforce.control.output_feedback_law import OutputFeedbackLaw, OutputFeedbackMemory, OutputFeedbackStep
from graspforce.control.state import DesiredMotion, GraspState
from graspforce.core.errors import InvalidInput
from graspforce.core.records import unchecked_constructor
from graspforce.estimation.estimate import GraspEstimate
from graspforce.estimation.measurement import Measurement
from graspforce.estimation.pose.pose_fusion import PoseOffset
from graspforce.grasp.grasp import Grasp

_make_state = unchecked_constructor(GraspState)


@dataclass(frozen=True, eq=False, slots=True)
class FeedbackControl:
    """Law and memory after a step. Each method returns the next record.

    Args:
        law: estimator and control law of the present contacts.
        memory: memory after the last step.
        estimate: estimate of the last step; None before the first.
        released: control law without the contacts that let go; None if none lets go, or if it is not prepared.
    """

    law: OutputFeedbackLaw
    memory: OutputFeedbackMemory
    estimate: GraspEstimate | None = None
    released: ObjectControlLaw | None = None

    @classmethod
    def start(
        cls, law: OutputFeedbackLaw, memory: ControlMemory | None = None, offset: PoseOffset | None = None
    ) -> FeedbackControl:
        """Return the control of a grasp before its first step.

        Args:
            law: estimator and control law.
            memory: memory of the control law of an earlier step to continue from; None for a new start.
            offset: offset of the object from its pose in the grasp, from an earlier estimate; none by default.
        """
        released = None
        if memory is not None and memory.ramp is not None:
            released = GraspControl.start(law.law.grasp, law.settings, memory, type(law.law)).released
        return cls(law, law.initial_memory(memory, offset), None, released)

    @property
    def grasp(self) -> Grasp:
        """The present grasp."""
        return self.law.law.grasp

    @property
    def is_changing(self) -> bool:
        """Whether contacts let go or join."""
        return self.memory.control.ramp is not None

    def check(self, change: ContactChange) -> None:
        """Check that a change can begin.

        Args:
            change: the change.

        Raises:
            InvalidInput: another change is in progress, a finger that joins has a contact, or no contact would be left.
            UnknownName: no such finger, or a finger that lets go has no contact.
        """
        change.check(self.grasp, self.is_changing)

    def prepare(self, change: ContactChange) -> PreparedChange:
        """Return a change with its control laws, each after a first step. This takes the time of some control periods.

        Args:
            change: the change.

        Raises:
            InvalidInput: no step was made, or as in `check`.
            UnknownName: as in `check`.
        """
        return self._control.prepare(change, self._state(change))

    def begin(self, prepared: PreparedChange) -> FeedbackControl:
        """Return the control at the begin of a change.

        Args:
            prepared: the change, from `prepare`; these fingertips are at their contacts.

        Raises:
            InvalidInput: as in `prepare`.
            UnknownName: as in `prepare`.
        """
        return self._continued(self._control.begin(prepared, self._state(prepared.change)))

    def step(
        self,
        measurement: Measurement,
        desired: DesiredMotion,
        external: npt.ArrayLike | None = None,
        conditions: ContactConditions | None = None,
    ) -> tuple[OutputFeedbackStep, FeedbackControl]:
        """Compute estimate and command for the next period, and the control after it with the same contacts.

        Args:
            measurement: as in `OutputFeedbackController.step`.
            desired: as in `OutputFeedbackController.step`.
            external: as in `OutputFeedbackController.step`.
            conditions: as in `OutputFeedbackLaw.step`.

        Raises:
            InvalidInput: as in `OutputFeedbackController.step`.
            UnknownName: as in `OutputFeedbackController.step`.
        """
        step = self.law.step(self.memory, measurement, desired, external, conditions)
        return step, FeedbackControl(self.law, step.memory, step.estimate, self.released)

    def without_released(self) -> FeedbackControl:
        """Return the control without the contacts that have let go; itself if none has."""
        if self.memory.control.ramp is None or self.estimate is None:
            return self
        control = self._control
        rest = control.without_released(_make_state(self.estimate.q, self.estimate.v, self.estimate.object))
        return self if rest is control else self._continued(rest)

    @property
    def _control(self) -> GraspControl:
        """The control law with its memory."""
        return GraspControl(self.law.law, self.memory.control, self.released)

    def _state(self, change: ContactChange) -> GraspState:
        """Return the estimated state of the last step. Raise InvalidInput before the first."""
        if self.estimate is None:
            raise InvalidInput("change", change, "made after the first step, which estimates the state")
        return _make_state(self.estimate.q, self.estimate.v, self.estimate.object)

    def _continued(self, control: GraspControl) -> FeedbackControl:
        """Return the control with a control law, maybe of other contacts, at the estimated state of the last step."""
        if control.law is self.law.law:
            memory = self.memory._replace(control=control.memory)
            return dataclasses.replace(self, memory=memory, released=control.released)
        assert self.estimate is not None  # a step was made
        law = self.law.with_contacts(control.law)
        memory = law.continued_memory(self.memory, control.memory, self.grasp.fingers, self.estimate.q)
        return FeedbackControl(law, memory, self.estimate, control.released)
