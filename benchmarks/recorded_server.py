"""A server that records itself: `python -m benchmarks.recorded_server [--seconds S] [--save FILE]`.

This process steps two streams at 1 kHz, one at a server with `--record` and one at a server without. Bursts of half a second
take turns, so that a drift of the machine's speed affects both. Between the bursts it sends the requests of `docs/wire.md` to
the server with `--record`: force problems, measures, explanations, kinematics, single steps, streams, a grasp search, a plan.

Then the recording is answered again, and all replies are compared to the bit, apart from times. The library mcap reads the file
with its checksums; a warning is an error.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from mcap.reader import make_reader

from benchmarks import report_page
from benchmarks.control_stream import allegro_grasp, state_sequence
from benchmarks.interference import PERIOD
from benchmarks.service_load import LOCAL, TIMEOUT, python_process, read_line
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState
from graspforce.core.errors import ServiceError
from graspforce.service import Client, Stream
from graspforce.service.recording.recording_reader import ServerRecording
from graspforce.service.replay.replay import Replay, load_hands
from graspforce.service.replay.report import ReplayReport

BURST = 500  # periods
WARM_UP = 50  # periods of a burst that are not timed
REQUEST_EVERY = 10  # bursts between two rounds of requests
HANDS = ("allegro_right", "four_finger")
SERVERS = {"without --record": False, "with --record": True}
QUERY = re.compile(r"<!-- query (\S+) -->\s*```json\n(.*?)```", re.S)
WIRE_PAGE = Path(__file__).parents[1] / "docs/wire.md"


@contextlib.contextmanager
def start_server(record: Path | None) -> Iterator[str]:
    """Run ``graspforce serve``, and yield its address. At the end, wait until the process has ended.

    Args:
        record: the recording; None for none.
    """
    hands = [word for hand in HANDS for word in ("--hand", hand)]
    recording = [] if record is None else ["--record", str(record)]
    with python_process("graspforce", "serve", *hands, "--listen", LOCAL, "--json", *recording) as child:
        yield json.loads(read_line(child))["addresses"][0]
        child.terminate()
        child.wait(TIMEOUT)


def burst(stream: Stream, points: list[tuple[GraspState, BodyMotion]]) -> list[float]:
    """Return the times of the round trips of one burst, s."""
    trips, tick = [], time.perf_counter()
    for i, point in enumerate(points):
        tick = max(tick + PERIOD, time.perf_counter())
        time.sleep(max(tick - time.perf_counter(), 0.0))
        start = time.perf_counter()
        stream.step(*point, wait=TIMEOUT)
        if i >= WARM_UP:
            trips.append(time.perf_counter() - start)
    return trips


def send_requests(client: Client) -> None:
    """Send the requests of the page of the wire; error records are answers, too."""
    for key, text in QUERY.findall(WIRE_PAGE.read_text()):
        with contextlib.suppress(ServiceError):
            client.query(key, json.loads(text), timeout=TIMEOUT)


def record(path: Path, seconds: float) -> dict[str, list[float]]:
    """Record a server, and return the times of the round trips by server, s.

    Args:
        path: the recording.
        seconds: length of the recorded stream, s.
    """
    grasp = allegro_grasp()
    points = state_sequence(grasp, BURST)
    trips: dict[str, list[float]] = {name: [] for name in SERVERS}
    with contextlib.ExitStack() as opened:
        clients = {}
        for name, is_recorded in SERVERS.items():
            address = opened.enter_context(start_server(path if is_recorded else None))
            clients[name] = opened.enter_context(Client(address, timeout=TIMEOUT))
        streams = {
            name: opened.enter_context(client.open_stream(grasp, ControlSettings(), validity=TIMEOUT))
            for name, client in clients.items()
        }
        for number in range(round(seconds / (BURST * PERIOD))):
            if number % REQUEST_EVERY == 0:
                send_requests(clients["with --record"])
            for name, stream in streams.items():
                trips[name] += burst(stream, points)
    return trips


def count_messages(path: Path) -> Counter[str]:
    """Return the number of messages by schema, as the library mcap reads them; warnings are errors.

    Args:
        path: the recording.
    """
    found: Counter[str] = Counter()
    with warnings.catch_warnings(), path.open("rb") as file:
        warnings.simplefilter("error")
        for schema, _, _ in make_reader(file, validate_crcs=True).iter_messages():
            found["without schema" if schema is None else schema.name] += 1
    return found


def rows_of(report: ReplayReport) -> list[tuple[str, ...]]:
    """Return the rows of a report: one for each kind of key, and one for all states."""
    rows: dict[str, list[int]] = {}
    reasons: dict[str, Counter[str]] = {}
    for name, result in report.sources.items():
        kind = "states of streams" if name.startswith("streams/") else re.sub(r"streams/.*", "streams/<id>", name[9:])
        total = rows.setdefault(kind, [0, 0, 0])
        for i, value in enumerate((result.count, result.equal, result.different)):
            total[i] += value
        reasons.setdefault(kind, Counter()).update(result.explained)
    why = {kind: "; ".join(f"{count} × {reason}" for reason, count in each.items()) for kind, each in reasons.items()}
    return [(kind, *map(str, counts), why[kind]) for kind, counts in rows.items()]


def show(
    trips: dict[str, list[float]], report: ReplayReport, messages: Counter[str], facts: list[str], save: Path | None
) -> None:
    """Print the tables, and write the page."""
    medians = {name: 1e6 * float(np.median(each)) for name, each in trips.items()}  # µs
    tails = {name: 1e6 * float(np.percentile(each, 99)) for name, each in trips.items()}  # µs
    base = medians["without --record"]
    latency = [(name, f"{medians[name]:.0f}", f"{tails[name]:.0f}", f"{medians[name] / base:.3f}") for name in trips]
    head = ("server", "median µs", "99 % µs", "median, ratio")
    replayed = ("key", "exchanges", "equal to the bit", "different", "explained")
    report_page.show("Round trips of a stream at 1 kHz", head, latency)
    report_page.show("Replay", replayed, rows_of(report))
    counts = [(name, str(count)) for name, count in sorted(messages.items())]
    report_page.show("Messages by schema", ("schema", "messages"), counts)
    print(*facts, *report.notes, sep="\n")
    for name, result in report.sources.items():
        for number, difference in result.examples:
            print(f"{name}, exchange {number}: {difference}")
    if save is None:
        return
    parts = [report_page.table(head, latency), report_page.table(replayed, rows_of(report), text_columns=1)]
    parts += [report_page.table(("schema", "messages"), counts), " ".join(facts)]
    about = report_page.facts(f"{os.cpu_count()} cores", f"load average {os.getloadavg()[0]:.1f}")
    report_page.save(save, "A server that records itself", __doc__, about, "\n\n".join(parts))


def main() -> None:
    """Record, replay, print the tables and write the page."""
    parser = report_page.parser("recorded_server", __doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="length of the recorded stream, s")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "day.mcap"
        trips = record(path, options.seconds)
        recording = ServerRecording.open(path)
        while not recording.is_complete:  # its process writes the rest
            time.sleep(0.1)
            recording = ServerRecording.open(path)
        began = time.perf_counter()
        report = Replay(recording, load_hands(recording)).run()
        seconds = time.perf_counter() - began
        facts = [
            f"Recording: {path.stat().st_size / 1e6:.1f} MB, {sum(recording.dropped.values())} exchanges dropped.",
            f"Replay: {report.equal} of {report.count} replies equal to the bit in {seconds:.1f} s.",
        ]
        show(trips, report, count_messages(path), facts, options.save)


if __name__ == "__main__":
    main()
