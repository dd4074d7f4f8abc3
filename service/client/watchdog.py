"""The watchdog's law: the motor torque of a stream while no commands arrive.

The age t of a command is the time since the client sent the state that it answers, on the client's clock. A command is good if
it arrives before its age exceeds the validity, and if its state is not older than that of the last good command.

| phase  | age of the last good command | motor torque                                           |
|--------|------------------------------|--------------------------------------------------------|
| normal | t ≤ validity                 | tau_good, the torque of the command                    |
| hold   | validity < t ≤ hold          | tau_good + brake                                       |
| ramp   | hold < t < hold + ramp       | s(t) tau_good + brake, s falls linearly from 1 to floor |
| floor  | t ≥ hold + ramp              | floor · tau_good + brake                               |
| resume | a good command arrives       | moves to the commands by at most `step` per period     |

The brake is K (q_lost − q) − D v, with q_lost the posture at which the last good command expired. Outside the normal phase, the
watchdog's torque stays within the motors' limits, and no joint's torque changes by more than `step` per period. `Watchdog` has
the parameters and the law, `CommandMonitor` the phases. Neither uses the network or a clock.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np
import numpy.typing as npt

from graspforce.core import arrays, records
from graspforce.core.arrays import Array
from graspforce.core.compiled import native
from graspforce.core.errors import InvalidInput


@dataclass(frozen=True, slots=True)
class Watchdog:
    """Parameters of the motor torque while no commands arrive.

        tau(t) = s(t) tau_good + K (q_lost − q) − D v

        s(t) = 1                                  for t ≤ hold
        s(t) = 1 − (1 − floor) (t − hold)/ramp    for hold < t < hold + ramp
        s(t) = floor                              for t ≥ hold + ramp

    with t the age of the last good command, tau_good its torque, and q_lost the posture at which it expired.

    From the loss until the new commands are reached, no joint's torque changes by more than `step` per period. All joints
    approach their targets in proportion. If the contact forces of both torques lie inside their friction cones, so do all
    forces in between, because the cones are convex.

    A constant torque would drop a moving object; K and D stop the joints and hold it. The defaults suit joints with an inertia
    of 0.0001 to 0.002 kg·m², as in the shipped hands. In simulation they hold a ball of 50 g that moves at 31 mm/s. So do K
    from 1 to 6 N·m/rad (0.3 is too weak; 10 makes light fingers oscillate) and D from 0.02 to 0.1 N·m·s/rad (0.3 makes them
    oscillate). D must stay well below 2 M/dt, with M the joint's inertia and dt the period. A motor at its torque limit cannot
    brake.

    Args:
        hold: time for which the full torque stays, s (default 1.0).
        ramp: duration of the ramp from the full torque down to `floor`, s (default 1.0).
        floor: fraction of the torque after the ramp, from 0 to 1 (default 0.0).
        stiffness: K of every joint, N·m/rad (default 2.0).
        damping: D of every joint, N·m·s/rad (default 0.04).
        step: largest change of a joint's torque per period, N·m (default 0.01).

    Raises:
        InvalidInput: a number is negative or not finite, `floor` is above 1, or `step` is zero.
    """

    hold: float = 1.0
    ramp: float = 1.0
    floor: float = 0.0
    stiffness: float = 2.0
    damping: float = 0.04
    step: float = 0.01

    def __post_init__(self) -> None:
        names = ("hold", "ramp", "floor", "stiffness", "damping")
        checked = {name: arrays.check_number(getattr(self, name), name, minimum=0.0) for name in names}
        if checked["floor"] > 1.0:
            raise InvalidInput("floor", self.floor, "at most 1")
        records.set_fields(self, **checked, step=arrays.check_number(self.step, "step", above=0.0))

    def scale(self, age: float) -> float:
        """Return the factor s(t) on the last good torque.

        Args:
            age: t, age of the last good command, s.
        """
        if age <= self.hold:
            return 1.0
        if age >= self.hold + self.ramp:
            return self.floor
        return 1.0 - (1.0 - self.floor) * (age - self.hold) / self.ramp

    def torque(self, age: float, tau: npt.ArrayLike, q_lost: npt.ArrayLike, q: npt.ArrayLike, v: npt.ArrayLike) -> Array:
        """Return the torque tau(t) before the rate limit.

        Args:
            age: t, age of the last good command, s.
            tau: (n,) tau_good, torque of the last good command, N·m.
            q_lost: (n,) posture at which that command expired, rad.
            q: (n,) posture now, rad.
            v: (n,) joint rates now, rad/s.

        Returns:
            (n,) motor torques, N·m.
        """
        brake = self.stiffness * (np.asarray(q_lost) - np.asarray(q)) - self.damping * np.asarray(v)  # N·m
        return np.asarray(self.scale(age) * np.asarray(tau) + brake)

    def rate_limit(self, previous: npt.ArrayLike, target: npt.ArrayLike) -> Array:
        """Return the next torque on the straight line from one torque to another.

        Args:
            previous: (n,) torque of the last period, N·m.
            target: (n,) torque to reach, N·m.

        Returns:
            (n,) torque, N·m: no joint differs from `previous` by more than `step`. The target itself if it is that close.
        """
        start, end = np.asarray(previous), np.asarray(target)
        change = end - start  # N·m
        largest = float(np.abs(change).max(initial=0.0))  # N·m
        return end if largest <= self.step else np.asarray(start + self.step / largest * change)


class MotorTorque(msgspec.Struct, frozen=True, eq=False):
    """The torque of one period and its phase.

    Args:
        tau: (n,) motor torques, N·m.
        age: age of the last good command, s.
        late: True if the age exceeds the validity: the torque is the watchdog's.
        resuming: True while the torque moves back to the commands.
    """

    tau: Array
    age: float
    late: bool
    resuming: bool


class CommandMonitor:
    """Selection of the motor torque: the last good command or the watchdog. Use it from one thread.

    Args:
        watchdog: torque law while no commands arrive.
        validity: largest age of a good command, s.
        lower: (n,) lower limits of the watchdog's torque, N·m.
        upper: (n,) upper limits of the watchdog's torque, N·m.
        step: (n,) largest change of the torque per period while commands arrive, N·m.

    Raises:
        InvalidInput: `validity` is not a finite number above 0.
    """

    def __init__(
        self,
        watchdog: Watchdog,
        validity: float,
        lower: Array | float = -np.inf,
        upper: Array | float = np.inf,
        step: Array | float = np.inf,
    ) -> None:
        self.watchdog, self._step = watchdog, step
        self.validity = arrays.check_number(validity, "validity", above=0.0)
        self._lower, self._upper = lower, upper
        self._last_command: tuple[float, Array] | None = None  # when its state was sent, s, and its torque, N·m
        self._output: Array | None = None  # torque of the last period, N·m
        self._q_lost: Array | None = None  # posture at which the last good command expired, rad
        self._resuming = False

    def accept(self, tau: Array, sent_time: float, now: float) -> bool:
        """Store a command if it is good.

        Args:
            tau: (n,) torque of the command, N·m.
            sent_time: when the state that it answers was sent, s.
            now: current time on the same clock, s.

        Returns:
            True if the command is good: within its validity, and its state not older than that of the last good command.
        """
        if now - sent_time > self.validity or (self._last_command is not None and sent_time < self._last_command[0]):
            return False
        self._last_command = (sent_time, tau)
        return True

    def torque(self, now: float, q: Array, v: Array) -> MotorTorque | None:
        """Return the motor torque of this period. Call it once per period: each call is one step of the rate limit.

        Args:
            now: current time on the clock of `accept`, s.
            q: (n,) posture, rad.
            v: (n,) joint rates, rad/s.

        Returns:
            The torque, or None before the first good command.
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
            output = target if self._output is None else self._limit_step(self._output, target)
        self._output = output
        return MotorTorque(output, age, late, self._resuming and not late)

    def _limit_step(self, previous: Array, target: Array) -> Array:
        """Return the next torque on the straight line from one torque to another, by at most `step` in each joint."""
        if native is not None and isinstance(self._step, np.ndarray):
            excess = float(native.torque_step_ratio(target, previous, self._step))
        else:
            excess = float((np.abs(target - previous) / self._step).max(initial=0.0))
        return target if excess <= 1.0 else previous + (target - previous) / excess
