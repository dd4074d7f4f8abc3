"""Time profiles of the hand's base: closed forms, continuity, records."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from graspforce.control.phases.cycle_plan import CyclePlan, base_motion, place_profile
from graspforce.control.phases.motion_profile import CarryProfiles, MotionProfile
from graspforce.core.errors import InvalidInput
from graspforce.geometry.minimum_jerk import minimum_jerk
from tests.control.phases.test_cycle_plan import plan

RAMP = ([0.0, 0.4, 1.0], [0.0, 0.3, 1.0], [0.0, 1.2, 0.0], [0.0, 0.5, 0.0])


@pytest.mark.parametrize("t", [0.0, 0.1, 0.25, 0.4, 0.5, 0.7])
def test_profile_of_least_jerk_is_the_quintic(t):
    np.testing.assert_allclose(MotionProfile.least_jerk(0.5)(t), minimum_jerk(t, 0.5), atol=1e-12)


def test_rates_are_derivatives_of_the_share():
    profile, step = MotionProfile(*RAMP), 1e-5
    for t in (0.1, 0.39, 0.41, 0.8):
        before, now, after = profile(t - step), profile(t), profile(t + step)
        assert (after[0] - before[0]) / (2.0 * step) == pytest.approx(now[1], abs=1e-6)
        assert (after[1] - before[1]) / (2.0 * step) == pytest.approx(now[2], abs=1e-6)


def test_stretched_profile_passes_the_same_shares_later():
    profile = MotionProfile(*RAMP)
    s, rate, acceleration = profile(0.3)
    np.testing.assert_allclose(profile.stretched(2.0)(0.6), (s, rate / 2.0, acceleration / 4.0))


def test_base_moves_along_its_displacement():
    profile, start, displacement = MotionProfile(*RAMP), np.array([0.0, 0.0, 0.1]), np.array([0.03, 0.04, 0.0])
    for t in (0.2, 0.6):
        s, rate, acceleration = profile(t)
        base = base_motion(start, displacement, profile, t)
        np.testing.assert_allclose(base.p, start + s * displacement)
        np.testing.assert_allclose(base.v, rate * displacement)
        np.testing.assert_allclose(base.a, acceleration * displacement)


def test_plan_with_profiles_survives_json():
    profiles = CarryProfiles(MotionProfile(*RAMP), MotionProfile.least_jerk(0.4), MotionProfile.least_jerk(0.3))
    sent = replace(plan(), profiles=profiles)
    again = CyclePlan.from_dict(json.loads(json.dumps(sent.to_dict())), sent.grasp.hand)
    assert again.to_dict() == sent.to_dict()
    assert again.carry_profiles.place.duration == 0.3


@pytest.mark.parametrize("distance", [0.0, 0.005, 0.02, 0.021, 0.05, 0.3])
def test_way_to_the_table_ends_slowly_and_never_goes_back(distance):
    """The last 10 mm of a lift have at most 30 mm/s, which a quintic polynomial from that speed to rest never exceeds.

    A short way has a peak of 15/8 of its mean speed.
    """
    profile = place_profile(distance)
    s, rate, _ = profile.sample(np.linspace(0.0, profile.duration, 2001))
    assert (rate >= -1e-9).all()
    near = distance * (1.0 - s) <= 0.01
    largest = 0.03 if distance > 0.02 else 0.03 * 15.0 / 16.0
    assert distance * rate[near].max() <= largest * (1.0 + 1e-6)
    assert profile.duration >= 0.3  # s


def test_plan_without_profiles_moves_with_least_jerk():
    profiles = plan().carry_profiles
    assert profiles.lift.duration == pytest.approx(0.5)  # 50 mm with 0.1 m/s
    assert profiles.place.duration == pytest.approx(0.4 + 2.0 / 3.0)  # 40 mm with 0.1 m/s, 10 mm with 15 mm/s in the mean
    assert profiles.move.duration == pytest.approx(0.3)  # no displacement


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"times": [0.0, 1.0, 0.5]}, "plan.profiles.lift.times"),
        ({"share": [0.0, 0.3, 0.9]}, "plan.profiles.lift.share"),
        ({"rate": [0.1, 1.2, 0.0]}, "plan.profiles.lift.rate"),
        ({"acceleration": [0.0]}, "plan.profiles.lift.acceleration"),
        ({"speed": 1.0}, "plan.profiles.lift.speed"),
    ],
)
def test_invalid_profiles_are_named(change, field):
    profile = MotionProfile(*RAMP)
    record = replace(plan(), profiles=CarryProfiles(profile, profile, profile)).to_dict()
    record["profiles"]["lift"] |= change
    with pytest.raises(InvalidInput) as caught:
        CyclePlan.from_dict(record, plan().grasp.hand)
    assert caught.value.field == field
