"""The closed loop in a plant that is not ours: the object follows, withstands, and what is recorded is what happened."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.control_grasps import named_grasp
from support.hands import load

from graspforce import ContactSet, InvalidInput
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState, ObjectController, PoseGains
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.search import find_grasp
from graspforce.simulation.closed_loop import simulate
from graspforce.simulation.disturbance import FrictionChange, Push
from graspforce.simulation.metrics import compute_metrics
from graspforce.simulation.plant import Plant
from graspforce.simulation.recording import Recording
from graspforce.simulation.reference import constant_reference, linear_reference, rotation_reference, sine_reference
from graspforce.simulation.scene import build_scene
from graspforce.simulation.sensors import SensorChannel, SensorReader, Sensors

SETTINGS = ControlSettings(gravity_H=PALM_UP)
PD = replace(SETTINGS, gains=PoseGains(ki_linear=0.0, ki_angular=0.0))


def start_of(grasp) -> BodyMotion:
    return BodyMotion(grasp.p_HO, grasp.R_HO)


def run(reference=None, duration=0.5, settings=SETTINGS, body=None, sensors=None, disturbances=()) -> Recording:
    """Run the three-finger grasp in closed loop; by default the object stays still."""
    grasp = three_finger_grasp()
    plant = Plant(build_scene(grasp, gravity_H=PALM_UP, body=body), disturbances=disturbances)
    return simulate(
        plant, ObjectController(grasp, settings), reference or constant_reference(start_of(grasp)), duration, sensors=sensors
    )


# ── closed loop ────────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize(("period", "most"), [(1.0, 0.05e-3), (1.0 / 3.0, 0.15e-3)])
@pytest.mark.parametrize("axis", range(3))
def test_a_sinusoid_of_10_mm_is_followed(axis, period, most):
    r = run(linear_reference(start_of(three_finger_grasp()), 0.01 * np.eye(3)[axis], period), period)
    metrics = compute_metrics(r)
    assert np.ptp(r.p_HO[:, axis]) == pytest.approx(0.01, rel=0.02)  # it did go there
    assert metrics.position_error_rms < most  # m
    assert metrics.orientation_error_peak < np.radians(0.1)
    assert metrics.max_cone_violation == 0.0
    assert metrics.min_planned_margin > 0.0
    assert metrics.force_error < 0.05
    assert (metrics.lost_contact_steps, metrics.reused_force_steps, metrics.saturated_steps) == (0, 0, 0)


def test_what_moves_before_the_run_is_not_called_slipping():
    """The tips of four_finger go by 0.1 mm when they press harder, and the controller was asked before that."""
    grasp = find_grasp(load("four_finger"), Body.solid(Sphere(0.03), 0.05), friction=0.7, gravity_H=(0.0, 0.0, -9.81))
    r = simulate(Plant(build_scene(grasp)), ObjectController(grasp), constant_reference(start_of(grasp)), 0.05)
    assert r.warnings == ()


def test_a_turn_is_followed():
    r = run(rotation_reference(start_of(three_finger_grasp()), [1.0, 2.0, 0.5], 0.1, 0.5), 0.5)
    assert compute_metrics(r).orientation_error_rms < 1e-3  # rad, of 0.1
    assert np.linalg.norm(Rotation.from_matrix(r.R_HO[250]).as_rotvec()) == pytest.approx(0.1, rel=0.02)


@pytest.mark.parametrize("travel", [[0.01, 0.0, 0.0], [0.0, 0.01, 0.0], [0.0, 0.0, 0.01]])
def test_soft_fingers_follow_and_bear_the_moments_that_are_planned(travel):
    """Four joints a finger: the tips turn with the object, or torsional friction would wind them up to 10 mN·m and more."""
    grasp = three_finger_grasp(model="soft")
    plant = Plant(build_scene(grasp, gravity_H=PALM_UP))
    r = simulate(plant, ObjectController(grasp, SETTINGS), linear_reference(start_of(grasp), travel, 0.5), 0.5)
    metrics = compute_metrics(r)
    assert metrics.position_error_peak < 0.05e-3  # m
    assert metrics.orientation_error_peak < np.radians(0.1)
    assert metrics.force_error < 0.01
    assert (metrics.lost_contact_steps, metrics.reused_force_steps, metrics.max_cone_violation) == (0, 0, 0.0)
    assert metrics.min_slip_margin > 0.4  # N, of the 0.5 N that was asked for
    # The frames turn apart about n: n's moment is the same in both.
    np.testing.assert_allclose(r.f[..., 3], r.planned[..., 3], atol=1.5e-4)  # N·m
    assert np.abs(r.planned[..., 3]).max() > 2e-4


def test_soft_fingers_that_cannot_follow_keep_the_object_and_say_so():
    """Three joints a finger: lifting the sphere would spin the tips. It stays, firmly held, and the controller tells."""
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


def test_a_push_moves_the_object_by_the_mass_of_object_and_hand():
    """(M_o + G M_h Gᵀ)(ẍ + K_d ẋ + K_p x) = F, M_h = (J M⁻¹ Jᵀ)⁻¹: 000 (39)–(44) with the PD law, integrated by itself."""
    grasp, force = three_finger_grasp(), np.array([0.0, 0.5, 0.0])
    r = run(duration=0.7, settings=PD, disturbances=[Push(force, 0.05, 0.1)])
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
    moved = np.linalg.norm(r.position_error, axis=1)
    assert moved.max() == pytest.approx(predicted, rel=0.05)
    assert moved[r.t >= 0.65].max() < 1e-4  # m, half a second after the push


def test_a_wrong_mass_leaves_no_offset():
    grasp = three_finger_grasp()
    heavy = replace(grasp.body, mass=1.2 * grasp.body.mass, inertia=1.2 * grasp.body.inertia)
    moved = np.linalg.norm(run(duration=1.0, body=heavy).position_error, axis=1)
    assert moved.max() > 2e-5  # m: it did sag
    assert moved[-1] < 1e-6
    left = np.linalg.norm(run(duration=0.3, body=heavy, settings=PD).position_error, axis=1)[-1]
    assert left > 5e-5  # without the integral it stays


def test_friction_may_fall_as_far_as_the_squeeze_was_asked_for():
    falls = FrictionChange(0.4, 0.05, 0.5)
    covered = run(duration=0.7, settings=replace(SETTINGS, friction_reserve=0.45), disturbances=[falls])
    assert np.linalg.norm(covered.position_error, axis=1).max() < 5e-5  # m
    assert compute_metrics(covered).min_slip_margin > 0.0
    bare = run(duration=0.5, settings=replace(SETTINGS, friction_reserve=0.0, slip_margin=0.05), disturbances=[falls])
    moved = np.linalg.norm(bare.position_error, axis=1)
    assert moved.max() > 5e-4  # m
    assert "slips" in bare.warnings[0][1]
    assert bare.warnings[0][0] < bare.t[moved > 5e-4][0]  # the warning comes first


def test_noisy_late_and_rounded_measurements_still_hold():
    sensors = Sensors(
        q=SensorChannel(0.0, 1e-4), v=SensorChannel(5e-3), position=SensorChannel(1e-5), rotation=SensorChannel(1e-4),
        velocity=SensorChannel(1e-3),
        angular_velocity=SensorChannel(1e-2), delay=2e-3, seed=3,
    )  # fmt: skip
    r = run(duration=0.5, sensors=sensors)
    assert compute_metrics(r).position_error_peak < 5e-4  # m
    again = run(duration=0.5, sensors=sensors)
    np.testing.assert_array_equal(r.p_HO, again.p_HO)  # the same seed, the same run
    other = run(duration=0.5, sensors=replace(sensors, seed=4))
    assert np.abs(r.p_HO - other.p_HO).max() > 0.0


def test_what_a_watcher_raises_ends_the_run():
    grasp, seen = three_finger_grasp(), []

    def watch(plant, command):
        seen.append((plant.t, command.f))
        if len(seen) == 3:
            raise KeyboardInterrupt

    plant = Plant(build_scene(grasp, gravity_H=PALM_UP))
    with pytest.raises(KeyboardInterrupt):
        simulate(plant, ObjectController(grasp, SETTINGS), constant_reference(start_of(grasp)), 1.0, on_step=watch)
    assert [t for t, _ in seen] == pytest.approx([1e-3, 2e-3, 3e-3])


# ── records ────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_a_recording_comes_back_from_its_file(tmp_path):
    r = run(duration=0.02, disturbances=[FrictionChange(0.01, 0.005)])
    assert len(r.t) == 20
    r.save(tmp_path / "run.npz")
    back = Recording.load(tmp_path / "run.npz")
    for each in fields(Recording):
        if isinstance(getattr(r, each.name), np.ndarray):
            np.testing.assert_array_equal(getattr(back, each.name), getattr(r, each.name))
            assert not getattr(back, each.name).flags.writeable
        else:
            assert getattr(back, each.name) == getattr(r, each.name)
    for content in (b"", b"PK\x03\x04 no"):
        (tmp_path / "broken.npz").write_bytes(content)
        with pytest.raises(InvalidInput, match="a recording"):
            Recording.load(tmp_path / "broken.npz")
    with pytest.raises(InvalidInput, match="a recording"):
        Recording.load(tmp_path / "nowhere.npz")
    np.savez(tmp_path / "other.npz", words=np.array("{}"))
    with pytest.raises(InvalidInput, match="a recording"):
        Recording.load(tmp_path / "other.npz")


def test_a_part_of_a_recording_is_what_was_then():
    r = run(duration=0.02)
    late = r.since(0.0145)
    np.testing.assert_array_equal(late.t, r.t[15:])
    np.testing.assert_array_equal(late.f, r.f[15:])
    np.testing.assert_array_equal(late.torque_upper, r.torque_upper)


def test_figures_are_what_their_words_say():
    """By hand, from a run of which three steps are kept and overwritten."""
    r = run(duration=0.003)
    p = r.p_desired + np.array([[3e-3, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, -4e-3]])
    R = Rotation.from_rotvec([[0.0, 0.2, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]).as_matrix() @ r.R_desired
    f = np.tile([0.3, 0.4, 1.0, 0.0], (3, 3, 1))  # ‖f_t‖ = 0.5, μ = 0.7: a margin of 0.2
    f[1, 2] = [0.0, 0.9, 1.0, 0.0]  # 0.2 N outside, where the controller believes in 0.1 N
    f[2, 0] = [0.0, 1.7, 1.0, 0.0]  # 1.0 N outside, where the controller does not
    margin = np.full((3, 3), 0.1)
    margin[2, 0] = -0.1
    planned = f.copy()
    planned[..., 2] += 0.1
    tau = np.zeros_like(r.tau)
    tau[1, 4] = -0.35  # of 0.7
    touching = np.ones((3, 3))
    touching[1, 1] = 0.0
    made = replace(
        r, p_HO=p, R_HO=R, f=f, planned=planned, planned_R_OC=r.R_OC, planned_margin=margin, tau=tau, touching=touching,
        forces_reused=np.array([0.0, 1.0, 1.0]), saturated=np.array([0.0, 0.0, 1.0]),
    )  # fmt: skip
    metrics = compute_metrics(made)
    assert metrics.position_error_rms == pytest.approx(np.sqrt((9e-6 + 16e-6) / 3.0))
    assert metrics.position_error_peak == pytest.approx(4e-3)
    assert metrics.orientation_error_peak == pytest.approx(0.2)
    assert metrics.orientation_error_rms == pytest.approx(0.2 / np.sqrt(3.0))
    assert metrics.min_slip_margin == pytest.approx(-1.0)
    assert metrics.min_planned_margin == pytest.approx(-0.1)
    squares = 7 * 1.25 + 1.81 + 3.89  # N²
    assert metrics.force_error == pytest.approx(np.sqrt(9 * 0.01 / squares))
    assert metrics.max_cone_violation == pytest.approx(0.2)
    assert metrics.max_torque_fraction == pytest.approx(0.5)
    assert (metrics.lost_contact_steps, metrics.slip_steps, metrics.reused_force_steps, metrics.saturated_steps) == (1, 2, 2, 1)
    np.testing.assert_allclose(made.orientation_error[0], [0.0, 0.2, 0.0], atol=1e-12)
    assert compute_metrics(made.since(2e-3)).reused_force_steps == 1


# ── references ─────────────────────────────────────────────────────────────────────────────────────────────────────────────

START = BodyMotion([0.1, -0.2, 0.3], Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix())


@pytest.mark.parametrize(
    ("reference", "half"),
    [
        (constant_reference(START), np.zeros(6)),
        (linear_reference(START, [0.01, -0.02, 0.03], 0.8), np.array([0.01, -0.02, 0.03, 0.0, 0.0, 0.0])),
        (rotation_reference(START, [0.0, 3.0, 4.0], 0.5, 0.8), np.array([0.0, 0.0, 0.0, 0.0, 0.3, 0.4])),
        (sine_reference(START, [0.01, -0.02, 0.03], 0.8), np.zeros(6)),
    ],
    ids=["still", "reach", "turn", "sine"],
)
def test_twist_and_acceleration_are_the_derivatives_of_the_pose(reference, half):
    """Central differences over 1e-5 s: rounding and truncation leave some 1e-9 in rates, 1e-6 in accelerations."""
    h = 1e-5
    for t in (2e-5, 0.1, 0.33, 0.55, 0.8 + 1e-3, 1.3):
        now, later, sooner = reference(t), reference(t + h), reference(t - h)
        turned = Rotation.from_matrix(later.R_HO @ sooner.R_HO.T).as_rotvec()
        moved = np.concatenate([later.p_HO - sooner.p_HO, turned]) / (2.0 * h)
        np.testing.assert_allclose(now.twist, moved, atol=1e-7)
        np.testing.assert_allclose(now.acceleration, (later.twist - sooner.twist) / (2.0 * h), atol=1e-5)
    np.testing.assert_allclose(reference(0.0).p_HO, START.p_HO)
    np.testing.assert_array_equal(reference(0.0).twist, np.zeros(6))
    np.testing.assert_allclose(reference(0.4).p_HO - START.p_HO, half[:3], atol=1e-12)
    turned = Rotation.from_matrix(reference(0.4).R_HO @ START.R_HO.T).as_rotvec()
    np.testing.assert_allclose(turned, half[3:], atol=1e-7)


# ── sensors ────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def states(n: int) -> list[GraspState]:
    rng = np.random.default_rng(8)
    R = Rotation.random(n, random_state=8).as_matrix()
    motions = [BodyMotion(rng.normal(size=3), R[i], rng.normal(size=6)) for i in range(n)]
    return [GraspState(rng.normal(size=4), rng.normal(size=4), motion) for motion in motions]


def test_perfect_sensors_say_the_truth_and_late_ones_what_was_true():
    true = states(6)
    perfect, late = SensorReader(Sensors(), 1e-3), SensorReader(Sensors(delay=2e-3), 1e-3)
    for k, state in enumerate(true):
        np.testing.assert_array_equal(perfect.read(state).object.R_HO, state.object.R_HO)
        was, said = true[max(k - 2, 0)], late.read(state)
        np.testing.assert_array_equal(said.q, was.q)
        np.testing.assert_array_equal(said.object.twist, was.object.twist)


def test_readings_come_in_whole_steps():
    sensors = Sensors(*(SensorChannel(0.0, size) for size in (0.1, 0.2, 0.3, 0.05, 0.4, 0.5)))
    for state in states(5):
        said = SensorReader(sensors, 1e-3).read(state)
        read = (said.q, said.v, said.object.p_HO, said.object.twist[:3], said.object.twist[3:])
        truth = (state.q, state.v, state.object.p_HO, state.object.twist[:3], state.object.twist[3:])
        for value, true, size in zip(read, truth, (0.1, 0.2, 0.3, 0.4, 0.5), strict=True):
            np.testing.assert_allclose(value / size, np.round(value / size), atol=1e-9)
            assert np.abs(value - true).max() <= size / 2 + 1e-12
        rotation = Rotation.from_matrix(said.object.R_HO).as_rotvec() / 0.05
        np.testing.assert_allclose(rotation, np.round(rotation), atol=1e-6)


def test_noise_has_the_stated_size_in_every_channel():
    """4000 readings: a standard deviation is known to 1.1 %, so 5 % are more than four times that."""
    sensors = Sensors(*(SensorChannel(size) for size in (0.01, 0.02, 0.03, 0.04, 0.05, 0.06)), seed=5)
    state, reader = states(1)[0], SensorReader(sensors, 1e-3)
    said = [reader.read(state) for _ in range(4000)]
    true = state.object
    off = {
        0.01: [s.q - state.q for s in said],
        0.02: [s.v - state.v for s in said],
        0.03: [s.object.p_HO - true.p_HO for s in said],
        0.04: Rotation.from_matrix([s.object.R_HO @ true.R_HO.T for s in said]).as_rotvec(),
        0.05: [s.object.twist[:3] - true.twist[:3] for s in said],
        0.06: [s.object.twist[3:] - true.twist[3:] for s in said],
    }
    for size, values in off.items():
        np.testing.assert_allclose(np.std(values, axis=0), size, rtol=0.05)
        np.testing.assert_allclose(np.mean(values, axis=0), 0.0, atol=4.5 * size / np.sqrt(4000))


def test_a_run_of_no_step_is_refused():
    with pytest.raises(InvalidInput, match=r"duration = 0.0004: must be at least one step, 0.001 s"):
        run(duration=4e-4)
