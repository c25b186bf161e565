"""Plots of searches for a goal and of sweeps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from magmpm.compiled.arrays import Named, NamedNumbers
from magmpm.errors import shown_unit, significant
from magmpm.viz import style
from magmpm.viz.plots import LOOK, saved


def progress(report: Named, path: str | Path) -> Path:
    """Values of each trial (a goal's report), and the best so far among those that keep the constraints; a panel for each goal."""
    goals = report["goals"]
    keeps = np.array(report["feasible"], bool)
    ends = np.array(report["ends"])
    with rc_context(LOOK):
        figure = Figure(figsize=(5.4, 1.2 + 2.2 * len(goals)), layout="constrained")
        panels = figure.subplots(len(goals), 1, sharex=True, squeeze=False)[:, 0]
        for k, (axes, goal) in enumerate(zip(panels, goals, strict=True)):
            label, factor = shown_unit(goal)
            values = [np.nan if of is None else factor * of[k] for of in report["values"]]
            sign = -1.0 if label.startswith("maximize") else 1.0
            _panel(axes, np.array(values, dtype=float), keeps, ends, sign)
            axes.set_ylabel(_said(label))
        panels[-1].set_xlabel("trial")
        panels[-1].set_xlim(-0.5, max(len(ends) - 0.5, 0.5))
        panels[-1].xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
        handles, labels = panels[0].get_legend_handles_labels()
        if len(goals) > 1:  # each has a best of its own
            labels = ["best so far" if of.startswith("best") else of for of in labels]
        figure.legend(
            handles,
            labels,
            loc="outside upper left",
            ncols=2,
            columnspacing=1.4,
            handletextpad=0.5,
        )
        return saved(figure, path)


def _panel(
    axes: Axes, values: np.ndarray, keeps: np.ndarray, ends: np.ndarray, sign: float
) -> None:
    """Draw the values of one goal, which is small where sign is 1, and marks of the trials that have none."""
    number = np.arange(len(values))
    ranked = np.where(keeps & np.isfinite(values), sign * values, np.inf)
    best = np.full(len(values), np.nan)
    if len(values):
        least = np.minimum.accumulate(ranked)
        best[np.isfinite(least)] = sign * least[np.isfinite(least)]
    axes.scatter(number[keeps], values[keeps], s=16, color="#999999", linewidths=0, label="trial")
    breaks = ~keeps & np.isfinite(values)
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
    marks = {"failed": ("x", style.ALARM), "pruned": ("|", "#666666"), "not run": ("_", "#666666")}
    for end, (marker, color) in marks.items():
        of = number[ends == end]
        if len(of):
            axes.scatter(
                of,
                np.full(len(of), 0.97),
                transform=axes.get_xaxis_transform(),
                marker=marker,
                s=18,
                color=color,
                linewidths=1.0,
                label={"not run": "not run: violates a bound anyway"}.get(end, end),
            )


def front(report: Named, path: str | Path) -> Path:
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
    rows: Sequence[Named],
    varied: Sequence[str],
    path: str | Path,
    numbers: Sequence[float],
    unit: str | None,
) -> Path | None:
    """The measures of a sweep over one or two varied numbers; None where there are more, or nothing to draw.

    A panel for each measure that changes; of two numbers the second has a line for each of its values. numbers: the first varied number
    of each row, in `unit`; unit None: it is no number, and numbers are places.
    """
    measures = _that_change(rows, varied)
    if not measures or not 1 <= len(varied) <= 2:
        return None
    groups = list(dict.fromkeys(str(row[varied[1]]) for row in rows)) if len(varied) == 2 else [""]
    with rc_context(LOOK):
        figure = Figure(figsize=(5.4, 0.8 + 1.9 * len(measures)), layout="constrained")
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
            figure.legend(handles, groups, title=varied[1], loc="outside upper left", ncols=4)
        return saved(figure, path)


def _that_change(rows: Sequence[Named], varied: Sequence[str], least: float = 1e-6) -> list[str]:
    """Measures of a sweep's rows that change by more than `least` of the largest value in their unit: below is what the solver leaves."""
    found: dict[str, list[float]] = {}
    for row in rows:
        for key, value in row.items():
            if key not in varied and isinstance(value, (int, float)):
                found.setdefault(key, []).append(value)
    largest: NamedNumbers = {}
    for key, values in found.items():
        unit = key.rpartition("_")[2]
        largest[unit] = max(largest.get(unit, 0.0), max(map(abs, values)))
    return [
        key
        for key, values in found.items()
        if max(values) - min(values) > least * largest[key.rpartition("_")[2]]
    ]


def _said(label: str) -> str:
    """A goal's label without its verb, in words."""
    return (label.partition(" ")[2] or label).replace("_", " ")


def _best(best: np.ndarray) -> str:
    known = best[np.isfinite(best)]
    return f"best so far ({significant(float(known[-1]))})" if len(known) else "best so far"
