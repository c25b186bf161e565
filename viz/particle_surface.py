"""The surface around a cloud of particles, for bodies whose shape is not known in advance."""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from magmpm.viz.meshes import TriangleSurface


def around_particles(
    reference: np.ndarray, volume: np.ndarray, part: np.ndarray
) -> TriangleSurface:
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
    return TriangleSurface(points, triangles, np.asarray(part)[nearest])


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
    """Surface where values (nx, ny, nz) on a lattice of unit spacing cross a level, larger inside: points (n, 3), triangles (m, 3).

    One point in every cell that the surface passes, at the mean of its crossings with the cell's edges.
    Source: S. F. F. Gibson, Constrained elastic surface nets, MICCAI 1998.
    """
    inside = values > level
    around = []
    crossings = []
    for axis in range(3):
        low, high = (
            tuple(
                slice(k, n - 1 + k) if i == axis else slice(None)
                for i, n in enumerate(values.shape)
            )
            for k in (0, 1)
        )
        edge = np.argwhere(inside[low] != inside[high])
        a, b, material_below = (
            of[tuple(edge.T)] for of in (values[low], values[high], inside[low])
        )
        crossing = edge.astype(float)
        crossing[:, axis] += (level - a) / (b - a)
        u, v = np.eye(3, dtype=int)[[(axis + 1) % 3, (axis + 2) % 3]]
        cells = edge[:, None] - np.array([u + v, v, 0 * u, u])  # the four around each edge
        around.append(
            np.where(material_below[:, None, None], cells, cells[:, ::-1])
        )  # the surface faces away from the material
        crossings.append(crossing)
    cells = np.vstack(around)
    crossing = np.vstack(crossings)
    shape = tuple(n - 1 for n in values.shape)
    valid: np.ndarray = np.all((cells >= 0) & (cells < shape), axis=2)
    key = np.where(
        valid, np.ravel_multi_index(tuple(np.moveaxis(cells, 2, 0)), shape, mode="clip"), -1
    )
    number = np.unique(key[valid], return_inverse=True)[1]
    owner = np.nonzero(valid)[0]
    count = np.bincount(number)
    points = np.stack([np.bincount(number, crossing[owner, i]) / count for i in range(3)], axis=1)
    key[valid] = number
    quads = key[valid.all(axis=1)]
    return points, np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
