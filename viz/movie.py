"""A short movie of the best shapes of a study, one after another, all seen from the same place."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from viz import style
from viz.camera import Frame
from viz.encode import NO_FFMPEG, Movie, write_gif, write_mp4
from viz.picture import Picture
from viz.process import RenderError
from viz.worker import Renderer

# Seconds a shape stands still, the last one stands, and one fades into the next.
_HOLD, _LAST, _FADE = 0.7, 2.0, 0.25


def best_shapes_movie(
    pictures: Sequence[Picture],
    path: str | Path,
    renderer: Renderer,
    fps: int = 20,
    size: tuple[int, int] = style.TRIAL_SIZE,
) -> Movie:
    """Show each picture for a moment, one fading into the next, and the last one longer.

    The frames between two shapes are mixed pictures, not shapes in between: those were never solved. fps:
    frames a second. size: width and height, even numbers. Without imageio-ffmpeg a GIF of the same name is
    written instead. Raises RenderError, also when there are no pictures.
    """
    if not pictures:
        raise RenderError("a movie needs at least one picture")
    if size[0] % 2 or size[1] % 2:
        raise RenderError(f"a movie's size is {size[0]} x {size[1]}; mp4 needs even numbers")
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    frame = Frame.of(pictures)
    stills = [renderer.image(picture, size=size, frame=frame) for picture in pictures]
    # The encoder takes 50 to 100 MB: not at the same time as the drawing process.
    renderer.rest()
    if importlib.util.find_spec("imageio_ffmpeg") is None:
        path = path.with_suffix(".gif")
        write_gif(stills, path, [_HOLD] * (len(stills) - 1) + [_LAST])
        return Movie(path, NO_FFMPEG)
    path = path.with_suffix(".mp4")
    write_mp4(_faded(stills, fps), path, fps, size)
    return Movie(path)


def _faded(stills: list[np.ndarray], fps: int) -> Iterator[np.ndarray]:
    """Every frame of the movie, (h, w, 3) uint8."""
    before: np.ndarray | None = None
    steps = max(round(_FADE * fps), 1)
    for number, still in enumerate(stills):
        if before is not None:
            for k in range(1, steps):
                share = k / steps
                yield ((1 - share) * before + share * still + 0.5).astype(np.uint8)
        for _ in range(round((_LAST if number == len(stills) - 1 else _HOLD) * fps)):
            yield still
        before = still
