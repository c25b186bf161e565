"""A fit in words, as data, as the numbers of a picture, and as the scene's file with the constants that were found."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array, Plain
from magmpm.inputs.quantities import divided
from magmpm.scene.addresses import put, value_at, written
from magmpm.scene.apparatus import AXIS, POSITION
from magmpm.studies.fitting.constants import GEOMETRY, applied, places_of
from magmpm.studies.fitting.prediction import Label, Prediction
from magmpm.studies.fitting.search import Fit, Fitted
from magmpm.studies.fitting.solve import quantile_of
from magmpm.studies.fitting.table import Measurements
from magmpm.studies.search.best_scene import as_yaml, moved_content

MOST_SERIES = 9  # in the picture


@dataclass(frozen=True)
class HeldOut:
    """Prediction of readings that a fit did not see.

    Attributes
    ----------
    found : Fit
        The fit, with the held-out readings in place of its own.
    of_constants : array (n,), m or rad
        Standard errors of the prediction that come from the constants' errors.
    half : array (n,), m or rad
        Half the interval, at the fit's level, in which a reading is expected.
    """

    found: Fit
    of_constants: Array
    half: Array

    @property
    def inside(self) -> float:
        """Share of the readings that lie in their intervals."""
        return float(np.mean(np.abs(self.found.residuals) <= self.half))

    def summary(self) -> Plain:
        """Write it as plain data.

        Returns
        -------
        dict[str, Any]
            Values in SI.
        """
        rows = zip(
            self.found.labels, self.found.residuals.tolist(), self.half.tolist(), strict=True
        )
        return {
            "rms_m": self.found.rms_m,
            "rms_rad": self.found.rms_rad,
            "inside": self.inside,
            "numbers": len(self.found.residuals),
            "readings": [
                {
                    "table": label.table,
                    "line": label.line,
                    "what": label.what,
                    "unit": label.unit,
                    "measured": label.measured,
                    "predicted": label.simulated,
                    "residual": residual,
                    "half_interval": half,
                }
                for label, residual, half in rows
            ],
        }

    def text(self) -> str:
        """Write it for people.

        Returns
        -------
        str
            One line.
        """
        angles = any(label.angle for label in self.found.labels)
        sizes = [f"{1e3 * self.found.rms_m:.3g} mm"] * (not self.found.measured.angles_alone)
        sizes += [f"{math.degrees(self.found.rms_rad):.3g} deg"] * angles
        numbers = len(self.found.residuals)
        return (
            f"  held out         {numbers} number{'s' * (numbers != 1)}, predicted with rms"
            f" {' and '.join(sizes)}; {100 * self.inside:.0f} % of them in their"
            f" {100 * self.found.level:g} % intervals"
        )


def predict_held_out(found: Fit, measured: Measurements) -> HeldOut:
    """Predict readings that the fit did not see, to first order in the constants' errors; a reading has the fit's noise as well.

    Parameters
    ----------
    found : Fit
        The fit.
    measured : Measurements
        The readings.

    Returns
    -------
    HeldOut
        The prediction.

    Raises
    ------
    SolveError
        Where no equilibrium is found.
    """
    prediction = Prediction(found.scene, measured, tuple(one.constant for one in found.constants))
    residuals, slopes = prediction.at(found.x)
    ratios = (
        found.ratios if len(found.ratios) == len(measured.each) else (1.0,) * len(measured.each)
    )
    there = replace(
        found,
        measured=measured,
        residuals=residuals,
        labels=tuple(prediction.labels),
        ratios=ratios,
    )
    errors = np.array(
        [
            one.error / abs(one.constant.slope(x))
            for one, x in zip(found.constants, found.x.tolist(), strict=True)
        ]
    )
    of_constants = np.sqrt(
        np.einsum("ni,ij,nj->n", slopes * errors, found.correlation, slopes * errors)
    )
    quantile = quantile_of(found.level, np.inf if found.noise == "given" else found.degrees)
    return HeldOut(
        there,
        of_constants,
        quantile * np.hypot(of_constants, [there.sigma_of(label) for label in there.labels]),
    )


def summary(found: Fit) -> Plain:
    """Write a fit as plain data.

    Parameters
    ----------
    found : Fit
        The fit.

    Returns
    -------
    dict[str, Any]
        Values in SI.
    """
    both = zip(found.residuals.tolist(), found.labels, strict=True)
    return {
        "name": found.scene.name,
        "measured": found.measured.named,
        "tables": [
            {
                "path": str(one.path),
                "kind": one.kind,
                "numbers": one.numbers,
                "sigma_m": found.sigma_m * ratio,
            }
            for one, ratio in zip(found.measured.each, found.ratios, strict=True)
        ],
        "constants": [_entry(one) for one in found.constants],
        "level": found.level,
        "noise": {"sigma_m": found.sigma_m, "sigma_rad": found.sigma_rad, "from": found.noise},
        "rms_m": found.rms_m,
        "rms_rad": found.rms_rad,
        "numbers": len(found.residuals),
        "states": len(found.measured.states),
        "degrees_of_freedom": found.degrees,
        "correlation": found.correlation.tolist(),
        "residuals": [
            {"table": of.table, "line": of.line, "what": of.what, "value": value, "unit": of.unit}
            for value, of in both
        ],
        "suspects": (
            None
            if found.suspects is None
            else [{"name": one.name, "probability": one.probability} for one in found.suspects]
        ),
        "moves": {kind: dict(by) for kind, by in found.moves.items()},
        "warnings": list(found.warnings),
        "solves": found.solves,
        "seconds": found.seconds,
    }


def _entry(one: Fitted) -> Plain:
    c = one.constant
    entry: Plain = {
        "name": c.name,
        "address": c.address,
        "kind": c.kind,
        "value": one.value,
        "unit": c.unit,
        "low": one.low,
        "high": one.high,
    }
    if c.variable.material is not None:
        entry["material"] = c.variable.material
    return {
        **entry,
        "standard_error": one.error,
        "interval": one.method,
        "start": c.start,
        "grid_shift": one.grid_shift,
    }


def text(found: Fit) -> str:
    """Write a fit as a table for people.

    Parameters
    ----------
    found : Fit
        The fit.

    Returns
    -------
    str
        The text.
    """
    sizes = len(found.measured.states)
    head = (
        f"{found.scene.name}: {len(found.residuals)} numbers of {sizes} state{'s' * (sizes != 1)},"
        f" {found.measured.named}"
    )
    width = max(len(one.constant.name) for one in found.constants)
    share = f"{100 * found.level:g} % interval"
    lines = [
        head,
        f"  {'':{width}}  {'fitted':>12}  {share:^27}  {'standard error':>15}  {'finer grid':>11}",
    ]
    for one in found.constants:
        (factor, unit), (low, high) = one.constant.shown, _ends(one)
        finer = "" if one.grid_shift is None else f"{factor * one.grid_shift:+.2g}"
        value = f"{factor * one.value:.5g}"
        interval = f"{low:>12} to {high:<11}"
        constant = one.constant
        address = "" if constant.address == constant.name else constant.address
        lines.append(
            f"  {one.constant.name:{width}}  {value:>12}  {interval}  {factor * one.error:>15.3g} "
            f" {finer:>11}  {unit:6}  {address}".rstrip()
        )
    of_each = ", ".join(
        f"{1e3 * found.sigma_m * ratio:.3g}" for ratio in dict.fromkeys(found.ratios)
    )
    lengths = (
        () if found.measured.angles_alone else ((f"{1e3 * found.rms_m:.3g} mm", f"{of_each} mm"),)
    )
    degrees = math.degrees
    angles = (
        ()
        if found.sigma_rad is None
        else ((f"{degrees(found.rms_rad):.3g} deg", f"{degrees(found.sigma_rad):.3g} deg"),)
    )
    rms, noise = (" and ".join(words) for words in zip(*lengths, *angles, strict=True))
    lines += [
        (
            f"  residuals        rms {rms}; noise {noise} a number ({found.noise}), "
            f"{found.degrees} degree{'s' * (found.degrees != 1)} of freedom"
        ),
        f"  intervals        {_method(found)}",
        f"  taken as exact   {_exact(found)}",
        f"  solves           {found.solves} in {found.seconds:.1f} s",
    ]
    return "\n".join(lines)


def _exact(found: Fit) -> str:
    """Quantities whose error is in no interval, by what they would move the constants, and the outcome of the test of them."""
    parts = []
    for kind, name, share, of in (
        (GEOMETRY, "geometry", 1.0, "1 % more diameter in the scene:"),
        ("field", "the field", 10.0, "0.1 mT: up to"),
        ("magnetization", "directions", math.pi / 1.8, "1 deg: up to"),
    ):
        moved = [
            f"{each} {share * by:{'+' * (kind == GEOMETRY)}.2g} %"
            for each, by in found.moves.get(kind, {}).items()
        ]
        parts.append(f"{name} ({of} {', '.join(moved)})" if moved else name)
    words = f"{', '.join(parts)}, and all else that is not varied"
    if found.suspects is None:
        return words
    if not found.suspects:
        return f"{words}; too few readings to test this"
    first = found.suspects[0]
    return (
        f"{words}; of {len(found.suspects)} suspects the likeliest is {first.name}: chance explains"
        f" the residuals as well with p = {first.probability:.2g}"
    )


def _method(found: Fit) -> str:
    """Ways in which the intervals were found."""
    methods = " and ".join(sorted({one.method for one in found.constants}))
    quantile = "normal quantile" if found.noise == "given" else "Student's t"
    return f"{methods}, {quantile}"


def residuals_table(found: Fit, half: Array | None = None) -> str:
    """Write the residuals as CSV: line of the measured file, what, simulated minus measured, in standard errors; of several tables, which.

    Parameters
    ----------
    found : Fit
        The fit.
    half : array (n,), m or rad, optional
        Half the interval in which each reading is expected, of readings held out: then the
        prediction and this stand there as well.

    Returns
    -------
    str
        The text.
    """
    several = bool(found.measured.tables)
    rows = [
        "line,what,residual,unit,standard_errors"
        + ",predicted,half_interval" * (half is not None)
        + ",table" * several
    ]
    for k, (value, label) in enumerate(zip(found.residuals, found.labels, strict=True)):
        scale, unit = (math.degrees(1.0), "deg") if label.angle else (1e3, "mm")
        row = f"{label.line},{label.what},{scale * value:.6g},{unit},{value / found.sigma_of(label):.4g}"
        if half is not None:
            row += f",{' '.join(format(scale * one, '.6g') for one in np.ravel(label.simulated).tolist())},{scale * half[k]:.4g}"
        rows.append(row + f",{label.table + 1}" * several)
    return "\n".join(rows) + "\n"


def fitted_scene(found: Fit, source: Path, folder: Path) -> str:
    """Write the scene's file with the fitted constants, and in comments what they are.

    Parameters
    ----------
    found : Fit
        The fit.
    source : Path
        The scene's file.
    folder : Path
        Where the text will stand: its paths are relative to this.

    Returns
    -------
    str
        The text.
    """
    content = moved_content(source, folder)
    constants = [one.constant for one in found.constants]
    there = applied(found.scene, constants, found.x)
    values = {place: value_at(there, place, units=True) for place in places_of(there, constants)}
    put(content, {place: _short(value) for place, value in values.items()}, there)
    source_names = ", ".join(one.path.name for one in found.measured.each)
    comment = "".join(
        f"# {line}\n"
        for line in (f"Fitted to {source_names} by `magmpm fit`:", *text(found).splitlines()[1:])
    )
    return comment + "\n" + as_yaml(content)


def _short(value: Any) -> Any:
    """A value of a file to ten digits."""
    if isinstance(value, list):
        return [_short(each) for each in value]
    number, unit = divided(value) or (0.0, "")
    return f"{number:.10g} {unit}" if unit else round(number, 9)


def shown(found: Fit, held: HeldOut | None = None) -> Plain:
    """Collect the content of the picture (viz.fit_plot): a panel for each table, then those of what was held out, and residuals.

    A panel has series of measured and simulated numbers over what was changed, and of held-out ones
    half the interval in which they are expected.

    Parameters
    ----------
    found : Fit
        The fit.
    held : HeldOut, optional
        What was held out.

    Returns
    -------
    dict[str, Any]
        Plain data.
    """
    several = bool(found.measured.tables) or held is not None
    both = [found] if held is None else [found, held.found]
    residuals = [
        float(r / one.sigma_of(label))
        for one in both
        for r, label in zip(one.residuals, one.labels, strict=True)
    ]
    return {
        "residuals": residuals,
        "lines": (
            [*range(1, 1 + len(residuals))] if several else [label.line for label in found.labels]
        ),
        "held_out": [k >= len(found.residuals) for k in range(len(residuals))],
        "numbers": [_in_words(one) for one in found.constants],
        "panels": [
            {
                **_panel(one, table, k, None if one is found or held is None else held.half),
                **({"title": title} if several else {}),
            }
            for one in both
            for k, table in enumerate(one.measured.each)
            for title in [
                table.path.name
                + ("" if one is found else ", held out, with the intervals predicted")
            ]
        ],
    }


def _panel(found: Fit, table: Measurements, number: int, half: Array | None) -> Plain:
    """Panel of a table."""
    labels = [label for label in found.labels if label.table == number]
    if table.kind == "curve":
        return _curves(table, labels)
    over, label_of = _over(found, table)
    halves = iter(
        [h for h, label in zip(half, found.labels, strict=True) if label.table == number]
        if half is not None
        else []
    )
    series: dict[str, Plain] = {}
    for label in labels:
        x, group = over[label.line]
        one = series.setdefault(
            f"{label.what.replace('_', ' ')}{group}", {"x": [], "measured": [], "fitted": []}
        )
        factor = 180 / math.pi if label.angle else 1e3
        one["x"].append(x)
        one["measured"].append(factor * label.measured[0])
        one["fitted"].append(factor * label.simulated[0])
        if half is not None:
            one.setdefault("half", []).append(factor * float(next(halves)))
    kept = dict(list(series.items())[:MOST_SERIES])
    some = f" ({len(kept)} of {len(series)} series)" if len(kept) < len(series) else ""
    y_label = (
        "angle (deg)"
        if table.angles_alone
        else "place (mm), angle (deg)"
        if table.has_angles
        else "place (mm)"
    )
    return {"series": kept, "x_label": label_of + some, "y_label": y_label}


def _ends(one: Fitted) -> tuple[str, ...]:
    """Ends of an interval, as shown."""
    return tuple(
        "open" if end is None else f"{one.constant.shown[0] * end:.4g}"
        for end in (one.low, one.high)
    )


def _in_words(one: Fitted) -> str:
    (factor, unit), (low, high) = one.constant.shown, _ends(one)
    return (
        f"{one.constant.name.replace('_', ' ')} {factor * one.value:.4g} ({low} to {high}) {unit}"
    )


def _over(found: Fit, table: Measurements) -> tuple[dict[int, tuple[float, str]], str]:
    """Places of the table's lines on the axis, with the group that each line's series belongs to; the axis's label."""
    over: dict[int, tuple[float, str]] = {}
    states = table.states
    fields = np.array([state.field or found.scene.field.uniform for state in states])
    strongest = fields[np.argmax(np.linalg.norm(fields, axis=1))]
    direction = strongest / max(float(np.linalg.norm(strongest)), 1e-300)
    several = len(states) > 1
    apparatus, named = _apparatus(table)
    for k, state in enumerate(states):
        for line, s in zip(state.lines.tolist(), state.s.tolist(), strict=True):
            if state.time is not None:
                over[line] = 1e3 * state.time, "" if math.isnan(s) else f" at {1e3 * s:.3g} mm"
            elif table.kind == "places":
                over[line] = 1e3 * s, f", state {k + 1}" if several else ""
            else:
                over[line] = (
                    (1e3 * float(fields[k] @ direction), "") if named is None else apparatus[k]
                )
    if states[0].time is not None:
        return over, "time (ms)"
    if table.kind == "places":
        return over, "arc length (mm)"
    if named is not None:
        return over, named
    straight = np.allclose(
        np.cross(fields, direction), 0.0, atol=1e-3 * max(float(np.linalg.norm(strongest)), 1e-12)
    )
    return (
        over,
        (
            "field (mT)"
            if straight
            else f"part of the field along [{', '.join(f'{d:.2f}' for d in direction)}] (mT)"
        ),
    )


def _apparatus(table: Measurements) -> tuple[list[tuple[float, str]], str | None]:
    """Place of each state on the axis and the group of its series, by what the apparatus changes most; the axis's label, None: nothing."""
    rows = [dict(state.apparatus.settings) for state in table.states]
    if POSITION in rows[0]:
        away = np.array([row[POSITION] for row in rows])
        sizes = np.linalg.norm(away, axis=1)
        polar = np.degrees(np.arctan2(np.hypot(away[:, 1], away[:, 2]), away[:, 0])).round()
        group = [f" at {angle:.0f} deg" if np.ptp(polar) > 0 else "" for angle in polar]
        if np.ptp(sizes) > 1e-6:
            return (
                list(zip((1e3 * sizes).tolist(), group, strict=True)),
                "distance of the magnet's center from the clamp (mm)",
            )
    if AXIS in rows[0]:
        axes = np.array([row[AXIS] for row in rows])
        across = np.linalg.norm(axes[:, 1:], axis=1)
        turns = np.degrees(np.arctan2(across, axes[:, 0])).tolist()
        return [(turn, "") for turn in turns], "angle of the magnet's axis to the body's (deg)"
    for place, value in rows[0].items():
        if isinstance(value, float):
            coil = place[:2] == ("field", "coils")
            named = "current in the first coil (A)" if coil else f"{written(place)} (SI)"
            return [(float(row[place]), "") for row in rows], named  # type: ignore[arg-type]
    inserted = [state.apparatus.inserted for state in table.states]
    if inserted[0] is None:
        return [], None
    return [(1e3 * (length or 0.0), "") for length in inserted], "inserted length (mm)"


def _curves(table: Measurements, labels: list[Label]) -> Plain:
    """Points of digitized curves, and where they are nearest to the simulated ones, in the first two coordinates they have."""
    state_of = {line: k for k, state in enumerate(table.states) for line in state.lines.tolist()}
    series: dict[str, Plain] = {}
    for label in labels:
        name = f"curve {state_of[label.line] + 1}"
        keys = ("x", "measured", "fitted_x", "fitted")
        one = series.setdefault(name, {key: [] for key in keys})
        for key, value in zip(keys, (*label.measured[:2], *label.simulated[:2]), strict=True):
            one[key].append(1e3 * value)
    first, second = ("xyz"[i] for i in table.axes[:2])
    return {
        "series": dict(list(series.items())[:MOST_SERIES]),
        "x_label": f"{first} (mm)",
        "y_label": f"{second} (mm)",
        "equal": True,
    }
