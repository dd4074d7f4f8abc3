"""A hand without an object: closed forms of the step response, limits, and what friction leaves."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from support.hands import load

from graspforce.control.joints.joint_command import JointMotion
from graspforce.control.joints.joint_controller import JOINT_LAWS, JointController
from graspforce.control.joints.joint_laws import PDGains, PIDGains
from graspforce.control.joints.joint_reference import minimum_jerk_reference
from graspforce.core.errors import InvalidInput
from graspforce.hand.identification.joint_recording import load_joint_recording
from graspforce.simulation.free_hand.free_plant import FreeHandPlant
from graspforce.simulation.free_hand.joint_plots import save_joint_plots
from graspforce.simulation.free_hand.joint_run import JointRun, run_joints, step_responses

HANDS = ["four_finger", "dlr_hit2", "shadow_right", "parallel_jaws"]  # plain, coupled, with a wrist and tendons, sliding


def small_goal(hand):
    """Return a posture 5 % of the range of each joint away from neutral, so that no motor reaches its limit."""
    up, down = hand.q_upper - hand.neutral, hand.q_lower - hand.neutral
    return hand.neutral + 0.05 * np.where(up >= -down, up, down)


@pytest.mark.parametrize("name", HANDS)
def test_computed_torque_answers_a_step_like_a_critically_damped_system(name):
    hand, omega = load(name), 2.0 * math.pi * 2.0  # rad/s
    goal = small_goal(hand)
    controller = JointController.with_frequency(hand, "computed_torque", 2.0)
    run = run_joints(FreeHandPlant(hand), controller, minimum_jerk_reference(hand.neutral, goal, 0.0), 0.6)
    error = (1.0 + omega * run.t) * np.exp(-omega * run.t)
    # Torques are held for 1 ms: half a period of delay at 2 Hz changes the response by about omega dt / 2 = 0.6 %.
    for j in range(hand.n):
        progress = (run.q[:, j] - run.q[0, j]) / (goal[j] - run.q[0, j])
        np.testing.assert_allclose(progress, 1.0 - error, atol=0.02)


@pytest.mark.parametrize("law", JOINT_LAWS)
@pytest.mark.parametrize("name", HANDS)
def test_every_law_brings_every_joint_to_its_goal(name, law):
    hand = load(name)
    goal = small_goal(hand)
    controller = JointController.with_frequency(hand, law, 3.0)
    run = run_joints(FreeHandPlant(hand), controller, minimum_jerk_reference(hand.neutral, goal, 0.2), 2.0)
    for response in step_responses(run):
        assert response.settling_time < 1.5
        assert abs(response.final_error) < 1e-3 * abs(response.travel)
        assert response.peak_use <= 1.0


def test_a_hand_falls_without_torques_and_is_still_with_those_of_gravity():
    hand = load("four_finger")
    plant, falling = FreeHandPlant(hand, gravity_H=(9.81, 0.0, 0.0)), FreeHandPlant(hand, gravity_H=(9.81, 0.0, 0.0))
    tau = hand.gravity_torque(hand.neutral, (9.81, 0.0, 0.0))
    for _ in range(100):
        still, moved = plant.step(tau), falling.step(np.zeros(hand.n))
    np.testing.assert_allclose(still.q, hand.neutral, atol=1e-9)  # rad: rounding over 0.1 s
    assert np.abs(moved.q - hand.neutral).max() > 0.05


def test_pd_stops_where_friction_balances_it_and_pid_goes_on():
    hand, friction = load("four_finger"), 0.02  # N·m
    goal = small_goal(hand)
    runs = {}
    for law in ("pd_gravity", "pid"):
        controller = JointController.with_frequency(hand, law, 4.0)
        plant = FreeHandPlant(hand, joint_friction=np.full(hand.n, friction))
        runs[law] = run_joints(plant, controller, minimum_jerk_reference(hand.neutral, goal, 0.2), 4.0)
        errors = np.abs(goal - runs[law].q[-1])
        if law == "pd_gravity":
            # At rest Kp |e| is at most the friction; MuJoCo's friction creeps, which only reduces e.
            assert (controller.gains.kp * errors <= 1.01 * friction).all()
            assert errors.max() > 1e-3
    pd_error, pid_error = (np.abs(goal - runs[law].q[-1]).max() for law in ("pd_gravity", "pid"))
    assert pid_error < 0.2 * pd_error


def test_minimum_jerk_motion_has_the_rates_of_its_derivative():
    start, goal, T, step = np.array([0.1, -0.2]), np.array([0.5, 0.3]), 0.8, 1e-5
    reference = minimum_jerk_reference(start, goal, T)
    np.testing.assert_allclose(reference(0.0).q, start)
    np.testing.assert_allclose(reference(T).q, goal)
    np.testing.assert_allclose(reference(T / 2).v, 1.875 * (goal - start) / T, rtol=1e-12)  # the largest rate of this motion
    for t in (0.1, 0.33, 0.7):
        before, now, after = reference(t - step), reference(t), reference(t + step)
        np.testing.assert_allclose((after.q - before.q) / (2 * step), now.v, atol=1e-8)
        np.testing.assert_allclose((after.v - before.v) / (2 * step), now.a, atol=1e-7)


def test_step_response_has_the_overshoot_of_a_second_order_system():
    zeta, omega = 0.3, 10.0
    t = np.arange(0.0, 3.0, 1e-3)
    damped = omega * math.sqrt(1.0 - zeta**2)
    x = 1.0 - np.exp(-zeta * omega * t) * (np.cos(damped * t) + zeta * omega / damped * np.sin(damped * t))
    run = JointRun(
        hand="test",
        law="test",
        joints=("joint",),
        units=("rad",),
        t=t,
        q=0.5 * x[:, None],
        v=np.zeros((len(t), 1)),
        tau=np.full((len(t), 1), -0.25),
        q_desired=np.full((len(t), 1), 0.5),
        torque_limit=np.array([1.0]),
    )
    (response,) = step_responses(run)
    assert math.isclose(response.overshoot, math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta**2)), rel_tol=1e-4)
    assert math.isclose(response.travel, 0.5)
    assert math.isclose(response.peak_use, 0.25)
    envelope = math.log(1.0 / (0.02 * math.sqrt(1.0 - zeta**2))) / (zeta * omega)  # s
    assert response.settling_time <= envelope
    cut = replace(run, t=t[:100], q=run.q[:100], v=run.v[:100], tau=run.tau[:100], q_desired=run.q_desired[:100])
    assert math.isnan(step_responses(cut)[0].settling_time)


def test_saved_run_is_a_recording_for_identification(tmp_path):
    hand = load("four_finger")
    controller = JointController.with_frequency(hand, "computed_torque", 3.0)
    run = run_joints(FreeHandPlant(hand), controller, minimum_jerk_reference(hand.neutral, small_goal(hand), 0.1), 0.2)
    run.save(tmp_path / "run.npz")
    recording = load_joint_recording(tmp_path / "run.npz", list(hand.joint_names))
    np.testing.assert_array_equal(recording.q, run.q)
    np.testing.assert_array_equal(recording.tau, run.tau)
    assert {path.name for path in save_joint_plots(run, tmp_path)} == {"positions.png", "torques.png"}


def test_wrong_arguments_are_named():
    hand = load("four_finger")
    with pytest.raises(InvalidInput, match="law"):
        JointController.with_frequency(hand, "lqr", 3.0)
    with pytest.raises(InvalidInput, match="frequency"):
        JointController.with_frequency(hand, "pid", 0.0)
    with pytest.raises(InvalidInput, match="gains"):
        JointController(hand, "pid", PDGains(np.ones(hand.n), np.ones(hand.n)))
    with pytest.raises(InvalidInput, match="gains"):
        JointController(hand, "pid", PIDGains(np.ones(3), np.ones(3), np.ones(3)))
    with pytest.raises(InvalidInput, match="joint_friction"):
        FreeHandPlant(hand, joint_friction=np.full(hand.n, -1.0))
    with pytest.raises(InvalidInput, match="tau"):
        FreeHandPlant(hand).step([0.0])
    with pytest.raises(InvalidInput, match="duration"):
        run_joints(
            FreeHandPlant(hand), JointController.with_frequency(hand, "pid", 1.0), lambda t: JointMotion(hand.neutral), 0.0
        )
