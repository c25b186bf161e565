"""The solids of an undeformed body, one for each of its components: how deep a place lies in them.

A point of another surface touches a solid where the place in the undeformed solid that is now at the point lies below its surface. Rods
and lone convex parts of few faces have exact distances, other components of meshes a table (bodies.signed_distance). Beside sharp edges its
surface bulges by 0.08 of its spacing, and what slides under such an edge is pushed. Bores of tubes are taken as full.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from magmpm.bodies.contact_surface import cut
from magmpm.bodies.signed_distance import solid, to_triangles, value
from magmpm.compiled.arrays import Array, Index
from magmpm.compiled.jit import compiled

CONVEX, ROD, TABLE = range(3)
MOST_PLANES = 100  # of a convex solid: 0.5 us a pair, where a table takes 0.06; a tenth of a motion at most
FLAT = 1e-3  # cells: what is nearer to a plane lies on it. Turned STL files have a millionth
FINE = 4  # points of a table in a cell width


class Solids(NamedTuple):
    """kind (s,): CONVEX, ROD or TABLE; size (s, 4) m: first the radius of a rod along x, or a table's first point and spacing, or zeros;
    points (s, 3) of a table along x, y, z; first (s + 1,): where its coefficients (k,) begin, or the planes (4 each) of a convex solid and
    of a rod's ends: unit normal outward, and its product with a place of the plane, m."""

    kind: Index
    size: Array
    points: Index
    first: Index
    coefficients: Array


def box_solid(low: Sequence[float], high: Sequence[float]) -> Solids:
    """A box between two corners (3,) m."""
    return _one(CONVEX, np.column_stack([np.vstack([-np.eye(3), np.eye(3)]), [*(-c for c in low), *high]]))


def rod_solid(start: float, end: float, radius: float) -> Solids:
    """A round rod around the x axis, from start to end (m)."""
    return _one(ROD, np.array([[-1.0, 0.0, 0.0, -start], [1.0, 0.0, 0.0, end]]), [radius, 0.0, 0.0, 0.0])


def mesh_solids(components: Sequence[Sequence[Array]], cell: float) -> Solids:
    """One solid for each component: parts (f, 3, 3) m that hold together, without the faces on which they touch; cell: of the grid, m."""
    each = [(_convex(parts[0], cell) if len(parts) == 1 else None) or _table(parts, cell) for parts in components]
    kind, size, points, _, coefficients = (np.concatenate(fields) for fields in zip(*each, strict=True))
    return Solids(kind, size, points, np.cumsum([0, *(one.coefficients.size for one in each)]), coefficients)


def _one(kind: int, coefficients: Array, size: Sequence[float] = (0.0,) * 4, points: Sequence[int] = (0, 0, 0)) -> Solids:
    return Solids(np.array([kind]), np.array([size]), np.array([points]), np.array([0, coefficients.size]), coefficients.ravel())


def _convex(part: Array, cell: float) -> Solids | None:
    """The solid of a part (f, 3, 3) m that is its own convex hull and has at most MOST_PLANES faces; of another, None."""
    from scipy.spatial import ConvexHull  # 0.1 s to import, and most scenes have no meshes

    hull, planes = ConvexHull(part.reshape(-1, 3)), list[Array]()
    faces, equations = hull.points[hull.simplices], hull.equations
    while len(faces) and len(planes) < MOST_PLANES:
        planes.append(equations[0])
        far, off = (np.abs(each @ planes[-1][:3] + planes[-1][3]).max(axis=1) > FLAT * cell for each in (faces, part))
        faces, equations, part = faces[far], equations[far], part[off]
    return None if len(faces) or len(part) else _one(CONVEX, np.array(planes) * [1.0, 1.0, 1.0, -1.0])


def _table(parts: Sequence[Array], cell: float) -> Solids:
    """The table of a component. Triangles with all corners on another part are where the two hold together, not its surface."""
    spacing, outside = cell / FINE, []
    for k, part in enumerate(parts):
        kept = np.ones(len(part), bool)
        for other in (parts[j] for j in range(len(parts)) if j != k):
            near = _meets(part, other, spacing)
            if near.any():
                pieces = cut(part[near], cell)
                corners, there = np.ascontiguousarray(pieces.reshape(-1, 3)), np.ascontiguousarray(other[_meets(other, part, spacing)])
                free = (to_triangles(corners, there) > 0.1 * spacing).reshape(-1, 3).any(axis=1)
                part, kept = np.concatenate([part, pieces[free]]), np.concatenate([kept & ~near, np.ones(free.sum(), bool)])
        outside.append(part[kept])
    table = solid(parts, np.concatenate(outside), spacing)
    return _one(TABLE, table.coefficients, [*table.origin, table.spacing], table.coefficients.shape)


def _meets(triangles: Array, other: Array, within: float) -> NDArray[np.bool_]:
    """Triangles (f, 3, 3) that come nearer than this (m) to the box around other ones (g, 3, 3)."""
    low, high = other.reshape(-1, 3).min(axis=0) - within, other.reshape(-1, 3).max(axis=0) + within
    return np.asarray(np.all((triangles.max(axis=1) > low) & (triangles.min(axis=1) < high), axis=1))


@compiled
def solid_distance(solids, s, x, normal):  # type: ignore[no-untyped-def]
    """Signed distance (m) of a place x (3,) m from the surface of solid s, negative inside; normal (3,): its slope, outward.

    Beside edges outside of a convex solid or rod it is that of the farthest face's plane, which is less.
    """
    kind, begin, end = solids.kind[s], solids.first[s], solids.first[s + 1]
    if kind == TABLE:
        at, spacing = solids.size[s], solids.size[s, 3]
        p, q, r = (x[0] - at[0]) / spacing, (x[1] - at[1]) / spacing, (x[2] - at[2]) / spacing
        nx, ny, nz = solids.points[s, 0], solids.points[s, 1], solids.points[s, 2]
        normal[:] = 0.0
        if not (0.5 <= p < nx - 1.5 and 0.5 <= q < ny - 1.5 and 0.5 <= r < nz - 1.5):
            return np.inf
        d, s0, s1, s2 = value(p, q, r, spacing, ny, nz, solids.coefficients[begin:end])
        normal[0], normal[1], normal[2] = -s0, -s1, -s2
        return -d
    most = -np.inf
    for k in range(begin, end, 4):
        plane = solids.coefficients[k : k + 4]
        d = plane[0] * x[0] + plane[1] * x[1] + plane[2] * x[2] - plane[3]
        if d > most:
            most = d
            normal[:] = plane[:3]
    if kind == ROD:  # its ends are planes
        r = np.sqrt(x[1] ** 2 + x[2] ** 2)
        if r - solids.size[s, 0] > most:
            most = r - solids.size[s, 0]
            normal[0], normal[1], normal[2] = 0.0, x[1] / r, x[2] / r
    return most
