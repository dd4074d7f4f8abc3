"""Fair queues: clients take turns, items of one client keep their order, and the busiest client is rejected first."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque

from hypothesis import given, settings
from hypothesis import strategies as st

from graspforce.service.server.deadline import Deadline
from graspforce.service.server.fair_queue import FairQueue


def queue_without_threads(capacity=None):
    """Return a queue in which all items wait."""
    return FairQueue("test", lambda item: None, threads=0, capacity=capacity)


def drained(queue):
    """Remove all items and return them in the order in which a thread would handle them."""
    return [queue._next() for _ in range(len(queue))]


def test_items_of_one_client_keep_their_order():
    queue = queue_without_threads()
    for i in range(5):
        assert queue.offer(i) == []
    assert drained(queue) == [0, 1, 2, 3, 4]


def test_clients_take_turns():
    queue = queue_without_threads()
    for item, client in [("a1", b"a"), ("a2", b"a"), ("a3", b"a"), ("b1", b"b"), ("c1", b"c"), ("c2", b"c")]:
        queue.offer(item, client)
    assert drained(queue) == ["a1", "b1", "c1", "a2", "c2", "a3"]


def test_full_queue_rejects_newest_item_of_busiest_client():
    queue = queue_without_threads(capacity=4)
    for i in range(4):
        assert queue.offer(("flood", i), b"flood") == []
    assert queue.offer(("flood", 4), b"flood") == [("flood", 4)]
    assert queue.offer(("b", 0), b"b") == [("flood", 3)]
    assert queue.offer(("b", 1), b"b") == [("flood", 2)]  # half each
    assert queue.offer(("b", 2), b"b") == [("b", 2)]
    assert queue.offer(("flood", 5), b"flood") == [("flood", 5)]
    assert drained(queue) == [("flood", 0), ("b", 0), ("flood", 1), ("b", 1)]
    empty = queue_without_threads(capacity=0)
    assert empty.offer(1) == [1]


def test_names_of_a_client_share_its_turns():
    """A client with a thousand names gets the same share as one with a single name."""
    queue = queue_without_threads()
    for i in range(1000):
        queue.offer(("flood", i), b"", str(i).encode())
    for i in range(10):
        queue.offer(("polite", i), b"polite")
    assert [client for client, _ in drained(queue)[:20]] == ["flood", "polite"] * 10


def test_full_bytes_reject_the_newest_items_of_the_largest_client():
    queue = FairQueue("test", lambda item: None, threads=0, max_bytes=100)
    assert queue.offer("large 1", b"large", size=40) == []
    assert queue.offer("large 2", b"large", size=40) == []
    assert queue.offer("small", b"small", size=30) == ["large 2"]
    assert queue.bytes == 70
    assert queue.offer("huge", b"other", size=200) == ["huge"]  # nothing is removed for an item that cannot fit
    assert queue.offer("large 3", b"large", size=40) == ["large 3"]
    assert drained(queue) == ["large 1", "small"]
    assert (len(queue), queue.bytes) == (0, 0)


def test_items_of_a_client_that_has_disconnected_are_dropped():
    queue = queue_without_threads()
    for i in range(4):
        queue.offer(i, b"ab"[i % 2 :][:1], size=10)
    assert queue.drop(b"a") == [0, 2]
    assert queue.drop(b"a") == []
    assert (len(queue), queue.bytes) == (2, 20)
    assert drained(queue) == [1, 3]


@given(st.lists(st.one_of(st.none(), st.sampled_from([b"a", b"b", b"c", b"d"])), max_size=80), st.integers(1, 12))
@settings(max_examples=150, deadline=None)
def test_each_item_is_served_once_and_waits_for_at_most_one_of_each_other_client(events, capacity):
    """Offers of four clients and removals (None), compared with a plain model of the queue."""
    queue, inside, number = queue_without_threads(capacity), {client: deque() for client in (b"a", b"b", b"c", b"d")}, 0
    passed = {client: Counter() for client in inside}  # items of others since the client last had a turn
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
            if lost:
                assert sum(map(len, inside.values())) == capacity + 1
                [(owner, item)] = lost
                assert inside[owner].pop() == item  # the newest
                assert len(inside[owner]) + 1 >= max(map(len, inside.values()))
        assert len(queue) == sum(map(len, inside.values())) <= capacity
    assert sorted(queue.take_all()) == sorted((client, item) for client, items in inside.items() for item in items)


def test_close_handles_waiting_items_or_returns_them():
    done, gate = [], threading.Event()
    queue = FairQueue("test", lambda item: (gate.wait(10.0), done.append(item)), threads=2)
    for i in range(6):
        queue.offer(i, bytes([i]))
    gate.set()
    assert queue.close(Deadline(10.0)) == []
    assert sorted(done) == [0, 1, 2, 3, 4, 5]
    release = threading.Event()
    queue = FairQueue("test", lambda item: release.wait(10.0))
    queue.offer(0)
    while len(queue):
        time.sleep(1e-3)  # until a thread handles it
    queue.offer(1)
    assert queue.close(Deadline(0.0)) == [1]
    release.set()


def test_failing_item_does_not_stop_the_queue(caplog):
    done = threading.Event()
    queue = FairQueue("test", lambda item: 1 / item if item == 0 else done.set())
    queue.offer(0)
    queue.offer(1)
    assert done.wait(10.0)
    queue.close(Deadline(10.0))
    assert "a request could not be answered" in caplog.text
