"""Where things stand on the page: one layout for both backends, in fractions of the page from its lower left.

    +--------------------------------------------+
    | title                             caption  |
    |                              +-----------+ |
    |   main view                  | top       | |
    |                              +-----------+ |
    |                              | side      | |
    |                              +-----------+ |
    | compass  |B|    scale bar       legend     |
    +--------------------------------------------+

Nothing in one panel can reach another, so text never lies on the body whatever its shape.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magmpm.results.readable import quantity
from viz import style
from viz.camera import Frame, View
from viz.picture import Picture
from viz.scenery import POLES


@dataclass(frozen=True)
class Panel:
    """A rectangle of the page: left, bottom, right, top in fractions of its width and height."""

    left: float
    bottom: float
    right: float
    top: float

    def aspect(self, page_aspect: float) -> float:
        """Width over height, for a page of that aspect."""
        return page_aspect * (self.right - self.left) / (self.top - self.bottom)

    def place(self, flat: np.ndarray, aspect: float) -> np.ndarray:
        """Half heights from the panel's centre (n, 2) -> fractions of the page (n, 2)."""
        half = 0.5 * np.array([self.right - self.left, self.top - self.bottom])
        center = np.array([self.left, self.bottom]) + half
        return center + np.asarray(flat)[:, :2] * half / np.array([aspect, 1.0])


TITLE_Y = 0.955
MAIN = Panel(0.0, 0.165, 0.685, 0.925)
TOP = Panel(0.70, 0.55, 0.985, 0.905)
SIDE = Panel(0.70, 0.175, 0.985, 0.53)
COMPASS = Panel(0.005, 0.005, 0.125, 0.16)
FIELD = Panel(0.135, 0.03, 0.225, 0.15)
FIELD_TEXT_X, FIELD_TEXT_Y = 0.235, 0.085
BAR_CENTER, BAR_Y = 0.535, 0.100
LEGEND_X, LEGEND_TOP, LEGEND_ROW, LEGEND_COLUMN, LEGEND_GAP = 0.715, 0.128, 0.044, 0.168, 0.018
TOP_NAME, SIDE_NAME = "top: x right, y up", "side: x right, z up"

# In units of half their panel's height.
AXIS_LENGTH, LABEL_GAP, FIELD_LENGTH = 0.62, 0.17, 1.7


@dataclass(frozen=True)
class ScaleBar:
    """unit: m, its length; left, right, y: fractions of the page;"""

    unit: float
    left: float
    right: float
    y: float


def unit(picture: Picture) -> float:
    """Length (m) of the scale bar and of the floor's squares: a round number, about a quarter of the body."""
    return style.nice_length(0.3 * picture.length)


def floor_lines(frame: Frame, spacing: float) -> np.ndarray:
    """Grid lines on the floor at multiples of the spacing (m), (n, 2, 3) m."""
    low, high = frame.floor
    z = low[2]
    xs = np.arange(np.ceil(low[0] / spacing), np.floor(high[0] / spacing) + 1) * spacing
    ys = np.arange(np.ceil(low[1] / spacing), np.floor(high[1] / spacing) + 1) * spacing
    lines = [[(x, low[1], z), (x, high[1], z)] for x in xs] + [[(low[0], y, z), (high[0], y, z)] for y in ys]
    return np.array(lines, dtype=float).reshape(-1, 2, 3)


def shadows(picture: Picture, frame: Frame) -> tuple[np.ndarray, np.ndarray | None]:
    """Particles, or the surface's points, and target dots dropped onto the floor, (n, 3) and (q, 3) m."""
    dropped: list[np.ndarray] = []
    for points in (picture.particles if picture.surface is None else picture.surface.points, picture.target):
        if points is not None:
            flat = np.array(points, dtype=float)
            flat[:, 2] = frame.floor[0][2]
            dropped.append(flat)
    return dropped[0], style.thinned(dropped[1], style.TARGET_DOTS) if len(dropped) == 2 else None


def scale_bar(view: View, panel: Panel, aspect: float, unit: float) -> ScaleBar:
    """The bar of that length (m) for a panel."""
    # The view's half height is half the panel's height; widths are fractions of the page's width.
    width = unit / view.half_height / aspect * 0.5 * (panel.right - panel.left)
    return ScaleBar(unit, BAR_CENTER - width / 2, BAR_CENTER + width / 2, BAR_Y)


@dataclass(frozen=True)
class CompassLabel:
    """Text beside an arrow of the compass, at (x, y) fractions of the page."""

    text: str
    x: float
    y: float


def compass_view(main: View) -> View:
    """The main view's directions around the origin, one unit to half the panel's height."""
    return View(main.right, main.up, main.toward, np.zeros(3), 1.0)


def compass_arrows(picture: Picture) -> list[tuple[str, np.ndarray]]:
    """Label and vector (3,) from the compass's origin: the axes, and which way things fall."""
    arrows = [(name, AXIS_LENGTH * np.eye(3)[i]) for i, name in enumerate("xyz")]
    if picture.gravity is not None and np.linalg.norm(picture.gravity) > 0:
        arrows.append(("g", AXIS_LENGTH * picture.gravity / np.linalg.norm(picture.gravity)))
    return arrows


def field_arrow(picture: Picture) -> np.ndarray | None:
    """The field's direction (3,), as long as its panel holds, or None without a field."""
    strength = float(np.linalg.norm(picture.field))
    return FIELD_LENGTH * picture.field / strength if strength > 0 else None


def compass_labels(picture: Picture, main: View, page_aspect: float) -> list[CompassLabel]:
    """Where the compass's labels stand: a little beyond each arrow's point, as seen."""
    view, aspect = compass_view(main), COMPASS.aspect(page_aspect)
    labels = []
    for text, vector in compass_arrows(picture):
        flat = view.project(vector[None])[0, :2]
        seen = float(np.linalg.norm(flat))
        # An arrow pointing at the viewer has no direction on the page: its label goes below it.
        away = flat / seen if seen > 0.1 else np.array([0.0, -1.0])
        ((x, y),) = COMPASS.place((flat + LABEL_GAP * away)[None], aspect)
        labels.append(CompassLabel(text, float(x), float(y)))
    return labels


@dataclass(frozen=True)
class LegendItem:
    """mark: "dot", "arrow", "line" or "swatch" (colours side by side), centred at (x, y), before the text."""

    mark: str
    colours: tuple[str, ...]
    text: str
    x: float
    y: float


def legend(picture: Picture) -> list[LegendItem]:
    """What the picture's signs mean; only those that are in it."""
    entries: list[tuple[str, tuple[str, ...], str]] = []
    magnetised = picture.magnetised
    if magnetised.any():
        used = min(int(magnetised.sum()), len(style.SEGMENTS))
        entries.append(("swatch", style.SEGMENTS[:used], "magnetic"))
    if not magnetised.all():
        entries.append(("swatch", (style.UNMAGNETISED,), "unmagnetised"))
    if magnetised.any():
        entries.append(("arrow", (style.MAGNETISATION,), "magnetisation"))
    entries.append(("line", (style.INK,), "axis"))
    if picture.target is not None:
        entries.append(("dot", (style.TARGET,), picture.target_name))
    for name, colour in {prop.name: prop.colour for prop in picture.props if prop.name}.items():
        poles = (style.NORTH, style.SOUTH)
        short = name.removesuffix(POLES).split()[-1]  # there is little room, and the swatch shows the poles
        entries.append(("swatch", poles if name.endswith(POLES) else (colour,), short))
    rows = 3 if len(entries) <= 6 else 4
    step, top = (LEGEND_ROW, LEGEND_TOP) if rows == 3 else (0.75 * LEGEND_ROW, LEGEND_TOP + 0.01)
    return [
        LegendItem(mark, colours, text, LEGEND_X + (i // rows) * LEGEND_COLUMN, top - (i % rows) * step)
        for i, (mark, colours, text) in enumerate(entries)
    ]


def field_text(picture: Picture) -> str:
    """The field's magnitude, "|B| = 10.0 mT"; nothing without a field."""
    return magnitude(picture.field) if np.any(picture.field) else ""


def magnitude(field: np.ndarray) -> str:
    """A field's (3,) T magnitude in words; tenths of mT where that says enough."""
    strength = float(np.linalg.norm(field))
    if 1e-3 <= strength < 1.0:
        return f"|B| = {strength * 1e3:.1f} mT"
    return f"|B| = {quantity(strength, 'T')}"


def title_text(picture: Picture) -> str:
    """The title, cut to what fits beside the caption."""
    most = 28 if picture.mark else 46
    return picture.title if len(picture.title) <= most else picture.title[: most - 1] + "…"


@dataclass(frozen=True)
class Views:
    """The three projections of one picture on a page of one aspect."""

    main: View
    top: View
    side: View

    @classmethod
    def of(cls, frame: Frame, page_aspect: float) -> Views:
        top, side = frame.top_and_side(TOP.aspect(page_aspect))
        return cls(frame.main(MAIN.aspect(page_aspect)), top, side)
