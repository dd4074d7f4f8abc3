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


def test_object_on_the_table_stays_there_while_the_base_moves():
    """In H, the object moves against the base; the acceleration of 1 m/s² is far below μ g, at which it would slide."""
    scene = standing_cylinder(3)
    grasp, hand = scene.grasp, scene.grasp.hand
    plant = TablePlant(scene, World(), (grasp.p_HO, grasp.R_HO), OPEN).inner
    start, along = plant.state().object, np.cross(scene.down, [0.0, 0.0, 1.0])
    along /= np.linalg.norm(along)
    displacement = np.zeros(3)
    for k in range(200):
        t = (k + 1) * plant.dt
        displacement, acceleration = 0.5 * t**2 * along, 1.0 * along  # m, m/s²
        plant.move_base(displacement, acceleration)
        state = plant.step(hand.gravity_torque(plant.state().q, scene.gravity_H))
    moved = state.object.p_HO - start.p_HO
    np.testing.assert_allclose(moved, -displacement, rtol=0, atol=2e-4)  # m: the contact yields
    np.testing.assert_allclose(state.object.R_HO, start.R_HO, rtol=0, atol=5e-3)
    assert np.linalg.norm(displacement) > 5e-3


def test_held_object_moves_with_the_base():
    scene = ball_scene()
    plant = TablePlant(scene, World(), (scene.grasp.p_HO, scene.grasp.R_HO), OPEN).inner
    plant.reset()
    start = plant.state().object.p_HO
    for k in range(50):
        plant.move_base(-1e-4 * (k + 1) * scene.down, np.zeros(3))
        state = plant.step(plant.true_contacts().tau)
    assert np.linalg.norm(state.object.p_HO - start) < 1e-3  # m; the base has moved by 5 mm
