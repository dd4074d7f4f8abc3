"""Natural units, grasp matrix and fingers in C: equal to their references in Python."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components
from support.incremental_cases import feasible_problem, move_origin
from support.random_problems import random_contacts, random_problem

from graspforce import Actuation, Cone, ContactSet, ForceProblem, Objective
from graspforce.force.backends import compiled_kernel
from graspforce.force.scale import joint_lever_arms, scale

if not compiled_kernel.is_available():
    pytest.skip("the kernel was not built: no C compiler at installation", allow_module_level=True)


def measured_units(problem: ForceProblem) -> dict[str, np.ndarray]:
    """Return the natural units that C computes."""
    arrays = compiled_kernel.kernel_arrays(problem)
    compiled_kernel.Kernel(**arrays).certify(0, 1)
    return {name: arrays[f"{name}_unit"][0] for name in ("force", "length", "cost", "torque")}


def with_special_cases(rng: np.random.Generator, problem: ForceProblem) -> ForceProblem:
    """Return a problem with special cases of the units: zero load, bias beyond a limit, idle joints, contacts without force."""
    actuation, c = problem.actuation, problem.contacts
    w = problem.w * (rng.random() < 0.7)
    if actuation is not None:
        n = actuation.J.shape[1]
        J = actuation.J * (rng.random(n) < 0.8) * 10.0 ** rng.choice([0, 0, -15], n)
        tau_u = actuation.tau_u * rng.choice([0.0, 1.0, 1e3], n)
        weight = actuation.weight * (rng.random(n) < 0.8)
        actuation = Actuation(J, tau_u, actuation.lower, actuation.upper, weight)
    max_normal = np.where(rng.random(len(c)) < 0.2, 0.0, c.max_normal)
    min_normal = np.minimum(c.min_normal * (rng.random() < 0.5), max_normal)
    mu, gamma = c.mu * (rng.random(len(c)) < 0.8), c.gamma * (rng.random(len(c)) < 0.8)
    contacts = ContactSet(c.p_OC, c.R_OC, c.models, mu, gamma, min_normal, max_normal)
    return ForceProblem(contacts, w, actuation, Cone(), problem.objective)


@pytest.mark.parametrize("seed", range(60))
def test_natural_units_equal_their_reference_in_python(seed):
    """Some tens of operations leave each number right to 1e-13."""
    rng = np.random.default_rng([50, seed])
    problem = random_problem(rng)
    while problem.objective.type in ("max_normal", "margin"):
        problem = random_problem(rng)
    for case in (with_special_cases(rng, problem), move_origin(with_special_cases(rng, problem), rng.normal(size=3))):
        expected, measured = scale(case), measured_units(case)
        for name in ("force", "length", "cost"):
            assert measured[name] == pytest.approx(getattr(expected, name), rel=1e-13)
        assert measured["torque"] == pytest.approx(expected.torque, rel=1e-13)


def test_force_unit_relieves_a_joint_beyond_its_limit():
    """tau ≥ 1 N·m on a lever arm of 5 cm needs 20 N, even beside a joint without limits and lever arm."""
    problem = ForceProblem(
        random_contacts(np.random.default_rng(0), 1, ("point",)),
        np.zeros(6),
        Actuation([[0, 0], [0, 0], [0.05, 0]], lower=[1.0, None]),
    )
    assert (joint_lever_arms(problem) == [0.05, 0.0]).all()
    assert scale(problem).force == pytest.approx(20.0, rel=1e-14)
    assert measured_units(problem)["force"] == pytest.approx(20.0, rel=1e-14)


@pytest.mark.parametrize("distance", [0.0, 1.0, 1e3])
def test_grasp_matrix_equals_its_reference_in_python(distance):
    """Without other prices z = −Gᵀ y, so each unit vector y shows a row of G. Both round the same differences of positions."""
    rng = np.random.default_rng([51, int(distance)])
    for _ in range(10):
        problem = move_origin(feasible_problem(rng), distance * rng.normal(size=3))
        problem = ForceProblem(problem.contacts, problem.w, objective=Objective("force"))
        arrays = compiled_kernel.kernel_arrays(problem)
        kernel = compiled_kernel.Kernel(**arrays)
        for r in range(6):
            arrays["y"][0] = np.eye(6)[r]
            kernel.certify(0, 1)
            assert -arrays["z"][0] == pytest.approx(problem.G_centred[r], rel=1e-13, abs=1e-15 * (1 + distance))


@pytest.mark.parametrize("density", [0.02, 0.1, 0.3])
def test_fingers_are_the_connected_components_of_J(density):
    """Contacts and joints are the two sides of a graph, linked where J is not zero."""
    rng = np.random.default_rng(int(100 * density))
    for _ in range(100):
        components = rng.choice([1, 3, 4], size=rng.integers(1, 9)).astype(np.intc)
        J = rng.normal(size=(components.sum(), rng.integers(0, 12))) * (rng.random((components.sum(), 1)) < 0.9)
        J *= rng.random(J.shape) < density
        N, n = len(components), J.shape[1]
        contact_block, joint_block = np.zeros(N, dtype=np.intc), np.zeros(n, dtype=np.intc)
        largest = compiled_kernel.find_fingers(components, J, contact_block, joint_block)
        owner = np.repeat(np.arange(N), components)
        rows, columns = np.nonzero(J)
        graph = sp.coo_matrix((np.ones(len(rows)), (owner[rows], N + columns)), shape=(N + n, N + n))
        label = connected_components(graph, directed=False)[1]
        assert ((contact_block[:, None] == contact_block) == (label[:N, None] == label[:N])).all()
        for j in np.flatnonzero(J.any(axis=0)):
            assert (contact_block[label[:N] == label[N + j]] == joint_block[j]).all()
        assert (joint_block[~J.any(axis=0)] == contact_block[0]).all()
        assert set(contact_block) == set(range(contact_block.max() + 1))
        assert largest == max(components[contact_block == b].sum() for b in set(contact_block))


def test_find_fingers_rejects_arrays_that_do_not_fit():
    right = (np.full(3, 3, np.intc), np.zeros((9, 2)), np.zeros(3, np.intc), np.zeros(2, np.intc))
    assert compiled_kernel.find_fingers(*right) == 3
    wrong = {0: np.full(3, -1, np.intc), 1: np.zeros((8, 2)), 2: np.array(1, np.intc), 3: np.zeros(2)}
    for at, array in wrong.items():
        with pytest.raises(ValueError, match="a row for each component"):
            compiled_kernel.find_fingers(*right[:at], array, *right[at + 1 :])
