"""Synergies: known components come back, and the laws of orthogonal projection hold."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graspforce.core.errors import InvalidInput
from graspforce.learning import PostureLibrary, correlate_with_size, fit_preshape, fit_synergies

JOINTS = tuple("abcdef")


def known(rng, rows=400, noise=0.0):
    """Postures of two known components with standard deviations 0.6 and 0.2 rad; returns (library, mean, components)."""
    components = np.linalg.qr(rng.normal(size=(6, 2)))[0].T
    mean = rng.normal(size=6)
    a = rng.normal(size=(rows, 2))
    a = (a - a.mean(axis=0)) @ np.linalg.inv(np.linalg.cholesky(np.cov(a.T))).T * [0.6, 0.2]
    q = mean + a @ components + noise * rng.normal(size=(rows, 6))
    return PostureLibrary(JOINTS, q), mean, components


@given(seed=st.integers(0, 1000))
@settings(deadline=None, max_examples=25)
def test_known_synergies_come_back(seed):
    library, mean, components = known(np.random.default_rng(seed))
    fitted = fit_synergies(library)
    np.testing.assert_allclose(fitted.mean, mean, atol=1e-12)
    np.testing.assert_allclose(np.sqrt(fitted.variances[:2]), [0.6, 0.2], rtol=1e-9)
    np.testing.assert_allclose(np.abs(fitted.components[:2] @ components.T), np.eye(2), atol=1e-6)
    assert fitted.count_for(0.99999) == 2


def test_components_are_the_eigenvectors_of_the_covariance():
    library, _, _ = known(np.random.default_rng(1), noise=0.1)
    fitted = fit_synergies(library)
    values, vectors = np.linalg.eigh(np.cov(library.q.T))
    np.testing.assert_allclose(fitted.variances, values[::-1], rtol=1e-10)
    np.testing.assert_allclose(np.abs(fitted.components @ vectors[:, ::-1]), np.eye(6), atol=1e-7)
    assert fitted.total_variance == pytest.approx(values.sum())


@given(seed=st.integers(0, 1000), count=st.integers(0, 6))
@settings(deadline=None, max_examples=25)
def test_reconstruction_is_an_orthogonal_projection(seed, count):
    rng = np.random.default_rng(seed)
    library, _, _ = known(rng, 30, 0.2)
    fitted, q = fit_synergies(library), rng.normal(size=(4, 6))
    near = fitted.reconstruct(q, count)
    np.testing.assert_allclose(fitted.reconstruct(near, count), near, atol=1e-12)
    np.testing.assert_allclose((q - near) @ fitted.components[:count].T, 0.0, atol=1e-12)


def test_the_error_falls_with_each_component_and_matches_the_variance():
    """In the library itself, the mean square error with k components is the variance that remains, times (N − 1)/N."""
    library, _, _ = known(np.random.default_rng(4), 50, 0.2)
    fitted = fit_synergies(library)
    total = np.square(fitted.reconstruction_error(library.q)).sum(axis=1)
    remains = fitted.total_variance - np.concatenate([[0.0], np.cumsum(fitted.variances)])
    np.testing.assert_allclose(total, remains * 49 / 50, atol=1e-12)
    assert (np.diff(total) < 0.0).all()


def test_amplitudes_and_postures_are_inverse():
    library, _, _ = known(np.random.default_rng(5), 20, 0.2)
    fitted = fit_synergies(library)
    np.testing.assert_allclose(fitted.posture(fitted.amplitudes[3]), library.q[3], atol=1e-12)
    np.testing.assert_allclose(fitted.project(library.q), fitted.amplitudes, atol=1e-12)


def test_a_sweep_reaches_the_span_on_both_sides():
    library, _, _ = known(np.random.default_rng(6))
    fitted = fit_synergies(library)
    a = fitted.project(fitted.sweep(1, span=2.0, frames=41))
    np.testing.assert_allclose(a[:, [0, 2, 3]], 0.0, atol=1e-12)
    assert a[:, 1].max() == pytest.approx(0.4) == -a[:, 1].min()


def sized(rng, rows=60):
    """Postures whose first amplitude depends on the opposition size, at 5 rad/m."""
    component = np.array([0.6, 0.8, 0.0, 0.0, 0.0, 0.0])
    sizes = rng.uniform(0.02, 0.08, (rows, 3))
    q = 5.0 * (sizes[:, :1] - 0.05) * component + 0.002 * rng.normal(size=(rows, 6))
    return PostureLibrary(JOINTS, q, sizes=sizes), component


def test_correlation_finds_the_size_that_matters():
    library, _ = sized(np.random.default_rng(7))
    found = correlate_with_size(library, fit_synergies(library))
    assert abs(found.r[0, 0]) > 0.99
    assert found.significant[0, 0]
    np.testing.assert_allclose(found.r[0], np.corrcoef(fit_synergies(library).amplitudes[:, 0], library.sizes.T)[0, 1:])


def test_a_constant_size_has_no_correlation():
    library, _ = sized(np.random.default_rng(8))
    flat = PostureLibrary(JOINTS, library.q, sizes=np.column_stack([library.sizes[:, :2], np.full(60, 0.03)]))
    found = correlate_with_size(flat, fit_synergies(flat))
    assert not found.significant[:, 2].any()
    assert (found.r[:, 2] == 0.0).all()


def test_uncorrelated_sizes_are_significant_at_the_rate_of_the_level():
    """1200 pairs without correlation at a level of 0.05: 60 are expected; the limits are ± 4 standard deviations."""
    rng, count = np.random.default_rng(9), 0
    for _ in range(200):
        q = rng.normal(size=(20, 2))
        library = PostureLibrary(("a", "b"), q, sizes=rng.uniform(0.01, 0.1, (20, 3)))
        count += int(correlate_with_size(library, fit_synergies(library)).significant.sum())
    assert 30 <= count <= 90


def test_a_preshape_follows_the_size():
    library, component = sized(np.random.default_rng(10))
    model = fit_preshape(library, fit_synergies(library), 1)
    np.testing.assert_allclose(model.posture([0.07, 0.05, 0.05]), 0.1 * component, atol=2e-3)  # noise of 0.002 in 60 rows
    assert model.rms.max() < 3e-3


def test_invalid_arguments_are_refused():
    library, _ = sized(np.random.default_rng(11))
    fitted = fit_synergies(library)
    without = PostureLibrary(JOINTS, library.q)
    for call in (
        lambda: fit_synergies(PostureLibrary(JOINTS, library.q[:1])),
        lambda: fit_synergies(library, 7),
        lambda: fitted.posture(np.zeros(7)),
        lambda: fitted.reconstruct(library.q, 7),
        lambda: fitted.count_for(1.5),
        lambda: fitted.reconstruction_error(np.zeros((0, 6))),
        lambda: correlate_with_size(without, fitted),
        lambda: correlate_with_size(library, fitted, 1.0),
        lambda: fit_preshape(without, fitted),
        lambda: fit_preshape(library, fitted).posture([0.0, 0.1, 0.1]),
    ):
        with pytest.raises(InvalidInput):
            call()
