"""Plants with drives: the drives' laws in motion, gears under load, and the margin that the controller reports."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.drive_laws import joint_torque
from support.simulated_runs import start_of

from graspforce.contact import friction
from graspforce.control import ControlSettings, OutputFeedbackController
from graspforce.control.drives.drive_commands import DriveCommand, DriveMap
from graspforce.estimation import SensorModel
from graspforce.hand.descriptions.drive_description import DRIVE_MODES
from graspforce.hand.drives.drive import Drive, Drives
from graspforce.simulation import World, make_world_plant, simulate_measured, sine_reference
from graspforce.simulation.plants.driven_plant import DriveModel, DrivenPlant

GRASP = three_finger_grasp()
HAND = GRASP.hand
CONSTANTS = {"torque_constant": 1.2, "stiffness": 4.0, "damping": 0.05}
PLANTS = ["links", "urdf"]


def command_for(drive: Drive, tau) -> DriveCommand:
    return DriveMap(HAND.with_drives(drive)).set_points(np.asarray(tau), GRASP.q, np.zeros(HAND.n))


def step_at_rest(model: DriveModel, command: DriveCommand):
    """Return torque, friction and current of a step with the hand at rest in the grasp."""
    return model.step(command, GRASP.q, np.zeros(HAND.n))


@pytest.mark.parametrize("mode", DRIVE_MODES)
def test_drive_in_motion_follows_the_law_of_one_joint(mode):
    rng = np.random.default_rng(8)
    drive = Drive(mode, **CONSTANTS)
    command = command_for(drive, rng.uniform(-0.2, 0.2, HAND.n))
    true = replace(drive, stiffness=0.8 * 4.0, damping=0.8 * 0.05)
    q, v = GRASP.q + 1e-3 * rng.standard_normal(HAND.n), rng.standard_normal(HAND.n)
    torque, loss, _ = DriveModel(Drives((true,) * HAND.n), 1e-3).step(command, q, v)
    expected = [joint_torque(true, command, i, q[i], v[i]) for i in range(HAND.n)]
    np.testing.assert_allclose(torque, expected, rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(loss, 0.0)


def test_set_points_act_after_the_delay_and_at_the_rate_of_the_drive():
    drive = Drive(delay=0.003, rate=500.0)  # 3 and 2 steps of 1 ms
    model = DriveModel(Drives((drive,) * HAND.n), 1e-3)
    torques = [step_at_rest(model, command_for(drive, np.full(HAND.n, 0.01 * k)))[0][0] for k in range(10)]
    # the set-point of step k − 3, or the first one, taken in every second step
    np.testing.assert_allclose(torques, [0.0, 0.0, 0.0, 0.0, 0.01, 0.01, 0.03, 0.03, 0.05, 0.05], atol=1e-15)


def test_rate_that_is_no_part_of_the_step_rate_is_kept_on_average():
    drive = Drive(rate=90.0)
    model = DriveModel(Drives((drive,) * HAND.n), 1e-3)
    torques = [step_at_rest(model, command_for(drive, np.full(HAND.n, 1e-3 * k)))[0][0] for k in range(1000)]
    assert len(set(torques)) == 90


@pytest.mark.parametrize(("mode", "name"), [("torque", "torque"), ("current", "current"), ("position", "position")])
def test_set_points_are_rounded_to_the_resolution(mode, name):
    step = 0.004
    drive = Drive(mode, **CONSTANTS, resolution=step)
    command = command_for(drive, np.linspace(-0.1, 0.1, HAND.n))
    rounded = step * np.round(getattr(command, name) / step)
    expected = {"torque": rounded, "current": 1.2 * rounded, "position": 4.0 * (rounded - GRASP.q)}[mode]
    torque, _, _ = step_at_rest(DriveModel(Drives((drive,) * HAND.n), 1e-3), command)
    np.testing.assert_allclose(torque, expected, rtol=1e-12, atol=1e-15)


def test_servo_makes_no_torque_within_its_backlash():
    drive = Drive("position", stiffness=4.0, backlash=0.02)
    model = DriveModel(Drives((drive,) * HAND.n), 1e-3)
    for offset, torque in ((0.009, 0.0), (-0.009, 0.0), (0.03, 4.0 * 0.02), (-0.03, -4.0 * 0.02)):
        command = command_for(drive, np.full(HAND.n, 4.0 * offset))
        np.testing.assert_allclose(step_at_rest(model, command)[0], torque, atol=1e-12)


@pytest.mark.parametrize("mode", DRIVE_MODES)
def test_current_limit_holds_in_every_mode(mode):
    drive = Drive(mode, **CONSTANTS, current_limit=0.1)
    unlimited = replace(drive, current_limit=np.inf)
    command = command_for(unlimited, np.full(HAND.n, 0.5))
    torque, _, current = step_at_rest(DriveModel(Drives((drive,) * HAND.n), 1e-3), command)
    np.testing.assert_allclose(torque, 0.12, rtol=1e-12)
    np.testing.assert_allclose(current, 0.1, rtol=1e-12)


def test_torque_and_friction_of_a_gear_give_its_efficiency_in_both_directions():
    drive = Drive(efficiency=0.7, backdriving_efficiency=0.5)
    command = command_for(Drive(), np.full(HAND.n, 0.2))
    torque, loss, _ = step_at_rest(DriveModel(Drives((drive,) * HAND.n), 1e-3), command)
    np.testing.assert_allclose(torque - loss, 0.7 * 0.2, rtol=1e-12)  # the motor drives
    np.testing.assert_allclose(torque + loss, 0.2 / 0.5, rtol=1e-12)  # the joint drives the motor


@pytest.mark.parametrize("name", PLANTS)
def test_gear_friction_holds_joints_at_rest(name):
    """Torques that are wrong by less than the gear's friction do not move the hand; without it they do."""
    moved = []
    for level in (0.0, 0.05):
        plant = make_world_plant(World(), GRASP, PALM_UP, name)
        plant.set_gear_friction(np.full(HAND.n, level))  # N·m
        start = plant.state().q
        tau = plant.true_contacts().tau
        for _ in range(50):
            state = plant.step(tau + 0.02)
        moved.append(np.abs(state.q - start).max())
    assert moved[0] > 1e-2
    assert moved[1] < 1e-4  # MuJoCo's friction is a stiff damper


@pytest.mark.parametrize("name", PLANTS)
def test_plant_without_own_drives_takes_torques_as_before(name):
    world = World(sensors=SensorModel(encoder_noise=1e-5))
    plant = make_world_plant(world, GRASP, PALM_UP, name)
    runs = []
    for each in (plant, DrivenPlant(plant, Drives.ideal(HAND.n))):
        controller = OutputFeedbackController(GRASP, ControlSettings(gravity_H=PALM_UP))
        runs.append(simulate_measured(each, controller, sine_reference(start_of(GRASP), [0, 0, 1e-3], 0.2), 0.1, world).truth)
    np.testing.assert_array_equal(runs[0].p_HO, runs[1].p_HO)
    np.testing.assert_array_equal(runs[0].tau, runs[1].tau)


@pytest.mark.parametrize("name", PLANTS)
@pytest.mark.parametrize("mode", ["current", "impedance", "position", "position_with_current_limit"])
def test_object_is_held_with_more_margin_than_guaranteed(name, mode):
    """Torque constants up to 10 % and stiffness up to 20 % wrong; the controller knows these bounds, not the values."""
    drive = Drive(mode, torque_error=0.1, stiffness_error=0.2, **CONSTANTS)
    grasp = replace(GRASP, hand=HAND.with_drives(drive))
    world = World(torque_error=0.1, stiffness_error=0.2, seed=4)
    plant = make_world_plant(world, grasp, PALM_UP, name)
    assert isinstance(plant, DrivenPlant)
    controller = OutputFeedbackController(grasp, ControlSettings(gravity_H=PALM_UP, slip_margin=1.0))
    kept = []

    def compare(plant, command):
        contacts = plant.true_contacts()
        margin = friction.slip_margin(contacts.f, contacts.mu, contacts.gamma)
        kept.append((margin >= command.guaranteed_margin).all())

    run = simulate_measured(plant, controller, sine_reference(start_of(GRASP), [0, 0, 2e-3], 0.5), 0.25, world, on_step=compare)
    assert run.drop_time is None
    assert np.linalg.norm(run.truth.p_HO - run.truth.p_desired, axis=1).max() < 3e-4  # m
    assert np.mean(kept) >= 0.999


def test_true_drives_differ_within_the_stated_error_and_by_seed():
    drives = HAND.with_drives(Drive("position", stiffness=4.0, damping=0.1)).drives
    one, other = (World(stiffness_error=0.3, seed=seed).true_drives(drives).values("stiffness") for seed in (1, 2))
    assert (np.abs(one / 4.0 - 1.0) <= 0.3).all()
    assert np.ptp(one) > 0.3
    assert not np.array_equal(one, other)
    np.testing.assert_array_equal(World(seed=1).true_drives(drives).values("stiffness"), 4.0)


def test_true_delay_backlash_and_losses_differ_by_factors_of_their_own():
    drive = Drive(delay=0.01, backlash=0.02, efficiency=0.7, backdriving_efficiency=0.6)
    true = World(drive_error=0.3, seed=3).true_drives(HAND.with_drives(drive).drives)
    parts = {
        "delay": true.values("delay") / 0.01,
        "backlash": true.values("backlash") / 0.02,
        "efficiency": (1.0 - true.values("efficiency")) / 0.3,
        "backdriving_efficiency": (1.0 - true.values("backdriving_efficiency")) / 0.4,
    }
    for name, factors in parts.items():
        assert (np.abs(factors - 1.0) <= 0.3 + 1e-12).all(), name
        assert np.ptp(factors) > 0.3, name
    assert len({tuple(factors) for factors in parts.values()}) == 4
    assert World(drive_error=0.3, seed=3).true_drives(HAND.with_drives(Drive()).drives).is_ideal
