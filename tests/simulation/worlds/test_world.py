"""Worlds: their ranges, their record, and their values for a grasp."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest
from support.allegro_grasp import PALM_UP, three_finger_grasp

from graspforce import InvalidInput
from graspforce.estimation import SensorModel
from graspforce.simulation.worlds.world import World

SEEDS = range(300)


def test_real_worlds_are_repeatable_and_differ():
    records = [json.dumps(World.real(seed).to_dict()) for seed in range(20)]
    assert records == [json.dumps(World.real(seed).to_dict()) for seed in range(20)]
    assert len(set(records)) == 20


def test_real_worlds_stay_in_the_ranges_that_they_state():
    """Each of 300 worlds, and the extremes come close to the ends: 1 − 0.95³⁰⁰ is 1 to six digits."""
    worlds = [World.real(seed, torque_limit=0.5) for seed in SEEDS]
    ranges = {
        "mass_factor": (0.5, 2.0),
        "friction_factor": (0.6, 1.1),
        "tip_offset": (0.0, 3e-3),
        "shape_offset": (0.0, 1e-3),
        "shape_turn": (0.0, math.radians(5.0)),
        "joint_friction": (0.015, 0.07),
        "stiction": (0.0, 0.5),
        "viscous_friction": (0.0, 0.005),
        "torque_error": (0.0, 0.1),
        "encoder_offset": (0.0, 5e-3),
    }
    for name, (lower, upper) in ranges.items():
        values = np.array([getattr(world, name) for world in worlds])
        assert lower <= values.min() < lower + 0.05 * (upper - lower), name
        assert upper - 0.05 * (upper - lower) < values.max() <= upper, name
    assert max(np.linalg.norm(world.centre_offset) for world in worlds) <= 0.01
    assert {world.sensors.latency for world in worlds} == {1e-3 * k for k in range(11)}
    assert all(1e-4 <= world.sensors.encoder_noise <= 1e-3 for world in worlds)
    cameras = [world.sensors.camera for world in worlds if world.sensors.camera is not None]
    assert 0.65 < len(cameras) / len(worlds) < 0.85  # 0.75, four standard deviations
    assert all(0.02 <= camera.latency <= 0.08 and camera.position_bias <= 3e-3 for camera in cameras)
    pushes = np.array([world.pushes[0] for world in worlds])
    np.testing.assert_allclose(np.linalg.norm(pushes[:, :3], axis=1), 0.5)
    assert np.abs(pushes[:, :3].mean(axis=0)).max() < 4.0 * 0.5 / math.sqrt(3 * len(worlds))  # no preferred direction


def test_record_survives_json():
    for seed in range(10):
        world = World.real(seed)
        loaded = World.from_dict(json.loads(json.dumps(world.to_dict())))
        assert loaded.to_dict() == world.to_dict()
    world = World(drive_losses=[["index", 0.5]])
    assert World.from_dict(json.loads(json.dumps(world.to_dict()))).drive_losses == (("index", 0.5),)
    assert World.from_dict({}).to_dict() == World.nominal().to_dict()


@pytest.mark.parametrize(
    ("record", "field"),
    [
        ({"mass_factor": 0.0}, "world.mass_factor"),
        ({"friction_factor": -1.0}, "world.friction_factor"),
        ({"joint_friction": math.nan}, "world.joint_friction"),
        ({"torque_error": 1.0}, "world.torque_error"),
        ({"centre_offset": [0.0, 0.0]}, "world.centre_offset"),
        ({"pushes": [[1.0, 0.0, 0.0, -1.0, 0.1]]}, "world.pushes[0][3]"),
        ({"pushes": [[1.0, 0.0]]}, "world.pushes[0]"),
        ({"drive_losses": [["index"]]}, "world.drive_losses[0]"),
        ({"drive_losses": [["index", 0.1], ["thumb", -1.0]]}, "world.drive_losses[1][1]"),
        ({"drive_losses": [[1, 0.1]]}, "world.drive_losses[0][0]"),
        ({"camera_outages": [[0.0, math.inf]]}, "world.camera_outages[0][1]"),
        ({"sensors": {"rate": 0.0}}, "world.sensors.rate"),
        ({"seed": 2**32}, "world.seed"),
        ({"mas_factor": 1.0}, "world.mas_factor"),
    ],
)
def test_impossible_worlds_are_rejected_with_the_field(record, field):
    with pytest.raises(InvalidInput) as error:
        World.from_dict(record)
    assert error.value.field == field


def test_sensors_are_a_sensor_model():
    with pytest.raises(InvalidInput, match="a SensorModel"):
        World(sensors=0.1)


def test_nominal_world_changes_nothing():
    grasp = three_finger_grasp()
    options = World.nominal().plant_options(grasp, PALM_UP)
    assert options.body.to_dict() == grasp.body.to_dict()
    np.testing.assert_array_equal(options.friction, grasp.contacts.mu)
    np.testing.assert_array_equal(options.tip_offsets(grasp), 0.0)
    np.testing.assert_array_equal(options.per_joint("coulomb", 16), 0.0)
    np.testing.assert_array_equal(options.per_joint("torque_gain", 16), 1.0)
    np.testing.assert_array_equal(np.append(options.shape_offset, options.shape_turn), 0.0)
    assert options.torsional_friction is None


def test_sizes_are_those_of_the_world_and_directions_are_random():
    grasp = three_finger_grasp()
    world = World(
        mass_factor=1.5, centre_offset=[0.0, 0.0, 0.01], friction_factor=0.6, tip_offset=3e-3, shape_offset=1e-3,
        shape_turn=0.05, joint_friction=0.1, joint_friction_spread=0.2, stiction=0.5, torque_error=0.1, seed=4,
    )  # fmt: skip
    options = world.plant_options(grasp, PALM_UP)
    assert options.body.mass == pytest.approx(1.5 * grasp.body.mass)
    np.testing.assert_allclose(options.body.inertia, 1.5 * grasp.body.inertia)
    np.testing.assert_allclose(options.body.p_OM - grasp.body.p_OM, world.centre_offset)
    np.testing.assert_allclose(options.friction, 0.6 * grasp.contacts.mu)
    np.testing.assert_allclose(np.linalg.norm(options.tip_offset, axis=1), 3e-3)
    assert np.linalg.matrix_rank(options.tip_offset) == 3  # another direction for each finger
    assert np.linalg.norm(options.shape_offset) == pytest.approx(1e-3)
    assert np.linalg.norm(options.shape_turn) == pytest.approx(0.05)
    assert np.all(np.abs(options.coulomb - 0.1) <= 0.02)
    assert np.ptp(options.coulomb) > 0.01
    np.testing.assert_allclose(options.stribeck, 0.5 * options.coulomb)
    assert np.all(np.abs(options.torque_gain - 1.0) <= 0.1)
    assert np.ptp(options.torque_gain) > 0.05


def test_a_quantity_keeps_its_values_when_another_one_changes():
    """So that two worlds with the same seed differ in what was changed only."""
    grasp = three_finger_grasp()
    world = World(tip_offset=1e-3, joint_friction=0.1, joint_friction_spread=0.2, seed=7)
    changed = dataclasses.replace(world, shape_turn=0.1, torque_error=0.1, sensors=SensorModel(encoder_noise=1e-3))
    first, second = (each.plant_options(grasp, PALM_UP) for each in (world, changed))
    np.testing.assert_array_equal(first.tip_offset, second.tip_offset)
    np.testing.assert_array_equal(first.coulomb, second.coulomb)
    other = dataclasses.replace(world, seed=8).plant_options(grasp, PALM_UP)
    assert np.abs(other.tip_offset - first.tip_offset).max() > 1e-4
