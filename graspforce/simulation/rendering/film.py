"""Films of a simulation: frames at a fixed rate into a video, an animated image, or a directory of PNG files."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Any

import imageio.v2 as imageio
import numpy as np
from PIL import Image as PillowImage

from graspforce.core.errors import InvalidInput
from graspforce.simulation.rendering.display_model import Image

ANIMATIONS = (".gif", ".webp")  # suffixes of animated images
VIDEOS = (".mp4", ".m4v", ".mov", ".mkv", ".avi", ".webm")  # suffixes of videos
VIDEO_RATE, ANIMATION_RATE = 30, 15  # frames a second
ANIMATION_WIDTH = 640  # pixels
_GIF_COLOURS = 96
_WEBP_QUALITY = 80


class FilmWriter:
    """Writes the frames of a film. Use it as a context manager: leaving the context completes the files.

    Videos get 30 frames a second, animated images (.gif, .webp) 15 at a width of 640 pixels, unless arguments say otherwise.

    Args:
        video: file of the film, such as film.mp4, film.gif or film.webp; None for no film.
        frames: directory for the frames as PNG files; None for no frames.
        rate: frames per second; None for the usual rate.
        width: largest width of an animated image, pixels; None for the usual one.

    Attributes:
        rate: frames per second that it expects.
        count: number of frames so far.

    Raises:
        InvalidInput: no video of this kind can be written.
    """

    def __init__(self, video: Path | None, frames: Path | None, rate: float | None = None, width: int | None = None) -> None:
        self._video, self._frames, self.count = video, frames, 0
        self._is_animation = video is not None and video.suffix.lower() in ANIMATIONS
        usual = ANIMATION_RATE if self._is_animation and frames is None else VIDEO_RATE
        self.rate: float = usual if rate is None else rate
        self._animation_rate: float = ANIMATION_RATE if rate is None else rate
        self._width = ANIMATION_WIDTH if width is None else width
        self._writer: Any = None
        self._animation: list[PillowImage.Image] = []
        for path in (None if video is None else video.parent, frames):
            if path is not None:
                path.mkdir(parents=True, exist_ok=True)
        if video is not None and not self._is_animation:
            self._writer = _open_video(video, self.rate)

    def add(self, image: Image) -> None:
        """Add a frame (height, width, 3)."""
        if self._writer is not None:
            self._writer.append_data(image)
        if self._frames is not None:
            imageio.imwrite(self._frames / f"{self.count:05d}.png", image)
        if self._is_animation and self.count * self._animation_rate // self.rate == len(self._animation):
            picture = PillowImage.fromarray(image)
            height = round(picture.height * self._width / picture.width)
            if picture.width > self._width:
                picture = picture.resize((self._width, height), PillowImage.Resampling.LANCZOS)
            self._animation.append(picture)
        self.count += 1

    def close(self) -> None:
        """Complete the files."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None
        if self._animation and self._video is not None:
            _save_animation(self._animation, self._video, self._animation_rate)
            self._animation = []

    def __enter__(self) -> FilmWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def _open_video(path: Path, rate: float) -> Any:
    allowed = "a film's file, such as film.mp4, film.webp or film.gif"
    if path.suffix.lower() not in VIDEOS:
        raise InvalidInput("--video", str(path), allowed)
    try:
        return imageio.get_writer(path, fps=rate, quality=8, macro_block_size=8)
    except (ValueError, OSError, ImportError) as error:
        raise InvalidInput("--video", str(path), f"{allowed} ({error})") from None


def _save_animation(pictures: list[PillowImage.Image], path: Path, rate: float) -> None:
    """Write an endless animation; a GIF gets one palette for all frames."""
    options: dict[str, Any] = {"quality": _WEBP_QUALITY, "method": 4}
    if path.suffix.lower() == ".gif":
        sample = PillowImage.fromarray(np.concatenate([np.asarray(p) for p in pictures[:: max(len(pictures) // 6, 1)]]))
        palette = sample.quantize(_GIF_COLOURS, method=PillowImage.Quantize.MEDIANCUT)
        pictures = [p.quantize(palette=palette, dither=PillowImage.Dither.NONE) for p in pictures]
        options = {"optimize": True}
    duration = round(1000.0 / rate)  # ms
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=duration, loop=0, **options)
