"""The network service: a server, a client, control streams, and the records that only the wire knows."""

from graspforce.service.client import Client
from graspforce.service.commands import RemoteCommand
from graspforce.service.control_records import VALIDITY, ControlRequest, StreamOpening
from graspforce.service.handler import Handler, Limits, force_problem
from graspforce.service.process import OwnProcess, own_process
from graspforce.service.records import DistributeRequest, ServerStatus
from graspforce.service.reply import Reply
from graspforce.service.server import Server, serve
from graspforce.service.stream import Stream
from graspforce.service.stream_state import StreamState
from graspforce.service.watchdog import Watchdog

__all__ = [
    "VALIDITY",
    "Client",
    "ControlRequest",
    "DistributeRequest",
    "Handler",
    "Limits",
    "OwnProcess",
    "RemoteCommand",
    "Reply",
    "Server",
    "ServerStatus",
    "Stream",
    "StreamOpening",
    "StreamState",
    "Watchdog",
    "force_problem",
    "own_process",
    "serve",
]
