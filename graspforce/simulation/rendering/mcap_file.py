"""Recordings as MCAP files with Foxglove's schemas, for its viewer and for other tools that read MCAP.

| topic | schema | contents |
|---|---|---|
| `/tf` | `foxglove.FrameTransforms` | poses of the hand's links and the object, in the frame `hand` |
| `/scene/parts` | `foxglove.SceneUpdate` | their meshes, once |
| `/scene/contacts` | `foxglove.SceneUpdate` | arrows of the contact forces, and friction cones |
| `/object/pose`, `/object/desired` | `foxglove.PoseInFrame` | true and desired pose of the object |
| `/joint_states` | `foxglove.JointStates` | positions, rates and torques of the motors' joints |
| `/contacts` | JSON | normal force and slip margin by finger, N; position error, mm |
| `/actions` | JSON | the motions of the fingers: finger, number and name of the motion, duration, s |
| `/log` | `foxglove.Log` | warnings of the controller, and collisions |

Times count from the start of the run. Pictures and poses have 50 rows a second, joints and contacts as many as the recording.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from graspforce.contact import friction
from graspforce.core import foxglove_messages as fox
from graspforce.core.optional_libraries import optional_imports
from graspforce.core.whole_file import replace_file
from graspforce.learning.actions.labels import LABEL_SCHEMA, MotionLabel
from graspforce.simulation.plants.scene import Scene
from graspforce.simulation.recordings.recording import Recording
from graspforce.simulation.rendering.display_model import DisplayModel
from graspforce.simulation.rendering.marks import recorded_state
from graspforce.simulation.rendering.part_meshes import PartMesh, part_meshes

_FRAME = "hand"  # name of the frame H
_PICTURE_PERIOD = 0.02  # s
_OBJECT_OPACITY = 0.6
_CONTACTS_SCHEMA = {
    "title": "graspforce.Contacts",
    "type": "object",
    "properties": {
        "normal_force": {"type": "object", "description": "by finger, N", "additionalProperties": {"type": "number"}},
        "slip_margin": {"type": "object", "description": "by finger, N", "additionalProperties": {"type": "number"}},
        "position_error": {"type": "number", "description": "distance of the object from its desired position, mm"},
    },
}


def save_mcap(
    recording: Recording,
    scene: Scene,
    path: str | os.PathLike[str],
    directories: Sequence[str | os.PathLike[str]] = (),
) -> None:
    """Write a recording as an MCAP file.

    Args:
        recording: the recording.
        scene: scene of its grasp.
        path: the file; an existing file is replaced.
        directories: directories to search for mesh files, as in `Hand.meshes`.

    Raises:
        MissingLibrary: foxglove-sdk is not installed.
        ModelError: a mesh is missing.
        OSError: the file cannot be written.
    """
    with optional_imports():
        import foxglove
    display, context = DisplayModel(scene, directories=directories), foxglove.Context()
    with replace_file(Path(path)) as temporary, foxglove.open_mcap(temporary, allow_overwrite=True, context=context):
        writer = _Writer(display, context)
        writer.write_parts(part_meshes(display))
        writer.write_log(recording)
        writer.write_actions(recording.motion_labels(scene.grasp.hand))
        next_picture = 0.0
        for row, t in enumerate(recording.t.tolist()):
            if t >= next_picture:
                next_picture += _PICTURE_PERIOD
                writer.write_picture(recording, row)
            writer.write_numbers(recording, row)


class _Writer:
    """Channels of a file that is being written.

    Args:
        display: the model that is shown.
        context: of foxglove; its messages go to the file.
    """

    def __init__(self, display: DisplayModel, context: Any) -> None:
        import foxglove
        from foxglove import channels, messages

        self._m, self._display = messages, display
        self._tf = channels.FrameTransformsChannel("/tf", context=context)
        self._parts = channels.SceneUpdateChannel("/scene/parts", context=context)
        self._contact_marks = channels.SceneUpdateChannel("/scene/contacts", context=context)
        self._pose = channels.PoseInFrameChannel("/object/pose", context=context)
        self._desired = channels.PoseInFrameChannel("/object/desired", context=context)
        self._joints = channels.JointStatesChannel("/joint_states", context=context)
        self._contacts = foxglove.Channel("/contacts", schema=_CONTACTS_SCHEMA, context=context)
        self._actions = foxglove.Channel("/actions", schema=LABEL_SCHEMA, context=context)
        self._log = channels.LogChannel("/log", context=context)

    def write_parts(self, parts: Sequence[PartMesh]) -> None:
        """Write the meshes, which move with their frames.

        Args:
            parts: the meshes.
        """
        m = self._m
        entities = [
            m.SceneEntity(
                frame_id=self._frame(part.body),
                id=part.name,
                frame_locked=True,
                triangles=[
                    m.TriangleListPrimitive(
                        pose=fox.pose(np.zeros(3), np.eye(3)),
                        points=[m.Point3(x=x, y=y, z=z) for x, y, z in part.vertices.tolist()],
                        color=fox.colour(part.colour, _OBJECT_OPACITY if part.is_object else 1.0),
                        indices=part.faces.ravel().tolist(),
                    )
                ],
            )
            for part in parts
        ]
        self._parts.log(m.SceneUpdate(entities=entities), log_time=0)

    def write_log(self, recording: Recording) -> None:
        """Write the warnings and the collisions of a recording.

        Args:
            recording: the recording.
        """
        m = self._m
        lines = [(t, text) for t, text in recording.warnings]
        lines += [(t, f"{first} and {second} collide with {force:.2f} N") for t, first, second, force in recording.collisions]
        for t, text in sorted(lines):
            message = m.Log(timestamp=fox.timestamp(t), level=m.LogLevel.Warning, message=text, name=recording.hand)
            self._log.log(message, log_time=fox.log_time(t))

    def write_actions(self, labels: Sequence[MotionLabel]) -> None:
        """Write the motions of the fingers.

        Args:
            labels: the labels.
        """
        for each in labels:
            self._actions.log(each.to_record(), log_time=fox.log_time(each.begin))

    def write_picture(self, recording: Recording, row: int) -> None:
        """Write the frames of all bodies, the object's poses, and the marks of the contacts.

        Args:
            recording: the recording.
            row: index of the step.
        """
        m, display, t = self._m, self._display, float(recording.t[row])
        state = recorded_state(display.scene, recording, row)
        display.update(state)
        time = fox.log_time(t)
        data = display.data
        transforms = [
            fox.transform(t, _FRAME, self._frame(body), data.xpos[body], data.xmat[body].reshape(3, 3))
            for body in range(1, display.model.nbody)
        ]
        self._tf.log(m.FrameTransforms(transforms=transforms), log_time=time)
        for channel, p, R in (
            (self._pose, recording.p_HO[row], recording.R_HO[row]),
            (self._desired, recording.p_desired[row], recording.R_desired[row]),
        ):
            channel.log(fox.pose_in_frame(t, _FRAME, p, R), log_time=time)
        entities = [fox.contact_entity(t, _FRAME, mark) for mark in state.contacts]
        self._contact_marks.log(m.SceneUpdate(entities=entities), log_time=time)

    def write_numbers(self, recording: Recording, row: int) -> None:
        """Write joints, normal forces, slip margins and position error of a step.

        Args:
            recording: the recording.
            row: index of the step.
        """
        t, q, v, tau = float(recording.t[row]), recording.q[row], recording.v[row], recording.tau[row]
        time = fox.log_time(t)
        self._joints.log(fox.joint_states(t, recording.joints, q, v, tau), log_time=time)
        margins = friction.slip_margin(recording.f[row], recording.mu[row], recording.gamma[row]).tolist()
        forces = recording.f[row, :, 2].tolist()
        error = 1e3 * float(np.linalg.norm(recording.p_HO[row] - recording.p_desired[row]))  # mm
        numbers = {
            "normal_force": dict(zip(recording.fingers, forces, strict=True)),
            "slip_margin": dict(zip(recording.fingers, margins, strict=True)),
            "position_error": error,
        }
        self._contacts.log(numbers, log_time=time)

    def _frame(self, body: int) -> str:
        """Return the name of a body's frame."""
        return str(self._display.model.body(body).name) if body else _FRAME
