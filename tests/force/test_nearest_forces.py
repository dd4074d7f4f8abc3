"""Forces with the nearest wrench, by the kernel and by Clarabel: analytical cases and random problems."""

from __future__ import annotations

import numpy as np
import pytest
from support.random_problems import inner_forces, random_actuation, random_contacts

from graspforce import Actuation, Contact, ContactSet, ForceProblem, solve
from graspforce.contact.matrices import characteristic_length, grasp_matrix
from graspforce.core.arrays import Array
from graspforce.force.backends import compiled_kernel
from graspforce.force.certificate import certify
from graspforce.force.multipliers import Multipliers
from graspforce.force.nearest_forces import NearestForces

# The kernel's cost of torques moves the wrench by a thousandth of the force, and of the distance.
ACCURACY = 2e-3


@pytest.fixture(params=["kernel", "general"], autouse=True)
def solver(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Run each test with the kernel, and as if it had not been built."""
    if request.param == "general":
        monkeypatch.setattr(compiled_kernel, "Kernel", None)
    elif not compiled_kernel.is_available():
        pytest.skip("the kernel was not built: no C compiler at installation")
    return request.param


def nearest(problem: ForceProblem) -> tuple[Array, float] | None:
    """Return the forces with the nearest wrench, and their distance, N."""
    contacts, actuation = problem.contacts, problem.actuation
    limits, friction = np.array([contacts.min_normal, contacts.max_normal]), np.array([contacts.mu, contacts.gamma])
    numbers = problem.w, actuation.J, actuation.tau_u, contacts.p_OC, contacts.R_OC, friction, limits
    return NearestForces(problem).solve(*numbers)


def violation(problem: ForceProblem, f: Array) -> float:
    """Return the largest violation of cones and limits by forces, relative, apart from equilibrium."""
    balanced = problem.replace(w=grasp_matrix(problem.contacts) @ f)
    n, N = len(problem.actuation.tau_u), len(problem.contacts)
    none = Multipliers(np.zeros(6), np.zeros(N), np.zeros(N), np.zeros(n), np.zeros(n), np.zeros(N))
    return certify(balanced, f, none).primal_residual


def two_fingers(w: Array, most: float = 10.0) -> ForceProblem:
    """Return two opposite contacts with μ = 0.5, 1 cm from O on the y axis."""
    contacts = [Contact([0, y, 0], [0, -y, 0], 0.5, max_normal=most) for y in (-0.01, 0.01)]
    return ForceProblem(contacts, w, Actuation(np.zeros((6, 1)), [0.0]))


def test_load_beyond_friction_is_borne_as_far_as_it_goes() -> None:
    """Each finger carries μ 10 N = 5 N; 2 N of the weight of 12 N are missing."""
    f, distance = nearest(two_fingers([0, 0, 12.0, 0, 0, 0]))
    assert distance == pytest.approx(2.0, rel=ACCURACY)
    np.testing.assert_allclose(grasp_matrix(two_fingers(np.zeros(6)).contacts) @ f, [0, 0, 10, 0, 0, 0], atol=12 * ACCURACY)


def test_moment_about_the_line_between_two_points_is_missing() -> None:
    """The weight is borne; the moment of 0.01 N·m, over the length of 1 cm, is missing."""
    problem = two_fingers([0, 0, 3.0, 0, 0.01, 0])
    f, distance = nearest(problem)
    assert distance == pytest.approx(0.01 / characteristic_length(problem.contacts), rel=ACCURACY)
    np.testing.assert_allclose((grasp_matrix(problem.contacts) @ f)[:3], [0, 0, 3], atol=3 * ACCURACY)


def test_supplied_wrench_is_at_no_distance() -> None:
    _, distance = nearest(two_fingers([0.1, 0.0, 3.0, 0, 0, 0.001]))
    assert distance == pytest.approx(0.0, abs=3 * ACCURACY)


def test_distance_is_that_of_the_explained_infeasibility() -> None:
    """`solve` finds the nearest wrench of an infeasible problem by Clarabel; forces stay in their cones and limits."""
    rng, infeasible = np.random.default_rng(95), 0
    for _ in range(12):
        contacts = ContactSet.stack(random_contacts(rng, int(rng.integers(2, 6))))
        f = inner_forces(rng, contacts, share=0.6)
        w = grasp_matrix(contacts) @ f + 20.0 * rng.normal(size=6) * [1, 1, 1, 0.05, 0.05, 0.05]
        problem = ForceProblem(contacts, w, random_actuation(rng, contacts, f))
        found, distance = nearest(problem)
        assert violation(problem, found) < 1e-6
        missing = problem.w_centred - problem.G_centred @ found
        missing[3:] /= problem.length
        assert distance == pytest.approx(np.linalg.norm(missing), rel=1e-9)
        answer = solve(problem, "clarabel")
        if answer.infeasibility is None or answer.infeasibility.nearest_wrench is None:
            continue
        gap = problem.replace(w=w - answer.infeasibility.nearest_wrench).w_centred
        gap[3:] /= problem.length
        scale = np.linalg.norm(problem.w_centred[:3])
        assert distance == pytest.approx(np.linalg.norm(gap), abs=ACCURACY * scale)
        infeasible += 1
    assert infeasible >= 6


def test_contradicting_limits_allow_no_forces() -> None:
    """A motor without contact beyond its limit."""
    problem = two_fingers([0, 0, 1.0, 0, 0, 0])
    broken = ForceProblem(problem.contacts, problem.w, Actuation(np.zeros((6, 1)), [2.0], [-1.0], [1.0]))
    assert nearest(broken) is None
