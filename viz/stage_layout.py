"""The page of a motion: where its panels stand, and what stands around them, in fractions of the page from its lower left.

+--------------------------------------------+
| title                         t, pace      |
|                                            |
|   the view                                 |
|                                            |
| compass |B|  scale bar  field in t  legend |
+--------------------------------------------+
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from viz import style
from viz.camera import View
from viz.layout import (
    AXIS_LENGTH,
    FIELD_LENGTH,
    LABEL_GAP,
    CompassLabel,
    LegendItem,
    Panel,
    ScaleBar,
    compass_view,
    magnitude,
)
from viz.scenery import POLES, Prop
from viz.stage import Shot, Stage

TITLE_Y = 0.952
MAIN = Panel(0.0, 0.185, 1.0, 0.915)
COMPASS = Panel(0.008, 0.01, 0.098, 0.17)
FIELD = Panel(0.105, 0.045, 0.155, 0.135)
FIELD_TEXT_X, FIELD_TEXT_Y = 0.163, 0.090
BAR_CENTER, BAR_Y = 0.365, 0.105
CURVE = Panel(0.525, 0.05, 0.70, 0.15)
LEGEND_X, LEGEND_TOP, LEGEND_ROW, LEGEND_COLUMN, LEGEND_GAP = 0.735, 0.135, 0.045, 0.138, 0.016
ROWS, MOST_ROWS = 3, 4


@dataclass(frozen=True)
class Layout:
    """Which panels are drawn: one or two views, each with its compass or without, the field; `written`: with the page's text."""

    mains: tuple[Panel, ...]
    compasses: tuple[Panel, ...]
    field: Panel | None
    written: bool


PAGE = Layout((MAIN,), (COMPASS,), FIELD, written=True)
# What is tall leaves room for a second view, a quarter of a turn about the vertical from the first.
TALL = 0.8  # width over height
TWO_VIEWS = Layout(
    (Panel(0.0, 0.185, 0.5, 0.915), Panel(0.5, 0.185, 1.0, 0.915)),
    (COMPASS, Panel(0.515, 0.2, 0.605, 0.36)),
    FIELD,
    written=True,
)


def page_of(shot: Shot) -> Layout:
    """One view, or two of what is tall."""
    return PAGE if shot.aspect > TALL else TWO_VIEWS


def bare(size: tuple[int, int]) -> Layout:
    """A panel of a sheet, of that width and height: nothing is written, and the field's arrow stands in its upper left corner."""
    edge = min(0.17, 0.22 * size[0] / size[1])
    return Layout(
        (Panel(0.0, 0.0, 1.0, 1.0),),
        (),
        Panel(0.01, 0.98 - edge, 0.01 + edge * size[1] / size[0], 0.98),
        written=False,
    )


def compass_arrows(stage: Stage) -> list[tuple[str, np.ndarray]]:
    """CompassLabel and vector (3,) from the compass's origin: the axes, and which way things fall."""
    arrows = [(name, AXIS_LENGTH * np.eye(3)[i]) for i, name in enumerate("xyz")]
    if stage.gravity is not None and np.linalg.norm(stage.gravity) > 0:
        down = AXIS_LENGTH * stage.gravity / np.linalg.norm(stage.gravity)
        along = [np.allclose(vector, down, atol=0.1 * AXIS_LENGTH) for _, vector in arrows]
        if any(along):
            k = along.index(True)
            arrows[k] = (f"{arrows[k][0]}, g", arrows[k][1])
        else:
            arrows.append(("g", down))
    return arrows


def compass_labels(stage: Stage, view: View, place: Panel, aspect: float) -> list[CompassLabel]:
    """Where the compass's labels stand: a little beyond each arrow's point."""
    labels = []
    for text, vector in compass_arrows(stage):
        flat = compass_view(view).project(vector[None])[0, :2]
        seen = float(np.linalg.norm(flat))
        away = flat / seen if seen > 0.1 else np.array([0.0, -1.0])
        ((x, y),) = place.place((flat + LABEL_GAP * away)[None], place.aspect(aspect))
        labels.append(CompassLabel(text, float(x), float(y)))
    return labels


def field_arrow(stage: Stage) -> np.ndarray | None:
    """The field's arrow (3,), its length by the strength against the strongest of the motion; None if that is too short."""
    if stage.field is None:
        return None
    strength = float(np.linalg.norm(stage.field))
    strongest = strength
    if stage.history is not None:
        strongest = float(np.linalg.norm(stage.history.values, axis=1).max())
    return FIELD_LENGTH * stage.field / strongest if strength > 0.08 * strongest > 0 else None


def field_width(arrow: np.ndarray) -> float:
    """How thick its shaft is: a weak field's arrow is thin as well as short."""
    return min(0.2, 0.3 * float(np.linalg.norm(arrow)))


def field_text(stage: Stage) -> str:
    """The field's magnitude; nothing where there is no field at any time."""
    if stage.field is None:
        return ""
    if np.any(stage.field):
        return magnitude(stage.field)
    return "|B| = 0" if stage.history is not None and np.any(stage.history.values) else ""


def varies(stage: Stage) -> bool:
    """Whether the field changes over the motion, so that a curve of it tells something."""
    if stage.history is None or len(stage.history.times) < 2:
        return False
    values = stage.history.values
    return bool(np.ptp(values, axis=0).max() > 1e-3 * np.abs(values).max())


def curves(stage: Stage) -> tuple[np.ndarray, np.ndarray, float]:
    """Field components against time in the curve's panel: x (k,) and y (k, 3) in fractions of the page, and x of now."""
    assert stage.history is not None
    times, values = stage.history.times, stage.history.values
    span = max(float(np.ptp(times)), 1e-300)
    x = CURVE.left + (times - times[0]) / span * (CURVE.right - CURVE.left)
    most = float(np.abs(values).max())
    middle, half = 0.5 * (CURVE.bottom + CURVE.top), 0.45 * (CURVE.top - CURVE.bottom)
    now = times[0] if stage.time is None else stage.time
    return (
        x,
        middle + half * values / most,
        float(CURVE.left + (now - times[0]) / span * (CURVE.right - CURVE.left)),
    )


def scale_bar(view: View, aspect: float, unit: float) -> ScaleBar:
    """The bar of that length (m)."""
    width = unit / view.half_height / MAIN.aspect(aspect) * 0.5 * (MAIN.right - MAIN.left)
    return ScaleBar(unit, BAR_CENTER - width / 2, BAR_CENTER + width / 2, BAR_Y)


def signs(
    stages: Sequence[Stage], seen: Sequence[tuple[View, float]] = (), *, touching: bool = False
) -> list[tuple[str, tuple[str, ...], str]]:
    """Mark, colours and text of what must be explained: only what is drawn in one of these stages.

    seen: the views they are drawn in, with each panel's aspect: of what stands around the body only what is in one of them counts.
    touching: contact counts though none of the stages has any.
    """
    first = stages[0]
    entries: list[tuple[str, tuple[str, ...], str]] = []
    held = np.zeros(len(first.magnetised), dtype=bool) if first.held is None else first.held
    if (first.magnetised & ~held).any():
        used = min(int(first.magnetised.sum()), len(style.SEGMENTS))
        entries.append(("swatch", style.SEGMENTS[:used], "magnetic"))
    if not (first.magnetised | held).all():
        entries.append(("swatch", (style.UNMAGNETISED,), "unmagnetised"))
    if held.any():
        entries.append(("swatch", (style.HELD,), "held"))
    if any(len(stage.arrows) for stage in stages):
        entries.append(("arrow", (style.MAGNETISATION,), "magnetisation"))
    if first.ground is not None:
        entries.append(("swatch", (style.GROUND_SHADOW,), "ground"))
    if touching or any(len(stage.pushes) for stage in stages):
        entries.append(("arrow", (style.CONTACT,), "contact force"))
    elif any(len(stage.contact) for stage in stages):
        entries.append(("dot", (style.CONTACT,), "contact"))
    props = [
        p for stage in stages for p in stage.props if not seen or any(in_view(p, *view) for view in seen)
    ]
    colours = {p.name: p.colour for p in props if p.name}
    # What may come into the picture comes last, and moves no other entry.
    for name in sorted(colours, key=lambda name: (name.endswith(POLES), name == "clamp")):
        poles = (style.NORTH, style.SOUTH)
        entries.append(("swatch", poles if name.endswith(POLES) else (colours[name],), name))
    return entries


def in_view(prop: Prop, view: View, aspect: float) -> bool:
    """Whether any triangle of a prop reaches into a view, by the rectangle around it."""
    flat = view.project(prop.points)[:, :2] / np.array([aspect, 1.0])
    corners = flat[prop.triangles]
    return bool(((corners.min(axis=1) < 1.0) & (corners.max(axis=1) > -1.0)).all(axis=1).any())


def legend(stage: Stage, seen: Sequence[tuple[View, float]] = ()) -> list[LegendItem]:
    """The legend of a movie's page. It stays the same while things move: contact is in it wherever there is any at some time."""
    entries = signs([stage], seen, touching=stage.touches)[: 2 * MOST_ROWS]
    rows = max(ROWS, -(-len(entries) // 2))
    step, top = (LEGEND_ROW, LEGEND_TOP) if rows == ROWS else (0.75 * LEGEND_ROW, LEGEND_TOP + 0.01)
    return [
        LegendItem(mark, colours, text, LEGEND_X + (i // rows) * LEGEND_COLUMN, top - (i % rows) * step)
        for i, (mark, colours, text) in enumerate(entries)
    ]


def views(shot: Shot, size: tuple[int, int], layout: Layout) -> tuple[View, ...]:
    """The view of each main panel on a page of that width and height, all at one scale."""
    shots = [shot, shot.turned()][: len(layout.mains)]
    found = [s.view(panel.aspect(size[0] / size[1])) for s, panel in zip(shots, layout.mains)]
    half = max(view.half_height for view in found)
    return tuple(replace(view, half_height=half) for view in found)
