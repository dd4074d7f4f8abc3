"""Control of a stream of a joint-space law."""

from __future__ import annotations

import math

import numpy as np

from graspforce.control.joints.force_controller import ForceController
from graspforce.control.joints.joint_command import JointCommand
from graspforce.control.joints.joint_laws import PIDMemory
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.service.wire.joint_records import JointCommandRecord, JointState, JointStreamSetup, continued_memory


class JointControl:
    """The law of a stream with its memory.

    Args:
        setup: fixed parameters of the stream.
    """

    def __init__(self, setup: JointStreamSetup) -> None:
        self._setup, self._integral = setup, setup.integral
        self._memory: PIDMemory | None = None

    def decode(self, payload: bytes, codec: str) -> JointState:
        """Return a state.

        Args:
            payload: the encoded state.
            codec: its encoding.

        Raises:
            InvalidInput: as in `JointState.decode`.
        """
        return JointState.decode(self._setup, payload, codec)

    def step(self, state: JointState) -> JointCommandRecord:
        """Return the command for a state.

        Args:
            state: the state.

        Raises:
            InvalidInput: the state has too large numbers.
        """
        command, integral, memory = self._step(state)
        if not math.isfinite(sum(command.tau_unlimited.tolist()) + sum(integral.tolist())):
            raise InvalidInput("measured", "too large numbers", "of a magnitude that gives finite torques")
        self._integral, self._memory = integral, memory
        return JointCommandRecord(command.tau.tolist(), command.tau_unlimited.tolist(), integral.tolist())

    def _step(self, state: JointState) -> tuple[JointCommand, Array, PIDMemory | None]:
        """Return the command, the integral, and the memory of the laws of motion."""
        controller, dt = self._setup.controller, self._setup.period
        if isinstance(controller, ForceController):
            assert state.torque is not None  # decode() has checked it
            assert state.torque_desired is not None
            command, integral = controller.step(state.measured, state.torque, state.torque_desired, dt, self._integral)
            return command, integral, None
        assert state.desired is not None
        memory = self._memory or continued_memory(self._setup, state)
        command, memory = controller.step(state.measured, state.desired, dt, memory)
        return command, np.asarray(memory.integral), memory
