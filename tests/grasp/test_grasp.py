"""A grasp: its checks, contact errors, force problem and table."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.box_grasp import FINGERS, make_grasp

from graspforce import ContactModel, ContactSet, InvalidInput, Objective, Status, solve
from graspforce.contact.motion import BodyMotion
from graspforce.core.errors import UnknownName


def test_contact_error_is_the_shift_of_the_object():
    grasp = make_grasp()
    np.testing.assert_allclose(grasp.contact_errors(), 0.0, atol=2e-9)  # tolerance of the inverse kinematics
    shift = np.array([1e-3, -2e-3, 2e-3])
    np.testing.assert_allclose(make_grasp(p_HO=grasp.p_HO + shift).contact_errors(), 3e-3, atol=2e-9)


def test_grasp_rejects_wrong_fingers_and_shapes():
    with pytest.raises(UnknownName, match="finger_9"):
        make_grasp(fingers=(*FINGERS[:3], "finger_9"))
    for fingers in (FINGERS[:3], (*FINGERS[:3], "finger_1")):
        with pytest.raises(InvalidInput, match="4 different fingers"):
            make_grasp(fingers=fingers)
    with pytest.raises(InvalidInput, match="q = "):
        make_grasp(q=np.zeros(5))


def test_force_problem_is_that_of_the_weight_at_rest():
    grasp, gravity = make_grasp(), [0.3, -0.2, -9.8]
    problem = grasp.force_problem(gravity, objective=Objective("margin"))
    np.testing.assert_array_equal(problem.w, grasp.body.wrench(BodyMotion(grasp.p_HO, grasp.R_HO), gravity))
    np.testing.assert_allclose(problem.actuation.tau_u, grasp.hand.gravity_torque(grasp.q, gravity), atol=1e-15)
    J = grasp.hand.contact_jacobian(grasp.q, grasp.fingers, grasp.contacts, grasp.p_HO, grasp.R_HO)
    np.testing.assert_array_equal(problem.actuation.J, J)
    assert problem.objective.type == "margin"
    assert solve(grasp.force_problem()).status is Status.OPTIMAL


def test_printed_grasp_is_a_table_of_its_contacts():
    grasp = make_grasp()
    lines = str(grasp).splitlines()
    assert lines[0] == "four_finger holds a box of 0.15 kg at (0.0, 0.0, 55.0) mm in H"
    assert lines[2].split() == ["finger_1", "point", "30.00", "22.50", "0.00", "-1.000", "0.000", "0.000", "0.6"]
    assert len(lines) == 2 + len(grasp.contacts)
    assert repr(grasp) == "<Grasp: four_finger, finger_1, finger_2, finger_3, finger_4, 0.15 kg>"
    assert grasp._repr_html_().count("<tr>") == 1 + len(grasp.contacts)


def test_pads_of_the_fingers_give_the_contact_models():
    grasp = make_grasp()
    assert all(contact.model is ContactModel.POINT for contact in grasp.with_pads().contacts.contacts)
    padded = replace(grasp, hand=grasp.hand.with_pads(0.004)).with_pads()
    assert all(contact.model is ContactModel.SOFT for contact in padded.contacts.contacts)
    np.testing.assert_array_equal(padded.contacts.gamma, np.full(4, 0.004))
    for name in ("p_OC", "R_OC", "mu", "min_normal", "max_normal"):
        np.testing.assert_array_equal(getattr(padded.contacts, name), getattr(grasp.contacts, name))
    without = replace(padded, hand=grasp.hand).with_pads()
    assert without.contacts.models == grasp.contacts.models
    contacts = [replace(grasp.contacts.contacts[0], model="frictionless"), *grasp.contacts.contacts[1:]]
    slick = replace(padded, contacts=ContactSet.stack(contacts)).with_pads()
    assert slick.contacts.models == (ContactModel.FRICTIONLESS, *[ContactModel.SOFT] * 3)
