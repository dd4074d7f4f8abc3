"""The limits of a server."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ServerLimits:
    """Limits on requests, streams and plans. The server refuses requests that exceed them, with the error code given below.

    Args:
        payload: bytes of a request (``too_large``).
        contacts: contacts of a problem (``too_large``).
        matrix_entries: entries of a problem's dense constraint matrix (``too_large``).
        streams: open control streams (``overloaded``).
        plans: moves that are planned at the same time, each in a process of its own (``overloaded``).
        plan_budget: largest budget of a plan, s (``invalid``).
        intervals: largest number of intervals of a plan (``invalid``).
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
