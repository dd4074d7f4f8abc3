"""Small margins, slip, lost contacts and joint limits: the forces of the command, and its warnings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.control_grasps import named_grasp
from support.control_steps import (
    disturbed,
    pose_at_rest,
    settings_with,
    with_contacts,
)

from graspforce import ContactSet
from graspforce.contact.matrices import grasp_matrix
from graspforce.contact.motion import BodyMotion
from graspforce.control import (
    GraspState,
    ObjectController,
)
from graspforce.control.contacts.contact_conditions import ContactConditions
from graspforce.control.object_control_law import ObjectControlLaw

pytestmark = pytest.mark.usefixtures("arithmetic")


def test_frictionless_and_soft_contacts_keep_their_cones_and_margins() -> None:
    """A soft contact's moment counts in the margin; a frictionless contact has no margin."""
    grasp = named_grasp("four_finger box")
    soft = with_contacts(grasp, model="soft", torsional_friction=0.005)
    command = ObjectController(soft, settings_with()).step(*disturbed(soft, 1))
    assert command.f.shape == (16,)
    f = command.f.reshape(-1, 4)
    load = np.sqrt(f[:, 0] ** 2 + f[:, 1] ** 2 + (0.63 * f[:, 3] / 0.005) ** 2)
    assert (load <= 0.63 * f[:, 2] - 0.3 + 1e-6).all()
    np.testing.assert_allclose(grasp_matrix(command.contacts) @ command.f, command.w, atol=1e-6)

    contacts = [*grasp.contacts.contacts[:3], replace(grasp.contacts.contacts[3], model="frictionless", friction=None)]
    slick = replace(grasp, contacts=ContactSet.stack(contacts))
    command = ObjectController(slick, settings_with()).step(*disturbed(slick, 1))
    assert command.f.shape == (10,)
    assert not command.warnings
    np.testing.assert_allclose(grasp_matrix(command.contacts) @ command.f, command.w, atol=1e-6)


def test_slipping_fingers_are_named_before_half_a_millimetre() -> None:
    """The object sinks between the fingers at 2 mm/s, so that all slip. Then only one finger slips."""
    grasp = named_grasp("four_finger box")
    controller, speed = ObjectController(grasp, settings_with()), np.array([0.0, 0.0, -2e-3])
    warned = None
    for i in range(300):
        motion = BodyMotion(grasp.p_HO + 1e-3 * i * speed, grasp.R_HO, [*speed, 0.0, 0.0, 0.0])
        command = controller.step(GraspState(grasp.q, np.zeros(12), motion), pose_at_rest(grasp))
        if command.warnings and warned is None:
            warned = np.linalg.norm(motion.p_HO - grasp.p_HO)
            assert [warning.split()[:2] for warning in command.warnings] == [[finger, "slips:"] for finger in grasp.fingers]
            np.testing.assert_allclose(command.creep, warned, rtol=0.06)  # it decays with 1 s, for 0.05 s
    assert warned is not None
    assert 1e-4 <= warned < 5e-4

    controller.reset()
    J = grasp.hand.contact_jacobian(grasp.q, grasp.fingers, grasp.contacts, grasp.p_HO, grasp.R_HO)
    v = np.linalg.lstsq(J, [0.0] * 3 + [0.005, 0.0, 0.0] + [0.0] * 6, rcond=None)[0]
    for i in range(31):
        command = controller.step(GraspState(grasp.q + 1e-3 * i * v, v, pose_at_rest(grasp)), pose_at_rest(grasp))
    assert [warning.split()[0] for warning in command.warnings] == ["finger_2"]
    np.testing.assert_allclose(command.creep, [0.0, 1.5e-4, 0.0, 0.0], atol=5e-6)


def test_fast_rolling_over_a_long_way_is_not_slip() -> None:
    """Object and fingers oscillate by 6 mm at 3 Hz, and the measured rates are half a period old."""
    grasp, period = named_grasp("allegro_right sphere"), 1e-3
    law = ObjectControlLaw(grasp, settings_with())
    memory, q, v, farthest = law.initial_memory(), np.array(grasp.q), np.zeros(16), 0.0

    def place(t: float) -> np.ndarray:
        return grasp.p_HO + np.array([0.0, 3e-3 * (1.0 - np.cos(6.0 * np.pi * t)), 0.0])

    def rates(q: np.ndarray, t: float) -> np.ndarray:
        """Return joint rates with which the fingers roll on the sphere."""
        velocity = np.array([0.0, 18e-3 * np.pi * np.sin(6.0 * np.pi * t), 0.0])  # m/s
        rows = []
        for finger in grasp.fingers:
            c = grasp.hand.tip_pose(q, finger)[0] - place(t)
            rows.append(grasp.hand.point_jacobian(q, finger, place(t) + 0.03 * c / np.linalg.norm(c))[:3])
        return np.linalg.lstsq(np.vstack(rows), np.tile(velocity, 3), rcond=None)[0]

    for i in range(700):
        t = i * period
        command, memory = law.step(memory, GraspState(q, v, BodyMotion(place(t), grasp.R_HO)), pose_at_rest(grasp))
        assert command.creep.max() < 1e-5  # m: a tenth of the creep limit
        farthest = max(farthest, float(np.linalg.norm(command.contacts.p_OC - grasp.contacts.p_OC, axis=1).max()))
        v = rates(q + period / 2 * rates(q, t), t + period / 2)
        q = q + period * v
    assert farthest > 1e-3  # m: the contacts moved on the sphere


def test_joints_at_their_limits_are_named() -> None:
    grasp = named_grasp("four_finger box")
    q = np.array(grasp.q)
    q[4] = grasp.hand.q_upper[4] + 1e-3
    warnings = (
        ObjectController(grasp, settings_with())
        .step(GraspState(q, np.zeros(12), pose_at_rest(grasp)), pose_at_rest(grasp))
        .warnings
    )
    assert f"{grasp.hand.joints[4].name} is at its position limit: {q[4]:.3f} rad" in warnings


def test_lost_contacts_are_named() -> None:
    grasp = named_grasp("four_finger box")
    q = np.array(grasp.q)
    wide = replace(grasp.contacts, p_OC=grasp.contacts.p_OC * np.array([[1.0 + 2e-3 / 0.03, 1.0, 1.0]] + [[1.0] * 3] * 3))
    q = grasp.hand.grasp_posture(grasp.fingers, wide, grasp.p_HO, grasp.R_HO, grasp.q)
    command = ObjectController(grasp, settings_with()).step(
        GraspState(q, np.zeros(12), pose_at_rest(grasp)), pose_at_rest(grasp)
    )
    assert command.warnings == ("finger_1 has lost contact: 2.00 mm from the object",)


def test_stated_slip_and_contact_decide_instead_of_distances() -> None:
    """The object is 2 mm away from two fingers. Flags of the contacts replace the distances."""
    grasp = named_grasp("four_finger box")
    law = ObjectControlLaw(grasp, settings_with())
    inward = grasp.R_HO @ grasp.contacts.R_OC[0, :, 2]
    moved = BodyMotion(grasp.p_HO + 2e-3 * inward, grasp.R_HO)
    state = GraspState(grasp.q, np.zeros(grasp.hand.n), moved)

    def stated(conditions: ContactConditions | None) -> set[str]:
        command, _ = law.step(law.initial_memory(), state, moved, None, conditions)
        return {" ".join(text.split()[:2]) for text in command.warnings if text.startswith("finger")}

    assert any(text.endswith(" has") for text in stated(None))  # has lost contact
    assert stated(ContactConditions([False] * 4, touching=[True] * 4)) == set()
    found = stated(ContactConditions([True, False, False, False], touching=[True, True, False, True]))
    assert found == {"finger_1 slips:", "finger_3 has"}
