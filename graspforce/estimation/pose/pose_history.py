"""History of poses, from which the pose at the time of a late image is interpolated."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from typing import NamedTuple

from graspforce.core.arrays import Array
from graspforce.core.records import unchecked_constructor
from graspforce.geometry.poses import interpolate_pose

_CHUNK = 32  # entries; appending copies at most so many references


class TimedPose(NamedTuple):
    """Pose of the object in H at a time.

    Attributes:
        t: time, s.
        p_HO: (3,) position, m.
        R_HO: (3, 3) axes in H.
    """

    t: float
    p_HO: Array
    R_HO: Array


@dataclass(frozen=True, eq=False, slots=True)
class PoseHistory:
    """Poses in the order of their times. Appending returns a new history and shares the old entries.

    Attributes:
        chunks: full chunks of entries, the oldest first.
        recent: the entries after them.
    """

    chunks: tuple[tuple[TimedPose, ...], ...] = ()
    recent: tuple[TimedPose, ...] = ()

    def append(self, pose: TimedPose, max_length: int) -> PoseHistory:
        """Return the history with another pose.

        Args:
            pose: a pose later than all others.
            max_length: number of entries above which the oldest are dropped, chunk by chunk.
        """
        recent = (*self.recent, pose)
        if len(recent) < _CHUNK:
            return _make_history(self.chunks, recent)
        return _make_history((*self.chunks, recent)[-max(max_length // _CHUNK, 1) :], ())

    @property
    def newest(self) -> TimedPose:
        """The last entry of a history that is not empty."""
        return self.recent[-1] if self.recent else self.chunks[-1][-1]

    def pose_at(self, t: float) -> TimedPose | None:
        """Return the pose at a time, interpolated on SE(3); None before the first and after the last entry.

        Args:
            t: time, s.
        """
        chunks = (*self.chunks, self.recent)
        i = next((i for i in reversed(range(len(chunks))) if chunks[i] and chunks[i][0].t <= t), None)
        if i is None:
            return None
        k = bisect_right(chunks[i], t, key=lambda pose: pose.t)  # at least 1
        before = chunks[i][k - 1]
        if before.t == t:
            return before
        later = chunks[i][k:] or next((chunk for chunk in chunks[i + 1 :] if chunk), ())
        if not later:
            return None
        p, R, _ = interpolate_pose(*before[1:], *later[0][1:], (t - before.t) / (later[0].t - before.t))
        return TimedPose(t, p, R)

    def displaced(self, p: Array, R: Array, since: float) -> PoseHistory:
        """Return the history of another frame that is fixed in the object.

        Args:
            p: (3,) position of that frame in the object, m.
            R: (3, 3) its axes.
            since: time before which entries are dropped, s.
        """
        entries = [pose for chunk in (*self.chunks, self.recent) for pose in chunk if pose.t >= since]
        moved = tuple(TimedPose(pose.t, pose.p_HO + pose.R_HO @ p, pose.R_HO @ R) for pose in entries)
        return PoseHistory((moved[:-1],) if len(moved) > 1 else (), moved[-1:])


_make_history = unchecked_constructor(PoseHistory)
