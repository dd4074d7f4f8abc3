"""The object controller: the object control law with its memory, and changes of the contacts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy.typing as npt

from graspforce.control.command import Command
from graspforce.control.contacts.contact_change import ContactChange
from graspforce.control.contacts.contact_conditions import Mask, make_conditions
from graspforce.control.grasp_control import GraspControl
from graspforce.control.memory import ControlMemory
from graspforce.control.settings import ControlSettings
from graspforce.control.state import DesiredMotion, GraspState
from graspforce.grasp.grasp import Grasp

_DEFAULTS = ControlSettings()


class ObjectController:
    """Controller that makes a grasped object follow a motion. Call `step` once every period.

    The state gives joint positions and the object's pose; the command gives motor torques:

        controller = ObjectController(grasp, ControlSettings(period=1e-3))
        command = controller.step(GraspState(q, v, BodyMotion(p_HO, R_HO, twist)), BodyMotion(p_d, R_d))
        send(command.tau)

    Args:
        grasp: hand, object and contacts.
        settings: gains, margins, gravity and limits. Default: palm up, 1 kHz.
    """

    def __init__(self, grasp: Grasp, settings: ControlSettings = _DEFAULTS) -> None:
        self._start, self.settings = grasp, settings
        self.reset()

    def reset(self) -> None:
        """Reset grasp and memory to the start: contacts, integral, forces and sliding."""
        self._control = GraspControl.start(self._start, self.settings)

    def change_settings(self, settings: ControlSettings) -> None:
        """Continue with other settings, such as another slip margin. The memory stays.

        This takes the time of some steps, because it prepares the control law. Large changes step the torques.

        Args:
            settings: the new settings.
        """
        self.settings = settings
        self._control = GraspControl.start(self._control.grasp, settings, self._control.memory)

    @property
    def grasp(self) -> Grasp:
        """The present grasp: that of the start until contacts change."""
        return self._control.grasp

    @property
    def is_changing(self) -> bool:
        """Whether contacts let go or join."""
        return self._control.is_changing

    def change_contacts(self, change: ContactChange, state: GraspState) -> None:
        """Begin a change of the contacts; the next steps carry it out, without a jump of the forces.

        This takes the time of some steps, because it prepares the control laws of the changed contacts.

        Fingers that join belong to the grasp at once; their forces rise from zero. Fingers that let go leave the grasp after
        the step in which they carry nothing, and then follow the posture of the desired motion. They stay if the other fingers
        cannot hold the object; `is_changing` is false when the change is over.

        Args:
            change: fingers that let go, and contacts of fingers that join.
            state: measured state; the fingertips that join are at their contacts.

        Raises:
            InvalidInput: another change is in progress, a finger that joins has a contact, or no contact would be left.
            UnknownName: no such finger, or a finger that lets go has no contact.
        """
        self._control = self._control.begin(self._control.prepare(change, state), state)

    @property
    def memory(self) -> ControlMemory:
        """Memory after the last step."""
        return self._control.memory

    def step(
        self,
        state: GraspState,
        desired: DesiredMotion,
        external: npt.ArrayLike | None = None,
        *,
        slipping: Sequence[bool] | Mask | None = None,
        friction: npt.ArrayLike | None = None,
        lost: Sequence[str] = (),
    ) -> Command:
        """Compute the motor torques for the next period.

        Args:
            state: measured joint positions (n,) in rad and rates (n,) in rad/s, and the object's pose and twist in H.
            desired: desired pose, twist and acceleration of the object in H. With a `GraspMotion` the joints follow their own
                desired motion in the null space of the contacts, otherwise they keep the posture of the grasp.
            external: (6,) estimate of the wrench on the object that comes neither from gravity nor from the fingers, about O's
                origin, in O, N and N·m. None: no such wrench.
            slipping: (N,) whether each contact slips now, such as `estimation` finds it. The forces of this period already
                squeeze these contacts more; see `slip_reflex`.
            friction: (N,) lower bounds of the friction coefficients in this period, ≥ 0. Default: those of the contacts.
            lost: names of fingers whose drives are off. The other fingers take over their forces in this period if certified
                forces exist; otherwise the command stops the object, see `lost_drives`.

        Returns:
            Torques (n,) in N·m with the planned contact forces, their certificate and warnings.

        Raises:
            InvalidInput: the state belongs to another hand, or a value is not finite.
            UnknownName: a lost finger is not one of the grasp.
        """
        conditions = make_conditions(slipping, friction, lost)
        command, control = self._control.step(state, desired, external, conditions)
        self._control = control.without_released(state)
        return command
