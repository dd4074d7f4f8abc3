"""Size, rate and viewpoint of films, as options of several commands."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from graspforce.core import arrays, fields
from graspforce.core.errors import InvalidInput

if TYPE_CHECKING:  # it needs MuJoCo
    from graspforce.simulation.rendering import CameraOptions, DisplayModel, SceneState

_USUAL_SIZE = (1280, 720)  # pixels
_BLOCK = 8  # pixels
_SMALLEST, _LARGEST = 64, 4096  # pixels
_MAX_RATE = 240.0  # frames a second
_HIGHEST = 85.0  # degrees


@dataclass(frozen=True, slots=True)
class FilmFormat:
    """Size, rate and viewpoint of a film.

    Args:
        size: width and height of the frames, pixels.
        rate: frames per second; None for 30 in videos and 15 in animated images.
        azimuth: turn of the camera about the vertical axis, degrees, from where it stands by itself.
        elevation: of the camera above the horizontal plane, degrees; None for the usual one.
        width: largest width of animated images, pixels; None for the usual one.

    Raises:
        InvalidInput: names the option and what is allowed.
    """

    size: tuple[int, int] = _USUAL_SIZE
    rate: float | None = None
    azimuth: float = 0.0
    elevation: float | None = None
    width: int | None = None

    def __post_init__(self) -> None:
        for each in self.size:
            fields.check_integer(each, "--film-size", minimum=_SMALLEST, maximum=_LARGEST)
            if each % _BLOCK:
                raise InvalidInput("--film-size", each, f"a multiple of {_BLOCK}, for video codecs")
        if self.rate is not None and arrays.check_number(self.rate, "--fps", above=0.0) > _MAX_RATE:
            raise InvalidInput("--fps", self.rate, f"at most {_MAX_RATE:g}")
        if self.elevation is not None and abs(self.elevation) > _HIGHEST:
            raise InvalidInput("--film-camera", self.elevation, f"an elevation from -{_HIGHEST:g} to {_HIGHEST:g} degrees")

    @property
    def picture(self) -> tuple[int, int]:
        """Width and height of the picture above the strip, pixels."""
        from graspforce.simulation.rendering.overlay import picture_size

        return picture_size(*self.size)

    def fill_text(self, display: DisplayModel, states: Sequence[SceneState]) -> str:
        """Return the least part of the frames, with the strip, that hand and object cover, as text.

        Args:
            display: the model, with the camera of the film.
            states: states of all frames, at least one.
        """
        from graspforce.simulation.rendering.coverage import least_coverage

        width, height = self.picture
        part = least_coverage(display, states, width, height) * height / self.size[1]
        return f"hand and object cover at least {100.0 * part:.0f} % of the frame"

    def camera(self, options: CameraOptions) -> CameraOptions:
        """Return the options of a camera with this viewpoint, and with the shape of the picture in the frames.

        Args:
            options: the other options.
        """
        elevation = options.elevation if self.elevation is None else math.radians(self.elevation)
        width, height = self.picture
        aspect = width / height
        return replace(options, aspect=aspect, azimuth=math.radians(self.azimuth), elevation=elevation)


def parse_film_format(size: str | None, rate: float | None, camera: str | None) -> FilmFormat:
    """Return the format of a film from its options.

    Args:
        size: WIDTHxHEIGHT in pixels; None for 1280x720.
        rate: frames per second; None for the usual rate.
        camera: AZIMUTH,ELEVATION in degrees; None for the usual viewpoint.

    Raises:
        InvalidInput: names the option and what is allowed.
    """
    pixels, width = _USUAL_SIZE, None
    if size is not None:
        parts = size.split("x")
        if len(parts) != 2 or not all(each.isdecimal() for each in parts):
            raise InvalidInput("--film-size", size, "WIDTHxHEIGHT in pixels, such as 1280x720")
        pixels = int(parts[0]), int(parts[1])
        width = pixels[0]
    if camera is None:
        return FilmFormat(pixels, rate, width=width)
    try:
        azimuth, elevation = (float(each) for each in camera.split(","))
    except ValueError:
        raise InvalidInput("--film-camera", camera, "AZIMUTH,ELEVATION in degrees, such as 30,20") from None
    for each in (azimuth, elevation):
        arrays.check_number(each, "--film-camera")
    return FilmFormat(pixels, rate, azimuth, elevation, width)
