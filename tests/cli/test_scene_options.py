"""Options of the bodies around a hand: obstacles, and the table under an object."""

from __future__ import annotations

import numpy as np
import pytest
from support.control_grasps import named_grasp
from support.meshes import box_mesh

from graspforce import InvalidInput
from graspforce.cli.scene_options import collision_settings, parse_obstacle, parse_table, support, table_under
from graspforce.geometry import Box, Cylinder, Solid, Sphere, Superquadric, TriangleMesh

SHAPES = {
    "sphere": Sphere(0.03),
    "cylinder": Cylinder(0.02, 0.09),
    "box": Box([0.03, 0.05, 0.07]),
    "superquadric": Superquadric([0.02, 0.03, 0.04], [0.6, 1.3]),
    "edges": Superquadric([0.02, 0.03, 0.04], [2.0, 2.0]),
    "mesh": TriangleMesh(*box_mesh([0.03, 0.05, 0.07])),
}


def test_obstacle_has_the_given_shape_and_pose() -> None:
    obstacle = parse_obstacle("box:0.1,0.2,0.02@0,0.01,-0.05,0,0,1.5707963267948966")
    assert isinstance(obstacle.shape, Box)
    assert obstacle.shape.edges == pytest.approx([0.1, 0.2, 0.02])
    assert obstacle.p_HO == pytest.approx([0.0, 0.01, -0.05])
    np.testing.assert_allclose(obstacle.R_HO[:, 0], [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_array_equal(parse_obstacle("sphere:0.01@0,0,0.1").R_HO, np.eye(3))


@pytest.mark.parametrize(
    "text", ["box:0.1,0.2,0.02", "sphere:-1@0,0,0", "mesh:a.stl@0,0,0", "sphere:0.01@0,0", "sphere:0.01@0,0,0,1"]
)
def test_wrong_obstacles_are_rejected(text: str) -> None:
    with pytest.raises(InvalidInput, match="obstacle"):
        parse_obstacle(text)


def test_wrong_tables_and_clearances_are_rejected() -> None:
    for text in ("0,0,0", "up"):
        with pytest.raises(InvalidInput, match="table"):
            parse_table(text)
    with pytest.raises(InvalidInput, match="clearance"):
        collision_settings(-0.001, ())


@pytest.mark.parametrize("name", SHAPES)
def test_support_is_the_largest_distance_along_a_direction(name: str) -> None:
    """The plane at that distance touches the solid: no point beyond it is inside, and a point of the surface is on it."""
    shape: Solid = SHAPES[name]
    rng = np.random.default_rng(0)
    rays = rng.standard_normal((20_000, 3))
    surface = shape.project_to_surface(0.2 * rays / np.linalg.norm(rays, axis=1)[:, None])
    for direction in rng.standard_normal((5, 3)):
        direction /= np.linalg.norm(direction)
        heights = surface @ direction
        assert heights.max() <= support(shape, direction) + 1e-9
        assert heights.max() == pytest.approx(support(shape, direction), abs=1e-3)  # m, of the nearest of the points


def test_object_stands_on_the_table() -> None:
    grasp, up_O = named_grasp("four_finger box"), np.array([0.0, 0.6, 0.8])
    table, shape = table_under(grasp, up_O), grasp.body.shape
    assert isinstance(shape, Solid)
    lowest = grasp.p_HO - support(shape, -up_O) * grasp.R_HO @ up_O
    assert table.distance(lowest[None])[0] == pytest.approx(0.0, abs=1e-12)
    assert table.distance(grasp.p_HO[None])[0] == pytest.approx(support(shape, -up_O))
