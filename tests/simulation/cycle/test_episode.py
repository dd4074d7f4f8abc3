"""Episodes: pose errors, and the scene of a controller with full knowledge."""

from __future__ import annotations

import numpy as np
import pytest

from graspforce.control.settings import ControlSettings
from graspforce.geometry import Box, Cylinder, Sphere
from graspforce.simulation.cycle.episode import PoseError, known_scene
from graspforce.simulation.cycle.pose_errors import displaced_pose
from graspforce.simulation.cycle.table_scene import rest_faces
from graspforce.simulation.worlds.world import World
from tests.support.table_scenes import ball_scene


@pytest.mark.parametrize("seed", range(5))
def test_pose_errors_stay_within_their_bounds_and_on_the_table(seed):
    scene = ball_scene()
    offset, angle = PoseError(0.01, 0.2).draw(World(seed=seed))
    assert np.linalg.norm(offset) <= 0.01
    assert abs(angle) <= 0.2
    p, R = displaced_pose(scene, offset, angle)
    assert (p - scene.grasp.p_HO) @ scene.down == pytest.approx(0.0, abs=1e-12)
    assert np.linalg.norm(p - scene.grasp.p_HO) == pytest.approx(np.linalg.norm(offset))
    assert np.allclose(R @ scene.grasp.R_HO.T @ scene.down, scene.down)


@pytest.mark.parametrize("seed", range(3))
def test_scene_of_full_knowledge_has_the_truth_of_the_world(seed):
    scene, world = ball_scene(), World.real(seed)
    known, told, _ = known_scene(scene, world, ControlSettings())
    true, again = (w.plant_options(s.grasp, scene.gravity_H) for w, s in ((world, scene), (told, known)))
    assert again.body.mass == true.body.mass == known.grasp.body.mass
    assert np.allclose(again.body.p_OM, known.grasp.body.p_OM)
    assert np.allclose(again.friction, known.grasp.contacts.mu)
    assert np.allclose(again.coulomb, known.grasp.hand.friction.coulomb)
    assert not again.shape_turn.any()
    assert np.allclose(again.torque_gain, 1.0)


@pytest.mark.parametrize("shape", [Sphere(0.03), Cylinder(0.02, 0.07), Box((0.03, 0.05, 0.08))])
def test_objects_stand_on_their_faces(shape):
    """The table touches the surface at the foot of the face, and no point of the object is below."""
    rng = np.random.default_rng(0)
    points = shape.project_to_surface(0.05 * rng.standard_normal((200, 3)))
    for direction, distance in rest_faces(shape):
        assert shape.phi(distance * direction) == pytest.approx(0.0, abs=1e-12)
        assert (points @ direction).max() <= distance + 1e-9
