"""Campaigns: trials in random worlds, in several processes, with a file of results that can be continued."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from graspforce.core import fields
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.core.result_file import ResultFile, read_results
from graspforce.simulation.campaigns.outcome import Result, RunOutcome, Sign
from graspforce.simulation.campaigns.trial import CampaignSetup, TrialRecord, run_trial

SCHEMA = "graspforce/campaign/1"

Trial = tuple[str, int]  # label of the grasp, seed of the world

_THREAD_VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
_STOP_TIME = 5.0  # s, for workers to end


def run_campaign(
    setup: CampaignSetup,
    trials: Sequence[Trial],
    *,
    workers: int = 1,
    on_trial: Callable[[TrialRecord], None] | None = None,
) -> list[TrialRecord]:
    """Run trials in worker processes, each with one thread.

    A worker that crashes is replaced, and its trial counts as an error.

    Args:
        setup: what the trials have in common.
        trials: label of the grasp and seed of the world of each trial.
        workers: number of processes.
        on_trial: called with each trial when it is complete. An exception that it raises, such as KeyboardInterrupt, ends the
            campaign.

    Returns:
        The trials, in the order in which they were completed.

    Raises:
        InvalidInput: a trial has no grasp in the setup, or the number of workers is less than 1.
    """
    fields.check_integer(workers, "workers", minimum=1, maximum=1024)
    labels = [label for label, _ in setup.grasps]
    for label, _ in trials:
        fields.check_choice(label, "trials", labels)
    pending, records = list(reversed(trials)), []
    pool = [_Worker(setup) for _ in range(min(workers, len(trials)))]
    try:
        for worker in pool:
            worker.start(pending.pop())
        busy = list(pool)
        while busy:
            for connection in wait([worker.connection for worker in busy]):
                worker = next(worker for worker in busy if worker.connection is connection)
                record = worker.result()
                records.append(record)
                if on_trial is not None:
                    on_trial(record)
                if pending:
                    worker.start(pending.pop())
                else:
                    busy.remove(worker)
    finally:
        for worker in pool:
            worker.stop()
    return records


class _Worker:
    """A process that runs trials one after another.

    Attributes:
        connection: readable when the trial is complete or the process has ended.

    Args:
        setup: the campaign.
    """

    connection: Connection

    def __init__(self, setup: CampaignSetup) -> None:
        self._setup = setup
        self._process: Any = None
        self._trial: Trial | None = None

    def start(self, trial: Trial) -> None:
        """Start a trial; the process first, if there is none."""
        if self._process is None:
            context = multiprocessing.get_context("spawn")
            self.connection, child = context.Pipe()
            self._process = context.Process(target=_work, args=(child, self._setup), daemon=True)
            with _one_thread():
                self._process.start()
            child.close()
        self._trial = trial
        self.connection.send(trial)

    def result(self) -> TrialRecord:
        """Return the completed trial; an error if the process has ended."""
        assert self._trial is not None  # start() was called
        label, seed = self._trial
        try:
            return TrialRecord.from_dict(self.connection.recv())
        except (EOFError, OSError):
            self._process.join(_STOP_TIME)
            message = f"the worker process ended with exit code {self._process.exitcode}"
            self.connection.close()
            self._process = None
            world = self._setup.draw(seed, float(dict(self._setup.grasps)[label].hand.torque_upper.min()))
            return TrialRecord(label, seed, world, RunOutcome("error", "error", message=message), None, 0.0)

    def stop(self) -> None:
        """End the process."""
        if self._process is not None:
            self.connection.close()  # an idle worker ends by itself
            self._process.terminate()
            self._process.join(_STOP_TIME)
            self._process = None


def _work(connection: Connection, setup: CampaignSetup) -> None:
    """Run trials that arrive over a connection until it is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends the campaign
    while True:
        try:
            label, seed = connection.recv()
        except EOFError:
            return
        connection.send(run_trial(setup, label, seed).to_dict())


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let processes that are started meanwhile use one thread for linear algebra."""
    before = {name: os.environ.get(name) for name in _THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


class CampaignFile:
    """A file of a campaign's trials: a line of JSON with its conditions, then one for each trial.

    The file is locked until `close`, so that only one process writes it.

    Args:
        path: the file; it is created if it is missing, otherwise it is continued.
        conditions: facts that distinguish the campaign, such as duration and options. They must be those in the file.

    Attributes:
        records: the trials in the file.

    Raises:
        InvalidInput: another process writes the file, it is of another campaign, or it is no such file.
    """

    def __init__(self, path: Path, conditions: Mapping[str, object]) -> None:
        self._file = ResultFile(path, SCHEMA, conditions)
        try:
            self.records = _trials(self._file.records)
        except InvalidInput:
            self.close()
            raise

    def append(self, record: TrialRecord) -> None:
        """Add a trial to the file.

        Args:
            record: the trial.
        """
        self._file.append(record.to_dict())
        self.records.append(record)

    def missing(self, trials: Sequence[Trial]) -> list[Trial]:
        """Return the trials that are not in the file.

        Args:
            trials: label and seed of each trial.
        """
        present = {(record.grasp, record.seed) for record in self.records}
        return [trial for trial in trials if trial not in present]

    def close(self) -> None:
        """Close the file, and let other processes write it."""
        self._file.close()

    def __enter__(self) -> CampaignFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def read_campaign(path: Path) -> tuple[JsonRecord, list[TrialRecord]]:
    """Return the conditions and the trials of a campaign's file; a partial last line is skipped.

    Args:
        path: the file.

    Raises:
        InvalidInput: no such file, or not of a campaign.
    """
    conditions, records = read_results(path, SCHEMA)
    return conditions, _trials(records)


def _trials(records: Sequence[object]) -> list[TrialRecord]:
    """Return the trials of plain records, whose first is in line 2 of the file."""
    return [TrialRecord.from_dict(record, f"line {i}") for i, record in enumerate(records, start=2)]


@dataclass(frozen=True, slots=True)
class FailureGroup:
    """Trials of one grasp that failed in the same way.

    Attributes:
        grasp: label of the grasp.
        result: the failure.
        sign: its first sign.
        seeds: seeds of the worlds.
        avoidable: seeds of those in which a controller with full knowledge held the object.
    """

    grasp: str
    result: Result
    sign: Sign
    seeds: tuple[int, ...]
    avoidable: tuple[int, ...]


def group_failures(records: Sequence[TrialRecord]) -> list[FailureGroup]:
    """Return the failures by grasp, result and first sign; the largest groups of a grasp first.

    Args:
        records: trials.
    """
    failed = [record for record in records if not record.controller.is_held]
    counts = Counter((record.grasp, record.controller.result, record.controller.sign) for record in failed)
    groups = []
    for grasp, result, sign in sorted(counts, key=lambda key: (key[0], -counts[key], key)):
        members = sorted(
            (r for r in failed if (r.grasp, r.controller.result, r.controller.sign) == (grasp, result, sign)),
            key=lambda record: record.seed,
        )
        avoidable = tuple(record.seed for record in members if record.exact is not None and record.exact.is_held)
        groups.append(FailureGroup(grasp, result, sign, tuple(record.seed for record in members), avoidable))
    return groups
