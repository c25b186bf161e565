"""The twelve free targets of `make bench-design`: splines of constant length whose curvature no design is known to give.

    python data/targets/bench/make_free.py

The curvature vector in a frame that does not turn about the tangent (Bishop's) is a cubic spline through five random values along a
40 mm axis that leaves the origin along +x; NumPy's default generator, seeded with [SEED, number]. Odd numbers are planar, even ones
spatial. A catheter of data/scenes/five_segments.yaml can bend at s, at most, by

    k(s) = Br B A (L - s) / (mu0 E I):   all torques beyond s at their largest and in one direction.

Numbers 1 to 6 stay within `WITHIN` of k(s) everywhere (which does not make them reachable: the body has five segments, and a bend turns
the magnets); numbers 7 to 12 go beyond it: their largest curvature is `BEYOND` times k(0), wherever it lies. Everything here was fixed
before any study ran on these targets.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

HERE = Path(__file__).resolve().parent
SEED, COUNT = 10, 12
LENGTH, DIAMETER, REMANENCE, FIELD, SHEAR = 40e-3, 4e-3, 0.138, 10e-3, 120e3
WITHIN, BEYOND = 0.45, 1.3
KNOTS, STEPS, ROWS = 5, 2000, 21


def most_curvature(s: np.ndarray) -> np.ndarray:
    """Largest curvature (1/m) at s (m) that the field can give, with E = 9 K G / (3 K + G) at K = 20 G and A / I = 16 / d^2."""
    young = 9 * 20 / 61 * SHEAR
    return np.asarray(
        REMANENCE * FIELD / (4e-7 * math.pi) * 16 / DIAMETER**2 / young * (LENGTH - s)
    )


def curvature(number: int) -> np.ndarray:
    """Curvature vectors (STEPS, 2), 1/m, at the middles of equal steps."""
    rng = np.random.default_rng([SEED, number])
    values = rng.normal(size=(KNOTS, 2))
    plane = rng.uniform(0, 2 * math.pi)
    if number % 2:
        values = np.outer(values[:, 0], [math.cos(plane), math.sin(plane)])
    s = (np.arange(STEPS) + 0.5) / STEPS * LENGTH
    bent = CubicSpline(np.linspace(0, LENGTH, KNOTS), values)(s)
    size = np.linalg.norm(bent, axis=1)
    if number > COUNT // 2:
        return np.asarray(bent * BEYOND * most_curvature(np.zeros(1)) / size.max())
    # tapered as k(s) is, then scaled
    return np.asarray(bent * (WITHIN * most_curvature(s) / size.max())[:, None])


def curve(bent: np.ndarray) -> np.ndarray:
    """Rows [s, x, y, z] (STEPS + 1, 4), m; midpoint rule with exact rotations."""
    h = LENGTH / len(bent)
    frame, rows = np.eye(3), [np.zeros(4)]
    for y, z in bent:
        half = Rotation.from_rotvec(np.array([0.0, -z, y]) * h / 2).as_matrix()
        middle = frame @ half
        rows.append(rows[-1] + h * np.array([1.0, *middle[:, 0]]))
        frame = middle @ half
    return np.array(rows)


def main() -> None:
    """Write free_01.csv to free_12.csv."""
    for number in range(1, COUNT + 1):
        bent = curvature(number)
        kind = f"{'planar' if number % 2 else 'spatial'}, curvature {'beyond' if number > COUNT // 2 else 'within'} what the field can give"
        rows = curve(bent)[:: STEPS // (ROWS - 1)]
        lines = [
            f"# free {number}: {kind} (make_free.py)",
            "s_mm,x_mm,y_mm,z_mm",
            *(",".join(f"{1e3 * value + 0.0:.6f}" for value in row) for row in rows),
        ]
        (HERE / f"free_{number:02d}.csv").write_text("\n".join(lines) + "\n")
        turned = np.rad2deg(np.linalg.norm(bent, axis=1).sum() * LENGTH / STEPS)
        print(lines[0], f"; tip at {np.round(1e3 * rows[-1, 1:], 1)} mm, turns {turned:.0f} deg")


if __name__ == "__main__":
    main()
