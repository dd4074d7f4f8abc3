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

from benchmarks import report_page
from benchmarks.closed_loop import three_finger_grasp
from graspforce.bench.race import processor
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState
from graspforce.grasp.grasp import Grasp
from graspforce.planning import FreeMove
from graspforce.planning.tracking import object_task
from graspforce.service import Client, serve
from graspforce.service.server import request_handler
from graspforce.service.workers import jobs, planning_process
from graspforce.service.workers.planning_worker import PlanningWorker

HAND = "allegro_right"
BURST = 400  # steps, the first ones to warm up
WARM_UP = 20
PERIOD = 1e-3  # s
_SERVERS = {"a process": "own", "a thread": "thread"}


class ThreadPlanner(PlanningWorker):
    """What the service would be without planning processes."""

    def plan(self, job, hand, progress, late):  # type: ignore[no-untyped-def]
        """In this very thread."""
        self._stop = False

        def send(message: jobs.WorkerMessage) -> None:
            if message.kind == jobs.PROGRESS:
                progress(message.reply)

        return planning_process.run_job(job, hand, send, lambda: self._stop)

    def cancel(self) -> None:
        """At its next stage or iteration."""
        self._stop = True


def _serve(kind: str) -> None:
    if kind == "thread":
        request_handler.PlanningWorker = ThreadPlanner  # type: ignore[misc]
    serve([HAND], listen="tcp/127.0.0.1:0", on_ready=lambda server: print(server.addresses[0], flush=True))


def _move(grasp: Grasp) -> FreeMove:
    p_HO = grasp.p_HO + np.array([[0.0, 0.0, 0.0], [0.002, 0.0, 0.003]])
    turned = Rotation.from_rotvec([0.05, 0.0, 0.0]).as_matrix() @ grasp.R_HO
    return FreeMove(object_task(grasp, ControlSettings()), p_HO, np.array([grasp.R_HO, turned]), q_start=grasp.q)


def _plan_client(address: str) -> None:
    """Plan while standard input says go, a letter a plan; say how long each took."""
    move = _move(three_finger_grasp())
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


def _burst(client: Client, grasp: Grasp) -> list[float]:
    """Round trips of one stream, s."""
    seen = GraspState(grasp.q, np.zeros(grasp.hand.n), BodyMotion(grasp.p_HO, grasp.R_HO))
    trips = []
    with client.open_stream(grasp, ControlSettings()) as stream:
        for _ in range(BURST):
            since = time.perf_counter()
            stream.step(seen, seen.object, wait=0.1)
            trips.append(time.perf_counter() - since)
            time.sleep(max(PERIOD - trips[-1], 0.0))
    return trips[WARM_UP:]


def main() -> None:
    """Run the measurement, or one of its processes."""
    parser = report_page.parser("plan_beside_stream", __doc__)
    parser.add_argument("--rounds", type=int, default=10, help="bursts of each subject")
    parser.add_argument("--serve", help=argparse.SUPPRESS)
    parser.add_argument("--ask", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve:
        _serve(options.serve)
    elif options.ask:
        _plan_client(options.ask)
    else:
        _measure(options.rounds, options.save)


def _measure(rounds: int, save: Path | None) -> None:
    grasp, trips, plans = three_finger_grasp(), {}, {}  # type: ignore[var-annotated]
    with contextlib.ExitStack() as stack:
        clients, plan_clients = {}, {}
        for words, kind in _SERVERS.items():
            address = _read_line(stack.enter_context(_process("--serve", kind)))
            clients[words] = stack.enter_context(Client(address, timeout=30.0))
            plan_clients[words] = stack.enter_context(_process("--ask", address))
            assert _read_line(plan_clients[words]) == "ready"
        for _ in range(rounds):
            for words, client in clients.items():
                for planning in (False, True):
                    if planning:
                        _send_line(plan_clients[words], "go")
                    trips.setdefault((words, planning), []).extend(_burst(client, grasp))
                    if planning:
                        plans.setdefault(words, []).append(float(_read_line(plan_clients[words])))
    head = ("server", "meanwhile", "p50 ms", "p95 ms", "p99 ms", "largest ms", "over 5 ms")
    rows = []
    for (words, planning), seconds in trips.items():
        figures = 1e3 * np.percentile(seconds, [50, 95, 99, 100])
        late = f"{100.0 * np.mean(np.array(seconds) > 5e-3):.2f} %"
        took = f"a plan in {words}, {np.median(plans[words]):.2f} s each" if planning else "no plan"
        rows.append((words, took, *(f"{x:.2f}" for x in figures), late))
    facts = f"{processor()}, Python {platform.python_version()}, {len(trips['a process', True])} steps each."
    report_page.show("round trips of a stream's step", head, rows)
    print(facts)
    if save is not None:
        report_page.save(save, "What a control stream feels of plans", __doc__, facts, report_page.table(head, rows, words=2))


def _send_line(child: subprocess.Popen[str], word: str) -> None:
    assert child.stdin is not None  # a pipe
    child.stdin.write(word + "\n")
    child.stdin.flush()


def _read_line(child: subprocess.Popen[str]) -> str:
    assert child.stdout is not None  # a pipe
    return child.stdout.readline().strip()


if __name__ == "__main__":
    main()
