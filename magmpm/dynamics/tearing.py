"""Detection of a torn body in the updated formulation: its particles move past a grid, which alone holds them together.

A body that is stretched to about twice its length (2 particles a cell and direction) leaves cells between its particles empty. Then
nothing carries stress across the gap, F no longer follows the shape, and the parts fly off while det F looks healthy: numerical
fracture, a known fault of the method. Source: Sadeghirad, Brannon and Burghardt, IJNME 86 (2011) 1435-1456, section 1. The total
formulation, whose grid is in the undeformed body, has no such limit.

The distance of the middles of two cells that are neighbors in the undeformed body must be what F says, mean(F) (X_b - X_a). Where the two
differ by more than TORN cells, the body is torn between them.
"""

from __future__ import annotations

import numpy as np

from magmpm.compiled.arrays import Array, Index
from magmpm.model import Model

TORN = 0.5  # cells: of fifty drawn motions 45 stay below 0.1, four that are stretched 1.5 to 2.7 times reach 0.2 to 0.4; torn ones 0.8


class Tearing:
    """The cells of a body in pairs of neighbors."""

    def __init__(self, model: Model, component: Index) -> None:
        """component (n,): of each particle (magmpm.bodies.connectivity); parts that only touch are not neighbors."""
        particles, shape = model.particles, (*model.grid.cells, int(component.max()) + 1)
        key = np.ravel_multi_index((*particles.cell.astype(np.int64).T, component), shape)
        cells, self.cell = np.unique(key, return_inverse=True)
        self.weight = particles.volume / np.bincount(self.cell, particles.volume)[self.cell]
        middle = self._mean(particles.position)
        place, pairs = np.unravel_index(cells, shape), []
        for axis in range(3):
            has_next = place[axis] + 1 < shape[axis]
            to = cells[has_next] + int(np.prod(shape[axis + 1 :]))
            at = np.minimum(np.searchsorted(cells, to), len(cells) - 1)
            there = cells[at] == to
            pairs.append(np.stack([np.flatnonzero(has_next)[there], at[there]], axis=1))
        self.a, self.b = np.concatenate(pairs).T
        self.apart = middle[self.b] - middle[self.a]
        self.size = float(model.grid.spacing.min())

    def _mean(self, values: Array) -> Array:
        """Means (cells, k) of values (n, k) of the particles."""
        return np.stack([np.bincount(self.cell, self.weight * column) for column in values.T], axis=1)

    def largest(self, x: Array, F: Array) -> tuple[float, int]:
        """The largest difference (cells) between a distance of neighbors and what F says, at positions x (n, 3) m and F (n, 3, 3); and a
        particle next to it."""
        if not len(self.a):
            return 0.0, -1
        places, mean_F = self._mean(x), self._mean(F.reshape(-1, 9)).reshape(-1, 3, 3)
        told = np.einsum("pij,pj->pi", 0.5 * (mean_F[self.a] + mean_F[self.b]), self.apart)
        off = np.linalg.norm(places[self.b] - places[self.a] - told, axis=1) / self.size
        worst = int(np.argmax(off))
        return float(off[worst]), int(np.flatnonzero(self.cell == self.a[worst])[0])
