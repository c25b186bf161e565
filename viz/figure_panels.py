"""Moments of a motion, or of several, side by side at one scale: a figure for a paper, or the frame of a movie."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from magmpm.errors import length as readable_length
from magmpm.viz import movies, style
from magmpm.viz.annotations import Page, Sign, field_arrow, field_text, signs, varies
from magmpm.viz.camera import Framing, View
from magmpm.viz.from_motion import MotionRenderer
from magmpm.viz.from_result import Still, trial_snapshot
from magmpm.viz.layout import Views, bare
from magmpm.viz.movies import chosen
from magmpm.viz.picture_file import save_image
from magmpm.viz.snapshot import Snapshot, seconds
from magmpm.viz.worker import Renderer


def moments(motion: MotionRenderer) -> list[int]:
    """Numbers of the first frame, of the last, and of the one between that is most unlike both.

    Unlike: by the root mean square of what particles have moved. What closes and opens again is shown closed; what goes one way, halfway.
    """
    looks = chosen(len(motion), 200)
    some = chosen(len(motion.body.reference), 2000)
    places = (motion.motion.position(int(k))[some].astype(float) for k in looks)
    first, last = (motion.motion.position(int(k))[some].astype(float) for k in looks[[0, -1]])
    distances = [min(float(np.mean((now - end) ** 2)) for end in (first, last)) for now in places]
    middle = int(looks[int(np.argmax(np.nan_to_num(distances, nan=-1.0, posinf=-1.0)))])
    if middle in (0, len(motion) - 1):  # nothing moves, or there are only two
        return [int(k) for k in chosen(len(motion), 3)]
    return [0, middle, len(motion) - 1]


def figure(
    motion: MotionRenderer,
    path: str | Path,
    renderer: Renderer,
    numbers: Sequence[int] | None = None,
    width: int = 1800,
) -> Path:
    """Moments of a motion side by side, or one below another where they are wide, as one picture.

    numbers: of frames, by default those of `moments`. width: pixels, about. All are seen from the same place at the same scale.
    Raises RenderError.
    """
    numbers = moments(motion) if numbers is None else list(numbers)
    across = (
        len(numbers) if motion.framing_of(numbers).aspect < 2.8 else 1
    )  # wider moments are stacked
    if across == 1:  # a page's width, as the others are three panels wide
        width = 2 * width // 3
    return save_image(
        composed([(motion, k) for k in numbers], renderer, across, width), path, optimize=True
    )


def draw_result(result: Any, path: Path, target: np.ndarray | None = None) -> str:
    """Draw a result into a file by a process for this picture alone; target: as of from_result.trial_snapshot.

    Returns why it could not be drawn as usual, or nothing. Raises RenderError.
    """
    with Renderer() as renderer:
        if target is None:
            still = Still(result)
            renderer.render(still.snapshot(), path, framing=still.framing)
        else:
            renderer.render(
                trial_snapshot(result, target=target, smooth=True), path, size=style.FINAL_SIZE
            )
        return renderer.note


def draw_motion(motion: Any, path: Path, numbers: Sequence[int] | None = None) -> str:
    """Draw a motion as `draw_result` does: moments side by side, or a movie where the file is an mp4 or GIF. Raises RenderError."""
    with Renderer() as renderer:
        if path.suffix in (".mp4", ".gif"):
            made = movies.movie(MotionRenderer(motion), path, renderer)
            return " ".join(filter(None, (made.note, renderer.note)))
        figure(MotionRenderer(motion), path, renderer, numbers)
        return renderer.note


def composed(
    shown: Sequence[tuple[MotionRenderer, int]],
    renderer: Renderer,
    across: int,
    width: int,
    words: Sequence[str] | None = None,
    framing: Framing | None = None,
) -> np.ndarray:
    """Frames of motions in rows of so many, all seen from one place at one scale, with one scale bar and one legend: (h, w, 3) uint8.

    width: pixels, about; h and w are even. words: above each panel, by default its time and field. framing: what must be in view, by
    default all that is in these frames. Raises RenderError.
    """
    moving = framing is not None
    framing = framing or Framing.of_all([motion.framing_of([k]) for motion, k in shown])
    gap = round(0.008 * width)
    wide = (width - (across + 1) * gap) // across
    tall = round(wide / float(np.clip(framing.aspect, 0.6, 4.0)))
    snapshots = [motion.snapshot(int(k)) for motion, k in shown]
    layout = bare((wide, tall))
    letter = round((0.0165 if across > 1 else 0.022) * width)  # pixels
    rows = -(-len(snapshots) // across)
    head = round(1.9 * letter)
    foot = 4 * letter
    size = rows * (tall + head + gap) + foot, across * (wide + gap) + gap
    canvas = np.full((size[0] + size[0] % 2, size[1] + size[1] % 2, 3), 255, dtype=np.uint8)
    corners = [
        (gap + i % across * (wide + gap), i // across * (tall + head + gap) + head)
        for i in range(len(snapshots))
    ]
    for snapshot, (x, y) in zip(snapshots, corners):
        canvas[y : y + tall, x : x + wide] = renderer.image(
            snapshot, framing=framing, layout=layout
        )
    page = Page(canvas)
    above = [_moment(snapshot) for snapshot in snapshots] if words is None else words
    for (x, y), name, text in zip(corners, "abcdefghijklmnopqrstuvwxyz", above):
        at = 1 - (y - 0.5 * head) / page.height
        page.text(name, x / page.width, at, letter / page.height, bold=True)
        page.text(text, (x + 1.3 * letter) / page.width, at, letter / page.height)
        page.frame((x, y, x + wide, y + tall))
    # In a movie, whose framing is given, the legend does not change as the field comes and goes.
    field = any(field_arrow(s) is not None or (moving and varies(s)) for s in snapshots)
    _foot(
        page,
        snapshots,
        Views.of(framing, layout, wide / tall).mains[0],
        (wide, tall),
        letter,
        field=field,
    )
    return np.asarray(page.image)


def _moment(snapshot: Snapshot) -> str:
    text = "" if snapshot.time is None else f"t = {seconds(snapshot.time, snapshot.duration)}"
    field = field_text(snapshot)
    return f"{text}    {field}" if field else text


def _foot(
    page: Page,
    snapshots: Sequence[Snapshot],
    view: View,
    panel: tuple[int, int],
    pixels: int,
    *,
    field: bool,
) -> None:
    """One scale bar and one legend for all panels; panel: its width and height, pixels: a letter's height, field: whether it is shown."""
    snapshot = snapshots[-1]
    letter = pixels / page.height
    step = pixels / page.width
    y = 2.2 * letter
    meter = 0.5 / view.half_height * panel[1] / page.width
    # Of what is small beside what stands around it the bar is a few of the floor's squares long.
    unit = next(
        (n * snapshot.unit for n in (1, 2, 5) if n * snapshot.unit * meter > 1.5 * step),
        10 * snapshot.unit,
    )
    label = max(0.5 * page.length(readable_length(unit), letter), 0.5 * unit * meter)
    middle = 0.6 * step + label
    page.scale_bar(middle, y, unit * meter, unit, size=letter)
    found = signs(snapshots, [(view, panel[0] / panel[1])])
    if field:
        found = [Sign("arrow", (style.FIELD,), "field"), *found]
    start = middle + label + 2.5 * step
    lines = _in_lines(
        found, [page.length(sign.text, 0.9 * letter) + 1.2 * step for sign in found], start, step
    )
    for row, (line, gap) in enumerate(lines):
        x = start
        height = y + (0.8 * letter if len(lines) > 1 else 0.0) - 1.6 * letter * row
        for sign, width in line:
            page.sign(sign, x, height, step, size=letter, text=0.9 * letter)
            x += width + gap


def _in_lines(
    found: Sequence[Sign], widths: Sequence[float], start: float, step: float
) -> list[tuple[list[tuple[Sign, float]], float]]:
    """A legend in one line, or in two where it is too long for one: its entries with their widths, and the gap between them."""
    pairs = list(zip(found, widths))
    lines = [pairs]
    if start + sum(widths) + 0.8 * step * len(pairs) > 1.0:
        half = -(-len(pairs) // 2)
        lines = [pairs[:half], pairs[half:]]
    free = min((1.0 - start - sum(w for _, w in line)) / max(len(line), 1) for line in lines)
    return [(line, min(free, 2.5 * step)) for line in lines]
