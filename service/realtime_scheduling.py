"""Real-time scheduling of the threads of this process, on Linux.

Linux shares processors fairly among ordinary threads, so that a thread which has waited for a message may wait for milliseconds
more until a thread of another program has used its share. Threads of the policy SCHED_FIFO run before all ordinary threads. The
server needs it for its control steps, and a driver on the same machine for its loop: each waits for the other.

The system must permit it: by the capability CAP_SYS_NICE, or by the limit RLIMIT_RTPRIO (`ulimit -r`, or ``LimitRTPRIO`` of a
systemd unit).
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator

from graspforce.core import fields
from graspforce.core.errors import InvalidInput

DEFAULT_PRIORITY = 10
MAX_PRIORITY = 49  # Linux handles interrupts in threads of priority 50


def use_realtime_scheduling(priority: int = DEFAULT_PRIORITY) -> None:
    """Schedule all threads of this process by SCHED_FIFO; threads that they start later inherit it.

    Processes that these threads start inherit it, too, unless they start within `ordinary_scheduling`. Use the same priority in
    server and driver: a driver with a higher one, which waits busily for its command, can hold up a server on the same machine.

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


@contextlib.contextmanager
def ordinary_scheduling() -> Iterator[None]:
    """Schedule this thread as an ordinary one within a ``with`` block, so that processes which it starts are ordinary."""
    if sys.platform != "linux" or os.sched_getscheduler(0) == os.SCHED_OTHER:
        yield
        return
    policy, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    try:
        yield
    finally:
        os.sched_setscheduler(0, policy, parameter)


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
