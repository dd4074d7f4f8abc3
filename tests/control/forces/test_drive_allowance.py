"""Margins planned for drives: random torque errors leave the wanted margin, and the integral can oppose the worst ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.control_grasps import named_grasp
from support.control_steps import pose_at_rest, settings_with, state_at_rest

from graspforce.contact import friction
from graspforce.control import Command, ControlSettings, ObjectController
from graspforce.control.contacts.contact_constraints import ContactConstraints
from graspforce.control.drives.drive_commands import DriveMap
from graspforce.control.drives.drive_margin import torque_sensitivity
from graspforce.control.forces.drive_allowance import DriveAllowance, drive_allowance
from graspforce.control.object_control_law import ObjectControlLaw
from graspforce.core.arrays import Array
from graspforce.grasp.grasp import Grasp
from graspforce.hand.drives.drive import Drive

pytestmark = pytest.mark.usefixtures("arithmetic")

WANTED = 0.5  # N
SETTINGS = settings_with(slip_margin=WANTED)
NAMES = ["allegro_right sphere", "dlr_hit2 sphere"]
DRIVES = {
    "current": Drive("current", torque_constant=1.0, torque_error=0.2),
    "position": Drive("position", stiffness=5.0, damping=0.05, stiffness_error=0.3),
}


def driven(name: str, drive: Drive) -> Grasp:
    grasp = named_grasp(name)
    return replace(grasp, hand=grasp.hand.with_drives(drive))


def rest_command(grasp: Grasp, settings: ControlSettings = SETTINGS) -> Command:
    return ObjectController(grasp, settings).step(state_at_rest(grasp), pose_at_rest(grasp))


def rest_parts(grasp: Grasp):
    """Return the targets at rest, and matrices and masses of the contacts."""
    law = ObjectControlLaw(grasp, SETTINGS)
    targets = law.compute_targets(law.initial_memory(), state_at_rest(grasp), pose_at_rest(grasp), None)
    constraints = ContactConstraints.from_contacts(grasp.contacts)
    A, B, _ = constraints.constraint_rows(targets.rolling)
    return targets, constraints, (A, B, grasp.hand.mass_matrix(grasp.q), grasp.body.mass_matrix())


def allowance_of(grasp: Grasp, settings: ControlSettings = SETTINGS) -> DriveAllowance:
    targets, constraints, _ = rest_parts(grasp)
    return drive_allowance(grasp, settings, constraints, DriveMap(grasp.hand), targets)


def force_changes(grasp: Grasp, torque_errors: Array) -> tuple[Array, Array]:
    """Return changes of the contact forces (samples, N, 4) and object accelerations (samples, 6) of A q̈ = B a as one system."""
    _, constraints, (A, B, M, M_object) = rest_parts(grasp)
    (r, n), samples = A.shape, len(torque_errors)
    system = np.block([[M, np.zeros((n, 6)), A.T], [np.zeros((6, n)), M_object, -B.T], [A, -B, np.zeros((r, r))]])
    solved = np.linalg.lstsq(system, np.vstack([torque_errors.T, np.zeros((6 + r, samples))]), rcond=1e-12)[0]
    padded = np.zeros((samples, 4 * len(grasp.contacts)))
    padded[:, constraints.padded_rows] = solved[n + 6 :].T * constraints.row_units
    return padded.reshape(samples, -1, 4), solved[n : n + 6].T


@pytest.mark.parametrize("mode", DRIVES)
@pytest.mark.parametrize("name", NAMES)
def test_wanted_margin_remains_for_random_torque_errors(name, mode):
    """The planned margin covers one standard deviation: a contact keeps the wanted margin in 84 % of all cases at least."""
    grasp = driven(name, DRIVES[mode])
    contacts, command = grasp.contacts, rest_command(grasp)
    assert (command.slip_margin > WANTED).all()
    errors = command.drive.torque_error * np.random.default_rng(7).uniform(-1.0, 1.0, (2000, grasp.hand.n))
    changes, _ = force_changes(grasp, errors)
    true = np.array([friction.slip_margin(contacts.pad(command.f) + each, contacts.mu, contacts.gamma) for each in changes])
    assert ((true >= WANTED).mean(axis=0) >= 0.84).all()
    assert (true >= command.guaranteed_margin - 1e-9).all()  # rounding of the linear system


@pytest.mark.parametrize("name", NAMES)
def test_ideal_drives_need_no_further_margin(name):
    grasp = driven(name, Drive())
    command = rest_command(grasp)
    modelled = friction.slip_margin(command.contacts.pad(command.f), 0.9 * grasp.contacts.mu, grasp.contacts.gamma)
    np.testing.assert_allclose(modelled.min(), WANTED, rtol=1e-6)  # tolerance of the certificate; 0.9 for the reserve


@pytest.mark.parametrize("name", NAMES)
def test_margin_is_not_raised_if_errors_grow_faster_than_it(name):
    """With torques known to ± 200 %, each newton of margin costs more than a newton of guaranteed margin."""
    uncertain, ideal = (driven(name, drive) for drive in (replace(DRIVES["current"], torque_error=2.0), Drive()))
    assert allowance_of(uncertain).slip_margin == 0.0
    np.testing.assert_allclose(rest_command(uncertain).f, rest_command(ideal).f, atol=1e-6)  # N: the certificate's tolerance


@pytest.mark.parametrize("name", NAMES)
def test_margin_for_drives_does_not_saturate_motors(name):
    """Motors that can just hold the object get no load for the errors of their drives that takes their last torque."""
    strong = driven(name, DRIVES["position"])
    tau = np.abs(rest_command(driven(name, Drive())).tau)
    weak = replace(strong, hand=strong.hand.with_torque_limits(np.full(strong.hand.n, 1.15 * tau.max())))
    command = rest_command(weak)
    assert 0.0 < allowance_of(weak).slip_margin < allowance_of(strong).slip_margin
    assert not command.saturated
    assert not command.warnings


@pytest.mark.parametrize("mode", DRIVES)
def test_integral_can_oppose_all_torque_errors_at_once(mode):
    grasp = driven("allegro_right sphere", DRIVES[mode])
    settings = replace(SETTINGS, integral_limit_linear=0.5, integral_limit_angular=5.0)  # m/s² and rad/s²
    linear, angular = allowance_of(grasp, settings).integral_limits
    error = rest_command(grasp, settings).drive.torque_error
    _, acceleration = force_changes(grasp, error * np.random.default_rng(8).choice([-1.0, 1.0], (500, grasp.hand.n)))
    largest = np.linalg.norm(acceleration.reshape(-1, 2, 3), axis=2).max(axis=0)
    assert 0.5 < largest[0] <= linear  # m/s²
    assert 5.0 < largest[1] <= angular  # rad/s²
    assert allowance_of(driven("allegro_right sphere", Drive()), settings).integral_limits == (0.5, 5.0)
    _, _, parts = rest_parts(grasp)
    sensitivity = torque_sensitivity(*parts, ContactConstraints.from_contacts(grasp.contacts), grasp.contacts)
    rolled = sensitivity.acceleration @ error
    np.testing.assert_allclose(force_changes(grasp, error[None])[1][0], rolled, atol=1e-9 * np.abs(rolled).max())
