"""The plant obeys Newton: its contact forces bear what acts on the object, and what disturbs it does so by its own law."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.hands import load

from graspforce import Contact, ContactSet, InvalidInput
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, ObjectController
from graspforce.core.errors import UnknownName
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.grasp import Grasp
from graspforce.hand.motor import MotorModel
from graspforce.simulation.disturbance import ContactLoss, FrictionChange, MassChange, MotorFailure, Push
from graspforce.simulation.plant import Plant
from graspforce.simulation.scene import build_scene

EARTH, WEIGHTLESS = (0.0, 0.0, -9.81), (0.0, 0.0, 0.0)


def afloat(hand: str = "four_finger", **options) -> Plant:
    """Return an object that no finger reaches, in no gravity: a rigid body alone."""
    inertia = np.array([[2e-5, 1e-6, 0.0], [1e-6, 3e-5, -2e-6], [0.0, -2e-6, 4e-5]])
    body = Body(0.1, inertia, [0.004, -0.003, 0.006], Sphere(0.01))
    contacts = ContactSet.stack([Contact([0.01, 0.0, 0.0], [-1.0, 0.0, 0.0], 0.5)])
    R_HO = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix()
    model = load(hand)
    grasp = Grasp(model, body, (model.fingers[0].name,), contacts, model.neutral, [0.0, 0.0, 0.6], R_HO)
    return Plant(build_scene(grasp, gravity_H=WEIGHTLESS), **options)


def holding(plant: Plant) -> Callable[[], np.ndarray]:
    """Return torques that bear the present contact forces and damp the joints, without a controller."""
    grasp = plant.scene.grasp
    f = plant.true_contacts().f.ravel()[grasp.contacts.columns]

    def torques() -> np.ndarray:
        state = plant.state()
        J = grasp.hand.contact_jacobian(state.q, grasp.fingers, grasp.contacts, state.object.p_HO, state.object.R_HO)
        return grasp.hand.gravity_torque(state.q, plant.scene.gravity_H) + J.T @ f - 0.02 * state.v

    return torques


def borne(plant: Plant) -> np.ndarray:
    """Return the wrench of the plant's contact forces about O's origin, in O."""
    true_contacts, grasp = plant.true_contacts(), plant.scene.grasp
    n = len(grasp.contacts)
    contacts = ContactSet(
        true_contacts.p_OC,
        true_contacts.R_OC,
        grasp.contacts.models,
        true_contacts.mu,
        true_contacts.gamma,
        np.zeros(n),
        np.full(n, np.inf),
    )
    return np.einsum("nij,nj->i", contacts.wrench_bases(), true_contacts.f)


@pytest.mark.parametrize("model", ["point", "soft"])
def test_at_rest_the_contact_forces_bear_the_weight(model):
    grasp = three_finger_grasp(model=model)
    plant = Plant(build_scene(grasp, gravity_H=PALM_UP))
    torques = holding(plant)
    for _ in range(20):
        plant.step(torques())
    true_contacts = plant.true_contacts()
    w = grasp.body.wrench(plant.object_motion(), PALM_UP)
    assert true_contacts.touching.all()
    # a hundredth of the weight of 0.49 N: the fingers still move by some µm/s, and the hold is not a stable one
    np.testing.assert_allclose(borne(plant)[:3], w[:3], atol=5e-3)
    np.testing.assert_allclose(borne(plant)[3:], w[3:], atol=5e-3 * 0.03)
    assert np.all(true_contacts.f[:, 2] > 0.0)
    assert np.all(true_contacts.depth > 0.0)
    assert np.all(true_contacts.depth < 1e-4)  # m
    for i in range(3):
        np.testing.assert_allclose(true_contacts.R_OC[i, :, 2], grasp.contacts.R_OC[i, :, 2], atol=1e-3)
        np.testing.assert_allclose(true_contacts.R_OC[i] @ true_contacts.R_OC[i].T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(true_contacts.mu, 0.7)
    np.testing.assert_allclose(true_contacts.gamma, 0.005 if model == "soft" else 0.0)


@pytest.mark.parametrize("model", ["point", "soft"])
def test_contact_forces_gravity_and_push_make_the_objects_acceleration(model):
    """Newton and Euler on the recorded forces, their moment about the normal included, while a push off the centre acts."""
    grasp = three_finger_grasp(model=model)
    push = Push([0.3, 0.4, -0.2], 0.0, 0.02, [0.0, 0.01, 0.02])
    plant = Plant(build_scene(grasp, gravity_H=PALM_UP), disturbances=[push])
    torques, twist = holding(plant), 0.0
    for _ in range(20):
        before = plant.object_motion()
        after = plant.step(torques()).object
        acceleration = (after.twist - before.twist) / plant.dt
        needed = grasp.body.wrench(BodyMotion(before.p_HO, before.R_HO, before.twist, acceleration), PALM_UP)
        force = before.R_HO.T @ push.force
        given = borne(plant) + np.append(force, np.cross(push.point, force))
        # the true contact lies in the middle of 10 µm of overlap, and the turn during a step is left out
        np.testing.assert_allclose(given[:3], needed[:3], atol=1e-6)
        np.testing.assert_allclose(given[3:], needed[3:], atol=1e-6)
        twist = max(twist, np.abs(plant.true_contacts().f[:, 3]).max())
    assert twist > 1e-4 if model == "soft" else twist == 0.0  # N·m: a hundred times what would be overlooked


def test_pressing_begins_as_asked():
    grasp = three_finger_grasp()
    plant = Plant(build_scene(grasp, gravity_H=PALM_UP))
    f = 2.0 * plant.true_contacts().f.ravel()[grasp.contacts.columns]
    f -= np.linalg.lstsq(*_balance(grasp, f), rcond=None)[0]
    state = plant.reset(f)
    np.testing.assert_allclose(plant.true_contacts().f[:, :3].ravel(), f, atol=0.01 * np.abs(f).max())
    np.testing.assert_array_equal(state.object.p_HO, grasp.p_HO)
    np.testing.assert_array_equal(state.v, 0.0)
    assert plant.t == 0.0


def test_what_the_structure_bears_is_there_from_the_first_step():
    """Planar fingers on a ball, normals up to 50° out of their planes: no motor presses along them, and nothing slides."""
    hand, ball, fingers = load("anthropomorphic15"), Sphere(0.043), ("thumb", "index", "little")
    q = [
        0.5820,
        1.3894,
        0.0616,
        0.4106,
        1.6570,
        0.4745,
        *np.full(6, 0.08),
        0.6934,
        0.1410,
        0.9450,
    ]  # rad
    p_HO = np.array([0.05586, 0.01637, 0.06903])  # m
    closest_points = ball.project_to_surface(np.array([hand.tip_pose(q, name)[0] for name in fingers]) - p_HO)
    contacts = ContactSet.stack([Contact(p, -p, 0.8, max_normal=20.0) for p in closest_points])
    grasp = Grasp(hand, Body.solid(ball, 0.01), fingers, contacts, q, p_HO, np.eye(3))
    J = grasp.hand.contact_jacobian(grasp.q, grasp.fingers, grasp.contacts, grasp.p_HO, grasp.R_HO).reshape(
        len(grasp.fingers), 3, -1
    )
    across = np.linalg.svd(J)[0][:, :, 2]  # of each finger's plane, in the contact frames
    assert np.abs(across[:, 2]).max() > 0.5
    controller, desired = ObjectController(grasp, ControlSettings(gravity_H=EARTH)), BodyMotion(grasp.p_HO, grasp.R_HO)
    plant = Plant(build_scene(grasp, gravity_H=EARTH))
    first = controller.step(plant.state(), desired)
    assert np.linalg.norm(first.structural_wrench[:3]) > 0.1  # N
    state = plant.reset(first.f)
    np.testing.assert_allclose(plant.true_contacts().f[:, :3].ravel(), first.f, atol=0.01 * first.f.max())
    controller.reset()
    away, least = [], []
    for _ in range(100):
        state = plant.step(controller.step(state, desired).tau)
        true_contacts = plant.true_contacts()
        away.append(np.linalg.norm(state.object.p_HO - grasp.p_HO))
        least.append((true_contacts.mu * true_contacts.f[:, 2] - np.hypot(true_contacts.f[:, 0], true_contacts.f[:, 1])).min())
    assert max(away) < 2e-6  # m; 190e-6 where the tips slide over the ball
    assert min(least) > 0.9 * first.slip_margin.min()


def _balance(grasp, f):
    """G and by how much G f is not the weight."""
    bases = grasp.contacts.wrench_bases()
    G = bases.transpose(1, 0, 2).reshape(6, -1)[:, grasp.contacts.columns]
    return G, G @ f - grasp.body.wrench(BodyMotion(grasp.p_HO, grasp.R_HO), PALM_UP)


def test_torques_are_cut_at_the_motors_limits():
    plant = afloat()
    hand = plant.scene.grasp.hand
    command = np.where(np.arange(hand.n) % 2, 100.0, -100.0)
    plant.step(command)
    np.testing.assert_array_equal(plant.true_contacts().tau, np.clip(command, hand.torque_lower, hand.torque_upper))
    with pytest.raises(InvalidInput, match="tau"):
        plant.step(np.full(hand.n, np.nan))


def test_motors_stand_between_command_and_joint():
    """A voltage drive at rest gives what is asked; then back-EMF takes k² N²/R of the rate, and the winding delays by L/R."""
    hand = load("four_finger")
    motors = MotorModel.for_hand(hand, amplifier="voltage")
    plant, command = afloat(motors=motors), np.full(hand.n, 0.01)
    plant.step(command)
    np.testing.assert_allclose(plant.true_contacts().tau, command, rtol=1e-12)
    v = plant.state().v
    plant.step(command)
    brake = (motors.gear_ratio * motors.torque_constant) ** 2 / motors.resistance  # N·m·s/rad
    np.testing.assert_allclose(plant.true_contacts().tau, command - brake * v, rtol=1e-9)
    slow = afloat(motors=MotorModel.for_hand(hand, amplifier="voltage", electrical_time_constant=0.01))
    slow.step(command)
    x = 0.1  # dt over the winding's time constant
    np.testing.assert_allclose(slow.true_contacts().tau, command * (1.0 + np.expm1(-x) / x), rtol=1e-9)
    slow.step(command)
    assert np.all(slow.true_contacts().tau > 0.13 * command)  # the current goes on from where it was
    slow.reset(np.zeros(3))
    slow.step(command)
    np.testing.assert_allclose(slow.true_contacts().tau, command * (1.0 + np.expm1(-x) / x), rtol=1e-9)
    with pytest.raises(InvalidInput, match="12 motors"):
        afloat(motors=MotorModel.for_hand(load("allegro_right")))


def test_joints_accelerate_as_the_hands_own_dynamics_say():
    plant = afloat("dlr_hit2")  # with followers
    hand, scene = plant.scene.grasp.hand, plant.scene
    a = np.random.default_rng(3).normal(size=hand.n)  # rad/s²
    state = plant.state()
    plant.step(hand.inverse_dynamics(state.q, state.v, a, scene.gravity_H))
    # couplings are soft by 1e-4 of what they bear
    np.testing.assert_allclose(plant.state().v, plant.dt * a, atol=1e-3 * plant.dt)


def test_followers_follow_their_leaders():
    """A swing of 0.3 rad at 2 Hz: the stated accuracy of couplings."""
    plant = afloat("dlr_hit2")
    hand = plant.scene.grasp.hand
    worst, omega = 0.0, 4.0 * np.pi
    for k in range(500):
        state, phase = plant.state(), omega * k * plant.dt
        q = hand.neutral + 0.15 * (1.0 - np.cos(phase))
        a = 0.15 * omega**2 * np.cos(phase) + 900.0 * (q - state.q) + 60.0 * (0.15 * omega * np.sin(phase) - state.v)
        plant.step(hand.inverse_dynamics(state.q, state.v, a, plant.scene.gravity_H))
        worst = max(worst, plant.coupling_error())
    assert 0.0 < worst < 1e-6  # rad


def test_a_push_moves_a_free_body_by_its_impulse():
    """m Δv_M = F T and Δ(I ω) = (r − c) × F T, from rest and for a time so short that it hardly turns."""
    force, point = np.array([0.3, -0.2, 0.5]), np.array([0.002, 0.005, -0.004])
    plant = afloat(disturbances=[Push(force, 0.002, 0.003, point)])
    body, rest = plant.scene.grasp.body, np.zeros(plant.scene.grasp.hand.n)
    for _ in range(10):
        plant.step(rest)
    now = plant.object_motion()
    R_HO = plant.scene.grasp.R_HO
    spin = np.linalg.solve(R_HO @ body.inertia @ R_HO.T, np.cross(R_HO @ (point - body.p_OM), force)) * 0.003  # rad/s
    np.testing.assert_allclose(now.twist[3:], spin, rtol=3e-3)  # it turns by 0.003 rad meanwhile
    of_mass_centre = now.twist[:3] + np.cross(now.twist[3:], now.R_HO @ body.p_OM)  # m/s
    np.testing.assert_allclose(of_mass_centre, force * 0.003 / body.mass, rtol=1e-4)


def test_more_mass_moves_less():
    push = Push([0.0, 0.0, 0.1], 0.0, 1.0)
    plain, loaded = afloat(disturbances=[push]), afloat(disturbances=[MassChange(2.0, 0.005), push])
    rest = np.zeros(plain.scene.grasp.hand.n)
    for k in range(10):
        before = [p.object_motion().twist for p in (plain, loaded)]
        plain.step(rest), loaded.step(rest)
        gained = [p.object_motion().twist - v for p, v in zip((plain, loaded), before, strict=True)]
        factor = 1.0 if k < 5 else 2.0
        np.testing.assert_allclose(gained[0], factor * gained[1], rtol=1e-2)  # it turns a little meanwhile
    loaded.reset(np.zeros(3))
    assert loaded.model.body_mass[loaded.scene.object_body] == pytest.approx(0.1)


def test_friction_goes_along_a_line_and_stays():
    change = FrictionChange(0.4, 0.002, 0.004, "middle")
    plant = Plant(build_scene(three_finger_grasp(), gravity_H=PALM_UP), disturbances=[change])
    seen, torques = [], holding(plant)
    for _ in range(10):
        plant.step(torques())
        seen.append(plant.true_contacts().mu)
    seen = np.array(seen)
    np.testing.assert_allclose(seen[:, 1], [0.7, 0.7, 0.7, 0.625, 0.55, 0.475, 0.4, 0.4, 0.4, 0.4])
    np.testing.assert_allclose(seen[:, [0, 2]], 0.7)


def test_a_finger_leaves_when_it_is_pulled_harder_than_it_presses():
    grasp = three_finger_grasp()
    scene = build_scene(grasp, gravity_H=PALM_UP)
    pressing = Plant(scene).true_contacts().f[0, 2]  # N
    for factor, leaves in ((0.3, False), (1.5, True)):
        plant = Plant(scene, disturbances=[ContactLoss("index", factor * pressing, 0.0, 0.05)])
        torques = holding(plant)
        for _ in range(15):
            plant.step(torques())
        assert plant.true_contacts().touching[0] == (not leaves)
    plant = Plant(scene, disturbances=[ContactLoss("ring", 1.0, 0.0, 0.05)])
    with pytest.raises(UnknownName, match="index, middle, thumb"):
        plant.step(holding(plant)())


def test_a_dead_motor_gives_nothing():
    plant = afloat(disturbances=[MotorFailure("finger_1_joint_2", 0.002)])
    hand = plant.scene.grasp.hand
    i = [joint.name for joint in hand.joints].index("finger_1_joint_2")
    for k in range(4):
        plant.step(np.full(hand.n, 0.01))
        assert plant.true_contacts().tau[i] == (0.01 if k < 2 else 0.0)
        assert np.delete(plant.true_contacts().tau, i) == pytest.approx(0.01)
    with pytest.raises(UnknownName, match="finger_1_joint_1"):
        afloat(disturbances=[MotorFailure("elbow", 0.0)]).step(np.zeros(hand.n))


def test_what_is_dropped_lies_on_the_floor():
    grasp = three_finger_grasp()
    plant = Plant(build_scene(grasp, gravity_H=PALM_UP, floor=0.08))
    hand = grasp.hand
    for _ in range(1500):
        state = plant.state()
        open_hand = hand.gravity_torque(state.q, PALM_UP) - 0.5 * (state.q - hand.q_lower) - 0.02 * state.v
        plant.step(open_hand)
    height = plant.object_motion().p_HO[0] - (grasp.p_HO[0] - 0.08)  # m above the floor, x being up
    assert height == pytest.approx(0.03, abs=1e-4)


def test_what_cannot_be_is_refused():
    for make in (
        lambda: Push([0.0, 0.0, np.nan], 0.0, 1.0),
        lambda: Push([0.0, 0.0, 1.0], -1.0, 1.0),
        lambda: MassChange(0.0, 1.0),
        lambda: FrictionChange(-0.1, 0.0),
        lambda: ContactLoss("index", -1.0, 0.0, 1.0),
        lambda: MotorFailure("x", 0.0, float("nan")),
    ):
        with pytest.raises(InvalidInput):
            make()
    heavy = three_finger_grasp(mass=20.0)
    with pytest.raises(InvalidInput, match="cannot hold"):
        Plant(build_scene(heavy, gravity_H=PALM_UP))
