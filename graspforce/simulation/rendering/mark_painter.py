"""Forces, friction cones and pushes painted over an image: visible through the object, with flat shading and smooth edges."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from PIL import Image as PillowImage
from PIL import ImageDraw

from graspforce.core.arrays import Array
from graspforce.simulation.rendering.camera import CameraView
from graspforce.simulation.rendering.display_model import Image
from graspforce.simulation.rendering.marks import ContactMark, PushMark

_SIDES = 40  # facets around a cone
_ARROW_SIDES = 14
_HEAD_LENGTH, _HEAD_RADIUS = 0.38, 2.4  # of an arrow, over its length and over its radius
_CONE_OPACITY, _ARROW_OPACITY = 0.62, 1.0
_SMOOTHING = 2  # samples per pixel and axis
_LIGHT = np.array([-0.4, 0.75, 0.55])  # direction to the light in the camera's axes
_PUSH_COLOUR = np.array([0.55, 0.25, 0.65])
_ARROW_SHADE = 0.62  # brightness of an arrow over that of its cone

Facets = list[tuple[Array, Array]]  # (corners (n, 3), unit outward normal (3,)), in H


def paint_marks(image: Image, view: CameraView, contacts: Sequence[ContactMark], push: PushMark | None = None) -> Image:
    """Return the image with contact forces, friction cones and a push painted over it.

    Args:
        image: (height, width, 3), seen from `view`.
        view: pose and field of view of the camera.
        contacts: marks to paint; fingers that do not touch are left out.
        push: external force on the object.
    """
    canvas = PillowImage.fromarray(image)
    touching = sorted((mark for mark in contacts if mark.touching), key=lambda mark: -view.depth(mark.apex))
    for mark in touching:
        _paint(canvas, view, cone_facets(mark), mark.colour, _CONE_OPACITY)
    for mark in touching:
        colour = _ARROW_SHADE * mark.colour
        _paint(canvas, view, arrow_facets(mark.apex, mark.arrow, mark.radius), colour, _ARROW_OPACITY)
    if push is not None:
        _paint(canvas, view, arrow_facets(push.end - push.arrow, push.arrow, push.radius), _PUSH_COLOUR, _ARROW_OPACITY)
    return np.asarray(canvas)


def cone_facets(mark: ContactMark) -> Facets:
    """Return the surface of a contact's friction cone: its apex at the contact, its base inside the object.

    Args:
        mark: the contact.
    """
    x, y, n = mark.R_HC.T
    centre = mark.apex + mark.height * n
    angles = np.linspace(0.0, 2.0 * math.pi, _SIDES + 1)
    spokes = np.outer(np.cos(angles), x) + np.outer(np.sin(angles), y)
    rim = centre + mark.mu * mark.height * spokes
    facets: Facets = [(rim[:-1], n)]
    for i in range(_SIDES):
        normal = (spokes[i] + spokes[i + 1]) / 2.0 - mark.mu * n
        facets.append((np.array([mark.apex, rim[i], rim[i + 1]]), normal / np.linalg.norm(normal)))
    return facets


def arrow_facets(start: Array, arrow: Array, radius: float) -> Facets:
    """Return the surface of an arrow: a shaft and a head.

    Args:
        start: (3,) tail of the arrow in H, m.
        arrow: (3,) from tail to tip in H, m.
        radius: of the shaft, m.
    """
    length = float(np.linalg.norm(arrow))
    if length == 0.0:
        return []
    axis = arrow / length
    x = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    x = x / np.linalg.norm(x)
    y = np.cross(axis, x)
    head = min(_HEAD_LENGTH * length, 4.0 * radius)
    neck, tip = start + (length - head) * axis, start + arrow
    angles = np.linspace(0.0, 2.0 * math.pi, _ARROW_SIDES + 1)
    spokes = np.outer(np.cos(angles), x) + np.outer(np.sin(angles), y)
    facets: Facets = [(start + radius * spokes[:-1], -axis), (neck + _HEAD_RADIUS * radius * spokes[:-1], -axis)]
    slope = _HEAD_RADIUS * radius / head
    for i in range(_ARROW_SIDES):
        a, b = spokes[i], spokes[i + 1]
        side = (a + b) / np.linalg.norm(a + b)
        facets.append((np.array([start + radius * a, start + radius * b, neck + radius * b, neck + radius * a]), side))
        wide = _HEAD_RADIUS * radius
        facets.append((np.array([neck + wide * a, neck + wide * b, tip]), (side + slope * axis) / math.hypot(1.0, slope)))
    return facets


def _paint(canvas: PillowImage.Image, view: CameraView, facets: Facets, colour: Array, opacity: float) -> None:
    """Paint the facets that face the camera, the farthest first, as one translucent body."""
    shown = []
    for corners, normal in facets:
        if (view.position - corners[0]) @ normal > 0.0:
            shown.append((view.depth(corners.mean(axis=0)), view.project(corners), normal))
    if not shown:
        return
    corners = np.concatenate([pixels for _, pixels, _ in shown])
    low = np.maximum(np.floor(corners.min(axis=0)).astype(int) - 1, 0)
    high = np.minimum(np.ceil(corners.max(axis=0)).astype(int) + 1, np.array(canvas.size))
    if np.any(high <= low):
        return
    width, height = (int(n) for n in high - low)
    layer = PillowImage.new("RGBA", (_SMOOTHING * width, _SMOOTHING * height), (*_bytes(colour), 0))
    draw = ImageDraw.Draw(layer)
    light = view.axes @ (_LIGHT / np.linalg.norm(_LIGHT))
    for _, pixels, normal in sorted(shown, key=lambda each: -each[0]):
        shade = 0.72 + 0.40 * max(float(normal @ light), 0.0)
        polygon = [tuple(point) for point in _SMOOTHING * (pixels - low)]
        draw.polygon(polygon, fill=(*_bytes(shade * colour), 255))
    layer = layer.resize((width, height), PillowImage.Resampling.BOX)
    mask = layer.getchannel("A").point(lambda value: int(opacity * value))
    canvas.paste(layer.convert("RGB"), (int(low[0]), int(low[1])), mask)


def _bytes(colour: Array) -> tuple[int, int, int]:
    red, green, blue = np.clip(255.0 * colour, 0.0, 255.0).astype(int).tolist()
    return red, green, blue
