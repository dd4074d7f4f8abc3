"""The friction observer finds constant levels and keeps still at rest; the hold stops the integral at rest."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspforce.control.friction.disturbance_observer import FrictionObserver, ObserverTimes, RestMemory, hold_integral
from graspforce.core.errors import InvalidInput

N, DT = 3, 1e-3  # joints; s
BOUND = np.full(N, 0.3)  # N·m
SHARE = np.array([1.2, 1.0, 0.8])

torques = st.floats(-1.0, 1.0)  # N·m


def make_observer(**times: float) -> FrictionObserver:
    return FrictionObserver(SHARE, BOUND, ObserverTimes(**times), DT)


def track(true: np.ndarray, direction, steps: int) -> np.ndarray:
    """Return the levels after motions whose feedback makes up for the missing friction torque: u = φ (c_true − c)."""
    observer, level = make_observer(), np.zeros(N)
    for k in range(steps):
        phi = direction(k * DT)
        level = observer.step(level, phi, phi * (true - level))
    return level


def test_levels_in_the_expected_shares_are_found() -> None:
    """A common friction decays with a rate of at least 1/0.3 s, so 3 s leave at most e^(−10)."""
    true = 0.1 * SHARE
    level = track(true, lambda t: np.full(N, np.sign(np.sin(6.0 * t))), 3000)
    np.testing.assert_allclose(level, true, rtol=5e-5)


def test_levels_of_single_joints_approach_the_truth() -> None:
    """Forgetting T_f = 0.5 s against T_joint = 0.3 s keeps at least T_f/(T_f + T_joint) of a joint's difference."""
    true = np.array([0.06, 0.1, 0.14])
    level = track(true, lambda t: np.ones(N), 5000)
    mean = (level @ SHARE) / (SHARE @ SHARE)
    difference, expected = level - SHARE * mean, true - SHARE * (true @ SHARE) / (SHARE @ SHARE)
    np.testing.assert_allclose(difference, expected * 0.5 / (0.5 + 0.3), rtol=0.02)  # the common term adds 1 %
    assert np.abs(level - true).max() < np.abs(true - 0.1 * SHARE).max()


@given(st.lists(torques, min_size=N, max_size=N), st.lists(st.floats(-1.0, 1.0), min_size=N, max_size=N))
def test_common_level_has_its_own_time_for_feedback_across_the_plan(u: list[float], phi: list[float]) -> None:
    level, direction, across = np.array([0.1, 0.05, 0.2]), np.array(phi), np.array(u)
    expected = make_observer(common=0.4).step(level, direction, across)
    computed = make_observer(across=0.4).step(level, direction, across, np.zeros(N))
    np.testing.assert_allclose(computed, expected, rtol=0, atol=1e-15)
    along = make_observer().step(level, direction, across, across)
    np.testing.assert_array_equal(along, make_observer().step(level, direction, across))


@given(st.lists(torques, min_size=N, max_size=N))
def test_levels_stay_constant_at_rest(u: list[float]) -> None:
    level = np.array([0.1, 0.0, 0.2])
    np.testing.assert_array_equal(make_observer().step(level, np.zeros(N), np.array(u)), level)


@given(st.lists(torques, min_size=N, max_size=N), st.lists(st.floats(-1.0, 1.0), min_size=N, max_size=N))
def test_levels_do_not_depend_on_the_sign_of_the_motion(u: list[float], phi: list[float]) -> None:
    level, u_array, direction = np.array([0.1, 0.05, 0.2]), np.array(u), np.array(phi)
    forward, back = (make_observer().step(level, sign * direction, sign * u_array) for sign in (1.0, -1.0))
    np.testing.assert_array_equal(forward, back)


@given(st.lists(st.floats(-1e6, 1e6), min_size=N, max_size=N))
def test_levels_stay_within_their_bounds(u: list[float]) -> None:
    level = make_observer().step(np.full(N, 0.1), np.ones(N), np.array(u))
    assert (level >= 0.0).all()
    assert (level <= BOUND).all()


@pytest.mark.parametrize("name", ["common", "joint", "forgetting"])
def test_times_out_of_range_are_named(name: str) -> None:
    with pytest.raises(InvalidInput, match=name):
        ObserverTimes(**{name: 0.0})


# ── hold of the integral ───────────────────────────────────────────────────────────────────────────────────────────────────

TOLERANCE = np.array([5e-5] * 3 + [5e-4] * 3)  # m and rad


def at(x: float) -> np.ndarray:
    """Return the same error x in all components, in units of the tolerance."""
    return x * TOLERANCE


def test_integral_grows_until_the_error_is_within_the_tolerance() -> None:
    memory, integral = None, np.zeros(6)
    for x, grows in ((3.0, True), (2.0, True), (0.9, False), (0.5, False), (-0.05, False)):
        last, (integral, memory) = integral, hold_integral(memory, at(x), integral, integral + at(x), TOLERANCE, 1000)
        np.testing.assert_array_equal(integral, last + at(x) if grows else last)


def test_integral_is_held_after_one_jump_over_the_goal() -> None:
    """A jump of twice the error would make an integral swing to the other side and back."""
    integral, memory = hold_integral(None, at(3.0), np.zeros(6), at(3.0), TOLERANCE, 1000)
    for _ in range(3):
        before, (integral, memory) = integral, hold_integral(memory, at(-3.0), integral, integral + at(-3.0), TOLERANCE, 1000)
        np.testing.assert_array_equal(integral, before)
    assert memory.held.all()


def test_integral_is_held_after_the_allowed_time() -> None:
    integral, memory = hold_integral(None, at(3.0), np.zeros(6), at(3.0), TOLERANCE, 5)
    for k in range(1, 8):
        before, (integral, memory) = integral, hold_integral(memory, at(3.0), integral, integral + at(3.0), TOLERANCE, 5)
        assert (integral != before).all() == (k < 5)


def test_push_releases_the_integral() -> None:
    integral, memory = hold_integral(None, at(0.5), np.zeros(6), at(0.5), TOLERANCE, 1000)
    assert memory.held.all()
    integral, memory = hold_integral(memory, at(4.0), integral, integral + at(4.0), TOLERANCE, 1000)
    np.testing.assert_array_equal(integral, at(4.0))
    assert not memory.held.any()


def test_integral_of_a_load_does_not_count_as_a_jump() -> None:
    """An integral that carries a load before the rest may have the other sign than the error."""
    load = -at(100.0)
    integral, memory = hold_integral(None, at(3.0), load, load + at(3.0), TOLERANCE, 1000)
    np.testing.assert_array_equal(integral, load + at(3.0))
    assert not memory.held.any()


def test_components_are_held_separately() -> None:
    error = np.array([3.0, 0.5, 3.0, 0.5, 3.0, 0.5]) * TOLERANCE
    integral, memory = hold_integral(None, error, np.zeros(6), error, TOLERANCE, 1000)
    np.testing.assert_array_equal(memory.held, [0.0, 1.0] * 3)
    np.testing.assert_array_equal(integral, np.where(memory.held > 0.0, 0.0, error))


def test_state_of_the_hold_is_read_as_written() -> None:
    _, memory = hold_integral(None, at(0.5), at(2.0), at(3.0), TOLERANCE, 1000)
    again = RestMemory.from_dict(json.loads(json.dumps(memory.to_dict())))
    assert again.to_dict() == memory.to_dict()
