"""Plots of searches for a goal and of sweeps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from magmpm.errors import shown_unit, significant
from magmpm.viz import style
from magmpm.viz.plots import LOOK, saved


def progress(report: Mapping[str, Any], path: str | Path) -> Path:
    """Values of the first goal of each trial (a goal's report), and the best so far among those that keep the constraints."""
    label, factor = shown_unit(report["goals"][0])
    sign = -1.0 if label.startswith("maximize") else 1.0
    values = np.array([np.nan if of is None else factor * of[0] for of in report["values"]])
    keeps = np.array(report["feasible"], bool)
    number = np.arange(len(values))
    ranked = np.where(keeps & np.isfinite(values), sign * values, np.inf)
    best = np.full(len(values), np.nan)
    if len(values):
        least = np.minimum.accumulate(ranked)
        best[np.isfinite(least)] = sign * least[np.isfinite(least)]
    missing = ~np.isfinite(values)
    with rc_context(LOOK):
        figure = Figure(figsize=(5.4, 3.4), layout="constrained")
        axes = figure.add_subplot()
        axes.scatter(
            number[keeps], values[keeps], s=16, color="#999999", linewidths=0, label="trial"
        )
        breaks = ~keeps & ~missing
        if breaks.any():
            axes.scatter(
                number[breaks],
                values[breaks],
                s=18,
                facecolors="none",
                edgecolors="#999999",
                linewidths=0.8,
                label="breaks a constraint",
            )
        axes.step(number, best, where="post", color=style.TARGET, linewidth=1.6, label=_best(best))
        if missing.any():
            axes.scatter(
                number[missing],
                np.full(missing.sum(), 0.97),
                transform=axes.get_xaxis_transform(),
                marker="x",
                s=18,
                color=style.ALARM,
                linewidths=1.0,
                label="failed or not run",
            )
        axes.set_xlabel("trial")
        axes.set_ylabel(_said(label))
        axes.set_xlim(-0.5, max(len(values) - 0.5, 0.5))
        axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
        figure.legend(loc="outside upper left", ncols=2, columnspacing=1.4, handletextpad=0.5)
        return saved(figure, path)


def front(report: Mapping[str, Any], path: str | Path) -> Path:
    """The first two goals of every trial, and the front of those that no other is better than."""
    labels, factors = zip(*(shown_unit(goal) for goal in report["goals"][:2]), strict=True)
    scale = np.array(factors)
    every = np.array([of[:2] for of in report["values"] if of is not None]).reshape(-1, 2) * scale
    best = np.array([one["values"][:2] for one in report["pareto"]]).reshape(-1, 2) * scale
    best = best[np.argsort(best[:, 0])]
    with rc_context(LOOK):
        figure = Figure(figsize=(5.4, 3.6), layout="constrained")
        axes = figure.add_subplot()
        axes.scatter(every[:, 0], every[:, 1], s=16, color="#999999", linewidths=0, label="trial")
        axes.plot(
            best[:, 0],
            best[:, 1],
            "o-",
            color=style.TARGET,
            ms=5,
            lw=1.0,
            label=f"Pareto front ({len(best)})",
        )
        axes.set_xlabel(_said(labels[0]))
        axes.set_ylabel(_said(labels[1]))
        axes.margins(x=0.08, y=0.12)
        figure.legend(loc="outside upper left", ncols=2, columnspacing=1.2, handletextpad=0.4)
        return saved(figure, path)


def sweep(
    rows: Sequence[Mapping[str, Any]],
    varied: Sequence[str],
    path: str | Path,
    numbers: Sequence[float],
    unit: str | None,
) -> Path | None:
    """The measures of a sweep over one or two varied numbers; None where there are more, or nothing to draw.

    A panel for each measure; of two numbers the second has a line for each of its values. numbers: the first varied number of each row, in
    `unit`; unit None: it is no number, and numbers are places.
    """
    measures = list(
        dict.fromkeys(
            key
            for row in rows
            for key, value in row.items()
            if key not in varied and isinstance(value, (int, float))
        )
    )
    if not measures or not 1 <= len(varied) <= 2:
        return None
    groups = list(dict.fromkeys(str(row[varied[1]]) for row in rows)) if len(varied) == 2 else [""]
    with rc_context(LOOK):
        figure = Figure(figsize=(5.4, 0.6 + 2.3 * len(measures)), layout="constrained")
        panels = figure.subplots(len(measures), 1, sharex=True, squeeze=False)[:, 0]
        colors = style.SEGMENTS if len(groups) > 1 else (style.TARGET,)
        for panel, measure in zip(panels, measures, strict=True):
            for k, group in enumerate(groups):
                of = [
                    (x, row.get(measure, np.nan))
                    for x, row in zip(numbers, rows, strict=True)
                    if len(varied) < 2 or str(row[varied[1]]) == group
                ]
                x, y = np.array(sorted(of), dtype=float).T
                panel.plot(x, y, "o-", ms=4, lw=1.2, color=colors[k % len(colors)], label=group)
            panel.set_ylabel(measure)
        if unit is None:
            texts = list(dict.fromkeys(str(row[varied[0]]) for row in rows))
            panels[-1].set_xticks(range(len(texts)), texts)
        panels[-1].set_xlabel(f"{varied[0]} ({unit})" if unit else varied[0])
        if len(groups) > 1:
            handles, _ = panels[0].get_legend_handles_labels()
            figure.legend(handles, groups, title=varied[1], loc="outside right upper")
        return saved(figure, path)


def _said(label: str) -> str:
    """A goal's label without its verb, in words."""
    return (label.partition(" ")[2] or label).replace("_", " ")


def _best(best: np.ndarray) -> str:
    known = best[np.isfinite(best)]
    return f"best so far ({significant(float(known[-1]))})" if len(known) else "best so far"
