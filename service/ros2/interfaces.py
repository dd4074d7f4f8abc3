"""Messages, services and actions of ROS 2: their types, type hashes and encoding (CDR), by the library rosbags.

The messages are those of ROS 2 Jazzy. Their type hashes follow REP 2016, so that a message with other fields has another hash,
and never reaches a node that expects these. Services and actions are built from the definitions below as rosidl builds them:
a service of a request, a response and an event; an action of two services and a feedback message.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from graspforce.core.errors import InvalidInput
from graspforce.core.optional_libraries import optional_imports

# Definitions beyond the messages of rosbags: (request, response), or (goal, result, feedback).
_MESSAGES = {"control_msgs/msg/GripperCommand": "float64 position\nfloat64 max_effort"}
_SERVICES = {
    "std_srvs/srv/Trigger": ("", "bool success\nstring message"),
    "std_srvs/srv/SetBool": ("bool data", "bool success\nstring message"),
    "rcl_interfaces/srv/DescribeParameters": ("string[] names", "ParameterDescriptor[] descriptors"),
    "rcl_interfaces/srv/GetParameters": ("string[] names", "ParameterValue[] values"),
    "rcl_interfaces/srv/GetParameterTypes": ("string[] names", "uint8[] types"),
    "rcl_interfaces/srv/ListParameters": ("string[] prefixes\nuint64 depth", "ListParametersResult result"),
    "rcl_interfaces/srv/SetParameters": ("Parameter[] parameters", "SetParametersResult[] results"),
    "rcl_interfaces/srv/SetParametersAtomically": ("Parameter[] parameters", "SetParametersResult result"),
    "action_msgs/srv/CancelGoal": ("GoalInfo goal_info", "int8 return_code\nGoalInfo[] goals_canceling"),
}
_GRIPPER_STATE = "float64 position\nfloat64 effort\nbool stalled\nbool reached_goal"
_ACTIONS = {
    "control_msgs/action/GripperCommand": ("control_msgs/GripperCommand command", _GRIPPER_STATE, _GRIPPER_STATE),
}
_EMPTY = "uint8 structure_needs_at_least_one_member"  # of records without fields


_EVENT_INFO = "service_msgs/msg/ServiceEventInfo"


def make_store() -> Any:
    """Return a store of the messages of ROS 2 Jazzy.

    Raises:
        MissingLibrary: rosbags is not installed.
    """
    with optional_imports():
        from rosbags.typesys import Stores, get_typestore
    store = get_typestore(Stores.ROS2_JAZZY)
    constants, members = store.fielddefs[_EVENT_INFO]
    # rosidl reads char as uint8, the library as a type of its own: the hashes of all services depend on it.
    store.fielddefs[_EVENT_INFO] = constants, [(name, _replace(kind, {"char": "uint8"})) for name, kind in members]
    return store


@cache
def _store() -> Any:
    """Return the store with the node's services and actions."""
    store = make_store()
    for name, text in _MESSAGES.items():
        _register(store, name, text)
    for name, parts in _SERVICES.items():
        register_service(store, name, *parts)
    for name, (goal, result, feedback) in _ACTIONS.items():
        register_action(store, name, goal, result, feedback)
    return store


def register_service(store: Any, name: str, request: str, response: str) -> None:
    """Register a service with its request, response and event.

    Args:
        store: the store of types.
        name: name of the service, such as ``std_srvs/srv/Trigger``.
        request: fields of the request, as in a message definition.
        response: fields of the response.
    """
    _register(store, f"{name}_Request", request)
    _register(store, f"{name}_Response", response)
    _register(
        store,
        f"{name}_Event",
        f"service_msgs/ServiceEventInfo info\n{name}_Request[<=1] request\n{name}_Response[<=1] response",
    )
    parts = ("Request request_message", "Response response_message", "Event event_message")
    _register(store, name, "\n".join(f"{name}_{part}" for part in parts))


def register_action(store: Any, name: str, goal: str, result: str, feedback: str) -> None:
    """Register an action with its services and its feedback message.

    Args:
        store: the store of types.
        name: name of the action, such as ``control_msgs/action/GripperCommand``.
        goal: fields of the goal, as in a message definition.
        result: fields of the result.
        feedback: fields of the feedback.
    """
    uuid = "unique_identifier_msgs/UUID goal_id"
    for part, text in (("Goal", goal), ("Result", result), ("Feedback", feedback)):
        _register(store, f"{name}_{part}", text)
    register_service(store, f"{name}_SendGoal", f"{uuid}\n{name}_Goal goal", "bool accepted\nbuiltin_interfaces/Time stamp")
    register_service(store, f"{name}_GetResult", uuid, f"int8 status\n{name}_Result result")
    _register(store, f"{name}_FeedbackMessage", f"{uuid}\n{name}_Feedback feedback")
    parts = (
        *("Goal goal", "Result result", "Feedback feedback", "SendGoal send_goal_service"),
        *("GetResult get_result_service", "FeedbackMessage feedback_message"),
    )
    _register(store, name, "\n".join(f"{name}_{part}" for part in parts))


def _register(store: Any, name: str, text: str) -> None:
    """Register a type under its own name; the library's parser would insert ``msg`` into names of services and actions."""
    from rosbags.typesys import get_types_from_msg

    package = name.partition("/")[0]
    plain, restored = f"{package}/msg/Parsed", {}
    for known in sorted({*_names_in(text)}, key=len, reverse=True):
        stand_in = known.replace("/srv/", "/msg/").replace("/action/", "/msg/")
        text = text.replace(known, stand_in)
        restored[stand_in] = known
    (constants, fields) = get_types_from_msg(text or _EMPTY, plain)[plain]
    store.register({name: (constants, [(field, _replace(kind, restored)) for field, kind in fields])})


def _names_in(text: str) -> list[str]:
    """Return the names of services' and actions' parts in a definition."""
    types = (line.split(" ")[0].partition("[")[0] for line in text.splitlines())
    return [name for name in types if "/srv/" in name or "/action/" in name]


def _replace(kind: Any, names: dict[str, str]) -> Any:
    """Return the description of a field with other names of types."""
    if isinstance(kind, str):
        return names.get(kind, kind)
    return tuple(_replace(part, names) for part in kind) if type(kind) is tuple else kind


def type_hash(name: str) -> str:
    """Return the type hash of a message, a service or an action.

    Args:
        name: its name, such as ``sensor_msgs/msg/JointState``.

    Raises:
        MissingLibrary: rosbags is not installed.
    """
    return _hash(name)


@cache
def _hash(name: str) -> str:
    """Return the type hash, which is computed once."""
    return str(_store().hash_rihs01(name))


def dds_type(name: str) -> str:
    """Return the name of a type in key expressions.

    Args:
        name: its name, such as ``sensor_msgs/msg/JointState``, which gives ``sensor_msgs::msg::dds_::JointState_``.
    """
    package, kind, short = name.split("/")
    return f"{package}::{kind}::dds_::{short}_"


def make(name: str, /, **fields: Any) -> Any:
    """Return a message. All its fields must be given; arrays of numbers are NumPy arrays.

    Args:
        name: name of its type.
        fields: values of its fields.
    """
    return _store().types[name](**fields)


def encode(name: str, message: Any) -> bytes:
    """Return a message in CDR, little-endian, with its header of 4 bytes.

    Args:
        name: name of its type.
        message: the message.
    """
    return bytes(_store().serialize_cdr(message, name))


def decode(name: str, payload: bytes) -> Any:
    """Return a message.

    Args:
        name: name of its type.
        payload: the message in CDR.

    Raises:
        InvalidInput: the payload is not such a message.
    """
    try:
        return _store().deserialize_cdr(payload, name)
    except Exception as error:  # the library's generated code raises many types
        raise InvalidInput("payload", f"{len(payload)} bytes", f"a message {name} in CDR ({error})") from None
