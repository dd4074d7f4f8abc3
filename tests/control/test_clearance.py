"""Clearance of commands: the least distance in the measured state, computed only when it is read."""

from __future__ import annotations

import numpy as np
import pytest
from support.control_grasps import named_grasp
from support.control_steps import disturbed, pose_at_rest, state_at_rest

from graspforce import InvalidInput
from graspforce.control import ControlSettings, ObjectController
from graspforce.geometry import Sphere
from graspforce.grasp.collision.nearest_pair import NearestPair
from graspforce.grasp.collision.obstacle import Obstacle
from graspforce.grasp.collision.scene_collision import SceneCollision


@pytest.mark.parametrize("name", ["four_finger box", "allegro_right sphere", "dlr_hit2 sphere"])
def test_clearance_is_the_least_distance_in_the_measured_state(name: str) -> None:
    controller = ObjectController(named_grasp(name))
    grasp = controller.grasp
    scene = SceneCollision(grasp.hand, grasp.body.shape, grasp.fingers)
    for seed in range(3):
        state, desired = disturbed(grasp, seed)
        clearance, gap = (
            controller.step(state, desired).clearance,
            scene.least_gap(state.q, state.object.p_HO, state.object.R_HO),
        )
        assert clearance is not None
        assert gap is not None
        assert clearance.distance == pytest.approx(gap.distance, abs=max(1e-5, 0.02 * abs(gap.distance)))  # of the search


def test_obstacle_beside_the_object_is_the_nearest_body() -> None:
    """Two balls: the distance is that of the centres less both radii. The obstacle is far from the contacts."""
    grasp = named_grasp("allegro_right sphere")
    assert isinstance(grasp.body.shape, Sphere)
    directions = np.random.default_rng(0).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    free = directions[(directions @ grasp.R_HO @ grasp.contacts.p_OC.T).max(axis=1).argmin()]
    radius, distance = 0.002, 5e-4  # m
    place = grasp.p_HO + (grasp.body.shape.radius + radius + distance) * free
    controller = ObjectController(grasp, ControlSettings(obstacles=[Obstacle(Sphere(radius), place)]))
    clearance = controller.step(state_at_rest(grasp), pose_at_rest(grasp)).clearance
    assert clearance is not None
    assert (clearance.first, clearance.second) == ("object", "obstacles[0]")
    assert clearance.distance == pytest.approx(distance, abs=1e-9)


def test_step_computes_no_clearance_that_is_not_read(monkeypatch) -> None:
    calls = []
    monkeypatch.setattr(NearestPair, "find", lambda *_: calls.append(1))
    controller = ObjectController(named_grasp("four_finger box"))
    command = controller.step(state_at_rest(controller.grasp), pose_at_rest(controller.grasp))
    assert not calls
    assert command.clearance is command.clearance is None
    assert len(calls) == 1


def test_settings_keep_obstacles_and_steps_in_their_record() -> None:
    obstacle = Obstacle(Sphere(0.01), [0.1, 0.0, 0.2])
    record = ControlSettings(clearance_steps=50, obstacles=[obstacle]).to_dict()
    again = ControlSettings.from_dict(record)
    assert again.clearance_steps == 50
    assert again.obstacles[0].to_dict() == obstacle.to_dict()
    assert "obstacles" not in ControlSettings().to_dict()
    assert "clearance_steps" not in ControlSettings().to_dict()
    for change, field in (({"clearance_steps": -1}, "clearance_steps"), ({"obstacles": [3]}, "obstacles[0]")):
        with pytest.raises(InvalidInput) as caught:
            ControlSettings(**change)
        assert caught.value.field == field
