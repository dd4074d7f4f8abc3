"""Exact states of a stream with binary arrays in MessagePack, encoded by compiled code.

Most states have the same parts: joints, object and desired motion. The payload equals that of `StreamState`, byte by byte.
"""

from __future__ import annotations

from typing import Any, cast

from graspforce.control import DesiredMotion, GraspMotion, GraspState
from graspforce.core.arrays import Array
from graspforce.core.compiled import native


def write_state(
    joint_count: int, sequence: int, time: float, state: GraspState, desired: DesiredMotion, external: Array | None
) -> bytes | None:
    """Return the payload of a state; None if `StreamState` must encode it: arrays that do not fit, or no compiled code.

    Args:
        joint_count: number of joints of the hand.
        sequence: as in `StreamState`.
        time: as in `StreamState`, s.
        state: as in `StreamState`.
        desired: as in `StreamState`.
        external: as in `StreamState`.
    """
    if native is None:
        return None
    body, motion = state.object, desired
    joints: tuple[Any, ...] = ()
    if isinstance(motion, GraspMotion):
        joints, motion = (motion.q, motion.v, motion.a), motion.object
    parts = (
        *(state.q, state.v, body.p_HO, body.R_HO, body.twist),
        *(motion.p_HO, motion.R_HO, motion.twist, motion.acceleration),
        *joints,
    )
    if external is not None:
        parts = (*parts, external)
    return cast("bytes | None", native.write_stream_state(parts, joint_count, sequence, time))
