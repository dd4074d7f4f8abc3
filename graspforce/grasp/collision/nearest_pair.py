"""The nearest two bodies of a scene in one posture, for control loops.

Spheres and boxes around the bodies bound the distance of every pair from below. Exact distances are computed in the order of
these bounds, until the next bound is above the least distance found.
"""

from __future__ import annotations

import numpy as np

from graspforce.core.arrays import Array
from graspforce.grasp.collision.scene_collision import SceneCollision
from graspforce.hand.collision import LinkGap
from graspforce.hand.hand import Hand
from graspforce.hand.shapes.collision_body import place, signed_distance


class NearestPair:
    """Finds the nearest pair of a scene in one posture.

    Args:
        hand: the hand.
        scene: its bodies, and the pairs that must not touch.
    """

    def __init__(self, hand: Hand, scene: SceneCollision) -> None:
        bodies = scene.bodies
        self._model, self._scene = hand.model, scene
        self._poses = np.tile(np.eye(4), (scene.object_frame + 2, 1, 1))  # of the moving links, the object, and the base
        self._frames = np.array([body.frame for body in bodies], dtype=np.intp)
        self._centres = np.array([[*body.p_FB, 1.0] for body in bodies]).reshape(-1, 4, 1)
        self._axes = np.array([body.R_FG for body in bodies]).reshape(-1, 3, 3)
        self._half_extents = np.array([body.half_extents for body in bodies]).reshape(-1, 3)
        self._radii = np.array([body.radius for body in bodies])

    def find(self, q: Array, p_HO: Array, R_HO: Array) -> LinkGap | None:
        """Return the nearest two bodies that must not touch; None if there is no such pair.

        Args:
            q: (n,) joint positions, rad.
            p_HO: (3,) position of the object in H, m.
            R_HO: (3, 3) axes of the object in H.
        """
        scene = self._scene
        if not len(scene.pairs):
            return None
        poses, held = self._poses.copy(), scene.object_frame
        poses[:held] = self._model.joint_poses(q)
        poses[held, :3, 3], poses[held, :3, :3] = p_HO, R_HO
        bounds = self._lower_bounds(poses[self._frames])
        least, nearest, points = np.inf, 0, np.zeros((2, 3))
        for pair in bounds.argsort().tolist():
            if bounds[pair] >= least:
                break
            bodies = [scene.bodies[i] for i in scene.pairs[pair]]
            one, other = (place(body, poses[body.frame, :3, 3], poses[body.frame, :3, :3]) for body in bodies)
            distance, found = signed_distance(bodies[0], one, bodies[1], other)
            if distance < least:
                least, nearest, points = distance, pair, found
        return LinkGap(*scene.names(nearest), least, points)

    def _lower_bounds(self, poses: Array) -> Array:
        """Return lower bounds (P,) of the pairs' distances for the poses (B, 4, 4) of their frames, m.

        The sphere of one body is compared with the sphere and with the box of the other one, both ways.
        """
        one, other = self._scene.pairs.T
        centres = (poses @ self._centres)[:, :3, 0]
        boxes = poses[:, :3, :3] @ self._axes
        apart = centres[other] - centres[one]
        bounds = np.sqrt((apart * apart).sum(axis=1)) - self._radii[one] - self._radii[other]
        for box, ball in ((one, other), (other, one)):
            beyond = np.abs((apart[:, None] @ boxes[box])[:, 0]) - self._half_extents[box]
            outside = np.maximum(beyond, 0.0)
            distance = np.sqrt((outside * outside).sum(axis=1)) + np.minimum(beyond.max(axis=1), 0.0)
            bounds = np.maximum(bounds, distance - self._radii[ball])
        return np.asarray(bounds)
