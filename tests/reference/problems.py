"""Validation problems: each a scene at any cell size, and an independent answer.

for name, problem in finite_element_problems(Path("data/references/fem.json")).items():
    result = run(problem.scene(cells_across=4))
    print(name, largest_distance(result, problem.centreline) / problem.length)
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import InputError
from magmpm.inputs.csv_tables import read_centreline
from magmpm.scene import Scene

# Pa, K/G, T: of the problems that are made here
SHEAR = 120e3
RATIO = 20.0
REMANENCE = 0.1


@dataclass(frozen=True)
class Problem:
    """One problem. centreline: rows [s, x, y, z] (m, 4) m; error: of the answer itself, over the length."""

    name: str
    content: dict[str, Any]  # Scene.to_si() but for the resolution
    centreline: Array
    error: float

    @property
    def length(self) -> float:
        """Length of the catheter, m."""
        return float(self.content["body"]["catheter"]["length"])

    def scene(self, cells_across: int, anti_locking: str = "f-bar", **static: Any) -> Scene:
        """The scene at this resolution; anti_locking: of `solver`; static: settings of `solver.static`."""
        solver = {"anti_locking": anti_locking, "static": static}
        return Scene.from_si(
            {**self.content, "resolution": {"cells_across": cells_across}, "solver": solver}
        )


def finite_element_problems(path: Path) -> dict[str, Problem]:
    """The problems of data/references/fem.json or jointed_catheters.json (their SOURCES.md says what the keys mean).

    Raises InputError when the file or a table it names can't be read."""
    try:
        cases = json.loads(path.read_text(encoding="utf-8"))["cases"]
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path}: can't be read as finite-element references ({error})") from None
    return {name: _finite_element_problem(name, case, path.parent) for name, case in cases.items()}


def _finite_element_problem(name: str, case: dict[str, Any], folder: Path) -> Problem:
    materials = {}
    segments = []
    for segment in case["segments"]:
        material = f"G {segment['shear_modulus']:g} Pa, Br {segment['remanence']:g} T"
        own = {key: segment[key] for key in ("shear_modulus", "remanence")}
        materials[material] = own | {key: case[key] for key in ("bulk_to_shear", "density")}
        direction = segment["direction"] if segment["remanence"] else [0.0, 0.0, 0.0]
        segments.append(
            {"magnetization": direction, "material": material, "length": segment["length"]}
        )
    effects: dict[str, Any] = {}
    if any(case["field"]):
        effects["magnetic_torque"] = {}
    if any(case["gravity"]):
        effects["gravity"] = {"acceleration": case["gravity"]}
    sizes = {key: case[key] for key in ("length", "diameter", "inner_diameter")}
    body = {"catheter": {**sizes, "material": next(iter(materials)), "segments": segments}}
    content = {
        "name": name,
        "materials": materials,
        "body": body,
        "field": {"uniform": case["field"]},
        "effects": effects,
    }
    error = 1e-3 * case["centreline_error_mm"] / case["length"]
    rows = case["centreline"]  # a table's name, or the rows themselves in mm
    centreline = read_centreline(folder / rows) if isinstance(rows, str) else 1e-3 * np.array(rows)
    return Problem(name, content, centreline, error)
