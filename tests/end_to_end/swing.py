"""A catheter that swings, as a scene file, and the environment of a process that runs it."""

from __future__ import annotations

import os
from pathlib import Path

ROOT = Path(__file__).parents[2]
SCENE = """\
name: swing
materials:
  magnetic: {{shear_modulus: 120 kPa, bulk_to_shear: 20, density: 1882 kg/m^3, remanence: 100 mT}}
body:
  catheter:
    length: 16 mm
    diameter: 4 mm
    material: magnetic
    segments: [{{magnetization: [1, 0, 0]}}]
field: {{uniform: [0 mT, 2 mT, 20 mT]}}
effects: {{magnetic_torque: {{}}}}
solver: {{dynamic: {{{dynamic}}}}}
resolution: {{cells_across: 2}}
"""


def scene(folder: Path, dynamic: str) -> Path:
    path = folder / "scene.yaml"
    path.write_text(SCENE.format(dynamic=dynamic), encoding="utf-8")
    return path


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
