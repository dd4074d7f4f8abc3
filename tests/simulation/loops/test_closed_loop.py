"""The closed loop: tracking, disturbances, model errors, sensors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.control_grasps import named_grasp
from support.hands import load
from support.simulated_runs import SETTINGS, simulate_three_fingers, start_of

from graspforce import ContactSet, InvalidInput
from graspforce.control import ControlSettings, ObjectController, PoseGains
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.search import find_grasp
from graspforce.simulation.loops.closed_loop import simulate
from graspforce.simulation.loops.reference import constant_reference, linear_reference, rotation_reference
from graspforce.simulation.plants.disturbance import FrictionChange, Push
from graspforce.simulation.plants.plant import Plant
from graspforce.simulation.plants.scene import build_scene
from graspforce.simulation.recordings.metrics import compute_metrics
from graspforce.simulation.sensors.sensor_models import SensorChannel, Sensors

PD = replace(SETTINGS, gains=PoseGains(ki_linear=0.0, ki_angular=0.0))


@pytest.mark.parametrize(("period", "most"), [(1.0, 0.05e-3), (1.0 / 3.0, 0.15e-3)])
@pytest.mark.parametrize("axis", range(3))
def test_object_follows_a_sinusoid_of_10_mm(axis, period, most):
    r = simulate_three_fingers(linear_reference(start_of(three_finger_grasp()), 0.01 * np.eye(3)[axis], period), period)
    metrics = compute_metrics(r)
    assert np.ptp(r.p_HO[:, axis]) == pytest.approx(0.01, rel=0.02)
    assert metrics.position_error_rms < most  # m
    assert metrics.orientation_error_peak < np.radians(0.1)
    assert metrics.max_cone_violation == 0.0
    assert metrics.min_planned_margin > 0.0
    assert metrics.force_error < 0.05
    assert (metrics.lost_contact_steps, metrics.reused_force_steps, metrics.saturated_steps) == (0, 0, 0)


def test_motion_before_the_run_is_not_reported_as_slip():
    """The initial forces displace the tips of four_finger by 0.1 mm, after the controller's first command."""
    grasp = find_grasp(load("four_finger"), Body.solid(Sphere(0.03), 0.05), friction=0.7, gravity_H=(0.0, 0.0, -9.81))
    r = simulate(Plant(build_scene(grasp)), ObjectController(grasp), constant_reference(start_of(grasp)), 0.05)
    assert r.warnings == ()


def test_object_follows_a_rotation():
    r = simulate_three_fingers(rotation_reference(start_of(three_finger_grasp()), [1.0, 2.0, 0.5], 0.1, 0.5), 0.5)
    assert compute_metrics(r).orientation_error_rms < 1e-3  # rad, of 0.1
    assert np.linalg.norm(Rotation.from_matrix(r.R_HO[250]).as_rotvec()) == pytest.approx(0.1, rel=0.02)


@pytest.mark.parametrize("travel", [[0.01, 0.0, 0.0], [0.0, 0.01, 0.0], [0.0, 0.0, 0.01]])
def test_soft_contacts_follow_and_carry_the_planned_moments(travel):
    """With four joints per finger, the tips rotate with the object; otherwise torsional friction would exceed 10 mN·m."""
    grasp = three_finger_grasp(model="soft")
    plant = Plant(build_scene(grasp, gravity_H=PALM_UP))
    r = simulate(plant, ObjectController(grasp, SETTINGS), linear_reference(start_of(grasp), travel, 0.5), 0.5)
    metrics = compute_metrics(r)
    assert metrics.position_error_peak < 0.05e-3  # m
    assert metrics.orientation_error_peak < np.radians(0.1)
    assert metrics.force_error < 0.01
    assert (metrics.lost_contact_steps, metrics.reused_force_steps, metrics.max_cone_violation) == (0, 0, 0.0)
    assert metrics.min_slip_margin > 0.4  # N, of 0.5 N planned
    # Tangents of planned and true frames differ by a rotation about n, which keeps the moment about n.
    np.testing.assert_allclose(r.f[..., 3], r.planned[..., 3], atol=1.5e-4)  # N·m
    assert np.abs(r.planned[..., 3]).max() > 2e-4


def test_soft_contacts_that_cannot_follow_hold_the_object_and_warn():
    """With three joints per finger, lifting the sphere would rotate the tips on it: the object stays, and a warning follows."""
    points = named_grasp("four_finger sphere")
    soft = [replace(each, model="soft", torsional_friction=0.005) for each in points.contacts.contacts]
    grasp, settings = replace(points, contacts=ContactSet.stack(soft)), ControlSettings()
    plant = Plant(build_scene(grasp))
    r = simulate(plant, ObjectController(grasp, settings), linear_reference(start_of(grasp), [0.0, 0.0, 0.005], 0.5), 0.3)
    metrics = compute_metrics(r)
    assert metrics.position_error_peak > 4e-3  # m
    assert metrics.force_error < 0.01
    assert (metrics.lost_contact_steps, metrics.reused_force_steps, metrics.max_cone_violation) == (0, 0, 0.0)
    assert metrics.min_slip_margin > 0.4  # N
    assert "cannot make all of this motion without slipping" in r.warnings[0][1]


def test_push_response_matches_the_impedance_law():
    """The law of Mattar (2013) with PD gains: (M_o + G M_h Gᵀ)(ẍ + K_d ẋ + K_p x) = F, M_h = (J M⁻¹ Jᵀ)⁻¹."""
    grasp, force = three_finger_grasp(), np.array([0.0, 0.5, 0.0])
    r = simulate_three_fingers(duration=0.7, settings=PD, disturbances=[Push(force, 0.05, 0.1)])
    hand = grasp.hand
    J = hand.contact_jacobian(grasp.q, grasp.fingers, grasp.contacts, grasp.p_HO, grasp.R_HO)
    G = grasp.contacts.wrench_bases().transpose(1, 0, 2).reshape(6, -1)[:, grasp.contacts.columns]
    M_h = np.linalg.inv(J @ np.linalg.inv(hand.mass_matrix(grasp.q)) @ J.T)
    a = np.linalg.solve(grasp.body.mass_matrix() + G @ M_h @ G.T, [*force, 0.0, 0.0, 0.0])  # m/s², rad/s²
    kp, kd, _ = PD.gains.rows()

    def law(t, x):
        return [*x[6:], *(a * (t < 0.1) - kd * x[6:] - kp * x[:6])]

    x = solve_ivp(law, (0.0, 0.3), np.zeros(12), max_step=1e-3, rtol=1e-8, atol=1e-12)
    predicted = np.linalg.norm(x.y[:3], axis=0).max()
    error = np.linalg.norm(r.position_error, axis=1)
    assert error.max() == pytest.approx(predicted, rel=0.05)
    assert error[r.t >= 0.65].max() < 1e-4  # m, half a second after the push


def test_wrong_mass_leaves_no_offset():
    grasp = three_finger_grasp()
    heavy = replace(grasp.body, mass=1.2 * grasp.body.mass, inertia=1.2 * grasp.body.inertia)
    error = np.linalg.norm(simulate_three_fingers(duration=1.0, body=heavy).position_error, axis=1)
    assert error.max() > 2e-5  # m: it sags first
    assert error[-1] < 1e-6
    left = np.linalg.norm(simulate_three_fingers(duration=0.3, body=heavy, settings=PD).position_error, axis=1)[-1]
    assert left > 5e-5  # the offset stays without the integral


def test_friction_reserve_covers_a_loss_of_friction():
    falls = FrictionChange(0.4, 0.05, 0.5)
    covered = simulate_three_fingers(duration=0.7, settings=replace(SETTINGS, friction_reserve=0.45), disturbances=[falls])
    assert np.linalg.norm(covered.position_error, axis=1).max() < 5e-5  # m
    assert compute_metrics(covered).min_slip_margin > 0.0
    bare = simulate_three_fingers(
        duration=0.5, settings=replace(SETTINGS, friction_reserve=0.0, slip_margin=0.05), disturbances=[falls]
    )
    error = np.linalg.norm(bare.position_error, axis=1)
    assert error.max() > 5e-4  # m
    assert "slips" in bare.warnings[0][1]
    assert bare.warnings[0][0] < bare.t[error > 5e-4][0]  # the warning comes before the slip


def test_object_is_held_with_noisy_delayed_and_quantised_measurements():
    sensors = Sensors(
        q=SensorChannel(0.0, 1e-4), v=SensorChannel(5e-3), position=SensorChannel(1e-5), rotation=SensorChannel(1e-4),
        velocity=SensorChannel(1e-3),
        angular_velocity=SensorChannel(1e-2), delay=2e-3, seed=3,
    )  # fmt: skip
    r = simulate_three_fingers(duration=0.5, sensors=sensors)
    assert compute_metrics(r).position_error_peak < 5e-4  # m
    again = simulate_three_fingers(duration=0.5, sensors=sensors)
    np.testing.assert_array_equal(r.p_HO, again.p_HO)  # the same seed, the same run
    other = simulate_three_fingers(duration=0.5, sensors=replace(sensors, seed=4))
    assert np.abs(r.p_HO - other.p_HO).max() > 0.0


class OnlyInterface:
    """A plant that has the members of `PlantInterface`, and nothing else."""

    MEMBERS = ("grasp", "dt", "t", "reset", "step", "state", "true_contacts")

    def __init__(self, plant):
        self._plant = plant

    def __getattr__(self, name):
        if name not in self.MEMBERS:
            raise AttributeError(name)
        return getattr(self._plant, name)


def test_loop_needs_only_the_interface_of_a_plant():
    grasp = three_finger_grasp()
    plant = Plant(build_scene(grasp, gravity_H=PALM_UP))
    still = constant_reference(start_of(grasp))
    whole = simulate(plant, ObjectController(grasp, SETTINGS), still, 0.02)
    narrow = simulate(OnlyInterface(plant), ObjectController(grasp, SETTINGS), still, 0.02)
    np.testing.assert_array_equal(narrow.f, whole.f)


def test_exception_of_a_callback_ends_the_run():
    grasp, times = three_finger_grasp(), []

    def watch(plant, command):
        times.append((plant.t, command.f))
        if len(times) == 3:
            raise KeyboardInterrupt

    plant = Plant(build_scene(grasp, gravity_H=PALM_UP))
    with pytest.raises(KeyboardInterrupt):
        simulate(plant, ObjectController(grasp, SETTINGS), constant_reference(start_of(grasp)), 1.0, on_step=watch)
    assert [t for t, _ in times] == pytest.approx([1e-3, 2e-3, 3e-3])


def test_duration_below_a_step_is_rejected():
    with pytest.raises(InvalidInput, match=r"duration = 0.0004: must be at least one step, 0.001 s"):
        simulate_three_fingers(duration=4e-4)
