"""Control of a grasp from messages: the torques of Python's controller, a plant that is held, moved and released, refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.box_grasp import make_grasp
from support.ros2_messages import carried, joint_state, pose, wrench

from graspforce import simulation
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, OutputFeedbackController
from graspforce.core.errors import InvalidInput, RequestRefused
from graspforce.estimation.measurement import Measurement, PoseMeasurement
from graspforce.hand.drives.drive import Drive
from graspforce.service.ros2 import messages
from graspforce.service.ros2.fingertip_wrenches import FingertipWrenches
from graspforce.service.ros2.hold_control import HoldControl, HoldOptions
from graspforce.service.ros2.messages import JointSample, PoseSample

GRASP = make_grasp()
START = 1_700_000_000 * 10**9  # ns
PERIOD = 0.002  # s
OPTIONS = HoldOptions(rate=1.0 / PERIOD, settings=ControlSettings(slip_margin=0.3))


def sample(t: float, q: np.ndarray) -> JointSample:
    """Return a joint state as it arrives: after its encoding, with the joints in another order and further ones."""
    names = [*reversed(GRASP.hand.joint_names), "arm_joint"]
    message = joint_state(START + round(t * 1e9), names, np.append(q[::-1], 0.7))
    return messages.read_joints(carried(messages.JOINT_STATE, message), GRASP.hand.joint_names, START - 10**9)


def test_torques_are_those_of_the_controller_in_python():
    control = HoldControl(GRASP, OPTIONS)
    assert control.step(sample(0.0, GRASP.q), None) is None  # idle
    control.open()
    controller = OutputFeedbackController(GRASP, control.settings, OPTIONS.sensors)
    desired, rng = BodyMotion(GRASP.p_HO, GRASP.R_HO), np.random.default_rng(1)
    for k in range(1, 40):
        joints = sample(k * PERIOD, GRASP.q + 1e-4 * rng.standard_normal(GRASP.hand.n))
        seen = PoseSample(joints.t - 0.03, GRASP.p_HO + 1e-3, GRASP.R_HO) if k % 10 == 0 else None
        measured = None if seen is None else PoseMeasurement(*seen)
        expected = controller.step(Measurement(joints.t, joints.q, object=measured), desired)
        command = control.step(joints, seen)
        np.testing.assert_allclose(command.values, expected.tau, rtol=0.0, atol=1e-12)
    forces = control.contact_forces()
    total = sum(force for force, _ in forces.values())
    np.testing.assert_allclose(total, command.record.wrench[:3], atol=1e-9)  # N, equilibrium


def run(plant, control, seconds, start):
    """Run a plant with commands from messages. Return its last state and the time."""
    state, steps = plant.state(), round(PERIOD / plant.dt)
    tau = np.zeros(GRASP.hand.n)
    for k in range(round(seconds / PERIOD)):
        t = start + k * PERIOD
        command = control.step(sample(t, state.q), None)
        if command is not None:
            tau = command.values
        for _ in range(steps):
            state = plant.step(tau)
    return state, start + seconds


def test_a_simulated_hand_holds_squeezes_and_releases_an_object():
    plant = simulation.Plant(simulation.build_scene(GRASP))
    plant.reset()
    control = HoldControl(GRASP, OPTIONS)
    control.step(sample(0.0, GRASP.q), None)
    control.open()
    state, t = run(plant, control, 0.2, PERIOD)
    np.testing.assert_allclose(state.object.p_HO, GRASP.p_HO, atol=1e-3)
    squeeze = sum(np.linalg.norm(force) for force, _ in control.contact_forces().values())
    control.set_slip_margin(1.5)
    state, t = run(plant, control, 0.2, t)
    np.testing.assert_allclose(state.object.p_HO, GRASP.p_HO, atol=1e-3)
    assert sum(np.linalg.norm(force) for force, _ in control.contact_forces().values()) > 1.5 * squeeze
    q_held = state.q
    control.release()
    assert control.mode == "released"
    state, t = run(plant, control, OPTIONS.release_time + 0.2, t)
    assert state.object.p_HO[2] < GRASP.p_HO[2] - 0.01  # the object falls
    for i, finger in enumerate(GRASP.fingers):
        way = GRASP.hand.tip_pose(state.q, finger)[0] - GRASP.hand.tip_pose(q_held, finger)[0]
        outward = -GRASP.R_HO @ GRASP.contacts.R_OC[i, :, 2]
        assert way @ outward > 0.3 * OPTIONS.opening  # finger_1 reaches 0.4


def test_services_are_refused_with_a_reason_where_they_make_no_sense():
    control = HoldControl(GRASP, OPTIONS)
    with pytest.raises(RequestRefused, match="no joint state has arrived"):
        control.open()
    for act in (control.release, control.check_holding):
        with pytest.raises(RequestRefused, match="does not hold"):
            act()
    control.step(sample(0.0, GRASP.q + 0.2), None)
    with pytest.raises(RequestRefused, match="rad from the posture of the grasp"):
        control.open()
    with pytest.raises(InvalidInput, match="slip_margin"):
        control.set_slip_margin(-1.0)
    assert control.mode == "idle"


def test_implausible_states_get_no_command_and_a_reason():
    control = HoldControl(GRASP, OPTIONS)
    control.step(sample(0.0, GRASP.q), None)
    control.open()
    assert control.step(sample(PERIOD, GRASP.q), None) is not None
    assert control.step(sample(2 * PERIOD, GRASP.q + 0.5), None) is None
    assert "posture" in control.problem
    assert control.step(sample(3 * PERIOD, GRASP.q), None) is not None
    assert control.problem == ""


def test_positions_are_the_set_points_of_drives_that_take_them():
    drive = Drive("position", stiffness=20.0, damping=0.1)
    grasp = replace(GRASP, hand=GRASP.hand.with_drives(drive))
    control = HoldControl(grasp, OPTIONS)
    assert control.interface == "position"
    control.step(sample(0.0, GRASP.q), None)
    control.open()
    for k in range(1, 20):
        command = control.step(sample(k * PERIOD, GRASP.q), None)
    # the servo K (q_set − q) makes the torque of the command: the hand is at rest
    np.testing.assert_allclose(drive.stiffness * (command.values - GRASP.q), command.record.torque, atol=1e-6)
    control.release()
    start = 20 * PERIOD
    first = control.step(sample(start, GRASP.q), None)
    np.testing.assert_allclose(first.values, GRASP.q, atol=1e-9)
    last = control.step(sample(start + 2.0 * OPTIONS.release_time, GRASP.q), None)
    assert np.abs(last.values - GRASP.q).max() > 0.1  # rad, open


def test_interfaces_that_the_drives_do_not_take_are_refused():
    with pytest.raises(InvalidInput, match="take no positions"):
        HoldControl(GRASP, replace(OPTIONS, interface="position"))
    assert HoldControl(GRASP, OPTIONS).interface == "effort"
    for bad in ({"rate": 10.0}, {"rate": 5000.0}, {"interface": "velocity"}, {"opening": 0.0}):
        with pytest.raises(InvalidInput):
            HoldOptions(**bad)


def test_joint_states_and_poses_that_do_not_fit_are_refused():
    names = list(GRASP.hand.joint_names)
    short = joint_state(START, names[:-1], GRASP.q[:-1])
    with pytest.raises(InvalidInput, match=names[-1]):
        messages.read_joints(short, names, START)
    with pytest.raises(InvalidInput, match="position"):
        messages.read_joints(joint_state(START, names, GRASP.q[:-1]), names, START)
    with pytest.raises(InvalidInput, match="finite"):
        messages.read_joints(joint_state(START, names, np.full(len(names), np.nan)), names, START)
    unknown = messages.read_joints(joint_state(START, names, GRASP.q, np.full(len(names), np.nan)), names, START)
    assert unknown.v is None  # NaN stands for a rate that is not measured
    R = Rotation.from_rotvec([0.1, -0.4, 0.2]).as_matrix()
    message = carried(messages.POSE, pose(START + 10**6, np.array([0.1, 0.2, 0.3]), R, "palm"))
    read = messages.read_pose(message, "palm", START)
    np.testing.assert_allclose(read.p_HO, [0.1, 0.2, 0.3])
    np.testing.assert_allclose(read.R_HO, R, atol=1e-12)
    assert read.t == pytest.approx(1e-3)
    with pytest.raises(InvalidInput, match="base frame"):
        messages.read_pose(message, "wrist", START)


FORCES = np.array([[-1.0, 0.1, 0.3], [-1.1, 0.0, 0.4], [1.0, -0.1, 0.35], [1.1, 0.0, 0.45]])  # N, in H


def test_measured_contact_forces_reach_the_monitor_in_either_frame():
    options = replace(OPTIONS, tip_force_noise=0.05)
    control = HoldControl(GRASP, options)
    control.step(sample(0.0, GRASP.q), None)
    control.open()
    controller = OutputFeedbackController(GRASP, control.settings, options.sensors)
    desired, rng = BodyMotion(GRASP.p_HO, GRASP.R_HO), np.random.default_rng(2)
    for k in range(1, 40):
        joints = sample(k * PERIOD, GRASP.q + 1e-4 * rng.standard_normal(GRASP.hand.n))
        measured = FORCES + 0.05 * rng.standard_normal(FORCES.shape)
        for i, finger in enumerate(GRASP.fingers):
            R = GRASP.hand.tip_pose(joints.q, finger)[1]
            in_tip = wrench(R.T @ measured[i], GRASP.hand.finger(finger).tip)
            message = in_tip if i % 2 else wrench(measured[i], "palm")
            control.tips.receive(finger, carried(messages.WRENCH, message), "palm")
        rows = np.hstack([measured, np.zeros_like(measured)])
        expected = controller.step(Measurement(joints.t, joints.q, tip_wrench=rows), desired)
        command = control.step(joints, None)
        np.testing.assert_allclose(command.values, expected.tau, rtol=0.0, atol=1e-12)
    found = np.array(command.record.estimate.monitor["force"])
    np.testing.assert_allclose(found, controller.monitor.forces.f, rtol=0.0, atol=1e-9)
    assert control.tips.received == 4 * 39


def test_old_or_missing_contact_forces_are_not_used():
    wrenches = FingertipWrenches(GRASP)
    for i, finger in enumerate(GRASP.fingers):
        assert wrenches.at(1.0, GRASP.q) is None
        wrenches.receive(finger, wrench(FORCES[i], ""), "")
    np.testing.assert_allclose(wrenches.at(1.0, GRASP.q)[:, :3], FORCES)
    wrenches.receive(GRASP.fingers[0], wrench(FORCES[0], GRASP.hand.urdf.root), "")
    assert wrenches.at(1.049, GRASP.q) is not None
    assert wrenches.at(1.051, GRASP.q) is None  # of the other fingers


def test_contact_forces_that_do_not_fit_are_refused():
    wrenches, finger = FingertipWrenches(GRASP), GRASP.fingers[0]
    with pytest.raises(InvalidInput, match="frame_id"):
        wrenches.receive(finger, wrench(FORCES[0], "sensor"), "palm")
    for bad in (np.array([np.nan, 0.0, 0.0]), np.array([0.0, 1e7, 0.0])):
        with pytest.raises(InvalidInput, match="force"):
            wrenches.receive(finger, wrench(bad, ""), "")
        with pytest.raises(InvalidInput, match="torque"):
            wrenches.receive(finger, wrench(FORCES[0], "", bad), "")
    with pytest.raises(InvalidInput, match="tip_force_noise"):
        HoldOptions(tip_force_noise=0.0)
    assert HoldControl(GRASP, OPTIONS).tips is None
