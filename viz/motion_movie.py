"""The movie of a motion, pictures of single moments, and a sheet of its first, middle and last moment for a paper."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from viz import stage_layout, style
from viz.camera import View
from viz.encode import NO_FFMPEG, Movie, write_gif, write_mp4
from viz.layout import LegendItem, ScaleBar
from viz.page import Page
from viz.play import Play
from viz.process import RenderError
from viz.stage import Stage, seconds
from viz.worker import Renderer

# A movie lasts about that long (s), within what these frame rates (1/s) allow; longer motions are shown with fewer frames.
_LASTS, _SLOWEST, _FASTEST = 6.0, 8.0, 25.0
MOST_FRAMES = 500
_HOLD = 1.0  # s that the last moment stands
_GIF_FRAMES = 40

# Moments wider than this many times their height stand below one another.
_STACKED = 2.8


def chosen(frames: int, most: int = MOST_FRAMES) -> np.ndarray:
    """Numbers of at most `most` of so many frames, evenly spread, first and last among them."""
    return np.unique(np.linspace(0, frames - 1, min(frames, most)).round().astype(int))


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
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    numbers = chosen(len(play))
    fps = fps or rate(len(numbers))
    slower = pace(play.motion.times[numbers], fps)

    def images(some: np.ndarray) -> Iterator[np.ndarray]:
        for k in some:
            yield renderer.stage_image(play.stage(int(k), slower), play.shot, size=size)

    if importlib.util.find_spec("imageio_ffmpeg") is None:
        path = path.with_suffix(".gif")
        few = chosen(len(numbers), _GIF_FRAMES)
        shown = len(numbers) / fps / len(few)
        write_gif(images(numbers[few]), path, [shown] * (len(few) - 1) + [_HOLD])
        return Movie(path, NO_FFMPEG)
    path = path.with_suffix(".mp4")
    write_mp4(_held(images(numbers), round(_HOLD * fps)), path, round(fps), size)
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


def sheet(
    play: Play, path: str | Path, renderer: Renderer, numbers: Sequence[int] | None = None, width: int = 1800
) -> Path:
    """Moments of a motion side by side, or one below another where they are wide, as one PNG.

    numbers: of frames, by default the first, the middle and the last; width: pixels, about. All are seen from the same place at the same
    scale. Raises RenderError.
    """
    numbers = list(chosen(len(play), 3) if numbers is None else numbers)
    natural = play.shot.aspect
    across = len(numbers) if natural < _STACKED else 1
    if across == 1:  # a page's width, as the others are three panels wide
        width = 2 * width // 3
    gap = round(0.008 * width)
    wide = (width - (across + 1) * gap) // across
    tall = round(wide / float(np.clip(natural, 0.8, 4.0)))
    stages = [play.stage(int(k)) for k in numbers]
    layout = stage_layout.bare((wide, tall))
    (view,) = stage_layout.views(play.shot, (wide, tall), layout)
    panels = [renderer.stage_image(s, play.shot, size=(wide, tall), layout=layout) for s in stages]
    unit = round((0.0165 if across > 1 else 0.022) * width)  # pixels, a letter's height
    rows = -(-len(panels) // across)
    head, foot = round(1.9 * unit), 4 * unit
    height = rows * (tall + head + gap) + foot
    canvas = np.full((height, across * (wide + gap) + gap, 3), 255, dtype=np.uint8)
    corners = []
    for i, panel in enumerate(panels):
        x, y = gap + i % across * (wide + gap), i // across * (tall + head + gap) + head
        canvas[y : y + tall, x : x + wide] = panel
        corners.append((x, y))
    page = Page(canvas)
    for (x, y), letter, stage in zip(corners, "abcdefghijklmnopqrstuvwxyz", stages):
        at = 1 - (y - 0.5 * head) / page.height
        size = unit / page.height
        page.text(letter, x / page.width, at, size, bold=True)
        page.text(_moment(stage), (x + 1.3 * unit) / page.width, at, size)
        page.frame((x, y, x + wide, y + tall))
    _foot(page, stages, view, tall, unit)
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f".{path.name}")
    Image.fromarray(np.asarray(page.image)).save(unfinished, format="PNG", optimize=True)
    unfinished.replace(path)
    return path


def _moment(stage: Stage) -> str:
    text = "" if stage.time is None else f"t = {seconds(stage.time, stage.duration)}"
    field = stage_layout.field_text(stage)
    return f"{text}    {field}" if field else text


def _foot(page: Page, stages: Sequence[Stage], view: View, tall: int, unit: int) -> None:
    """One scale bar and one legend for all panels."""
    stage, letter = stages[-1], unit / page.height
    step = unit / page.width
    y = 2.2 * letter
    label = max(
        0.5 * page.length(style.in_mm(stage.unit), letter),
        0.25 * stage.unit / view.half_height * tall / page.width,
    )
    middle, half = 0.6 * step + label, 0.25 * stage.unit / view.half_height * tall / page.width
    page.scale_bar(ScaleBar(stage.unit, middle - half, middle + half, y), size=letter)
    items = stage_layout.legend(stage)
    if stage.field is not None:
        items = [LegendItem("arrow", (style.FIELD,), "field", 0, 0), *items]
    widths = [page.length(item.text, 0.9 * letter) + 1.2 * step for item in items]
    start = middle + label + 2.5 * step
    gap = min((1.0 - start - sum(widths)) / max(len(items), 1), 2.5 * step)
    x = start
    for item, width in zip(items, widths):
        page.mark(LegendItem(item.mark, item.colours, item.text, x, y), size=letter)
        page.text(item.text, x + step, y, 0.9 * letter)
        x += width + gap
