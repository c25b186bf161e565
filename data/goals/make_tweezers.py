"""Writes meshes/tweezers_*.stl, the parts of scenes/tweezers.yaml, in millimeters.

    python data/goals/make_tweezers.py

A foot, and on it two arms along z, each with a tip at its end.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from magmpm.bodies.surface_mesh import Mesh, write_stl

BLOCKS = {  # mm: two opposite corners
    "foot": ((-4.0, 0.0, 0.0), (4.0, 2.0, 2.0)),
    "left_arm": ((-4.0, 0.0, 2.0), (-3.0, 2.0, 10.0)),
    "left_tip": ((-4.0, 0.0, 10.0), (-3.0, 2.0, 14.0)),
    "right_arm": ((3.0, 0.0, 2.0), (4.0, 2.0, 10.0)),
    "right_tip": ((3.0, 0.0, 10.0), (4.0, 2.0, 14.0)),
}


def block(low: tuple[float, float, float], high: tuple[float, float, float]) -> Mesh:
    """A block with edges along the axes."""
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    faces = [(side[0], side[k], side[k + 1]) for side in sides for k in (1, 2)]
    return Mesh(np.array(low) + corner * (np.array(high) - np.array(low)), np.array(faces))


if __name__ == "__main__":
    folder = Path(__file__).parent / "meshes"
    for name, (low, high) in BLOCKS.items():
        write_stl(block(low, high), folder / f"tweezers_{name}.stl")
