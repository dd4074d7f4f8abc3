"""The monitor of the controller from measurements finds mass and forces, and no slip where there is none."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.simulated_runs import SETTINGS, start_of

from graspforce.control import OutputFeedbackController
from graspforce.estimation import SensorModel
from graspforce.simulation import World, linear_reference, simulate_measured
from graspforce.simulation.worlds.world_plants import make_world_plant

SENSORS = SensorModel(encoder_noise=1e-4, tip_force_noise=0.03, torque_noise=2e-3)


@cache
def run(mass_factor: float = 1.0, friction_factor: float = 1.0, duration: float = 1.0):
    """Return the recording and the monitor's estimates of a run, following 5 mm at 1 Hz."""
    grasp = three_finger_grasp()
    world = World(mass_factor=mass_factor, friction_factor=friction_factor, sensors=SENSORS, seed=2)
    plant = make_world_plant(world, grasp, PALM_UP)
    controller = OutputFeedbackController(grasp, SETTINGS, SENSORS)
    estimates = []
    recording = simulate_measured(
        plant, controller, linear_reference(start_of(grasp), np.array([0.0, 0.005, 0.0]), 1.0), duration, world,
        on_step=lambda plant, command: estimates.append(controller.monitor),
    )  # fmt: skip
    return recording, estimates


def test_mass_is_found_within_three_percent():
    for factor in (0.5, 2.0):
        _, estimates = run(mass_factor=factor)
        true = factor * three_finger_grasp().body.mass
        assert abs(estimates[-1].payload.mass / true - 1.0) < 0.03


def test_forces_agree_with_the_plant():
    recording, estimates = run()
    # A measurement contains the forces of the plant's last step.
    error = np.array([each.forces.f for each in estimates[200:]]) - recording.truth.f[199:-1, :, :3]
    assert np.sqrt(np.mean(error**2)) < 1.1 * SENSORS.tip_force_noise  # N; 10 % for the frames, which turn as tips roll


def test_no_slip_is_reported_without_slip():
    recording, estimates = run()
    assert recording.sliding.max() < 1e-4  # m
    assert not any(each.slip.has_alarm for each in estimates[1:])


def test_friction_is_not_bounded_above_without_slip():
    _, estimates = run()
    friction = estimates[-1].friction
    assert np.isinf(friction.upper).all()
    assert (friction.lower <= three_finger_grasp().contacts.mu).all()


def test_record_of_the_estimate_is_plain():
    _, estimates = run()
    record = estimates[-1].to_dict()
    assert json.loads(json.dumps(record)) == record


@pytest.mark.parametrize("monitored", [True, False])
def test_noise_gives_no_warning_of_slip(monitored):
    """Noise of 1 mrad moves the estimated contact points by more than 0.1 mm. No finger slips."""
    grasp = three_finger_grasp()
    sensors = SensorModel(encoder_noise=1e-3, tip_force_noise=0.03)
    world = World(sensors=sensors, seed=3)
    plant, found = make_world_plant(world, grasp, PALM_UP), []
    controller = OutputFeedbackController(grasp, sensors=sensors, monitored=monitored)
    simulate_measured(
        plant, controller, linear_reference(start_of(grasp), np.array([0.0, 0.005, 0.0]), 1.0), 0.5, world,
        on_step=lambda plant, command: found.append(any("slips" in text for text in command.warnings)),
    )  # fmt: skip
    assert found
    assert not any(found)


def test_slip_that_the_monitor_finds_is_reported():
    grasp = three_finger_grasp()
    world = World(friction_factor=0.3, sensors=SENSORS, seed=2)
    plant, found = make_world_plant(world, grasp, PALM_UP), []
    controller = OutputFeedbackController(grasp, SETTINGS, SENSORS)
    simulate_measured(
        plant, controller, linear_reference(start_of(grasp), np.array([0.0, 0.005, 0.0]), 1.0), 0.3, world,
        on_step=lambda plant, command: found.append((controller.monitor, command.warnings)),
    )  # fmt: skip
    slipping = [(monitor.slip.slipping, warnings) for monitor, warnings in found[1:]]
    assert any(flags.any() for flags, _ in slipping)
    for flags, warnings in slipping:
        assert [any(text.startswith(f"{name} slips") for text in warnings) for name in grasp.fingers] == flags.tolist()
