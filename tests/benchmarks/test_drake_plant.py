"""The plant in Drake: agreement with Pinocchio and with MuJoCo, laws of mechanics, joint friction."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.control_grasps import make_nearest_grasp, named_grasp
from support.hands import load, random_posture

from graspforce import InvalidInput
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState, ObjectController
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.simulation import PlantOptions, UrdfPlant, linear_reference, simulate

pytest.importorskip("pydrake")
sys.path.append(str(Path(__file__).parents[2]))  # the folder of benchmarks; behind the installed packages

from benchmarks.drake_plant import SUBSTEPS, DrakePlant, coupling_error, mass_matrix

EARTH = np.array([0.0, 0.0, -9.81])  # m/s²
SETTINGS = ControlSettings(gravity_H=PALM_UP)


def allegro_plant(events=(), substeps: int = SUBSTEPS, **options) -> DrakePlant:
    return DrakePlant(three_finger_grasp(), PlantOptions(gravity_H=PALM_UP, **options), events=events, substeps=substeps)


@pytest.mark.parametrize("name", ["allegro_right sphere", "four_finger box"])
def test_mass_matrix_is_that_of_pinocchio(name):
    """Two libraries read the same URDF; both round sums of some hundred terms."""
    grasp = named_grasp(name)
    plant = DrakePlant(grasp, PlantOptions(gravity_H=EARTH))
    for seed in range(2):
        q = random_posture(grasp.hand, seed)
        M = grasp.hand.mass_matrix(q)
        np.testing.assert_allclose(mass_matrix(plant, q), M, rtol=0, atol=1e-12 * np.abs(M).max())


def test_contacts_carry_the_given_forces_from_the_start():
    grasp, plant = three_finger_grasp(), allegro_plant()
    rest = BodyMotion(grasp.p_HO, grasp.R_HO)
    f = ObjectController(grasp, SETTINGS).step(GraspState(grasp.q, np.zeros(16), rest), rest).f
    state = plant.reset(f)
    expected = grasp.contacts.pad(f)
    np.testing.assert_allclose(plant.true_contacts().f, expected, atol=0.01 * expected[:, 2].max())
    assert np.linalg.norm(state.object.p_HO - grasp.p_HO) < 5e-5  # m: fingers that settle pull at the object's spring
    assert not state.v.any()
    depth = expected[:, 2] / 1e5  # m: the stiffness of the contacts in N/m
    np.testing.assert_allclose(plant.true_contacts().depth, depth, rtol=0.02)


def test_momentum_of_the_object_follows_the_forces():
    """m (v⁺ − v) / dt = Σ f + m g + push in a step of the engine, to the tolerance of its solver."""
    force, friction = np.array([0.2, -0.1, 0.3]), np.array([0.4, 0.5, 0.6])  # N
    plant = allegro_plant([lambda plant: plant.push(force)], substeps=1, friction=friction)
    mass, tau = plant.grasp.body.mass, plant.true_contacts().tau
    for _ in range(20):
        before = plant.state().object
        after = plant.step(0.9 * tau).object
        contacts = plant.true_contacts()
        on_object = before.R_HO @ np.einsum("nij,nj->i", contacts.R_OC, contacts.f[:, :3])
        rate = mass * (after.twist[:3] - before.twist[:3]) / plant.dt
        np.testing.assert_allclose(rate, on_object + mass * np.array(PALM_UP) + force, atol=1e-5)
        shares = np.linalg.norm(contacts.f[:, :2], axis=1) / np.maximum(contacts.f[:, 2], 1e-9)
        assert np.all(shares <= friction * (1.0 + 1e-6))


@pytest.mark.parametrize("options", [{}, {"coulomb": 0.05, "viscous": 0.01}, {"tip_offset": np.full((3, 3), 1e-3)}])
def test_two_engines_hold_and_move_a_ball_alike(options):
    """Two engines from one URDF; contact models differ by some µm, and friction of joints amplifies that to a tenth."""
    grasp = three_finger_grasp()
    reference = linear_reference(BodyMotion(grasp.p_HO, grasp.R_HO), [0.005, 0.0, 0.0], 1.0)
    plants = [Plant(grasp, PlantOptions(gravity_H=PALM_UP, **options)) for Plant in (DrakePlant, UrdfPlant)]
    drake, mujoco = (simulate(plant, ObjectController(grasp, SETTINGS), reference, 0.4) for plant in plants)
    difference = np.linalg.norm(drake.p_HO - mujoco.p_HO, axis=1).max()
    off = np.linalg.norm(mujoco.position_error, axis=1).max()
    assert difference < max(1e-5, 0.1 * off)  # m
    if not options:
        assert np.sqrt(np.mean(np.square(drake.position_error).sum(axis=1))) < 5e-6  # m
        np.testing.assert_allclose(drake.f[..., :3], mujoco.f[..., :3], atol=0.02 * mujoco.f[..., 2].max())


def rates_under(extra: float, steps: int, **options):
    """Return the rates of a joint in a hand without gravity that does not touch, under a constant torque on it."""
    grasp = three_finger_grasp()
    body = Body(50.0, grasp.body.inertia, shape=grasp.body.shape)  # a heavy object stays where it is
    coulomb = np.full(16, 1.0)
    coulomb[9] = options.pop("coulomb", 0.0)
    plant = DrakePlant(grasp, PlantOptions(gravity_H=np.zeros(3), body=body, coulomb=coulomb, **options))
    tau = np.zeros(16)
    tau[9] = extra
    return np.array([plant.step(tau).v[9] for _ in range(steps)])


def test_joint_friction_follows_its_law():
    """The ring finger's second joint moves alone, and touches nothing."""
    assert np.abs(rates_under(0.045, 20, coulomb=0.05)).max() < 1e-3  # rad/s: the brake's smoothing
    sliding = rates_under(0.06, 20, coulomb=0.05)
    constant, falling = rates_under(0.08, 20, coulomb=0.07), rates_under(0.08, 20, coulomb=0.04, stribeck=joint_nine(0.03))
    assert sliding[-1] == pytest.approx(constant[-1], rel=1e-2)  # both have 0.01 N·m left
    assert falling[-1] > 1.5 * constant[-1]
    assert rates_under(0.05, 60, viscous=joint_nine(0.5))[-1] == pytest.approx(0.1, rel=1e-3)  # rad/s


def joint_nine(value: float):
    return value * np.eye(16)[9]


def test_torques_are_limited_and_scaled():
    plant = allegro_plant(torque_gain=0.8)
    plant.step(np.full(16, 9.0))
    np.testing.assert_allclose(plant.true_contacts().tau, 0.8 * 0.7)  # N·m
    plant.set_torque_gain(np.zeros(16))
    plant.step(np.full(16, 0.1))
    assert not plant.true_contacts().tau.any()


def test_coupled_joints_move_together():
    hand = load("dlr_hit2")
    grasp = make_nearest_grasp(hand, ("thumb", "index"), Sphere(0.03), [0.0838, -0.0084, 0.0745])
    plant = DrakePlant(grasp, PlantOptions(gravity_H=EARTH))
    rng = np.random.default_rng(1)
    for _ in range(50):
        plant.step(rng.uniform(-0.05, 0.05, hand.n))
    assert coupling_error(plant) < 1e-4  # rad: the engine's couplings are stiff springs
    M = hand.mass_matrix(hand.neutral)
    np.testing.assert_allclose(mass_matrix(plant, hand.neutral), M, rtol=0, atol=1e-12 * np.abs(M).max())


def test_hands_without_spherical_tips_are_rejected():
    with pytest.raises(InvalidInput, match="spherical tips"):
        DrakePlant(named_grasp("dlr_hit2 sphere"), PlantOptions(gravity_H=EARTH))


def test_options_that_drake_lacks_are_rejected():
    with pytest.raises(InvalidInput, match=r"torsional_friction = 0\.005: must be absent"):
        allegro_plant(torsional_friction=0.005)
