"""Plots of numbers: how a study converges, what accuracy costs, a motion's energies and contact forces, and one quantity over another.

Inputs are plain lists or arrays. Each plot is written to the path given, whose ending says how (PNG, PDF, SVG): PDF and SVG keep text as
text, for papers. Functions are of the module's top level, so that viz.worker.Renderer.run can draw them in its process.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter

from magmpm.compiled.arrays import Named
from magmpm.errors import PAIR
from magmpm.results.whole_file import whole_file
from magmpm.viz import style

LOOK: Any = {
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.8,
    "axes.labelsize": 9.0,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "savefig.dpi": 200,
}
# Text stays text. No date and no random identifiers: the same numbers give the same file.
_FILES: Any = {"pdf.fonttype": 42, "svg.fonttype": "none", "svg.hashsalt": "magmpm"}
_FINEST = "#0077BB"
_REFERENCE = "#CC3311"

# Tol's "bright" scheme; line styles distinguish the curves without color.
_COLORS = ("#4477AA", "#EE6677", "#228833", "#CCBB44", "#66CCEE", "#AA3377")
_DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)))
_ENERGY_UNITS = ((1e-3, "mJ"), (1e-6, "µJ"), (1e-9, "nJ"))
_FORCE_UNITS = ((1.0, "N"), (1e-3, "mN"), (1e-6, "µN"))

Table = Mapping[str, np.ndarray]


def convergence(
    rms: Sequence[float | None],
    path: str | Path,
    stop: float | None = None,
    title: str = "",
    failed: Sequence[int] = (),
) -> Path:
    """The rms of each trial of a study and the best so far, against the trial's number.

    rms: m, one for each trial in order, None or not finite where a trial has none. failed: further trials (numbers from 0) whose solve
    failed, whatever rms they were given as a penalty. stop: m, the rms at which the study stops. The axis is logarithmic where the
    values span more than a factor of ten.
    """
    values = (
        np.array([np.nan if value is None else float(value) for value in rms], dtype=float) * 1e3
    )
    values[[k for k in failed if k < len(values)]] = np.nan
    values[~np.isfinite(values)] = np.nan
    number = np.arange(len(values))
    good = np.isfinite(values)
    best = np.fmin.accumulate(values) if len(values) else values
    with rc_context(LOOK):
        figure = Figure(figsize=(5.4, 3.4), layout="constrained")
        axes = figure.add_subplot()
        axes.scatter(
            number[good], values[good], s=16, color="#999999", linewidths=0, label="trial", zorder=2
        )
        label = "best so far"
        if good.any():
            k = int(np.nanargmin(values))
            label += f" ({values[k]:.2f} mm, trial {k})"
            axes.scatter(
                number[k], values[k], s=42, facecolors="none", edgecolors=style.TARGET, zorder=4
            )
            _scale_of_rms(axes, np.append(values[good], [] if stop is None else stop * 1e3))
        else:
            axes.set_yticks([])
            axes.text(
                0.5,
                0.5,
                "no trial has an rms",
                transform=axes.transAxes,
                ha="center",
                color=style.FAINT_INK,
            )
        # The step starts with the first trial that has an rms and goes on to the last.
        axes.step(
            number, best, where="post", color=style.TARGET, linewidth=1.6, label=label, zorder=3
        )
        _stop_and_failures(axes, None if stop is None else stop * 1e3, number[~good])
        axes.set_xlabel("trial")
        axes.set_ylabel("rms distance to the target (mm)")
        axes.set_xlim(-0.5, max(len(values) - 0.5, 0.5))
        axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
        figure.legend(loc="outside upper left", ncols=3, columnspacing=1.4, handletextpad=0.5)
        if title:
            # Inside: an outside legend stands where a figure's title would.
            axes.set_title(title, fontsize=10, weight="bold", loc="right")
        return saved(figure, path)


# of a second objective: what its axis says, and how many of its units make an SI one
QUANTITIES = {
    "largest_field_T": ("largest field (mT)", 1e3),
    "magnetized_volume_m3": ("magnetized volume (mm\u00b3)", 1e9),
}


def pareto(report: Named, path: str | Path) -> Path:
    """The two objectives of every trial of a study, with the front of those that no other is better than.

    report: of the study, with `objectives`, `values` (SI, None for a failed trial), `pareto` and `compromise`. The trial nearest to the
    ideal point, with both objectives scaled to the front's extent, is named.
    """
    label, unit = QUANTITIES[report["objectives"][1]]
    scale = np.array([1e3, unit])
    front = np.array([entry["values"] for entry in report["pareto"]]).reshape(-1, 2) * scale
    on_it = {entry["number"] for entry in report["pareto"]}
    others = (
        np.array(
            [v for k, v in enumerate(report["values"]) if v is not None and k not in on_it]
        ).reshape(-1, 2)
        * scale
    )
    with rc_context(LOOK):
        figure = Figure(figsize=(5.4, 3.6), layout="constrained")
        axes = figure.add_subplot()
        axes.scatter(
            others[:, 0],
            others[:, 1],
            s=16,
            color="#999999",
            linewidths=0,
            label="dominated trial",
            zorder=2,
        )
        axes.step(
            front[:, 0], front[:, 1], where="post", color=style.TARGET, linewidth=1.2, zorder=3
        )
        count = f"Pareto front ({len(front)} of {len(report['values'])})"
        axes.scatter(
            front[:, 0], front[:, 1], s=26, color=style.TARGET, linewidths=0, label=count, zorder=4
        )
        for entry, point in zip(report["pareto"], front, strict=True):
            if entry["number"] == report["compromise"]:
                at = f"{point[0]:.3g} mm, {point[1]:.3g} {label.split('(')[1].rstrip(')')}"
                text = f"best compromise: trial {entry['number']} ({at})"
                axes.scatter(
                    point[0],
                    point[1],
                    s=80,
                    facecolors="none",
                    edgecolors="#007766",
                    linewidths=1.4,
                    label=text,
                    zorder=5,
                )
        axes.set_xlabel("rms distance to the target (mm)")
        axes.set_ylabel(label)
        axes.margins(x=0.08, y=0.12)
        figure.legend(loc="outside upper left", ncols=2, columnspacing=1.2, handletextpad=0.4)
        axes.set_title(report["name"], fontsize=10, weight="bold", loc="right")
        return saved(figure, path)


def _stop_and_failures(axes: Axes, stop: float | None, failed: np.ndarray) -> None:
    """A line at the rms (mm) at which the study stops, and crosses for the failed trials' numbers."""
    if stop is not None:
        axes.axhline(stop, color="#009988", linewidth=1.0, linestyle=(0, (5, 3)), zorder=1)
        axes.annotate(
            f"stop\n{stop:.3g} mm",
            (1.0, stop),
            xycoords=axes.get_yaxis_transform(),
            xytext=(4, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
            color="#007766",
        )
    if len(failed):
        # Along the upper edge: a failed trial has no rms, and no place on that axis.
        top = axes.get_xaxis_transform()
        look: Any = {"marker": "x", "s": 22, "color": _REFERENCE, "linewidths": 1.2}
        axes.scatter(
            failed, np.full(len(failed), 0.97), transform=top, label="failed", zorder=4, **look
        )


def _scale_of_rms(axes: Axes, shown: np.ndarray) -> None:
    """Logarithmic where the values shown (mm) span more than a factor of ten, else from zero."""
    low = float(shown.min())
    high = float(shown.max())
    if low > 0 and high > 10 * low:
        axes.set_yscale("log")
        axes.set_ylim(0.75 * low, 1.6 * high)
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
    else:
        axes.set_ylim(0.0, 1.12 * high)


def accuracy(
    table: Sequence[Named],
    path: str | Path,
    title: str = "",
    reference_name: str = "reference",
    order_finest: float | None = None,
    order_reference: float | None = None,
) -> Path:
    """Plot the cost of accuracy: error against seconds, and error against cell size with its order.

    table: one mapping for each cell size, with cells_across; cell_size (m); seconds; error_finest, the largest distance to the finest
    solution as a fraction of the length, None for the finest itself; and error_reference, the same to an independent answer, None or
    left out where there is none. The orders of convergence are what a study found: distances to the finest solution, which has an error
    of its own, fall faster than errors.
    """
    rows = sorted(table, key=lambda row: float(row["cell_size"]), reverse=True)
    series = [
        ("error_reference", f"against {reference_name}", _REFERENCE, "s"),
        ("error_finest", "against the finest", _FINEST, "o"),
    ]
    with rc_context(LOOK):
        figure = Figure(figsize=(7.2, 3.3), layout="constrained")
        cost, order = figure.subplots(1, 2)
        for key, name, color, marker in series:
            known = _known(rows, key)
            if not known:
                continue
            error = np.array([100.0 * float(row[key]) for row in known])
            look: Any = {
                "color": color,
                "marker": marker,
                "markersize": 5,
                "linewidth": 1.3,
                "label": name,
            }
            cost.plot([float(row["seconds"]) for row in known], error, **look)
            order.plot([1e3 * float(row["cell_size"]) for row in known], error, **look)
        _label_cells(cost, rows, [key for key, *_ in series])
        if order_finest is not None:
            _slope_triangle(order, _known(rows, "error_finest"), "error_finest", order_finest)
        elif order_reference is not None:
            near = _known(rows, "error_reference")
            _slope_triangle(order, near, "error_reference", order_reference)
        for axes in (cost, order):
            axes.set_xscale("log")
            axes.set_yscale("log")
            axes.grid(True, which="major", color="#EEEEEE", linewidth=0.8, zorder=0)
            axes.set_axisbelow(True)
            axes.margins(0.12)
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
                axis.set_major_formatter(StrMethodFormatter("{x:g}"))
                axis.set_minor_formatter(NullFormatter())
        sizes = [1e3 * float(row["cell_size"]) for row in rows]
        order.set_xticks(sizes, [f"{size:.3g}" for size in sizes])
        cost.set_xlabel("time of the solve (s)")
        cost.set_ylabel("largest error (% of length)")
        order.set_xlabel("cell size (mm)")
        cost.set_title("a  price")
        order.set_title("b  order")
        cost.legend(loc="best")
        if title:
            figure.suptitle(title, fontsize=10)
        return saved(figure, path)


def _known(rows: Sequence[Named], key: str) -> list[Named]:
    """Rows that have a positive value of this key."""
    return [row for row in rows if row.get(key) is not None and float(row[key]) > 0]


def _label_cells(axes: Axes, rows: Sequence[Named], keys: Sequence[str]) -> None:
    """Label each row, above its upper point, with the number of cells across the body."""
    near: Any = {"xytext": (5, 5), "textcoords": "offset points", "fontsize": 8, "color": style.INK}
    for row in rows:
        errors = [100.0 * float(row[key]) for key in keys if _known([row], key)]
        if errors:
            axes.annotate(f"{row['cells_across']:g}", (float(row["seconds"]), max(errors)), **near)
    axes.annotate(
        "numbers: cells across",
        (0.02, 0.02),
        xycoords="axes fraction",
        fontsize=7.5,
        color=style.FAINT_INK,
    )


def _slope_triangle(axes: Axes, known: Sequence[Named], key: str, slope: float) -> None:
    """A triangle below a series, with the slope that is its order of convergence."""
    size = np.array([1e3 * float(row["cell_size"]) for row in known])
    error = np.array([100.0 * float(row[key]) for row in known])
    # The middle third of the series, moved down clear of it.
    low, high = np.exp(np.quantile(np.log([size.min(), size.max()]), [0.4, 0.75]))
    drop = 0.45 * float(np.min(error / size**slope))
    bottom, top = (drop * x**slope for x in (low, high))
    axes.plot(
        [low, high, high, low], [bottom, bottom, top, bottom], color=style.FAINT_INK, linewidth=1.0
    )
    near: Any = {"textcoords": "offset points", "fontsize": 8, "color": style.FAINT_INK}
    axes.annotate("1", (np.sqrt(low * high), bottom), xytext=(0, -3), ha="center", va="top", **near)
    axes.annotate(
        f"{slope:.1f}", (high, np.sqrt(bottom * top)), xytext=(4, 0), ha="left", va="center", **near
    )


def motion(
    energies: Table,
    contacts: Mapping[str, Table],
    path: str | Path,
    title: str = "",
    jumps: Sequence[float] = (),
) -> Path:
    """A motion's energies, and below them forces of obstacles and between parts where there are any, against time.

    energies: columns of energies.csv, s and J; contacts: effect -> columns of contacts.csv, s and N; jumps: times, s, to be marked.
    """
    touching = {
        name: c
        for name, c in contacts.items()
        if name.partition(PAIR)[0] in (name, "self_contact")  # parts have shares of an obstacle's
        if any(np.any(c[f"F{axis}"] != 0) for axis in "xyz")
    }
    rows = 2 if touching else 1
    with rc_context(LOOK):
        figure = Figure(figsize=(6.4, 2.7 * rows), layout="constrained")
        axes = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
        _energies(axes[0], energies)
        for time in jumps:
            axes[0].axvline(time, color=style.ALARM, linewidth=1.0, linestyle=":", zorder=0)
        if touching:
            _forces(axes[1], touching)
        axes[-1].set_xlabel("time (s)")
        axes[-1].locator_params(axis="x", nbins=7)
        figure.align_ylabels(axes)
        for letter, panel in zip("ab", axes if rows == 2 else []):
            panel.set_title(letter)
        if title:
            axes[0].set_title(title, loc="right", fontsize=10, weight="bold")
        return saved(figure, path)


def _energies(axes: Axes, energies: Table) -> None:
    # Potentials count from an arbitrary zero: from their first value they can be compared.
    from_zero = {
        name: 0.0 if name in ("kinetic", "elastic", "dissipated") else values[0]
        for name, values in energies.items()
    }
    curves = {
        name: energies[name] - from_zero[name]
        for name in (*(n for n in energies if n not in ("t", "total")), "total")
    }
    unit, word = _unit(list(curves.values()), _ENERGY_UNITS)
    for i, (name, values) in enumerate(curves.items()):
        look: Any = {
            "color": _COLORS[i % len(_COLORS)],
            "linestyle": _DASHES[i % len(_DASHES)],
            "linewidth": 1.3,
        }
        if name == "total":
            look = {"color": style.INK, "linestyle": "-", "linewidth": 1.8}
        axes.plot(energies["t"], values / unit, label=name.replace("_", " "), **look)
    _dress(axes, f"energy since the start ({word})")


def _forces(axes: Axes, contacts: Mapping[str, Table]) -> None:
    curves = {
        (name, axis): contact[f"F{axis}"] for name, contact in contacts.items() for axis in "xyz"
    }
    unit, word = _unit(list(curves.values()), _FORCE_UNITS)
    least = 1e-3 * max(float(np.nanmax(np.abs(force))) for force in curves.values())
    shown = [
        (name, axis, force)
        for (name, axis), force in curves.items()
        if np.any(np.abs(force) > least)
    ]
    for i, (name, axis, force) in enumerate(shown):
        look: Any = {
            "color": _COLORS[i % len(_COLORS)],
            "linestyle": _DASHES[i % len(_DASHES)],
            "linewidth": 1.3,
        }
        axes.plot(
            contacts[name]["t"], force / unit, label=f"{name.replace('_', ' ')}, $F_{axis}$", **look
        )
    _dress(axes, f"contact force on the body ({word})")


def _dress(axes: Axes, label: str) -> None:
    """Add what energies and forces share: label, zero line and legend."""
    axes.set_ylabel(label)
    axes.axhline(0.0, color=style.GRID, linewidth=0.8, zorder=0)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def _unit(curves: list[np.ndarray], units: tuple[tuple[float, str], ...]) -> tuple[float, str]:
    """The largest unit in which the largest value is at least 1; the smallest if none is."""
    largest = max((float(np.abs(c[np.isfinite(c)]).max(initial=0.0)) for c in curves), default=0.0)
    return next((unit for unit in units if largest >= unit[0]), units[-1])


def saved(figure: Figure, path: str | Path) -> Path:
    """Write a figure as its path's ending says; its folder is made."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    kind = path.suffix[1:].lower() or "png"
    metadata = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}.get(kind)
    # The layout makes room for the ticks it finds: those of the axes' last size are there only once it has been through.
    figure.draw_without_rendering()
    with whole_file(path) as unfinished, rc_context(_FILES):
        figure.savefig(unfinished, format=kind, metadata=metadata)
    return path
