"""Shapes: normals against differences of φ, closest points against samples, curvature, volume and inertia by quadrature."""

import numpy as np
import pytest
from support.shapes import AXES, SHAPES, SOLIDS, SURFACES, directions, ellipsoid_level, radial_distances, surface_points

from graspforce import InvalidInput
from graspforce.geometry import Box, Cylinder, ImplicitSurface, Sphere, Superquadric

each_shape = pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES.keys())
each_solid = pytest.mark.parametrize("shape", SOLIDS.values(), ids=SOLIDS.keys())


# --- normals --------------------------------------------------------------------------------------------------------------


@each_shape
def test_the_normal_is_the_negative_unit_gradient_of_phi(shape):
    p = surface_points(shape, 1, 60)
    assert len(p) > 40
    n = shape.inward_normal(p)
    step = 1e-7  # m; truncation error step²·φ''', up to 1e-6 at sharp superquadrics, and rounding 1e-17/step
    slope = np.stack([(shape.phi(p + step * e) - shape.phi(p - step * e)) / (2 * step) for e in np.eye(3)], axis=-1)
    assert np.linalg.norm(n, axis=1) == pytest.approx(1.0, abs=1e-14)
    assert n == pytest.approx(-slope / np.linalg.norm(slope, axis=1)[:, None], abs=1e-5)


@each_shape
def test_the_normal_points_inwards(shape):
    p = surface_points(shape, 2, 40)
    n = shape.inward_normal(p)
    assert (shape.phi(p + 1e-5 * n) < 0.0).all()
    assert (shape.phi(p - 1e-5 * n) > 0.0).all()


@each_shape
def test_one_point_and_many_agree_and_results_are_read_only(shape):
    p = surface_points(shape, 3, 7)
    methods = ((shape.phi, ()), (shape.signed_distance, ()), (shape.inward_normal, (3,)), (shape.project_to_surface, (3,)))
    for method, width in methods:
        many = method(p)
        assert many.shape == (len(p), *width)
        assert not many.flags.writeable
        assert method(p[2]) == pytest.approx(many[2], abs=1e-15)
        assert np.shape(method(p[2].tolist())) == width
        assert method(np.zeros((0, 3))).shape == (0, *width)


# --- closest points -------------------------------------------------------------------------------------------------------


@each_shape
def test_the_closest_point_is_on_the_surface_and_no_sample_is_closer(shape):
    rng = np.random.default_rng(4)
    d = directions(5, 2000 if isinstance(shape, ImplicitSurface) else 100000)
    samples = radial_distances(shape, d)[:, None] * d
    # For an implicit surface this holds within the radii of curvature only: 1 cm here.
    points = rng.normal(size=(12, 3)) * 0.06
    if isinstance(shape, ImplicitSurface):
        points = samples[:12] + 0.01 * rng.uniform(-1, 1, size=(12, 3))
    x = shape.project_to_surface(points)
    far = np.linalg.norm(points - x, axis=1)
    sampled = np.linalg.norm(points[:, None] - samples, axis=2).min(axis=1)
    assert shape.phi(x) == pytest.approx(0.0, abs=1e-12)
    assert (far <= sampled + 1e-12).all()
    spacing = 0.16 / np.sqrt(len(samples)) * 4  # m, over the largest radius
    assert (sampled - far <= spacing).all()


@each_shape
@pytest.mark.parametrize("distance", [-2e-4, 2e-4, 3e-3])  # m, inside within the least radius of curvature
def test_a_point_on_the_normal_has_its_distance_from_the_surface(shape, distance):
    p = surface_points(shape, 6, 40)
    found = shape.signed_distance(p - distance * shape.inward_normal(p))
    assert (np.abs(found) <= abs(distance) + 1e-9).all()  # m; another place may be nearer
    assert (np.sign(found) == np.sign(distance)).all()
    assert np.median(np.abs(found - distance)) < 1e-8  # m


@each_shape
def test_the_normal_at_a_closest_point_passes_through_the_given_point(shape):
    p = surface_points(shape, 6, 25)
    n = shape.inward_normal(p)
    for height in (1e-3, -1e-4):  # outside, and inside within most radii of curvature
        x = shape.project_to_surface(p - height * n)
        gap = np.linalg.norm(x - (p - height * n), axis=1)
        assert (gap <= abs(height) * (1 + 1e-9)).all()
        if height > 0 and shape is not SHAPES["dented"]:  # convex: the closest point is unique
            assert x == pytest.approx(p, abs=1e-9)


def test_closest_points_to_the_centre():
    for shape, half in ((Sphere(0.07), 0.07), (Cylinder(0.03, 0.11), 0.03), (Box([0.04, 0.06, 0.1]), 0.02)):
        x = shape.project_to_surface([0.0, 0.0, 0.0])
        assert np.linalg.norm(x) == pytest.approx(half, rel=1e-14)
        assert shape.phi(x) == pytest.approx(0.0, abs=1e-16)
    assert np.linalg.norm(SOLIDS["ellipsoid"].project_to_surface([0, 0, 0])) == pytest.approx(0.03, rel=1e-12)


def test_implicit_and_parametric_ellipsoids_agree():
    rng = np.random.default_rng(7)
    p = rng.normal(size=(30, 3)) * 0.05
    implicit, quadric = SURFACES["implicit"], SOLIDS["ellipsoid"]
    outside = p[quadric.phi(p) > 0]
    assert implicit.project_to_surface(outside) == pytest.approx(
        quadric.project_to_surface(outside), abs=1e-8
    )  # square root of the rounding of a distance up to 0.2 m
    x = surface_points(quadric, 8, 30)
    assert implicit.inward_normal(x) == pytest.approx(quadric.inward_normal(x), abs=1e-12)
    assert implicit.curvatures(x) == pytest.approx(quadric.curvatures(x), rel=1e-7)


# --- curvatures -----------------------------------------------------------------------------------------------------------


def test_curvatures_have_known_values():
    assert Sphere(0.07).curvatures([0.0, 0.07, 0.0]) == pytest.approx([1 / 0.07] * 2, rel=1e-14)
    assert Cylinder(0.03, 0.11).curvatures([0.018, 0.024, 0.02]) == pytest.approx([1 / 0.03, 0.0], rel=1e-14, abs=1e-12)
    assert Cylinder(0.03, 0.11).curvatures([0.01, 0.0, -0.055]) == pytest.approx([0.0, 0.0], abs=0.0)
    assert Box([0.04, 0.06, 0.1]).curvatures([0.02, 0.01, 0.03]) == pytest.approx([0.0, 0.0], abs=0.0)
    a, b, c = AXES
    tips = [[a, 0, 0], [0, -b, 0], [0, 0, c]]
    known = [[a / b**2, a / c**2], [b / a**2, b / c**2], [c / a**2, c / b**2]]
    assert SOLIDS["ellipsoid"].curvatures(tips) == pytest.approx(np.array(known), rel=1e-12)
    assert SURFACES["implicit"].curvatures(tips) == pytest.approx(np.array(known), rel=1e-7)


@each_shape
def test_curvatures_are_the_rates_of_the_normal(shape):
    """The outward normal changes by S dx, so the eigenvalues of its differences are the principal curvatures."""
    p = surface_points(shape, 9, 25)
    step = 1e-8 if not isinstance(shape, ImplicitSurface) else 1e-7  # m; within the tolerance for a point on the surface
    for point, given_curvatures in zip(p, shape.curvatures(p), strict=True):
        n = -shape.inward_normal(point)
        T = np.linalg.svd(n[None])[2][1:].T
        turn = [(shape.inward_normal(point - step * t) - shape.inward_normal(point + step * t)) / (2 * step) for t in T.T]
        S = T.T @ np.array(turn).T
        measured = np.linalg.eigvals(S).real
        assert given_curvatures[0] >= given_curvatures[1]
        # Errors of the differences: 1e-16 over the step, and truncation at high curvature.
        assert given_curvatures == pytest.approx(sorted(measured, reverse=True), rel=1e-4, abs=1e-4)


# --- volume and inertia ---------------------------------------------------------------------------------------------------


def octant_quadrature(shape, order=60):
    """Return the volume and ∫x², ∫y², ∫z²: ∫ r³/3 dΩ and ∫ d² r⁵/5 dΩ over an octant by Gauss–Legendre quadrature, times 8."""
    x, weight = np.polynomial.legendre.leggauss(order)
    x, weight = 0.25 * np.pi * (x + 1.0), 0.25 * np.pi * weight
    polar, azimuth = np.meshgrid(x, x, indexing="ij")
    d = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=-1).reshape(-1, 3)
    area = 8.0 * (np.outer(weight, weight) * np.sin(polar)).ravel()
    r = radial_distances(shape, d)
    return area @ (r**3 / 3.0), (area * r**5 / 5.0) @ d**2


@each_solid
def test_volume_and_inertia_agree_with_quadrature(shape):
    volume, second = octant_quadrature(shape)
    # Smooth octants integrate to rounding; an edge or a small exponent causes an error of about 1/order².
    tolerance = 1e-6 if shape in (SOLIDS["sphere"], SOLIDS["ellipsoid"], SOLIDS["octahedron"], SOLIDS["double cone"]) else 2e-3
    assert shape.volume == pytest.approx(volume, rel=tolerance)
    mass, inertia = shape.inertia(850.0)
    assert mass == pytest.approx(850.0 * shape.volume, rel=1e-14)
    assert np.diag(inertia) == pytest.approx(850.0 * (second.sum() - second), rel=2 * tolerance)
    assert np.count_nonzero(inertia - np.diag(np.diag(inertia))) == 0


def test_a_sphere_of_water_has_its_known_weight():
    mass, inertia = Sphere(0.1).inertia(1000.0)
    assert mass * 9.81 == pytest.approx(41.0920, abs=5e-5)
    assert inertia == pytest.approx(0.4 * mass * 0.01 * np.eye(3), rel=1e-14)


# --- errors ---------------------------------------------------------------------------------------------------------------


@each_shape
def test_the_error_gives_the_distance_of_a_point_off_the_surface(shape):
    p = surface_points(shape, 11, 3)
    n = shape.inward_normal(p)
    with pytest.raises(InvalidInput, match=r"p_O\[1\] = .*on the surface to within .* m: it is 0\.00(09|1).* m off") as caught:
        shape.inward_normal([p[0], p[1] - 1e-3 * n[1], p[2]])
    assert caught.value.field == "p_O[1]"
    with pytest.raises(InvalidInput, match=r"^p_O = "):
        shape.curvatures(p[0] - 1e-3 * n[0])
    shape.inward_normal(p - 1e-8 * n)  # within the tolerance


@pytest.mark.parametrize(
    ("shape", "place"),
    [
        (Sphere(0.07), [0, 0, 0]),
        (Cylinder(0.03, 0.11), [0.03, 0, 0.055]),
        (Cylinder(0.03, 0.11), [0, -0.03 + 1e-9, -0.055]),
        (Box([0.04, 0.06, 0.1]), [0.02, 0.03, 0.01]),
        (Box([0.04, 0.06, 0.1]), [0.02, 0.03, -0.05]),
        (Superquadric(AXES, [1, 1]), [0, 0, 0]),
        (Superquadric(AXES, [2, 2]), [0.015, 0.025, 0]),
        (Superquadric(AXES, [2, 1]), [0, 0, 0.08]),
        (Superquadric(AXES, [1, 2]), [0, 0.05, 0]),
        (ImplicitSurface(lambda p: float(p @ p), lambda p: 2 * p, 1.0), [0, 0, 0]),
    ],
)
def test_rejects_a_point_without_a_normal(shape, place):
    for method in (shape.inward_normal, shape.curvatures):
        with pytest.raises(InvalidInput, match=r"p_O = .*where the surface has a normal: not "):
            method(place)


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: Sphere(0.0), "radius"),
        (lambda: Sphere("1"), "radius"),
        (lambda: Cylinder(0.1, -1.0), "height"),
        (lambda: Cylinder(float("nan"), 1.0), "radius"),
        (lambda: Box([0.1, 0.2]), "edges"),
        (lambda: Box([0.1, 0.0, 0.2]), "edges[1]"),
        (lambda: Superquadric([1, 1, -1], [1, 1]), "axes[2]"),
        (lambda: Superquadric([1, 1, 1], [1, 2.5]), "exponents[1]"),
        (lambda: Superquadric([1, 1, 1], [0, 1]), "exponents[0]"),
        (lambda: ImplicitSurface(ellipsoid_level, lambda p: p, 0.0), "size"),
        (lambda: Sphere(1.0).inertia(0.0), "density"),
        (lambda: Sphere(1.0).project_to_surface([1.0, 2.0]), "p_O"),
        (lambda: Sphere(1.0).project_to_surface([[1.0, 2.0, 3.0], [1.0]]), "p_O"),
        (lambda: Sphere(1.0).phi([0.0, np.inf, 0.0]), "p_O[1]"),
        (lambda: Sphere(1.0).phi("centre"), "p_O"),
        (lambda: ImplicitSurface(lambda p: p, lambda p: p, 1.0).phi([1, 0, 0]), "value(p_O)"),
        (lambda: ImplicitSurface(lambda p: 0.0, lambda p: [1.0], 1.0).inward_normal([1, 0, 0]), "gradient(p_O)"),
        (lambda: ImplicitSurface(lambda p: 1.0 + p @ p, lambda p: 2 * p, 1.0).project_to_surface([1, 0, 0]), "p_O"),
    ],
)
def test_the_error_names_the_invalid_field(make, field):
    with pytest.raises(InvalidInput) as caught:
        make()
    assert caught.value.field == field
