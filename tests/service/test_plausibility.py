"""States that the hand or the object cannot have are refused, and the torque's step is bounded in every command."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support.control_requests import GRASP, HAND, desired, setup

import graspforce as gf
from graspforce.contact.motion import BodyMotion
from graspforce.control import GraspState
from graspforce.core.errors import InvalidInput
from graspforce.geometry import Box
from graspforce.grasp import find_grasp
from graspforce.grasp.body import Body
from graspforce.service import StreamState
from graspforce.service.client.watchdog import CommandMonitor, Watchdog
from graspforce.service.server.plausibility import Implausible, StateGuard, reach_of
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.server.torque_step import largest_step
from graspforce.service.wire import protocol

VALIDITY = 0.02  # s
PERIOD = 1e-3  # s
REST = GraspState(GRASP.q, np.zeros(HAND.n), BodyMotion(GRASP.p_HO, GRASP.R_HO))


def changed(**change):
    """Return the state at rest with another posture (`q`), rates (`v`), position (`p`), orientation (`R`) or twist."""
    motion = BodyMotion(change.get("p", GRASP.p_HO), change.get("R", GRASP.R_HO), change.get("twist", np.zeros(6)))
    return GraspState(change.get("q", GRASP.q), change.get("v", np.zeros(HAND.n)), motion)


def one_joint(values, i, value):
    return np.where(np.arange(len(values)) == i, value, values)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"q": one_joint(GRASP.q, 2, HAND.q_upper[2] + 0.11)}, "state.posture[2]"),
        ({"q": one_joint(GRASP.q, 0, HAND.q_lower[0] - 0.11)}, "state.posture[0]"),
        ({"v": one_joint(GRASP.q, 1, 3.1 * HAND.velocity_limit[1])}, "state.velocity[1]"),
        ({"p": [0.0, 0.0, 1.0]}, "state.object.position[2]"),
        ({"twist": [0.0, 0.0, 0.0, 0.0, 60.0, 0.0]}, "state.object.twist[4]"),
    ],
)
def test_first_state_beyond_a_range_is_refused(change, field):
    with pytest.raises(Implausible) as caught:
        StateGuard(GRASP, VALIDITY).check(changed(**change), 0.0, 0.0)
    assert (caught.value.code, caught.value.field) == ("implausible", field)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"q": GRASP.q + one_joint(np.zeros(HAND.n), 4, -0.3)}, "state.posture[4]"),
        ({"p": GRASP.p_HO + np.array([0.05, 0.0, 0.0])}, "state.object.position[0]"),
        ({"R": GRASP.R_HO @ Rotation.from_rotvec([0.0, 0.0, 0.5]).as_matrix()}, "state.object.rotation[0][0]"),
    ],
)
def test_jump_is_refused_until_it_lasts(change, field):
    guard, jumped = StateGuard(GRASP, VALIDITY), changed(**change)
    guard.check(REST, 0.0, 0.0)
    times = PERIOD * np.arange(1, 100)
    accepted = []
    for t in times:
        error = refusal(guard, jumped, t)
        if error is None:
            accepted.append(t)
        else:
            assert not accepted
            assert error.field.startswith(field[: field.rindex("[")])
    assert accepted[0] == pytest.approx(times[0] + 0.05, abs=2 * PERIOD)


def refusal(guard, state, t):
    """Return the exception of a state, or None if it is accepted."""
    try:
        guard.check(state, t, t)
    except Implausible as error:
        return error
    return None


@pytest.mark.parametrize(
    ("joint", "position", "message"),
    [
        (1e-3 * 45.5, None, "plausible: from -0.005 to 0.045 m"),
        (1e-3 * -5.5, None, "plausible: from -0.005 to 0.045 m"),
        (1e-3 * 18.0, 1e-3 * 15.0, "closer to the last one, 0.015 m: a jump"),
    ],
)
def test_positions_of_sliding_joints_have_margins_in_metres(joint, position, message):
    """The jaws open by 40 mm: margins of turning joints, 0.1 and 0.05 read as metres, would accept any position."""
    jaws = find_grasp(gf.Hand.load("parallel_jaws"), Body.solid(Box([0.03, 0.03, 0.03]), 0.05), friction=0.7)
    guard = StateGuard(jaws, VALIDITY)

    def state(q, v=0.0):
        return GraspState([q], [v], BodyMotion(jaws.p_HO, jaws.R_HO))

    if position is not None:
        guard.check(state(position), 0.0, 0.0)
        guard.check(state(position + 2e-3), PERIOD, PERIOD)
        guard.check(state(position), 2 * PERIOD, 2 * PERIOD)
    with pytest.raises(Implausible) as caught:
        guard.check(state(joint), 2 * PERIOD, 2 * PERIOD)
    assert (caught.value.field, caught.value.allowed) == ("state.posture[0]", message)
    with pytest.raises(Implausible, match="m/s") as caught:
        StateGuard(jaws, VALIDITY).check(state(0.015, 1.0), 0.0, 0.0)
    assert caught.value.field == "state.velocity[0]"


def test_single_glitch_is_refused_and_the_next_state_accepted():
    guard, glitch = StateGuard(GRASP, VALIDITY), changed(p=GRASP.p_HO + np.array([0.05, 0.0, 0.0]))
    for i in range(200):
        t = i * PERIOD
        if i % 10 == 5:
            with pytest.raises(Implausible):
                guard.check(glitch, t, t)
        else:
            guard.check(REST, t, t)


def test_clock_of_the_sender_does_not_excuse_a_jump():
    """A state that claims to come an hour later arrives a millisecond later."""
    guard = StateGuard(GRASP, VALIDITY)
    guard.check(REST, 0.0, 0.0)
    with pytest.raises(Implausible):
        guard.check(changed(q=GRASP.q + one_joint(np.zeros(HAND.n), 0, 1.4)), 3600.0, PERIOD)


@given(seed=st.integers(0, 2**32 - 1), fraction=st.floats(0.0, 1.0))
@settings(max_examples=50, deadline=None)
def test_motion_within_the_limits_is_plausible(seed, fraction):
    """Joints between their limits at rates up to their limits, and an object that moves as fast as fingertips may."""
    rng, guard = np.random.default_rng(seed), StateGuard(GRASP, VALIDITY)
    q, p = rng.uniform(HAND.q_lower, HAND.q_upper), np.asarray(GRASP.p_HO)
    v, speed = (
        fraction * np.asarray(HAND.velocity_limit) * rng.choice([-1.0, 1.0], HAND.n),
        fraction * rng.uniform(-1.0, 1.0, 3),
    )
    for i in range(20):
        t = i * PERIOD
        guard.check(changed(q=np.clip(q + v * t, HAND.q_lower, HAND.q_upper), v=v, p=p + 0.5 * speed * t), t, t)


def test_reach_bounds_the_fingertips():
    rng = np.random.default_rng(5)
    for q in rng.uniform(HAND.q_lower, HAND.q_upper, (200, HAND.n)):
        assert max(np.linalg.norm(HAND.tip_pose(q, finger.name)[0]) for finger in HAND.fingers) <= reach_of(HAND)


def test_refused_state_gets_an_error_record_and_changes_nothing():
    one, other = (ServerStream("a", setup(memory=None)) for _ in range(2))
    for i in range(3):
        good = StreamState(i + 1, i * PERIOD, REST, desired()).encode(protocol.MSGPACK)
        bad = StreamState(i + 1, i * PERIOD, changed(p=[0.0, 0.0, 2.0]), desired()).encode(protocol.MSGPACK)
        refused = one.command(bad, protocol.MSGPACK)
        assert not refused.ok
        assert protocol.decode(refused.payload, refused.encoding)["error"] == "implausible"
        replies = [each.command(good, protocol.MSGPACK, received=i * PERIOD) for each in (one, other)]
        torques = [protocol.decode(reply.payload, reply.encoding)["torque"] for reply in replies]
        assert torques[0] == torques[1]
    assert one.outcomes == {"ok": 3, "implausible": 3}


@pytest.mark.parametrize("codec", [protocol.JSON, protocol.MSGPACK])
@pytest.mark.parametrize("fraction", [0.001, 0.01, 2.0])
def test_torque_step_is_bounded_in_every_command(codec, fraction):
    rng, bound = np.random.default_rng(3), largest_step(GRASP, fraction)
    stream, taus, warned = ServerStream("a", replace(setup(memory=None), torque_step=fraction)), [], []
    for i in range(60):
        motion = BodyMotion(GRASP.p_HO + 2e-3 * rng.standard_normal(3), GRASP.R_HO, 0.05 * rng.standard_normal(6))
        state = GraspState(GRASP.q + 5e-3 * rng.standard_normal(HAND.n), 0.1 * rng.standard_normal(HAND.n), motion)
        reply = stream.command(StreamState(i + 1, i * PERIOD, state, desired()).encode(codec), codec, received=i * PERIOD)
        assert reply.ok, reply.payload
        record = protocol.decode(reply.payload, reply.encoding)
        torque = record["torque"]
        taus.append(np.frombuffer(torque) if isinstance(torque, bytes) else np.array(torque))
        warned.append(any("torque step limited" in warning for warning in record["warnings"]))
    steps = np.abs(np.diff(taus, axis=0)) / bound
    assert steps.max() <= 1.0 + 1e-9
    assert any(warned) == (fraction < 1.0)
    np.testing.assert_array_equal(warned[1:], np.isclose(steps.max(axis=1), 1.0))


def test_monitor_bounds_the_step_of_good_commands():
    step = np.full(HAND.n, 0.1)
    monitor = CommandMonitor(Watchdog(), VALIDITY, step=step)
    target, previous = np.linspace(-1.0, 1.0, HAND.n), np.zeros(HAND.n)
    for i in range(30):
        t = i * PERIOD
        assert monitor.accept(previous if i == 0 else target, t, t)
        output = monitor.torque(t, GRASP.q, np.zeros(HAND.n))
        assert np.abs(output.tau - previous).max() <= 0.1 + 1e-12
        previous = output.tau
    np.testing.assert_array_equal(previous, target)


def test_torque_step_is_checked():
    for invalid in (0.0, -1.0, 2.1, float("nan")):
        with pytest.raises(InvalidInput, match="torque_step"):
            replace(setup(), torque_step=invalid)
    record = replace(setup(), torque_step=0.1).to_dict()
    assert record["torque_step"] == 0.1
    assert "torque_step" not in setup().to_dict()
