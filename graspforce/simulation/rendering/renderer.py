"""Pictures of a running plant, with its contact forces as arrows: rendered by MuJoCo where there is OpenGL."""

from __future__ import annotations

import importlib
import warnings
import weakref
from typing import Any, Protocol

import mujoco
import numpy as np

from graspforce.simulation.appearance import CAMERA, Image
from graspforce.simulation.plant import Plant

_GL_BACKENDS = ("egl", "osmesa", "cgl", "glfw")  # of MuJoCo's: two for Linux without a display, macOS, and any with one
_MAX_GEOMS = 2000


class Renderer(Protocol):
    """Who draws a plant."""

    description: str

    def render(self, plant: Plant) -> Image:
        """The plant now, (height, width, 3)."""
        ...  # pragma: no cover


def make_renderer(plant: Plant, width: int = 960, height: int = 720) -> Renderer:
    """The best way to draw a plant on this machine: OpenGL, or else Matplotlib. ``words`` says which, and why.

    Args:
        plant: what to draw; its scene stays what it is.
        width, height: of the pictures.
    """
    failures = []
    for name in _GL_BACKENDS:
        try:
            return MujocoRenderer(plant, name, width, height)
        except Exception as error:  # a driver that is missing raises whatever its binding likes
            failures.append(f"{name}: {str(error).splitlines()[0] if str(error) else type(error).__name__}")
    from graspforce.simulation.rendering.matplotlib_renderer import MatplotlibRenderer  # Matplotlib takes a second to import

    return MatplotlibRenderer(width, height, f"drawn by Matplotlib, since there is no OpenGL here ({'; '.join(failures)})")


def missing_display_reason() -> str:
    """Why no window can be opened here; empty where one can. MuJoCo's viewer itself would end the process without a word."""
    try:
        import glfw  # comes with MuJoCo
    except ImportError as error:  # its library is not there
        return str(error)
    with warnings.catch_warnings(record=True) as caught_warnings:
        warnings.simplefilter("always")
        if glfw.init():
            glfw.terminate()
            return ""
    return "; ".join(str(each.message) for each in caught_warnings) or "GLFW finds no window system"


def open_viewer(plant: Plant) -> Any:
    """MuJoCo's viewer of a running plant: a context with ``sync()`` and ``is_running()``. It needs a display.

    It begins with the scene's camera and the contact forces; Esc there lets the mouse turn the view, Tab shows the panels.
    """
    from mujoco import viewer  # takes a window system with it

    viewer_handle = viewer.launch_passive(plant.model, plant.data, show_left_ui=False, show_right_ui=False)
    with viewer_handle.lock():
        viewer_handle.cam.type, viewer_handle.cam.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, plant.model.camera(CAMERA).id
        viewer_handle.opt.flags[mujoco.mjtVisFlag.mjVIS_CONTACTFORCE] = True
        viewer_handle.opt.flags[mujoco.mjtVisFlag.mjVIS_TRANSPARENT] = False
    viewer_handle.sync()
    return viewer_handle


def _free_context(gl: Any, context: Any) -> None:
    """Give back what a renderer has in OpenGL, in its own context: in another's the same numbers are another's pictures."""
    gl.make_current()
    context.free()
    gl.free()


class MujocoRenderer:
    """MuJoCo's renderer, in an OpenGL context that needs no window.

    Args:
        plant: what to draw.
        context: the module of MuJoCo that makes the OpenGL context: egl, osmesa, cgl or glfw.
        width, height: of the pictures.

    Raises:
        Whatever the context's driver raises where it is not there.
    """

    def __init__(self, plant: Plant, context: str, width: int, height: int) -> None:
        self._gl: Any = importlib.import_module(f"mujoco.{context}").GLContext(width, height)
        self._gl.make_current()
        model = plant.scene.model
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        weakref.finalize(self, _free_context, self._gl, self._context)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._scene = mujoco.MjvScene(model, _MAX_GEOMS)
        self._option, self._camera = mujoco.MjvOption(), mujoco.MjvCamera()
        self._option.flags[mujoco.mjtVisFlag.mjVIS_CONTACTFORCE] = True
        self._option.flags[mujoco.mjtVisFlag.mjVIS_TRANSPARENT] = False
        self._camera.type, self._camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, model.camera(CAMERA).id
        self._view = mujoco.MjrRect(0, 0, width, height)
        self.description = f"rendered by MuJoCo ({context})"

    def render(self, plant: Plant) -> Image:
        """The plant now, (height, width, 3)."""
        self._gl.make_current()
        mujoco.mjv_updateScene(
            plant.model, plant.data, self._option, None, self._camera, mujoco.mjtCatBit.mjCAT_ALL, self._scene
        )
        mujoco.mjr_render(self._view, self._scene, self._context)
        picture = np.empty((self._view.height, self._view.width, 3), np.uint8)
        mujoco.mjr_readPixels(picture, None, self._view, self._context)
        return np.ascontiguousarray(picture[::-1])  # OpenGL counts rows from below
