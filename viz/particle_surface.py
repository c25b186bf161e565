"""The surface around a cloud of particles, for bodies whose shape is not known in advance."""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from viz.meshes import Surface


def around_particles(reference: np.ndarray, volume: np.ndarray, part: np.ndarray) -> Surface:
    """The surface around particles (n, 3) m with those volumes (n,) m^3; each triangle has the nearest particle's part.

    It lies where the share of space that is filled, with each volume spread linearly over the cells of a lattice, is one half.
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
    """Edge (m) of the cube that a whole particle fills. Particles at the surface fill cut cells, and a few fill more than one."""
    return float(np.quantile(volume, 0.9)) ** (1 / 3)


def connected_components(reference: np.ndarray, size: float) -> np.ndarray:
    """The connected component (n,) of each particle: particles within about two sizes (m) belong together."""
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
            total[..., axis] += np.divide(level - a, b - a, out=np.zeros(cells), where=cut)
            for i, c in zip(others, corner):
                total[..., i] += c * cut
            count += cut
    has = count > 0
    number = np.full(cells, -1)
    number[has] = np.arange(np.count_nonzero(has))
    points = np.argwhere(has) + total[has] / count[has][:, None]
    quads = np.vstack([_quads(inside, number, axis) for axis in range(3)])
    return points, np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def _quads(inside: np.ndarray, number: np.ndarray, axis: int) -> np.ndarray:
    """Corners (q, 4) of a quadrilateral around each lattice edge along an axis that the surface crosses."""
    u, v = (axis + 1) % 3, (axis + 2) % 3
    low, high = (tuple(slice(k, n - 1 + k) if i == axis else slice(None) for i, n in enumerate(inside.shape)) for k in (0, 1))
    crossing = np.argwhere(inside[low] != inside[high])
    crossing = crossing[(crossing[:, [u, v]] > 0).all(axis=1)]
    crossing = crossing[(crossing[:, [u, v]] < [number.shape[u], number.shape[v]]).all(axis=1)]
    corners = []
    for du, dv in ((-1, -1), (0, -1), (0, 0), (-1, 0)):
        cell = crossing.copy()
        cell[:, u] += du
        cell[:, v] += dv
        corners.append(number[tuple(cell.T)])
    quad = np.stack(corners, axis=1)
    outward = inside[low][tuple(crossing.T)]  # material below: the surface faces up the axis
    return np.where(outward[:, None], quad, quad[:, ::-1])
