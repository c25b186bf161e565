"""Smooth curves through points."""

from __future__ import annotations

import numpy as np

from magmpm.compiled.arrays import Array


def curve(points: Array, step: float) -> Array:
    """Points (m, 3) at most `step` (m) apart on the smooth curve (cubic spline over the chords) through points (k, 3)."""
    from scipy.interpolate import CubicSpline  # only where a scene has a curve

    chord = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    fine = np.linspace(0.0, chord[-1], max(2, int(np.ceil(chord[-1] / step)) + 1))
    if len(points) == 2:
        return np.asarray(points[0] + fine[:, None] / chord[-1] * (points[1] - points[0]))
    return np.asarray(CubicSpline(chord, points)(fine))


def tightest_bend(path: Array) -> float:
    """Smallest radius of curvature (m) of a finely sampled curve (m, 3); inf for a straight one."""
    first, second = path[1:-1] - path[:-2], path[2:] - path[1:-1]
    area = np.linalg.norm(
        np.cross(first, second), axis=1
    )  # twice the triangle of three neighbours: R = a b c / (4 area)
    sides = (
        np.linalg.norm(first, axis=1)
        * np.linalg.norm(second, axis=1)
        * np.linalg.norm(first + second, axis=1)
    )
    bent = area > 1e-9 * sides ** (2 / 3)
    return float(np.min(sides[bent] / (2 * area[bent]))) if bent.any() else float("inf")
