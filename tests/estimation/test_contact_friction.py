"""Friction coefficients: bounds that contain the truth, and no upper bound without a slip."""

from __future__ import annotations

import math

import numpy as np
import pytest

from graspforce.core.errors import InvalidInput
from graspforce.estimation.contact_forces import ContactForces
from graspforce.estimation.contact_friction import ContactFrictionEstimator, ContactFrictionSettings
from graspforce.estimation.slip.detector import SlipEstimate

PERIOD, NOISE = 1e-3, 0.02  # s and N
NO = np.zeros(2, bool)


def forces(f, rng=None, inertial=0.0, has_tips=True):
    noisy, covariance = np.array(f) if rng is None else f + NOISE * rng.normal(size=(2, 3)), NOISE**2 * np.eye(6)
    parts = noisy, covariance, np.zeros((6, 6)), np.full((2, 3), inertial)
    if not has_tips:
        return ContactForces(*parts, None, np.zeros((2, 3, 3)))
    fused = parts[0] + 0.3  # N: fused with torques, which accelerations and pushes disturb
    return ContactForces(fused, *parts[1:], np.zeros((2, 3)), np.zeros((2, 3, 3)), noisy, (NOISE**2, 0.0))


def slip(slipping=NO, alarms=NO, is_certain=True, distance=0.0, force_alert=False):
    distances = np.array([[0.0, distance], [0.0, 0.0]])  # m; along the force of SLIDE
    return SlipEstimate(slipping, alarms, NO, NO, distances, np.zeros(0), 40.0, force_alert, bool(alarms.any()), is_certain)


def stuck(estimator, memory, f, steps, rng=None):
    for _ in range(steps):
        estimate, memory = estimator.step(memory, forces(f, rng), slip())
    return estimate, memory


def slipped(estimator, memory, f, rng=None, steps=30):
    """Slide for some steps at the forces f, with an alarm of the first finger after 10."""
    for k in range(steps):
        alarms = np.array([k == 10, False])
        estimate, memory = estimator.step(memory, forces(f, rng), slip(np.array([k >= 10, False]), alarms))
    return estimate, memory


STICK = np.array([[0.3, 0.4, 1.0], [0.0, 0.1, 2.0]])  # ratios 0.5 and 0.05
SLIDE = np.array([[0.0, 0.42, 1.0], [0.0, 0.1, 2.0]])  # 0.42


def test_without_slip_friction_is_unbounded_above():
    estimator = ContactFrictionEstimator(np.array([0.7, 0.7]), PERIOD)
    estimate, _ = stuck(estimator, estimator.initial_memory(), STICK, 200)
    assert np.isinf(estimate.upper).all()
    assert (estimate.lower <= [0.5, 0.05]).all()
    assert estimate.lower[0] > 0.4
    assert np.array_equal(estimate.expected, [0.7, 0.7])


def test_a_contact_that_sticks_above_the_given_coefficient_raises_it():
    estimator = ContactFrictionEstimator(np.array([0.4, 0.4]), PERIOD)
    estimate, _ = stuck(estimator, estimator.initial_memory(), STICK, 200)
    assert estimate.expected[0] == estimate.lower[0] > 0.4
    assert estimate.expected[1] == 0.4


@pytest.mark.parametrize("seed", range(20))
def test_a_slip_gives_the_coefficient_within_its_bounds(seed):
    rng = np.random.default_rng(seed)
    estimator = ContactFrictionEstimator(np.array([0.7, 0.7]), PERIOD)
    estimate, _ = slipped(estimator, estimator.initial_memory(), SLIDE, rng)
    assert abs(estimate.expected[0] - 0.42) < 0.15 * 0.42
    assert estimate.lower[0] < 0.42 < estimate.upper[0] or abs(estimate.expected[0] - 0.42) < 0.06  # 2 deviations: 95 %
    assert estimate.upper[0] - estimate.lower[0] < 0.2
    assert math.isinf(estimate.upper[1])  # the other finger did not slip
    assert estimate.expected[1] == 0.7


def test_bounds_have_the_stated_coverage():
    inside, draws = 0, 300
    for seed in range(draws):
        estimator = ContactFrictionEstimator(np.array([0.7, 0.7]), PERIOD, ContactFrictionSettings(ratio_error=0.0))
        estimate, _ = slipped(estimator, estimator.initial_memory(), SLIDE, np.random.default_rng(seed), 11)
        inside += estimate.lower[0] < 0.42 < estimate.upper[0]
    # 95.4 % for two deviations; the mean over 4 ms is not full after 10 ms, which costs a few per cent
    assert 0.89 < inside / draws <= 1.0


@pytest.mark.parametrize(("turn", "is_certain", "is_used"), [(0.6, True, True), (0.6, False, False), (0.1, False, True)])
def test_an_uncertain_finger_is_used_if_friction_points_straight_against_its_slip(turn, is_certain, is_used):
    estimator = ContactFrictionEstimator(np.array([0.7, 0.7]), PERIOD)
    f = SLIDE.copy()
    f[0, :2] = 0.42 * math.sin(turn), 0.42 * math.cos(turn)
    _, memory = stuck(estimator, estimator.initial_memory(), f, 10)
    alarms = np.array([True, False])
    estimate, _ = estimator.step(memory, forces(f), slip(alarms, alarms, is_certain=is_certain, distance=1e-3))
    assert np.isfinite(estimate.upper[0]) == is_used


def test_a_slip_after_a_long_slip_of_the_same_finger_shows_nothing():
    estimator, alarms = ContactFrictionEstimator(np.array([0.7, 0.7]), PERIOD), np.array([True, False])
    memory = estimator.initial_memory()
    for distance, is_used in ((1e-3, True), (3e-3, True), (1e-3, False)):  # m; 4 mm of 30 mm turn the normal by 0.13
        _, memory = stuck(estimator, memory._replace(information=(0.0, 0.0), slip_ratio=(0.0, 0.0)), SLIDE, 20)
        estimate, memory = estimator.step(memory, forces(SLIDE), slip(alarms, alarms, distance=distance))
        assert np.isfinite(estimate.upper[0]) == is_used


def width_after_a_slip(before, distance):
    """Return the width of the bounds after a slip at SLIDE; the ratio was another one until two periods before."""
    estimator, alarms = ContactFrictionEstimator(np.array([0.7, 0.7]), PERIOD), np.array([True, False])
    _, memory = stuck(estimator, estimator.initial_memory(), before, 20)
    _, memory = stuck(estimator, memory, SLIDE, 2)
    estimate, _ = estimator.step(memory, forces(SLIDE), slip(alarms, alarms, distance=distance))
    return estimate.upper[0] - estimate.lower[0]


def test_slip_until_it_is_found_widens_the_bounds():
    """By the standard deviation of a uniform part of it, over 30 mm."""
    least, wider = (width_after_a_slip(SLIDE, distance) for distance in (0.0, 3e-3))
    assert wider**2 - least**2 == pytest.approx((4.0 * 3e-3 / 0.03) ** 2 / 12.0)


def test_a_mean_ratio_that_lags_behind_the_present_one_widens_the_bounds():
    """A part of the window is from before a fall of the ratio by 0.1: more than the noise of 0.02."""
    other = SLIDE + np.array([[0.0, 0.1, 0.0], [0.0, 0.0, 0.0]])
    lag = 0.1 * math.exp(-3 * PERIOD / ContactFrictionSettings().window)  # of the mean ratio
    width, noise = width_after_a_slip(SLIDE, 0.0), NOISE * math.sqrt(1.0 + (0.42 + lag) ** 2)
    assert lag > noise
    assert width_after_a_slip(other, 0.0) == pytest.approx(math.sqrt(width**2 + 16.0 * (lag**2 - noise**2)), rel=1e-3)


def test_a_force_that_changes_within_the_window_shows_nothing():
    estimator = ContactFrictionEstimator(np.array([0.7, 0.7]), PERIOD)
    _, memory = stuck(estimator, estimator.initial_memory(), 0.5 * SLIDE + [[0, 0, 0.5], [0, 0, 0]], 10)
    alarms = np.array([True, False])
    estimate, _ = estimator.step(memory, forces(SLIDE), slip(alarms, alarms))
    assert np.isinf(estimate.upper).all()


@pytest.mark.parametrize(("distance", "other_normal", "is_used"), [(1e-3, 2.0, True), (-1e-3, 2.0, False), (1e-3, 0.05, False)])
def test_a_slip_is_used_if_friction_opposes_it_and_all_fingers_press(distance, other_normal, is_used):
    estimator = ContactFrictionEstimator(np.array([0.7, 0.7]), PERIOD)
    f, alarms = SLIDE * [[1.0, 1.0, 1.0], [0.0, 0.0, 0.5 * other_normal]], np.array([True, False])
    _, memory = stuck(estimator, estimator.initial_memory(), f, 10)
    estimate, _ = estimator.step(memory, forces(f), slip(alarms, alarms, distance=distance))
    assert np.isfinite(estimate.upper[0]) == is_used


@pytest.mark.parametrize(("steps", "share", "is_used"), [(0, 1.0, True), (10, 1.0, True), (10, 0.5, False), (80, 1.0, False)])
def test_a_slip_without_fingertip_sensors_is_used_if_it_goes_on(steps, share, is_used):
    estimator = ContactFrictionEstimator(np.array([0.7, 0.7]), PERIOD)
    alarms, first = np.array([True, False]), forces(SLIDE * [[1.0, share, 1.0]], has_tips=False)
    memory = estimator.initial_memory()
    for _ in range(20):
        _, memory = estimator.step(memory, first, slip())
    estimate, memory = estimator.step(memory, first, slip(alarms, alarms, distance=1e-3))
    assert np.isinf(estimate.upper).all()  # the slip may be over
    for _ in range(steps):
        _, memory = estimator.step(memory, forces(SLIDE, has_tips=False), slip(alarms))
    estimate, _ = estimator.step(memory, forces(SLIDE, has_tips=False), slip(alarms, alarms, distance=1e-3))
    assert np.isfinite(estimate.upper[0]) == is_used


def test_more_slips_narrow_the_bounds():
    estimator, rng = (
        ContactFrictionEstimator(np.array([0.7, 0.7]), PERIOD, ContactFrictionSettings(ratio_error=0.0)),
        np.random.default_rng(1),
    )
    memory, widths = estimator.initial_memory(), []
    for _ in range(3):
        estimate, memory = slipped(estimator, memory, SLIDE, rng)
        widths.append(estimate.upper[0] - estimate.lower[0])
        _, memory = stuck(estimator, memory, 0.5 * SLIDE + [[0, 0, 0.5], [0, 0, 0]], 50, rng)
    assert widths[0] > widths[1] > widths[2]


def test_a_change_of_the_surface_replaces_the_coefficient():
    estimator = ContactFrictionEstimator(np.array([0.7, 0.7]), PERIOD)
    _, memory = slipped(estimator, estimator.initial_memory(), SLIDE)
    estimate, memory = slipped(estimator, memory, SLIDE * [[1.0, 0.5, 1.0]])
    assert abs(estimate.expected[0] - 0.21) < 0.03
    estimate, _ = stuck(estimator, memory, STICK, 100)  # sticks at 0.5: μ has grown
    assert math.isinf(estimate.upper[0])
    assert estimate.expected[0] == 0.7


def test_sticking_is_forgotten():
    settings = ContactFrictionSettings(memory_time=0.1)
    estimator = ContactFrictionEstimator(np.array([0.7, 0.7]), PERIOD, settings)
    before, memory = stuck(estimator, estimator.initial_memory(), STICK, 100)
    after, _ = stuck(estimator, memory, 0.1 * STICK + [[0, 0, 1.0], [0, 0, 1.0]], 300)
    assert after.lower[0] < 0.2 * before.lower[0] + 0.05


def test_unexpected_accelerations_widen_the_bounds_of_forces_from_torques_only():
    def width(inertial, has_tips):
        estimator = ContactFrictionEstimator(np.array([0.7, 0.7]), PERIOD)
        memory = estimator.initial_memory()
        for k in range(22):
            alarms = np.array([k in (10, 20), False])
            measured = forces(SLIDE, inertial=inertial, has_tips=has_tips)
            estimate, memory = estimator.step(memory, measured, slip(alarms, alarms, distance=1e-4))
        return estimate.upper[0] - estimate.lower[0]

    assert 1.5 * width(0.0, False) < width(0.03, False) < 0.6 * 0.42  # N; four deviations of 15 % at most
    assert width(0.03, True) == width(0.0, True)
    assert width(0.1, False) == math.inf


def test_a_contact_without_force_shows_nothing():
    estimator = ContactFrictionEstimator(np.array([0.7, 0.7]), PERIOD)
    estimate, _ = slipped(estimator, estimator.initial_memory(), np.array([[0.02, 0.0, 0.01], [0.0, 0.0, 0.0]]))
    assert np.isinf(estimate.upper).all()
    assert (estimate.lower == 0.0).all()
    assert estimate.to_dict()["upper"] == [None, None]


def test_settings_survive_their_record():
    settings = ContactFrictionSettings(deviations=3.0)
    assert ContactFrictionSettings.from_dict(settings.to_dict()) == settings
    with pytest.raises(InvalidInput, match=r"contact_friction\.window"):
        ContactFrictionSettings.from_dict({"window": 0.0})
