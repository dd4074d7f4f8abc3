"""The plant of a table scene at its start: the object stands on the table, and no finger needs to hold it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from graspforce.core.constants import STANDARD_GRAVITY
from graspforce.geometry import Cylinder
from graspforce.geometry.rotations import rotation_exp
from graspforce.grasp.body import Body
from graspforce.simulation.cycle.cycle_run import TablePlant
from graspforce.simulation.cycle.plan_cycle import plan_cycle
from graspforce.simulation.cycle.table_scene import TableScene
from graspforce.simulation.worlds.world import World
from tests.support.table_scenes import MASS, RADIUS, ball_scene

OPEN = plan_cycle(ball_scene()).q_start  # rad: no finger touches


def standing_cylinder(seed: int) -> TableScene:
    """Return the scene with a cylinder instead of the ball, upright along gravity and turned about the vertical."""
    scene = ball_scene()
    axes = np.linalg.svd(scene.down[None])[2][1:]
    upright = np.column_stack([*axes, np.cross(*axes)])
    R_HO = rotation_exp(float(np.random.default_rng(seed).uniform(0.0, 6.0)) * scene.down) @ upright
    body = Body.solid(Cylinder(0.8 * RADIUS, 2.0 * RADIUS), MASS)
    return replace(scene, grasp=replace(scene.grasp, body=body, R_HO=R_HO))


@pytest.mark.parametrize("seed", range(12))
def test_upright_cylinder_stands_on_the_table(seed):
    """In free fall it would sink 12 mm in this time; at rest the contact yields by some hundredths of a millimetre."""
    scene = standing_cylinder(seed)
    grasp, hand = scene.grasp, scene.grasp.hand
    plant = TablePlant(scene, World(), (grasp.p_HO, grasp.R_HO), OPEN).inner
    start = plant.state().object.p_HO
    for _ in range(50):
        state = plant.step(hand.gravity_torque(plant.state().q, scene.gravity_H))
    assert abs((state.object.p_HO - start) @ scene.down) < 1e-4


def test_object_may_be_heavier_than_the_hand_can_hold():
    scene = ball_scene()
    heavy = TablePlant(scene, World(mass_factor=100.0), (scene.grasp.p_HO, scene.grasp.R_HO), OPEN)
    assert heavy.weight == pytest.approx(100.0 * MASS * STANDARD_GRAVITY)
