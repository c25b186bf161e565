"""Zhao's beam past buckling: equilibria over the field, their comparison in docs/gallery/zhao_beam.md, and its picture.

    python docs/gallery/zhao_beam.py [--motion [plane_strain] [width_5mm]]

Runs data/scenes/zhao_plane_strain.yaml and zhao_width_5mm.yaml at every field of data/references/zhao_beam.json, and varies what the
differences depend on (width, K/G): a minute or two. With --motion the dynamic solver also lets the beam swing and settle: some minutes more
in plane strain, half an hour with the width. Without it, the earlier numbers of the motion stay.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from magmpm.scene import Scene, load_scene
from magmpm.simulate import run
from magmpm.viz.plots import LOOK, saved

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs/gallery/zhao_beam.md"
PICTURE = ROOT / "docs/images/gallery/zhao_beam_fields.png"
NUMBERS = ROOT / "docs/gallery/zhao_beam.json"
# build.py has the marks of the measured table
BEGIN = "<!-- compared -->"
END = "<!-- /compared -->"
SCENES = {"plane_strain": "zhao_plane_strain", "width_5mm": "zhao_width_5mm"}
NAMES = {"plane_strain": "plane strain", "width_5mm": "5 mm wide"}
CURVE = (
    5.0,
    5.1,
    5.25,
    5.5,
    6.0,
    6.5,
    7.0,
    8.0,
    9.0,
    10.0,
    12.0,
    15.0,
    20.0,
    25.0,
    32.0,
    40.0,
)  # mT: points of the lines in the picture
MOTION_CELLS = 3  # through the thickness
# kg/m^3, 1/s: for the motion; its final state depends on neither
DENSITY = 1900.0
DAMPING = 80.0


def changed(scene: Scene, **changes: Any) -> Scene:
    """The scene with other settings of its strip (width, in m) or another K/G."""
    data = scene.to_si()
    ratio = changes.pop("bulk_to_shear", None)
    if ratio is not None:
        for material in data["materials"].values():
            material["bulk_to_shear"] = ratio
    data["body"]["strip"].update(changes)
    return Scene.from_si(data)


def tip_at(scene: Scene, field: float) -> tuple[float, float]:
    """Tip deflection and axial tip displacement, over the length, in a field (mT) opposite to the magnetization."""
    tip = run(scene.with_field([-1e-3 * field, 0.0, 0.0])).tip / scene.length
    return float(tip[2]), float(tip[0] - 1)


def settled(scene: Scene, field: float) -> tuple[float, float]:
    """The same after motion: a transverse field of a tenth selects the direction, then goes to zero, and the beam swings until it rests."""
    data = scene.with_cells(MOTION_CELLS).to_si()
    side = [-1e-3 * field, 0.0, 1e-4 * field]
    alone = [-1e-3 * field, 0.0, 0.0]
    for material in data["materials"].values():
        material["density"] = DENSITY
    data["effects"]["damping"] = {"rate": DAMPING}
    frames = [
        {"time": 0.0, "uniform": side},
        {"time": 0.04, "uniform": side},
        {"time": 0.05, "uniform": alone},
    ]
    data["field"] = {"uniform": alone, "over_time": {"keyframes": frames}}
    data["solver"]["dynamic"] = {"duration": 0.4 if field >= 10 else 0.8}
    tip = run(Scene.from_si(data)).tip / scene.length
    return float(tip[2]), float(tip[0] - 1)


def sweep(fields: list[float], motion: list[str]) -> dict[str, Any]:
    """All numbers of the page."""
    scenes = {key: load_scene(ROOT / f"data/scenes/{name}.yaml") for key, name in SCENES.items()}
    found: dict[str, Any] = {"field_mT": fields, "static": {}, "settled": {}, "variants": {}}
    found["curves"] = {}
    for key, scene in scenes.items():
        found["curves"][key] = [tip_at(scene.with_cells(2), field)[0] for field in CURVE]
        found["static"][key] = [tip_at(scene, field) for field in fields]
        if key in motion:
            found["settled"][key] = {
                "cells": MOTION_CELLS,
                "tip": [settled(scene, field) for field in fields[1:]],
            }
    some = (7.0, 15.0, 40.0)
    found["variants"]["fields_mT"] = some
    plane = scenes["plane_strain"]
    wide = scenes["width_5mm"].with_cells(2)
    cases = {
        "plane strain, K = 500 G": changed(plane, bulk_to_shear=500.0),
        "plane strain, K = 20 G": plane,
        **{
            f"{w:g} mm wide, K = 20 G": changed(wide, width=1e-3 * w)
            for w in (20.0, 10.0, 5.0, 2.5, 0.84)
        },
        "5 mm wide, K = 500 G": changed(wide, bulk_to_shear=500.0),
    }
    found["variants"]["deflection"] = {
        name: [tip_at(case, field)[0] for field in some] for name, case in cases.items()
    }
    return found


def draw(found: dict[str, Any], known: dict[str, Any]) -> Path:
    """Draw the picture: deflection against field."""
    published = known["published"]
    fem = known["finite_elements"]
    curves = found["curves"]
    x = known["field_mT"]
    points = [
        ("our finite elements, plane strain", fem["plane_strain"]["deflection"], "+", "#0077BB"),
        ("our finite elements, 5 mm wide", fem["width_5mm"]["deflection"], "x", "#EE7733"),
        ("experiment (Zhao et al.)", published["experiment"], "o", "#222222"),
        ("finite elements (Zhao et al.)", published["zhao_finite_elements"], "s", "#777777"),
        ("magneticMPM", published["magneticMPM"], "^", "#AA3377"),
    ]
    with rc_context(LOOK):
        figure = Figure(figsize=(6.4, 4.2), layout="constrained")
        axes = figure.subplots()
        axes.plot(
            CURVE,
            curves["plane_strain"],
            color="#0077BB",
            label="magmpm, plane strain",
            linewidth=1.5,
        )
        axes.plot(
            CURVE, curves["width_5mm"], color="#EE7733", label="magmpm, 5 mm wide", linewidth=1.5
        )
        for name, values, marker, color in points:
            y = np.array([np.nan if value is None else float(value) for value in values])
            face = color if marker in "x+" else "white"
            axes.plot(x, y, marker, color=color, label=name, markersize=6, markerfacecolor=face)
        axes.grid(True, color="#EEEEEE", linewidth=0.8, zorder=0)
        axes.set_axisbelow(True)
        axes.set_xlabel("field opposite to the magnetization (mT)")
        axes.set_ylabel("deflection of the tip over the length")
        axes.legend(loc="best")
        axes.set_title("Zhao's beam")
        return saved(figure, PICTURE)


def tables(found: dict[str, Any], known: dict[str, Any]) -> list[str]:
    """The lines of the measured section of the page."""
    fields = found["field_mT"]
    rows: list[tuple[str, list[float | None]]] = []
    for key, name in NAMES.items():
        rows.append((f"**magmpm, {name}**", [d for d, _ in found["static"][key]]))
        rows.append((f"our finite elements, {name}", known["finite_elements"][key]["deflection"]))
        if key in found["settled"]:
            rows.append(
                (
                    f"magmpm, {name}, {_motion(found, key)}",
                    [None, *[d for d, _ in found["settled"][key]["tip"]]],
                )
            )
    rows += [
        ("experiment (Zhao et al.)", known["published"]["experiment"]),
        ("finite elements (Zhao et al.)", known["published"]["zhao_finite_elements"]),
        ("magneticMPM", known["published"]["magneticMPM"]),
        ("elastica, 3 G", known["elastica"]["3G"]),
        ("elastica, 4 G", known["elastica"]["4G"]),
    ]
    lines = [
        "Tip deflection over the length:",
        "",
        f"| field (mT) | {' | '.join(f'{x:g}' for x in fields)} |",
    ]
    lines += ["| --- |" + " --- |" * len(fields)]
    lines += [
        f"| {name} | {' | '.join('' if v is None else f'{v:.4g}' for v in values)} |"
        for name, values in rows
    ]
    lines += [
        "",
        "Largest errors against our finite elements from 7 mT up, in percent of the length:",
        "",
    ]
    lines += ["| | across the beam | along it |", "| --- | --- | --- |"]
    for key, name in NAMES.items():
        fem = known["finite_elements"][key]
        for label, ours in (("statics", found["static"][key][1:]), *_settled(found, key)):
            errors = [
                max(abs(a[k] - b) for a, b in zip(ours, fem[what][1:], strict=True))
                for k, what in enumerate(("deflection", "axial"))
            ]
            lines.append(f"| {name}, {label} | {100 * errors[0]:.2f} | {100 * errors[1]:.2f} |")
    some = found["variants"]["fields_mT"]
    lines += [
        "",
        "What the deflection depends on (statics; widths with 2 cells through the thickness):",
        "",
    ]
    lines += [
        f"| field (mT) | {' | '.join(f'{x:g}' for x in some)} |",
        "| --- |" + " --- |" * len(some),
    ]
    lines += [
        f"| {name} | {' | '.join(f'{v:.4f}' for v in values)} |"
        for name, values in found["variants"]["deflection"].items()
    ]
    return lines


def _motion(found: dict[str, Any], key: str) -> str:
    return f"settled motion, {found['settled'][key]['cells']} cells"


def _settled(found: dict[str, Any], key: str) -> list[tuple[str, list[tuple[float, float]]]]:
    return [(_motion(found, key), found["settled"][key]["tip"])] if key in found["settled"] else []


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--motion",
        nargs="*",
        choices=list(SCENES),
        help="also compute the settled motion, for both scenes or for those named",
    )
    options = parser.parse_args()
    known = json.loads((ROOT / "data/references/zhao_beam.json").read_text(encoding="utf-8"))
    motion = [] if options.motion is None else options.motion or list(SCENES)
    found = sweep(known["field_mT"], motion)
    if NUMBERS.exists():
        found["settled"] = {
            **json.loads(NUMBERS.read_text(encoding="utf-8"))["settled"],
            **found["settled"],
        }
    NUMBERS.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    PICTURE.parent.mkdir(parents=True, exist_ok=True)
    draw(found, known)
    before, rest = PAGE.read_text(encoding="utf-8").split(BEGIN, 1)
    block = "\n".join([BEGIN, "", *tables(found, known), "", END])
    PAGE.write_text(before + block + rest.split(END, 1)[1], encoding="utf-8")
    print(f"saved {PAGE} and {PICTURE}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
