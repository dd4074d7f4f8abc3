"""Heat of motors: energy, steady states, the limits that protect a winding, and hold times against a second integrator."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from support.hands import load

from graspforce.core.errors import InvalidInput
from graspforce.hand.descriptions.drive_description import ThermalDescription
from graspforce.hand.drives.drive import Drive, Drives
from graspforce.hand.heat import COPPER, MotorTemperatures, ThermalModel, report_heat

THERMAL = ThermalDescription(
    winding_resistance=8.0, winding_time_constant=6.0, housing_resistance=30.0, housing_time_constant=400.0,
    largest_temperature=100.0, source="invented",
)  # fmt: skip
DRIVE = Drive("current", torque_constant=0.8, resistance=5.0, thermal=THERMAL)
MODEL = ThermalModel(Drives((DRIVE,)), ambient=20.0)
COLD = MODEL.at_rest()

torques = st.floats(0.01, 2.0)  # N·m
warm = st.floats(20.0, 90.0)  # °C


def slope(t: float, x, current: float):
    """Return dT/dt of winding and housing, written from the heat balance."""
    winding, housing = x
    heat = 5.0 * (1.0 + COPPER * (winding - 25.0)) * current**2
    flow = (winding - housing) / 8.0
    return [(heat - flow) / (6.0 / 8.0), (flow - (housing - 20.0) / 30.0) / (400.0 / 30.0)]


def temperatures(winding: float, housing: float) -> MotorTemperatures:
    return MotorTemperatures(np.array([winding]), np.array([housing]))


def test_steps_follow_the_heat_balance():
    """Against SciPy's integrator; the heat of each step is that of its begin, so the error is of first order in the step."""
    current, end, errors = 0.6, 30.0, []
    exact = solve_ivp(slope, (0.0, end), [20.0, 20.0], args=(current,), rtol=1e-10, atol=1e-10).y[:, -1]
    for dt in (0.2, 0.1):
        state = COLD
        for _ in range(round(end / dt)):
            state = MODEL.step(state, [current], dt)
        errors.append(np.abs([state.winding[0] - exact[0], state.housing[0] - exact[1]]).max())
    assert errors[0] < 0.1  # K
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.1)


@settings(max_examples=25)
@given(torques, warm, warm)
def test_hold_time_is_when_a_second_integrator_reaches_the_limit(tau, winding, housing):
    start = temperatures(max(winding, housing), housing)
    time = MODEL.hold_times(start, [tau])[0]
    current = tau / 0.8
    if np.isinf(time):
        assert tau <= MODEL.continuous_torques()[0] * (1.0 + 1e-9)
        return
    y = solve_ivp(slope, (0.0, time), [start.winding[0], housing], args=(current,), rtol=1e-9, atol=1e-9, method="LSODA").y
    assert y[0, -1] == pytest.approx(100.0, abs=1e-3)


def test_continuous_torque_is_the_border_of_loads_held_forever():
    torque = MODEL.continuous_torques()[0]
    assert np.isinf(MODEL.hold_times(COLD, [0.999 * torque])[0])
    assert 0.0 < MODEL.hold_times(COLD, [1.01 * torque])[0] < 1e5
    assert MODEL.hold_times(temperatures(101.0, 60.0), [0.1])[0] == 0.0


@settings(max_examples=25)
@given(torques, warm)
def test_limited_torques_never_overheat_a_winding(wanted, housing):
    """Ten minutes with the limit of each second, from any housing temperature; the housing warms up within the second."""
    state = temperatures(housing, housing)
    for _ in range(600):
        tau = min(wanted, MODEL.torque_limits(state)[0])
        new = MODEL.step(state, MODEL.currents([tau]), 1.0)
        assert new.winding[0] <= 100.0 + max(new.housing[0] - state.housing[0], 0.0) + 1e-9
        state = new


def test_limit_falls_with_the_housing_to_the_continuous_torque():
    limits = [MODEL.torque_limits(temperatures(h, h))[0] for h in (20.0, 50.0, 80.0, 100.0)]
    assert np.all(np.diff(limits) < 0.0)
    assert limits[-1] == 0.0
    state = COLD
    for _ in range(4000):  # ten time constants of the housing, at the limit of each step
        tau = MODEL.torque_limits(state)[0]
        state = MODEL.step(state, MODEL.currents([tau]), 1.0)
    assert tau == pytest.approx(MODEL.continuous_torques()[0], rel=1e-3)


def test_cold_weight_is_the_copper_loss_and_hot_motors_cost_more():
    assert MODEL.torque_weight(temperatures(20.0, 20.0))[0] == pytest.approx(5.0 * (1 - 5 * COPPER) / 0.8**2, rel=1e-12)
    weights = [MODEL.torque_weight(temperatures(t, 20.0))[0] for t in (20.0, 60.0, 90.0)]
    assert weights[2] > 10.0 * weights[1] > weights[0]


def test_heat_of_a_step_is_stored_or_given_to_the_air():
    """Without current the heat that the air takes up is what the two bodies lose."""
    state, dt = temperatures(90.0, 50.0), 1.0
    stored = (6.0 / 8.0) * 70.0 + (400.0 / 30.0) * 30.0  # J over the air
    lost = 0.0
    for _ in range(5000):
        new = MODEL.step(state, [0.0], dt)
        lost += 0.5 * dt * (state.housing[0] + new.housing[0] - 40.0) / 30.0
        state = new
    assert lost == pytest.approx(stored, rel=1e-3)  # the trapezoidal rule with steps of 1 s


def test_missing_data_are_named():
    with pytest.raises(InvalidInput, match=r"drives\[0\]\.thermal.*the thermal model needs it"):
        ThermalModel(Drives((Drive("current", torque_constant=1.0, resistance=2.0),)))


def test_hand_takes_smaller_limits_only():
    hand = load("four_finger")
    limits = np.linspace(0.01, 10.0, hand.n)
    limited = hand.with_torque_limits(limits, 2.0 * np.ones(hand.n))
    np.testing.assert_array_equal(limited.torque_upper, np.minimum(limits, hand.torque_upper))
    np.testing.assert_array_equal(limited.torque_weight, 2.0)
    with pytest.raises(InvalidInput, match="largest"):
        hand.with_torque_limits(np.zeros(hand.n))


def test_reserve_is_a_part_of_the_range_over_the_air():
    reserved = MODEL.with_reserve(0.25)
    assert reserved.largest[0] == pytest.approx(20.0 + 0.75 * 80.0)
    assert reserved.continuous_torques()[0] < MODEL.continuous_torques()[0]
    with pytest.raises(InvalidInput, match="reserve"):
        MODEL.with_reserve(1.0)


# ── reports of runs ────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_report_agrees_with_one_exact_step_and_names_the_finger_that_reaches_its_limit_first() -> None:
    hand = load("four_finger").with_drives(DRIVE)
    tau = np.zeros((2000, hand.n))
    tau[:, hand.finger("finger_2").joints[1]] = 0.6  # N·m; 0.29 can be held forever
    report = report_heat(hand, np.arange(2000) * 1e-3, tau, ["finger_1", "finger_2"])
    model = ThermalModel(hand.drives)
    expected = model.at_rest()
    for _ in range(20):
        expected = model.step(expected, model.currents(tau[0]), 0.1)
    np.testing.assert_allclose(report.temperatures.winding, expected.winding, rtol=1e-12)
    np.testing.assert_allclose(report.hold_times, model.hold_times(expected, tau[0]), rtol=1e-9)
    assert report.finger == "finger_2"


def test_report_names_no_finger_under_loads_for_ever_and_needs_thermal_data() -> None:
    hand = load("four_finger").with_drives(DRIVE)
    report = report_heat(hand, [0.0, 0.1], np.full((2, hand.n), 0.01), ["finger_1"])
    assert report.finger is None
    assert np.isinf(report.hold_times).all()
    assert report_heat(load("four_finger"), [0.0], np.zeros((1, hand.n)), ["finger_1"]) is None
    with pytest.raises(InvalidInput, match="t = "):
        report_heat(hand, [], np.zeros((0, hand.n)), ["finger_1"])


def test_shipped_thermal_data_agree_with_the_published_continuous_values() -> None:
    """Barrett: 36.7 mN·m at 17.7 mN·m/A. LEAP: 0.6 A."""
    for name, expected in (("barrett", 0.0367 / 0.0177), ("leap_right", 0.6)):
        model = ThermalModel(load(name).drives)
        np.testing.assert_allclose(model.currents(model.continuous_torques()), expected, rtol=0.01)
