"""The short-step path of the kernel: the laws of its bound along the path, its number of steps, and certified answers."""

from __future__ import annotations

import json
import math
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from support.c_controllers import COMPILER, SOURCES
from support.random_problems import random_problem

import graspforce as gf
from benchmarks import iterations
from graspforce.core.errors import InvalidInput
from graspforce.force.backends.compiled_kernel import is_available
from graspforce.force.backends.protocol import SolverSettings
from graspforce.force.backends.structured import KernelBackend, KernelSession
from graspforce.force.certificate import certify, certify_infeasibility

ROOT = Path(__file__).parents[2]
BETA = 0.37  # largest distance from the central path
KINDS = 5  # of problems in benchmarks/random_problem.inc; the last one is overloaded

needs_kernel = pytest.mark.skipif(not is_available(), reason="the kernel was not built")


def bound(degree: int, reduction: float) -> int:
    """Return ⌈ln θ / ln σ⌉ for N = `degree` and θ = `reduction`, from the equation of docs/concepts/iteration_bound.md."""
    root, k = math.sqrt(2.0 * degree), 2.0 * math.sqrt(2.0) * BETA * (1.0 - BETA)
    delta = max(np.roots([1.0, k / root, BETA**2 - k]))
    return math.ceil(math.log(reduction) / math.log(1.0 - delta / root))


@pytest.fixture(scope="module")
def laws(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if COMPILER is None:
        pytest.skip("needs a C compiler")
    source = Path(__file__).with_name("short_step_laws.c")
    program = tmp_path_factory.mktemp("laws") / "laws"
    flags = ["-std=gnu11", "-O0", "-DGF_LANES=1", "-Wno-psabi", f"-I{SOURCES}", f"-I{SOURCES / 'include'}"]
    subprocess.run([COMPILER, *flags, str(source), "-lm", "-o", str(program)], check=True, timeout=300)
    return program


@pytest.mark.parametrize(("contacts", "joints"), [(3, 3), (4, 3), (4, 0), (5, 4)])
def test_path_obeys_the_laws_of_the_bound(laws: Path, contacts: int, joints: int) -> None:
    """Tolerances are the accuracy to which steps are refined, 1e-12 of the data, times the condition of hard problems."""
    sizes = [str(contacts), str(joints), "20"]
    lines = subprocess.run([str(laws), *sizes], check=True, capture_output=True, text=True).stdout.splitlines()
    assert len(lines) == KINDS
    for kind, line in enumerate(lines):
        optimal, infeasible, left, steps = map(int, line.split()[:4])
        mu, residual, distance, size, share, product = map(float, line.split()[4:])
        assert (optimal, infeasible) == (0, 20) if kind == KINDS - 1 else optimal + infeasible == 20
        assert left == 0  # full steps stay in the interior
        assert steps <= bound(1 + contacts * (3 + 2 * joints), 1e-24)
        assert mu <= 1e-4  # relative difference from σ times the last one
        assert residual <= 1e-6  # likewise
        assert distance <= BETA
        assert size <= 1e-2  # eᵀ(s + z) + τ + κ + xᵀHx/τ = (1 + μ) N
        assert share <= 1.0  # τ ≥ (1 − β)/T, or κ ≥ (1 − β)/T without an optimum
        assert product <= 1.0  # κ ≤ μ T, or τ ≤ μ T


@needs_kernel
@pytest.mark.parametrize("reduction", [1e-24, 1e-12, 0.5, 1.0])
def test_bound_equals_its_formula(reduction: float) -> None:
    problem = gf.problems.load("trajectory/carry-1-000").problem
    session = KernelSession(problem, SolverSettings())
    assert problem.actuation is not None
    degree = 1 + 3 * len(problem.contacts) + 2 * problem.actuation.J.shape[1]
    assert session.short_step_bound(reduction) == (bound(degree, reduction) if reduction < 1.0 else 0)


def test_documented_bounds_equal_the_formula() -> None:
    text = (ROOT / "docs" / "concepts" / "iteration_bound.md").read_text()
    rows = re.findall(r"^\| (\d+) \| (\d+) \| (\d+) \| [\d.]+ \| (\d+) \| (\d+) \|$", text, re.MULTILINE)
    assert len(rows) == 6
    for row in rows:
        contacts, joints, degree, half, whole = map(int, row)
        assert degree == 1 + contacts * (3 + 2 * joints)
        assert (half, whole) == (bound(degree, 1e-12), bound(degree, 1e-24))


@needs_kernel
def test_short_steps_alone_find_certified_answers() -> None:
    """Random problems with all contact models, cones and objectives; the second solver decides which verdict is right."""
    rng, verdicts = np.random.default_rng(3), []
    for _ in range(40):
        problem = random_problem(rng)
        session = KernelSession(problem, SolverSettings(max_iterations=1, short_steps=10_000))
        solution, expected = session.solve(), gf.solve(problem, explain=False)
        assert solution.multipliers is not None
        assert solution.iterations <= 1 + session.short_step_bound(1e-24)
        verdicts.append(solution.status)
        assert solution.status is expected.status
        if solution.status is gf.Status.INFEASIBLE:
            assert certify_infeasibility(problem, solution.multipliers).certificate.verified
        else:
            assert certify(problem, solution.f, solution.multipliers).is_tight
    assert {gf.Status.OPTIMAL, gf.Status.INFEASIBLE} == set(verdicts)


@needs_kernel
@pytest.mark.parametrize("name", [name for name in gf.problems.names("soft") if "sum-normal" in name])
def test_kernel_alone_certifies_soft_contacts_with_least_normal_forces(name: str) -> None:
    """Without fused multiply-add, the first path ends three of these inaccurate; short steps follow."""
    problem = gf.problems.load(name).problem
    solution = KernelBackend().solve(problem, SolverSettings())
    assert solution.multipliers is not None
    if solution.status is gf.Status.INFEASIBLE:
        assert certify_infeasibility(problem, solution.multipliers).certificate.verified
    else:
        assert certify(problem, solution.f, solution.multipliers).is_tight


@needs_kernel
@pytest.mark.parametrize(("contacts", "joints"), iterations.SIZES)
def test_short_steps_solve_the_failures_of_the_first_path(contacts: int, joints: int) -> None:
    """They are those of some 10⁷ solves, with limits within 1e-6 of feasible forces."""
    records = [json.loads(line) for line in iterations.RECORDS.read_text().splitlines()]
    own = [record for record in records if record["task"][:2] == [contacts, joints]]
    failed = [one for record in own for one in iterations.recorded_failures(record["task"], record)]
    assert len(failed) == sum(len(record["failed"]) for record in own) > 0
    for problem in failed:
        session = KernelSession(problem, SolverSettings())
        solution = session.solve()
        assert iterations.is_certified(problem, solution)
        assert solution.iterations <= 60 + session.short_step_bound(1e-24)


@needs_kernel
def test_short_steps_follow_only_where_they_are_allowed() -> None:
    problem = gf.problems.load("trajectory/carry-1-000").problem
    limited = KernelBackend().solve(problem, SolverSettings(max_iterations=1))
    assert (limited.iterations, limited.found) == (1, False)
    few = KernelBackend().solve(problem, SolverSettings(max_iterations=1, short_steps=5))
    assert (few.iterations, few.found) == (6, False)
    normal = KernelBackend().solve(problem, SolverSettings())
    assert normal.iterations == KernelBackend().solve(problem, SolverSettings(short_steps=0)).iterations < 20


@pytest.mark.parametrize("steps", [-1, 10**6 + 1, 1.5])
def test_settings_reject_other_numbers_of_steps(steps: float) -> None:
    with pytest.raises(InvalidInput, match="short_steps"):
        SolverSettings(short_steps=steps)  # type: ignore[arg-type]


@needs_kernel
def test_kernel_rejects_invalid_numbers() -> None:
    kernel = KernelSession(gf.problems.load("trajectory/carry-1-000").problem, SolverSettings())._kernel
    for steps in (-1, 10**6 + 1):
        with pytest.raises(ValueError, match="must be from 0 to 1000000"):
            kernel.limit_short_steps(steps)
    for reduction in (0.0, -1.0, 2.0, math.nan):
        with pytest.raises(ValueError, match="must be above 0 and at most 1"):
            kernel.short_step_bound(reduction)
