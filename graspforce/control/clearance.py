"""The least distance between links, palm, object and obstacles in a control step."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

from graspforce.control.state import GraspState
from graspforce.grasp.collision.nearest_pair import NearestPair
from graspforce.grasp.collision.obstacle import Obstacle
from graspforce.grasp.collision.scene_collision import SceneCollision
from graspforce.grasp.collision.settings import CollisionSettings
from graspforce.grasp.grasp import Grasp
from graspforce.hand.collision import LinkGap


class ClearanceQuery:
    """Finds the least distance in a state. The geometry is built at the first use, which takes longer than a step.

    Args:
        grasp: hand, object and fingers that touch it.
        obstacles: bodies at rest in H.
    """

    def __init__(self, grasp: Grasp, obstacles: Sequence[Obstacle]) -> None:
        self._grasp, self._obstacles = grasp, obstacles

    def prepare(self) -> None:
        """Build the geometry now, so that the first query takes no longer than the others."""
        _ = self._nearest

    def find(self, state: GraspState) -> LinkGap | None:
        """Return the nearest two bodies that must not touch; None if there is no such pair.

        Args:
            state: measured state.
        """
        return self._nearest.find(state.q, state.object.p_HO, state.object.R_HO)

    @cached_property
    def _nearest(self) -> NearestPair:
        grasp, settings = self._grasp, CollisionSettings(obstacles=self._obstacles)
        return NearestPair(grasp.hand, SceneCollision(grasp.hand, grasp.body.shape, grasp.fingers, settings))
