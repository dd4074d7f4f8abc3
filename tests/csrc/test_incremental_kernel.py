"""A kernel that follows a problem: what changes is checked, placed and scaled in C as in Python, and nothing else changes."""

from __future__ import annotations

import dataclasses
import itertools
import os
import shutil
import subprocess
import sys
import sysconfig
import threading
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components
from support.random_problems import inner_forces, random_actuation, random_contacts, random_problem

from graspforce import (
    Actuation,
    Cone,
    ContactSet,
    ForceProblem,
    InvalidInput,
    Objective,
    Solver,
    Status,
    solve,
)
from graspforce.contact.matrices import grasp_matrix
from graspforce.core.errors import BackendError
from graspforce.force.backends import structured
from graspforce.force.scale import joint_lever_arms, scale

if not structured.is_available():
    pytest.skip("the kernel was not built: no C compiler at installation", allow_module_level=True)

SOURCES = Path(__file__).parents[2] / "graspforce" / "csrc"
COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
NAMES = ("w", "J", "tau_u", "p", "R")


def feasible_problem(rng: np.random.Generator, models: tuple[str, ...] = ("frictionless", "point", "soft")) -> ForceProblem:
    """A feasible grasp with a hand, exact cones, an objective that the kernel takes, and O some way off."""
    contacts = ContactSet.stack(random_contacts(rng, int(rng.integers(3, 8)), models))
    f = inner_forces(rng, contacts, share=0.6)
    kind = str(rng.choice(["torque", "force", "sum_normal"]))
    tight = random_actuation(rng, contacts, f)
    actuation = Actuation(tight.J, tight.tau_u, 1.5 * tight.lower, 1.5 * tight.upper, tight.weight)
    problem = ForceProblem(contacts, grasp_matrix(contacts) @ f, actuation, Cone(), Objective(kind, 1e-4 * (kind == "torque")))
    return moved(problem, 0.05 * rng.normal(size=3))


def moved(problem: ForceProblem, origin: np.ndarray) -> ForceProblem:
    w = np.append(problem.w[:3], problem.w[3:] - np.cross(origin, problem.w[:3]))
    return problem.replace(p=problem.contacts.p_OC - origin, w=w)


def turned(rng: np.random.Generator, R: np.ndarray) -> np.ndarray:
    """Frames turned by some thousandths of a radian each, exactly: Cayley's (1 − S/2)⁻¹ (1 + S/2) is a rotation."""
    S = np.cross(np.eye(3), 2e-3 * rng.normal(size=(len(R), 1, 3)))
    return R @ np.linalg.solve(np.eye(3) - S / 2, np.eye(3) + S / 2)


def nearby(rng: np.random.Generator, problem: ForceProblem) -> dict[str, np.ndarray]:
    """Everything that a controller changes at a step, by some thousandths."""
    p = problem.contacts.p_OC + 1e-5 * rng.normal(size=problem.contacts.p_OC.shape)
    R = turned(rng, problem.contacts.R_OC)
    return {
        "w": problem.w * rng.uniform(0.998, 1.002, 6),
        "J": problem.actuation.J * rng.uniform(0.998, 1.002, problem.actuation.J.shape),
        "tau_u": problem.actuation.tau_u * rng.uniform(0.998, 1.002, len(problem.actuation.tau_u)),
        "p": p,
        "R": R,
    }


def numbers_of(problem: ForceProblem) -> dict[str, np.ndarray]:
    c, actuation = problem.contacts, problem.actuation
    return {"w": problem.w, "J": actuation.J, "tau_u": actuation.tau_u, "p": c.p_OC, "R": c.R_OC}


# ---- one truth in two languages -----------------------------------------------------------------------------------------


def measured_units(problem: ForceProblem) -> np.ndarray:
    arrays = structured.kernel_arrays(problem)
    structured.Kernel(**arrays).certify(0, 1)
    return arrays["units"][0]


def strange(rng: np.random.Generator, problem: ForceProblem) -> ForceProblem:
    """The same with what the units' law has cases for: no load, bias beyond a limit, idle joints, dead contacts, no weight."""
    actuation, c = problem.actuation, problem.contacts
    w = problem.w * (rng.random() < 0.7)
    if actuation is not None:
        J = actuation.J * (rng.random(actuation.J.shape[1]) < 0.8) * 10.0 ** rng.choice([0, 0, -15], actuation.J.shape[1])
        tau_u = actuation.tau_u * rng.choice([0.0, 1.0, 1e3], actuation.J.shape[1])
        actuation = Actuation(
            J, tau_u, actuation.lower, actuation.upper, actuation.weight * (rng.random(len(actuation.weight)) < 0.8)
        )
    dead = np.where(rng.random(len(c)) < 0.2, 0.0, c.max_normal)
    least = np.minimum(c.min_normal * (rng.random() < 0.5), dead)
    mu, gamma = c.mu * (rng.random(len(c)) < 0.8), c.gamma * (rng.random(len(c)) < 0.8)
    contacts = ContactSet(c.p_OC, c.R_OC, c.models, mu, gamma, least, dead)
    return ForceProblem(contacts, w, actuation, Cone(), problem.objective)


@pytest.mark.parametrize("seed", range(60))
def test_the_units_in_c_are_the_units(seed):
    """The law of scale.py, case by case; some tens of operations on a number leave it 1e-13 of itself."""
    rng = np.random.default_rng([50, seed])
    problem = random_problem(rng)
    while problem.objective.type in ("max_normal", "margin"):
        problem = random_problem(rng)
    for one in (strange(rng, problem), moved(strange(rng, problem), rng.normal(size=3))):
        unit, own = scale(one), measured_units(one)
        assert own[:3] == pytest.approx([unit.force, unit.length, unit.cost], rel=1e-13)
        assert own[3:] == pytest.approx(unit.torque, rel=1e-13)


def test_a_joint_beyond_its_limit_counts_beside_one_without_limit_or_load():
    """tau ≥ 1 on a lever of 5 cm asks for 20 N, whatever a second joint lacks."""
    problem = ForceProblem(
        random_contacts(np.random.default_rng(0), 1, ("point",)),
        np.zeros(6),
        Actuation([[0, 0], [0, 0], [0.05, 0]], lower=[1.0, None]),
    )
    assert (joint_lever_arms(problem) == [0.05, 0.0]).all()
    assert scale(problem).force == pytest.approx(20.0, rel=1e-14)
    assert measured_units(problem)[0] == pytest.approx(20.0, rel=1e-14)


@pytest.mark.parametrize("distance", [0.0, 1.0, 1e3])
def test_the_grasp_matrix_in_c_is_the_grasp_matrix(distance):
    """Where nothing else pulls, z = −Gᵀ y: a unit y shows a row. Far away both round the same differences of positions."""
    rng = np.random.default_rng([51, int(distance)])
    for _ in range(10):
        problem = moved(feasible_problem(rng), distance * rng.normal(size=3))
        problem = ForceProblem(problem.contacts, problem.w, objective=Objective("force"))
        arrays = structured.kernel_arrays(problem)
        kernel, answer, k = structured.Kernel(**arrays), arrays["answer"][0], problem.size
        for r in range(6):
            answer[:] = 0.0
            answer[k + r] = 1.0
            kernel.certify(0, 1)
            assert -answer[k + 6 : 2 * k + 6] == pytest.approx(problem.G_centred[r], rel=1e-13, abs=1e-15 * (1 + distance))


@pytest.mark.parametrize("density", [0.02, 0.1, 0.3])
def test_fingers_are_the_connected_components(density):
    """Contacts and joints as the two sides of a graph, an edge where J is not zero."""
    rng = np.random.default_rng(int(100 * density))
    for _ in range(100):
        components = rng.choice([1, 3, 4], size=rng.integers(1, 9)).astype(np.intc)
        J = rng.normal(size=(components.sum(), rng.integers(0, 12))) * (rng.random((components.sum(), 1)) < 0.9)
        J *= rng.random(J.shape) < density
        contact_block, joint_block = np.zeros(len(components), dtype=np.intc), np.zeros(J.shape[1], dtype=np.intc)
        largest = structured._fingers(components, J, contact_block, joint_block)
        owner = np.repeat(np.arange(len(components)), components)
        N, n = len(components), J.shape[1]
        rows, columns = np.nonzero(J)
        graph = sp.coo_matrix((np.ones(len(rows)), (owner[rows], N + columns)), shape=(N + n, N + n))
        label = connected_components(graph, directed=False)[1]
        same = contact_block[:, None] == contact_block
        assert (same == (label[:N, None] == label[:N])).all()
        for j in np.flatnonzero(J.any(axis=0)):
            assert (contact_block[label[:N] == label[N + j]] == joint_block[j]).all()
        assert (joint_block[~J.any(axis=0)] == contact_block[0]).all()
        assert set(contact_block) == set(range(contact_block.max() + 1))
        assert largest == max(components[contact_block == b].sum() for b in set(contact_block))


# ---- a solver that follows ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("names", [names for r in range(1, 6) for names in itertools.combinations(NAMES, r)], ids="-".join)
def test_following_changes_just_what_is_named(names):
    """The answer and its problem are those of the problem made afresh; what is not named stays as it was."""
    rng = np.random.default_rng([52, len(names), *(NAMES.index(name) for name in names)])
    for _ in range(3):
        problem = feasible_problem(rng)
        solver, afresh = Solver(problem, explain=False), problem
        solver.solve()
        for _ in range(3):
            given = {name: array for name, array in nearby(rng, afresh).items() if name in names}
            afresh = afresh.replace(**given)
            answer, other = solver.solve(**given), solve(afresh, explain=False)
            assert answer.status is other.status
            for name, array in numbers_of(answer.problem).items():
                assert np.array_equal(array, numbers_of(afresh)[name])
            if other.found:
                assert answer.objective == pytest.approx(other.objective, rel=2e-8, abs=2e-8 * scale(afresh).cost)
                assert answer.certificate.tolerance == other.certificate.tolerance


def test_most_steps_are_the_kernels_own():
    rng = np.random.default_rng(53)
    own = 0
    for _ in range(30):
        problem = feasible_problem(rng)
        solver = Solver(problem, explain=False)
        solver.solve()
        answer = solver.solve(**nearby(rng, problem))
        own += answer.backend == "structured" and structured.session(answer) is not None
    assert own >= 29


def test_an_answer_keeps_its_numbers_whatever_happens_to_the_arrays_it_was_given():
    rng = np.random.default_rng(54)
    problem = feasible_problem(rng)
    solver = Solver(problem)
    solver.solve()
    given = nearby(rng, problem)
    first = solver.solve(**given)
    copies = {name: array.copy() for name, array in given.items()}
    for array in given.values():
        array[:] = np.nan
    second = solver.solve(w=problem.w)
    for name, array in numbers_of(first.problem).items():
        assert np.array_equal(array, copies[name])
        assert not array.flags.writeable
        assert np.array_equal(numbers_of(second.problem)[name], problem.w if name == "w" else copies[name])
    assert first.torques == pytest.approx(second.problem.torques(first.f), rel=1e-12)
    with pytest.raises(ValueError, match="read-only"):
        first.f[0] = 1.0
    for name in ("status", "f", "problem", "certificate", "anything"):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(first, name, None)
    again = dataclasses.replace(first, seconds=0.0)
    assert (again.seconds, again.f is first.f, again.problem is first.problem) == (0.0, True, True)


def spoilt(array: np.ndarray, value: float) -> np.ndarray:
    array = array.copy()
    array.flat[array.size // 2] = value
    return array


@pytest.mark.parametrize("name", NAMES)
def test_what_is_no_plain_array_is_refused_in_words_or_converted(name):
    """The kernel takes plain arrays alone. All else goes through `replace`, with the words and conversions that it has."""
    rng = np.random.default_rng([55, NAMES.index(name)])
    problem = feasible_problem(rng)
    good = nearby(rng, problem)[name]
    solver = Solver(problem, explain=False)
    before = solver.solve().objective
    bad = [spoilt(good, x) for x in (np.nan, np.inf, -np.inf)]
    bad += [good[:-1], good.ravel()[:-1], good[None], good.astype(complex), good > 0, "w", {}, [good.tolist(), 1]]
    bad += [np.zeros(0), np.zeros((0, 6)), np.float64(1.0)]
    if name == "R":
        bad += [good * 1.01, -good, np.zeros_like(good)]
    if name == "p":
        bad += [1.5e308 * np.sign(good)]
    session = structured.session(solver._last_solution)
    for value in bad:
        arguments = [value if own == name else None for own in NAMES]
        assert session.solve_changed(0.0, *arguments) is None
        with pytest.raises(InvalidInput) as told:
            solver.solve(**{name: value})
        with pytest.raises(InvalidInput) as expected:
            problem.replace(**{name: value})
        assert str(told.value) == str(expected.value)
    assert solver.solve().objective == pytest.approx(before, rel=2e-8)
    wanted = solve(problem.replace(**{name: good}), explain=False).objective
    wide = np.zeros((*good.shape, 2))
    wide[..., 0] = good
    laid_out = (np.asfortranarray(good), wide[..., 0], wide[::-1, ..., 0][::-1], memoryview(good), good)
    for value in laid_out:
        taken = session.solve_changed(0.0, *(value if own == name else None for own in NAMES))
        assert np.array_equal(numbers_of(taken.problem)[name], good)
    for value in (*laid_out, good.tolist(), good.astype(">f8")):
        assert solver.solve(**{name: value}).objective == pytest.approx(wanted, rel=2e-8)


def test_a_matrix_that_is_nearly_a_rotation_is_as_good_as_ever():
    """Between 1e-10, where C is sure, and 1e-9, which `replace` allows, Python decides."""
    rng = np.random.default_rng(56)
    problem = feasible_problem(rng)
    solver = Solver(problem)
    solver.solve()
    nearly = problem.contacts.R_OC * (1 + 2e-10)
    assert structured.session(solver._last_solution).solve_changed(0.0, R=nearly) is None
    answer = solver.solve(R=nearly)
    assert np.array_equal(answer.problem.contacts.R_OC, nearly)
    assert answer.status is Status.OPTIMAL


def test_without_a_hand_there_is_nothing_to_move():
    problem = feasible_problem(np.random.default_rng(57))
    solver = Solver(ForceProblem(problem.contacts, problem.w))
    solver.solve()
    for changes in (
        {"J": problem.actuation.J},
        {"tau_u": problem.actuation.tau_u},
        {"J": np.zeros((problem.size, 0))},
        {"tau_u": []},
    ):
        with pytest.raises(InvalidInput, match="given before its jacobian or bias_torque can change"):
            solver.solve(**changes)
    assert solver.solve(w=problem.w * 1.01).found


def test_contacts_may_lie_in_memory_as_they_like():
    """A set of contacts is taken as it is; a solver follows from it all the same."""
    problem = feasible_problem(np.random.default_rng(61))
    c = problem.contacts
    wide = [np.stack([x, x], axis=-1)[..., 0] for x in (c.p_OC, c.R_OC, c.mu, c.gamma, c.min_normal, c.max_normal)]
    contacts = ContactSet(*wide[:2], c.models, *wide[2:])
    solver = Solver(ForceProblem(contacts, problem.w, problem.actuation, objective=problem.objective))
    assert solver.solve().objective == pytest.approx(solve(problem).objective, rel=2e-8)
    answer = solver.solve(w=0.999 * problem.w)
    assert answer.backend == "structured"
    assert np.array_equal(answer.problem.contacts.R_OC, c.R_OC)


def test_pyramids_follow_too():
    problem = feasible_problem(np.random.default_rng(58), ("point",))
    problem = ForceProblem(problem.contacts, problem.w, problem.actuation, Cone("pyramid", 8, "inner"))
    solver = Solver(problem)
    solver.solve()
    for _ in range(3):
        given = {name: array for name, array in nearby(np.random.default_rng(59), problem).items() if name != "R"}
        answer = solver.solve(**given)
        assert answer.certificate.verified
        assert answer.objective == pytest.approx(solve(problem.replace(**given), "clarabel").objective, rel=2e-8)


# ---- the binding --------------------------------------------------------------------------------------------------------


def test_a_kernel_that_is_not_bound_does_nothing():
    """Neither before it has its arrays nor after it was given some that do not fit."""
    arrays = structured.kernel_arrays(feasible_problem(np.random.default_rng(60)))
    bad = {
        "w must hold 6 numbers": {"w": np.zeros(5)},
        "either G is given, or p and R": {"p": None},
        "p must hold": {"p": np.zeros((1, 3))},
        "finite G": {"p": 1.5e308 * np.sign(arrays["p"])},
    }
    for words, changes in bad.items():
        half = structured.Kernel.__new__(structured.Kernel)
        with pytest.raises(ValueError, match=words):
            half.__init__(**{**arrays, **changes})
        for call in (lambda: half.solve(0, 1, 1e-9, 60, False), lambda: half.certify(0, 1)):  # noqa: B023
            with pytest.raises(RuntimeError, match="not bound"):
                call()
    right = (np.full(3, 3, np.intc), np.zeros((9, 2)), np.zeros(3, np.intc), np.zeros(2, np.intc))
    assert structured._fingers(*right) == 3
    wrong = {0: np.full(3, -1, np.intc), 1: np.zeros((8, 2)), 2: np.array(1, np.intc), 3: np.zeros(2)}
    for at, array in wrong.items():
        with pytest.raises(ValueError, match="a row for each component"):
            structured._fingers(*right[:at], array, *right[at + 1 :])


def test_a_solver_that_two_threads_ask_at_once_says_so_or_answers():
    """Who comes while another's answer is on its way is told so in words; who gets an answer gets a proven one."""
    rng = np.random.default_rng(17)
    contacts = ContactSet.stack(random_contacts(rng, 60, ("point",)))
    f = inner_forces(rng, contacts, share=0.6)
    problem = ForceProblem(contacts, grasp_matrix(contacts) @ f, random_actuation(rng, contacts, f))
    solver = Solver(problem, explain=False)
    assert solver.solve().found
    begin, told, answered = threading.Barrier(2), [], []

    def ask() -> None:
        begin.wait()
        for _ in range(200):
            try:
                answered.append(solver.solve(w=problem.w).status)
            except BackendError as error:
                told.append(str(error))

    threads = [threading.Thread(target=ask) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(told) + len(answered) == 400  # nothing else was raised
    assert set(answered) == {Status.OPTIMAL}
    assert all("each thread needs a Solver of its own" in text for text in told)


def test_a_follower_refuses_what_is_no_problem():
    """It is made of a problem or not at all; after a problem that does not fit it waits for one that does."""
    problem = feasible_problem(np.random.default_rng(62))
    numbers, columns = structured._kernel_inputs(problem), problem.contacts.columns
    follower = structured.IncrementalKernel(48, columns, None, *numbers)
    none = [None] * 5
    wanted = follower.step(1e-9, 60, False, *none)
    bad = {"w must hold 6": {0: np.zeros(5)}, "J must hold": {1: np.zeros((2, 2))}, "p must hold": {3: np.zeros((1, 3))}}
    bad |= {"finite G": {3: 1.5e308 * np.sign(numbers[3])}, "mu must hold": {5: numbers[5].astype(np.float32)}}
    for words, changes in bad.items():
        wrong = [changes.get(i, array) for i, array in enumerate(numbers)]
        with pytest.raises(ValueError, match=words):
            follower.load(*wrong)
        with pytest.raises(RuntimeError, match="no problem is loaded"):
            follower.step(1e-9, 60, False, *none)
        assert follower.load(*numbers)
        assert follower.step(1e-9, 60, False, *none) == wanted
        with pytest.raises(ValueError, match="must"):
            structured.IncrementalKernel(48, columns, None, *wrong)
    for wrong_columns in (columns[1:], columns + 1, columns.astype(np.int32), columns[:0], None, columns[::-1].copy()):
        with pytest.raises(ValueError, match=r"columns|fingers"):
            structured.IncrementalKernel(48, wrong_columns, None, *numbers)
    with pytest.raises(OverflowError, match="at most 2 force components that share joints"):
        structured.IncrementalKernel(2, columns, None, *numbers)
    for call in (follower.load, follower.step, structured.IncrementalKernel, structured._record):
        with pytest.raises(TypeError, match="takes"):
            call(1, 2)


def test_a_jacobian_that_couples_other_fingers_is_not_followed_but_answered():
    """C keeps J within the fingers that it found; another pattern makes another kernel, and one that fits goes on with it."""
    rng = np.random.default_rng(63)
    for _ in range(10):
        problem = feasible_problem(rng, ("point",))
        solver = Solver(problem, explain=False)
        solver.solve()
        session = structured.session(solver._last_solution)
        outside = np.argwhere(~session.finger_mask())
        coupled = problem.actuation.J.copy()
        coupled[tuple(outside[rng.integers(len(outside))])] = 1e-3
        assert session.solve_changed(0.0, J=coupled) is None
        assert not session.load(problem.replace(J=coupled))
        answer, other = solver.solve(J=coupled), solve(problem.replace(J=coupled), "clarabel", explain=False)
        assert (answer.status, answer.backend) == (other.status, "structured" if other.found else answer.backend)
        assert answer.objective == pytest.approx(other.objective, rel=2e-8)
        assert np.array_equal(answer.problem.actuation.J, coupled)
        again = solver.solve(J=0.999 * coupled)
        assert (again.backend, structured.session(again)) == ("structured", structured.session(answer))
        minus = np.where(problem.actuation.J == 0.0, -0.0, problem.actuation.J)
        assert session.solve_changed(0.0, J=minus) is not None


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
def test_binding_under_sanitizers(tmp_path):
    """The whole extension in a build with both sanitizers, under an interpreter that gives it wrong lengths and bad numbers."""
    library = subprocess.run(
        [COMPILER, "-print-file-name=libasan.so"], capture_output=True, text=True, check=False
    ).stdout.strip()
    if not os.path.isabs(library):
        pytest.skip("this compiler has no shared sanitizer")
    module = tmp_path / ("_structured" + str(sysconfig.get_config_var("EXT_SUFFIX")))
    names = ("python/structured_module.c", "kernel/solve.c", "kernel/certify.c", "kernel/grasp_matrix.c", "kernel/strings.c")
    flags = [
        "-std=c11",
        "-O0",
        "-g",
        "-fPIC",
        "-shared",
        "-Wno-psabi",
        "-fsanitize=address,undefined",
        "-fno-sanitize-recover=all",
    ]
    include = f"-I{sysconfig.get_paths()['include']}"
    subprocess.run(
        [
            COMPILER,
            *flags,
            include,
            f"-I{SOURCES / 'include'}",
            *(str(SOURCES / name) for name in names),
            "-lm",
            "-o",
            str(module),
        ],
        check=True,
    )
    fuzz = Path(__file__).with_name("binding_fuzz.py")
    # The interpreter itself keeps what it has until it ends: leaks are not looked for.
    environment = {**os.environ, "LD_PRELOAD": library, "ASAN_OPTIONS": "detect_leaks=0", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, str(fuzz), str(module), "400"],
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    taken, refused, raised = map(int, done.stdout.split())
    assert min(taken, refused, raised) > 100  # the driver reaches every kind of end
