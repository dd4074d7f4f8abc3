"""Start the processes that work for the server beside its streams.

Each is in a process group of its own, so that Ctrl-C in a terminal reaches the server only, which then ends its processes in
order. It stays in the server's session: with `sched_autogroup_enabled`, Linux gives each session an equal share of the
processors, and the niceness of a process counts only within its session. It is an ordinary process also if the server has
real-time scheduling. Its niceness is then less: it would take processor time from requests, and streams do not need it.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Sequence
from multiprocessing import Pipe
from multiprocessing.connection import Connection

from graspforce.service.realtime_scheduling import is_realtime, ordinary_scheduling

# One thread for each library: small matrices gain nothing from more.
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_NICENESS_REDUCTION = 10  # beside a server with real-time scheduling


def start_worker(
    command: Sequence[str], niceness: int, *, stdin: int = subprocess.DEVNULL, pass_fds: Sequence[int] = ()
) -> subprocess.Popen[bytes]:
    """Start a process in a process group of its own.

    Args:
        command: its command line.
        niceness: how far its priority is below that of a server with ordinary scheduling, from 0 to 19; 10 less if the server
            has real-time scheduling.
        stdin: its standard input, as in `subprocess.Popen`.
        pass_fds: file descriptors that it inherits.

    Raises:
        OSError: the process cannot be started.
    """
    output = subprocess.DEVNULL  # some solvers print banners that no option turns off
    environment, inherited = worker_environment(), tuple(pass_fds)
    if is_realtime():
        niceness = max(niceness - _NICENESS_REDUCTION, 0)
    with ordinary_scheduling():
        if sys.version_info >= (3, 11):
            process = subprocess.Popen(
                command, stdin=stdin, stdout=output, env=environment, pass_fds=inherited, process_group=0
            )
        else:  # Python 3.10 can only start a session
            process = subprocess.Popen(
                command, stdin=stdin, stdout=output, env=environment, pass_fds=inherited, start_new_session=True
            )
    _add_niceness(process.pid, niceness)
    return process


def start_piped_worker(command: Sequence[str], niceness: int) -> tuple[subprocess.Popen[bytes], Connection]:
    """Start a process with a pipe, and return the process and this end of the pipe.

    Args:
        command: its command line; the number of its end of the pipe is appended.
        niceness: as in `start_worker`.

    Raises:
        OSError: the process cannot be started.
    """
    ours, theirs = Pipe()
    with theirs:
        number = theirs.fileno()
        try:
            return start_worker([*command, str(number)], niceness, pass_fds=(number,)), ours
        except OSError:
            ours.close()
            raise


def worker_environment() -> dict[str, str]:
    """Return the environment variables of a worker process: the server's, with one thread for each library."""
    return {**os.environ, **dict.fromkeys(_THREAD_VARIABLES, "1")}


def _add_niceness(pid: int, niceness: int) -> None:
    """Lower the priority of a process that has just started."""
    if hasattr(os, "setpriority"):
        with contextlib.suppress(ProcessLookupError):  # it has ended already
            os.setpriority(os.PRIO_PROCESS, pid, os.getpriority(os.PRIO_PROCESS, pid) + niceness)
