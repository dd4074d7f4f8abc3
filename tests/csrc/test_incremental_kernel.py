"""The incremental kernel in a `Solver`: each step changes the named arrays only, and its solution equals a new one."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from support.incremental_cases import CHANGEABLE, change_slightly, changeable_arrays, feasible_problem, kernel_changes

from graspforce import Cone, ContactSet, ForceProblem, InvalidInput, Solver, Status, solve
from graspforce.force.backends import compiled_kernel
from graspforce.force.scale import scale

if not compiled_kernel.is_available():
    pytest.skip("the kernel was not built: no C compiler at installation", allow_module_level=True)


@pytest.mark.parametrize("names", [c for r in range(1, 8) for c in itertools.combinations(CHANGEABLE, r)], ids="-".join)
def test_step_changes_the_named_arrays_only(names):
    """The solution and its problem equal those of a new problem."""
    rng = np.random.default_rng([52, len(names), *(CHANGEABLE.index(name) for name in names)])
    for _ in range(3):
        expected = feasible_problem(rng)
        solver = Solver(expected, explain=False)
        solver.solve()
        for _ in range(3):
            changes = {name: array for name, array in change_slightly(rng, expected).items() if name in names}
            expected = expected.replace(**changes)
            answer, other = solver.solve(**changes), solve(expected, explain=False)
            assert answer.status is other.status
            for name, array in changeable_arrays(answer.problem).items():
                assert np.array_equal(array, changeable_arrays(expected)[name])
            if other.found:
                assert answer.objective == pytest.approx(other.objective, rel=2e-8, abs=2e-8 * scale(expected).cost)
                assert answer.certificate.tolerance == other.certificate.tolerance


def test_nearly_all_steps_need_no_other_solver():
    rng = np.random.default_rng(53)
    own = 0
    for _ in range(30):
        problem = feasible_problem(rng)
        solver = Solver(problem, explain=False)
        solver.solve()
        answer = solver.solve(**change_slightly(rng, problem))
        own += answer.backend == "structured" and solver._session is not None
    assert own >= 29


def test_solution_does_not_share_memory_with_the_arrays_given():
    """A solution keeps its numbers, read-only, when the caller overwrites the arrays and when the solver goes on."""
    rng = np.random.default_rng(54)
    problem = feasible_problem(rng)
    solver = Solver(problem)
    solver.solve()
    changes = change_slightly(rng, problem)
    first = solver.solve(**changes)
    copies = {name: array.copy() for name, array in changes.items()}
    for array in changes.values():
        array[:] = np.nan
    second = solver.solve(w=problem.w)
    for name, array in changeable_arrays(first.problem).items():
        assert np.array_equal(array, copies[name])
        assert not array.flags.writeable
        assert np.array_equal(changeable_arrays(second.problem)[name], problem.w if name == "w" else copies[name])
    assert first.torques == pytest.approx(second.problem.torques(first.f), rel=1e-12)
    with pytest.raises(ValueError, match="read-only"):
        first.f[0] = 1.0
    for name in ("status", "f", "problem", "certificate", "anything"):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(first, name, None)
    again = dataclasses.replace(first, seconds=0.0)
    assert (again.seconds, again.f is first.f, again.problem is first.problem) == (0.0, True, True)


def with_number(array: np.ndarray, value: float) -> np.ndarray:
    array = array.copy()
    array.flat[array.size // 2] = value
    return array


@pytest.mark.parametrize("name", CHANGEABLE)
def test_kernel_takes_plain_arrays_and_leaves_all_else_to_replace(name):
    """`ForceProblem.replace` converts what can be converted and raises its own errors for the rest."""
    rng = np.random.default_rng([55, CHANGEABLE.index(name)])
    problem = feasible_problem(rng)
    good = change_slightly(rng, problem)[name]
    solver = Solver(problem, explain=False)
    before = solver.solve().objective
    bad = [with_number(good, x) for x in (np.nan, np.inf, -np.inf)[:: 2 if name == "normal_limits" else 1]]
    bad += [good[:-1], good.ravel()[:-1], good[None], good.astype(complex), good > 0, "w", {}, [good.tolist(), 1]]
    bad += [np.zeros(0), np.zeros((0, 6)), np.float64(1.0)]
    if name == "R":
        bad += [good * 1.01, -good, np.zeros_like(good)]
    if name == "p":
        bad += [1.5e308 * np.sign(good)]
    if name in ("mu", "normal_limits"):
        bad += [-1e-9 - good, with_number(good, -1e-9)]
    if name == "normal_limits":
        bad += [good[::-1] + 1.0, np.full(good.shape, np.inf)]
    session = solver._session
    for value in bad:
        if name not in ("mu", "normal_limits"):
            assert session.solve_arrays(0.0, *kernel_changes(**{name: value})) is None
        with pytest.raises(InvalidInput) as raised:
            solver.solve(**{name: value})
        with pytest.raises(InvalidInput) as expected:
            problem.replace(**{name: value})
        assert str(raised.value) == str(expected.value)
    assert solver.solve().objective == pytest.approx(before, rel=2e-8)
    objective = solve(problem.replace(**{name: good}), explain=False).objective
    wide = np.zeros((*good.shape, 2))
    wide[..., 0] = good
    layouts = (np.asfortranarray(good), wide[..., 0], wide[::-1, ..., 0][::-1], memoryview(good), good)
    for value in layouts:
        answer = session.solve_arrays(0.0, *kernel_changes(**{name: value}))
        assert np.array_equal(changeable_arrays(answer.problem)[name], good)
    for value in (*layouts, good.tolist(), good.astype(">f8")):
        assert solver.solve(**{name: value}).objective == pytest.approx(objective, rel=2e-8)


def test_near_rotations_are_accepted_by_way_of_replace():
    """C accepts rotations to 1e-10. Up to the tolerance of `replace`, Python decides."""
    rng = np.random.default_rng(56)
    problem = feasible_problem(rng)
    solver = Solver(problem)
    solver.solve()
    R = problem.contacts.R_OC * (1 + 2e-10)
    assert solver._session.solve_arrays(0.0, *kernel_changes(R=R)) is None
    answer = solver.solve(R=R)
    assert np.array_equal(answer.problem.contacts.R_OC, R)
    assert answer.status is Status.OPTIMAL


def test_step_rejects_hand_arrays_without_a_hand():
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


def test_contact_arrays_may_have_any_strides():
    problem = feasible_problem(np.random.default_rng(61))
    c = problem.contacts
    strided = [np.stack([x, x], axis=-1)[..., 0] for x in (c.p_OC, c.R_OC, c.mu, c.gamma, c.min_normal, c.max_normal)]
    contacts = ContactSet(*strided[:2], c.models, *strided[2:])
    solver = Solver(ForceProblem(contacts, problem.w, problem.actuation, objective=problem.objective))
    assert solver.solve().objective == pytest.approx(solve(problem).objective, rel=2e-8)
    answer = solver.solve(w=0.999 * problem.w)
    assert answer.backend == "structured"
    assert np.array_equal(answer.problem.contacts.R_OC, c.R_OC)


def test_steps_with_pyramids_agree_with_clarabel():
    problem = feasible_problem(np.random.default_rng(58), ("point",))
    problem = ForceProblem(problem.contacts, problem.w, problem.actuation, Cone("pyramid", 8, "inner"))
    solver = Solver(problem)
    solver.solve()
    for _ in range(3):
        changes = {name: array for name, array in change_slightly(np.random.default_rng(59), problem).items() if name != "R"}
        answer = solver.solve(**changes)
        assert answer.certificate.verified
        assert answer.objective == pytest.approx(solve(problem.replace(**changes), "clarabel").objective, rel=2e-8)


def test_jacobian_that_couples_other_fingers_gets_a_new_kernel():
    """The kernel stores J within the fingers that it found. Later Jacobians of the new structure use the new kernel."""
    rng = np.random.default_rng(63)
    for _ in range(10):
        problem = feasible_problem(rng, ("point",))
        solver = Solver(problem, explain=False)
        solver.solve()
        session = solver._session
        outside = np.argwhere(~session._result.finger_mask())
        coupled = problem.actuation.J.copy()
        coupled[tuple(outside[rng.integers(len(outside))])] = 1e-3
        assert session.solve_arrays(0.0, *kernel_changes(J=coupled)) is None
        assert not session.load(problem.replace(J=coupled))
        answer, other = solver.solve(J=coupled), solve(problem.replace(J=coupled), "clarabel", explain=False)
        assert (answer.status, answer.backend) == (other.status, "structured" if other.found else answer.backend)
        assert answer.objective == pytest.approx(other.objective, rel=2e-8)
        assert np.array_equal(answer.problem.actuation.J, coupled)
        again = solver.solve(J=0.999 * coupled)
        assert (again.backend, solver._session) == ("structured", session)
        negative_zeros = np.where(problem.actuation.J == 0.0, -0.0, problem.actuation.J)
        assert session.solve_arrays(0.0, *kernel_changes(J=negative_zeros)) is not None
