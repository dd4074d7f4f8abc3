"""Joint-space laws: what 003 reports, Lyapunov's function, exact error dynamics, orders of convergence, no wind-up."""

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
    computed_torque,
    force_step,
    pd_gravity,
    pid,
    pid_step,
)
from graspforce.core.errors import InvalidInput
from graspforce.hand.motor import MotorModel

G = np.array([1.0, -4.0, -8.9])  # m/s², gravity askew


def acceleration(mechanism, q, v, tau, g) -> np.ndarray:
    """Forward dynamics: M⁻¹ (tau − c − g)."""
    rest = np.zeros_like(q)
    M = np.transpose([mechanism.inverse_dynamics(q, rest, e, np.zeros(3)) for e in np.eye(len(q))])
    return np.linalg.solve(M, tau - mechanism.inverse_dynamics(q, v, rest, g))


def follow(mechanism, law, q, v, times, g=G, rtol=1e-9, method="DOP853"):
    """The mechanism under ``law(t, q, v) -> tau``: (q, v) at the times, (len(times), 2, n)."""
    n = len(q)

    def rates(t, x):
        return np.concatenate([x[n:], acceleration(mechanism, x[:n], x[n:], law(t, x[:n], x[n:]), g)])

    run = solve_ivp(rates, (0.0, times[-1]), np.concatenate([q, v]), method=method, t_eval=times, rtol=rtol, atol=1e-3 * rtol)
    assert run.success, run.message
    return run.y.T.reshape(len(times), 2, n)


# ── 003: a finger under PD with gravity compensation ──────────────────────────────────────────────────────────────────────────


class Finger003:
    """The finger of 003 in its dynamics' own angles, (16)–(18) mended; c_i and l_i as section 4.3 prints them.

    Its gravity lies along F's x axis, so a finger with q1 = 0 hangs, and one with q1 = π/2 is level.
    """

    def gravity_torque(self, q, gravity_H):
        return self.inverse_dynamics(q, np.zeros(3), np.zeros(3), gravity_H)

    def inverse_dynamics(self, q, v, a, gravity_H):
        return anthropomorphic15_torques(
            q, v, a, gravity_H[0], ANTHROPOMORPHIC15_DYNAMICS_LENGTHS, ANTHROPOMORPHIC15_PRINTED_CENTRES
        )


GRAVITY_003 = np.array([9.81, 0.0, 0.0])  # m/s², in F
GAINS_003 = PDGains([70.0, 45.0, 20.0], [70.0, 40.0, 20.0])  # N·m/rad, N·m·s/rad: section 4.3
GOALS_003 = np.array([pi / 2, 5 * pi / 9, 7 * pi / 18])  # rad
BAND = 0.0025  # of the step: the band in which "about 6 s" is a settling time of these gains
SETTLED_003 = log(1 / BAND) * GAINS_003.kv / GAINS_003.kp  # s
STEPS_003 = [*np.diag(GOALS_003), GOALS_003]  # each joint by itself, and all together


def settling_times(q, goal, times):
    """When each joint that has to move enters the band for good, s."""
    outside = np.abs(q - goal) > BAND * np.abs(goal - q[0])
    return [times[np.flatnonzero(column)[-1] + 1] for column in outside.T[goal != q[0]]]


@pytest.mark.parametrize("goal", STEPS_003, ids=["first", "second", "third", "all"])
def test_the_finger_of_003_settles_as_reported_and_its_gains_alone_say_when(goal):
    """003 reports about 6 s for every joint. Kp/Kv decides: e^(−Kp/Kv t) enters 0.25 % at 5.991, 5.326 and 5.991 s.

    The gains are so large for a finger of 55 g (Kv/M is some 10⁵ 1/s) that inertia does not show: 1e-4 s of what follows.
    """
    np.testing.assert_allclose(SETTLED_003, [5.991, 5.326, 5.991], atol=5e-4)
    # The figures known for these gains, 5.985, 5.321 and 5.985 s, are those of a band that two digits write as 0.25 % too.
    band = np.exp(-np.array([5.985, 5.321, 5.985]) * GAINS_003.kp / GAINS_003.kv)
    np.testing.assert_allclose(band, 0.002515, atol=3e-6)
    times = np.linspace(0.0, 7.0, 35_001)
    finger, wanted = Finger003(), JointMotion(goal)

    def law(t, q, v):
        return pd_gravity(GAINS_003, finger, JointMotion(q, v), wanted, GRAVITY_003).tau

    q = follow(finger, law, np.zeros(3), np.zeros(3), times, GRAVITY_003, rtol=1e-7, method="Radau")[:, 0]
    settled = settling_times(q, goal, times)
    np.testing.assert_allclose(settled, SETTLED_003[goal != 0.0], atol=6e-4)  # a grid of 2e-4 s, and the inertia
    late = times > 0.01
    fading = goal * np.exp(-np.outer(times[late], GAINS_003.kp / GAINS_003.kv))
    np.testing.assert_allclose(goal - q[late], fading, atol=2e-4)  # rad
    assert (q <= goal + 1e-4).all()  # rad: no overshoot, and the joints that rest are hardly stirred


def test_back_emf_slows_the_settling_as_more_damping_would():
    """Without a current loop the motor brings k² N²/R of its own: the error fades as e^(−Kp/(Kv + k² N²/R) t)."""
    motors = MotorModel(np.full(3, 100.0), 0.02, [0.2, 0.16, 0.1], 1e6, drive="voltage")
    own = np.array([20.0, 25.0, 40.0])  # N·m·s/rad, (N k)²/R
    finger, wanted, times = Finger003(), JointMotion(GOALS_003), np.linspace(0.0, 20.0, 20_001)

    def law(t, q, v):
        asked = pd_gravity(GAINS_003, finger, JointMotion(q, v), wanted, GRAVITY_003).tau
        return motors.step(np.zeros(3), asked, v, 1e-3).tau  # without inductance no step remembers the one before

    q = follow(finger, law, np.zeros(3), np.zeros(3), times, GRAVITY_003, rtol=1e-7, method="Radau")[:, 0]
    settled = settling_times(q, GOALS_003, times)
    np.testing.assert_allclose(settled, log(1 / BAND) * (GAINS_003.kv + own) / GAINS_003.kp, atol=2e-3)  # a grid of 1e-3 s


def test_the_torques_that_003_reports_are_not_those_of_its_step():
    """003 reports largest torques of 0.059, 0.037 and 0.018 N·m for steps to 90°, 100° and 70° with these gains.

    The law itself gives Kp q_d at once, some two thousand times as much. What 003's figures come near to is the gravity term
    of the law: of a level finger, straight and with c_i taken literally, 0.0596, 0.0376 and 0.0168 N·m. The first two are the
    largest that the steps meet; the third joint's step of 70° from hanging ends at 0.0158, and 0.018 is beyond what gravity can
    ever ask of that joint, m3 c3 g = 0.0168.
    """
    finger, rest = Finger003(), JointMotion(np.zeros(3))
    first = [pd_gravity(GAINS_003, finger, rest, JointMotion(goal), GRAVITY_003).tau for goal in STEPS_003]
    np.testing.assert_allclose(np.diag(first), [110.0, 78.5, 24.4], atol=0.05)  # N·m, the digits given
    np.testing.assert_allclose(first[3], np.diag(first), rtol=1e-12)

    level = JointMotion([pi / 2, 0.0, 0.0])
    held = pd_gravity(GAINS_003, finger, level, level, GRAVITY_003).tau
    np.testing.assert_allclose(np.abs(held), [0.0596, 0.0376, 0.0168], atol=5e-5)

    along = [np.linspace(0.0, 1.0, 200)[:, None] * goal for goal in STEPS_003[:3]]  # as slowly as the settling has it
    largest = [np.abs([finger.gravity_torque(q, GRAVITY_003) for q in path]).max(0) for path in along]
    np.testing.assert_allclose(np.diag(largest), [0.0596, 0.0376, 0.0158], atol=5e-5)
    assert np.diag(largest)[2] < 0.015 * 0.114 * 9.81 < 0.018
    assert np.diag(first).min() > 1000 * 0.018


def test_the_shipped_hand_settles_like_the_finger_of_003():
    """anthropomorphic15 has 003's finger in relative angles, with rotors and mended lengths: the gains decide here too."""
    hand = load("anthropomorphic15")
    gains = PDGains(np.tile(GAINS_003.kp, 5), np.tile(GAINS_003.kv, 5))
    goal = hand.q_lower + 0.8 * (hand.q_upper - hand.q_lower)
    wanted, times = JointMotion(goal), np.linspace(0.0, 6.5, 13_001)

    def law(t, q, v):
        return pd_gravity(gains, hand, JointMotion(q, v), wanted, G).tau

    q = follow(hand, law, hand.q_lower, np.zeros(15), times, rtol=1e-6, method="Radau")[:, 0]
    settled = settling_times(q, goal, times)
    np.testing.assert_allclose(settled, np.tile(SETTLED_003, 5), atol=1.5e-3)  # a grid of 5e-4 s, and the inertia


# ── PD with gravity compensation: Lyapunov ────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("name", SHIPPED_HANDS)
def test_lyapunov_s_function_falls_at_the_rate_of_the_damping(name):
    """V = ½ vᵀMv + ½ eᵀKp e: V̇ = −vᵀ Kv v at any state, by differences along the motion's second-order Taylor step."""
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
        fall = -v @ (gains.kv * v)
        assert (after - before) / (2 * h) == pytest.approx(fall, rel=1e-5)  # rounding 1e-15/h, a step's cube beyond
        assert fall < 0.0


def test_the_energy_that_003_writes_as_its_lyapunov_function_rises():
    """(21) is K + U alone: a finger that is lifted gains it. With ½ eᵀKp e in place of U the same motion only loses."""
    hand = load("anthropomorphic15")
    gains = PDGains(np.full(15, 0.5), np.full(15, 0.02))
    down = np.array([0.0, 0.0, 9.81])  # the palm looks down: to stretch is to lift
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


def fading(kp, kv, e, e_rate, t):
    """e of ë + kv ė + kp e = 0 at the times t, by the two roots of each joint's polynomial."""
    roots = np.array([np.roots([1.0, d, s]) for s, d in zip(kp, kv, strict=True)], dtype=complex).T
    parts = np.array([(e_rate - roots[1] * e), -(e_rate - roots[0] * e)]) / (roots[0] - roots[1])
    return sum(part * np.exp(np.outer(t, root)) for part, root in zip(parts, roots, strict=True)).real


@pytest.mark.parametrize("name", ["dlr_hit2", "four_finger"])
def test_under_computed_torque_every_error_fades_as_its_own_oscillator(name):
    """ë + Kv ė + Kp e = 0 exactly, along a moving path, gravity askew: couplings (T) and inertia cancel."""
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
    np.testing.assert_allclose(errors, fading(gains.kp, gains.kv, e, e_rate, times), atol=1e-8)  # rad, the integrator's
    assert np.abs(errors[25]).max() > 1e-3  # the test is about something


def test_computed_torque_with_the_limits_of_002_still_arrives():
    """002's chain: torques within ±0.5 N·m, H-bridge, motor. A large step meets the limits, and ends where it should.

    002 gives neither gains nor windings, and no numbers of its results; its torque limits are the shipped hand's motors'.
    """
    hand = load("dlr_hit2")
    np.testing.assert_array_equal(hand.torque_upper, 0.5)
    gains = PDGains(np.full(15, 1600.0), np.full(15, 80.0))
    motors = MotorModel.for_hand(hand)
    goal = hand.q_lower + np.tile([0.6, 0.9, 0.9], 5) * (hand.q_upper - hand.q_lower)
    wanted, limits = JointMotion(goal), (hand.torque_lower, hand.torque_upper)
    q, v, current, dt, met = np.zeros(15), np.zeros(15), np.zeros(15), 1e-3, 0
    for _ in range(1000):
        command = computed_torque(gains, hand, JointMotion(q, v), wanted, G, limits)
        step = motors.step(current, command.tau, v, dt)
        current = step.current
        met += int(np.abs(command.saturated).sum())
        assert np.abs(step.tau).max() <= 0.5 + 1e-12
        a = acceleration(hand, q, v, step.tau, G)
        q, v = q + dt * v + dt**2 / 2 * a, v + dt * a
    assert met > 50
    np.testing.assert_allclose(q, goal, atol=1e-4)
    np.testing.assert_allclose(step.tau, hand.gravity_torque(goal, G), atol=1e-4)


def test_the_chain_of_002_follows_a_smooth_motion():
    """002 says of its closing hand that it moves smoothly and precisely. At 1 kHz, all fingers closing in a second, errors stay
    below 1e-4 rad and torques far within ±0.5 N·m; the errors are the sampling's: half the period leaves half of them.
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


def test_the_times_of_24_are_the_gains():
    np.testing.assert_allclose(TERMS.ki, [5.0, 0.7 / 1.1], rtol=1e-15)
    np.testing.assert_allclose(TERMS.kd, [0.1, 0.14], rtol=1e-15)


def test_the_sampled_law_is_the_filter_of_25():
    """K_p + K_ip/(1 − z⁻¹) + K_d (1 − z⁻¹) over one denominator, by a library's filter."""
    dt, e = 2e-3, np.random.default_rng(1).normal(size=(200, 2))
    memory, out = PIDMemory.initial([0.0, 0.0]), []
    for row in e:
        command, memory = pid_step(TERMS, memory, row, dt)
        out.append(command.tau)
    for j in range(2):
        kp, kip, kd = TERMS.kp[j], TERMS.ki[j] * dt, TERMS.kd[j] / dt
        wanted = signal.lfilter([kp + kip + kd, -kp - 2 * kd, kd], [1.0, -1.0], e[:, j])
        np.testing.assert_allclose(np.array(out)[:, j], wanted, rtol=1e-11, atol=1e-11)


def test_the_sampled_law_becomes_the_continuous_one_with_the_first_order_of_dt():
    """e = sin 3t, whose integral and derivative are known: halving dt halves what is between them."""
    known, off = np.array([0.03, -0.02]), []
    for steps in (400, 800, 1600):
        t = np.linspace(0.0, 1.3, steps + 1)
        memory = PIDMemory.initial([0.0, 0.0])
        for x in t[1:]:
            command, memory = pid_step(TERMS, memory, np.full(2, np.sin(3 * x)), t[1], known)
        integral = TERMS.ki * (1 - np.cos(3 * 1.3)) / 3
        there, rate = pid(TERMS, integral, np.full(2, np.sin(3.9)), np.full(2, 3 * np.cos(3.9)), known)
        np.testing.assert_allclose(rate, TERMS.ki * np.sin(3.9), rtol=1e-15)
        off.append(command.tau - there.tau)
    np.testing.assert_allclose(off[0] / off[1], 2.0, rtol=0.01)
    np.testing.assert_allclose(off[1] / off[2], 2.0, rtol=0.01)
    assert np.abs(off[2]).max() < 2e-3


def test_no_kick_from_where_the_joints_begin():
    command, _ = pid_step(TERMS, PIDMemory.initial([0.5, -0.5]), [0.5, -0.5], 1e-3)
    np.testing.assert_allclose(command.tau, [1.0 + 5.0 * 0.5e-3, -0.35 - 0.7 / 1.1 * 0.5e-3], rtol=1e-12)


@given(seed=st.integers(0, 100_000))
def test_the_integral_never_pushes_beyond_a_limit(seed):
    """At every step: the integral's own gain is given in full where no limit is met; where one is, never beyond it, and the
    gain away from it is always given. Mirrored errors and limits give mirrored torques."""
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
        np.testing.assert_array_equal(command.saturated, (command.wanted > upper) * 1.0 - (command.wanted < lower))

        gain, given_ = gains.ki * e * dt, memory.integral - before.integral
        rest = command.wanted - gain - before.integral  # the other terms
        with_it = rest + memory.integral
        np.testing.assert_allclose(given_[command.saturated == 0], gain[command.saturated == 0], atol=1e-12)
        pushed = np.abs(given_) > 1e-12
        outward = pushed & (np.sign(given_) == command.saturated)
        assert (with_it[outward] <= upper[outward] + 1e-12).all()
        assert (with_it[outward] >= lower[outward] - 1e-12).all()
        across = (command.saturated != 0) & (np.clip(rest + before.integral, lower, upper) == rest + before.integral)
        np.testing.assert_allclose(with_it[across], command.tau[across], atol=1e-12)  # it goes up to the limit, and stops
        inward = np.sign(gain) == -command.saturated
        np.testing.assert_allclose(given_[inward], gain[inward], atol=1e-12)


def test_a_limited_law_recovers_at_once_where_one_that_winds_up_overshoots():
    """An inertia that must go a radian with a tenth of the torque that it asks for, and a steady load to be found."""
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
    kept, wound = (path.max() - 1.0 for path in paths)
    assert kept < 0.5 * wound
    assert wound > 0.1
    assert abs(paths[0][-1] - 1.0) < 1e-4  # the load is found: no error is left
    np.testing.assert_allclose(memory.integral, load_, atol=1e-3)


def test_the_continuous_law_holds_its_integral_while_it_would_push_beyond_a_limit():
    gains = PIDGains([1.0, 1.0, 1.0], [2.0, 2.0, 2.0], [0.0, 0.0, 0.0])
    limits = ([-0.5] * 3, [0.5] * 3)
    command, rate = pid(gains, [0.0, 0.0, -2.0], [1.0, 0.1, 0.3], np.zeros(3), limits=limits)
    np.testing.assert_array_equal(command.saturated, [1.0, 0.0, -1.0])
    np.testing.assert_allclose(rate, [0.0, 0.2, 0.6], rtol=1e-15)  # held; free; free to come back


# ── the force loop ────────────────────────────────────────────────────────────────────────────────────────────────────────────

SPRING, ROTOR, DRAG = 30.0, 2e-3, 0.05  # δ N·m/rad, J kg·m², B N·m·s/rad


def press(gains, wanted, dt, end, unknown=0.0):
    """The sensed torque of an actuator against a spring, its load in its balance; held torques, solved exactly."""
    A = np.array([[0.0, 1.0], [-SPRING / ROTOR, -DRAG / ROTOR]])
    step = signal.cont2discrete((A, np.array([[0.0], [1 / ROTOR]]), np.eye(2), np.zeros((2, 1))), dt)
    x, integral, sensed = np.zeros(2), np.zeros(1), [0.0]
    for _ in range(round(end / dt)):
        command, integral = force_step(gains, integral, [wanted], [SPRING * x[0]], [x[1]], dt)
        x = step[0] @ x + step[1][:, 0] * (command.tau[0] + unknown)
        sensed.append(SPRING * x[0])
    return np.array(sensed)


def test_the_force_loop_is_37_mended():
    """tau_f/tau_d = δ k_ps/(J s² + (B + Kv) s + δ k_ps), k_ps = 1 + Kp; it ends at 1, not at 1/k_i."""
    gains, off = ForceGains([3.0], [0.0], [0.4]), []
    k = SPRING * 4.0
    system = signal.lti([k], [ROTOR, DRAG + 0.4, k])
    for dt in (1e-4, 5e-5):
        sensed = press(gains, 0.25, dt, 0.1)
        _, wanted = signal.step(system, T=dt * np.arange(len(sensed)))
        off.append(np.abs(sensed - 0.25 * wanted).max())
    assert off[0] / off[1] == pytest.approx(2.0, rel=0.05)
    assert off[1] < 0.01 * 0.25
    assert sensed[-1] == pytest.approx(0.25, rel=1e-3)


def test_what_the_model_does_not_know_leaves_its_share_and_the_integral_takes_it_away():
    """A disturbance d: error d/(1 + Kp) at rest, 0 with Ki."""
    without, with_ = (press(ForceGains([3.0], [ki], [0.4]), 0.25, 2e-4, 1.0, unknown=0.02)[-1] for ki in (0.0, 60.0))
    assert without == pytest.approx(0.25 + 0.02 / 4.0, rel=1e-6)
    assert with_ == pytest.approx(0.25, rel=1e-6)


def test_one_step_of_the_force_loop_by_hand_and_its_integral_at_a_limit():
    gains = ForceGains([3.0, 3.0], [50.0, 50.0], [0.2, 0.2])
    command, integral = force_step(
        gains, [0.01, 0.01], [0.3, 0.3], [0.1, 0.1], [0.5, 0.5], 2e-3, [0.05, 0.05], ([-9, -9], [9, 0.5])
    )
    # 0.05 + 0.3 + 3·0.2 + 0.01 + 50·0.2·0.002 − 0.2·0.5
    np.testing.assert_allclose(command.tau, [0.88, 0.5], rtol=1e-14)
    np.testing.assert_array_equal(command.saturated, [0.0, 1.0])
    np.testing.assert_allclose(integral, [0.03, 0.01], rtol=1e-14)


def test_a_fingertip_presses_a_wall_with_the_wanted_force():
    """A finger of four_finger against a stiff wall: Jᵀ f in, friction of the drives unknown to the law; f arrives."""
    hand = load("four_finger")
    chosen = list(hand.finger("finger_1").joints)
    q0, f_wanted = np.array(hand.neutral), np.array([0.4, -0.2, 1.5])  # N, of the finger on the wall, in H
    place, stiff = hand.tip_pose(q0, "finger_1")[0], 2000.0  # N/m
    gains = ForceGains(np.full(12, 4.0), np.full(12, 80.0), np.full(12, 0.2))
    unknown = np.linspace(-0.004, 0.004, 12)  # N·m
    q, v, integral, dt = q0, np.zeros(12), np.zeros(12), 2e-4
    others, limits = np.setdiff1d(np.arange(12), chosen), (hand.torque_lower, hand.torque_upper)
    for _ in range(3000):
        J = hand.point_jacobian(q, "finger_1", hand.tip_pose(q, "finger_1")[0])[:3]
        f = stiff * (hand.tip_pose(q, "finger_1")[0] - place)
        tau_g = hand.gravity_torque(q, G)
        command, integral = force_step(gains, integral, J.T @ f_wanted, J.T @ f, v, dt, tau_g, limits)
        tau = np.array(command.tau)
        tau[others] = tau_g[others]  # the other fingers rest
        bias = np.where(np.isin(np.arange(12), chosen), unknown, 0.0)
        a = acceleration(hand, q, v, tau + bias - J.T @ f, G)
        v = v + dt * a
        q = q + dt * v
    np.testing.assert_allclose(f, f_wanted, atol=1e-4)


# ── what is refused ───────────────────────────────────────────────────────────────────────────────────────────────────────────


def test_what_no_law_takes():
    with pytest.raises(InvalidInput, match=r"kp\[1\] = 0.0: must be greater than 0"):
        PDGains([1.0, 0.0], [1.0, 1.0])
    with pytest.raises(InvalidInput, match=r"kd\[0\] = -1.0: must be at least 0"):
        PIDGains([1.0], [0.0], [-1.0])
    with pytest.raises(InvalidInput, match=r"ki = .* a list of 1 numbers, not 2"):
        ForceGains([1.0], [0.0, 1.0], [0.0])
    with pytest.raises(InvalidInput, match=r"tau_i = .* greater than 0"):
        PIDGains.from_times([1.0], [0.0], [0.0])
    with pytest.raises(InvalidInput, match=r"now.q = .* a list of 3 numbers, not 2"):
        pd_gravity(GAINS_003, Finger003(), JointMotion([0.0, 0.0]), JointMotion(np.zeros(3)), GRAVITY_003)
    with pytest.raises(InvalidInput, match=r"dt = 0"):
        pid_step(TERMS, PIDMemory.initial([0.0, 0.0]), [0.0, 0.0], 0.0)
    with pytest.raises(InvalidInput, match=r"limits\[0\]\[1\] = 0.5: must be at most limits\[1\]\[1\], which is 0.4"):
        pid_step(TERMS, PIDMemory.initial([0.0, 0.0]), [0.0, 0.0], 1e-3, limits=([-1.0, 0.5], [1.0, 0.4]))
    with pytest.raises(InvalidInput, match=r"v = "):
        JointMotion([0.0, 0.0], [1.0])
