"""Force control with joint torque sensors: transfer function, static error, and contact of a fingertip with a wall."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal
from support.hands import load
from support.joint_dynamics import GRAVITY, acceleration

from graspforce.control.joints.force_loop import ForceGains, TorqueReading, force_step
from graspforce.core.errors import InvalidInput

SPRING, ROTOR, DRAG = 30.0, 2e-3, 0.05  # δ N·m/rad, J kg·m², B N·m·s/rad


def press(gains, tau_desired, dt, end, unknown=0.0):
    """Return the measured torque of an actuator against a spring; exact solution with torques constant over a period."""
    A = np.array([[0.0, 1.0], [-SPRING / ROTOR, -DRAG / ROTOR]])
    step = signal.cont2discrete((A, np.array([[0.0], [1 / ROTOR]]), np.eye(2), np.zeros((2, 1))), dt)
    x, integral, tau_f = np.zeros(2), np.zeros(1), [0.0]
    for _ in range(round(end / dt)):
        command, integral = force_step(gains, integral, [tau_desired], TorqueReading([SPRING * x[0]], [x[1]]), dt)
        x = step[0] @ x + step[1][:, 0] * (command.tau[0] + unknown)
        tau_f.append(SPRING * x[0])
    return np.array(tau_f)


def test_force_loop_has_the_transfer_function_of_its_docstring():
    """tau_f/tau_d = δ k_ps/(J s² + (B + Kv) s + δ k_ps) with k_ps = 1 + Kp; its static gain is 1."""
    gains, differences = ForceGains([3.0], [0.0], [0.4]), []
    k = SPRING * 4.0
    system = signal.lti([k], [ROTOR, DRAG + 0.4, k])
    for dt in (1e-4, 5e-5):
        tau_f = press(gains, 0.25, dt, 0.1)
        _, response = signal.step(system, T=dt * np.arange(len(tau_f)))
        differences.append(np.abs(tau_f - 0.25 * response).max())
    assert differences[0] / differences[1] == pytest.approx(2.0, rel=0.05)
    assert differences[1] < 0.01 * 0.25
    assert tau_f[-1] == pytest.approx(0.25, rel=1e-3)


def test_integral_removes_the_error_of_an_unmodelled_torque():
    """A disturbance d leaves the static error d/(1 + Kp) without integral, and none with it."""
    without, with_integral = (press(ForceGains([3.0], [ki], [0.4]), 0.25, 2e-4, 1.0, unknown=0.02)[-1] for ki in (0.0, 60.0))
    assert without == pytest.approx(0.25 + 0.02 / 4.0, rel=1e-6)
    assert with_integral == pytest.approx(0.25, rel=1e-6)


def test_force_step_equals_its_equation_with_the_integral_stopped_at_a_limit():
    gains = ForceGains([3.0, 3.0], [50.0, 50.0], [0.2, 0.2])
    command, integral = force_step(
        gains, [0.01, 0.01], [0.3, 0.3], TorqueReading([0.1, 0.1], [0.5, 0.5]), 2e-3, [0.05, 0.05], ([-9, -9], [9, 0.5])
    )
    # 0.05 + 0.3 + 3·0.2 + 0.01 + 50·0.2·0.002 − 0.2·0.5
    np.testing.assert_allclose(command.tau, [0.88, 0.5], rtol=1e-14)
    np.testing.assert_array_equal(command.saturated, [0.0, 1.0])
    np.testing.assert_allclose(integral, [0.03, 0.01], rtol=1e-14)


def test_fingertip_presses_a_wall_with_the_desired_force():
    """A finger of four_finger presses a stiff wall, with drive friction that the law does not model."""
    hand = load("four_finger")
    chosen = list(hand.finger("finger_1").joints)
    q0, f_desired = np.array(hand.neutral), np.array([0.4, -0.2, 1.5])  # N, of the finger on the wall, in H
    place, stiff = hand.tip_pose(q0, "finger_1")[0], 2000.0  # N/m
    gains = ForceGains(np.full(12, 4.0), np.full(12, 80.0), np.full(12, 0.2))
    unknown = np.linspace(-0.004, 0.004, 12)  # N·m
    q, v, integral, dt = q0, np.zeros(12), np.zeros(12), 2e-4
    others, limits = np.setdiff1d(np.arange(12), chosen), (hand.torque_lower, hand.torque_upper)
    for _ in range(3000):
        J = hand.point_jacobian(q, "finger_1", hand.tip_pose(q, "finger_1")[0])[:3]
        f = stiff * (hand.tip_pose(q, "finger_1")[0] - place)
        tau_g = hand.gravity_torque(q, GRAVITY)
        command, integral = force_step(gains, integral, J.T @ f_desired, TorqueReading(J.T @ f, v), dt, tau_g, limits)
        tau = np.array(command.tau)
        tau[others] = tau_g[others]  # the other fingers stay at rest
        bias = np.where(np.isin(np.arange(12), chosen), unknown, 0.0)
        a = acceleration(hand, q, v, tau + bias - J.T @ f, GRAVITY)
        v = v + dt * a
        q = q + dt * v
    np.testing.assert_allclose(f, f_desired, atol=1e-4)


def test_invalid_gains_are_named() -> None:
    with pytest.raises(InvalidInput, match=r"ki = .* a list of 1 numbers, not 2"):
        ForceGains([1.0], [0.0, 1.0], [0.0])
    with pytest.raises(InvalidInput, match=r"measured\.tau = "):
        force_step(ForceGains([1.0], [0.0], [0.0]), [0.0], [0.0], TorqueReading([0.0, 0.0], [0.0]), 1e-3)
