"""`make bench-bounds`: does a design become worse where the field may be stronger? Drawn bodies and targets that bend strongly.

    python tests/benchmarks/larger_bounds.py [--targets 40] [--seeds 3] [--bodies N]

Each target is drawn from its number, before anything is solved: a catheter or a strip, L/D 8 to 20, of two to four equal segments, half of
them with gravity; and a smooth curve that turns by 100 to 200 degrees in all, most of it anywhere along the body, given by as many points
as there are segments, or up to twice as many. The five bounds of the field are those whose loads, M B A L^2/(E I), are LOADS: in the first
few of these targets can be reached, and the straight body has several equilibria in all of them.

Every (target, seed) is searched within each bound on rods; with --bodies N the first N targets are also searched by studies of bodies
(gauss-newton, TRIALS trials, 2 cells across). *Worse* is an rms above 1.05 times the least of the smaller bounds and above that by FLOOR of
the length, which is what a rod, or a body of 2 cells, is known to anyway. Both counts are printed, with and without that floor.
Results are kept in runs/bench/larger_bounds.json, a row for each target and seed; rows that are there are not made again.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import machine
import numpy as np
from scipy.spatial.transform import Rotation

from magmpm.fields.dipole import MU0
from magmpm.materials import young_modulus
from magmpm.results.whole_file import write_json
from magmpm.scene import Scene
from magmpm.simulate import run, sensitivities
from magmpm.studies.engine.loop import run_study
from magmpm.studies.problem.study import Study
from magmpm.studies.problem.variables import Vary, VaryDirections, VaryField
from magmpm.studies.rods.rod_designs import rod_designs

LOADS = (4.4, 5.5, 6.6, 7.7, 8.8)
RATIO = 1.05
FLOOR = 1e-3
TRIALS = 6
PIECES = 1200  # of the curve
OUT = machine.ROOT / "runs/bench/larger_bounds.json"


def drawn(number: int) -> tuple[Scene, np.ndarray, list[float]]:
    """The scene of a number, its target (m, 4) m, rows [s, x, y, z], and the bounds of the field, T."""
    draw = np.random.default_rng([4605, number])

    def between(low: float, high: float) -> float:
        return float(np.exp(draw.uniform(np.log(low), np.log(high))))

    strip = bool(draw.integers(2))
    thickness = between(0.8e-3, 4e-3)
    length = between(8, 20) * thickness
    width = thickness * between(1.5, 4) if strip else thickness
    shear = between(50e3, 200e3)
    remanence = between(0.05, 0.2)
    segments = int(draw.integers(2, 5))
    area = width * thickness if strip else np.pi / 4 * thickness**2
    second = width * thickness**3 / 12 if strip else np.pi / 64 * thickness**4
    unit = young_modulus(shear, 20 * shear) * second * MU0 / (remanence * area * length**2)
    bounds = [float(load * unit) for load in LOADS]
    body: dict[str, Any] = {"length": length, "material": "magnetic"}
    body["segments"] = [
        {"magnetization": [1.0, 0.0, 0.0], "length": length / segments} for _ in range(segments)
    ]
    body |= (
        {"width": width, "thickness": thickness}
        if strip
        else {"diameter": thickness, "inner_diameter": 0.0}
    )
    effects: dict[str, Any] = {"magnetic_torque": {}}
    if draw.random() < 0.5:
        effects["gravity"] = {"acceleration": [0.0, 0.0, -9.81]}
    content = {
        "name": f"drawn {number}",
        "materials": {
            "magnetic": {
                "shear_modulus": shear,
                "bulk_to_shear": 20,
                "density": 1900.0,
                "remanence": remanence,
            }
        },
        "body": {"strip" if strip else "catheter": body},
        "field": {"uniform": [0.0, 0.0, bounds[0]]},
        "effects": effects,
        "resolution": {"cells_across": 2},
    }
    curve = _curve(draw, length, strip)
    points = int(draw.integers(segments, 2 * segments + 1))
    rows = np.round(np.linspace(0, PIECES, points + 1)).astype(int)[1:]
    return Scene.from_si(content), curve[rows], bounds


def _curve(draw: np.random.Generator, length: float, strip: bool) -> np.ndarray:
    """Rows [s, x, y, z], (PIECES + 1, 4) m. A strip bends across its thickness, toward +z or -z; a catheter's plane turns along it."""
    turn = np.deg2rad(draw.uniform(100, 200))
    middle = draw.uniform(0.25, 0.75)
    wide = draw.uniform(0.15, 0.5)
    place = (np.arange(PIECES) + 0.5) / PIECES
    size = np.exp(-0.5 * ((place - middle) / wide) ** 2)
    angles = turn * size / size.sum()  # of each piece
    if strip:
        plane = np.full(PIECES, np.pi / 2 * (1 + 2 * draw.integers(2)))
    else:
        plane = draw.uniform(0, 2 * np.pi) + np.deg2rad(draw.uniform(-60, 60)) * place
    frame = np.eye(3)
    rows = [np.zeros(4)]
    for k in range(PIECES):
        axis = -np.sin(plane[k]) * frame[:, 1] + np.cos(plane[k]) * frame[:, 2]
        half = Rotation.from_rotvec(angles[k] / 2 * axis).as_matrix()
        frame = half @ frame
        point = rows[-1][1:] + length / PIECES * frame[:, 0]
        frame = half @ frame
        rows.append(np.array([(k + 1) * length / PIECES, *point]))
    return np.array(rows)


def by_rods(number: int, seed: int) -> list[float | None]:
    """The least rms (m) that rods reach within each bound."""
    scene, target, bounds = drawn(number)
    found: list[float | None] = []
    for bound in bounds:
        designs = rod_designs(scene, target, scene.magnetized_regions(), bound, seed=seed)
        found.append(min((design.rms for design in designs), default=None))
    return found


def by_bodies(number: int, seed: int) -> list[float | None]:
    """The least rms (m) of a study within each bound."""
    scene, target, bounds = drawn(number)
    found: list[float | None] = []
    for bound in bounds:
        vary = Vary(magnetization=VaryDirections(), field=VaryField(max=bound))
        study = Study(
            Path("drawn.yaml"), "drawn", scene, target, vary, TRIALS, "gauss-newton", seed, None
        )
        with tempfile.TemporaryDirectory() as folder:
            best = run_study(study, solve=run, differentiate=sensitivities, out=folder).best
        found.append(None if best is None else best["rms_m"])
    return found


def worse(rms: list[float | None], length: float, floor: float) -> list[int]:
    """Places of the bounds within which the design is worse than within a smaller one."""
    places = []
    least = np.inf
    for k, value in enumerate(rms):
        here = np.inf if value is None else value
        if here > RATIO * least and here > least + floor * length:
            places.append(k)
        least = min(least, here)
    return places


def made(kind: str, number: int, seed: int) -> dict[str, Any]:
    """The row of a target and a seed."""
    begun = time.process_time()
    rms = by_rods(number, seed) if kind == "rods" else by_bodies(number, seed)
    scene = drawn(number)[0]
    row = {
        "kind": kind,
        "target": number,
        "seed": seed,
        "body": scene.body.kind,
        "length_m": scene.length,
        "rms_m": rms,
    }
    return {**row, "cpu_s": round(time.process_time() - begun, 2)}


def described(row: dict[str, Any]) -> str:
    """A row as a line."""
    shares = ", ".join(
        "none" if rms is None else f"{100 * rms / row['length_m']:.2f}" for rms in row["rms_m"]
    )
    places = worse(row["rms_m"], row["length_m"], FLOOR)
    verdict = f"; worse at load {', '.join(f'{LOADS[k]:g}' for k in places)}" if places else ""
    return (
        f"{row['kind']}, target {row['target']} ({row['body']}), seed {row['seed']}: rms {shares} %"
        f" of the length{verdict}"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--targets", type=int, default=40)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument(
        "--bodies", type=int, default=0, help="so many of the targets also by studies of bodies"
    )
    options = parser.parse_args()
    rows = json.loads(OUT.read_text()) if OUT.exists() else []
    known = {(row["kind"], row["target"], row["seed"]): row for row in rows}
    OUT.parent.mkdir(parents=True, exist_ok=True)
    status = 0
    for kind, targets in (("rods", options.targets), ("bodies", options.bodies)):
        counted = []
        for number in range(targets):
            for seed in range(1, options.seeds + 1):
                key = (kind, number, seed)
                if key not in known:
                    known[key] = made(*key)
                    write_json(OUT, list(known.values()))
                    print(described(known[key]), flush=True)
                counted.append(known[key])
        count = sum(len(worse(row["rms_m"], row["length_m"], FLOOR)) for row in counted)
        every = sum(len(worse(row["rms_m"], row["length_m"], 0.0)) for row in counted)
        if counted:
            print(
                f"{kind}: {targets} targets, {options.seeds} seeds, {len(LOADS)} bounds: worse by"
                f" more than {100 * RATIO - 100:.0f} % within a larger bound: {count}; counting"
                f" those within {100 * FLOOR:g} % of the length too: {every}"
            )
        status = status or int(count > 0)
    return status


if __name__ == "__main__":
    sys.exit(main())
