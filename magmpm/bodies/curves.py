"""Curves through points, and normals of triangles."""

import numpy as np

from magmpm.compiled.arrays import Array

AXIS_STATIONS = 41  # along a body, where axes are compared


def linear(at: Array, s: Array, rows: Array) -> Array:
    """Values (m, q) at places (m,), linear between rows (n, q) at s (n,), and those of the ends beyond."""
    return np.stack([np.interp(at, s, column) for column in rows.T], axis=1)


def arc_lengths(points: Array) -> Array:
    """Arc lengths (k,) of points (k, 3), along the chords between them."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def curve(points: Array, step: float) -> Array:
    """Points (m, 3) at most `step` (m) apart on the smooth curve (cubic spline over the chords) through points (k, 3)."""
    from scipy.interpolate import CubicSpline  # only where a scene has a curve

    chord = arc_lengths(points)
    fine = np.linspace(0.0, chord[-1], max(2, int(np.ceil(chord[-1] / step)) + 1))
    if len(points) == 2:
        return np.asarray(points[0] + fine[:, None] / chord[-1] * (points[1] - points[0]))
    return np.asarray(CubicSpline(chord, points)(fine))


def tightest_radius(points: Array) -> float:
    """Least radius (m) of the circles through three neighbors of points (m, 3) on a curve; inf where it is straight."""
    if len(points) < 3:
        return np.inf
    a = points[1:-1] - points[:-2]
    b = points[2:] - points[1:-1]
    double = np.linalg.norm(
        np.cross(a, b), axis=1
    )  # twice the triangle's area: the radius is a b c / (4 area)
    sides = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1) * np.linalg.norm(a + b, axis=1)
    bent = double > 1e-9 * sides ** (2 / 3)
    return float(np.min(sides[bent] / (2.0 * double[bent]), initial=np.inf))


def on_rows(s: Array, rows: Array, at: Array) -> tuple[Array, Array]:
    """Values (m, q) and slopes (m, q) per m, at arc lengths `at` (m,) m, of parabolas through rows (2 cells + 1, q) at s, three to a cell.

    s (2 cells + 1,) m: from 0, evenly spaced within each cell. Raises ValueError for an arc length outside of it.
    """
    at = np.asarray(at, dtype=float)
    length = s[-1]
    if np.any(at < -1e-9 * length) or np.any(at > (1 + 1e-6) * length):
        raise ValueError(f"s must lie between 0 and the length, {length} m")
    cells = (len(rows) - 1) // 2
    width = np.diff(s[::2])
    even = np.ptp(width) < 1e-9 * length
    place = (
        at / length * cells if even else np.interp(at, s[::2], np.arange(cells + 1))
    )  # cells below it
    cell = np.clip(place.astype(int), 0, cells - 1)
    t = (place - cell)[:, None]
    a, b, c = (rows[2 * cell + k] for k in range(3))
    values = a * (1 - t) * (1 - 2 * t) + b * 4 * t * (1 - t) + c * t * (2 * t - 1)
    slopes = (a * (4 * t - 3) + b * (4 - 8 * t) + c * (4 * t - 1)) * cells / length
    if not even:
        slopes *= (length / cells / width[cell])[:, None]
    return values, slopes


def face_normals(triangles: Array) -> Array:
    """Normals (m, 3) of triangles (m, 3, 3) m by the right-hand rule, m^2: twice as long as the areas."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    return np.cross(b - a, c - a)
