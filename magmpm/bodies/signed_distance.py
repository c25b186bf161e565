"""Signed distance from the wall of a lumen, tabulated on a grid of points and read between them with quadratic B-splines.

Positive inside the lumen, zero on its wall, negative beyond. The splines go through the table's values, with a slope that is continuous:
between points of spacing s a wall of radius r is off by less than 0.02 s^2/r, a sharp edge by 0.2 s. Outside of a table nothing touches.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from magmpm.bodies.curves import face_normals
from magmpm.compiled.arrays import Array
from magmpm.compiled.jit import compiled, inlined_elsewhere, inner, task_body
from magmpm.compiled.parallel import TOGETHER, over_parts, parts_of, task
from magmpm.compiled.simd import above, larger, pick, smaller

MOST_POINTS = 4_000_000  # 32 MB
ON_EDGE = 3
WITHIN = 4
TIE = 1e-5  # of their distance: faces whose distances differ by no more have the same nearest place
# of a table's spacing: triangles, and slivers between parts, that are no thicker are due to
# rounding
SLIVER_THICKNESS = 1e-4
BAND = (
    4  # points of the table beyond the wall, on either side, that hold true distances to a surface
)


@dataclass(frozen=True)
class DistanceTable:
    """origin (3,) m of the first point, spacing m, and the splines' coefficients (nx, ny, nz) m."""

    origin: Array
    spacing: float
    coefficients: Array

    @classmethod
    def through(cls, origin: Array, spacing: float, values: Array) -> DistanceTable:
        """The splines that go through these values at the points."""
        from scipy.ndimage import (
            spline_filter,
        )  # only where a scene has walls: every scene imports this file

        return cls(origin, spacing, spline_filter(values, order=2, mode="mirror"))

    @property
    def flat(self) -> Array:
        """The coefficients one after another, and the one beyond that is read and not used."""
        return np.append(self.coefficients, 0.0)

    def at(self, points: Array) -> tuple[Array, Array]:
        """Distance (n,) m and its slope (n, 3) at points (n, 3) m; inf and 0 where the table does not reach."""
        found = np.full(len(points), np.inf)
        slopes = np.zeros((len(points), 3))
        table = (self.spacing, self.coefficients.shape, self.flat)
        for n, place in enumerate((points - self.origin) / self.spacing):
            found[n], *slopes[n] = value(*place, *table)
        return found, np.where(np.isfinite(found)[:, None], slopes, 0.0)


def points_between(
    low: Array, high: Array, spacing: float
) -> tuple[Array, float, tuple[int, int, int]]:
    """Origin, spacing and shape of a table over a box (m); the spacing is widened where it would take more than MOST_POINTS.

    The points lie about the middle of the box: what is its own mirror image has a table that is, too.
    """
    size = np.asarray(high) - np.asarray(low)
    spacing = max(spacing, float(np.prod(size + spacing) / MOST_POINTS) ** (1 / 3))
    nx, ny, nz = (int(n) for n in np.ceil(size / spacing).astype(int) + 1)
    return (
        (np.asarray(low) + high - spacing * (np.array([nx, ny, nz]) - 1)) / 2,
        spacing,
        (nx, ny, nz),
    )


def to_path(points: Array, path: Array) -> Array:
    """Distance (n,) m of points (n, 3) from a polyline (m, 3) whose first and last piece go on for ever."""
    from scipy.spatial import cKDTree

    _, nearest = cKDTree(path).query(points)
    best = np.full(len(points), np.inf)
    last = len(path) - 2
    for piece in (np.maximum(nearest - 1, 0), np.minimum(nearest, last)):
        a = path[piece]
        d = path[piece + 1] - path[piece]
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
    """Distance (n,) m of points (n, 3) from the wall of a tube around a finely sampled curve (m, 3), straight past both ends (m)."""
    slope = np.gradient(path, axis=0)
    slope /= np.linalg.norm(slope, axis=1, keepdims=True)
    more = np.linspace(0.0, past, max(2, len(path) // 10))[1:, None]
    around = np.concatenate([path[0] - more * slope[0], path, path[-1] + more * slope[-1]])
    along = np.concatenate(
        [np.tile(slope[0], (len(more), 1)), slope, np.tile(slope[-1], (len(more), 1))]
    )
    found = np.empty(len(points))
    for n, point in enumerate(points):  # the nearest of the circles that the wall is made of
        apart = point - around
        forward = np.einsum("ij,ij->i", apart, along)
        aside = np.linalg.norm(apart - forward[:, None] * along, axis=1)
        found[n] = np.hypot(forward, aside - radius).min()
    return found


def tube(path: Array, radius: float, spacing: float) -> DistanceTable:
    """A tube of this radius (m) around a finely sampled curve (m, 3), open at both ends, which go on straight as far as the table does."""
    margin = past_ends(radius, spacing)
    origin, spacing, shape = points_between(
        path.min(axis=0) - margin, path.max(axis=0) + margin, spacing
    )
    values = np.empty(shape)
    y, z = (origin[k] + spacing * np.arange(shape[k]) for k in (1, 2))
    for i in range(shape[0]):  # plane by plane, for memory's sake
        plane = np.stack(np.meshgrid(origin[0] + spacing * i, y, z, indexing="ij"), -1).reshape(
            -1, 3
        )
        values[i] = radius - to_path(plane, path).reshape(shape[1:])
    return DistanceTable.through(origin, spacing, values)


def solid(parts: Sequence[Array], outside: Array, spacing: float, within: float) -> DistanceTable:
    """The inside of closed meshes (f, 3, 3) m that face outward, and of gaps between them, `within` m; outside (m, 3, 3): their surface."""
    from scipy.ndimage import distance_transform_edt

    margin = (BAND + 2) * spacing
    origin, spacing, shape = points_between(
        outside.min(axis=(0, 1)) - margin, outside.max(axis=(0, 1)) + margin, spacing
    )
    inside = np.zeros(shape, np.bool_)
    none = np.zeros(shape, np.bool_)
    closest = np.full(shape, np.inf)
    for k, corners in enumerate((*parts, outside)):
        values = np.full(shape, BAND * spacing)
        side = np.zeros(shape)
        near_triangles(faces_of(corners), origin, spacing, BAND * spacing, values, side, none, 0.0)
        if k < len(parts):
            closest = np.minimum(closest, values)
            inside |= (
                side[
                    tuple(
                        distance_transform_edt(
                            side == 0.0, return_distances=False, return_indices=True
                        )
                    )
                ]
                < 0.0
            )
    inside |= values > closest + 2 * within  # what is nearest is within the joined parts
    return DistanceTable.through(origin, spacing, np.where(inside, values, -values))


def faces_of(corners: Array) -> Array:
    """Corners m and unit normals (m, 12), outward, of triangles (m, 3, 3) m; a normal is 0 where they have no area."""
    normal = face_normals(corners)
    return np.column_stack(
        [
            corners.reshape(-1, 9),
            normal / np.maximum(np.linalg.norm(normal, axis=1)[:, None], 1e-300),
        ]
    )


@task_body
def _part_to_triangles(part, given):
    """`to_triangles` of one part of the points."""
    points, corners, found = given
    x = np.empty(3)
    away = np.empty(3)
    for k in range(part * TOGETHER, min((part + 1) * TOGETHER, len(points))):
        nearest = np.inf
        for i in range(3):
            x[i] = points[k, i]
        for f in range(0, len(corners), 9):
            nearest = min(nearest, to_triangle(x, corners, f, away)[0])
        found[k] = nearest


@compiled
def to_triangles(points, corners):
    """Distance (n,) m of points (n, 3) from the nearest of the triangles (m, 3, 3)."""
    found = np.empty(len(points))
    # slices of an array that threads share would make them wait for its count of owners
    flat = np.ascontiguousarray(corners).reshape(-1)
    over_parts(parts_of(len(points)), task(_part_to_triangles, (points, flat, found)))
    return found


@inner
def to_triangle(x, faces, f, away):
    """Distance (m) of x (3,) m from the triangle whose corners (m) begin at faces[f], and where its nearest place is: 0, 1, 2: at that
    corner; ON_EDGE; WITHIN. away (3,) m: from there to x. Source: Ericson, Real-Time Collision Detection, section 5.1.5."""
    d1 = 0.0
    d2 = 0.0
    d3 = 0.0
    d4 = 0.0
    d5 = 0.0
    d6 = 0.0
    for i in range(3):
        ab = faces[f + 3 + i] - faces[f + i]
        ac = faces[f + 6 + i] - faces[f + i]
        ap = x[i] - faces[f + i]
        bp = x[i] - faces[f + 3 + i]
        cp = x[i] - faces[f + 6 + i]
        d1 = d1 + ab * ap
        d2 = d2 + ac * ap
        d3 = d3 + ab * bp
        d4 = d4 + ac * bp
        d5 = d5 + ab * cp
        d6 = d6 + ac * cp
    va = d3 * d6 - d5 * d4
    vb = d5 * d2 - d1 * d6
    vc = d1 * d4 - d3 * d2
    v = 0.0
    w = 0.0
    at = ON_EDGE
    if d1 <= 0.0 and d2 <= 0.0:
        at = 0
    elif d3 >= 0.0 and d4 <= d3:
        v = 1.0
        at = 1
    elif d6 >= 0.0 and d5 <= d6:
        w = 1.0
        at = 2
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / max(d1 - d3, 1e-300)
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / max(d2 - d6, 1e-300)
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    else:
        v = vb / (va + vb + vc)
        w = vc / (va + vb + vc)
        at = WITHIN
    for i in range(3):
        away[i] = (
            x[i]
            - faces[f + i]
            - v * (faces[f + 3 + i] - faces[f + i])
            - w * (faces[f + 6 + i] - faces[f + i])
        )
    return np.sqrt(away[0] ** 2 + away[1] ** 2 + away[2] ** 2), at


@inner
def beside(best, side, d, at, faces, f, away):
    """The smallest distance (m) from some faces and the side of the nearest, negative inside; best, side: those without the last one, whose
    12 numbers begin at faces[f], which is at the distance d, its nearest place `at`, from there by `away` (3,) m.

    Faces that share the nearest place count by the angle seen from there (Baerentzen, Aanaes, IEEE Trans. Vis. Comput. Graph. 11 (2005)).
    """
    if d > best * (1.0 + TIE):
        return best, side
    angle = np.pi * (at - ON_EDGE + 1)
    if at < ON_EDGE:
        uv = 0.0
        uu = 0.0
        vv = 0.0
        for i in range(3):
            u = faces[f + (3 * at + 3) % 9 + i] - faces[f + 3 * at + i]
            v = faces[f + (3 * at + 6) % 9 + i] - faces[f + 3 * at + i]
            uv = uv + u * v
            uu = uu + u * u
            vv = vv + v * v
        angle = np.arccos(max(-1.0, min(1.0, uv / np.sqrt(uu * vv + 1e-300))))
    turned = angle * (faces[f + 9] * away[0] + faces[f + 10] * away[1] + faces[f + 11] * away[2])
    return (d, turned) if d < best * (1.0 - TIE) else (min(d, best), side + turned)


@inner
def to_faces(begin, end, near, faces, x, normal):
    """Signed distance (m) of x (3,) m from the nearest of the faces near[begin : end]; normal (3,): its slope."""
    best = np.inf
    side = 0.0
    nearest = 0
    flat = False
    for k in range(begin, end):
        f = 12 * near[k]
        along = abs(
            faces[f + 9] * (x[0] - faces[f])
            + faces[f + 10] * (x[1] - faces[f + 1])
            + faces[f + 11] * (x[2] - faces[f + 2])
        )
        if along > best * (1.0 + TIE) or (flat and along > best * (1.0 - TIE)):
            continue  # no place on it is nearer
        d, at = to_triangle(x, faces, f, normal)
        if d < best:
            nearest = f
            flat = at == WITHIN
        best, side = beside(best, side, d, at, faces, f, normal)
    d = np.copysign(best, side)
    _ = to_triangle(x, faces, nearest, normal)
    for i in range(3):
        normal[i] = faces[nearest + 9 + i] if flat or d == 0.0 else normal[i] / d
    return d


@compiled
def near_triangles(faces, origin, spacing, band, values, side, listed, beyond):
    """values (nx, ny, nz): smallest distance to the faces (m, 12), where less than what stands there, up to `band` (m); side: of `beside`.

    Returns flat indices (n,) of points that are to be listed, (nx, ny, nz), and of faces no farther than their value and `beyond` (m).
    """
    low = np.empty(3, np.int64)
    high = np.empty(3, np.int64)
    x = np.empty(3)
    away = np.empty(3)
    flat = faces.reshape(-1)
    points = [0 for _ in range(0)]
    found = [0 for _ in range(0)]
    for f in range(len(faces)):
        for k in range(3):
            low[k] = max(0, int(np.ceil((faces[f, k:9:3].min() - band - origin[k]) / spacing)))
            high[k] = min(
                values.shape[k] - 1,
                int(np.floor((faces[f, k:9:3].max() + band - origin[k]) / spacing)),
            )
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for k in range(low[2], high[2] + 1):
                    x[0], x[1], x[2] = (
                        origin[0] + spacing * i,
                        origin[1] + spacing * j,
                        origin[2] + spacing * k,
                    )
                    d, at = to_triangle(x, flat, 12 * f, away)
                    values[i, j, k], side[i, j, k] = beside(
                        values[i, j, k], side[i, j, k], d, at, flat, 12 * f, away
                    )
                    if listed[i, j, k] and d <= values[i, j, k] + beyond:
                        points.append((i * values.shape[1] + j) * values.shape[2] + k)
                        found.append(f)
    return np.array(points), np.array(found)


@inlined_elsewhere
def _splines(p, count):
    """The middle of those three of `count` points whose quadratic splines reach a place p, how far (1/2 at most) it is from there, and the
    splines' values and slopes."""
    i = larger(smaller(math.floor(p + 0.5), count - 2.0), 1.0)
    d = p - i
    low = 0.5 - d
    high = 0.5 + d
    return i, d, (0.5 * low * low, 0.75 - d * d, 0.5 * high * high), (-low, -2.0 * d, high)


@inlined_elsewhere
def _around(p, q, r, shape):
    """Index of the first coefficient that a place sees; how far it is from the middle one, along the axis where that is most; values and
    slopes of the splines along all axes."""
    i, x, u, du = _splines(p, shape[0])
    j, y, v, dv = _splines(q, shape[1])
    k, z, w, dw = _splines(r, shape[2])
    first = ((i - 1.0) * float(shape[1]) + (j - 1.0)) * float(shape[2]) + (k - 1.0)
    return first, larger(larger(abs(x), abs(y)), abs(z)), (u, v, w), (du, dv, dw)


@inlined_elsewhere
def value(p, q, r, spacing, shape, coefficients):
    """Distance (m) and the three components of its slope, at a place p, q, r in points from the first of a table of this shape, of one
    point or eight; inf, with a slope of no meaning, where the table does not reach."""
    first, away, (u, v, w), (du, dv, dw) = _around(p, q, r, shape)
    here = 0.0 * away
    along_x = here
    along_y = here
    along_z = here
    for a in range(3):
        on = 0.0 * away
        aside = on
        up = on
        for b in range(3):
            c0, c1, c2 = pick(coefficients, first, (a * shape[1] + b) * shape[2])
            row = w[0] * c0 + w[1] * c1 + w[2] * c2
            on = on + v[b] * row
            aside = aside + dv[b] * row
            up = up + v[b] * (dw[0] * c0 + dw[1] * c1 + dw[2] * c2)
        here = here + u[a] * on
        along_x = along_x + du[a] * on
        along_y = along_y + u[a] * aside
        along_z = along_z + u[a] * up
    distance = above(away, 0.5, np.inf, here)
    return distance, along_x / spacing, along_y / spacing, along_z / spacing


@inner
def curvature(p, q, r, spacing, shape, coefficients):
    """Second derivatives (1/m) of the distance along xx, yy, zz, xy, xz, yz, constant or linear in each cell; arguments as of `value`."""
    first, _, (u, v, w), (du, dv, dw) = _around(p, q, r, shape)
    second = (1.0, -2.0, 1.0)
    xx = 0.0
    yy = 0.0
    zz = 0.0
    xy = 0.0
    xz = 0.0
    yz = 0.0
    for a in range(3):
        for b in range(3):
            c0, c1, c2 = pick(coefficients, first, (a * shape[1] + b) * shape[2])
            line = w[0] * c0 + w[1] * c1 + w[2] * c2
            slope = dw[0] * c0 + dw[1] * c1 + dw[2] * c2
            xx += second[a] * v[b] * line
            yy += u[a] * second[b] * line
            zz += u[a] * v[b] * (c0 - 2.0 * c1 + c2)
            xy += du[a] * dv[b] * line
            xz += du[a] * v[b] * slope
            yz += u[a] * dv[b] * slope
    scale = 1.0 / spacing**2
    return xx * scale, yy * scale, zz * scale, xy * scale, xz * scale, yz * scale
