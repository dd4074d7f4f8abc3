"""Messages to a node of a grasp, for the tests of ROS 2."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from graspforce.service.ros2 import interfaces, messages


def header(time: int, frame: str = "") -> Any:
    """Return a header with a time in ns."""
    stamp = interfaces.make("builtin_interfaces/msg/Time", sec=time // 10**9, nanosec=time % 10**9)
    return interfaces.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def joint_state(time: int, names: list[str], q: np.ndarray, v: np.ndarray | None = None) -> Any:
    """Return a joint state; without rates if `v` is None."""
    none = np.zeros(0)
    rates = none if v is None else v
    return interfaces.make(messages.JOINT_STATE, header=header(time), name=names, position=q, velocity=rates, effort=none)


def pose(time: int, p: np.ndarray, R: np.ndarray, frame: str = "") -> Any:
    """Return a pose."""
    x, y, z, w = Rotation.from_matrix(R).as_quat().tolist()
    position = interfaces.make("geometry_msgs/msg/Point", x=float(p[0]), y=float(p[1]), z=float(p[2]))
    orientation = interfaces.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
    inner = interfaces.make("geometry_msgs/msg/Pose", position=position, orientation=orientation)
    return interfaces.make(messages.POSE, header=header(time, frame), pose=inner)


def wrench(force: np.ndarray, frame: str, moment: np.ndarray | None = None) -> Any:
    """Return a wrench; without a moment if it is None."""
    parts = [force, np.zeros(3) if moment is None else moment]
    vectors = [interfaces.make("geometry_msgs/msg/Vector3", x=float(x), y=float(y), z=float(z)) for x, y, z in parts]
    inner = interfaces.make("geometry_msgs/msg/Wrench", force=vectors[0], torque=vectors[1])
    return interfaces.make(messages.WRENCH, header=header(0, frame), wrench=inner)


def carried(name: str, message: Any) -> Any:
    """Return a message after its encoding and decoding."""
    return interfaces.decode(name, interfaces.encode(name, message))
