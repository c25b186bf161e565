"""The shells of a closed mesh, its connected surfaces: which encloses which, and whether every point is inside the body once or not at all.

An outward shell is a piece of the body, an inward one a cavity within a piece. Where pieces share a volume it would count twice; an
inward shell outside of every piece would count less than nothing. Both leave the sum of the volumes positive, so shells are told apart.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array

LINES = 40  # lines along x each way, by which what two meshes share is measured
TOLERANCE = 1e-3  # of the smaller of two shells: what they may share, or lack of being one in the other; faces may touch
NOTHING = 1e-9  # of the mesh's box: a shell with less volume than this is none
SAME = 1e-6  # of the mesh's size: vertices this near are one (STL repeats them in single precision)
SAME_ANGLE = 1e-3  # rad: triangles nearer to each other than this around their edge are one plane
PAIRS = 1_000_000  # of lines and triangles looked at at a time
SHOWN = 3  # shells of each kind that a message tells of

Index = NDArray[Any]


def shells_of(vertices: Array, faces: Index) -> tuple[Index, Index]:
    """The shell (f,) that each triangle of a closed mesh, with consistent normals, belongs to; and first vertices of edges around which
    some sector is covered twice, or less than once where another is not at all.

    Triangles that share an edge are of one shell. Where four or more meet at an edge, as where two boxes touch, each goes with the next
    one on the side of the material.
    """
    from scipy.sparse import coo_matrix  # only where a scene has a mesh: scipy takes a fifth of a second
    from scipy.sparse.csgraph import connected_components

    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    face = np.tile(np.arange(len(faces)), 3)
    low, high = edges.min(1), edges.max(1)
    _, of, used = np.unique(low * len(vertices) + high, return_inverse=True, return_counts=True)
    order = np.argsort(of, kind="stable")
    first = np.concatenate([[0], np.cumsum(used)])
    pairs = [face[order[np.add.outer(first[:-1][used == 2], [0, 1])]]]
    overlaps, size = [], float(np.ptp(vertices, axis=0).max())
    for k in np.flatnonzero(used > 2):
        around = order[first[k] : first[k + 1]]
        matched, covered_once = _matched(vertices, faces[face[around]], edges[around], size)
        pairs.append(face[around[matched]])
        if not covered_once:
            overlaps.append(low[around[0]])
    links = np.concatenate(pairs)
    graph = coo_matrix((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(len(faces), len(faces)))
    return np.asarray(connected_components(graph, directed=False)[1]), np.array(overlaps, np.int64)


def _matched(vertices: Array, faces: Index, edges: Index, size: float) -> tuple[Index, bool]:
    """Pairs (k / 2, 2) of the k triangles at one edge, each with the next around the edge through the material; and whether material
    begins and ends in turn around it.

    faces (k, 3); edges (k, 2): the edge's ends as each triangle runs through them; size: the mesh's.
    """
    forward = edges[:, 0] < edges[:, 1]
    start, end = vertices[edges[0].min()], vertices[edges[0].max()]
    along = (end - start) / np.linalg.norm(end - start)
    away = vertices[faces.sum(1) - edges.sum(1)] - start
    away = away - (away @ along)[:, None] * along
    height = np.linalg.norm(away, axis=1)
    same = SAME_ANGLE + 4 * SAME * size / max(float(height.min()), 1e-300)
    axis = away[0] / max(float(height[0]), 1e-300)
    angle = np.arctan2(away @ np.cross(along, axis), away @ axis)
    pairs, left = [], list(np.flatnonzero(~forward))
    for one in np.flatnonzero(forward):
        # The normal is along x away: the material lies the other way round.
        turn = (angle[one] - angle[left]) % (2 * np.pi)
        nearest = int(np.argmin(np.where((turn < same) | (turn > 2 * np.pi - same), 2 * np.pi, turn)))
        pairs.append((one, left.pop(nearest)))
    order = np.argsort(angle)
    turned, steps = angle[order], np.where(forward[order], -1, 1)  # across a triangle that runs along the edge the material ends
    starts = np.flatnonzero(np.diff(turned, prepend=-np.inf) > same)
    covers = np.cumsum(np.add.reduceat(steps, starts))
    if len(starts) > 1 and turned[0] + 2 * np.pi - turned[-1] <= same:  # the last of them are the first
        covers = covers[:-1]
    return np.array(pairs), bool(np.ptp(covers) <= 1)


def trouble(vertices: Array, faces: Index, size: float) -> tuple[str, str] | None:
    """Rule and remedy where a closed mesh with consistent normals covers a point twice, or less than not at all; else None.

    size: volume of the mesh's box, in its unit cubed.
    """
    least = faces[np.arange(len(faces))[:, None], (np.argmin(faces, axis=1)[:, None] + np.arange(3)) % 3]
    twice = len(faces) - len(np.unique(least, axis=0))
    if twice:
        return (
            f"each triangle of a mesh must stand once, and {twice} of this one stand{'s' * (twice == 1)} again: what they enclose "
            "would count twice",
            "remove the doubled solid (in MeshLab: Remove Duplicate Faces), and export the part again",
        )
    label, overlaps = shells_of(vertices, faces)
    if len(overlaps):
        return (
            f"a mesh must cover each point once, and beside {len(overlaps)} edges of this one, where several pieces meet, solids overlap "
            f"or one is inverted, the first near ({', '.join(f'{x:.4g}' for x in vertices[overlaps[0]])})",
            "unite what overlaps (in Blender: the Boolean modifier, Union), or remove what stands twice, and export the part again",
        )
    if label.max() == 0:
        return None
    order = np.argsort(label, kind="stable")
    shells = [vertices[faces[part]] for part in np.split(order, np.cumsum(np.bincount(label))[:-1])]
    volume = np.array([_volume(shell) for shell in shells])
    solid = np.flatnonzero(np.abs(volume) > NOTHING * size)
    return _misplaced([shells[k] for k in solid], volume[solid])


def _volume(triangles: Array) -> float:
    """Signed volume within triangles (f, 3, 3)."""
    a, b, c = (triangles[:, k] - triangles[0, 0] for k in range(3))
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6)


def _misplaced(shells: list[Array], volume: Array) -> tuple[str, str] | None:
    """What is wrong with shells (each (f, 3, 3)) of signed volumes (k,), as `trouble` says it."""
    low = np.array([shell.min(axis=(0, 1)) for shell in shells])
    high = np.array([shell.max(axis=(0, 1)) for shell in shells])
    around = np.zeros(len(shells))  # how often a point just outside of each shell is inside of others
    crossed: list[str] = []
    for i in range(len(shells)):
        for j in (i + 1 + np.flatnonzero(np.all((low[i + 1 :] < high[i]) & (high[i + 1 :] > low[i]), axis=1))).tolist():
            inner, outer = (i, j) if abs(volume[i]) <= abs(volume[j]) else (j, i)
            share, own = _within(shells[inner], shells[outer])
            slack = TOLERANCE * (high[inner] - low[inner])
            boxed = np.all((low[inner] >= low[outer] - slack) & (high[inner] <= high[outer] + slack))
            if boxed and share > (1 - TOLERANCE) * own:
                around[inner] += np.sign(volume[outer])
            elif share > TOLERANCE * abs(volume[inner]):
                crossed.append(f"{_named(i, volume)} and {_named(j, volume)} share {share:.3g}")
    outward = volume > 0
    inverted = [_named(k, volume) for k in np.flatnonzero(~outward & (around < 1)).tolist()]
    nested = [_named(k, volume) for k in np.flatnonzero(outward & (around > 0)).tolist()]
    wrong = [
        *([f"{_list(inverted)} face{'s' * (len(inverted) == 1)} inward and {'is' if len(inverted) == 1 else 'are'} no cavity of another"]
          if inverted else []),
        *([f"{_list(nested)} lie{'s' * (len(nested) == 1)} in the material of another"] if nested else []),
        *([_list(crossed)] if crossed else []),
    ]  # fmt: skip
    if not wrong and not np.any(~outward & (around > 1)):
        return None
    wrong = wrong or [f"{_list([_named(k, volume) for k in np.flatnonzero(~outward & (around > 1)).tolist()])} is in two others at once"]
    remedies = ["flip the normals of what is inverted"] if inverted else []
    remedies += ["unite what overlaps (in Blender: the Boolean modifier, Union)"] if crossed or nested else []
    return (
        "the shells of a mesh must lie apart and face outward, but for cavities, which face inward, each wholly within one shell; this "
        f"mesh has {len(shells)} shells: {'; '.join(wrong)} (volumes in the file's unit cubed)",
        f"{', or '.join(remedies) or 'remove one of them'}, and export the part again",
    )


def _named(k: int, volume: Array) -> str:
    return f"shell {k + 1} of volume {abs(volume[k]):.4g}"


def _list(names: list[str]) -> str:
    more = len(names) - SHOWN
    return ", ".join(names[:SHOWN]) + (f" and {more} more" if more > 0 else "")


def shared(one: Array, other: Array) -> float:
    """Volume within both of two closed meshes of triangles (f, 3, 3), whichever way they face, within a few per cent."""
    return _within(one, other)[0]


def _within(one: Array, other: Array) -> tuple[float, float]:
    """Volumes within both of two closed meshes, and within the first, of the box that both their boxes share.

    Exact along LINES^2 lines parallel to x through that box.
    """
    meshes = (one, other)
    low = np.max([t.min(axis=(0, 1)) for t in meshes], axis=0)
    high = np.min([t.max(axis=(0, 1)) for t in meshes], axis=0)
    smaller = min(abs(_volume(t)) for t in meshes)
    if np.any(high <= low) or np.prod(high - low) < 1e-6 * smaller:
        return 0.0, 0.0
    # An irrational shift of each row keeps lines off edges that are parallel to the axes.
    k = np.arange(LINES * LINES)
    unit = np.column_stack([(k + 0.5) / len(k), (k * 0.6180339887498949 + 0.37) % 1.0])
    yz = low[1:] + unit * (high - low)[1:]
    near = [t[np.all((t[:, :, 1:].min(1) <= high[1:]) & (t[:, :, 1:].max(1) >= low[1:]), axis=1)] for t in meshes]
    lines = list(zip(*(_crossings(t, yz) for t in near), strict=True))
    each = float(np.prod((high - low)[1:])) / len(yz)
    span = np.array([low[0], high[0]])
    return each * sum(_shared_length(a, b) for a, b in lines), each * sum(_shared_length(a, span) for a, _ in lines)


def _crossings(triangles: Array, yz: Array) -> list[Array]:
    """For each line (y, z), of rising y, the sorted x at which it enters and leaves the mesh."""
    first = np.searchsorted(yz[:, 0], triangles[:, :, 1].min(1), side="left")
    count = np.searchsorted(yz[:, 0], triangles[:, :, 1].max(1), side="right") - first
    where: list[tuple[Index, Array]] = [(np.zeros(0, np.int64), np.zeros(0))]
    chunks = np.searchsorted(np.cumsum(count), np.arange(PAIRS, count.sum() + PAIRS, PAIRS), side="left")
    for part in np.split(np.arange(len(triangles)), chunks):
        face = np.repeat(part, count[part])
        line = np.repeat(first[part] - np.cumsum(count[part]) + count[part], count[part]) + np.arange(len(face))
        a, b, c = triangles[face, 0], triangles[face, 1], triangles[face, 2]
        area = (b[:, 1] - a[:, 1]) * (c[:, 2] - a[:, 2]) - (b[:, 2] - a[:, 2]) * (c[:, 1] - a[:, 1])
        d = yz[line] - a[:, 1:]
        with np.errstate(divide="ignore", invalid="ignore"):
            u = (d[:, 0] * (c[:, 2] - a[:, 2]) - d[:, 1] * (c[:, 1] - a[:, 1])) / area
            v = (d[:, 1] * (b[:, 1] - a[:, 1]) - d[:, 0] * (b[:, 2] - a[:, 2])) / area
            hit = np.flatnonzero((u >= 0) & (v >= 0) & (u + v <= 1))
        a, b, c = a[hit, 0], b[hit, 0], c[hit, 0]
        where.append((line[hit], a + u[hit] * (b - a) + v[hit] * (c - a)))
    line, x = (np.concatenate(values) for values in zip(*where, strict=True))
    order = np.lexsort((x, line))
    return np.split(x[order], np.cumsum(np.bincount(line, minlength=len(yz)))[:-1])


def _shared_length(a: Array, b: Array) -> float:
    """Length that two sets of intervals (sorted ends; an odd one out is dropped) share."""
    total = 0.0
    for s, e in a[: len(a) // 2 * 2].reshape(-1, 2):
        for t, f in b[: len(b) // 2 * 2].reshape(-1, 2):
            total += max(0.0, min(e, f) - max(s, t))
    return total
