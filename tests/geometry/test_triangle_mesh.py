"""Triangle meshes: distances, normals and curvatures of the surfaces that they approximate, and what a mesh must be."""

from __future__ import annotations

import json

import numpy as np
import pytest
from support.meshes import box_mesh, sphere_mesh, torus_mesh

from graspforce.core.errors import InvalidInput, ModelError
from graspforce.geometry import Box, Solid, TriangleMesh
from graspforce.geometry.distance_field import closest_on_triangles
from graspforce.grasp.body import Body

RADIUS = 0.03  # m
MAJOR, MINOR = 0.04, 0.015  # m, of the torus


@pytest.fixture(scope="module")
def ball():
    return TriangleMesh(*sphere_mesh(RADIUS, divisions=4))


@pytest.fixture(scope="module")
def torus():
    return TriangleMesh(*torus_mesh(MAJOR, MINOR, 80, 40))


def random_directions(count, seed=0):
    d = np.random.default_rng(seed).normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1)[:, None]


def chord_error(edge, curvature):
    """Return how far the middle of a chord is below a surface, m."""
    return curvature * edge**2 / 8.0


# ── the surface ────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_closest_points_of_a_ball_are_on_its_radius(ball):
    d = random_directions(200)
    p = d * np.random.default_rng(1).uniform(0.6, 3.0, size=(200, 1)) * RADIUS
    x = ball.project_to_surface(p)
    edge = np.linalg.norm(ball.vertices[ball.faces[:, 0]] - ball.vertices[ball.faces[:, 1]], axis=1).max()
    # Below the sphere by the chords of the faces, and by the smoothing h² κ/6 with κ = 2/r.
    allowed = chord_error(edge, 2.0 / RADIUS) + ball.spacing**2 / (3.0 * RADIUS)
    assert np.abs(np.linalg.norm(x, axis=1) - RADIUS).max() < allowed
    assert (1.0 - (x * d).sum(axis=1) / np.linalg.norm(x, axis=1)).max() < (0.5 * edge / RADIUS) ** 2
    np.testing.assert_allclose(ball.phi(x), 0.0, atol=1e-12)
    np.testing.assert_allclose(ball.inward_normal(x), -d, atol=edge / RADIUS)


def test_curvatures_of_a_ball_and_a_torus(ball, torus):
    # Smoothing over a facet (3 to 4 mm) leaves few traces of the facets in the second derivatives: a fifth.
    ball, torus = (TriangleMesh(mesh.vertices, mesh.faces, spacing=0.004) for mesh in (ball, torus))
    x = ball.project_to_surface(2.0 * RADIUS * random_directions(100))
    np.testing.assert_allclose(ball.curvatures(x), 1.0 / RADIUS, rtol=0.2)
    outer, inner = torus.project_to_surface([[2.0 * MAJOR, 0.0, 0.0], [0.7 * (MAJOR - MINOR), 0.0, 0.0]])
    np.testing.assert_allclose(torus.curvatures(outer), [1.0 / MINOR, 1.0 / (MAJOR + MINOR)], rtol=0.2)
    np.testing.assert_allclose(torus.curvatures(inner), [1.0 / MINOR, -1.0 / (MAJOR - MINOR)], rtol=0.2)


def test_distances_of_a_torus_have_the_sign_of_its_inside(torus):
    p = np.random.default_rng(2).uniform(-1.0, 1.0, size=(2000, 3)) * [0.06, 0.06, 0.02]  # m, in the grid
    exact = np.hypot(np.hypot(p[:, 0], p[:, 1]) - MAJOR, p[:, 2]) - MINOR
    # Exact near the surface to chords and smoothing; farther away to the spacing of the grid.
    tolerance = np.where(np.abs(exact) < 2.0 * torus.spacing, 3e-4, 1.5 * torus.spacing)
    middle = np.hypot(np.hypot(p[:, 0], p[:, 1]) - MAJOR, p[:, 2]) < 3.0 * torus.spacing  # kinks on the medial circle
    axis = np.hypot(p[:, 0], p[:, 1]) < 3.0 * torus.spacing
    error = np.abs(torus.phi(p) - exact)
    keep = ~(middle | axis)
    assert (error[keep] < tolerance[keep]).all()


def test_gradient_and_hessian_are_the_derivatives_of_phi(torus):
    x = torus.project_to_surface(0.06 * random_directions(50))
    p, step = x + 0.4 * torus.spacing, 1e-6  # m; central differences of a cubic have errors of step²
    gradient = np.stack([(torus.phi(p + step * e) - torus.phi(p - step * e)) / (2 * step) for e in np.eye(3)], axis=1)
    np.testing.assert_allclose(torus._gradient(p), gradient, atol=1e-6)
    hessian = np.stack(
        [(torus._gradient(p + step * e) - torus._gradient(p - step * e)) / (2 * step) for e in np.eye(3)], axis=2
    )
    np.testing.assert_allclose(torus._hessian(p), hessian, atol=1e-3 / torus.spacing * 1e-2)


def test_flat_faces_are_exact_and_edges_are_rounded():
    edges = np.array([0.05, 0.04, 0.06])
    mesh = TriangleMesh(*box_mesh(edges))
    points = np.array([[0.04, 0.003, 0.01], [0.002, -0.03, 0.02], [-0.01, 0.004, -0.05]])
    np.testing.assert_allclose(mesh.project_to_surface(points), Box(edges).project_to_surface(points), atol=1e-12)
    np.testing.assert_allclose(
        mesh.inward_normal(mesh.project_to_surface(points)),
        Box(edges).inward_normal(Box(edges).project_to_surface(points)),
        atol=1e-12,
    )
    corner = mesh.project_to_surface([0.05, 0.04, 0.06])
    assert 0.0 < np.linalg.norm(corner - edges / 2.0) < 1.5 * mesh.spacing


def test_closest_points_of_triangles_are_not_farther_than_any_sample():
    rng = np.random.default_rng(3)
    corners, p = rng.normal(size=(200, 3, 3)), rng.normal(size=(200, 3))
    x, _ = closest_on_triangles(p, corners)
    weights = rng.dirichlet((0.4, 0.4, 0.4), size=2000)  # many on edges and at corners
    samples = np.einsum("sk,nki->nsi", weights, corners)
    nearest = np.linalg.norm(samples - p[:, None], axis=2).min(axis=1)
    distance = np.linalg.norm(x - p, axis=1)
    assert (distance <= nearest + 1e-12).all()
    assert (nearest - distance).max() < 0.2  # the samples come close
    edges = corners - np.roll(corners, -1, axis=1)
    normal = np.cross(edges[:, 0], edges[:, 1])
    heights = np.einsum("ni,ni->n", x - corners[:, 0], normal / np.linalg.norm(normal, axis=1)[:, None])
    np.testing.assert_allclose(heights, 0.0, atol=1e-9)  # in the plane of the triangle


# ── volume, centre, inertia ────────────────────────────────────────────────────────────────────────────────────────────────


def test_volume_and_inertia_of_a_box_are_exact():
    edges, centre = [0.05, 0.04, 0.06], [0.01, -0.02, 0.3]
    mesh, box = TriangleMesh(*box_mesh(edges, centre)), Box(edges)
    assert np.isclose(mesh.volume, box.volume, rtol=1e-12)
    np.testing.assert_allclose(mesh.centre, centre, atol=1e-14)
    np.testing.assert_allclose(mesh.inertia(700.0)[1], box.inertia(700.0)[1], rtol=1e-10, atol=1e-18)
    body = Body.solid(mesh, 0.2)
    np.testing.assert_allclose(body.p_OM, centre, atol=1e-14)
    np.testing.assert_allclose(body.inertia, Body.solid(box, 0.2).inertia, rtol=1e-10, atol=1e-18)


def test_inertia_of_a_torus_turns_with_it(torus):
    mass, inertia = torus.inertia(500.0)
    exact = mass * np.array([MAJOR**2 / 2 + 5 * MINOR**2 / 8] * 2 + [MAJOR**2 + 3 * MINOR**2 / 4])
    np.testing.assert_allclose(inertia, np.diag(exact), rtol=1.5e-2, atol=1e-6 * exact.max())  # facets: (π/40)² = 6e-3
    c, s = np.cos(0.7), np.sin(0.7)
    R = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    turned = TriangleMesh(torus.vertices @ R.T, torus.faces)
    np.testing.assert_allclose(turned.inertia(500.0)[1], R @ inertia @ R.T, rtol=1e-9, atol=1e-12 * exact.max())


def test_convexity(ball, torus):
    assert TriangleMesh(*box_mesh([0.1, 0.2, 0.3])).is_convex
    assert ball.is_convex
    assert not torus.is_convex


# ── records and files ──────────────────────────────────────────────────────────────────────────────────────────────────────


def test_record_of_a_mesh_gives_it_back(ball):
    mesh = TriangleMesh(*box_mesh([0.05, 0.04, 0.06]), spacing=0.001)
    record = json.loads(json.dumps(mesh.to_dict()))
    again = Solid.from_dict(record)
    assert isinstance(again, TriangleMesh)
    assert record["type"] == "mesh"
    np.testing.assert_array_equal(again.vertices, mesh.vertices)
    np.testing.assert_array_equal(again.faces, mesh.faces)
    assert again.spacing == 0.001
    del record["spacing"]
    assert Solid.from_dict(record).spacing == pytest.approx(0.06 / 64)
    body = Body.from_dict({"mass": 0.3, "shape": record})
    np.testing.assert_allclose(Body.from_dict(body.to_dict()).inertia, body.inertia)


def write_obj(path, vertices, faces):
    lines = ["v " + " ".join(map(repr, v.tolist())) for v in vertices]
    path.write_text("\n".join([*lines, *("f " + " ".join(str(i + 1) for i in face) for face in faces)]) + "\n")


def write_stl(path, vertices, faces):
    rows = ["solid part"]
    for face in faces:
        rows += ["facet normal 0 0 0", "outer loop", *(f"vertex {x!r} {y!r} {z!r}" for x, y, z in vertices[face].tolist())]
        rows += ["endloop", "endfacet"]
    path.write_text("\n".join([*rows, "endsolid part"]) + "\n")


@pytest.mark.parametrize(("suffix", "write"), [("obj", write_obj), ("stl", write_stl)])
def test_files_in_millimetres_are_read(tmp_path, suffix, write):
    pytest.importorskip("trimesh")
    vertices, faces = box_mesh([50.0, 40.0, 60.0])
    write(tmp_path / f"part.{suffix}", vertices, faces[:, ::-1])  # inside out: the reader turns it
    mesh = TriangleMesh.load(tmp_path / f"part.{suffix}", scale=1e-3)
    assert np.isclose(mesh.volume, 0.05 * 0.04 * 0.06, rtol=1e-6)  # STL has single precision
    assert len(mesh.vertices) == 8


def test_files_that_are_not_meshes_are_named(tmp_path):
    pytest.importorskip("trimesh")
    with pytest.raises(ModelError, match=r"missing\.stl"):
        TriangleMesh.load(tmp_path / "missing.stl")
    vertices, faces = box_mesh([1.0, 1.0, 1.0])
    write_obj(tmp_path / "open.obj", vertices, faces[:-1])
    with pytest.raises(InvalidInput, match=r"open\.obj.*a closed surface"):
        TriangleMesh.load(tmp_path / "open.obj")


# ── what a mesh must be ────────────────────────────────────────────────────────────────────────────────────────────────────

VERTICES, FACES = box_mesh([0.05, 0.04, 0.06])


@pytest.mark.parametrize(
    ("vertices", "faces", "field", "text"),
    [
        (VERTICES[:3], FACES, "vertices", "from 4 to"),
        (VERTICES, FACES[:3], "faces", "from 4 to"),
        (VERTICES, FACES[:-1], "faces[", "no other face has the edge"),
        (VERTICES, np.vstack([FACES, FACES[:1]]), "faces[", "another face has the edge"),
        (VERTICES, FACES[:, ::-1], "faces", "counter-clockwise seen from outside"),
        (VERTICES, np.vstack([FACES[:-1], [[0, 1, 8]]]), "faces[11]", "three indices from 0 to 7"),
        (VERTICES, np.vstack([FACES[:-1], [[0, 1, 1]]]), "faces[11]", "three different vertices"),
        (VERTICES, FACES + 0.5, "faces[0]", "three indices"),
        (np.full((8, 3), np.nan), FACES, "vertices", "finite"),
        (VERTICES, "box", "faces", ""),
    ],
)
def test_wrong_meshes_are_named(vertices, faces, field, text):
    with pytest.raises(InvalidInput) as error:
        TriangleMesh(vertices, faces)
    assert error.value.field.startswith(field)
    assert text in str(error.value)


@pytest.mark.parametrize("spacing", [0.0, -1.0, 1e-6, float("nan"), "fine"])
def test_wrong_spacings_are_named(spacing):
    with pytest.raises(InvalidInput, match="spacing"):
        TriangleMesh(VERTICES, FACES, spacing)
