"""Checks of requests that do not depend on their key."""

from __future__ import annotations

import time

from graspforce.core import fields
from graspforce.core.errors import InvalidInput, RequestRefused


def check_deadline(deadline: float, what: str, received: float) -> None:
    """Refuse a request after its deadline.

    Args:
        deadline: the deadline, on the clock `time.perf_counter`, s.
        what: "begun" or "finished", for the message.
        received: when the request arrived, s.

    Raises:
        RequestRefused: the deadline is over.
    """
    now = time.perf_counter()
    if now > deadline:
        budget, elapsed = deadline - received, now - received  # s
        message = f"budget of {budget:.6g} s exceeded: the work was not {what} {elapsed:.6g} s after receipt"
        raise RequestRefused("deadline", message)


def reject_backend(backend: str | None) -> None:
    """Refuse a choice of solver.

    Args:
        backend: name of the solver in the request, or None.

    Raises:
        InvalidInput: there is one.
    """
    if backend is not None:
        raise InvalidInput("backend", backend, "absent: only solve and distribute have a choice of solvers")


def check_empty_request(record: object) -> None:
    """Refuse fields in a request that has none.

    Args:
        record: the request.

    Raises:
        InvalidInput: it has other fields than those of the envelope.
    """
    fields.check_record(record, "", optional=["sequence", "budget"])


def check_contact_count(record: object, most: int) -> None:
    """Refuse too many contacts before any of them is read.

    Args:
        record: the record that has the contacts; anything else is left to the reader.
        most: largest number of contacts.

    Raises:
        RequestRefused: there are more.
    """
    contacts = record.get("contacts") if isinstance(record, dict) else None
    if isinstance(contacts, list) and len(contacts) > most:
        raise RequestRefused("too_large", f"there are {len(contacts)} contacts: at most {most} are allowed")
