"""Explanations: margins and factors with closed forms, words that name the limits, and the deadline."""

from __future__ import annotations

import dataclasses
import json
import time
from types import SimpleNamespace

import numpy as np
import pytest
from support.random_problems import random_problem

from graspforce import Actuation, Contact, ForceProblem, InvalidInput, SolverSettings, Status, explain, solve
from graspforce.cli import main
from graspforce.force.backends import clarabel


def pair(weight: float, torque: float | None = None) -> ForceProblem:
    """Return two opposed contacts with μ = 0.5 and f_n ≤ 10 N that lift a weight, N; a motor has 0.1 m of lever."""
    contacts = [Contact((0, y, 0), (0, -y, 0), 0.5, max_normal=10.0) for y in (0.05, -0.05)]
    J = np.zeros((6, 2))
    J[2, 0] = J[5, 1] = 0.1
    actuation = None if torque is None else Actuation(J, lower=[-torque] * 2, upper=[torque] * 2)
    return ForceProblem(contacts, (0, 0, weight, 0, 0, 0), actuation)


def test_a_solvable_problem_has_its_margins_and_factors():
    """4 N need f_n = 4 N: the friction is used up, the normal forces are at 40 %, the torques of 0.4 N·m at 50 %."""
    answer = explain(pair(4.0, 0.8), (0, 0, 1.0, 0, 0, 0), joint_names=["index_2", "thumb_2"])
    assert answer.solution.status is Status.OPTIMAL
    uses = {(limit.name, limit.kind): limit for limit in answer.limits}
    friction = uses["contact 0", "friction"]
    assert (friction.used, friction.value, friction.margin) == pytest.approx((1.0, 0.5, 0.0), abs=1e-5)
    assert uses["contact 1", "normal force"].used == pytest.approx(0.4, abs=1e-6)
    assert uses["thumb_2", "torque"].used == pytest.approx(0.5, abs=1e-6)
    assert [limit.used for limit in answer.limits] == sorted((limit.used for limit in answer.limits), reverse=True)
    # at most 8 N of normal force: 2 N of friction remain, half the friction or half the torque suffices, 4 N more are lifted
    assert answer.slip_margin == pytest.approx(2.0, rel=1e-6)
    assert answer.friction_factor == pytest.approx(0.5, rel=1e-5)
    assert answer.torque_factor == pytest.approx(0.5, rel=1e-5)
    assert answer.wrench_fraction == pytest.approx(2.0, rel=1e-6)
    assert answer.payload.amount == pytest.approx(4.0, rel=1e-6)
    text = str(answer)
    assert "contact 0 uses 100 % of its friction" in text
    assert "slip margin of 2 N" in text
    assert "200 % of the wrench" in text


def test_an_unsolvable_problem_has_the_changes_that_help():
    """16 N need f_n = 16 N each: 1.6 times the friction at 10 N; 62.5 % of the wrench can be supplied."""
    answer = explain(pair(16.0))
    assert answer.solution.status is Status.INFEASIBLE
    assert answer.limits == ()
    assert answer.friction_factor == pytest.approx(1.6, rel=1e-5)
    assert answer.wrench_fraction == pytest.approx(0.625, rel=1e-6)
    assert answer.nearest_wrench == pytest.approx([0, 0, 10, 0, 0, 0], abs=1e-5)
    assert answer.slip_margin is None
    assert "16 is required and at most 10 can be supplied" in str(answer)
    assert "At most 62.5 % of the wrench" in str(answer)


def test_the_torque_factor_is_the_border_of_feasibility():
    for seed in range(8):
        problem = random_problem(np.random.default_rng(seed))
        answer = explain(problem)
        kappa = answer.torque_factor
        if kappa is None or not 1e-3 < kappa < 1e3:
            continue
        for factor, feasible in ((1.001 * kappa, True), (0.999 * kappa, False)):
            a = problem.actuation
            lower, upper = ([None if not np.isfinite(x) else factor * x for x in side] for side in (a.lower, a.upper))
            changed = Actuation(a.J, a.tau_u, lower, upper, a.weight)
            other = ForceProblem(problem.contacts, problem.w, changed, problem.cone, problem.objective)
            assert solve(other, explain=False).found == feasible


def test_everything_after_the_deadline_is_none():
    """The kernel stops after one iteration, which is no solution, and no other solver begins."""
    answer = explain(pair(4.0), (0, 0, 1.0, 0, 0, 0), seconds=0.0)
    assert answer.solution.status is Status.FAILED
    assert answer.solution.timed_out
    assert answer.limits == ()
    record = json.loads(json.dumps(answer.to_dict(), allow_nan=False))
    numbers = ("slip_margin", "friction_factor", "torque_factor", "wrench_fraction", "payload", "nearest_wrench")
    assert all(record[name] is None for name in numbers)
    assert record["solution"]["timed_out"] is True
    assert answer.sentences == ("The time was over before forces or a proof of infeasibility were found.",)


def test_a_proof_of_the_first_iteration_is_kept():
    """10 N can be held. What would make 16 N feasible takes more time."""
    answer = explain(pair(16.0), (0, 0, 1.0, 0, 0, 0), seconds=0.0)
    assert answer.solution.status is Status.INFEASIBLE
    assert answer.solution.certificate.verified
    assert answer.friction_factor is answer.wrench_fraction is answer.nearest_wrench is answer.payload is None


@pytest.mark.parametrize("weight", [4.0, 16.0])
@pytest.mark.parametrize("seconds", [1e-6, 5e-6])
def test_a_deadline_of_microseconds_gives_a_certified_answer_or_none(weight, seconds):
    """Whether the kernel ends in time depends on the machine; the other numbers need more."""
    answer = explain(pair(weight), (0, 0, 1.0, 0, 0, 0), seconds=seconds)
    solution = answer.solution
    assert solution.timed_out == (solution.status is Status.FAILED)
    assert answer.wrench_fraction is answer.payload is answer.slip_margin is answer.friction_factor is None


def test_a_deadline_interrupts_the_fallback_and_the_proof(monkeypatch):
    """The kernel's answer is refused; each program of the fallback then takes as long as it may, and proves nothing."""
    own, limits = clarabel.ClarabelBackend(), []

    def late(program, time_limit=None):
        limits.append(time_limit)
        end = time.perf_counter() + time_limit
        while time.perf_counter() < end:
            pass
        return dataclasses.replace(own.solve_program(program), converged=False)

    def refused(problem, settings, guess=None):
        limits.append(settings.time_limit)
        return own.solve(problem, SolverSettings(max_iterations=1))

    backend = SimpleNamespace(name=own.name, solve=refused, start_session=own.start_session, solve_program=late)
    monkeypatch.setattr("graspforce.force.backends.registry.general_backend", lambda: backend)
    kernel = SolverSettings(max_iterations=1)
    solution = solve(pair(4.0), settings=kernel, deadline=0.02)
    assert solution.status is Status.FAILED
    assert solution.timed_out
    assert len(limits) <= 2  # none of them, if the machine paused before
    assert all(0.0 < limit <= 0.02 for limit in limits)
    with pytest.raises(InvalidInput, match="deadline"):
        solve(pair(4.0), deadline=-1.0)


def test_a_solver_in_progress_stops_at_the_deadline(monkeypatch):
    """A program takes a second of a simulated clock, or its time limit: the number that it was for is None."""
    clock, limits = [0.0], []
    own = clarabel.ClarabelBackend()

    def slow(program, time_limit=None):
        result = own.solve_program(program)
        limits.append(time_limit)
        clock[0] += min(1.0, time_limit)
        return dataclasses.replace(result, converged=time_limit >= 1.0)

    backend = SimpleNamespace(name=own.name, solve=own.solve, start_session=own.start_session, solve_program=slow)
    monkeypatch.setattr("graspforce.force.backends.registry.general_backend", lambda: backend)
    for module in ("force.infeasibility", "analysis.explain"):
        monkeypatch.setattr(f"graspforce.{module}.time", SimpleNamespace(perf_counter=lambda: clock[0]))
    answer = explain(pair(4.0), (0, 0, 1.0, 0, 0, 0), seconds=1.5)
    assert answer.wrench_fraction == pytest.approx(10.0 / 4.0, rel=1e-6)
    assert answer.payload is None
    assert answer.friction_factor is answer.slip_margin is None
    assert limits == pytest.approx([1.5, 0.5])
    assert clock[0] == pytest.approx(1.5)


def test_rejects_wrong_names_and_a_direction_of_zero():
    with pytest.raises(InvalidInput, match="contact_names"):
        explain(pair(4.0), contact_names=["thumb"])
    with pytest.raises(InvalidInput, match="direction"):
        explain(pair(4.0), np.zeros(6))
    with pytest.raises(InvalidInput, match="seconds"):
        explain(pair(4.0), seconds=-1.0)


@pytest.mark.parametrize(("weight", "code"), [(4.0, 0), (16.0, 3)])
def test_the_command_prints_the_sentences(weight, code, tmp_path, capsys):
    file = tmp_path / "pair.json"
    file.write_text(json.dumps(pair(weight).to_dict()))
    assert main(["explain", str(file)]) == code
    assert "of the wrench can be supplied" in capsys.readouterr().out
    assert main(["explain", str(file), "--json"]) == code
    record = json.loads(capsys.readouterr().out)
    assert record["status"] == ("optimal" if code == 0 else "infeasible")
