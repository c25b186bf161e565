"""The picture of a fit: what was measured, what the fitted scene gives, and how far they are apart."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from magmpm.compiled.arrays import Named
from magmpm.viz import style
from magmpm.viz.plots import LOOK, saved

_COLORS = (
    "#0077BB",
    "#CC3311",
    "#009988",
    "#EE7733",
    "#33BBEE",
    "#AA3377",
    "#999933",
    "#882255",
    "#555555",
)
_MARKS = "osD^vPX<>"


def fitted(shown: Named, path: str | Path, title: str = "") -> Path:
    """Measured points and the fitted scene's, over field, arc length or time, or in a plane; below, residuals in standard errors.

    shown: panels, one for each table: series, a mapping of names to x, measured and fitted (lists; fitted_x where those are at other x),
    x_label, y_label, title, equal: whether both axes have one scale; residuals in standard errors and the lines of the table they are of;
    numbers: the constants in words.
    Returns the path, whose ending says PNG, PDF or SVG.
    """
    with rc_context(LOOK):
        panels = shown["panels"]
        figure = Figure(figsize=(6.4, 2.1 + 3.3 * len(panels)), layout="constrained")
        *above, below = figure.subplots(
            len(panels) + 1, 1, height_ratios=(*[2.4] * len(panels), 1.0)
        )
        for axes, panel in zip(above, panels, strict=True):
            _points(axes, panel)
            axes.set_title(panel.get("title", ""), fontsize=8, loc="left", color=style.FAINT_INK)
        _residuals(
            below, shown, "line of the table" if len(panels) == 1 else "number, table after table"
        )
        figure.align_ylabels([*above, below])
        words = "\n".join(shown["numbers"][:6])
        figure.suptitle(f"{title}\n{words}" if title else words, fontsize=9)
        return saved(figure, path)


def _points(axes: Axes, shown: Named) -> None:
    for k, (name, one) in enumerate(shown["series"].items()):
        color = _COLORS[k % len(_COLORS)]
        mark = _MARKS[k % len(_MARKS)]
        x = np.array(one.get("fitted_x", one["x"]))
        y = np.array(one["fitted"])
        order = np.argsort(x, kind="stable") if "fitted_x" not in one else np.arange(len(x))
        axes.plot(x[order], y[order], color=color, linewidth=1.3, zorder=2)
        look: Any = {
            "linestyle": "none",
            "marker": mark,
            "markersize": 4.5,
            "markerfacecolor": "white",
            "markeredgecolor": color,
        }
        if "half" in one:
            axes.errorbar(
                one["x"],
                one["fitted"],
                one["half"],
                linestyle="none",
                ecolor=color,
                elinewidth=0.8,
                capsize=2.5,
                zorder=1,
            )
        axes.plot(one["x"], one["measured"], label=name, zorder=3, **look)
    axes.plot([], [], color=style.FAINT_INK, linewidth=1.3, label="fitted scene")
    axes.set_xlabel(shown["x_label"])
    axes.set_ylabel(shown["y_label"])
    axes.grid(True, color="#EEEEEE", linewidth=0.8, zorder=0)
    axes.set_axisbelow(True)
    if shown.get("equal"):
        axes.set_aspect("equal", adjustable="datalim")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def _residuals(axes: Axes, shown: Named, x_label: str) -> None:
    sizes = np.array(shown["residuals"])
    axes.axhspan(-1.96, 1.96, color="#EEEEEE", linewidth=0, zorder=0)
    axes.axhline(0.0, color=style.FAINT_INK, linewidth=0.8, zorder=1)
    lines = np.array(shown["lines"])
    held = np.array(shown.get("held_out", [False] * len(sizes)))
    axes.plot(
        lines[~held],
        sizes[~held],
        linestyle="none",
        marker="o",
        markersize=3.5,
        color=style.INK,
        zorder=2,
        label="fitted",
    )
    if held.any():
        axes.plot(
            lines[held],
            sizes[held],
            linestyle="none",
            marker="D",
            markersize=3.5,
            color=_COLORS[1],
            zorder=2,
            label="held out",
        )
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    most = max(3.0, 1.1 * float(np.max(np.abs(sizes), initial=0.0)))
    axes.set_ylim(-most, most)
    axes.set_xlabel(x_label)
    axes.set_ylabel("residual\n(standard errors)")
    axes.annotate(
        "95 % of normal errors",
        (1.0, 1.96),
        xycoords=axes.get_yaxis_transform(),
        xytext=(4, -8),
        textcoords="offset points",
        fontsize=7,
        color=style.FAINT_INK,
    )
