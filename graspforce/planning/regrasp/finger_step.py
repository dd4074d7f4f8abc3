"""The step of one finger from contact to contact on an object at rest, while the others hold it.

The tip leaves the surface along the normal, moves around the object at a height above it, and arrives along the new normal.
"""

from __future__ import annotations

import numpy as np

from graspforce.contact.contact import Contact
from graspforce.contact.motion import BodyMotion
from graspforce.core.arrays import Array
from graspforce.geometry import Shape
from graspforce.geometry.minimum_jerk import minimum_jerk
from graspforce.grasp.collision.scene_collision import SceneCollision
from graspforce.hand.hand import Hand
from graspforce.planning.path.paths import JointPath
from graspforce.planning.regrasp.contact_candidates import closest_places
from graspforce.planning.regrasp.tip_paths import follow_tip

HEIGHTS = (0.006, 0.003, 0.012, 0.025)  # m above the surface, tried in this order
_PROJECTIONS = 4  # onto the surface at the height, each with points that are spaced evenly anew
_HEIGHT_TOLERANCE = 2e-4  # m
_POINTS = 24  # places of the tip between lift and arrival, before they are spaced evenly
_SPACING = 0.003  # m: largest distance of the tip from posture to posture
_FEWEST, _MOST = 12, 60  # postures of a step
_ROUNDING = np.array([1.0, 2.0, 3.0, 2.0, 1.0]) / 9.0  # weights of neighbours, which round the corners
_DENSITY = 6  # instants that are checked for each posture
_PENETRATION = 1e-4  # m: largest depth of the tip below the surface, at the ends
_SLOPE = 0.3  # least height of the tip, over its distance from the nearer end or its height on the way
_SAMPLES = 400  # instants of a step at which torques are computed
_PEAK = 1.875  # largest rate of the rise with least jerk, divided by its mean
_MIN_DURATION = 0.25  # s
_LEAST_CHANGE = 1e-5  # rad: a smaller one from posture to posture leads to the place where the finger is
_MAX_JUMP = 0.5  # rad: largest change of a joint between two postures; a larger one is another branch of the kinematics


class FingerStepPlanner:
    """Planner of steps of single fingers.

    Args:
        hand: the hand.
        shape: surface of the object.
        scene: collision geometry of hand, object and obstacles; None for no checks.
    """

    def __init__(self, hand: Hand, shape: Shape, scene: SceneCollision | None) -> None:
        self._hand, self._shape, self._scene = hand, shape, scene

    def plan(self, finger: str, motion: BodyMotion, q: Array, before: Contact, after: Contact) -> Array | None:
        """Return the postures of a step, (K, n), rad; None if no height gives a motion within limits and without collision.

        Args:
            finger: name of the finger.
            motion: pose of the object.
            q: (n,) posture at the start, rad.
            before: contact at the start, in O.
            after: contact at the end, in O.
        """
        for height in HEIGHTS:
            tips = tip_positions(self._shape, self._hand.finger(finger).tip_radius or 0.0, (before, after), height)
            postures = self._postures(finger, q, motion.p_HO + tips @ motion.R_HO.T)
            if postures is not None and self._is_free(finger, postures, motion, height):
                return postures
        return None

    def _postures(self, finger: str, q: Array, tips_H: Array) -> Array | None:
        """Return postures with the tip at positions in H, (K, n), rad; None if it jumps, rests or does not reach them."""
        postures = follow_tip(self._hand, finger, q, tips_H)
        if postures is None:
            return None
        changes = np.abs(np.diff(postures, axis=0)).max(axis=1)  # rad
        return postures if changes.min() > _LEAST_CHANGE and changes.max() <= _MAX_JUMP else None

    def _is_free(self, finger: str, postures: Array, motion: BodyMotion, height: float) -> bool:
        """Return whether no two bodies come too near along the path through postures, and the tip keeps its height."""
        path = JointPath.through(postures).points(np.linspace(0.0, 1.0, _DENSITY * len(postures))).q
        tips = (self._hand.tips_along(path, [finger])[0][:, 0] - motion.p_HO) @ motion.R_HO  # in O, m
        heights = self._shape.phi(tips) - (self._hand.finger(finger).tip_radius or 0.0)  # m
        from_ends = np.linalg.norm(tips[:, None] - tips[[0, -1]], axis=2).min(axis=1)  # m
        if (heights < _SLOPE * np.minimum(from_ends, height) - _PENETRATION).any():
            return False
        if self._scene is None:
            return True
        p, R = np.tile(motion.p_HO, (len(path), 1)), np.tile(motion.R_HO, (len(path), 1, 1))
        along = self._scene.least_gap_along(path, p, R)
        return along is None or along.lack <= 0.0


def _space_evenly(corners: Array) -> Array:
    """Return evenly spaced points along a polyline with rounded corners and the same ends, (K, 3).

    Args:
        corners: (M, 3) corners of the polyline.
    """
    length = float(np.linalg.norm(np.diff(corners, axis=0), axis=1).sum())  # m
    even = _evenly(corners, int(np.clip(np.ceil(length / _SPACING) + 1, _FEWEST, _MOST)))
    reach = len(_ROUNDING) // 2
    before = 2.0 * even[0] - even[reach:0:-1]  # reflected at the ends, which therefore stay
    after = 2.0 * even[-1] - even[-2 : -reach - 2 : -1]
    padded = np.vstack([before, even, after])
    return np.stack([np.convolve(column, _ROUNDING, mode="valid") for column in padded.T], axis=1)


def tip_positions(shape: Shape, radius: float, contacts: tuple[Contact, Contact], height: float) -> Array:
    """Return evenly spaced positions of a tip that leaves one contact and arrives at another, in O, (K, 3), m.

    The tip goes straight where it stays above the surface, and otherwise along the surface at its height.

    Args:
        shape: surface of the object.
        radius: of the tip, m.
        contacts: at the start and at the end, in O.
        height: of the tip above the surface, m.
    """
    ends = [contact.position - (radius + h) * contact.normal for contact in contacts for h in (0.0, height)]
    start, above_start, end, above_end = ends
    shares = np.linspace(0.0, 1.0, _POINTS)[:, None]
    between = (1.0 - shares) * above_start + shares * above_end
    for _ in range(_PROJECTIONS):
        distance = shape.phi(between)
        low = np.flatnonzero(distance < radius + height - _HEIGHT_TOLERANCE)
        if not len(low):
            break
        surface, towards = closest_places(shape, between[low])
        inward = np.where(distance[low, None] < 0.0, -towards, towards)
        between[low] = surface - (radius + height) * inward
        between = _evenly(between, _POINTS)  # an edge between two points leaves a gap
    return _space_evenly(np.vstack([start, between, end]))


def _evenly(corners: Array, count: int) -> Array:
    """Return evenly spaced points along a polyline with the same ends, (count, 3)."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])  # m
    return np.stack([np.interp(np.linspace(0.0, along[-1], count), along, column) for column in corners.T], axis=1)


def step_duration(hand: Hand, postures: Array, joint_rate: Array, torque_rate: float) -> float:
    """Return the shortest duration of a step from rest to rest that keeps limits, s.

    The torques that accelerate the joints are M q̈, with M at the start. Their rates fall with the cube of the duration.

    Args:
        hand: the hand.
        postures: (K, n) postures of the step, rad.
        joint_rate: (n,) largest joint rates, rad/s.
        torque_rate: largest rate of the torques that accelerate the joints, N·m/s.
    """
    by_rate = _PEAK * float((np.abs(np.diff(postures, axis=0)) / joint_rate).max(axis=1).sum())
    duration = max(by_rate, _MIN_DURATION)
    t = np.linspace(0.0, duration, _SAMPLES)
    s, s_rate, s_acceleration = np.array([minimum_jerk(each, duration) for each in t]).T
    points = JointPath.through(postures).points(s)
    acceleration = s_acceleration[:, None] * points.q_s + s_rate[:, None] ** 2 * points.q_ss  # rad/s²
    torque = acceleration @ hand.mass_matrix(postures[0])  # N·m
    largest = float(np.abs(np.diff(torque, axis=0)).max()) / float(t[1])  # N·m/s
    return duration * max(float(np.cbrt(largest / torque_rate)), 1.0)
