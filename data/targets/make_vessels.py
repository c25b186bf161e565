"""Writes the paths of the insertion studies: curves of prescribed curvature from a guide's exit on, computed without a solver.

    python data/targets/make_vessels.py

Each path is 56 mm long, as the catheter of data/scenes/insertion.yaml, and leaves the guide along +x. Its curvature vector is prescribed
along s in a frame that does not turn about the tangent (the Bishop frame).

vessel_s: in the x-z plane; rises by 45 degrees over the first half of a sine, and turns back over the second. Smallest radius 23 mm.
vessel_spatial: bends by 115 degrees in all, while the plane of its bend turns by 90 degrees from +y toward +z. Smallest radius 25 mm.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from magmpm.inputs.csv_tables import write_centreline

HERE = Path(__file__).resolve().parent
LENGTH = 56e-3  # m
STEPS = 2800
ROWS = 57
TURN = 45.0  # degrees
SMALLEST = 25e-3  # m, radius of the spatial path
FADE = 5e-3  # m over which its curvature grows from zero at the exit, and falls to zero at the end


def curve(curvature: np.ndarray, step: float) -> np.ndarray:
    """Rows [s, x, y, z] (k + 1, 4) m of the curve with curvature (k, 2) 1/m toward +y and +z; step m. Midpoint rule, exact rotations."""
    frame, rows = np.eye(3), [np.zeros(4)]
    for toward_y, toward_z in curvature:
        half = Rotation.from_rotvec(np.array([0.0, -toward_z, toward_y]) * step / 2).as_matrix()
        middle = frame @ half
        rows.append(rows[-1] + step * np.array([1.0, *middle[:, 0]]))
        frame = middle @ half
    return np.array(rows)


def vessel_s() -> np.ndarray:
    """Curvature in the x-z plane: a sine: by TURN up, then as much back."""
    x = (np.arange(STEPS) + 0.5) / STEPS
    curvature = np.deg2rad(TURN) * np.pi / LENGTH * np.sin(2 * np.pi * x)
    return curve(np.stack([0 * x, curvature], axis=1), LENGTH / STEPS)


def vessel_spatial() -> np.ndarray:
    """Curvature of constant size but at its ends, its direction turning evenly from +y to +z."""
    s = (np.arange(STEPS) + 0.5) / STEPS * LENGTH
    size = np.clip(np.minimum(s, LENGTH - s) / FADE, 0.0, 1.0) / SMALLEST
    angle = np.pi / 2 * s / LENGTH
    return curve(size[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1), LENGTH / STEPS)


def main() -> None:
    """Write both tables."""
    for name, rows in (("vessel_s", vessel_s()), ("vessel_spatial", vessel_spatial())):
        kept = rows[:: STEPS // (ROWS - 1)]
        x, y, z = 1e3 * kept[-1, 1:]
        comment = f"{name}: a curve of prescribed curvature, by make_vessels.py; it ends at ({x:.1f}, {y:.1f}, {z:.1f}) mm"
        write_centreline(HERE / f"{name}.csv", kept, comment=comment)
        print(comment)


if __name__ == "__main__":
    main()
