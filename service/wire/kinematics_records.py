"""Requests for the kinematics of a hand, and their answers: postures to tip poses, and tip positions to postures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graspforce.core import arrays, fields
from graspforce.core.arrays import Array
from graspforce.core.errors import InvalidInput
from graspforce.core.json_text import JsonRecord
from graspforce.geometry.poses import pose_from_dict, pose_to_dict
from graspforce.hand.hand import Hand


@dataclass(frozen=True, eq=False, slots=True)
class TipPose:
    """Pose and Jacobian of a fingertip. Frames: H hand base, F tip frame.

    Attributes:
        p_HF: (3,) position of F in H, m.
        R_HF: (3, 3) axes of F in H.
        jacobian: (6, n) Jacobian of the twist of F in H's axes, linear rows first, m/rad and 1.
    """

    p_HF: Array
    R_HF: Array
    jacobian: Array


def forward_record(hand: Hand, request: object) -> JsonRecord:
    """Return the answer to ``hands/<hand>/forward``.

    Args:
        hand: the hand.
        request: record with the `posture`, (n,), rad.

    Raises:
        InvalidInput: a field is missing, unknown or of the wrong shape; names it.
    """
    values = fields.check_record(request, "", required=["posture"])
    q = arrays.check_array(values["posture"], "posture", (hand.n,))
    tips = []
    for finger in hand.fingers:
        p_HF, R_HF = hand.tip_pose(q, finger.name)
        jacobian = hand.point_jacobian(q, finger.name, p_HF)
        tips.append({"finger": finger.name, **pose_to_dict(p_HF, R_HF), "jacobian": jacobian.tolist()})
    return {"joints": list(hand.joint_names), "posture": q.tolist(), "tips": tips}


def inverse_record(hand: Hand, request: object) -> JsonRecord:
    """Return the answer to ``hands/<hand>/inverse``.

    Args:
        hand: the hand.
        request: record with `tips`, the position (3,) of each named finger's tip frame in H, m, and optionally `start`, the
            posture (n,) to start from, rad.

    Raises:
        InvalidInput: a field is missing, unknown or of the wrong shape, or a point is out of reach; names it.
        UnknownName: the hand has no finger of that name.
    """
    values = fields.check_record(request, "", required=["tips"], optional=["start"])
    tips, start = values["tips"], values.get("start")
    if not isinstance(tips, dict) or not tips:
        raise InvalidInput("tips", tips, "a record of positions by finger, with at least one finger")
    q = hand.tip_posture(tips, None if start is None else arrays.check_array(start, "start", (hand.n,)))
    return {"joints": list(hand.joint_names), "posture": q.tolist()}


def read_tip_poses(record: object) -> dict[str, TipPose]:
    """Return the fingertips of an answer to ``forward``, by finger.

    Args:
        record: the answer without the service's own fields.

    Raises:
        InvalidInput: a field is missing, unknown or of the wrong shape; names it.
    """
    values = fields.check_record(record, "", required=["joints", "posture", "tips"])
    joints, found = fields.check_sequence(values["joints"], "joints"), {}
    for i, each in enumerate(fields.check_sequence(values["tips"], "tips")):
        tip = fields.check_record(each, f"tips[{i}]", required=["finger", "position", "rotation", "jacobian"])
        p_HF, R_HF, _ = pose_from_dict({name: tip[name] for name in ("position", "rotation")}, f"tips[{i}]")
        jacobian = arrays.check_array(tip["jacobian"], f"tips[{i}].jacobian", (6, len(joints)))
        found[fields.check_text(tip["finger"], f"tips[{i}].finger")] = TipPose(p_HF, R_HF, jacobian)
    return found


def read_posture(record: object) -> Array:
    """Return the posture (n,) of an answer to ``inverse``, rad.

    Args:
        record: the answer without the service's own fields.

    Raises:
        InvalidInput: a field is missing, unknown or of the wrong shape; names it.
    """
    values = fields.check_record(record, "", required=["joints", "posture"])
    joints = fields.check_sequence(values["joints"], "joints")
    return np.asarray(arrays.check_array(values["posture"], "posture", (len(joints),)))
