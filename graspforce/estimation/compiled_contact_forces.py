"""Contact forces in C (`csrc/include/graspforce/contact_forces.h`). `contact_forces` is the reference implementation.

The C code writes gains and forces to blocks of memory. Fields that are seldom needed become arrays at their first access.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from graspforce.contact.compiled_kinematics import primitive_parameters
from graspforce.core.arrays import Array
from graspforce.core.compiled import Block, native, new_block
from graspforce.estimation.contact_forces import (
    ContactForceEstimator,
    ContactForces,
    ForceGains,
    ForceMemory,
    ForceModelErrors,
)
from graspforce.estimation.pose.compiled_contact_pose import CompiledContactPose
from graspforce.estimation.pose.contact_pose import ContactPose
from graspforce.estimation.sensor_model import SensorModel
from graspforce.grasp.grasp import Grasp


def make_force_estimator(
    grasp: Grasp, sensors: SensorModel, gravity_H: Array, errors: ForceModelErrors, disturbance_error: float
) -> ContactForceEstimator:
    """Return an estimator of contact forces: compiled if possible, the reference implementation elsewhere.

    Args:
        grasp: hand, object and contacts.
        sensors: noise of torques and fingertip sensors.
        gravity_H: (3,) acceleration of gravity in H, m/s².
        errors: constant errors of the model.
        disturbance_error: standard deviation of the estimated acceleration d, rad/s².
    """
    is_compiled = native is not None and primitive_parameters(grasp.body.shape) is not None
    estimator = CompiledForceEstimator if is_compiled else ContactForceEstimator
    return estimator(grasp, sensors, gravity_H, errors, disturbance_error)


class CompiledForceGains(ForceGains):
    """Gains in the block that the C code wrote.

    Attributes:
        block: all fields of the gains.
    """

    block: Block

    @classmethod
    def of(cls, block: Block) -> CompiledForceGains:
        """Return the gains of a block.

        Args:
            block: the block, as the compiled form wrote it.
        """
        block.setflags(write=False)
        gains = cls(*(block[name] for name in ForceGains._fields))
        gains.block = block
        return gains


class CompiledContactForces(ContactForces):
    """Forces in the block that the C code wrote.

    Attributes:
        block: all fields of the forces.
        gains: gains with which they were computed.
        has_tips: whether fingertip sensors measured forces.
    """

    block: Block
    gains: CompiledForceGains
    has_tips: bool
    f = cached_property(lambda forces: forces.block["f"])
    inertial = cached_property(lambda forces: forces.block["inertial"])
    mismatch = cached_property(lambda forces: forces.block["mismatch"] if forces.has_tips else None)
    measured = cached_property(lambda forces: forces.block["measured"] if forces.has_tips else None)
    noise = cached_property(lambda forces: forces.gains.noise)
    bias = cached_property(lambda forces: forces.gains.bias)
    mismatch_noise = cached_property(lambda forces: forces.gains.mismatch_noise)

    def __init__(self, block: Block, gains: CompiledForceGains, has_tips: bool, measured_variance: tuple[float, float]) -> None:
        vars(self).update(block=block, gains=gains, has_tips=has_tips, measured_variance=measured_variance)


class CompiledForceEstimator(ContactForceEstimator):
    """Estimator of the contact forces of a grasp by compiled code, which supports the object's shape.

    Args:
        grasp: hand, object and contacts.
        sensors: noise of torques and fingertip sensors.
        gravity_H: (3,) acceleration of gravity in H, m/s².
        errors: constant errors of the model.
        disturbance_error: standard deviation of the estimated acceleration d, rad/s².
    """

    def __init__(
        self,
        grasp: Grasp,
        sensors: SensorModel,
        gravity_H: Array,
        errors: ForceModelErrors | None = None,
        disturbance_error: float = 0.0,
    ) -> None:
        super().__init__(grasp, sensors, gravity_H, errors, disturbance_error)
        count, limits = self._count, self._errors
        self._model = new_block(np.dtype(native.force_model_layout(count)))
        values = {"torque_noise": self._torque_noise, "tip_noise": self._tip_noise, "gamma": self._gamma, "prior": self._prior}
        values |= {"disturbance_error": self._disturbance_error, "torque_bias": limits.torque_bias, "tip_bias": limits.tip_bias}
        values |= {"torque_scale": limits.torque_scale, "tip_scale": limits.tip_scale}
        for name, value in values.items():
            self._model[name] = value
        self._gains_dtype: np.dtype[np.void] = np.dtype(native.force_gains_layout(count, grasp.hand.n))
        self._dtype: np.dtype[np.void] = np.dtype(native.contact_forces_layout(count))

    def step(
        self,
        memory: ForceMemory,
        contacts: ContactPose,
        joints: Sequence[Array],
        tau: Array,
        acceleration: Array | None = None,
        tip_wrench: Array | None = None,
        free_torque: Array | None = None,
    ) -> tuple[ContactForces, ForceMemory]:
        """Return the contact forces of a period, and the memory for the next one; see `ContactForceEstimator.step`.

        Args:
            memory: memory after the last period; `ForceMemory()` before the first.
            contacts: the contacts, from the memory of a compiled estimator.
            joints: (n,) joint positions, rad, rates, rad/s, and deviations d of the accelerations, rad/s².
            tau: (n,) joint torques during the last period, N·m, without joint friction.
            acceleration: (n,) joint acceleration commanded for that period, rad/s²; None for none.
            tip_wrench: (N, 6) measured forces and moments of the fingers on the object, in H; None without sensors.
            free_torque: (n,) torques of the hand's own motion, N·m. Default: computed here.
        """
        assert isinstance(contacts, CompiledContactPose)  # the estimator makes no other for such a surface
        tau_u = self._free_torque(joints, acceleration) if free_torque is None else free_torque
        gains, memory = self._current_gains(memory, contacts, joints[0], tau, tip_wrench)
        assert isinstance(gains, CompiledForceGains)  # `_gains` makes no other
        block = new_block(self._dtype)
        native.contact_forces(
            contact_count=self._count,
            tau=tau,
            tip_wrench=tip_wrench,
            tau_u=tau_u,
            deviation=joints[2],
            gains=gains.block,
            pose=contacts.block,
            forces=block,
        )
        block.setflags(write=False)
        return CompiledContactForces(block, gains, tip_wrench is not None, self.measured_variance), memory

    def _gains(self, contacts: ContactPose, q: Array, tau: Array, tip_wrench: Array | None) -> CompiledForceGains:
        """Return the gains at the present contacts. The reference implementation treats errors of the contacts' positions."""
        assert isinstance(contacts, CompiledContactPose)
        block = new_block(self._gains_dtype)
        is_complete = self._errors.contact_place == 0.0 and native.force_gains(
            contact_count=self._count,
            tau=tau,
            tip_wrench=tip_wrench,
            model=self._model,
            pose=contacts.block,
            M=self._hand.model.mass_matrix(q),
            gains=block,
        )
        if not is_complete:
            for name, value in super()._gains(contacts, q, tau, tip_wrench)._asdict().items():
                block[name] = value
        return CompiledForceGains.of(block)
