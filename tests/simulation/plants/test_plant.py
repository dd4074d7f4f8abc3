"""The plant: its forces and motions obey Newton's and Euler's laws."""

from __future__ import annotations

import numpy as np
import pytest
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.hands import load
from support.simulated_runs import contact_wrench, free_body_plant, holding_torques

from graspforce import InvalidInput
from graspforce.contact.motion import BodyMotion
from graspforce.hand.motor import MotorModel
from graspforce.simulation.plants.disturbance import Push
from graspforce.simulation.plants.engine_settings import EngineSettings
from graspforce.simulation.plants.plant import Plant
from graspforce.simulation.plants.scene import build_scene


@pytest.mark.parametrize("model", ["point", "soft"])
def test_contact_forces_carry_the_weight_at_rest(model):
    grasp = three_finger_grasp(model=model)
    plant = Plant(build_scene(grasp, gravity_H=PALM_UP))
    torques = holding_torques(plant)
    for _ in range(20):
        plant.step(torques())
    true_contacts = plant.true_contacts()
    w = grasp.body.wrench(plant.object_motion(), PALM_UP)
    assert true_contacts.touching.all()
    # 1 % of the weight of 0.49 N: without a controller the fingers move at some µm/s
    np.testing.assert_allclose(contact_wrench(plant)[:3], w[:3], atol=5e-3)
    np.testing.assert_allclose(contact_wrench(plant)[3:], w[3:], atol=5e-3 * 0.03)
    assert np.all(true_contacts.f[:, 2] > 0.0)
    assert np.all(true_contacts.depth > 0.0)
    assert np.all(true_contacts.depth < 1e-4)  # m
    for i in range(3):
        np.testing.assert_allclose(true_contacts.R_OC[i, :, 2], grasp.contacts.R_OC[i, :, 2], atol=1e-3)
        np.testing.assert_allclose(true_contacts.R_OC[i] @ true_contacts.R_OC[i].T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(true_contacts.mu, 0.7)
    np.testing.assert_allclose(true_contacts.gamma, 0.005 if model == "soft" else 0.0)


@pytest.mark.parametrize("model", ["point", "soft"])
def test_contact_forces_gravity_and_push_accelerate_the_object(model):
    """Newton's and Euler's laws for the contact forces, with moments about the normals, and an eccentric push."""
    grasp = three_finger_grasp(model=model)
    push = Push([0.3, 0.4, -0.2], 0.0, 0.02, [0.0, 0.01, 0.02])
    plant = Plant(build_scene(grasp, gravity_H=PALM_UP), disturbances=[push])
    torques, twist = holding_torques(plant), 0.0
    for _ in range(20):
        before = plant.object_motion()
        after = plant.step(torques()).object
        acceleration = (after.twist - before.twist) / plant.dt
        needed = grasp.body.wrench(BodyMotion(before.p_HO, before.R_HO, before.twist, acceleration), PALM_UP)
        force = before.R_HO.T @ push.force
        given = contact_wrench(plant) + np.append(force, np.cross(push.point, force))
        # the contact point lies in the middle of a penetration of 10 µm; the rotation in a step is neglected
        np.testing.assert_allclose(given[:3], needed[:3], atol=1e-6)
        np.testing.assert_allclose(given[3:], needed[3:], atol=1e-6)
        twist = max(twist, np.abs(plant.true_contacts().f[:, 3]).max())
    assert twist > 1e-4 if model == "soft" else twist == 0.0  # N·m: 100 times the tolerance


def test_torques_are_limited_to_the_motors_range():
    plant = free_body_plant()
    hand = plant.scene.grasp.hand
    command = np.where(np.arange(hand.n) % 2, 100.0, -100.0)
    plant.step(command)
    np.testing.assert_array_equal(plant.true_contacts().tau, np.clip(command, hand.torque_lower, hand.torque_upper))
    with pytest.raises(InvalidInput, match="tau"):
        plant.step(np.full(hand.n, np.nan))


def test_motor_model_acts_between_command_and_joint():
    """A voltage drive gives the command at rest; back-EMF adds a damping of k² N²/R, and the winding a lag of L/R."""
    hand = load("four_finger")
    motors = MotorModel.for_hand(hand, amplifier="voltage")
    plant, command = free_body_plant(motors=motors), np.full(hand.n, 0.01)
    plant.step(command)
    np.testing.assert_allclose(plant.true_contacts().tau, command, rtol=1e-12)
    v = plant.state().v
    plant.step(command)
    brake = (motors.gear_ratio * motors.torque_constant) ** 2 / motors.resistance  # N·m·s/rad
    np.testing.assert_allclose(plant.true_contacts().tau, command - brake * v, rtol=1e-9)
    slow = free_body_plant(motors=MotorModel.for_hand(hand, amplifier="voltage", electrical_time_constant=0.01))
    slow.step(command)
    x = 0.1  # dt over the winding's time constant
    np.testing.assert_allclose(slow.true_contacts().tau, command * (1.0 + np.expm1(-x) / x), rtol=1e-9)
    slow.step(command)
    assert np.all(slow.true_contacts().tau > 0.13 * command)  # the current continues from the last step
    slow.reset(np.zeros(3))
    slow.step(command)
    np.testing.assert_allclose(slow.true_contacts().tau, command * (1.0 + np.expm1(-x) / x), rtol=1e-9)
    with pytest.raises(InvalidInput, match="12 motors"):
        free_body_plant(motors=MotorModel.for_hand(load("allegro_right")))


def test_joints_accelerate_by_the_hands_dynamics():
    plant = free_body_plant("dlr_hit2")  # has couplings
    hand, scene = plant.scene.grasp.hand, plant.scene
    a = np.random.default_rng(3).normal(size=hand.n)  # rad/s²
    state = plant.state()
    plant.step(hand.inverse_dynamics(state.q, state.v, a, scene.gravity_H))
    # couplings are compliant by 1e-4 of their load
    np.testing.assert_allclose(plant.state().v, plant.dt * a, atol=1e-3 * plant.dt)


def test_dependent_joints_follow_their_leading_joints():
    """Coupling error in an oscillation of 0.3 rad at 2 Hz."""
    plant = free_body_plant("dlr_hit2")
    hand = plant.scene.grasp.hand
    worst, omega = 0.0, 4.0 * np.pi
    for k in range(500):
        state, phase = plant.state(), omega * k * plant.dt
        q = hand.neutral + 0.15 * (1.0 - np.cos(phase))
        a = 0.15 * omega**2 * np.cos(phase) + 900.0 * (q - state.q) + 60.0 * (0.15 * omega * np.sin(phase) - state.v)
        plant.step(hand.inverse_dynamics(state.q, state.v, a, plant.scene.gravity_H))
        worst = max(worst, plant.coupling_error())
    assert 0.0 < worst < 1e-6  # rad


def test_dropped_object_rests_on_the_floor():
    """Fingers below the object would catch it: here they are not solid."""
    grasp = three_finger_grasp()
    plant = Plant(build_scene(grasp, gravity_H=PALM_UP, floor=0.08, engine=EngineSettings(solid_links=False)))
    hand = grasp.hand
    for _ in range(1500):
        state = plant.state()
        open_hand = hand.gravity_torque(state.q, PALM_UP) - 0.5 * (state.q - hand.q_lower) - 0.02 * state.v
        plant.step(open_hand)
    height = plant.object_motion().p_HO[0] - (grasp.p_HO[0] - 0.08)  # m above the floor, x being up
    assert height == pytest.approx(0.03, abs=1e-4)


def test_rolling_resistance_slows_a_ball_on_the_floor():
    """A ball of radius r rolls without slip: (m + 2/5 m) a = m g d / r, with the lever arm d of rolling resistance."""
    grasp, speeds = three_finger_grasp(), {}
    push = Push([0.0, 0.012, 0.0], 1.2, 0.2)
    engine = EngineSettings(solid_links=False)
    plant = Plant(build_scene(grasp, gravity_H=PALM_UP, floor=0.08, engine=engine), disturbances=[push])
    hand = grasp.hand
    for i in range(2300):
        state = plant.state()
        plant.step(hand.gravity_torque(state.q, PALM_UP) - 0.5 * (state.q - hand.q_lower) - 0.02 * state.v)
        speeds[i] = float(np.linalg.norm(plant.object_motion().twist[:3]))
    measured = (speeds[1500] - speeds[2299]) / (799 * plant.dt)
    # the ball also spins about the vertical, which takes a part of the friction: 3 % less
    assert measured == pytest.approx(2e-4 * 9.81 / (1.4 * 0.03), rel=0.05)
