"""Tests of the solver suite: adapters, verdicts, limits, races, statistics and the report.

Fake solvers hang, crash or return wrong results on purpose.
"""

from __future__ import annotations

import dataclasses
import importlib
import json
import math
import os
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest

import graspforce as gf
from graspforce import problems
from graspforce.bench import plots, race, report
from graspforce.bench.adapter import SolverResult, SolverStatus
from graspforce.bench.judge import ACCEPTED_RESIDUAL, VERDICTS_WORST_FIRST, Judgement, Verdict, judge, worst_judgement
from graspforce.bench.outcome import RaceOutcome, RaceTask, load
from graspforce.bench.registry import SOLVERS, installed_solvers, load_adapter, version
from graspforce.bench.si_units import to_si_units
from graspforce.bench.statistics import (
    SHIFT,
    compare_races,
    feasible_cases,
    group_outcomes,
    performance_profile,
    shifted_mean,
    summarize_solvers,
    warm_start_gains,
)
from graspforce.bench.worker import Worker, load_case_problem, previous_case
from graspforce.cli import main
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.force.cone_program import conic_program

FAKE = """
    import os, time
    from graspforce.bench.adapter import BoundSolver, SolverResult, SolverStatus
    from graspforce import solve

    PACKAGE, EXACT_CONES, WARM_START = "graspforce", True, False

    def bind(program, settings):
        solve(program.problem, "clarabel", explain=False)  # imports Clarabel: no part of the timed run

        def run(start):
            {body}
            return solve(program.problem, "clarabel", explain=False)

        def read(answer):
            return SolverResult(SolverStatus.SOLVED, {forces}, answer.multipliers, answer.iterations)

        return BoundSolver(run, read)
"""


@pytest.fixture
def fake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Return a function that writes a solver module with some behaviour and forces, and returns its name."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def make(name: str, body: str = "pass", forces: str = "answer.f") -> str:
        text = textwrap.dedent(FAKE).format(body=body, forces=forces)
        (tmp_path / f"{name}.py").write_text(text)
        return name

    return make


def task(solver: str, case: str = "opposed/force", **change: object) -> RaceTask:
    return dataclasses.replace(RaceTask(solver, "default", "scaled", False, False, case), **change)


def outcome(
    solver: str, case: str, seconds: float | None, verdict: Verdict = Verdict.CERTIFIED, **change: object
) -> RaceOutcome:
    known = {"contacts": 3, "feasible": True, "judgement": Judgement(verdict), "iterations": 7}
    return dataclasses.replace(RaceOutcome(task(solver, case), seconds=seconds, cold=None, **known), **change)


# ── solvers ────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.filterwarnings("ignore:Warm-started solve failed")  # Moreau then starts cold
@pytest.mark.parametrize("units", ["scaled", "si"])
@pytest.mark.parametrize("name", [name for name in SOLVERS if name in installed_solvers()])
def test_every_solver_is_certified_on_an_easy_case(name: str, units: str, capfd: pytest.CaptureFixture[str]) -> None:
    """The certificate accepts only multipliers with correct signs, scales and order; cold, and warm if supported."""
    module = load_adapter(name)
    for case in ("opposed/torque-limit", "pyramid/inner-8-torque-1", "opposed/force"):
        problem = problems.load(case).problem
        if problem.cone.type == "exact" and not module.EXACT_CONES:
            problem = dataclasses.replace(problem, cone=gf.Cone("pyramid", 8, "inner"))
        program = conic_program(problem)
        entry = module.bind(to_si_units(program) if units == "si" else program, "high")
        feasible = gf.solve(problem, explain=False).found
        if name == "proxqp-nearest" and not feasible:
            continue  # it need not terminate; a test with a time limit covers it
        raw = entry.run(None)
        for answer in (raw, entry.run(raw)) if module.WARM_START else (raw,):
            verdict = judge(problem, feasible, entry.read(answer), "default").verdict
            allowed = {Verdict.CERTIFIED} if feasible else {Verdict.CERTIFIED, Verdict.UNPROVEN, Verdict.NO_ANSWER}
            if name in ("hpipm", "qpax", "qrqp"):
                allowed.add(Verdict.NO_ANSWER)  # they fail on some cases, and report it
            if name == "slsqp":
                allowed |= {Verdict.CORRECT, Verdict.NO_ANSWER}  # no multipliers; needs a scaled problem
            if units == "si":  # without scaling, some solvers reach less accuracy
                allowed |= {Verdict.UNVERIFIED, Verdict.INEXACT, Verdict.NO_ANSWER}
            assert verdict in allowed, case
    capfd.readouterr()  # qpOASES' banner


def test_at_least_eight_solvers_are_installed() -> None:
    assert len(installed_solvers()) >= 8
    assert all(version(name) for name in installed_solvers())


def test_unknown_solver_error_lists_known_solvers() -> None:
    for name in ("clarabell", "no.such.module", ""):
        with pytest.raises(UnknownName, match="structured, clarabel, ecos"):
            load_adapter(name)


@pytest.mark.parametrize(
    "name", ["ring/3-torque", "opposed/soft-load-moment-exact", "opposed/torque-weight", "nose-cone/5-margin"]
)
def test_si_units_are_the_problems_own_numbers(name: str) -> None:
    problem = problems.load(name).problem
    program = to_si_units(conic_program(problem))
    k = len(program.component_indices)
    assert program.A[:6, :k] == pytest.approx(problem.G_centred[:, program.component_indices], abs=1e-12)
    assert program.b[:6] == pytest.approx(problem.w_centred, abs=1e-12)
    if problem.objective.type == "torque":
        actuation = problem.actuation
        assert (
            pytest.approx(actuation.J @ np.diag(actuation.weight) @ actuation.J.T + problem.objective.force_weight * np.eye(k))
            == program.P
        )
    for row, bound, limit in zip(program.C, program.d, program.limits[len(program.b) - 6 :], strict=True):
        if limit is not None and limit.kind == "torque":
            own = problem.actuation.J[program.component_indices, limit.index]
            assert row[:k] == pytest.approx(-limit.sign * own)
            most = problem.actuation.upper if limit.sign < 0 else -problem.actuation.lower
            bias = problem.actuation.tau_u[limit.index]
            assert bound == pytest.approx(most[limit.index] + limit.sign * bias)


# ── judging ────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_verdict_follows_the_certificate_not_the_status() -> None:
    problem = problems.load("opposed/torque-weight").problem
    answer = gf.solve(problem, "clarabel")

    def verdict(
        f: np.ndarray | None, multipliers: gf.Multipliers | None, status: SolverStatus = SolverStatus.SOLVED
    ) -> Verdict:
        return judge(problem, True, SolverResult(status, f, multipliers, 1), "default").verdict

    assert verdict(answer.f, answer.multipliers) is Verdict.CERTIFIED
    assert verdict(answer.f * 1.001, answer.multipliers) is Verdict.INEXACT
    assert verdict(answer.f * 1.1, answer.multipliers) is Verdict.WRONG
    assert verdict(answer.f, None) is Verdict.CORRECT  # the forces are judged by themselves
    assert verdict(answer.f * 1.001, None) is Verdict.INEXACT
    assert verdict(answer.f * 1.1, None) is Verdict.WRONG
    assert verdict(None, answer.multipliers) is Verdict.WRONG
    assert verdict(answer.f, answer.multipliers, SolverStatus.INFEASIBLE) is Verdict.WRONG
    assert verdict(answer.f, answer.multipliers, SolverStatus.NO_ANSWER) is Verdict.NO_ANSWER


def test_infeasibility_needs_a_valid_proof() -> None:
    case = problems.load("opposed/capped")
    proof = case.expected.proof
    assert (
        judge(case.problem, False, SolverResult(SolverStatus.INFEASIBLE, None, proof, 1), "default").verdict
        is Verdict.CERTIFIED
    )
    wrong = dataclasses.replace(proof, y=-proof.y)
    assert (
        judge(case.problem, False, SolverResult(SolverStatus.INFEASIBLE, None, wrong, 1), "default").verdict is Verdict.UNPROVEN
    )
    assert (
        judge(case.problem, False, SolverResult(SolverStatus.INFEASIBLE, None, None, 1), "default").verdict is Verdict.UNPROVEN
    )
    f = np.zeros(case.problem.size)
    assert judge(case.problem, False, SolverResult(SolverStatus.SOLVED, f, proof, 1), "default").verdict is Verdict.WRONG


def test_finer_settings_need_smaller_residuals() -> None:
    assert ACCEPTED_RESIDUAL["high"] < ACCEPTED_RESIDUAL["default"] < ACCEPTED_RESIDUAL["low"]
    problem = problems.load("opposed/force").problem
    answer = gf.solve(problem, "clarabel")
    near = SolverResult(SolverStatus.SOLVED, answer.f * (1 + 1e-7), answer.multipliers, 1)
    verdicts = [judge(problem, True, near, settings).verdict for settings in ("low", "default", "high")]
    assert verdicts == [Verdict.CERTIFIED, Verdict.CERTIFIED, Verdict.INEXACT]


# ── processes ──────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_hanging_and_crashing_solvers_do_not_stop_the_race(fake) -> None:
    hangs, crashes, faults, raises = (
        fake("hanging_solver", "while True: pass"),
        fake("crashing_solver", "os._exit(3)"),
        fake("faulting_solver", "import ctypes; ctypes.string_at(0)"),  # a segmentation fault
        fake("raising_solver", "raise RuntimeError('no')"),
    )
    wrong, correct = fake("wrong_solver", forces="2 * answer.f"), fake("correct_solver")
    with Worker(limit=0.3) as worker:
        assert worker.run(task(hangs)).judgement.verdict is Verdict.TIMED_OUT
        assert worker.run(task(crashes)).judgement.verdict is Verdict.CRASHED
        stopped = worker.run(task(faults, "opposed/capped"))
        assert stopped.judgement.verdict is Verdict.CRASHED
        assert (stopped.contacts, stopped.feasible) == (2, False)  # the case's facts, whatever the solver does
        assert worker.run(task(raises)).judgement.verdict is Verdict.CRASHED
        doubled = worker.run(task(wrong))
        assert (doubled.judgement.verdict, doubled.seconds) == (Verdict.WRONG, None)
        assert doubled.judgement.residual > 0.1
        found = worker.run(task(correct))
        assert found.judgement.verdict is Verdict.CERTIFIED
        assert found.seconds > 0.0
        assert (found.contacts, found.feasible, found.iterations > 0, found.verdict_varies) == (2, True, True, False)


@pytest.mark.skipif("proxqp-nearest" not in installed_solvers(), reason="needs proxsuite")
def test_endless_proxqp_run_is_stopped_at_the_limit() -> None:
    """With primal_infeasibility_solving the dense solver does not terminate on this case; without it, it does."""
    case = "infeasible/near-1e-04-object-4"
    with Worker(limit=0.5) as worker:
        ends, hangs = (worker.run(task(name, case, pyramid=True, units="si")) for name in ("proxqp", "proxqp-nearest"))
    assert not ends.feasible
    assert ends.judgement.verdict in (Verdict.CERTIFIED, Verdict.UNPROVEN)
    assert hangs.judgement.verdict is Verdict.TIMED_OUT


def test_processor_time_and_wall_clock_limits_both_apply(fake) -> None:
    """Waiting does not count as processor time; a process that sleeps beyond the wall-clock limit has timed out."""
    with Worker(limit=0.2) as worker:
        assert worker.run(task(fake("waiting_solver", "time.sleep(0.5)"))).judgement.verdict is Verdict.CERTIFIED
    with Worker(limit=0.2, wall_limit=0.5) as worker:
        begun = time.monotonic()
        assert worker.run(task(fake("sleeping_solver", "time.sleep(60)"))).judgement.verdict is Verdict.TIMED_OUT
        assert time.monotonic() - begun < 30.0  # starting a process takes seconds, the sleep a minute


def test_one_run_within_the_limit_suffices(fake, tmp_path: Path) -> None:
    """Two tries above the limit do not matter if the third one is below."""
    tried = tmp_path / "tried"
    body = f"open({str(tried)!r}, 'a').write('x')\n        while len(open({str(tried)!r}).read()) < 3: pass"
    with Worker(limit=0.2) as worker:
        assert worker.run(task(fake("slow_at_first", body))).judgement.verdict is Verdict.CERTIFIED
    assert len(tried.read_text()) >= 3


def test_worst_of_several_verdicts_counts_and_is_marked_as_varying(fake) -> None:
    name = fake("varying_solver", forces="answer.f * (2 if answers.append(0) or len(answers) == 2 else 1)")
    module = Path(importlib.import_module(name).__file__)
    module.write_text("answers = []\n" + module.read_text())
    with Worker(limit=10.0) as worker:
        found = worker.run(task(name))
    assert (found.judgement.verdict, found.seconds, found.verdict_varies) == (Verdict.WRONG, None, True)
    judgements = [Judgement(Verdict.CERTIFIED, 1e-9), Judgement(Verdict.INEXACT, 1e-3), Judgement(Verdict.INEXACT, 2e-3)]
    assert worst_judgement(judgements) == judgements[2]
    assert set(VERDICTS_WORST_FIRST) == set(Verdict)


def test_warm_start_does_not_depend_on_earlier_runs() -> None:
    """The cold solution of the previous case gives the same steps, computed again or stored."""
    first, then = task("daqp", "trajectory/carry-1-004", pyramid=True), task("daqp", "trajectory/carry-1-005", pyramid=True)
    warm = dataclasses.replace(then, warm=True)
    with Worker(limit=10.0) as worker:
        alone = worker.run(warm)
        after = [worker.run(one) for one in (first, then, warm)]
    assert alone.cold is not None
    assert after[2].cold is not None
    assert alone.iterations == after[2].iterations < after[1].iterations
    assert alone.judgement == after[2].judgement
    assert [previous_case(name) for name in ("trajectory/carry-1-000", "trajectory/carry-2-001")] == [
        None,
        "trajectory/carry-2-000",
    ]
    with Worker(limit=10.0) as worker:
        assert worker.run(task("daqp", "trajectory/carry-1-000", pyramid=True, warm=True)).cold is None


def test_solver_that_crashes_on_the_previous_case_starts_cold(fake) -> None:
    name = fake("crashes_before", "os._exit(3) if program.problem.name.endswith('004') else None")
    with Worker(limit=10.0) as worker:
        found = worker.run(task(name, "trajectory/carry-1-005", warm=True))
    assert (found.judgement.verdict, found.cold) == (Verdict.CERTIFIED, None)


MEMORY = """
import os
from graspforce.bench.judge import judge
from graspforce.bench.registry import installed_solvers, load_adapter
from graspforce.bench.worker import load_case_problem
from graspforce.force.cone_program import conic_program

for case in ("fixture/clamp-limit", "opposed/capped", "opposed/force", "infeasible/ball-01", "pyramid/inner-8-torque-1"):
    for name in installed_solvers():
        problem, feasible = load_case_problem(case, not load_adapter(name).EXACT_CONES)
        if name == "proxqp-nearest" and not feasible:
            continue  # it need not terminate
        entry = load_adapter(name).bind(conic_program(problem), "default")
        print("verdict", name, case, judge(problem, feasible, entry.read(entry.run(None)), "default").verdict.value)
"""


def test_results_do_not_depend_on_uninitialised_memory() -> None:
    """Verdicts are the same for every byte that fills freshly allocated memory."""
    answers = []
    for fill in ("0", "85", "255"):
        environment = {**os.environ, "MALLOC_PERTURB_": fill}  # GNU C library only; ignored elsewhere
        ran = subprocess.run([sys.executable, "-c", MEMORY], env=environment, capture_output=True, text=True, check=True)
        answers.append([line for line in ran.stdout.splitlines() if line.startswith("verdict")])
    assert len(answers[0]) >= 5 * len(set(installed_solvers()) - {"proxqp-nearest"})
    assert answers[0] == answers[1] == answers[2]


def test_unsupported_problems_are_marked_unsupported(fake) -> None:
    refusing = fake("refusing_solver", "from graspforce.core.errors import BackendError; raise BackendError('no cones')")
    with Worker(limit=10.0) as worker:
        assert worker.run(task(refusing, "opposed/margin")).judgement.verdict is Verdict.UNSUPPORTED
        for case in ("opposed/margin", "opposed/capped"):
            assert worker.run(task("structured", case)).judgement.verdict is Verdict.CERTIFIED


def test_pyramid_replacing_a_cone_has_its_own_feasibility() -> None:
    exact, feasible = load_case_problem("nose-cone/5-friction-above", False)
    assert (exact.cone.type, feasible) == ("exact", True)
    inner, feasible = load_case_problem("nose-cone/5-friction-above", True)  # held by the cone, not by its inner pyramid
    assert (inner.cone.type, inner.cone.side, feasible) == ("pyramid", "inner", False)
    own, feasible = load_case_problem("nose-cone/5-outer-4", True)
    assert (own.cone.side, own.cone.facets, feasible) == ("outer", 4, True)


# ── the race ───────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_chosen_cases_are_spread_evenly_and_sequences_stay_whole() -> None:
    assert len(race.select_cases(["ist", "textbook"], 0)) == len(problems.names("ist")) + len(problems.names("textbook"))
    few = race.select_cases(["ist"], 10)
    assert len(few) == 10
    assert few[0] == problems.names("ist")[0]
    whole = race.select_cases(["trajectory"], 20)
    assert [name.rpartition("-")[0] for name in whole].count("trajectory/carry-1") == 41
    assert len(whole) == 82
    assert (
        race.select_cases(["ring", "textbook"], 0)
        == race.select_cases(["textbook"], 0)[-25:] + race.select_cases(["textbook"], 0)[:-25]
    )


def test_tasks_cover_what_each_solver_supports() -> None:
    wanted = list(
        race.race_tasks(
            race.make_race_plan(["structured", "daqp"], collections=["scaling", "pyramid", "trajectory"], max_cases=0)
        )
    )
    assert len(set(wanted)) == len(wanted)
    sizes = {name: len(problems.load(name).problem.contacts) for name in problems.names("scaling")}
    scaling = [t for t in wanted if t.case in sizes]
    for solver, pyramid in (("structured", False), ("structured", True), ("daqp", True)):
        assert max(sizes[t.case] for t in scaling if t.solver == solver and t.pyramid is pyramid) == max(sizes.values())
    bounded = race.make_race_plan(["structured"], collections=["scaling"], max_cases=0)
    kept = list(race.race_tasks(dataclasses.replace(bounded, pyramid_contacts=100)))
    assert max(sizes[t.case] for t in kept if t.pyramid) == 100
    assert max(sizes[t.case] for t in kept if not t.pyramid) == max(sizes.values())
    assert all(t.pyramid for t in wanted if t.solver == "daqp" or t.case.startswith("pyramid/"))
    warm = [t for t in wanted if t.warm]
    assert {t.case for t in warm} == set(problems.names("trajectory"))
    assert {t.solver for t in warm} == {"structured", "daqp"}


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"settings": ["medium"]}, "settings = 'medium': must be one of default, high, low"),
        ({"units": ["imperial"]}, "units = 'imperial': must be one of scaled, si"),
        ({"collections": ["rings"]}, "collection"),
        ({"solvers": ["nobody"]}, "solver"),
        ({"limit": 0.0}, "limit = 0.0"),
        ({"max_cases": -1}, "max_cases = -1"),
    ],
)
def test_race_plan_rejects_unknown_names_and_values(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(gf.GraspForceError, match=message):
        race.make_race_plan(**wrong)


def test_race_resumes_from_saved_outcomes(tmp_path: Path, fake, monkeypatch: pytest.MonkeyPatch) -> None:
    solver, path = fake("slow_and_steady"), tmp_path / "outcomes.jsonl"
    race_plan = race.make_race_plan([solver], collections=["ring"], max_cases=2)
    count = len(list(race.race_tasks(race_plan)))
    seen: list[tuple[int, int]] = []
    facts, outcomes = race.run(race_plan, path, lambda what, done, of: seen.append((done, of)))
    assert seen == [(i, count) for i in range(count + 1)]
    conditions, kept = load(path)
    assert kept == outcomes
    assert {name: conditions[name] for name in facts} == json.loads(json.dumps(facts))
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[:3]) + '\n{"solver": "cut o')  # two outcomes, and one that was being written

    ran: list[RaceTask] = []
    real = Worker.run
    monkeypatch.setattr(Worker, "run", lambda self, one: ran.append(one) or real(self, one))
    _, again = race.run(race_plan, path)
    assert ran == [one.task for one in outcomes[2:]]
    assert [one.judgement.verdict for one in again] == [one.judgement.verdict for one in outcomes]
    assert load(path)[1] == again
    with pytest.raises(InvalidInput, match="another limit"):
        race.run(dataclasses.replace(race_plan, limit=9.0), path)


def test_incomplete_last_line_is_skipped_and_other_files_are_rejected(tmp_path: Path) -> None:
    path = tmp_path / "outcomes.jsonl"
    path.write_text('{"schema": "graspforce/bench/2"}\n' + json.dumps(outcome("a", "x", 1.0).to_dict()) + '\n{"solver": "b')
    assert load(path)[1] == [outcome("a", "x", 1.0)]
    for text in ("", "[]", '{"schema": "else"}', '{"schema": "graspforce/bench/2"}\n{"solver": 1}'):
        path.write_text(text + "\n")
        with pytest.raises(InvalidInput):
            load(path)


# ── sums ───────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_shifted_mean_follows_its_formula() -> None:
    assert shifted_mean([3e-3, 3e-3]) == pytest.approx(3e-3)
    assert shifted_mean([1e-3, 4e-3], shift=0.0) == pytest.approx(2e-3)  # √(1·4)
    assert shifted_mean([0.0, 8 * SHIFT]) == pytest.approx(2 * SHIFT)  # √(1·9) − 1
    assert math.isnan(shifted_mean([]))


def test_means_count_failures_as_the_limit_over_commonly_supported_cases() -> None:
    outcomes = [
        outcome("a", "x", 1e-3),
        outcome("a", "y", None, Verdict.WRONG),
        outcome("a", "z", 5e-3),
        outcome("b", "x", 2e-3),
        outcome("b", "y", 3e-3),
        outcome("b", "z", None, Verdict.UNSUPPORTED),
        outcome("b", "u", None, Verdict.UNPROVEN, feasible=False),
    ]
    (group,) = group_outcomes(outcomes)
    a, b = summarize_solvers(group, limit=2.0)
    assert (a.attempted, a.claimed, a.counts[Verdict.WRONG]) == (3, 3, 1)
    assert (b.attempted, b.claimed, b.counts[Verdict.UNSUPPORTED], b.counts[Verdict.UNPROVEN]) == (4, 3, 1, 1)
    assert a.mean == pytest.approx(math.sqrt((1e-3 + SHIFT) * (2.0 + SHIFT)) - SHIFT)  # x and y: b does not support z
    assert b.mean == pytest.approx(math.sqrt((2e-3 + SHIFT) * (3e-3 + SHIFT)) - SHIFT)
    assert (a.median, b.median) == (pytest.approx(3e-3), pytest.approx(2.5e-3))
    assert performance_profile(group) == {"a": [1.0, math.inf], "b": [1.0, 2.0]}
    assert performance_profile(group, common=False) == {"a": [1.0, 1.0, math.inf], "b": [1.0, 2.0, math.inf]}
    assert (feasible_cases(group, True), feasible_cases(group, False)) == ({"x", "y"}, {"x", "y", "z"})


def test_profile_counts_cases_that_a_solver_did_not_attempt_as_not_solved() -> None:
    outcomes = [outcome("a", "x", 1e-3), outcome("a", "y", 1e-3), outcome("b", "x", 2e-3)]
    (group,) = group_outcomes(outcomes)
    assert performance_profile(group, common=False) == {"a": [1.0, 1.0], "b": [2.0, math.inf]}
    assert performance_profile(group) == {"a": [1.0], "b": [2.0]}


def test_warm_gains_count_only_steps_with_a_previous_solution() -> None:
    outcomes = []
    for i in range(4):
        case = f"trajectory/t-1-{i:03}"
        warm = task("a", case, warm=True)
        cold = 4e-3 if i else None  # the first step has no previous step
        outcomes += [outcome("a", case, 9.0, iterations=8), outcome("a", case, 1e-3, task=warm, cold=cold, iterations=2)]
    outcomes.append(outcome("a", "trajectory/t-1-004", None, Verdict.INEXACT, iterations=8))
    outcomes.append(outcome("a", "trajectory/t-1-004", 1e-3, task=task("a", "trajectory/t-1-004", warm=True), cold=1.0))
    (gain,) = warm_start_gains(outcomes)
    assert (gain.steps, gain.speedup, gain.cold_iterations, gain.warm_iterations) == (3, 4.0, 8.0, 2.0)


def test_differences_name_changed_verdicts_and_ratios_of_times() -> None:
    before = [outcome("a", "x", 1e-3), outcome("a", "y", 1e-3), outcome("a", "gone", 1.0)]
    now = [outcome("a", "x", 2e-3), outcome("a", "y", None, Verdict.WRONG), outcome("b", "new", 1.0)]
    changed, ratios = compare_races(before, now)
    assert [(old.task.case, new.judgement.verdict) for old, new in changed] == [("y", Verdict.WRONG)]
    assert ratios == {"a": 2.0}


# ── the report ─────────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.fixture(scope="module")
def raced() -> tuple[dict[str, object], list[RaceOutcome]]:
    """Return a small race with figures of every kind."""
    race_plan = race.make_race_plan(["structured", "daqp"], collections=["scaling", "trajectory", "infeasible"], max_cases=3)
    return race.run(race_plan)


def test_report_is_reproducible_except_for_times(raced, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    facts, outcomes = raced
    slower = [dataclasses.replace(o, seconds=o.seconds and 2 * o.seconds) for o in outcomes]
    texts = [report.write(tmp_path / "a", facts, outcomes, "bench").read_text()]
    monkeypatch.setattr(report, "draw_figures", lambda *_: {})  # drawn once is enough
    texts.append(report.write(tmp_path / "b", facts, slower, "bench").read_text())
    verdicts = [text.split("## Times")[0] for text in texts]
    assert verdicts[0] == verdicts[1]
    assert texts[0] != texts[1]
    for name in ("profiles", "contacts", "accuracy", "warm"):
        assert f"]({name}.png)" in texts[0]
        assert (tmp_path / "a" / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    assert "## Limitations" in texts[0]
    assert "| structured" in texts[0]
    assert all(len(line) <= 128 for line in texts[0].splitlines() if not line.startswith("|"))


def test_report_lists_wrong_timed_out_and_crashed_cases(tmp_path: Path) -> None:
    facts = {"machine": "m", "cores": 1, "python": "3", "limit": 2.0, "versions": {"a": "1.0"}}
    outcomes = [
        outcome("a", "ist/one", None, Verdict.WRONG, judgement=Judgement(Verdict.WRONG, 0.9)),
        outcome("a", "ist/two", None, Verdict.WRONG),
        outcome("a", "ist/three", None, Verdict.TIMED_OUT),
        outcome("a", "ist/four", None, Verdict.CRASHED),
    ]
    text = report.write(tmp_path / "made", facts, outcomes, "bench").read_text()
    assert "| a, default, scaled, exact cones | wrong | 2 | `ist/one` (9e-01), `ist/two` (no residual) |" in text
    assert "| timed out | 1 | `ist/three` |" in text
    assert "| crashed | 1 | `ist/four` |" in text
    assert "| a 1.0 | 4 | 50.0 % | 0.0 % | 50.0 % |" in text


def test_report_states_data_versions_clock_and_varying_verdicts(raced, tmp_path: Path) -> None:
    facts, outcomes = raced
    changed = [dataclasses.replace(outcomes[0], verdict_varies=True), *outcomes[1:]]
    text = " ".join(report.write(tmp_path / "stated", facts, changed, "bench").read_text().split())
    assert f"Problem data {problems.DATA_VERSION}, SHA-256 {problems.data_hash()[:16]}…" in text
    assert "Clock: governor" in text
    assert f"Verdicts varied between the runs of a task in {sum(o.verdict_varies for o in changed)} of {len(changed)}" in text
    assert "feasible ones" in text


def test_no_figures_without_outcomes(tmp_path: Path) -> None:
    assert plots.draw_figures([], [], tmp_path) == {}


def test_the_command_races_saves_compares_and_reports(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    saved, report = str(tmp_path / "outcomes.jsonl"), tmp_path / "report"
    asked = ["bench", "--collection", "opposed", "--solver", "clarabel", "--max-cases", "3", "--save", saved]
    assert main([*asked, "--report", str(report)]) == 0
    out = capsys.readouterr().out
    assert "exact cones, default settings, scaled units" in out
    assert (report / "report.md").read_text().count(
        "`graspforce bench --collection opposed --solver clarabel --max-cases 3"
    ) == 1
    assert main([*asked, "--compare-with", saved]) == 0
    assert "0 verdicts changed." in capsys.readouterr().out
    assert main([*asked, "--time-limit", "5"]) == 1
    assert "made with another limit" in capsys.readouterr().err


def test_example_adapter_of_the_readme_works(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (Path(__file__).parents[2] / "benchmarks" / "README.md").read_text()
    (tmp_path / "solver_of_the_page.py").write_text(text.split("```python\n")[1].split("```")[0])
    monkeypatch.syspath_prepend(str(tmp_path))
    with Worker(limit=10.0) as worker:
        for case in ("opposed/force-inner-8", "ring/3-inner-4-turned", "opposed/capped"):
            done = worker.run(task("solver_of_the_page", case, pyramid=True))
            assert done.judgement.verdict is Verdict.CERTIFIED, case


def test_a_process_runs_a_limited_number_of_tasks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiled code of many shapes would fill the memory of a process."""
    monkeypatch.setattr("graspforce.bench.worker._TASKS_PER_PROCESS", 2)
    processes = []
    with Worker(2.0) as worker:
        for name in ("opposed/force", "ring/3-force", "ring/3-torque", "opposed/capped", "opposed/force"):
            outcome = worker.run(RaceTask("structured", "default", "scaled", False, False, name))
            assert outcome.judgement.is_correct
            processes.append(worker._process.pid)
    assert [processes.index(pid) for pid in processes] == [0, 0, 2, 2, 4]
