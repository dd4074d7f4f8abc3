"""A node at a router: an independent library finds it, exchanges messages with it, and calls its services."""

from __future__ import annotations

import itertools
import json
import threading

import numpy as np
import pytest
import zenoh
from support.ros2_peer import HOST, peer, router
from support.servers import wait_until
from zenoh_ros2_sdk.discovery import get_service_names_and_types, get_topic_info, get_topic_names_and_types

from graspforce.service.ros2 import interfaces
from graspforce.service.ros2.key_expressions import Attachment, NodeName, data_key
from graspforce.service.ros2.node import Node
from graspforce.service.zenoh_session import build_configuration

NAME = NodeName("graspforce", "/left")
ARRAY, TRIGGER = "std_msgs/msg/Float64MultiArray", "std_srvs/srv/Trigger"


@pytest.fixture(scope="module")
def address():
    with router() as endpoint:
        yield endpoint


@pytest.fixture
def session(address):
    config = build_configuration(None, {"mode": "client", "connect/endpoints": [address]}, {})
    with zenoh.open(config) as opened:
        yield opened


@pytest.fixture
def joined(address):
    with peer(address) as library:
        yield library


def numbers(values):
    """Return a message of numbers."""
    layout = interfaces.make("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
    return interfaces.make(ARRAY, layout=layout, data=np.array(values, dtype=np.float64))


def trigger_response(success, message):
    return interfaces.make(f"{TRIGGER}_Response", success=success, message=message)


def test_node_is_found_with_its_topics_and_services(session, joined):
    with Node(session, NAME) as node:
        node.publish("~/commands", ARRAY)
        node.subscribe("/joint_states", "sensor_msgs/msg/JointState", lambda message: None)
        node.serve("~/release", TRIGGER, lambda request: trigger_response(True, ""))
        expected = {"/left/graspforce/commands": [ARRAY], "/joint_states": ["sensor_msgs/msg/JointState"]}
        found = {}
        wait_until(lambda: found.update(get_topic_names_and_types(0, HOST, joined.port)) or expected.items() <= found.items())
        info = get_topic_info("/left/graspforce/commands", 0, HOST, joined.port, verbose=True)
        assert (info.publisher_count, info.subscriber_count) == (1, 0)
        assert (info.publishers[0].node_name, info.publishers[0].type_hash) == ("graspforce", interfaces.type_hash(ARRAY))
        assert get_service_names_and_types(0, HOST, joined.port) == [("/left/graspforce/release", [TRIGGER])]
    wait_until(lambda: not get_topic_names_and_types(0, HOST, joined.port))


def test_messages_arrive_unchanged_in_both_directions(session, joined):
    ours, theirs = [], []
    with Node(session, NAME) as node:
        node.subscribe("~/numbers", ARRAY, ours.append)
        publisher = node.publish("~/commands", ARRAY)
        joined.subscriber("/left/graspforce/commands", ARRAY, theirs.append)
        sender = joined.publisher("/left/graspforce/numbers", ARRAY)
        sent = numbers([1.5, -2.0])
        kinds = joined.session.store.types
        same = kinds[ARRAY](kinds["std_msgs/msg/MultiArrayLayout"]([], 0), sent.data)
        wait_until(lambda: sender.publish(layout=same.layout, data=same.data) or bool(ours))
        assert ours[0].data.tolist() == [1.5, -2.0]
        wait_until(lambda: publisher.publish(sent) or bool(theirs))
        assert theirs[0].data.tolist() == [1.5, -2.0]


def test_services_answer_the_library(session, joined):
    with Node(session, NAME) as node:
        node.serve("~/release", TRIGGER, lambda request: trigger_response(True, "released"))
        definition = ("uint8 structure_needs_at_least_one_member", "bool success\nstring message")
        client = joined.client("/left/graspforce/release", TRIGGER, *definition)
        response = client.call(structure_needs_at_least_one_member=0)
        assert (response.success, response.message) == (True, "released")


def test_requests_that_are_none_get_an_error(session, address):
    def fail(request):
        raise ArithmeticError("numbers of the hand")

    with Node(session, NAME) as node:
        node.serve("~/release", TRIGGER, fail)
        key = data_key(0, NAME.resolve("~/release"), TRIGGER)
        attachment = bytes(8) + bytes(8) + b"\x10" + bytes(16)
        proper = b"\x00\x01\x00\x00\x00"
        config = build_configuration(None, {"mode": "client", "connect/endpoints": [address]}, {})
        with zenoh.open(config) as client:
            for payload, given in ((proper, None), (proper, b"short"), (b"", attachment), (proper, attachment)):
                [reply] = client.get(key, payload=payload, attachment=given, timeout=20.0)
                text = reply.err.payload.to_bytes().decode()
                assert text
                assert "numbers of the hand" not in text


def test_a_slow_service_refuses_more_requests_than_it_may_answer_at_once(session, address):
    may_end = threading.Event()

    def wait(request):
        may_end.wait(20.0)
        return trigger_response(True, "")

    with Node(session, NAME) as node:
        node.serve("~/plan", TRIGGER, wait)
        key = data_key(0, NAME.resolve("~/plan"), TRIGGER)
        config = build_configuration(None, {"mode": "client", "connect/endpoints": [address]}, {})
        with zenoh.open(config) as client:
            asked = [
                client.get(key, payload=b"\x00\x01\x00\x00\x00", attachment=bytes(16) + b"\x10" + bytes(16), timeout=20.0)
                for _ in range(10)
            ]
            refused = [next(iter(replies)).err for replies in asked[8:]]
            assert all(b"too many requests" in error.payload.to_bytes() for error in refused)
            may_end.set()
            assert all(next(iter(replies)).ok is not None for replies in asked[:8])


def test_messages_of_another_type_are_counted_and_ignored(session, address):
    ours = []
    with Node(session, NAME) as node:
        subscription = node.subscribe("~/numbers", ARRAY, ours.append)
        config = build_configuration(None, {"mode": "client", "connect/endpoints": [address]}, {})
        with zenoh.open(config) as client:
            key = data_key(0, NAME.resolve("~/numbers"), ARRAY)
            tags = (Attachment(number, 0, bytes(16)).encode() for number in itertools.count(1))
            wait_until(lambda: client.put(key, json.dumps({"data": [1.0]}), attachment=next(tags)) or subscription.refused > 0)
            proper = interfaces.encode(ARRAY, numbers([3.0]))
            wait_until(lambda: client.put(key, proper, attachment=next(tags)) or bool(ours))
            refused = subscription.refused
            wait_until(lambda: client.put(key, proper) or subscription.refused > refused)  # without attachment
    assert ours[0].data.tolist() == [3.0]


def test_lost_messages_are_counted(session, address):
    ours = []
    with Node(session, NAME) as node:
        subscription = node.subscribe("~/numbers", ARRAY, ours.append)
        config = build_configuration(None, {"mode": "client", "connect/endpoints": [address]}, {})
        with zenoh.open(config) as client:
            key = data_key(0, NAME.resolve("~/numbers"), ARRAY)

            def put(sequence, gid):
                payload = interfaces.encode(ARRAY, numbers([float(sequence)]))
                client.put(key, payload, attachment=Attachment(sequence, 0, gid).encode())

            def has(sequence):
                return bool(ours) and ours[-1].data.tolist() == [float(sequence)]

            wait_until(lambda: put(1, bytes(16)) or has(1))
            for sequence, gid, lost in ((2, bytes(16), 0), (6, bytes(16), 3), (9, b"b" * 16, 3)):  # the last: another publisher
                put(sequence, gid)
                wait_until(lambda sequence=sequence: has(sequence))
                assert subscription.lost == lost


def test_a_closed_node_ignores_messages_and_requests(session, address):
    for _ in range(20):  # a message arrives while the subscription ends
        with Node(session, NAME) as node:
            node.subscribe("~/numbers", ARRAY, lambda message: None)
            publisher = node.publish("~/numbers", ARRAY)
            publisher.publish(numbers([1.0]))
        publisher.publish(numbers([2.0]))
    node.close()
