"""A solve in milliseconds for tests of studies: the rod in place of the solver, with a result that can be kept."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from magmpm.basis import Array
from magmpm.rod import solve_rod
from magmpm.scene import Scene
from magmpm.tables import write_centreline

SCENES = Path(__file__).parents[2] / "data" / "scenes"

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
    """As much of a Result as a study uses."""

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
        return Path(folder)


def solve(scene: Scene) -> RodResult:
    """The scene's rod, as a result."""
    shape = solve_rod(scene, elements=20)
    s = np.linspace(
        0.0, scene.body.catheter.length, 41
    )  # rows at cells' faces and middles, as measures want them
    return RodResult(scene.to_si(), np.column_stack([s, shape.at(s)]), iterations=shape.iterations)


def write_study(folder: Path, text: str = STUDY, scene: str | None = None) -> Path:
    """A study file with its scene and a target: a bend of 60 degrees with constant curvature. Returns its path."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scene.yaml").write_text(scene or (SCENES / "five_segments.yaml").read_text())
    s = np.linspace(0.0, 0.04, 21)
    radius = 0.04 / np.deg2rad(60)
    bend = radius * (1 - np.cos(s / radius))
    write_centreline(
        folder / "target.csv", np.column_stack([s, radius * np.sin(s / radius), 0.6 * bend, 0.8 * bend])
    )
    path = folder / "probe.yaml"
    path.write_text(text)
    return path
