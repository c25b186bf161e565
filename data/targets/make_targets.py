"""Writes the targets of the example studies: space curves of prescribed curvature, computed without a solver.

    python data/targets/make_targets.py

Each target is the axis of an inextensible rod, 40 mm long, clamped along +x. Its curvature vector is prescribed along s in a frame that
does not rotate about the tangent (the Bishop frame). In-plane bending lies in the plane of the field of the example scene, (0, 0.6, 0.8).

C: bends in one direction, most at the base, by 75 degrees in total.
S: bends up and, beyond 55 % of the length, back; the outer three quarters also bend sideways, so that the curve leaves the plane.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from magmpm.inputs.csv_tables import write_centreline

HERE = Path(__file__).resolve().parent
LENGTH = 40e-3  # m
UP, SIDE = np.array([0.0, 0.6, 0.8]), np.array([0.0, -0.8, 0.6])
STEPS = 2000
ROWS = 21

Bend = Callable[[float], float]  # function of s/L: curvature in degrees per length


def curve(up: Bend, side: Bend) -> np.ndarray:
    """Rows [s, x, y, z] (STEPS + 1, 4) m of the curve with curvatures `up` and `side`; midpoint rule, with exact rotations."""
    frame = np.stack([[1.0, 0.0, 0.0], UP, SIDE], axis=1)
    h = 1 / STEPS
    rows = [np.zeros(4)]
    for k in range(STEPS):
        x = (k + 0.5) * h
        half = Rotation.from_rotvec(np.deg2rad([0.0, -side(x), up(x)]) * h / 2).as_matrix()
        middle = frame @ half
        rows.append(rows[-1] + LENGTH * h * np.array([1.0, *middle[:, 0]]))
        frame = middle @ half
    return np.array(rows)


def c_shape() -> np.ndarray:
    """75 degrees in total; the curvature decreases to zero at the tip as 1 - (s/L)^2."""
    return curve(lambda x: 75 * 1.5 * (1 - x * x), lambda x: 0.0)


def s_shape() -> np.ndarray:
    """Upward with up to 90 degrees per length, beyond 55 % back with up to 60, and sideways with up to 60."""
    turn = 0.55

    def up(x: float) -> float:
        if x < turn:
            return 90 * np.cos(np.pi / 2 * x / turn)
        return -60 * np.sin(np.pi * (x - turn) / (1 - turn))

    def side(x: float) -> float:
        return 60 * np.sin(np.pi * (x - 0.25) / 0.75) if x > 0.25 else 0.0

    return curve(up, side)


def main() -> None:
    """Write both tables."""
    for name, rows in (("c_shape", c_shape()), ("s_shape", s_shape())):
        kept = rows[:: STEPS // (ROWS - 1)]
        moved = 1e3 * np.linalg.norm(kept[-1, 1:] - [LENGTH, 0, 0])
        comment = f"{name}: a curve of prescribed curvature, by make_targets.py; its tip moves {moved:.1f} mm"
        write_centreline(HERE / f"{name}.csv", kept, comment=comment)
        print(comment)


if __name__ == "__main__":
    main()
