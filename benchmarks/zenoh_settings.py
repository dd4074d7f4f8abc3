"""Round trips over Zenoh with different settings: `python -m benchmarks.zenoh_settings`.

An echo process for each setting replies to messages of a state's size with messages of a command's size, from another thread
behind a ring buffer of one message. Both ends have the setting; the others are graspforce's. Bursts at 1 kHz take turns, so
that a drift of the machine's speed affects all settings equally. The ratio is that of the medians to graspforce's settings.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import threading
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np
import zenoh
from zenoh.handlers import RingChannel

from benchmarks import report_page
from benchmarks.service_load import COMMAND_BYTES, LOCAL, STATE_BYTES, TIMEOUT, python_process, read_line
from graspforce.service.zenoh_session import build_configuration

SETTINGS: dict[str, dict[str, object]] = {
    "graspforce": {},
    "no batching": {"transport/link/tx/queue/batching/enabled": False},
    "express messages": {"express": True},
    "low-latency transport": {"transport/unicast/lowlatency": True, "transport/unicast/qos/enabled": False},
    "shared memory": {"transport/shared_memory/enabled": True},
    "reliable, blocking": {"block": True},
    "real-time priority": {"priority": "REAL_TIME"},
    "no limit of messages": {"transport/link/rx/max_message_size": 2**30},
}
PUBLISHER = ("express", "block", "priority")  # settings of the publishers, not of the session
BURST, WARM_UP, PERIOD = 200, 20, 1e-3  # round trips, round trips, s


def _open(name: str, mode: str, own: dict[str, object]) -> zenoh.Session:
    """Open a session with a setting."""
    settings = {key: value for key, value in SETTINGS[name].items() if key not in PUBLISHER}
    return zenoh.open(build_configuration(None, {"mode": mode}, {**settings, **own}))


def _publisher(name: str, session: zenoh.Session, key: str) -> zenoh.Publisher:
    """Declare a publisher with a setting."""
    own = SETTINGS[name]
    control = zenoh.CongestionControl.BLOCK if own.get("block") else zenoh.CongestionControl.DROP
    priority = getattr(zenoh.Priority, str(own.get("priority", "DATA")))
    return session.declare_publisher(key, congestion_control=control, express=bool(own.get("express")), priority=priority)


def run_echo(name: str) -> None:
    """Answer each message until standard input closes."""
    sys.setswitchinterval(1e-4)  # as `graspforce serve` does
    with _open(name, "peer", {"listen/endpoints": [LOCAL], "adminspace/enabled": True}) as session:
        command = _publisher(name, session, "echo/command")
        states = session.declare_subscriber("echo/state", RingChannel(1))

        def run() -> None:
            with contextlib.suppress(zenoh.ZError):
                while True:
                    states.handler.recv()
                    command.put(b"x" * COMMAND_BYTES)

        thread = threading.Thread(target=run)
        thread.start()
        [reply] = session.get(f"@/{session.zid()}/*", timeout=TIMEOUT)
        print(json.loads(reply.ok.payload.to_bytes())["locators"][0], flush=True)
        sys.stdin.read()
        states.undeclare()
        thread.join()


def measure(names: list[str], rounds: int) -> dict[str, list[float]]:
    """Return the times of the round trips by setting, s."""
    trips: dict[str, list[float]] = {name: [] for name in names}
    ends = {}
    with contextlib.ExitStack() as stack:
        for name in names:
            address = read_line(stack.enter_context(python_process("benchmarks.zenoh_settings", "--echo", name)))
            session = stack.enter_context(_open(name, "client", {"connect/endpoints": [address]}))
            ends[name] = _publisher(name, session, "echo/state"), session.declare_subscriber("echo/command", RingChannel(1))
        time.sleep(1.0)  # s, for discovery
        for _ in range(rounds):
            for name, (state, command) in ends.items():
                tick = time.perf_counter()
                for i in range(BURST):
                    tick = max(tick + PERIOD, time.perf_counter())
                    time.sleep(max(tick - time.perf_counter(), 0.0))
                    start = time.perf_counter()
                    state.put(b"x" * STATE_BYTES)
                    command.handler.recv()
                    if i >= WARM_UP:
                        trips[name].append(time.perf_counter() - start)
    return trips


def _show(trips: dict[str, list[float]], save: Path | None) -> None:
    """Print the table and write the page."""
    usual = np.median(trips["graspforce"])
    head = ("setting", "median µs", "90 % µs", "99 % µs", "largest µs", "ratio")
    rows = [
        (name, *(f"{1e6 * x:.0f}" for x in np.quantile(own, [0.5, 0.9, 0.99, 1.0])), f"{np.median(own) / usual:.2f}")
        for name, own in trips.items()
    ]
    title = "Round trips over Zenoh with different settings"
    counts = f"Zenoh {version('eclipse-zenoh')}", f"{len(trips['graspforce'])} round trips per row"
    report_page.publish(title, __doc__, head, rows, save, *counts)


def main() -> None:
    """Measure, print the table and write the page; or run an echo."""
    parser = report_page.parser("zenoh_settings", __doc__)
    parser.add_argument("--rounds", type=int, default=20, help="bursts of each setting")
    parser.add_argument("--echo", choices=list(SETTINGS), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.echo:
        run_echo(options.echo)
    else:
        _show(measure(list(SETTINGS), options.rounds), options.save)


if __name__ == "__main__":
    main()
