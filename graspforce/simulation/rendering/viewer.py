"""MuJoCo's interactive viewer of a running plant."""

from __future__ import annotations

import threading
import warnings
from typing import Any

import mujoco
import numpy as np

from graspforce.core.arrays import Array
from graspforce.simulation.plants.link_geoms import HIDDEN_GROUP
from graspforce.simulation.plants.plant import Plant
from graspforce.simulation.plants.scene_parts import OBJECT
from graspforce.simulation.rendering.display_model import CAMERA, DisplayModel
from graspforce.simulation.rendering.marks import SceneState, capture_state

_CONE_OPACITY, _OBJECT_OPACITY = 0.4, 0.5
_CLOSE_TIMEOUT = 5.0  # s
_PUSH_COLOUR = (0.55, 0.25, 0.65)


def missing_display_reason() -> str:
    """Return why no window can be opened, or an empty string. Without a display MuJoCo's viewer would end the process."""
    try:
        import glfw  # installed with MuJoCo
    except ImportError as error:  # its shared library is missing
        return str(error)
    with warnings.catch_warnings(record=True) as caught_warnings:
        warnings.simplefilter("always")
        if glfw.init():
            glfw.terminate()
            return ""
    return "; ".join(str(each.message) for each in caught_warnings) or "GLFW finds no window system"


class Viewer:
    """A window that follows a plant. Esc frees the camera for the mouse, Tab shows the panels.

    Args:
        display: the model to show.

    Raises:
        RuntimeError: the window cannot be opened; check `missing_display_reason` first.
    """

    def __init__(self, display: DisplayModel) -> None:
        from mujoco import viewer  # opens the window system

        self._display = display
        display.model.mat_rgba[display.model.material(OBJECT).id, 3] = _OBJECT_OPACITY  # marks lie inside the object
        running = threading.enumerate()
        self.handle: Any = viewer.launch_passive(display.model, display.data, show_left_ui=False, show_right_ui=False)
        self._threads = [thread for thread in threading.enumerate() if thread not in running]
        with self.handle.lock():
            self.handle.cam.type = mujoco.mjtCamera.mjCAMERA_FIXED
            self.handle.cam.fixedcamid = display.model.camera(CAMERA).id
            self.handle.opt.geomgroup[HIDDEN_GROUP] = False

    def is_running(self) -> bool:
        """Return whether the window is open."""
        return bool(self.handle.is_running())

    def show(self, plant: Plant) -> None:
        """Show the present state of a plant.

        Args:
            plant: a plant of the displayed scene.
        """
        with self.handle.lock():
            state = capture_state(plant)
            self._display.update(state)
            self.handle.user_scn.ngeom = 0
            _add_marks(self.handle.user_scn, self._display, state)
        self.handle.sync()

    def close(self) -> None:
        """Close the window, and wait for the viewer's thread: it must not outlive the interpreter."""
        self.handle.close()
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(_CLOSE_TIMEOUT)


def _add_marks(scene: Any, display: DisplayModel, state: SceneState) -> None:
    """Append contact forces, friction cones and pushes to a MjvScene."""
    for mark in state.contacts:
        if mark.touching:
            _add_arrow(scene, mark.apex, mark.apex + mark.arrow, mark.radius, mark.colour)
            position, transform = display.cone_pose(mark.apex, mark.R_HC, mark.height, mark.mu)
            geom = _add_geom(scene, mujoco.mjtGeom.mjGEOM_MESH, np.array([*mark.colour, _CONE_OPACITY]))
            geom.pos[:], geom.mat[:], geom.dataid = position, transform, 2 * display.cone_id
    push = state.push
    if push is not None:
        _add_arrow(scene, push.end - push.arrow, push.end, push.radius, np.array(_PUSH_COLOUR))


def _add_arrow(scene: Any, start: Array, end: Array, radius: float, colour: Array) -> None:
    geom = _add_geom(scene, mujoco.mjtGeom.mjGEOM_ARROW, np.array([*colour, 1.0]))
    mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_ARROW, radius, start, end)


def _add_geom(scene: Any, kind: Any, rgba: Array) -> Any:
    """Return a new decorative geom of the scene."""
    if scene.ngeom >= scene.maxgeom:
        raise RuntimeError(f"the scene is full: {scene.maxgeom} geoms")
    geom = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), rgba.astype(np.float32))
    geom.category = mujoco.mjtCatBit.mjCAT_DECOR
    geom.transparent = rgba[3] < 1.0
    scene.ngeom += 1
    return geom
