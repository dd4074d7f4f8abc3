"""Images of a plant without OpenGL: shaded triangles, drawn with Pillow from the farthest to the nearest."""

from __future__ import annotations

import numpy as np
from PIL import Image as PillowImage
from PIL import ImageDraw

from graspforce.core.arrays import Array
from graspforce.simulation.plants.link_geoms import HIDDEN_GROUP
from graspforce.simulation.rendering import stage
from graspforce.simulation.rendering.camera import CameraView
from graspforce.simulation.rendering.display_model import DisplayModel, Image
from graspforce.simulation.rendering.mark_painter import paint_marks
from graspforce.simulation.rendering.marks import SceneState
from graspforce.simulation.rendering.tessellation import geom_triangles, triangle_colours

_SMOOTHING = 2  # samples per pixel and axis
_AMBIENT, _SUN, _FILL, _GLOSS = 0.42, 0.55, 0.18, 0.25
_SHADOW = 0.62  # brightness of the table in the shadow


class SoftwareRenderer:
    """A renderer that needs Pillow only.

    Args:
        display: the model to draw.
        width: of the images, pixels.
        height: of the images, pixels.
        reason: why there is no better renderer.
    """

    def __init__(self, display: DisplayModel, width: int, height: int, reason: str) -> None:
        self.description = f"drawn without OpenGL, {display.description}. {reason}"
        self._display, self._size = display, (width, height)
        model = display.model
        self._table = next((i for i in range(model.ngeom) if model.geom(i).name == stage.TABLE), None)
        shown = [i for i in range(model.ngeom) if i != self._table and model.geom_group[i] != HIDDEN_GROUP]
        triangles = [geom_triangles(model, i) for i in shown]
        self._geom = np.repeat(shown, [len(each) for each in triangles])
        self._triangles = np.concatenate(triangles)
        self._colours = np.concatenate(
            [triangle_colours(model, i, each) for i, each in zip(shown, triangles, strict=True)]
        )  # of each triangle, 0 to 1
        self._background = _background(_SMOOTHING * width, _SMOOTHING * height)

    def render(self, state: SceneState) -> Image:
        """Return an image of a state, (height, width, 3)."""
        display, (width, height) = self._display, self._size
        display.update(state)
        view = display.view(_SMOOTHING * width, _SMOOTHING * height)
        R = display.data.geom_xmat[self._geom].reshape(-1, 3, 3)
        corners = np.einsum("nij,nkj->nki", R, self._triangles) + display.data.geom_xpos[self._geom][:, None]
        canvas = self._background.copy()
        draw = ImageDraw.Draw(canvas)
        if self._table is not None:
            self._draw_table(draw, view, corners)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-15)
        middles = corners.mean(axis=1)
        front = np.flatnonzero(np.einsum("ni,ni->n", view.position - middles, normals) > 0.0)
        order = front[np.argsort(-np.linalg.norm(middles[front] - view.position, axis=1))]
        shades = self._shade(view, normals[order], middles[order], self._colours[order])
        pixels = view.project(corners[order].reshape(-1, 3)).reshape(-1, 6).tolist()
        for polygon, colour in zip(pixels, shades, strict=True):
            draw.polygon(polygon, fill=tuple(colour))
        image = np.asarray(canvas.resize((width, height), PillowImage.Resampling.BOX))
        return paint_marks(image, display.view(width, height), state.contacts, state.push)

    def _shade(self, view: CameraView, normals: Array, middles: Array, colours: Array) -> list[list[int]]:
        """Return the colours of triangles under sun and fill light, 0 to 255."""
        data = self._display.data
        sun, fill = -data.light_xdir[0], -data.light_xdir[1]
        to_camera = view.position - middles
        half = sun + to_camera / np.linalg.norm(to_camera, axis=1, keepdims=True)
        gloss = np.einsum("ni,ni->n", normals, half / np.linalg.norm(half, axis=1, keepdims=True))
        light = _AMBIENT + _SUN * np.maximum(normals @ sun, 0.0) + _FILL * np.maximum(normals @ fill, 0.0)
        shaded = colours * light[:, None] + _GLOSS * np.maximum(gloss, 0.0)[:, None] ** 24
        values: list[list[int]] = np.clip(255.0 * shaded, 0.0, 255.0).astype(int).tolist()
        return values

    def _draw_table(self, draw: ImageDraw.ImageDraw, view: CameraView, corners: Array) -> None:
        """Draw the round table and the shadows on it."""
        model, data = self._display.model, self._display.data
        axis = data.geom_xmat[self._table].reshape(3, 3)[:, 2]
        axis = axis if axis @ self._display.up > 0.0 else -axis
        top = data.geom_xpos[self._table] + model.geom_size[self._table][1] * axis
        angles = np.linspace(0.0, 2.0 * np.pi, 120, endpoint=False)
        x = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
        x = model.geom_size[self._table][0] * x / np.linalg.norm(x)
        rim = top + np.outer(np.cos(angles), x) + np.outer(np.sin(angles), np.cross(axis, x))
        colour = np.array(stage.TABLE_COLOUR)
        draw.polygon(_polygon(view.project(rim)), fill=_bytes(0.93 * colour))
        sun = data.light_xdir[0]
        drop = (corners - top) @ axis / (sun @ axis)
        shadows = (corners - drop[..., None] * sun)[(drop <= 0.0).all(axis=1)]
        on_table = (np.linalg.norm(shadows - top, axis=2) < model.geom_size[self._table][0]).all(axis=1)
        for polygon in view.project(shadows[on_table].reshape(-1, 3)).reshape(-1, 6).tolist():
            draw.polygon(polygon, fill=_bytes(_SHADOW * colour))


def _background(width: int, height: int) -> PillowImage.Image:
    """Return the gradient behind the hand."""
    share = np.linspace(0.0, 1.0, height)[:, None]
    above, below = np.array(stage.BACKGROUND), np.array(stage.BACKGROUND_BELOW)
    column = 255.0 * ((1.0 - share) * (0.4 * above + 0.6 * below) + share * below)
    return PillowImage.fromarray(np.repeat(column[:, None].astype(np.uint8), width, axis=1))


def _polygon(points: Array) -> list[tuple[float, float]]:
    return [(float(x), float(y)) for x, y in points]


def _bytes(colour: Array) -> tuple[int, int, int]:
    red, green, blue = np.clip(255.0 * colour, 0.0, 255.0).astype(int).tolist()
    return red, green, blue
