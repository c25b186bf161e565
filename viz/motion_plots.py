"""Plots of a motion's numbers: energies and contact forces over time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from viz import style
from viz.plots import LOOK, saved

# Tol's "bright" scheme; line styles tell the curves apart without colour.
_COLOURS = ("#4477AA", "#EE6677", "#228833", "#CCBB44", "#66CCEE", "#AA3377")
_DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)))
_ENERGY_UNITS = ((1e-3, "mJ"), (1e-6, "µJ"), (1e-9, "nJ"))
_FORCE_UNITS = ((1.0, "N"), (1e-3, "mN"), (1e-6, "µN"))


def motion(
    energies: Mapping[str, np.ndarray],
    contacts: Mapping[str, Mapping[str, np.ndarray]],
    path: str | Path,
    title: str = "",
) -> Path:
    """Energies, and below them contact forces where there are any, against time.

    energies: columns of energies.csv, s and J; contacts: effect -> columns of contacts.csv, s and N. The ending of path says how it is
    written (PNG, PDF, SVG).
    """
    touching = {name: c for name, c in contacts.items() if any(np.any(c[f"F{axis}"] != 0) for axis in "xyz")}
    rows = 2 if touching else 1
    with rc_context(LOOK):
        figure = Figure(figsize=(6.4, 2.7 * rows), layout="constrained")
        axes = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
        _energies(axes[0], energies)
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


def _energies(axes: Axes, energies: Mapping[str, np.ndarray]) -> None:
    time = energies["t"]
    names = [name for name in energies if name not in ("t", "total")]
    # Potentials count from an arbitrary zero: from their first value they can be compared.
    curves = {
        name: energies[name] - (0.0 if name in ("kinetic", "elastic", "dissipated") else energies[name][0])
        for name in names
    }
    curves["total"] = energies["total"] - energies["total"][0]
    unit, word = _unit(list(curves.values()), _ENERGY_UNITS)
    for i, (name, values) in enumerate(curves.items()):
        last = name == "total"
        axes.plot(
            time,
            values / unit,
            color=style.INK if last else _COLOURS[i % len(_COLOURS)],
            linestyle="-" if last else _DASHES[i % len(_DASHES)],
            linewidth=1.8 if last else 1.3,
            label=name.replace("_", " "),
        )
    axes.set_ylabel(f"energy since the start ({word})")
    axes.axhline(0.0, color=style.GRID, linewidth=0.8, zorder=0)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def _forces(axes: Axes, contacts: Mapping[str, Mapping[str, np.ndarray]]) -> None:
    unit, word = _unit([c[f"F{axis}"] for c in contacts.values() for axis in "xyz"], _FORCE_UNITS)
    i, least = (
        0,
        1e-3 * max(float(np.nanmax(np.abs(c[f"F{axis}"]))) for c in contacts.values() for axis in "xyz"),
    )
    for name, contact in contacts.items():
        for axis in "xyz":
            force = contact[f"F{axis}"]
            if np.any(np.abs(force) > least):
                axes.plot(
                    contact["t"],
                    force / unit,
                    color=_COLOURS[i % len(_COLOURS)],
                    linestyle=_DASHES[i % len(_DASHES)],
                    linewidth=1.3,
                    label=f"{name.replace('_', ' ')}, $F_{axis}$",
                )
                i += 1
    axes.set_ylabel(f"contact force on the body ({word})")
    axes.axhline(0.0, color=style.GRID, linewidth=0.8, zorder=0)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def _unit(curves: list[np.ndarray], units: tuple[tuple[float, str], ...]) -> tuple[float, str]:
    """The largest unit in which the largest value is at least 1; the smallest if none is."""
    largest = max((float(np.abs(c[np.isfinite(c)]).max(initial=0.0)) for c in curves), default=0.0)
    return next((unit for unit in units if largest >= unit[0]), units[-1])
