"""A short movie of the best shapes of a study, one after another, all seen from the same place."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from viz import style
from viz.camera import Frame
from viz.picture import Picture
from viz.process import RenderError
from viz.worker import Renderer

NO_FFMPEG = "imageio-ffmpeg is not installed, so the movie is a GIF; for mp4: pip install 'magmpm[render]'."

# Seconds a shape stands still, the last one stands, and one fades into the next.
_HOLD, _LAST, _FADE = 0.7, 2.0, 0.25

_LEAN = ("-x264-params", "rc-lookahead=2:sync-lookahead=0:ref=1:bframes=0")


@dataclass(frozen=True)
class Movie:
    """path: the file written, .mp4 or .gif. note: empty, or one line that says why it is not an mp4."""

    path: Path
    note: str = ""


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
        _write_gif(stills, path)
        return Movie(path, NO_FFMPEG)
    path = path.with_suffix(".mp4")
    _write_mp4(_faded(stills, fps), path, fps, size)
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


def _write_mp4(frames: Iterator[np.ndarray], path: Path, fps: int, size: tuple[int, int]) -> None:
    """Encode with H.264 as browsers play it.

    One thread that looks two frames ahead takes 57 MB where the defaults take 103; the file is no larger.
    """
    from imageio_ffmpeg import write_frames

    unfinished = path.with_name(f"{path.stem}.part.mp4")
    writer = write_frames(
        str(unfinished),
        size,
        fps=fps,
        codec="libx264",
        pix_fmt_out="yuv420p",
        macro_block_size=2,
        quality=None,
        output_params=[
            "-crf",
            "20",
            "-preset",
            "veryfast",
            "-threads",
            "1",
            "-movflags",
            "+faststart",
            *_LEAN,
        ],
    )
    try:
        writer.send(None)
        for frame in frames:
            writer.send(np.ascontiguousarray(frame))
    except OSError as error:
        raise RenderError(f"{path.name} could not be encoded: {error}") from None
    finally:
        writer.close()
    unfinished.replace(path)


def _write_gif(stills: list[np.ndarray], path: Path) -> None:
    """The stills without fading, at half the size: a GIF stores every changed pixel."""
    from PIL import Image

    images = [Image.fromarray(still).reduce(2).quantize(128) for still in stills]
    times = [1000 * _HOLD] * (len(images) - 1) + [1000 * _LAST]
    images[0].save(path, save_all=True, append_images=images[1:], duration=[round(t) for t in times], loop=0)
