"""The limits of a server."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ServerLimits:
    """Limits on requests, streams and plans. The server refuses what exceeds them.

    Args:
        payload: bytes of a request; beyond, ``too_large``.
        contacts: contacts of a problem; beyond, ``too_large``.
        matrix_entries: entries of a problem's dense constraint matrix; beyond, ``too_large``.
        streams: open control streams; beyond, ``overloaded``.
        plans: moves that are planned at the same time, each in a process of its own; beyond, ``overloaded``.
        plan_budget: largest budget of a plan, s; beyond, ``invalid``.
        intervals: largest number of intervals of a plan; beyond, ``invalid``.
        idle_timeout: time without states after which a stream is closed, s.
    """

    payload: int = 8 * 2**20
    contacts: int = 500
    matrix_entries: int = 5_000_000
    streams: int = 64
    plans: int = 2
    plan_budget: float = 60.0
    intervals: int = 500
    idle_timeout: float = 10.0
