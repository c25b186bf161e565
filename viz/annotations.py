"""Annotations of a page: title, caption, compass, field, its curve, scale bar and legend.

Pillow draws it onto the finished image, with matplotlib's copy of DejaVu Sans, so that both renderers' pictures look alike;
matplotlib itself is not imported.
"""

from __future__ import annotations

import functools
import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from magmpm import errors as readable
from magmpm.viz import style
from magmpm.viz.camera import View, in_view
from magmpm.viz.layout import Layout, Panel, Views
from magmpm.viz.snapshot import Snapshot

# Circles and slanted lines are drawn this many times larger and averaged down; Pillow does not smooth them.
_OVERSAMPLING = 4


@dataclass(frozen=True)
class Sign:
    """A mark and what it means. mark: "dot", "arrow", "line" or "swatch" (colors side by side)."""

    mark: str
    colors: tuple[str, ...]
    text: str


def compass_arrows(snapshot: Snapshot) -> list[tuple[str, np.ndarray]]:
    """Label and vector (3,) from the compass's origin: the axes, and which way things fall."""
    axis_length = 0.62  # of half their panel's height
    arrows = [(name, axis_length * np.eye(3)[i]) for i, name in enumerate("xyz")]
    if snapshot.gravity is not None and np.linalg.norm(snapshot.gravity) > 0:
        down = axis_length * snapshot.gravity / np.linalg.norm(snapshot.gravity)
        along = [np.allclose(vector, down, atol=0.1 * axis_length) for _, vector in arrows]
        if any(along):
            k = along.index(True)
            arrows[k] = (f"{arrows[k][0]}, g", arrows[k][1])
        else:
            arrows.append(("g", down))
    return arrows


def field_arrow(snapshot: Snapshot) -> np.ndarray | None:
    """The field's arrow (3,), its length by the strength against the strongest of the motion; None if that is too short."""
    if snapshot.field is None:
        return None
    strength = strongest = float(np.linalg.norm(snapshot.field))
    if snapshot.history is not None:
        strongest = float(np.linalg.norm(snapshot.history.values, axis=1).max())
    return 1.7 * snapshot.field / strongest if strength > 0.08 * strongest > 0 else None


def field_text(snapshot: Snapshot) -> str:
    """The field's magnitude, "|B| = 10.0 mT", in tenths of mT where that says enough; nothing where there is no field at any time."""
    if snapshot.field is None:
        return ""
    strength = float(np.linalg.norm(snapshot.field))
    strongest = (
        0.0 if snapshot.history is None else np.abs(snapshot.history.values).max(initial=0.0)
    )
    if strength <= 1e-9 * strongest:  # rounding, as of sin(2 pi)
        return "|B| = 0" if strongest > 0.0 else ""
    return (
        f"|B| = {strength * 1e3:.1f} mT"
        if 1e-3 <= strength < 1.0
        else f"|B| = {readable.quantity(strength, 'T')}"
    )


def varies(snapshot: Snapshot) -> bool:
    """True if the field changes over the motion, so that a curve of it shows something."""
    if snapshot.history is None or len(snapshot.history.times) < 2:
        return False
    values = snapshot.history.values
    return bool(np.ptp(values, axis=0).max() > 1e-3 * np.abs(values).max())


def signs(
    snapshots: Sequence[Snapshot],
    seen: Sequence[tuple[View, float]] = (),
    *,
    touching: bool = False,
) -> list[Sign]:
    """Signs to explain in the legend: only what is drawn in one of these snapshots.

    seen: the views they are drawn in, with each panel's aspect: only obstacles that are in one of them count. touching: contact counts
    though none of the snapshots has any.
    """
    first = snapshots[0]
    held = np.zeros(len(first.magnetized), dtype=bool) if first.held is None else first.held
    used = min(int(first.magnetized.sum()), len(style.SEGMENTS))
    pushed = touching or any(len(s.pushes) for s in snapshots)
    known = [
        ((first.magnetized & ~held).any(), Sign("swatch", style.SEGMENTS[:used], "magnetic")),
        (
            not (first.magnetized | held).all(),
            Sign("swatch", (style.UNMAGNETIZED,), "unmagnetized"),
        ),
        (held.any(), Sign("swatch", (style.HELD,), "held")),
        (
            any(len(s.arrows) for s in snapshots),
            Sign("arrow", (style.MAGNETIZATION,), "magnetization"),
        ),
        (any(len(s.fields) for s in snapshots), Sign("arrow", (style.FIELD,), "field")),
        (any(len(s.axis) > 1 for s in snapshots), Sign("line", (style.INK,), "axis")),
        (len(first.trace) > 0, Sign("line", (style.TRACE,), "path so far")),
        (first.target is not None, Sign("dot", (style.TARGET,), first.target_name)),
        (first.ground is not None, Sign("swatch", (style.GROUND_SHADOW,), "ground")),
        (pushed, Sign("arrow", (style.CONTACT,), "contact force")),
        (
            not pushed and any(len(s.contact) for s in snapshots),
            Sign("dot", (style.CONTACT,), "contact"),
        ),
    ]
    entries = [sign for is_drawn, sign in known if is_drawn]
    obstacles = [
        o
        for s in snapshots
        for o in s.obstacles
        if not seen or any(in_view(o, *view) for view in seen)
    ]
    colors = {o.name: o.color for o in obstacles if o.name}
    # What may come into the picture comes last, and moves no other entry.
    for name in sorted(colors, key=lambda name: (name.endswith(style.POLES), name == "clamp")):
        poles = (style.NORTH, style.SOUTH)
        entries.append(
            Sign("swatch", poles if name.endswith(style.POLES) else (colors[name],), name)
        )
    return entries


def legend(snapshot: Snapshot, seen: Sequence[tuple[View, float]] = ()) -> list[Sign]:
    """The legend of a page. It stays the same while things move: contact is in it if there is any at some time."""
    most_rows = 4  # of two signs
    return signs([snapshot], seen, touching=snapshot.touches)[: 2 * most_rows]


def bar_width(view: View, panel: Panel, aspect: float, unit: float) -> float:
    """Width of a scale bar of that length (m), a fraction of the page's; aspect: the panel's."""
    # The view's half height is half the panel's height; widths are fractions of the page's width.
    return unit / view.half_height / aspect * 0.5 * (panel.right - panel.left)


def written(image: np.ndarray, snapshot: Snapshot, views: Views, layout: Layout) -> np.ndarray:
    """The image (h, w, 3) uint8 with all text and lines of the page; a new array."""
    page = Page(image)
    alarming = bool(snapshot.mark or snapshot.event)
    letters = 28 if alarming else 46  # that fit next to a mark, or the caption, on a page of 4:3
    most = round(letters * page.aspect / (4 / 3))
    title = snapshot.title if len(snapshot.title) <= most else snapshot.title[: most - 1] + "…"
    page.text(title, 0.02, layout.title_y, style.TEXT_LARGE)
    color = style.ALARM if alarming else style.INK
    page.text(
        snapshot.caption(),
        0.985,
        layout.title_y,
        style.TEXT_LARGE,
        anchor="rm",
        bold=True,
        color=color,
    )
    for inset in layout.insets:
        panel = inset.panel
        page.frame((*page.pixel(panel.left, panel.top), *page.pixel(panel.right, panel.bottom)))
        page.text(
            inset.name,
            panel.left + 0.008,
            panel.top - 0.024,
            style.TEXT_SMALL,
            color=style.FAINT_INK,
        )
    for panel, view in zip(layout.compasses, views.mains):
        page.compass(snapshot, view, panel)
    for text, at in snapshot.notes:
        ((x, y),) = layout.mains[0].place(
            views.mains[0].project(at[None]), layout.mains[0].aspect(page.aspect)
        )
        half = 0.5 * page.length(text, style.TEXT_SMALL) + 0.005  # no text leaves the page
        page.text(
            text,
            float(np.clip(x, half, 1.0 - half)),
            float(y),
            style.TEXT_SMALL,
            anchor="mm",
            color=style.FIELD,
        )
    page.text(field_text(snapshot), *layout.field_text, style.TEXT_MEDIUM, color=style.FIELD)
    aspects = [panel.aspect(page.aspect) for panel in layout.mains]
    page.scale_bar(
        *layout.bar,
        bar_width(views.mains[0], layout.mains[0], aspects[0], snapshot.unit),
        snapshot.unit,
    )
    place = layout.legend
    if place is not None:
        found = legend(snapshot, list(zip(views.mains, aspects)))
        legend_rows = 3  # more are set closer
        rows = max(legend_rows, -(-len(found) // 2))
        step, top = (
            (place.row, place.top) if rows == legend_rows else (0.75 * place.row, place.top + 0.01)
        )
        for i, sign in enumerate(found):
            text = (
                sign.text.removesuffix(f" {style.POLES}").split()[-1] if place.short else sign.text
            )  # a swatch shows the poles
            page.sign(
                Sign(sign.mark, sign.colors, text),
                place.left + (i // rows) * place.column,
                top - (i % rows) * step,
                place.gap,
            )
    if layout.curve is not None and varies(snapshot):
        page.curve(snapshot, layout.curve)
    return np.asarray(page.image)


class Page:
    """An image that is written on. Places are fractions of the page from its lower left, sizes fractions of its height."""

    def __init__(self, image: np.ndarray) -> None:
        self.image = Image.fromarray(image)
        self.draw = ImageDraw.Draw(self.image)
        self.width, self.height = self.image.size
        self.aspect = self.width / self.height

    def compass(self, snapshot: Snapshot, view: View, panel: Panel) -> None:
        """The labels of a compass's arrows: each a little beyond its arrow's point, as seen."""
        for words, vector in compass_arrows(snapshot):
            flat = view.compass().project(vector[None])[0, :2]
            seen = float(np.linalg.norm(flat))
            # An arrow pointing at the viewer has no direction on the page: its label goes below it.
            away = flat / seen if seen > 0.1 else np.array([0.0, -1.0])
            ((x, y),) = panel.place((flat + 0.17 * away)[None], panel.aspect(self.aspect))
            self.text(
                words, float(x), float(y), style.TEXT_SMALL, anchor="mm", color=style.FAINT_INK
            )

    def frame(self, corners: tuple[float, float, float, float]) -> None:
        """A thin frame: left, top, right, bottom in pixels."""
        self.draw.rectangle(corners, outline=style.FRAME, width=max(round(0.0016 * self.height), 1))

    def scale_bar(
        self, x: float, y: float, width: float, unit: float, size: float = style.TEXT_MEDIUM
    ) -> None:
        """A scale bar about (x, y) that stands for a length (m); size: the text's height, and the bar's ends go with it."""
        grow = size / style.TEXT_MEDIUM
        thick = max(round(0.0025 * grow * self.height), 1)
        ends = x - width / 2, x + width / 2
        for mark in np.linspace(*ends, 6):
            tall = grow * (0.009 if mark in ends else 0.0045)
            self.draw.line(
                (*self.pixel(mark, y + tall), *self.pixel(mark, y - tall)),
                fill=style.INK,
                width=thick,
            )
        self.draw.line(
            (*self.pixel(ends[0], y), *self.pixel(ends[1], y)), fill=style.INK, width=thick
        )
        self.text(readable.length(unit), x, y - 0.036 * grow, size, anchor="mm")

    def sign(
        self,
        sign: Sign,
        x: float,
        y: float,
        gap: float,
        size: float = style.TEXT_SMALL,
        text: float | None = None,
    ) -> None:
        """A legend's mark centered at (x, y), and its text a gap to the right. size: the mark's height; text: the text's, if different."""
        edge = round(0.026 / style.TEXT_SMALL * size * self.height)
        big = edge * _OVERSAMPLING
        patch = Image.new("RGB", (big, big), "white")
        draw = ImageDraw.Draw(patch)
        color = sign.colors[0]
        if sign.mark == "dot":
            draw.ellipse((0.15 * big, 0.15 * big, 0.85 * big, 0.85 * big), fill=color)
        elif sign.mark == "arrow":
            draw.line((0.0, 0.5 * big, 0.6 * big, 0.5 * big), fill=color, width=round(0.16 * big))
            draw.polygon(
                ((0.5 * big, 0.22 * big), (0.5 * big, 0.78 * big), (big, 0.5 * big)), fill=color
            )
        elif sign.mark == "line":
            draw.line((0.0, 0.5 * big, big, 0.5 * big), fill=color, width=round(0.08 * big))
        else:
            wide = big / len(sign.colors)
            for k, each in enumerate(sign.colors):
                draw.rectangle((k * wide, 0.1 * big, (k + 1) * wide, 0.9 * big), fill=each)
        left, top = self.pixel(x, y)
        self.image.paste(
            patch.resize((edge, edge), Image.Resampling.BOX),
            (round(left - edge / 2), round(top - edge / 2)),
        )
        self.text(sign.text, x + gap, y, size if text is None else text)

    def curve(self, snapshot: Snapshot, panel: Panel) -> None:
        """The field's components over the motion, with a mark at now."""
        assert snapshot.history is not None
        times = snapshot.history.times
        values = snapshot.history.values
        width = round((panel.right - panel.left) * self.width)
        height = round((panel.top - panel.bottom) * self.height)
        big = _OVERSAMPLING * np.array([width, height])
        patch = Image.new("RGB", (int(big[0]), int(big[1])), "white")
        draw = ImageDraw.Draw(patch)
        line = max(round(0.0022 * _OVERSAMPLING * self.height), 1)
        x = (times - times[0]) / max(float(np.ptp(times)), 1e-300) * big[0]
        y = big[1] * (0.5 - 0.45 * values / float(np.abs(values).max()))
        now = float(np.interp(times[0] if snapshot.time is None else snapshot.time, times, x))
        draw.line((0.0, 0.5 * big[1], big[0], 0.5 * big[1]), fill=style.GRID, width=line)
        for jump in np.interp(snapshot.history.jumps, times, x):
            draw.line((float(jump), 0.0, float(jump), big[1]), fill=style.ALARM, width=2 * line)
        draw.line((now, 0.0, now, big[1]), fill=style.FAINT_INK, width=line)
        for i, color in enumerate(style.COMPONENTS):
            draw.line(
                np.stack([x, y[:, i]], axis=1).ravel().tolist(),
                fill=color,
                width=round(1.6 * line),
                joint="curve",
            )
            at = float(np.interp(now, x, y[:, i]))
            radius = 0.008 * _OVERSAMPLING * self.height
            draw.ellipse((now - radius, at - radius, now + radius, at + radius), fill=color)
        left, top = self.pixel(panel.left, panel.top)
        self.image.paste(
            patch.resize((width, height), Image.Resampling.BOX), (round(left), round(top))
        )
        for i, (name, color) in enumerate(zip(("Bx", "By", "Bz"), style.COMPONENTS)):
            self.text(
                name,
                panel.left - 0.006,
                panel.top - 0.012 - 0.038 * i,
                style.TEXT_SMALL,
                anchor="rm",
                color=color,
            )
        for words, at, anchor in (
            ("0", panel.left, "mm"),
            (f"{times[-1]:.3g} s", panel.right, "rm"),
        ):
            self.text(
                words,
                at,
                panel.bottom - 0.024,
                0.85 * style.TEXT_SMALL,
                anchor=anchor,
                color=style.FAINT_INK,
            )

    def text(
        self,
        words: str,
        x: float,
        y: float,
        size: float,
        *,
        anchor: str = "lm",
        color: str = style.INK,
        bold: bool = False,
    ) -> None:
        """Words at (x, y); anchor: as Pillow names it."""
        if words:
            self.draw.text(
                self.pixel(x, y),
                words,
                fill=color,
                font=_font(round(size * self.height), bold),
                anchor=anchor,
            )

    def length(self, words: str, size: float) -> float:
        """Length of a text, a fraction of the page's width."""
        return (
            float(self.draw.textlength(words, font=_font(round(size * self.height), False)))
            / self.width
        )

    def pixel(self, x: float, y: float) -> tuple[float, float]:
        """Position of a place of the page, pixels from the upper left."""
        return x * self.width, (1.0 - y) * self.height


@functools.lru_cache(maxsize=16)
def _font(size: int, bold: bool) -> ImageFont.FreeTypeFont:
    readable.require("matplotlib", "render", key="pictures", use="texts of pictures")
    spec = importlib.util.find_spec("matplotlib")
    assert spec is not None
    fonts = Path(str(spec.origin)).parent / "mpl-data" / "fonts" / "ttf"
    return ImageFont.truetype(
        str(fonts / ("DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf")), size
    )
