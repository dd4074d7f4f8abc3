"""Minimum time as a program: its derivatives, its order, and problems whose answer is known, by both solvers."""

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
JOINTS = [  # I, mgl, U, θ₀, θ₁ and T in s: facts of an arm with one joint in gravity
    (1.0, 1.0, 2.0, 0.0, 1.0, 1.3296929500),
    (1.0, 0.5, 1.0, -0.5, 1.5, 2.4893388243),
    (1e-3, 0.02, 0.05, 0.0, 1.2, 0.2928735884),
]


def second_order(name: str, start: Array, goal: Array, limit: float, law: Callable[[ca.SX, ca.SX, ca.SX], ca.SX]):
    """Return a program |law(y, v, a)| ≤ limit from rest to rest."""
    n = len(start)
    y, v, a = (ca.SX.sym(letter, n) for letter in "yva")
    g = law(y, v, a)
    held = make_equations(name, ca.vertcat(y, v, a), ca.SX.sym("none", 0), g)
    bound = np.full(g.numel(), limit)

    def program(intervals: int, T: float) -> tuple[Program, Array]:
        layout = KnotLayout(n, 0)
        variables = tuple(int(i) for kind in "yva" for i in layout.part(kind))
        ends = tuple(range(2 * n))
        structure = ProgramStructure(layout, intervals, (KnotEquations(held, variables, (False,) * len(bound)),), ends, ends)
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
    """COPS 3.0, Dolan, Moré and Munson (2004), problem 8, L = 5: its best known time is 9.1409."""

    def law(y: ca.SX, _: ca.SX, a: ca.SX) -> ca.SX:
        inertia = ((5.0 - y[0]) ** 3 + y[0] ** 3) / 3.0
        return ca.vertcat(5.0 * a[0], inertia * ca.sin(y[2]) ** 2 * a[1], inertia * a[2])

    start = np.array([4.5, 0.0, np.pi / 4])
    return second_order("robot_arm", start, np.array([4.5, 2 * np.pi / 3, np.pi / 4]), 1.0, law)


def duration(answer: OptimiserResult, program: Program) -> float:
    assert answer.converged
    return float(answer.x[-1, program.structure.layout.duration])


@pytest.mark.parametrize("solver", SOLVERS)
def test_the_robot_arm_of_cops(solver: str) -> None:
    make, errors = robot_arm(), []
    for intervals in (20, 40, 80):
        program, x = make(intervals, 10.0)
        errors.append(duration(optimise(program, x, solver), program) / 9.1409 - 1.0)
    assert 0.0 < errors[2] < 1e-3
    assert errors[0] > 3.0 * errors[1] > 0.0  # second order: a quarter each time, less the solver's own tolerance
    assert errors[1] > 2.5 * errors[2]


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize(("I", "mgl", "U", "begin", "end", "T"), JOINTS)
def test_one_joint_in_gravity(solver: str, I: float, mgl: float, U: float, begin: float, end: float, T: float) -> None:  # noqa: E741
    """In units of its own: θ by a radian, time by √(I/U)."""
    unit = np.sqrt(I / U)  # s
    make = second_order("pendulum", np.array([begin]), np.array([end]), 1.0, lambda y, _, a: a + mgl / U * ca.sin(y))
    errors = []
    for intervals in (20, 40, 80):
        program, x = make(intervals, 2.0 * T / unit)
        errors.append(duration(optimise(program, x, solver), program) * unit / T - 1.0)
    assert abs(errors[2]) < 1e-3
    assert abs(errors[2]) < abs(errors[1]) < abs(errors[0])
    assert abs(errors[2]) < 0.15 * abs(errors[0])  # a sixteenth, and where in an interval the jump falls


def test_a_double_integrator_loses_as_its_square_of_the_grid_says() -> None:
    """With a jump of the acceleration in the middle of K intervals, K even: it falls linearly through both intervals next to
    the middle, over 2 h. Half way d/2 = ∫∫ gives T/T₀ = (1 − 4/(3 K²) …)^(−1/2): worked out by quadrature of that profile."""
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
        assert pytest.approx(1.0 / np.sqrt(y), rel=2e-4) == T  # the solver's tolerance, which leaves the bounds by as much
        assert T > 2.0


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_capped_speed(solver: str) -> None:
    """d/v + v/a where v² < a d: to a thousandth at 40 intervals, with an error of second order, its part 0.4 to 1.3 times 1/K²
    after where in an interval the two jumps fall."""
    d, a_most, v_most = 0.3, 7.0, 0.9  # m, m/s², m/s
    exact = d / v_most + v_most / a_most
    make = second_order("capped", np.zeros(1), np.array([d]), 1.0, lambda y, v, a: ca.vertcat(a / a_most, v / v_most))
    program, x = make(40, 0.6)
    assert duration(optimise(program, x, solver), program) == pytest.approx(exact, rel=1e-3)
    for intervals in (10, 20, 40):
        program, x = make(intervals, 0.6)
        answer = optimise(program, x, solver, tolerance=1e-8)
        error = intervals**2 * (duration(answer, program) / exact - 1.0)
        assert 0.4 < error < 1.3
        assert np.abs(answer.x[:, program.structure.layout.part("v")]).max() < v_most * (1.0 + 1e-6)


@pytest.mark.parametrize("dependent", [0, 1])
@pytest.mark.parametrize("staged", [False, True])
def test_derivatives_are_those_that_casadi_would_make_of_the_whole(dependent: int, staged: bool) -> None:
    """Our Jacobian, gradient and Hessian, put in place by hand, against automatic differentiation of f and g."""
    y, v, a, z = (ca.SX.sym(name, 2) for name in ("y", "v", "a", "z"))
    numbers = ca.SX.sym("p", 2)
    g = ca.vertcat(ca.sin(y[0]) * v[1] * numbers[0] + z[0] ** 3, a[0] * a[1] * z[1] - numbers[1] * ca.exp(y[1]))
    one: Equations = make_equations("one", ca.vertcat(y, v, a, z), numbers, g)
    two: Equations = make_equations("two", ca.vertcat(z, y), ca.SX.sym("none", 0), ca.dot(z, z) * y[0])
    layout = KnotLayout(2, 2, dependent)
    at = [
        tuple(int(i) for i in np.concatenate(x))
        for x in (
            [layout.part("y"), layout.part("v"), layout.part("a"), layout.z((0, 1))],
            [layout.z((0, 1)), layout.part("y")],
        )
    ]
    structure = ProgramStructure(
        layout, 3, (KnotEquations(one, at[0], (True, False)), KnotEquations(two, at[1], (False,))), (0, 1, 2), (0, 3)
    )
    t = transcribe(structure, staged)
    x, p = t.x, t.p
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", len(t.equal))
    f, rows = t.value(x, p), t.constraints(x, p)
    lagrangian = lam_f * f + ca.dot(lam_g, rows)
    whole = ca.Function("whole", [x, p, lam_f, lam_g], [ca.jacobian(rows, x), ca.gradient(f, x), *ca.hessian(lagrangian, x)])
    rng = np.random.default_rng(5)
    point = [rng.normal(size=s.numel()) for s in (x, p, lam_f, lam_g)]
    J, falls, H, pull = (np.array(each) for each in whole(*point))
    ours_pull, ours_H = (np.array(each) for each in t.lagrangian_derivatives(*point))
    np.testing.assert_allclose(np.array(t.jacobian_values(*point[:2])[1]), J, atol=1e-12)
    np.testing.assert_allclose(np.array(t.gradient(*point[:2])), falls, atol=1e-12)
    np.testing.assert_allclose(ours_H, H, atol=1e-12)
    np.testing.assert_allclose(ours_pull, pull, atol=1e-12)
    assert len(t.equal) == t.constraints.size1_out(0)
    assert sum(t.rows) + 3 * t.steps == len(t.equal)


@pytest.mark.parametrize("dependent", [0, 1])
def test_steps_between_knots_and_staged_ones_say_the_same(dependent: int) -> None:
    """At any x the same objective and the same rows; staged those of what is copied besides, which are kept by their making."""
    y, v, a = (ca.SX.sym(name, 2) for name in "yva")
    held = make_equations("held", ca.vertcat(y, v, a), ca.SX.sym("none", 0), a + ca.sin(y) * v)
    layout, K = KnotLayout(2, 1, dependent), 3
    structure = ProgramStructure(layout, K, (KnotEquations(held, tuple(range(6)), (True, False)),), (0, 1), (0, 1, 3))
    short, staged = transcribe(structure), transcribe(structure, staged=True)
    rng = np.random.default_rng(8)
    x, p = rng.normal(size=(K + 1, layout.size)), rng.uniform(size=layout.size + 1)
    p[layout.size] *= dependent == 0  # where coordinates are led, staged ones are smoothed too
    f, f_staged = (float(t.value(t.to_solver_vector(x), p)) for t in (short, staged))
    g, g_staged = (np.array(t.constraints(t.to_solver_vector(x), p)).ravel() for t in (short, staged))
    assert f == pytest.approx(f_staged, rel=1e-12)
    assert staged.steps == short.steps + len(layout.next_values)
    first = np.cumsum([0, *(staged.steps + rows for rows in staged.rows[:-2])])  # rows of g_staged: where each step begins
    copied = (first[:, None] + layout.next_values).ravel()
    np.testing.assert_allclose(g_staged[copied], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.delete(g_staged, copied), g, atol=1e-12)
    assert np.abs(g).min() > 1e-6  # nothing is zero by itself


def test_a_watch_sees_every_iteration_and_may_stop_it() -> None:
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
    again = optimise(program, x)  # what was told to one call holds for it alone
    assert again.converged


def test_cayley_s_parameters_and_their_rates() -> None:
    """C is a rotation; Ċ = [ω]× C and ω̇ by differences; and back."""
    rng = np.random.default_rng(2)
    r, r_d, r_dd = (rng.normal(size=(20, 3)) for _ in range(3))
    C, omega, alpha = cayley.rotation_and_rates(r, r_d, r_dd)
    np.testing.assert_allclose(C @ C.transpose(0, 2, 1), np.tile(np.eye(3), (20, 1, 1)), atol=1e-13)
    np.testing.assert_allclose(cayley.parameters(C), r, atol=1e-9)  # near half a turn the trace is near −1
    for found, exact in zip(cayley.parameter_rates(r, omega, alpha), (r_d, r_dd), strict=True):
        np.testing.assert_allclose(found, exact, atol=1e-10)
    h = 1e-5  # central differences err by h² times derivatives of order ten
    before, after = (cayley.rotation_and_rates(r + s * r_d + s**2 / 2 * r_dd, r_d + s * r_dd, r_dd) for s in (-h, h))
    turning = (after[0] - before[0]) / (2 * h) @ C.transpose(0, 2, 1)
    spin = np.stack([turning[:, 2, 1], turning[:, 0, 2], turning[:, 1, 0]], axis=1)
    np.testing.assert_allclose(spin, omega, atol=1e-7)
    np.testing.assert_allclose((after[1] - before[1]) / (2 * h), alpha, atol=1e-7)
