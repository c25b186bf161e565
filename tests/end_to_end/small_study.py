"""A small study that is really solved (2 cells across, torque alone), for tests of what is made of a study's folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import magmpm
from magmpm.inputs.csv_tables import write_centreline
from magmpm.studies.engine.loop import run_study
from magmpm.studies.search.definition import load_study

SCENE = """\
name: short catheter
materials:
  MATERIAL: {shear_modulus: 120 kPa, bulk_to_shear: 20, density: 1882 kg/m^3, remanence: 138 mT}
body:
  catheter:
    length: 24 mm
    diameter: 4 mm
    material: MATERIAL
    segments: [{magnetization: [1, 0, 0]}, {}, {magnetization: [0, 0, 1]}]
field: {uniform: [0 mT, 4 mT, 8 mT]}
effects: {magnetic_torque: {}}
resolution: {cells_across: 2}
"""
STUDY = """\
scene: scene.yaml
vary: {magnetization: {}}
match: {centreline: target.csv}
trials: 2
sampler: random
seed: 3
"""


def study_file(folder: Path) -> Path:
    return folder / "short.yaml"


def finished(folder: Path, *, trials: int, material: str = "silicone", solve: Callable[..., Any] = magmpm.run, more: str = "") -> Path:
    """Run the study, with more lines in its file, without pictures; the folder of its results."""
    quoted = "'" + material.replace("'", "''") + "'"
    (folder / "scene.yaml").write_text(SCENE.replace("MATERIAL", quoted))
    study_file(folder).write_text(STUDY + more)
    s = np.linspace(0.0, 0.024, 13)
    write_centreline(folder / "target.csv", np.column_stack([s, 0.03 * np.sin(s / 0.03), 0 * s, 0.03 * (1 - np.cos(s / 0.03))]))
    out = folder / "out"
    run_study(load_study(study_file(folder)), solve=solve, differentiate=magmpm.sensitivities, out=out, trials=trials)
    (out / "convergence.png").write_bytes(b"\x89PNG\r\n\x1a\n")  # a picture, so that none is drawn
    return out
