"""Controllers for simulations that run in a service, over streams."""

from __future__ import annotations

import time
from typing import Any

from graspforce.control import DesiredMotion, GraspState
from graspforce.control.drives.drive_commands import DriveMap
from graspforce.control.joints.joint_command import JointCommand, JointMotion
from graspforce.control.joints.joint_laws import PIDMemory
from graspforce.control.phases.cycle_plan import CyclePlan
from graspforce.control.phases.phase_rules import PHASE_RULES, PhaseName
from graspforce.control.phases.phase_step import PhaseCommand, PhaseRecord
from graspforce.estimation.measurement import Measurement
from graspforce.service import JointStream, PhaseStream, RemoteCommand, Stream


class StreamController:
    """A control stream used as a controller: it sends the state each period and returns the newest valid command.

    If no command is valid, it returns the watchdog's torque. Simulated time passes in one of two ways:

    - lockstep: the plant waits for the command of each state, up to the stream's validity. A busy machine slows the simulation
      but does not change its result. While commands are late, the plant waits one period for each state.
    - real time: a state is sent each period of the clock, and the plant waits one period at most. If the command is later, the
      motors get the command of an earlier state.

    The validity and the watchdog use the clock in both cases.

    Attributes:
        round_trips: times from sending a state to receiving its command, of the commands in time, s.
        stale_steps: number of steps in which the motors got the command of an earlier state.
        late: number of steps in which the motors got the watchdog's torque.

    Args:
        stream: an open stream that no other code uses.
        real_time: run in real time instead of lockstep.
    """

    def __init__(self, stream: Stream, *, real_time: bool = False) -> None:
        self.stream = stream
        self.round_trips: list[float] = []
        self.stale_steps = self.late = 0
        self._real_time = real_time
        self._is_late = False
        self._next_time: float | None = None  # when the next state goes out, s

    def step(self, state: GraspState, desired: DesiredMotion, external: Any = None) -> RemoteCommand:
        """Return the command for a state. Arguments as in `Stream.step`."""
        period = self.stream.setup.settings.period  # s
        if self._real_time:
            self._wait_for_period(period)
        wait = period if self._real_time or self._is_late else self.stream.setup.validity
        command = self.stream.step(state, desired, external, wait=wait)
        self._is_late = command.late
        if command.late:
            self.late += 1
        elif command.sequence == self.stream.sequence:
            self.round_trips.append(command.age)
        else:
            self.stale_steps += 1
        return command

    def _wait_for_period(self, period: float) -> None:
        """Sleep until the next state is due; missed deadlines are skipped."""
        now = time.monotonic()
        due = now if self._next_time is None else self._next_time
        if due > now:
            time.sleep(due - now)
        self._next_time = max(due, now) + period


class PhaseStreamController:
    """A stream of phases used as the controller of a simulated cycle, in lockstep: the plant waits for each command.

    A stream runs one cycle, from its first measurement on.

    Attributes:
        phase: phase of the last command.
        records: the phases that have ended, with the planned grasp: a stream does not send the touched one.

    Args:
        stream: an open stream that no other code uses.
    """

    def __init__(self, stream: PhaseStream) -> None:
        self._stream, self._start = stream, 0.0
        self.phase: PhaseName = "approach"
        self.records: tuple[PhaseRecord, ...] = ()
        setup = stream.setup
        self._drives = DriveMap(setup.hand, setup.settings.position_error, setup.period)

    @property
    def plan(self) -> CyclePlan:
        """The plan of the cycle."""
        return self._stream.setup.plan

    @property
    def is_over(self) -> bool:
        """Whether the cycle is done or has stopped."""
        return self.phase in ("done", "stopped")

    def reset(self) -> None:
        """Do nothing: the server begins with the first measurement."""

    def step(self, measurement: Measurement) -> PhaseCommand:
        """Return the command for a measurement.

        Args:
            measurement: the newest measurement.
        """
        command = self._stream.step(measurement, wait=self._stream.setup.validity)
        if command.phase != self.phase:
            is_aborted = command.phase in ("stopped", "reopen")
            reason = command.message.partition(": ")[2] if is_aborted else PHASE_RULES[self.phase].exit
            ended = PhaseRecord(self.phase, self._start, command.t, reason, is_aborted, self.plan.grasp)
            self.records, self._start, self.phase = (*self.records, ended), command.t, command.phase
        return PhaseCommand(
            t=command.t,
            phase=command.phase,
            tau=command.tau,
            base=command.base,
            touching=command.touching,
            f_normal=command.f_normal,
            slip_margin=command.slip_margin,
            message=command.message,
            joints=command.joints,
            drives=self._drives,
        )


class JointStreamController:
    """A stream of a joint-space law used as the controller of a simulated hand, in lockstep.

    Args:
        stream: an open stream that no other code uses.
    """

    def __init__(self, stream: JointStream) -> None:
        self._stream = stream

    @property
    def law(self) -> str:
        """Name of the law."""
        return self._stream.setup.law

    def step(
        self, measured: JointMotion, desired: JointMotion, dt: float, memory: PIDMemory | None = None
    ) -> tuple[JointCommand, PIDMemory]:
        """Return the command for a state; as `JointController.step`, but the server has the memory."""
        command = self._stream.step(measured, desired, wait=self._stream.setup.validity)
        return JointCommand(command.tau, command.tau_unlimited), PIDMemory(command.integral, desired.q - measured.q)
