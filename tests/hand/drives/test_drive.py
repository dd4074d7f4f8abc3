"""Drives: their constants at the joints, torque limits that follow from currents, and the cost of the copper loss."""

from __future__ import annotations

import numpy as np
import pytest
from support.hands import load
from support.written_hands import write_hand

from graspforce.core.errors import InvalidInput, ModelError
from graspforce.hand.descriptions.drive_description import DRIVE_MODES
from graspforce.hand.drives.drive import Drive
from graspforce.hand.hand import Hand

MOTOR = {"joints": ["*"], "torque": 0.5, "velocity": 3.0, "rotor_inertia": 1e-8, "gear_ratio": 100.0, "source": "invented"}
CURRENT = {"joints": ["*"], "mode": "current", "torque_constant": 0.01, "source": "invented"}


def test_hands_without_drives_take_torques_exactly(tmp_path):
    hand = Hand.load(write_hand(tmp_path))
    assert hand.drives.is_ideal
    assert hand.drives.modes == ("torque", "torque")
    assert hand.describe()["drives"][0]["mode"] == "torque"


def test_torque_constant_at_the_joint_includes_the_gear(tmp_path):
    hand = Hand.load(write_hand(tmp_path, motors=[MOTOR], drives=[{**CURRENT, "joints": ["near"]}]))
    assert hand.drives.modes == ("current", "torque")
    np.testing.assert_array_equal(hand.drives.values("torque_constant"), [0.01 * 100.0, np.nan])


def test_efficiency_of_backdriving_is_that_of_driving_by_default(tmp_path):
    given = {**CURRENT, "efficiency": 0.8}
    hand = Hand.load(write_hand(tmp_path, motors=[MOTOR], drives=[given]))
    assert hand.drives.joints[0].backdriving_efficiency == 0.8
    hand = Hand.load(write_hand(tmp_path, motors=[MOTOR], drives=[{**given, "backdriving_efficiency": 0.5}]))
    assert hand.drives.joints[0].backdriving_efficiency == 0.5


@pytest.mark.parametrize("current", [0.1, 0.4, 10.0])
def test_current_limit_reduces_the_torque_limit(tmp_path, current):
    given = {**CURRENT, "efficiency": 0.9, "current_limit": current}
    hand = Hand.load(write_hand(tmp_path, motors=[MOTOR], drives=[given]))
    np.testing.assert_allclose(hand.torque_upper, min(0.5, 0.9 * 0.01 * 100.0 * current), rtol=1e-14)
    np.testing.assert_array_equal(hand.torque_lower, -hand.torque_upper)


def test_copper_loss_is_the_heat_of_the_currents(tmp_path):
    given = {**CURRENT, "resistance": 4.0}
    hand = Hand.load(write_hand(tmp_path, motors=[MOTOR], drives=[given], torque_weight="copper_loss"))
    tau = np.array([0.3, -0.2])  # N·m
    current = tau / (0.01 * 100.0)  # A
    assert tau @ (hand.torque_weight * tau) == pytest.approx(4.0 * current @ current, rel=1e-14)


def test_weight_of_the_description_follows_new_drives(tmp_path):
    given = {**CURRENT, "resistance": 4.0}
    hand = Hand.load(write_hand(tmp_path, motors=[MOTOR], drives=[given], torque_weight="copper_loss"))
    other = hand.with_drives(Drive("current", torque_constant=2.0, resistance=4.0, current_limit=0.1))
    np.testing.assert_allclose(other.torque_weight, hand.torque_weight / 4.0, rtol=1e-14)
    np.testing.assert_allclose(other.torque_upper, 0.2, rtol=1e-14)


@pytest.mark.parametrize("kind", ["unit", "utilisation"])
def test_hand_takes_another_weight_without_its_drives(kind):
    hand = load("four_finger")
    expected = np.ones(hand.n) if kind == "unit" else hand.torque_upper**-2
    np.testing.assert_allclose(hand.with_torque_weight(kind).torque_weight, expected, rtol=1e-14)


def test_copper_loss_without_constants_is_refused():
    with pytest.raises(InvalidInput, match=r"torque_weight.*resistance and a torque constant.*lacks one"):
        load("four_finger").with_torque_weight("copper_loss")


@pytest.mark.parametrize("mode", DRIVE_MODES)
def test_modes_state_the_constants_they_need(mode):
    needed = {"current": "torque_constant", "impedance": "stiffness", "position": "stiffness"}
    if mode == "torque":
        assert Drive(mode).largest_torque == np.inf
        return
    with pytest.raises(InvalidInput, match=f"{needed.get(mode, 'torque_constant')}.*the mode {mode} needs it"):
        Drive(mode)


@pytest.mark.parametrize(
    ("drives", "message"),
    [
        ([{"joints": ["far*"], "mode": "current", "source": "s"}], "drive of joint far: torque_constant"),
        ([CURRENT, CURRENT], "joint near must match at most one drive, not 2"),
        ([{**CURRENT, "joints": ["thumb"]}], "the drive of thumb matches no actuated joint; these are near, far"),
        ([{**CURRENT, "mode": "speed"}], r"Invalid enum value 'speed' - at `\$.drives"),
        ([{**CURRENT, "efficiency": 1.2}], r"<= 1.*drives"),
    ],
)
def test_contradictions_name_the_joint_or_the_field(tmp_path, drives, message):
    with pytest.raises(ModelError, match=message):
        Hand.load(write_hand(tmp_path, motors=[MOTOR], drives=drives))


def test_number_of_drives_is_that_of_the_joints():
    with pytest.raises(InvalidInput, match=r"drives = '3 drives': must be one for each of the 12 actuated joints"):
        load("four_finger").with_drives([Drive()] * 3)
