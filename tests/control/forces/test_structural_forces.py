"""Forces that neither motors nor load determine: what they are, and that planned forces have none."""

from __future__ import annotations

import numpy as np
from support.link_grasps import power_grasp

from graspforce.contact.matrices import grasp_matrix
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings, GraspState, ObjectController
from graspforce.control.forces.structural_forces import structural_forces
from graspforce.grasp.link_grasp import LinkGrasp
from graspforce.grasp.search import find_grasp


def planned(grasp: LinkGrasp, margin: float) -> np.ndarray:
    held = grasp.as_grasp()
    rest = BodyMotion(held.p_HO, held.R_HO)
    controller = ObjectController(held, ControlSettings(slip_margin=margin))
    command = controller.step(GraspState(held.q, np.zeros(held.hand.n), rest), rest)
    assert command.solution.certificate.verified
    np.testing.assert_allclose(command.tau, held.hand.gravity_torque(held.q) + held.actuation().J.T @ command.f, atol=1e-9)
    return command.f


def test_structural_forces_change_neither_torques_nor_wrench() -> None:
    grasp = power_grasp("dlr_hit2").as_grasp()
    P, contacts = structural_forces(grasp), grasp.contacts
    assert P.shape[1] > 0
    np.testing.assert_allclose(P.T @ P, np.eye(P.shape[1]), atol=1e-12)  # point contacts: forces only
    # below the tolerance of the rank: a lever arm of 0.1 mm, and a part in 1,000 of the wrench
    assert np.abs(grasp.actuation().J.T @ P).max() < 1e-4
    assert np.abs(grasp_matrix(contacts) @ P).max() < 3e-3
    rows = np.vstack([grasp.actuation().J.T, grasp_matrix(contacts)])
    assert contacts.size - np.linalg.matrix_rank(rows, tol=1e-9) <= P.shape[1]


def test_planned_forces_are_those_of_least_norm_with_their_torques_and_wrench() -> None:
    """Contacts of equal stiffness would carry exactly these forces."""
    grasp = power_grasp("dlr_hit2")
    f = planned(grasp, 0.5)
    held = grasp.as_grasp()
    np.testing.assert_allclose(structural_forces(held).T @ f, 0.0, atol=1e-8)  # the solver's tolerance
    J, G = held.actuation().J, grasp_matrix(held.contacts)
    rows = np.vstack([J.T, G])
    least = np.linalg.pinv(rows, 1e-6) @ (rows @ f)
    np.testing.assert_allclose(f, least, atol=1e-6)


def test_fingertips_have_none() -> None:
    grasp = power_grasp("dlr_hit2")
    tips = find_grasp(grasp.hand, grasp.body, friction=0.6)
    assert structural_forces(tips).shape == (tips.contacts.size, 0)
    assert structural_forces(LinkGrasp.from_grasp(tips).as_grasp()).shape == (tips.contacts.size, 0)
