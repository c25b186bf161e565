"""The solids of an undeformed body, one for each of its components: how deep a place lies in them.

A point of another surface touches a solid where the place in the undeformed solid that is now at the point lies below its surface. Boxes
and rods are planes and a cylinder; components of meshes have a table of distances (bodies.signed_distance), and where its splines bend
around an edge, the faces of the mesh.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from magmpm.bodies import signed_distance as distance
from magmpm.bodies.contact_surface import cut
from magmpm.bodies.curves import face_normals
from magmpm.compiled.arrays import Array, Index, Mask
from magmpm.compiled.jit import compiled

ON = 0.1  # of a table's spacing: parts that come this near are on each other
PLACES = np.vstack(
    [np.eye(3), np.full(3, 1 / 3)]
)  # in a triangle, as shares of its corners, that tell whether it is on another part
# times: triangles that are partly on another part are cut, from 64 cells down to a table's spacing
HALVED = 8
TABLE_POINTS_PER_CELL = 4  # points of a table in a cell width
# of a table's spacing: what is this far outside by its faces may be within, beside a crack between
# faces of joined parts
CRACK = 0.25
NEEDLE = (
    distance.SLIVER_THICKNESS / TABLE_POINTS_PER_CELL
)  # cells: thickness of triangles that are left out
# of the spacing: error of a table beside edges of 10 degrees. Beside square ones it is 0.2, and
# what slides there is pushed
SHARP = 0.02
POINTS_AROUND_FOOT = 3  # points around those: from one to the next the error falls to a sixth


class Solids(NamedTuple):
    """points (s, 3) of a table along x, y, z, or zeros; size (s, 4) m: its first point and spacing, or the radius of a rod, inf for a box;
    first (s + 1,): where its coefficients (k,) begin, or planes (4 each): unit normal outward, its product with a place of the plane, m;
    near: where in itself the faces around each coefficient's point begin (k + 1,), then these; faces (12 each): corners m, unit normal.
    """

    size: Array
    points: Index
    first: Index
    coefficients: Array
    near: Index
    faces: Array


def box_solid(low: Sequence[float], high: Sequence[float]) -> Solids:
    """A box between two corners (3,) m."""
    return _exact(
        np.inf, np.column_stack([np.vstack([-np.eye(3), np.eye(3)]), [*(-c for c in low), *high]])
    )


def rod_solid(start: float, end: float, radius: float) -> Solids:
    """A round rod around the x axis, from start to end (m)."""
    return _exact(radius, np.array([[-1.0, 0.0, 0.0, -start], [1.0, 0.0, 0.0, end]]))


def _exact(radius: float, planes: Array) -> Solids:
    none = np.zeros((1, 3), np.int64)
    return Solids(
        np.array([[radius, 0.0, 0.0, 0.0]]),
        none,
        np.array([0, planes.size]),
        planes.ravel(),
        none[0],
        np.zeros(0),
    )


def mesh_solids(components: Sequence[Sequence[Array]], cell: float, gap: float = 0.0) -> Solids:
    """One solid for each component: parts (f, 3, 3) m that hold together, across gaps (m) too, without faces inside; cell: of grids, m."""
    within = max(ON * cell / TABLE_POINTS_PER_CELL, gap)
    outside = [_outside(parts, cell, within) for parts in components]
    tables = [
        distance.solid(parts, corners, cell / TABLE_POINTS_PER_CELL, within)
        for parts, corners in zip(components, outside, strict=True)
    ]
    faces = [distance.faces_of(corners) for corners in outside]
    around = [_around(*each) for each in zip(tables, faces, strict=True)]
    first, before = (
        np.cumsum([0, *each]) for each in ([table.flat.size for table in tables], map(len, faces))
    )
    point, face = (
        np.concatenate([each[n] + start[k] for k, each in enumerate(around)])
        for n, start in enumerate((first, before))
    )
    order = np.argsort(point, kind="stable")
    near = np.concatenate(
        [first[-1] + 1 + np.searchsorted(point[order], np.arange(first[-1] + 1)), face[order]]
    )
    return Solids(
        np.array([[*table.origin, table.spacing] for table in tables]),
        np.array([table.coefficients.shape for table in tables]),
        first,
        np.concatenate([table.flat for table in tables]),
        near,
        np.concatenate(faces).ravel(),
    )


def _around(table: distance.DistanceTable, faces: Array) -> tuple[Index, Index]:
    """Points of a table around which it is off, as near edges of its faces (m, 12), and faces that may be nearest there; as pairs."""
    from scipy.ndimage import binary_dilation, correlate1d, map_coordinates

    place = (
        cut(faces[:, :9].reshape(-1, 3, 3), table.spacing).reshape(-1, 3) - table.origin
    ) / table.spacing
    off = (
        np.abs(
            map_coordinates(table.coefficients, place.T, order=2, mode="mirror", prefilter=False)
        )
        > SHARP * table.spacing
    )
    sharp = np.zeros(table.coefficients.shape, np.bool_)
    sharp[tuple(np.rint(place[off]).astype(int).T)] = True
    # of the box around a point:
    values = table.coefficients
    band = distance.BAND * table.spacing
    across = np.sqrt(3) * table.spacing
    for axis in range(3):
        values = correlate1d(values, [0.125, 0.75, 0.125], axis, mode="mirror")
    listed = binary_dilation(sharp, np.ones((3, 3, 3)), POINTS_AROUND_FOOT) & (
        np.abs(values) < band - across
    )  # its distances differ by so much
    return distance.near_triangles(
        faces,
        table.origin,
        table.spacing,
        band,
        np.abs(values),
        np.zeros_like(values),
        listed,
        across,
    )


def _outside(parts: Sequence[Array], cell: float, within: float) -> Array:
    """The surface (m, 3, 3) m of a component: that of its parts, without what is on another part, where the two hold together."""
    surface = []
    for k, part in enumerate(parts):
        others = np.concatenate([part[:0], *(other for j, other in enumerate(parts) if j != k)])
        near = np.any(
            [
                np.zeros(len(part), np.bool_),
                *(meets(part, other, within) for j, other in enumerate(parts) if j != k),
            ],
            axis=0,
        )
        surface.append(part[~near])
        for triangle in part[near]:
            there = others[meets(others, triangle[None], within)]
            pieces = _uncovered(triangle, there, within, NEEDLE * cell)
            for times in range(HALVED, -1, -1):  # where round parts with other facets hold together
                pieces = cut(pieces, cell / TABLE_POINTS_PER_CELL * 2**times)
                off = (
                    distance.to_triangles(
                        (PLACES @ pieces).reshape(-1, 3), np.ascontiguousarray(there)
                    )
                    > within
                ).reshape(-1, 4)
                surface.append(pieces[off.any(axis=1) if times == 0 else off.all(axis=1)])
                pieces = pieces[off.any(axis=1) & ~off.all(axis=1)]
    return np.ascontiguousarray(np.concatenate(surface))


def _uncovered(triangle: Array, others: Array, within: float, thin: float) -> Array:
    """Pieces (k, 3, 3) m, no slivers (thin, m), of a triangle (3, 3) m that are not on others (n, 3, 3) which face it, this near (m)."""
    from manifold3d import CrossSection, FillRule, JoinType, triangulate

    along, aside = triangle[1:] - triangle[0]
    frame = np.array([along, np.cross(np.cross(along, aside), along), np.cross(along, aside)])
    frame /= np.linalg.norm(frame, axis=1)[:, None]
    own, flat = (
        (each - triangle[0]) @ frame.T / within for each in (triangle, others)
    )  # Clipper rounds to 1e-8
    facing = face_normals(flat)[:, 2] < 0
    on = flat[facing & (np.abs(flat[:, :, 2]).max(axis=1) < 1.0)]
    if not len(on):
        return triangle[None]
    whole = CrossSection([own[:, :2]])
    more = thin / within
    left = (
        whole - CrossSection(list(on[:, ::-1, :2]), FillRule.NonZero).offset(more, JoinType.Miter)
    ).offset(more, JoinType.Miter) ^ whole
    outlines = left.to_polygons()
    corners = np.concatenate(outlines) if outlines else np.zeros((0, 2))
    return np.asarray((triangle[0] + within * corners @ frame[:2])[triangulate(outlines)])


def meets(triangles: Array, other: Array, within: float) -> Mask:
    """Triangles (f, 3, 3) that come nearer than this (m) to the box around other ones (g, 3, 3)."""
    low = other.reshape(-1, 3).min(axis=0) - within
    high = other.reshape(-1, 3).max(axis=0) + within
    return np.asarray(
        np.all((triangles.max(axis=1) > low) & (triangles.min(axis=1) < high), axis=1)
    )


@compiled
def solid_distance(solids, s, x, normal):  # type: ignore[no-untyped-def]
    """Signed distance (m) of a place x (3,) m from the surface of solid s, negative inside; normal (3,): its slope, outward.

    Beside edges outside of a box or rod it is that of the farthest face's plane, which is less.
    """
    begin = solids.first[s]
    end = solids.first[s + 1]
    nx = solids.points[s, 0]
    ny = solids.points[s, 1]
    nz = solids.points[s, 2]
    size = solids.size[s]
    most = -np.inf
    if nx > 0:
        p = (x[0] - size[0]) / size[3]
        q = (x[1] - size[1]) / size[3]
        r = (x[2] - size[2]) / size[3]
        normal[:] = 0.0
        if not (0.5 <= p < nx - 1.5 and 0.5 <= q < ny - 1.5 and 0.5 <= r < nz - 1.5):
            return np.inf
        point = begin + (int(p + 0.5) * ny + int(q + 0.5)) * nz + int(r + 0.5)
        if solids.near[point] < solids.near[point + 1]:
            d = distance.to_faces(
                solids.near[point], solids.near[point + 1], solids.near, solids.faces, x, normal
            )
            if (
                d < CRACK * size[3]
                or distance.value(p, q, r, size[3], (nx, ny, nz), solids.coefficients[begin:end])[0]
                < 0.0
            ):
                return d
            normal *= -1.0
            return -d
        d, s0, s1, s2 = distance.value(
            p, q, r, size[3], (nx, ny, nz), solids.coefficients[begin:end]
        )
        normal[0], normal[1], normal[2] = -s0, -s1, -s2
        return -d
    for k in range(begin, end, 4):
        plane = solids.coefficients[k : k + 4]
        d = plane[0] * x[0] + plane[1] * x[1] + plane[2] * x[2] - plane[3]
        if d > most:
            most = d
            normal[:] = plane[:3]
    r = np.sqrt(x[1] ** 2 + x[2] ** 2)
    if r - size[0] > most:
        most = r - size[0]
        normal[0], normal[1], normal[2] = 0.0, x[1] / r, x[2] / r
    return most
