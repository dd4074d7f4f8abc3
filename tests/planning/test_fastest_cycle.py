"""Minimum-time pick and place: closed forms where the base limits, force problems where the hand limits."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

from graspforce import ContactSet, ForceProblem
from graspforce.contact.motion import BodyMotion
from graspforce.control import ControlSettings
from graspforce.control.joints.joint_trajectory import JointTrajectory
from graspforce.control.phases.cycle_plan import CyclePlan
from graspforce.core.errors import InvalidInput
from graspforce.force.solver import solve
from graspforce.planning import PlanFailure
from graspforce.planning.fastest_cycle import CycleLimits, fastest_cycle, fastest_profile
from tests.support.table_scenes import ball_scene

DISTANCE = 0.05  # m
FAST = CycleLimits(speed=20.0, acceleration=1e3, jerk=1e5, torque_reserve=0.0)  # the hand limits
RESERVE = 0.1  # of friction, of `ControlSettings`


def settings() -> ControlSettings:
    """Return settings with the scene's gravity."""
    return ControlSettings(gravity_H=ball_scene().gravity_H)


def profile_of(limits, displacement=None):
    """Return the profile of a lift by 50 mm."""
    scene = ball_scene()
    return fastest_profile(scene.grasp, -DISTANCE * scene.down if displacement is None else displacement, settings(), limits)


@functools.cache
def plan() -> CyclePlan:
    """Return a plan of the ball's cycle with a straight approach."""
    scene = ball_scene()
    q = scene.grasp.q
    start = np.maximum(q - 0.25, scene.grasp.hand.q_lower + 0.01)
    approach = JointTrajectory.between(start, q - 0.05, 0.8)
    return CyclePlan(scene.grasp, scene.gravity_H, q - 0.05, [0.02] * 3, approach, -DISTANCE * scene.down, [0.0, 0.03, 0.0])


def test_duration_is_the_closed_form_if_acceleration_and_jerk_limit():
    """T = a/j + √((a/j)² + 4 d/a). The grid of 60 intervals and the check between its knots add less than 1 %."""
    a, j = 3.0, 60.0
    T = a / j + np.sqrt((a / j) ** 2 + 4.0 * DISTANCE / a)
    assert T <= profile_of(CycleLimits(10.0, a, j)).duration < 1.01 * T


def test_duration_is_the_closed_form_if_speed_limits():
    """T = d/v + v/a + a/j."""
    v, a, j = 0.1, 3.0, 60.0
    T = DISTANCE / v + v / a + a / j
    assert T <= profile_of(CycleLimits(v, a, j)).duration < 1.01 * T


def margin_of_forces(acceleration: float) -> bool:
    """Return whether contact forces within 90 % of the friction accelerate the ball upwards, by an independent problem."""
    scene = ball_scene()
    grasp, gravity = scene.grasp, scene.gravity_H + acceleration * scene.down
    own = grasp.contacts
    contacts = ContactSet(own.p_OC, own.R_OC, own.models, (1.0 - RESERVE) * own.mu, own.gamma, own.min_normal, own.max_normal)
    actuation = grasp.hand.actuation(grasp.q, grasp.fingers, contacts, grasp.p_HO, grasp.R_HO, gravity_H=gravity)
    return solve(ForceProblem(contacts, grasp.body.wrench(BodyMotion(grasp.p_HO, grasp.R_HO), gravity), actuation)).found


def test_forces_limit_the_motion_if_the_base_does_not():
    """At the largest acceleration forces exist, at twice as much they do not."""
    profile = profile_of(FAST)
    largest, least = DISTANCE * profile.acceleration.max(), DISTANCE * profile.acceleration.min()  # m/s²
    assert largest > 3.0
    assert margin_of_forces(largest)
    assert margin_of_forces(least)
    assert not margin_of_forces(2.0 * largest)


def test_reserves_make_the_motion_slower():
    fastest = profile_of(FAST).duration
    assert profile_of(replace(FAST, torque_reserve=0.4)).duration > 1.05 * fastest


def test_no_displacement_takes_no_time():
    assert profile_of(CycleLimits(), np.zeros(3)).duration <= 0.01


def test_fastest_cycle_keeps_paths_and_limits():
    before, limits = plan(), CycleLimits()
    after = fastest_cycle(before, settings(), limits)
    np.testing.assert_allclose(after.approach.q[[0, -1]], before.approach.q)
    assert after.approach.duration < 0.5 * before.approach.duration
    for fast, fixed in zip(after.carry_profiles, before.carry_profiles, strict=True):
        assert fast.duration < fixed.duration
    hand = before.grasp.hand
    assert (np.abs(after.approach.v) <= 1.001 * hand.velocity_limit).all()
    jerk = np.diff(after.approach.a, axis=0) / np.diff(after.approach.t)[:, None]
    assert np.abs(jerk).max() <= 1.01 * limits.joint_jerk
    again = CyclePlan.from_dict(after.to_dict(), hand)
    assert again.to_dict() == after.to_dict()


def test_object_too_heavy_is_refused_with_a_reason():
    scene = ball_scene()
    heavy = replace(scene.grasp, body=replace(scene.grasp.body, mass=5.0))
    failure = fastest_profile(heavy, -DISTANCE * scene.down, settings(), CycleLimits())
    assert isinstance(failure, PlanFailure)
    assert "cannot be held still" in failure.reason


@pytest.mark.parametrize("field", ["speed", "acceleration", "jerk", "joint_jerk", "torque_reserve"])
def test_limits_are_checked(field):
    with pytest.raises(InvalidInput, match=field):
        CycleLimits(**{field: -1.0})
