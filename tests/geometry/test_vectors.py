"""Vector operations, against NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from support.contact_strategies import seeds

from graspforce.geometry.vectors import cross, row_norms, skew, table_axes, tangent_bases, unit_vectors


@given(seeds)
def test_cross_and_skew_are_the_cross_product(seed):
    v, y = np.random.default_rng(seed).normal(size=(2, 5, 3))
    expected = np.cross(v, y)
    np.testing.assert_allclose([cross(a.tolist(), b.tolist()) for a, b in zip(v, y, strict=True)], expected, atol=1e-15)
    np.testing.assert_allclose((skew(v) @ y[:, :, None])[:, :, 0], expected, atol=1e-15)
    np.testing.assert_allclose(y[0] @ skew(v[0]), -expected[0], atol=1e-15)
    assert skew(v.reshape(5, 1, 3)).shape == (5, 1, 3, 3)


@pytest.mark.parametrize("scale", [1e-200, 1.0, 1e200])
def test_norms_and_unit_vectors_neither_overflow_nor_underflow(scale):
    v = scale * np.array([[3.0, 4.0, 12.0], [0.0, 0.0, -2.0]])
    np.testing.assert_allclose(row_norms(v), [13.0 * scale, 2.0 * scale], rtol=1e-15)
    np.testing.assert_allclose(unit_vectors(v), [[3 / 13, 4 / 13, 12 / 13], [0, 0, -1]], rtol=1e-15)


def test_a_zero_vector_has_the_fallback_for_a_unit_vector():
    v = np.array([[0.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    assert unit_vectors(v).tolist() == [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    assert unit_vectors(v, fallback=(1.0, 0.0, 0.0)).tolist() == [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]


@given(seeds)
def test_tangent_bases_complete_a_right_handed_frame(seed):
    n = unit_vectors(np.random.default_rng(seed).normal(size=(4, 3)))
    T = tangent_bases(n)
    frames = np.concatenate([T, n[:, :, None]], axis=2)
    np.testing.assert_allclose(frames.transpose(0, 2, 1) @ frames, np.tile(np.eye(3), (4, 1, 1)), atol=1e-15)
    np.testing.assert_allclose(np.linalg.det(frames), 1.0, atol=1e-14)


@given(seeds)
def test_axes_of_a_table_are_orthonormal_and_horizontal(seed):
    down = unit_vectors(np.random.default_rng(seed).normal(size=(1, 3)))[0]
    rows = np.vstack([table_axes(down), down])
    np.testing.assert_allclose(rows @ rows.T, np.eye(3), atol=1e-14)
