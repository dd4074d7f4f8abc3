"""Superquadrics: textbook gradient, axis planes, closest points of convex bodies, and limiting shapes."""

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from support.shapes import AXES, SOLIDS, directions, radial_distances, surface_points

from graspforce import InvalidInput
from graspforce.geometry import Box, Cylinder, Sphere, Superquadric


@given(st.floats(0.05, 1.95), st.floats(0.05, 1.95), st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_the_superquadric_normal_is_the_textbook_gradient(e1, e2, seed):
    shape = Superquadric(AXES, [e1, e2])
    d = directions(seed, 1)
    p = (radial_distances(shape, d)[:, None] * d)[0]
    u = np.abs(p / AXES)
    assume(u.min() > 1e-3)
    across = u[0] ** (2 / e2) + u[1] ** (2 / e2)
    assert across ** (e2 / e1) + u[2] ** (2 / e1) == pytest.approx(1.0, rel=1e-9)
    slope = np.array([*(across ** (e2 / e1 - 1) * u[:2] ** (2 / e2 - 1)), u[2] ** (2 / e1 - 1)]) * np.sign(p) / AXES
    assert shape.inward_normal(p) == pytest.approx(-slope / np.linalg.norm(slope), abs=1e-9)


@pytest.mark.parametrize("e", [0.1, 0.5, 1.0, 1.5, 1.9])
def test_a_superquadric_has_normals_in_the_axis_planes(e):
    shape = Superquadric(AXES, [e, e])
    for i in range(3):
        tip = AXES * np.eye(3)[i]
        assert shape.inward_normal(tip) == pytest.approx(-np.eye(3)[i], abs=1e-15)
        assert shape.inward_normal(-tip) == pytest.approx(np.eye(3)[i], abs=1e-15)
    n = shape.inward_normal(shape.project_to_surface([0.04, 0.07, 0.0]))
    assert n[2] == pytest.approx(0.0, abs=1e-6)


@given(st.floats(0.1, 2.0), st.floats(0.1, 2.0), st.integers(0, 2**32 - 1), st.floats(0.2, 3.0))
@settings(max_examples=25, deadline=None)
def test_no_sample_of_a_superquadric_is_closer_than_the_closest_point(e1, e2, seed, scale):
    shape = Superquadric(AXES, [e1, e2])
    d = directions(seed, 4000)
    samples = d * AXES
    samples /= (shape.phi(samples) / AXES.max() + 1.0)[:, None]
    p = scale * samples[0]
    x = shape.project_to_surface(p)
    assert shape.phi(x) == pytest.approx(0.0, abs=1e-15)
    assert np.linalg.norm(x - p) <= np.linalg.norm(samples - p, axis=1).min() + 1e-12


EXPONENT = st.one_of(st.floats(0.05, 2.0), st.sampled_from([1e-6, 0.2, 1.0, 1.001, 1.9, 1.999, 1.99999, 2.0]))
NEAR_A_PLANE = st.tuples(*[st.one_of(st.floats(-1.0, 1.0), st.floats(-1e-6, 1e-6), st.just(0.0))] * 3)


@example(1.999, 1.999, (0.0, 1e-9, 0.421875), 1e-9, 0)
@example(2.0, 1e-6, (4.2698091e-07, -1.9731389e-07, -0.29805698), 3.9280468e-07, 0)
@example(0.2, 1e-6, (8.3262310e-07, -9.1977786e-07, 0.86897193), 4.6830718e-08, 0)
@given(EXPONENT, EXPONENT, NEAR_A_PLANE, st.floats(1e-9, 3.0), st.integers(0, 2**32 - 1))
@settings(max_examples=150, deadline=None)
def test_closest_points_of_superquadrics_from_outside_satisfy_the_projection_inequality(e1, e2, d, height, seed):
    """(p − x)·(y − x) ≤ 0 for all y of a convex body if and only if x is its closest point to p. Also at poles and edges."""
    shape = Superquadric(AXES, [e1, e2])
    p = np.array(d) * AXES
    assume(np.abs(d).max() > 1e-3)
    p = p / (shape.phi(p) / AXES.max() + 1.0) * (1.0 + height)
    x = shape.project_to_surface(p)
    assert shape.phi(x) == pytest.approx(0.0, abs=1e-14)
    samples = (
        np.vstack([directions(seed, 2000), x / AXES + 1e-3 * directions(seed, 1000)]) * AXES
    )  # all over the surface, and close to x
    samples /= (shape.phi(samples) / AXES.max() + 1.0)[:, None]
    away, gap = np.linalg.norm(samples - x, axis=1), np.linalg.norm(p - x)
    # In the worst case x is accurate to the square root of the rounding of its distance from p.
    assert ((samples - x) @ (p - x) <= 1e-8 * gap * (away + gap) + 1e-12 * AXES.max() * away).all()


@given(EXPONENT, EXPONENT, NEAR_A_PLANE, st.floats(0.0, 1.0), st.integers(0, 2**32 - 1))
@settings(max_examples=100, deadline=None)
def test_the_ball_through_a_closest_point_from_inside_is_inside_the_superquadric(e1, e2, d, part, seed):
    shape = Superquadric(AXES, [e1, e2])
    p = np.array(d) * AXES
    assume(np.abs(d).max() > 1e-3)
    p = part * p / (shape.phi(p) / AXES.max() + 1.0)
    x = shape.project_to_surface(p)
    assert shape.phi(x) == pytest.approx(0.0, abs=1e-14)
    radius = np.linalg.norm(p - x)
    towards = (x - p) / radius if radius > 0.0 else np.zeros(3)
    rays = np.vstack([directions(seed, 3000), towards + 0.03 * directions(seed, 1000)])
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    assert (shape.phi(p + radius * rays) <= 1e-9 * AXES.max()).all()


@pytest.mark.parametrize("shape", [s for s in SOLIDS.values() if isinstance(s, Superquadric)])
def test_superquadrics_with_exponents_up_to_two_are_convex(shape):
    assert (shape.curvatures(surface_points(shape, 10, 200)) >= -1e-9).all()


def test_the_curvature_of_a_superquadric_in_its_axis_planes_is_zero_or_infinite():
    flat, sharp = Superquadric(AXES, [0.5, 0.5]), Superquadric(AXES, [1.0, 1.5])
    assert flat.curvatures([0.03, 0.0, 0.0]) == pytest.approx([0.0, 0.0], abs=1e-12)
    with pytest.raises(InvalidInput, match="finite curvature"):
        sharp.curvatures([0.0, 0.05, 0.0])
    with pytest.raises(InvalidInput, match="finite curvature"):  # at the pole its limit depends on the direction
        Superquadric(AXES, [1.0, 0.5]).curvatures([0.0, 0.0, 0.08])


def test_superquadrics_contain_sphere_box_cylinder_and_octahedron():
    ball = Superquadric([0.07] * 3, [1.0, 1.0])
    assert ball.volume == pytest.approx(Sphere(0.07).volume, rel=1e-13)
    assert ball.inertia(2.0)[1] == pytest.approx(Sphere(0.07).inertia(2.0)[1], rel=1e-13)
    for exponents, solid in (([1e-6, 1e-6], Box(2 * AXES)), ([1e-6, 1.0], Cylinder(0.03, 0.16))):
        axes = AXES if isinstance(solid, Box) else [0.03, 0.03, 0.08]
        limit = Superquadric(axes, exponents)
        assert limit.volume == pytest.approx(solid.volume, rel=1e-5)
        assert limit.inertia(3.0)[1] == pytest.approx(solid.inertia(3.0)[1], rel=1e-5)
    assert SOLIDS["octahedron"].volume == pytest.approx(4.0 / 3.0 * AXES.prod(), rel=1e-13)
