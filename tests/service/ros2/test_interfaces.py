"""Types, hashes, keys and CDR of ROS 2: against an installed Jazzy, rmw_zenoh's design document, and an independent library.

The hashes are those of a ROS 2 Jazzy installation (`share/<package>/*/<name>.json`), as public repositories quote them. The
keys and tokens are the examples of rmw_zenoh's design document. zenoh-ros2-sdk builds both on its own.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from zenoh_ros2_sdk.attachment import Attachment as PeerAttachment
from zenoh_ros2_sdk.entity import EndpointEntity, EntityKind, NodeEntity
from zenoh_ros2_sdk.keyexpr import endpoint_liveliness_keyexpr, node_liveliness_keyexpr, topic_keyexpr
from zenoh_ros2_sdk.qos import QosDurability, QosProfile, QosReliability
from zenoh_ros2_sdk.utils import compute_service_type_hash, ros2_to_dds_type

from graspforce.core.errors import InvalidInput
from graspforce.service.ros2 import interfaces
from graspforce.service.ros2.key_expressions import (
    DEFAULT_QOS,
    LATCHED_QOS,
    PUBLISHER,
    SENSOR_QOS,
    SERVICE,
    SUBSCRIPTION,
    Attachment,
    Entity,
    NodeName,
    data_key,
    entity_token,
    node_token,
)

JAZZY = {
    "sensor_msgs/msg/JointState": "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    "std_msgs/msg/Float64MultiArray": "1025ddc6b9552d191f89ef1a8d2f60f3d373e28b283d8891ddcc974e8c55397f",
    "std_srvs/srv/SetBool": "abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a",
    "std_srvs/srv/SetBool_Event": "3c4c20015afb4303eafd347b1d6a786f171a89c814726961a9593ef10df878cf",
    "std_srvs/srv/SetBool_Request": "c62fbb99d94e1b25e8ef9e109f9581956bb1b3361a45a4e5810c36a90d29932e",
    "std_srvs/srv/SetBool_Response": "d0814e7f7b4880ab77e9c57426c7aa1562ab69f11eef8e2e968812f9cbd0b059",
    "std_srvs/srv/Trigger": "eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
}
STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
SESSION = "aac3178e146ba6f1fc6e6a4085e77f21"


@pytest.mark.parametrize("name", JAZZY)
def test_type_hashes_are_those_of_a_ros_installation(name):
    assert interfaces.type_hash(name) == f"RIHS01_{JAZZY[name]}"


def test_services_and_actions_are_built_as_in_ros():
    """Types that the node does not use, with hashes from ROS: AddTwoInts of the design document, LookupTransform of Jazzy."""
    store = interfaces.make_store()
    interfaces.register_service(store, "example_interfaces/srv/AddTwoInts", "int64 a\nint64 b", "int64 sum")
    assert store.hash_rihs01("example_interfaces/srv/AddTwoInts").startswith("RIHS01_e118de6bf5eeb66a2491b5bda11202e7")
    goal = (
        "string target_frame\nstring source_frame\nbuiltin_interfaces/Time source_time\nbuiltin_interfaces/Duration timeout\n"
        "builtin_interfaces/Time target_time\nstring fixed_frame\nbool advanced"
    )
    name = "tf2_msgs/action/LookupTransform"
    interfaces.register_action(store, name, goal, "geometry_msgs/TransformStamped transform\ntf2_msgs/TF2Error error", "")
    parts = {
        "": "0b8adf6bc0b5958879e3265b41a457e03558fe523890a81252c70eba97a82c5d",
        "_SendGoal": "4646ff5706c86b04d0a1098d329951a9731a7517e16702905de6073cc72c8530",
        "_GetResult": "3cd1715751899e3167b5aec3e4ac194f7da9e8493a77285f9f6a4c914f5e8b24",
        "_FeedbackMessage": "10cb89922dcb103e95c185d43e8a5efa3d38db996f733151a2f3e2ac133f4839",
    }
    for part, expected in parts.items():
        assert store.hash_rihs01(name + part) == f"RIHS01_{expected}", part


def test_service_hash_is_that_of_the_peer():
    expected = compute_service_type_hash("std_srvs/srv/SetBool", "bool data", "bool success\nstring message")
    assert interfaces.type_hash("std_srvs/srv/SetBool") == expected


def test_keys_and_tokens_are_those_of_the_design_document():
    chatter = "std_msgs/msg/String"
    assert data_key(0, "/chatter", chatter) == f"0/chatter/std_msgs::msg::dds_::String_/{STRING_HASH}"
    assert data_key(0, "/robot1/chatter", chatter) == f"0/robot1/chatter/std_msgs::msg::dds_::String_/{STRING_HASH}"
    listener = NodeName("listener", domain=2)
    assert node_token(listener, SESSION) == f"@ros2_lv/2/{SESSION}/0/0/NN/%/%/listener"
    entity = Entity(SUBSCRIPTION, 10, "/chatter", chatter)
    expected = f"@ros2_lv/2/{SESSION}/0/10/MS/%/%/listener/%chatter/std_msgs::msg::dds_::String_/{STRING_HASH}/::,10:,:,:,,"
    assert entity_token(listener, SESSION, entity) == expected


KINDS = {PUBLISHER: EntityKind.PUBLISHER, SUBSCRIPTION: EntityKind.SUBSCRIPTION, SERVICE: EntityKind.SERVICE}


@pytest.mark.parametrize("namespace", ["/", "/left", "/robot/left"])
@pytest.mark.parametrize("kind", KINDS)
def test_keys_and_tokens_are_those_of_the_peer(kind, namespace):
    node, name = NodeName("graspforce", namespace, domain=7), "sensor_msgs/msg/JointState"
    peer_node = NodeEntity(7, SESSION, 0, "graspforce", namespace)
    hash_, dds = interfaces.type_hash(name), ros2_to_dds_type(name)
    assert dds == interfaces.dds_type(name)
    assert node_token(node, SESSION) == node_liveliness_keyexpr(peer_node)
    topic = node.resolve("~/joint_states")
    assert data_key(7, topic, name) == topic_keyexpr(7, topic, dds, hash_)
    peer = EndpointEntity(peer_node, 3, KINDS[kind], topic, dds, hash_, DEFAULT_QOS)
    assert entity_token(node, SESSION, Entity(kind, 3, topic, name)) == endpoint_liveliness_keyexpr(peer)


def test_qualities_of_service_read_as_they_are_named():
    assert QosProfile.decode(DEFAULT_QOS) == QosProfile()
    assert QosProfile.decode(SENSOR_QOS) == QosProfile(reliability=QosReliability.BEST_EFFORT)
    assert QosProfile.decode(LATCHED_QOS) == QosProfile(durability=QosDurability.TRANSIENT_LOCAL, history_depth=1)


@given(st.integers(0, 2**63 - 1), st.integers(0, 2**63 - 1), st.binary(min_size=16, max_size=16))
def test_attachments_are_those_of_the_peer(sequence, time, gid):
    ours = Attachment(sequence, time, gid)
    assert ours.encode() == PeerAttachment(sequence, time, gid).to_bytes()
    assert Attachment.decode(ours.encode()) == ours


@given(st.binary(max_size=60))
def test_other_attachments_are_refused(payload):
    if len(payload) != 33 or payload[16] != 16:
        with pytest.raises(InvalidInput):
            Attachment.decode(payload)


def test_names_resolve_as_in_ros():
    node = NodeName("hand", "/left")
    assert [node.resolve(name) for name in ("~/a", "/b/c", "d")] == ["/left/hand/a", "/b/c", "/left/d"]
    assert NodeName("hand").resolve("~/a") == "/hand/a"
    for name in ("", "~/", "a b", "/1a", "a/*", "a//b"):
        with pytest.raises(InvalidInput):
            node.resolve(name)
    for bad in ({"name": "1a"}, {"name": "a", "namespace": "left"}, {"name": "a", "domain": 233}):
        with pytest.raises(InvalidInput):
            NodeName(**bad)


def test_cdr_of_a_joint_state_is_that_of_the_standard():
    """CDR by hand: little-endian integers, texts with length and zero, numbers of 8 bytes aligned after the header."""
    time = interfaces.make("builtin_interfaces/msg/Time", sec=1, nanosec=2)
    header = interfaces.make("std_msgs/msg/Header", stamp=time, frame_id="a")
    message = interfaces.make(
        "sensor_msgs/msg/JointState",
        header=header,
        name=["j"],
        position=np.array([1.5]),
        velocity=np.array([]),
        effort=np.array([]),
    )
    expected = (
        b"\x00\x01\x00\x00"
        + (1).to_bytes(4, "little") + (2).to_bytes(4, "little")
        + (2).to_bytes(4, "little") + b"a\x00" + b"\x00\x00"
        + (1).to_bytes(4, "little") + (2).to_bytes(4, "little") + b"j\x00" + b"\x00\x00"
        + (1).to_bytes(4, "little")
    )  # fmt: skip
    payload = interfaces.encode("sensor_msgs/msg/JointState", message)
    assert payload.startswith(expected)
    rest = payload[len(expected) :]
    padding = -(len(expected) - 4) % 8
    assert rest == b"\x00" * padding + np.array([1.5]).tobytes() + bytes(8)
    assert interfaces.decode("sensor_msgs/msg/JointState", payload).name == ["j"]


@given(st.binary(max_size=200))
def test_payloads_that_are_no_messages_are_refused(payload):
    try:
        interfaces.decode("sensor_msgs/msg/JointState", payload)
    except InvalidInput:
        return
