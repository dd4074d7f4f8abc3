"""What the motors get when commands stop, and how a stream finds back: arithmetic on times and torques, without a network.

While commands come in time they are handed on untouched. When none has come for longer than its validity, the last good
torque stays, then relaxes along a ramp. When commands come again the torque moves towards them by bounded steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np

from graspforce.core import arrays
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput


@dataclass(frozen=True, slots=True)
class Watchdog:
    """What a driver does while it hears nothing.

        tau(t) = s(t) tau_good + K (q_lost − q) − D v,
        s(t) = 1 until t = hold, then falls by a straight line to floor within ramp, and stays,

    with t the age of the last good command and q_lost the posture in which it ran out. From the loss until the server's
    commands are met again, no joint's torque changes by more than ``step`` from one command to the next; it goes straight
    towards what it should be, so that between two torques whose contact forces stay in their cones it passes only such.

    A torque alone does not stop an object that moves, nor hold one for long: in simulation every hand lost a ball of 50 g that
    moved at 31 mm/s within a second. K and D stop it within about a millimetre and hold it. For joints of 0.0001 to
    0.002 kg·m², as the shipped hands have, the defaults stand well inside of what was found to hold: K from 1 to 6 N·m/rad
    (0.3 gives way, 10 shakes light fingers), D from 0.02 to 0.1 N·m·s/rad (0.3 shakes them: at a kilohertz D is to stay well
    below 2 M/dt). A hand of another size needs others, and a motor that is at its limit already has nothing to hold with.

    Args:
        hold: how long the last good torque stays whole, s.
        ramp: how long it takes to relax, s.
        floor: what stays of it in the end, 0 to 1.
        stiffness: K of every joint, N·m/rad.
        damping: D of every joint, N·m·s/rad.
        step: the largest change of a joint's torque from one command to the next, N·m.

    Raises:
        InvalidInput: a negative or infinite number, a floor above 1, or a step of zero.
    """

    hold: float = 1.0
    ramp: float = 1.0
    floor: float = 0.0
    stiffness: float = 2.0
    damping: float = 0.04
    step: float = 0.01

    def __post_init__(self) -> None:
        for name in ("hold", "ramp", "floor", "stiffness", "damping"):
            object.__setattr__(self, name, arrays.check_number(getattr(self, name), name, minimum=0.0))
        if self.floor > 1.0:
            raise InvalidInput("floor", self.floor, "at most 1")
        object.__setattr__(self, "step", arrays.check_number(self.step, "step", above=0.0))

    def scale(self, age: float) -> float:
        """s: what stays of the last good torque.

        Args:
            age: of the last good command, s.
        """
        if age <= self.hold:
            return 1.0
        if age >= self.hold + self.ramp:
            return self.floor
        return 1.0 - (1.0 - self.floor) * (age - self.hold) / self.ramp

    def torque(self, age: float, tau: Array, q_lost: Array, q: Array, v: Array) -> Array:
        """The torque that the motors should get, before its steps are bounded.

        Args:
            age: of the last good command, s.
            tau: (n,) its torque, N·m.
            q_lost: (n,) the posture in which it ran out, rad.
            q, v: (n,) posture and joint rates now, rad and rad/s.

        Returns:
            (n,) N·m.
        """
        return np.asarray(self.scale(age) * tau + self.stiffness * (q_lost - q) - self.damping * v)

    def rate_limit(self, previous: Array, target: Array) -> Array:
        """The next torque on the straight way from one to another, no joint's further than ``step``.

        Args:
            before: (n,) the torque that the motors have, N·m.
            wanted: (n,) the torque that they should get, N·m.

        Returns:
            (n,) N·m; ``wanted`` itself where that is near enough.
        """
        change = target - previous  # N·m
        largest = float(np.abs(change).max(initial=0.0))  # N·m
        return target if largest <= self.step else np.asarray(previous + self.step / largest * change)


class MotorTorque(msgspec.Struct, frozen=True, eq=False):
    """A torque as it goes to the motors.

    Args:
        tau: (n,) N·m.
        age: of the command behind it, s: since the state that it answers was sent.
        late: that command is older than its validity: the torque is the watchdog's.
        resuming: the torque is on its way back to commands that come again.
    """

    tau: Array
    age: float
    late: bool
    resuming: bool


class CommandMonitor:
    """Keeps the last good command, and says at any time which torque the motors get. For one thread.

    Args:
        watchdog: what to do while nothing comes.
        validity: how old a command may be, s, counted from when the state that it answers was sent.
        lower, upper: (n,) the motors' limits, which the watchdog's own torque keeps, joint by joint, N·m.
    """

    def __init__(
        self, watchdog: Watchdog, validity: float, lower: Array | float = -np.inf, upper: Array | float = np.inf
    ) -> None:
        self.watchdog = watchdog
        self._lower, self._upper = lower, upper
        self.validity = arrays.check_number(validity, "validity", above=0.0)
        self._last_command: tuple[float, Array] | None = (
            None  # when the state behind the last good command was sent, and its torque
        )
        self._output: Array | None = None  # what the motors got last
        self._q_lost: Array | None = None  # where the joints were when the last good command ran out
        self._resuming = False

    def accept(self, tau: Array, sent_time: float, now: float) -> bool:
        """A command came; whether it is good: not older than its validity, and not older than one that came before.

        Args:
            tau: (n,) its torque, N·m.
            sent: when the state that it answers was sent, s.
            now: s on the same clock.
        """
        if now - sent_time > self.validity or (self._last_command is not None and sent_time < self._last_command[0]):
            return False
        self._last_command = (sent_time, tau)
        return True

    def torque(self, now: float, q: Array, v: Array) -> MotorTorque | None:
        """What the motors get now; None before the first good command.

        Args:
            now: s, on the clock of `accept`.
            q, v: (n,) posture and joint rates now, rad and rad/s.
        """
        if self._last_command is None:
            return None
        sent_time, tau = self._last_command
        age = now - sent_time  # s
        late = age > self.validity
        if late:
            self._q_lost = q if self._q_lost is None else self._q_lost
            target = np.clip(self.watchdog.torque(age, tau, self._q_lost, q, v), self._lower, self._upper)
            self._resuming = True
        else:
            self._q_lost, target = None, tau
        if self._resuming and self._output is not None:
            output = self.watchdog.rate_limit(self._output, target)
            self._resuming = late or output is not target
        else:
            output = target
        self._output = output
        return MotorTorque(output, age, late, self._resuming and not late)
