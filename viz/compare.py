"""Plots of one quantity over another, measured and known: what is ours as a line, what others published as marks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from viz.plots import LOOK, saved


@dataclass(frozen=True)
class Series:
    """One curve: y (m,) over x (m,), None where it has no value. look: line, or the marker of separate points."""

    name: str
    x: Sequence[float]
    y: Sequence[float | None]
    look: str = "line"  # line | dashes | any of matplotlib's markers
    colour: str = "#0077BB"


def compare(
    series: Sequence[Series], path: str | Path, *, x_label: str, y_label: str, title: str = ""
) -> Path:
    """All series in one plot of the project's look. Returns the path, whose ending says PNG, PDF or SVG."""
    with rc_context(LOOK):
        figure = Figure(figsize=(6.4, 4.2), layout="constrained")
        axes = figure.subplots()
        for s in series:
            y = np.array([np.nan if value is None else float(value) for value in s.y])
            if s.look in {"line", "dashes"}:
                axes.plot(
                    s.x,
                    y,
                    color=s.colour,
                    linewidth=1.5,
                    linestyle="-" if s.look == "line" else "--",
                    label=s.name,
                )
            else:
                face = s.colour if s.look in "x+" else "white"
                axes.plot(
                    s.x,
                    y,
                    linestyle="none",
                    marker=s.look,
                    markersize=6,
                    color=s.colour,
                    markerfacecolor=face,
                    label=s.name,
                )
        axes.grid(True, color="#EEEEEE", linewidth=0.8, zorder=0)
        axes.set_axisbelow(True)
        axes.set_xlabel(x_label)
        axes.set_ylabel(y_label)
        axes.legend(loc="best")
        if title:
            axes.set_title(title)
        return saved(figure, path)
