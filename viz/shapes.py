"""Surfaces of triangles, and those of bodies whose shape is known: tubes and bars, sharp edges and all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Surface:
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
    def joined(cls, surfaces: Sequence[Surface]) -> Surface:
        """One surface of several, which share no points."""
        first = np.cumsum([0, *(len(s.points) for s in surfaces[:-1])])
        return cls(
            np.vstack([s.points for s in surfaces]),
            np.vstack([s.triangles + start for s, start in zip(surfaces, first)]),
            np.concatenate([s.part for s in surfaces]),
        )


def normals(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Unit normals (n, 3) at the points: the triangles' around it, by their areas."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    face = np.cross(b - a, c - a)
    total = np.zeros_like(points, dtype=float)
    for i in range(3):
        for axis in range(3):
            total[:, axis] += np.bincount(triangles[:, i], face[:, axis], minlength=len(points))
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)


def tube(ends: Sequence[float], outer: float, inner: float, step: float, around: int = 40) -> Surface:
    """A straight tube or rod along +x from the origin.

    ends: m, where each part ends along x; outer, inner: radii in m; step: m, about the length of a triangle.
    """
    turn = 2 * np.pi * np.arange(around) / around
    circle = np.stack([np.zeros(around), np.cos(turn), np.sin(turn)], axis=1)
    pieces, start = [], 0.0
    for k, end in enumerate(ends):
        along = np.linspace(start, end, max(round((end - start) / step), 1) + 1)
        for radius, outward in ((outer, True), (inner, False)):
            if radius > 0:
                rings = [radius * circle + [x, 0.0, 0.0] for x in along]
                pieces.append(lofted(rings, k, closed=True, flip=outward))
        start = end
    radii = np.linspace(inner, outer, max(round((outer - inner) / step), 2) + 1)
    for x, part, front in ((0.0, 0, False), (ends[-1], len(ends) - 1, True)):
        rings = [max(r, 1e-6 * outer) * circle + [x, 0.0, 0.0] for r in radii]
        pieces.append(lofted(rings, part, closed=True, flip=not front))
    return Surface.joined(pieces)


def bar(
    ends: Sequence[float], width: float, thickness: float, step: float, base: Sequence[float] = (0, 0, 0)
) -> Surface:
    """A straight bar with sharp edges along +x: width along y, thickness along z, all in m.

    ends: m from the base, where each part ends; base (3,) m: centre of its base face; step: m, about the length of a triangle.
    """
    y, z = (np.linspace(-size / 2, size / 2, max(round(size / step), 1) + 1) for size in (width, thickness))
    pieces, start = [], 0.0
    for k, end in enumerate(ends):
        along = np.linspace(start, end, max(round((end - start) / step), 1) + 1)
        for side in (-1, 1):
            top = [
                np.stack([np.full(len(y), x), y, np.full(len(y), side * thickness / 2)], axis=1)
                for x in along
            ]
            face = [
                np.stack([np.full(len(z), x), np.full(len(z), side * width / 2), z], axis=1) for x in along
            ]
            pieces += [
                lofted(top, k, closed=False, flip=side < 0),
                lofted(face, k, closed=False, flip=side > 0),
            ]
        start = end
    for x, part, front in ((0.0, 0, False), (ends[-1], len(ends) - 1, True)):
        rows = [np.stack([np.full(len(z), x), np.full(len(z), at), z], axis=1) for at in y]
        pieces.append(lofted(rows, part, closed=False, flip=not front))
    whole = Surface.joined(pieces)
    return Surface(whole.points + np.asarray(base, dtype=float), whole.triangles, whole.part)


def lofted(rows: Sequence[np.ndarray], part: int, *, closed: bool, flip: bool) -> Surface:
    """Triangles between rows (r, 3) of points."""
    r = len(rows[0])
    j = np.arange(r if closed else r - 1)
    after = (j + 1) % r
    strips = [
        np.concatenate(
            [
                np.stack([i * r + j, (i + 1) * r + j, (i + 1) * r + after], axis=1),
                np.stack([i * r + j, (i + 1) * r + after, i * r + after], axis=1),
            ]
        )
        for i in range(len(rows) - 1)
    ]
    triangles = np.vstack(strips)
    if flip:
        triangles = triangles[:, ::-1]
    return Surface(np.vstack(rows), triangles, np.full(len(triangles), part))


def refined(surface: Surface, longest: float, most: int = 200_000) -> Surface:
    """The same surface with every edge longer than `longest` (m) halved until none is, or `most` triangles are reached."""
    points, triangles, part = surface.points, surface.triangles, surface.part
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
    return Surface(points, triangles, part)


def _split(triangles: np.ndarray, part: np.ndarray, middle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles cut at the middles (m, 3) of their edges 01, 12, 20; -1 where an edge stays whole."""
    new, owner = [], []

    def keep(rows: np.ndarray, *corners: np.ndarray) -> None:
        new.append(np.stack(corners, axis=1))
        owner.append(part[rows])

    cuts = (middle >= 0).sum(axis=1)
    rows = np.flatnonzero(cuts == 0)
    keep(rows, *triangles[rows].T)
    rows = np.flatnonzero(cuts == 3)
    (a, b, c), (ab, bc, ca) = triangles[rows].T, middle[rows].T
    for corners in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)):
        keep(rows, *corners)
    for count in (1, 2):
        rows = np.flatnonzero(cuts == count)
        # Turned so that edge 01 is the only one cut, or the only whole one.
        turn = np.argmax((middle[rows] >= 0) == (count == 1), axis=1)
        order = (turn[:, None] + np.arange(3)) % 3
        (a, b, c) = np.take_along_axis(triangles[rows], order, axis=1).T
        (ab, bc, ca) = np.take_along_axis(middle[rows], order, axis=1).T
        if count == 1:
            keep(rows, a, ab, c)
            keep(rows, ab, b, c)
        else:
            keep(rows, ca, bc, c)
            keep(rows, a, b, bc)
            keep(rows, a, bc, ca)
    return np.vstack(new), np.concatenate(owner)
