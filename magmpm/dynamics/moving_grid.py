"""The grid of the updated formulation: a box of nodes around the particles, once for each component of the body."""

from __future__ import annotations

from itertools import combinations, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from magmpm.bodies.grid import ClampPlane, spline_weights
from magmpm.compiled.arrays import Array, Index
from magmpm.effects.hooks import has_hook
from magmpm.kernels.apic_step import Grid
from magmpm.model import Model


class Box(NamedTuple):
    """A box of cells around a model's particles.

    component (n,): of each particle; low (3,): first cell of the box, counted in the model's grid; shape (3,): number of nodes.
    """

    model: Model
    component: Index
    low: Index
    shape: Index

    def grid(self, cell: Index) -> tuple[Grid, Array, Index]:
        """All grids, for particles in cells (n, 3) of the box; held mass (`_held_nodes`); where components may meet (`_reached`)."""
        model, h, nodes = self.model, self.model.grid.spacing, int(np.prod(self.shape))
        origin, grids = model.grid.origin + self.low * h, int(self.component.max()) + 1
        planes, shared = self._reached(cell)
        fixed, weight = self._held_nodes(origin, grids)
        mirrors, next_to_faces = self._mirrors(fixed)
        grid = Grid(
            origin, h, *self._along(), nodes, np.zeros(4 * grids * nodes + 8), np.zeros(4 * grids * nodes + 8), planes, fixed, mirrors,
            next_to_faces, model.plane_strain, self._nodes_place(origin) if has_hook("node", model.effects) else np.zeros(3),
        )  # fmt: skip
        return grid, weight, shared

    def _along(self) -> tuple[int, int]:
        """Steps in node number along x and y."""
        return int(self.shape[1] * self.shape[2]), int(self.shape[2])

    def _reached(self, cell: Index) -> tuple[Index, Index]:
        """Planes of nodes, grid after grid, that may get mass before particles in cells (n, 3) are sorted again. And the box (2, 3) of
        nodes that two components may both reach, from the first to one past the last: empty if none can meet.

        A particle in cell c touches nodes c to c + 2, and moves by less than a cell.
        """
        first = np.array([cell[self.component == k].min(axis=0) - 1 for k in range(int(self.component.max()) + 1)])
        last = np.array([cell[self.component == k].max(axis=0) + 4 for k in range(len(first))])
        first, last = np.maximum(first, 0), np.minimum(last, self.shape)
        planes = np.concatenate([k * self.shape[0] + np.arange(a, b) for k, (a, b) in enumerate(zip(first[:, 0], last[:, 0], strict=True))])
        pairs = combinations(range(len(first)), 2)
        shared = [(np.maximum(first[a], first[b]), np.minimum(last[a], last[b])) for a, b in pairs]
        shared = [box for box in shared if (box[0] < box[1]).all()]
        if not shared:
            return planes, np.zeros((2, 3), np.int64)
        inside = np.array([np.min([low for low, _ in shared], axis=0), np.max([high for _, high in shared], axis=0)])
        return planes, np.clip(inside, 1, self.shape - 1)  # slopes of mass need the neighbors of a node

    def _held_nodes(self, origin: Array, grids: int) -> tuple[NDArray[np.int8], Array]:
        """(grids nodes,) 1 at nodes that held particles of the grid's component touch; and, with several components, the held mass, kg."""
        nodes, along = int(np.prod(self.shape)), self._along()
        fixed, weight = np.zeros(grids * nodes, np.int8), np.zeros(grids * nodes if grids > 1 else 0)
        held = np.flatnonzero(self.model.held)
        if len(held):
            s = (self.model.particles.position[held] - origin) / self.model.grid.spacing
            first = s.astype(np.int64) @ np.array([*along, 1]) + nodes * self.component[held]
            mass, N = self.model.density[held] * self.model.particles.volume[held], spline_weights(s - np.floor(s))
            for a, b, c in product(range(3), repeat=3):
                node = first + a * along[0] + b * along[1] + c
                fixed[node] = 1
                if len(weight):
                    np.add.at(weight, node, mass * N[:, 0, a] * N[:, 1, b] * N[:, 2, c])
        return fixed, weight

    def _mirrors(self, fixed: NDArray[np.int8]) -> tuple[Index, int]:
        """Pairs (pairs, 2) of nodes on either side of a face at rest, the outer one first; and how many of them, the first, adjoin a face.

        The outer node gets minus the velocity of the inner one. So the face is at rest, and nothing else (bodies.grid.clamp_first_node).
        Behind the face of the base, all nodes mirror those in front of it, or are fixed. Nodes inside a face are free, even where a held
        part touches them: this changes `fixed`.
        """
        model, found = self.model, [np.zeros((0, 2), np.int64)]
        number = np.arange(len(fixed)).reshape(-1, *self.shape)  # in the grids of all components
        for plane in (*model.planes, *([ClampPlane(0, True, 0)] if model.clamped_face else [])):
            inner, axis = plane.cell + 1 - int(self.low[plane.axis]), 1 + plane.axis
            pair = number.take([inner - 1 if plane.lower else inner + 1, inner], axis=axis)
            pairs = np.moveaxis(pair, axis, -1).reshape(-1, 2)
            if model.held.any():
                pairs = pairs[(fixed[pairs] != 0).all(axis=1)]
            found.append(pairs)
        next_to_faces = sum(len(pairs) for pairs in found)
        for outer in range(-int(self.low[0]) if model.clamped_face else 0):
            inner = 1 - 2 * int(self.low[0]) - outer
            if inner < self.shape[0]:
                found.append(np.stack([number[:, outer], number[:, inner]], axis=-1).reshape(-1, 2))
            else:
                fixed[number[:, outer]] = 1
        mirrors = np.concatenate(found)
        if model.held.any():
            fixed[mirrors[:, 1]] = 0
        return mirrors, next_to_faces

    def _nodes_place(self, origin: Array) -> Array:
        h = self.model.grid.spacing
        axes = [origin[a] + h[a] * (np.arange(self.shape[a]) - 0.5) for a in range(3)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).ravel()
