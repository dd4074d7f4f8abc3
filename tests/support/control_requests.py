"""Requests for the tests of control over the wire: a grasp, states near it, and invalid records."""

from __future__ import annotations

import copy
from typing import Any

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graspforce.contact.kinematics import TipContactState
from graspforce.contact.motion import BodyMotion
from graspforce.control import (
    ControlMemory,
    ControlSettings,
    DesiredMotion,
    GraspMotion,
    GraspState,
    PoseGains,
)
from graspforce.control.drives.torque_factors import TorqueFactors
from graspforce.service import ControlRequest, StreamSetup, StreamState
from graspforce.service.wire.protocol import JSON, MSGPACK
from support.box_grasp import make_grasp

CODECS = pytest.mark.parametrize("codec", [JSON, MSGPACK])
ROUNDING = 1e-12  # of numbers of order 1, because normals and tangents are normalised again on arrival
GRASP = make_grasp()
HAND = GRASP.hand
HANDS = {HAND.name: HAND}
CONTROL = f"hands/{HAND.name}/control"
GAINS = PoseGains(kp_linear=900.0, ki_angular=500.0)
SETTINGS = ControlSettings(GAINS, slip_margin=0.2, gravity_H=[0.0, 3.0, -9.0], period=2e-3)
EXTERNAL = np.array([0.05, -0.02, 0.1, 1e-3, 0.0, -2e-3])  # N, N·m


def state(seed: int = 3) -> GraspState:
    """Return a moving state close to the grasp."""
    rng = np.random.default_rng(seed)
    turn = Rotation.from_rotvec(1e-3 * rng.standard_normal(3)).as_matrix()  # rad
    motion = BodyMotion(GRASP.p_HO + 1e-4 * rng.standard_normal(3), GRASP.R_HO @ turn, 0.01 * rng.standard_normal(6))
    return GraspState(GRASP.q + 1e-3 * rng.standard_normal(HAND.n), 0.05 * rng.standard_normal(HAND.n), motion)


def desired(seed: int = 4) -> BodyMotion:
    """Return a desired motion of the object, about a millimetre from the grasp."""
    rng = np.random.default_rng(seed)
    twist, acceleration = 0.02 * rng.standard_normal((2, 6))
    return BodyMotion(GRASP.p_HO + 1e-3 * rng.standard_normal(3), GRASP.R_HO, twist, acceleration)


def desired_with_joints(seed: int = 6) -> GraspMotion:
    """Return the same motion with desired joint motion."""
    rng = np.random.default_rng(seed)
    return GraspMotion(desired(), GRASP.q + 0.01 * rng.standard_normal(HAND.n), *rng.standard_normal((2, HAND.n)))


def memory() -> ControlMemory:
    """Return a possible memory of an earlier step."""
    rng = np.random.default_rng(5)
    k, count = GRASP.contacts.size, len(GRASP.contacts)
    f = np.tile([0.1, -0.05, 1.9], count) + 0.01 * rng.standard_normal(k)  # N
    tip_contacts = TipContactState(GRASP.contacts.p_OC * 1.2, GRASP.contacts.R_OC, GRASP.contacts.p_OC + 1e-5)
    integral, creep = 1e-6 * rng.standard_normal(6), 1e-5 * rng.standard_normal((count, 2))
    spin, (errors, posture) = rng.standard_normal((count, 2)), 0.01 * rng.standard_normal((2, HAND.n))
    factors = TorqueFactors(errors, integral, posture)
    return ControlMemory(integral, GRASP.contacts.R_OC, creep, f, tip_contacts, spin=spin, torque_factors=factors)


def request(**change: Any) -> ControlRequest:
    """Return a control request with all fields."""
    fields = {
        "state": state(),
        "desired": desired_with_joints(),
        "settings": SETTINGS,
        "external": EXTERNAL,
        "memory": memory(),
        **change,
    }
    return ControlRequest(GRASP, **fields)


def setup(**change: Any) -> StreamSetup:
    """Return a stream setup with all fields."""
    return StreamSetup(GRASP, **{"settings": SETTINGS, "validity": 0.05, "memory": memory(), **change})


def stream_state(sequence: int = 7, seed: int = 3, motion: DesiredMotion | None = None) -> StreamState:
    """Return a state of a stream."""
    return StreamState(sequence, 12.25, state(seed), motion or desired_with_joints(), EXTERNAL)


def with_change(record: dict[str, Any], path: tuple[str | int, ...], value: Any) -> dict[str, Any]:
    """Return the record with one value changed; ``...`` removes the field."""
    record = copy.deepcopy(record)
    inner: Any = record
    for step in path[:-1]:
        inner = inner[step]
    if value is ...:
        del inner[path[-1]]
    else:
        inner[path[-1]] = value
    return record


def to_plain(record: Any) -> Any:
    """Return a record with lists in place of arrays, which can be compared."""
    return msgspec.to_builtins(record, enc_hook=lambda value: value.tolist())


def to_binary(record: Any) -> Any:
    """Return a record with the bytes of float64 numbers in place of lists."""
    if isinstance(record, dict):
        return {name: to_binary(item) for name, item in record.items()}
    return np.array(record, dtype="<f8").tobytes() if isinstance(record, list) else record


# fields of a command that a step determines
COMMAND_FIELDS = (
    *("tau", "f", "w", "acceleration", "joint_acceleration", "error", "slip_margin", "creep", "uncontrollable"),
    "structural_wrench",
)
NAN = float("nan")
NOT_A_ROTATION = (2.0 * np.eye(3)).tolist()

_FLAT = [[1e-320, 0.0, 0.0], [0.0, 1e-4, 0.0], [0.0, 0.0, 1e-4]]  # kg·m²

# (path, value, field of the error, begin of what is allowed)
BAD_GRASP = [
    *((("hold", "body", "mass"), value, "hold.body.mass", "at least 1e-09 and at most 1e+06") for value in (1e308, 1e-320)),
    *((("hold", "body", "inertia"), (s * np.eye(3)).tolist(), "hold.body.inertia", "of principal") for s in (1e-320, 1e-21)),
    (("hold", "body", "inertia"), _FLAT, "hold.body.inertia", "of principal moments"),
    (("hold", "body", "inertia", 0, 0), 1e308, "hold.body.inertia[0][0]", "from -1e+09 to 1e+09"),
    (("hold", "body", "centre_of_mass", 2), 1e308, "hold.body.centre_of_mass[2]", "from -1000 to 1000"),
    (("hold", "body"), {"mass": 0.1, "shape": {"type": "sphere", "radius": 1e308}}, "hold.body.shape", "of a size"),
    (("hold", "body"), {"mass": 0.1, "shape": {"type": "sphere", "radius": 1e-50}}, "hold.body.shape", "of a size"),
    (("hold", "body", "shape"), {"type": "sphere", "radius": 1e18}, "hold.body.shape", "of a size"),
    (("hold", "contacts", 1, "position", 0), 1e18, "hold.contacts[1].position[0]", "from -1000 to 1000"),
    *((("hold", "object", "position", 1), s * 1e308, "hold.object.position[1]", "from -1000 to 1000") for s in (1.0, -1.0)),
    (("hold", "posture", 3), 1e308, "hold.posture[3]", "from -1e+06 to 1e+06"),
    (("settings", "gravity", 2), -1e308, "settings.gravity[2]", "from -1e+06 to 1e+06"),
    (("settings", "gains", "kd_linear"), 1e308, "settings.gains.kd_linear", "at least 0 and at most 1e+12"),
    (("settings", "posture_damping"), 1e308, "settings.posture_damping", "at least 0 and at most 1e+06"),
    (("settings", "reflex_time"), 1e308, "settings.reflex_time", "greater than 0 and at most 1e+06"),
    (("memory", "integral", 0), 1e308, "memory.integral[0]", "from -1e+06 to 1e+06"),
    (("hold",), ..., "hold", "given"),
    (("hold", "body", "mass"), 0.0, "hold.body.mass", "greater than 0"),
    (("hold", "body", "shape", "type"), "torus", "hold.body.shape.type", "one of sphere, cylinder, box, superquadric, mesh"),
    (("hold", "contacts", 1, "friction"), NAN, "hold.contacts[1].friction", "a finite number, at least 0"),
    (("hold", "contacts", 1, "finger"), "thumb", "hold.contacts[1].finger", "one of finger_1"),
    (("hold", "posture"), [0.1] * 11, "hold.posture", "a list of 12 numbers, not 11"),
    (("hold", "object", "rotation"), NOT_A_ROTATION, "hold.object.rotation", "a rotation"),
    (("settings", "gravity"), [0.0], "settings.gravity", "a list of 3 numbers, not 1"),
    (("settings", "gravity", 1), NAN, "settings.gravity[1]", "a finite number"),
    (("settings", "period"), 0.0, "settings.period", "greater than 0"),
    (("settings", "period"), 1e18, "settings.period", "at least 1e-06 and at most 10"),
    (("settings", "period"), 1e-320, "settings.period", "at least 1e-06 and at most 10"),
    (("settings", "gains", "kp_linear"), "high", "settings.gains.kp_linear", "a finite number, at least 0"),
    (("settings", "gains", "ki_linear"), 1e9, "settings.gains.ki_linear", "less than kp_linear·kd_linear"),
    (("settings", "gains"), 3.0, "settings.gains", "a record"),
    (("settings", "grip"), 1.0, "settings.grip", "absent: the known fields are gains, slip_margin"),
    (("memory", "integral"), [0.0] * 5, "memory.integral", "a list of 6 numbers, not 5"),
    (("memory", "frames", 2), NOT_A_ROTATION, "memory.frames[2]", "a rotation"),
    (("memory", "touched", "tips"), [[0.0]], "memory.touched.tips", "an array of 4 × 3 numbers"),
    (("memory", "touched", "tip_frames", 1), NOT_A_ROTATION, "memory.touched.tip_frames[1]", "a rotation"),
    (("memory", "touched"), {}, "memory.touched.tips", "given"),
    (("memory", "force"), [1.0], "memory.force", "a list of 12 numbers, not 1"),
]
BAD_STATE = [
    (("state", "posture", 1), 1e308, "state.posture[1]", "from -1e+06 to 1e+06"),
    (("state", "velocity", 2), -1e7, "state.velocity[2]", "from -1e+06 to 1e+06"),
    (("state", "object", "position", 2), -1e308, "state.object.position[2]", "from -1000 to 1000"),
    (("state", "object", "twist", 5), 1e308, "state.object.twist[5]", "from -1e+06 to 1e+06"),
    (("desired", "position", 0), 1001.0, "desired.position[0]", "from -1000 to 1000"),
    (("desired", "twist", 3), 1e308, "desired.twist[3]", "from -1e+06 to 1e+06"),
    (("desired", "acceleration", 0), -1e308, "desired.acceleration[0]", "from -1e+06 to 1e+06"),
    (("desired", "joints", "posture", 0), 1e308, "desired.joints.posture[0]", "from -1e+06 to 1e+06"),
    (("desired", "joints", "velocity", 0), 1e308, "desired.joints.velocity[0]", "from -1e+06 to 1e+06"),
    (("desired", "joints", "acceleration", 0), 1e308, "desired.joints.acceleration[0]", "from -1e+06 to 1e+06"),
    (("external", 4), 1e308, "external[4]", "from -1e+06 to 1e+06"),
    (("state",), ..., "state", "given"),
    (("state", "posture"), [0.1] * 13, "state.posture", "a list of 12 numbers, not 13"),
    (("state", "posture", 4), NAN, "state.posture[4]", "a finite number"),
    (("state", "velocity"), "fast", "state.velocity", "a list of 12 numbers"),
    (("state", "velocity", 2), True, "state.velocity", "a list of 12 numbers"),
    (("state", "object", "position"), [0.0, [1.0], 0.0], "state.object.position", "a list of 3 numbers"),
    (("state", "object", "rotation"), NOT_A_ROTATION, "state.object.rotation", "a rotation"),
    (("state", "object", "twist", 5), NAN, "state.object.twist[5]", "a finite number"),
    (("state", "object", "acceleration"), [0.0] * 6, "state.object.acceleration", "absent"),
    (("desired", "rotation"), ..., "desired", "given with either rotation or quaternion"),
    (("desired", "acceleration"), [0.0] * 3, "desired.acceleration", "a list of 6 numbers, not 3"),
    (("desired",), None, "desired", "a record"),
    (("desired", "joint"), {}, "desired.joint", "absent"),
    (("desired", "joints"), [0.1] * 12, "desired.joints", "a record"),
    (("desired", "joints", "posture"), ..., "desired.joints.posture", "given"),
    (("desired", "joints", "posture"), None, "desired.joints.posture", "a list of 12 numbers"),
    (("desired", "joints", "velocity"), [0.0] * 11, "desired.joints.velocity", "a list of 12 numbers, not 11"),
    (("desired", "joints", "acceleration", 3), NAN, "desired.joints.acceleration[3]", "a finite number"),
    (("external",), [0.0] * 7, "external", "a list of 6 numbers, not 7"),
    (("wrench",), [0.0] * 6, "wrench", "absent: the known fields are"),
]
_NOISES = ("encoder_noise", "encoder_resolution", "velocity_noise", "torque_noise", "current_noise", "tip_force_noise")
_POSE_NOISES = ("position_noise", "angle_noise", "position_bias", "angle_bias")
BAD_SENSORS = [
    *((("sensors",), {"latency": value}, "sensors.latency", "at least 0 and at most 1") for value in (1e3, 1e308)),
    *((("sensors",), {"rate": value}, "sensors.rate", "at least 0.1 and at most 1e+06") for value in (1e-320, 1e308)),
    *((("sensors",), {name: 1e308}, f"sensors.{name}", "at least 0 and at most 1000") for name in _NOISES),
    *((("sensors",), {"camera": {name: 1e308}}, f"sensors.camera.{name}", "at least") for name in _POSE_NOISES),
    (("sensors",), {"camera": {"position_noise": 1e-320}}, "sensors.camera.position_noise", "at least 1e-15"),
    (("sensors",), {"camera": {"rate": 1e-320}}, "sensors.camera.rate", "at least 0.001 and at most 1e+06"),
    (("sensors",), {"camera": {"latency": 1e4}}, "sensors.camera.latency", "at least 0 and at most 1"),
    (("sensors",), {"encoder_noise": True}, "sensors.encoder_noise", "a finite number"),
]
BAD_SETUP = [
    *BAD_GRASP,
    *BAD_SENSORS,
    (("hand",), "left", "hand", "one of four_finger"),
    (("hand",), 3, "hand", "text"),
    (("validity",), 0.0, "validity", "greater than 0"),
    (("period",), 1e-3, "period", "absent: the known fields are hand, hold, settings, validity, memory"),
]
BAD_STREAM_STATE = [
    *BAD_STATE,
    (("sequence",), -1, "sequence", "an integer from 0"),
    (("sequence",), ..., "sequence", "given"),
    (("time",), NAN, "time", "a finite number"),
    (("time",), "noon", "time", "a finite number"),
]
