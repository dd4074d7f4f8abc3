"""The network service: a server, a client, and the records that only the wire knows."""

from graspforce.service.client import Client
from graspforce.service.handler import Handler, Limits, Reply, force_problem
from graspforce.service.records import DistributeRequest, ServerStatus
from graspforce.service.server import Server, serve

__all__ = [
    "Client",
    "DistributeRequest",
    "Handler",
    "Limits",
    "Reply",
    "Server",
    "ServerStatus",
    "force_problem",
    "serve",
]
