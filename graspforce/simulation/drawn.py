"""Pictures of a running plant where there is no OpenGL: lines, nets and arrows by Matplotlib."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from graspforce.arrays import Array
from graspforce.simulation import looks
from graspforce.simulation.looks import Picture
from graspforce.simulation.plant import Plant

_DPI = 100


class Drawn:
    """Matplotlib's pictures.

    Args:
        width, height: pixels.
        words: why there are no better ones.
    """

    def __init__(self, width: int, height: int, words: str) -> None:
        self.words = words
        self._figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
        self._canvas: Any = FigureCanvasAgg(self._figure)

    def frame(self, plant: Plant) -> Picture:
        """The plant now, (height, width, 3)."""
        scene, data = plant.scene, plant.data
        self._figure.clear()
        axes = self._figure.add_subplot(projection="3d")
        axes.set_axis_off()
        tree = scene.hold.hand.tree()
        place = [data.body(link.joint) for link in tree.links]
        ends = [(link.parent, place[i].xpos) for i, link in enumerate(tree.links)]
        ends += [(tip.link, place[tip.link].xpos + place[tip.link].xmat.reshape(3, 3) @ tip.p_LF) for tip in tree.tips]
        for parent, end in ends:
            begin = np.zeros(3) if parent < 0 else place[parent].xpos
            axes.plot(*np.array([begin, end]).T, color=looks.LINK, linewidth=2.0 if parent < 0 else 6.0, solid_capstyle="round")
        tips = data.geom_xpos[list(scene.tip_geoms)]
        axes.scatter(*tips.T, color=looks.TIP, s=80, depthshade=False)
        motion, touch = plant.motion(), plant.touch()
        axes.plot_wireframe(*_net(plant, motion.p_HO, motion.R_HO), color=looks.THING, linewidth=0.7)
        for p, R, f in zip(touch.p_OC, touch.R_OC, touch.f, strict=True):
            arrow = looks.FORCE * motion.R_HO @ R @ f[:3]
            axes.quiver(*(motion.p_HO + motion.R_HO @ p), *arrow, color="#c0392b", linewidth=2.0)
        _aim(axes, plant)
        self._canvas.draw()
        return np.array(self._canvas.buffer_rgba(), dtype=np.uint8)[:, :, :3]


def _aim(axes: Any, plant: Plant) -> None:
    """Look as the scene's camera looks, at the same place; up is the axis of H that is nearest to it."""
    model, turned = plant.model, np.zeros(9)
    mujoco.mju_quat2Mat(turned, model.camera(looks.CAMERA).quat)
    back = turned.reshape(3, 3)[:, 2]
    middle, reach = model.stat.center, model.stat.extent / 2.0
    for set_limits, value in zip((axes.set_xlim, axes.set_ylim, axes.set_zlim), middle, strict=True):
        set_limits(value - 0.6 * reach, value + 0.6 * reach)
    axes.set_box_aspect((1, 1, 1))
    up = int(np.abs(plant.scene.gravity_H).argmax())
    azimuth = np.arctan2(back[(up + 2) % 3], back[(up + 1) % 3])
    axes.view_init(elev=np.degrees(np.arcsin(back[up])), azim=np.degrees(azimuth), vertical_axis="xyz"[up])


def _net(plant: Plant, p_HO: Array, R_HO: Array) -> tuple[Array, Array, Array]:
    """Points of the object's surface, in H, on a grid."""
    shape = plant.scene.hold.body.shape
    assert shape is not None  # the scene was built from it
    theta, phi = np.meshgrid(np.linspace(0.0, np.pi, 13), np.linspace(0.0, 2.0 * np.pi, 25))
    rays = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1).reshape(-1, 3)
    x, y, z = (p_HO + shape.nearest(rays) @ R_HO.T).T.reshape(3, *theta.shape)
    return x, y, z
