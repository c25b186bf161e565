"""The grid in the undeformed body and its quadratic B-splines.

A grid is a box of cells. Along each axis, cell i carries the three uniform quadratic B-splines of nodes i, i+1 and i+2
(node i is centered on cell i - 1), so that n cells have n + 2 nodes. Knots lie on the cell faces, where a body's flat faces are put.
Source: de Boor, A Practical Guide to Splines; for the role in MPM, Steffen, Kirby, Berzins, IJNME 76 (2008).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array

NODES = 3  # B-splines of degree 2 that a cell carries along one axis


def spline_weights(xi: Array) -> Array:
    """Values of the three quadratic B-splines of a cell.

    xi: (...) position within the cell, 0 to 1. Returns (..., 3), a partition of unity.
    """
    return np.stack([0.5 * (1.0 - xi) ** 2, 0.5 + xi * (1.0 - xi), 0.5 * xi**2], axis=-1)


def spline_slopes(xi: Array) -> Array:
    """Derivatives of ``spline_weights`` with respect to xi. Returns (..., 3); divide by the cell size for 1/m."""
    return np.stack([xi - 1.0, 1.0 - 2.0 * xi, xi], axis=-1)


def clamp_first_node(weights: Array, slopes: Array) -> tuple[Array, Array]:
    """Splines of the first cell of an axis when the displacement is zero on that cell's lower face.

    On the face the two splines of nodes 0 and 1 are both 1/2, and node 2's is 0: the face is at rest, all of it and nothing more,
    exactly when node 0's coefficient is minus node 1's. Node 0 is eliminated by that rule, and the stencil moves up by one:
    the returned (..., 3) values and slopes belong to nodes 1, 2 and 3 (node 3's are 0).
    """
    zero = np.zeros_like(weights[..., 0])
    moved = [np.stack([v[..., 1] - v[..., 0], v[..., 2], zero], axis=-1) for v in (weights, slopes)]
    return moved[0], moved[1]


def clamp_last_node(weights: Array, slopes: Array) -> tuple[Array, Array]:
    """Splines of the last cell of an axis when the displacement is zero on that cell's upper face.

    The mirror image of ``clamp_first_node``: the last node's coefficient is minus its neighbor's, and takes no part. The stencil stays.
    """
    zero = np.zeros_like(weights[..., 0])
    moved = [np.stack([v[..., 0], v[..., 1] - v[..., 2], zero], axis=-1) for v in (weights, slopes)]
    return moved[0], moved[1]


def clamp_low_node(weights: Array, slopes: Array) -> tuple[Array, Array]:
    """Splines of a cell when the displacement is zero on its lower face: ``clamp_first_node`` with the stencil left where it is."""
    zero = np.zeros_like(weights[..., 0])
    moved = [np.stack([zero, v[..., 1] - v[..., 0], v[..., 2]], axis=-1) for v in (weights, slopes)]
    return moved[0], moved[1]


@dataclass(frozen=True)
class Grid:
    """A box of cells. origin (3,) m: lower corner; spacing (3,) m: cell sizes; cells: number of cells along x, y, z."""

    origin: Array
    spacing: Array
    cells: tuple[int, int, int]

    @property
    def nodes(self) -> tuple[int, int, int]:
        """Number of spline nodes along x, y, z: two more than cells."""
        return (self.cells[0] + 2, self.cells[1] + 2, self.cells[2] + 2)

    def node_coordinates(self, axis: int) -> Array:
        """Centers (m) of the splines along one axis, (nodes,): where a coefficient acts most (Greville points)."""
        return self.origin[axis] + self.spacing[axis] * (np.arange(self.nodes[axis]) - 0.5)

    def locate(self, points: Array, cell: NDArray[np.int64]) -> Array:
        """Position within the given cells, 0 to 1. points (n, 3) m, cell (n, 3) -> (n, 3).

        Raises ValueError if a point lies outside its cell: an index outside the grid would corrupt memory in a kernel.
        """
        xi = (points - self.origin) / self.spacing - cell
        slack = 1e-9  # rounding of a point on a face
        if np.any(xi < -slack) or np.any(xi > 1 + slack) or np.any(cell < 0) or np.any(cell >= self.cells):
            raise ValueError("a particle lies outside the cell it was given")
        return np.clip(xi, 0.0, 1.0)


@dataclass(frozen=True)
class ClampPlane:
    """A face of the grid's cells on which all that is held holds the rest: the grid has its knots there.

    axis: its normal; lower: whether what is free lies above it; cell: index along the axis of the first cell that is free (the last, if
    not lower).
    """

    axis: int
    lower: bool
    cell: int
