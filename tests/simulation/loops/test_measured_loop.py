"""The closed loop with measurements: delay, rate, drop, records, and the controllers to compare with."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.simulated_runs import SETTINGS, start_of

from graspforce import InvalidInput, ObjectController
from graspforce.control import OutputFeedbackController
from graspforce.core.errors import UnknownName
from graspforce.estimation import CameraModel, SensorModel
from graspforce.estimation.measurement import Measurement
from graspforce.simulation import Plant, Recording, build_scene, constant_reference, linear_reference, simulate
from graspforce.simulation.loops.comparison_controllers import DirectController, ExactController
from graspforce.simulation.loops.measured_loop import simulate_measured
from graspforce.simulation.recordings.measured_recording import MeasuredRecording
from graspforce.simulation.worlds.world import World
from graspforce.simulation.worlds.world_plants import make_world_plant

GRASP = three_finger_grasp()
PERFECT_CAMERA = CameraModel(rate=1000.0, latency=0.0, position_noise=1e-12, angle_noise=1e-12)
PERFECT = SensorModel(has_velocity=True, camera=PERFECT_CAMERA)
REACH = linear_reference(start_of(GRASP), [0.0, 0.0, 0.002], 0.4)
STILL = constant_reference(start_of(GRASP))


def run(world: World, duration: float, reference=STILL, controller="exact", plant="links") -> MeasuredRecording:
    plant = make_world_plant(world, GRASP, PALM_UP, plant)
    options = world.plant_options(GRASP, PALM_UP)
    made = ExactController(GRASP, options, SETTINGS, plant) if controller == "exact" else DirectController(GRASP, SETTINGS)
    return simulate_measured(plant, made, reference, duration, world)


@pytest.mark.parametrize(("plan_spin", "model"), [(True, "soft"), (False, "point")])
def test_full_knowledge_controls_pads_in_both_ways(plan_spin, model):
    world = World(pad_torsion=0.005)
    plant = make_world_plant(world, GRASP, PALM_UP)
    made = ExactController(GRASP, world.plant_options(GRASP, PALM_UP), SETTINGS, plant, plan_spin=plan_spin)
    command = made.step(Measurement(0.0, GRASP.q), STILL(0.0))
    assert {each.value for each in command.contacts.models} == {model}


def test_full_knowledge_of_the_nominal_world_is_the_ideal_loop():
    """Equal but for the posture at the start, which the inverse kinematics find again to 1e-8 rad."""
    ideal = simulate(Plant(build_scene(GRASP, gravity_H=PALM_UP)), ObjectController(GRASP, SETTINGS), REACH, 0.2)
    measured = run(World.nominal(), 0.2, REACH).truth
    np.testing.assert_allclose(measured.p_HO, ideal.p_HO, atol=1e-8)
    np.testing.assert_allclose(measured.f, ideal.f, atol=1e-4)  # N, of 2 N


@pytest.mark.parametrize(
    "world",
    [
        World(mass_factor=2.0),
        World(centre_offset=[0.0, 0.006, 0.008]),
        World(friction_factor=0.6),
        World(pad_torsion=0.005),
        World(tip_offset=3e-3),
        World(shape_offset=1e-3, shape_turn=0.09),
        World(torque_error=0.1),
    ],
    ids=["mass", "centre", "friction", "pads", "tips", "surface", "torque"],
)
def test_full_knowledge_follows_as_in_the_ideal_world(world):
    """The truth is in the controller's model, so that accuracy is lost only to the other contact points.

    The second plant starts with contact forces that are 1 % off, which costs up to 20 µm, and its contacts creep.
    """
    ideal = simulate(Plant(build_scene(GRASP, gravity_H=PALM_UP)), ObjectController(GRASP, SETTINGS), REACH, 0.1)
    peak = np.linalg.norm(ideal.position_error, axis=1).max()  # m
    for plant, allowed, creep in (("links", 1.2 * peak, 1e-7), ("urdf", 2e-5, 2e-6)):
        r = run(world, 0.1, REACH, plant=plant)
        assert np.linalg.norm(r.motion_error, axis=1).max() < allowed, plant
        assert r.sliding.max() < creep, plant
        assert not r.is_dropped


def test_torques_act_after_the_delay_of_the_loop():
    world = World(sensors=SensorModel(latency=5e-3))
    r = run(world, 0.1, REACH).truth
    np.testing.assert_array_equal(r.tau[5:], r.tau_command[:-5])
    np.testing.assert_array_equal(r.tau[:5], np.repeat(r.tau[:1], 5, axis=0))  # of the command at rest


def test_controller_runs_at_the_rate_of_its_sensors():
    world = World(sensors=dataclasses.replace(PERFECT, rate=250.0))
    r = run(world, 0.1, REACH, "direct")
    held = r.truth.tau_command.reshape(25, 4, -1)
    np.testing.assert_array_equal(held, np.repeat(held[:, :1], 4, axis=1))
    assert np.all(np.ptp(held[:, 0], axis=0)[:4] > 0.0)
    np.testing.assert_allclose(r.estimate.t, 4e-3 * np.arange(25))
    for rate in (300.0, 2000.0):
        with pytest.raises(InvalidInput, match=r"world\.sensors\.rate = .* 1000 Hz divided by a whole number"):
            run(World(sensors=SensorModel(rate=rate)), 0.01)
    with pytest.raises(InvalidInput, match="at least one step"):
        run(World.nominal(), 1e-5)


def test_measurements_without_error_are_followed_and_recorded():
    r = run(World(sensors=PERFECT), 0.3, REACH, "direct")
    assert np.linalg.norm(r.motion_error, axis=1).max() < 2e-4  # m: the twist is low-passed at 100 rad/s
    assert np.abs(r.estimation_error()).max() < 1e-9
    np.testing.assert_array_equal(r.estimate.v, r.truth.v)
    assert len(r.camera.t_image) == 300
    np.testing.assert_allclose(r.camera.p_HO, r.truth.p_HO, atol=1e-10)


def test_controller_with_an_estimator_holds_without_a_pose_and_its_bounds_are_recorded():
    """Encoder noise of 1 mrad displaces the tips by 0.1 mm; the object stays within five times that."""
    sensors = SensorModel(encoder_noise=1e-3)
    world = World(sensors=sensors)
    plant = make_world_plant(world, GRASP, PALM_UP)
    r = simulate_measured(plant, OutputFeedbackController(GRASP, SETTINGS, sensors), REACH, 0.3, world)
    assert not r.is_dropped
    assert np.linalg.norm(r.motion_error, axis=1).max() < 5e-4
    error = np.linalg.norm(r.estimation_error()[:, :3], axis=1)
    assert error.max() < 5e-4
    assert np.all(error < 5.0 * np.linalg.norm(r.estimate.deviation[:, :3], axis=1))
    difference = r.estimation_error()[:, :3] + r.truth.position_error[r.true_rows()]
    np.testing.assert_allclose(r.tracking_error()[:, :3], difference, atol=1e-12)


@pytest.mark.parametrize("plant", ["links", "urdf"])
def test_object_that_is_pushed_away_is_dropped_and_the_run_ends_early(plant):
    """No contact can hold against a push of 30 N, 60 times the weight."""
    world = World(pushes=((0.0, 0.0, 30.0, 0.05, 0.05),))
    r = run(world, 2.0, controller="direct", plant=plant)
    assert r.is_dropped
    assert 0.05 < r.drop_time < 0.3
    assert r.truth.t[-1] == pytest.approx(r.drop_time + 0.2, abs=2e-3)
    assert r.camera.p_HO.shape == (0, 3)


class FailingController(DirectController):
    """A controller that raises an exception from a time on."""

    start = 0.0

    def step(self, measurement, desired, lost=()):
        if measurement.t >= self.start:
            raise ZeroDivisionError("no contact")
        return super().step(measurement, desired)


def test_exception_without_contact_ends_the_run_and_others_are_raised(tmp_path):
    world = World(pushes=((0.0, 0.0, 30.0, 0.05, 0.05),))
    plant = make_world_plant(world, GRASP, PALM_UP)
    controller = FailingController(GRASP, SETTINGS)
    controller.start = 0.02
    with pytest.raises(ZeroDivisionError):
        simulate_measured(plant, controller, STILL, 1.0, world)
    lost_at = run(world, 1.0, controller="direct").drop_time
    controller.start = lost_at + 0.01
    r = simulate_measured(plant, controller, STILL, 1.0, world)
    assert (r.drop_time, r.controller_error) == (lost_at, "ZeroDivisionError: no contact")
    assert r.truth.t[-1] < controller.start
    r.save(tmp_path / "run.npz")
    assert MeasuredRecording.load(tmp_path / "run.npz").controller_error == r.controller_error


def test_run_ends_when_the_callback_returns_false():
    world = World.nominal()
    plant = make_world_plant(world, GRASP, PALM_UP)
    controller = ExactController(GRASP, world.plant_options(GRASP, PALM_UP), SETTINGS, plant)
    times: list[float] = []

    def until(plant, command) -> bool:
        times.append(plant.t)
        return len(times) < 20

    recording = simulate_measured(plant, controller, STILL, 0.1, world, on_step=until)
    assert len(recording.truth.t) == len(times) == 20
    assert not recording.is_dropped


def test_runs_are_repeatable_and_depend_on_the_seed():
    world = World(sensors=SensorModel(encoder_noise=1e-3, has_velocity=True, camera=PERFECT_CAMERA), seed=1)
    first, again, other = (run(each, 0.05, controller="direct") for each in (world, world, dataclasses.replace(world, seed=2)))
    np.testing.assert_array_equal(first.truth.tau, again.truth.tau)
    assert np.abs(first.truth.tau - other.truth.tau).max() > 0.0


def test_recording_survives_saving(tmp_path):
    r = run(World(sensors=PERFECT), 0.05, controller="direct")
    r.save(tmp_path / "run.npz")
    loaded = MeasuredRecording.load(tmp_path / "run.npz")
    np.testing.assert_array_equal(loaded.estimate.p_HO, r.estimate.p_HO)
    np.testing.assert_array_equal(loaded.camera.R_HO, r.camera.R_HO)
    np.testing.assert_array_equal(loaded.sliding, r.sliding)
    assert loaded.drop_time is None
    np.testing.assert_array_equal(Recording.load(tmp_path / "run.npz").f, r.truth.f)  # the truth alone
    exact = run(World.nominal(), 0.01)
    exact.save(tmp_path / "exact.npz")
    assert MeasuredRecording.load(tmp_path / "exact.npz").estimate is None
    with pytest.raises(InvalidInput, match="no estimate"):
        exact.estimation_error()
    exact.truth.save(tmp_path / "truth.npz")
    with pytest.raises(InvalidInput, match="a recording with measurements"):
        MeasuredRecording.load(tmp_path / "truth.npz")


def test_joint_friction_costs_less_with_full_knowledge():
    """Coulomb friction of 0.05 N·m: unknown it costs millimetres, fed forward along the planned rates it does not."""
    world = World(joint_friction=0.05, sensors=PERFECT)
    kinds = ("direct", "exact")
    unknown, known = (np.linalg.norm(run(world, 0.4, REACH, kind).motion_error, axis=1).max() for kind in kinds)
    assert unknown > 3e-4
    assert known < 0.2 * unknown


class RecordingController(DirectController):
    """A controller that records which fingers it is told to be without drive."""

    def reset(self):
        super().reset()
        self.told = []

    def step(self, measurement, desired, lost=()):
        self.told.append((measurement.t, lost))
        return super().step(measurement, desired, lost=lost)


def test_lost_drives_are_told_in_the_period_of_the_loss_and_give_no_torque():
    """The loss at 5 ms falls between two periods of 2 ms: the drives are off at 5 ms, and the controller knows at 6 ms."""
    world = World(drive_losses=(("middle", 0.005), ("index", 0.008)), sensors=SensorModel(rate=500.0))
    plant, controller = make_world_plant(world, GRASP, PALM_UP), RecordingController(GRASP, SETTINGS)
    torques, step = [], plant.step
    plant.step = lambda tau: torques.append(np.array(tau)) or step(tau)
    simulate_measured(plant, controller, STILL, 0.012, world)
    told = [(round(1e3 * t), lost) for t, lost in controller.told]  # ms
    both = ("middle", "index")
    assert told == [(0, ()), (2, ()), (4, ()), (6, ("middle",)), (8, both), (10, both)]
    for finger, first in (("middle", 5), ("index", 8)):
        motors = np.array(torques)[:, list(GRASP.hand.finger(finger).joints)]
        assert not motors[first:].any()
        assert motors[:first].any(axis=1).all()


def test_lost_finger_must_be_one_of_the_grasp():
    with pytest.raises(UnknownName, match="pinky"):
        run(World(drive_losses=(("pinky", 0.1),)), 0.01)
