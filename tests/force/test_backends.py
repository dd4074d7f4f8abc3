"""Laws of all backends, of their registry and settings, and of sessions."""

from __future__ import annotations

import copy
import dataclasses
import pickle
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from support.random_problems import feasible_problem, inner_forces, random_contacts, random_problem

import graspforce as gf
from graspforce.contact.matrices import grasp_matrix
from graspforce.core.errors import BackendError, InvalidInput, UnknownName, UnsupportedProblem
from graspforce.force import solver
from graspforce.force.backends import registry
from graspforce.force.backends.protocol import SimpleSession, SolverSettings
from graspforce.force.multipliers import Multipliers
from graspforce.force.scale import scale
from graspforce.force.solution import LazySolution, Solution

NAMES = gf.available_backends()


def pyramid_problem(seed: int) -> gf.ForceProblem:
    """Return a feasible problem with pyramids, which every backend supports."""
    problem = feasible_problem(seed)
    return gf.ForceProblem(problem.contacts, problem.w, problem.actuation, gf.Cone("pyramid", 8, "inner"))


@pytest.mark.parametrize("name", NAMES)
def test_every_backend_solves_alone_and_in_a_session(name):
    backend, problem = registry.find_backend(name), pyramid_problem(1)
    reference = gf.solve(problem).objective
    session = backend.start_session(problem, SolverSettings())
    for solution in (backend.solve(problem, SolverSettings()), session.solve(), session.solve(w=problem.w)):
        assert solution.backend == backend.name == name
        assert solution.problem.cost(solution.f) == pytest.approx(reference, rel=1e-5)
    changed = session.solve(w=1.01 * problem.w)
    assert np.array_equal(session.problem.w, 1.01 * problem.w)
    assert np.array_equal(changed.problem.w, 1.01 * problem.w)
    with pytest.raises(InvalidInput, match="wrench"):
        session.solve(w=[1.0, 2.0])
    assert np.array_equal(session.problem.w, 1.01 * problem.w)


def test_solver_module_names_no_backend():
    source = Path(solver.__file__).read_text()
    assert [name for name in NAMES if re.search(rf"\b{name}\b", source, flags=re.I)] == []


class EchoBackend:
    """A backend that returns the kernel's forces under another name, and supports only ``supported`` problems."""

    name, unavailable_reason, supported = "echo", "", True

    def __init__(self):
        self.settings, self.sessions = [], 0

    def solve(self, problem, settings, guess=None):
        if not self.supported:
            raise UnsupportedProblem("echo supports nothing")
        self.settings.append(settings)
        kernel = registry.find_backend("structured").solve(problem, settings)
        return dataclasses.replace(kernel, backend="echo", certificate=None) if kernel.found else kernel

    def start_session(self, problem, settings):
        self.sessions += 1
        return SimpleSession(problem, lambda changed: self.solve(changed, settings))


@pytest.fixture
def echo(monkeypatch):
    """Register a backend as a user would: one module, one line."""
    backend, module = EchoBackend(), ModuleType("graspforce.force.backends.echo")
    module.BACKENDS = (backend,)
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setattr(registry, "_MODULES", (*registry._MODULES, "echo"))
    yield backend
    registry._load.cache_clear()


def test_backend_needs_one_module_and_one_line(echo):
    problem, settings = feasible_problem(2), SolverSettings(tolerance=1e-9, max_iterations=50)
    assert gf.available_backends()[-1] == "echo"
    assert gf.solve(problem, "echo", settings=settings).backend == "echo"
    repeated = gf.Solver(problem, "echo", settings=settings)
    for factor in (1.0, 1.01):
        solution = repeated.solve(w=factor * problem.w)
        assert (solution.backend, solution.status) == ("echo", gf.Status.OPTIMAL)
    assert echo.settings == [settings] * 3
    assert echo.sessions == 1


def test_general_backend_solves_problems_that_the_preferred_one_does_not_support(echo, monkeypatch):
    monkeypatch.setattr(registry, "_PREFERRED", "echo")
    problem = feasible_problem(3)
    assert gf.solve(problem).backend == gf.Solver(problem).solve().backend == "echo"
    repeated = gf.Solver(problem)
    assert repeated.solve().backend == "echo"
    monkeypatch.setattr(EchoBackend, "supported", False)
    assert gf.solve(problem).backend == repeated.solve(w=1.01 * problem.w).backend == "clarabel"
    assert np.array_equal(repeated.problem.w, 1.01 * problem.w)
    with pytest.raises(UnsupportedProblem, match="echo supports nothing"):
        gf.solve(problem, "echo")


def test_unavailable_backends_are_unknown(echo, monkeypatch):
    monkeypatch.setattr(EchoBackend, "unavailable_reason", "echo is not installed")
    assert "echo" not in gf.available_backends()
    with pytest.raises(UnknownName, match="must be one of structured"):
        gf.solve(feasible_problem(4), "echo")


# ── settings ──────────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize(("name", "largest"), [("structured", 2), ("clarabel", 2), ("proxqp", 6), ("osqp", 2)])
def test_iteration_limit_is_kept(name, largest):
    """ProxQP limits its outer iterations and counts the inner ones too."""
    settings = SolverSettings(max_iterations=2)
    assert registry.find_backend(name).solve(pyramid_problem(5), settings).iterations <= largest


@pytest.mark.parametrize("name", ["structured", "clarabel", "proxqp", "scs"])
def test_looser_tolerance_needs_fewer_iterations(name):
    backend, problem = registry.find_backend(name), pyramid_problem(6)
    tight, loose = (backend.solve(problem, SolverSettings(tolerance=tolerance)) for tolerance in (1e-9, 1e-3))
    assert loose.iterations < tight.iterations


def test_settings_never_change_what_counts_as_optimal():
    """With a loose tolerance the certificate fails, and the fallback solves the problem again."""
    problem = feasible_problem(7)
    for settings in (SolverSettings(tolerance=1e-1), SolverSettings(max_iterations=1)):
        solution = gf.solve(problem, settings=settings)
        assert solution.status is gf.Status.OPTIMAL
        assert max(solution.certificate.primal_residual, solution.certificate.gap) <= 1e-8
        assert solution.objective == pytest.approx(gf.solve(problem).objective, rel=2e-8)
        assert gf.Solver(problem, settings=settings).solve().objective == pytest.approx(solution.objective, rel=2e-8)


@pytest.mark.parametrize("values", [{"tolerance": 0.0}, {"max_iterations": 0}, {"time_limit": -1.0}, {"tolerance": np.nan}])
def test_invalid_settings_name_their_field(values):
    with pytest.raises(InvalidInput, match=next(iter(values))):
        SolverSettings(**values)


def test_negative_time_for_the_explanation_is_refused():
    with pytest.raises(InvalidInput, match="explain_seconds = -1"):
        gf.solve(feasible_problem(8), explain_seconds=-1)


def test_guess_saves_iterations_of_proxqp_and_changes_no_solution():
    """Summed over problems: a single one can be unlucky."""
    cold = warm = 0
    for seed in range(10):
        problem = pyramid_problem(seed)
        near = problem.replace(w=1.001 * problem.w)
        guess, alone = gf.solve(problem, "proxqp"), gf.solve(near, "proxqp")
        guessed = gf.solve(near, "proxqp", guess=guess)
        assert guessed.objective == pytest.approx(alone.objective, rel=2e-8)
        assert gf.solve(near, guess=guess).objective == pytest.approx(alone.objective, rel=2e-8)
        cold, warm = cold + alone.iterations, warm + guessed.iterations
    assert warm < cold


# ── agreement and refusals ────────────────────────────────────────────────────────────────────────────────────────────────


def opposed_pair() -> list[gf.Contact]:
    """Return two opposed contacts 4 m apart on the y axis."""
    return [gf.Contact([0, -2, 0], [0, 1, 0], 0.1), gf.Contact([0, 2, 0], [0, -1, 0], 0.1)]


def test_named_backends_agree_with_clarabel():
    rng = np.random.default_rng(11)
    contacts = gf.ContactSet.stack(random_contacts(rng, 4, ("point",)))
    w = grasp_matrix(contacts) @ inner_forces(rng, contacts, 0.6)
    problem = gf.ForceProblem(contacts, w, cone=gf.Cone("pyramid", 8, "inner"))
    reference = gf.solve(problem, "clarabel")
    for name in ("proxqp", "quadprog"):
        answer = gf.solve(problem, name)
        assert (answer.backend, answer.status) == (name, gf.Status.OPTIMAL)
        assert answer.objective == pytest.approx(reference.objective, rel=2e-8)


def test_fallback_solves_problems_whose_certificate_fails():
    """With lever arms below 0.05 m the cost is flat in most directions, and ProxQP stops far from the optimum."""
    solved_by_fallback = 0
    for seed in range(12):
        problem = random_problem(np.random.default_rng([7, seed]))
        problem = gf.ForceProblem(
            problem.contacts, problem.w, problem.actuation, gf.Cone("pyramid", 6, "inner"), problem.objective
        )
        answer, reference = gf.solve(problem, "proxqp", explain=False), gf.solve(problem, "clarabel", explain=False)
        assert answer.status is reference.status
        solved_by_fallback += answer.backend == "clarabel"
        if answer.found:
            assert answer.objective == pytest.approx(reference.objective, rel=2e-8, abs=2e-8 * scale(problem).cost)
    assert solved_by_fallback >= 1


def test_every_available_backend_returns_the_optimum():
    problem = gf.ForceProblem(opposed_pair(), [0, 0, 10, 0, 0, 0], cone=gf.Cone("pyramid", 8, "inner"))
    for name in gf.available_backends():
        assert gf.solve(problem, name).objective == pytest.approx(gf.solve(problem).objective, rel=2e-8)


# Friction coefficients from 1e-8 to 1e12: HiGHS does not terminate.
UNENDING = """
from graspforce import Cone, Contact, ForceProblem, solve

contacts = [
    Contact([0.0441, -0.00422, -0.0232], [-0.882, 0.0845, 0.464], 8.75e5, "soft", torsional_friction=4.86e4),
    Contact([0.0252, -0.0375, 0.0213], [-0.505, 0.751, -0.426], 2.55e-8, "soft", torsional_friction=0.005, min_normal=0.00709),
    Contact([0.0441, 0.0229, 0.0056], [-0.882, -0.458, -0.112], 5.2e11),
]
problem = ForceProblem(contacts, [-0.603, -0.132, 0.0112, 0, 0, 0], cone=Cone("pyramid", 3, "inner"))
print(solve(problem, "highs").status.value)
"""


def test_solver_that_does_not_terminate_is_stopped():
    """The solver runs in a process of its own, which the test can end."""
    said = subprocess.run([sys.executable, "-c", UNENDING], capture_output=True, text=True, check=True, timeout=60)
    assert said.stdout.split()[-1] in [status.value for status in gf.Status]


def test_backends_for_pyramids_reject_exact_cones():
    for name in ("proxqp", "quadprog"):
        with pytest.raises(BackendError, match="supports pyramids"):
            gf.solve(gf.ForceProblem(opposed_pair(), [0, 0, 10, 0, 0, 0]), name)


def test_unknown_backend_lists_the_available_ones():
    problem = gf.ForceProblem(opposed_pair(), [0, 0, 10, 0, 0, 0])
    with pytest.raises(UnknownName, match=r"backend = 'gurobbi': must be one of structured, clarabel, proxqp") as caught:
        gf.solve(problem, "gurobbi")
    with pytest.raises(UnknownName, match="gurobbi"):
        gf.Solver(problem, "gurobbi")
    assert caught.value.field == "backend"


@pytest.mark.parametrize("backend", ["clarabel", "proxqp"])
def test_solver_keeps_values_that_do_not_change(backend):
    problem = gf.ForceProblem(opposed_pair(), [0, 0, 10, 0, 0, 0], cone=gf.Cone("pyramid", 8, "inner"))
    solver = gf.Solver(problem, backend)
    assert solver.solve().objective == pytest.approx(gf.solve(problem).objective, rel=2e-8)
    for load in np.linspace(10, 11, 5):
        answer = solver.solve(w=[0, 0, load, 0, 0, 0])
        fresh = gf.solve(problem.replace(w=[0, 0, load, 0, 0, 0]))
        assert (answer.backend, answer.objective) == (backend, pytest.approx(fresh.objective, rel=2e-8))
    rough = solver.solve(mu=[0.2, 0.2])
    assert rough.objective == pytest.approx(gf.solve(problem.replace(w=[0, 0, 11, 0, 0, 0], mu=[0.2, 0.2])).objective, rel=2e-8)


def test_warm_start_saves_iterations_of_proxqp():
    problem = gf.ForceProblem(opposed_pair(), [0, 0, 10, 0, 0, 0], cone=gf.Cone("pyramid", 8, "inner"))
    solver = gf.Solver(problem, "proxqp")
    first = solver.solve()
    assert solver.solve().iterations < first.iterations


# ── solutions without backend state ───────────────────────────────────────────────────────────────────────────────────────


def test_solution_has_no_state_of_its_backend():
    names = {field.name for field in dataclasses.fields(Solution)}
    assert names == {
        "status", "problem", "f", "certificate", "infeasibility", "backend", "iterations", "seconds", "multipliers",
        "cost_bound", "timed_out",
    }  # fmt: skip
    solution = gf.Solver(feasible_problem(9)).solve()
    assert type(solution) is LazySolution
    for other in (pickle.loads(pickle.dumps(solution)), copy.copy(solution)):
        assert type(other) is Solution
        assert np.array_equal(other.f, solution.f)
        assert np.array_equal(other.torques, solution.problem.torques(solution.f))
        assert other.certificate == solution.certificate
        assert other.to_dict()["forces"] == solution.to_dict()["forces"]


def test_lazy_fields_are_those_of_the_eager_solution():
    """The kernel's own numbers against those that follow from f."""
    for seed in range(10):
        problem = feasible_problem(seed, models=("frictionless", "point", "soft"))
        lazy = gf.solve(problem)
        eager = pickle.loads(pickle.dumps(lazy))
        assert lazy.torques == pytest.approx(eager.torques, rel=1e-12, abs=1e-14)
        assert lazy.problem is problem
        assert gf.Certificate.from_dict(lazy.certificate.to_dict()) == lazy.certificate


def test_multipliers_are_about_the_centroid_and_written_about_the_origin():
    problem = feasible_problem(10)
    shift, w = np.array([1.0, -2.0, 3.0]), problem.w.copy()  # m
    w[3:] += np.cross(shift, w[:3])
    far = problem.replace(p=problem.contacts.p_OC + shift, w=w)
    for backend in ("structured", "clarabel"):
        m = gf.solve(far, backend).multipliers
        assert np.array_equal(m.point, far.contacts.centroid)
        about_O = m.about(np.zeros(3))
        assert about_O.y @ far.G == pytest.approx(m.y @ far.G_centred, rel=1e-9, abs=1e-9)
        assert about_O.about(m.point).y == pytest.approx(m.y, rel=1e-12, abs=1e-12)
        assert m.to_dict()["y"] == about_O.y.tolist()
        again = Multipliers.from_dict(m.to_dict())
        assert np.array_equal(again.point, np.zeros(3))
        assert np.array_equal(again.normal_lower, m.normal_lower)
