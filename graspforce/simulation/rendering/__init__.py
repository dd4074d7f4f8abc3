"""Films and views of a simulated hand: display model, renderers, overlay, film files, interactive viewer."""

from graspforce.simulation.rendering.camera import CameraOptions
from graspforce.simulation.rendering.display_model import DisplayModel, Image
from graspforce.simulation.rendering.film import FilmWriter
from graspforce.simulation.rendering.marks import SceneState, capture_state
from graspforce.simulation.rendering.overlay import Overlay
from graspforce.simulation.rendering.renderer import Renderer, make_renderer
from graspforce.simulation.rendering.viewer import Viewer, missing_display_reason

__all__ = [
    "CameraOptions",
    "DisplayModel",
    "FilmWriter",
    "Image",
    "Overlay",
    "Renderer",
    "SceneState",
    "Viewer",
    "capture_state",
    "make_renderer",
    "missing_display_reason",
]
