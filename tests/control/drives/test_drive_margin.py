"""The slip margin under torque errors: forces of the constrained dynamics with wrong torques, in the worst case and random."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.control_grasps import named_grasp, with_all_contact_models
from support.control_steps import disturbed

from graspforce.contact import friction
from graspforce.control import ObjectController
from graspforce.control.contacts.contact_constraints import ContactConstraints
from graspforce.control.drives.drive_margin import torque_sensitivity
from graspforce.grasp.grasp import Grasp
from graspforce.hand.drives.drive import Drive

pytestmark = pytest.mark.usefixtures("arithmetic")

GRASPS = ["allegro_right sphere", "four_finger box", "dlr_hit2 sphere"]


def constrained_forces(A, B, M, M_object, tau):
    """Return the forces of A q̈ = B a, M q̈ = tau − Aᵀ f, M_o a = Bᵀ f as one linear system, in the rows of A."""
    r, n = A.shape
    system = np.block([[M, np.zeros((n, 6)), A.T], [np.zeros((6, n)), M_object, -B.T], [A, -B, np.zeros((r, r))]])
    return np.linalg.lstsq(system, np.concatenate([tau, np.zeros(6 + r)]), rcond=1e-12)[0][n + 6 :]


def dynamics(grasp: Grasp, seed: int):
    """Return a command, with the rows and masses of its contacts."""
    controller = ObjectController(grasp)
    state, desired = disturbed(grasp, seed)
    command = controller.step(state, desired)
    constraints = ContactConstraints.from_contacts(grasp.contacts)
    A, B, _ = constraints.constraint_rows(command._source.targets.rolling)
    return command, constraints, (A, B, grasp.hand.mass_matrix(state.q), grasp.body.mass_matrix())


@pytest.mark.parametrize("name", GRASPS)
def test_margin_holds_for_all_torque_errors_within_the_bound(name):
    grasp, rng = named_grasp(name), np.random.default_rng(5)
    contacts, error = grasp.contacts, rng.uniform(0.0, 0.02, grasp.hand.n)
    command, constraints, parts = dynamics(grasp, 1)
    loss = torque_sensitivity(*parts, constraints, contacts).margin @ error
    planned = constraints.constraint_forces(contacts.pad(command.f))
    for _ in range(200):
        wrong = error * rng.choice([-1.0, 1.0], grasp.hand.n)
        padded = np.zeros(4 * len(contacts))
        padded[constraints.padded_rows] = planned + constrained_forces(*parts, wrong)
        margin = friction.slip_margin(padded.reshape(-1, 4), contacts.mu, contacts.gamma)
        assert (margin >= command.slip_margin - loss - 1e-9).all()  # rounding of the linear system


@pytest.mark.parametrize("name", GRASPS)
def test_error_of_one_joint_takes_part_of_the_bound(name):
    """A bound many times above the effect would be of no use: one joint alone reaches at least a fifth of its share."""
    grasp = named_grasp(name)
    contacts = grasp.contacts
    command, constraints, parts = dynamics(grasp, 2)
    planned = constraints.constraint_forces(contacts.pad(command.f))
    for j in grasp.hand.finger(grasp.fingers[0]).joints:
        error = np.zeros(grasp.hand.n)
        error[j] = 0.01
        loss, found = torque_sensitivity(*parts, constraints, contacts).margin @ error, np.zeros(len(contacts))
        for sign in (-1.0, 1.0):
            padded = np.zeros(4 * len(contacts))
            padded[constraints.padded_rows] = planned + constrained_forces(*parts, sign * error)
            margin = friction.slip_margin(padded.reshape(-1, 4), contacts.mu, contacts.gamma)
            found = np.maximum(found, command.slip_margin - margin)
        assert found.max() >= 0.2 * loss.max()


@pytest.mark.parametrize("error", [0.1, 0.2])
def test_guaranteed_margin_falls_in_proportion_to_the_torque_error(error):
    grasp = named_grasp("allegro_right sphere")
    uncertain = replace(grasp, hand=grasp.hand.with_drives(Drive("current", torque_constant=1.0, torque_error=error)))
    command, constraints, parts = dynamics(uncertain, 4)
    np.testing.assert_allclose(command.drive.torque_error, error * np.abs(command.tau), rtol=1e-9)
    loss = torque_sensitivity(*parts, constraints, grasp.contacts).margin @ np.abs(command.tau)  # N, of errors of 100 %
    assert (loss > 0.0).all()
    np.testing.assert_allclose(command.slip_margin - command.guaranteed_margin, error * loss, rtol=1e-9)


def test_torque_errors_of_soft_contacts_use_their_torsion():
    grasp = with_all_contact_models(named_grasp("allegro_right sphere"), 3)
    command, constraints, parts = dynamics(grasp, 1)
    rng, error = np.random.default_rng(6), np.full(grasp.hand.n, 0.005)
    loss = torque_sensitivity(*parts, constraints, grasp.contacts).margin @ error
    units = constraints.row_units
    planned = constraints.constraint_forces(grasp.contacts.pad(command.f))
    for _ in range(200):
        padded = np.zeros(4 * len(grasp.contacts))
        wrong = constrained_forces(*parts, error * rng.choice([-1.0, 1.0], grasp.hand.n))
        padded[constraints.padded_rows] = units * (planned + wrong)
        margin = friction.slip_margin(padded.reshape(-1, 4), grasp.contacts.mu, grasp.contacts.gamma)
        assert (margin >= command.slip_margin - loss - 1e-9).all()
