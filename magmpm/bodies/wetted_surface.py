"""Surfaces that a fluid meets: stretches of a rod's or strip's skin, its ends, and the faces of parts.

A slender body meets a fluid as sections: the law of its drag (effects.fluid) is one of a length of rod, or of an area of strip, so its
pieces lie around a rod, and in the middle of a strip. A body of parts meets it by the faces on its outside.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from magmpm.bodies.contact_surface import cut
from magmpm.bodies.curves import face_normals
from magmpm.bodies.signed_distance import to_triangles
from magmpm.compiled.arrays import Array, Index

ROUND, FLAT, END, FACE = range(
    4
)  # a length of rod; areas of a strip, of the end of either, of a face of a solid


@dataclass(frozen=True)
class WettedSurface:
    """Pieces (n,) of a body that a fluid meets, in the undeformed body.

    kind (n,): ROUND, FLAT, END or FACE; place (n, 3) m; tangents (n, 2, 3): of a ROUND piece the axis, and nothing; of others two unit
    vectors whose cross product is the normal, outward for END and FACE; size (n,): m of axis, or m^2; region (n,): the part that each is
    of, else 0; width, length (n,) m: of the whole body, across and along, or of a solid the diameter of a ball of its surface, twice;
    thickness (n,) m: of a strip, else 0; solid (n,): of a rod's outline, the share that is not bore, else 1.
    """

    kind: Index
    place: Array
    tangents: Array
    size: Array
    region: Index
    width: Array
    length: Array
    thickness: Array
    solid: Array

    def joined(self, other: WettedSurface) -> WettedSurface:
        """These pieces and others."""
        names = self.__dataclass_fields__
        both = {name: np.concatenate([getattr(self, name), getattr(other, name)]) for name in names}
        return WettedSurface(**both)


class Scale(NamedTuple):
    """The width, length, thickness and solid of a WettedSurface, where all of its pieces have the same."""

    width: float
    length: float
    thickness: float = 0.0
    solid: float = 1.0


def pieces(
    kind: int,
    place: Array,
    tangents: Array,
    size: Array,
    scale: Scale,
    region: Index | None = None,
) -> WettedSurface:
    """Pieces of one kind: numbers that hold for all may be given once."""
    n = len(place)
    return WettedSurface(
        np.full(n, kind),
        place,
        np.ascontiguousarray(np.broadcast_to(tangents, (n, 2, 3)), dtype=float),
        np.ascontiguousarray(np.broadcast_to(size, n), dtype=float),
        np.zeros(n, np.int64) if region is None else region,
        np.full(n, scale.width),
        np.full(n, scale.length),
        np.full(n, scale.thickness),
        np.full(n, scale.solid),
    )


def wetted_rod(faces: Array, *, outer: float, inner: float, base: bool) -> WettedSurface:
    """A round rod around the x axis: eight pieces around the middle of each cell, and its free ends.

    faces (cells + 1,) m: x of the cells' faces; outer, inner m: radii; base: whether its lower end is free.
    """
    around = 8
    angle = 2.0 * math.pi / around * (np.arange(around) + 0.5)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    middle = (faces[1:] + faces[:-1]) / 2
    side = np.column_stack([np.repeat(middle, around), np.tile(outer * circle, (len(middle), 1))])
    length = float(faces[-1] - faces[0])
    axis = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    scale = Scale(2.0 * outer, length, solid=1.0 - (inner / outer) ** 2)
    found = pieces(ROUND, side, axis, np.repeat(np.diff(faces) / around, around), scale)
    # of a disk, points at the radius of gyration have its moments
    ring = math.sqrt((outer**2 + inner**2) / 2) * circle
    area = math.pi * (outer**2 - inner**2) / around
    for x, normal in ((faces[0], -1.0), (faces[-1], 1.0)):
        if normal > 0.0 or base:
            end = np.insert(ring, 0, x, axis=1)
            found = found.joined(pieces(END, end, _across(normal), np.array(area), scale))
    return found


def wetted_strip(
    faces: Array, across: Array, z: float, thickness: float, *, one_wide: bool, base: bool
) -> WettedSurface:
    """A strip in the plane at z (m): a piece in the middle of each cell along and across, and its free ends.

    faces (cells + 1,), across (k + 1,) m: x and y of the cells' faces; one_wide: nothing varies along y; base: as in wetted_rod.
    """
    span = across if not one_wide else across[[0, -1]]
    x = (faces[1:] + faces[:-1]) / 2
    y = (span[1:] + span[:-1]) / 2
    along, over = np.meshgrid(x, y, indexing="ij")
    place = np.column_stack([along.ravel(), over.ravel(), np.full(along.size, z)])
    sides = float(faces[-1] - faces[0]), float(across[-1] - across[0])
    scale = Scale(min(sides), max(sides), thickness)
    flat = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    found = pieces(FLAT, place, flat, np.outer(np.diff(faces), np.diff(span)).ravel(), scale)
    for end, normal in ((faces[0], -1.0), (faces[-1], 1.0)):
        if normal > 0.0 or base:
            edge = np.column_stack([np.full(len(y), end), y, np.full(len(y), z)])
            area = thickness * np.diff(span)
            found = found.joined(pieces(END, edge, _across(normal), area, scale))
    return found


def _across(normal: float) -> Array:
    """Two unit vectors (2, 3) whose cross product is +x or -x."""
    return np.array([[0.0, 1.0, 0.0], [0.0, 0.0, normal]])


def wetted_parts(parts: list[Array], component: NDArray[np.integer], cell: float) -> WettedSurface:
    """The outside of parts, each (f, 3, 3) m: a piece for all that faces one way in a cell of this width (m), without what lies on another.

    component (parts,): the connected body that each is of.
    """
    gap = 0.02 * cell  # m: parts that are joined lie on each other, or nearly
    found: list[WettedSurface] = []
    for k, mesh in enumerate(parts):
        triangles = cut(mesh, cell)
        middle = np.ascontiguousarray(triangles.mean(axis=1))
        area = face_normals(triangles) / 2
        outside = np.linalg.norm(area, axis=1) > 0.0
        for other, corners in enumerate(parts):
            if other != k and component[other] == component[k]:
                outside &= to_triangles(middle, corners) > gap
        place, area = _together(middle[outside], area[outside], cell)
        size = np.linalg.norm(area, axis=1)
        first = _beside(area)
        second = np.cross(area / size[:, None], first)
        tangents = np.stack([first, second], axis=1)
        region = np.full(len(size), k)
        found.append(pieces(FACE, place, tangents, size, Scale(1.0, 1.0), region))
    every = found[0]
    for one in found[1:]:
        every = every.joined(one)
    of = component[every.region]
    areas = np.bincount(of, every.size)
    ball = np.sqrt(areas / math.pi)[of]
    return WettedSurface(**{**vars(every), "width": ball, "length": ball})


def _together(place: Array, area: Array, cell: float) -> tuple[Array, Array]:
    """Places (k, 3) m and areas as vectors (k, 3) m^2 of what lies in one cell and faces one way, to a tenth of a radian or so."""
    size = np.linalg.norm(area, axis=1)
    key = np.column_stack([np.floor(place / cell), np.round(8.0 * area / size[:, None])])
    _, of = np.unique(key, axis=0, return_inverse=True)
    of = of.ravel()
    sizes = np.bincount(of, size)
    middle = [np.bincount(of, size * place[:, i]) / sizes for i in range(3)]
    whole = [np.bincount(of, area[:, i]) for i in range(3)]
    return np.column_stack(middle), np.column_stack(whole)


def _beside(vectors: Array) -> Array:
    """A unit vector (n, 3) at right angles to each of some vectors (n, 3)."""
    least = np.eye(3)[np.abs(vectors).argmin(axis=1)]
    across = np.cross(vectors, least)
    return np.asarray(across / np.linalg.norm(across, axis=1)[:, None])
