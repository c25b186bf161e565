"""A solve in milliseconds for tests of studies: the rod model instead of the solver, with a result that can be stored."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from magmpm.bodies.curves import on_rows
from magmpm.compiled.arrays import Array
from magmpm.inputs.csv_tables import write_centreline
from magmpm.rod.cosserat import RodShape, rod_model, solve_rod
from magmpm.rod.family import RodFamily
from magmpm.scene import Scene
from magmpm.scene.variables import Variable, variables

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
    stability: float | None = 0.5
    segment_center: Array = field(default_factory=lambda: np.zeros((0, 3)))
    segment_remanence: Array = field(default_factory=lambda: np.zeros((0, 3)))

    def save(self, folder: Path | str) -> Path:
        Path(folder).mkdir(parents=True, exist_ok=True)
        data = {"scene": self.scene, "tip": self.centreline[-1, 1:].tolist()}
        (Path(folder) / "result.json").write_text(json.dumps(data))
        np.savez(Path(folder) / "state.npz", centreline=self.centreline)
        return Path(folder)


def solve(scene: Scene, *, start: RodShape | None = None) -> RodResult:
    """Solves the rod model of the scene; start: near this shape, not on the branch that grows from zero load."""
    shape = solve_rod(scene, elements=20) if start is None else _near(scene, start)
    s = np.linspace(
        0.0, scene.body.catheter.length, 41
    )  # rows at the faces and centers of cells, as the measures require
    return RodResult(scene.to_si(), np.column_stack([s, shape.at(s)]), iterations=shape.iterations)


def _near(scene: Scene, start: RodShape) -> RodShape:
    """The rod's equilibrium near a shape."""
    family, directions = _family(scene)
    q = _quaternions(family, start)
    assert family.relaxed(q, directions, np.zeros((1, 3)))[2].all()
    return family.shape(q[0], directions[0], np.zeros(3))


def _family(scene: Scene) -> tuple[RodFamily, Array]:
    """The rod of 20 elements, and the directions (1, k, 3) of its magnetized segments."""
    regions = scene.magnetized_regions()
    family = RodFamily.of(rod_model(scene, 20), scene.body.catheter.segment_lengths(), regions)
    return family, np.array([scene.regions()[i].magnetization for i in regions])[None]


def _quaternions(family: RodFamily, shape: RodShape) -> Array:
    """The frames of a shape at a family's, as quaternions (1, n + 1, 4), scalar first, neighbors of one sign."""
    q = Rotation.from_matrix(shape.frames).as_quat()[:, [3, 0, 1, 2]]
    signs = np.cumprod(np.where(np.sum(q[1:] * q[:-1], axis=1) < 0, -1.0, 1.0))
    q[1:] *= signs[:, None]
    at = np.concatenate([[0.0], np.cumsum(family.rod.length)])
    q = np.stack([np.interp(at, shape.s, column) for column in q.T], axis=1)
    return (q / np.linalg.norm(q, axis=1)[:, None])[None]


@dataclass
class RodSensitivities:
    """The part of magmpm.Sensitivities that a study uses."""

    result: RodResult
    variables: tuple[Variable, ...]
    centreline: Array

    def at(self, s: Array) -> Array:
        rows = self.centreline.reshape(len(self.centreline), -1)
        return on_rows(self.result.centreline[:, 0], rows, s)[0].reshape(
            len(s), *self.centreline.shape[1:]
        )


def differentiate(
    scene: Scene, of: Sequence[str], *, start: RodShape | None = None
) -> RodSensitivities:
    """As `solve`, with the rod's own derivatives by directions and the field."""
    found = variables(scene, of)
    regions = scene.magnetized_regions()
    family, directions = _family(scene)
    quaternions = family.straight(1) if start is None else _quaternions(family, start)
    for share in (
        np.linspace(0, 1, 7)[1:] if start is None else [1.0]
    ):  # as solve_rod: on the branch that grows from zero load
        _, slopes, stable = family.relaxed(quaternions, directions, np.zeros((1, 3)), share=share)
    assert stable.all()
    columns = []
    for variable in found:
        place = 3 * (len(regions) if variable.kind == "field" else regions.index(variable.region))
        along = (
            np.eye(3)[variable.component]
            if variable.kind == "field"
            else np.array(variable.direction)
        )
        columns.append(slopes[0, :, :, place : place + 3] @ along)
    result = solve(scene, start=start)
    of_rod = np.concatenate([[0.0], np.cumsum(family.rod.length)])
    of_rows = result.centreline[:, 0]
    rows = [
        np.stack([np.interp(of_rows, of_rod, column[:, i]) for i in range(3)], axis=1)
        for column in columns
    ]
    return RodSensitivities(result, found, np.stack(rows, axis=2))


def write_study(folder: Path, text: str = STUDY, scene: str | None = None) -> Path:
    """A study file with its scene and a target: a bend of 60 degrees with constant curvature. Returns its path."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scene.yaml").write_text(scene or SCENE)
    s = np.linspace(0.0, 0.04, 21)
    radius = 0.04 / np.deg2rad(60)
    bend = radius * (1 - np.cos(s / radius))
    write_centreline(
        folder / "target.csv",
        np.column_stack([s, radius * np.sin(s / radius), 0.6 * bend, 0.8 * bend]),
    )
    path = folder / "probe.yaml"
    path.write_text(text)
    return path
