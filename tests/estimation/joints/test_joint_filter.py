"""The joint filter is exact on its model, consistent on noise, and equal to a textbook Kalman filter."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg, stats

from graspforce.core.errors import InvalidInput
from graspforce.estimation import EstimatorSettings, SensorModel
from graspforce.estimation.joints import joint_filter
from graspforce.estimation.joints.joint_filter import JointFilter

PERIOD = 1e-3  # s
F = np.array([[1.0, PERIOD, PERIOD**2 / 2], [0.0, 1.0, PERIOD], [0.0, 0.0, 1.0]])
G = np.array([PERIOD**2 / 2, PERIOD, 0.0])


def run(joints, measured, commands, v0=None, v=None):
    """Return all states (K, 3, n) of the filter."""
    memory = joints.initial_memory(0.0, measured[0], v0)
    states = []
    for k in range(1, len(measured)):
        rates = None if v is None else v[k]
        state, memory = joints.step(memory, k * PERIOD, measured[k], rates, commands[k - 1])
        states.append(state)
    return np.array(states), memory


def simulate(commands, disturbance, x0, q_noise=0.0, rng=None):
    """Return true states (K, 3, n) of joints under commands constant in each period."""
    x, states = np.array(x0), [np.array(x0)]
    for a in commands:
        x = F @ x + np.outer(G, a)
        if disturbance is not None:
            x = x + disturbance(rng)
        states.append(x)
    return np.array(states)


def test_a_commanded_motion_without_noise_is_exact():
    rng = np.random.default_rng(0)
    commands = rng.normal(size=(300, 4)) * 20.0
    true = simulate(commands, None, [rng.normal(size=4), rng.normal(size=4), np.zeros(4)])
    joints = JointFilter(4, SensorModel(encoder_noise=1e-3), EstimatorSettings(), PERIOD)
    states, _ = run(joints, true[:, 0], commands, v0=true[0, 1])
    np.testing.assert_allclose(states, true[1:], rtol=0.0, atol=1e-9)  # rounding of about 300 steps with gains up to 1e3


def test_a_constant_disturbance_is_found():
    """After several time constants the rates have no lag, and the disturbance is that of the joints."""
    d = np.array([50.0, -20.0])
    true = simulate(np.zeros((1500, 2)), None, [np.zeros(2), np.zeros(2), d])
    joints = JointFilter(2, SensorModel(encoder_noise=1e-4), EstimatorSettings(), PERIOD)
    states, _ = run(joints, true[:, 0], np.zeros((1500, 2)))
    np.testing.assert_allclose(states[-1, 2], d, rtol=1e-6)
    np.testing.assert_allclose(states[-1, 1], true[-1, 1], atol=1e-6)


@pytest.mark.parametrize("has_velocity", [False, True])
def test_errors_are_as_large_as_the_covariance_says(has_velocity):
    """The normalised squared errors of independent joints follow a chi-square distribution at every time."""
    settings = EstimatorSettings(acceleration_noise=2.0, disturbance_noise=200.0, initial_rate_error=0.1)
    sensors = SensorModel(encoder_noise=5e-4, has_velocity=has_velocity, velocity_noise=0.05)
    n, K, rng = 400, 120, np.random.default_rng(1)
    T, q1, q2 = PERIOD, settings.acceleration_noise**2, settings.disturbance_noise**2
    white = q1 * np.array([[T**3 / 3, T**2 / 2, 0.0], [T**2 / 2, T, 0.0], [0.0, 0.0, 0.0]])
    walk = q2 * np.array([[T**5 / 20, T**4 / 8, T**3 / 6], [T**4 / 8, T**3 / 3, T**2 / 2], [T**3 / 6, T**2 / 2, T]])
    noise = np.linalg.cholesky(white + walk + 1e-30 * np.eye(3))
    start = [rng.normal(size=n), 0.1 * rng.normal(size=n), 10.0 * rng.normal(size=n)]
    true = simulate(np.zeros((K, n)), lambda rng: noise @ rng.normal(size=(3, n)), start, rng=rng)
    measured = true[:, 0] + 5e-4 * rng.normal(size=(K + 1, n))
    rates = true[:, 1] + 0.05 * rng.normal(size=(K + 1, n)) if has_velocity else None
    joints = JointFilter(n, sensors, settings, PERIOD)
    memory = joints.initial_memory(0.0, measured[0])  # at rest: the rates are known to 0.1 rad/s
    for k in range(1, K + 1):
        state, memory = joints.step(memory, k * PERIOD, measured[k], None if rates is None else rates[k], None)
        if k in (1, 5, 20, K):
            error = state - true[k]
            squares = (error * np.linalg.solve(joints.covariance(memory), error)).sum(axis=0)
            low, high = stats.chi2.ppf([1e-4, 1.0 - 1e-4], 3 * n)
            assert low < squares.sum() < high, k


def test_gains_converge_to_the_solution_of_the_riccati_equation():
    settings, sigma = EstimatorSettings(), 1e-3
    joints = JointFilter(1, SensorModel(encoder_noise=sigma), settings, PERIOD)
    T, q1, q2 = PERIOD, settings.acceleration_noise**2, settings.disturbance_noise**2
    Q = q1 * np.array([[T**3 / 3, T**2 / 2, 0.0], [T**2 / 2, T, 0.0], [0.0, 0.0, 0.0]])
    Q += q2 * np.array([[T**5 / 20, T**4 / 8, T**3 / 6], [T**4 / 8, T**3 / 3, T**2 / 2], [T**3 / 6, T**2 / 2, T]])
    H = np.array([[1.0, 0.0, 0.0]])
    before = linalg.solve_discrete_are(F.T, H.T, Q, [[sigma**2]])
    after = before - before @ H.T @ H @ before / (before[0, 0] + sigma**2)
    memory = joints.initial_memory(0.0, np.zeros(1))
    for k in range(1, 4001):
        _, memory = joints.step(memory, k * PERIOD, np.zeros(1), None, None)
    # steps whose covariance changes by less than 1e-6 end the table; the slowest mode decays by about 1e-1 a step or faster
    np.testing.assert_allclose(joints.covariance(memory), after, rtol=1e-3)


@pytest.mark.parametrize("delay", [1, 7, 20])
def test_known_commands_predict_the_present_exactly(delay):
    """With a latency of m periods, the estimate equals the state that the commands since then produce."""
    rng = np.random.default_rng(2)
    K, n = 200, 3
    commands = 10.0 * rng.normal(size=(K, n))
    true = simulate(commands, None, np.zeros((3, n)))
    joints = JointFilter(n, SensorModel(encoder_noise=1e-4, latency=delay * PERIOD), EstimatorSettings(), PERIOD)
    memory = joints.initial_memory(0.0, true[0, 0])
    for k in range(1, K):
        # the command of step k − 1 acts m periods later: the joints measured at step k have felt the one of step k − 1 − m
        felt = true[max(k - delay, 0), 0]
        state, memory = joints.step(memory, k * PERIOD, felt, None, commands[k - 1])
        np.testing.assert_allclose(state, true[k], atol=1e-9)


def test_missed_measurements_do_not_matter_on_a_known_motion():
    true = simulate(np.full((60, 1), 5.0), None, np.zeros((3, 1)))
    joints = JointFilter(1, SensorModel(encoder_noise=1e-3), EstimatorSettings(), PERIOD)
    memory = joints.initial_memory(0.0, true[0, 0])
    for k in (1, 2, 5, 6, 30, 31, 60):
        state, memory = joints.step(memory, k * PERIOD, true[k, 0], None, np.array([5.0]))
        np.testing.assert_allclose(state, true[k], atol=1e-10)


def test_after_a_long_gap_the_filter_starts_anew():
    joints = JointFilter(1, SensorModel(encoder_noise=1e-3), EstimatorSettings(), PERIOD)
    _, memory = joints.step(joints.initial_memory(0.0, np.zeros(1)), PERIOD, np.ones(1), None, None)
    state, memory = joints.step(memory, 10.0, np.array([2.0]), None, None)
    np.testing.assert_array_equal(state[:, 0], [2.0, 0.0, 0.0])
    assert memory.updates == 0


def test_the_same_measurement_again_changes_nothing_and_an_earlier_one_is_an_error():
    joints = JointFilter(1, SensorModel(encoder_noise=1e-3), EstimatorSettings(), PERIOD)
    memory = joints.initial_memory(1.0, np.ones(1))
    state, same = joints.step(memory, 1.0, np.ones(1), None, None)
    assert same is memory
    np.testing.assert_array_equal(state, memory.x)
    with pytest.raises(InvalidInput, match=r"measurement\.t"):
        joints.step(memory, 0.5, np.ones(1), None, None)


def test_commands_beyond_what_motors_can_do_are_cut_off():
    """A command of 1e9 rad/s² counts as the largest possible one."""
    estimates = []
    for command in (100.0, 1e9):
        joints = JointFilter(1, SensorModel(encoder_noise=1e-3), EstimatorSettings(), PERIOD, np.array([100.0]))
        memory = joints.initial_memory(0.0, np.zeros(1))
        state, _ = joints.step(memory, PERIOD, np.zeros(1), None, np.array([-command]))
        estimates.append(state)
    np.testing.assert_array_equal(*estimates)


@pytest.mark.parametrize("latency", [0.0, 1e-3, 3e-3])
@pytest.mark.parametrize("has_velocity", [False, True])
def test_compiled_updates_equal_the_reference(latency, has_velocity, monkeypatch):
    """With commands beyond their limits, periods without a measurement or a command, and measured rates."""
    if joint_filter.native is None:
        pytest.skip("the compiled module was not built: no C compiler at installation")
    rng, n = np.random.default_rng(9), 5
    sensors = SensorModel(encoder_noise=1e-4, has_velocity=has_velocity, velocity_noise=1e-2, latency=latency)
    joints = JointFilter(n, sensors, EstimatorSettings(), PERIOD, np.full(n, 2.0))
    measured = [(rng.normal(size=n), rng.normal(size=n) if k % 4 else None) for k in range(30)]
    commands = [3.0 * rng.normal(size=n) if k % 5 else None for k in range(30)]
    times = PERIOD * np.cumsum(rng.integers(1, 4, 30))
    results = []
    for native in (joint_filter.native, None):
        monkeypatch.setattr(joint_filter, "native", native)
        memory, states = joints.initial_memory(0.0, np.zeros(n)), []
        for t, (q, v), command in zip(times.tolist(), measured, commands, strict=True):
            state, memory = joints.step(memory, t, q, v, command)
            assert not memory.x.flags.writeable
            states.append(state)
        results.append(np.array(states))
    scale = np.abs(results[1]).max()
    np.testing.assert_allclose(results[0] / scale, results[1] / scale, rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("has_velocity", [False, True])
def test_positions_at_the_start_equal_those_of_least_squares(has_velocity):
    """Fixed-point smoothing gives the mean and the variance of the positions at the start, given all measurements."""
    settings, rng, count = EstimatorSettings(), np.random.default_rng(5), 8
    sensors = SensorModel(encoder_noise=1e-3, has_velocity=has_velocity, velocity_noise=0.01)
    joints = JointFilter(1, sensors, settings, PERIOD)
    q, v, commands = 1e-3 * rng.normal(size=count), 0.01 * rng.normal(size=count), 5.0 * rng.normal(size=count)
    memory = joints.initial_memory(0.0, q[:1], v[:1] if has_velocity else None)
    for k in range(1, count):
        rates = v[k : k + 1] if has_velocity else None
        _, memory = joints.step(memory, k * PERIOD, q[k : k + 1], rates, commands[k - 1 : k])
    rows, weights, values = prior_rows(q[0], v[0] if has_velocity else 0.0, count)
    for k in range(1, count):
        for measured, variance, axis in ((q[k], 1e-6, 0), (v[k], 1e-4, 1))[: 1 + has_velocity]:
            row = np.zeros((1, 3 * count))
            row[0, 3 * k + axis] = 1.0
            rows.append(row), weights.append(np.array([[1.0 / variance]])), values.append(np.array([measured]))
        step = np.zeros((3, 3 * count))
        step[:, 3 * k : 3 * k + 3], step[:, 3 * k - 3 : 3 * k] = np.eye(3), -F
        rows.append(step), weights.append(np.linalg.inv(joints._Q)), values.append(G * commands[k - 1])
    information = sum(row.T @ W @ row for row, W in zip(rows, weights, strict=True))
    score = sum(row.T @ W @ value for row, W, value in zip(rows, weights, values, strict=True))
    scale = 1.0 / np.sqrt(np.diag(information))  # equilibrates: entries differ by a factor of 1e18
    inverse = scale[:, None] * np.linalg.inv(scale[:, None] * information * scale) * scale
    assert memory.start[0] == pytest.approx((inverse @ score)[0], rel=1e-5, abs=1e-9)
    assert joints.start_variance(memory) == pytest.approx(inverse[0, 0], rel=1e-5)


def prior_rows(q, v, count):
    """Return rows, weights and values of least squares for the state at the first measurement."""
    row = np.zeros((3, 3 * count))
    row[:, :3] = np.eye(3)
    variances = np.array([1e-6, EstimatorSettings().initial_rate_error ** 2, joint_filter._DISTURBANCE_ERROR**2])
    return [row], [np.diag(1.0 / variances)], [np.array([q, v, 0.0])]
