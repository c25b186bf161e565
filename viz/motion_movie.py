"""The movie of a motion, or of several side by side, and pictures of single moments."""

from __future__ import annotations

import importlib.util
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from viz import style
from viz.encode import NO_FFMPEG, Movie, write_gif, write_mp4
from viz.play import Play
from viz.process import RenderError
from viz.sheet import chosen, composed
from viz.stage import Shot
from viz.worker import Renderer

# A movie lasts about that long (s), within what these frame rates (1/s) allow; longer motions are shown with fewer frames.
_LASTS, _SLOWEST, _FASTEST = 6.0, 8.0, 25.0
MOST_FRAMES = 500
_HOLD = 1.0  # s that the last moment stands
_GIF_FRAMES = 40


def rate(frames: int) -> float:
    """Frames a second at which a movie of so many frames is shown."""
    return float(np.clip(round(frames / _LASTS), _SLOWEST, _FASTEST))


def pace(times: np.ndarray, fps: float) -> float | None:
    """How many times slower than life frames at those times (s) are when shown at fps; None for a single one."""
    span = float(times[-1] - times[0])
    return (len(times) - 1) / fps / span if span > 0 else None


def movie(
    play: Play,
    path: str | Path,
    renderer: Renderer,
    *,
    fps: float | None = None,
    size: tuple[int, int] = style.MOVIE_SIZE,
) -> Movie:
    """Show a motion from its first frame to its last.

    fps: frames a second, by default such that it lasts a few seconds. size: width and height, even numbers. Without imageio-ffmpeg a
    GIF of the same name is written. Raises RenderError.
    """
    if size[0] % 2 or size[1] % 2:
        raise RenderError(f"a movie's size is {size[0]} x {size[1]}; mp4 needs even numbers")
    numbers = chosen(len(play), MOST_FRAMES)
    fps = fps or rate(len(numbers))
    slower = pace(play.motion.times[numbers], fps)

    def image(k: int) -> np.ndarray:
        return renderer.stage_image(play.stage(k, slower), play.shot, size=size)

    return _written(path, image, numbers, fps)


def beside(
    plays: Sequence[Play],
    path: str | Path,
    renderer: Renderer,
    words: Callable[[Play, int], str],
    *,
    fps: float | None = None,
    width: int = style.MOVIE_SIZE[0],
) -> Movie:
    """Show motions side by side, from one place at one scale, frame by frame as far as the shortest goes.

    words: what stands above a frame of a motion. fps, GIF and RenderError: as in `movie`; width: pixels, about.
    """
    numbers = chosen(min(len(play) for play in plays), MOST_FRAMES)
    shot = Shot.of_all([play.shot for play in plays])

    def image(k: int) -> np.ndarray:
        shown = [(play, k) for play in plays]
        return composed(shown, renderer, len(plays), width, [words(play, k) for play in plays], shot)

    return _written(path, image, numbers, fps or rate(len(numbers)))


def _written(path: str | Path, image: Callable[[int], np.ndarray], numbers: np.ndarray, fps: float) -> Movie:
    """The frames of those numbers as a movie, mp4 or GIF; image: a frame's picture (h, w, 3) uint8."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)

    def images(some: Iterable[int]) -> Iterator[np.ndarray]:
        return (image(int(k)) for k in some)

    if importlib.util.find_spec("imageio_ffmpeg") is None:
        path = path.with_suffix(".gif")
        few = chosen(len(numbers), _GIF_FRAMES)
        each = len(numbers) / fps / len(few)
        write_gif(images(numbers[few]), path, [each] * (len(few) - 1) + [_HOLD])
        return Movie(path, NO_FFMPEG)
    path = path.with_suffix(".mp4")
    first = image(int(numbers[0]))
    shown = itertools.chain([first], images(numbers[1:]))
    write_mp4(_held(shown, round(_HOLD * fps)), path, round(fps), (first.shape[1], first.shape[0]))
    return Movie(path)


def _held(images: Iterator[np.ndarray], times: int) -> Iterator[np.ndarray]:
    """The images, the last one so many times more."""
    image = None
    for image in images:
        yield image
    for _ in range(times if image is not None else 0):
        assert image is not None
        yield image


def pictures(play: Play, folder: str | Path, renderer: Renderer, numbers: Sequence[int]) -> list[Path]:
    """PNG pictures of frames, folder/frame_0012.png. Raises RenderError."""
    return [
        renderer.render_stage(play.stage(int(k)), play.shot, Path(folder) / f"frame_{int(k):04d}.png")
        for k in numbers
    ]
