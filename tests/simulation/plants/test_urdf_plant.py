"""The plant of the URDF: laws of mechanics, agreement with Pinocchio and with the other plant, friction, errors."""

from __future__ import annotations

import ast
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.control_grasps import five_finger_grasp, named_grasp
from support.hands import SHIPPED_HANDS, load, random_posture

import graspforce.simulation
from graspforce import Contact, ContactSet, Hand, InvalidInput
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState, ObjectController
from graspforce.core.errors import ModelError
from graspforce.geometry import Sphere, Superquadric
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.hand.descriptions.description import MODELS_FOLDER
from graspforce.simulation import Plant, PlantOptions, UrdfPlant, build_scene, compute_metrics, linear_reference, simulate
from graspforce.simulation.plants.urdf_model import compile_urdf

mujoco = pytest.importorskip("mujoco")

EARTH = np.array([0.0, 0.0, -9.81])  # m/s²
SETTINGS = ControlSettings(gravity_H=PALM_UP)


def allegro_plant(grasp: Grasp | None = None, **options) -> UrdfPlant:
    return UrdfPlant(grasp or three_finger_grasp(), PlantOptions(gravity_H=PALM_UP, **options))


def distant_grasp(hand: Hand) -> Grasp:
    """Return a grasp with the object out of reach, for tests of the hand alone."""
    contacts = ContactSet.stack([Contact([0.01, 0.0, 0.0], [-1.0, 0.0, 0.0], 0.5)])
    return Grasp(hand, Body.solid(Sphere(0.01), 0.05), (hand.fingers[0].name,), contacts, hand.neutral, [0, 0, 1], np.eye(3))


def actuated_dynamics(hand: Hand, q, v):
    """Return mass matrix and bias torque of the engine in the coordinates of the motors."""
    compiled = compile_urdf(distant_grasp(hand), PlantOptions(gravity_H=EARTH))
    rows, T, model = compiled.joint_rows, compiled.T, compiled.model
    data = mujoco.MjData(model)
    data.qpos[rows], data.qvel[rows] = T @ q + compiled.q0, T @ v
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return T.T @ full[np.ix_(rows, rows)] @ T, T.T @ data.qfrc_bias[rows]


def check_dynamics(hand: Hand, q, v) -> None:
    """Check the engine's dynamics against Pinocchio's; both round sums of some hundred terms."""
    M, bias = actuated_dynamics(hand, q, v)
    np.testing.assert_allclose(M, hand.mass_matrix(q), rtol=0, atol=1e-12 * np.abs(M).max())
    expected = hand.inverse_dynamics(q, v, np.zeros(hand.n), EARTH)
    np.testing.assert_allclose(bias, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


# ── the hand ─────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_plant_shares_no_code_with_the_other_plant():
    folder = Path(graspforce.simulation.__file__).parent / "plants"
    for name in ("urdf_plant", "urdf_model", "urdf_preload", "plant_options", "plant_interface"):
        imported = {
            node.module for node in ast.walk(ast.parse((folder / f"{name}.py").read_text())) if isinstance(node, ast.ImportFrom)
        }
        for other in ("scene", "scene_parts", "plant", "contact_bias", "preload", "engine_settings"):
            assert f"graspforce.simulation.plants.{other}" not in imported


@pytest.mark.parametrize("name", SHIPPED_HANDS)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_dynamics_are_those_of_pinocchio(name, seed):
    hand = load(name)
    check_dynamics(hand, random_posture(hand, seed), np.random.default_rng(seed).normal(size=hand.n))


def copy_of_four_finger(folder: Path, **fields) -> Hand:
    """Return four_finger from files in a folder, with other fields in its description."""
    record = json.loads((MODELS_FOLDER / "four_finger.json").read_text())
    (folder / "four_finger.urdf").write_text((MODELS_FOLDER / "four_finger.urdf").read_text())
    (folder / "copy.json").write_text(json.dumps({**record, **fields}))
    return Hand.load(folder / "copy.json")


def test_locked_joints_stay_at_their_positions(tmp_path):
    hand = copy_of_four_finger(tmp_path, locked=[{"joint": "finger_2_joint_1", "position": 0.2, "source": "test"}])
    check_dynamics(hand, hand.neutral, np.ones(hand.n))


def test_impossible_inertia_is_a_model_error(tmp_path):
    """No body has a principal moment above the sum of the others; MuJoCo rejects it, Pinocchio does not."""
    inertia = [1e-6, 1e-6, 1e-5, 0, 0, 0]  # kg·m²
    override = {"link": "finger_1_link_2", "mass": 0.02, "com": [0, 0, 0], "inertia": inertia, "source": "test"}
    grasp = distant_grasp(copy_of_four_finger(tmp_path, inertias=[override]))
    with pytest.raises(ModelError, match=r"four_finger\.urdf: MuJoCo cannot compile it"):
        compile_urdf(grasp, PlantOptions())


def test_couplings_hold_in_motion():
    plant = UrdfPlant(named_grasp("dlr_hit2 sphere"), PlantOptions(gravity_H=EARTH))
    rng, rows = np.random.default_rng(1), plant.compiled.joint_rows
    for _ in range(50):
        plant.step(rng.uniform(-0.05, 0.05, plant.grasp.hand.n))
    error = plant.data.qpos[rows] - plant.compiled.T @ plant.state().q - plant.compiled.q0
    assert np.abs(error).max() < 1e-4  # rad: the engine's couplings are stiff springs


# ── the start ────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def planned_forces(grasp: Grasp, gravity_H):
    """Return forces that hold the weight with a slip margin."""
    controller = ObjectController(grasp, ControlSettings(gravity_H=gravity_H))
    rest = BodyMotion(grasp.p_HO, grasp.R_HO)
    return controller.step(GraspState(grasp.q, np.zeros(grasp.hand.n), rest), rest).f


def force_sum(plant: UrdfPlant):
    """Return the sum of the contact forces on the object, in H, with the attitude at the begin of the step."""
    contacts = plant.true_contacts()
    return np.einsum("nij,nj->i", contacts.R_OC, contacts.f[:, :3]) @ plant.grasp.R_HO.T


@pytest.mark.parametrize("name", ["allegro_right sphere", "allegro_right box", "four_finger cylinder", "dlr_hit2 sphere"])
def test_contacts_carry_the_given_forces_from_the_start(name):
    """Joints that move by themselves settle with a time constant of some 50 ms, so that 1 % of the forces remains."""
    grasp = named_grasp(name)
    plant = UrdfPlant(grasp, PlantOptions(gravity_H=EARTH))
    f = planned_forces(grasp, EARTH)
    state = plant.reset(f)
    contacts, expected = plant.true_contacts(), grasp.contacts.pad(f)
    tolerance = 0.01 * expected[:, 2].max()  # N
    assert contacts.touching.all()
    np.testing.assert_allclose(contacts.f[:, :3], expected[:, :3], atol=tolerance)
    np.testing.assert_allclose(force_sum(plant), -grasp.body.mass * EARTH, atol=tolerance)
    np.testing.assert_allclose(contacts.p_OC, grasp.contacts.p_OC, atol=1e-3)  # m: idle joints drift while contacts settle
    assert plant.t == 0.0
    assert np.linalg.norm(state.object.p_HO - grasp.p_HO) < 5e-5  # m: fingers that settle pull at the object's spring
    assert not state.v.any()
    assert not state.object.twist.any()


def test_default_forces_hold_the_weight():
    plant = allegro_plant()
    np.testing.assert_allclose(force_sum(plant), -0.05 * np.array(PALM_UP), atol=0.01)
    heavy = three_finger_grasp(mass=5.0)
    with pytest.raises(InvalidInput, match=r"f = None: must be given, because the hand cannot hold the object's weight"):
        allegro_plant(heavy)


def test_point_tips_touch_with_the_origins_of_their_frames():
    grasp = five_finger_grasp()
    grasp = replace(grasp, body=replace(grasp.body, shape=Sphere(float(np.linalg.norm(grasp.contacts.p_OC[0])))))
    with pytest.raises(InvalidInput, match="shape"):
        UrdfPlant(five_finger_grasp(), PlantOptions(gravity_H=EARTH))
    hand = named_grasp("dlr_hit2 sphere")
    assert hand.hand.finger("index").tip_radius is None
    plant = UrdfPlant(hand, PlantOptions(gravity_H=EARTH))
    np.testing.assert_allclose(plant.true_contacts().p_OC, hand.contacts.p_OC, atol=1e-4)  # m


def test_start_with_errors_of_place_is_in_contact_at_the_true_places():
    grasp, offset = three_finger_grasp(), np.array([[0.0, 0.002, 0.0], [0.0, 0.0, 0.002], [0.002, 0.0, 0.0]])
    for options in ({"tip_offset": offset}, {"shape_offset": [0.0, 0.002, 0.001]}):
        plant = allegro_plant(grasp, **options)
        contacts = plant.true_contacts()
        assert contacts.touching.all()
        centre = plant.options.shape_offset
        np.testing.assert_allclose(np.linalg.norm(contacts.p_OC - centre, axis=1), 0.03, atol=5e-5)  # m: the radius, penetrated
        n = (centre - contacts.p_OC) / np.linalg.norm(contacts.p_OC - centre, axis=1)[:, None]
        np.testing.assert_allclose(contacts.R_OC[:, :, 2], n, atol=1e-3)
        assert np.linalg.norm(contacts.p_OC - grasp.contacts.p_OC, axis=1).max() > 5e-4  # m: not where the grasp says


def test_turned_box_has_turned_normals():
    grasp = named_grasp("four_finger box")
    angle = np.radians(5.0)
    plant = UrdfPlant(grasp, PlantOptions(gravity_H=EARTH, shape_turn=[0.0, 0.0, angle]))
    cosines = np.vecdot(plant.true_contacts().R_OC[:, :, 2], grasp.contacts.R_OC[:, :, 2])
    np.testing.assert_allclose(cosines, np.cos(angle), atol=1e-9)


# ── laws of mechanics ────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_momentum_of_the_object_follows_the_forces():
    """m (v⁺ − v) / dt = Σ f + m g + push, to the rounding of the solver."""
    force = np.array([0.2, -0.1, 0.3])  # N
    plant = UrdfPlant(three_finger_grasp(), PlantOptions(gravity_H=PALM_UP), events=[lambda plant: plant.push(force)])
    mass = plant.grasp.body.mass
    tau = plant.true_contacts().tau
    for _ in range(20):
        before = plant.state().object
        after = plant.step(0.9 * tau).object
        contacts = plant.true_contacts()
        on_object = before.R_HO @ np.einsum("nij,nj->i", contacts.R_OC, contacts.f[:, :3])
        rate = mass * (after.twist[:3] - before.twist[:3]) / plant.dt
        np.testing.assert_allclose(rate, on_object + mass * np.array(PALM_UP) + force, atol=1e-9)


def test_push_acts_at_the_origin_of_the_object():
    """Without contacts, about the centre of mass: m a = F, I α = (p_O − p_M) × F + m, at rest."""
    inertia = np.diag([2e-5, 3e-5, 4e-5])
    body = Body(0.08, inertia, [0.004, -0.003, 0.006], Sphere(0.03))
    force, moment = np.array([0.3, -0.2, 0.1]), np.array([1e-3, 2e-3, -1e-3])
    grasp = three_finger_grasp()
    plant = UrdfPlant(grasp, PlantOptions(gravity_H=np.zeros(3), body=body), events=[lambda plant: plant.push(force, moment)])
    release(plant)
    motion = plant.step(np.zeros(grasp.hand.n)).object
    alpha = np.linalg.solve(inertia, moment - np.cross(body.p_OM, force))
    np.testing.assert_allclose(motion.twist[3:] / plant.dt, alpha, rtol=1e-9)
    np.testing.assert_allclose(motion.twist[:3] / plant.dt, force / body.mass - np.cross(alpha, body.p_OM), rtol=1e-9)


def release(plant: UrdfPlant | Plant) -> None:
    """Put the object far from the fingers, at rest."""
    address = plant.compiled.object_q if isinstance(plant, UrdfPlant) else plant.scene.object_q_address
    plant.data.qpos[address : address + 3] = [0.0, 0.0, 1.0]


def test_both_plants_fall_alike():
    """Two models of one hand and a free object under the same torques: they differ by rounding only."""
    grasp = three_finger_grasp()
    plants = [Plant(build_scene(grasp, gravity_H=PALM_UP)), allegro_plant(grasp)]
    rng = np.random.default_rng(2)
    torques = rng.uniform(-0.02, 0.02, (50, grasp.hand.n))  # N·m
    states = []
    for plant in plants:
        release(plant)
        plant.data.qpos[
            plant.scene.q_address[plant.scene.motor_joints] if isinstance(plant, Plant) else plant.compiled.q_rows
        ] = grasp.q
        for tau in torques:
            state = plant.step(tau)
        states.append(state)
    np.testing.assert_allclose(states[0].q, states[1].q, atol=1e-10)
    np.testing.assert_allclose(states[0].object.p_HO, states[1].object.p_HO, atol=1e-10)
    t, steps = 0.05, 50
    fallen = 0.5 * np.array(PALM_UP) * t**2 * (1.0 + 1.0 / steps)  # m: of the semi-implicit Euler method
    np.testing.assert_allclose(states[1].object.p_HO - [0.0, 0.0, 1.0], fallen, atol=1e-9)


def test_both_plants_hold_and_move_a_ball_alike():
    """Contact models and rolling differ at 1 µm; the contact forces are those that the controller plans."""
    grasp = three_finger_grasp()
    runs = [
        simulate(
            plant,
            ObjectController(grasp, SETTINGS),
            linear_reference(BodyMotion(grasp.p_HO, grasp.R_HO), [0.005, 0.0, 0.0], 1.0),
            0.5,
        )
        for plant in (Plant(build_scene(grasp, gravity_H=PALM_UP)), allegro_plant(grasp))
    ]
    np.testing.assert_allclose(runs[0].p_HO, runs[1].p_HO, atol=1e-5)  # m
    np.testing.assert_allclose(runs[0].f[..., :3], runs[1].f[..., :3], atol=0.02 * runs[0].f[..., 2].max())
    assert compute_metrics(runs[1]).position_error_rms < 5e-6  # m
    assert runs[1].warnings == ()


# ── joints ───────────────────────────────────────────────────────────────────────────────────────────────────────────────────


def rates_under(extra: float, joint: int, steps: int, **options):
    """Return the rates of a joint in a free hand without gravity, under a constant torque on this joint."""
    grasp = three_finger_grasp()
    plant = UrdfPlant(grasp, PlantOptions(gravity_H=np.zeros(3), **options))
    release(plant)
    tau = np.zeros(grasp.hand.n)
    tau[joint] = extra
    return np.array([plant.step(tau).v for _ in range(steps)])


def test_coulomb_friction_holds_a_joint_up_to_its_torque():
    below, above = (rates_under(torque, 5, 20, coulomb=0.05) for torque in (0.045, 0.06))
    assert np.abs(below).max() < 1e-4  # rad/s: the engine's friction creeps a little
    assert above[-1, 5] > 0.05
    assert np.abs(np.delete(above[-1], 5)).max() < 1e-2  # other joints of the finger are held


def test_sliding_friction_is_lower_than_at_rest():
    """In 5 ms the joint passes the Stribeck velocity; then the drop of friction accelerates it."""
    constant, falling = (
        rates_under(0.08, 5, 20, coulomb=coulomb, stribeck=stribeck, stribeck_velocity=0.02)
        for coulomb, stribeck in ((0.07, 0.0), (0.04, 0.03))
    )
    assert falling[-1, 5] > 1.5 * constant[-1, 5] > 0.0
    assert np.abs(rates_under(0.065, 5, 20, coulomb=0.04, stribeck=0.03)).max() < 1e-4  # rad/s


def test_viscous_friction_limits_the_rate():
    viscous = np.zeros(16)
    viscous[5] = 0.5  # N·m·s/rad, so that M/B is some 4 ms
    coulomb = np.full(16, 1.0)
    coulomb[5] = 0.0
    assert rates_under(0.05, 5, 40, viscous=viscous, coulomb=coulomb)[-1, 5] == pytest.approx(0.1, rel=1e-3)  # rad/s


def test_torques_are_limited_and_scaled():
    gain = np.linspace(0.8, 1.2, 16)
    plant = allegro_plant(torque_gain=gain)
    plant.step(np.full(16, 0.1))
    np.testing.assert_allclose(plant.true_contacts().tau, 0.1 * gain)
    plant.step(np.full(16, 9.0))
    np.testing.assert_allclose(plant.true_contacts().tau, 0.7 * gain)  # N·m: the command is limited, then scaled
    plant.set_torque_gain(np.zeros(16))
    plant.step(np.full(16, 0.1))
    assert not plant.true_contacts().tau.any()


# ── contacts ─────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize(("options", "condim"), [({}, 3), ({"torsional_friction": 0.005}, 4), ({"rolling_friction": 1e-4}, 6)])
def test_forces_stay_in_the_true_cones(options, condim):
    """‖f_t‖ ≤ μ f_n; √(‖f_t‖²/μ² + m²/γ²) ≤ f_n with torsion; at the edge under a torque that no contact can resist."""
    twist = [1e-2, 0.0, 0.0]  # N·m
    plant = UrdfPlant(
        three_finger_grasp(), PlantOptions(gravity_H=PALM_UP, friction=[0.5, 0.6, 0.7], **options),
        events=[lambda plant: plant.push([2.0, 0.0, 0.0], twist)],
    )  # fmt: skip
    assert set(plant.model.pair_dim[list(plant.compiled.pairs)]) == {condim}
    tau, used = plant.true_contacts().tau, 0.0
    for _ in range(30):
        plant.step(tau)
        contacts = plant.true_contacts()
        f = contacts.f[contacts.touching]
        gamma = contacts.gamma[contacts.touching]
        shares = np.square(f[:, :2]).sum(axis=1) / np.square(contacts.mu[contacts.touching])
        if condim == 4:
            shares = shares + np.square(f[:, 3] / gamma)
        assert np.all(np.sqrt(shares) <= f[:, 2] * (1.0 + 1e-6) + 1e-9)
        used = max(used, float((np.sqrt(shares) / np.maximum(f[:, 2], 1e-9)).max()))
    assert used > 0.99  # the object slips
    np.testing.assert_array_equal(contacts.mu, [0.5, 0.6, 0.7])
    np.testing.assert_array_equal(contacts.gamma, 0.005 if condim == 4 else 0.0)


def test_friction_that_vanishes_drops_the_object():
    def oil(plant):
        if plant.t >= 0.01:
            plant.set_friction(np.full(3, 1e-3))

    grasp = three_finger_grasp()
    plant = UrdfPlant(grasp, PlantOptions(gravity_H=PALM_UP), events=[oil])
    tau = plant.true_contacts().tau
    for _ in range(60):
        state = plant.step(tau)
    assert (state.object.p_HO - grasp.p_HO)[0] < -1e-3  # m; gravity is along −x
    np.testing.assert_array_equal(plant.true_contacts().mu, 1e-3)


def test_frames_of_the_contacts_are_those_of_contact_records():
    contacts = allegro_plant().true_contacts()
    for p, R in zip(contacts.p_OC, contacts.R_OC, strict=True):
        np.testing.assert_allclose(Contact(p, R[:, 2], 0.5).R_OC, R, atol=1e-12)


def test_loop_corrects_errors_of_the_plant():
    """Mass 30 % off, motors 10 % weak, tips 2 mm off: the integral removes the error to 0.1 mm in 0.5 s."""
    grasp = three_finger_grasp()
    body = replace(grasp.body, mass=1.3 * grasp.body.mass)
    plant = allegro_plant(grasp, body=body, torque_gain=0.9, tip_offset=np.full((3, 3), 1e-3))
    rest = linear_reference(BodyMotion(grasp.p_HO, grasp.R_HO), np.zeros(3), 1.0)
    run = simulate(plant, ObjectController(grasp, SETTINGS), rest, 0.5)
    assert np.linalg.norm(run.position_error[-1]) < 1e-4  # m
    assert run.touching.all()


# ── options ──────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("coulomb", -0.1, "at least 0"),
        ("stribeck_velocity", 0.0, "greater than 0"),
        ("dt", 0.0, "greater than 0"),
        ("friction", [0.5, 0.5], "a list of 3 numbers"),
        ("torque_gain", [1.0], "a list of 16 numbers"),
        ("tip_offset", [[0.0, 0.0, 0.0]], "an array of 3 × 3 numbers"),
        ("shape_turn", [0.0], "a list of 3 numbers"),
        ("body", Body.solid(Superquadric([0.03, 0.03, 0.03], [0.5, 0.5]), 0.05), "a sphere, a cylinder or a box"),
    ],
)
def test_impossible_options_are_named(field, value, message):
    with pytest.raises(InvalidInput, match=f"{'shape' if field == 'body' else field}.*must be.*{message}"):
        allegro_plant(**{field: value})


def test_commands_are_checked():
    plant = allegro_plant()
    with pytest.raises(InvalidInput, match="tau"):
        plant.step(np.zeros(3))
    with pytest.raises(InvalidInput, match="mu"):
        plant.set_friction([-1.0, 0.5, 0.5])
    with pytest.raises(InvalidInput, match="f"):
        plant.reset(np.zeros(2))
