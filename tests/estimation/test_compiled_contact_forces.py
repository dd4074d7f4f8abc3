"""Contact forces in C equal the reference in NumPy to rounding."""

from __future__ import annotations

import numpy as np
import pytest
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.control_grasps import named_grasp, with_all_contact_models

from graspforce.estimation import GraspEstimator, Measurement, SensorModel
from graspforce.estimation.compiled_contact_forces import CompiledForceEstimator, make_force_estimator
from graspforce.estimation.contact_forces import ContactForceEstimator, ForceMemory, ForceModelErrors

pytest.importorskip("graspforce.core._native", reason="the compiled module was not built: no C compiler at installation")

ROUNDING = 2e-9  # of forces, relative: the information has a condition of up to 2e6, for anthropomorphic15
COVARIANCE_ROUNDING = 1e-8  # relative: the prior of 20 N beside 1 mN·m of noise makes the information's condition 1e8
ERRORS = ForceModelErrors(torque_bias=2e-3, torque_scale=0.02, tip_bias=0.01, tip_scale=0.03)
NAMES = ("noise", "bias", "mismatch_noise", "f", "inertial", "mismatch", "measured")


def grasp_of(name):
    return with_all_contact_models(three_finger_grasp() if name == "allegro" else named_grasp(name), 0)


def random_inputs(grasp, rng, has_tips):
    """Return contacts, joints, torques, accelerations and fingertip wrenches of a hand in motion that squeezes."""
    n, count = grasp.hand.n, len(grasp.contacts)
    contacts = GraspEstimator(grasp).initial_memory(Measurement(0.0, grasp.q + 1e-3 * rng.normal(size=n))).pose
    f = rng.uniform([-0.3, -0.3, 1.0], [0.3, 0.3, 2.0], (count, 3))
    A = contacts.A.reshape(count, 4, n)[:, :3].reshape(3 * count, n)
    joints, a = rng.normal(0.0, [[0.0], [0.5], [5.0]], (3, n)), rng.normal(0.0, 5.0, n)
    joints[0] += grasp.q
    tau = grasp.hand.inverse_dynamics(joints[0], joints[1], a, PALM_UP) + A.T @ f.ravel() + 1e-3 * rng.normal(size=n)
    wrench = np.zeros((count, 6))
    wrench[:, :3] = np.einsum("ij,njk,nk->ni", contacts.R_HO, contacts.R_OC, f) + 0.02 * rng.normal(size=(count, 3))
    return contacts, joints, tau, a, wrench if has_tips else None


def assert_same(found, expected):
    """Assert that two forces agree, each field relative to its largest number."""
    for name in NAMES:
        ours, theirs = getattr(found, name), getattr(expected, name)
        assert (ours is None) == (theirs is None)
        if theirs is not None:
            rounding = ROUNDING if theirs.shape == expected.f.shape else COVARIANCE_ROUNDING
            np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=rounding * np.abs(theirs).max(), err_msg=name)
    assert found.measured_variance == expected.measured_variance


@pytest.mark.parametrize("has_tips", [False, True])
@pytest.mark.parametrize("errors", [ForceModelErrors(), ERRORS, ForceModelErrors(contact_place=1e-3)])
@pytest.mark.parametrize("name", ["allegro", "four_finger box", "dlr_hit2 sphere", "anthropomorphic15"])
def test_forces_equal_those_of_the_reference(name, errors, has_tips):
    """All contact models; the torsional moments of soft contacts add errors."""
    grasp, sensors = grasp_of(name), SensorModel(torque_noise=1e-3, tip_force_noise=0.02)
    both = [kind(grasp, sensors, PALM_UP, errors, 3.0) for kind in (CompiledForceEstimator, ContactForceEstimator)]
    rng = np.random.default_rng(1)
    for _ in range(5):
        inputs = random_inputs(grasp, rng, has_tips)
        found, expected = (estimator.step(ForceMemory(), *inputs)[0] for estimator in both)
        assert_same(found, expected)
        assert not found.f.flags.writeable


def test_a_given_free_torque_replaces_the_inverse_dynamics():
    grasp, sensors = grasp_of("allegro"), SensorModel(torque_noise=1e-3, tip_force_noise=0.02)
    contacts, joints, tau, a, wrench = random_inputs(grasp, np.random.default_rng(2), True)
    tau_u = grasp.hand.inverse_dynamics(joints[0], joints[1], a, PALM_UP)
    for kind in (CompiledForceEstimator, ContactForceEstimator):
        estimator = kind(grasp, sensors, PALM_UP)
        computed, _ = estimator.step(ForceMemory(), contacts, joints, tau, a, wrench)
        given, _ = estimator.step(ForceMemory(), contacts, joints, tau, None, wrench, tau_u)
        np.testing.assert_allclose(given.f, computed.f, rtol=0.0, atol=1e-12)


def test_gains_are_kept_between_steps_and_renewed_after_a_change_of_the_posture():
    grasp, sensors = grasp_of("allegro"), SensorModel(torque_noise=1e-3)
    estimator = make_force_estimator(grasp, sensors, PALM_UP, ForceModelErrors(), 0.0)
    contacts, joints, tau, a, _ = random_inputs(grasp, np.random.default_rng(3), False)
    _, memory = estimator.step(ForceMemory(), contacts, joints, tau, a)
    first = memory.gains
    for _ in range(8):
        _, memory = estimator.step(memory, contacts, joints, tau, a)
    assert memory.gains is first
    joints = joints + np.array([[0.02], [0.0], [0.0]])
    for _ in range(8):
        _, memory = estimator.step(memory, contacts, joints, tau, a)
    assert memory.gains is not first
