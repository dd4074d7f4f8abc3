"""The camera of a film: a viewpoint that sees the contacts, framed on the hand and the object, orbiting slowly."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from graspforce.core.arrays import Array
from graspforce.simulation.plants.scene_parts import OBJECT

FIELD_OF_VIEW = 30.0  # degrees, vertical
_AZIMUTHS = 48  # candidate viewpoints around the vertical
_SIDE_ANGLE = math.radians(35.0)  # preferred angle between the viewpoint and the hand's front
_FRONT_WEIGHT = 0.7  # of the preferred viewpoint, in visible contacts
_FILL = 0.94  # of the free part of the frame
_ITERATIONS = 20


@dataclass(frozen=True, slots=True)
class CameraOptions:
    """Frame and motion of a film's camera.

    Args:
        aspect: width over height of the frame.
        swing: amplitude of the orbit, rad.
        period: of the orbit, s.
        elevation: of the camera above the horizontal plane, rad.
        azimuth: turn of the viewpoint about the vertical axis from where it sees the most contacts, rad.
        radius: of the ball about the object that the frame shows, m; parts of the hand outside it may be cut off.
    """

    aspect: float = 16.0 / 9.0
    swing: float = 0.0
    period: float = 10.0
    elevation: float = math.radians(24.0)
    radius: float = math.inf
    azimuth: float = 0.0


@dataclass(frozen=True, eq=False, slots=True)
class CameraView:
    """A pinhole camera at one instant.

    Args:
        position: (3,) in H, m.
        axes: (3, 3) in H; columns: right, up, backward.
        width: of the image, pixels.
        height: of the image, pixels.
    """

    position: Array
    axes: Array
    width: int
    height: int

    def depth(self, point: Array) -> float:
        """Return the distance of a point (3,) in front of the camera, m."""
        return float((self.position - point) @ self.axes[:, 2])

    def project(self, points: Array) -> Array:
        """Return the pixels (N, 2), right and down from the upper left corner, of points (N, 3) in H."""
        local = (points - self.position) @ self.axes
        scale = self.height / 2.0 / math.tan(math.radians(FIELD_OF_VIEW) / 2.0)  # pixels
        tangents = local[:, :2] / -local[:, 2:]
        return np.array([self.width, self.height]) / 2.0 + scale * tangents * [1.0, -1.0]


@dataclass(frozen=True, eq=False, slots=True)
class OrbitCamera:
    """A camera that looks at a point and swings about the vertical axis through it.

    Args:
        target: (3,) the point in H, m.
        vertical: (3, 3) rows: two horizontal axes and the vertical axis, in H.
        azimuth: middle of the swing, rad, from the first horizontal axis.
        elevation: above the horizontal plane, rad.
        distance: from the target, m.
        swing: amplitude of the swing, rad.
        period: of the swing, s.
    """

    target: Array
    vertical: Array
    azimuth: float
    elevation: float
    distance: float
    swing: float
    period: float

    def pose(self, t: float) -> tuple[Array, Array]:
        """Return the camera's position (3,), m, and axes (3, 3) in H at time t; columns: right, up, backward."""
        azimuth = self.azimuth + self.swing * math.sin(2.0 * math.pi * t / self.period)
        axes = _axes(self.vertical, azimuth, self.elevation)
        return self.target + self.distance * axes[:, 2], axes

    def towards(self) -> Array:
        """Return the horizontal unit vector (3,) from the target to the camera in the middle of the swing, in H."""
        return np.asarray(math.cos(self.azimuth) * self.vertical[0] + math.sin(self.azimuth) * self.vertical[1])


def vertical_frame(gravity_H: Array) -> Array:
    """Return two horizontal axes and the vertical one as rows, in H; H's third axis is vertical without gravity."""
    norm = float(np.linalg.norm(gravity_H))
    up = -gravity_H / norm if norm > 0.0 else np.array([0.0, 0.0, 1.0])
    x = np.eye(3)[int(np.argmin(np.abs(up)))] if abs(up[0]) > 0.9 else np.array([1.0, 0.0, 0.0])
    x = x - (x @ up) * up
    x = x / np.linalg.norm(x)
    return np.array([x, np.cross(up, x), up])


def place_camera(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    vertical: Array,
    contacts: Array,
    points: Array,
    options: CameraOptions,
) -> OrbitCamera:
    """Place a camera in front of the hand where it sees the most contacts, as close as the hand fits into the frame.

    Args:
        model: the display model, whose geoms hide one another.
        data: its data, with positions computed.
        vertical: as `vertical_frame` returns it.
        contacts: (N, 3) points on the object just inside the contacts, in H, m.
        points: (M, 3) corners of the hand's and the object's parts, in H, m.
        options: frame and motion.
    """
    front = data.geom(OBJECT).xpos - points.mean(axis=0)
    preferred = math.atan2(vertical[1] @ front, vertical[0] @ front) + _SIDE_ANGLE
    best, azimuth = -math.inf, preferred
    for candidate in preferred + np.linspace(-math.pi, math.pi, _AZIMUTHS, endpoint=False):
        direction = _axes(vertical, candidate, options.elevation)[:, 2]
        seen = sum(_is_visible(model, data, point, direction) for point in contacts)
        score = seen + _FRONT_WEIGHT * math.cos(candidate - preferred)
        if score > best:
            best, azimuth = score, float(candidate)
    azimuth += options.azimuth
    tangent = math.tan(math.radians(FIELD_OF_VIEW) / 2.0)
    half = np.array([tangent * options.aspect, tangent]) * _FILL
    shown = points[np.linalg.norm(points - data.geom(OBJECT).xpos, axis=1) <= options.radius]
    points = shown if len(shown) else points
    distance, target = _fit(points, _axes(vertical, azimuth, options.elevation), half)
    for angle in (azimuth - options.swing, azimuth + options.swing):
        distance = max(distance, _distance(points - target, _axes(vertical, angle, options.elevation), half))
    return OrbitCamera(target, vertical, azimuth, options.elevation, distance, options.swing, options.period)


def _axes(vertical: Array, azimuth: float, elevation: float) -> Array:
    """Return the camera's right, up and backward axes as columns, in H."""
    x, y, up = vertical
    level = math.cos(azimuth) * x + math.sin(azimuth) * y
    back = math.cos(elevation) * level + math.sin(elevation) * up
    right = np.cross(up, back)
    right = right / np.linalg.norm(right)
    return np.column_stack([right, np.cross(back, right), back])


def _is_visible(model: mujoco.MjModel, data: mujoco.MjData, point: Array, direction: Array) -> bool:
    """Return whether nothing but the object stands between a point and a camera far away in a direction."""
    hit = np.zeros(1, np.int32)
    body = int(model.geom(OBJECT).bodyid[0])
    mujoco.mj_ray(model, data, point, direction, None, 1, body, hit)
    return bool(hit[0] < 0)


def _distance(offsets: Array, axes: Array, half: Array) -> float:
    """Return the distance from which points about the target lie inside the frame, m."""
    local = offsets @ axes
    return float(np.max(local[:, 2:] + np.abs(local[:, :2]) / half))


def _fit(points: Array, axes: Array, half: Array) -> tuple[float, Array]:
    """Return the least distance and the target for which all points lie inside the frame."""
    local = points @ axes
    centre = (local.min(axis=0) + local.max(axis=0)) / 2.0
    distance = 0.0
    for _ in range(_ITERATIONS):
        offsets = local - centre
        distance = float(np.max(offsets[:, 2:] + np.abs(offsets[:, :2]) / half))
        seen = offsets[:, :2] / (distance - offsets[:, 2:])  # tangents of the angles to the axis
        centre[:2] += (seen.min(axis=0) + seen.max(axis=0)) / 2.0 * distance
    return distance, axes @ centre
