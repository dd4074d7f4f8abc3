"""Motors: Ohm's, Kirchhoff's and Newton's laws, the transfer functions of 000, energy, and limits on both sides."""

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

N, K, R, SUPPLY, L = 50.0, 0.011, 3.7, 9.0, 2.3e-3  # no two alike: 1/turn, N·m/A, Ω, V, H


THOUSANDTHS = st.integers(-1000, 1000).map(lambda x: x / 1000.0)  # the other integrator squares its errors: no 1e-200


def motor(**changes) -> MotorModel:
    return MotorModel([N], **{"torque_constant": K, "resistance": R, "supply": SUPPLY, **changes})


def one(array) -> float:
    (value,) = array
    return float(value)


# ── the winding ───────────────────────────────────────────────────────────────────────────────────────────────────────────────


@given(
    command=THOUSANDTHS.map(lambda x: 2.0 * x),
    v=THOUSANDTHS.map(lambda x: 10.0 * x),
    i0=THOUSANDTHS.map(lambda x: 0.8 * x),
    dt=st.floats(1e-4, 3e-3),
    amplifier=st.sampled_from(["current", "voltage"]),
)
def test_a_step_solves_the_winding_s_equation(command, v, i0, dt, amplifier):
    """L di/dt = u − R i − k N v, integrated by another; its mean gives the torque, the mean of R i² the heat."""
    motors = motor(inductance=L, current_limit=0.9, damping=0.002, amplifier=amplifier)
    step = motors.step([i0], [command], [v], dt)
    u = one(step.voltage)
    path = solve_ivp(
        lambda t, i: (u - R * i - K * N * v) / L, (0.0, dt), [i0], method="DOP853", rtol=1e-12, atol=1e-14, dense_output=True
    )
    assert one(step.current) == pytest.approx(path.y[0, -1], abs=1e-10)
    mean = quad(lambda t: path.sol(t)[0], 0.0, dt)[0] / dt
    square = quad(lambda t: path.sol(t)[0] ** 2, 0.0, dt)[0] / dt
    # a seventh-order interpolation between steps: 1e-7 A
    assert one(step.tau) == pytest.approx(N * K * mean - 0.002 * v, abs=1e-7)
    assert one(step.heat) == pytest.approx(R * square, abs=1e-6)


def test_steps_compose():
    """The exact solution over dt is the one over dt/3 thrice, under a voltage that nothing clips."""
    motors = motor(inductance=L, amplifier="voltage")
    whole = motors.step([0.2], [0.3], [1.5], 1e-3)
    i, impulse, heat = [0.2], 0.0, 0.0
    for _ in range(3):
        part = motors.step(i, [0.3], [1.5], 1e-3 / 3)
        i, impulse, heat = part.current, impulse + one(part.tau) / 3, heat + one(part.heat) / 3
    assert one(i) == pytest.approx(one(whole.current), rel=1e-13)
    assert impulse == pytest.approx(one(whole.tau), rel=1e-13)
    assert heat == pytest.approx(one(whole.heat), rel=1e-13)


@pytest.mark.parametrize("amplifier", ["current", "voltage"])
def test_no_inductance_is_the_limit_of_a_small_one(amplifier):
    """The mean current lags by L/(R dt) of its change: halving L halves what is left."""
    none = one(motor(amplifier=amplifier).step([0.1], [0.3], [2.0], 1e-3).tau)
    off = [one(motor(amplifier=amplifier, inductance=h).step([0.1], [0.3], [2.0], 1e-3).tau) - none for h in (2e-5, 1e-5)]
    assert off[0] / off[1] == pytest.approx(2.0, rel=1e-9)
    assert off[1] == pytest.approx(-1e-5 / (R * 1e-3) * (none - N * K * 0.1), rel=1e-9)


def test_a_current_drive_brings_the_torque_within_a_step_and_friction_comes_off_it():
    motors = motor(inductance=L, damping=0.004, friction=0.01)
    first = motors.step([0.0], [0.2], [-3.0], 2e-3)
    assert one(first.current) == pytest.approx(0.2 / (N * K), rel=1e-12)
    second = motors.step(first.current, [0.2], [-3.0], 2e-3)
    assert one(second.tau) == pytest.approx(0.2 + 0.004 * 3.0 + 0.01, rel=1e-12)
    assert one(first.saturated) == one(second.saturated) == 0.0


def test_dry_friction_opposes_the_rate_and_fades_below_a_twentieth_of_a_radian_per_second():
    motors = motor(friction=0.03)
    lost = [one(motors.step([0.0], [0.0], [v], 1e-3).tau) for v in (-1.0, -0.05, -0.025, 0.0, 0.01, 2.0)]
    np.testing.assert_allclose(lost, [0.03, 0.03, 0.015, 0.0, -0.006, -0.03], atol=1e-15)


# ── the transfer functions of 000 ─────────────────────────────────────────────────────────────────────────────────────────────

INERTIA, DAMPING = 3.1e-4, 1.3e-3  # kg·m², N·m·s/rad, at the joint


def spin(motors: MotorModel, command, dt: float, end: float) -> np.ndarray:
    """θ and its rate of an inertia behind the motor at the times 0, dt, …: exact for a torque that is held.

    ``command`` is given θ and the rate. The load's damping is in the motor's.
    """
    x, i, rows = np.zeros(2), [0.0], [np.zeros(2)]
    for _ in range(round(end / dt)):
        step = motors.step(i, [command(*x)], [x[1]], dt)
        a, i = one(step.tau) / INERTIA, step.current
        x = x + dt * np.array([x[1] + a * dt / 2, a])
        rows.append(x)
    return np.array(rows)


def test_the_speed_has_the_gain_and_the_time_constant_of_26():
    """(26), mended: J θ̈ + (B + k_b k_i/R) θ̇ = k_i u/R, all at the joint: N² k²/R joins the damping, N k/R drives."""
    motors, u = motor(damping=DAMPING, amplifier="voltage"), 2.0
    total = DAMPING + (N * K) ** 2 / R
    gain, time = N * K / R / total, INERTIA / total  # rad/(s·V), s
    command = u / R * N * K  # the torque at rest that the voltage stands for
    off = []
    for dt in (time / 100, time / 200):
        rates = spin(motors, lambda q, v: command, dt, 12 * time)[:, 1]
        t = dt * np.arange(len(rates))
        off.append(np.abs(rates - gain * u * (1 - np.exp(-t / time))).max())
        assert rates[-1] == pytest.approx(gain * u, rel=1e-4)  # e⁻¹² is left
    assert off[0] / off[1] == pytest.approx(2.0, rel=0.03)  # holding the rate is of first order in dt
    assert off[1] < 2e-3 * gain * u  # a quarter of dt/T
    printed = gain * u * total / ((DAMPING + (N * K) ** 2) / R)  # (26) as printed divides the mechanical damping by R too
    assert abs(printed - gain * u) > 0.01 * gain * u


def test_the_position_loop_is_28_mended():
    """θ/θ_d = w²/(s² + (R B + k_b k_i)/(R J) s + w²), w² = K_θ k_i/(R J): (28) with its numerator divided by R J."""
    motors, volts = motor(damping=DAMPING, amplifier="voltage"), 60.0  # V per rad
    total = DAMPING + (N * K) ** 2 / R
    w2 = volts * N * K / R / INERTIA
    system = signal.lti([w2], [1.0, total / INERTIA, w2])
    goal, off = 0.1, []  # 6 V at first, less than the supply
    for dt in (4e-5, 2e-5):
        angles = spin(motors, lambda q, v: volts * (goal - q) / R * N * K, dt, 0.1)[:, 0]
        t = dt * np.arange(len(angles))
        _, wanted = signal.step(system, T=t)
        off.append(np.abs(angles - goal * wanted).max())
    assert off[0] / off[1] == pytest.approx(2.0, rel=0.05)
    assert off[1] < 5e-3 * goal
    assert angles[-1] == pytest.approx(goal, rel=1e-4)  # its gain at rest is 1; e⁻¹³ is left


# ── energy ────────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@given(seed=st.integers(0, 100_000), coil=st.sampled_from([0.0, 1e-5, L]), amplifier=st.sampled_from(["current", "voltage"]))
def test_electric_power_becomes_work_heat_friction_and_field(seed, coil, amplifier):
    """u ī = tau v + friction·v + R i² + ½ L Δ(i²)/dt, clipped or not, driving or driven."""
    rng = np.random.default_rng(seed)
    motors = motor(inductance=coil, current_limit=rng.uniform(0.1, 2.0), damping=0.01, friction=0.02, amplifier=amplifier)
    i, dt = rng.uniform(-0.5, 0.5, 1), 10 ** rng.uniform(-4, -2)
    for _ in range(10):
        v = rng.normal(0.0, 10.0, 1)
        step = motors.step(i, rng.normal(0.0, 0.5, 1), v, dt)
        field = coil / 2 * (step.current**2 - i**2) / dt
        scale = max(one(np.abs(step.electric_power)), one(step.heat), 1e-3)
        balance = step.electric_power - step.tau * v - step.friction * v - step.heat - field
        assert abs(one(balance)) < 1e-10 * scale  # mean squares of a nearly constant current cancel some digits
        assert one(step.friction * v) >= 0.0
        assert one(step.heat) >= 0.0
        i = step.current


# ── limits ────────────────────────────────────────────────────────────────────────────────────────────────────────────────────


@given(seed=st.integers(0, 100_000), amplifier=st.sampled_from(["current", "voltage"]))
def test_both_limits_hold_on_both_sides(seed, amplifier):
    rng = np.random.default_rng(seed)
    most, coil = rng.uniform(0.1, 3.0), rng.choice([0.0, L])
    motors = motor(current_limit=most, inductance=coil, damping=0.01, friction=0.02, amplifier=amplifier)
    i0, command, v = rng.uniform(-most, most, 1), rng.normal(0.0, 2.0, 1), rng.normal(0.0, 8.0, 1)
    step = motors.step(i0, command, v, 1e-3)
    assert abs(one(step.voltage)) <= SUPPLY
    if abs(N * K * one(v)) <= SUPPLY:  # slower than the speed at which the back-EMF alone exceeds the supply
        assert abs(one(step.current)) <= most * (1 + 1e-12)
    mirrored = motors.step(-i0, -command, -v, 1e-3)
    for name in ("tau", "current", "voltage", "saturated", "friction"):
        np.testing.assert_allclose(getattr(mirrored, name), -getattr(step, name), rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(mirrored.electric_power, step.electric_power, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("v", [-30.0, -17.0, -9.0, -0.5, 0.0, 0.5, 9.0, 17.0, 30.0])
@pytest.mark.parametrize("amplifier", ["current", "voltage"])
def test_the_range_is_what_huge_commands_reach(v, amplifier):
    """17 rad/s: the back-EMF exceeds the supply of 9 V, a joint driven from outside."""
    motors = motor(current_limit=1.3, inductance=L, damping=0.003, friction=0.01, amplifier=amplifier)
    lower, upper = motors.torque_range([v])
    reached = []
    for command in (-100.0, 100.0):
        i = [0.0]
        for _ in range(40):
            step = motors.step(i, [command], [v], 1e-3)
            i = step.current
        reached.append(one(step.tau))
        assert one(step.saturated) == np.sign(command)
    np.testing.assert_allclose([one(lower), one(upper)], reached, rtol=1e-9)


def test_the_range_is_the_torque_speed_line():
    """Where the supply rules: (±V − k N v) N k/R; where the current limit does: ± N k i_max; less friction on both sides."""
    motors = motor(current_limit=1.3, damping=0.003, friction=0.01)
    lower, upper = motors.torque_range([14.0])
    assert one(upper) == pytest.approx((SUPPLY - N * K * 14.0) * N * K / R - 0.052, rel=1e-12)
    assert one(lower) == pytest.approx(-N * K * 1.3 - 0.052, rel=1e-12)
    lower, upper = motors.torque_range([-14.0])
    assert one(upper) == pytest.approx(N * K * 1.3 + 0.052, rel=1e-12)
    assert one(lower) == pytest.approx((-SUPPLY + N * K * 14.0) * N * K / R + 0.052, rel=1e-12)


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_the_motors_of_a_hand_give_its_largest_torque_up_to_its_largest_rate(name):
    hand = load(name)
    motors = MotorModel.for_hand(hand)
    for share in (0.0, 0.5, 1.0, -1.0):
        lower, upper = motors.torque_range(share * hand.velocity_limit)
        np.testing.assert_allclose(upper if share >= 0 else -lower, hand.torque_upper, rtol=1e-12)
    _, beyond = motors.torque_range(1.1 * hand.velocity_limit)
    np.testing.assert_allclose(beyond, 0.9 * hand.torque_upper, rtol=1e-9)  # a tenth more back-EMF, a tenth less current
    rest, asked = np.zeros(hand.n), 0.4 * hand.torque_upper
    np.testing.assert_allclose(motors.step(rest, asked, rest, 1e-3).tau, asked, rtol=1e-12)


def test_the_split_between_gear_and_winding_does_not_show_at_the_joint():
    hand = load("dlr_hit2")
    v, asked = np.linspace(-5, 5, hand.n), np.linspace(-0.8, 0.8, hand.n)
    a, b = (
        MotorModel.for_hand(hand, gear_ratio=N, supply=V, electrical_time_constant=2e-4, amplifier="voltage").step(
            np.zeros(hand.n), asked, v, 1e-3
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
def test_what_no_motor_has_is_refused(changes, words):
    with pytest.raises(InvalidInput, match=words):
        motor(**changes)


def test_a_step_needs_time():
    with pytest.raises(InvalidInput, match="dt = 0"):
        motor().step([0.0], [0.0], [0.0], 0.0)
    with pytest.raises(InvalidInput, match="command = "):
        motor().step([0.0], [0.0, 1.0], [0.0], 1e-3)
