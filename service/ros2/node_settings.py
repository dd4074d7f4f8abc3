"""Settings of the node of a grasp as texts ``NAME=VALUE``, for the command line."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

from graspforce.control import ControlSettings
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.service.ros2.grasp_node import NodeOptions
from graspforce.service.ros2.hold_control import HoldOptions
from graspforce.service.ros2.key_expressions import NodeName

_NAME = ("name", "namespace", "domain")  # of the node
_TOPICS = ("joint_states", "object_pose", "commands", "base_frame", "object_frame")
_HOLD = ("rate", "interface", "encoder_noise", "tip_force_noise", "opening", "release_time")
_CONTROL = ("slip_margin",)
_TEXTS = ("name", "namespace", "interface", *_TOPICS)
SETTING_NAMES = (*_NAME, *_TOPICS, *_HOLD, *_CONTROL)
"""Names of the settings."""


def read_settings(settings: Iterable[str], insecure: bool = False) -> tuple[NodeOptions, HoldOptions]:
    """Return the options of a node and of its control; the others have their defaults.

    Args:
        settings: the texts. The default of `domain` is the environment variable ``ROS_DOMAIN_ID``.

        insecure: as in `NodeOptions`.

    Raises:
        UnknownName: there is no such setting.
        InvalidInput: a value is not allowed.
    """
    given: dict[str, Any] = {"domain": _number("domain", os.environ.get("ROS_DOMAIN_ID") or "0")}
    for setting in settings:
        name, _, text = setting.partition("=")
        if name not in SETTING_NAMES:
            raise UnknownName("setting", name, SETTING_NAMES)
        given[name] = text if name in _TEXTS else _number(name, text)

    def part(names: Iterable[str]) -> dict[str, Any]:
        return {name: given[name] for name in names if name in given}

    node = NodeOptions(name=NodeName(**{"name": "graspforce", **part(_NAME)}), insecure=insecure, **part(_TOPICS))
    return node, HoldOptions(**part(_HOLD), settings=ControlSettings(**part(_CONTROL)))


def _number(name: str, text: str) -> float:
    """Return the number of a text; a whole one for the domain."""
    try:
        return int(text) if name == "domain" else float(text)
    except ValueError:
        raise InvalidInput(name, text, "a whole number" if name == "domain" else "a number") from None
