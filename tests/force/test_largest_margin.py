"""The largest slip margin, by the kernel and by Clarabel: an analytical case, random problems, and problems without limits."""

from __future__ import annotations

import numpy as np
import pytest
from support.random_problems import inner_forces, random_actuation, random_contacts

from graspforce import Actuation, Contact, ContactSet, ForceProblem, Objective, solve
from graspforce.contact.matrices import grasp_matrix
from graspforce.force import largest_margin
from graspforce.force.backends import compiled_kernel
from graspforce.force.largest_margin import LargestMargin

# Both solvers stop at 1e-9 of their scaled residuals; the margins are up to a hundred times the scaled units.
ACCURACY = 1e-6


@pytest.fixture(params=["kernel", "general"], autouse=True)
def solver(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Run each test with the kernel, and as if it had not been built."""
    if request.param == "general":
        monkeypatch.setattr(compiled_kernel, "Kernel", None)
    elif not compiled_kernel.is_available():
        pytest.skip("the kernel was not built: no C compiler at installation")
    return request.param


def largest(problem: ForceProblem, limit: float, solver: LargestMargin | None = None) -> float | None:
    """Return the largest margin of a problem, N."""
    contacts, actuation = problem.contacts, problem.actuation
    limits, friction = np.array([contacts.min_normal, contacts.max_normal]), np.array([contacts.mu, contacts.gamma])
    numbers = problem.w, actuation.J, actuation.tau_u, contacts.p_OC, contacts.R_OC, friction, limits
    return (solver or LargestMargin(problem, limit)).solve(*numbers)


def random_problem(rng: np.random.Generator) -> ForceProblem:
    """Return a problem with a hand and all contact models, O away from the contacts; some cannot be held."""
    contacts = random_contacts(rng, int(rng.integers(2, 7)))
    contacts[0] = Contact(contacts[0].position, contacts[0].normal, 0.5, max_normal=20.0)  # rough and bounded
    contacts = ContactSet.stack(contacts)
    f = inner_forces(rng, contacts, share=0.6)
    w = grasp_matrix(contacts) @ f * (1.0 if rng.random() < 0.8 else 30.0)
    return ForceProblem(contacts, w, random_actuation(rng, contacts, f)).replace(p=contacts.p_OC)


def two_fingers(weight: float, most: float | None, mu: float = 0.5, **contact: object) -> ForceProblem:
    """Return two opposite contacts, 1 cm from O, that carry a weight."""
    contacts = [Contact([0, y, 0], [0, -y, 0], mu, max_normal=most, **contact) for y in (-0.01, 0.01)]
    return ForceProblem(contacts, [0, 0, weight, 0, 0, 0], Actuation(np.zeros((6 + 2 * bool(contact), 1)), [0.0]))


@pytest.mark.parametrize("weight", [0.0, 1e-9, 3.0, 9.9])
def test_margin_of_two_fingers_is_their_friction_less_half_the_weight(weight: float) -> None:
    for limit in (0.1, 100.0):
        assert largest(two_fingers(weight, 10.0), limit) == pytest.approx(min(limit, 5.0 - weight / 2), abs=ACCURACY)
    assert largest(two_fingers(10.1, 10.0), 1.0) is None


def test_moment_of_soft_contacts_counts_in_the_margin() -> None:
    """Each contact transmits half of a moment about the line between them: the load is μ m/γ."""
    problem = two_fingers(0.0, 10.0, model="soft", torsional_friction=0.01).replace(w=[0, 0, 0, 0, 0.08, 0])
    assert largest(problem, 100.0) == pytest.approx(5.0 - 0.5 * 0.04 / 0.01, abs=ACCURACY)


def test_margin_equals_that_of_the_margin_objective() -> None:
    """Clarabel solves ‖f_t‖ ≤ μ f_n − s as it stands, without the shift of the normal forces."""
    rng, found = np.random.default_rng(91), 0
    for _ in range(40):
        problem = random_problem(rng)
        margin = largest(problem, 1e3)
        direct = ForceProblem(problem.contacts, problem.w, problem.actuation, objective=Objective("margin"))
        reference = solve(direct, "clarabel", explain=False)
        assert (margin is not None) == reference.found
        if margin is not None:
            assert margin == pytest.approx(reference.objective, abs=ACCURACY * max(1.0, reference.objective))
            found += 1
    assert 25 <= found < 40


def test_changed_numbers_give_the_margin_of_a_new_problem() -> None:
    rng = np.random.default_rng(92)
    problem = two_fingers(1.0, 10.0)
    solver = LargestMargin(problem, 100.0)
    for _ in range(10):
        limits = [[0.0, 0.0], 10.0 ** rng.uniform(0.0, 1.0, 2)]
        changed = problem.replace(w=problem.w * rng.uniform(0.0, 0.5), mu=rng.uniform(0.3, 0.9, 2), normal_limits=limits)
        assert largest(changed, 100.0, solver) == pytest.approx(largest(changed, 100.0), abs=ACCURACY)


def test_margin_without_limits_is_the_largest_of_interest_or_zero(solver: str) -> None:
    """Without a limit on the forces every margin is feasible; the general solver then has no bounded problem."""
    assert largest(two_fingers(1.0, None), 7.0) == pytest.approx(7.0 if solver == "kernel" else 0.0, abs=ACCURACY)


def test_contact_without_normal_force_has_no_margin_of_its_own() -> None:
    """The third contact may not press; the margin is that of the other two, if the third needs none."""
    problem = two_fingers(2.0, 10.0)
    third = Contact([0, 0, 0.01], [0, 0, -1], 0.0, max_normal=0.0)
    contacts = [*problem.contacts.contacts, third]
    held = ForceProblem(contacts, problem.w, Actuation(np.zeros((9, 1)), [0.0]))
    assert largest(held, 100.0) == pytest.approx(4.0, abs=ACCURACY)


def test_margin_without_friction_is_zero() -> None:
    assert largest(two_fingers(0.0, 10.0, mu=0.0), 1.0) == 0.0


def test_failure_of_the_kernel_falls_back_to_the_general_solver(solver: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if solver == "kernel":
        problem, failed = two_fingers(1.0, 10.0), largest_margin.Status.FAILED
        own = LargestMargin(problem, 1.0)
        monkeypatch.setattr(own._kernel, "solve", lambda *_: (failed, np.nan))
        assert largest(problem, 1.0, own) == pytest.approx(1.0, abs=ACCURACY)
