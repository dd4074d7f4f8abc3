"""Recordings as MCAP files: another library reads them, with Foxglove's schemas, and finds the recording's numbers."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.allegro_grasp import PALM_UP, three_finger_grasp
from support.simulated_runs import SETTINGS, start_of

from graspforce import ObjectController
from graspforce.simulation import Plant, build_scene, linear_reference, simulate
from graspforce.simulation.rendering.mcap_file import save_mcap

pytest.importorskip("foxglove")
reader_module = pytest.importorskip("mcap.reader")
decoder_module = pytest.importorskip("mcap_protobuf.decoder")

GRASP = three_finger_grasp()
FOXGLOVE = {
    "/tf": "FrameTransforms",
    "/scene/parts": "SceneUpdate",
    "/scene/contacts": "SceneUpdate",
    "/object/pose": "PoseInFrame",
    "/object/desired": "PoseInFrame",
    "/joint_states": "JointStates",
    "/log": "Log",
}


@pytest.fixture(scope="module")
def messages(tmp_path_factory):
    """Return the recording, and the decoded messages by topic as (schema, time in s, message)."""
    scene = build_scene(GRASP, gravity_H=PALM_UP)
    motion = linear_reference(start_of(GRASP), [0.0, 0.005, 0.004], 0.2)
    recording = simulate(Plant(scene), ObjectController(GRASP, SETTINGS), motion, 0.1)
    recording = dataclasses.replace(recording, warnings=((0.05, "a finger slips"),), collisions=((0.06, "palm", "link", 2.0),))
    path = tmp_path_factory.mktemp("mcap") / "run.mcap"
    save_mcap(recording, scene, path)
    found: dict[str, list] = {}
    with path.open("rb") as file:
        reader = reader_module.make_reader(file, decoder_factories=[decoder_module.DecoderFactory()], validate_crcs=True)
        for schema, channel, message in reader.iter_messages():
            is_json = channel.message_encoding == "json"
            content = (
                json.loads(message.data)
                if is_json
                else decoder_module.DecoderFactory().decoder_for("protobuf", schema)(message.data)
            )
            found.setdefault(channel.topic, []).append((schema.name, 1e-9 * message.log_time, content))
    return recording, found


def test_topics_have_the_schemas_of_foxglove(messages) -> None:
    _, found = messages
    assert set(found) == {*FOXGLOVE, "/contacts", "/actions"}
    for topic, name in FOXGLOVE.items():
        assert {schema for schema, _, _ in found[topic]} == {f"foxglove.{name}"}


def test_actions_are_the_labels_of_the_recording(messages) -> None:
    recording, found = messages
    labels = recording.motion_labels(GRASP.hand)
    assert {each.finger for each in labels} == {finger.name for finger in GRASP.hand.fingers}
    assert {schema for schema, _, _ in found["/actions"]} == {"graspforce.MotionLabel"}
    written = sorted((t, each["finger"], each["motion"], each["duration"]) for _, t, each in found["/actions"])
    expected = sorted((each.begin, each.finger, each.motion, each.end - each.begin) for each in labels)
    for one, other in zip(written, expected, strict=True):
        assert one[1:3] == other[1:3]
        assert one[0] == pytest.approx(other[0], abs=1e-9)
        assert one[3] == pytest.approx(other[3], abs=1e-9)


def test_poses_and_joints_are_those_of_the_recording(messages) -> None:
    recording, found = messages
    assert len(found["/joint_states"]) == len(recording.t)
    assert len(found["/object/pose"]) == 5  # 50 a second
    for _, t, pose in found["/object/pose"]:
        row = int(np.searchsorted(recording.t, t - 1e-9))
        p, o = pose.pose.position, pose.pose.orientation
        np.testing.assert_allclose([p.x, p.y, p.z], recording.p_HO[row], atol=1e-12)
        np.testing.assert_allclose(Rotation.from_quat([o.x, o.y, o.z, o.w]).as_matrix(), recording.R_HO[row], atol=1e-12)
    for row in (0, 57):
        _, t, joints = found["/joint_states"][row]
        assert t == pytest.approx(recording.t[row])
        assert [each.name for each in joints.joints] == list(recording.joints)
        np.testing.assert_array_equal([each.position for each in joints.joints], recording.q[row])
        np.testing.assert_array_equal([each.effort for each in joints.joints], recording.tau[row])


def test_the_frames_carry_the_parts_and_the_object(messages) -> None:
    recording, found = messages
    _, _, parts = found["/scene/parts"][0]
    _, _, tf = found["/tf"][0]
    frames = {each.child_frame_id: each.translation for each in tf.transforms} | {"hand": None}
    assert {entity.frame_id for entity in parts.entities} <= set(frames)
    assert all(entity.frame_locked for entity in parts.entities)
    object_frame = frames["object"]
    np.testing.assert_allclose([object_frame.x, object_frame.y, object_frame.z], recording.p_HO[0], atol=1e-12)


def test_cones_stand_on_the_contacts_and_open_into_the_object(messages) -> None:
    """The apex of a cone, half its height before its middle, is at the contact point. Its half angle is arctan μ."""
    recording, found = messages
    _, _, update = found["/scene/contacts"][0]
    assert [entity.id for entity in update.entities] == list(recording.fingers)
    for i, entity in enumerate(update.entities):
        (cone,), (arrow,) = entity.cylinders, entity.arrows
        o = cone.pose.orientation
        R = Rotation.from_quat([o.x, o.y, o.z, o.w]).as_matrix()
        middle = np.array([cone.pose.position.x, cone.pose.position.y, cone.pose.position.z])
        contact = recording.p_HO[0] + recording.R_HO[0] @ recording.p_OC[0, i]
        np.testing.assert_allclose(middle - 0.5 * cone.size.z * R[:, 2], contact, atol=1e-9)
        assert cone.size.x / 2.0 / cone.size.z == pytest.approx(recording.mu[0, i])
        assert (cone.bottom_scale, cone.top_scale) == (0.0, 1.0)
        a = arrow.pose.orientation
        along = Rotation.from_quat([a.x, a.y, a.z, a.w]).as_matrix()[:, 0]
        force = recording.R_HO[0] @ recording.R_OC[0, i] @ recording.f[0, i, :3]
        np.testing.assert_allclose(along, force / np.linalg.norm(force), atol=1e-9)


def test_margins_warnings_and_collisions_are_written(messages) -> None:
    recording, found = messages
    _, _, numbers = found["/contacts"][30]
    assert list(numbers["slip_margin"].values()) == pytest.approx(recording.slip_margin[30].tolist())
    assert list(numbers["normal_force"]) == list(recording.fingers)
    assert [log.message for _, _, log in found["/log"]] == ["a finger slips", "palm and link collide with 2.00 N"]
