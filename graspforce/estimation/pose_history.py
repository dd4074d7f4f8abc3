"""History of poses, from which the pose at the time of a late image is interpolated."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from typing import NamedTuple

from graspforce.core.arrays import Array
from graspforce.core.records import unchecked_constructor
from graspforce.geometry.rotations import rotation_exp, rotation_log

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
        later = next((chunk for chunk in (*self.chunks, self.recent) if chunk and chunk[-1].t >= t), None)
        if later is None:
            return None
        i = bisect_right(later, t, key=lambda pose: pose.t)
        after = later[min(i, len(later) - 1)]
        if after.t == t or (i > 0 and later[i - 1].t == t):
            return after if after.t == t else later[i - 1]
        before = later[i - 1] if i > 0 else self._last_before(later)
        if before is None:
            return None
        share = (t - before.t) / (after.t - before.t)
        turn = rotation_log(before.R_HO.T @ after.R_HO)  # rad
        p = before.p_HO + share * (after.p_HO - before.p_HO)
        return TimedPose(t, p, before.R_HO @ rotation_exp([share * x for x in turn]))

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

    def _last_before(self, chunk: tuple[TimedPose, ...]) -> TimedPose | None:
        """Return the last entry before a chunk; None for the first chunk."""
        chunks = (*self.chunks, self.recent)
        i = next(i for i, each in enumerate(chunks) if each is chunk)
        return chunks[i - 1][-1] if i > 0 else None


_make_history = unchecked_constructor(PoseHistory)
