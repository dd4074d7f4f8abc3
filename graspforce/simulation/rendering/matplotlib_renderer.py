"""Pictures of a running plant where there is no OpenGL: lines, nets and arrows by Matplotlib."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from graspforce.core.arrays import Array
from graspforce.simulation import appearance
from graspforce.simulation.appearance import Image
from graspforce.simulation.plant import Plant

_DPI = 100


class MatplotlibRenderer:
    """Matplotlib's pictures.

    Args:
        width, height: pixels.
        words: why there are no better ones.
    """

    def __init__(self, width: int, height: int, description: str) -> None:
        self.description = description
        self._figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
        self._canvas: Any = FigureCanvasAgg(self._figure)

    def render(self, plant: Plant) -> Image:
        """The plant now, (height, width, 3)."""
        scene, data = plant.scene, plant.data
        self._figure.clear()
        axes = self._figure.add_subplot(projection="3d")
        axes.set_axis_off()
        tree = scene.grasp.hand.tree()
        place = [data.body(link.joint) for link in tree.links]
        ends = [(link.parent, place[i].xpos) for i, link in enumerate(tree.links)]
        ends += [(tip.link, place[tip.link].xpos + place[tip.link].xmat.reshape(3, 3) @ tip.p_LF) for tip in tree.tips]
        for parent, end in ends:
            begin = np.zeros(3) if parent < 0 else place[parent].xpos
            axes.plot(
                *np.array([begin, end]).T,
                color=appearance.LINK_COLOUR,
                linewidth=2.0 if parent < 0 else 6.0,
                solid_capstyle="round",
            )
        tips = data.geom_xpos[list(scene.tip_geoms)]
        axes.scatter(*tips.T, color=appearance.TIP_COLOUR, s=80, depthshade=False)
        object_motion, true_contacts = plant.object_motion(), plant.true_contacts()
        axes.plot_wireframe(
            *_surface_grid(plant, object_motion.p_HO, object_motion.R_HO), color=appearance.OBJECT_COLOUR, linewidth=0.7
        )
        for p, R, f in zip(true_contacts.p_OC, true_contacts.R_OC, true_contacts.f, strict=True):
            arrow = appearance.FORCE_ARROW_LENGTH * object_motion.R_HO @ R @ f[:3]
            axes.quiver(*(object_motion.p_HO + object_motion.R_HO @ p), *arrow, color="#c0392b", linewidth=2.0)
        _set_camera(axes, plant)
        self._canvas.draw()
        return np.array(self._canvas.buffer_rgba(), dtype=np.uint8)[:, :, :3]


def _set_camera(axes: Any, plant: Plant) -> None:
    """Look as the scene's camera looks, at the same place; up is the axis of H that is nearest to it."""
    model, turned = plant.model, np.zeros(9)
    mujoco.mju_quat2Mat(turned, model.camera(appearance.CAMERA).quat)
    back = turned.reshape(3, 3)[:, 2]
    middle, half_extent = model.stat.center, model.stat.extent / 2.0
    for set_limits, value in zip((axes.set_xlim, axes.set_ylim, axes.set_zlim), middle, strict=True):
        set_limits(value - 0.6 * half_extent, value + 0.6 * half_extent)
    axes.set_box_aspect((1, 1, 1))
    up = int(np.abs(plant.scene.gravity_H).argmax())
    azimuth = np.arctan2(back[(up + 2) % 3], back[(up + 1) % 3])
    axes.view_init(elev=np.degrees(np.arcsin(back[up])), azim=np.degrees(azimuth), vertical_axis="xyz"[up])


def _surface_grid(plant: Plant, p_HO: Array, R_HO: Array) -> tuple[Array, Array, Array]:
    """Points of the object's surface, in H, on a grid."""
    shape = plant.scene.grasp.body.shape
    assert shape is not None  # the scene was built from it
    theta, phi = np.meshgrid(np.linspace(0.0, np.pi, 13), np.linspace(0.0, 2.0 * np.pi, 25))
    rays = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1).reshape(-1, 3)
    x, y, z = (p_HO + shape.project_to_surface(rays) @ R_HO.T).T.reshape(3, *theta.shape)
    return x, y, z
