"""Layout of a page, in fractions of its width and height from the lower left.

A moment of a motion:                              A trial, from above and from the side too:

+--------------------------------------------+    +--------------------------------------------+
| title                             t, pace  |    | title                             caption  |
|                                            |    |                              +-----------+ |
|   main view                                |    |   main view                  | top       | |
|                                            |    |                              +-----------+ |
|                                            |    |                              | side      | |
|                                            |    |                              +-----------+ |
| compass |B|  scale bar  field in t  legend |    | compass  |B|    scale bar       legend     |
+--------------------------------------------+    +--------------------------------------------+

Nothing in one panel can reach another, so text never lies on the body, whatever its shape.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from magmpm.viz import style
from magmpm.viz.camera import Framing, View


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
        """Half heights from the panel's center (n, 2) -> fractions of the page (n, 2)."""
        half = 0.5 * np.array([self.right - self.left, self.top - self.bottom])
        center = np.array([self.left, self.bottom]) + half
        return center + np.asarray(flat)[:, :2] * half / np.array([aspect, 1.0])


@dataclass(frozen=True)
class Inset:
    """A second, orthographic view: its panel, its name, and the direction to its camera."""

    panel: Panel
    name: str
    toward: tuple[float, float, float]


@dataclass(frozen=True)
class LegendPlace:
    """Place of the legend: the first mark, the steps to the next row and column, the gap before the text, rows; short: of its text."""

    left: float
    top: float
    row: float
    column: float
    gap: float
    short: bool = False


@dataclass(frozen=True)
class Layout:
    """A page: one or two main views, each with its compass or without, insets, and the places of what is written around them.

    size: its usual width and height in pixels. field: the panel of its arrow; field_text, bar: (x, y) of the text and of the middle of
    the scale bar; curve: the panel of the field in time. Without a legend nothing is written.
    """

    mains: tuple[Panel, ...]
    field: Panel
    size: tuple[int, int]
    compasses: tuple[Panel, ...] = ()
    insets: tuple[Inset, ...] = ()
    title_y: float = 0.955
    field_text: tuple[float, float] = (0.0, 0.0)
    bar: tuple[float, float] = (0.0, 0.0)
    curve: Panel | None = None
    legend: LegendPlace | None = None


PAGE = Layout(
    mains=(Panel(0.0, 0.185, 1.0, 0.915),),
    compasses=(Panel(0.008, 0.01, 0.098, 0.17),),
    field=Panel(0.105, 0.045, 0.155, 0.135),
    size=style.MOVIE_SIZE,
    title_y=0.952,
    field_text=(0.163, 0.090),
    bar=(0.365, 0.105),
    curve=Panel(0.525, 0.05, 0.70, 0.15),
    legend=LegendPlace(0.735, 0.135, 0.045, 0.138, 0.016),
)
# What is tall leaves room for a second view, a quarter of a turn about the vertical from the first.
TWO_VIEWS = replace(
    PAGE,
    mains=(Panel(0.0, 0.185, 0.5, 0.915), Panel(0.5, 0.185, 1.0, 0.915)),
    compasses=(*PAGE.compasses, Panel(0.515, 0.2, 0.605, 0.36)),
)
TRIAL = Layout(
    mains=(Panel(0.0, 0.165, 0.685, 0.925),),
    compasses=(Panel(0.005, 0.005, 0.125, 0.16),),
    field=Panel(0.135, 0.03, 0.225, 0.15),
    size=style.TRIAL_SIZE,
    insets=(
        Inset(Panel(0.70, 0.55, 0.985, 0.905), "top: x right, y up", (0.0, 0.0, 1.0)),
        Inset(Panel(0.70, 0.175, 0.985, 0.53), "side: x right, z up", (0.0, -1.0, 0.0)),
    ),
    field_text=(0.235, 0.085),
    bar=(0.535, 0.100),
    legend=LegendPlace(0.705, 0.128, 0.044, 0.178, 0.018, short=True),
)


def page_of(framing: Framing, *, insets: bool = False) -> Layout:
    """One view, or two of what is tall; or a trial's, with its insets."""
    return TRIAL if insets else PAGE if framing.aspect > 0.8 else TWO_VIEWS  # width over height


def bare(size: tuple[int, int]) -> Layout:
    """A panel of a figure, of that width and height: nothing is written, and the field's arrow is in its upper left corner."""
    edge = min(0.17, 0.22 * size[0] / size[1])
    return Layout(
        (Panel(0.0, 0.0, 1.0, 1.0),),
        Panel(0.01, 0.98 - edge, 0.01 + edge * size[1] / size[0], 0.98),
        size,
    )


@dataclass(frozen=True)
class Views:
    """The projections of one page: of each main panel, all at one scale, and of each inset, all at one scale."""

    mains: tuple[View, ...]
    insets: tuple[View, ...]

    @classmethod
    def of(cls, framing: Framing, layout: Layout, page_aspect: float) -> Views:
        """The views of what must be in view on a page of that aspect (width over height)."""
        framings = [framing, framing.turned()][: len(layout.mains)]
        mains = [f.view(panel.aspect(page_aspect)) for f, panel in zip(framings, layout.mains)]
        half = max(view.half_height for view in mains)
        insets = [
            view
            for inset in layout.insets[:1]  # all are of one size
            for view in framing.orthographic(
                [i.toward for i in layout.insets], inset.panel.aspect(page_aspect)
            )
        ]
        return cls(tuple(replace(view, half_height=half) for view in mains), tuple(insets))
