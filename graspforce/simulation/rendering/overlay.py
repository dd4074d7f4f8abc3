"""A panel beside the hand: time, tracking error, and each contact's friction use, slip margin and normal force."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image as PillowImage
from PIL import ImageDraw, ImageFont

from graspforce.contact.use_colour import use_colour
from graspforce.simulation.rendering.display_model import Image
from graspforce.simulation.rendering.marks import ContactMark, SceneState

COVERED = 0.27  # part of the frame's width under the panel

_BACKGROUND, _OPACITY = (17, 22, 30), 0.93
_TEXT, _FAINT, _TRACK, _LIMIT = (240, 243, 247), (158, 170, 184), (52, 61, 74), (224, 92, 60)
_PUSH_COLOUR = (110, 40, 140)
_SMALL, _MEDIUM, _LARGE, _HUGE = 16, 19, 24, 32  # pixels
_DESIGN_HEIGHT = 720  # pixels: sizes are for frames of this height
_HEADING, _COMPACT_HEADING = 158, 150  # pixels above the first contact
_TALLEST = 190  # pixels for one contact
_CURVE = 90  # pixels from the top of a contact's block to its curve
_LOWEST_CURVE = 16  # pixels: lower curves are left out
_HISTORY = 6.0  # s of the film, shown by the curves


class Overlay:
    """The panel of a film.

    Args:
        title: first line of the panel.
        subtitle: second line, smaller.
        width: of the frames, pixels.
        height: of the frames, pixels.
        is_compact: large text and less of it, for small films.
        slow_motion: seconds of the film for each second of the simulation; the curves show 6 s of the film.
    """

    def __init__(
        self, title: str, subtitle: str, width: int, height: int, is_compact: bool = False, slow_motion: float = 1.0
    ) -> None:
        self._title, self._subtitle, self._size, self._is_compact = title, subtitle, (width, height), is_compact
        self._shown_time = _HISTORY / slow_motion  # s
        self._scale = min(height / _DESIGN_HEIGHT, width / (_DESIGN_HEIGHT * 16.0 / 9.0))
        fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
        self._fonts = {
            (size, bold): ImageFont.truetype(fonts / f"DejaVuSans{'-Bold' if bold else ''}.ttf", max(self._pixels(size), 6))
            for size in (_SMALL, _MEDIUM, _LARGE, _HUGE)
            for bold in (False, True)
        }
        self._history: list[tuple[float, list[float]]] = []
        self._without_contact = ("lost", _LIMIT)  # label of a finger that does not touch, and its colour

    def paint(self, image: Image, state: SceneState, status: float | str) -> Image:
        """Return the image with the panel painted over its left part.

        Args:
            image: (height, width, 3), of the state.
            state: time, contacts and push.
            status: distance of the object from its reference, m; or a text, such as the phase of a grasp.
        """
        t, contacts = state.t, state.contacts
        self._without_contact = ("lost", _LIMIT) if isinstance(status, float) else ("open", _FAINT)
        self._history = [row for row in self._history if row[0] > t - self._shown_time]
        self._history.append((t, [mark.use for mark in contacts]))
        width, height = round(COVERED * self._size[0]), self._size[1]
        canvas = PillowImage.fromarray(image)
        panel = PillowImage.new("RGB", (width, height), _BACKGROUND)
        canvas.paste(panel, (0, 0), PillowImage.new("L", panel.size, int(255 * _OPACITY)))
        draw = ImageDraw.Draw(canvas)
        self._paint_heading(draw, t, status)
        heading = self._pixels(_COMPACT_HEADING if self._is_compact else _HEADING)
        block = min((height - heading) // max(len(contacts), 1), self._pixels(_TALLEST))
        for i, mark in enumerate(contacts):
            paint = self._paint_compact_contact if self._is_compact else self._paint_contact
            paint(draw, mark, i, heading + i * block, block)
        if state.push is not None:
            text, size = f"push {state.push.force:.1f} N", _HUGE if self._is_compact else _LARGE
            self._text(draw, (width + self._pixels(24), self._pixels(20)), text, size, True, _PUSH_COLOUR)
        return np.asarray(canvas)

    def _paint_heading(self, draw: ImageDraw.ImageDraw, t: float, status: float | str) -> None:
        """Paint titles, time, and tracking error or status."""
        left, pixels = self._pixels(24), self._pixels
        if self._is_compact:
            self._paint_title(draw, (left, pixels(22)))
            self._text(draw, (left, pixels(62)), f"t = {t:.1f} s", _LARGE)
            self._text(
                draw, (left, pixels(98)), status if isinstance(status, str) else "friction in use:", _LARGE, colour=_FAINT
            )
            return
        self._paint_title(draw, (left, pixels(24)))
        self._text(draw, (left, pixels(57)), self._subtitle, _SMALL, colour=_FAINT)
        self._text(draw, (left, pixels(88)), f"t = {t:4.2f} s", _MEDIUM)
        text = status if isinstance(status, str) else f"tracking error {_length(status)}"
        self._text(draw, (left, pixels(116)), text, _SMALL, colour=_FAINT)

    def _paint_title(self, draw: ImageDraw.ImageDraw, place: tuple[int, int]) -> None:
        """Paint the title in the largest type that fits into the panel; the smallest is cut at its right edge."""
        width, title = COVERED * self._size[0] - 2.0 * place[0], self._title  # pixels
        sizes = [size for size in (_LARGE, _MEDIUM, _SMALL) if draw.textlength(title, self._fonts[size, True]) <= width]
        size = sizes[0] if sizes else _SMALL
        while draw.textlength(title, self._fonts[size, True]) > width:
            title = title[:-2] + "…"
        self._text(draw, place, title, size, bold=True)

    def _paint_contact(self, draw: ImageDraw.ImageDraw, mark: ContactMark, index: int, top: int, block: int) -> None:
        """Paint a contact: name, friction use as text, bar and curve, slip margin and normal force."""
        pixels, colour = self._pixels, _bytes(mark)
        left, right = pixels(24), round(COVERED * self._size[0]) - pixels(24)
        draw.line((left, top, right, top), fill=_TRACK, width=1)
        self._text(draw, (left, top + pixels(12)), mark.finger, _MEDIUM, bold=True)
        label = f"{100.0 * mark.use:.0f} % of friction" if mark.touching else "no contact"
        self._text(draw, (right, top + pixels(14)), label, _SMALL, anchor="ra", colour=colour)
        self._bar(draw, (left, top + pixels(42)), right - left, pixels(9), mark)
        self._text(draw, (left, top + pixels(60)), f"slip margin {max(mark.slip_margin, 0.0):.2f} N", _SMALL)
        self._text(draw, (right, top + pixels(60)), f"normal {mark.f_n:.2f} N", _SMALL, anchor="ra", colour=_FAINT)
        high, low = top + pixels(_CURVE + 4), top + block - pixels(14)  # of 100 and 0 %
        if low - high < pixels(_LOWEST_CURVE):
            return
        draw.line((left, high, right, high), fill=_LIMIT, width=1)
        draw.line((left, low, right, low), fill=_TRACK, width=1)
        now = self._history[-1][0]
        points = [
            (right - (right - left) * (now - t) / self._shown_time, low + (high - low) * uses[index])
            for t, uses in self._history
        ]
        if len(points) > 1:
            draw.line(points, fill=colour, width=max(pixels(2), 1), joint="curve")

    def _paint_compact_contact(self, draw: ImageDraw.ImageDraw, mark: ContactMark, _: int, top: int, __: int) -> None:
        """Paint a contact in large type: name, friction use, bar and slip margin."""
        pixels, (label, colour) = self._pixels, self._without_contact
        left, right = pixels(24), round(COVERED * self._size[0]) - pixels(24)
        draw.line((left, top, right, top), fill=_TRACK, width=2)
        self._text(draw, (left, top + pixels(22)), mark.finger, _LARGE, bold=True)
        if mark.touching:
            label, colour = f"{100.0 * mark.use:.0f} %", _bytes(mark)
        self._text(draw, (right, top + pixels(15)), label, _HUGE, True, colour, "ra")
        self._bar(draw, (left, top + pixels(64)), right - left, pixels(16), mark)
        self._text(draw, (left, top + pixels(96)), f"slip margin {max(mark.slip_margin, 0.0):.1f} N", _LARGE, colour=_FAINT)

    def _bar(self, draw: ImageDraw.ImageDraw, place: tuple[int, int], width: int, height: int, mark: ContactMark) -> None:
        left, top = place
        draw.rectangle((left, top, left + width, top + height), fill=_TRACK)
        if not mark.touching and self._without_contact[1] == _FAINT:
            return
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
    """Return a length in m as text with a readable unit."""
    return f"{1e6 * value:.1f} µm" if value < 1e-4 else f"{1e3 * value:.2f} mm"


def _bytes(mark: ContactMark) -> tuple[int, int, int]:
    red, green, blue = (255.0 * use_colour(mark.use)).astype(int).tolist()
    return red, green, blue
