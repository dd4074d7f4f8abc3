"""Latency of the query `grasp`: a client requests a grasp of a primitive from a server in another process.

Each case is one object of the IST set, all of them spheres, cylinders and boxes, with one hand: 50 g, μ = 0.6, weight in six
directions, no class. Queries come one at a time; one to each hand before the others is not recorded.

*latency*: elapsed time from the client's call to the decoded answer. *processor*: processor time of the server and its planning
process during the query. Refusals, for objects without a grasp, count with their times.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks import report_page
from benchmarks.lifecycle.search import FRICTION, HANDS, MASS
from graspforce.core.errors import GraspForceError
from graspforce.core.result_file import ResultFile, read_results
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.hand.hand import Hand
from graspforce.problems.objects import ist_objects
from graspforce.service import Client
from graspforce.service.wire.grasp_records import GraspRequest

TITLE = "Latency of the query `grasp`"
SCHEMA = "graspforce/grasp_latency/1"
ALLOWED = 1.0  # s: median latency
_BUDGET = 30.0  # s, of a query
_TICK = os.sysconf("SC_CLK_TCK")  # 1/s
_SERVER = """
import sys
from graspforce.service import serve
serve(sys.argv[1:], listen="tcp/127.0.0.1:0", on_ready=lambda server: print(server.addresses[0], flush=True))
"""


@dataclass(frozen=True, slots=True)
class LatencyRecord:
    """One query.

    Args:
        hand: name of the hand.
        name: name of the object.
        latency: s.
        processor: processor time of the server and its planning process, s.
        load: the machine's load average over a minute, before the query.
        fault: the server's message; empty for a grasp.
    """

    hand: str
    name: str
    latency: float
    processor: float
    load: float
    fault: str


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the section.

    Args:
        parser: the parser.
    """
    parser.add_argument("--hands", default=",".join(HANDS), help="names of the hands")
    parser.add_argument("--objects", type=int, default=20, help="number of objects")
    parser.add_argument("--seed", type=int, default=0, help="seed of the searches")


def run(path: Path, options: argparse.Namespace) -> None:
    """Send the queries that are missing in a file of results.

    Args:
        path: the file.
        options: of the section.
    """
    hands = options.hands.split(",")
    with ResultFile(path, SCHEMA, {"mass": MASS, "friction": FRICTION, "seed": options.seed}) as results:
        done = {(each["hand"], each["name"]) for each in results.records if isinstance(each, dict)}
        objects = list(ist_objects())[: options.objects]
        command = [sys.executable, "-c", _SERVER, *hands]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
            try:
                assert server.stdout is not None
                with Client(server.stdout.readline().strip(), timeout=2.0 * _BUDGET) as client:
                    for name in hands:
                        hand = Hand.load(name)
                        _query(client, server.pid, hand, "warm-up", GraspRequest(Body.solid(Sphere(0.03), MASS)))
                        for each in objects:
                            if (name, each.title) not in done:
                                request = GraspRequest(Body.solid(each.shape, MASS), FRICTION, seed=options.seed)
                                record = _query(client, server.pid, hand, each.title, request)
                                print(record, flush=True)
                                results.append(asdict(record))
            finally:
                server.terminate()


def _query(client: Client, server: int, hand: Hand, name: str, request: GraspRequest) -> LatencyRecord:
    """Send one query, and return its times."""
    load, fault, spent, start = os.getloadavg()[0], "", _processor_time(server), time.perf_counter()
    try:
        client.find_grasp(hand, request, budget=_BUDGET)
    except GraspForceError as error:
        fault = str(error)
    latency = time.perf_counter() - start
    return LatencyRecord(hand.name, name, latency, _processor_time(server) - spent, load, fault)


def _processor_time(process: int) -> float:
    """Return the processor time of a process and its children, s."""
    total = sum(map(int, Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[11:13])) / _TICK
    for task in Path(f"/proc/{process}/task").iterdir():
        total += sum(_processor_time(int(child)) for child in (task / "children").read_text().split())
    return total


def page(path: Path) -> str:
    """Return the Markdown of the section.

    Args:
        path: the file of results.
    """
    records = [LatencyRecord(**record) for record in read_results(path, SCHEMA)[1] if isinstance(record, dict)]
    rows = [_row(hand, [each for each in records if each.hand == hand]) for hand in dict.fromkeys(e.hand for e in records)]
    rows.append(_row("**all**", records))
    head = ("hand", "queries", "found", "median latency s", "95 % s", "largest s", "median processor s", "95 % s", "load")
    about = [" ".join(part.split()) for part in (__doc__ or "").split("\n\n")[1:]]
    goal = f"Required: a median latency of at most {ALLOWED:g} s. *load*: mean load average of the machine before the queries."
    return "\n\n".join([*about, report_page.table(head, rows), goal])


def _row(name: str, records: list[LatencyRecord]) -> tuple[str, ...]:
    """Return the cells of a row."""
    latency, processor = (np.array([getattr(each, key) for each in records]) for key in ("latency", "processor"))
    return (
        *(name, str(len(records)), str(sum(not each.fault for each in records))),
        *(f"{np.median(latency):.2f}", f"{np.percentile(latency, 95):.2f}", f"{latency.max():.2f}"),
        *(f"{np.median(processor):.2f}", f"{np.percentile(processor, 95):.2f}"),
        f"{np.mean([each.load for each in records]):.1f}",
    )
