"""Deadlines that a signal handler can bring forward."""

from __future__ import annotations

import threading
import time

from graspforce.service.server.deadline import Deadline


def test_limit_brings_a_deadline_forward_and_never_back():
    deadline = Deadline(100.0)
    deadline.limit(200.0)
    assert deadline.remaining <= 100.0
    deadline.limit(50.0)
    assert 0.0 < deadline.remaining <= 50.0
    deadline.expire()
    deadline.limit(50.0)
    assert deadline.remaining == 0.0


def test_join_ends_when_the_deadline_expires():
    forever = threading.Event()
    thread = threading.Thread(target=forever.wait, daemon=True)
    thread.start()
    deadline = Deadline(100.0)
    joining = threading.Thread(target=deadline.join, args=(thread,))
    joining.start()
    joining.join(0.3)
    assert joining.is_alive()
    assert thread.is_alive()
    deadline.expire()
    joining.join(10.0)
    assert not joining.is_alive()
    assert thread.is_alive()
    forever.set()
    Deadline(10.0).join(thread)
    assert not thread.is_alive()


def test_join_waits_the_extra_time_after_the_deadline():
    forever = threading.Event()
    thread = threading.Thread(target=forever.wait, daemon=True)
    thread.start()
    deadline, start = Deadline(0.0), time.monotonic()
    deadline.join(thread, extra=0.2)
    assert time.monotonic() - start >= 0.2
    forever.set()
