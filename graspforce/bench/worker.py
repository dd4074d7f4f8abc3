"""Run a solver in its own process, so that a timeout or a crash does not end the race.

The parent sends tasks. For each task the child sends the facts of the case, then "bound" when the problem is in the solver's
arrays. "ready" follows when a warm run has its start, "ended" when the timed run has returned, and last the outcome. The parent
detects a crash by the closed pipe, and kills a child that exceeds a limit.

Verdicts must not depend on the load of the machine or on earlier tasks:

- The limit counts processor time, by the system's profiling timer (SIGPROF, not caught). A solver has timed out only if it
  exceeds the limit on each of `_MAX_TRIES` tries, each in a new process. The least of several times varies less than one time.
- The wall-clock limit ends only processes that sleep.
- Results may depend on memory addresses. Each cold task is therefore run several times, and the worst verdict counts.
- A warm start uses the solver's own cold solution of the previous case, which is computed again if it is not stored.
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
from graspforce.bench.case_program import case_program
from graspforce.bench.case_sequences import previous_case
from graspforce.bench.judge import Judgement, Verdict, judge, worst_judgement
from graspforce.bench.outcome import RaceOutcome, RaceTask
from graspforce.bench.registry import load_adapter
from graspforce.bench.si_units import to_si_units, to_single_precision
from graspforce.core.errors import BackendError, GraspForceError
from graspforce.force.problem import ForceProblem
from graspforce.force.problem_options import Cone
from graspforce.force.solver import solve
from graspforce.force.status import Status
from graspforce.problems.case import ExpectedOptimum

CaseFacts = tuple[int, bool]  # number of contacts of a case, and whether it is feasible

FACETS = 8  # facets of the inner pyramid that replaces an exact cone
_RUN_ENDED = "ended"
_BOUND = "bound"
_READY = "ready"
_UNKNOWN_FACTS = (0, True)  # facts of a case that could not be loaded
_PREPARATION_LIMIT = 120.0  # s, wall clock, to start a process or to build a large program; not part of the solver's time
_EXIT_CODE_POLLS = 100
_MAX_TRIES = 3  # tries of a solver that exceeds the limit
_RUNS_PER_TASK = 3  # runs within one wall-clock limit: one that warms caches, a cold one and the warm one
_MIN_PROCESSOR_SHARE = 0.1  # share of a processor that a solver gets on a busy machine; with less it is taken as asleep
_MAX_KEPT_ANSWERS = 4  # stored cold solutions for warm starts
_MIN_TOTAL_TIME = 0.05  # s; short solves are repeated up to this total time, and at most `_MAX_RUNS` times
_MAX_RUNS = 5
_TASKS_PER_PROCESS = 1000  # then a new process: solvers that compile code for each shape keep it in memory
_MIN_RUNS = 3  # runs of each cold task, because some solvers are not deterministic


class Worker:
    """Child process that runs tasks one after another.

    Args:
        limit: processor time of one solve, s.
        wall_limit: wall-clock limit of the runs of one task, s; by default 30 × ``limit``, which allows for a busy machine.
    """

    def __init__(self, limit: float, wall_limit: float | None = None) -> None:
        self._limit = limit
        self._wall_limit = _RUNS_PER_TASK * limit / _MIN_PROCESSOR_SHARE if wall_limit is None else wall_limit
        self._process: Any = None
        self._pipe: Connection | None = None
        self._count = 0  # tasks of the process

    def run(self, task: RaceTask) -> RaceOutcome:
        """Return the outcome of a task, also if the solver times out or crashes.

        Args:
            task: the task.
        """
        for k in range(_MAX_TRIES):
            outcome, asleep = self._try_once(task)
            if outcome.judgement.verdict is not Verdict.TIMED_OUT or asleep:
                return dataclasses.replace(outcome, verdict_varies=outcome.verdict_varies or k > 0)
        return outcome

    def _try_once(self, task: RaceTask, use_previous: bool = True) -> tuple[RaceOutcome, bool]:
        """Return the outcome of one try, and whether the wall-clock limit ended the child.

        Args:
            task: the task.
            use_previous: whether a warm run starts from the previous case; False after the solver failed on that case.
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
        """Return the outcome of a child that did not reply: it reached a limit or crashed."""
        process = self._process
        alive = bool(process.is_alive())
        timed_out = alive or process.exitcode == -signal.SIGPROF
        self.close()
        return _outcome_without_answer(task, facts, Verdict.TIMED_OUT if timed_out else Verdict.CRASHED), alive

    def close(self) -> None:
        """Kill the child process."""
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
        is_used_up = self._count >= _TASKS_PER_PROCESS
        if self._process is None or self._pipe is None or is_used_up or not self._process.is_alive():
            self.close()
            self._count = 0
            context = multiprocessing.get_context("forkserver")
            context.set_forkserver_preload([__name__])  # so that a process starts within a fraction of a second
            self._pipe, theirs = context.Pipe()
            self._process = context.Process(target=_serve, args=(theirs, dict(os.environ)), daemon=True)
            self._process.start()
            theirs.close()
        self._count += 1
        return self._pipe

    def _receive(self, pipe: Connection, seconds: float) -> Any:
        """Return the child's next message within some seconds; None if there is none or the child died."""
        try:
            if pipe.poll(seconds):
                return pipe.recv()
        except (EOFError, OSError):
            self._process.join(1.0)  # so that is_alive returns False
            for _ in range(_EXIT_CODE_POLLS):  # another thread may just have collected it, and sets the exit code next
                if self._process.exitcode is not None:
                    break
                time.sleep(0.01)
        return None


def _outcome_without_answer(task: RaceTask, facts: CaseFacts, verdict: Verdict) -> RaceOutcome:
    return RaceOutcome(task, *facts, Judgement(verdict), None, None, 0)


# ── in the child ───────────────────────────────────────────────────────────────────────────────────────────────────────────


def _serve(pipe: Connection, environment: dict[str, str]) -> None:
    """Run tasks until the pipe closes.

    Args:
        pipe: to the parent.
        environment: of the parent; that of the server of processes is as old as the server.
    """
    os.environ.clear()
    os.environ |= environment
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)  # some solvers print a banner that no option disables
    answers: dict[RaceTask, Any] = {}
    with contextlib.suppress(EOFError), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the certificate judges the solution, not the solver's warnings
        while True:
            task, limit, use_previous = pipe.recv()
            _run_task(task, limit, use_previous, pipe, answers)


def _run_task(task: RaceTask, limit: float, use_previous: bool, pipe: Connection, answers: dict[RaceTask, Any]) -> None:
    """Run a task and send its messages: facts of the case, "bound" or a verdict, "ready", "ended", outcome."""
    problem, feasible = load_case_problem(task.case, task.pyramid)
    pipe.send((len(problem.contacts), feasible))
    try:
        bound_solver = _bind_solver(task, problem)
    except GraspForceError:
        return pipe.send(Verdict.UNSUPPORTED)
    except Exception:  # solvers raise exceptions of any type
        return pipe.send(Verdict.CRASHED)
    pipe.send(_BOUND)
    start = _warm_start(task, limit, answers) if task.warm and use_previous else None
    pipe.send(_READY)
    run_result: tuple[Any, float] | Verdict
    cold = None
    try:
        if start is not None:
            _time_run(_bind_solver(task, problem), None, limit)  # warms the caches for the cold run
            cold = _time_run(_bind_solver(task, problem), None, limit)[1]
        run_result = _time_run(bound_solver, start, limit)
    except BackendError:
        run_result = Verdict.UNSUPPORTED
    except Exception:  # solvers raise exceptions of any type
        run_result = Verdict.CRASHED
    pipe.send(_RUN_ENDED)
    outcome = dataclasses.replace(_judge_runs(task, bound_solver, run_result, limit), cold=cold)
    if not task.warm and not isinstance(run_result, Verdict):
        _keep_answer(answers, task, run_result[0] if outcome.judgement.is_solved else None)
    return pipe.send(outcome)


def _bind_solver(task: RaceTask, problem: ForceProblem) -> BoundSolver:
    """Bind a solver to the problem. Each run needs a new binding, because some solvers keep their last solution."""
    program = case_program(problem)
    program = to_si_units(program) if task.units == "si" else program
    program = to_single_precision(program) if task.settings == "float32" else program
    return load_adapter(task.solver).bind(program, task.settings)


def _warm_start(task: RaceTask, limit: float, answers: dict[RaceTask, Any]) -> Any:
    """Return the solver's correct cold solution of the previous case, or None."""
    earlier = previous_case(task.case)
    if earlier is None:
        return None
    cold = dataclasses.replace(task, warm=False, case=earlier)
    if cold not in answers:
        raw, solved = None, False
        problem, feasible, optimum = load_proven_case(earlier, task.pyramid)
        with contextlib.suppress(Exception):  # solvers raise exceptions of any type; the run then starts cold
            bound_solver = _bind_solver(cold, problem)
            raw, _ = _time_run(bound_solver, None, limit)
            solved = judge(problem, feasible, bound_solver.read(raw), task.settings, optimum).is_solved
        _keep_answer(answers, cold, raw if solved else None)
    return answers[cold]


def _keep_answer(answers: dict[RaceTask, Any], task: RaceTask, raw: Any) -> None:
    answers[task] = raw
    while len(answers) > _MAX_KEPT_ANSWERS:
        del answers[next(iter(answers))]


def _judge_runs(
    task: RaceTask, bound_solver: BoundSolver, run_result: tuple[Any, float] | Verdict, limit: float
) -> RaceOutcome:
    """Return the outcome of a run. A cold task is run several times, and its worst judgement counts."""
    problem, feasible, optimum = load_proven_case(task.case, task.pyramid)
    facts = (len(problem.contacts), feasible)
    if isinstance(run_result, Verdict):
        return _outcome_without_answer(task, facts, run_result)
    runs, times = [(bound_solver, run_result[0])], [run_result[1]]  # keeps all outputs, so that memory addresses differ
    try:
        while not task.warm and (len(runs) < _MIN_RUNS or (len(runs) < _MAX_RUNS and sum(times) < _MIN_TOTAL_TIME)):
            solver = _bind_solver(task, problem)
            raw, elapsed = _time_run(solver, None, limit)
            runs.append((solver, raw))
            times.append(elapsed)
        results = [solver.read(raw) for solver, raw in runs]
        judgements = [judge(problem, feasible, result, task.settings, optimum) for result in results]
    except Exception:  # malformed output, or an exception in a repeated run
        return dataclasses.replace(_outcome_without_answer(task, facts, Verdict.CRASHED), verdict_varies=len(runs) > 1)
    judgement = worst_judgement(judgements)
    seconds = statistics.median(times) if judgement.is_solved else None
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
    """Run and time a solver. The system ends the process above the limit of processor time."""
    signal.setitimer(signal.ITIMER_PROF, limit)
    try:
        begin = time.perf_counter()
        raw = bound_solver.run(start)
        return raw, time.perf_counter() - begin
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


def load_case_problem(name: str, pyramid: bool) -> tuple[ForceProblem, bool]:
    """Return the problem of a case, exact or with pyramids, and whether it is feasible.

    With pyramids in place of exact cones the problem differs from that of the case; `solve` then proves its feasibility.

    Args:
        name: name of the case.
        pyramid: whether exact cones are replaced by inner pyramids of `FACETS` facets.
    """
    return load_proven_case(name, pyramid)[:2]


@lru_cache(maxsize=8)
def load_proven_case(name: str, pyramid: bool) -> tuple[ForceProblem, bool, ExpectedOptimum | None]:
    """Return the problem of a case, whether it is feasible, and its proven optimum if it is.

    Args:
        name: name of the case.
        pyramid: whether exact cones are replaced by inner pyramids of `FACETS` facets.
    """
    case = problems.load(name)
    if not pyramid or case.problem.cone.type == "pyramid":
        feasible = isinstance(case.expected, ExpectedOptimum)
        return case.problem, feasible, case.expected if isinstance(case.expected, ExpectedOptimum) else None
    problem = dataclasses.replace(case.problem, cone=Cone("pyramid", FACETS, "inner"))
    solution = solve(problem, explain=False)
    if solution.status is Status.INFEASIBLE:
        return problem, False, None
    if not solution.found or solution.objective is None or solution.certificate is None:
        raise BackendError(f"{name}: the pyramid is neither solved nor proven infeasible")
    return problem, True, ExpectedOptimum(solution.objective, solution.certificate.tolerance)
