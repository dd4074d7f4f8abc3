"""The watchdog's law: hold, ramp, floor, brake, and bounded torque steps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspforce.core.errors import InvalidInput
from graspforce.service.client.watchdog import CommandMonitor, Watchdog

TAU = np.array([0.31, -0.12, 0.07])  # N·m
Q, V = np.array([0.4, -0.2, 1.1]), np.array([0.3, -0.8, 0.05])  # rad, rad/s
REST = np.zeros(3)
DOG = Watchdog(hold=0.25, ramp=0.5, floor=0.2, stiffness=0.0, damping=0.0, step=0.004)
PERIOD, VALIDITY = 1e-3, 5e-3  # s

sizes = st.floats(0.0, 10.0)
torques = st.lists(st.floats(-5.0, 5.0), min_size=3, max_size=3).map(np.array)


def test_scale_is_one_then_linear_then_the_floor():
    ages = [0.0, 0.25, 0.35, 0.5, 0.75, 1e9]
    assert [DOG.scale(age) for age in ages] == pytest.approx([1.0, 1.0, 1.0 - 0.8 * 0.2, 0.6, 0.2, 0.2], rel=1e-12)


@given(hold=sizes, ramp=sizes, floor=st.floats(0.0, 1.0), ages=st.lists(st.floats(0.0, 30.0), min_size=2, max_size=2))
def test_scale_never_rises_and_stays_between_floor_and_one(hold, ramp, floor, ages):
    dog = Watchdog(hold=hold, ramp=ramp, floor=floor)
    early, late = sorted(ages)
    rounding = 1e-12  # of the ramp
    assert 1.0 >= dog.scale(early) >= dog.scale(late) - rounding
    assert dog.scale(late) >= floor - rounding


def test_brake_pulls_to_the_posture_of_the_loss():
    dog = Watchdog(hold=1.0, stiffness=0.8, damping=0.02)
    moved = Q + np.array([0.01, -0.02, 0.0])  # rad
    np.testing.assert_allclose(dog.torque(0.5, TAU, Q, moved, V) - TAU, -0.8 * (moved - Q) - 0.02 * V, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(dog.torque(0.5, TAU, Q, Q, REST), TAU)


@given(before=torques, target=torques, step=st.floats(1e-3, 1.0))
def test_rate_limit_is_bounded_straight_and_reaches_the_target(before, target, step):
    dog = Watchdog(step=step)
    tau = dog.rate_limit(before, target)
    way, gone = target - before, tau - before
    rounding = 1e-12 * (1.0 + np.abs(way).max())
    assert np.abs(gone).max() <= step + rounding
    scale = step / np.abs(way).max() if np.abs(way).max() > step else 1.0
    np.testing.assert_allclose(gone, scale * way, atol=rounding)
    if np.abs(way).max() <= step:
        assert tau is target


def test_commands_in_time_pass_unchanged():
    monitor = CommandMonitor(DOG, VALIDITY)
    assert monitor.torque(0.0, Q, V) is None
    for i, tau in enumerate((TAU, -3.0 * TAU, 5.0 * TAU)):
        sent_time = i * PERIOD
        assert monitor.accept(tau, sent_time, sent_time + 3e-4)
        output = monitor.torque(sent_time + 4e-4, Q, V)
        assert output.tau is tau
        assert (output.late, output.resuming) == (False, False)
        assert output.age == pytest.approx(4e-4)


def test_torque_holds_ramps_and_resumes_by_bounded_steps():
    monitor = CommandMonitor(DOG, VALIDITY)
    monitor.accept(TAU, 0.0, 0.0)
    torques_out, lates, resuming = [], [], []
    back = 1.0  # s, when commands with another torque arrive
    for now in np.arange(0.0, 1.2, PERIOD):
        if now >= back:
            assert monitor.accept(-TAU, now, now)
        output = monitor.torque(float(now), Q, REST)
        torques_out.append(output.tau)
        lates.append(output.late)
        resuming.append(output.resuming)
    taus, times = np.array(torques_out), np.arange(0.0, 1.2, PERIOD)
    away = times < back
    np.testing.assert_allclose(taus[away], np.outer([DOG.scale(t) for t in times[away]], TAU), atol=1e-12)
    np.testing.assert_array_equal(np.array(lates), away & (times > VALIDITY))
    assert np.abs(np.diff(taus, axis=0)).max() <= DOG.step * (1.0 + 1e-9)  # rounding
    # from 0.2 tau to −tau; the joint with 0.31 N·m needs 1.2 · 0.31/0.004 = 93 steps
    assert sum(resuming) == 92
    np.testing.assert_array_equal(taus[-1], -TAU)
    assert monitor.accept(TAU, 1.2, 1.2)
    assert monitor.torque(1.2, Q, REST).tau is TAU  # reached: from here commands pass unchanged


def test_brake_starts_by_bounded_steps():
    monitor = CommandMonitor(Watchdog(hold=1.0, damping=0.5, step=0.003), VALIDITY)
    monitor.accept(TAU, 0.0, 0.0)
    before = monitor.torque(VALIDITY, Q, V).tau
    after = monitor.torque(VALIDITY + PERIOD, Q, V).tau
    assert np.abs(after - before).max() == pytest.approx(0.003)


def test_watchdog_torque_stays_within_motor_limits():
    """The torque of a joint that was pushed away is clipped to its motor's limit; the other joints keep theirs."""
    lower, upper = np.array([-0.5, -0.2, -0.1]), np.array([0.5, 0.2, 0.1])  # N·m
    monitor = CommandMonitor(Watchdog(hold=1.0, stiffness=2.0, damping=0.0, step=0.05), VALIDITY, lower, upper)
    monitor.accept(TAU, 0.0, 0.0)
    away = Q + np.array([0.0, 0.3, -0.01])  # rad
    monitor.torque(VALIDITY + PERIOD, Q, REST)
    for k in range(20):
        output = monitor.torque(VALIDITY + (2 + k) * PERIOD, away, REST)
        assert (output.tau >= lower).all()
        assert (output.tau <= upper).all()
    # −0.12 − 2 · 0.3 is below its limit; 0.07 + 2 · 0.01 is within its limit
    np.testing.assert_allclose(output.tau, [0.31, -0.2, 0.09], atol=1e-15)


def test_late_and_old_commands_are_rejected():
    monitor = CommandMonitor(DOG, VALIDITY)
    assert not monitor.accept(TAU, 0.0, 1.01 * VALIDITY)
    assert monitor.torque(0.0, Q, V) is None
    assert monitor.accept(TAU, 0.010, 0.011)
    assert not monitor.accept(-TAU, 0.009, 0.011)  # its state is older
    assert monitor.torque(0.012, Q, V).tau is TAU


@pytest.mark.parametrize(
    ("change", "allowed"),
    [
        ({"hold": -1.0}, "at least 0"),
        ({"ramp": float("inf")}, "finite"),
        ({"floor": 1.1}, "at most 1"),
        ({"stiffness": -0.1}, "at least 0"),
        ({"damping": float("nan")}, "finite"),
        ({"step": 0.0}, "greater than 0"),
    ],
)
def test_settings_are_validated(change, allowed):
    with pytest.raises(InvalidInput, match=allowed) as caught:
        Watchdog(**change)
    assert caught.value.field in change


def test_validity_is_validated():
    with pytest.raises(InvalidInput, match="validity"):
        CommandMonitor(DOG, 0.0)
