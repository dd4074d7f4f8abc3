"""The driver of a simulated hand: the plant runs here, the controller in a service at the other end of a control stream."""

from __future__ import annotations

import time
from typing import Any

from graspforce.control import DesiredMotion, GraspState
from graspforce.service import RemoteCommand, Stream


class StreamController:
    """A control stream in the place of a controller: sends the state each period, and gives the motors what there is then.

    That is the newest command, or, where none is young enough, the watchdog's torque. How the plant's time goes:

    - in lockstep the plant waits for each state's own command, up to the stream's validity, so that a busy machine slows the
      simulation and changes nothing in it; while commands fail to come it waits one period a state, about real time;
    - in real time a state goes out each period of the clock, as a hand of metal would send it, and waits one period at most.
      Where that is not enough the motors get the command of an earlier state.

    The stream's validity and its watchdog count by the clock in either.

    Attributes:
        round_trips: from a state's departure to its command, of those whose own command was there in time, s.
        earlier: steps whose motors got the command of an earlier state.
        late: steps whose motors got the watchdog's torque.

    Args:
        stream: open; nothing else steps it.
        real_time: in real time; otherwise in lockstep.
    """

    def __init__(self, stream: Stream, *, real_time: bool = False) -> None:
        self.stream = stream
        self.round_trips: list[float] = []
        self.stale_steps = self.late = 0
        self._real_time = real_time
        self._is_late = False
        self._next_time: float | None = None  # when the next state goes out, s

    def step(self, state: GraspState, desired: DesiredMotion, external: Any = None) -> RemoteCommand:
        """What the motors get for this state; as `Stream.step`."""
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
        """Sleep until the next state is due; what was missed is not made up for."""
        now = time.monotonic()
        due = now if self._next_time is None else self._next_time
        if due > now:
            time.sleep(due - now)
        self._next_time = max(due, now) + period
