"""Where a point of the material is, from the particles near it."""

import numpy as np
from numpy.typing import NDArray

from magmpm.bodies.grid import Grid
from magmpm.bodies.section_quadrature import Particles
from magmpm.compiled.arrays import Array

SEEN = 5  # nodes along an axis that the particles of a cell and its neighbors see


def point_weights(grid: Grid, particles: Particles, mine: NDArray[np.bool_], point: Array) -> Array:
    """Weights that give a material point's deformed position from those of the particles.

    A displacement that the grid's splines hold is met exactly, wherever the particles determine the splines that the
    point sees, as two a direction and cell do in two cells or more; elsewhere one that is linear in space is, and of
    the others the nearest.

    Parameters
    ----------
    grid : Grid
        Of the undeformed body.
    particles : Particles
        n of them, at their undeformed positions.
    mine : (n,) array of bool
        Those that move with the same nodes as the point.
    point : (3,) array
        The point in the undeformed body, m.

    Returns
    -------
    (n,) array
        Without unit; their sum is 1.
    """
    cells = np.unique(particles.cell[mine], axis=0)
    place = (point - grid.origin) / grid.spacing
    outside = np.maximum(np.maximum(cells - place, place - cells - 1), 0.0)
    home = cells[np.argmin(np.linalg.norm(outside * grid.spacing, axis=1))]
    near = np.flatnonzero(mine & (np.abs(particles.cell - home) <= 1).all(axis=1))
    seen = _on_nodes(grid, particles.position[near], particles.cell[near], home)
    wanted = _on_nodes(grid, point[None], home[None], home)[0]
    away = (particles.position[near] - point) / grid.spacing
    linear = np.column_stack([np.ones(len(near)), away])
    # Exact for what is linear in space, and with what is left free of the weights as near as can be for the splines.
    first = np.linalg.lstsq(linear.T, np.array([1.0, 0.0, 0.0, 0.0]), rcond=None)[0]
    free = np.linalg.qr(linear, mode="complete")[0][:, 4:]
    more = np.linalg.lstsq(seen.T @ free, wanted - seen.T @ first, rcond=None)[0]
    weights = np.zeros(len(mine))
    weights[near] = first + free @ more
    return weights


def _on_nodes(grid: Grid, points: Array, cell: NDArray[np.int64], home: NDArray[np.int64]) -> Array:
    """Values (m, SEEN^3) of the splines around a cell at points (m, 3) m in cells (m, 3) that are next to it or are it."""
    values = grid.splines(points, cell)[0]
    along = np.zeros((len(points), 3, SEEN))
    rows = np.arange(len(points))
    for axis in range(3):
        for k in range(3):
            along[rows, axis, cell[:, axis] - home[axis] + 1 + k] = values[:, axis, k]
    return np.einsum("ma,mb,mc->mabc", along[:, 0], along[:, 1], along[:, 2]).reshape(len(points), -1)
