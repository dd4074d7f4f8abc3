"""Contact forces: known answers, and errors as large as their covariances say."""

from __future__ import annotations

import numpy as np
import pytest
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.control_grasps import named_grasp

from graspforce.contact.contact import Contact, ContactSet
from graspforce.core.errors import InvalidInput
from graspforce.estimation import GraspEstimator, Measurement, SensorModel
from graspforce.estimation.contact_forces import (
    ContactForceEstimator,
    ForceMemory,
    ForceModelErrors,
    contact_wrench,
    wrench_covariances,
)

GRASPS = ("allegro_right sphere", "dlr_hit2 sphere", "anthropomorphic15")


def contacts_of(grasp):
    return GraspEstimator(grasp).initial_memory(Measurement(0.0, grasp.q)).pose


def at_rest(grasp):
    return np.array([grasp.q, np.zeros(grasp.hand.n), np.zeros(grasp.hand.n)])


def rows_of(grasp):
    """Return A of the point velocities, (3 N, n)."""
    return contacts_of(grasp).A.reshape(len(grasp.contacts), 4, -1)[:, :3].reshape(3 * len(grasp.contacts), -1)


def squeezing_forces(grasp, seed):
    """Return forces inside the friction cones, (N, 3), N."""
    rng = np.random.default_rng(seed)
    f = rng.uniform(-0.3, 0.3, (len(grasp.contacts), 3))
    f[:, 2] = rng.uniform(1.0, 2.0, len(grasp.contacts))
    return f


def in_hand(grasp, f):
    """Return measured fingertip wrenches (N, 6) in H of forces in C."""
    wrench = np.zeros((len(f), 6))
    wrench[:, :3] = np.einsum("ij,njk,nk->ni", grasp.R_HO, grasp.contacts.R_OC, f)
    return wrench


def test_torques_at_rest_give_the_forces():
    grasp = three_finger_grasp()
    f = squeezing_forces(grasp, 1)
    tau = grasp.hand.gravity_torque(grasp.q, PALM_UP) + rows_of(grasp).T @ f.ravel()
    estimator = ContactForceEstimator(grasp, SensorModel(), PALM_UP)
    forces, _ = estimator.step(ForceMemory(), contacts_of(grasp), at_rest(grasp), tau)
    assert np.abs(forces.f - f).max() < 1e-6  # the prior of 20 N weighs 1e-9 of the torques
    assert forces.mismatch is None


def test_torques_in_motion_give_the_forces():
    grasp, rng = three_finger_grasp(), np.random.default_rng(2)
    hand, f = grasp.hand, squeezing_forces(grasp, 2)
    v, a, d = rng.normal(0.0, [[0.5], [5.0], [5.0]], (3, hand.n))
    tau = hand.inverse_dynamics(grasp.q, v, a + d, PALM_UP) + rows_of(grasp).T @ f.ravel()
    estimator = ContactForceEstimator(grasp, SensorModel(), PALM_UP)
    forces, _ = estimator.step(ForceMemory(), contacts_of(grasp), np.array([grasp.q, v, d]), tau, a)
    assert np.abs(forces.f - f).max() < 1e-6
    at_commanded, _ = estimator.step(ForceMemory(), contacts_of(grasp), np.array([grasp.q, v, 0.0 * d]), tau, a)
    assert np.abs(at_commanded.f - forces.inertial - forces.f).max() < 1e-9  # the part of d


def test_fingertip_sensors_alone_give_the_forces():
    grasp = three_finger_grasp()
    f = squeezing_forces(grasp, 3)
    no_torques = ForceModelErrors(torque_bias=100.0)
    estimator = ContactForceEstimator(grasp, SensorModel(tip_force_noise=0.01), PALM_UP, no_torques)
    forces, _ = estimator.step(ForceMemory(), contacts_of(grasp), at_rest(grasp), np.zeros(16), None, in_hand(grasp, f))
    assert np.abs(forces.f - f).max() < 1e-5
    assert np.allclose(forces.covariance, 1e-4 * np.eye(9), rtol=1e-3, atol=1e-9)  # N²: the sensors' own noise


def normalised_errors(grasp, sensors, errors, draws, seed):
    """Return squared errors of the forces over their covariances, from random errors of all measurements."""
    rng, hand, count = np.random.default_rng(seed), grasp.hand, len(grasp.contacts)
    contacts, A = contacts_of(grasp), rows_of(grasp)
    f = squeezing_forces(grasp, seed)
    true_tau = hand.gravity_torque(grasp.q, PALM_UP) + A.T @ f.ravel()
    estimator = ContactForceEstimator(grasp, sensors, PALM_UP, errors)
    values = []
    for _ in range(draws):
        tau = true_tau + sensors.torque_noise * rng.normal(size=hand.n) + errors.torque_bias * rng.normal(size=hand.n)
        tips = (
            f + (sensors.tip_force_noise or 0.0) * rng.normal(size=(count, 3)) + errors.tip_bias * rng.normal(size=(count, 3))
        )
        measured = None if sensors.tip_force_noise is None else in_hand(grasp, tips)
        forces, _ = estimator.step(ForceMemory(), contacts, at_rest(grasp), tau, None, measured)
        error = (forces.f - f).ravel()
        values.append(error @ np.linalg.solve(forces.covariance, error))
    return np.array(values)


@pytest.mark.parametrize("tips", [None, 0.05])
def test_errors_are_as_large_as_their_covariance(tips):
    grasp = three_finger_grasp()
    sensors = SensorModel(torque_noise=3e-3, tip_force_noise=tips)
    values = normalised_errors(grasp, sensors, ForceModelErrors(torque_bias=2e-3, tip_bias=0.02), 300, 4)
    assert abs(values.mean() / 9.0 - 1.0) < 4.0 * np.sqrt(2.0 / (9.0 * 300))  # χ² with 9 degrees of freedom, 4 deviations


def test_a_second_source_reduces_the_covariance():
    grasp = three_finger_grasp()
    contacts, tau = contacts_of(grasp), grasp.hand.gravity_torque(grasp.q, PALM_UP)
    both = ContactForceEstimator(grasp, SensorModel(torque_noise=3e-3, tip_force_noise=0.05), PALM_UP)
    torques, _ = both.step(ForceMemory(), contacts, at_rest(grasp), tau)
    fused, _ = both.step(ForceMemory(), contacts, at_rest(grasp), tau, None, np.zeros((3, 6)))
    assert np.linalg.eigvalsh(torques.covariance - fused.covariance)[0] > -1e-9
    assert np.linalg.eigvalsh(0.05**2 * np.eye(9) - fused.covariance)[0] > -1e-9


def test_a_change_of_the_sensors_takes_effect_at_once():
    grasp = three_finger_grasp()
    contacts, tau = contacts_of(grasp), grasp.hand.gravity_torque(grasp.q, PALM_UP)
    estimator = ContactForceEstimator(grasp, SensorModel(torque_noise=3e-3, tip_force_noise=0.05), PALM_UP)
    first, memory = estimator.step(ForceMemory(), contacts, at_rest(grasp), tau)
    second, memory = estimator.step(memory, contacts, at_rest(grasp), tau, None, np.zeros((3, 6)))
    third, _ = estimator.step(memory, contacts, at_rest(grasp), tau)
    assert second.mismatch is not None
    assert np.array_equal(first.covariance, third.covariance)
    assert second.covariance.trace() < first.covariance.trace()


def test_mismatch_shows_an_unexpected_acceleration():
    grasp = three_finger_grasp()
    f, M = squeezing_forces(grasp, 5), grasp.hand.mass_matrix(grasp.q)
    deviation = np.zeros(16)
    deviation[0] = 20.0  # rad/s²
    tau = grasp.hand.gravity_torque(grasp.q, PALM_UP) + rows_of(grasp).T @ f.ravel() + M @ deviation
    estimator = ContactForceEstimator(grasp, SensorModel(torque_noise=1e-3, tip_force_noise=0.02), PALM_UP)
    forces, _ = estimator.step(ForceMemory(), contacts_of(grasp), at_rest(grasp), tau, None, in_hand(grasp, f))
    assert forces.mismatch is not None
    moved = np.linalg.norm(forces.mismatch, axis=1)
    assert moved[0] > 0.1  # N: the finger of joint 0
    assert moved[1:].max() < 0.05 * moved[0]


def test_frictionless_contacts_have_no_tangential_force():
    point = three_finger_grasp()
    normals = point.contacts.R_OC[:, :, 2]
    contacts = ContactSet.stack(
        [Contact(p, n, model="frictionless") for p, n in zip(point.contacts.p_OC, normals, strict=True)]
    )
    grasp = type(point)(point.hand, point.body, point.fingers, contacts, point.q, point.p_HO, point.R_HO)
    tau = grasp.hand.gravity_torque(grasp.q, PALM_UP) + rows_of(grasp)[2::3].T @ np.ones(3)
    forces, _ = ContactForceEstimator(grasp, SensorModel(torque_noise=1e-3), PALM_UP).step(
        ForceMemory(), contacts_of(grasp), at_rest(grasp), tau
    )
    assert np.abs(forces.f[:, :2]).max() < 1e-2
    assert np.abs(forces.f[:, 2] - 1.0).max() < 1e-2


def test_a_displaced_contact_stays_within_its_bias():
    grasp, place = three_finger_grasp(), 3e-3  # m
    f, contacts = squeezing_forces(grasp, 6), contacts_of(grasp)
    estimator = ContactForceEstimator(grasp, SensorModel(torque_noise=1e-3), PALM_UP, ForceModelErrors(contact_place=place))
    errors, rng = [], np.random.default_rng(6)
    for _ in range(40):
        moved = [
            Contact(contact.position + contact.R_OC[:, :2] @ rng.normal(0.0, place, 2), contact.normal, 0.7)
            for contact in grasp.contacts.contacts
        ]
        true = ContactSet.stack(moved)
        J = grasp.hand.contact_jacobian(grasp.q, grasp.fingers, true, grasp.p_HO, grasp.R_HO)
        in_true = np.einsum("nji,njk,nk->ni", true.R_OC, grasp.contacts.R_OC, f)  # the same forces, in other frames
        tau = grasp.hand.gravity_torque(grasp.q, PALM_UP) + J.T @ in_true.ravel()
        forces, _ = estimator.step(ForceMemory(), contacts, at_rest(grasp), tau)
        errors.append((forces.f - f).ravel() / np.sqrt(forces.covariance.diagonal()))
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) < 1.3  # the prior and the roughly known forces make it cautious


def test_torsion_makes_torques_less_certain():
    def variance(gamma):
        grasp = three_finger_grasp()
        soft = [Contact(each.position, each.normal, 0.7, "soft", each.tangent, gamma) for each in grasp.contacts.contacts]
        grasp = type(grasp)(grasp.hand, grasp.body, grasp.fingers, ContactSet.stack(soft), grasp.q, grasp.p_HO, grasp.R_HO)
        tau = grasp.hand.gravity_torque(grasp.q, PALM_UP) + rows_of(grasp)[2::3].T @ np.ones(3)
        estimator = ContactForceEstimator(grasp, SensorModel(torque_noise=1e-3), PALM_UP)
        return estimator.step(ForceMemory(), contacts_of(grasp), at_rest(grasp), tau)[0].covariance.trace()

    assert variance(0.005) > 1.01 * variance(0.0)


def test_the_wrench_on_the_object_is_that_of_the_contacts():
    grasp = three_finger_grasp()
    f = squeezing_forces(grasp, 7)
    tau = grasp.hand.gravity_torque(grasp.q, PALM_UP) + rows_of(grasp).T @ f.ravel()
    estimator = ContactForceEstimator(grasp, SensorModel(), PALM_UP)
    forces, _ = estimator.step(ForceMemory(), contacts_of(grasp), at_rest(grasp), tau)
    w, (noise, bias) = contact_wrench(contacts_of(grasp), forces.f), wrench_covariances(contacts_of(grasp), forces)
    in_O = np.einsum("nij,nj->ni", grasp.contacts.R_OC, f)
    expected = np.concatenate([in_O.sum(axis=0), np.cross(grasp.contacts.p_OC, in_O).sum(axis=0)])
    assert np.abs(w - expected).max() < 1e-6
    assert np.linalg.eigvalsh(noise)[0] > -1e-12
    assert np.linalg.eigvalsh(bias)[0] > -1e-12


@pytest.mark.parametrize("name", GRASPS)
def test_undetermined_forces_keep_the_size_of_the_prior(name):
    grasp = named_grasp(name)
    tau = grasp.hand.gravity_torque(grasp.q, (0.0, 0.0, -9.81))
    estimator = ContactForceEstimator(grasp, SensorModel(torque_noise=1e-3), np.array([0.0, 0.0, -9.81]))
    forces, _ = estimator.step(ForceMemory(), contacts_of(grasp), at_rest(grasp), tau)
    assert np.sqrt(forces.covariance.diagonal()).max() < 20.1  # N, `force_size`
    assert np.abs(forces.f).max() < 1.0


def test_model_errors_survive_their_record():
    errors = ForceModelErrors(torque_bias=0.01, contact_place=1e-3)
    assert ForceModelErrors.from_dict(errors.to_dict()) == errors
    assert ForceModelErrors.from_dict({}) == ForceModelErrors()


@pytest.mark.parametrize(("field", "value"), [("torque_bias", -1.0), ("force_size", 0.0), ("tip_noize", 1.0)])
def test_model_errors_reject_bad_values(field, value):
    with pytest.raises(InvalidInput) as caught:
        ForceModelErrors.from_dict({field: value})
    assert caught.value.field == f"force_errors.{field}"


@pytest.mark.parametrize("name", GRASPS)
def test_old_gains_do_not_change_exact_forces_of_fingertip_sensors(name):
    """The gains hold for some periods, in which the posture changes by up to 10 mrad."""
    grasp = named_grasp(name)
    sensors, f = SensorModel(torque_noise=1e-3, tip_force_noise=0.02), squeezing_forces(grasp, 8)
    estimator = ContactForceEstimator(grasp, sensors, PALM_UP)
    rest, memory = np.zeros(grasp.hand.n), ForceMemory()
    for turn in (0.0, 8e-3):  # rad
        q = grasp.q + turn
        contacts = GraspEstimator(grasp).initial_memory(Measurement(0.0, q)).pose
        A = contacts.A.reshape(len(f), 4, -1)[:, :3].reshape(3 * len(f), -1)
        tau = grasp.hand.gravity_torque(q, PALM_UP) + A.T @ f.ravel()
        wrench = np.zeros((len(f), 6))
        wrench[:, :3] = np.einsum("ij,njk,nk->ni", contacts.R_HO, contacts.R_OC, f)
        forces, memory = estimator.step(memory, contacts, np.array([q, rest, rest]), tau, None, wrench)
        assert np.abs(forces.f - f).max() < 1e-10
        assert np.abs(forces.mismatch).max() < 1e-10
    assert memory.age == 1  # the gains are those of the first posture
