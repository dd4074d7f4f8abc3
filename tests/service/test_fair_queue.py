"""Lanes: everybody in turn, each one's items in their order, and room taken from whoever has most."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque

from hypothesis import given, settings
from hypothesis import strategies as st

from graspforce.service.server.fair_queue import FairQueue


def stopped(capacity=None):
    """A lane without threads: what is offered waits."""
    return FairQueue("test", lambda item: None, threads=0, capacity=capacity)


def drained(queue):
    """What a thread would work on, in this order."""
    return [queue._next() for _ in range(len(queue))]


def test_items_of_one_are_worked_on_in_their_order():
    queue = stopped()
    for i in range(5):
        assert queue.offer(i) is None
    assert drained(queue) == [0, 1, 2, 3, 4]


def test_one_of_everybody_in_turn():
    queue = stopped()
    for item, client in [("a1", b"a"), ("a2", b"a"), ("a3", b"a"), ("b1", b"b"), ("c1", b"c"), ("c2", b"c")]:
        queue.offer(item, client)
    assert drained(queue) == ["a1", "b1", "c1", "a2", "c2", "a3"]


def test_who_has_most_waiting_makes_room():
    queue = stopped(capacity=4)
    for i in range(4):
        assert queue.offer(("flood", i), b"flood") is None
    assert queue.offer(("flood", 4), b"flood") == ("flood", 4)
    assert queue.offer(("b", 0), b"b") == ("flood", 3)
    assert queue.offer(("b", 1), b"b") == ("flood", 2)  # half each
    assert queue.offer(("b", 2), b"b") == ("b", 2)
    assert queue.offer(("flood", 5), b"flood") == ("flood", 5)
    assert drained(queue) == [("flood", 0), ("b", 0), ("flood", 1), ("b", 1)]
    nowhere = stopped(capacity=0)
    assert nowhere.offer(1) == 1


@given(st.lists(st.one_of(st.none(), st.sampled_from([b"a", b"b", b"c", b"d"])), max_size=80), st.integers(1, 12))
@settings(max_examples=150, deadline=None)
def test_nothing_is_lost_or_done_twice_and_nobody_waits_for_more_than_one_of_each_other(events, capacity):
    """Offers by four, and takings (None). Against a plain model: what is in the lane, by whom, in order."""
    queue, inside, number = stopped(capacity), {client: deque() for client in (b"a", b"b", b"c", b"d")}, 0
    passed = {client: Counter() for client in inside}  # since the head of whose items could last be taken: how many of others
    for client in events:
        if client is None:
            if not len(queue):
                continue
            owner, item = queue._next()
            assert inside[owner].popleft() == item
            for other in inside:
                if other != owner and inside[other]:
                    passed[other][owner] += 1
                    assert passed[other][owner] <= 1
            passed[owner].clear()
        else:
            number += 1
            if not inside[client]:
                passed[client].clear()
            inside[client].append(number)
            lost = queue.offer((client, number), client)
            if lost is not None:
                assert sum(map(len, inside.values())) == capacity + 1
                owner, item = lost
                assert inside[owner].pop() == item  # the newest
                assert len(inside[owner]) + 1 >= max(map(len, inside.values()))
        assert len(queue) == sum(map(len, inside.values())) <= capacity
    assert sorted(queue.take_all()) == sorted((client, item) for client, items in inside.items() for item in items)


def test_closing_finishes_what_waits_or_hands_it_back():
    done, gate = [], threading.Event()
    queue = FairQueue("test", lambda item: (gate.wait(10.0), done.append(item)), threads=2)
    for i in range(6):
        queue.offer(i, bytes([i]))
    gate.set()
    assert queue.close(time.monotonic() + 10.0) == []
    assert sorted(done) == [0, 1, 2, 3, 4, 5]
    held = threading.Event()
    queue = FairQueue("test", lambda item: held.wait(10.0))
    queue.offer(0)
    while len(queue):
        time.sleep(1e-3)  # until it is being worked on
    queue.offer(1)
    assert queue.close(time.monotonic()) == [1]
    held.set()


def test_a_work_that_fails_does_not_end_the_lane(caplog):
    done = threading.Event()
    queue = FairQueue("test", lambda item: 1 / item if item == 0 else done.set())
    queue.offer(0)
    queue.offer(1)
    assert done.wait(10.0)
    queue.close(time.monotonic() + 10.0)
    assert "a request could not be answered" in caplog.text
