"""Gains from sensors: margins against known answers, and against the simulated loop with the joint filter."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
import pytest

from graspforce.control import ControlSettings
from graspforce.control.friction.friction_compensation import FrictionSettings
from graspforce.control.sensor_gains import LoopGains, LoopTargets, fastest_loop, loop_margins
from graspforce.core.errors import InvalidInput
from graspforce.estimation.joints.joint_filter import JointFilter
from graspforce.estimation.sensor_model import SensorModel
from graspforce.estimation.settings import EstimatorSettings
from graspforce.hand.drives.drive import Drive, Drives

DT = 1e-3  # s
NOISY = SensorModel(encoder_noise=1e-3)
LATE = SensorModel(encoder_noise=1e-3, latency=5e-3)
WITH_RATES = SensorModel(encoder_noise=1e-3, has_velocity=True, velocity_noise=0.02)


def simulate_loop(sensors: SensorModel, gains: LoopGains, steps: int, joints: int, extra_delay: int, noise: bool):
    """Return positions and commands (steps, joints) of double integrators with the joint filter, from 1 mrad at rest."""
    rng = np.random.default_rng(0)
    joint_filter = JointFilter(joints, sensors, EstimatorSettings(), DT)
    q, v, sum_q, a = np.full(joints, 0.0 if noise else 1e-3), np.zeros(joints), np.zeros(joints), np.zeros(joints)
    delay = joint_filter.delay + extra_delay
    past = deque([(q, v)] * (delay + 1), maxlen=delay + 1)
    memory = joint_filter.initial_memory(0.0, q, v if sensors.has_velocity else None)
    positions, commands = [], []
    for k in range(1, steps + 1):
        q, v = q + DT * v + 0.5 * DT**2 * a, v + DT * a
        past.append((q, v))
        y, y_rate = past[0]
        if noise:
            y = y + sensors.encoder_noise * rng.standard_normal(joints)
            y_rate = y_rate + sensors.velocity_noise * rng.standard_normal(joints)
        estimate, memory = joint_filter.step(memory, k * DT, y, y_rate if sensors.has_velocity else None, a)
        a = -gains.kp * estimate[0] - gains.kd * estimate[1] - gains.ki * sum_q
        sum_q = sum_q + DT * estimate[0]
        positions.append(q)
        commands.append(a)
    return np.array(positions), np.array(commands)


def test_slow_loop_has_the_margin_of_a_continuous_double_pole() -> None:
    """(2ωs + ω²)/s² has its crossover at ω √(2 + √5) and the margin atan 2√(2 + √5) = 76.35°; the hold takes ω_c T/2."""
    rate = 5.0
    margins = loop_margins(SensorModel(has_velocity=True), LoopGains.critically_damped(rate, 0.0), DT)
    crossover = rate * math.sqrt(2.0 + math.sqrt(5.0))
    assert margins.crossover == pytest.approx(crossover, rel=2e-3)
    expected = math.degrees(math.atan(2.0 * crossover / rate) - 0.5 * crossover * DT)
    assert margins.phase_margin == pytest.approx(expected, abs=0.3)  # the filter of nearly perfect sensors takes the rest
    assert margins.delay_margin == pytest.approx(math.radians(margins.phase_margin) / margins.crossover, rel=1e-3)


@pytest.mark.parametrize("sensors", [NOISY, LATE, WITH_RATES])
@pytest.mark.parametrize("rate", [20.0, 60.0])
def test_simulated_loop_is_stable_up_to_the_delay_margin(sensors: SensorModel, rate: float) -> None:
    """Two periods less decay, two periods more grow; a period at the margin changes the phase by ω_c T."""
    gains = LoopGains.critically_damped(rate, 0.0)
    periods = loop_margins(sensors, gains, DT).delay_margin / DT
    steps = 4000

    def growth(extra: int) -> float:
        q, _ = simulate_loop(sensors, gains, steps, 1, extra, noise=False)
        return float(np.abs(q[-steps // 4 :]).max() / np.abs(q[steps // 2 : -steps // 4]).max())

    assert growth(math.floor(periods) - 2) < 1.0
    assert growth(math.ceil(periods) + 2) > 1.0


@pytest.mark.parametrize("sensors", [NOISY, LATE, WITH_RATES])
def test_noise_is_that_of_the_simulated_loop(sensors: SensorModel) -> None:
    """500 joints for 1 s after 1 s of transient: some 500·20 independent samples, a standard error of 1 %."""
    gains = LoopGains.critically_damped(40.0, 5.0)
    margins = loop_margins(sensors, gains, DT)
    q, a = (values[1000:] for values in simulate_loop(sensors, gains, 2000, 500, 0, noise=True))
    assert np.sqrt(np.square(a).mean()) == pytest.approx(margins.acceleration_noise, rel=0.04)
    assert np.sqrt(np.square(q).mean()) == pytest.approx(margins.position_noise, rel=0.06)


def test_unstable_loop_has_no_margins() -> None:
    margins = loop_margins(NOISY, LoopGains(1600.0, 0.0, 0.0), DT)  # no damping
    assert (margins.phase_margin, margins.delay_margin, margins.acceleration_noise) == (0.0, 0.0, math.inf)


@pytest.mark.parametrize(
    "sensors", [SensorModel(), NOISY, LATE, WITH_RATES, SensorModel(latency=0.02), SensorModel(rate=100.0)]
)
def test_fastest_loop_meets_the_targets_and_a_faster_one_does_not(sensors: SensorModel) -> None:
    targets = LoopTargets(largest_rate=200.0)
    gains, margins = fastest_loop(sensors, DT, targets)
    assert margins.meets(targets)
    assert margins == loop_margins(sensors, gains, DT)
    if margins.rate < targets.largest_rate:
        faster = LoopGains.critically_damped(1.05 * margins.rate, min(targets.integral, margins.rate / 8.0))
        assert not loop_margins(sensors, faster, DT).meets(targets)


def test_worse_sensors_give_slower_gains() -> None:
    def rate(**sensor: float) -> float:
        return fastest_loop(SensorModel(**sensor), DT)[1].rate

    for name, values in (("encoder_noise", (0.0, 3e-4, 1e-3, 3e-3)), ("latency", (0.0, 5e-3, 2e-2, 5e-2))):
        rates = [rate(**{name: value}) for value in values]
        assert rates == sorted(rates, reverse=True)
        assert rates[-1] < 0.5 * rates[0]


def test_unreachable_targets_are_refused() -> None:
    with pytest.raises(InvalidInput, match="sensors"):
        fastest_loop(SensorModel(encoder_noise=0.1), DT, LoopTargets(acceleration_noise=0.01))
    for name in ("phase_margin", "largest_rate", "acceleration_noise"):
        with pytest.raises(InvalidInput, match=name):
            LoopTargets(**{name: 0.0})


def test_settings_for_sensors_have_the_gains_and_keep_the_rest() -> None:
    base = ControlSettings(slip_margin=1.5, friction=FrictionSettings())
    settings, margins = ControlSettings.for_sensors(LATE, base)
    gains, expected = fastest_loop(LATE, base.period)
    assert margins == expected
    assert (settings.gains.kp_linear, settings.gains.kd_angular, settings.gains.ki_linear) == gains
    assert settings.slip_margin == 1.5
    assert math.sqrt(settings.posture_stiffness) <= 0.5 * margins.rate
    assert settings.posture_damping == pytest.approx(2.0 * math.sqrt(settings.posture_stiffness))
    assert settings.friction is not None
    assert settings.friction.rest_tolerance_angular == pytest.approx(max(5e-4, 4.0 * margins.position_noise))


def test_exact_sensors_allow_faster_gains_than_the_default() -> None:
    settings, margins = ControlSettings.for_sensors(SensorModel())
    assert settings.gains.kp_linear > ControlSettings().gains.kp_linear
    assert margins.phase_margin > 60.0


def test_gains_allow_for_delay_and_rate_of_the_drives() -> None:
    """A delay counts as one of the sensors. Rare set-points raise the required delay margin by half their hold."""
    sensors, targets = SensorModel(encoder_noise=1e-4), LoopTargets()
    late = ControlSettings.for_sensors(sensors, drives=Drives((Drive(delay=4e-3), Drive())))
    same = ControlSettings.for_sensors(SensorModel(encoder_noise=1e-4, latency=4e-3))
    assert late.margins == same.margins
    assert ControlSettings.for_sensors(sensors, drives=Drives.ideal(2)).margins == ControlSettings.for_sensors(sensors).margins
    rates = []
    for rate in (1000.0, 200.0, 90.0, 40.0):
        margins = ControlSettings.for_sensors(sensors, drives=Drives((Drive(rate=rate), Drive()))).margins
        assert margins.delay_margin >= targets.delay_margin + 0.5 * (1.0 / rate - DT)
        rates.append(margins.rate)
    assert rates == sorted(rates, reverse=True)
    assert rates[-1] < 0.5 * rates[0]
