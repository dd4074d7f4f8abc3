"""The choice of a renderer: OpenGL where the machine has it, software elsewhere."""

from __future__ import annotations

from typing import Protocol

from graspforce.simulation.rendering.display_model import DisplayModel, Image
from graspforce.simulation.rendering.marks import SceneState
from graspforce.simulation.rendering.opengl_renderer import OpenGLRenderer
from graspforce.simulation.rendering.software_renderer import SoftwareRenderer

_GL_BACKENDS = ("egl", "osmesa", "cgl", "glfw")  # modules of MuJoCo: two for Linux without a display, macOS, any display
_INSTALL = "For OpenGL on Debian or Ubuntu: apt-get install libegl1 libgl1-mesa-dri, or libosmesa6"


class Renderer(Protocol):
    """Draws a plant: hand, object, contact forces and friction cones."""

    description: str

    def render(self, state: SceneState) -> Image:
        """Return an image of a state, (height, width, 3)."""
        ...  # pragma: no cover


def make_renderer(display: DisplayModel, width: int = 1280, height: int = 720) -> Renderer:
    """Return the best renderer of this machine; its `description` names it and, without OpenGL, the reason and the remedy.

    Args:
        display: the model to draw.
        width: of the images, pixels.
        height: of the images, pixels.
    """
    failures = []
    for name in _GL_BACKENDS:
        try:
            return OpenGLRenderer(display, name, width, height)
        except Exception as error:  # a missing driver raises errors of its binding's own kinds
            failures.append(f"{name}: {str(error).splitlines()[0] if str(error) else type(error).__name__}")
    return SoftwareRenderer(display, width, height, f"{_INSTALL} ({'; '.join(failures)})")
