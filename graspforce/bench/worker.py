"""A solver in a process of its own: it may hang or crash without taking anybody along.

The parent sends tasks. For each the child says when the problem is in the solver's arrays, when the solver has ended, and what
the outcome is: the limit of time counts the solver alone. A child that is late is killed, one that died is noticed.
"""

from __future__ import annotations

import contextlib
import dataclasses
import multiprocessing
import os
import statistics
import time
import warnings
from functools import lru_cache
from multiprocessing.connection import Connection
from typing import Any

from graspforce import problems
from graspforce.bench.entrant import Entry
from graspforce.bench.judge import Judgement, Verdict, judge
from graspforce.bench.outcome import Outcome, Task
from graspforce.bench.registry import entrant
from graspforce.bench.units import in_si
from graspforce.errors import BackendError, GraspForceError
from graspforce.problem import Cone, ForceProblem
from graspforce.program import conic_program
from graspforce.solution import Status
from graspforce.solve import solve

Facts = tuple[int, bool]  # how many contacts a case has, and whether it has an answer

FACETS = 8  # of the pyramid that stands in for an exact cone
_ENDED = "ended"
_UNKNOWN = (0, True)  # the facts of a case that could not even be stated
_PREPARING = 120.0  # s: what it may take to start a process, or to write a large problem down; not the solver's time
_ENOUGH = 0.05  # s: short solves are repeated until they have taken this long together,
_MOST_REPEATS = 5  # or so many times


class Worker:
    """A child process for one solver after another.

    Args:
        limit: s, how long a solver may take for one problem.
    """

    def __init__(self, limit: float) -> None:
        self._limit = limit
        self._process: Any = None
        self._pipe: Connection | None = None

    def run(self, task: Task) -> Outcome:
        """The outcome of a task, whatever the solver does."""
        pipe = self._child()
        pipe.send(task)
        stated = self._received(pipe, _PREPARING)
        if stated is None:
            self.close()
            return _ended(task, _UNKNOWN, Verdict.CRASHED)
        verdict, facts = stated
        if verdict is not None:
            return _ended(task, facts, verdict)
        if self._received(pipe, self._limit) is None:
            hanging = bool(self._process.is_alive())
            self.close()
            return _ended(task, facts, Verdict.STOPPED if hanging else Verdict.CRASHED)
        outcome = self._received(pipe, _PREPARING)
        if not isinstance(outcome, Outcome):
            self.close()
            return _ended(task, facts, Verdict.CRASHED)
        return outcome

    def close(self) -> None:
        """End the child."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
        if self._pipe is not None:
            self._pipe.close()
        self._process = self._pipe = None

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _child(self) -> Connection:
        if self._process is None or self._pipe is None or not self._process.is_alive():
            self.close()
            context = multiprocessing.get_context("spawn")
            self._pipe, theirs = context.Pipe()
            self._process = context.Process(target=_serve, args=(theirs,), daemon=True)
            self._process.start()
            theirs.close()
        return self._pipe

    def _received(self, pipe: Connection, seconds: float) -> Any:
        """What the child sends within so many seconds; None where it sends nothing, or is dead."""
        try:
            if pipe.poll(seconds):
                return pipe.recv()
        except (EOFError, OSError):
            self._process.join(1.0)  # it is going: let is_alive know
        return None


def _ended(task: Task, facts: Facts, verdict: Verdict) -> Outcome:
    return Outcome(task, *facts, Judgement(verdict), None, None, 0)


# ── in the child ───────────────────────────────────────────────────────────────────────────────────────────────────────────


def _serve(pipe: Connection) -> None:
    """Run tasks until the pipe closes."""
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)  # some solvers print banners that no option turns off
    last: dict[tuple[str, ...], Any] = {}
    with contextlib.suppress(EOFError), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a solver's doubts about its answer are for the certificate to settle
        while True:
            task: Task = pipe.recv()
            _race(task, pipe, last)


def _race(task: Task, pipe: Connection, last: dict[tuple[str, ...], Any]) -> None:
    """Send whether the solver takes the problem, then that it has ended, then the outcome."""
    problem, feasible = stated(task.case, task.pyramid)
    facts = (len(problem.contacts), feasible)
    try:
        program = conic_program(problem)
        entry = entrant(task.solver).bind(in_si(program) if task.units == "si" else program, task.settings)
    except GraspForceError:
        return pipe.send((Verdict.REFUSED, facts))
    except Exception:  # each solver has exceptions of its own
        return pipe.send((Verdict.CRASHED, facts))
    chain = (task.solver, task.settings, task.units, str(task.pyramid), sequence(task.case))
    start = last.pop(chain, None) if task.warm else None
    pipe.send((None, facts))
    ran: tuple[Any, float] | Verdict
    cold = None
    try:
        if start is not None:
            entry.run(None)  # so that caches are as warm for the cold run as for the warm one
            cold = _timed(entry, None)[1]
        ran = _timed(entry, start)
    except BackendError:
        ran = Verdict.REFUSED
    except Exception:  # of the solver's own
        ran = Verdict.CRASHED
    pipe.send(_ENDED)
    outcome = dataclasses.replace(_judged(task, problem, feasible, entry, ran), cold=cold)
    if task.warm and outcome.judgement.verdict is Verdict.CERTIFIED and not isinstance(ran, Verdict):
        last[chain] = ran[0]
    return pipe.send(outcome)


def _judged(task: Task, problem: ForceProblem, feasible: bool, entry: Entry, ran: tuple[Any, float] | Verdict) -> Outcome:
    """The outcome of what a solver returned in its first run, or of its failure."""
    facts = (len(problem.contacts), feasible)
    if isinstance(ran, Verdict):
        return _ended(task, facts, ran)
    raw, first = ran
    try:
        claim = entry.read(raw)
        judgement = judge(problem, feasible, claim, task.settings)
    except Exception:  # what it returned does not fit the problem
        return _ended(task, facts, Verdict.CRASHED)
    if judgement.verdict is not Verdict.CERTIFIED:
        return Outcome(task, *facts, judgement, None, None, claim.iterations)
    seconds = first if task.warm else _median(entry, first)
    return Outcome(task, *facts, judgement, seconds, None, claim.iterations)


def _timed(entry: Entry, start: Any) -> tuple[Any, float]:
    begun = time.perf_counter()
    raw = entry.run(start)
    return raw, time.perf_counter() - begun


def _median(entry: Entry, first: float) -> float:
    """The median of some cold runs, where they are short."""
    taken = [first]
    while len(taken) < _MOST_REPEATS and sum(taken) < _ENOUGH:
        taken.append(_timed(entry, None)[1])
    return statistics.median(taken)


@lru_cache(maxsize=8)
def stated(name: str, pyramid: bool) -> tuple[ForceProblem, bool]:
    """A case's problem, as a pyramid or as it is, and whether it has an answer.

    The pyramid that stands in for an exact cone is another problem: whether that has an answer `solve` finds out, and proves.
    """
    case = problems.load(name)
    if not pyramid or case.problem.cone.type == "pyramid":
        return case.problem, case.expected.status is Status.OPTIMAL
    problem = dataclasses.replace(case.problem, cone=Cone("pyramid", FACETS, "inner"))
    return problem, solve(problem, explain=False).found


def sequence(name: str) -> str:
    """The sequence that a case belongs to: its name without the last number."""
    return name.rpartition("-")[0]
