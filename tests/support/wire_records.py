"""Requests of all kinds with all their optional records, each with the function that reads it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from graspforce.contact.contact import Contact
from graspforce.control import ContactChange, ControlSettings
from graspforce.control.friction.friction_compensation import FrictionSettings
from graspforce.control.phases.motion_profile import CarryProfiles, MotionProfile
from graspforce.control.phases.phase_settings import PhaseSettings
from graspforce.estimation.sensor_model import CameraModel, SensorModel
from graspforce.force.problem import ForceProblem
from graspforce.force.uncertainty import Uncertainty
from graspforce.geometry import Box, Cylinder, Sphere, Superquadric
from graspforce.grasp.body import Body
from graspforce.grasp.collision.obstacle import Obstacle
from graspforce.grasp.collision.settings import CollisionSettings
from graspforce.hand.drives.joint_friction import JointFriction
from graspforce.planning import move_from_dict
from graspforce.planning.regrasp import RegraspSettings, goal_from_steps
from graspforce.service import ControlRequest, DistributeRequest, GraspRequest, RegraspRequest, StreamState
from graspforce.service.wire.kinematics_records import forward_record, inverse_record
from graspforce.service.wire.phase_records import PhaseState
from graspforce.service.wire.protocol import JSON, encode
from graspforce.service.wire.stream_setups import read_setup
from support import control_requests, plan_requests, service_requests
from support.wire_page import page_requests

HAND = control_requests.HAND
Case = tuple[str, dict[str, Any], Callable[[dict[str, Any]], object]]
"""Name of a schema, a record, and the function that reads it."""

_TETRAHEDRON = {
    "type": "mesh",
    "vertices": [[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.0, 0.05, 0.0], [0.0, 0.0, 0.05]],
    "faces": [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
}


def read_problem(record: dict[str, Any]) -> object:
    """Read a force problem."""
    return ForceProblem.from_dict(record)


def read_control(record: dict[str, Any]) -> object:
    """Read a control request."""
    return ControlRequest.from_dict(HAND, record)


def read_stream(record: dict[str, Any]) -> object:
    """Read the setup of a stream."""
    return read_setup(control_requests.HANDS, record)


def read_state(record: dict[str, Any]) -> object:
    """Read a state of a stream that controls a held object."""
    return StreamState.from_dict(HAND, record)


def read_phase_state(record: dict[str, Any]) -> object:
    """Read a state of a stream of phases."""
    return PhaseState.decode(HAND, encode(record, JSON), JSON)


def read_move(record: dict[str, Any]) -> object:
    """Read a move."""
    return move_from_dict(record, plan_requests.hand())


def _page_record(key: str) -> dict[str, Any]:
    """Return the record of the page's request to a key, without its id and its budget."""
    record = next(record for kind, each, record in page_requests() if (kind, each) == ("query", key))
    return {name: value for name, value in record.items() if name not in ("id", "budget")}


def cases() -> list[Case]:
    """Return requests and states of all kinds."""
    n = HAND.n
    friction = FrictionSettings(model=JointFriction(np.full(n, 0.01)))
    obstacle = Obstacle(Cylinder(0.1, 0.02), [0.0, 0.0, -0.2])
    settings = ControlSettings(friction=friction, obstacles=[obstacle]).to_dict()
    sensors = SensorModel(camera=CameraModel()).to_dict()
    problem = service_requests.pinch(
        hand={"jacobian": np.eye(6).tolist()},
        cone={"type": "pyramid", "facets": 8, "side": "inner"},
        objective={"type": "torque", "force_weight": 1e-6},
        uncertainty=Uncertainty(0.1, mass_error=0.1).to_dict(),
    )
    control = control_requests.request(desired=control_requests.desired_with_joints()).to_dict() | {"settings": settings}
    control["memory"] = control_requests.memory().to_dict()
    setup = control_requests.setup().to_dict() | {"settings": settings, "sensors": sensors}
    setup["offset"] = {"position": [0.0, 0.0, 0.001], "quaternion": [1.0, 0.0, 0.0, 0.0]}
    cycle = _page_record("streams/my-cycle") | {"phases": PhaseSettings().to_dict(), "sensors": sensors, "settings": settings}
    cycle["plan"]["profiles"] = CarryProfiles(*[MotionProfile.least_jerk(0.3)] * 3).to_dict()
    joints = _page_record("streams/my-joints")
    gains = {name: value for name, value in joints.items() if name != "frequency"} | {
        "gains": {"kp": [9.0] * n, "kv": [6.0] * n}
    }
    state = control_requests.stream_state(motion=control_requests.desired_with_joints()).to_dict()
    state["conditions"] = {"slipping": [False] * 4, "friction": [0.5] * 4, "lost": [], "touching": [True] * 4}
    contact = Contact([0.03, 0.0, 0.0], [-1, 0, 0], friction=0.5)
    change = ContactChange(release=["finger_2"], add={"finger_1": contact}).to_dict()
    measured = {"sequence": 1, "time": 2.0, "desired": state["desired"], "contacts": {"number": 1, **change}}
    measured["measurement"] = {
        "t": 1.0, "posture": [0.0] * n, "object": {"t": 0.9, "position": [0, 0, 0.05], "quaternion": [1, 0, 0, 0]},
    }  # fmt: skip
    shapes = [Sphere(0.03), Box([0.06, 0.06, 0.05]), Cylinder(0.03, 0.08), Superquadric([0.03, 0.03, 0.04], [0.5, 0.8])]
    bodies = [Body.solid(shape, 0.2).to_dict() for shape in shapes] + [{"mass": 0.1, "shape": _TETRAHEDRON}]
    collisions = CollisionSettings(0.002, [Obstacle(Sphere(0.01), [0.3, 0.0, 0.0])]).to_dict()
    moves = [move.to_dict() | {"collisions": collisions} for move in plan_requests.moves().values()]
    turned = goal_from_steps(control_requests.GRASP, [0.0, 0.0, 0.0], [0.0, 0.0, 0.5], ControlSettings())
    regrasp = RegraspRequest(turned, RegraspSettings(margin=0.1)).to_dict() | {"settings": settings}
    limits = {"acceleration_limits": {"linear": 5.0, "angular": 50.0, "joints": 400.0}}
    return [
        ("solve/request", problem, read_problem),
        ("quality/request", problem, read_problem),
        ("hands/forward/request", {"posture": [0.0] * n}, lambda record: forward_record(HAND, record)),
        ("hands/inverse/request", _page_record("hands/four_finger/inverse"), lambda record: inverse_record(HAND, record)),
        *(("hands/grasp/request", {"body": body, "friction": 0.6}, GraspRequest.from_dict) for body in bodies),
        (
            "hands/distribute/request",
            service_requests.distribute_request(HAND).to_dict() | {name: problem[name] for name in ("cone", "uncertainty")},
            DistributeRequest.from_dict,
        ),
        ("hands/control/request", control, read_control),
        *(("hands/plan/request", move | limits, read_move) for move in moves),
        ("hands/regrasp/request", regrasp | {"collisions": collisions}, lambda record: RegraspRequest.from_dict(HAND, record)),
        *(("streams/request", record, read_stream) for record in (setup, cycle, joints, gains)),
        ("streams/state", state, read_state),
        ("streams/state", measured, read_state),
        ("streams/state", {name: measured[name] for name in ("sequence", "time", "measurement")}, read_phase_state),
    ]
