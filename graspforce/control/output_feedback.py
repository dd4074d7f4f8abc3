"""Control of a grasped object from measurements, and changes of its contacts.

Each period, an estimator gives joint positions, joint rates and the object's pose from what the hand measures
(`graspforce.estimation`). The law of `ObjectController` acts on this estimate; see `OutputFeedbackLaw`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy.typing as npt

from graspforce.control.command import Command
from graspforce.control.contacts.contact_change import ContactChange
from graspforce.control.contacts.contact_conditions import Mask, make_conditions
from graspforce.control.feedback_control import FeedbackControl
from graspforce.control.output_feedback_law import OutputFeedbackLaw
from graspforce.control.settings import ControlSettings
from graspforce.control.state import DesiredMotion
from graspforce.core.errors import InvalidInput
from graspforce.estimation.estimate import GraspEstimate
from graspforce.estimation.grasp_monitor import GraspMonitorEstimate
from graspforce.estimation.measurement import Measurement
from graspforce.estimation.sensor_model import SensorModel
from graspforce.grasp.grasp import Grasp


class OutputFeedbackController:
    """Controller that makes a grasped object follow a motion, from what a hand measures. Call `step` once every period.

    Only joint positions are required; camera poses of the object may be late, rare or missing:

        sensors = SensorModel(encoder_noise=1e-3, camera=CameraModel(rate=30.0, latency=0.05))
        controller = OutputFeedbackController(grasp, sensors=sensors)
        command = controller.step(Measurement(t, q), BodyMotion(p_d, R_d))
        send(command.tau)

    Args:
        grasp: hand, object and contacts, as far as they are known.
        settings: settings of the controller. Default: `ControlSettings.for_sensors` of the sensors and the hand's drives.
        sensors: noise, rate and latency of the sensors. Default: nearly perfect encoders, no camera.
        monitored: as in `OutputFeedbackLaw`.

    Attributes:
        monitor: contact forces, slip, friction and payload of the last step; None without a monitor.
    """

    def __init__(
        self,
        grasp: Grasp,
        settings: ControlSettings | None = None,
        sensors: SensorModel | None = None,
        monitored: bool | None = None,
    ) -> None:
        self._first_law = OutputFeedbackLaw(grasp, settings, sensors, monitored)
        self._sensors, self._monitored = sensors, monitored
        self._control: FeedbackControl
        self.reset()

    @property
    def settings(self) -> ControlSettings:
        """Settings of the control law."""
        return self._control.law.settings

    def continue_with(self, grasp: Grasp) -> None:
        """Continue with another model of the same grasp, such as other torque limits, friction or mass.

        Estimate and memory are kept. It takes some milliseconds: a driver with a hard period calls it in another thread.

        Args:
            grasp: the same hand, fingers and contact models with other numbers.

        Raises:
            InvalidInput: contacts let go or join now.
        """
        if self.is_changing:
            raise InvalidInput("grasp", grasp, "given when no contacts let go or join")
        self._first_law = OutputFeedbackLaw(grasp, self.settings, self._sensors, self._monitored)
        self._control = dataclasses.replace(self._control, law=self._first_law)

    @property
    def grasp(self) -> Grasp:
        """The present grasp: that of the start until contacts change."""
        return self._control.grasp

    @property
    def is_changing(self) -> bool:
        """Whether contacts let go or join."""
        return self._control.is_changing

    @property
    def estimate(self) -> GraspEstimate | None:
        """Estimate of the last step; None before the first."""
        return self._control.estimate

    def change_contacts(self, change: ContactChange) -> None:
        """Begin a change of the contacts, as `ObjectController.change_contacts`, at the estimated state of the last step.

        Estimator and monitor continue with the contacts that are left or join, from the estimated pose of the object. The
        estimates of slip, friction and payload start anew then.

        Args:
            change: fingers that let go, and contacts of fingers that join; these fingertips are at their contacts.

        Raises:
            InvalidInput: no step was made, another change is in progress, a finger that joins has a contact, or no contact
                would be left.
            UnknownName: no such finger, or a finger that lets go has no contact.
        """
        self._control = self._control.begin(self._control.prepare(change))

    def reset(self) -> None:
        """Forget everything, as before the first step, and return to the contacts of the start."""
        self._control = FeedbackControl(self._first_law, self._first_law.initial_memory())
        self.monitor: GraspMonitorEstimate | None = None

    def step(
        self,
        measurement: Measurement,
        desired: DesiredMotion,
        external: npt.ArrayLike | None = None,
        *,
        slipping: Sequence[bool] | Mask | None = None,
        friction: npt.ArrayLike | None = None,
        lost: Sequence[str] = (),
    ) -> Command:
        """Compute the command for the next period.

        Args:
            measurement: what the hand measured in this period; joint positions at least.
            desired: desired pose, twist and acceleration of the object in H at the time of the measurement; in a `GraspMotion`
                also of the joints. It is continued over the latency of the sensors with constant acceleration.
            external: (6,) known wrench on the object that comes neither from gravity nor from the fingers, about O's origin,
                in O, N and N·m. None: no such wrench.
            slipping: (N,) whether each contact slips now. Default: as the monitor finds it.
            friction: (N,) lower bounds of the friction coefficients in this period, ≥ 0. Default: as the monitor finds them.
            lost: names of fingers whose drives are off, as in `ObjectController.step`. Their fingertips do not determine the
                object's pose.

        Returns:
            Torques (n,) in N·m with the planned contact forces, their certificate and warnings. `Command.error` is the pose
            error of the best known pose, `GraspEstimate.fused_pose`.

        Raises:
            InvalidInput: the measurement belongs to another hand, is earlier than the last one, or a value is not finite.
            UnknownName: a lost finger is not one of the grasp.
        """
        conditions = make_conditions(slipping, friction, lost)
        step, control = self._control.step(measurement, desired, external, conditions)
        self.monitor, self._control = step.monitor, control.without_released()
        return step.command
