"""What is measured of a hand and the object that it holds."""

from __future__ import annotations

from dataclasses import dataclass

from graspforce import arrays
from graspforce.arrays import Array
from graspforce.body import BodyMotion


@dataclass(frozen=True, eq=False, slots=True)
class GraspState:
    """A hand and the object in it at one instant, as measured.

    Args:
        q: (n,) joint positions, rad.
        v: (n,) joint rates, rad/s.
        object: the object's pose and twist, seen from H; its acceleration is not read.

    Raises:
        InvalidInput: not finite, or of another shape than one another.
    """

    q: Array
    v: Array
    object: BodyMotion

    def __post_init__(self) -> None:
        object.__setattr__(self, "q", arrays.array(self.q, "q", (None,)))
        object.__setattr__(self, "v", arrays.array(self.v, "v", self.q.shape))
