"""The node of one grasp: joint states, poses and contact forces in, commands, plans and diagnostics out, and its services."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import zenoh

from graspforce.core.errors import GraspForceError, RequestRefused, ServiceError, ServiceTimeout
from graspforce.service.realtime_scheduling import ORDINARY, ServerPriorities
from graspforce.service.ros2 import messages
from graspforce.service.ros2.action_server import ActionServer
from graspforce.service.ros2.hold_control import HoldCommand, HoldControl
from graspforce.service.ros2.key_expressions import SENSOR_QOS, STATE_QOS, NodeName
from graspforce.service.ros2.messages import PoseSample
from graspforce.service.ros2.node import Node
from graspforce.service.ros2.parameters import NumberParameter, ParameterServer
from graspforce.service.ros2.planning import BeginPlan, plan_to_pose
from graspforce.service.server.configuration import check_endpoints
from graspforce.service.wire.command_records import CommandRecord
from graspforce.service.zenoh_session import build_configuration, describe_zenoh_error

log = logging.getLogger("graspforce.ros2")

DEFAULT_ROUTER = "tcp/127.0.0.1:7447"
_SLIP_MARGIN = "slip margin of all contacts, N: a larger one squeezes more"
_CONTACT_PERIOD = 0.02  # s between messages of planned contact forces
_DIAGNOSTIC_PERIOD = 1.0  # s
_FIRST_COMMAND_TIME = 1.0  # s, until a hand that is to hold an object has its first command
_STALE_TIME = 0.5  # s without joint states


@dataclass(frozen=True, slots=True)
class NodeOptions:
    """How a grasp appears in ROS 2.

    Args:
        name: name of the node.
        joint_states: topic of the joint states; ``~/`` stands for the name of the node.
        object_pose: topic of the measured poses of the object.
        commands: topic of the commands, such as ``/effort_controller/commands`` of a forward command controller.
        base_frame: frame of the hand's base, in which poses must be; empty for any.
        object_frame: frame of the planned contact forces.
        insecure: whether the router may be beyond this machine without TLS: any program in the network can then drive the hand.
    """

    name: NodeName = field(default_factory=lambda: NodeName("graspforce"))
    joint_states: str = "~/joint_states"
    object_pose: str = "~/object_pose"
    commands: str = "~/commands"
    base_frame: str = ""
    object_frame: str = "object"
    insecure: bool = False


class GraspNode:
    """A grasp as a node of ROS 2. Use it as a context manager, or call `close`.

    Args:
        control: control of the grasp.
        begin_plan: function that begins a plan.
        options: names of topics and frames.
        router: Zenoh endpoint of the router of ROS 2.
        priorities: real-time priorities of the server in this process; the control has that of a stream.

    Raises:
        ServiceError: no router listens at the endpoint.
        MissingLibrary: rosbags is not installed.
        InvalidInput: a name is not allowed, or the router is beyond this machine
            without TLS.
    """

    def __init__(
        self,
        control: HoldControl,
        begin_plan: BeginPlan,
        options: NodeOptions,
        router: str = DEFAULT_ROUTER,
        priorities: ServerPriorities = ORDINARY,
    ) -> None:
        self._control, self._begin_plan, self._options = control, begin_plan, options
        self._start = time.time_ns()
        self._pose: PoseSample | None = None
        self._goal: PoseSample | None = None
        self._last: HoldCommand | None = None
        self._states = self._commands_sent = 0
        self._last_state = self._last_planned = -float("inf")
        self._closing = threading.Event()
        with priorities.for_messages():
            self._session = _open_session(router, options.insecure)
        try:
            self._node = Node(self._session, options.name)
            self._declare(priorities.of_stream(control.settings.period))
        except BaseException:
            self._session.close()
            raise
        self._thread = threading.Thread(target=self._diagnose, name="ros2-diagnostics", daemon=True)
        self._thread.start()

    def __enter__(self) -> GraspNode:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the router. A second call does nothing."""
        self._closing.set()
        self._thread.join()
        self._node.close()
        if not self._session.is_closed():
            self._session.close()

    def _declare(self, priority: int | None) -> None:
        """Declare topics and services.

        Args:
            priority: real-time priority of the control.
        """
        node, options = self._node, self._options
        self._commands = node.publish(options.commands, messages.NUMBERS)
        fingers = self._control.grasp.fingers
        self._planned = {name: node.publish(f"~/planned_contacts/{name}", messages.WRENCH, SENSOR_QOS) for name in fingers}
        self._trajectories = node.publish("~/joint_trajectory", messages.TRAJECTORY)
        self._diagnostics = node.publish("/diagnostics", messages.DIAGNOSTICS)
        node.serve("~/open", messages.TRIGGER, self._answer(self._open))
        node.serve("~/release", messages.TRIGGER, self._answer(self._release))
        node.serve("~/plan", messages.TRIGGER, self._answer(self._plan))
        ActionServer(node, "~/gripper_cmd", messages.GRIPPER, self._grip, self._gripper_result)
        control = self._control
        squeeze = NumberParameter(_SLIP_MARGIN, lambda: control.settings.slip_margin, control.set_slip_margin)
        ParameterServer(node, {"slip_margin": squeeze})
        node.subscribe("~/goal_pose", messages.POSE, self._receive_goal)
        node.subscribe(options.object_pose, messages.POSE, self._receive_pose, SENSOR_QOS)
        for finger in fingers if control.tips is not None else ():
            node.subscribe(f"~/contacts/{finger}", messages.WRENCH, partial(self._receive_wrench, finger), SENSOR_QOS)
        self._joints = node.subscribe(
            options.joint_states, messages.JOINT_STATE, self._receive_joints, STATE_QOS, priority=priority
        )

    # ── messages ─────────────────────────────────────────────────────────────────────────────────────────────────────────

    def _receive_joints(self, message: Any) -> None:
        """Compute and publish the command for a joint state."""
        sample = messages.read_joints(message, self._control.grasp_joints, self._start)
        pose, self._pose = self._pose, None
        self._states, self._last_state = self._states + 1, time.monotonic()
        command = self._control.step(sample, pose)
        if command is None:
            return
        self._commands.publish(messages.make_numbers(command.values))
        self._last, self._commands_sent = command, self._commands_sent + 1
        if command.record is not None and self._last_state - self._last_planned >= _CONTACT_PERIOD:
            self._last_planned = self._last_state
            self._publish_planned(command)

    def _receive_pose(self, message: Any) -> None:
        """Keep a measured pose for the next joint state."""
        self._pose = messages.read_pose(message, self._options.base_frame, self._start)

    def _receive_wrench(self, finger: str, message: Any) -> None:
        """Keep a measured wrench of a finger for the next joint states."""
        assert self._control.tips is not None  # else there is no such subscription
        self._control.tips.receive(finger, message, self._options.base_frame)

    def _receive_goal(self, message: Any) -> None:
        """Keep the goal of the next plan."""
        self._goal = messages.read_pose(message, self._options.base_frame, self._start)

    def _publish_planned(self, command: HoldCommand) -> None:
        """Publish the planned force of each finger on the object, in O, with the moment about its normal."""
        assert command.record is not None
        now, forces = time.time_ns(), self._control.contact_forces()
        for finger, publisher in self._planned.items():
            force, moment = forces.get(finger, (np.zeros(3), np.zeros(3)))
            publisher.publish(messages.make_wrench(force, moment, self._options.object_frame, now))

    # ── services ─────────────────────────────────────────────────────────────────────────────────────────────────────────

    @staticmethod
    def _answer(act: Callable[[], str]) -> Callable[[Any], Any]:
        """Return the function that answers a request of a service without fields."""

        def answer(request: Any) -> Any:
            try:
                return messages.make_response(True, act())
            except GraspForceError as error:
                return messages.make_response(False, str(error))

        return answer

    def _open(self) -> str:
        """Begin to hold the object."""
        self._control.open()
        return "the hand holds the object"

    def _release(self) -> str:
        """Open the hand."""
        self._control.release()
        return "the hand opens"

    def _plan(self) -> str:
        """Plan a motion to the last goal, publish its trajectory, and follow it."""
        self._control.check_holding()
        if self._goal is None:
            raise RequestRefused("forbidden", "no goal has arrived at ~/goal_pose")
        grasp = self._control.grasp
        pace = plan_to_pose(self._begin_plan, grasp, self._control.settings, self._goal)
        self._control.follow(pace)
        trajectory = messages.make_trajectory(grasp.hand.joint_names, pace.plan.knots, pace.time_scale, time.time_ns())
        self._trajectories.publish(trajectory)
        return f"the object moves to the goal in {pace.duration:.3f} s"

    def _grip(self, goal: Any) -> Any:
        """Carry out a command of a gripper: hold the object at the position 0, and open the hand at any other one."""
        effort = float(goal.command.max_effort)
        if goal.command.position > 0.0:
            self._control.release()
            self._closing.wait(self._control.release_time)
            return self._gripper_result(is_reached=True)
        if effort > 0.0:
            self._control.set_slip_margin(effort)
        self._control.open()
        if not self._control.wait_for_command(_FIRST_COMMAND_TIME):
            raise ServiceTimeout(f"no command within {_FIRST_COMMAND_TIME:g} s: {self._control.problem or 'no joint states'}")
        return self._gripper_result(is_reached=True)

    def _gripper_result(self, is_reached: bool = False) -> Any:
        """Return the state of the hand as that of a gripper."""
        forces = [float(np.linalg.norm(force)) for force, _ in self._control.contact_forces().values()]
        opening = self._control.opening if self._control.mode == "released" else 0.0
        return messages.make_gripper_result(opening, max(forces, default=0.0), is_reached)

    # ── diagnostics ──────────────────────────────────────────────────────────────────────────────────────────────────────

    def _diagnose(self) -> None:
        """Publish diagnostics every second until the node is closed."""
        while not self._closing.wait(_DIAGNOSTIC_PERIOD):
            level, text = self._health()
            values: dict[str, object] = {
                "mode": self._control.mode,
                "interface": self._control.interface,
                "joint states": self._states,
                "lost joint states": self._joints.lost,
                "commands": self._commands_sent,
            }
            if self._control.tips is not None:
                values["measured contact forces"] = self._control.tips.received
            record = None if self._last is None else self._last.record
            if record is not None and self._control.mode == "holding":
                values["least slip margin (N)"] = round(min(record.slip_margin), 4)
                values["saturated"] = record.saturated
                values.update(self._estimated(record))
            name = f"{self._options.name.name}: {self._control.grasp.hand.name}"
            self._diagnostics.publish(messages.make_diagnostics(level, name, text, values, time.time_ns()))

    def _estimated(self, record: CommandRecord) -> dict[str, object]:
        """Return the estimated normal force of each finger, N, and the fingers that slip; nothing without sensors of forces."""
        monitor = None if record.estimate is None else record.estimate.monitor
        if monitor is None:
            return {}
        fingers = self._control.grasp.fingers
        values: dict[str, object] = {
            f"normal force of {finger} (N)": round(force[2], 3) for finger, force in zip(fingers, monitor["force"], strict=True)
        }
        slipping = [finger for finger, slips in zip(fingers, monitor["slipping"], strict=True) if slips]
        return {**values, "slipping": ", ".join(slipping) or "none"}

    def _health(self) -> tuple[int, str]:
        """Return the level of the diagnostics, and their text."""
        if time.monotonic() - self._last_state > _STALE_TIME:
            return messages.STALE, "no joint states"
        if self._control.problem:
            return messages.ERROR, self._control.problem
        record = None if self._last is None else self._last.record
        if self._control.mode == "holding" and record is not None and record.warnings:
            return messages.WARN, "; ".join(record.warnings)
        return messages.OK, self._control.mode


def _open_session(router: str, insecure: bool) -> zenoh.Session:
    """Return a session at the router of ROS 2.

    Raises:
        ServiceError: no router listens there.
        InvalidInput: it is beyond this machine without TLS.
    """
    config = build_configuration(None, {"mode": "client", "listen/endpoints": []}, {"connect/endpoints": [router]})
    check_endpoints(config, insecure)
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        hint = "start it with `ros2 run rmw_zenoh_cpp rmw_zenohd`"
        raise ServiceError(f"no Zenoh router of ROS 2 at {router}: {describe_zenoh_error(error)}; {hint}") from None
