"""A solver in a process of its own: it may hang or crash without taking anybody along.

The parent sends tasks. For each the child says what the case is, when the problem is in the solver's arrays, when the solver
has ended, and what the outcome is. A child that died is noticed, one that hangs is ended.

Verdicts must not depend on what else the machine does, nor on what was run before. The limit therefore counts the solver's
own processor time, which the system measures and ends (its profiling timer, whose signal nobody catches), and a solver counts
as stopped only where it did not end on any of `_MAX_TRIES` tries, each in a new process: near the limit the least of some times
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
from graspforce.bench.adapter import BoundSolver
from graspforce.bench.judge import Judgement, Verdict, judge, worst_judgement
from graspforce.bench.outcome import RaceOutcome, RaceTask
from graspforce.bench.registry import load_adapter
from graspforce.bench.si_units import to_si_units
from graspforce.core.errors import BackendError, GraspForceError
from graspforce.force.cone_program import conic_program
from graspforce.force.problem import ForceProblem
from graspforce.force.problem_options import Cone
from graspforce.force.solver import solve
from graspforce.force.status import Status

CaseFacts = tuple[int, bool]  # how many contacts a case has, and whether it has an answer

FACETS = 8  # of the pyramid that stands in for an exact cone
_RUN_ENDED = "ended"
_BOUND = "bound"
_READY = "ready"
_UNKNOWN_FACTS = (0, True)  # the facts of a case that could not even be stated
_PREPARATION_LIMIT = 120.0  # s: what it may take to start a process, or to write a large problem down; not the solver's time
_MAX_TRIES = 3  # of a solver that does not end within the limit
_RUNS_PER_TASK = 3  # of the solver under one patience: one that warms caches, a cold one, and the warm one
_MIN_PROCESSOR_SHARE = 0.1  # of a processor: what a solver gets at the least on a busy machine; one that gets less is asleep
_MAX_KEPT_ANSWERS = 4  # cold answers in sequences, to start from
_MIN_TOTAL_TIME = 0.05  # s: short solves are repeated until they have taken this long together,
_MAX_RUNS = 5  # or so many times
_MIN_RUNS = 3  # runs at the least, however long: some solvers do not do the same twice


class Worker:
    """A child process for one solver after another.

    Args:
        limit: s of processor time, how long a solver may take for one problem.
        patience: s on the wall's clock, after which it is ended whatever its processor time; None for what the limit takes on
            a very busy machine.
    """

    def __init__(self, limit: float, wall_limit: float | None = None) -> None:
        self._limit = limit
        self._wall_limit = _RUNS_PER_TASK * limit / _MIN_PROCESSOR_SHARE if wall_limit is None else wall_limit
        self._process: Any = None
        self._pipe: Connection | None = None

    def run(self, task: RaceTask) -> RaceOutcome:
        """Return the outcome of a task, whatever the solver does."""
        for _ in range(_MAX_TRIES - 1):
            outcome, asleep = self._try_once(task)
            if outcome.judgement.verdict is not Verdict.TIMED_OUT or asleep:
                return outcome
        return self._try_once(task)[0]

    def _try_once(self, task: RaceTask, use_previous: bool = True) -> tuple[RaceOutcome, bool]:
        """Return the outcome of one try, and whether the wall-clock limit ended the child.

        Args:
            task: the task.
            use_previous: whether a warm run starts from the previous case, or from nothing if the solver crashed on that.
        """
        pipe = self._child()
        pipe.send((task, self._limit, use_previous))
        facts = self._receive(pipe, _PREPARATION_LIMIT)
        if facts is None:
            return self._outcome_without_reply(task, _UNKNOWN_FACTS)
        bound = self._receive(pipe, _PREPARATION_LIMIT)
        if bound is None:
            return self._outcome_without_reply(task, facts)
        if bound != _BOUND:
            return _outcome_without_answer(task, facts, bound), False
        if self._receive(pipe, self._wall_limit) is None:
            lost = self._outcome_without_reply(task, facts)
            return self._try_once(task, use_previous=False) if task.warm and use_previous else lost
        if self._receive(pipe, self._wall_limit) is None:
            return self._outcome_without_reply(task, facts)
        outcome = self._receive(pipe, _PREPARATION_LIMIT)
        return self._outcome_without_reply(task, facts) if outcome is None else (outcome, False)

    def _outcome_without_reply(self, task: RaceTask, facts: CaseFacts) -> tuple[RaceOutcome, bool]:
        """Return the outcome of a child without a reply: it hung, reached its time limit, or died."""
        process = self._process
        hanging = bool(process.is_alive())
        stopped = hanging or process.exitcode == -signal.SIGPROF
        self.close()
        return _outcome_without_answer(task, facts, Verdict.TIMED_OUT if stopped else Verdict.CRASHED), hanging

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

    def _receive(self, pipe: Connection, seconds: float) -> Any:
        """Return the child's next message within some seconds; None if there is none or the child died."""
        try:
            if pipe.poll(seconds):
                return pipe.recv()
        except (EOFError, OSError):
            self._process.join(1.0)  # it is going: let is_alive know
        return None


def _outcome_without_answer(task: RaceTask, facts: CaseFacts, verdict: Verdict) -> RaceOutcome:
    return RaceOutcome(task, *facts, Judgement(verdict), None, None, 0)


# ── in the child ───────────────────────────────────────────────────────────────────────────────────────────────────────────


def _serve(pipe: Connection) -> None:
    """Run tasks until the pipe closes."""
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)  # some solvers print banners that no option turns off
    answers: dict[RaceTask, Any] = {}
    with contextlib.suppress(EOFError), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a solver's doubts about its answer are for the certificate to settle
        while True:
            task, limit, use_previous = pipe.recv()
            _run_task(task, limit, use_previous, pipe, answers)


def _run_task(task: RaceTask, limit: float, use_previous: bool, pipe: Connection, answers: dict[RaceTask, Any]) -> None:
    """Send the case's facts, whether the solver takes the problem, that it can start, that it has ended, then the outcome."""
    problem, feasible = load_case_problem(task.case, task.pyramid)
    pipe.send((len(problem.contacts), feasible))
    try:
        bound_solver = _bind_solver(task, problem)
    except GraspForceError:
        return pipe.send(Verdict.UNSUPPORTED)
    except Exception:  # each solver has exceptions of its own
        return pipe.send(Verdict.CRASHED)
    pipe.send(_BOUND)
    start = _warm_start(task, limit, answers) if task.warm and use_previous else None
    pipe.send(_READY)
    run_result: tuple[Any, float] | Verdict
    cold = None
    try:
        if start is not None:
            _time_run(
                _bind_solver(task, problem), None, limit
            )  # so that caches are as warm for the cold run as for the warm one
            cold = _time_run(_bind_solver(task, problem), None, limit)[1]
        run_result = _time_run(bound_solver, start, limit)
    except BackendError:
        run_result = Verdict.UNSUPPORTED
    except Exception:  # of the solver's own
        run_result = Verdict.CRASHED
    pipe.send(_RUN_ENDED)
    outcome = dataclasses.replace(_judge_runs(task, problem, feasible, bound_solver, run_result, limit), cold=cold)
    if not task.warm and not isinstance(run_result, Verdict):
        _keep_answer(answers, task, run_result[0] if outcome.judgement.verdict is Verdict.CERTIFIED else None)
    return pipe.send(outcome)


def _bind_solver(task: RaceTask, problem: ForceProblem) -> BoundSolver:
    """Bind a solver to the problem; a new one for each run, since some keep their last solution."""
    program = conic_program(problem)
    return load_adapter(task.solver).bind(to_si_units(program) if task.units == "si" else program, task.settings)


def _warm_start(task: RaceTask, limit: float, answers: dict[RaceTask, Any]) -> Any:
    """Return the solver's certified cold solution of the previous case, or None."""
    earlier = previous_case(task.case)
    if earlier is None:
        return None
    cold = dataclasses.replace(task, warm=False, case=earlier)
    if cold not in answers:
        raw, certified = None, False
        problem, feasible = load_case_problem(earlier, task.pyramid)
        with contextlib.suppress(Exception):  # of the solver's own: then there is nothing to start from
            bound_solver = _bind_solver(cold, problem)
            raw, _ = _time_run(bound_solver, None, limit)
            certified = judge(problem, feasible, bound_solver.read(raw), task.settings).verdict is Verdict.CERTIFIED
        _keep_answer(answers, cold, raw if certified else None)
    return answers[cold]


def _keep_answer(answers: dict[RaceTask, Any], task: RaceTask, raw: Any) -> None:
    answers[task] = raw
    while len(answers) > _MAX_KEPT_ANSWERS:
        del answers[next(iter(answers))]


def _judge_runs(
    task: RaceTask,
    problem: ForceProblem,
    feasible: bool,
    bound_solver: BoundSolver,
    run_result: tuple[Any, float] | Verdict,
    limit: float,
) -> RaceOutcome:
    """Return the outcome of a solver's result or failure; cold, of the worst result of several runs."""
    facts = (len(problem.contacts), feasible)
    if isinstance(run_result, Verdict):
        return _outcome_without_answer(task, facts, run_result)
    runs, taken = [(bound_solver, run_result[0])], [run_result[1]]  # all kept, so that each run finds its memory elsewhere
    try:
        while not task.warm and (len(runs) < _MIN_RUNS or (len(runs) < _MAX_RUNS and sum(taken) < _MIN_TOTAL_TIME)):
            again = _bind_solver(task, problem)
            raw, passed = _time_run(again, None, limit)
            runs.append((again, raw))
            taken.append(passed)
        results = [one.read(raw) for one, raw in runs]
        judgements = [judge(problem, feasible, result, task.settings) for result in results]
    except Exception:  # what it returned does not fit the problem, or it did not return again
        return _outcome_without_answer(task, facts, Verdict.CRASHED)
    judgement = worst_judgement(judgements)
    seconds = statistics.median(taken) if judgement.verdict is Verdict.CERTIFIED else None
    return RaceOutcome(
        task,
        *facts,
        judgement,
        seconds,
        None,
        results[0].iterations,
        verdict_varies=len({one.verdict for one in judgements}) > 1,
    )


def _time_run(bound_solver: BoundSolver, start: Any, limit: float) -> tuple[Any, float]:
    """Run and time a solver; the process ends beyond the limit of processor time."""
    signal.setitimer(signal.ITIMER_PROF, limit)
    try:
        begun = time.perf_counter()
        raw = bound_solver.run(start)
        return raw, time.perf_counter() - begun
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


@lru_cache(maxsize=8)
def load_case_problem(name: str, pyramid: bool) -> tuple[ForceProblem, bool]:
    """Return a case's problem, exact or as a pyramid, and whether it is feasible.

    The pyramid that stands in for an exact cone is another problem: whether that has an answer `solve` finds out, and proves.
    """
    case = problems.load(name)
    if not pyramid or case.problem.cone.type == "pyramid":
        return case.problem, case.expected.status is Status.OPTIMAL
    problem = dataclasses.replace(case.problem, cone=Cone("pyramid", FACETS, "inner"))
    return problem, solve(problem, explain=False).found


def sequence_name(name: str) -> str:
    """Return the sequence of a case: its name without the last number."""
    return name.rpartition("-")[0]


def previous_case(name: str) -> str | None:
    """Return the previous case of a sequence; None for the first."""
    every = problems.names(name.partition("/")[0])
    i = every.index(name)
    return every[i - 1] if i and sequence_name(every[i - 1]) == sequence_name(name) else None
