"""Runs of a hand without an object under a joint-space controller, and the step responses of its joints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from graspforce.control.joints.joint_command import JointCommand, JointMotion
from graspforce.control.joints.joint_laws import PIDMemory
from graspforce.control.joints.joint_reference import JointReference
from graspforce.core import arrays
from graspforce.core.arrays import Array, freeze
from graspforce.core.whole_file import replace_file
from graspforce.simulation.free_hand.free_plant import FreeHandPlant


@dataclass(frozen=True, eq=False, slots=True)
class JointRun:
    """The steps of a run.

    Attributes:
        hand: name of the hand.
        law: name of the control law.
        joints: names of the n joints.
        units: unit of each joint's position, rad or m.
        t: (K,) begin of each step, s.
        q: (K, n) positions, rad.
        v: (K, n) rates, rad/s.
        tau: (K, n) torques of the motors during the step, N·m.
        q_desired: (K, n) desired positions, rad.
        torque_limit: (n,) largest torques, N·m.
    """

    hand: str
    law: str
    joints: tuple[str, ...]
    units: tuple[str, ...]
    t: Array
    q: Array
    v: Array
    tau: Array
    q_desired: Array
    torque_limit: Array

    def save(self, path: Path) -> None:
        """Write t, q, v, tau and q_desired as .npz: a recording that `graspforce hands identify` reads.

        Args:
            path: the file.
        """
        with replace_file(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, t=self.t, q=self.q, v=self.v, tau=self.tau, q_desired=self.q_desired)


@dataclass(frozen=True, slots=True)
class StepResponse:
    """The response of one joint to its move.

    Attributes:
        joint: name of the joint.
        travel: from start to goal, rad.
        settling_time: time after which the error stays within 2 % of the travel, s; NaN if it does not.
        overshoot: largest motion beyond the goal as a fraction of the travel; 0 if there is none.
        final_error: error at the end, rad.
        peak_torque: largest torque, N·m.
        peak_use: largest torque as a fraction of the motor's limit.
    """

    joint: str
    travel: float
    settling_time: float
    overshoot: float
    final_error: float
    peak_torque: float
    peak_use: float


SETTLING_BAND = 0.02  # of the travel


class JointStepper(Protocol):
    """A joint-space controller: `JointController`, or one that runs in a service."""

    @property
    def law(self) -> str: ...  # pragma: no cover

    def step(
        self, measured: JointMotion, desired: JointMotion, dt: float, memory: PIDMemory | None = None
    ) -> tuple[JointCommand, PIDMemory]:
        """Return the command of a period, and the memory for the next one."""
        ...  # pragma: no cover


def run_joints(
    plant: FreeHandPlant,
    controller: JointStepper,
    reference: JointReference,
    duration: float,
    on_step: Callable[[float], bool | None] = lambda t: None,
) -> JointRun:
    """Run a controller on a hand without an object.

    Args:
        plant: the hand, which begins where it is.
        controller: the controller of the same hand.
        reference: desired motion.
        duration: simulated time, s, > 0.
        on_step: called with the time after each step, s; if it returns False, the run ends.

    Raises:
        InvalidInput: the duration is not positive.
    """
    count = max(1, round(arrays.check_number(duration, "duration", above=0.0) / plant.dt))
    hand, start, motion = plant.hand, plant.t, plant.motion()
    memory: PIDMemory | None = None
    rows: list[tuple[npt.ArrayLike, ...]] = []
    for _ in range(count):
        t = plant.t - start
        desired = reference(t)
        command, memory = controller.step(motion, desired, plant.dt, memory)
        rows.append((t, motion.q, motion.v, command.tau, desired.q))
        motion = plant.step(command.tau)
        if on_step(plant.t - start) is False:
            break
    times, q, v, tau, q_desired = (freeze(np.array(column)) for column in zip(*rows, strict=True))
    return JointRun(
        hand=hand.name,
        law=controller.law,
        joints=tuple(joint.name for joint in hand.joints),
        units=tuple(joint.position_unit for joint in hand.joints),
        t=times,
        q=q,
        v=v,
        tau=tau,
        q_desired=q_desired,
        torque_limit=hand.torque_upper,
    )


def step_responses(run: JointRun) -> tuple[StepResponse, ...]:
    """Return the response of each joint that the reference moves.

    Args:
        run: the run.
    """
    found = []
    for j, joint in enumerate(run.joints):
        travel = float(run.q_desired[-1, j] - run.q[0, j])
        if travel == 0.0:
            continue
        progress = (run.q[:, j] - run.q[0, j]) / travel
        outside = np.flatnonzero(np.abs(progress - 1.0) > SETTLING_BAND)
        is_settled = not len(outside) or outside[-1] + 1 < len(run.t)
        peak = float(np.abs(run.tau[:, j]).max())
        found.append(
            StepResponse(
                joint=joint,
                travel=travel,
                settling_time=(float(run.t[outside[-1] + 1]) if len(outside) else 0.0) if is_settled else float("nan"),
                overshoot=max(float(progress.max()) - 1.0, 0.0),
                final_error=float(run.q_desired[-1, j] - run.q[-1, j]),
                peak_torque=peak,
                peak_use=peak / float(run.torque_limit[j]),
            )
        )
    return tuple(found)
