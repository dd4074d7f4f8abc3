"""Learned squeeze: the stated confidence holds for unseen runs, and squeezes are applied to force problems."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from graspforce import Contact, ForceProblem, solve
from graspforce.core.errors import InvalidInput
from graspforce.force.certificate import primal_residual
from graspforce.force.problem_options import Objective
from graspforce.learning import fit_squeeze, robust_squeeze, squeeze_features, with_squeeze
from graspforce.learning.squeeze import FEATURES, nominal_normals


def ring(mu=0.5, force=(0.0, 0.0, 3.0), max_normal=None):
    angles = 2.0 * np.pi * np.arange(3) / 3
    contacts = [
        Contact((0.03 * np.cos(a), 0.03 * np.sin(a), 0.0), (-np.cos(a), -np.sin(a), 0.0), friction=mu, max_normal=max_normal)
        for a in angles
    ]
    return ForceProblem(contacts, [*force, 0.0, 0.0, 0.0])


def runs(count, seed):
    """Return forces with a known dependence on two features, and an error that grows with the second one."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(0.0, 1.0, (count, 2))
    return x, np.exp(1.0 + 2.0 * x[:, 0] + (0.05 + 0.2 * x[:, 1]) * rng.normal(size=count))


@pytest.mark.parametrize("method", ["boosting", "gaussian_process"])
@pytest.mark.parametrize("confidence", [0.8, 0.95])
def test_unseen_runs_are_covered_at_the_stated_confidence(method, confidence):
    """Means over six divisions: a single one has a standard deviation of at most 4 % with 100 runs of calibration."""
    covered = []
    for seed in range(6):
        model = fit_squeeze(*runs(300, seed), ("a", "b"), confidence, method, seed)
        x, forces = runs(1000, 100 + seed)
        covered.append(np.mean(model.bound(x) >= forces))
    assert np.mean(covered) == pytest.approx(confidence, abs=0.05)


def test_a_gaussian_process_predicts_known_runs():
    model = fit_squeeze(*runs(300, 0), ("a", "b"), 0.9, "gaussian_process")
    x = np.array([[0.2, 0.5], [0.8, 0.5]])
    np.testing.assert_allclose(model.estimate(x), np.exp(1.0 + 2.0 * x[:, 0]), rtol=0.1)
    assert (model.bound(x) > model.estimate(x)).all()


def test_more_confidence_means_more_force():
    x, forces = runs(300, 1)
    bounds = [fit_squeeze(x, forces, ("a", "b"), c).bound(x[:20]) for c in (0.5, 0.8, 0.95)]
    assert (bounds[0] < bounds[1]).all()
    assert (bounds[1] < bounds[2]).all()


def test_the_nominal_squeeze_of_a_ring_is_weight_over_friction():
    """Three contacts around a vertical axis: each bears a third of 3 N by friction, 1 N = μ f_n."""
    np.testing.assert_allclose(nominal_normals(ring(0.5)), 2.0, rtol=1e-5)
    features = dict(zip(FEATURES, squeeze_features(ring(0.5), 0.1), strict=True))
    assert np.exp(features["nominal squeeze"]) == pytest.approx(6.0, rel=1e-5)
    assert np.exp(features["friction"]) == pytest.approx(0.5)
    assert features["friction error"] == 0.1


def test_a_squeeze_is_a_least_sum_of_normal_forces():
    problem = with_squeeze(ring(0.5), 12.0)
    solution = solve(problem)
    assert solution.found
    assert solution.f[problem.contacts.normal_rows].sum() >= 12.0 * (1.0 - 1e-6)


def test_invalid_arguments_are_refused():
    x, forces = runs(60, 2)
    for call, message in (
        (lambda: fit_squeeze(x[:20], forces[:20], ("a", "b")), "30 runs"),
        (lambda: fit_squeeze(x, forces, ("a", "b"), 0.99), "runs at least"),
        (lambda: fit_squeeze(x, forces, ("a", "b"), 1.0), "between 0 and 1"),
        (lambda: fit_squeeze(x, -forces, ("a", "b")), "greater than 0"),
        (lambda: fit_squeeze(x, forces, ("a",)), "n × 1 numbers"),
        (lambda: fit_squeeze(x, forces, ("a", "b"), 0.9, "forest"), "one of"),
        (lambda: with_squeeze(ring(max_normal=3.0), 12.0), "largest normal"),
        (lambda: squeeze_features(ring(0.5, (0.0, 0.0, 30.0), 3.0), 0.1), "has a solution"),
        (lambda: squeeze_features(ring(0.0, (0.0, 0.0, 0.0)), 0.1), "friction"),
    ):
        with pytest.raises(InvalidInput, match=message):
            call()


def test_robust_squeeze_loses_as_much_friction_as_the_squeeze_covers():
    """The least normal forces of the robust problem add up to the squeeze, and a larger squeeze covers a larger loss."""
    problem = replace(ring(), objective=Objective("sum_normal"))
    nominal = float(nominal_normals(problem).sum())
    losses = []
    for total in (0.9 * nominal, 1.1 * nominal, 1.5 * nominal, 2.0 * nominal):
        robust = robust_squeeze(problem, total)
        assert robust.uncertainty is not None
        losses.append(float(np.max(robust.uncertainty.friction_error)))
        solution = solve(robust)
        assert solution.found
        assert float(solution.f[problem.contacts.normal_rows].sum()) == pytest.approx(max(total, nominal), rel=1e-3)
        weaker = replace(problem.contacts, mu=(1.0 - losses[-1]) * problem.contacts.mu)
        assert primal_residual(ForceProblem(weaker, problem.w), solution.f) <= 1e-6
    assert losses[0] == 0.0
    assert losses == sorted(losses)
    assert losses[1] > 0.0


def test_robust_squeeze_refuses_what_friction_does_not_explain():
    with pytest.raises(InvalidInput, match="total"):
        robust_squeeze(ring(), 1e6)
    with pytest.raises(InvalidInput, match="uncertainty"):
        robust_squeeze(robust_squeeze(ring(), 10.0), 12.0)
