"""The part of each grid cell that lies inside a closed mesh: its volume, first and second moments, exact to rounding.

The surface is cut at the grid's planes into pieces that each lie in one cell. By the divergence theorem along x, the integral of f over the
part of the mesh within a cell is the sum over the surface of n_x times the integral of f along x from the cell's left face: up to the
surface for pieces in the cell, up to the cell's right face for pieces farther right in the same column. No test whether a point is
inside is needed. Source: Mirtich, Fast and accurate computation of polyhedral mass properties, J. Graphics Tools 1 (1996), applied to each
cell.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from magmpm.bodies.grid import Grid
from magmpm.compiled.arrays import Array

ON_PLANE = 1e-6  # of a cell: vertices this near a grid plane lie on it; STL files hold single precision, 6e-8 of a coordinate
EMPTY = 1e-9  # share of a cell of the volume, below which it is rounding error
MOST_CELLS = 30_000_000  # of the box around one part

_A, _B = (6 - 15**0.5) / 21, (6 + 15**0.5) / 21
# Radon's rule, exact for polynomials of degree 5 on a triangle: barycentric points (7, 3) and weights (7,).
_POINTS = np.array([[1 / 3] * 3, *(np.roll([1 - 2 * p, p, p], k) for p in (_A, _B) for k in range(3))])
_WEIGHTS = np.array([9 / 40, *[(155 - 15**0.5) / 1200] * 3, *[(155 + 15**0.5) / 1200] * 3])


def cell_moments(triangles: Array, grid: Grid) -> tuple[NDArray[np.int64], Array]:
    """The cells that a closed mesh fills in part or whole, and the moments of the filled part.

    triangles (f, 3, 3) m, inside the grid. Returns cell (k, 3), in the order of x, y, z, and moments (k, 10) in the cell's own
    coordinates, 0 to 1 each way: integrals of 1, x, y, z, x^2, xy, xz, y^2, yz, z^2.
    """
    scaled = (triangles - grid.origin) / grid.spacing
    nearest = np.round(scaled)
    scaled = np.where(np.abs(scaled - nearest) < ON_PLANE, nearest, scaled)
    low = np.floor(scaled.reshape(-1, 3).min(0)).astype(int)
    shape = np.maximum(np.ceil(scaled.reshape(-1, 3).max(0)).astype(int) - low, 1)
    if np.any(low < 0) or np.any(low + shape > grid.cells):
        raise ValueError("the mesh leaves the grid")
    if np.prod(shape) > MOST_CELLS:
        raise ValueError(f"the box around the mesh has {np.prod(shape)} cells, more than {MOST_CELLS}")
    pieces = scaled - low
    for axis in range(3):
        pieces = _cut(pieces, axis)
    cell = np.clip(np.floor(pieces.mean(axis=1)).astype(int), 0, shape - 1)
    local = pieces - cell[:, None, :]
    edge, other = local[:, 1] - local[:, 0], local[:, 2] - local[:, 0]
    area = (edge[:, 1] * other[:, 2] - edge[:, 2] * other[:, 1]) / 2  # n_x dA
    flat = np.ravel_multi_index(cell.T, shape)
    count = int(np.prod(shape))
    own, column = np.zeros((10, count)), np.zeros((6, count))
    for point, weight in zip(_POINTS, _WEIGHTS, strict=True):
        x, y, z = np.einsum("k,fki->if", point, local)
        w = weight * area
        terms = (
            x, x * x / 2, x * y, x * z, x**3 / 3, x * x * y / 2, x * x * z / 2, x * y * y, x * y * z, x * z * z
        )  # fmt: skip
        for k, term in enumerate(terms):
            own[k] += np.bincount(flat, w * term, count)
        for k, term in enumerate((np.ones_like(x), y, z, y * y, y * z, z * z)):
            column[k] += np.bincount(flat, w * term, count)
    grid_of = column.reshape(6, *shape)
    beyond = np.cumsum(grid_of[:, ::-1], axis=1)[:, ::-1] - grid_of  # of the pieces farther right in the column
    one, y, z, yy, yz, zz = beyond.reshape(6, -1)
    own += np.stack([one, one / 2, y, z, one / 3, y / 2, z / 2, yy, yz, zz])
    filled = np.flatnonzero(own[0] > EMPTY)
    return np.stack(np.unravel_index(filled, shape), axis=1) + low, own[:, filled].T


def _cut(triangles: Array, axis: int) -> Array:
    """Triangles cut at the integer planes of an axis, so that none crosses one."""
    done: list[Array] = []
    while len(triangles):
        low = np.floor(triangles[:, :, axis].min(1))
        high = np.ceil(triangles[:, :, axis].max(1))
        whole = high - low <= 1
        done.append(triangles[whole])
        triangles, low, high = triangles[~whole], low[~whole], high[~whole]
        if len(triangles):
            triangles = _split(triangles, axis, np.floor((low + high) / 2))
    return np.concatenate(done) if done else triangles


def _split(triangles: Array, axis: int, plane: Array) -> Array:
    """Each triangle (f, 3, 3), which has corners on both sides of its plane, as three: one on one side, two on the other."""
    side = triangles[:, :, axis] - plane[:, None]
    above = side > 0
    alone = np.where(above.sum(1) == 1, above.argmax(1), (side < 0).argmax(1))  # the corner that is alone on its side
    order = (alone[:, None] + np.arange(3)) % 3
    corners = np.take_along_axis(triangles, order[:, :, None], axis=1)
    side = np.take_along_axis(side, order, axis=1)
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab = a + (side[:, 0] / (side[:, 0] - side[:, 1]))[:, None] * (b - a)
    ac = a + (side[:, 0] / (side[:, 0] - side[:, 2]))[:, None] * (c - a)
    ab[:, axis] = ac[:, axis] = plane
    made = [np.stack(t, axis=1) for t in ((a, ab, ac), (ab, b, c), (ab, c, ac))]
    pieces = np.concatenate(made)
    flat = np.all(pieces == pieces[:, :1], axis=(1, 2))
    return pieces[~flat]
