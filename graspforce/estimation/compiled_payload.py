"""Payload in C (`csrc/include/graspforce/payload_step.h`). `payload` is the reference implementation.

The C code reads and writes the state in one block of memory.
"""

from __future__ import annotations

import numpy as np

from graspforce.contact.compiled_kinematics import primitive_parameters
from graspforce.contact.motion import BodyMotion
from graspforce.core.arrays import Array
from graspforce.core.compiled import Block, native, new_block
from graspforce.estimation.compiled_contact_forces import CompiledContactForces
from graspforce.estimation.contact_forces import ContactForces, contact_wrench, wrench_covariances
from graspforce.estimation.payload import (
    PayloadEstimate,
    PayloadEstimator,
    PayloadInputs,
    PayloadMemory,
    PayloadSettings,
    make_estimate,
)
from graspforce.estimation.pose.compiled_contact_pose import CompiledContactPose
from graspforce.estimation.pose.contact_pose import ContactPose
from graspforce.grasp.body import Body

_NO_SUMS = np.zeros(15)


class ForcePayloadEstimator(PayloadEstimator):
    """Estimator of the payload from sums of contact forces over some periods.

    Args:
        body: the given body: prior of mass and centre of mass, and inertia.
        period: time between two updates, s.
        settings: memory, prior and thresholds.
    """

    def __init__(self, body: Body, period: float, settings: PayloadSettings | None = None) -> None:
        super().__init__(body, period, settings, block=1)

    def update(
        self,
        memory: PayloadMemory,
        contacts: ContactPose,
        forces: ContactForces,
        mean: tuple[Array, int],
        motion: tuple[BodyMotion, Array],
    ) -> PayloadMemory:
        """Return the memory after some periods. Contacts and rates are those of the last one: they change little meanwhile.

        Args:
            memory: memory after the last update.
            contacts: the contacts.
            forces: contact forces of the last period, for their covariances.
            mean: (N, 3) sum of the contact forces, N, and the number of periods.
            motion: desired motion of the object, and (3,) the acceleration of gravity in H, m/s².
        """
        (force_sum, periods), (body, gravity_H) = mean, motion
        rates = np.empty((3, 3))
        rates[0], rates[1], rates[2] = body.acceleration[:3] - gravity_H, body.acceleration[3:], body.twist[3:]
        noise, bias = wrench_covariances(contacts, forces)
        w = contact_wrench(contacts, force_sum / periods)
        return self.step(memory, PayloadInputs(w, (noise / periods, bias), rates.dot(contacts.R_HO)))[1]


def make_payload_estimator(body: Body, period: float, settings: PayloadSettings | None = None) -> ForcePayloadEstimator:
    """Return an estimator of the payload: compiled if possible, the reference implementation elsewhere.

    Args:
        body: the given body: prior of mass and centre of mass, and inertia.
        period: time between two updates, s.
        settings: memory, prior and thresholds.
    """
    is_compiled = native is not None and primitive_parameters(body.shape) is not None
    return (CompiledPayloadEstimator if is_compiled else ForcePayloadEstimator)(body, period, settings)


class CompiledPayloadMemory(PayloadMemory):
    """Memory in the block that the C code wrote.

    Attributes:
        block: the state.
    """

    block: Block

    @classmethod
    def of(cls, block: Block) -> CompiledPayloadMemory:
        """Return the memory of a block.

        Args:
            block: the block, as the compiled form wrote it.
        """
        block.setflags(write=False)
        residual, disturbed, updates = block["residual"], float(block["disturbed"][0]), int(block["updates"][0])
        parts = float(block["mass"][0]), block["p_OM"], block["covariance"], residual, block["external_covariance"]
        sums = block["information"], block["score"], block["gain"], block["noise"], block["direction"]
        estimate: PayloadEstimate = make_estimate(*parts, disturbed > 0.0)
        memory = cls(0, _NO_SUMS, *sums, residual, block["slow"], disturbed, updates, estimate)
        memory.block = block
        return memory


class CompiledPayloadEstimator(ForcePayloadEstimator):
    """Estimator of the payload by compiled code. Contacts and forces come from compiled estimators.

    Args:
        body: the given body: prior of mass and centre of mass, and inertia.
        period: time between two updates, s.
        settings: memory, prior and thresholds.
    """

    def __init__(self, body: Body, period: float, settings: PayloadSettings | None = None) -> None:
        super().__init__(body, period, settings)
        self._numbers = new_block(np.dtype(native.payload_settings_layout()))
        values: dict[str, object] = {"period": self._block, "kept": self._kept, "external_gain": self._external_gain}
        values |= {"prior": np.diag(self._prior), "theta": self._theta, "inertia": self._inertia}
        values |= {"threshold": self._threshold, "unmodelled": np.diag(self._unmodelled)}
        values |= {"attitude_error": self.settings.attitude_error, "adaption_time": self.settings.adaption_time}
        for name, value in values.items():
            self._numbers[name] = value
        self._inputs_dtype: np.dtype[np.void] = np.dtype(native.payload_inputs_layout())
        self._state_dtype: np.dtype[np.void] = np.dtype(native.payload_state_layout())

    def initial_memory(self) -> CompiledPayloadMemory:
        """Return the memory before the first step."""
        return self._in_block(super().initial_memory())

    def update(
        self,
        memory: PayloadMemory,
        contacts: ContactPose,
        forces: ContactForces,
        mean: tuple[Array, int],
        motion: tuple[BodyMotion, Array],
    ) -> CompiledPayloadMemory:
        """Return the memory after some periods; see `ForcePayloadEstimator.update`.

        Args:
            memory: memory after the last update, of this estimator.
            contacts: the contacts, from the memory of a compiled estimator.
            forces: contact forces of the last period, of a compiled estimator.
            mean: (N, 3) sum of the contact forces, N, and the number of periods.
            motion: desired motion of the object, and (3,) the acceleration of gravity in H, m/s².
        """
        assert isinstance(memory, CompiledPayloadMemory)  # `initial_memory` makes no other
        assert isinstance(contacts, CompiledContactPose)
        assert isinstance(forces, CompiledContactForces)
        inputs, state = new_block(self._inputs_dtype), new_block(self._state_dtype)
        native.payload_inputs(
            motor_count=contacts.block["A"].shape[1],
            force_sum=mean[0],
            periods=mean[1],
            acceleration=motion[0].acceleration,
            twist=motion[0].twist,
            gravity_H=motion[1],
            pose=contacts.block,
            gains=forces.gains.block,
            inputs=inputs,
        )
        if native.payload_step(settings=self._numbers, inputs=inputs, last=memory.block, next=state):
            return CompiledPayloadMemory.of(state)
        return self._in_block(super().update(memory, contacts, forces, mean, motion))

    def _in_block(self, memory: PayloadMemory) -> CompiledPayloadMemory:
        """Return a memory of the reference implementation in a block."""
        block, estimate = new_block(self._state_dtype), memory.estimate
        for name in ("information", "score", "gain", "noise", "direction", "residual", "slow", "disturbed", "updates"):
            block[name] = getattr(memory, name)
        for name in ("mass", "p_OM", "covariance", "external_covariance"):
            block[name] = getattr(estimate, name)
        return CompiledPayloadMemory.of(block)
