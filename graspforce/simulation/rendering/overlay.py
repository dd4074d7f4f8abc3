"""Captions on the picture, and a strip below it with each contact's friction use, slip margin and normal force."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image as PillowImage
from PIL import ImageDraw, ImageFont

from graspforce.contact.use_colour import use_colour
from graspforce.simulation.rendering.display_model import Image
from graspforce.simulation.rendering.marks import ContactMark, SceneState

STRIP = 0.2  # part of the frame's height under the strip

_BACKGROUND = (17, 22, 30)
_TEXT, _FAINT, _TRACK, _LIMIT = (240, 243, 247), (158, 170, 184), (52, 61, 74), (224, 92, 60)
_CAPTION, _CAPTION_FAINT, _PUSH_COLOUR = (24, 30, 40), (72, 82, 96), (110, 40, 140)
_CAPTION_BACKGROUND, _CAPTION_OPACITY = (232, 238, 244), 0.72
_SIZES = {False: (15, 18, 26), True: (24, 28, 40)}  # pixels of small, medium and large text, normal and compact
_DESIGN_HEIGHT = 720  # pixels: sizes are for frames of this height
_MARGIN = 20  # pixels
_HISTORY = 6.0  # s of the film, shown by the curves
_BLOCK = 8  # pixels: heights of pictures are multiples, for video codecs


def picture_size(width: int, height: int) -> tuple[int, int]:
    """Return the size of the picture above the strip, pixels.

    Args:
        width: of the frames, pixels.
        height: of the frames, pixels.
    """
    return width, height - max(round(STRIP * height / _BLOCK), 1) * _BLOCK


class Overlay:
    """Captions and strip of a film.

    Args:
        title: first line of the captions.
        subtitle: second line, such as how much slower the film is.
        width: of the frames, pixels.
        height: of the frames, pixels; `picture_size` has the size of the picture in it.
        is_compact: large text and less of it, for small films.
        slow_motion: seconds of the film for each second of the simulation; the curves show 6 s of the film.
    """

    def __init__(
        self, title: str, subtitle: str, width: int, height: int, is_compact: bool = False, slow_motion: float = 1.0
    ) -> None:
        self._title, self._subtitle, self._size, self._is_compact = title, subtitle, (width, height), is_compact
        self._digits = 1 if slow_motion < 2.0 else 2 if slow_motion < 20.0 else 4  # of the time in s
        self._shown_time = _HISTORY / slow_motion  # s
        self._scale = min(height / _DESIGN_HEIGHT, width / (_DESIGN_HEIGHT * 16.0 / 9.0))
        fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
        self._small, self._medium, self._large = _SIZES[is_compact]
        self._fonts = {
            (size, bold): ImageFont.truetype(fonts / f"DejaVuSans{'-Bold' if bold else ''}.ttf", max(self._pixels(size), 6))
            for size in _SIZES[is_compact]
            for bold in (False, True)
        }
        self._history: list[tuple[float, list[float]]] = []
        self._without_contact = ("lost", _LIMIT)  # label of a finger that does not touch, and its colour

    def paint(self, image: Image, state: SceneState, status: float | str) -> Image:
        """Return the frame: the picture with captions, and the strip below it.

        Args:
            image: (height, width, 3), of the state, in the size of `picture_size`.
            state: time, contacts and push.
            status: distance of the object from its reference, m; or a text, such as the phase of a grasp.
        """
        t, contacts = state.t, state.contacts
        self._without_contact = ("lost", _LIMIT) if isinstance(status, float) else ("open", _FAINT)
        self._history = [row for row in self._history if row[0] > t - self._shown_time]
        self._history.append((t, [mark.use for mark in contacts]))
        canvas = PillowImage.new("RGB", self._size, _BACKGROUND)
        canvas.paste(PillowImage.fromarray(image), (0, 0))
        draw = ImageDraw.Draw(canvas)
        self._paint_captions(canvas, draw, state, status)
        top, cell = image.shape[0], self._size[0] / max(len(contacts), 1)
        for i, mark in enumerate(contacts):
            self._paint_contact(draw, mark, i, (round(i * cell), round((i + 1) * cell)), top)
        return np.asarray(canvas)

    def _paint_captions(
        self, canvas: PillowImage.Image, draw: ImageDraw.ImageDraw, state: SceneState, status: float | str
    ) -> None:
        """Paint titles, time, tracking error or status, and the push, on the picture."""
        margin, line = self._pixels(_MARGIN), self._pixels(1.35 * self._medium)
        text = status if isinstance(status, str) else f"tracking error {_length(status)}"
        time = f"t = {state.t:.{self._digits}f} s"
        lines = [self._subtitle, f"{time}, {text}" if text and (isinstance(status, str) or not self._is_compact) else time]
        title, size = self._fitted_title(draw, margin)
        below = margin + self._pixels(1.4 * self._large)
        widths = [draw.textlength(title, self._fonts[size, True])]
        widths += [draw.textlength(words, self._fonts[self._medium, False]) for words in lines]
        box = round(max(widths)) + 2 * margin, below + len(lines) * line + margin // 2
        canvas.paste(_CAPTION_BACKGROUND, (0, 0, *box), PillowImage.new("L", box, round(255 * _CAPTION_OPACITY)))
        self._text(draw, (margin, margin), title, size, bold=True, colour=_CAPTION)
        for i, words in enumerate(lines):
            self._text(draw, (margin, below + i * line), words, self._medium, colour=_CAPTION_FAINT)
        if state.push is not None:
            place = self._size[0] - margin, margin
            self._text(draw, place, f"push {state.push.force:.1f} N", self._large, True, _PUSH_COLOUR, "ra")

    def _fitted_title(self, draw: ImageDraw.ImageDraw, left: int) -> tuple[str, int]:
        """Return the title and the largest size in which it fits into three quarters of the width; the smallest is cut."""
        width, title = 0.75 * self._size[0] - left, self._title  # pixels
        sizes = [size for size in (self._large, self._medium) if draw.textlength(title, self._fonts[size, True]) <= width]
        size = sizes[0] if sizes else self._small
        while draw.textlength(title, self._fonts[size, True]) > width:
            title = title[:-2] + "…"
        return title, size

    def _paint_contact(
        self, draw: ImageDraw.ImageDraw, mark: ContactMark, index: int, edges: tuple[int, int], top: int
    ) -> None:
        """Paint a contact's part of the strip: name, friction use as number and curve, slip margin and normal force."""
        pad, bottom = self._pixels(12), self._size[1] - self._pixels(10)
        left, right = edges[0] + pad, edges[1] - pad
        label, colour = self._without_contact
        if mark.touching:
            label, colour = f"{100.0 * mark.use:.0f} %", _bytes(mark)
        y = top + self._pixels(8)
        self._text(draw, (left, y), mark.finger, self._medium, bold=True)
        self._text(draw, (right, y), label, self._medium, True, colour, "ra")
        y += self._pixels(1.35 * self._medium)
        margin = f"margin {max(mark.slip_margin, 0.0):.2f} N"
        if self._is_compact:
            self._text(draw, (left, y), margin, self._small, colour=_FAINT)
        else:
            self._text(draw, (left, y), f"slip {margin}", self._small)
            self._text(draw, (right, y), f"normal {mark.f_n:.2f} N", self._small, anchor="ra", colour=_FAINT)
        high = y + self._pixels(1.7 * self._small)
        draw.line((left, high, right, high), fill=_LIMIT, width=1)  # 100 %: the finger slips
        draw.line((left, bottom, right, bottom), fill=_TRACK, width=1)
        now = self._history[-1][0]
        points = [
            (right - (right - left) * (now - t) / self._shown_time, bottom + (high - bottom) * uses[index])
            for t, uses in self._history
        ]
        if len(points) > 1:
            draw.line(points, fill=colour, width=max(self._pixels(2.5), 1), joint="curve")

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
