"""The solids of an undeformed body, one for each of its components: how deep a place lies in them.

A point of another surface touches a solid where the place in the undeformed solid that is now at the point lies below its surface. Rods
and boxes have exact distances, components of meshes a table (bodies.signed_distance). Bores are taken as full: nothing enters them.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from magmpm.bodies.contact_surface import cut
from magmpm.bodies.signed_distance import Table, solid, to_triangles, value
from magmpm.compiled.arrays import Array, Index
from magmpm.compiled.jit import compiled

BOX, ROD, TABLE = range(3)
FINE = 4  # points of a table in a cell width


class Solids(NamedTuple):
    """kind (s,): BOX, ROD or TABLE; size (s, 6) m: corners of a box; both ends and radius of a rod along x; a table's first point and
    spacing; points (s, 3) of a table along x, y, z; first (s + 1,): where its coefficients (k,) begin."""

    kind: Index
    size: Array
    points: Index
    first: Index
    coefficients: Array


def box_solid(low: Sequence[float], high: Sequence[float]) -> Solids:
    """A box between two corners (3,) m."""
    return _one(BOX, [*low, *high])


def rod_solid(start: float, end: float, radius: float) -> Solids:
    """A round rod around the x axis, from start to end (m)."""
    return _one(ROD, [start, end, radius, 0.0, 0.0, 0.0])


def mesh_solids(components: Sequence[Sequence[Array]], cell: float) -> Solids:
    """One solid for each component: parts (f, 3, 3) m that hold together, without the faces on which they touch; cell: of the grid, m."""
    tables = [_table(parts, cell) for parts in components]
    return Solids(
        kind=np.full(len(tables), TABLE),
        size=np.array([[*table.origin, table.spacing, 0.0, 0.0] for table in tables]),
        points=np.array([table.coefficients.shape for table in tables]),
        first=np.cumsum([0, *(table.coefficients.size for table in tables)]),
        coefficients=np.concatenate([table.coefficients.ravel() for table in tables]),
    )


def _one(kind: int, size: list[float]) -> Solids:
    return Solids(np.array([kind]), np.array([size]), np.zeros((1, 3), np.int64), np.zeros(2, np.int64), np.zeros(0))


def _table(parts: Sequence[Array], cell: float) -> Table:
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
    return solid(parts, np.concatenate(outside), spacing)


def _meets(triangles: Array, other: Array, within: float) -> NDArray[np.bool_]:
    """Triangles (f, 3, 3) that come nearer than this (m) to the box around other ones (g, 3, 3)."""
    low, high = other.reshape(-1, 3).min(axis=0) - within, other.reshape(-1, 3).max(axis=0) + within
    return np.asarray(np.all((triangles.max(axis=1) > low) & (triangles.min(axis=1) < high), axis=1))


@compiled
def solid_distance(solids, s, x, normal):  # type: ignore[no-untyped-def]
    """Signed distance (m) of a place x (3,) m from the surface of solid s, negative inside; normal (3,): its slope, outward.

    Beside edges outside of a box or rod it is that of the nearest face's plane, which is less.
    """
    kind = solids.kind[s]
    normal[:] = 0.0
    if kind == TABLE:
        at, spacing = solids.size[s], solids.size[s, 3]
        p, q, r = (x[0] - at[0]) / spacing, (x[1] - at[1]) / spacing, (x[2] - at[2]) / spacing
        nx, ny, nz = solids.points[s, 0], solids.points[s, 1], solids.points[s, 2]
        if not (0.5 <= p < nx - 1.5 and 0.5 <= q < ny - 1.5 and 0.5 <= r < nz - 1.5):
            return np.inf
        d, s0, s1, s2 = value(p, q, r, spacing, ny, nz, solids.coefficients[solids.first[s] : solids.first[s + 1]])
        normal[0], normal[1], normal[2] = -s0, -s1, -s2
        return -d
    most = -np.inf
    axes = 1 if kind == ROD else 3
    for i in range(axes):
        low, high = solids.size[s, i], solids.size[s, i + 3 if kind == BOX else 1]
        d = max(low - x[i], x[i] - high)
        if d > most:
            most = d
            normal[:] = 0.0
            normal[i] = 1.0 if x[i] - high > low - x[i] else -1.0
    if kind == ROD:
        r = np.sqrt(x[1] ** 2 + x[2] ** 2)
        if r - solids.size[s, 2] > most:
            most = r - solids.size[s, 2]
            normal[0], normal[1], normal[2] = 0.0, x[1] / r, x[2] / r
    return most
