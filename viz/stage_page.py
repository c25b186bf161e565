"""What is written on the page of a motion: title, time, compass, field and its curve, scale bar and legend. Drawn by Pillow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from viz import stage_layout, style
from viz.camera import View
from viz.page import Page
from viz.stage import Stage
from viz.stage_layout import CURVE, Layout


def written_on(image: np.ndarray, stage: Stage, views: Sequence[View], layout: Layout) -> np.ndarray:
    """The image (h, w, 3) uint8 with all text and lines of the page; a new array."""
    page = Page(image)
    page.text(stage.title[: 40 if stage.mark else 60], 0.015, stage_layout.TITLE_Y, style.TEXT_LARGE)
    page.text(stage.caption(), 0.985, stage_layout.TITLE_Y, style.TEXT_LARGE, anchor="rm", bold=True, colour=style.caption(stage.mark))
    for place, view in zip(layout.compasses, views):
        for label in stage_layout.compass_labels(stage, view, place, page.aspect):
            page.text(label.text, label.x, label.y, style.TEXT_SMALL, anchor="mm", colour=style.FAINT_INK)
    page.text(
        stage_layout.field_text(stage),
        stage_layout.FIELD_TEXT_X,
        stage_layout.FIELD_TEXT_Y,
        style.TEXT_MEDIUM,
        colour=style.FIELD,
    )
    page.scale_bar(stage_layout.scale_bar(views[0], page.aspect, stage.unit))
    seen = [(view, place.aspect(page.aspect)) for place, view in zip(layout.mains, views)]
    for item in stage_layout.legend(stage, seen):
        page.mark(item)
        page.text(item.text, item.x + stage_layout.LEGEND_GAP, item.y, style.TEXT_SMALL)
    if stage_layout.varies(stage):
        _curve(page, stage)
    return np.asarray(page.image)


def _curve(page: Page, stage: Stage) -> None:
    """The field's components over the motion, with a mark at now."""
    x, y, now = stage_layout.curves(stage)
    fine = 4
    width = round((CURVE.right - CURVE.left) * page.width)
    height = round((CURVE.top - CURVE.bottom) * page.height)
    patch = Image.new("RGB", (fine * width, fine * height), "white")
    draw = ImageDraw.Draw(patch)

    def at(px: float, py: float) -> tuple[float, float]:
        return (
            (px - CURVE.left) / (CURVE.right - CURVE.left) * fine * width,
            (CURVE.top - py) / (CURVE.top - CURVE.bottom) * fine * height,
        )

    middle = 0.5 * (CURVE.bottom + CURVE.top)
    line = max(round(0.0022 * fine * page.height), 1)
    draw.line((*at(CURVE.left, middle), *at(CURVE.right, middle)), fill=style.GRID, width=line)
    draw.line((*at(now, CURVE.bottom), *at(now, CURVE.top)), fill=style.FAINT_INK, width=line)
    for i, colour in enumerate(style.COMPONENTS):
        path = [at(float(a), float(b)) for a, b in zip(x, y[:, i])]
        draw.line([c for point in path for c in point], fill=colour, width=round(1.6 * line), joint="curve")
        a, b = at(now, float(np.interp(now, x, y[:, i])))
        r = 0.008 * fine * page.height
        draw.ellipse((a - r, b - r, a + r, b + r), fill=colour)
    left, top = page.pixel(CURVE.left, CURVE.top)
    page.image.paste(patch.resize((width, height), Image.Resampling.BOX), (round(left), round(top)))
    for i, (name, colour) in enumerate(zip(("Bx", "By", "Bz"), style.COMPONENTS)):
        page.text(
            name,
            CURVE.left - 0.006,
            CURVE.top - 0.012 - 0.038 * i,
            style.TEXT_SMALL,
            anchor="rm",
            colour=colour,
        )
    page.text(
        "0", CURVE.left, CURVE.bottom - 0.024, 0.85 * style.TEXT_SMALL, anchor="mm", colour=style.FAINT_INK
    )
    assert stage.history is not None
    end = f"{stage.history.times[-1]:.3g} s"
    page.text(
        end, CURVE.right, CURVE.bottom - 0.024, 0.85 * style.TEXT_SMALL, anchor="rm", colour=style.FAINT_INK
    )
