"""A controller for the simulation that runs in a service, over a control stream."""

from __future__ import annotations

import time
from typing import Any

from graspforce.control import DesiredMotion, GraspState
from graspforce.service import RemoteCommand, Stream


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
