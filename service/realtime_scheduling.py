"""Real-time scheduling of the threads of this process, on Linux.

Linux shares processors fairly among ordinary threads, so that a thread which has waited for a message may wait for milliseconds
more until a thread of another program has used its share. Threads of the policy SCHED_FIFO run before all ordinary threads. The
server needs it for its control steps, and a driver on the same machine for its loop: each waits for the other.

The system must permit it: by the capability CAP_SYS_NICE, or by the limit RLIMIT_RTPRIO (`ulimit -r`, or ``LimitRTPRIO`` of a
systemd unit).
"""

from __future__ import annotations

import contextlib
import math
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass

from graspforce.core import fields
from graspforce.core.errors import InvalidInput

DEFAULT_PRIORITY = 10
MAX_PRIORITY = 49  # Linux handles interrupts in threads of priority 50

_FASTEST_PERIOD = 1e-3  # s; no stream gets a higher priority than those of this period
_STREAM_LEVELS = 5  # priorities of streams; the lowest one is for periods of 12 ms and more


def use_realtime_scheduling(priority: int = DEFAULT_PRIORITY) -> None:
    """Schedule all threads of this process by SCHED_FIFO; threads that they start later inherit it.

    Processes that these threads start inherit it, too, unless they start within `ordinary_scheduling`. Give a driver the
    priority of its server (`graspforce serve --realtime`): with a higher one, its busy wait for a command can hold up the
    server on the same machine.

    Args:
        priority: priority among real-time threads, from 1 to 49.

    Raises:
        InvalidInput: the priority is out of range, the system does not permit it, or the system is not Linux.
    """
    fields.check_integer(priority, "priority", minimum=1, maximum=MAX_PRIORITY)
    if sys.platform != "linux":
        raise InvalidInput("priority", priority, "absent: real-time scheduling needs Linux")
    try:
        _schedule_threads(os.SCHED_FIFO, priority)
    except PermissionError:
        allowed = "permitted by the system: raise its limit (`ulimit -r`, or LimitRTPRIO= in systemd), or grant CAP_SYS_NICE"
        raise InvalidInput("priority", priority, allowed) from None


def end_realtime_scheduling() -> None:
    """Schedule all threads of this process as ordinary ones again."""
    if sys.platform == "linux":
        _schedule_threads(os.SCHED_OTHER, 0)


def is_realtime() -> bool:
    """Return whether this thread has real-time scheduling."""
    return sys.platform == "linux" and os.sched_getscheduler(0) in (os.SCHED_FIFO, os.SCHED_RR)


@contextlib.contextmanager
def ordinary_scheduling() -> Iterator[None]:
    """Schedule this thread as an ordinary one within a ``with`` block, so that processes which it starts are ordinary."""
    if not is_realtime():
        yield
        return
    with _thread_scheduling(os.SCHED_OTHER, 0):
        yield


@dataclass(frozen=True)
class ServerPriorities:
    """Real-time priorities of a server's threads. Faster streams have higher ones, as in rate-monotonic scheduling.

    A thread that has received a state thus interrupts slower streams and requests. With one priority for all threads it would
    wait for them, because threads of equal priority do not interrupt each other.

    Args:
        highest: priority of Zenoh's threads and of streams with a period of 1 ms or less; None for ordinary scheduling.

    Raises:
        InvalidInput: the priority is out of range.

    Source:
        C. L. Liu and J. W. Layland (1973), "Scheduling Algorithms for Multiprogramming in a Hard-Real-Time Environment".
    """

    highest: int | None

    def __post_init__(self) -> None:
        if self.highest is not None:
            fields.check_integer(self.highest, "realtime", minimum=1, maximum=MAX_PRIORITY)

    @property
    def requests(self) -> int | None:
        """Priority of all other threads: below that of every stream if `highest` is at least 6, otherwise 1."""
        return None if self.highest is None else max(self.highest - _STREAM_LEVELS, 1)

    def of_stream(self, period: float) -> int | None:
        """Return the priority of a stream: one less for each doubling of the period above 1 ms.

        Args:
            period: control period, s.
        """
        if self.highest is None:
            return None
        level = min(max(round(math.log2(period / _FASTEST_PERIOD)), 0), _STREAM_LEVELS - 1)
        return max(self.highest - level, 1)

    def apply(self) -> None:
        """Schedule the threads of this process as those of requests.

        Raises:
            InvalidInput: as in `use_realtime_scheduling`.
        """
        if self.highest is not None:
            use_realtime_scheduling(self.highest)  # checks that the highest priority is permitted
            _schedule_threads(os.SCHED_FIFO, self.requests or 1)

    def end(self) -> None:
        """Schedule the threads of this process as ordinary ones again if they were real-time."""
        if self.highest is not None:
            end_realtime_scheduling()

    @contextlib.contextmanager
    def for_messages(self) -> Iterator[None]:
        """Give this thread the highest priority within a ``with`` block, so that threads which it starts have it."""
        if self.highest is None:
            yield
            return
        with _thread_scheduling(os.SCHED_FIFO, self.highest):
            yield


ORDINARY = ServerPriorities(None)


def schedule_thread(priority: int | None) -> None:
    """Schedule this thread by SCHED_FIFO.

    Args:
        priority: priority that the system permits; None to change nothing.
    """
    if priority is not None and sys.platform == "linux":
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))


@contextlib.contextmanager
def _thread_scheduling(policy: int, priority: int) -> Iterator[None]:
    """Schedule this thread by a policy within a ``with`` block."""
    if sys.platform != "linux":
        yield
        return
    before, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    os.sched_setscheduler(0, policy, os.sched_param(priority))
    try:
        yield
    finally:
        os.sched_setscheduler(0, before, parameter)


def _schedule_threads(policy: int, priority: int) -> None:
    """Set the policy of all threads of this process, also of those that start meanwhile.

    Raises:
        PermissionError: the system does not permit it.
    """
    if sys.platform != "linux":
        return
    done = set[str]()
    while threads := set(os.listdir("/proc/self/task")) - done:
        for thread in threads:
            with contextlib.suppress(ProcessLookupError):  # it has ended
                os.sched_setscheduler(int(thread), policy, os.sched_param(priority))
        done |= threads
