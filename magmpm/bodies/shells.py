"""The shells of a closed mesh, its connected surfaces: which encloses which, and whether every point is inside the body once or not at all.

An outward shell is a solid, an inward one a cavity within a solid. Where solids overlap, their volume would count twice; an inward shell
outside every solid would count less than nothing. Both leave the sum of the volumes positive, so each shell is checked against the others.
What two solids share is computed exactly, by Manifold (https://github.com/elalish/manifold). Manifold takes each edge as shared by two
triangles; where more meet, its answer depends on their order, so such edges are taken apart here first.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from magmpm.compiled.arrays import Array, Index
from magmpm.errors import InputError, require

if TYPE_CHECKING:
    from manifold3d import Manifold

TOLERANCE = 1e-3  # of the smaller of two shells: touching faces of a drawing never fit exactly
SAME_VERTEX = (
    1e-6  # of the mesh's size: vertices this near are one (STL repeats them in single precision)
)


class MeshError(InputError):
    """A mesh that can't be used: rule and remedy, for messages to quote."""

    def __init__(self, rule: str, remedy: str) -> None:
        super().__init__(f"{rule}; {remedy}")
        self.rule = rule
        self.remedy = remedy


def solid_of(vertices: Array, faces: Index) -> Manifold:
    """A closed mesh, vertices (v, 3) and faces (f, 3) that face consistently, for exact intersections and rays. Raises MeshError."""
    return _solid(*_taken_apart(vertices, faces)[:2])


def shells_of(vertices: Array, faces: Index) -> tuple[list[Manifold], Index]:
    """The shells of a closed mesh whose triangles face consistently; and first vertices of edges around which some sector is covered
    twice, or less than once where another is not at all.

    Triangles that share an edge are of one shell. Of four or more, as where boxes touch, each goes with the next through the material.
    """
    corners, triangles, overlaps = _taken_apart(vertices, faces)
    return _solid(corners, triangles).decompose(), overlaps


def _solid(vertices: Array, faces: Index) -> Manifold:
    require("manifold3d", "parts", key="mesh", use="closed meshes")
    from manifold3d import Error, Manifold, Mesh64  # only where a scene has a mesh

    solid = Manifold(
        Mesh64(np.array(vertices, np.float64, order="C"), np.array(faces, np.uint64, order="C"))
    )
    if solid.status() != Error.NoError:
        raise MeshError(
            f"a mesh must be a closed surface, and this one is not ({solid.status().name})",
            "export the part again",
        )
    return solid


def sides_of(faces: Index) -> tuple[Index, Index, Index, Index, Index]:
    """The sides (3 f, 2) of faces (f, 3), first those from corner 0 to 1; the lower vertex of each; and of the edges, in ascending order of
    their vertices, the first side, the edge of each side, and the number of sides.
    """
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    low = sides.min(1)
    both = low * (faces.max(initial=0) + 1) + sides.max(1)
    _, first, of, used = np.unique(both, return_index=True, return_inverse=True, return_counts=True)
    return sides, low, first, of, used


def _taken_apart(vertices: Array, faces: Index) -> tuple[Array, Index, Index]:
    """The same surface with every edge in two triangles, and the overlaps of `shells_of`.

    Where more meet at an edge, each pair of them after the first gets an edge of its own: by way of a vertex of its own in the middle.
    """
    edges, low, _, of, used = sides_of(faces)
    order = np.argsort(of, kind="stable")
    first = np.concatenate([[0], np.cumsum(used)])
    middles: dict[int, dict[int, int]] = {}  # of a face: vertex in the middle of its side
    added = [vertices]
    overlaps = []
    size = float(np.ptp(vertices, axis=0).max())
    for k in np.flatnonzero(used > 2):
        around = order[first[k] : first[k + 1]]
        pairs, covered_once = _matched(vertices, faces[around % len(faces)], edges[around], size)
        if not covered_once:
            overlaps.append(low[around[0]])
        for pair in around[pairs[1:]]:
            for side in pair:
                middles.setdefault(side % len(faces), {})[side // len(faces)] = (
                    len(vertices) + len(added) - 1
                )
            added.append(vertices[edges[pair[0]]].mean(axis=0, keepdims=True))
    split = []
    for face, middle in middles.items():
        ring = [
            vertex
            for side in range(3)
            for vertex in (faces[face, side], middle.get(side))
            if vertex is not None
        ]
        start = ring.index(next(iter(middle.values())))
        ring = (
            ring[start:] + ring[:start]
        )  # a fan around a vertex in the middle of a side: no triangle of it is flat
        split += [(ring[0], *ring[n : n + 2]) for n in range(1, len(ring) - 1)]
    whole = np.delete(faces, list(middles), axis=0)
    return (
        np.concatenate(added),
        np.concatenate([whole, np.array(split, faces.dtype).reshape(-1, 3)]),
        np.array(overlaps, np.int64),
    )


def _matched(vertices: Array, faces: Index, edges: Index, size: float) -> tuple[Index, bool]:
    """Pairs (k / 2, 2) of the k triangles at an edge, each with the next through the material; and whether it begins and ends in turn.

    faces (k, 3); edges (k, 2): the edge's ends as each triangle runs through them; size: the mesh's.
    """
    forward = edges[:, 0] < edges[:, 1]
    start = vertices[edges[0].min()]
    end = vertices[edges[0].max()]
    along = (end - start) / np.linalg.norm(end - start)
    away = vertices[faces.sum(1) - edges.sum(1)] - start
    away = away - (away @ along)[:, None] * along
    height = np.linalg.norm(away, axis=1)
    same = 1e-3 + 4 * SAME_VERTEX * size / max(float(height.min()), 1e-300)
    axis = away[0] / max(float(height[0]), 1e-300)
    angle = np.arctan2(away @ np.cross(along, axis), away @ axis)
    pairs = []
    left = list(np.flatnonzero(~forward))
    for one in np.flatnonzero(forward):
        # The normal is along x away: the material lies the other way round.
        turn = (angle[one] - angle[left]) % (2 * np.pi)
        nearest = int(
            np.argmin(np.where((turn < same) | (turn > 2 * np.pi - same), 2 * np.pi, turn))
        )
        pairs.append((one, left.pop(nearest)))
    order = np.argsort(angle)
    # across a triangle that runs along the edge the material ends
    turned = angle[order]
    steps = np.where(forward[order], -1, 1)
    starts = np.flatnonzero(np.diff(turned, prepend=-np.inf) > same)
    covers = np.cumsum(np.add.reduceat(steps, starts))
    if (
        len(starts) > 1 and turned[0] + 2 * np.pi - turned[-1] <= same
    ):  # the last of them are the first
        covers = covers[:-1]
    return np.array(pairs), bool(np.ptp(covers) <= 1)


def doubled(vertices: Array, faces: Index) -> tuple[str, str] | None:
    """Rule and remedy where a triangle stands again, facing the same way; else None."""
    least = faces[
        np.arange(len(faces))[:, None], (np.argmin(faces, axis=1)[:, None] + np.arange(3)) % 3
    ]
    _, first, of = np.unique(least, axis=0, return_index=True, return_inverse=True)
    again = np.flatnonzero(first[of.ravel()] != np.arange(len(faces)))
    if not len(again):
        return None
    return (
        (
            f"each triangle of a mesh must appear once, and {len(again)} of this one "
            f"appear{'s' * (len(again) == 1)} again, the first near "
            f"{place(vertices[faces[again[0]]].mean(axis=0))}: the volume they enclose would "
            "count twice"
        ),
        (
            "remove the duplicate solid, or the duplicate triangles (in MeshLab: Remove "
            "Duplicate Faces), and export the part again"
        ),
    )


def place(point: Array) -> str:
    """A point of a mesh in its file's unit, for messages: "(12, 0, -2)"."""
    return f"({', '.join(f'{x:.4g}' for x in point)})"


def solids_of(vertices: Array, faces: Index) -> list[Manifold]:
    """The separate solids of a closed mesh that `shell_fault` has passed: its outward shells, each without the cavities in it.

    Solids that share an edge or a corner alone are separate here, and lie at a distance of zero.
    """
    shells = shells_of(vertices, faces)[0]
    least = 1e-9 * float(
        np.prod(np.ptp(vertices, axis=0))
    )  # smaller ones are rounding, as for shell_fault
    found = sorted(
        (shell for shell in shells if shell.volume() > least), key=lambda shell: shell.volume()
    )
    for cavity in (facing_outward(shell) for shell in shells if shell.volume() < -least):
        for k, solid in enumerate(found):  # the smallest around it first
            if (solid ^ cavity).volume() > (1 - TOLERANCE) * cavity.volume():
                found[k] = solid - cavity
                break
    return found


def shell_fault(vertices: Array, faces: Index, size: float) -> tuple[str, str] | None:
    """Rule and remedy where a closed mesh covers a point twice, or less than not at all; else None. size: of its box, cubed."""
    shells, overlaps = shells_of(vertices, faces)
    if len(overlaps):
        return (
            (
                f"a mesh must cover each point once, and beside {len(overlaps)} edges of this one,"
                " where several pieces meet, solids overlap or one is inverted, the first near"
                f" {place(vertices[overlaps[0]])}"
            ),
            (
                "merge overlapping solids (in Blender: the Boolean modifier, Union), or remove "
                "duplicates, and export the part again"
            ),
        )
    return _misplaced([shell for shell in shells if abs(shell.volume()) > 1e-9 * size])


def overlapping_boxes(solids: Sequence[Manifold]) -> list[tuple[int, int]]:
    """Pairs (i, j), i < j, of solids whose boxes overlap."""
    box = np.array([solid.bounding_box() for solid in solids]).reshape(-1, 6)
    low = box[:, :3]
    high = box[:, 3:]
    return [
        (i, int(j))
        for i in range(len(box))
        for j in (
            i
            + 1
            + np.flatnonzero(np.all((low[i + 1 :] < high[i]) & (high[i + 1 :] > low[i]), axis=1))
        )
    ]


def facing_outward(shell: Manifold) -> Manifold:
    """The solid within a shell, whichever way it faces."""
    if shell.volume() >= 0:
        return shell
    mesh = shell.to_mesh64()
    return _solid(mesh.vert_properties[:, :3], mesh.tri_verts[:, ::-1])


def _misplaced(shells: list[Manifold]) -> tuple[str, str] | None:
    """Rule and remedy where a shell is misplaced, as of `shell_fault`; else None."""
    volume = np.array([shell.volume() for shell in shells])
    solids = [facing_outward(shell) for shell in shells]
    around = np.zeros(
        len(shells)
    )  # how often a point just outside of each shell is inside of others
    crossed: list[str] = []
    for i, j in overlapping_boxes(solids):
        inner, outer = (i, j) if abs(volume[i]) <= abs(volume[j]) else (j, i)
        share = (solids[i] ^ solids[j]).volume()
        if share > (1 - TOLERANCE) * abs(volume[inner]):
            around[inner] += np.sign(volume[outer])
        elif share > TOLERANCE * abs(volume[inner]):
            crossed.append(f"{_named(i, volume)} and {_named(j, volume)} share {share:.3g}")
    outward = volume > 0
    inverted = [_named(k, volume) for k in np.flatnonzero(~outward & (around < 1)).tolist()]
    nested = [_named(k, volume) for k in np.flatnonzero(outward & (around > 0)).tolist()]
    wrong = []
    if inverted:
        alone = len(inverted) == 1
        wrong.append(
            f"{_list(inverted)} face{'s' if alone else ''} inward and "
            f"{'is' if alone else 'are'} no cavity of another"
        )
    if nested:
        alone = len(nested) == 1
        wrong.append(f"{_list(nested)} lie{'s' if alone else ''} in the material of another")
    if crossed:
        wrong.append(_list(crossed))
    if not wrong and not np.any(~outward & (around > 1)):
        return None
    wrong = wrong or [
        f"{_list([_named(k, volume) for k in np.flatnonzero(~outward & (around > 1)).tolist()])} is"
        " in two others at once"
    ]
    remedies = ["flip the normals of what is inverted"] if inverted else []
    remedies += (
        ["merge overlapping solids (in Blender: the Boolean modifier, Union)"]
        if crossed or nested
        else []
    )
    return (
        (
            "the shells of a mesh must lie apart and face outward, but for cavities, which face"
            f" inward, each wholly within one shell; this mesh has {len(shells)} shells:"
            f" {'; '.join(wrong)} (volumes in the file's unit cubed)"
        ),
        f"{', or '.join(remedies) or 'remove one of them'}, and export the part again",
    )


def _named(k: int, volume: Array) -> str:
    return f"shell {k + 1} of volume {abs(volume[k]):.4g}"


def _list(names: list[str]) -> str:
    more = len(names) - 3
    return ", ".join(names[:3]) + (f" and {more} more" if more > 0 else "")
