"""A solver in a process of its own: it may hang or crash without taking anybody along.

The parent sends tasks. For each the child says what the case is, when the problem is in the solver's arrays, when the solver
has ended, and what the outcome is. A child that died is noticed, one that hangs is ended.

Verdicts must not depend on what else the machine does, nor on what was run before. The limit therefore counts the solver's
own processor time, which the system measures and ends (its profiling timer, whose signal nobody catches), and a solver counts
as stopped only where it did not end on any of `_TRIES` tries, each in a new process: near the limit the least of some times
decides, which varies less than any one of them. Answers may depend on where in memory a solver's numbers come to lie: each is
asked again, and the worst of its answers counts. The clock on the wall ends only what sleeps. A warm start is from the
solver's own cold answer to the case before, found again where it is not at hand.
"""

from __future__ import annotations

import contextlib
import dataclasses
import multiprocessing
import os
import signal
import statistics
import time
import warnings
from functools import lru_cache
from multiprocessing.connection import Connection
from typing import Any

from graspforce import problems
from graspforce.bench.entrant import Entry
from graspforce.bench.judge import Judgement, Verdict, judge, worst
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
_BOUND = "bound"
_READY = "ready"
_UNKNOWN = (0, True)  # the facts of a case that could not even be stated
_PREPARING = 120.0  # s: what it may take to start a process, or to write a large problem down; not the solver's time
_TRIES = 3  # of a solver that does not end within the limit
_RUNS = 3  # of the solver under one patience: one that warms caches, a cold one, and the warm one
_SHARE = 0.1  # of a processor: what a solver gets at the least on a busy machine; one that gets less is asleep
_KEPT = 4  # cold answers in sequences, to start from
_ENOUGH = 0.05  # s: short solves are repeated until they have taken this long together,
_MOST_REPEATS = 5  # or so many times
_JUDGED = 3  # runs at the least, however long: some solvers do not do the same twice


class Worker:
    """A child process for one solver after another.

    Args:
        limit: s of processor time, how long a solver may take for one problem.
        patience: s on the wall's clock, after which it is ended whatever its processor time; None for what the limit takes on
            a very busy machine.
    """

    def __init__(self, limit: float, patience: float | None = None) -> None:
        self._limit = limit
        self._patience = _RUNS * limit / _SHARE if patience is None else patience
        self._process: Any = None
        self._pipe: Connection | None = None

    def run(self, task: Task) -> Outcome:
        """The outcome of a task, whatever the solver does."""
        for _ in range(_TRIES - 1):
            outcome, asleep = self._tried(task)
            if outcome.judgement.verdict is not Verdict.STOPPED or asleep:
                return outcome
        return self._tried(task)[0]

    def _tried(self, task: Task, follow: bool = True) -> tuple[Outcome, bool]:
        """The outcome of one try, and whether the child was ended by the wall's clock.

        Args:
            task: the task.
            follow: whether a warm one starts from the case before, or, where the solver does not survive that, from nothing.
        """
        pipe = self._child()
        pipe.send((task, self._limit, follow))
        facts = self._received(pipe, _PREPARING)
        if facts is None:
            return self._lost(task, _UNKNOWN)
        bound = self._received(pipe, _PREPARING)
        if bound is None:
            return self._lost(task, facts)
        if bound != _BOUND:
            return _ended(task, facts, bound), False
        if self._received(pipe, self._patience) is None:
            lost = self._lost(task, facts)
            return self._tried(task, follow=False) if task.warm and follow else lost
        if self._received(pipe, self._patience) is None:
            return self._lost(task, facts)
        outcome = self._received(pipe, _PREPARING)
        return self._lost(task, facts) if outcome is None else (outcome, False)

    def _lost(self, task: Task, facts: Facts) -> tuple[Outcome, bool]:
        """The outcome of a child that did not answer: it hangs, was stopped by its own timer, or died."""
        process = self._process
        hanging = bool(process.is_alive())
        stopped = hanging or process.exitcode == -signal.SIGPROF
        self.close()
        return _ended(task, facts, Verdict.STOPPED if stopped else Verdict.CRASHED), hanging

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
    answers: dict[Task, Any] = {}
    with contextlib.suppress(EOFError), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a solver's doubts about its answer are for the certificate to settle
        while True:
            task, limit, follow = pipe.recv()
            _race(task, limit, follow, pipe, answers)


def _race(task: Task, limit: float, follow: bool, pipe: Connection, answers: dict[Task, Any]) -> None:
    """Send the case's facts, whether the solver takes the problem, that it can start, that it has ended, then the outcome."""
    problem, feasible = stated(task.case, task.pyramid)
    pipe.send((len(problem.contacts), feasible))
    try:
        entry = _entry(task, problem)
    except GraspForceError:
        return pipe.send(Verdict.REFUSED)
    except Exception:  # each solver has exceptions of its own
        return pipe.send(Verdict.CRASHED)
    pipe.send(_BOUND)
    start = _start(task, limit, answers) if task.warm and follow else None
    pipe.send(_READY)
    ran: tuple[Any, float] | Verdict
    cold = None
    try:
        if start is not None:
            _timed(_entry(task, problem), None, limit)  # so that caches are as warm for the cold run as for the warm one
            cold = _timed(_entry(task, problem), None, limit)[1]
        ran = _timed(entry, start, limit)
    except BackendError:
        ran = Verdict.REFUSED
    except Exception:  # of the solver's own
        ran = Verdict.CRASHED
    pipe.send(_ENDED)
    outcome = dataclasses.replace(_judged(task, problem, feasible, entry, ran, limit), cold=cold)
    if not task.warm and not isinstance(ran, Verdict):
        _keep(answers, task, ran[0] if outcome.judgement.verdict is Verdict.CERTIFIED else None)
    return pipe.send(outcome)


def _entry(task: Task, problem: ForceProblem) -> Entry:
    """The solver with the problem in its arrays; a new one for each run, since some keep what they found last."""
    program = conic_program(problem)
    return entrant(task.solver).bind(in_si(program) if task.units == "si" else program, task.settings)


def _start(task: Task, limit: float, answers: dict[Task, Any]) -> Any:
    """The solver's cold answer to the case before, where there is one and it is certified; else None."""
    earlier = before(task.case)
    if earlier is None:
        return None
    cold = dataclasses.replace(task, warm=False, case=earlier)
    if cold not in answers:
        raw, certified = None, False
        problem, feasible = stated(earlier, task.pyramid)
        with contextlib.suppress(Exception):  # of the solver's own: then there is nothing to start from
            entry = _entry(cold, problem)
            raw, _ = _timed(entry, None, limit)
            certified = judge(problem, feasible, entry.read(raw), task.settings).verdict is Verdict.CERTIFIED
        _keep(answers, cold, raw if certified else None)
    return answers[cold]


def _keep(answers: dict[Task, Any], task: Task, raw: Any) -> None:
    answers[task] = raw
    while len(answers) > _KEPT:
        del answers[next(iter(answers))]


def _judged(
    task: Task, problem: ForceProblem, feasible: bool, entry: Entry, ran: tuple[Any, float] | Verdict, limit: float
) -> Outcome:
    """The outcome of what a solver returned, or of its failure; cold, of the worst that it returned in several runs."""
    facts = (len(problem.contacts), feasible)
    if isinstance(ran, Verdict):
        return _ended(task, facts, ran)
    runs, taken = [(entry, ran[0])], [ran[1]]  # all kept, so that each run finds its memory elsewhere
    try:
        while not task.warm and (len(runs) < _JUDGED or (len(runs) < _MOST_REPEATS and sum(taken) < _ENOUGH)):
            again = _entry(task, problem)
            raw, passed = _timed(again, None, limit)
            runs.append((again, raw))
            taken.append(passed)
        claims = [one.read(raw) for one, raw in runs]
        judgements = [judge(problem, feasible, claim, task.settings) for claim in claims]
    except Exception:  # what it returned does not fit the problem, or it did not return again
        return _ended(task, facts, Verdict.CRASHED)
    judgement = worst(judgements)
    seconds = statistics.median(taken) if judgement.verdict is Verdict.CERTIFIED else None
    return Outcome(
        task, *facts, judgement, seconds, None, claims[0].iterations, varies=len({one.verdict for one in judgements}) > 1
    )


def _timed(entry: Entry, start: Any, limit: float) -> tuple[Any, float]:
    """What a run returned and took; beyond the limit of processor time the process ends."""
    signal.setitimer(signal.ITIMER_PROF, limit)
    try:
        begun = time.perf_counter()
        raw = entry.run(start)
        return raw, time.perf_counter() - begun
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


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


def before(name: str) -> str | None:
    """The case before a case in its sequence; None for the first."""
    every = problems.names(name.partition("/")[0])
    i = every.index(name)
    return every[i - 1] if i and sequence(every[i - 1]) == sequence(name) else None
