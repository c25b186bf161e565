"""Writes elastica_load5.csv, the reference solution of data/scenes/elastica.yaml.

    python data/references/make_elastica.py

A rod that neither stretches nor shears, clamped at s = 0 and magnetized along its axis, in a transverse field:

    theta'' + load cos(theta) = 0,  theta(0) = 0,  theta'(1) = 0,  load = M B A L^2 / (E I),

with s in units of L. Solved by shooting on theta'(0); the CSV file contains a rod of 40 mm that bends in the x-z plane.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from magmpm.inputs.csv_tables import write_centreline

LOAD, LENGTH, POINTS = 5.0, 40e-3, 41


def shoot(curvature: float, at: np.ndarray) -> np.ndarray:
    """theta, theta', x/L, z/L, (4, m), at the arc lengths `at` (over L), for a given curvature at the clamp."""

    def slope(_: float, y: np.ndarray) -> list[float]:
        return [y[1], -LOAD * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])]

    solved = solve_ivp(
        slope, (0, 1), [0, curvature, 0, 0], method="DOP853", rtol=1e-12, atol=1e-13, t_eval=at
    )
    return np.asarray(solved.y)


def main() -> None:
    s = np.linspace(0, 1, POINTS)
    # the first branch: theta stays below 90 degrees, so theta'(0)^2 < 2 load
    curvature = brentq(lambda k: shoot(k, s)[1, -1], 0.0, np.sqrt(2 * LOAD), xtol=1e-14)
    _, _, x, z = shoot(curvature, s)
    print(f"tip deflection / L {z[-1]:.6f}, tip x / L {x[-1]:.6f}")
    rows = LENGTH * np.column_stack([s, x, 0 * s, z])
    note = f"hard-magnetic elastica, load {LOAD:g} at 90 degrees, by make_elastica.py"
    write_centreline(Path(__file__).with_name("elastica_load5.csv"), rows, comment=note)


if __name__ == "__main__":
    main()
