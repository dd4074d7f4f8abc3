"""Plans of moves for the node: made in a planning process of the server, at a pace that the controller can track."""

from __future__ import annotations

import queue
from collections.abc import Callable

from graspforce.control import ControlSettings
from graspforce.core.errors import RequestRefused, ServiceTimeout
from graspforce.core.json_text import JsonRecord
from graspforce.grasp.grasp import Grasp
from graspforce.planning import Move, PathMove, Plan, PlanFailure
from graspforce.planning.tracking import TimeScaledPlan, object_task, time_scale_plan
from graspforce.service.ros2.messages import PoseSample
from graspforce.service.wire import protocol
from graspforce.service.wire.plan_records import read_answer
from graspforce.service.wire.reply import Reply

_BUDGET = 10.0  # s, of a plan
_TRANSFER_TIME = 5.0  # s beyond it

BeginPlan = Callable[[str, bytes, str | None, Callable[[Reply], None]], None]
"""Function that begins a plan: `graspforce.service.Server.begin_plan`."""


def plan_to_pose(begin: BeginPlan, grasp: Grasp, settings: ControlSettings, goal: PoseSample) -> TimeScaledPlan:
    """Return the fastest plan that moves a held object to a pose on a straight line, and that the controller can track.

    Args:
        begin: function that begins a plan.
        grasp: the grasp as it is.
        settings: settings of its controller.
        goal: pose of the object.

    Raises:
        RequestRefused: there is no such plan; the message has the reason.
        InvalidInput: the goal is the present pose.
        ServiceTimeout: no answer arrived in time.
    """
    poses = [grasp.p_HO, goal.p_HO], [grasp.R_HO, goal.R_HO]
    move = PathMove(object_task(grasp, settings), *poses, q_start=grasp.q)
    found = _plan(begin, f"{protocol.hand_key(grasp.hand.name)}/plan", move)
    pace = time_scale_plan(found, grasp, settings) if isinstance(found, Plan) else found
    if isinstance(pace, PlanFailure):
        raise RequestRefused("forbidden", pace.reason)
    return pace


def _plan(begin: BeginPlan, key: str, move: Move) -> Plan | PlanFailure:
    """Return the plan of a move, or the reason why there is none."""
    answers: queue.Queue[Reply] = queue.Queue()
    request = {**move.to_dict(), "budget": _BUDGET}
    begin(key, protocol.encode(request, protocol.MSGPACK), protocol.MSGPACK, answers.put)
    try:
        reply = answers.get(timeout=_BUDGET + _TRANSFER_TIME)
    except queue.Empty:
        raise ServiceTimeout(f"no plan arrived within {_BUDGET + _TRANSFER_TIME:g} s") from None
    record: JsonRecord = protocol.decode(reply.payload, protocol.MSGPACK)  # type: ignore[assignment]  # of the server itself
    if not reply.ok:
        raise protocol.read_error(record)
    return read_answer(move, {name: value for name, value in record.items() if name not in protocol.ANSWER_ENVELOPE})
