"""Joint-space laws: published results, Lyapunov functions, error dynamics, orders of convergence, anti-windup."""

from __future__ import annotations

from math import log, pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal
from scipy.integrate import solve_ivp
from support.hand_closed_forms import (
    ANTHROPOMORPHIC15_DYNAMICS_LENGTHS,
    ANTHROPOMORPHIC15_PRINTED_CENTRES,
    anthropomorphic15_torques,
)
from support.hands import SHIPPED_HANDS, load, random_posture

from graspforce.control.joint_laws import (
    ForceGains,
    JointMotion,
    PDGains,
    PIDGains,
    PIDMemory,
    TorqueReading,
    computed_torque,
    force_step,
    pd_gravity,
    pid,
    pid_step,
)
from graspforce.core.errors import InvalidInput
from graspforce.hand.motor import MotorModel

G = np.array([1.0, -4.0, -8.9])  # m/s², gravity in a general direction


def acceleration(mechanism, q, v, tau, g) -> np.ndarray:
    """Return the forward dynamics M⁻¹ (tau − c − g)."""
    rest = np.zeros_like(q)
    M = np.transpose([mechanism.inverse_dynamics(q, rest, e, np.zeros(3)) for e in np.eye(len(q))])
    return np.linalg.solve(M, tau - mechanism.inverse_dynamics(q, v, rest, g))


def follow(mechanism, law, q, v, times, g=G, rtol=1e-9, method="DOP853"):
    """Return (q, v) at the times under ``law(t, q, v) -> tau``, (len(times), 2, n)."""
    n = len(q)

    def rates(t, x):
        return np.concatenate([x[n:], acceleration(mechanism, x[:n], x[n:], law(t, x[:n], x[n:]), g)])

    run = solve_ivp(rates, (0.0, times[-1]), np.concatenate([q, v]), method=method, t_eval=times, rtol=rtol, atol=1e-3 * rtol)
    assert run.success, run.message
    return run.y.T.reshape(len(times), 2, n)


# ── PD with gravity compensation: the finger of the digital-twin hand study ───────────────────────────────────────────────────


class StudyFinger:
    """Finger of the study in the angles of its dynamics, eqs. (16)–(18) corrected; c_i and l_i as printed in section 4.3.

    Gravity points along the x axis of F: the finger hangs at q1 = 0 and is horizontal at q1 = π/2.
    """

    def gravity_torque(self, q, gravity_H):
        return self.inverse_dynamics(q, np.zeros(3), np.zeros(3), gravity_H)

    def inverse_dynamics(self, q, v, a, gravity_H):
        return anthropomorphic15_torques(
            q, v, a, gravity_H[0], ANTHROPOMORPHIC15_DYNAMICS_LENGTHS, ANTHROPOMORPHIC15_PRINTED_CENTRES
        )


STUDY_GRAVITY = np.array([9.81, 0.0, 0.0])  # m/s², in F
STUDY_GAINS = PDGains([70.0, 45.0, 20.0], [70.0, 40.0, 20.0])  # N·m/rad, N·m·s/rad: section 4.3
STUDY_GOALS = np.array([pi / 2, 5 * pi / 9, 7 * pi / 18])  # rad
BAND = 0.0025  # of the step: the band that gives the reported settling time of about 6 s
STUDY_SETTLING = log(1 / BAND) * STUDY_GAINS.kv / STUDY_GAINS.kp  # s
STUDY_STEPS = [*np.diag(STUDY_GOALS), STUDY_GOALS]  # each joint alone, and all together


def settling_times(q, goal, times):
    """Return when each moving joint stays in the band, s."""
    outside = np.abs(q - goal) > BAND * np.abs(goal - q[0])
    return [times[np.flatnonzero(column)[-1] + 1] for column in outside.T[goal != q[0]]]


@pytest.mark.parametrize("goal", STUDY_STEPS, ids=["first", "second", "third", "all"])
def test_pd_gravity_settles_as_the_study_reports(goal):
    """The study reports about 6 s for every joint: e^(−Kp/Kv t) enters the band of 0.25 % at 5.991, 5.326 and 5.991 s.

    The gains are so large for a finger of 55 g (Kv/M is about 10⁵ 1/s) that inertia contributes only 1e-4 s.
    """
    np.testing.assert_allclose(STUDY_SETTLING, [5.991, 5.326, 5.991], atol=5e-4)
    # The published times 5.985, 5.321 and 5.985 s belong to a band that also rounds to 0.25 %.
    band = np.exp(-np.array([5.985, 5.321, 5.985]) * STUDY_GAINS.kp / STUDY_GAINS.kv)
    np.testing.assert_allclose(band, 0.002515, atol=3e-6)
    times = np.linspace(0.0, 7.0, 35_001)
    finger, goal_motion = StudyFinger(), JointMotion(goal)

    def law(t, q, v):
        return pd_gravity(STUDY_GAINS, finger, JointMotion(q, v), goal_motion, STUDY_GRAVITY).tau

    q = follow(finger, law, np.zeros(3), np.zeros(3), times, STUDY_GRAVITY, rtol=1e-7, method="Radau")[:, 0]
    settled = settling_times(q, goal, times)
    np.testing.assert_allclose(settled, STUDY_SETTLING[goal != 0.0], atol=6e-4)  # the grid of 2e-4 s, and inertia
    late = times > 0.01
    decay = goal * np.exp(-np.outer(times[late], STUDY_GAINS.kp / STUDY_GAINS.kv))
    np.testing.assert_allclose(goal - q[late], decay, atol=2e-4)  # rad
    assert (q <= goal + 1e-4).all()  # rad: no overshoot, and resting joints stay


def test_back_emf_acts_as_additional_damping():
    """Without a current loop the motor adds the damping k² N²/R: the error decays as e^(−Kp/(Kv + k² N²/R) t)."""
    motors = MotorModel(np.full(3, 100.0), 0.02, [0.2, 0.16, 0.1], 1e6, amplifier="voltage")
    damping = np.array([20.0, 25.0, 40.0])  # N·m·s/rad, (N k)²/R
    finger, goal_motion, times = StudyFinger(), JointMotion(STUDY_GOALS), np.linspace(0.0, 20.0, 20_001)

    def law(t, q, v):
        tau = pd_gravity(STUDY_GAINS, finger, JointMotion(q, v), goal_motion, STUDY_GRAVITY).tau
        return motors.step(np.zeros(3), tau, v, 1e-3).tau  # without inductance the current has no memory

    q = follow(finger, law, np.zeros(3), np.zeros(3), times, STUDY_GRAVITY, rtol=1e-7, method="Radau")[:, 0]
    settled = settling_times(q, STUDY_GOALS, times)
    np.testing.assert_allclose(
        settled, log(1 / BAND) * (STUDY_GAINS.kv + damping) / STUDY_GAINS.kp, atol=2e-3
    )  # the grid of 1e-3 s


def test_the_torques_of_the_study_are_gravity_torques_not_step_torques():
    """The study reports largest torques of 0.059, 0.037 and 0.018 N·m for steps to 90°, 100° and 70° with these gains.

    The law gives Kp q_d at the start of a step, about two thousand times as much. The reported values are close to the gravity
    term of a straight horizontal finger with the printed c_i: 0.0596, 0.0376 and 0.0168 N·m. The first two are the largest
    during the steps. The third joint's step of 70° ends at 0.0158. Its reported 0.018 exceeds the largest possible gravity
    torque of that joint, m3 c3 g = 0.0168.
    """
    finger, rest = StudyFinger(), JointMotion(np.zeros(3))
    first = [pd_gravity(STUDY_GAINS, finger, rest, JointMotion(goal), STUDY_GRAVITY).tau for goal in STUDY_STEPS]
    np.testing.assert_allclose(np.diag(first), [110.0, 78.5, 24.4], atol=0.05)  # N·m, to the printed digits
    np.testing.assert_allclose(first[3], np.diag(first), rtol=1e-12)

    level = JointMotion([pi / 2, 0.0, 0.0])
    tau = pd_gravity(STUDY_GAINS, finger, level, level, STUDY_GRAVITY).tau
    np.testing.assert_allclose(np.abs(tau), [0.0596, 0.0376, 0.0168], atol=5e-5)

    paths = [np.linspace(0.0, 1.0, 200)[:, None] * goal for goal in STUDY_STEPS[:3]]  # quasi-static
    largest = [np.abs([finger.gravity_torque(q, STUDY_GRAVITY) for q in path]).max(0) for path in paths]
    np.testing.assert_allclose(np.diag(largest), [0.0596, 0.0376, 0.0158], atol=5e-5)
    assert np.diag(largest)[2] < 0.015 * 0.114 * 9.81 < 0.018
    assert np.diag(first).min() > 1000 * 0.018


def test_the_anthropomorphic15_hand_settles_like_the_finger_of_the_study():
    """anthropomorphic15 has the study's finger in relative angles, with rotors and corrected lengths."""
    hand = load("anthropomorphic15")
    gains = PDGains(np.tile(STUDY_GAINS.kp, 5), np.tile(STUDY_GAINS.kv, 5))
    goal = hand.q_lower + 0.8 * (hand.q_upper - hand.q_lower)
    goal_motion, times = JointMotion(goal), np.linspace(0.0, 6.5, 13_001)

    def law(t, q, v):
        return pd_gravity(gains, hand, JointMotion(q, v), goal_motion, G).tau

    q = follow(hand, law, hand.q_lower, np.zeros(15), times, rtol=1e-6, method="Radau")[:, 0]
    settled = settling_times(q, goal, times)
    np.testing.assert_allclose(settled, np.tile(STUDY_SETTLING, 5), atol=1.5e-3)  # the grid of 5e-4 s, and inertia


# ── PD with gravity compensation: Lyapunov ────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_lyapunov_function_decreases_with_the_damping_power(name):
    """V = ½ vᵀMv + ½ eᵀKp e has V̇ = −vᵀ Kv v at any state; checked by differences along a second-order Taylor step."""
    hand, h = load(name), 1e-6
    rng = np.random.default_rng(3)
    gains = PDGains(rng.uniform(0.5, 2.0, hand.n), rng.uniform(0.01, 0.1, hand.n))
    goal = random_posture(hand, 1)

    def V(q, v):
        return v @ hand.mass_matrix(q) @ v / 2 + (goal - q) @ (gains.kp * (goal - q)) / 2

    for seed in range(5):
        q, v = random_posture(hand, seed), rng.normal(0.0, 2.0, hand.n)
        tau = pd_gravity(gains, hand, JointMotion(q, v), JointMotion(goal), G).tau
        a = acceleration(hand, q, v, tau, G)
        after, before = (V(q + s * v + s**2 / 2 * a, v + s * a) for s in (h, -h))
        rate = -v @ (gains.kv * v)
        assert (after - before) / (2 * h) == pytest.approx(rate, rel=1e-5)  # rounding is 1e-15/h, truncation h²
        assert rate < 0.0


def test_the_printed_lyapunov_function_of_the_study_increases():
    """Eq. (21) is kinetic plus potential energy, which increases when a finger is lifted. With ½ eᵀKp e for U it decreases."""
    hand = load("anthropomorphic15")
    gains = PDGains(np.full(15, 0.5), np.full(15, 0.02))
    down = np.array([0.0, 0.0, 9.81])  # palm down: stretching lifts the fingers
    start, goal = hand.q_upper, JointMotion(hand.q_lower)
    times = np.linspace(0.0, 1.5, 301)

    def law(t, q, v):
        return pd_gravity(gains, hand, JointMotion(q, v), goal, -down).tau

    path = follow(hand, law, start, np.zeros(15), times, -down)
    V = [hand.energy(q, v)[0] + (goal.q - q) @ (gains.kp * (goal.q - q)) / 2 for q, v in path]
    assert (np.diff(V) < 1e-9).all()
    assert V[-1] < 1e-4 * V[0]
    printed = np.array([sum(hand.energy(q, v, -down)) for q, v in path])
    assert np.diff(printed).max() > 1e-4  # J, in one step of 5 ms


# ── computed torque ───────────────────────────────────────────────────────────────────────────────────────────────────────────


def oscillator_error(kp, kv, e, e_rate, t):
    """Return e of ë + kv ė + kp e = 0 at the times t, by the two roots of each joint's polynomial."""
    roots = np.array([np.roots([1.0, d, s]) for s, d in zip(kp, kv, strict=True)], dtype=complex).T
    parts = np.array([(e_rate - roots[1] * e), -(e_rate - roots[0] * e)]) / (roots[0] - roots[1])
    return sum(part * np.exp(np.outer(t, root)) for part, root in zip(parts, roots, strict=True)).real


@pytest.mark.parametrize("name", ["dlr_hit2", "four_finger"])
def test_computed_torque_decouples_the_joint_errors(name):
    """ë + Kv ė + Kp e = 0 holds exactly along a moving path: couplings and inertia cancel."""
    hand = load(name)
    rng = np.random.default_rng(5)
    gains = PDGains(rng.uniform(50.0, 400.0, hand.n), rng.uniform(5.0, 60.0, hand.n))  # under- and overdamped
    middle, half, w = (hand.q_upper + hand.q_lower) / 2, (hand.q_upper - hand.q_lower) / 4, rng.uniform(2.0, 5.0, hand.n)

    def path(t):
        return JointMotion(
            middle + half * np.sin(w * t), half * w * np.cos(w * t), -half * w**2 * np.sin(w * t)
        )  # rad, rad/s, rad/s²

    def law(t, q, v):
        return computed_torque(gains, hand, JointMotion(q, v), path(t), G).tau

    times = np.linspace(0.0, 0.5, 51)
    e, e_rate = rng.normal(0.0, 0.2, hand.n), rng.normal(0.0, 1.0, hand.n)
    moved = follow(hand, law, path(0.0).q - e, path(0.0).v - e_rate, times, rtol=1e-10)
    errors = np.array([path(t).q for t in times]) - moved[:, 0]
    np.testing.assert_allclose(
        errors, oscillator_error(gains.kp, gains.kv, e, e_rate, times), atol=1e-8
    )  # rad, from the integrator
    assert np.abs(errors[25]).max() > 1e-3  # the test is not trivial


def test_computed_torque_converges_with_saturated_motors():
    """The study's chain: torques within ±0.5 N·m, H-bridge, motor. A large step saturates the motors and still converges.

    The dual-platform study of the DLR-HIT II hand gives neither gains nor windings nor numeric results. Its torque limits are
    those of the shipped hand.
    """
    hand = load("dlr_hit2")
    np.testing.assert_array_equal(hand.torque_upper, 0.5)
    gains = PDGains(np.full(15, 1600.0), np.full(15, 80.0))
    motors = MotorModel.for_hand(hand)
    goal = hand.q_lower + np.tile([0.6, 0.9, 0.9], 5) * (hand.q_upper - hand.q_lower)
    goal_motion, limits = JointMotion(goal), (hand.torque_lower, hand.torque_upper)
    q, v, current, dt, saturated_count = np.zeros(15), np.zeros(15), np.zeros(15), 1e-3, 0
    for _ in range(1000):
        command = computed_torque(gains, hand, JointMotion(q, v), goal_motion, G, limits)
        step = motors.step(current, command.tau, v, dt)
        current = step.current
        saturated_count += int(np.abs(command.saturated).sum())
        assert np.abs(step.tau).max() <= 0.5 + 1e-12
        a = acceleration(hand, q, v, step.tau, G)
        q, v = q + dt * v + dt**2 / 2 * a, v + dt * a
    assert saturated_count > 50
    np.testing.assert_allclose(q, goal, atol=1e-4)
    np.testing.assert_allclose(step.tau, hand.gravity_torque(goal, G), atol=1e-4)


def test_sampled_computed_torque_has_errors_of_first_order_in_the_period():
    """The dual-platform study closes its hand smoothly and precisely.

    At 1 kHz, with all fingers closing in one second, errors stay below 1e-4 rad and torques far within ±0.5 N·m.
    Half the period halves the errors.
    """
    hand, gains = load("dlr_hit2"), PDGains(np.full(15, 1600.0), np.full(15, 80.0))
    motors, limits, far = MotorModel.for_hand(hand), (hand.torque_lower, hand.torque_upper), 0.8 * (hand.q_upper - hand.q_lower)

    def path(t):
        w = pi  # rad/s
        return JointMotion(far / 2 * (1 - np.cos(w * t)), far / 2 * w * np.sin(w * t), far / 2 * w**2 * np.cos(w * t))

    largest = []
    for dt in (1e-3, 5e-4):
        q, v, current, errors = np.zeros(15), np.zeros(15), np.zeros(15), []
        for k in range(round(1.0 / dt)):
            command = computed_torque(gains, hand, JointMotion(q, v), path(k * dt), G, limits)
            step = motors.step(current, command.tau, v, dt)
            current = step.current
            a = acceleration(hand, q, v, step.tau, G)
            q, v = q + dt * v + dt**2 / 2 * a, v + dt * a
            errors.append(np.abs(path((k + 1) * dt).q - q).max())
            assert np.abs(step.tau).max() < 0.1
        largest.append(max(errors))
    assert largest[0] < 1e-4
    assert largest[0] / largest[1] == pytest.approx(2.0, rel=0.1)


# ── PID ───────────────────────────────────────────────────────────────────────────────────────────────────────────────────────

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


# ── the force loop ────────────────────────────────────────────────────────────────────────────────────────────────────────────

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
        tau_g = hand.gravity_torque(q, G)
        command, integral = force_step(gains, integral, J.T @ f_desired, TorqueReading(J.T @ f, v), dt, tau_g, limits)
        tau = np.array(command.tau)
        tau[others] = tau_g[others]  # the other fingers stay at rest
        bias = np.where(np.isin(np.arange(12), chosen), unknown, 0.0)
        a = acceleration(hand, q, v, tau + bias - J.T @ f, G)
        v = v + dt * a
        q = q + dt * v
    np.testing.assert_allclose(f, f_desired, atol=1e-4)


# ── invalid input ─────────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_invalid_gains_and_measurements_are_named():
    with pytest.raises(InvalidInput, match=r"kp\[1\] = 0.0: must be greater than 0"):
        PDGains([1.0, 0.0], [1.0, 1.0])
    with pytest.raises(InvalidInput, match=r"kd\[0\] = -1.0: must be at least 0"):
        PIDGains([1.0], [0.0], [-1.0])
    with pytest.raises(InvalidInput, match=r"ki = .* a list of 1 numbers, not 2"):
        ForceGains([1.0], [0.0, 1.0], [0.0])
    with pytest.raises(InvalidInput, match=r"tau_i = .* greater than 0"):
        PIDGains.from_times([1.0], [0.0], [0.0])
    with pytest.raises(InvalidInput, match=r"measured.q = .* a list of 3 numbers, not 2"):
        pd_gravity(STUDY_GAINS, StudyFinger(), JointMotion([0.0, 0.0]), JointMotion(np.zeros(3)), STUDY_GRAVITY)
    with pytest.raises(InvalidInput, match=r"dt = 0"):
        pid_step(TERMS, PIDMemory.initial([0.0, 0.0]), [0.0, 0.0], 0.0)
    with pytest.raises(InvalidInput, match=r"limits\[0\]\[1\] = 0.5: must be at most limits\[1\]\[1\], which is 0.4"):
        pid_step(TERMS, PIDMemory.initial([0.0, 0.0]), [0.0, 0.0], 1e-3, limits=([-1.0, 0.5], [1.0, 0.4]))
    with pytest.raises(InvalidInput, match=r"v = "):
        JointMotion([0.0, 0.0], [1.0])
