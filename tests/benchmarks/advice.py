"""Advice of `magmpm effects` against runs with and without each effect on a finer grid, on scenes drawn at random: at rest and beside
walls on 4 cells, else in motion on 3.

make bench-advice: 40 scenes, every effect that each could have. A call is right if it says of an effect that it moves the answer by more
than the requested error, 1 % of the length, when the finer runs say so too. Effects for which the scene has no data (a rate, a wall) are no
calls. self_contact is not tried: it acts in motion alone, and on bodies that fold.

    python tests/benchmarks/advice.py [FIRST LAST]     # scenes FIRST to LAST - 1, added to runs/bench-advice/calls.jsonl
    python tests/benchmarks/advice.py report           # what these say
"""

import json
import math
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from magmpm.errors import MagmpmError
from magmpm.fields.dipole import MU0
from magmpm.materials import young_modulus
from magmpm.scene import Scene
from magmpm.solving.influence import Variants, variants
from magmpm.studies.explore.effects_table import survey

# fixed before the first run
SEED = 20261122
SCENES = 40
FOLDER = Path("runs/bench-advice")


def drawn(number: int) -> Scene:
    """A scene of the benchmark: of four, one at rest, one along equilibria, two in motion, of these one that is fed into a vessel."""
    draw = np.random.default_rng([SEED, number])

    def between(low: float, high: float) -> float:
        return float(np.exp(draw.uniform(np.log(low), np.log(high))))

    kind = ("static", "quasi_static", "motion", "fed")[number % 4] if number % 8 != 5 else "static"
    thickness = between(1e-3, 4e-3)
    shear = between(60e3, 400e3)
    density = between(1000.0, 2500.0)
    length = thickness * between(8, 20)
    remanence = 0.0 if kind == "fed" else between(0.02, 0.15)
    bending = young_modulus(shear, 20 * shear) * thickness**2 / 16  # over the area
    load = between(0.02, 3.0)
    strength = load * bending * MU0 / (max(remanence, 0.02) * length**2)
    direction = draw.normal(size=3)
    field: dict[str, Any] = {"uniform": (strength * direction / np.linalg.norm(direction)).tolist()}
    segments = [
        {"magnetization": draw.normal(size=3).tolist()} for _ in range(int(draw.integers(1, 4)))
    ]
    effects: dict[str, Any] = {"magnetic_torque": {}} if remanence else {}
    first = 3.516 * np.sqrt(bending / (density * length**4))
    solver: dict[str, Any] = {"static": {}}
    if kind == "quasi_static":
        field["over_time"] = {"ramp": {"duration": 0.1}}
        solver = {"quasi_static": {"steps": 4}}
    if kind in ("motion", "fed"):
        solver = {
            "dynamic": {"duration": 2 * np.pi / first * between(0.3, 1.0), "output_every": None}
        }
        effects["damping"] = {"rate": first * between(0.03, 3.0)}
    gravity = bool(draw.random() < 0.4)
    if gravity:
        effects["gravity"] = {}
    if kind == "motion" and draw.random() < 0.5:
        effects["ground"] = {
            "point": [0.0, 0.0, -thickness * between(0.55, 6.0)],
            "friction": float(draw.uniform(0, 0.5)),
        }
    if kind == "fed":
        duration = solver["dynamic"]["duration"]
        radius = thickness * between(0.8, 2.0)
        field = {"uniform": [0.0, 0.0, 0.0]}
        exit_ = 0.6 * length
        side = between(0.02, 1.0) * length
        effects["feed"] = {
            "speed": between(0.1, 0.5) * (exit_ - thickness) / duration,
            "exit": exit_,
        }
        path = [
            [-length, 0, 0],
            [0.5 * exit_, 0, 0],
            [exit_ + 0.3 * length, 0, 0.05 * side],
            [exit_ + length, 0, side],
        ]
        effects["walls"] = {
            "tube": {"radius": radius, "path": path},
            "friction": float(draw.uniform(0, 0.3)),
        }
    material = {
        "shear_modulus": shear,
        "bulk_to_shear": 20.0,
        "density": density,
        "remanence": remanence,
    }
    return Scene.from_si(
        {
            "name": f"advice {number} ({kind})",
            "materials": {"m": material},
            "field": field,
            "effects": effects,
            "solver": solver,
            "body": {
                "catheter": {
                    "length": length,
                    "diameter": thickness,
                    "material": "m",
                    "segments": segments,
                }
            },
            "resolution": {"cells_across": 2},
        }
    )


def calls(number: int) -> list[dict[str, Any]]:
    """One row for each effect that the scene could have: what was advised, and what the full runs say."""
    scene = drawn(number)
    out = []
    error = scene.allowed_error
    begun = time.perf_counter()
    table = survey(scene)
    seconds = time.perf_counter() - begun
    fine = Variants(scene, error, math.inf)
    finer = 2 if scene.static or scene.effects.walls is not None else 1
    for row in table.effects:
        both = variants(scene, row.effect)
        if isinstance(both, str) or row.effect == "self_contact":
            continue
        about = {
            "scene": number,
            "name": scene.name,
            "effect": row.effect,
            "named": row.named,
            "error": error,
            "seconds": seconds,
        }
        about |= {
            "advice": row.advice,
            "shift": row.shift_m,
            "uncertainty": row.uncertainty_m,
            "length": scene.length,
        }
        try:
            true = max(fine.frames(both[0], finer).distances(fine.frames(both[1], finer)).values())
        except MagmpmError as trouble:
            out.append({**about, "true": None, "why": str(trouble)[:200]})
            continue
        out.append(
            {**about, "true": true, "right": (true > error) == (row.advice in ("keep", "add"))}
        )
    return out


def report() -> None:
    """Summary of the calls so far."""
    rows = [json.loads(line) for line in (FOLDER / "calls.jsonl").read_text().splitlines()]
    done = [row for row in rows if row["true"] is not None]
    for row in done:
        if not row["right"]:
            given = (
                "-"
                if row["shift"] is None
                else f"{1e3 * row['shift']:.3g} +- {1e3 * row['uncertainty']:.2g}"
            )
            print(
                f"wrong: {row['name']:24} {row['effect']:21} {row['advice']:10} {given} mm, full"
                f" runs {1e3 * row['true']:.3g} mm, asked {1e3 * row['error']:.3g} mm"
            )
    right = sum(row["right"] for row in done)
    known = [row for row in done if row["shift"] is not None]
    within = [
        row
        for row in known
        if abs(row["shift"] - row["true"]) <= row["uncertainty"] + 1e-3 * row["length"]
    ]
    share = 100 / max(len(done), 1)
    print(
        f"{len({row['scene'] for row in rows})} scenes, {len(done)} calls, {len(rows) - len(done)}"
        " without a full run"
    )
    print(
        f"right: {right} = {share * right:.1f} %; true shift within the uncertainty (or 0.1 % of"
        f" L): {share * len(within):.0f} %"
    )


def main() -> None:
    """As the first lines of this file say."""
    given = sys.argv[1:]
    if given == ["report"]:
        report()
    else:
        first, last = (int(one) for one in given) if given else (0, SCENES)
        FOLDER.mkdir(parents=True, exist_ok=True)
        for number in range(first, last):
            with (FOLDER / "calls.jsonl").open("a") as stream:
                for row in calls(number):
                    stream.write(json.dumps(row) + "\n")
            print(number, flush=True)
        report()


if __name__ == "__main__":
    main()
