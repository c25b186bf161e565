"""The surface of a body of any shape, made once around its undeformed particles, and carried along by them.

Balls show a body's particles; a surface shows its shape. It is drawn around the particles (surface nets), unless the shape is known
(viz.shapes). Every point of it then moves with the particles around it, by moving least squares.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from viz.shapes import Surface

NEIGHBOURS = (16, 32, 64)  # asked in turn
FLAT = 0.15  # neighbours whose thickness is less than this part of their width tell little across


def around_particles(reference: np.ndarray, volume: np.ndarray, part: np.ndarray) -> Surface:
    """The surface around particles (n, 3) m of those volumes (n,) m^3; triangles are of the nearest particle's part.

    Where the volume per space, spread linearly over the cells of a lattice, is half.
    """
    size = spacing(volume)
    low = reference.min(axis=0) - 2.5 * size
    at = (reference - low) / size
    share = np.zeros(tuple(np.ceil(at.max(axis=0)).astype(int) + 3))
    base = np.floor(at).astype(int)
    off = at - base
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(corner, off, 1 - off), axis=1) * volume / size**3
        np.add.at(share, tuple((base + corner).T), weight)
    points, triangles = surface_nets(share, 0.5)
    points = low + size * points
    nearest = cKDTree(reference).query(points[triangles].mean(axis=1))[1]
    return Surface(points, triangles, np.asarray(part)[nearest])


def spacing(volume: np.ndarray) -> float:
    """Edge (m) of the cube a whole particle stands for. Those at the surface stand for cut cells, a few for more than one."""
    return float(np.quantile(volume, 0.9)) ** (1 / 3)


def bodies(reference: np.ndarray, size: float) -> np.ndarray:
    """Which of the separate bodies each particle (n,) belongs to: particles within about two sizes (m) hang together."""
    cell = np.floor((reference - reference.min(axis=0)) / (1.2 * size)).astype(int)
    full = np.zeros(tuple(cell.max(axis=0) + 1), dtype=bool)
    full[tuple(cell.T)] = True
    return np.asarray(ndimage.label(full, np.ones((3, 3, 3)))[0])[tuple(cell.T)] - 1


def surface_nets(values: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Where values (nx, ny, nz) on a lattice of unit spacing cross a level, larger inside: points (n, 3), triangles (m, 3).

    One point in every cell that the surface passes, at the mean of its crossings with the cell's edges.
    Source: S. F. F. Gibson, Constrained elastic surface nets, MICCAI 1998.
    """
    inside = values > level
    cells = tuple(n - 1 for n in values.shape)
    total, count = np.zeros((*cells, 3)), np.zeros(cells, dtype=int)
    for axis in range(3):
        others = [i for i in range(3) if i != axis]
        for corner in np.ndindex(2, 2):
            first = [slice(0, n) for n in cells]
            for i, c in zip(others, corner):
                first[i] = slice(c, c + cells[i])
            second = list(first)
            second[axis] = slice(1, 1 + cells[axis])
            a, b = values[tuple(first)], values[tuple(second)]
            cut = inside[tuple(first)] != inside[tuple(second)]
            where = np.divide(level - a, b - a, out=np.full(cells, 0.5), where=cut)
            place = np.zeros(3)
            place[others] = corner
            point = np.broadcast_to(place, (*cells, 3)).copy()
            point[..., axis] = where
            total += np.where(cut[..., None], point, 0.0)
            count += cut
    has = count > 0
    number = np.full(cells, -1)
    number[has] = np.arange(np.count_nonzero(has))
    points = np.argwhere(has) + total[has] / count[has][:, None]
    quads = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        low, high = (
            tuple(slice(k, values.shape[i] - 1 + k) if i == axis else slice(None) for i in range(3))
            for k in (0, 1)
        )
        crossing = np.argwhere(inside[low] != inside[high])
        crossing = crossing[(crossing[:, u] > 0) & (crossing[:, v] > 0)]
        crossing = crossing[(crossing[:, u] < cells[u]) & (crossing[:, v] < cells[v])]
        corners = []
        for du, dv in ((-1, -1), (0, -1), (0, 0), (-1, 0)):
            cell = crossing.copy()
            cell[:, u] += du
            cell[:, v] += dv
            corners.append(number[tuple(cell.T)])
        quad = np.stack(corners, axis=1)
        outward = inside[low][tuple(crossing.T)]  # material below: the surface looks up the axis
        quads.append(np.where(outward[:, None], quad, quad[:, ::-1]))
    quad = np.vstack(quads)
    return points, np.vstack([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])


def creased(points: np.ndarray, triangles: np.ndarray, part: int, angle: float = 40.0) -> Surface:
    """A closed mesh (n, 3) m, (m, 3), whose points are split where neighbouring triangles meet at more than angle (degrees).

    So that edges of a drawing stay sharp where normals are averaged over a point's triangles.
    """
    a, b, c = (points[triangles[:, i]] for i in range(3))
    face = np.cross(b - a, c - a)
    face /= np.maximum(np.linalg.norm(face, axis=1, keepdims=True), 1e-300)
    count = len(triangles)
    edge = np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)])
    of = np.tile(np.arange(count), 3)
    first, second = (np.concatenate([3 * np.arange(count) + (i + k) % 3 for i in range(3)]) for k in (0, 1))
    order = np.lexsort(np.sort(edge, axis=1).T)
    one, other = order[:-1], order[1:]
    pair = (np.sort(edge[one], axis=1) == np.sort(edge[other], axis=1)).all(axis=1)
    one, other = one[pair], other[pair]
    smooth = np.einsum("ij,ij->i", face[of[one]], face[of[other]]) > np.cos(np.radians(angle))
    one, other = one[smooth], other[smooth]
    # Neighbours run along their common edge in opposite directions.
    rows = np.concatenate([first[one], second[one]])
    columns = np.concatenate([second[other], first[other]])
    graph = sparse.coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(3 * count, 3 * count))
    number, corner = csgraph.connected_components(graph, directed=False)
    split = np.zeros((number, 3))
    split[corner] = points[triangles.ravel()]
    return Surface(split, corner.reshape(-1, 3), np.full(count, part))


class Binding:
    """Moves points with the particles around them: an affine fit to the nearest ones, which is exact for affine motion."""

    def __init__(self, points: np.ndarray, reference: np.ndarray) -> None:
        """points (m, 3) m and particles reference (n, 3) m in the undeformed body."""
        tree = cKDTree(reference)
        left = np.arange(len(points))
        rows, columns, values = [], [], []
        for count in NEIGHBOURS:
            count = min(count, len(reference))
            last = count in (NEIGHBOURS[-1], len(reference))
            found = tree.query(points[left], k=count)
            distance, near = (np.asarray(a).reshape(len(left), count) for a in found)
            value, flat = _affine(points[left], reference[near], distance)
            # Where the nearest particles lie nearly in a plane, more of them are asked.
            good = ~flat | last
            rows.append(np.repeat(left[good], count))
            columns.append(near[good].ravel())
            values.append(value[good].ravel())
            left = left[~good]
            if not len(left):
                break
        entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
        self._matrix = sparse.csr_matrix(entries, shape=(len(points), len(reference)))

    def at(self, position: np.ndarray) -> np.ndarray:
        """Where the points are, (m, 3) m, when the particles are at position (n, 3) m."""
        return np.asarray(self._matrix @ np.asarray(position, dtype=float))


def _affine(points: np.ndarray, near: np.ndarray, distance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights (m, k) with which values at near (m, k, 3) give the value at points (m, 3) of an affine fit to them, by least squares with
    weights that fall with the distance (m, k); and (m,) whether the neighbours lie nearly in a plane, so that they do not tell it."""
    reach = 1.15 * distance[:, -1:] + 1e-300
    weight = (1 - (distance / reach) ** 2) ** 2
    offset = (near - points[:, None]) / reach[..., None]
    basis = np.concatenate([np.ones((*distance.shape, 1)), offset], axis=2)
    moment = np.einsum("mk,mki,mkj->mij", weight, basis, basis)
    spread = moment[:, 1:, 1:] / moment[:, :1, :1] - np.einsum(
        "mi,mj->mij", moment[:, 0, 1:], moment[:, 0, 1:]
    ) / (moment[:, :1, :1] ** 2)
    sizes = np.linalg.eigvalsh(spread)
    flat = sizes[:, 0] < FLAT**2 * sizes[:, 2]
    # What the neighbours do not determine stays out.
    moment[:, 1:, 1:] += 1e-9 * np.trace(moment, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    first = np.zeros((len(points), 4, 1))
    first[:, 0] = 1.0
    coefficient = np.linalg.solve(moment, first)[:, :, 0]
    return weight * np.einsum("mki,mi->mk", basis, coefficient), flat


def gradients(reference: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Deformation gradients (n, 3, 3) of particles that moved from reference to position (n, 3) m: affine fits to the nearest ones."""
    count = min(NEIGHBOURS[1], len(reference))
    near = np.asarray(cKDTree(reference).query(reference, k=count)[1]).reshape(len(reference), count)
    before, after = reference[near], position[near]
    before, after = before - before.mean(axis=1, keepdims=True), after - after.mean(axis=1, keepdims=True)
    size = np.einsum("mki,mki->m", before, before)[:, None, None] + 1e-300
    moment = np.einsum("mki,mkj->mij", before, before) / size + 1e-9 * np.eye(3)
    return np.asarray(
        np.linalg.solve(moment, np.einsum("mki,mkj->mij", before, after) / size).transpose(0, 2, 1)
    )


class PartedBinding:
    """A Binding for each body of its own, so that bodies that touch do not pull each other's surface."""

    def __init__(
        self,
        points: np.ndarray,
        body_of_point: np.ndarray,
        reference: np.ndarray,
        body_of_particle: np.ndarray,
    ) -> None:
        self._count = len(points)
        self._bodies = [
            (at, of, Binding(points[at], reference[of]))
            for body in np.unique(body_of_point)
            for at, of in [(np.flatnonzero(body_of_point == body), np.flatnonzero(body_of_particle == body))]
        ]

    def at(self, position: np.ndarray) -> np.ndarray:
        """Where the points are, (m, 3) m, when the particles are at position (n, 3) m."""
        moved = np.empty((self._count, 3))
        for at, of, binding in self._bodies:
            moved[at] = binding.at(position[of])
        return moved
