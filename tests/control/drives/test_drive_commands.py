"""Set-points of drives: the drive's own law gives back the torque, within the stated error if its constants differ."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.control_grasps import named_grasp
from support.control_steps import disturbed
from support.drive_laws import is_fast, joint_torque, perturbed
from support.hands import load

from graspforce.contact.motion import BodyMotion
from graspforce.control import GraspState, ObjectController
from graspforce.control.drives.drive_commands import DIRECTION_RATE, DriveCommand, DriveMap
from graspforce.core.errors import InvalidInput
from graspforce.hand.descriptions.drive_description import DRIVE_MODES
from graspforce.hand.drives.drive import Drive

HAND = load("four_finger")
CONSTANTS = {"torque_constant": 1.3, "stiffness": 8.0, "damping": 0.2}
RATES = st.one_of(st.just(0.0), st.floats(0.5, 5.0), st.floats(-5.0, -0.5))  # rad/s: the gear's direction is certain
SEEDS = st.integers(0, 2**32 - 1)


def make_drive(mode, **changes) -> Drive:
    return Drive(mode, **{**CONSTANTS, **changes})


def random_posture(seed: int):
    """Return torques and joint positions well inside the limits, so that no position set-point is limited."""
    rng = np.random.default_rng(seed)
    q = 0.5 * (HAND.q_lower + HAND.q_upper)  # rad
    return rng.uniform(-0.1, 0.1, HAND.n), q


@pytest.mark.parametrize("mode", DRIVE_MODES)
@given(seed=SEEDS, v=RATES)
def test_drive_makes_the_commanded_torque(mode, seed, v):
    """The efficiencies are those of a worm gear: they differ by direction."""
    drive = make_drive(mode, efficiency=0.7, backdriving_efficiency=0.4)
    tau, q = random_posture(seed)
    command = DriveMap(HAND.with_drives(drive)).set_points(tau, q, np.full(HAND.n, v))
    made = [joint_torque(drive, command, i, q[i], v) for i in range(HAND.n)]
    assert v == 0.0 or is_fast(v, DIRECTION_RATE)
    np.testing.assert_allclose(made, tau, rtol=1e-9, atol=1e-12)  # rounding of q + m/K
    assert not command.limited.any()


@pytest.mark.parametrize("mode", DRIVE_MODES)
@given(seed=SEEDS, v=RATES, torque=st.floats(-0.2, 0.2), stiffness=st.floats(-0.3, 0.3))
def test_torque_is_within_the_stated_error(mode, seed, v, torque, stiffness):
    drive = make_drive(mode, torque_error=0.2, stiffness_error=0.3)
    tau, q = random_posture(seed)
    command = DriveMap(HAND.with_drives(drive)).set_points(tau, q, np.full(HAND.n, v))
    true = perturbed(drive, torque, stiffness)
    made = np.array([joint_torque(true, command, i, q[i], v) for i in range(HAND.n)])
    assert (np.abs(made - tau) <= command.torque_error + 1e-9).all()


@pytest.mark.parametrize("mode", ["torque", "current", "impedance", "position"])
@given(seed=SEEDS)
def test_rounding_of_set_points_is_within_the_stated_error(mode, seed):
    step = 0.002  # N·m, A or rad
    drive = make_drive(mode, resolution=step)
    tau, q = random_posture(seed)
    command = DriveMap(HAND.with_drives(drive)).set_points(tau, q, np.zeros(HAND.n))
    name = {"torque": "torque", "current": "current"}.get(mode, "position")
    rounded = step * np.round(getattr(command, name) / step)
    values = {each: getattr(command, each) for each in DriveCommand.__slots__}
    same = DriveCommand(**{**values, name: rounded})
    made = np.array([joint_torque(drive, same, i, q[i], 0.0) for i in range(HAND.n)])
    assert (np.abs(made - tau) <= command.torque_error + 1e-12).all()


@pytest.mark.parametrize("mode", ["impedance", "position", "position_with_current_limit"])
@given(seed=SEEDS, noise=st.floats(-1e-3, 1e-3), v=st.floats(-0.5, 0.5), held=st.floats(0.0, 2e-3))
def test_wrong_positions_and_held_set_points_are_within_the_stated_error(mode, seed, noise, v, held):
    """The true joint is up to 1 mrad off, and moves on while the drive holds a set-point for 2 ms."""
    drive = make_drive(mode, stiffness_error=0.3, rate=500.0)
    tau, q = random_posture(seed)
    command = DriveMap(HAND.with_drives(drive), position_error=1e-3, period=1e-3).set_points(tau, q, np.full(HAND.n, v))
    true = perturbed(drive, 0.0, 0.3)
    made = np.array([joint_torque(true, command, i, q[i] + noise + v * held, v) for i in range(HAND.n)])
    assert (np.abs(made - tau) <= command.torque_error + 1e-9).all()


def test_gear_at_rest_has_the_error_of_an_unknown_direction():
    drive = make_drive("current", efficiency=0.7, backdriving_efficiency=0.4)
    tau, q = random_posture(1)
    command = DriveMap(HAND.with_drives(drive)).set_points(tau, q, np.zeros(HAND.n))
    motor = 1.3 * command.current  # N·m
    ends = np.array([motor * 0.7, motor / 0.4])  # while it drives, and while the joint drives it
    for end in ends:
        np.testing.assert_array_less(np.abs(end - tau), command.torque_error + 1e-12)
    moving = DriveMap(HAND.with_drives(drive)).set_points(tau, q, np.full(HAND.n, 5.0))
    np.testing.assert_array_equal(moving.torque_error, 0.0)


def test_servos_make_their_torque_beyond_the_joint_limits_as_far_as_they_take_positions():
    tau = np.full(HAND.n, 0.4)
    for beyond, share in ((0.0, 0.0), (0.025, 0.5), (0.1, 1.0)):
        drive = make_drive("position", damping=0.0, beyond_limits=beyond)
        command = DriveMap(HAND.with_drives(drive)).set_points(tau, HAND.q_upper, np.zeros(HAND.n))
        np.testing.assert_allclose(8.0 * (command.position - HAND.q_upper), share * tau, atol=1e-12)
        assert (command.limited == (share < 1.0)).all()


def test_currents_and_positions_stay_within_the_limits_of_the_drive():
    tau, q = np.full(HAND.n, 0.5), HAND.q_upper - 0.01  # rad: a servo has 0.01 rad for its spring
    current = DriveMap(HAND.with_drives(make_drive("current", current_limit=0.2))).set_points(tau, q, np.zeros(HAND.n))
    np.testing.assert_allclose(current.current, 0.2)
    assert current.limited.all()
    position = DriveMap(HAND.with_drives(make_drive("position"))).set_points(tau, q, np.zeros(HAND.n))
    np.testing.assert_allclose(position.position, HAND.q_upper)
    assert position.limited.all()


@pytest.mark.parametrize("mode", DRIVE_MODES)
def test_records_keep_the_set_points_of_each_mode(mode):
    tau, q = random_posture(2)
    drives = [make_drive(mode)] + [Drive()] * (HAND.n - 1)
    command = DriveMap(HAND.with_drives(drives)).set_points(tau, q, np.ones(HAND.n))
    record = command.to_dict()
    assert record["joints"] == [joint.name for joint in HAND.joints]
    assert record["modes"] == [mode] + ["torque"] * (HAND.n - 1)
    same = DriveCommand.from_dict(record)
    for name in DriveCommand.__slots__:
        np.testing.assert_array_equal(getattr(same, name), getattr(command, name))


def test_record_errors_name_the_field():
    tau, q = random_posture(2)
    record = DriveMap(HAND).set_points(tau, q, np.zeros(HAND.n)).to_dict()
    with pytest.raises(InvalidInput, match=r"drive\.modes"):
        DriveCommand.from_dict({**record, "modes": ["speed"] * HAND.n})
    with pytest.raises(InvalidInput, match=r"drive\.torque_error"):
        DriveCommand.from_dict({**record, "torque_error": [-1.0] * HAND.n})
    with pytest.raises(InvalidInput, match=r"drive\.torque"):
        DriveCommand.from_dict({**record, "torque": [0.1]})


def test_ideal_drives_take_the_torques_and_keep_the_margin():
    grasp = named_grasp("four_finger box")
    command = ObjectController(grasp).step(*disturbed(grasp, 3))
    np.testing.assert_array_equal(command.drive.torque, command.tau)
    np.testing.assert_array_equal(command.guaranteed_margin, command.slip_margin)
    assert command.drive.joints == tuple(joint.name for joint in grasp.hand.joints)


def test_direction_of_gears_follows_the_plan_not_the_noise_of_rates():
    """A worm gear needs four times the motor torque in one direction: noise of measured rates must not switch it."""
    grasp = named_grasp("four_finger box")
    hand = grasp.hand.with_drives(make_drive("current", efficiency=0.5, backdriving_efficiency=0.4))
    grasp, noise = replace(grasp, hand=hand), np.random.default_rng(3)
    start = BodyMotion(grasp.p_HO, grasp.R_HO)
    currents, torques = [], []
    for _ in range(20):
        v = 0.05 * noise.standard_normal(hand.n)  # rad/s, more than the rate over which the direction is blended
        command = ObjectController(grasp).step(GraspState(grasp.q, v, start), start)
        currents.append(command.drive.current)
        torques.append(command.tau)
    at_rest = np.array(torques) / (0.5 * (0.5 + 1.0 / 0.4)) / 1.3  # A: the joint torque is in the middle of both directions
    np.testing.assert_allclose(currents, at_rest, rtol=1e-9)


@pytest.mark.parametrize("mode", ["impedance", "position"])
def test_damping_of_servos_does_not_amplify_the_noise_of_rates(mode):
    """The joint torque for the true rates differs from the commanded one by the damping of motions without contact only."""
    grasp = named_grasp("four_finger box")
    hand = grasp.hand.with_drives(make_drive(mode, damping=1.0))
    grasp, noise = replace(grasp, hand=hand), np.random.default_rng(4)
    start = BodyMotion(grasp.p_HO, grasp.R_HO)
    for _ in range(5):
        v = 0.05 * noise.standard_normal(hand.n)  # rad/s, measured; the hand rests
        command = ObjectController(grasp).step(GraspState(grasp.q, v, start), start)
        made = np.array([joint_torque(hand.drives.joints[i], command.drive, i, grasp.q[i], 0.0) for i in range(hand.n)])
        A, _, _ = command._source.constraints.constraint_rows(command._source.targets.rolling)
        left = A @ (made - command.tau)  # m/rad · N·m: what the torques do to the contacts per damping
        np.testing.assert_allclose(left, 0.0, atol=2e-3 * np.abs(A @ v).max())  # damping of the least squares
