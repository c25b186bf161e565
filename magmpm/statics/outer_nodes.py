"""Nodes outside a body's full cells follow those inside.

Where a body's surface cuts the cells of its grid, some nodes see next to no material: a sliver of a cell. The tangent is then as good as
singular in their displacements, and rounding decides its sign. So each such node is bound, by a spring, to where the nodes of the nearest
well-filled cell of the same part would have it: the coefficients of a quadratic function are themselves quadratic in the nodes' numbers, so
that three nodes along each axis tell those beyond them. A body that moves, turns, is strained or bent evenly stretches no spring, and
bodies along the axes of the grid, whose cells are full, have none.
Sources: Hoellig, Reif, Wipper, SIAM J. Numer. Anal. 39 (2001) 442 (extended B-splines, where the outer nodes have no freedom of their own);
Burman, C. R. Acad. Sci. Paris 348 (2010) 1217 (ghost penalty); Badia, Neiva, Verdugo, CMAME 400 (2022) 115607 (both, by this form).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magmpm.bodies.grid import Grid
from magmpm.compiled.arrays import Array, Index

FILLED = 0.3  # of a cell's volume: a cell with more of the body holds its nodes by itself
STIFFNESS = 0.1  # of shear modulus times cell size: of the springs


@dataclass(frozen=True)
class OuterNodes:
    """Outer nodes (k,) and the springs that bind them.

    element (k, 28): the outer node and the 27 of its inner cell, as grid indices (x, y, z) in the last axis; share (k, 28): 1 for the outer
    node, and minus the share of each inner one in where it should be; stiffness (k,) N/m.
    """

    element: Index  # (k, 28, 3)
    share: Array
    stiffness: Array

    def only(self, chosen: NDArray[np.bool_]) -> OuterNodes:
        """Some of them."""
        return OuterNodes(self.element[chosen], self.share[chosen], self.stiffness[chosen])

    @property
    def matrices(self) -> Array:
        """Stiffness matrices (k, 28, 28) N/m, of each axis."""
        return self.stiffness[:, None, None] * self.share[:, :, None] * self.share[:, None, :]


def outer_nodes(grid: Grid, cell: Index, volume: Array, segment: Index, shear: Array, usable: NDArray[np.bool_]) -> OuterNodes | None:
    """The outer nodes of particles that move: their cells (n, 3), volumes m^3, parts and shear moduli Pa. None where there are none.

    usable (n,): particles whose cells may bind others: those away from planes that change the splines.
    """
    count = int(np.prod(grid.cells))
    number = np.ravel_multi_index(cell.T, grid.cells)
    filled = np.bincount(number, volume, count) / float(np.prod(grid.spacing))
    full = filled >= FILLED
    if full[number].all():
        return None
    nodes = np.array(grid.nodes)
    inside = np.zeros(grid.nodes, bool)
    touched = np.zeros(grid.nodes, bool)
    of = np.full(grid.nodes, -1)  # the part with a particle nearest by: the last one in order, so that it is always the same
    for shift in np.ndindex(3, 3, 3):
        at = tuple((cell + shift).T)
        touched[at] = True
        of[at] = np.maximum(of[at], segment)
        inside[tuple((cell[full[number]] + shift).T)] = True
    outer = np.argwhere(touched & ~inside)
    inner = full[number] & usable
    if not len(outer) or not inner.any():
        return None
    chosen = _nearest(outer, of[tuple(outer.T)], cell[inner], segment[inner])
    base = cell[inner][chosen]
    across = np.arange(3)
    shares = [_extrapolated(outer[:, axis] - base[:, axis]) for axis in range(3)]
    share = np.einsum("ka,kb,kc->kabc", *shares).reshape(len(outer), 27)
    corner = np.stack(np.meshgrid(across, across, across, indexing="ij"), -1).reshape(27, 3)
    element = np.concatenate([outer[:, None], base[:, None] + corner], axis=1)
    assert (element < nodes).all()
    stiffness = STIFFNESS * shear[inner][chosen] * float(np.prod(grid.spacing)) ** (1 / 3)
    return OuterNodes(element, np.concatenate([np.ones((len(outer), 1)), -share], axis=1), stiffness)


def _extrapolated(place: Index) -> Array:
    """Shares (k, 3) of three coefficients in a row in the one at a place (k,), counted from the first of them."""
    t = place.astype(float)
    return np.stack([(t - 1) * (t - 2) / 2, -t * (t - 2), t * (t - 1) / 2], axis=1)


def _nearest(outer: Index, of: Index, cell: Index, segment: Index) -> Index:
    """The particle (k,) whose cell is the nearest to each outer node (k, 3), of the node's part (k,) if it has any."""
    from scipy.spatial import cKDTree  # 0.1 s to import, and straight bodies do not need it

    found = np.empty(len(outer), np.int64)
    for part in np.unique(of):
        mine = np.flatnonzero(segment == part)
        mine = mine if len(mine) else np.arange(len(segment))
        _, first = np.unique(cell[mine], axis=0, return_index=True)
        candidates = mine[first]
        # A node is centered on the cell before it.
        found[of == part] = candidates[cKDTree(cell[candidates]).query(outer[of == part] - 1)[1]]
    return found


class Springs:
    """The springs of a layout's outer nodes: their energy, forces and tangent. All vectors are (planes, m)."""

    def __init__(self, outer: OuterNodes, node: Index, count: int) -> None:
        """node (k, 28): each node's number among all `count` of the layout."""
        from scipy.sparse import csr_matrix

        rows = np.repeat(np.arange(len(node)), node.shape[1])
        self._stretch: Any = csr_matrix((outer.share.ravel(), (rows, node.ravel())), shape=(len(node), count))
        self.stiffness = outer.stiffness

    def stretched(self, grid: Array) -> Array:
        """Stretch (k, 3) m of the springs for coefficients (planes, m) m."""
        return np.asarray(self._stretch @ grid.reshape(-1, 3))

    def energy(self, grid: Array) -> float:
        """Their energy, J."""
        return 0.5 * float(np.sum(self.stiffness[:, None] * self.stretched(grid) ** 2))

    def gradient(self, grid: Array) -> Array:
        """Gradient of the energy, (planes, m) N: linear in the coefficients, so it is also the tangent times a change of them."""
        return np.asarray(self._stretch.T @ (self.stiffness[:, None] * self.stretched(grid))).reshape(grid.shape)
