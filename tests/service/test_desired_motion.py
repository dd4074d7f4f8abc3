"""Desired motions that no hand can have are refused, and leave no trace in a stream."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.control_requests import GRASP

from graspforce.contact.motion import BodyMotion
from graspforce.control import GraspMotion, GraspState
from graspforce.service import StreamState
from graspforce.service.server import desired_motion
from graspforce.service.server.desired_motion import DesiredGuard
from graspforce.service.server.plausibility import Implausible, object_reach
from graspforce.service.server.server_stream import ServerStream
from graspforce.service.wire import protocol
from graspforce.service.wire.control_records import StreamSetup

HAND, REACH = GRASP.hand, object_reach(GRASP)
STILL = BodyMotion(GRASP.p_HO, GRASP.R_HO)
GUARD = DesiredGuard(GRASP)


@pytest.fixture(params=["compiled", "Python"], autouse=True, scope="module")
def code(request):
    with pytest.MonkeyPatch.context() as patch:
        if request.param == "Python":
            patch.setattr(desired_motion, "native", None)
        yield request.param


@given(st.integers(0, 2), st.floats(-3.0, 3.0))
def test_positions_are_within_reach(axis, factor):
    p = np.zeros(3)
    p[axis] = factor * REACH
    motion = BodyMotion(p, GRASP.R_HO)
    if abs(factor) <= 1.0:
        GUARD.check(motion)
    else:
        with pytest.raises(Implausible) as caught:
            GUARD.check(motion)
        assert caught.value.field == f"desired.position[{axis}]"


@given(st.integers(0, 5), st.floats(-200.0, 200.0))
def test_twists_are_those_of_a_hand(axis, rate):
    twist, limit = np.zeros(6), 5.0 if axis < 3 else 50.0  # m/s, rad/s
    twist[axis] = rate
    motion = BodyMotion(GRASP.p_HO, GRASP.R_HO, twist)
    if abs(rate) <= limit:
        GUARD.check(motion)
    else:
        with pytest.raises(Implausible) as caught:
            GUARD.check(motion)
        assert caught.value.field == f"desired.twist[{axis}]"


@settings(deadline=None)
@given(st.integers(0, HAND.n - 1), st.floats(-0.5, 1.5))
def test_joints_are_near_their_range(joint, share):
    q = np.array(GRASP.q)
    q[joint] = HAND.q_lower[joint] + share * (HAND.q_upper[joint] - HAND.q_lower[joint])
    motion = GraspMotion(STILL, q, np.zeros(HAND.n), np.zeros(HAND.n))
    if -0.0999 <= share <= 1.0999:
        GUARD.check(motion)
    elif not -0.1001 <= share <= 1.1001:
        with pytest.raises(Implausible) as caught:
            GUARD.check(motion)
        assert caught.value.field == f"desired.joints.posture[{joint}]"


@pytest.mark.parametrize("codec", [protocol.JSON, protocol.MSGPACK])
def test_a_refused_motion_leaves_no_trace(codec):
    """The commands after it are those of a stream that never got it."""
    state = GraspState(GRASP.q, np.zeros(HAND.n), STILL)
    absurd = GraspMotion(STILL, GRASP.q + 100.0, np.zeros(HAND.n), np.zeros(HAND.n))
    streams = [ServerStream(name, StreamSetup(GRASP)) for name in ("a", "b")]
    for i in range(20):
        if i == 5:
            reply = streams[0].command(StreamState(i, 1e-3 * i, state, absurd).encode(codec), codec)
            error = protocol.decode(reply.payload, codec)
            assert (error["error"], error["field"]) == ("implausible", "desired.joints.posture[0]")
        payload = StreamState(i + 10, 1e-3 * i, state, STILL).encode(codec)
        one, other = (protocol.decode(each.command(payload, codec).payload, codec) for each in streams)
        assert one["torque"] == other["torque"]
    assert streams[0].outcomes == {"ok": 20, "implausible": 1}
