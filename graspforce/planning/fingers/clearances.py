"""Clearances of the fingertips from one another and from obstacles."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from graspforce.core.arrays import Array
from graspforce.grasp.collision.obstacle import Obstacle
from graspforce.hand.hand import Hand
from graspforce.planning.check import interpolation_nodes, sample_intervals
from graspforce.planning.plan import Plan

TOLERANCE = 1e-5  # m: largest lack of clearance between knots


@dataclass(frozen=True, eq=False, slots=True)
class TipClearances:
    """The clearances that fingertips must keep.

    Args:
        hand: the hand.
        clearance: smallest distance between the spheres of two tips, and between a tip's sphere and an obstacle, m.
        obstacles: the obstacles.
    """

    hand: Hand
    clearance: float
    obstacles: tuple[Obstacle, ...]

    @property
    def fingers(self) -> tuple[str, ...]:
        """Return the names of all fingers."""
        return tuple(finger.name for finger in self.hand.fingers)

    def radius(self, finger: str) -> float:
        """Return the radius of a fingertip, m; zero for a tip without one.

        Args:
            finger: name of the finger.
        """
        return self.hand.finger(finger).tip_radius or 0.0

    def largest_lack(self, q: Array) -> tuple[float, str]:
        """Return the largest amount by which a clearance is too small, m, and the words that name it.

        Args:
            q: (M, n) postures, rad.
        """
        return self._largest_lack(self.hand.tips_along(q, self.fingers)[0])

    def is_kept(self, plan: Plan) -> bool:
        """Return whether a plan keeps all clearances, between its knots too.

        Args:
            plan: a plan of fingers alone.
        """
        p, _ = self.hand.tips_along(plan.at(interpolation_nodes(plan.knots.times)).q, self.fingers)
        return self._largest_lack(sample_intervals(p))[0] <= TOLERANCE

    def _largest_lack(self, p: Array) -> tuple[float, str]:
        """Return the largest lack of clearance of tips with centres p (M, F, 3), m, and the words that name it."""
        lacks, words = [-np.inf], [""]
        for (i, one), (j, other) in combinations(enumerate(self.fingers), 2):
            least = self.radius(one) + self.radius(other) + self.clearance
            lacks.append(least - float(np.linalg.norm(p[:, i] - p[:, j], axis=1).min()))
            words.append(f"between the tips of {one} and {other}")
        for i, name in enumerate(self.fingers):
            for k, obstacle in enumerate(self.obstacles):
                lacks.append(self.radius(name) + self.clearance - float(obstacle.distance(p[:, i]).min()))
                words.append(f"between the tip of {name} and obstacles[{k}]")
        largest = int(np.argmax(lacks))
        return lacks[largest], words[largest]
