"""Fingers whose drives are off: the others take over, stop the object, or press with the nearest wrench."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.control_grasps import named_grasp
from support.control_steps import disturbed, pose_at_rest, settings_with, state_at_rest, with_contacts

from graspforce import ContactSet
from graspforce.contact import friction
from graspforce.contact.matrices import grasp_matrix
from graspforce.contact.motion import BodyMotion
from graspforce.control import Command, ControlMemory, GraspState, ObjectController
from graspforce.control.contacts.lost_drives import LostDrives
from graspforce.control.object_control_law import ObjectControlLaw
from graspforce.core.errors import UnknownName
from graspforce.grasp.grasp import Grasp

pytestmark = pytest.mark.usefixtures("arithmetic")

ROUNDING = 1e-6  # N: the certificate's tolerance of 1e-8 is relative to some newtons


def without_finger(grasp: Grasp, finger: str) -> Grasp:
    """Return the grasp with the contacts of the other fingers."""
    pairs = [pair for pair in zip(grasp.fingers, grasp.contacts.contacts, strict=True) if pair[0] != finger]
    return replace(grasp, fingers=[name for name, _ in pairs], contacts=ContactSet.stack([contact for _, contact in pairs]))


def rest_step(grasp: Grasp, **conditions: object) -> Command:
    """Return the command of a step at rest, after one with all drives."""
    controller = ObjectController(grasp, settings_with())
    controller.step(state_at_rest(grasp), pose_at_rest(grasp))
    return controller.step(state_at_rest(grasp), pose_at_rest(grasp), **conditions)


@pytest.mark.parametrize("name", ["four_finger box", "four_finger sphere", "dlr_hit2 sphere", "anthropomorphic15"])
def test_other_fingers_take_over_in_the_same_period(name: str) -> None:
    """Forces and torques are those of a grasp without the finger, which has neither."""
    grasp = named_grasp(name)
    for finger in grasp.fingers[1:]:  # the thumb comes first
        command = rest_step(grasp, lost=[finger])
        i, other = grasp.fingers.index(finger), without_finger(grasp, finger)
        expected = rest_step(other)
        assert command.warnings[0] == f"{finger} has lost its drive: the other fingers hold the object"
        assert command.solution.found
        assert not command.forces_reused
        padded = command.contacts.pad(command.f)
        assert not padded[i].any()
        assert not command.tau[list(grasp.hand.finger(finger).joints)].any()
        others = np.delete(padded, i, axis=0)
        scale = np.abs(others).max()
        np.testing.assert_allclose(grasp_matrix(command.contacts) @ command.f, command.w, atol=ROUNDING * scale)
        np.testing.assert_allclose(others, expected.contacts.pad(expected.f), atol=2e-3 * scale)
        kept = friction.slip_margin(others, 0.63 * np.ones(len(others)), np.zeros(len(others)))
        assert kept.min() >= 0.3 - ROUNDING * scale


@pytest.mark.parametrize("contact", [{}, {"model": "soft", "torsional_friction": 0.005}], ids=["point", "soft"])
@pytest.mark.parametrize("name", ["four_finger box", "four_finger sphere", "allegro_right box"])
def test_motion_of_a_limp_finger_does_not_change_the_others(name: str, contact: dict[str, object]) -> None:
    """A limp finger that has swung away constrains neither the object nor the joints of the others."""
    grasp = with_contacts(named_grasp(name), **contact)
    hand, rng, finger = grasp.hand, np.random.default_rng(0), grasp.fingers[1]
    limp = list(hand.finger(finger).joints)
    others = [joint for each in grasp.fingers if each != finger for joint in hand.finger(each).joints]
    state, desired = disturbed(grasp, 1)
    without, law = (ObjectControlLaw(each, settings_with()) for each in (without_finger(grasp, finger), grasp))
    expected = without.compute_targets(without.initial_memory(), state, desired, None)
    lost = LostDrives.of(grasp, (finger,))
    for _ in range(3):
        q, v = np.array(state.q), np.array(state.v)
        q[limp], v[limp] = rng.uniform(hand.q_lower[limp], hand.q_upper[limp]), rng.normal(size=len(limp))
        targets = law.compute_targets(law.initial_memory(), GraspState(q, v, state.object), desired, None, lost)
        np.testing.assert_allclose(targets.w, expected.w, rtol=1e-9, atol=1e-12)
        found, wanted = targets.accelerations.uncontrollable, expected.accelerations.uncontrollable
        np.testing.assert_allclose(found.T @ found, wanted.T @ wanted, atol=1e-9)  # the same twists in any basis
        joint_acceleration = targets.joint_acceleration[others], expected.joint_acceleration[others]
        np.testing.assert_allclose(*joint_acceleration, rtol=1e-7, atol=1e-6)  # rad/s²


def test_second_step_after_a_loss_keeps_the_forces() -> None:
    """Drives that come back are used again."""
    grasp = named_grasp("four_finger box")
    controller = ObjectController(grasp, settings_with())
    state, rest = state_at_rest(grasp), pose_at_rest(grasp)
    before = controller.step(state, rest)
    first, second = (controller.step(state, rest, lost=["finger_2"]) for _ in range(2))
    np.testing.assert_allclose(first.f, second.f, atol=1e-3)
    np.testing.assert_allclose(controller.step(state, rest).f, before.f, atol=1e-3)


def test_loss_of_more_fingers_than_can_be_spared_gives_the_nearest_wrench() -> None:
    """Opposed to nothing, two fingers on one face of a box bear nothing that pushes it away."""
    grasp = named_grasp("four_finger box")
    command = rest_step(grasp, lost=["finger_3", "finger_4"])
    text = "finger_3, finger_4 have lost their drives: no forces of the other fingers hold the object"
    assert command.warnings == (f"{text}: safe stop with the nearest wrench",)
    assert command.forces_reused
    assert not command.solution.found
    assert not command.f.reshape(-1, 3)[2:].any()
    wrench = grasp_matrix(command.contacts) @ command.f
    assert np.linalg.norm(wrench[:3] - command.w[:3]) <= np.linalg.norm(command.w[:3])
    last = rest_step(grasp)  # the other fingers would push with this force
    pushed = grasp_matrix(grasp.contacts)[:3, :6] @ last.f[:6]
    assert np.linalg.norm(pushed) > 2.0 * np.linalg.norm(wrench[:3])


def test_two_point_contacts_keep_their_squeeze_without_a_certificate() -> None:
    """Index and thumb oppose each other: they bear the weight with the margin, but no moment about their line."""
    grasp = named_grasp("allegro_right sphere")
    command = rest_step(grasp, lost=["middle"])
    assert command.forces_reused
    assert "safe stop" in command.warnings[0]
    wrench, f = grasp_matrix(command.contacts) @ command.f, command.f.reshape(-1, 3)
    assert np.linalg.norm(wrench[:3] - command.w[:3]) < 0.05 * np.linalg.norm(command.w[:3])
    margins = 0.63 * f[:, 2] - np.hypot(f[:, 0], f[:, 1])
    assert margins[[0, 2]].min() >= 0.3 - 1e-3
    soft = with_contacts(grasp, model="soft", torsional_friction=0.005)
    assert rest_step(soft, lost=["middle"]).warnings == ("middle has lost its drive: the other fingers hold the object",)


def test_motion_beyond_the_other_fingers_is_stopped() -> None:
    """With half the friction, three fingers bear the weight but not an acceleration of 60 m/s²; four bear both."""
    grasp = with_contacts(named_grasp("four_finger box"), max_normal=2.5)
    settings = settings_with(gravity_H=[0.0, 0.0, -9.81])
    controller = ObjectController(grasp, settings)
    state = state_at_rest(grasp)
    fast = BodyMotion(grasp.p_HO, grasp.R_HO, np.zeros(6), [0.0, 0.0, 60.0, 0.0, 0.0, 0.0])
    assert not controller.step(state, fast).forces_reused
    command = controller.step(state, fast, lost=["finger_1"])
    assert command.warnings[0] == "finger_1 has lost its drive: the other fingers stop the object"
    assert command.solution.found
    np.testing.assert_allclose(command.w, [0, 0, 0.05 * 9.81, 0, 0, 0], atol=1e-12)
    assert np.array_equal(controller.memory.integral, np.zeros(6))

    # feedback holds the position where the stop began, and damps the rotation
    twist = np.array([0.0, 0.01, 0.0, 0.0, 0.0, 0.1])
    moved = BodyMotion(grasp.p_HO + np.array([0.0, 1e-4, 0.0]), grasp.R_HO, twist)
    command = controller.step(GraspState(state.q, state.v, moved), fast, lost=["finger_1"])
    expected = [0.0, -1600.0 * 1e-4 - 80.0 * 0.01, 0.0, 0.0, 0.0, -80.0 * 0.1]  # the default gains
    np.testing.assert_allclose(command.acceleration, expected, atol=1e-9)
    memory = ControlMemory.from_dict(controller.memory.to_dict(), grasp.contacts)
    np.testing.assert_array_equal(memory.stop, grasp.p_HO)
    controller.step(state, pose_at_rest(grasp), lost=["finger_1"])
    assert controller.memory.stop is None  # the desired motion is feasible again


def test_motors_of_other_fingers_are_not_lost() -> None:
    grasp = named_grasp("four_finger box")
    lost = LostDrives.of(grasp, ("finger_2", "finger_4"))
    assert np.flatnonzero(lost.motors).tolist() == [3, 4, 5, 9, 10, 11]
    assert np.flatnonzero(lost.contacts).tolist() == [1, 3]
    first, second = grasp.hand.fingers[:2]
    shared = replace(grasp.hand, fingers=(first, replace(second, joints=(2, *second.joints)), *grasp.hand.fingers[2:]))
    lost = LostDrives.of(replace(grasp, hand=shared), ("finger_2",))
    assert np.flatnonzero(lost.motors).tolist() == [3, 4, 5]  # joint 2 also moves the first finger


def test_unknown_lost_finger_is_named() -> None:
    with pytest.raises(UnknownName, match="finger_7"):
        rest_step(named_grasp("four_finger box"), lost=["finger_7"])
