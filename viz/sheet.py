"""Moments of a motion, or of several, side by side at one scale: a picture for a paper, or the frame of a movie."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from magmpm.results.whole_file import whole_file
from viz import stage_layout, style
from viz.camera import View
from viz.layout import LegendItem, ScaleBar
from viz.page import Page
from viz.play import Play
from viz.stage import Shot, Stage, seconds
from viz.worker import Renderer

# Moments wider than this many times their height stand below one another; panels are no narrower than this.
_STACKED, _TALLEST = 2.8, 0.6
_LOOKS, _PARTICLES = 200, 2000  # frames and particles looked at for the moment that tells most


def chosen(frames: int, most: int) -> np.ndarray:
    """Numbers of at most `most` of so many frames, evenly spread, first and last among them."""
    return np.unique(np.linspace(0, frames - 1, min(frames, most)).round().astype(int))


def moments(play: Play) -> list[int]:
    """Numbers of the first frame, of the last, and of that between which is most unlike both.

    Unlike: by the root mean square of what particles have moved. What closes and opens again is shown closed; what goes one way, halfway.
    """
    looks = chosen(len(play), _LOOKS)
    some = chosen(len(play.body.reference), _PARTICLES)
    first, last = (play.motion.position(int(k))[some].astype(float) for k in looks[[0, -1]])
    apart = []
    for k in looks:
        now = play.motion.position(int(k))[some].astype(float)
        apart.append(min(float(np.mean((now - end) ** 2)) for end in (first, last)))
    middle = int(looks[int(np.argmax(np.nan_to_num(apart, nan=-1.0, posinf=-1.0)))])
    if middle in (0, len(play) - 1):  # nothing moves, or there are only two
        return [int(k) for k in chosen(len(play), 3)]
    return [0, middle, len(play) - 1]


def sheet(
    play: Play, path: str | Path, renderer: Renderer, numbers: Sequence[int] | None = None, width: int = 1800
) -> Path:
    """Moments of a motion side by side, or one below another where they are wide, as one PNG.

    numbers: of frames, by default those of `moments`. width: pixels, about. All are seen from the same place at the same scale.
    Raises RenderError.
    """
    numbers = moments(play) if numbers is None else list(numbers)
    across = len(numbers) if play.shot_of(numbers).aspect < _STACKED else 1
    if across == 1:  # a page's width, as the others are three panels wide
        width = 2 * width // 3
    return save(composed([(play, k) for k in numbers], renderer, across, width), path)


def save(image: np.ndarray, path: str | Path) -> Path:
    """Write a picture (h, w, 3) uint8 as PNG; its folder is made."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as unfinished:
        Image.fromarray(image).save(unfinished, format="PNG", optimize=True)
    return path


def composed(
    shown: Sequence[tuple[Play, int]],
    renderer: Renderer,
    across: int,
    width: int,
    words: Sequence[str] | None = None,
    shot: Shot | None = None,
) -> np.ndarray:
    """Frames of motions in rows of so many, all seen from one place at one scale, with one scale bar and one legend: (h, w, 3) uint8.

    width: pixels, about; h and w are even. words: above each panel, by default its time and field. shot: what must be seen and from where,
    by default all that is in these frames. Raises RenderError.
    """
    moving = shot is not None
    shot = shot or Shot.of_all([play.shot_of([k]) for play, k in shown])
    gap = round(0.008 * width)
    wide = (width - (across + 1) * gap) // across
    tall = round(wide / float(np.clip(shot.aspect, _TALLEST, 4.0)))
    stages = [play.stage(int(k)) for play, k in shown]
    layout = stage_layout.bare((wide, tall))
    (view,) = stage_layout.views(shot, (wide, tall), layout)
    unit = round((0.0165 if across > 1 else 0.022) * width)  # pixels, a letter's height
    rows = -(-len(stages) // across)
    head, foot = round(1.9 * unit), 4 * unit
    size = rows * (tall + head + gap) + foot, across * (wide + gap) + gap
    canvas = np.full((size[0] + size[0] % 2, size[1] + size[1] % 2, 3), 255, dtype=np.uint8)
    corners = []
    for i, stage in enumerate(stages):
        x, y = gap + i % across * (wide + gap), i // across * (tall + head + gap) + head
        canvas[y : y + tall, x : x + wide] = renderer.stage_image(
            stage, shot, size=(wide, tall), layout=layout
        )
        corners.append((x, y))
    page = Page(canvas)
    above = [_moment(stage) for stage in stages] if words is None else words
    for (x, y), letter, text in zip(corners, "abcdefghijklmnopqrstuvwxyz", above):
        at = 1 - (y - 0.5 * head) / page.height
        page.text(letter, x / page.width, at, unit / page.height, bold=True)
        page.text(text, (x + 1.3 * unit) / page.width, at, unit / page.height)
        page.frame((x, y, x + wide, y + tall))
    # In a movie, whose shot is given, the legend does not change as the field comes and goes.
    field = any(
        stage_layout.field_arrow(s) is not None or (moving and stage_layout.varies(s)) for s in stages
    )
    _foot(page, stages, view, (wide, tall), unit, field=field)
    return np.asarray(page.image)


def _moment(stage: Stage) -> str:
    text = "" if stage.time is None else f"t = {seconds(stage.time, stage.duration)}"
    field = stage_layout.field_text(stage)
    return f"{text}    {field}" if field else text


def _foot(
    page: Page, stages: Sequence[Stage], view: View, panel: tuple[int, int], pixels: int, *, field: bool
) -> None:
    """One scale bar and one legend for all panels; panel: its width and height, pixels: a letter's height, field: whether it is shown."""
    stage, letter, step = stages[-1], pixels / page.height, pixels / page.width
    y = 2.2 * letter
    metre = 0.5 / view.half_height * panel[1] / page.width
    # Of what is small beside what stands around it the bar is a few of the floor's squares long.
    unit = next((n * stage.unit for n in (1, 2, 5) if n * stage.unit * metre > 1.5 * step), 10 * stage.unit)
    half = 0.5 * unit * metre
    label = max(0.5 * page.length(style.in_mm(unit), letter), half)
    middle = 0.6 * step + label
    page.scale_bar(ScaleBar(unit, middle - half, middle + half, y), size=letter)
    items = stage_layout.signs(stages, [(view, panel[0] / panel[1])])
    if field:
        items = [("arrow", (style.FIELD,), "field"), *items]
    start = middle + label + 2.5 * step
    lines = _in_lines(
        items, [page.length(text, 0.9 * letter) + 1.2 * step for _, _, text in items], start, step
    )
    for row, (line, gap) in enumerate(lines):
        x, height = start, y + (0.8 * letter if len(lines) > 1 else 0.0) - 1.6 * letter * row
        for (mark, colours, text), width in line:
            page.mark(LegendItem(mark, colours, text, x, height), size=letter)
            page.text(text, x + step, height, 0.9 * letter)
            x += width + gap


Sign = tuple[str, tuple[str, ...], str]


def _in_lines(
    items: Sequence[Sign], widths: Sequence[float], start: float, step: float
) -> list[tuple[list[tuple[Sign, float]], float]]:
    """A legend in one line, or in two where it is too long for one: its entries with their widths, and the gap between them."""
    pairs = list(zip(items, widths))
    if start + sum(widths) + 0.8 * step * len(pairs) > 1.0:
        half = -(-len(pairs) // 2)
        lines = [pairs[:half], pairs[half:]]
    else:
        lines = [pairs]
    free = min((1.0 - start - sum(w for _, w in line)) / max(len(line), 1) for line in lines)
    return [(line, min(free, 2.5 * step)) for line in lines]
