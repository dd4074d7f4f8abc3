"""Pictures of a running plant, with its contact forces as arrows: rendered by MuJoCo where there is OpenGL."""

from __future__ import annotations

import importlib
import warnings
import weakref
from typing import Any, Protocol

import mujoco
import numpy as np

from graspforce.simulation.looks import CAMERA, Picture
from graspforce.simulation.plant import Plant

_CONTEXTS = ("egl", "osmesa", "cgl", "glfw")  # of MuJoCo's: two for Linux without a display, macOS, and any with one
_GEOMS = 2000


class Artist(Protocol):
    """Who draws a plant."""

    words: str

    def frame(self, plant: Plant) -> Picture:
        """The plant now, (height, width, 3)."""
        ...  # pragma: no cover


def artist(plant: Plant, width: int = 960, height: int = 720) -> Artist:
    """The best way to draw a plant on this machine: OpenGL, or else Matplotlib. ``words`` says which, and why.

    Args:
        plant: what to draw; its scene stays what it is.
        width, height: of the pictures.
    """
    refused = []
    for name in _CONTEXTS:
        try:
            return Rendered(plant, name, width, height)
        except Exception as error:  # a driver that is missing raises whatever its binding likes
            refused.append(f"{name}: {str(error).splitlines()[0] if str(error) else type(error).__name__}")
    from graspforce.simulation.drawn import Drawn  # Matplotlib takes a second to import

    return Drawn(width, height, f"drawn by Matplotlib, since there is no OpenGL here ({'; '.join(refused)})")


def no_display() -> str:
    """Why no window can be opened here; empty where one can. MuJoCo's viewer itself would end the process without a word."""
    try:
        import glfw  # comes with MuJoCo
    except ImportError as error:  # its library is not there
        return str(error)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        if glfw.init():
            glfw.terminate()
            return ""
    return "; ".join(str(each.message) for each in said) or "GLFW finds no window system"


def window(plant: Plant) -> Any:
    """MuJoCo's viewer of a running plant: a context with ``sync()`` and ``is_running()``. It needs a display.

    It begins with the scene's camera and the contact forces; Esc there lets the mouse turn the view, Tab shows the panels.
    """
    from mujoco import viewer  # takes a window system with it

    opened = viewer.launch_passive(plant.model, plant.data, show_left_ui=False, show_right_ui=False)
    with opened.lock():
        opened.cam.type, opened.cam.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, plant.model.camera(CAMERA).id
        opened.opt.flags[mujoco.mjtVisFlag.mjVIS_CONTACTFORCE] = True
        opened.opt.flags[mujoco.mjtVisFlag.mjVIS_TRANSPARENT] = False
    opened.sync()
    return opened


def _free(gl: Any, context: Any) -> None:
    """Give back what a renderer has in OpenGL, in its own context: in another's the same numbers are another's pictures."""
    gl.make_current()
    context.free()
    gl.free()


class Rendered:
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
        weakref.finalize(self, _free, self._gl, self._context)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._scene = mujoco.MjvScene(model, _GEOMS)
        self._option, self._camera = mujoco.MjvOption(), mujoco.MjvCamera()
        self._option.flags[mujoco.mjtVisFlag.mjVIS_CONTACTFORCE] = True
        self._option.flags[mujoco.mjtVisFlag.mjVIS_TRANSPARENT] = False
        self._camera.type, self._camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, model.camera(CAMERA).id
        self._view = mujoco.MjrRect(0, 0, width, height)
        self.words = f"rendered by MuJoCo ({context})"

    def frame(self, plant: Plant) -> Picture:
        """The plant now, (height, width, 3)."""
        self._gl.make_current()
        mujoco.mjv_updateScene(
            plant.model, plant.data, self._option, None, self._camera, mujoco.mjtCatBit.mjCAT_ALL, self._scene
        )
        mujoco.mjr_render(self._view, self._scene, self._context)
        picture = np.empty((self._view.height, self._view.width, 3), np.uint8)
        mujoco.mjr_readPixels(picture, None, self._view, self._context)
        return np.ascontiguousarray(picture[::-1])  # OpenGL counts rows from below
