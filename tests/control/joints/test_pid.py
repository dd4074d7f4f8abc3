"""The PID law: equality with its transfer function, convergence of the sampled form, and anti-windup."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from graspforce.control.joints.joint_laws import PIDGains, PIDMemory, pid, pid_step
from graspforce.core.errors import InvalidInput

TERMS = PIDGains.from_times([2.0, 0.7], [0.4, 1.1], [0.05, 0.2])


def test_gains_follow_from_integral_and_derivative_times():
    np.testing.assert_allclose(TERMS.ki, [5.0, 0.7 / 1.1], rtol=1e-15)
    np.testing.assert_allclose(TERMS.kd, [0.1, 0.14], rtol=1e-15)


def test_sampled_pid_equals_its_transfer_function():
    """K_p + K_ip/(1 − z⁻¹) + K_d (1 − z⁻¹) over one denominator, by SciPy's filter."""
    dt, e = 2e-3, np.random.default_rng(1).normal(size=(200, 2))
    memory, out = PIDMemory.initial([0.0, 0.0]), []
    for row in e:
        command, memory = pid_step(TERMS, memory, row, dt)
        out.append(command.tau)
    for j in range(2):
        kp, kip, kd = TERMS.kp[j], TERMS.ki[j] * dt, TERMS.kd[j] / dt
        expected = signal.lfilter([kp + kip + kd, -kp - 2 * kd, kd], [1.0, -1.0], e[:, j])
        np.testing.assert_allclose(np.array(out)[:, j], expected, rtol=1e-11, atol=1e-11)


def test_sampled_pid_converges_to_continuous_pid_with_first_order():
    """e = sin 3t has a known integral and derivative: halving dt halves the difference."""
    tau_u, differences = np.array([0.03, -0.02]), []
    for steps in (400, 800, 1600):
        t = np.linspace(0.0, 1.3, steps + 1)
        memory = PIDMemory.initial([0.0, 0.0])
        for x in t[1:]:
            command, memory = pid_step(TERMS, memory, np.full(2, np.sin(3 * x)), t[1], tau_u)
        integral = TERMS.ki * (1 - np.cos(3 * 1.3)) / 3
        continuous, rate = pid(TERMS, integral, np.full(2, np.sin(3.9)), np.full(2, 3 * np.cos(3.9)), tau_u)
        np.testing.assert_allclose(rate, TERMS.ki * np.sin(3.9), rtol=1e-15)
        differences.append(command.tau - continuous.tau)
    np.testing.assert_allclose(differences[0] / differences[1], 2.0, rtol=0.01)
    np.testing.assert_allclose(differences[1] / differences[2], 2.0, rtol=0.01)
    assert np.abs(differences[2]).max() < 2e-3


def test_first_step_has_no_derivative_kick():
    command, _ = pid_step(TERMS, PIDMemory.initial([0.5, -0.5]), [0.5, -0.5], 1e-3)
    np.testing.assert_allclose(command.tau, [1.0 + 5.0 * 0.5e-3, -0.35 - 0.7 / 1.1 * 0.5e-3], rtol=1e-12)


@given(seed=st.integers(0, 100_000))
def test_integral_never_pushes_beyond_a_limit(seed):
    """Within the limits the integral grows in full; at a limit it never grows beyond it, and always back from it.

    Mirrored errors and limits give mirrored torques.
    """
    rng = np.random.default_rng(seed)
    n, dt = 4, 0.01
    gains = PIDGains(*rng.uniform(0.0, 3.0, (3, n)) * [[1.0], [10.0], [0.01]])
    upper, lower = rng.uniform(0.1, 1.0, n), -rng.uniform(0.1, 1.0, n)
    memory = PIDMemory.initial(np.zeros(n))
    mirrored = memory
    for _ in range(60):
        e = rng.normal(0.3, 0.5, n)
        before = memory
        command, memory = pid_step(gains, before, e, dt, limits=(lower, upper))
        other, mirrored = pid_step(gains, mirrored, -e, dt, limits=(-upper, -lower))
        np.testing.assert_array_equal(other.tau, -command.tau)
        assert ((lower <= command.tau) & (command.tau <= upper)).all()
        np.testing.assert_array_equal(
            command.saturated, (command.tau_unlimited > upper) * 1.0 - (command.tau_unlimited < lower)
        )

        increment, growth = gains.ki * e * dt, memory.integral - before.integral
        other_terms = command.tau_unlimited - increment - before.integral
        total = other_terms + memory.integral
        np.testing.assert_allclose(growth[command.saturated == 0], increment[command.saturated == 0], atol=1e-12)
        outward = (np.abs(growth) > 1e-12) & (np.sign(growth) == command.saturated)
        assert (total[outward] <= upper[outward] + 1e-12).all()
        assert (total[outward] >= lower[outward] - 1e-12).all()
        without = other_terms + before.integral
        across = (command.saturated != 0) & (np.clip(without, lower, upper) == without)
        np.testing.assert_allclose(total[across], command.tau[across], atol=1e-12)  # it grows up to the limit
        inward = np.sign(increment) == -command.saturated
        np.testing.assert_allclose(growth[inward], increment[inward], atol=1e-12)


def test_anti_windup_reduces_overshoot():
    """An inertia moves by one radian with a tenth of the unlimited torque, against a constant load."""
    gains, J, load_, dt = PIDGains([4.0], [6.0], [0.5]), 0.05, 0.05, 1e-3  # N·m/rad …, kg·m², N·m, s
    paths = []
    for limited in (True, False):
        limits = ([-0.4], [0.4])
        q, v, memory, path = 0.0, 0.0, PIDMemory.initial([1.0]), []
        for _ in range(8000):
            command, memory = pid_step(gains, memory, [1.0 - q], dt, limits=limits if limited else None)
            tau = float(np.clip(command.tau, *limits)[0])
            a = (tau - load_) / J
            q, v = q + dt * v + dt**2 / 2 * a, v + dt * a
            path.append(q)
        paths.append(np.array(path))
    limited_overshoot, windup_overshoot = (path.max() - 1.0 for path in paths)
    assert limited_overshoot < 0.5 * windup_overshoot
    assert windup_overshoot > 0.1
    assert abs(paths[0][-1] - 1.0) < 1e-4  # the integral equals the load: no error remains
    np.testing.assert_allclose(memory.integral, load_, atol=1e-3)


def test_continuous_integral_stops_at_a_limit():
    gains = PIDGains([1.0, 1.0, 1.0], [2.0, 2.0, 2.0], [0.0, 0.0, 0.0])
    limits = ([-0.5] * 3, [0.5] * 3)
    command, rate = pid(gains, [0.0, 0.0, -2.0], [1.0, 0.1, 0.3], np.zeros(3), limits=limits)
    np.testing.assert_array_equal(command.saturated, [1.0, 0.0, -1.0])
    np.testing.assert_allclose(rate, [0.0, 0.2, 0.6], rtol=1e-15)  # stopped at the limit; free; free to return


def test_invalid_gains_and_limits_are_named():
    with pytest.raises(InvalidInput, match=r"kd\[0\] = -1.0: must be at least 0"):
        PIDGains([1.0], [0.0], [-1.0])
    with pytest.raises(InvalidInput, match=r"tau_i = .* greater than 0"):
        PIDGains.from_times([1.0], [0.0], [0.0])
    with pytest.raises(InvalidInput, match=r"dt = 0"):
        pid_step(TERMS, PIDMemory.initial([0.0, 0.0]), [0.0, 0.0], 0.0)
    with pytest.raises(InvalidInput, match=r"limits\[0\]\[1\] = 0.5: must be at most limits\[1\]\[1\], which is 0.4"):
        pid_step(TERMS, PIDMemory.initial([0.0, 0.0]), [0.0, 0.0], 1e-3, limits=([-1.0, 0.5], [1.0, 0.4]))
