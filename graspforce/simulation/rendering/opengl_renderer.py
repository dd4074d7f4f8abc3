"""Images of a plant by MuJoCo's renderer, in an OpenGL context that needs no window."""

from __future__ import annotations

import importlib
import weakref
from typing import Any

import mujoco
import numpy as np

from graspforce.simulation.plants.link_geoms import HIDDEN_GROUP
from graspforce.simulation.rendering.display_model import CAMERA, DisplayModel, Image
from graspforce.simulation.rendering.mark_painter import paint_marks
from graspforce.simulation.rendering.marks import SceneState

_MAX_GEOMS = 2000


class OpenGLRenderer:
    """MuJoCo's renderer.

    Args:
        display: the model to draw.
        backend: the module of MuJoCo that makes the OpenGL context: egl, osmesa, cgl or glfw.
        width: of the images, pixels.
        height: of the images, pixels.

    Raises:
        Exception: of any kind, from the backend's library, when it is missing.
    """

    def __init__(self, display: DisplayModel, backend: str, width: int, height: int) -> None:
        self._display = display
        self._gl: Any = importlib.import_module(f"mujoco.{backend}").GLContext(width, height)
        self._gl.make_current()
        self._context = mujoco.MjrContext(display.model, mujoco.mjtFontScale.mjFONTSCALE_100)
        weakref.finalize(self, _free_context, self._gl, self._context)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._scene = mujoco.MjvScene(display.model, _MAX_GEOMS)
        self._option, self._camera = mujoco.MjvOption(), mujoco.MjvCamera()
        self._option.geomgroup[HIDDEN_GROUP] = False
        self._camera.type, self._camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, display.model.camera(CAMERA).id
        self._view = mujoco.MjrRect(0, 0, width, height)
        self.description = f"rendered by MuJoCo ({backend}), {display.description}"

    def render(self, state: SceneState) -> Image:
        """Return an image of a state, (height, width, 3)."""
        display = self._display
        display.update(state)
        self._gl.make_current()
        mujoco.mjv_updateScene(
            display.model, display.data, self._option, None, self._camera, mujoco.mjtCatBit.mjCAT_ALL, self._scene
        )
        mujoco.mjr_render(self._view, self._scene, self._context)
        image = np.empty((self._view.height, self._view.width, 3), np.uint8)
        mujoco.mjr_readPixels(image, None, self._view, self._context)
        view = display.view(self._view.width, self._view.height)
        return paint_marks(np.ascontiguousarray(image[::-1]), view, state.contacts, state.push)  # rows from above


def _free_context(gl: Any, context: Any) -> None:
    """Free a renderer's OpenGL objects in its own context; in another context their numbers name other objects."""
    gl.make_current()
    context.free()
    gl.free()
