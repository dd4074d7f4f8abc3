"""The servo of the fingers: bounds of its feedback as forces at the tips."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from graspforce.control.joints.joint_command import JointMotion
from graspforce.control.phases.finger_servo import FingerServo, ForceBounds, ServoStep
from graspforce.estimation.measurement import Measurement
from graspforce.estimation.sensor_model import SensorModel
from graspforce.hand.hand import GRAVITY_PALM_UP, Hand

HAND = Hand.load("dlr_hit2")
FINGERS = ("thumb", "index", "ring")
NORMALS = np.array([[0.0, 0.6, 0.8], [1.0, 0.0, 0.0], [0.0, -0.8, 0.6]])
ALONG, ACROSS = np.full(3, 0.3), np.full(3, 0.9)  # N
SERVO = FingerServo(HAND, FINGERS, SensorModel(), np.array(GRAVITY_PALM_UP), 60.0, 0.015)
REST = 0.5 * (HAND.q_lower + HAND.q_upper)


def step(error: np.ndarray, bounds) -> ServoStep:
    """Return the step of a hand at rest that is away from its desired posture."""
    measurement = Measurement(0.0, REST)
    return SERVO.step(SERVO.initial_memory(measurement), measurement, JointMotion(REST + error), bounds)[0]


def parts(forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the sizes of forces along the normals and across them."""
    along = np.einsum("ij,ij->i", forces, NORMALS)
    return np.abs(along), np.linalg.norm(forces - along[:, None] * NORMALS, axis=1)


@pytest.mark.parametrize("seed", range(5))
def test_feedback_is_bounded_along_and_across_the_normals(seed):
    error = 0.1 * np.random.default_rng(seed).standard_normal(HAND.n)  # rad
    along, across = parts(step(error, ForceBounds(NORMALS, ALONG, ACROSS)).f_feedback)
    free_along, free_across = parts(step(error, np.full(3, 1e6)).f_feedback)
    np.testing.assert_allclose(along, np.minimum(free_along, ALONG), rtol=1e-9)
    np.testing.assert_allclose(across, np.minimum(free_across, ACROSS), rtol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_torques_are_those_of_the_bounded_forces(seed):
    """Without contact the torques of the feedback are Jᵀ F; the rest of the torques compensates gravity and friction."""
    error = 0.1 * np.random.default_rng(seed).standard_normal(HAND.n)  # rad
    bounded, still = (step(each, ForceBounds(NORMALS, ALONG, ACROSS)) for each in (error, np.zeros(HAND.n)))
    _, J = HAND.model.frame_jacobians(REST[None], [HAND.frame_id(name) for name in FINGERS])
    for i, name in enumerate(FINGERS):
        own = list(HAND.finger(name).joints)
        expected = J[0, i, :3][:, own].T @ bounded.f_feedback[i]
        # N·m: J Jᵀ is regularised by 1e-8 m², and the posture has levers of some centimetres
        np.testing.assert_allclose((bounded.tau - still.tau)[own], expected, rtol=0, atol=1e-3)


def test_force_across_does_not_depend_on_the_error_along():
    """A joint that sticks gets the force that moves it, however far the tip is behind along the normal."""
    rng = np.random.default_rng(3)
    _, J = (each[0] for each in HAND.model.frame_jacobians(REST[None], [HAND.frame_id(name) for name in FINGERS]))
    a, b = np.zeros(HAND.n), np.zeros(HAND.n)
    M = HAND.model.mass_matrix(REST)
    for i, name in enumerate(FINGERS):
        own = list(HAND.finger(name).joints)
        sideways = np.cross(NORMALS[i], rng.standard_normal(3))
        for far, target in ((0.0, a), (5.0, b)):
            target[own] = J[i, :3][:, own].T @ (0.1 * sideways + far * NORMALS[i])  # N·m
    errors = [1e-3 * np.linalg.solve(M, each) for each in (a, b)]
    near, far = (step(each, ForceBounds(NORMALS, ALONG, ACROSS)).f_feedback for each in errors)
    np.testing.assert_allclose(parts(near)[1], parts(far)[1], rtol=1e-3)


@pytest.mark.parametrize("seed", range(5))
def test_free_joints_away_from_their_goal_get_the_friction_that_holds_them(seed):
    """Beyond a band of 15 mrad, friction is compensated towards the goal at rest; within it nothing is added."""
    rng = np.random.default_rng(seed)
    measurement = Measurement(0.0, REST)
    level = rng.uniform(0.01, 0.1, HAND.n)  # N·m
    memory = replace(SERVO.initial_memory(measurement), friction=level)
    sign = rng.choice([-1.0, 1.0], HAND.n)
    for size, share in ((0.010, 0.0), (0.030, 1.0)):  # rad, and the part of the friction that is compensated
        desired = JointMotion(REST + size * sign)
        free, other = (
            SERVO.step(memory, measurement, desired, np.full(3, 0.01), is_free=is_free)[0].tau for is_free in (True, False)
        )
        within = np.abs(other + share * level * sign) < HAND.torque_upper
        np.testing.assert_allclose((free - other)[within], (share * level * sign)[within], rtol=0, atol=1e-9)


def test_torque_on_a_free_joint_that_sticks_grows_beyond_its_static_friction():
    """At 40 mrad from the goal the feedback of a light finger is less than 0.1 N·m; the learned friction makes up for it."""
    desired = JointMotion(REST + 0.04)  # rad
    memory = SERVO.initial_memory(Measurement(0.0, REST))
    still = step(np.zeros(HAND.n), np.full(3, 5.0)).tau
    for k in range(1000):
        found, memory = SERVO.step(memory, Measurement(k * SERVO.period, REST), desired, np.full(3, 5.0), is_free=True)
    joints = [j for name in FINGERS for j in HAND.finger(name).joints]
    pushed = found.tau - still  # N·m
    assert (np.minimum(pushed, HAND.torque_upper - still)[joints] > 0.1).all(), pushed[joints]


@pytest.mark.parametrize("name", ["allegro_right", "shadow_right", "dlr_hit2"])
@pytest.mark.parametrize("seed", range(3))
def test_bounded_feedback_accelerates_the_tips_as_its_forces_do(name, seed):
    """Fingers of four or five joints have torques that move joints and not the tip; they must not push the tip.

    The accelerations J M⁻¹ tau of the feedback are those of the bounded forces at the tips, J M⁻¹ Jᵀ F.
    """
    hand, rng = Hand.load(name), np.random.default_rng(seed)
    fingers = tuple(finger.name for finger in hand.fingers)[-3:]
    servo = FingerServo(hand, fingers, SensorModel(), np.zeros(3), 60.0, 0.015)
    rest = hand.q_lower + rng.uniform(0.3, 0.7, hand.n) * (hand.q_upper - hand.q_lower)
    measurement, normals = Measurement(0.0, rest), rng.standard_normal((3, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    error = 0.02 * rng.standard_normal(hand.n)  # rad: within the torque limits
    bounds = ForceBounds(normals, np.full(3, 0.01), np.full(3, 0.03))  # N
    wanted, still = (
        servo.step(servo.initial_memory(measurement), measurement, JointMotion(rest + each), bounds)[0]
        for each in (error, np.zeros(hand.n))
    )
    tau = wanted.tau - still.tau
    assert np.abs(wanted.f_feedback).max() > 1e-3  # N
    J = hand.model.frame_jacobians(rest[None], [hand.frame_id(finger) for finger in fingers])[1][0][:, :3].reshape(9, hand.n)
    mobility = J @ np.linalg.solve(hand.model.mass_matrix(rest), J.T)  # 1/kg
    actual = J @ np.linalg.solve(hand.model.mass_matrix(rest), tau)  # m/s²
    expected = mobility @ wanted.f_feedback.ravel()
    # the matrix is regularised by 1e-6 of its mean diagonal
    np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-3 * np.abs(expected).max())


@pytest.mark.parametrize("learns", [True, False])
def test_friction_is_learned_only_where_no_finger_may_touch(learns):
    """The force of a contact would count as friction: opening fingers that still press would learn far too much of it."""
    moving = JointMotion(REST, np.full(HAND.n, 0.2))
    memory = SERVO.initial_memory(Measurement(0.0, REST))
    for k in range(100):
        _, memory = SERVO.step(memory, Measurement(1e-3 * k, REST), moving, np.full(3, 20.0), is_free=True, learns=learns)
    assert (memory.friction > 0.0).any() == learns


@pytest.mark.parametrize("name", ["shadow_right", "barrett", "allegro_right"])
@pytest.mark.parametrize("seed", range(5))
def test_true_tip_force_is_within_the_bound_for_fingers_that_share_joints(name, seed):
    """The force that accelerates the tips as the torques of the feedback do, Λ J M⁻¹ tau with Λ = (J M⁻¹ Jᵀ)⁻¹."""
    hand, rng, bound = Hand.load(name), np.random.default_rng(seed), 2.0  # N
    fingers = tuple(finger.name for finger in hand.fingers)[-3:]
    servo = FingerServo(hand, fingers, SensorModel(), np.zeros(3), 60.0, 0.015)
    rest = hand.q_lower + rng.uniform(0.3, 0.7, hand.n) * (hand.q_upper - hand.q_lower)
    moving = [j for finger in fingers for j in hand.finger(finger).joints]
    measurement, error = Measurement(0.0, rest), rng.standard_normal(hand.n)
    error *= np.where(np.isin(np.arange(hand.n), moving), 0.2, 0.05)  # rad: idle fingers have no bound
    wanted, still = (
        servo.step(servo.initial_memory(measurement), measurement, JointMotion(rest + each), np.full(3, bound))[0]
        for each in (error, np.zeros(hand.n))
    )
    tau = wanted.tau - still.tau
    assert (np.abs(wanted.tau) < hand.torque_upper).all()  # within the limits of the motors
    J = hand.model.frame_jacobians(rest[None], [hand.frame_id(finger) for finger in fingers])[1][0][:, :3].reshape(9, hand.n)
    mobility = J @ np.linalg.solve(hand.model.mass_matrix(rest), J.T)  # 1/kg
    mobility += 1e-6 * mobility.trace() / 9 * np.eye(9)  # as in the servo
    true = np.linalg.solve(mobility, J @ np.linalg.solve(hand.model.mass_matrix(rest), tau)).reshape(3, 3)
    np.testing.assert_allclose(true, wanted.f_feedback, rtol=0, atol=0.01 * bound)
    sizes = np.linalg.norm(true, axis=1)
    assert sizes.max() <= 1.01 * bound
    assert sizes.max() >= 0.99 * bound  # the feedback is as strong as the bound permits


def test_bound_of_a_finger_does_not_weaken_fingers_without_shared_joints():
    """Only fingers with a common joint have a common factor."""
    far, near = (list(HAND.finger(name).joints) for name in FINGERS[:2])
    error, bound = np.zeros(HAND.n), np.full(3, 2.0)
    error[near] = 1e-3  # rad
    alone = step(error, bound)
    error[far] = 0.5  # rad
    together = step(error, bound)
    assert np.linalg.norm(together.f_feedback[0]) == pytest.approx(2.0)
    np.testing.assert_allclose(together.tau[near], alone.tau[near], rtol=0, atol=1e-12)


@pytest.mark.parametrize("amplitude", [0.03, 0.06, 0.12])
def test_joints_that_swing_about_their_goal_learn_less_friction_than_joints_that_stick(amplitude):
    """Swings come from too much compensation, so learning from them would increase them further."""
    desired, rate = JointMotion(REST), 50.0  # rad/s: the swings seen with a delay of 8 ms
    learned = []
    for angle in (lambda t: amplitude * np.sin(rate * t), lambda t: 0.7 * amplitude):  # rad: equal mean squares
        memory = SERVO.initial_memory(Measurement(0.0, REST + angle(0.0)))
        for k in range(500):
            t = k * SERVO.period
            _, memory = SERVO.step(memory, Measurement(t, REST + angle(t)), desired, np.full(3, 5.0), is_free=True)
        learned.append(memory.friction)
    assert (learned[0] < 0.25 * learned[1]).all()


def test_friction_is_compensated_and_learned_for_the_joints_of_free_fingers_only():
    """Static friction may hold a finger off the object while others already touch it."""
    joints = [list(HAND.finger(name).joints) for name in FINGERS]
    memory, measurement = SERVO.initial_memory(Measurement(0.0, REST)), Measurement(0.0, REST)
    memory = replace(memory, friction=np.full(HAND.n, 0.01))  # N·m
    bounds = ForceBounds(NORMALS, ALONG, ACROSS)
    results = [
        SERVO.step(memory, measurement, JointMotion(REST + 0.04), bounds, is_free=free)
        for free in (False, [True, False, False], True)
    ]
    (none, unchanged), (first, one), (every, each) = results
    np.testing.assert_array_equal(unchanged.friction, memory.friction)
    np.testing.assert_allclose(first.tau[joints[0]], every.tau[joints[0]], rtol=0, atol=1e-12)
    assert (one.friction[joints[0]] > memory.friction[joints[0]]).all()
    for i in (1, 2):
        np.testing.assert_allclose(first.tau[joints[i]], none.tau[joints[i]], rtol=0, atol=1e-12)
        np.testing.assert_array_equal(one.friction[joints[i]], memory.friction[joints[i]])
        assert (each.friction[joints[i]] > memory.friction[joints[i]]).all()
