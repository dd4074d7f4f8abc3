"""The controller of a cycle: measurements, stops and plans that it refuses or accepts."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

from graspforce.control.joints.joint_trajectory import JointTrajectory
from graspforce.control.phases.cycle_plan import CyclePlan
from graspforce.control.phases.motion_profile import CarryProfiles, MotionProfile
from graspforce.control.phases.phase_controller import PhaseController
from graspforce.control.phases.phase_rules import PHASE_RULES
from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.control.phases.phase_times import check_times, opening_time, planned_times
from graspforce.core.errors import InvalidInput
from graspforce.estimation.measurement import Measurement
from graspforce.hand.hand import Hand
from graspforce.simulation.cycle.plan_cycle import CycleMotion, plan_cycle
from tests.support.table_scenes import ball_scene

SETTINGS = PhaseSettings(close_speed=0.05)


@functools.cache
def plan() -> CyclePlan:
    return plan_cycle(ball_scene(), SETTINGS, CycleMotion(optimised=False))


@pytest.mark.parametrize(
    ("measurement", "field"),
    [
        (Measurement(0.0, np.zeros(15)), "measurement.q"),
        (Measurement(0.0, np.zeros(17)), "measurement.q"),
        (Measurement(0.0, np.zeros(16), tip_wrench=np.zeros((4, 6))), "measurement.tip_wrench"),
        (Measurement(0.0, np.zeros(16), tip_wrench=np.zeros((1, 6))), "measurement.tip_wrench"),
    ],
)
def test_measurements_of_another_hand_or_grasp_are_refused(measurement, field):
    controller = PhaseController(plan(), SETTINGS)
    with pytest.raises(InvalidInput) as caught:
        controller.step(measurement)
    assert caught.value.field == field
    assert controller.step(Measurement(0.0, plan().q_start, tip_wrench=np.zeros((3, 6)))).phase == "approach"


@pytest.mark.parametrize(("reason", "message"), [("", "stopped by the caller"), ("the arm is blocked", "the arm is blocked")])
def test_stop_stops_with_a_reason(reason, message):
    controller = PhaseController(plan(), SETTINGS)
    controller.step(Measurement(0.0, plan().q_start))
    controller.stop(reason)
    command = controller.step(Measurement(1e-3, plan().q_start))
    assert (controller.phase, command.message) == ("stopped", f"approach: {message}")
    assert controller.records[-1].reason == message


def changed(change: str, seconds: float) -> tuple[CyclePlan, PhaseSettings]:
    """Return a plan and settings with one time in them, s."""
    made, profiles, profile = plan(), plan().carry_profiles, MotionProfile.least_jerk(seconds)
    slow = JointTrajectory.between(made.q_start, made.q_pregrasp, seconds)
    if change == "approach":
        return replace(made, approach=slow), SETTINGS
    if change in CarryProfiles._fields:
        return replace(made, profiles=profiles._replace(**{change: profile})), SETTINGS
    return made, replace(SETTINGS, **{change: seconds})


@pytest.mark.parametrize(
    ("change", "phase", "seconds", "field"),
    [
        ("approach", "approach", 12.0, "plan.approach"),
        ("approach", "retract", 9.7, "plan.approach"),  # and 0.3 s to the pre-grasp posture
        ("squeeze_time", "squeeze", 2.8, "phases.squeeze_time"),
        ("transfer_time", "squeeze", 2.8, "phases.squeeze_time"),
        ("lift", "lift", 10.5, "plan.profiles.lift"),
        ("move", "move", 30.5, "plan.profiles.move"),
        ("place", "place", 9.7, "plan.profiles.place"),  # and 0.4 s of the transfer
    ],
)
def test_phases_that_cannot_end_within_their_limit_are_refused(change, phase, seconds, field):
    with pytest.raises(InvalidInput) as caught:
        PhaseController(*changed(change, seconds))
    limit = PHASE_RULES[phase].time_limit
    time = planned_times(*changed(change, seconds))[phase][0]
    assert time > limit
    assert caught.value.field == field
    assert f"{phase} of {time:.3g} s" in str(caught.value)
    assert f"{limit:g} s" in str(caught.value)


@pytest.mark.parametrize(
    ("change", "seconds"),
    [("approach", 9.5), ("squeeze_time", 2.5), ("transfer_time", 2.5), ("lift", 9.8), ("move", 29.8), ("place", 9.4)],
)
def test_slow_phases_within_their_limit_are_accepted(change, seconds):
    PhaseController(*changed(change, seconds))


def test_slow_fingertips_are_refused():
    for change, phase in (({"close_speed": 1e-3}, "close"), ({"open_speed": 1e-3}, "release")):
        with pytest.raises(InvalidInput, match=phase):
            check_times(plan(), replace(SETTINGS, **change))


def test_sliding_joints_open_slowly():
    """Revolute joints with 1 rad/s, prismatic ones with 50 mm/s; 0.3 s at least."""
    turns, slides = Hand.load("allegro_right"), Hand.load("parallel_jaws")
    assert opening_time(turns, turns.neutral, turns.neutral + 0.8) == pytest.approx(0.8)
    assert opening_time(slides, slides.neutral, slides.neutral + 0.04) == pytest.approx(0.8)
    assert opening_time(slides, slides.neutral, slides.neutral + 0.001) == 0.3
