"""The scene in a browser: hand, object, contact forces and friction cones, drawn by viser."""

from __future__ import annotations

import contextlib
import io
import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from graspforce.core import arrays, fields
from graspforce.core.optional_libraries import optional_imports
from graspforce.simulation.plants.scene_parts import rotation_quaternion
from graspforce.simulation.rendering.camera import FIELD_OF_VIEW
from graspforce.simulation.rendering.display_model import DisplayModel
from graspforce.simulation.rendering.marks import ContactMark, SceneState
from graspforce.simulation.rendering.part_meshes import part_meshes

if TYPE_CHECKING:
    import viser

_OBJECT_OPACITY, _CONE_OPACITY = 0.6, 0.5  # the forces lie inside the object
_CONE_SIDES = 40
_LEAST_MOVE, _LEAST_TURN = 1e-4, 3e-4  # m, and of a quaternion: a third of a pixel
_LEAST_SHADE = 3  # of 255
_PUSH_COLOUR, _LOAD_COLOUR = (140, 64, 166), (40, 40, 40)
_HEAD_RADIUS, _HEAD_LENGTH = 2.2, 4.5  # of arrows, over the radius of their shafts
_HIDDEN = np.zeros((1, 2, 3), dtype=np.float32)  # an arrow without length
_CAMERA_DISTANCE = 1.1  # over that of the films' camera, because the panel covers part of the picture


@dataclass(frozen=True, slots=True)
class ViewAddress:
    """Where a view is served.

    Args:
        host: name or address of the network interface. The default is reached from this computer only.
        port: TCP port; the next free one is taken if it is in use.

    Raises:
        InvalidInput: an empty name, or a port out of range.
    """

    host: str = "127.0.0.1"
    port: int = 8080

    def __post_init__(self) -> None:
        fields.check_text(self.host, "host")
        fields.check_integer(self.port, "port", minimum=1, maximum=65535)


class BrowserScene:
    """A web page that shows a scene.

    Args:
        display: the model to show.
        title: heading of the panel.
        address: where the page is served.

    Attributes:
        server: of viser; its `gui` takes further controls.

    Raises:
        MissingLibrary: viser is not installed.
    """

    def __init__(self, display: DisplayModel, title: str, address: ViewAddress | None = None) -> None:
        with optional_imports():
            import viser
        address = ViewAddress() if address is None else address
        logging.getLogger("websockets").setLevel(logging.CRITICAL)  # it prints tracebacks if a page closes while it connects
        self._display, self._cones = display, {}
        with contextlib.redirect_stdout(io.StringIO()):  # viser prints a banner
            self.server: viser.ViserServer = viser.ViserServer(address.host, address.port, label=title, verbose=False)
        scene = self.server.scene
        self.server.gui.configure_theme(show_logo=False)
        self.server.gui.main_panel.dock_right()
        self._set_camera()
        self._bodies = self._add_parts()
        self._sent = np.full((display.model.nbody, 3), np.inf), np.full((display.model.nbody, 4), np.inf)  # poses of bodies
        self._arrows: dict[str, Any] = {}
        self._values: dict[tuple[str, str], arrays.Array] = {}  # what the pages have, by node and property
        vertices, faces = _unit_cone()
        for name in display.scene.grasp.fingers:
            cone = scene.add_mesh_simple(
                f"/contacts/{name}/cone",
                vertices,
                faces,
                opacity=_CONE_OPACITY,
                side="double",
                cast_shadow=False,
            )
            cone.visible = False  # the argument `visible` does not hide it
            self._cones[name] = cone
        self._desired = scene.add_frame("/desired", axes_length=0.03, axes_radius=0.0008, visible=False)

    @property
    def url(self) -> str:
        """Address of the page."""
        host = self.server.get_host()
        return f"http://{'127.0.0.1' if host == '0.0.0.0' else host}:{self.server.get_port()}"

    def show(self, state: SceneState) -> None:
        """Show a state on all pages that are open.

        Args:
            state: the state.
        """
        display = self._display
        display.update(state)
        with self.server.atomic():
            self._move_bodies()
            for mark in state.contacts:
                self._show_contact(mark)
            push = state.push
            if push is not None:
                self._show_arrow("push", push.end - push.arrow, push.end, push.radius, _PUSH_COLOUR)
            else:
                self._hide_arrow("push")
            load = state.load
            if load is not None:
                self._show_arrow("load", load.start, load.start + load.arrow, load.radius, _LOAD_COLOUR)
            else:
                self._hide_arrow("load")

    def _move_bodies(self) -> None:
        """Move the bodies whose poses differ visibly from those that the pages have; viser takes 0.1 ms for each."""
        data, (positions, turns) = self._display.data, self._sent
        moved = np.abs(data.xpos - positions).max(axis=1) > _LEAST_MOVE
        turned = np.abs(data.xquat - turns).max(axis=1) > _LEAST_TURN
        for body, node in self._bodies.items():
            if moved[body]:
                node.position = positions[body] = data.xpos[body]
            if turned[body]:
                node.wxyz = turns[body] = data.xquat[body]

    def show_desired(self, p_HO: arrays.Array, R_HO: arrays.Array) -> None:
        """Show the desired pose of the object as a frame.

        Args:
            p_HO: (3,) position in H, m.
            R_HO: (3, 3) orientation in H.
        """
        with self.server.atomic():
            self._send(self._desired, "position", p_HO, _LEAST_MOVE)
            self._send(self._desired, "wxyz", rotation_quaternion(R_HO), _LEAST_TURN)
            self._send(self._desired, "visible", True)

    def close(self) -> None:
        """Close all pages, and free the port."""
        with contextlib.redirect_stdout(io.StringIO()):  # viser prints a message
            self.server.stop()

    def _set_camera(self) -> None:
        """Look at the scene as the films do."""
        display, camera = self._display, self.server.initial_camera
        position, _ = display.camera.pose(0.0)
        target = display.camera.target
        self.server.scene.set_up_direction(tuple(display.up))
        camera.look_at, camera.up = tuple(target), tuple(display.up)
        camera.position = tuple(target + _CAMERA_DISTANCE * (position - target))
        camera.fov = float(np.radians(FIELD_OF_VIEW))
        camera.near = 1e-3  # m

    def _add_parts(self) -> dict[int, Any]:
        """Add all parts, and return the frame of each body that moves."""
        scene, frames = self.server.scene, {}
        for part in part_meshes(self._display):
            if part.body not in frames:
                frames[part.body] = scene.add_frame(f"/bodies/{part.body}", show_axes=False)
            scene.add_mesh_simple(
                f"/bodies/{part.body}/{part.name}",
                part.vertices,
                part.faces,
                color=_bytes(part.colour),
                opacity=_OBJECT_OPACITY if part.is_object else None,
                flat_shading=not part.is_round,
                side="back" if part.is_object else "front",  # the near side would hide cones, which are translucent, too
            )
        return frames

    def _show_contact(self, mark: ContactMark) -> None:
        """Show the cone and the force of a contact; hide them if the finger does not touch."""
        cone, name = self._cones[mark.finger], f"contacts/{mark.finger}/force"
        self._send(cone, "visible", mark.touching)
        if not mark.touching:
            self._hide_arrow(name)
            return
        colour, width = _bytes(mark.colour), mark.mu * mark.height
        self._send(cone, "position", mark.apex, _LEAST_MOVE)
        self._send(cone, "wxyz", rotation_quaternion(mark.R_HC), _LEAST_TURN)
        self._send(cone, "scale", (width, width, mark.height), _LEAST_MOVE)
        self._send(cone, "color", colour, _LEAST_SHADE)
        self._show_arrow(name, mark.apex, mark.apex + mark.arrow, mark.radius, colour)

    def _show_arrow(
        self, name: str, start: arrays.Array, end: arrays.Array, radius: float, colour: tuple[int, int, int]
    ) -> None:
        """Show an arrow between two points in H, m."""
        if name not in self._arrows:
            self._arrows[name] = self.server.scene.add_arrows(
                f"/{name}",
                _HIDDEN,
                colour,
                shaft_radius=radius,
                head_radius=_HEAD_RADIUS * radius,
                head_length=_HEAD_LENGTH * radius,
            )
        arrow = self._arrows[name]
        self._send(arrow, "points", np.array([[start, end]], dtype=np.float32), _LEAST_MOVE)
        self._send(arrow, "colors", np.array(colour, dtype=np.uint8), _LEAST_SHADE)
        self._send(arrow, "visible", True)

    def _hide_arrow(self, name: str) -> None:
        """Hide an arrow if it was ever shown."""
        if name in self._arrows:
            self._send(self._arrows[name], "visible", False)

    def _send(self, node: Any, name: str, value: Any, least: float = 0.0) -> None:
        """Set a property of a node if it differs by more than `least` from that of the pages.

        Viser compares too, but takes 0.05 ms for it.
        """
        key, new = (node.name, name), np.asarray(value, dtype=float)
        sent = self._values.get(key)
        if sent is None or np.abs(new - sent).max() > least:
            self._values[key] = new
            setattr(node, name, value)


def _unit_cone() -> tuple[arrays.Array, Any]:
    """Return the side of a cone of height 1 and radius 1 with its apex at the origin, about the third axis."""
    angles = np.linspace(0.0, 2.0 * np.pi, _CONE_SIDES, endpoint=False)
    rim = np.column_stack([np.cos(angles), np.sin(angles), np.ones(_CONE_SIDES)])
    i = np.arange(_CONE_SIDES)
    faces = np.column_stack([np.full_like(i, _CONE_SIDES), (i + 1) % _CONE_SIDES, i])
    return np.concatenate([rim, np.zeros((1, 3))]), faces


def _bytes(colour: arrays.Array) -> tuple[int, int, int]:
    """Return red, green and blue from 0 to 255."""
    red, green, blue = np.rint(255.0 * np.clip(colour, 0.0, 1.0)).astype(int).tolist()
    return red, green, blue
