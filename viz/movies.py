"""Movies: of a motion, of several side by side, and of the best shapes of a study. mp4 where imageio-ffmpeg is installed, else GIF."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from magmpm.errors import RenderError, install, installed
from magmpm.viz import style
from magmpm.viz.camera import Framing
from magmpm.viz.layout import page_of
from magmpm.viz.snapshot import Snapshot
from magmpm.viz.worker import Renderer

if TYPE_CHECKING:
    from magmpm.viz.from_motion import MotionRenderer

NO_FFMPEG = f"imageio-ffmpeg is not installed, so the movie is a GIF; for mp4: {install('render')}."

MOST_FRAMES_SHOWN = 500

# Seconds that a best shape stands still, and that the last one stands.
_SHAPE = 0.7
_LAST_SHAPE = 2.0

# Players read a movie that doesn't say its colors as they please, large ones other than small ones. These are the colors of the pictures.
_COLORS = (
    "-vf",
    "scale=out_color_matrix=bt709:out_range=tv,setparams=colorspace=bt709:color_primaries=bt709:color_trc=bt709",
)
_LEAN = ("-x264-params", "rc-lookahead=2:sync-lookahead=0:ref=1:bframes=0")


@dataclass(frozen=True)
class Movie:
    """path: the file written, .mp4 or .gif. note: empty, or one line that says why it is not an mp4."""

    path: Path
    note: str = ""


def chosen(frames: int, most: int) -> np.ndarray:
    """Numbers of at most `most` of so many frames, evenly spread, first and last among them."""
    return np.unique(np.linspace(0, frames - 1, min(frames, most)).round().astype(int))


def rate(frames: int) -> float:
    """Frames a second at which a movie of so many frames is shown."""
    seconds = 6.0  # that a movie lasts, about; longer motions are shown with fewer frames
    return float(np.clip(round(frames / seconds), 8.0, 25.0))


def pace(times: np.ndarray, fps: float) -> float | None:
    """Factor by which frames at those times (s) are slower than life when shown at fps; None for a single one."""
    span = float(times[-1] - times[0])
    return (len(times) - 1) / fps / span if span > 0 else None


def movie(
    motion: MotionRenderer,
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
    _even(size)
    numbers = chosen(len(motion), MOST_FRAMES_SHOWN)
    fps = fps or rate(len(numbers))
    slower = pace(motion.motion.times[numbers], fps)

    def image(k: int) -> np.ndarray:
        return renderer.image(motion.snapshot(k, slower), framing=motion.framing, size=size)

    return frames_movie(path, image, numbers, fps)


def frames_movie(
    path: str | Path,
    image: Callable[[int], np.ndarray],
    numbers: np.ndarray,
    fps: float | None = None,
) -> Movie:
    """The frames of those numbers as a movie, mp4 or GIF; image: a frame's picture (h, w, 3) uint8."""
    hold = 1.0  # s that the last moment stands
    path = _ready(path)
    fps = fps or rate(len(numbers))
    if path.suffix == ".gif":
        few = chosen(len(numbers), 40)
        each = len(numbers) / fps / len(few)
        return _write_gif(
            (image(int(k)) for k in numbers[few]), path, [each] * (len(few) - 1) + [hold]
        )
    first = image(int(numbers[0]))

    def shown() -> Iterator[np.ndarray]:
        last = first
        yield first
        for k in numbers[1:]:
            last = image(int(k))
            yield last
        yield from itertools.repeat(last, round(hold * fps))

    return _write_mp4(shown(), path, round(fps), (first.shape[1], first.shape[0]))


def pictures(
    motion: MotionRenderer,
    folder: str | Path,
    renderer: Renderer,
    numbers: Sequence[int],
    kind: str = "png",
) -> list[Path]:
    """Pictures of frames, folder/frame_0012.png; kind: png, svg or pdf. Raises RenderError."""
    return [
        renderer.render(
            motion.snapshot(int(k)),
            Path(folder) / f"frame_{int(k):04d}.{kind}",
            framing=motion.framing,
        )
        for k in numbers
    ]


def best_shapes_movie(
    snapshots: Sequence[Snapshot],
    path: str | Path,
    renderer: Renderer,
    fps: int = 20,
    size: tuple[int, int] | None = None,
) -> Movie:
    """Show each snapshot for a moment, one fading into the next, and the last one longer, all seen from the same place.

    The frames between two shapes are mixed pictures, not shapes in between: those were never solved. fps: frames a second. size: width
    and height, even numbers, as the pictures are by themselves unless given. Without imageio-ffmpeg a GIF of the same name is written.
    Raises RenderError, also without snapshots.
    """
    if not snapshots:
        raise RenderError("a movie needs at least one picture")
    path = _ready(path)
    framing = Framing.of(snapshots)
    size = size or page_of(framing, insets=snapshots[0].insets).size
    _even(size)
    stills = [renderer.image(snapshot, size=size, framing=framing) for snapshot in snapshots]
    # The encoder takes 50 to 100 MB: not at the same time as the drawing process.
    renderer.rest()
    if path.suffix == ".gif":
        return _write_gif(stills, path, [_SHAPE] * (len(stills) - 1) + [_LAST_SHAPE])
    return _write_mp4(_faded(stills, fps), path, fps, size)


def _faded(stills: list[np.ndarray], fps: int) -> Iterator[np.ndarray]:
    """Every frame of a movie of shapes, (h, w, 3) uint8."""
    fade = 0.25  # s, from one shape to the next
    before: np.ndarray | None = None
    steps = max(round(fade * fps), 1)
    for number, still in enumerate(stills):
        if before is not None:
            for k in range(1, steps):
                share = k / steps
                yield ((1 - share) * before + share * still + 0.5).astype(np.uint8)
        yield from itertools.repeat(
            still, round((_LAST_SHAPE if number == len(stills) - 1 else _SHAPE) * fps)
        )
        before = still


def _even(size: tuple[int, int]) -> None:
    if size[0] % 2 or size[1] % 2:
        raise RenderError(f"a movie's size is {size[0]} x {size[1]}; mp4 needs even numbers")


def _ready(path: str | Path) -> Path:
    """Path of the movie, with the ending of a format that can be written here. Its folder is made."""
    path = Path(path).with_suffix(".mp4" if installed("imageio_ffmpeg") else ".gif")
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _write_mp4(frames: Iterable[np.ndarray], path: Path, fps: int, size: tuple[int, int]) -> Movie:
    """Encode with H.264 as browsers play it.

    One thread that looks two frames ahead takes 57 MB where the defaults take 103; the file is no larger.
    """
    from imageio_ffmpeg import write_frames

    unfinished = path.with_name(f"{path.stem}.part.mp4")
    options = [
        "-crf",
        "20",
        "-preset",
        "veryfast",
        "-threads",
        "1",
        "-movflags",
        "+faststart",
        *_LEAN,
        *_COLORS,
    ]
    kind: Any = {
        "codec": "libx264",
        "pix_fmt_out": "yuv420p",
        "macro_block_size": 2,
        "quality": None,
    }
    writer = write_frames(str(unfinished), size, fps=fps, output_params=options, **kind)
    try:
        writer.send(None)
        for frame in frames:
            writer.send(np.ascontiguousarray(frame))
    except OSError as error:
        raise RenderError(f"{path.name} could not be encoded: {error}") from None
    finally:
        writer.close()
    unfinished.replace(path)
    return Movie(path)


def _write_gif(stills: Iterable[np.ndarray], path: Path, seconds: Sequence[float]) -> Movie:
    """Pictures (h, w, 3) uint8 shown for so many seconds each, at half the size: a GIF stores every changed pixel."""
    from PIL import Image

    images = [Image.fromarray(still).reduce(2).quantize(128) for still in stills]
    times = [round(1000 * t) for t in seconds]
    images[0].save(path, save_all=True, append_images=images[1:], duration=times, loop=0)
    return Movie(path, NO_FFMPEG)
