"""`make measured`: the package against public measurements; pictures and tables of docs/measured.md.

    python docs/gallery/measured.py [zhao] [perpendicular] [kim] [kim_modes] [tan] [laws]

Zhao's beam and Tan's arch are predicted with published constants alone. Of Kim's guidewire one column is fitted, for several free lengths,
and the other five are predicted from it.
"""

from __future__ import annotations

import csv
import json
import math
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from magmpm import load_scene, run
from magmpm.scene import Scene
from magmpm.solving.solve import solve
from magmpm.studies.fitting import fit, predict_held_out, read_measured, read_split
from magmpm.viz import style
from magmpm.viz.plots import LOOK, saved

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "data"
PAGE = ROOT / "docs/measured.md"
IMAGES = ROOT / "docs/images"
SCATTER = 0.02  # of the length: scatter of points digitized from a published figure
LENGTHS = (
    10.0,
    14.0,
    16.0,
    18.0,
)  # mm: free lengths of the guidewire; its bent tip must clear the magnet in the nearest row
RATE = 6.5  # mT/s: of the field that snapped Tan's arch
LAWS = ("stretches", "rotates")
BLUE = "#0077BB"
RED = "#CC3311"


def _reversed(law: str) -> tuple[list[float], Any, dict[str, Any]]:
    """Fields (mT), measured deflections of Zhao's beam over its length, and those by published constants, for two widths."""
    reference = json.loads((DATA / "references/zhao_beam.json").read_text())
    fields = reference["field_mT"][1:]
    measured = np.array(reference["published"]["experiment"][1:])
    found = {}
    for name, words in (("zhao_width_5mm", "5 mm wide"), ("zhao_plane_strain", "plane strain")):
        scene = load_scene(DATA / f"scenes/{name}.yaml").with_material(magnetization_law=law)
        found[words] = (
            np.array(
                [float(run(scene.with_field([-1e-3 * field, 0.0, 0.0])).tip[2]) for field in fields]
            )
            / scene.length
        )
    return fields, measured, found


def zhao() -> tuple[str, Figure]:
    """Deflection of Zhao's beam in a reversed field by published constants: the table, and the picture."""
    fields, measured, found = _reversed("stretches")
    rows = [
        "| field (mT) | measured | " + " | ".join(found) + " |",
        "| --- " * (2 + len(found)) + "|",
    ]
    for k, field in enumerate(fields):
        errors = " | ".join(
            f"{tips[k]:.3f} ({100 * (tips[k] - measured[k]):+.1f} %)" for tips in found.values()
        )
        rows.append(f"| {field} | {measured[k]:.3f} | {errors} |")
    rms = " | ".join(
        f"{100 * math.sqrt(np.mean((tips - measured) ** 2)):.1f} % of L" for tips in found.values()
    )
    rows.append(f"| rms of the error | | {rms} |")
    figure, (above, below) = panels()
    look = {"linestyle": "none", "marker": "o", "color": style.INK, "markersize": 4}
    above.errorbar(fields, measured, SCATTER, **look, capsize=2, label="measured (Zhao et al.)")
    for (words, tips), color in zip(found.items(), (BLUE, RED), strict=True):
        above.plot(fields, tips, color=color, marker=".", label=f"predicted, {words}")
        below.plot(fields, 100 * (tips - measured), color=color, marker=".", linewidth=1)
    below.axhspan(-100 * SCATTER, 100 * SCATTER, color="#EEEEEE", linewidth=0, zorder=0)
    above.set(ylabel="tip deflection over length")
    below.set(xlabel="field against the magnetization (mT)", ylabel="error (% of L)")
    above.legend()
    return "\n".join(rows), figure


def perpendicular() -> tuple[str, None]:
    """Table of the deflection of Zhao's beam in a field across it, by published constants, for two widths."""
    fields = (1.0, 2.0, 5.0, 10.0, 20.0, 40.0)
    scenes = [
        load_scene(DATA / f"scenes/zhao_{name}.yaml") for name in ("width_5mm", "plane_strain")
    ]
    rows = ["| field (mT) | 5 mm wide | plane strain |", "| --- | --- | --- |"]
    for field in fields:
        tips = [
            float(run(scene.with_field([0.0, 0.0, 1e-3 * field])).tip[2]) / scene.length
            for scene in scenes
        ]
        rows.append(f"| {field:g} | {tips[0]:.3f} | {tips[1]:.3f} |")
    return "\n".join(rows), None


def kim() -> tuple[str, Figure]:
    """Tip angles of Kim's guidewire, fitted for several free lengths: the table, and the picture of the best."""
    base = load_scene(DATA / "scenes/kim_guidewire.yaml")
    path = DATA / "measured/kim2022_guidewire.csv"
    found: dict[float, Any] = {}
    rows = [
        "| free length (mm) | effective shear modulus (MPa), 95 % interval | residual, rms | largest | rms with the magnet over the "
        "undeformed tip |",
        "| --- | --- | --- | --- | --- |",
    ]
    for length in LENGTHS:
        data = base.to_si()
        data["body"]["catheter"]["length"] = 1e-3 * length
        data["materials"]["composite"]["shear_modulus"] *= (
            1e-3 * length / base.length
        ) ** 2  # the same deflection in a weak field
        scene = Scene.from_si(data)
        measured = read_measured(path, scene)
        one = found[length] = fit(measured, scene, vary=["shear_modulus"], thorough=False)
        over_tip = fit(
            _over_tip(measured, scene.length), scene, vary=["shear_modulus"], thorough=False
        )
        value, low, high = (
            1e-6 * (part or math.nan)
            for part in (one.constants[0].value, one.constants[0].low, one.constants[0].high)
        )
        worst = max(np.degrees(np.abs(one.residuals)))
        rows.append(
            f"| {length:g} | {value:.1f} ({low:.1f} to {high:.1f}) | {math.degrees(one.rms_rad):.1f} deg | "
            f"{worst:.1f} deg | {math.degrees(over_tip.rms_rad):.1f} deg |"
        )
    best = min(found.values(), key=lambda one: one.rms_rad)
    figure, (above, below) = panels()
    distances = [
        1e3 * float(np.linalg.norm(state.apparatus.magnet)) for state in best.measured.states
    ]
    for length, color in ((LENGTHS[0], RED), (1e3 * best.scene.length, BLUE)):
        one = min(found.items(), key=lambda each: abs(each[0] - length))[1]
        angles = [math.degrees(label.simulated[0]) for label in one.labels]
        above.plot(distances, angles, color=color, label=f"fitted, free length {length:.3g} mm")
        below.plot(distances, np.degrees(one.residuals), color=color, marker=".", linewidth=1)
    read = [math.degrees(label.measured[0]) for label in best.labels]
    above.plot(
        distances,
        read,
        linestyle="none",
        marker="o",
        color=style.INK,
        markersize=4,
        label="measured (Kim et al.)",
    )
    below.axhspan(-3, 3, color="#EEEEEE", linewidth=0, zorder=0)
    above.set(ylabel="tip angle (deg)", yticks=range(0, 91, 15))
    below.set(xlabel="distance of the magnet's center (mm)", ylabel="residual (deg)")
    above.legend()
    return "\n".join(rows), figure


def kim_modes() -> tuple[str, None]:
    """Table of the other columns of Kim's guidewire, predicted from the fit of the first."""
    scene = load_scene(DATA / "scenes/kim_guidewire.yaml")
    path = DATA / "measured/kim2022_guidewire_modes.csv"
    columns = [f"{mode}-{phi}" for mode in ("attraction", "repulsion") for phi in (90, 120, 150)]
    known, _ = read_split([path], scene, "series=" + ",".join(columns[1:]))
    found = fit(known, scene, vary=["shear_modulus"], thorough=False)
    rows = [
        "| column | rms | largest | nearest four rows | the rest | rms with the magnet at phi |",
        "| --- " * 6 + "|",
    ]
    for column in columns[1:]:
        others = [one for one in columns[1:] if one != column]
        left = read_split([path], scene, "series=" + ",".join(others))[0]
        left = replace(left, states=left.states[len(known.states) :])
        errors = np.degrees(predict_held_out(found, left).found.residuals)
        behind = "the same"
        if column in ("repulsion-120", "repulsion-150"):
            behind = _rms(np.degrees(predict_held_out(found, _mirrored(left)).found.residuals))
        rows.append(
            f"| {column.replace('-', ', ')} deg | {_rms(errors)} | {np.abs(errors).max():.0f} deg | {_rms(errors[:4])} | "
            f"{_rms(errors[4:])} | {behind} |"
        )
    return "\n".join(rows), None


def _rms(values: Any) -> str:
    return f"{math.sqrt(np.mean(np.square(values))):.1f} deg"


def _mirrored(measured: Any) -> Any:
    """The table with the magnet behind the clamp in place of before it, or the other way round."""
    states = []
    for state in measured.states:
        there = state.apparatus.magnet
        axis = state.apparatus.axis
        turned = replace(
            state.apparatus,
            magnet=(-there[0], there[1], there[2]),
            axis=(-axis[0], axis[1], axis[2]),
        )
        states.append(replace(state, apparatus=turned))
    return replace(measured, states=tuple(states))


def _over_tip(measured: Any, length: float) -> Any:
    """The table as if the magnet's distance were measured from the tip of the undeformed wire, of a length (m), in place of the clamp."""
    moved = [
        (state, replace(state.apparatus, magnet=(length, 0.0, state.apparatus.magnet[2])))
        for state in measured.states
    ]
    return replace(
        measured, states=tuple(replace(state, apparatus=apparatus) for state, apparatus in moved)
    )


def tan() -> tuple[str, Figure]:
    """Tan's arch by published constants, along equilibria and in motion: the table, and the picture of how far its middle has come down."""
    with (DATA / "measured/tan_arch.csv").open() as file:
        read = [
            (row["series"], float(row["x"]), float(row["y_mm"])) for row in csv.DictReader(file)
        ]
    seen = {
        name: np.array([row[1:] for row in read if row[0] == name]).T
        for name in dict.fromkeys(row[0] for row in read)
    }
    rest, snap = _snapping("rotates")
    made = {
        f"step_{field}mT_ms": _in_motion([(1e-3, field)], duration)
        for field, duration in ((5, 0.2), (7, 0.3))
    }
    time, down, _ = _in_motion(ramp := [(0.1, 5.0), (0.1 + 3.0 / RATE, 8.0)], 0.37)
    made = {name: (1e3 * one[0], one[1]) for name, one in made.items()}
    made["ramp_mT"] = np.interp(time, *np.transpose([(0.0, 0.0), *ramp])), down
    texts = []
    for each in (seen, made):
        (x, y), fives, (field, way) = each["step_7mT_ms"], each["step_5mT_ms"][1], each["ramp_mT"]
        peak = int(np.argmax(y))
        trough = peak + int(np.argmin(y[peak : peak + np.searchsorted(x[peak:], x[peak] + 45.0)]))
        texts.append(
            [
                f"{field[np.argmax(way > 4.0)]:.2f} mT",
                f"{fives.max():.2f} mm{', snaps' if fives.max() > 4.0 else ', no snap'}",
                f"{y[peak]:.2f} mm after {x[peak]:.0f} ms",
                f"{2 * (x[trough] - x[peak]):.0f} ms",
            ]
        )
    names = (
        f"half way down, in a field that grows by {RATE:g} mT/s, at",
        "5 mT turned on: swings to",
        "7 mT turned on: first peak",
        "twice the time from that peak to the trough after it",
    )
    rows = [f"| {name} | {one} | {other} |" for name, one, other in zip(names, *texts, strict=True)]
    rows += [
        f"| 7 mT: settles at | {seen['step_7mT_ms'][1, -1]:.2f} mm | {rest:.2f} mm |",
        f"| snaps in a field that grows slowly, at | | {snap:.2f} mT |",
    ]
    rows[:0] = ["| | measured | computed |", "| --- | --- | --- |"]
    figure, panels_ = panels(apart=True)
    for axes, names_ in zip(panels_, (("step_7mT_ms", "step_5mT_ms"), ("ramp_mT",)), strict=True):
        for name, color in zip(names_, (BLUE, RED), strict=False):
            axes.plot(
                *made[name],
                color=color,
                label="computed" if name == "ramp_mT" else f"{name[5]} mT turned on",
            )
            dots = {"linestyle": "none", "marker": "o", "color": style.INK, "markersize": 4}
            axes.plot(*seen[name], **dots, label=None if name == "step_7mT_ms" else "measured")
        axes.set(ylabel="middle comes down by (mm)")
        axes.legend(loc="upper left" if "ramp_mT" in names_ else "center right")
    panels_[0].set(xlabel="time (ms)")
    panels_[1].set(xlabel=f"field (mT), growing by {RATE:g} mT/s from 5 mT on", xlim=(0.0, 7.0))
    return "\n".join(rows), figure


def _snapping(law: str) -> tuple[float, float]:
    """How far (mm) the middle of Tan's arch has come down at rest in 7 mT, and the field (mT) in which it snaps."""
    time, down, jumps = _middle(
        load_scene(DATA / "scenes/tan_arch.yaml").with_material(magnetization_law=law), 1.0
    )
    return float(np.interp(7.0, 8.0 * time, down)), 1e3 * float(jumps[-1]["field"])


def laws() -> tuple[str, None]:
    """Table of every measured case by both laws of magnetization: F Br (stretches), R Br (rotates)."""
    rows = [
        "| case | measure | stretches, F Br | rotates, R Br | they differ by | measurement tells |",
        "| --- " * 6 + "|",
    ]

    def row(
        case: str, measure: str, values: Any, unit: str, apart: float, tells: float, digits: int = 2
    ) -> None:
        texts = " | ".join(f"{value:.{digits}f} {unit}" for value in values)
        rows.append(f"| {case} | {measure} | {texts} | {apart:.2g} {unit} | {tells:g} {unit} |")

    both = [_reversed(law) for law in LAWS]
    for width in both[0][2]:
        tips = [100 * (found[width] - measured) for _, measured, found in both]
        rms = [math.sqrt(np.mean(tip**2)) for tip in tips]
        row(
            f"Zhao, reversed, {width}",
            "rms of the error",
            rms,
            "% of L",
            np.abs(tips[0] - tips[1]).max(),
            100 * SCATTER,
        )
    fits = []
    for law in LAWS:
        scene = load_scene(DATA / "scenes/kim_guidewire.yaml").with_material(magnetization_law=law)
        fits.append(
            fit(
                read_measured(DATA / "measured/kim2022_guidewire.csv", scene),
                scene,
                vary=["shear_modulus"],
                thorough=False,
            )
        )
    angles = np.degrees(np.abs(fits[0].residuals - fits[1].residuals).max())
    row(
        "Kim, free length 18 mm",
        "rms after the fit",
        [math.degrees(one.rms_rad) for one in fits],
        "deg",
        angles,
        0.5,
        3,
    )
    moduli = [1e-6 * one.constants[0].value for one in fits]
    half = 0.5e-6 * (fits[0].constants[0].high - fits[0].constants[0].low)
    row(
        "Kim, the same",
        "effective shear modulus",
        moduli,
        "MPa",
        abs(moduli[0] - moduli[1]),
        round(half, 1),
    )
    (rest, snap), (rest_, snap_) = (_snapping(law) for law in LAWS)
    row(
        "Tan, settles in 7 mT (8.05 mm measured)",
        "middle comes down by",
        (rest, rest_),
        "mm",
        abs(rest - rest_),
        0.05,
        3,
    )
    row(
        "Tan, snaps in a field that grows slowly",
        "field",
        (snap, snap_),
        "mT",
        abs(snap - snap_),
        0.1,
        3,
    )
    return "\n".join(rows), None


def _in_motion(frames: list[tuple[float, float]], duration: float) -> tuple[Any, Any, Any]:
    """`_middle` of Tan's arch in motion from 0.25 s on. frames: s from then, and mT; duration: s."""
    data = load_scene(DATA / "scenes/tan_arch_motion.yaml").to_si()
    key = data["field"]["over_time"]["keyframes"]
    tilt = key[-1]["uniform"][0] / key[-1]["uniform"][2]
    key[4:] = [
        {"time": 0.25 + at, "uniform": [1e-3 * tilt * field, 0.0, 1e-3 * field]}
        for at, field in frames
    ]
    data["solver"]["dynamic"]["duration"] = 0.25 + duration
    return _middle(Scene.from_si(data), 0.25)


def _middle(scene: Scene, since: float) -> tuple[Any, Any, Any]:
    """Times (k,) s since a moment (s), how far (k,) mm the middle of a strip has come down since, and jumps."""
    rows: list[tuple[float, float]] = []
    result = solve(
        scene,
        on_frame=lambda time, axis, *_: rows.append(
            (time, float(np.interp(scene.length / 2, axis[:, 0], axis[:, 3])))
        ),
    )
    time, z = np.transpose([row for row in rows if row[0] > since - 1e-9])
    return time - since, 1e3 * (z[0] - z), result.jumps


def panels(*, apart: bool = False) -> tuple[Figure, Any]:
    """A picture of two panels: numbers, and errors below them; or, apart, two of numbers."""
    with rc_context(LOOK):
        figure = Figure(figsize=(5.2, 4.6), layout="constrained")
        both = figure.subplots(
            2, 1, sharex=not apart, height_ratios=(1.0, 1.0) if apart else (2.4, 1.0)
        )
        for axes in both:
            axes.grid(True, color="#EEEEEE", linewidth=0.8)
            axes.set_axisbelow(True)
        both[1].axhline(0.0, color=style.FAINT_INK, linewidth=0.8)
        return figure, both


def main(*names: str) -> int:
    """Write the pictures, and the tables into the page."""
    cases = {
        "zhao": zhao,
        "perpendicular": perpendicular,
        "kim": kim,
        "kim_modes": kim_modes,
        "tan": tan,
        "laws": laws,
    }
    for name in names or cases:
        table, figure = cases[name]()
        print(table)
        if figure is not None:
            with rc_context(LOOK):
                saved(figure, IMAGES / f"measured_{name}.png")
        page = PAGE.read_text(encoding="utf-8")
        place = rf"(<!-- table: {name} -->\n).*?(\n?<!-- end -->)"
        PAGE.write_text(
            re.sub(
                place,
                lambda found, table=table: found[1] + table + "\n<!-- end -->",
                page,
                flags=re.S,
            ),
            encoding="utf-8",
        )
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
