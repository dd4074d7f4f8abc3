"""The controller from measurements: it follows as well as from exact states, and its law has no memory of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.simulated_runs import SETTINGS, start_of

from graspforce import InvalidInput
from graspforce.contact.motion import BodyMotion
from graspforce.control import GraspMotion, GraspState, ObjectController, OutputFeedbackController, OutputFeedbackLaw
from graspforce.estimation import CameraModel, Measurement, PoseMeasurement, SensorModel
from graspforce.simulation import World, linear_reference, simulate_measured
from graspforce.simulation.worlds.world_plants import make_world_plant

TRAVEL = np.array([0.0, 0.005, 0.0])  # m


def run(world: World, duration: float = 0.7, settings=SETTINGS, on_step=lambda plant, command: None):
    """Return the recording of the controller in a world, following 5 mm at 1 Hz."""
    grasp = three_finger_grasp()
    plant = make_world_plant(world, grasp, PALM_UP)
    controller = OutputFeedbackController(grasp, settings, world.sensors)
    reference = linear_reference(start_of(grasp), TRAVEL, 1.0)
    return simulate_measured(plant, controller, reference, duration, world, on_step=on_step)


def test_object_follows_from_joint_positions_alone():
    # The first-edition controller follows with exact states to 2 µm; the encoders are perfect here.
    recording = run(World.nominal())
    error = np.linalg.norm(recording.motion_error, axis=1)
    assert not recording.is_dropped
    assert np.sqrt(np.mean(error**2)) < 5e-6


def test_estimate_agrees_with_the_truth_from_joint_positions_alone():
    error = run(World.nominal()).estimation_error()
    assert np.abs(error[:, :3]).max() < 1e-5  # m; the soft contacts of the plant creep by micrometres
    assert np.abs(error[:, 3:]).max() < 1e-3  # rad, at a radius of 30 mm


def test_error_from_encoder_noise_stays_near_the_noise_of_the_fingertips():
    noise = 1e-3  # rad; at 0.1 m from a joint 0.1 mm, and four joints in a finger
    recording = run(World(sensors=SensorModel(encoder_noise=noise), seed=3))
    error = recording.motion_error
    assert not recording.is_dropped
    assert np.sqrt(np.mean(np.sum((error - error.mean(axis=0)) ** 2, axis=1))) < 0.1 * 2.0 * noise


@pytest.mark.parametrize("seed", range(3))
def test_encoder_noise_alone_gives_no_warning(seed):
    """The first measurement is off by the noise; that this error is found later is no slip."""
    warnings = []
    world = World(sensors=SensorModel(encoder_noise=1e-3), seed=seed)
    recording = run(world, 0.3, on_step=lambda plant, command: warnings.extend(command.warnings))
    assert recording.sliding.max() < 1e-4  # m
    assert not warnings


def test_slip_beyond_the_noise_gives_a_warning():
    """The friction is a fifth of what the controller knows, so that fingertips slide by more than their noise."""
    warnings = []
    world = World(sensors=SensorModel(encoder_noise=1e-4), friction_factor=0.2)
    recording = run(world, 0.3, on_step=lambda plant, command: warnings.extend(command.warnings))
    assert recording.sliding.max() > 1e-3  # m
    assert any("slips" in each for each in warnings)


def test_object_is_held_with_a_late_camera_and_without_its_images():
    camera = CameraModel(rate=30.0, latency=0.05, position_noise=1e-3, angle_noise=0.017)
    world = World(sensors=SensorModel(encoder_noise=1e-4, camera=camera), camera_outages=((0.4, 0.3),), seed=5)
    recording = run(world)
    assert not recording.is_dropped
    assert recording.sliding.max() < 1e-4  # m
    assert np.linalg.norm(recording.motion_error, axis=1).max() < 1e-3  # m, the standard deviation of one image


def test_object_is_held_with_a_known_delay_of_the_loop():
    recording = run(World(sensors=SensorModel(latency=0.02)))
    assert not recording.is_dropped
    # without prediction the object would be 0.02 s late: 0.3 mm at 16 mm/s
    assert np.linalg.norm(recording.motion_error[100:], axis=1).max() < 2e-5  # m


def test_law_has_no_memory_of_its_own():
    grasp = three_finger_grasp()
    law, desired = OutputFeedbackLaw(grasp, SETTINGS), start_of(grasp)
    memory = law.step(law.initial_memory(), Measurement(0.0, grasp.q), desired).memory
    first = law.step(memory, Measurement(1e-3, grasp.q + 1e-4), desired).command
    law.step(memory, Measurement(1e-3, grasp.q - 1e-3), desired)
    again = law.step(memory, Measurement(1e-3, grasp.q + 1e-4), desired).command
    np.testing.assert_allclose(again.tau, first.tau, rtol=0, atol=1e-6)  # N·m; warm starts differ within the solver's tolerance


def test_first_command_equals_that_from_the_exact_state():
    grasp = three_finger_grasp()
    exact = ObjectController(grasp, SETTINGS).step(
        GraspState(grasp.q, np.zeros(grasp.hand.n), start_of(grasp)), start_of(grasp)
    )
    command = OutputFeedbackController(grasp, SETTINGS).step(Measurement(0.0, grasp.q), start_of(grasp))
    np.testing.assert_allclose(command.tau, exact.tau, rtol=0, atol=1e-6)  # N·m; the pose of the contacts is within 1 nm


def test_camera_offset_moves_the_object_to_the_desired_pose():
    """The camera sees the object 2 mm beside its place in the grasp; the pose error of the command turns to −2 mm."""
    grasp, offset = three_finger_grasp(), np.array([2e-3, 0.0, 0.0])  # m
    camera = CameraModel(rate=100.0, latency=0.0, position_noise=1e-4, angle_noise=1e-3)
    controller = OutputFeedbackController(grasp, SETTINGS, SensorModel(camera=camera))
    for k in range(1000):
        pose = PoseMeasurement(k * 1e-3, grasp.p_HO + offset, grasp.R_HO) if k % 10 == 0 else None
        command = controller.step(Measurement(k * 1e-3, grasp.q, object=pose), start_of(grasp))
    # The applied offset follows the estimate with a time constant of 0.2 s.
    np.testing.assert_allclose(command.error[:3], -offset, atol=2e-4)  # m


def test_desired_joint_motion_reaches_the_law():
    grasp = three_finger_grasp()
    rest = np.zeros(grasp.hand.n)
    moved = np.array(grasp.q)
    moved[8:12] += 0.1  # rad, of the finger that does not touch
    commands = [
        OutputFeedbackController(grasp, SETTINGS).step(Measurement(0.0, grasp.q), GraspMotion(start_of(grasp), q, rest, rest))
        for q in (grasp.q, moved)
    ]
    difference = commands[1].joint_acceleration - commands[0].joint_acceleration
    assert (difference[8:12] > 1.0).all()  # rad/s²: stiffness 400 1/s² times 0.1 rad, less the limit at the joint's speed


@pytest.mark.parametrize("q", [np.zeros(3), np.zeros(17)])
def test_rejects_the_joints_of_another_hand(q):
    with pytest.raises(InvalidInput, match="16 numbers"):
        OutputFeedbackController(three_finger_grasp(), SETTINGS).step(Measurement(0.0, q), BodyMotion(np.zeros(3), np.eye(3)))


def test_reset_forgets_the_past():
    grasp = three_finger_grasp()
    controller = OutputFeedbackController(grasp, replace(SETTINGS))
    first = controller.step(Measurement(0.0, grasp.q), start_of(grasp))
    controller.step(Measurement(1e-3, grasp.q + 1e-3), start_of(grasp))
    controller.reset()
    assert controller.estimate is None
    np.testing.assert_allclose(controller.step(Measurement(5.0, grasp.q), start_of(grasp)).tau, first.tau, rtol=0, atol=1e-6)
