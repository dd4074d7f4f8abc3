"""A step of the object controller that learns the errors of the drives; see `graspforce.control.drives.torque_factors`."""

from __future__ import annotations

from graspforce.control.contacts.contact_constraints import ContactConstraints
from graspforce.control.drives.drive_margin import TorqueSensitivity, torque_sensitivity
from graspforce.control.drives.torque_factors import TorqueFactorEstimator, TorqueFactors, null_space_part
from graspforce.control.settings import ControlSettings
from graspforce.control.state import DesiredMotion, GraspMotion, GraspState
from graspforce.control.step_data import StepResult, StepTargets
from graspforce.core.arrays import Array
from graspforce.grasp.grasp import Grasp


class DriveLearning:
    """Learning of one grasp's drives, without memory of its own.

    Args:
        grasp: the grasp.
        settings: settings of the controller.
        constraints: kinematic constraints of the contacts.

    Attributes:
        is_active: whether a drive states an error and the controller has an integral.
    """

    def __init__(self, grasp: Grasp, settings: ControlSettings, constraints: ContactConstraints) -> None:
        self._estimator = TorqueFactorEstimator(grasp.hand, settings.gains.rows()[2], settings.period)
        self._constraints, self._rank_tolerance = constraints, settings.rank_tolerance
        self.is_active = self._estimator.is_active

    def step(
        self,
        factors: TorqueFactors | None,
        grasp: Grasp,
        state: GraspState,
        desired: DesiredMotion,
        targets: StepTargets,
        result: StepResult,
    ) -> tuple[TorqueFactors, Array, TorqueSensitivity]:
        """Return the estimated errors, the integral that moved along, and the effects of torque errors.

        Args:
            factors: estimate after the last step; None before the first.
            grasp: the grasp at its present posture.
            state: measured state of the step.
            desired: desired motion, without the offset of the posture.
            targets: targets of the step.
            result: torques of the step, and the integral after it.
        """
        q_d = desired.q if isinstance(desired, GraspMotion) else grasp.q
        A, B, _ = self._constraints.constraint_rows(targets.rolling)
        masses = grasp.hand.model.mass_matrix(state.q), grasp.body.mass_matrix()
        sensitivity = torque_sensitivity(A, B, *masses, self._constraints, grasp.contacts)
        effect_H = (state.object.R_HO @ sensitivity.acceleration.reshape(2, 3, -1)).reshape(6, -1)
        drift = null_space_part(A, q_d - state.q, self._rank_tolerance)
        factors, integral = self._estimator.step(factors, effect_H, result.tau, result.integral, drift)
        return factors, integral, sensitivity
