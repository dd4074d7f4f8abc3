"""Latency of a control stream while the same server plans: `python -m benchmarks.plan_beside_stream`.

This process steps a stream at 1 kHz against a server in another process. A third process requests free moves from that server.
Bursts with and without planning take turns, so that a drift of the machine's speed affects both equally. Two servers take
turns as well: the shipped one plans in separate processes, and a variant plans in a thread of the server.
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
from graspforce.bench.conditions import processor
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
BURST = 400  # steps of a burst
WARM_UP = 20  # steps of a burst that are not timed
PERIOD = 1e-3  # s
_SERVERS = {"separate process": "process", "thread": "thread"}  # description and kind


class ThreadPlanner(PlanningWorker):
    """Worker that plans in a thread of the server instead of a separate process."""

    def plan(self, job, hand, progress, late):  # type: ignore[no-untyped-def]
        """Plan in the calling thread."""
        self._stop = False

        def send(message: jobs.WorkerMessage) -> None:
            if message.kind == jobs.PROGRESS:
                progress(message.reply)

        return planning_process.run_job(job, hand, send, lambda: self._stop)

    def cancel(self) -> None:
        """Stop the plan at its next stage or iteration."""
        self._stop = True


def _serve(kind: str) -> None:
    if kind == "thread":
        request_handler.PlanningWorker = ThreadPlanner  # type: ignore[misc]
    serve([HAND], listen="tcp/127.0.0.1:0", on_ready=lambda server: print(server.addresses[0], flush=True))


def _move(grasp: Grasp) -> FreeMove:
    p_HO = grasp.p_HO + np.array([[0.0, 0.0, 0.0], [0.002, 0.0, 0.003]])
    goal = Rotation.from_rotvec([0.05, 0.0, 0.0]).as_matrix() @ grasp.R_HO
    return FreeMove(object_task(grasp, ControlSettings()), p_HO, np.array([grasp.R_HO, goal]), q_start=grasp.q)


def _plan_client(address: str) -> None:
    """Request one plan for each line of standard input, and print the time of each, s."""
    move = _move(three_finger_grasp())
    with Client(address, timeout=60.0) as client:
        client.plan(move, budget=60.0)
        print("ready", flush=True)
        for _ in sys.stdin:
            start = time.perf_counter()
            client.plan(move, budget=60.0)
            print(f"{time.perf_counter() - start:.6f}", flush=True)


@contextlib.contextmanager
def _process(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "benchmarks.plan_beside_stream", *arguments]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as child:
        try:
            yield child
        finally:
            child.terminate()


def _burst(client: Client, grasp: Grasp) -> list[float]:
    """Return the times of the round trips of one burst, s."""
    state = GraspState(grasp.q, np.zeros(grasp.hand.n), BodyMotion(grasp.p_HO, grasp.R_HO))
    trips = []
    with client.open_stream(grasp, ControlSettings()) as stream:
        for _ in range(BURST):
            start = time.perf_counter()
            stream.step(state, state.object, wait=0.1)
            trips.append(time.perf_counter() - start)
            time.sleep(max(PERIOD - trips[-1], 0.0))
    return trips[WARM_UP:]


def main() -> None:
    """Measure, print the table and write the page; or run one of the other processes."""
    parser = report_page.parser("plan_beside_stream", __doc__)
    parser.add_argument("--rounds", type=int, default=10, help="bursts of each subject")
    parser.add_argument("--serve", help=argparse.SUPPRESS)
    parser.add_argument("--plan", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve:
        _serve(options.serve)
    elif options.plan:
        _plan_client(options.plan)
    else:
        _measure(options.rounds, options.save)


def _measure(rounds: int, save: Path | None) -> None:
    grasp, trips, plans = three_finger_grasp(), {}, {}  # type: ignore[var-annotated]
    with contextlib.ExitStack() as stack:
        clients, plan_clients = {}, {}
        for planner, kind in _SERVERS.items():
            address = _read_line(stack.enter_context(_process("--serve", kind)))
            clients[planner] = stack.enter_context(Client(address, timeout=30.0))
            plan_clients[planner] = stack.enter_context(_process("--plan", address))
            assert _read_line(plan_clients[planner]) == "ready"
        for _ in range(rounds):
            for planner, client in clients.items():
                for planning in (False, True):
                    if planning:
                        _send_line(plan_clients[planner], "go")
                    trips.setdefault((planner, planning), []).extend(_burst(client, grasp))
                    if planning:
                        plans.setdefault(planner, []).append(float(_read_line(plan_clients[planner])))
    head = ("planner", "load", "p50 ms", "p95 ms", "p99 ms", "max ms", "over 5 ms")
    rows = []
    for (planner, planning), seconds in trips.items():
        figures = 1e3 * np.percentile(seconds, [50, 95, 99, 100])
        late = f"{100.0 * np.mean(np.array(seconds) > 5e-3):.2f} %"
        load = f"planning, {np.median(plans[planner]):.2f} s per plan" if planning else "no planning"
        rows.append((planner, load, *(f"{x:.2f}" for x in figures), late))
    facts = f"{processor()}, Python {platform.python_version()}, {len(trips[planner, True])} steps per row."
    title = "Latency of a control stream during planning"
    report_page.show(title, head, rows)
    print(facts)
    if save is not None:
        report_page.save(save, title, __doc__, facts, report_page.table(head, rows, text_columns=2))


def _send_line(child: subprocess.Popen[str], line: str) -> None:
    assert child.stdin is not None  # a pipe
    child.stdin.write(line + "\n")
    child.stdin.flush()


def _read_line(child: subprocess.Popen[str]) -> str:
    assert child.stdout is not None  # a pipe
    return child.stdout.readline().strip()


if __name__ == "__main__":
    main()
