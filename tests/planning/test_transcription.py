"""Minimum-time programs: derivatives, order of convergence, and problems with known durations, with both solvers."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest

from graspforce.core.arrays import Array
from graspforce.planning.nlp import cayley
from graspforce.planning.nlp.equations import Equations, make_equations
from graspforce.planning.nlp.iteration import OptimiserIteration
from graspforce.planning.nlp.layout import KnotEquations, KnotLayout, Program, ProgramStructure
from graspforce.planning.nlp.optimisers import FATROP, IPOPT, OptimiserResult, optimise
from graspforce.planning.nlp.transcription import transcribe

SOLVERS = [IPOPT, FATROP]
JOINTS = [  # I, mgl, U, θ₀, θ₁ and T in s: an arm with one joint in gravity
    (1.0, 1.0, 2.0, 0.0, 1.0, 1.3296929500),
    (1.0, 0.5, 1.0, -0.5, 1.5, 2.4893388243),
    (1e-3, 0.02, 0.05, 0.0, 1.2, 0.2928735884),
]


def second_order(name: str, start: Array, goal: Array, limit: float, law: Callable[[ca.SX, ca.SX, ca.SX], ca.SX]):
    """Return a function that makes the program |law(y, v, a)| ≤ limit from rest to rest, and a guess."""
    n = len(start)
    y, v, a = (ca.SX.sym(letter, n) for letter in "yva")
    g = law(y, v, a)
    equations = make_equations(name, ca.vertcat(y, v, a), ca.SX.sym("none", 0), g)
    bound = np.full(g.numel(), limit)

    def program(intervals: int, T: float) -> tuple[Program, Array]:
        layout = KnotLayout(n, 0)
        variables = tuple(int(i) for kind in "yva" for i in layout.part(kind))
        ends = tuple(range(2 * n))
        structure = ProgramStructure(
            layout, intervals, (KnotEquations(equations, variables, (False,) * len(bound)),), ends, ends
        )
        lower, upper = np.full(layout.size, -np.inf), np.full(layout.size, np.inf)
        lower[layout.duration] = 1e-3 * T
        x = np.zeros((intervals + 1, layout.size))
        u = np.linspace(0.0, 1.0, intervals + 1)[:, None]
        x[:, layout.part("y")] = start + (goal - start) * u**3 * (10 - 15 * u + 6 * u**2)
        x[:, layout.duration] = T
        rest, none = np.zeros(n), np.zeros(0)
        ends_at = np.concatenate([start, rest]), np.concatenate([goal, rest])
        return Program(structure, (none,), ((-bound, bound),), lower, upper, *ends_at, np.zeros(layout.size), 0.0), x

    return program


def robot_arm():
    """Return the robot arm of COPS 3.0, L = 5, whose best known time is 9.1409. Source: Dolan, Moré and Munson (2004)."""

    def law(y: ca.SX, _: ca.SX, a: ca.SX) -> ca.SX:
        inertia = ((5.0 - y[0]) ** 3 + y[0] ** 3) / 3.0
        return ca.vertcat(5.0 * a[0], inertia * ca.sin(y[2]) ** 2 * a[1], inertia * a[2])

    start = np.array([4.5, 0.0, np.pi / 4])
    return second_order("robot_arm", start, np.array([4.5, 2 * np.pi / 3, np.pi / 4]), 1.0, law)


def duration(answer: OptimiserResult, program: Program) -> float:
    """Return the duration of a converged result."""
    assert answer.converged
    return float(answer.x[-1, program.structure.layout.duration])


@pytest.mark.parametrize("solver", SOLVERS)
def test_robot_arm_of_cops_takes_its_best_known_time(solver: str) -> None:
    make, errors = robot_arm(), []
    for intervals in (20, 40, 80):
        program, x = make(intervals, 10.0)
        errors.append(duration(optimise(program, x, solver), program) / 9.1409 - 1.0)
    assert 0.0 < errors[2] < 1e-3
    assert errors[0] > 3.0 * errors[1] > 0.0  # second order, a quarter each time, except for the solver's tolerance
    assert errors[1] > 2.5 * errors[2]


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize(("inertia", "mgl", "U", "begin", "end", "T"), JOINTS)
def test_one_joint_in_gravity_takes_the_exact_time(
    solver: str, inertia: float, mgl: float, U: float, begin: float, end: float, T: float
) -> None:
    """θ is in radians, time in units of √(I/U), I the inertia."""
    unit = np.sqrt(inertia / U)  # s
    make = second_order("pendulum", np.array([begin]), np.array([end]), 1.0, lambda y, _, a: a + mgl / U * ca.sin(y))
    errors = []
    for intervals in (20, 40, 80):
        program, x = make(intervals, 2.0 * T / unit)
        errors.append(duration(optimise(program, x, solver), program) * unit / T - 1.0)
    assert abs(errors[2]) < 1e-3
    assert abs(errors[2]) < abs(errors[1]) < abs(errors[0])
    assert abs(errors[2]) < 0.15 * abs(errors[0])  # about 1/16; it depends on the place of the step in its interval


def test_double_integrator_has_the_error_of_its_discretisation() -> None:
    """With K even the acceleration falls linearly over the two intervals in the middle. Integrating that profile gives T."""
    make = second_order("double", np.zeros(1), np.ones(1), 1.0, lambda y, v, a: a)
    for intervals in (10, 20, 40):
        program, x = make(intervals, 3.0)
        T = duration(optimise(program, x), program)
        profile = np.ones(intervals + 1)
        profile[intervals // 2], profile[intervals // 2 + 1 :] = 0.0, -1.0
        h, y, v = 1.0 / intervals, 0.0, 0.0
        for a, a_next in pairwise(profile):
            y, v = y + h * v + h**2 * (a / 3 + a_next / 6), v + h * (a + a_next) / 2
        assert v == pytest.approx(0.0, abs=1e-12)
        assert pytest.approx(1.0 / np.sqrt(y), rel=2e-4) == T  # the solver exceeds the bounds by its tolerance
        assert T > 2.0


@pytest.mark.parametrize("solver", SOLVERS)
def test_speed_limit_takes_the_closed_form(solver: str) -> None:
    """d/v + v/a if v² < a d, to a thousandth at 40 intervals. The relative error is 0.4 to 1.3 times 1/K²; it depends on the
    places of the two steps in their intervals."""
    d, a_max, v_max = 0.3, 7.0, 0.9  # m, m/s², m/s
    exact = d / v_max + v_max / a_max
    make = second_order("capped", np.zeros(1), np.array([d]), 1.0, lambda y, v, a: ca.vertcat(a / a_max, v / v_max))
    program, x = make(40, 0.6)
    assert duration(optimise(program, x, solver), program) == pytest.approx(exact, rel=1e-3)
    for intervals in (10, 20, 40):
        program, x = make(intervals, 0.6)
        answer = optimise(program, x, solver, tolerance=1e-8)
        error = intervals**2 * (duration(answer, program) / exact - 1.0)
        assert 0.4 < error < 1.3
        assert np.abs(answer.x[:, program.structure.layout.part("v")]).max() < v_max * (1.0 + 1e-6)


@pytest.mark.parametrize("dependent", [0, 1])
@pytest.mark.parametrize("staged", [False, True])
def test_assembled_derivatives_equal_automatic_differentiation(dependent: int, staged: bool) -> None:
    y, v, a, z = (ca.SX.sym(name, 2) for name in ("y", "v", "a", "z"))
    numbers = ca.SX.sym("p", 2)
    g = ca.vertcat(ca.sin(y[0]) * v[1] * numbers[0] + z[0] ** 3, a[0] * a[1] * z[1] - numbers[1] * ca.exp(y[1]))
    one: Equations = make_equations("one", ca.vertcat(y, v, a, z), numbers, g)
    two: Equations = make_equations("two", ca.vertcat(z, y), ca.SX.sym("none", 0), ca.dot(z, z) * y[0])
    layout = KnotLayout(2, 2, dependent)
    places = [
        tuple(int(i) for i in np.concatenate(x))
        for x in (
            [layout.part("y"), layout.part("v"), layout.part("a"), layout.z((0, 1))],
            [layout.z((0, 1)), layout.part("y")],
        )
    ]
    structure = ProgramStructure(
        layout, 3, (KnotEquations(one, places[0], (True, False)), KnotEquations(two, places[1], (False,))), (0, 1, 2), (0, 3)
    )
    t = transcribe(structure, staged)
    x, p = t.x, t.p
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", len(t.equal))
    f, rows = t.value(x, p), t.constraints(x, p)
    lagrangian = lam_f * f + ca.dot(lam_g, rows)
    whole = ca.Function("whole", [x, p, lam_f, lam_g], [ca.jacobian(rows, x), ca.gradient(f, x), *ca.hessian(lagrangian, x)])
    rng = np.random.default_rng(5)
    point = [rng.normal(size=s.numel()) for s in (x, p, lam_f, lam_g)]
    J, f_gradient, H, gradient = (np.array(each) for each in whole(*point))
    ours_gradient, ours_H = (np.array(each) for each in t.lagrangian_derivatives(*point))
    np.testing.assert_allclose(np.array(t.jacobian_values(*point[:2])[1]), J, atol=1e-12)
    np.testing.assert_allclose(np.array(t.gradient(*point[:2])), f_gradient, atol=1e-12)
    np.testing.assert_allclose(ours_H, H, atol=1e-12)
    np.testing.assert_allclose(ours_gradient, gradient, atol=1e-12)
    assert len(t.equal) == t.constraints.size1_out(0)
    assert sum(t.rows) + 3 * t.steps == len(t.equal)


@pytest.mark.parametrize("dependent", [0, 1])
def test_staged_form_equals_the_short_form(dependent: int) -> None:
    """Objective and rows are equal at any x; the rows of the copies are zero by construction."""
    y, v, a = (ca.SX.sym(name, 2) for name in "yva")
    equations = make_equations("rows", ca.vertcat(y, v, a), ca.SX.sym("none", 0), a + ca.sin(y) * v)
    layout, K = KnotLayout(2, 1, dependent), 3
    structure = ProgramStructure(layout, K, (KnotEquations(equations, tuple(range(6)), (True, False)),), (0, 1), (0, 1, 3))
    short, staged = transcribe(structure), transcribe(structure, staged=True)
    rng = np.random.default_rng(8)
    x, p = rng.normal(size=(K + 1, layout.size)), rng.uniform(size=layout.size + 1)
    p[layout.size] *= dependent == 0  # the staged form smooths dependent coordinates too
    f, f_staged = (float(t.value(t.to_solver_vector(x), p)) for t in (short, staged))
    g, g_staged = (np.array(t.constraints(t.to_solver_vector(x), p)).ravel() for t in (short, staged))
    assert f == pytest.approx(f_staged, rel=1e-12)
    assert staged.steps == short.steps + len(layout.next_values)
    first = np.cumsum([0, *(staged.steps + rows for rows in staged.rows[:-2])])  # first row of each step in g_staged
    copied = (first[:, None] + layout.next_values).ravel()
    np.testing.assert_allclose(g_staged[copied], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.delete(g_staged, copied), g, atol=1e-12)
    assert np.abs(g).min() > 1e-6  # no row is zero by chance


def test_callback_gets_every_iteration_and_can_stop_the_solver() -> None:
    program, x = robot_arm()(20, 10.0)
    seen: list[OptimiserIteration] = []

    def until(now: OptimiserIteration) -> bool:
        seen.append(now)
        return now.number < 3

    answer = optimise(program, x, callback=until)
    assert answer.stopped
    assert not answer.converged
    assert [each.number for each in seen] == [0, 1, 2, 3]
    late = optimise(program, x, seconds=0.0)
    assert late.stopped
    again = optimise(program, x)  # a stop applies to one call only
    assert again.converged


def test_cayley_parameters_and_rates_are_consistent() -> None:
    """C is a rotation matrix, Ċ = [ω]× C and ω̇ match differences, and the inverse functions give the parameters back."""
    rng = np.random.default_rng(2)
    r, r_d, r_dd = (rng.normal(size=(20, 3)) for _ in range(3))
    C, omega, alpha = cayley.rotation_and_rates(r, r_d, r_dd)
    np.testing.assert_allclose(C @ C.transpose(0, 2, 1), np.tile(np.eye(3), (20, 1, 1)), atol=1e-13)
    np.testing.assert_allclose(cayley.parameters(C), r, atol=1e-9)  # near half a turn 1 + tr C is small
    for found, exact in zip(cayley.parameter_rates(r, omega, alpha), (r_d, r_dd), strict=True):
        np.testing.assert_allclose(found, exact, atol=1e-10)
    h = 1e-5  # central differences: error h² times derivatives of order ten
    before, after = (cayley.rotation_and_rates(r + s * r_d + s**2 / 2 * r_dd, r_d + s * r_dd, r_dd) for s in (-h, h))
    C_rate = (after[0] - before[0]) / (2 * h) @ C.transpose(0, 2, 1)
    spin = np.stack([C_rate[:, 2, 1], C_rate[:, 0, 2], C_rate[:, 1, 0]], axis=1)
    np.testing.assert_allclose(spin, omega, atol=1e-7)
    np.testing.assert_allclose((after[1] - before[1]) / (2 * h), alpha, atol=1e-7)
