"""What a control stream feels of plans that the same server makes: `python -m benchmarks.plan_beside_stream`.

A driver here steps a stream at 1 kHz, a server in a process of its own answers it, and another process asks that server for
free moves. Bursts with and without plans take turns, so that a machine whose speed drifts slows both alike; so do two servers:
the one that ships, whose plans are made in processes of their own, and one that makes them in a thread.
"""

from __future__ import annotations

import argparse
import contextlib
import platform
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks import page
from benchmarks.closed_loop import three_fingers
from graspforce.bench.race import processor
from graspforce.body import BodyMotion
from graspforce.control import ControlSettings, GraspState
from graspforce.hold import Hold
from graspforce.planning import FreeMove
from graspforce.service import Client, handler, planning_process, serve
from graspforce.service.planner import Planner
from graspforce.tracking import task

HAND = "allegro_right"
BURST = 400  # steps, the first ones to warm up
WARM_UP = 20
PERIOD = 1e-3  # s
_SERVERS = {"a process": "own", "a thread": "thread"}


class ThreadPlanner(Planner):
    """What the service would be without planning processes."""

    def plan(self, job, hand, progress, late):  # type: ignore[no-untyped-def]
        """In this very thread."""
        self._stop = False

        def tell(message: planning_process.Message) -> None:
            if message.kind == planning_process.PROGRESS:
                progress(message.reply)

        return planning_process.answer(job, hand, tell, lambda: self._stop)

    def cancel(self) -> None:
        """At its next stage or iteration."""
        self._stop = True


def _serve(kind: str) -> None:
    if kind == "thread":
        handler.Planner = ThreadPlanner  # type: ignore[misc]
    serve([HAND], listen="tcp/127.0.0.1:0", on_ready=lambda server: print(server.addresses[0], flush=True))


def _move(hold: Hold) -> FreeMove:
    p_HO = hold.p_HO + np.array([[0.0, 0.0, 0.0], [0.002, 0.0, 0.003]])
    turned = Rotation.from_rotvec([0.05, 0.0, 0.0]).as_matrix() @ hold.R_HO
    return FreeMove(task(hold, ControlSettings()), p_HO, np.array([hold.R_HO, turned]), q_start=hold.q)


def _ask(address: str) -> None:
    """Plan while standard input says go, a letter a plan; say how long each took."""
    move = _move(three_fingers())
    with Client(address, timeout=60.0) as client:
        client.plan(move, budget=60.0)
        print("ready", flush=True)
        for _ in sys.stdin:
            since = time.perf_counter()
            client.plan(move, budget=60.0)
            print(f"{time.perf_counter() - since:.6f}", flush=True)


@contextlib.contextmanager
def _process(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "benchmarks.plan_beside_stream", *arguments]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as child:
        try:
            yield child
        finally:
            child.terminate()


def _burst(client: Client, hold: Hold) -> list[float]:
    """Round trips of one stream, s."""
    seen = GraspState(hold.q, np.zeros(hold.hand.n), BodyMotion(hold.p_HO, hold.R_HO))
    trips = []
    with client.open_stream(hold, ControlSettings()) as stream:
        for _ in range(BURST):
            since = time.perf_counter()
            stream.step(seen, seen.object, wait=0.1)
            trips.append(time.perf_counter() - since)
            time.sleep(max(PERIOD - trips[-1], 0.0))
    return trips[WARM_UP:]


def main() -> None:
    """What was asked for: the measurement, or one of its processes."""
    parser = page.parser("plan_beside_stream", __doc__)
    parser.add_argument("--rounds", type=int, default=10, help="bursts of each subject")
    parser.add_argument("--serve", help=argparse.SUPPRESS)
    parser.add_argument("--ask", help=argparse.SUPPRESS)
    wish = parser.parse_args()
    if wish.serve:
        _serve(wish.serve)
    elif wish.ask:
        _ask(wish.ask)
    else:
        _measure(wish.rounds, wish.save)


def _measure(rounds: int, save: Path | None) -> None:
    hold, trips, plans = three_fingers(), {}, {}  # type: ignore[var-annotated]
    with contextlib.ExitStack() as stack:
        clients, askers = {}, {}
        for words, kind in _SERVERS.items():
            address = _line(stack.enter_context(_process("--serve", kind)))
            clients[words] = stack.enter_context(Client(address, timeout=30.0))
            askers[words] = stack.enter_context(_process("--ask", address))
            assert _line(askers[words]) == "ready"
        for _ in range(rounds):
            for words, client in clients.items():
                for planning in (False, True):
                    if planning:
                        _say(askers[words], "go")
                    trips.setdefault((words, planning), []).extend(_burst(client, hold))
                    if planning:
                        plans.setdefault(words, []).append(float(_line(askers[words])))
    head = ("server", "meanwhile", "p50 ms", "p95 ms", "p99 ms", "largest ms", "over 5 ms")
    rows = []
    for (words, planning), seconds in trips.items():
        figures = 1e3 * np.percentile(seconds, [50, 95, 99, 100])
        late = f"{100.0 * np.mean(np.array(seconds) > 5e-3):.2f} %"
        took = f"a plan in {words}, {np.median(plans[words]):.2f} s each" if planning else "no plan"
        rows.append((words, took, *(f"{x:.2f}" for x in figures), late))
    facts = f"{processor()}, Python {platform.python_version()}, {len(trips['a process', True])} steps each."
    page.show("round trips of a stream's step", head, rows)
    print(facts)
    if save is not None:
        page.save(save, "What a control stream feels of plans", __doc__, facts, page.table(head, rows, words=2))


def _say(child: subprocess.Popen[str], word: str) -> None:
    assert child.stdin is not None  # a pipe
    child.stdin.write(word + "\n")
    child.stdin.flush()


def _line(child: subprocess.Popen[str]) -> str:
    assert child.stdout is not None  # a pipe
    return child.stdout.readline().strip()


if __name__ == "__main__":
    main()
