"""A thousand random messages of each type: the same bytes as those of an encoder that shares no code with the node's."""

from __future__ import annotations

import dataclasses
import random
import typing
from typing import Any

import pytest
from support import cdr_types

from graspforce.service.ros2 import interfaces

COUNT = 1000
NAMES = {
    "sensor_msgs/msg/JointState": cdr_types.JointState,
    "geometry_msgs/msg/PoseStamped": cdr_types.PoseStamped,
    "geometry_msgs/msg/WrenchStamped": cdr_types.WrenchStamped,
    "std_msgs/msg/Float64MultiArray": cdr_types.Float64MultiArray,
    "trajectory_msgs/msg/JointTrajectory": cdr_types.JointTrajectory,
    "diagnostic_msgs/msg/DiagnosticArray": cdr_types.DiagnosticArray,
    "std_srvs/srv/Trigger_Response": cdr_types.Trigger_Response,
}
LETTERS = "abcdefghijklmnopqrstuvwxyz_0123456789 äΩ"


def random_value(kind: Any, source: random.Random) -> Any:
    """Return a random value of a type of pycdr2."""
    if dataclasses.is_dataclass(kind):
        hints = typing.get_type_hints(kind, include_extras=True)
        return kind(**{each.name: random_value(hints[each.name], source) for each in dataclasses.fields(kind)})
    if kind is str:
        return "".join(source.choices(LETTERS, k=source.randrange(12)))
    if kind is bool:
        return source.random() < 0.5
    name = kind.__metadata__[0]
    if hasattr(name, "subtype"):
        return [random_value(name.subtype, source) for _ in range(source.randrange(5))]
    if name == "float64":
        return source.uniform(-1e6, 1e6)
    lower, upper = {"int32": (-(2**31), 2**31), "uint32": (0, 2**32), "uint8": (0, 256)}[name]
    return source.randrange(lower, upper)


@pytest.mark.parametrize("name", NAMES)
def test_messages_have_the_same_bytes_both_ways(name):
    source, kind = random.Random(name), NAMES[name]
    for _ in range(COUNT):
        value = random_value(kind, source)
        theirs = value.serialize()
        message = interfaces.decode(name, theirs)
        ours = interfaces.encode(name, message)
        assert ours == theirs
        assert kind.deserialize(ours) == value
