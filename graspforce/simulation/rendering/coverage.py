"""How much of a picture the hand and the object cover, and a camera that is near enough for them to fill it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from PIL import Image as PillowImage
from PIL import ImageDraw

from graspforce.core.arrays import Array
from graspforce.simulation.plants.link_geoms import HIDDEN_GROUP
from graspforce.simulation.plants.scene_parts import OBJECT
from graspforce.simulation.rendering.camera import CameraView, OrbitCamera
from graspforce.simulation.rendering.display_model import DisplayModel
from graspforce.simulation.rendering.hand_geoms import HAND_PREFIX
from graspforce.simulation.rendering.marks import SceneState
from graspforce.simulation.rendering.tessellation import geom_triangles

_HEIGHT = 120  # pixels of the masks
_STEPS = np.linspace(0.0, 1.0, 21)  # from the camera that shows all to the nearest one
_SAMPLES = 9  # pictures of a film
_NEAREST = 0.25  # of the distance that shows all
_CONTACT_MARGIN = 0.08  # part of the picture around the contacts


def silhouette(display: DisplayModel, view: CameraView) -> npt.NDArray[np.bool_]:
    """Return the pixels that show hand or object, (height, width), for the positions of the last update.

    Args:
        display: the model.
        view: the camera.
    """
    mask = PillowImage.new("1", (view.width, view.height))
    draw = ImageDraw.Draw(mask)
    for corners in _triangles(display):
        is_ahead = ((view.position - corners.reshape(-1, 3)) @ view.axes[:, 2] > 1e-3).reshape(-1, 3).all(axis=1)
        for polygon in view.project(corners[is_ahead].reshape(-1, 3)).reshape(-1, 6).tolist():
            draw.polygon(polygon, fill=1, outline=1)
    return np.asarray(mask)


def coverage(display: DisplayModel, width: int, height: int) -> float:
    """Return the part of a picture that hand and object cover, for the state and the camera of the last update.

    Args:
        display: the model.
        width: of the picture, pixels; a smaller one of the same shape is measured.
        height: of the picture, pixels.
    """
    return float(silhouette(display, display.view(round(_HEIGHT * width / height), _HEIGHT)).mean())


def least_coverage(display: DisplayModel, states: Sequence[SceneState], width: int, height: int) -> float:
    """Return the least part of the pictures of a film that hand and object cover, at times spread over it.

    Args:
        display: the model, with the camera of the film.
        states: states of all pictures, at least one.
        width: of the pictures, pixels.
        height: of the pictures, pixels.
    """
    parts = []
    for i in np.unique(np.linspace(0, len(states) - 1, _SAMPLES).astype(int)):
        display.update(states[i])
        parts.append(coverage(display, width, height))
    return min(parts)


def filling_camera(display: DisplayModel, least: float, width: int, height: int) -> OrbitCamera:
    """Return the farthest camera, on the way to the object, with which hand and object cover a part of the picture.

    The contacts stay inside the picture. If they leave it before, the camera is the nearest one that shows them. The
    arrangement is that of the last update of the model.

    Args:
        display: the model, with a camera that shows all of the hand.
        least: part of the picture to cover, 0 to 1, in the middle and at both ends of the camera's swing.
        width: of the picture, pixels.
        height: of the picture, pixels.
    """
    first, pixels = display.camera, (round(_HEIGHT * width / height), _HEIGHT)
    centre = np.array(display.data.geom(OBJECT).xpos)
    best = first
    for step in _STEPS:
        camera = dataclasses.replace(
            first,
            target=first.target + min(2.0 * step, 1.0) * (centre - first.target),
            distance=(1.0 - step * (1.0 - _NEAREST)) * first.distance,
        )
        views = [CameraView(*camera.pose(t), *pixels) for t in (0.0, 0.25 * first.period, 0.75 * first.period)]
        if step > 0.0 and not all(_shows(view, display.contact_points) for view in views):
            break
        best = camera
        if min(silhouette(display, view).mean() for view in views) >= least:
            break
    return best


def _shows(view: CameraView, points: Array) -> bool:
    """Return whether points are inside a picture, clear of its edges."""
    size = np.array([view.width, view.height])
    places = view.project(points) / size
    return bool((np.abs(places - 0.5) < 0.5 - _CONTACT_MARGIN).all())


def _triangles(display: DisplayModel) -> list[Array]:
    """Return the corners of the triangles of each visible part of hand and object, (M, 3, 3) in H, m."""
    model, data = display.model, display.data
    found = []
    for i in range(model.ngeom):
        if model.geom(i).name.startswith((OBJECT, HAND_PREFIX)) and model.geom_group[i] != HIDDEN_GROUP:
            local = geom_triangles(model, i)
            found.append(np.einsum("ij,nkj->nki", data.geom_xmat[i].reshape(3, 3), local) + data.geom_xpos[i])
    return found
