"""Signed distance from the wall of a lumen, tabulated on a grid of points and read between them with quadratic B-splines.

Positive inside the lumen, zero on its wall, negative beyond. The splines go through the table's values, with a slope that is continuous:
between points of spacing s a wall of radius r is off by less than 0.02 s^2/r, a sharp edge rounded off by 0.2 s. Particles outside the
table touch nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array
from magmpm.compiled.jit import compiled, compiled_elsewhere

MOST_POINTS = 4_000_000  # 32 MB
BAND = 4  # points of the table beyond the wall, on either side, that hold true distances to a surface
Faces = NDArray[np.int64]


@dataclass(frozen=True)
class Table:
    """origin (3,) m of the first point, spacing m, and the splines' coefficients (nx, ny, nz) m."""

    origin: Array
    spacing: float
    coefficients: Array

    @classmethod
    def through(cls, origin: Array, spacing: float, values: Array) -> Table:
        """The splines that go through these values at the points."""
        from scipy.ndimage import spline_filter  # only where a scene has walls: every scene imports this file

        return cls(origin, spacing, spline_filter(values, order=2, mode="mirror"))

    def at(self, points: Array) -> tuple[Array, Array]:
        """Distance (n,) m and its slope (n, 3) at points (n, 3) m; inf and 0 where the table does not reach."""
        found, slopes = np.full(len(points), np.inf), np.zeros((len(points), 3))
        flat, shape = self.coefficients.ravel(), self.coefficients.shape
        place = (points - self.origin) / self.spacing
        for n in np.flatnonzero(np.all((place >= 0.5) & (place < np.array(shape) - 1.5), axis=1)):
            found[n], *slopes[n] = value(*place[n], self.spacing, shape[1], shape[2], flat)
        return found, slopes


def points_between(low: Array, high: Array, spacing: float) -> tuple[Array, float, tuple[int, int, int]]:
    """Origin, spacing and shape of a table over a box (m); the spacing is widened where it would take more than MOST_POINTS.

    The points lie about the middle of the box: what is its own mirror image has a table that is, too.
    """
    size = np.asarray(high) - np.asarray(low)
    spacing = max(spacing, float(np.prod(size + spacing) / MOST_POINTS) ** (1 / 3))
    nx, ny, nz = (int(n) for n in np.ceil(size / spacing).astype(int) + 1)
    return (np.asarray(low) + high - spacing * (np.array([nx, ny, nz]) - 1)) / 2, spacing, (nx, ny, nz)


def to_path(points: Array, path: Array) -> Array:
    """Distance (n,) m of points (n, 3) from a polyline (m, 3) whose first and last piece go on for ever."""
    from scipy.spatial import cKDTree

    _, nearest = cKDTree(path).query(points)
    best = np.full(len(points), np.inf)
    last = len(path) - 2
    for piece in (np.maximum(nearest - 1, 0), np.minimum(nearest, last)):
        a, d = path[piece], path[piece + 1] - path[piece]
        t = np.einsum("ij,ij->i", points - a, d) / np.einsum("ij,ij->i", d, d)
        t = np.clip(t, np.where(piece == 0, -np.inf, 0.0), np.where(piece == last, np.inf, 1.0))
        best = np.minimum(best, np.linalg.norm(points - a - t[:, None] * d, axis=1))
    return best


def along_path(points: Array, path: Array) -> Array:
    """Index (n,) of the sample of a finely sampled curve (m, 3) that is nearest to each of the points (n, 3)."""
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(path).query(points)[1], dtype=float)


def past_ends(radius: float, spacing: float) -> float:
    """Length (m) by which the table of a tube, and the tube's wall with it, extends past its ends, at most."""
    return radius + BAND * spacing


def to_tube(points: Array, path: Array, radius: float, past: float) -> Array:
    """Distance (n,) m of points (n, 3) from the wall of a tube of this radius around a finely sampled curve (m, 3), which goes on straight
    past both ends (m)."""
    slope = np.gradient(path, axis=0)
    slope /= np.linalg.norm(slope, axis=1, keepdims=True)
    more = np.linspace(0.0, past, max(2, len(path) // 10))[1:, None]
    around = np.concatenate([path[0] - more * slope[0], path, path[-1] + more * slope[-1]])
    along = np.concatenate([np.tile(slope[0], (len(more), 1)), slope, np.tile(slope[-1], (len(more), 1))])
    found = np.empty(len(points))
    for n, point in enumerate(points):  # the nearest of the circles that the wall is made of
        apart = point - around
        forward = np.einsum("ij,ij->i", apart, along)
        aside = np.linalg.norm(apart - forward[:, None] * along, axis=1)
        found[n] = np.hypot(forward, aside - radius).min()
    return found


def tube(path: Array, radius: float, spacing: float) -> Table:
    """A tube of this radius (m) around a finely sampled curve (m, 3), open at both ends, which go on straight as far as the table does."""
    margin = past_ends(radius, spacing)
    origin, spacing, shape = points_between(path.min(axis=0) - margin, path.max(axis=0) + margin, spacing)
    values = np.empty(shape)
    y, z = (origin[k] + spacing * np.arange(shape[k]) for k in (1, 2))
    for i in range(shape[0]):  # plane by plane, for memory's sake
        plane = np.stack(np.meshgrid(origin[0] + spacing * i, y, z, indexing="ij"), -1).reshape(-1, 3)
        values[i] = radius - to_path(plane, path).reshape(shape[1:])
    return Table.through(origin, spacing, values)


def surface(vertices: Array, faces: Faces, spacing: float) -> Table:
    """The inside of a closed triangle mesh: vertices (k, 3) m, faces (m, 3)."""
    corners = np.ascontiguousarray(vertices[faces], dtype=float)
    return solid([corners], corners, spacing)


def solid(parts: Sequence[Array], outside: Array, spacing: float) -> Table:
    """The inside of closed meshes (each (f, 3, 3) m) whose common surface is `outside` (m, 3, 3). Beyond BAND points from it the distance
    stays at that.

    The sign is the parity of crossings along z, so meshes must be watertight; which way their triangles face does not matter.
    """
    flat = np.concatenate(parts).reshape(-1, 3)
    margin = (BAND + 2) * spacing
    origin, spacing, shape = points_between(flat.min(axis=0) - margin, flat.max(axis=0) + margin, spacing)
    values, inside = np.full(shape, BAND * spacing), np.zeros(shape, np.bool_)
    _near_triangles(np.ascontiguousarray(outside), origin, spacing, BAND * spacing, values)
    for corners in parts:
        own = np.zeros(shape, np.bool_)
        # Columns a hair off the points, by no simple fraction, so that none goes through an edge or a vertex of a mesh with round numbers.
        _crossings(np.ascontiguousarray(corners), origin + spacing * np.array([1.1e-5, 1.7e-5, 0.0]), spacing, own)
        inside |= own
    return Table.through(origin, spacing, np.where(inside, values, -values))


@compiled
def to_triangles(points, corners):
    """Distance (n,) m of points (n, 3) from the nearest of the triangles (m, 3, 3)."""
    found = np.full(len(points), np.inf)
    for k in range(len(points)):
        for triangle in corners:
            found[k] = min(found[k], _to_triangle(points[k], triangle[0], triangle[1], triangle[2]))
    return found


@compiled
def _to_triangle(x, a, b, c):
    """Distance of point x from the triangle a b c. Source: Ericson, Real-Time Collision Detection, section 5.1.5."""
    ab, ac, ap = b - a, c - a, x - a
    d1, d2 = np.dot(ab, ap), np.dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return np.linalg.norm(ap)
    bp = x - b
    d3, d4 = np.dot(ab, bp), np.dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return np.linalg.norm(bp)
    cp = x - c
    d5, d6 = np.dot(ab, cp), np.dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return np.linalg.norm(cp)
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return np.linalg.norm(ap - d1 / (d1 - d3) * ab)
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return np.linalg.norm(ap - d2 / (d2 - d6) * ac)
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        return np.linalg.norm(bp - (d4 - d3) / ((d4 - d3) + (d5 - d6)) * (c - b))
    whole = va + vb + vc
    return np.linalg.norm(ap - vb / whole * ab - vc / whole * ac)


@compiled
def _near_triangles(corners, origin, spacing, band, values):
    """values (nx, ny, nz): smallest distance to a triangle of corners (m, 3, 3), where less than what stands there."""
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    x = np.empty(3)
    for t in range(len(corners)):
        a, b, c = corners[t, 0], corners[t, 1], corners[t, 2]
        for k in range(3):
            low[k] = max(0, int(np.ceil((min(a[k], b[k], c[k]) - band - origin[k]) / spacing)))
            high[k] = min(values.shape[k] - 1, int(np.floor((max(a[k], b[k], c[k]) + band - origin[k]) / spacing)))
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for k in range(low[2], high[2] + 1):
                    x[0], x[1], x[2] = origin[0] + spacing * i, origin[1] + spacing * j, origin[2] + spacing * k
                    values[i, j, k] = min(values[i, j, k], _to_triangle(x, a, b, c))


@compiled
def _crossings(corners, origin, spacing, inside):
    """inside (nx, ny, nz): whether a line from the point along +z crosses the triangles an odd number of times."""
    for t in range(len(corners)):
        a, b, c = corners[t, 0], corners[t, 1], corners[t, 2]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area == 0.0:
            continue
        i0 = max(0, int(np.ceil((min(a[0], b[0], c[0]) - origin[0]) / spacing)))
        i1 = min(inside.shape[0] - 1, int(np.floor((max(a[0], b[0], c[0]) - origin[0]) / spacing)))
        j0 = max(0, int(np.ceil((min(a[1], b[1], c[1]) - origin[1]) / spacing)))
        j1 = min(inside.shape[1] - 1, int(np.floor((max(a[1], b[1], c[1]) - origin[1]) / spacing)))
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                x, y = origin[0] + spacing * i, origin[1] + spacing * j
                u = ((b[0] - x) * (c[1] - y) - (b[1] - y) * (c[0] - x)) / area
                v = ((c[0] - x) * (a[1] - y) - (c[1] - y) * (a[0] - x)) / area
                w = 1.0 - u - v
                if u >= 0.0 and v >= 0.0 and w >= 0.0:
                    z = u * a[2] + v * b[2] + w * c[2]
                    top = int(np.ceil((z - origin[2]) / spacing))  # points below it see this crossing
                    for k in range(min(top, inside.shape[2])):
                        inside[i, j, k] = not inside[i, j, k]


@compiled_elsewhere
def value(p, q, r, spacing, rows, columns, coefficients):
    """Distance (m) and the three components of its slope, at a place p, q, r in points from the table's first, each 0.5 or more and less
    than the last by as much. rows, columns: points along y and z; coefficients flat.

    In scalars and tuples: small arrays in a particle loop, and views handed on, cost more than all the rest.
    """
    i, j, k = int(p + 0.5), int(q + 0.5), int(r + 0.5)
    d, e, f = p - i, q - j, r - k
    u = (0.5 * (0.5 - d) ** 2, 0.75 - d * d, 0.5 * (0.5 + d) ** 2)
    v = (0.5 * (0.5 - e) ** 2, 0.75 - e * e, 0.5 * (0.5 + e) ** 2)
    w = (0.5 * (0.5 - f) ** 2, 0.75 - f * f, 0.5 * (0.5 + f) ** 2)
    du, dv, dw = (d - 0.5, -2.0 * d, d + 0.5), (e - 0.5, -2.0 * e, e + 0.5), (f - 0.5, -2.0 * f, f + 0.5)
    total, sx, sy, sz = 0.0, 0.0, 0.0, 0.0
    for a in range(3):
        for b in range(3):
            first = ((i - 1 + a) * rows + j - 1 + b) * columns + k - 1
            c0, c1, c2 = coefficients[first], coefficients[first + 1], coefficients[first + 2]
            line = w[0] * c0 + w[1] * c1 + w[2] * c2
            total += u[a] * v[b] * line
            sx += du[a] * v[b] * line
            sy += u[a] * dv[b] * line
            sz += u[a] * v[b] * (dw[0] * c0 + dw[1] * c1 + dw[2] * c2)
    return total, sx / spacing, sy / spacing, sz / spacing


@compiled
def curvature(p, q, r, spacing, rows, columns, coefficients):
    """Second derivatives (1/m) of the distance along xx, yy, zz, xy, xz, yz, constant or linear in each cell; arguments as of `value`."""
    i, j, k = int(p + 0.5), int(q + 0.5), int(r + 0.5)
    d, e, f = p - i, q - j, r - k
    u = (0.5 * (0.5 - d) ** 2, 0.75 - d * d, 0.5 * (0.5 + d) ** 2)
    v = (0.5 * (0.5 - e) ** 2, 0.75 - e * e, 0.5 * (0.5 + e) ** 2)
    w = (0.5 * (0.5 - f) ** 2, 0.75 - f * f, 0.5 * (0.5 + f) ** 2)
    du, dv, dw = (d - 0.5, -2.0 * d, d + 0.5), (e - 0.5, -2.0 * e, e + 0.5), (f - 0.5, -2.0 * f, f + 0.5)
    second = (1.0, -2.0, 1.0)
    xx, yy, zz, xy, xz, yz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for a in range(3):
        for b in range(3):
            first = ((i - 1 + a) * rows + j - 1 + b) * columns + k - 1
            c0, c1, c2 = coefficients[first], coefficients[first + 1], coefficients[first + 2]
            line, slope = w[0] * c0 + w[1] * c1 + w[2] * c2, dw[0] * c0 + dw[1] * c1 + dw[2] * c2
            xx += second[a] * v[b] * line
            yy += u[a] * second[b] * line
            zz += u[a] * v[b] * (c0 - 2.0 * c1 + c2)
            xy += du[a] * dv[b] * line
            xz += du[a] * v[b] * slope
            yz += u[a] * dv[b] * slope
    scale = 1.0 / spacing**2
    return xx * scale, yy * scale, zz * scale, xy * scale, xz * scale, yz * scale
