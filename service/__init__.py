"""The network service over Zenoh: server, client, control streams, and the records of requests and answers."""

from graspforce.core.optional_libraries import optional_imports

with optional_imports("zenoh"):
    from graspforce.service.client.client import Client
    from graspforce.service.client.joint_stream import JointStream
    from graspforce.service.client.phase_stream import PhaseStream
    from graspforce.service.client.stream import Stream
    from graspforce.service.client.watchdog import Watchdog
    from graspforce.service.realtime_scheduling import ordinary_scheduling, use_realtime_scheduling
    from graspforce.service.server.force_requests import make_force_problem
    from graspforce.service.server.limits import ServerLimits
    from graspforce.service.server.request_handler import RequestHandler
    from graspforce.service.server.serve import ServeOptions, run_server, serve
    from graspforce.service.server.server import Server
    from graspforce.service.server_process import ServerProcess, start_server_process
    from graspforce.service.wire.command_records import RemoteCommand
    from graspforce.service.wire.control_records import DEFAULT_VALIDITY, ControlRequest, StreamSetup
    from graspforce.service.wire.distribute_records import DistributeRequest
    from graspforce.service.wire.grasp_records import GraspRequest
    from graspforce.service.wire.joint_records import JointStreamSetup, RemoteJointCommand
    from graspforce.service.wire.phase_records import PhaseStreamSetup, RemotePhaseCommand
    from graspforce.service.wire.regrasp_records import RegraspRequest
    from graspforce.service.wire.reply import Reply
    from graspforce.service.wire.status_records import ServerStatus
    from graspforce.service.wire.stream_state import StreamState

__all__ = [
    "DEFAULT_VALIDITY",
    "Client",
    "ControlRequest",
    "DistributeRequest",
    "GraspRequest",
    "JointStream",
    "JointStreamSetup",
    "PhaseStream",
    "PhaseStreamSetup",
    "RegraspRequest",
    "RemoteCommand",
    "RemoteJointCommand",
    "RemotePhaseCommand",
    "Reply",
    "RequestHandler",
    "ServeOptions",
    "Server",
    "ServerLimits",
    "ServerProcess",
    "ServerStatus",
    "Stream",
    "StreamSetup",
    "StreamState",
    "Watchdog",
    "make_force_problem",
    "ordinary_scheduling",
    "run_server",
    "serve",
    "start_server_process",
    "use_realtime_scheduling",
]
