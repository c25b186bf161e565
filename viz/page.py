"""What is written around the panels: title, caption, frames, labels, scale bar and legend.

Drawn by Pillow onto the finished image, with matplotlib's copy of DejaVu Sans so that both backends look
alike; matplotlib itself is not imported.
"""

from __future__ import annotations

import functools
import importlib.util
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from viz import layout, style
from viz.picture import Picture

# Circles and slanted lines are drawn this many times larger and averaged down; Pillow does not smooth them.
_OVERSAMPLING = 4


def written_on(image: np.ndarray, picture: Picture, views: layout.Views) -> np.ndarray:
    """The image (h, w, 3) uint8 with all text and lines of the page; a new array."""
    page = Page(image)
    page.captions(picture)
    page.panels()
    page.compass(picture, views)
    page.scale_bar(
        layout.scale_bar(views.main, layout.MAIN, layout.MAIN.aspect(page.aspect), layout.unit(picture))
    )
    page.legend(picture)
    return np.asarray(page.image)


class Page:
    """An image that is written on. Places are fractions of the page from its lower left, sizes fractions of its height."""

    def __init__(self, image: np.ndarray) -> None:
        self.image = Image.fromarray(image)
        self.draw = ImageDraw.Draw(self.image)
        self.width, self.height = self.image.size
        self.aspect = self.width / self.height

    def captions(self, picture: Picture) -> None:
        self.text(layout.title_text(picture), 0.02, layout.TITLE_Y, style.TEXT_LARGE)
        self.text(picture.caption(), 0.985, layout.TITLE_Y, style.TEXT_LARGE, anchor="rm", bold=True, colour=style.caption(picture.mark))

    def panels(self) -> None:
        for panel, name in ((layout.TOP, layout.TOP_NAME), (layout.SIDE, layout.SIDE_NAME)):
            corners = (*self.pixel(panel.left, panel.top), *self.pixel(panel.right, panel.bottom))
            self.draw.rectangle(corners, outline=style.FRAME, width=max(round(0.0016 * self.height), 1))
            self.text(name, panel.left + 0.008, panel.top - 0.024, style.TEXT_SMALL, colour=style.FAINT_INK)

    def compass(self, picture: Picture, views: layout.Views) -> None:
        for label in layout.compass_labels(picture, views.main, self.aspect):
            self.text(label.text, label.x, label.y, style.TEXT_SMALL, anchor="mm", colour=style.FAINT_INK)
        self.text(
            layout.field_text(picture),
            layout.FIELD_TEXT_X,
            layout.FIELD_TEXT_Y,
            style.TEXT_MEDIUM,
            colour=style.FIELD,
        )

    def frame(self, corners: tuple[float, float, float, float]) -> None:
        """A thin frame: left, top, right, bottom in pixels."""
        self.draw.rectangle(corners, outline=style.FRAME, width=max(round(0.0016 * self.height), 1))

    def scale_bar(self, bar: layout.ScaleBar, size: float = style.TEXT_MEDIUM) -> None:
        """size: the text's height; the bar's ends go with it."""
        grow = size / style.TEXT_MEDIUM
        thick = max(round(0.0025 * grow * self.height), 1)
        for x in np.linspace(bar.left, bar.right, 6):
            tall = grow * (0.009 if x in (bar.left, bar.right) else 0.0045)
            self.draw.line(
                (*self.pixel(x, bar.y + tall), *self.pixel(x, bar.y - tall)), fill=style.INK, width=thick
            )
        self.draw.line(
            (*self.pixel(bar.left, bar.y), *self.pixel(bar.right, bar.y)), fill=style.INK, width=thick
        )
        self.text(style.in_mm(bar.unit), (bar.left + bar.right) / 2, bar.y - 0.036 * grow, size, anchor="mm")

    def legend(self, picture: Picture) -> None:
        for item in layout.legend(picture):
            self.mark(item)
            self.text(item.text, item.x + layout.LEGEND_GAP, item.y, style.TEXT_SMALL)

    def mark(self, item: layout.LegendItem, size: float = style.TEXT_SMALL) -> None:
        """The sign before a legend's text of that height."""
        edge = round(0.026 / style.TEXT_SMALL * size * self.height)
        big = edge * _OVERSAMPLING
        patch = Image.new("RGB", (big, big), "white")
        draw = ImageDraw.Draw(patch)
        if item.mark == "dot":
            draw.ellipse((0.15 * big, 0.15 * big, 0.85 * big, 0.85 * big), fill=item.colours[0])
        elif item.mark == "arrow":
            draw.line((0.0, 0.5 * big, 0.6 * big, 0.5 * big), fill=item.colours[0], width=round(0.16 * big))
            draw.polygon(
                ((0.5 * big, 0.22 * big), (0.5 * big, 0.78 * big), (big, 0.5 * big)), fill=item.colours[0]
            )
        elif item.mark == "line":
            draw.line((0.0, 0.5 * big, big, 0.5 * big), fill=item.colours[0], width=round(0.08 * big))
        else:
            for k, colour in enumerate(item.colours):
                draw.rectangle(
                    (k / len(item.colours) * big, 0.1 * big, (k + 1) / len(item.colours) * big, 0.9 * big),
                    fill=colour,
                )
        x, y = self.pixel(item.x, item.y)
        self.image.paste(
            patch.resize((edge, edge), Image.Resampling.BOX), (round(x - edge / 2), round(y - edge / 2))
        )

    def text(
        self,
        words: str,
        x: float,
        y: float,
        size: float,
        *,
        anchor: str = "lm",
        colour: str = style.INK,
        bold: bool = False,
    ) -> None:
        if words:
            self.draw.text(
                self.pixel(x, y),
                words,
                fill=colour,
                font=_font(round(size * self.height), bold),
                anchor=anchor,
            )

    def length(self, words: str, size: float) -> float:
        """Length of a text, a fraction of the page's width."""
        return float(self.draw.textlength(words, font=_font(round(size * self.height), False))) / self.width

    def pixel(self, x: float, y: float) -> tuple[float, float]:
        return x * self.width, (1.0 - y) * self.height


@functools.lru_cache(maxsize=16)
def _font(size: int, bold: bool) -> ImageFont.FreeTypeFont:
    spec = importlib.util.find_spec("matplotlib")
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError("the pictures' fonts are matplotlib's: pip install matplotlib")
    fonts = Path(spec.origin).parent / "mpl-data" / "fonts" / "ttf"
    return ImageFont.truetype(str(fonts / ("DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf")), size)
