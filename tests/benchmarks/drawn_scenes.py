"""Scenes drawn at random for tests/benchmarks/promised_error.py: catheters, tubes and strips; bodies of soft and stiff segments; paths.

Also the command line of the benchmarks over their seeds, and the rows that these keep.
"""

import argparse
import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from magmpm.fields.dipole import MU0
from magmpm.materials import young_modulus
from magmpm.scene import Scene

# T, kg/m^3
REMANENCE = 0.12
DENSITY = 1900.0
STRONGEST = 5.0  # M B A L^2/(E I): at 5 a catheter across the field points along it
Row = dict[str, Any]
# of the true error over the promised one
BOUNDS = (0.3, 1.0)
WORST = 1.5


def options_of(
    about: str | None,
    first: int,
    scenes: int,
    out: str,
    jointed: bool = False,
    cells: bool = False,
) -> argparse.Namespace:
    """The options of a benchmark over seeds; out: a file in runs/bench; jointed: whether bodies can be of soft and stiff segments; cells:
    whether the cells across can be given."""
    parser = argparse.ArgumentParser(
        description=about, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    if jointed:
        parser.add_argument("--jointed", action="store_true")
    if cells:
        parser.add_argument("--cells", type=int)
    parser.add_argument("--first", type=int, default=first)
    parser.add_argument("--scenes", type=int, default=scenes)
    parser.add_argument("--out", type=Path, default=Path("runs/bench") / out)
    return parser.parse_args()


def rows_of(
    options: argparse.Namespace,
    made: Callable[[int], Row],
    line: Callable[[Row], str],
    seeds: Iterable[int] | None = None,
) -> list[Row]:
    """A row for each seed, by default `scenes` from `first`: from the file, or made, saved and printed now."""
    rows = json.loads(options.out.read_text()) if options.out.exists() else []
    done = {row["seed"] for row in rows}
    options.out.parent.mkdir(parents=True, exist_ok=True)
    for seed in seeds or range(options.first, options.first + options.scenes):
        if seed not in done:
            rows.append(made(seed))
            options.out.write_text(json.dumps(rows, indent=1) + "\n")
            print(line(rows[-1]), flush=True)
    return rows


def shares(ratio: np.ndarray) -> str:
    """How true errors over promised ones are spread."""
    inside = (ratio >= BOUNDS[0]) & (ratio <= BOUNDS[1])
    return (
        f"true/promised in {BOUNDS} in {100 * inside.mean():.0f} %, above {WORST}:"
        f" {(ratio > WORST).sum()}, above 1: {(ratio > 1).sum()}, below {BOUNDS[0]}:"
        f" {(ratio < BOUNDS[0]).sum()}, median {np.median(ratio):.2f}, largest {ratio.max():.2f}"
    )


def drawn(seed: int) -> Scene:
    """The scene of a seed: L/D 3 to 80, K/G 5 to 500, one to six segments, a uniform field or that of a magnet, with or without gravity."""
    draw = np.random.default_rng([20260, seed])

    def between(low: float, high: float) -> float:
        return float(np.exp(draw.uniform(np.log(low), np.log(high))))

    kind = ("catheter", "tube", "strip")[int(draw.integers(3))]
    thickness = between(0.5e-3, 4e-3)
    slenderness = between(3, 80)
    ratio = between(5, 500)
    shear = between(50e3, 1e6)
    length = slenderness * thickness
    wide = between(1, 6)
    bore = float(draw.uniform(0.2, 0.8))
    width = min(wide, max(slenderness / 2, 1.0)) * thickness
    second = (
        thickness**4 / 12 * (width / thickness)
        if kind == "strip"
        else np.pi / 64 * thickness**4 * (1 - bore**4 * (kind == "tube"))
    )
    area = (
        width * thickness
        if kind == "strip"
        else np.pi / 4 * thickness**2 * (1 - bore**2 * (kind == "tube"))
    )
    bending = young_modulus(shear, ratio * shear) * second
    load = between(0.1, STRONGEST)
    field = _direction(draw) * load * bending * MU0 / (REMANENCE * area * length**2)
    materials = {
        "magnetic": {
            "shear_modulus": shear,
            "bulk_to_shear": ratio,
            "density": DENSITY,
            "remanence": REMANENCE,
        }
    }
    segments: list[dict[str, Any]] = [
        {"magnetization": _direction(draw).tolist()} for _ in range(int(draw.integers(1, 7)))
    ]
    if len(segments) > 2 and draw.random() < 0.25:  # one stiffer, plain
        materials["plain"] = {
            **materials["magnetic"],
            "shear_modulus": shear * between(1, 5),
            "remanence": 0.0,
        }
        segments[int(draw.integers(len(segments)))] = {
            "magnetization": [0.0, 0.0, 0.0],
            "material": "plain",
        }
    segments = [{**segment, "length": length / len(segments)} for segment in segments]
    effects: dict[str, Any] = {"magnetic_torque": {}}
    if draw.random() < 0.4:  # weight that bends as much as a field could, at most
        pull = between(0.1, STRONGEST) * bending / (DENSITY * area * length**3)
        effects["gravity"] = {"acceleration": (min(pull, 9.81) * _direction(draw)).tolist()}
    body: dict[str, Any] = {"length": length, "material": "magnetic", "segments": segments}
    if kind == "strip":
        body |= {"width": width, "thickness": thickness}
    else:
        body |= {
            "diameter": thickness,
            "inner_diameter": bore * thickness if kind == "tube" else 0.0,
        }
    content = {
        "name": f"drawn {seed} ({kind})",
        "materials": materials,
        "body": {"strip" if kind == "strip" else "catheter": body},
        "field": {"uniform": field.tolist()},
        "effects": effects,
    }
    return Scene.from_si(content)


def jointed(seed: int) -> Scene:
    """The scene of a seed: two to five segments of any length, by turns soft and 2 to 200 times as stiff, in a uniform field.

    Even seeds are strips in plane strain (L/D 4 to 25), odd ones catheters (4 to 14); K/G 5 to 100; the field bends the soft segments.
    """
    draw = np.random.default_rng([77, seed])
    flat = seed % 2 == 0

    def between(low: float, high: float) -> float:
        return float(np.exp(draw.uniform(np.log(low), np.log(high))))

    def direction() -> Any:
        found = draw.normal(size=3) * [1.0, 0.0 if flat else 1.0, 1.0]
        return found / np.linalg.norm(found)

    thickness = between(0.5e-3, 4e-3)
    length = (between(4, 25) if flat else between(4, 14)) * thickness
    ratio = between(5, 100)
    shear = between(50e3, 500e3)
    contrast = between(2, 200)
    shares = draw.dirichlet([4] * int(draw.integers(2, 6)))
    stiff = [(k + int(first)) % 2 == 1 for first in [draw.integers(2)] for k in range(len(shares))]
    width = thickness * between(1, 4)
    load = between(0.1, STRONGEST)
    soft_share = sum(share for share, rigid in zip(shares, stiff, strict=True) if not rigid)
    bending = young_modulus(shear, ratio * shear) * thickness**2 / (12 if flat else 16) / soft_share
    field = direction() * load * bending * MU0 / (REMANENCE * length**2)
    soft = {
        "shear_modulus": shear,
        "bulk_to_shear": ratio,
        "density": DENSITY,
        "remanence": REMANENCE,
    }
    materials = {
        "soft": soft,
        "stiff": {
            **soft,
            "shear_modulus": contrast * shear,
            "remanence": REMANENCE * int(draw.random() < 0.5),
        },
    }
    segments = [
        {
            "length": float(share) * length,
            "material": "stiff" if rigid else "soft",
            "magnetization": direction().tolist(),
        }
        for share, rigid in zip(shares, stiff, strict=True)
    ]
    for segment in segments:
        if not materials[segment["material"]]["remanence"]:
            segment["magnetization"] = [0.0, 0.0, 0.0]
    body = {"length": length, "material": "soft", "segments": segments}
    body |= (
        {"width": width, "thickness": thickness, "plane_strain": True}
        if flat
        else {"diameter": thickness}
    )
    content = {
        "name": f"jointed {seed} ({'strip' if flat else 'catheter'})",
        "materials": materials,
        "effects": {"magnetic_torque": {}},
    }
    return Scene.from_si(
        {
            **content,
            "body": {"strip" if flat else "catheter": body},
            "field": {"uniform": field.tolist()},
        }
    )


def along_path(seed: int) -> Scene:
    """The body of the drawn scene with that seed, cut to L/D 4 to 12, along a path: by turns in uniform fields, the scene's own turned and
    1 to 1/10 as strong, and near a dipole that moves at a distance of 2 to 4 lengths around the tip, as strong as that at 2.5.
    """
    draw = np.random.default_rng([78, seed])
    plain = drawn(seed)
    data = plain.to_si()
    thickness = plain.thickness
    length = float(np.clip(plain.length, 4 * thickness, 12 * thickness))
    shape = next(one for one in data["body"].values() if one is not None)
    shape["segments"] = [
        {**segment, "length": segment["length"] * length / plain.length}
        for segment in shape["segments"]
    ]
    shape["length"] = length
    strength = float(np.linalg.norm(data["field"]["uniform"])) * (plain.length / length) ** 2
    times = np.arange(int(draw.integers(3, 7)), dtype=float)
    if seed % 2 == 0:
        frames = [
            {"time": t, "uniform": (strength * draw.uniform(0.1, 1) * _direction(draw)).tolist()}
            for t in times
        ]
        field: dict[str, Any] = {
            "uniform": frames[0]["uniform"],
            "over_time": {"keyframes": frames},
        }
    else:
        moment = strength * (2.5 * length) ** 3 * 2 * np.pi / MU0 * _direction(draw)
        away = [_direction(draw) for _ in times]
        places = [
            np.array([length, 0.0, 0.0])
            + length * draw.uniform(2, 4) * np.array([abs(d[0]), d[1], d[2]])
            for d in away
        ]
        frames = [
            {"time": t, "move": place.tolist()} for t, place in zip(times, places, strict=True)
        ]
        field = {
            "dipole": {"position": [0.0, 0.0, 0.0], "moment": moment.tolist()},
            "over_time": {"keyframes": frames},
        }
        data["effects"]["magnetic_force"] = {}
    share = float(np.exp(draw.uniform(np.log(5e-4), np.log(2e-1))))
    of = ("centreline", "tip")[int(draw.random() < 0.5)]
    solver = {**data["solver"], "quasi_static": {"steps": int(draw.integers(8, 20))}}
    return Scene.from_si(
        {
            **data,
            "field": field,
            "solver": solver,
            "resolution": {"error": share, "of": of},
            "name": f"path {seed}",
        }
    )


def _direction(draw: np.random.Generator) -> Any:
    """A direction, all alike likely: (3,)."""
    found = draw.normal(size=3)
    return found / np.linalg.norm(found)
