"""Feasible loads without forces strictly inside all cones: each marked case has a proof, and unmarked ones have such forces."""

from __future__ import annotations

import numpy as np
import pytest

import graspforce as gf
from graspforce import problems
from graspforce.bench.export.tags import case_tags
from graspforce.bench.library_check import excludes_interior
from graspforce.problems.case import Case, ExpectedOptimum
from graspforce.problems.generators.no_interior import find_proof

NEAR = [name for name in problems.names("hard") if "/near-" in name]


def is_marked(case: Case) -> bool:
    return isinstance(case.expected, ExpectedOptimum) and case.expected.no_interior is not None


def shrunk(problem: gf.ForceProblem, share: float) -> gf.ForceProblem:
    """Return the problem with all cones and limits smaller by a share of their range: its forces are interior."""
    c, a = problem.contacts, problem.actuation
    limits = np.array([share * c.max_normal, (1.0 - share) * c.max_normal])
    inner = problem.replace(mu=(1.0 - share) * c.mu, normal_limits=limits)
    if a is None:
        return inner
    width = share * (a.upper - a.lower)
    actuation = gf.Actuation(a.J, a.tau_u, a.lower + width, a.upper - width, a.weight)
    return gf.ForceProblem(inner.contacts, inner.w, actuation, objective=inner.objective)


def test_marked_cases_have_a_proof_and_a_tag():
    marked = [name for name in problems.names() if is_marked(problems.load(name))]
    assert len(marked) == 9
    for name in marked:
        case = problems.load(name)
        assert excludes_interior(case.problem, case.expected.no_interior), name
        assert "no-interior" in case_tags(case)
        assert Case.from_dict(case.to_dict()).to_dict() == case.to_dict()


def test_the_proof_holds_for_random_forces_in_the_cones():
    """yᵀ G f ≤ 0 for all of them, and yᵀw = 0: the contacts with yᵀ G_i f_i < 0 must be without force."""
    rng = np.random.default_rng(3)
    for name in filter(lambda name: is_marked(problems.load(name)), NEAR):
        case = problems.load(name)
        problem, y = case.problem, case.expected.no_interior
        contacts = problem.contacts
        normals = rng.exponential(size=(500, len(contacts)))
        angle, used = rng.uniform(-np.pi, np.pi, normals.shape), np.sqrt(rng.random(normals.shape))
        tangential = used * contacts.mu * normals
        f = np.stack([tangential * np.cos(angle), tangential * np.sin(angle), normals], axis=2).reshape(500, -1)
        work = f @ (problem.G.T @ y)
        assert work.max() <= 1e-12
        assert work.min() < 0.0
        forces = gf.solve(problem, explain=False).f.reshape(-1, 3)
        assert forces[:, 2].min() <= 1e-6 * forces[:, 2].max()


@pytest.mark.parametrize("margin", ["1e-02", "1e-03", "1e-04", "1e-05"])
def test_unmarked_cases_have_forces_inside_all_limits(margin):
    for name in filter(lambda name: f"near-{margin}" in name, NEAR):
        case = problems.load(name)
        if not is_marked(case):
            assert gf.solve(shrunk(case.problem, 1e-3 * float(margin)), explain=False).found, name


def test_a_wrong_proof_is_refused():
    case = problems.load("hard/near-1e-06-hand-4")
    y = case.expected.no_interior
    assert not excludes_interior(case.problem, -y)
    assert not excludes_interior(case.problem, np.eye(6)[0])
    for i in range(6):
        assert not excludes_interior(case.problem, y + 1e-6 * np.abs(y[i]) * np.eye(6)[i])
    assert not excludes_interior(problems.load("hard/near-1e-06-hand-1").problem, y)


def test_the_search_for_a_proof_finds_none_for_other_loads():
    assert find_proof(problems.load("ring/3-force").problem, gf.solve(problems.load("ring/3-force").problem).f) is None
    problem = problems.load("hard/near-1e-02-object-1").problem
    assert find_proof(problem, gf.solve(problem).f) is None
