"""The structured kernel against the laws it states, against Clarabel, against known answers, and under sanitizers."""

from __future__ import annotations

import itertools
import math
import re
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from graspforce import Cone, ContactSet, ForceProblem, Objective
from graspforce.force.certificate import certify
from graspforce.force.solution import Multipliers

pytest.importorskip("graspforce.force.backends._structured", reason="the kernel was not built: no C compiler at installation")

from support.kernel_cases import (
    FAILED,
    INACCURATE,
    INFEASIBLE,
    OPTIMAL,
    KernelCase,
    bind_kernel,
    case_from_problem,
    case_without_hand,
    clarabel_optimum,
    dual_value,
    dual_violation,
    in_units,
    largest_load_factor,
    least_multiplier,
    lower_bound,
    objective,
    proof_margin,
    random_case,
    solve,
    stationarity,
    unpack_answer,
    violation,
)
from support.random_problems import inner_forces, random_actuation, random_contacts

SOURCES = Path(__file__).parents[2] / "graspforce" / "csrc"
COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler")

KINDS: dict[str, dict[str, object]] = {
    "point": {},
    "soft": {"models": (4,)},
    "mixed": {"models": (1, 3, 4), "joints": (2, 3, 4, 5)},
    "several contacts a finger": {"contacts": (1, 2, 3), "joints": (3, 4)},
    "fingers without joints": {"contacts": (1, 2, 3), "joints": (0, 1, 3), "models": (1, 3, 4), "force_weight": 1e-3},
    "limits missing": {"unlimited": 0.5},
    "fewer joints than components": {"joints": (1, 2)},
    "no hand": {"joints": (0,), "force_weight": 1.0},
    "friction zero": {"frictionless": 0.3, "models": (3, 4)},
    "normal force given": {"pinned": 0.3},
    "torque given": {"clamped": 0.4},
    "both given": {"pinned": 0.3, "clamped": 0.5, "contacts": (1, 2), "models": (1, 3, 4)},
    "pyramids of 4": {"facets": 4},
    "pyramids of 8": {"facets": 8},
}


def cases(kind: str, count: int, seed: int) -> list[KernelCase]:
    rng = np.random.default_rng(seed)
    return [random_case(rng, int(rng.integers(3, 7)), **KINDS[kind]) for _ in range(count)]  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", KINDS)
def test_optimal_as_clarabel_finds_it(kind: str) -> None:
    """Objective to 1e-8, the accuracy that is promised, and no law violated beyond 1e-8 of the force unit."""
    for case in cases(kind, 20, seed=11):
        answer = solve(case)
        least = clarabel_optimum(case)
        assert answer.status == OPTIMAL
        assert violation(case, answer.f) <= 1e-8
        assert objective(case, answer.f) == pytest.approx(least, rel=1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_multipliers_prove_the_optimum(kind: str) -> None:
    """Stationarity to rounding, signs, dual cones, and a Lagrangian that reaches the cost: together they prove the optimum."""
    for case in cases(kind, 10, seed=12):
        answer = solve(case)
        cost = objective(case, answer.f)
        price = np.abs(answer.y[:3]).max() + np.abs(answer.z).max()  # cost per N
        assert np.abs(stationarity(case, answer)).max() <= 1e-12 * (price + cost / case.force)
        assert least_multiplier(answer) >= 0.0
        assert dual_violation(case, answer) * case.force <= 1e-9 * cost
        assert lower_bound(case, answer) == pytest.approx(cost, rel=1e-8)


def test_nose_cone() -> None:
    """Lobo, Vandenberghe, Boyd, Lebret 1998, five contacts: least Σ‖f‖² = 0.65888534."""
    angle = 2 * np.pi * np.arange(1, 6) / 5
    x, y = 0.3 + np.cos(angle), np.sin(angle)
    normals = np.column_stack([-2 * x, -2 * y, np.ones(5)])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    answer = solve(case_without_hand(np.column_stack([x, y, x**2 + y**2]), normals, 0.3, [0, 0, 1, 0, 0, 0]))
    assert answer.status == OPTIMAL
    assert answer.f @ answer.f == pytest.approx(0.65888534, abs=5e-9)


@pytest.mark.parametrize("limit", [np.inf, 100.0, 50.0])
def test_two_opposed_contacts(limit: float) -> None:
    """Load 10 on two contacts, μ = 0.1: f_n = 50, f_t = 5 each, with one equality redundant and even with no room to spare."""
    case = case_without_hand([[0, -2, 0], [0, 2, 0]], [[0, 1, 0], [0, -1, 0]], 0.1, [0, 0, 10, 0, 0, 0], limit=limit)
    assert np.linalg.matrix_rank(case.G) == 5
    answer = solve(case)
    assert answer.status == OPTIMAL
    np.testing.assert_allclose(answer.f[[2, 5]], 50.0, rtol=1e-8)
    assert answer.f @ answer.f == pytest.approx(2 * 2525.0, rel=1e-8)


@pytest.mark.parametrize("contacts", [3, 4, 7])
def test_horizontal_ring(contacts: int) -> None:
    """n contacts on a circle, weight W: ½‖f‖² = W²(1 + 1/μ²)/(2n)."""
    angle, mu, W = 2 * np.pi * np.arange(contacts) / contacts, 0.5, 2.0
    out = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(contacts)])
    case = case_without_hand(0.05 * out, -out, mu, [0, 0, W, 0, 0, 0])
    assert objective(case, solve(case).f) == pytest.approx(W**2 * (1 + mu**-2) / (2 * contacts), rel=1e-8)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_one_contact_is_determined(share: float) -> None:
    """A single contact that bears the load alone, up to the edge of its cone: the feasible set is one point."""
    case = case_without_hand([[0, 0, 0]], [[0, 0, 1]], 0.5, [0.5 * share, 0, 1, 0, 0, 0])
    answer = solve(case)
    assert answer.status == OPTIMAL
    np.testing.assert_allclose(case.G[:3] @ answer.f, case.w[:3], atol=1e-8)


def test_coincident_contacts_share_alike() -> None:
    """Four contacts in one place against one: each bears a quarter of what a single one would."""
    normals = np.array([[-1, 0, 0]] * 4 + [[1, 0, 0]])
    case = case_without_hand(-0.03 * normals, normals, 0.5, [0, 0, 1, 0, 0, 0])
    answer = solve(case)
    assert answer.status == OPTIMAL
    np.testing.assert_allclose(answer.f.reshape(5, 3)[:4, 2], answer.f.reshape(5, 3)[4, 2] / 4, rtol=1e-6)
    assert objective(case, answer.f) == pytest.approx(clarabel_optimum(case), rel=1e-8)


def test_no_load() -> None:
    """w = 0: zero force where nothing pushes the motors; else the forces that relieve them, as Clarabel finds them."""
    rng = np.random.default_rng(3)
    for _ in range(30):
        drawn = random_case(rng, 4)
        idle = replace(drawn, w=np.zeros(6), min_normal=np.zeros(4), tau_u=0 * drawn.tau_u)
        answer = solve(idle)
        assert answer.status == OPTIMAL
        # The cost is right to 1e-12 of its unit, so forces are to 1e-6 of theirs, some newtons.
        assert np.abs(answer.f).max() <= 2e-5
        relieved = replace(drawn, w=np.zeros(6), min_normal=np.zeros(4))
        answer = solve(relieved)
        if answer.status == OPTIMAL:
            assert objective(relieved, answer.f) == pytest.approx(clarabel_optimum(relieved), rel=1e-8)
        else:
            assert answer.status == INFEASIBLE
            assert proof_margin(relieved, answer) > 0


@pytest.mark.parametrize("kind", ["point", "mixed", "limits missing"])
def test_linear_cost(kind: str) -> None:
    """The sum of normal forces as the only cost."""
    for case in cases(kind, 8, seed=14):
        cost = np.zeros(case.k)
        cost[case.normals] = 1.0
        linear = replace(case, cost=cost, weight=0 * case.weight)
        answer = solve(linear)
        assert answer.status == OPTIMAL
        assert objective(linear, answer.f) == pytest.approx(clarabel_optimum(linear), rel=1e-8)


@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1e3])
def test_unequal_friction(scale: float) -> None:
    """Very slippery and very rough contacts beside ordinary ones."""
    rng = np.random.default_rng(15)
    for _ in range(8):
        case = random_case(rng, 5)
        mu = case.mu * np.where(np.arange(5) % 2, scale, 1.0)
        f = np.zeros(case.k)
        f[case.normals] = rng.uniform(1.0, 3.0, size=5)
        f[case.normals - 1] = 0.5 * np.minimum(mu, 1.0) * f[case.normals]
        limit = np.abs(case.tau_u + case.J.T @ f) + 0.05
        case = replace(case, mu=mu, w=case.G @ f, lower=-limit, upper=limit)
        answer = solve(case)
        assert answer.status == OPTIMAL
        assert violation(case, answer.f) <= 1e-8
        assert objective(case, answer.f) == pytest.approx(clarabel_optimum(case), rel=1e-8)


# ---- no answer ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("excess", [1e-4, 1e-2, 9.0])
@pytest.mark.parametrize("kind", ["point", "soft", "mixed", "several contacts a finger", "limits missing", "both given"])
def test_overload_is_proven(kind: str, excess: float) -> None:
    """Beyond the largest load that Clarabel finds there is no answer, and the multipliers prove it by themselves."""
    proven = 0
    for case in cases(kind, 10, seed=21):
        load = largest_load_factor(case)
        if not 1.0 <= load < 1e3:  # without bound
            continue
        over = replace(case, w=(1 + excess) * load * case.w)
        answer = solve(over)
        if kind == "limits missing" and excess < 1e-3 and answer.status == FAILED:
            continue  # no force is out of reach there, so a small excess may find no proof: then it says so
        assert answer.status == INFEASIBLE
        assert np.isnan(answer.f).all()
        assert least_multiplier(answer) >= 0.0
        assert dual_value(over, answer) == pytest.approx(1.0, rel=1e-6)
        assert proof_margin(over, answer) > 0.9
        proven += 1
        within = replace(case, w=(1 + 0.99 * (load - 1)) * case.w)  # between a load that is held and the largest
        assert solve(within).status == OPTIMAL
    assert proven >= 5


@pytest.mark.parametrize("offset", [1e-3, 0.1])
@pytest.mark.parametrize("limit", [100.0, np.inf])
def test_wrench_outside_the_range_of_G(offset: float, limit: float) -> None:
    """Two point contacts bear no moment about the line between them, however small."""
    case = case_without_hand([[0, -2, 0], [0, 2, 0]], [[0, 1, 0], [0, -1, 0]], 0.1, [0, 0, 10, 0, offset, 0], limit=limit)
    answer = solve(case)
    assert answer.status == INFEASIBLE
    assert proof_margin(case, answer) > 0.9


def test_contradicting_limits() -> None:
    """Limits that cross, and a motor that nothing can relieve, are proven by their own two multipliers."""
    case = random_case(np.random.default_rng(22), 4)
    crossed = replace(case, min_normal=np.full(4, 2.0), max_normal=np.full(4, 1.0))
    torques = replace(case, lower=case.upper + 1.0)
    stuck = replace(case, J=case.J * (np.arange(12) > 0), tau_u=np.where(np.arange(12) == 0, 99.0, case.tau_u))
    for broken in (crossed, torques, stuck):
        answer = solve(broken)
        assert answer.status == INFEASIBLE
        assert proof_margin(broken, answer) > 0.9


# ---- units, numbers, starts ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("force", "length"), list(itertools.product([1e-4, 1.0, 1e4], [1e-2, 1.0, 1e2])))
def test_units_change_nothing_but_units(force: float, length: float) -> None:
    """Over eight decades of force and four of length the iterations are the same, and the forces but for rounding."""
    for kind in ("point", "mixed"):
        for case in cases(kind, 4, seed=31):
            other = in_units(case, force, length)
            first, second = solve(case), solve(other)
            assert first.status == second.status == OPTIMAL
            assert abs(first.iterations - second.iterations) <= 1
            unit = force * np.where(case.columns % 4 == 3, length, 1.0)
            assert objective(case, second.f * unit) == pytest.approx(objective(case, first.f), rel=1e-8)
            assert violation(case, second.f * unit) <= 1e-8


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
@pytest.mark.parametrize("name", ["G", "w", "mu", "min_normal", "J", "tau_u", "weight", "cost", "force_weight"])
def test_hostile_numbers_fail(name: str, bad: float) -> None:
    """Status failed within the bound on iterations, and the workspace works again afterwards."""
    case = random_case(np.random.default_rng(41), 4)
    spoilt = getattr(case, name).copy()
    where = tuple(np.argwhere(np.ones_like(spoilt) if name != "J" else case.J)[0])
    spoilt[where] = bad
    kernel, answer, report = bind_kernel(case, **{name: spoilt})
    assert kernel.solve(0, 1, 1e-9, 60, False) in (FAILED, INFEASIBLE) if bad == 1e300 else FAILED
    assert report[0, 1] <= 60
    kernel, answer, report = bind_kernel(case, count=2, **{name: np.stack([spoilt, getattr(case, name)])})
    kernel.solve(0, 2, 1e-9, 60, True)
    assert report[1, 0] == OPTIMAL
    np.testing.assert_allclose(answer[1, : case.k], solve(case).f)


@pytest.mark.parametrize("name", ["mu", "weight", "force_weight"])
def test_negative_numbers_fail(name: str) -> None:
    case = random_case(np.random.default_rng(42), 4)
    assert solve(replace(case, **{name: getattr(case, name) - 5.0})).status == FAILED


def test_iterations_are_bounded() -> None:
    """One iteration is not enough, and is all that is done."""
    case = random_case(np.random.default_rng(43), 4)
    answer = solve(case, most=1)
    assert answer.iterations == 1
    assert answer.status == FAILED


def test_looser_tolerance_costs_less() -> None:
    """Residuals stay within the tolerance asked for, with fewer iterations."""
    case = random_case(np.random.default_rng(44), 4)
    kernel, _, report = bind_kernel(case)
    kernel.solve(0, 1, 1e-4, 60, False)
    assert report[0, 0] == OPTIMAL
    assert report[0, 2:5].max() <= 1e-4
    assert report[0, 1] < solve(case).iterations


def test_warm_start() -> None:
    """After a change of up to 1 % the answer is that of a cold start, in fewer iterations; so after the shape has changed."""
    rng = np.random.default_rng(45)
    cold, warm = 0, 0
    for _ in range(20):
        case = random_case(rng, 4)
        new = replace(case, w=case.w * rng.uniform(0.99, 1.01, 6), J=case.J * rng.uniform(0.99, 1.01, case.J.shape))
        stacks = {"w": np.stack([case.w, new.w]), "J": np.stack([case.J, new.J])}
        kernel, answer, report = bind_kernel(case, count=2, **stacks)
        kernel.solve(0, 1, 1e-9, 60, False)
        kernel.solve(1, 2, 1e-9, 60, True)
        alone = solve(new)
        assert report[1, 0] == alone.status
        cold, warm = cold + alone.iterations, warm + int(report[1, 1])
        if alone.status == OPTIMAL:
            assert objective(new, answer[1, : case.k]) == pytest.approx(objective(new, alone.f), rel=1e-8)
    assert warm < 0.7 * cold
    slippery = np.stack([case.mu, case.mu * (np.arange(4) > 0)])
    kernel, answer, report = bind_kernel(case, count=2, mu=slippery)
    kernel.solve(0, 2, 1e-9, 60, True)
    assert report[1, 0] == solve(replace(case, mu=slippery[1])).status


# ---- many at once -------------------------------------------------------------------------------------------------------


def test_batch_equals_one_by_one_in_any_threads() -> None:
    """Stacked problems in two threads give, bit for bit, what each gives alone; a spoilt one spoils only itself."""
    rng = np.random.default_rng(51)
    case = random_case(rng, 4)
    w = case.w * rng.uniform(0.8, 1.0, size=(64, 1))
    w[17] = np.nan
    kernel, answer, report = bind_kernel(case, count=64, w=w)
    assert kernel.solve(0, 64, 1e-9, 60, False) == FAILED
    np.testing.assert_array_equal(np.flatnonzero(report[:, 0] == FAILED), [17])
    halves, reports = np.zeros_like(answer), np.zeros_like(report)
    workers = [bind_kernel(case, w=w, answer=halves, report=reports)[0] for _ in range(2)]
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda i: workers[i].solve(32 * i, 32 * i + 32, 1e-9, 60, False), range(2)))
    np.testing.assert_array_equal(halves, answer)
    np.testing.assert_array_equal(solve(replace(case, w=w[5])).f, answer[5, : case.k])


def test_fingers_in_any_order() -> None:
    """Renaming the fingers changes the answer by rounding only."""
    case = random_case(np.random.default_rng(52), 6, models=(1, 3, 4), contacts=(1, 2), joints=(2, 3))
    turned = replace(case, contact_block=(5 - case.contact_block), joint_block=(5 - case.joint_block))
    assert objective(case, solve(turned).f) == pytest.approx(objective(case, solve(case).f), rel=1e-8)


def test_one_block_is_always_right() -> None:
    """All fingers in one block: the structure is a promise, not part of the problem."""
    for case in cases("mixed", 5, seed=53):
        whole = replace(case, contact_block=0 * case.contact_block, joint_block=0 * case.joint_block)
        assert objective(case, solve(whole).f) == pytest.approx(objective(case, solve(case).f), rel=1e-8)


# ---- the binding --------------------------------------------------------------------------------------------------------


def test_binding_refuses_what_does_not_fit() -> None:
    case = random_case(np.random.default_rng(61), 3)
    with pytest.raises(ValueError, match="w must hold 6 numbers a problem"):
        bind_kernel(case, w=np.zeros(5))
    with pytest.raises(TypeError, match="mu must hold float64"):
        bind_kernel(case, mu=np.ones(3, dtype=np.float32))
    with pytest.raises(TypeError, match="components must hold C integers"):
        bind_kernel(case, components=np.full(3, 3, dtype=np.int64))
    with pytest.raises(ValueError, match="contact_block must be as long as components"):
        bind_kernel(case, contact_block=np.zeros(2, dtype=np.intc))
    with pytest.raises(ValueError, match="describe no hand"):
        bind_kernel(case, components=np.full(3, 2, dtype=np.intc))
    with pytest.raises(ValueError, match="describe no hand"):
        bind_kernel(case, contact_block=np.full(3, -1, dtype=np.intc))
    kernel, _, _ = bind_kernel(case)
    for bad in [(0, 2, 1e-9, 60, False), (-1, 1, 1e-9, 60, False), (0, 1, 0.0, 60, False), (0, 1, math.nan, 60, False)]:
        with pytest.raises(ValueError, match=r"<= last <= 1|tolerance > 0"):
            kernel.solve(*bad)
    with pytest.raises(TypeError):
        kernel.solve(0, 1)  # type: ignore[call-arg]
    with pytest.raises(RuntimeError, match="bound once"):
        kernel.__init__(**{**vars(case), "answer": np.zeros((1, 99)), "report": np.zeros((1, 8))})  # type: ignore[misc]


def test_kernel_reads_the_arrays_as_they_are_now() -> None:
    """No copies: what is written into a bound array counts at the next solve."""
    case = random_case(np.random.default_rng(62), 4)
    w = case.w.copy()
    kernel, answer, _ = bind_kernel(case, w=w)
    kernel.solve(0, 1, 1e-9, 60, False)
    w *= 0.9
    kernel.solve(0, 1, 1e-9, 60, False)
    np.testing.assert_array_equal(answer[0, : case.k], solve(replace(case, w=0.9 * case.w)).f)


# ---- the certificate ----------------------------------------------------------------------------------------------------


def random_certified(rng: np.random.Generator) -> ForceProblem:
    contacts = ContactSet.stack(random_contacts(rng, int(rng.integers(2, 7))))
    f = inner_forces(rng, contacts, share=0.6)
    actuation = random_actuation(rng, contacts, f) if rng.random() < 0.7 else None
    kind = str(rng.choice(["torque", "force", "sum_normal"] if actuation else ["force", "sum_normal"]))
    weight = float(rng.choice([0.0, 0.01])) if kind == "torque" else 0.0
    return ForceProblem(contacts, np.asarray(case_wrench(contacts, f)), actuation, Cone(), Objective(kind, weight))


def case_wrench(contacts: ContactSet, f: np.ndarray) -> np.ndarray:
    """G f, from the contacts' own wrench bases."""
    return np.asarray(np.einsum("irc,ic->r", contacts.wrench_bases(), contacts.pad(f)))


def test_certificate_equals_its_law_in_python() -> None:
    """certify.c and certificate.py give the same residuals, for answers and for numbers that are far from one."""
    rng = np.random.default_rng(71)
    for _ in range(60):
        problem = random_certified(rng)
        case = case_from_problem(problem)
        kernel, answer, report = bind_kernel(case)
        kernel.solve(0, 1, 1e-9, 60, False)
        for noise in (0.0, 1e-3, 1.0):
            answer[0] += noise * rng.normal(size=answer.shape[1])
            kernel.certify(0, 1)
            a = unpack_answer(case, answer[0], report[0])
            level = np.zeros(len(problem.contacts))
            y = a.y + np.append(np.cross(problem.contacts.centroid, a.y[3:]), np.zeros(3))  # about O, from about the centroid
            multipliers = Multipliers(y, a.nu_lower, a.nu_upper, a.lambda_lower, a.lambda_upper, level)
            reference = certify(problem, a.f, multipliers)
            residuals = [reference.primal_residual, reference.dual_residual, reference.gap]
            np.testing.assert_allclose(report[0, 5:], residuals, rtol=1e-9, atol=1e-13)
            np.testing.assert_allclose(a.tau, problem.torques(a.f), rtol=1e-12, atol=1e-14)


def test_every_optimal_answer_is_certified() -> None:
    """To the certificate's tight tolerance, in its own units."""
    rng = np.random.default_rng(72)
    verdicts = []
    for _ in range(100):
        kernel, _, report = bind_kernel(case_from_problem(random_certified(rng)))
        verdicts.append(kernel.solve(0, 1, 1e-9, 60, False))
        kernel.certify(0, 1)
        if verdicts[-1] == OPTIMAL:
            assert report[0, 5:].max() <= 1e-8
    assert verdicts.count(OPTIMAL) >= 95
    assert INACCURATE not in verdicts


def test_certificate_of_hostile_numbers_is_the_largest_number() -> None:
    case = random_case(np.random.default_rng(73), 3)
    case = replace(case, units=np.array([1.0, 0.05, 1.0, *np.full(case.sizes[1], 0.05)]))
    for bad in (np.nan, np.inf, 1e300):
        kernel, answer, report = bind_kernel(case)
        kernel.solve(0, 1, 1e-9, 60, False)
        answer[0, 1] = bad
        kernel.certify(0, 1)
        assert np.isfinite(report[0, 5:]).all()
        assert report[0, 5:].max() >= 1e6


def test_certificate_beside_an_infinite_cost_proves_nothing() -> None:
    """A joint that no force loads has a torque of 1e200 N·m after the solve: beside its square every gap would be nothing."""
    case = random_case(np.random.default_rng(75), 3)
    case.J[:, 0] = 0.0
    case = replace(case, units=np.array([1.0, 0.05, 1.0, *np.full(case.sizes[1], 0.05)]))
    kernel, _, report = bind_kernel(case)
    kernel.solve(0, 1, 1e-9, 60, False)
    case.tau_u[0] = 1e200
    kernel.certify(0, 1)
    assert (report[0, 6:] == np.finfo(float).max).all()


def test_certificate_knows_exact_cones_only() -> None:
    kernel, _, _ = bind_kernel(random_case(np.random.default_rng(74), 3, facets=4))
    with pytest.raises(ValueError, match="exact cones only"):
        kernel.certify(0, 1)


# ---- C ------------------------------------------------------------------------------------------------------------------


def compiled(folder: Path, sources: list[Path], *flags: str) -> Path:
    program = folder / "program"
    assert COMPILER is not None
    command = [COMPILER, *flags, "-Wno-psabi", f"-I{SOURCES / 'include'}", *map(str, sources), "-lm", "-o", str(program)]
    subprocess.run(command, check=True, timeout=300)
    return program


@needs_compiler
@pytest.mark.parametrize("lanes", [1, 2, 4])
def test_example_of_the_header(tmp_path: Path, lanes: int) -> None:
    """The program in solve.h's comment compiles, without a warning, and prints what the comment says; at any width."""
    comment = (SOURCES / "include/graspforce/solve.h").read_text().split("#ifndef")[0]
    example = comment[comment.index(" *     #include") : comment.index(" * prints")]
    (tmp_path / "example.c").write_text(re.sub(r"^ \*( {5})?", "", example, flags=re.M))
    wanted = re.search(r'prints "(.*)"', comment)
    flags = ["-std=c11", "-Wall", "-Wextra", "-Werror", "-O1", f"-DGF_LANES={lanes}"]
    program = compiled(tmp_path, [tmp_path / "example.c", SOURCES / "kernel/solve.c", SOURCES / "kernel/strings.c"], *flags)
    assert wanted is not None
    assert subprocess.run([program], check=True, capture_output=True, text=True, timeout=60).stdout.strip() == wanted[1]


@needs_compiler
def test_headers_serve_cpp(tmp_path: Path) -> None:
    """The headers compile as C++."""
    program = "int main() { return gf_workspace_size(nullptr) != 0; }\n"
    headers = sorted(path.name for path in (SOURCES / "include/graspforce").glob("*.h"))
    (tmp_path / "headers.cpp").write_text("".join(f'#include "graspforce/{name}"\n' for name in headers) + program)
    assert COMPILER is not None
    subprocess.run(
        [COMPILER, "-x", "c++", "-Wall", "-Werror", "-fsyntax-only", f"-I{SOURCES / 'include'}", str(tmp_path / "headers.cpp")],
        check=True,
        timeout=60,
    )


@needs_compiler
def test_kernel_under_sanitizers(tmp_path: Path) -> None:
    """Random and hostile numbers in a build with AddressSanitizer and UndefinedBehaviorSanitizer: no fault, no broken law."""
    (tmp_path / "probe.c").write_text("int main(void) { return 0; }\n")
    flags = ["-std=c11", "-O0", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    try:
        compiled(tmp_path, [tmp_path / "probe.c"], *flags)
    except subprocess.CalledProcessError:
        pytest.skip("this compiler has no sanitizers")
    fuzz = Path(__file__).with_name("kernel_fuzz.c")
    program = compiled(
        tmp_path, [fuzz, *(SOURCES / f"kernel/{name}.c" for name in ("solve", "certify", "grasp_matrix", "strings"))], *flags
    )
    done = subprocess.run([program, "3000"], check=False, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    optimal, _, infeasible, failed = map(int, done.stdout.split())
    assert min(optimal, infeasible, failed) > 100  # the driver reaches every kind of end
