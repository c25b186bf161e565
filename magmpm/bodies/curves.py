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


def tightest_radius(points: Array) -> float:
    """Least radius (m) of the circles through three neighbors of points (m, 3) on a curve; inf where it is straight."""
    if len(points) < 3:
        return np.inf
    a, b = points[1:-1] - points[:-2], points[2:] - points[1:-1]
    double = np.linalg.norm(np.cross(a, b), axis=1)  # twice the triangle's area: the radius is a b c / (4 area)
    sides = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1) * np.linalg.norm(a + b, axis=1)
    bent = double > 1e-9 * sides ** (2 / 3)
    return float(np.min(sides[bent] / (2.0 * double[bent]), initial=np.inf))
