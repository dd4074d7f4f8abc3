"""An action of ROS 2: goals are carried out one at a time, and have a result. They cannot be cancelled."""

from __future__ import annotations

import logging
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from graspforce.core.errors import GraspForceError
from graspforce.service.ros2 import interfaces
from graspforce.service.ros2.key_expressions import LATCHED_QOS
from graspforce.service.ros2.node import Node

log = logging.getLogger("graspforce.ros2")

UNKNOWN, EXECUTING, SUCCEEDED, ABORTED = 0, 2, 4, 6
"""States of goals, as in ``action_msgs/msg/GoalStatus``."""

_REJECTED = 1  # return code of a request to cancel
_STATUS = "action_msgs/msg/GoalStatusArray"
_CANCEL = "action_msgs/srv/CancelGoal"
_MAX_GOALS = 16  # whose results are kept
_NS = 10**9


@dataclass(eq=False, slots=True)
class _Goal:
    """A goal: its id, when it was accepted in ns, its state and its result."""

    id: Any
    time: int
    state: int = EXECUTING
    result: Any = None
    is_done: threading.Event = field(default_factory=threading.Event)


class ActionServer:
    """An action of a node. A goal that arrives while another one is carried out is rejected.

    Args:
        node: the node.
        name: name of the action; ``~/`` stands for the name of the node.
        type_name: name of its type, such as ``control_msgs/action/GripperCommand``.
        execute: function that carries out a goal and returns its result; an error of graspforce aborts the goal.
        failed: function that returns the result of a goal that was aborted.
    """

    def __init__(self, node: Node, name: str, type_name: str, execute: Callable[[Any], Any], failed: Callable[[], Any]) -> None:
        self._type, self._execute, self._failed = type_name, execute, failed
        self._lock = threading.Lock()
        self._goals: OrderedDict[bytes, _Goal] = OrderedDict()
        self._status = node.publish(f"{name}/_action/status", _STATUS, LATCHED_QOS)
        node.publish(f"{name}/_action/feedback", f"{type_name}_FeedbackMessage")
        node.serve(f"{name}/_action/send_goal", f"{type_name}_SendGoal", self._send_goal)
        node.serve(f"{name}/_action/get_result", f"{type_name}_GetResult", self._get_result)
        node.serve(f"{name}/_action/cancel_goal", _CANCEL, self._cancel_goal)

    def _send_goal(self, request: Any) -> Any:
        """Accept a goal, unless another one is carried out."""
        now = time.time_ns()
        goal, key = _Goal(request.goal_id, now), bytes(request.goal_id.uuid)
        with self._lock:
            is_free = key not in self._goals and all(each.is_done.is_set() for each in self._goals.values())
            if is_free:
                self._goals[key] = goal
                while len(self._goals) > _MAX_GOALS:
                    self._goals.popitem(last=False)
        if is_free:
            self._publish()
            threading.Thread(target=self._run, args=(goal, request.goal), name="ros2-action", daemon=True).start()
        return interfaces.make(f"{self._type}_SendGoal_Response", accepted=is_free, stamp=_time(now))

    def _run(self, goal: _Goal, request: Any) -> None:
        """Carry out a goal."""
        state = ABORTED
        try:
            goal.result = self._execute(request)
            state = SUCCEEDED
        except GraspForceError as error:
            log.warning("a goal of %s is aborted: %s", self._type, error)
        except Exception:
            log.exception("a goal of %s failed", self._type)
        goal.result = self._failed() if state == ABORTED else goal.result
        goal.state = state
        goal.is_done.set()
        self._publish()

    def _get_result(self, request: Any) -> Any:
        """Return the result of a goal when it is done."""
        with self._lock:
            goal = self._goals.get(bytes(request.goal_id.uuid))
        if goal is None:
            state, result = UNKNOWN, self._failed()
        else:
            goal.is_done.wait()
            state, result = goal.state, goal.result
        return interfaces.make(f"{self._type}_GetResult_Response", status=state, result=result)

    def _cancel_goal(self, request: Any) -> Any:
        """Refuse to cancel a goal."""
        return interfaces.make(f"{_CANCEL}_Response", return_code=_REJECTED, goals_canceling=[])

    def _publish(self) -> None:
        """Publish the states of all goals."""
        with self._lock:
            goals = list(self._goals.values())
        states = [
            interfaces.make(
                "action_msgs/msg/GoalStatus",
                goal_info=interfaces.make("action_msgs/msg/GoalInfo", goal_id=goal.id, stamp=_time(goal.time)),
                status=goal.state,
            )
            for goal in goals
        ]
        self._status.publish(interfaces.make(_STATUS, status_list=states))


def _time(time_ns: int) -> Any:
    """Return a time."""
    return interfaces.make("builtin_interfaces/msg/Time", sec=time_ns // _NS, nanosec=time_ns % _NS)
