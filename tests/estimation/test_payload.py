"""The payload: mass, centre of mass and external wrench from contact wrenches by Newton–Euler, an independent form of it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graspforce.contact.motion import BodyMotion
from graspforce.core.errors import InvalidInput
from graspforce.estimation.payload import PayloadEstimator, PayloadInputs, PayloadSettings
from graspforce.geometry import Box
from graspforce.geometry.rotations import rotation_exp
from graspforce.grasp.body import Body

PERIOD, GRAVITY = 1e-3, np.array([0.0, 0.0, -9.81])  # s and m/s²
NOISE = np.diag([0.02**2] * 3 + [6e-4**2] * 3)  # N² and (N·m)²
BODY = Body.solid(Box((0.05, 0.05, 0.05)), 0.05)


def payload(mass_ratio, centre):
    """Return a body like the given one with another mass and centre of mass."""
    return Body(mass_ratio * BODY.mass, mass_ratio * BODY.inertia, centre, BODY.shape)


def rates_of(motion):
    return np.array([motion.acceleration[:3] - GRAVITY, motion.acceleration[3:], motion.twist[3:]]) @ motion.R_HO


def tilting(t):
    """Return a motion that turns the object by up to half a radian."""
    turn, omega = np.array([0.5, -0.4, 0.1]), 2.0 * np.pi
    share, rate, change = 0.5 - 0.5 * np.cos(omega * t), 0.5 * omega * np.sin(omega * t), 0.5 * omega**2 * np.cos(omega * t)
    twist = np.concatenate([0.01 * rate * np.ones(3), rate * turn])
    return BodyMotion(
        np.zeros(3), rotation_exp(share * turn), twist, np.concatenate([0.01 * change * np.ones(3), change * turn])
    )


def still(t):
    return BodyMotion(np.zeros(3), np.eye(3))


def run(body, motion, duration, *, noise=None, external=None, settings=None, bias=None):
    """Return the payload estimates of a motion with perfect or noisy contact wrenches."""
    estimator = PayloadEstimator(BODY, PERIOD, settings)
    memory, rng, estimates = estimator.initial_memory(), np.random.default_rng(0 if noise is None else noise), []
    zero = np.zeros((6, 6))
    for k in range(round(duration / PERIOD)):
        t = k * PERIOD
        at = motion(t)
        w = np.array(body.wrench(at, GRAVITY))
        if external is not None:
            w -= external(t)
        if noise is not None:
            w += np.sqrt(NOISE.diagonal()) * rng.normal(size=6)
        estimate, memory = estimator.step(memory, PayloadInputs(w, (NOISE, zero if bias is None else bias), rates_of(at)))
        estimates.append(estimate)
    return estimates


@settings(max_examples=15, deadline=None)
@given(st.floats(0.5, 2.0), st.lists(st.floats(-0.01, 0.01), min_size=3, max_size=3))
def test_exact_wrenches_of_a_turning_body_give_mass_and_centre(mass_ratio, centre):
    true = payload(mass_ratio, centre)
    # a weak prior, so that the data decide
    weak = PayloadSettings(mass_ratio=100.0, centre_error=10.0, external_force=1e-4, attitude_error=1e-6)
    estimate = run(true, tilting, 0.4, settings=weak)[-1]
    # the inertia about O is that of the given body: m c² less than it should be, at most a quarter of the box's
    assert abs(estimate.mass / true.mass - 1.0) < 2e-3
    assert np.abs(estimate.p_OM - true.p_OM).max() < 4.3 * np.dot(centre, centre) + 1e-5  # m; 1.3 mm at the corners


@pytest.mark.parametrize(("mass_ratio", "centre"), [(0.5, [0, 0, 0]), (2.0, [0, 0.01, 0]), (1.0, [0.006, -0.006, 0.005])])
def test_mass_and_level_centre_are_found_within_a_second_at_rest(mass_ratio, centre):
    true = payload(mass_ratio, centre)
    estimate = run(true, still, 1.0, noise=1)[-1]
    assert abs(estimate.mass / true.mass - 1.0) < 0.03
    assert np.abs(estimate.p_OM[:2] - centre[:2]).max() < 1e-3
    deviation = np.sqrt(estimate.centre_covariance.diagonal())
    assert deviation[2] > 0.9 * 0.02 / mass_ratio  # along gravity only the prior is known
    assert deviation[:2].max() < 2e-3


def test_turning_shows_the_centre_along_gravity():
    centre = [0.004, -0.006, 0.01]
    estimate = run(payload(1.5, centre), tilting, 1.0, noise=2)[-1]
    assert np.abs(estimate.p_OM - centre).max() < 1.5e-3
    assert np.sqrt(estimate.centre_covariance.diagonal()).max() < 3e-3


def test_errors_are_as_large_as_their_covariance():
    quiet, values, draws = PayloadSettings(external_force=1e-6), [], 40
    for seed in range(draws):
        estimate = run(payload(1.3, [0.003, 0.002, 0.0]), still, 0.4, noise=seed, settings=quiet)[-1]
        true = 1.3 * BODY.mass * np.array([1.0, 0.003, 0.002])
        error = np.append(estimate.mass, estimate.mass * estimate.p_OM[:2]) - true
        values.append(error @ np.linalg.solve(estimate.covariance[:3, :3], error))
    assert abs(np.mean(values) / 3.0 - 1.0) < 4.0 * np.sqrt(2.0 / (3.0 * draws))  # χ² with 3 degrees of freedom


def test_a_constant_error_of_the_wrench_stays_within_the_bounds():
    rng, bias, values = np.random.default_rng(3), np.diag([0.05**2] * 3 + [1e-3**2] * 3), []
    for seed in range(40):
        error = np.sqrt(bias.diagonal()) * rng.normal(size=6)
        estimate = run(payload(1.0, [0, 0, 0]), still, 0.2, noise=seed, external=lambda t, e=error: e, bias=bias)[-1]
        values.append((estimate.mass - BODY.mass) / estimate.mass_deviation)
    assert 0.6 < np.sqrt(np.mean(np.square(values))) < 1.3
    assert estimate.mass_deviation > 0.9 * 0.05 / 9.81  # kg: no average reduces it


def test_a_push_is_external_and_leaves_the_mass():
    push = np.array([0.3, 0.0, -0.3, 0.0, 0.0, 0.0])

    def external(t):
        return push if 0.5 <= t < 0.7 else np.zeros(6)

    estimates = run(payload(1.0, [0, 0, 0]), still, 1.0, noise=4, external=external)
    during = estimates[690]
    assert during.is_disturbed
    assert np.abs(during.external - push).max() < 0.05  # N
    assert abs(during.mass / BODY.mass - 1.0) < 0.03
    assert not estimates[480].is_disturbed
    assert np.abs(estimates[480].external).max() < 4.0 * np.sqrt(estimates[480].external_covariance.diagonal().max())
    assert not estimates[-1].is_disturbed
    assert abs(estimates[-1].mass / BODY.mass - 1.0) < 0.03


def test_a_load_that_stays_becomes_payload():
    heavy = np.array([0.0, 0.0, -0.05 * 9.81, 0.0, 0.0, 0.0])  # another 50 g

    def external(t):
        return heavy if t >= 0.3 else np.zeros(6)

    quick = PayloadSettings(adaption_time=0.3)
    estimates = run(payload(1.0, [0, 0, 0]), still, 1.2, noise=5, external=external, settings=quick)
    assert estimates[500].is_disturbed
    assert abs(estimates[500].mass / BODY.mass - 1.0) < 0.03
    assert not estimates[-1].is_disturbed
    assert abs(estimates[-1].mass / (2.0 * BODY.mass) - 1.0) < 0.03


def test_errors_of_the_orientation_do_not_show_the_centre_along_gravity():
    rng, estimator = np.random.default_rng(6), PayloadEstimator(BODY, PERIOD)
    true, memory = payload(2.0, [0.0, 0.005, 0.01]), estimator.initial_memory()
    w, rates = true.wrench(still(0.0), GRAVITY), rates_of(still(0.0))
    for _ in range(800):
        R = rotation_exp(0.01 * rng.normal(size=3))  # orientation error: wrench and gravity turn alike
        inputs = PayloadInputs((w.reshape(2, 3) @ R).ravel(), (NOISE, np.zeros((6, 6))), rates @ R)
        estimate, memory = estimator.step(memory, inputs)
    deviation = np.sqrt(estimate.centre_covariance[2, 2])
    assert deviation > 0.008  # m: the prior of 20 mm at half the mass
    assert abs(estimate.p_OM[2] - 0.01) < 2.0 * deviation
    assert abs(estimate.p_OM[1] - 0.005) < 1e-3


def test_no_measurement_leaves_the_given_body():
    estimator = PayloadEstimator(BODY, PERIOD)
    estimate = estimator.initial_memory().estimate
    assert estimate.mass == BODY.mass
    assert np.isinf(estimate.external_covariance.diagonal()).all()
    record = estimate.to_dict()
    assert record["centre_of_mass"] == [0.0, 0.0, 0.0]
    assert "p_OM" not in record


def test_settings_survive_their_record():
    longer = PayloadSettings(memory_time=2.0)
    assert PayloadSettings.from_dict(longer.to_dict()) == longer
    with pytest.raises(InvalidInput, match=r"payload\.memory_time"):
        PayloadSettings.from_dict({"memory_time": 0.0})
    with pytest.raises(InvalidInput, match=r"payload\.false_alarm"):
        PayloadSettings.from_dict({"false_alarm": 1.0})
