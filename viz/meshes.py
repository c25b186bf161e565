"""Surfaces of triangles: tubes, bars and balls with sharp edges, tubes around paths, and finer or creased copies of a mesh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class TriangleSurface:
    """points (n, 3) m, triangles (m, 3) counter-clockwise from outside, part (m,) of each triangle."""

    points: np.ndarray
    triangles: np.ndarray
    part: np.ndarray

    @property
    def part_of_point(self) -> np.ndarray:
        """(n,) part of a triangle at each point."""
        of = np.zeros(len(self.points), dtype=int)
        of[self.triangles.ravel()] = np.repeat(self.part, 3)
        return of

    @classmethod
    def joined(cls, surfaces: Sequence[TriangleSurface]) -> TriangleSurface:
        """One surface made of several that share no points."""
        first = np.cumsum([0, *(len(s.points) for s in surfaces[:-1])])
        return cls(
            np.vstack([s.points for s in surfaces]),
            np.vstack([s.triangles + int(start) for s, start in zip(surfaces, first)]),
            np.concatenate([s.part for s in surfaces]),
        )


def fan(count: int) -> np.ndarray:
    """Triangles (count, 3) around a ring of so many points, whose middle is the point after them."""
    number = np.arange(count)
    middle = np.full(count, count)
    return np.stack([middle, number, (number + 1) % count], axis=1).astype(np.int32)


def normals(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(n, 3) unit normals at the points: the mean of the triangles around each, weighted by their areas.

    Without the weights, rounding turns the normals of slivers, such as those at the center of a disc, into any direction.
    """
    a, b, c = np.moveaxis(np.asarray(points, dtype=float)[triangles], 1, 0)
    corners = triangles.ravel()
    face = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    total = np.stack(
        [np.bincount(corners, face[:, axis], len(points)) for axis in range(3)], axis=1
    )
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)


def lofted(rows: Sequence[np.ndarray], part: int, *, closed: bool, flip: bool) -> TriangleSurface:
    """Triangles between rows (r, 3) of points; closed: the rows are rings."""
    r = len(rows[0])
    j = np.arange(r if closed else r - 1)
    after = (j + 1) % r
    first = r * np.arange(len(rows) - 1)[:, None, None]
    corners = np.concatenate(
        [np.stack([j, r + j, r + after], axis=1), np.stack([j, r + after, after], axis=1)]
    )
    triangles = (
        (first + corners).reshape(-1, 3).astype(np.int32)
    )  # small where it travels to the drawing process
    return TriangleSurface(
        np.vstack(rows), triangles[:, ::-1] if flip else triangles, np.full(len(triangles), part)
    )


def circle(radius: float, around: int, x: float = 0.0) -> np.ndarray:
    """Points (around, 3) m of a circle about the x axis, at x (m)."""
    turn = 2 * np.pi * np.arange(around) / around
    return np.stack([np.full(around, x), radius * np.cos(turn), radius * np.sin(turn)], axis=1)


def tube(
    ends: Sequence[float], outer: float, inner: float, step: float, around: int = 40
) -> TriangleSurface:
    """A straight tube or rod along +x from the origin.

    ends: m, where each part ends along x; outer, inner: radii in m; step: m, about the length of a triangle.
    """
    pieces = []
    start = 0.0
    for k, end in enumerate(ends):
        along = _marks(start, end, step)
        for radius, outward in ((outer, True), (inner, False)):
            if radius > 0:
                rings = [circle(radius, around, x) for x in along]
                pieces.append(lofted(rings, k, closed=True, flip=outward))
        start = end
    radii = np.linspace(inner, outer, max(round((outer - inner) / step), 2) + 1)
    for x, part, front in ((0.0, 0, False), (ends[-1], len(ends) - 1, True)):
        rings = [circle(max(r, 1e-6 * outer), around, x) for r in radii]
        pieces.append(lofted(rings, part, closed=True, flip=not front))
    return TriangleSurface.joined(pieces)


def bar(
    ends: Sequence[float],
    width: float,
    thickness: float,
    step: float,
    base: Sequence[float] = (0, 0, 0),
) -> TriangleSurface:
    """A straight bar with sharp edges along +x: width along y, thickness along z, all in m.

    ends: m from the base, where each part ends; base (3,) m: center of its base face; step: m, about the length of a triangle.
    """
    y, z = (_marks(-size / 2, size / 2, step) for size in (width, thickness))

    def row(x: float, at_y: np.ndarray | float, at_z: np.ndarray | float) -> np.ndarray:
        return np.stack(np.broadcast_arrays(x, at_y, at_z), axis=1)

    pieces = []
    start = 0.0
    for k, end in enumerate(ends):
        along = _marks(start, end, step)
        for side in (-1, 1):
            pieces.append(
                lofted(
                    [row(x, y, side * thickness / 2) for x in along], k, closed=False, flip=side < 0
                )
            )
            pieces.append(
                lofted([row(x, side * width / 2, z) for x in along], k, closed=False, flip=side > 0)
            )
        start = end
    for x, part, front in ((0.0, 0, False), (ends[-1], len(ends) - 1, True)):
        pieces.append(lofted([row(x, at, z) for at in y], part, closed=False, flip=not front))
    whole = TriangleSurface.joined(pieces)
    return TriangleSurface(
        whole.points + np.asarray(base, dtype=float), whole.triangles, whole.part
    )


def _marks(low: float, high: float, step: float) -> np.ndarray:
    """Evenly spread values from low to high, about a step apart."""
    return np.linspace(low, high, max(round((high - low) / step), 1) + 1)


def ball(radius: float, around: int = 48) -> TriangleSurface:
    """A sphere about the origin. Its half toward -x is part 0, the other part 1."""
    angles = np.linspace(0.0, np.pi, around // 2 + 1)
    rings = [circle(radius * max(np.sin(a), 1e-6), around, -radius * np.cos(a)) for a in angles]
    whole = lofted(rings, 0, closed=True, flip=True)
    north = whole.points[whole.triangles].mean(axis=1)[:, 0] > 0
    return TriangleSurface(whole.points, whole.triangles, north.astype(int))


def ring_sections(path: np.ndarray, section: np.ndarray, first: np.ndarray) -> list[np.ndarray]:
    """A section's points (a, 3) m, with x = 0, at each point of a path (n, 3) m: across it, and turned as little as it can be.

    first (3,): the direction of the section's y at the path's beginning.
    """
    tangent = np.gradient(path, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-300)
    rings = []
    for point, along in zip(path, tangent):
        first = first - along * (first @ along)
        first = first / np.linalg.norm(first)
        rings.append(point + section @ np.stack([along, first, np.cross(along, first)]))
    return rings


def swept(path: np.ndarray, radius: float, around: int = 32) -> TriangleSurface:
    """An open tube of that radius (m) around a path (n, 3) m."""
    begins = path[1] - path[0]
    first = np.cross(begins, np.eye(3)[np.argmin(np.abs(begins))])
    return lofted(ring_sections(path, circle(radius, around), first), 0, closed=True, flip=True)


def refined(surface: TriangleSurface, longest: float, most: int = 200_000) -> TriangleSurface:
    """The same surface with every edge longer than `longest` (m) halved until none is, or `most` triangles are reached."""
    points = surface.points
    triangles = surface.triangles
    part = surface.part
    while len(triangles) < most:
        edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        unique, which = np.unique(edges, axis=0, return_inverse=True)
        long = np.linalg.norm(points[unique[:, 0]] - points[unique[:, 1]], axis=1) > longest
        if not long.any():
            break
        middle = np.full(len(unique), -1)
        middle[long] = len(points) + np.arange(np.count_nonzero(long))
        points = np.vstack([points, points[unique[long]].mean(axis=1)])
        triangles, part = _split(triangles, part, middle[which.reshape(-1, 3)])
    return TriangleSurface(points, triangles, part)


# Triangles that replace one with so many edges cut. Corners are 0 to 2; the middles of the edges 01, 12, 20 are 3 to 5.
_CUTS = {0: ("012",), 1: ("032", "312"), 2: ("542", "014", "045"), 3: ("035", "314", "542", "345")}


def _split(
    triangles: np.ndarray, part: np.ndarray, middle: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Triangles cut at the middles (m, 3) of their edges 01, 12, 20; -1 where an edge stays whole."""
    new = []
    owner = []
    cuts = (middle >= 0).sum(axis=1)
    for count, pieces in _CUTS.items():
        rows = np.flatnonzero(cuts == count)
        # Turned so that edge 01 is the only one cut, or the only whole one.
        turn = (
            np.argmax((middle[rows] >= 0) == (count == 1), axis=1)
            if count in (1, 2)
            else np.zeros(len(rows), dtype=int)
        )
        order = (turn[:, None] + np.arange(3)) % 3
        corners = np.hstack(
            [np.take_along_axis(of[rows], order, axis=1) for of in (triangles, middle)]
        )
        for piece in pieces:
            new.append(corners[:, [int(c) for c in piece]])
            owner.append(part[rows])
    return np.vstack(new), np.concatenate(owner)


def creased(
    points: np.ndarray, triangles: np.ndarray, part: int, angle: float = 40.0
) -> TriangleSurface:
    """A closed mesh (n, 3) m, (m, 3), whose points are split where neighboring triangles meet at more than an angle (degrees).

    So the edges of a drawing stay sharp where normals are averaged over a point's triangles.
    """
    from scipy import sparse  # not in the drawing process, which imports this file as well
    from scipy.sparse import csgraph

    a, b, c = (points[triangles[:, i]] for i in range(3))
    face = np.cross(b - a, c - a)
    face /= np.maximum(np.linalg.norm(face, axis=1, keepdims=True), 1e-300)
    count = len(triangles)
    edge = np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)])
    of = np.tile(np.arange(count), 3)
    first, second = (
        np.concatenate([3 * np.arange(count) + (i + k) % 3 for i in range(3)]) for k in (0, 1)
    )
    order = np.lexsort(np.sort(edge, axis=1).T)
    one = order[:-1]
    other = order[1:]
    pair = (np.sort(edge[one], axis=1) == np.sort(edge[other], axis=1)).all(axis=1)
    one = one[pair]
    other = other[pair]
    smooth = np.einsum("ij,ij->i", face[of[one]], face[of[other]]) > np.cos(np.radians(angle))
    one = one[smooth]
    other = other[smooth]
    # Neighbors run along their common edge in opposite directions.
    rows = np.concatenate([first[one], second[one]])
    columns = np.concatenate([second[other], first[other]])
    graph = sparse.coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(3 * count, 3 * count))
    number, corner = csgraph.connected_components(graph, directed=False)
    split = np.zeros((number, 3))
    split[corner] = points[triangles.ravel()]
    return TriangleSurface(split, corner.reshape(-1, 3), np.full(count, part))
