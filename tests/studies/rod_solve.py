"""A solve in milliseconds for tests of studies: the rod model instead of the solver, with a result that can be stored."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.inputs.csv_tables import write_centreline
from magmpm.rod.cosserat import solve_rod
from magmpm.scene import Scene

SCENE = """\
name: five segments
materials:
  magnetic: {shear_modulus: 120 kPa, bulk_to_shear: 20, density: 1882 kg/m^3, remanence: 138 mT}
body:
  catheter:
    length: 40 mm
    diameter: 4 mm
    material: magnetic
    segments:
      - magnetization: [1, 0, 0]
      - magnetization: [0, 1, 0]
      - magnetization: [0, 0, 1]
      - magnetization: [-1, 0, 0.5]
      - magnetization: [0, 0, -1]
field: {uniform: [0 mT, 6 mT, 8 mT]}
effects: {magnetic_torque: {}}
resolution: {cells_across: 4}
"""

STUDY = """\
scene: scene.yaml
vary:
  magnetization: {}
match: {centreline: target.csv}
trials: 8
sampler: random
seed: 3
"""


@dataclass
class RodResult:
    """The part of a Result that a study uses."""

    scene: dict[str, Any]
    centreline: Array
    converged: bool = True
    iterations: int = 4
    min_det_F: float = 0.9
    max_det_F: float = 1.1
    versions: dict[str, str] = field(default_factory=dict)

    def save(self, folder: Path | str) -> Path:
        Path(folder).mkdir(parents=True, exist_ok=True)
        data = {"scene": self.scene, "tip": self.centreline[-1, 1:].tolist()}
        (Path(folder) / "result.json").write_text(json.dumps(data))
        np.savez(Path(folder) / "state.npz", centreline=self.centreline)
        return Path(folder)


def solve(scene: Scene) -> RodResult:
    """Solves the rod model of the scene."""
    shape = solve_rod(scene, elements=20)
    s = np.linspace(
        0.0, scene.body.catheter.length, 41
    )  # rows at the faces and centers of cells, as the measures require
    return RodResult(scene.to_si(), np.column_stack([s, shape.at(s)]), iterations=shape.iterations)


def write_study(folder: Path, text: str = STUDY, scene: str | None = None) -> Path:
    """A study file with its scene and a target: a bend of 60 degrees with constant curvature. Returns its path."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scene.yaml").write_text(scene or SCENE)
    s = np.linspace(0.0, 0.04, 21)
    radius = 0.04 / np.deg2rad(60)
    bend = radius * (1 - np.cos(s / radius))
    write_centreline(
        folder / "target.csv", np.column_stack([s, radius * np.sin(s / radius), 0.6 * bend, 0.8 * bend])
    )
    path = folder / "probe.yaml"
    path.write_text(text)
    return path
