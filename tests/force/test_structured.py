"""The structured kernel as a backend: supported problems, fallback, warm starts, and its certificate in C."""

from __future__ import annotations

import dataclasses
import shutil
import threading
import warnings

import numpy as np
import pytest
from support.random_problems import feasible_problem, random_problem

from graspforce import (
    Actuation,
    Cone,
    Contact,
    ForceProblem,
    InvalidInput,
    Objective,
    Solver,
    Status,
    available_backends,
    solve,
)
from graspforce.force.backends import compiled_kernel, registry, structured
from graspforce.force.backends.protocol import SolverSettings
from graspforce.force.certificate import certify, certify_infeasibility
from graspforce.force.scale import scale

KERNEL, SETTINGS = structured.KernelBackend(), SolverSettings()


def test_kernel_is_built_if_there_is_a_compiler():
    """Without this test, an extension that fails to compile would only make solutions slower."""
    if shutil.which("cc") or shutil.which("gcc") or shutil.which("clang"):
        assert compiled_kernel.is_available()
        assert available_backends()[0] == "structured"


@pytest.mark.parametrize("batch", range(10))
def test_kernel_solves_random_problems_and_agrees_with_clarabel(batch):
    """All contact models, exact cones and pyramids, feasible and infeasible; Clarabel at 1e-10 is the reference."""
    rng, own, asked = np.random.default_rng([31, batch]), 0, 0
    for _ in range(50):
        problem = random_problem(rng)
        if problem.objective.type in ("max_normal", "margin"):
            continue
        asked += 1
        answer, other = solve(problem, explain=False), solve(problem, "clarabel", explain=False)
        own += answer.backend == "structured"
        assert answer.status is other.status
        if answer.found:
            assert answer.objective == pytest.approx(other.objective, rel=2e-8, abs=2e-8 * scale(problem).cost)
    assert asked >= 20
    assert own >= 0.98 * asked


@pytest.mark.parametrize("seed", range(40))
def test_certificate_in_c_equals_the_certificate_in_python(seed):
    """Residuals agree to rounding at the solution and far from it; the two share no code."""
    problem = feasible_problem(
        seed, count=2 + seed % 6, models=(("point",), ("soft",), ("frictionless", "point", "soft"))[seed % 3]
    )
    answer = KERNEL.solve(problem, SolverSettings())
    arrays = compiled_kernel.kernel_arrays(problem)
    kernel = compiled_kernel.Kernel(**arrays)
    kernel.solve(0, 1, 1e-9, 60, False)
    assert np.array_equal(arrays["f"][0], answer.f)  # with dense J, and with J stored within the fingers
    for spoil in (0.0, 1e-6, 1e-2, 1.0):
        arrays["f"][0] = answer.f * (1 + spoil)
        kernel.certify(0, 1)
        residuals = [arrays["report"][name][0] for name in ("certified_primal", "certified_dual", "certified_gap")]
        here = certify(problem, answer.f * (1 + spoil), answer.multipliers)
        # Relative to the problem's scale, rounding in sums of some tens of products stays below 1e-13.
        assert residuals == pytest.approx([here.primal_residual, here.dual_residual, here.gap], rel=1e-9, abs=1e-12)
        if spoil == 0.0:  # the incremental kernel stores J within the fingers only
            own = answer.certificate
            seen = [own.primal_residual, own.dual_residual, own.gap]
            assert seen == pytest.approx(residuals, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("kind", ["max_normal", "margin"])
@pytest.mark.parametrize("seed", range(12))
def test_kernel_solves_objectives_with_a_shared_level(kind, seed):
    """Point and soft contacts, exact cones and pyramids, with and without motors; Clarabel is the reference."""
    rng = np.random.default_rng([71, seed])
    problem = feasible_problem(seed, count=3 + seed % 6, models=("frictionless", "point", "soft"))
    cone = Cone("pyramid", 6, str(rng.choice(["inner", "outer"]))) if seed % 3 == 0 else Cone()
    actuation = None if seed % 4 == 3 and kind == "max_normal" else problem.actuation
    problem = ForceProblem(problem.contacts, problem.w, actuation, cone, Objective(kind))
    answer, other = KERNEL.solve(problem, SolverSettings()), solve(problem, "clarabel")
    assert answer.status is Status.OPTIMAL
    assert answer.multipliers is not None
    assert certify(problem, answer.f, answer.multipliers).is_tight
    assert problem.cost(answer.f) == pytest.approx(other.objective, rel=2e-8, abs=2e-8 * scale(problem).cost)
    assert solve(problem).backend == "structured"
    overload = problem.replace(w=1e3 * problem.w)
    assert solve(overload, explain=False).status is solve(overload, "clarabel", explain=False).status


def test_negative_margin_proves_infeasibility():
    """Loads just beyond the largest one: no forces keep the margin 0, and the multipliers of the largest margin prove it."""
    proven = 0
    for seed in range(6):
        problem = dataclasses.replace(feasible_problem(seed), objective=Objective("margin"))
        low, high = 1.0, 1e3  # a feasible and an infeasible load
        while high / low > 1.0 + 1e-4:
            load = (low * high) ** 0.5
            low, high = (load, high) if KERNEL.solve(problem.replace(w=load * problem.w), SETTINGS).found else (low, load)
        beyond = KERNEL.solve(problem.replace(w=1.0001 * high * problem.w), SETTINGS)
        assert beyond.status is Status.INFEASIBLE
        assert beyond.multipliers is not None
        proven += certify_infeasibility(beyond.original_problem, beyond.multipliers).certificate.verified
    assert proven == 6


@pytest.mark.parametrize("objective", [Objective("force", moment_length=0.02), Objective("torque", 1e-3, 0.05)])
def test_kernel_weighs_moments_by_their_length(objective):
    problem = dataclasses.replace(feasible_problem(5, models=("soft",)), objective=objective)
    answer = solve(problem)
    assert answer.backend == "structured"
    assert answer.certificate.is_tight
    assert answer.objective == pytest.approx(solve(problem, "clarabel").objective, rel=2e-8)


def wrist(count: int) -> ForceProblem:
    """Return a problem of fingers with two joints each and one common wrist joint."""
    problem = feasible_problem(3, count=count)
    rng = np.random.default_rng(count)
    J = np.column_stack([problem.actuation.J[:, [j for j in range(3 * count) if j % 3]], 0.03 * rng.normal(size=problem.size)])
    f = solve(ForceProblem(problem.contacts, problem.w)).f
    room = np.abs(J.T @ f) + 0.05
    return ForceProblem(problem.contacts, problem.w, Actuation(J, lower=-room, upper=room))


@pytest.mark.parametrize("count", [4, 20])
def test_shared_joints_make_one_block_of_their_fingers(count):
    answer = solve(wrist(count))
    assert answer.backend == "structured"
    assert answer.objective == pytest.approx(solve(wrist(count), "clarabel").objective, rel=2e-8)


def test_changed_values_start_warm_and_agree_with_new_solutions():
    problem, rng = feasible_problem(5), np.random.default_rng(5)
    solver = Solver(problem)
    cold = solver.solve().iterations
    steps = []
    for _ in range(30):
        w = problem.w * (1 + 0.005 * rng.uniform(-1, 1, 6))
        J = problem.actuation.J * (1 + 0.005 * rng.uniform(-1, 1, problem.actuation.J.shape))
        answer = solver.solve(w=w, J=J, tau_u=problem.actuation.tau_u * 1.001, mu=problem.contacts.mu * 0.999)
        fresh = solve(problem.replace(w=w, J=J, tau_u=problem.actuation.tau_u * 1.001, mu=problem.contacts.mu * 0.999))
        assert (answer.backend, answer.status) == ("structured", fresh.status)
        assert answer.objective == pytest.approx(fresh.objective, rel=2e-8)
        steps.append(answer.iterations)
    assert np.median(steps) < cold


def test_joint_that_becomes_loaded_joins_its_finger():
    """At first no force loads the last joint of the last finger; later it belongs to that finger's block."""
    problem = feasible_problem(6)
    J = problem.actuation.J.copy()
    J[:, -1] = 0.0
    solver = Solver(problem.replace(J=J))
    solver.solve()
    for _ in range(2):
        answer = solver.solve(J=problem.actuation.J)
        assert answer.objective == pytest.approx(solve(problem, "clarabel").objective, rel=2e-8)
    assert answer.backend == "structured"


def test_solver_recovers_after_an_infeasible_problem():
    problem = feasible_problem(7)
    solver = Solver(problem, explain=False)
    good = solver.solve().objective
    assert solver.solve(w=problem.w * 1e4).status is Status.INFEASIBLE
    assert solver.solve(w=problem.w).objective == pytest.approx(good, rel=2e-8)


def test_earlier_solutions_stay_unchanged():
    problem = feasible_problem(8)
    solver = Solver(problem)
    first = solver.solve()
    before = first.f.copy()
    solver.solve(w=problem.w * 1.1)
    assert np.array_equal(first.f, before)
    assert first.torques == pytest.approx(problem.torques(before), rel=1e-12)
    with pytest.raises(ValueError, match="read-only"):
        first.f[0] = 1.0


def test_solvers_in_threads_are_independent():
    found: dict[int, list[float]] = {}

    def work(seed: int) -> None:
        solver = Solver(feasible_problem(seed))
        found[seed] = [solver.solve(w=feasible_problem(seed).w * (1 + 0.001 * i)).objective for i in range(50)]

    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(40, 44)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for seed, objectives in found.items():
        alone = [
            solve(feasible_problem(seed).replace(w=feasible_problem(seed).w * (1 + 0.001 * i))).objective for i in (0, 25, 49)
        ]
        assert [objectives[i] for i in (0, 25, 49)] == pytest.approx(alone, rel=2e-8)


def test_missing_kernel_warns_once_and_clarabel_solves(monkeypatch):
    say_once = registry._warn_unavailable
    say_once.cache_clear()
    monkeypatch.setattr(compiled_kernel, "Kernel", None)
    assert "structured" not in available_backends()
    with pytest.warns(RuntimeWarning, match="without a C compiler"):
        assert solve(feasible_problem(9)).backend == "clarabel"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert solve(feasible_problem(9)).backend == "clarabel"
    say_once.cache_clear()


def test_kernel_proves_infeasibility():
    own = 0
    for seed in range(40):
        problem = feasible_problem(100 + seed)
        problem = problem.replace(w=problem.w * 50)
        answer = KERNEL.solve(problem, SolverSettings())
        if answer.status is Status.INFEASIBLE:
            own += 1
            assert certify_infeasibility(problem, answer.multipliers).certificate.verified
            assert solve(problem, "clarabel", explain=False).status is Status.INFEASIBLE
    assert own >= 30


def test_pyramids_are_certified_in_python():
    problem = feasible_problem(11)
    problem = ForceProblem(problem.contacts, problem.w, problem.actuation, Cone("pyramid", 8, "inner"))
    assert KERNEL.solve(problem, SolverSettings()).certificate is None
    answer = solve(problem)
    assert answer.backend == "structured"
    assert answer.certificate.verified


def test_single_contact_carries_force_along_its_normal():
    """Within friction, the force of one contact is determined by the wrench."""
    answer = solve(ForceProblem([Contact([0, 0, 0], [0, 0, 1], 0.5)], [0.1, 0, 1, 0, 0, 0]))
    assert answer.f == pytest.approx([0.0, 0.1, 1.0], abs=1e-9) or answer.f == pytest.approx([0.0, -0.1, 1.0], abs=1e-9)
    with pytest.raises(InvalidInput):
        ForceProblem([], np.zeros(6))


@pytest.mark.parametrize("side", ["inner", "outer"])
@pytest.mark.parametrize("facets", [3, 8])
def test_kernel_proves_infeasibility_of_pyramids(side, facets):
    """Loads far and just beyond the largest one: the kernel returns a proof that holds for the pyramids, not only a failure."""
    proven = 0
    for seed in range(8):
        cone = Cone("pyramid", facets, side)
        problem = dataclasses.replace(feasible_problem(seed), objective=Objective("force"), cone=cone)
        for load in (3.0, 10.0, 30.0):
            overloaded = problem.replace(w=load * problem.w)
            if solve(overloaded, "clarabel", explain=False).status is not Status.INFEASIBLE:
                continue
            answer = KERNEL.solve(overloaded, SolverSettings())
            assert answer.status is Status.INFEASIBLE
            assert answer.multipliers is not None
            assert certify_infeasibility(overloaded, answer.multipliers).certificate.verified
            proven += 1
    assert proven >= 8
