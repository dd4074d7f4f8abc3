"""The node of a grasp with an independent library as the robot: states in, commands, forces, plans and diagnostics out."""

from __future__ import annotations

import os
import threading
import time

import numpy as np
import pytest
from support.box_grasp import make_grasp
from support.realtime import needs_realtime
from support.ros2_peer import HOST, peer, router
from support.servers import ANY_LOCAL_PORT, TIMEOUT, wait_until
from zenoh_ros2_sdk.discovery import get_service_names_and_types, get_topic_names_and_types

from graspforce.control import ControlSettings
from graspforce.core.errors import InvalidInput, ServiceError
from graspforce.service import Server
from graspforce.service.realtime_scheduling import ServerPriorities
from graspforce.service.ros2 import interfaces, messages
from graspforce.service.ros2.action_server import ABORTED, SUCCEEDED, UNKNOWN
from graspforce.service.ros2.grasp_node import GraspNode, NodeOptions
from graspforce.service.ros2.hold_control import HoldControl, HoldOptions
from graspforce.service.ros2.key_expressions import Attachment, NodeName, data_key

GRASP = make_grasp()
OPTIONS = HoldOptions(rate=200.0, tip_force_noise=0.1, settings=ControlSettings(slip_margin=0.3))
NODE = "/left/graspforce"
# N, in H: the fingers press along their inward normals, and carry 0.15 kg.
SENSED = {name: (-3.0 if i < 2 else 3.0, 0.0, 0.15 * 9.81 / 4.0) for i, name in enumerate(GRASP.fingers)}
TRIGGER = ("uint8 structure_needs_at_least_one_member", "bool success\nstring message")


class Robot:
    """A robot in ROS 2: it sends the joint states of a hand at rest, and collects what the node publishes."""

    def __init__(self, joined):
        self.types, self._joined, self._stop = None, joined, threading.Event()
        self.received = {}
        self._states = joined.publisher(f"{NODE}/joint_states", messages.JOINT_STATE)
        self.types = joined.session.store.types
        self.goal = joined.publisher(f"{NODE}/goal_pose", messages.POSE)
        self._wrenches = {finger: joined.publisher(f"{NODE}/contacts/{finger}", messages.WRENCH) for finger in GRASP.fingers}
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *exception):
        self._stop.set()
        self._thread.join()

    def header(self):
        now = time.time_ns()
        stamp = self.types["builtin_interfaces/msg/Time"](now // 10**9, now % 10**9)
        return self.types["std_msgs/msg/Header"](stamp, "")

    def _run(self):
        while not self._stop.wait(1.0 / OPTIONS.rate):
            none = np.zeros(0)
            names = list(GRASP.hand.joint_names)
            for finger, publisher in self._wrenches.items():
                publisher.publish(header=self.header(), wrench=self.wrench(SENSED[finger]))
            self._states.publish(header=self.header(), name=names, position=GRASP.q, velocity=none, effort=none)

    def wrench(self, force):
        """Return a wrench without moment."""
        kind = self.types["geometry_msgs/msg/Vector3"]
        return self.types["geometry_msgs/msg/Wrench"](kind(*force), kind(0.0, 0.0, 0.0))

    def listen(self, topic, type_name):
        """Collect the messages of a topic."""
        found = self.received.setdefault(topic, [])
        self._joined.subscriber(topic, type_name, found.append)
        return found

    def call(self, service):
        """Call a service without fields, and return its success and message."""
        client = self._joined.client(f"{NODE}/{service}", messages.TRIGGER, *TRIGGER)
        response = client.call(structure_needs_at_least_one_member=0)
        return response.success, response.message

    def send_goal(self, p):
        """Send a goal without rotation."""
        point = self.types["geometry_msgs/msg/Point"](*map(float, p))
        turn = self.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
        self.goal.publish(header=self.header(), pose=self.types["geometry_msgs/msg/Pose"](point, turn))


@pytest.fixture
def network():
    with router() as address, Server([GRASP.hand], listen=ANY_LOCAL_PORT) as server, peer(address) as joined:
        control = HoldControl(GRASP, OPTIONS)
        options = NodeOptions(NodeName("graspforce", "/left"))
        with GraspNode(control, server.begin_plan, options, address), Robot(joined) as robot:
            wait_until(lambda: control._sample is not None)  # the first joint state
            yield robot, control, joined


@needs_realtime
def test_control_of_a_realtime_server_has_the_priority_of_a_stream_of_its_rate():
    priorities = ServerPriorities(9)
    with router() as address:
        before = set(threading.enumerate())
        with GraspNode(HoldControl(GRASP, OPTIONS), lambda *request: None, NodeOptions(), address, priorities):
            started = {thread.name: thread for thread in set(threading.enumerate()) - before}
            control = started["ros2-joint_states"].native_id
            wait_until(lambda: os.sched_getscheduler(control) == os.SCHED_FIFO)
            assert os.sched_getparam(control).sched_priority == priorities.of_stream(1.0 / OPTIONS.rate) == 7
            assert os.sched_getscheduler(started["ros2-diagnostics"].native_id) == os.SCHED_OTHER  # that of this thread


def test_a_robot_opens_moves_and_releases_a_grasp(network):
    robot, control, joined = network
    expected = {
        f"{NODE}/commands": [messages.NUMBERS],
        f"{NODE}/contacts/finger_1": [messages.WRENCH],
        f"{NODE}/planned_contacts/finger_1": [messages.WRENCH],
        f"{NODE}/joint_trajectory": [messages.TRAJECTORY],
        f"{NODE}/object_pose": [messages.POSE],
        "/diagnostics": [messages.DIAGNOSTICS],
    }
    wait_until(lambda: expected.items() <= dict(get_topic_names_and_types(0, HOST, joined.port)).items())
    own = {f"{NODE}/{name}" for name in ("open", "release", "plan")}
    wait_until(lambda: own <= dict(get_service_names_and_types(0, HOST, joined.port)).keys())
    services = dict(get_service_names_and_types(0, HOST, joined.port))
    assert {name for name in services if "_action" not in name and "parameter" not in name} == own
    commands = robot.listen(f"{NODE}/commands", messages.NUMBERS)
    contacts = robot.listen(f"{NODE}/planned_contacts/finger_1", messages.WRENCH)
    plans = robot.listen(f"{NODE}/joint_trajectory", messages.TRAJECTORY)
    health = robot.listen("/diagnostics", messages.DIAGNOSTICS)

    assert robot.call("release") == (False, "the hand does not hold the object")
    wait_until(lambda: robot.call("open") == (True, "the hand holds the object"))
    wait_until(lambda: len(commands) > 20 and contacts)
    assert commands[-1].data.shape == (GRASP.hand.n,)
    force = contacts[-1].wrench.force
    assert force.x < -0.3  # N: finger_1 touches the face at +x, and pushes along its inward normal
    assert contacts[-1].header.frame_id == "object"

    is_done, text = robot.call("plan")
    assert not is_done
    assert "no goal" in text
    goal = GRASP.p_HO + np.array([0.0, 0.0, 0.002])
    robot.send_goal(goal)
    wait_until(lambda: robot.call("plan")[0])
    wait_until(lambda: plans)
    assert plans[0].joint_names == list(GRASP.hand.joint_names)
    np.testing.assert_allclose(plans[0].points[0].positions, GRASP.q, atol=2e-3)
    assert plans[0].points[-1].time_from_start.nanosec > 0

    wait_until(lambda: health and any("normal force" in pair.key for pair in health[-1].status[0].values))
    assert health[-1].status[0].level == messages.OK, health[-1].status[0].message
    values = {pair.key: pair.value for pair in health[-1].status[0].values}
    assert values["mode"] == "holding"
    assert int(values["measured contact forces"]) > 0

    def is_nearer_to_the_measured_force():
        pairs = {pair.key: pair.value for pair in health[-1].status[0].values}
        planned, estimated = -contacts[-1].wrench.force.x, float(pairs["normal force of finger_1 (N)"])
        return estimated > 0.5 * (planned + 3.0)

    wait_until(is_nearer_to_the_measured_force)  # the estimate approaches it over some states
    assert robot.call("release") == (True, "the hand opens")
    assert control.mode == "released"


def test_a_router_beyond_this_machine_needs_tls():
    control = HoldControl(GRASP, OPTIONS)
    with pytest.raises(InvalidInput, match="--insecure"):
        GraspNode(control, lambda *request: None, NodeOptions(), "tcp/192.168.1.4:7447")


def test_a_missing_router_is_named():
    with pytest.raises(ServiceError, match="rmw_zenohd"):
        GraspNode(HoldControl(GRASP, OPTIONS), lambda *request: None, NodeOptions(), "tcp/127.0.0.1:1")


def test_a_gripper_command_holds_and_opens(network):
    _, control, joined = network
    action = f"{NODE}/gripper_cmd/_action"
    topics = dict(get_topic_names_and_types(0, HOST, joined.port, include_hidden_topics=True))
    assert topics[f"{action}/status"] == ["action_msgs/msg/GoalStatusArray"]
    assert topics[f"{action}/feedback"] == [f"{messages.GRIPPER}_FeedbackMessage"]

    def ask(service, kind, **fields):
        key = data_key(0, f"{action}/{service}", kind)
        request = interfaces.encode(f"{kind}_Request", interfaces.make(f"{kind}_Request", **fields))
        attachment = Attachment(1, 0, bytes(16)).encode()
        [reply] = joined.session.session.get(key, payload=request, attachment=attachment, timeout=TIMEOUT)
        return interfaces.decode(f"{kind}_Response", reply.ok.payload.to_bytes())

    def grip(number, position, max_effort):
        """Send a goal, and return whether it was accepted, its state and its result."""
        goal_id = interfaces.make("unique_identifier_msgs/msg/UUID", uuid=np.full(16, number, dtype=np.uint8))
        command = interfaces.make("control_msgs/msg/GripperCommand", position=position, max_effort=max_effort)
        goal = interfaces.make(f"{messages.GRIPPER}_Goal", command=command)
        sent = ask("send_goal", f"{messages.GRIPPER}_SendGoal", goal_id=goal_id, goal=goal)
        done = ask("get_result", f"{messages.GRIPPER}_GetResult", goal_id=goal_id)
        return sent.accepted, done.status, done.result

    accepted, state, result = grip(1, 0.02, 0.0)
    assert (accepted, state, result.reached_goal) == (True, ABORTED, False)  # it holds nothing yet
    accepted, state, result = grip(2, 0.0, 0.7)
    assert (accepted, state, result.reached_goal) == (True, SUCCEEDED, True)
    assert control.settings.slip_margin == 0.7
    assert result.effort > 0.7  # N
    assert not grip(2, 0.0, 0.7)[0]  # the same goal again
    accepted, state, result = grip(3, 0.02, 0.0)
    assert (accepted, state, result.position) == (True, SUCCEEDED, OPTIONS.opening)
    assert control.mode == "released"
    unknown = interfaces.make("unique_identifier_msgs/msg/UUID", uuid=np.full(16, 9, dtype=np.uint8))
    assert ask("get_result", f"{messages.GRIPPER}_GetResult", goal_id=unknown).status == UNKNOWN
    info = interfaces.make("action_msgs/msg/GoalInfo", goal_id=unknown, stamp=stamp(0))
    refusal = ask("cancel_goal", "action_msgs/srv/CancelGoal", goal_info=info)
    assert (refusal.return_code, len(refusal.goals_canceling)) == (1, 0)


def stamp(seconds):
    return interfaces.make("builtin_interfaces/msg/Time", sec=seconds, nanosec=0)
