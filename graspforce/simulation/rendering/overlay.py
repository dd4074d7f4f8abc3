"""A strip of text below the hand: time, tracking error, and each contact's friction use, slip margin and normal force."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image as PillowImage
from PIL import ImageDraw, ImageFont

from graspforce.simulation.rendering.display_model import Image
from graspforce.simulation.rendering.marks import ContactMark, SceneState, use_colour

COVERED = 0.19  # part of the frame's height under the strip

_BACKGROUND, _OPACITY = (17, 22, 30), 0.88
_TEXT, _FAINT, _TRACK, _LIMIT = (240, 243, 247), (158, 170, 184), (52, 61, 74), (224, 92, 60)
_PUSH_COLOUR = (110, 40, 140)
_SMALL, _MEDIUM, _LARGE, _HUGE = 15, 19, 24, 30  # pixels
_DESIGN_HEIGHT = 720  # pixels: sizes below are for frames of this height
_HISTORY = 5.0  # s, shown by the curves
_FIRST_COLUMN = 0.25  # of the strip's width


class Overlay:
    """The strip of a film.

    Args:
        title: first line of the strip.
        subtitle: second line, smaller.
        width: of the frames, pixels.
        height: of the frames, pixels.
        is_compact: large text and less of it, for small films.
    """

    def __init__(self, title: str, subtitle: str, width: int, height: int, is_compact: bool = False) -> None:
        self._title, self._subtitle, self._size, self._is_compact = title, subtitle, (width, height), is_compact
        self._scale = min(height / _DESIGN_HEIGHT, width / (_DESIGN_HEIGHT * 16.0 / 9.0))
        fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
        self._fonts = {
            (size, bold): ImageFont.truetype(fonts / f"DejaVuSans{'-Bold' if bold else ''}.ttf", max(self._pixels(size), 6))
            for size in (_SMALL, _MEDIUM, _LARGE, _HUGE)
            for bold in (False, True)
        }
        self._history: list[tuple[float, list[float]]] = []

    def paint(self, image: Image, state: SceneState, position_error: float) -> Image:
        """Return the image with the strip painted over its lower part.

        Args:
            image: (height, width, 3), of the state.
            state: time, contacts and push.
            position_error: distance of the object from its reference, m.
        """
        t, contacts, push = state.t, state.contacts, state.push
        self._history = [row for row in self._history if row[0] > t - _HISTORY]
        self._history.append((t, [mark.use for mark in contacts]))
        width, height = self._size
        top = round((1.0 - COVERED) * height)
        canvas = PillowImage.fromarray(image)
        strip = PillowImage.new("RGB", (width, height - top), _BACKGROUND)
        canvas.paste(strip, (0, top), PillowImage.new("L", strip.size, int(255 * _OPACITY)))
        draw = ImageDraw.Draw(canvas)
        self._paint_heading(draw, t, position_error, top)
        if push is not None:
            text, size = f"push on the object: {push.force:.1f} N", _HUGE if self._is_compact else _LARGE
            self._text(draw, (self._pixels(28), self._pixels(24)), text, size, True, _PUSH_COLOUR)
        column = (1.0 - _FIRST_COLUMN) * width / max(len(contacts), 1)
        for i, mark in enumerate(contacts):
            self._paint_contact(draw, mark, i, round(_FIRST_COLUMN * width + i * column), top, round(column) - self._pixels(24))
        return np.asarray(canvas)

    def _paint_heading(self, draw: ImageDraw.ImageDraw, t: float, position_error: float, top: int) -> None:
        """Paint the left column: titles, time and tracking error."""
        left, pixels = self._pixels(28), self._pixels
        if self._is_compact:
            self._text(draw, (left, top + pixels(22)), self._title, _LARGE, bold=True)
            self._text(draw, (left, top + pixels(60)), f"t = {t:.1f} s", _LARGE)
            self._text(draw, (left, top + pixels(94)), f"error {_length(position_error)}", _LARGE, colour=_FAINT)
            return
        self._text(draw, (left, top + pixels(15)), self._title, _LARGE, bold=True)
        self._text(draw, (left, top + pixels(49)), self._subtitle, _SMALL, colour=_FAINT)
        self._text(draw, (left, top + pixels(77)), f"t = {t:4.2f} s", _MEDIUM)
        self._text(draw, (left, top + pixels(106)), f"tracking error {_length(position_error)}", _SMALL, colour=_FAINT)

    def _paint_contact(self, draw: ImageDraw.ImageDraw, mark: ContactMark, index: int, left: int, top: int, width: int) -> None:
        """Paint the column of one contact: name, friction use as text, bar and curve, margin and force."""
        pixels = self._pixels
        colour = _bytes(mark)
        if self._is_compact:
            self._text(draw, (left, top + pixels(20)), mark.finger, _LARGE, bold=True)
            self._text(draw, (left + width, top + pixels(18)), f"{100.0 * mark.use:.0f} %", _HUGE, True, colour, "ra")
            self._bar(draw, (left, top + pixels(62)), width, pixels(14), mark)
            self._text(draw, (left, top + pixels(92)), f"slip margin {max(mark.slip_margin, 0.0):.1f} N", _LARGE, colour=_FAINT)
            return
        self._text(draw, (left, top + pixels(13)), mark.finger, _MEDIUM, bold=True)
        label = f"{100.0 * mark.use:.0f} % of friction" if mark.touching else "no contact"
        self._text(draw, (left + width, top + pixels(16)), label, _SMALL, anchor="ra", colour=colour)
        self._bar(draw, (left, top + pixels(43)), width, pixels(9), mark)
        text = f"slip margin {max(mark.slip_margin, 0.0):.2f} N"
        self._text(draw, (left, top + pixels(58)), text, _SMALL)
        self._text(draw, (left + width, top + pixels(58)), f"normal {mark.f_n:.2f} N", _SMALL, anchor="ra", colour=_FAINT)
        low, high = top + pixels(127), top + pixels(86)  # of 0 and 100 %
        draw.line((left, high, left + width, high), fill=_LIMIT, width=1)
        draw.line((left, low, left + width, low), fill=_TRACK, width=1)
        now = self._history[-1][0]
        points = [(left + width * (1.0 - (now - t) / _HISTORY), low + (high - low) * uses[index]) for t, uses in self._history]
        if len(points) > 1:
            draw.line(points, fill=colour, width=max(pixels(2), 1), joint="curve")

    def _bar(self, draw: ImageDraw.ImageDraw, place: tuple[int, int], width: int, height: int, mark: ContactMark) -> None:
        left, top = place
        draw.rectangle((left, top, left + width, top + height), fill=_TRACK)
        draw.rectangle((left, top, left + max(round(mark.use * width), 1), top + height), fill=_bytes(mark))

    def _text(
        self,
        draw: ImageDraw.ImageDraw,
        place: tuple[int, int],
        text: str,
        size: int,
        bold: bool = False,
        colour: tuple[int, int, int] = _TEXT,
        anchor: str = "la",
    ) -> None:
        draw.text(place, text, fill=colour, font=self._fonts[size, bold], anchor=anchor)

    def _pixels(self, size: float) -> int:
        return round(size * self._scale)


def _length(value: float) -> str:
    """Return a length with a readable unit."""
    return f"{1e6 * value:.1f} µm" if value < 1e-4 else f"{1e3 * value:.2f} mm"


def _bytes(mark: ContactMark) -> tuple[int, int, int]:
    red, green, blue = (255.0 * use_colour(mark.use)).astype(int).tolist()
    return red, green, blue
