"""A small study with a goal: the tip of a rod of two segments, as high as can be, by the strength of the field."""

from pathlib import Path
from typing import Any

import magmpm
from magmpm.studies.goals.report import GoalReport

SCENE = """\
name: lifted rod
materials:
  m: {shear_modulus: 120 kPa, bulk_to_shear: 20, density: 1882 kg/m^3, remanence: 138 mT}
body:
  catheter:
    length: 20 mm
    diameter: 4 mm
    material: m
    clamp: base
    segments:
      - magnetization: [1, 0, 0]
      - magnetization: [0, 0, 0]
field: {uniform: [0 mT, 0 mT, 4 mT]}
effects: {magnetic_torque: {}}
solver: {static: {}}
resolution: {cells_across: 2}
advice: "off"
"""
STUDY = """\
scene: scene.yaml
vary:
  numbers:
    - {of: "field.uniform[2]", min: 1 mT, max: 8 mT}
goal:
  maximize: {displacement: {of: tip, along: [0, 0, 1]}}
trials: 6
sampler: tpe
"""


def written(folder: Path, study: str = STUDY, scene: str = SCENE) -> Path:
    (folder / "scene.yaml").write_text(scene)
    (folder / "study.yaml").write_text(study)
    return folder / "study.yaml"


def searched(folder: Path, study: str = STUDY, scene: str = SCENE, **more: Any) -> GoalReport:
    found = magmpm.design(
        written(folder, study, scene), folder=folder / "out", progress=False, **more
    )
    assert isinstance(found, GoalReport)
    return found


def plain(text: str) -> dict[str, Any]:
    import yaml

    return dict(yaml.safe_load(text))
