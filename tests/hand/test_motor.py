"""Motors: the equation of the winding, the transfer functions of Mattar (2013), energy, and limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal
from scipy.integrate import quad, solve_ivp
from support.hands import SHIPPED_HANDS, load

from graspforce.core.errors import InvalidInput
from graspforce.hand.motor import MotorModel

N, K, R, SUPPLY, L = 50.0, 0.011, 3.7, 9.0, 2.3e-3  # ratio, N·m/A, Ω, V, H: all different


THOUSANDTHS = st.integers(-1000, 1000).map(lambda x: x / 1000.0)  # no tiny numbers: the reference integrator squares them


def motor(**changes) -> MotorModel:
    """Return one motor with some arguments changed."""
    return MotorModel([N], **{"torque_constant": K, "resistance": R, "supply": SUPPLY, **changes})


def scalar(array) -> float:
    """Return the only entry of an array."""
    (value,) = array
    return float(value)


# ── the winding ────────────────────────────────────────────────────────────────────────────────────────────────────────────


@given(
    command=THOUSANDTHS.map(lambda x: 2.0 * x),
    v=THOUSANDTHS.map(lambda x: 10.0 * x),
    i0=THOUSANDTHS.map(lambda x: 0.8 * x),
    dt=st.floats(1e-4, 3e-3),
    amplifier=st.sampled_from(["current", "voltage"]),
)
def test_step_solves_the_winding_equation(command, v, i0, dt, amplifier):
    """L di/dt = u − R i − k N v by a reference integrator; the mean of i gives the torque, the mean of R i² the heat."""
    motors = motor(inductance=L, current_limit=0.9, damping=0.002, amplifier=amplifier)
    step = motors.step([i0], [command], [v], dt)
    u = scalar(step.voltage)
    path = solve_ivp(
        lambda t, i: (u - R * i - K * N * v) / L, (0.0, dt), [i0], method="DOP853", rtol=1e-12, atol=1e-14, dense_output=True
    )
    assert scalar(step.current) == pytest.approx(path.y[0, -1], abs=1e-10)
    mean = quad(lambda t: path.sol(t)[0], 0.0, dt)[0] / dt
    square = quad(lambda t: path.sol(t)[0] ** 2, 0.0, dt)[0] / dt
    # the reference interpolates with order seven: 1e-7 A
    assert scalar(step.tau) == pytest.approx(N * K * mean - 0.002 * v, abs=1e-7)
    assert scalar(step.heat) == pytest.approx(R * square, abs=1e-6)


def test_steps_compose():
    """One step of dt equals three steps of dt/3, if no limit is active."""
    motors = motor(inductance=L, amplifier="voltage")
    single = motors.step([0.2], [0.3], [1.5], 1e-3)
    i, impulse, heat = [0.2], 0.0, 0.0
    for _ in range(3):
        part = motors.step(i, [0.3], [1.5], 1e-3 / 3)
        i, impulse, heat = part.current, impulse + scalar(part.tau) / 3, heat + scalar(part.heat) / 3
    assert scalar(i) == pytest.approx(scalar(single.current), rel=1e-13)
    assert impulse == pytest.approx(scalar(single.tau), rel=1e-13)
    assert heat == pytest.approx(scalar(single.heat), rel=1e-13)


@pytest.mark.parametrize("amplifier", ["current", "voltage"])
def test_zero_inductance_is_the_limit_of_small_inductance(amplifier):
    """The mean current lags by L/(R dt) of its change: half the inductance, half the difference."""
    limit = scalar(motor(amplifier=amplifier).step([0.1], [0.3], [2.0], 1e-3).tau)
    error = [scalar(motor(amplifier=amplifier, inductance=h).step([0.1], [0.3], [2.0], 1e-3).tau) - limit for h in (2e-5, 1e-5)]
    assert error[0] / error[1] == pytest.approx(2.0, rel=1e-9)
    assert error[1] == pytest.approx(-1e-5 / (R * 1e-3) * (limit - N * K * 0.1), rel=1e-9)


def test_current_amplifier_reaches_the_torque_in_one_step():
    motors = motor(inductance=L, damping=0.004, friction=0.01)
    first = motors.step([0.0], [0.2], [-3.0], 2e-3)
    assert scalar(first.current) == pytest.approx(0.2 / (N * K), rel=1e-12)
    second = motors.step(first.current, [0.2], [-3.0], 2e-3)
    assert scalar(second.tau) == pytest.approx(0.2 + 0.004 * 3.0 + 0.01, rel=1e-12)
    assert scalar(first.saturated) == scalar(second.saturated) == 0.0


def test_coulomb_friction_opposes_the_rate_and_fades_near_zero():
    motors = motor(friction=0.03)
    tau = [scalar(motors.step([0.0], [0.0], [v], 1e-3).tau) for v in (-1.0, -0.05, -0.025, 0.0, 0.01, 2.0)]
    np.testing.assert_allclose(tau, [0.03, 0.03, 0.015, 0.0, -0.006, -0.03], atol=1e-15)


# ── transfer functions of Mattar (2013) ────────────────────────────────────────────────────────────────────────────────────

INERTIA, DAMPING = 3.1e-4, 1.3e-3  # kg·m², N·m·s/rad, at the joint


def spin(motors: MotorModel, command, dt: float, end: float) -> np.ndarray:
    """Return angle and rate of an inertia behind the motor at the times 0, dt, …, exact for piecewise constant torque.

    Args:
        motors: one motor, with the damping of the load.
        command: the commanded torque as a function of angle and rate.
        dt: period, s.
        end: last time, s.
    """
    x, i, rows = np.zeros(2), [0.0], [np.zeros(2)]
    for _ in range(round(end / dt)):
        step = motors.step(i, [command(*x)], [x[1]], dt)
        a, i = scalar(step.tau) / INERTIA, step.current
        x = x + dt * np.array([x[1] + a * dt / 2, a])
        rows.append(x)
    return np.array(rows)


def test_speed_response_is_that_of_corrected_equation_26():
    """J θ̈ + (B + k_b k_i/R) θ̇ = k_i u/R at the joint: damping B + N² k²/R, drive N k/R."""
    motors, u = motor(damping=DAMPING, amplifier="voltage"), 2.0
    total = DAMPING + (N * K) ** 2 / R
    gain, time = N * K / R / total, INERTIA / total  # rad/(s·V), s
    command = u / R * N * K  # N·m, the torque at rest for this voltage
    error = []
    for dt in (time / 100, time / 200):
        rates = spin(motors, lambda q, v: command, dt, 12 * time)[:, 1]
        t = dt * np.arange(len(rates))
        error.append(np.abs(rates - gain * u * (1 - np.exp(-t / time))).max())
        assert rates[-1] == pytest.approx(gain * u, rel=1e-4)  # up to e⁻¹²
    assert error[0] / error[1] == pytest.approx(2.0, rel=0.03)  # a constant rate is a first-order approximation
    assert error[1] < 2e-3 * gain * u  # a quarter of dt/T
    printed = gain * u * total / ((DAMPING + (N * K) ** 2) / R)  # as printed, (26) also divides the mechanical damping by R
    assert abs(printed - gain * u) > 0.01 * gain * u


def test_position_loop_is_that_of_corrected_equation_28():
    """θ/θ_d = w²/(s² + (R B + k_b k_i)/(R J) s + w²), w² = K_θ k_i/(R J): the numerator of (28) divided by R J."""
    motors, volts = motor(damping=DAMPING, amplifier="voltage"), 60.0  # V per rad
    total = DAMPING + (N * K) ** 2 / R
    w2 = volts * N * K / R / INERTIA
    system = signal.lti([w2], [1.0, total / INERTIA, w2])
    goal, error = 0.1, []  # initially 6 V, below the supply
    for dt in (4e-5, 2e-5):
        angles = spin(motors, lambda q, v: volts * (goal - q) / R * N * K, dt, 0.1)[:, 0]
        t = dt * np.arange(len(angles))
        _, expected = signal.step(system, T=t)
        error.append(np.abs(angles - goal * expected).max())
    assert error[0] / error[1] == pytest.approx(2.0, rel=0.05)
    assert error[1] < 5e-3 * goal
    assert angles[-1] == pytest.approx(goal, rel=1e-4)  # static gain 1, up to e⁻¹³


# ── energy ─────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@given(seed=st.integers(0, 100_000), coil=st.sampled_from([0.0, 1e-5, L]), amplifier=st.sampled_from(["current", "voltage"]))
def test_electric_power_is_work_heat_friction_and_field(seed, coil, amplifier):
    """u ī = tau v + friction·v + R i² + ½ L Δ(i²)/dt, with and without active limits, also in regeneration."""
    rng = np.random.default_rng(seed)
    motors = motor(inductance=coil, current_limit=rng.uniform(0.1, 2.0), damping=0.01, friction=0.02, amplifier=amplifier)
    i, dt = rng.uniform(-0.5, 0.5, 1), 10 ** rng.uniform(-4, -2)
    for _ in range(10):
        v = rng.normal(0.0, 10.0, 1)
        step = motors.step(i, rng.normal(0.0, 0.5, 1), v, dt)
        field = coil / 2 * (step.current**2 - i**2) / dt
        scale = max(scalar(np.abs(step.electric_power)), scalar(step.heat), 1e-3)
        balance = step.electric_power - step.tau * v - step.friction * v - step.heat - field
        assert abs(scalar(balance)) < 1e-10 * scale  # cancellation in the mean square of a nearly constant current
        assert scalar(step.friction * v) >= 0.0
        assert scalar(step.heat) >= 0.0
        i = step.current


# ── limits ─────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@given(seed=st.integers(0, 100_000), amplifier=st.sampled_from(["current", "voltage"]))
def test_voltage_and_current_limits_hold_in_both_directions(seed, amplifier):
    rng = np.random.default_rng(seed)
    limit, coil = rng.uniform(0.1, 3.0), rng.choice([0.0, L])
    motors = motor(current_limit=limit, inductance=coil, damping=0.01, friction=0.02, amplifier=amplifier)
    i0, command, v = rng.uniform(-limit, limit, 1), rng.normal(0.0, 2.0, 1), rng.normal(0.0, 8.0, 1)
    step = motors.step(i0, command, v, 1e-3)
    assert abs(scalar(step.voltage)) <= SUPPLY
    if abs(N * K * scalar(v)) <= SUPPLY:  # the back-EMF alone does not exceed the supply
        assert abs(scalar(step.current)) <= limit * (1 + 1e-12)
    mirrored = motors.step(-i0, -command, -v, 1e-3)
    for name in ("tau", "current", "voltage", "saturated", "friction"):
        np.testing.assert_allclose(getattr(mirrored, name), -getattr(step, name), rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(mirrored.electric_power, step.electric_power, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("v", [-30.0, -17.0, -9.0, -0.5, 0.0, 0.5, 9.0, 17.0, 30.0])
@pytest.mark.parametrize("amplifier", ["current", "voltage"])
def test_torque_range_is_reached_by_huge_commands(v, amplifier):
    """At 17 rad/s the back-EMF exceeds the supply of 9 V: the joint is driven from outside."""
    motors = motor(current_limit=1.3, inductance=L, damping=0.003, friction=0.01, amplifier=amplifier)
    lower, upper = motors.torque_range([v])
    reached = []
    for command in (-100.0, 100.0):
        i = [0.0]
        for _ in range(40):
            step = motors.step(i, [command], [v], 1e-3)
            i = step.current
        reached.append(scalar(step.tau))
        assert scalar(step.saturated) == np.sign(command)
    np.testing.assert_allclose([scalar(lower), scalar(upper)], reached, rtol=1e-9)


def test_torque_range_is_the_torque_speed_line():
    """(±V − k N v) N k/R at the supply limit, ± N k i_max at the current limit, less friction."""
    motors = motor(current_limit=1.3, damping=0.003, friction=0.01)
    lower, upper = motors.torque_range([14.0])
    assert scalar(upper) == pytest.approx((SUPPLY - N * K * 14.0) * N * K / R - 0.052, rel=1e-12)
    assert scalar(lower) == pytest.approx(-N * K * 1.3 - 0.052, rel=1e-12)
    lower, upper = motors.torque_range([-14.0])
    assert scalar(upper) == pytest.approx(N * K * 1.3 + 0.052, rel=1e-12)
    assert scalar(lower) == pytest.approx((-SUPPLY + N * K * 14.0) * N * K / R + 0.052, rel=1e-12)


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_motors_for_a_hand_reach_its_torque_and_rate_limits(name):
    hand = load(name)
    motors = MotorModel.for_hand(hand)
    for share in (0.0, 0.5, 1.0, -1.0):
        lower, upper = motors.torque_range(share * hand.velocity_limit)
        np.testing.assert_allclose(upper if share >= 0 else -lower, hand.torque_upper, rtol=1e-12)
    _, beyond = motors.torque_range(1.1 * hand.velocity_limit)
    np.testing.assert_allclose(beyond, 0.9 * hand.torque_upper, rtol=1e-9)  # 10 % more back-EMF, 10 % less current
    rest, command = np.zeros(hand.n), 0.4 * hand.torque_upper
    np.testing.assert_allclose(motors.step(rest, command, rest, 1e-3).tau, command, rtol=1e-12)


def test_joint_depends_only_on_the_product_of_gear_and_constant():
    hand = load("dlr_hit2")
    v, command = np.linspace(-5, 5, hand.n), np.linspace(-0.8, 0.8, hand.n)
    a, b = (
        MotorModel.for_hand(hand, gear_ratio=N, supply=V, electrical_time_constant=2e-4, amplifier="voltage").step(
            np.zeros(hand.n), command, v, 1e-3
        )
        for N, V in ((100.0, 12.0), (37.0, 24.0))
    )
    np.testing.assert_allclose(a.tau, b.tau, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(a.heat, b.heat, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"torque_constant": 0.0}, r"torque_constant\[0\] = 0.0: must be greater than 0"),
        ({"resistance": [1.0, 2.0]}, "resistance = .* a list of 1 numbers"),
        ({"supply": np.nan}, r"supply\[0\] = nan"),
        ({"current_limit": -1.0}, r"current_limit\[0\] = -1.0"),
        ({"inductance": -1e-6}, r"inductance\[0\] = -1e-06: must be at least 0"),
        ({"amplifier": "torque"}, "amplifier = 'torque': must be one of current, voltage"),
    ],
)
def test_motor_rejects_invalid_values(changes, words):
    with pytest.raises(InvalidInput, match=words):
        motor(**changes)


def test_step_rejects_invalid_values():
    with pytest.raises(InvalidInput, match="dt = 0"):
        motor().step([0.0], [0.0], [0.0], 0.0)
    with pytest.raises(InvalidInput, match="command = "):
        motor().step([0.0], [0.0, 1.0], [0.0], 1e-3)
