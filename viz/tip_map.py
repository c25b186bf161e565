"""The picture of a map of tips: where the tip goes, seen from two sides, and which fields are not sure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Plain
from magmpm.viz import style

SHOWN = {  # marks of fields that are not sure: symbol, color
    "two shapes": ("o", "#0033CC"),
    "snapped": ("s", "#882255"),
    "unstable": ("D", "#B3261E"),
    "failed": ("x", "#B3261E"),
}


@dataclass(frozen=True)
class MappedTips:
    """A map to draw: fields (m, 3) T, tips (m, 3) m or NaN, marks (m,); kind, axes and shape: as of studies.explore.tip_map.Fields;
    length: m, of the body."""

    fields: np.ndarray
    tips: np.ndarray
    marks: np.ndarray
    kind: str
    axes: Sequence[int]
    shape: Sequence[int]
    length: float

    @property
    def away(self) -> np.ndarray:
        """Distances (m,) of the tips from where the straight body has its own, mm."""
        return 1e3 * np.linalg.norm(self.tips - [self.length, 0.0, 0.0], axis=1)


def draw(path: Path, name: str, found: MappedTips) -> Path:
    """Draw a map into a PNG, SVG or PDF, with the name of its scene."""
    from matplotlib.figure import Figure

    from magmpm.viz.plots import saved

    figure = Figure(figsize=(11.5, 4.6), dpi=150, layout="constrained")
    sides, front, chart = figure.subplots(1, 3, width_ratios=[1.0, 1.0, 1.08])
    for place, pair in ((sides, (0, 2)), (front, (1, 2))):
        dots = _side(place, found, pair)
    bar = figure.colorbar(
        dots, ax=[sides, front], location="bottom", fraction=0.05, pad=0.02, aspect=45
    )
    bar.set_label("strength of the field, mT")
    (_plane if found.kind == "plane" else _sphere)(figure, chart, found)
    handles = [
        chart.scatter(
            [],
            [],
            marker=symbol,
            s=26,
            label=f"{mark} ({int(np.count_nonzero(found.marks == mark))})",
            **_face(symbol, color),
        )
        for mark, (symbol, color) in SHOWN.items()
        if np.any(found.marks == mark)
    ]
    handles = [sides.lines[0], *handles]  # the undeformed body
    figure.legend(
        handles=handles, loc="outside lower right", ncols=len(handles), frameon=False, fontsize=9
    )
    figure.suptitle(
        f"{name}: the tip over {len(found.fields)} fields", fontsize=12, color=style.INK
    )
    return saved(figure, path)


def _side(place: Any, found: MappedTips, pair: tuple[int, int]) -> Any:
    """The tips, mm, seen along one axis, with the undeformed body."""
    first, second = pair
    tips = 1e3 * found.tips
    strength = 1e3 * np.linalg.norm(found.fields, axis=1)
    nearest_last = np.argsort(strength)[::-1]
    dots = place.scatter(
        *tips[nearest_last][:, pair].T, c=strength[nearest_last], s=9, cmap="viridis", linewidths=0
    )
    for mark, (symbol, color) in SHOWN.items():
        of = (found.marks == mark) & np.isfinite(tips).all(axis=1)
        place.scatter(
            *tips[of][:, pair].T, marker=symbol, s=20, linewidths=0.7, **_face(symbol, color)
        )
    body = np.array([[0.0, 0.0, 0.0], [1e3 * found.length, 0.0, 0.0]])
    look: Plain = {"lw": 2.5} if first == 0 else {"lw": 0, "marker": "o", "ms": 4}
    place.plot(*body[:, pair].T, color=style.HELD, zorder=1, label="straight", **look)
    place.set(
        xlabel=f"{'xyz'[first]} of the tip, mm",
        ylabel=f"{'xyz'[second]} of the tip, mm",
        aspect="equal",
    )
    _plain(place)
    return dots


def _plane(figure: Any, chart: Any, found: MappedTips) -> None:
    """Plot how far the tip goes over two components of the field."""
    n, m = found.shape
    x, y = (1e3 * found.fields[:, axis] for axis in found.axes)
    shown = chart.pcolormesh(
        x.reshape(n, m),
        y.reshape(n, m),
        found.away.reshape(n, m),
        cmap="cividis",
        shading="nearest",
        rasterized=True,
    )
    figure.colorbar(shown, ax=chart, location="bottom", fraction=0.05, pad=0.02).set_label(
        "tip's distance from straight, mm"
    )
    _marks(chart, x, y, found.marks)
    chart.set(
        xlabel=f"B{'xyz'[found.axes[0]]}, mT", ylabel=f"B{'xyz'[found.axes[1]]}, mT", aspect="equal"
    )
    _plain(chart)


def _sphere(figure: Any, chart: Any, found: MappedTips) -> None:
    """Plot how far the tip goes at the greatest strength, over the field's direction. A direction has the worst mark of its strengths."""
    directions, strengths = found.shape
    last = np.arange(directions) * strengths + strengths - 1
    fields = 1e3 * found.fields[last]
    azimuth = np.degrees(np.arctan2(fields[:, 1], fields[:, 0]))
    elevation = np.degrees(
        np.arcsin(np.clip(fields[:, 2] / np.linalg.norm(fields, axis=1), -1.0, 1.0))
    )
    shown = chart.scatter(
        azimuth, elevation, c=found.away[last], s=34, cmap="cividis", linewidths=0
    )
    figure.colorbar(shown, ax=chart, location="bottom", fraction=0.05, pad=0.02).set_label(
        f"tip's distance from straight at {np.linalg.norm(fields[0]):.3g} mT, mm"
    )
    order = ["sure", *SHOWN]
    worst = np.array(
        [
            order[max(order.index(mark) for mark in row)]
            for row in found.marks.reshape(directions, strengths)
        ]
    )
    _marks(chart, azimuth, elevation, worst, 60)
    chart.set(
        xlabel="azimuth of the field, deg",
        ylabel="elevation of the field, deg",
        xlim=(-190, 190),
        ylim=(-95, 95),
    )
    chart.set_xticks([-180, -90, 0, 90, 180])
    chart.set_yticks([-90, -45, 0, 45, 90])
    _plain(chart)


def _marks(chart: Any, x: np.ndarray, y: np.ndarray, marks: np.ndarray, size: float = 16) -> None:
    for mark, (symbol, color) in SHOWN.items():
        of = marks == mark
        chart.scatter(x[of], y[of], marker=symbol, s=size, linewidths=0.9, **_face(symbol, color))


def _face(symbol: str, color: str) -> Plain:
    """Open symbols, through which the color of the strength is seen; a cross has no inside."""
    return {"color": color} if symbol == "x" else {"facecolors": "none", "edgecolors": color}


def _plain(place: Any) -> None:
    place.grid(True, color="#E5E5E2", lw=0.6)
    place.set_axisbelow(True)
    for side in ("top", "right"):
        place.spines[side].set_visible(False)
