"""Keeps the updated formulation's particles true to the body they are of.

F is integrated step by step, of a velocity that lies in the splines of a grid past which the particles move. In time particles shift,
by parts of a cell, in ways that relax the strain at the particles and leave the body bent: a strip of two cells that was folded and
let go kept a bend of 13 % of its length, in steps eight times smaller 3 %. A hyperelastic body has no such memory: its F is the gradient
of its deformation. So every INTERVAL steps the displacements of the particles are fitted, by least squares, with the splines of the
undeformed body's grid: the deformations that statics and the total formulation know. Places go a part of the way to that fit,
and F to its gradient, with its det averaged over cells as in statics (F-bar). The same strip keeps 0.2 %, and a catheter under
load settles where statics has it (docs/stability.md has the numbers). F alone is not enough: what the fit can't see would then have no
stiffness, and slowly grows.

The fit is weighted by mass: the centre of mass stays where it is. Velocities are not touched.

Folds of the body that touch and are not neighbours keep their pressure (it is strain that only the grid in space gives them: relaxed, it
would let them sink into each other), but not their tension: what sticks lets go within some spans. Left alone is what is OFF cells off
the fit: there the body has been torn. Components of the body (magmpm.bodies.connectivity) are fitted apart.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array, Index
from magmpm.dynamics.particle_groups import slab_edges
from magmpm.kernels import reference_fit as kernels
from magmpm.model import Model

INTERVAL = 512  # steps from one fit to the next
SPAN = 1024.0  # steps in which they go 1 - 1/e of the way; a third of it is stable as well
OFF = 0.25  # cells
EXACT = 1e-6  # cells: what is left of the fit's normal equations, per node
FAR = 7.0  # of the longest cell: particles within three cells of each other that were farther apart along an axis touch (turned: 5.2)
MOST = 24  # iterations of a fit: 20 take a swing from rest to within 1e-4 cells of the best
GOOD = 1e-3  # cells: what a fit may lack; F waits for the next one where it lacks more


class DriftCorrection:
    """Fits of a model's displacements. `field` (nodes, 3) m: the last fit's coefficients, from which the next one starts."""

    def __init__(self, model: Model) -> None:
        grid, particles = model.grid, model.particles
        cell = particles.cell.astype(np.int64)
        cell_first = particles.cell_first
        base = cell[cell_first[:-1]]
        self.particle_component = model.scene.body.shape.components(particles)
        self.component = self.particle_component[cell_first[:-1]]
        node, key = _stencils(base, self.component, grid.nodes)
        self.node_component, within = np.divmod(key, int(np.prod(grid.nodes)))
        self.node_place = grid.origin + grid.spacing * (np.stack(np.unravel_index(within, grid.nodes), axis=1) - 0.5)
        self.per = 1.0 / grid.spacing
        self.cells = kernels.Cells(_slabs(base[:, 0]), cell_first, node, grid.origin + base * grid.spacing, self.per)
        self.particles = kernels.Particles(particles.position, particles.volume, model.density, model.modes)
        self.rest = particles.position
        self.size = float(grid.spacing.min())
        self.held = model.held
        self.mass = float(model.density @ particles.volume)
        self.node_mass = self._moments(np.ones((len(cell), 3)), len(key))
        self.field = np.zeros((len(key), 3))

    def _moments(self, values: Array, nodes: int) -> Array:
        out = np.zeros((nodes, 3))
        kernels.moments(self.cells, self.particles, values, out)
        return out

    def _values(self, field: Array) -> Array:
        out = np.empty((len(self.rest), 3))
        kernels.interpolate(self.cells, self.rest, field, out)
        return out

    def fit(self, moved: Array) -> bool:
        """Fit displacements moved (n, 3) m, from the last fit on. Returns whether the fit is good enough to be used.

        What has changed by an affine motion of each component is added as it is: splines hold it exactly. The rest by conjugate gradients
        on the normal equations, of all three axes at once.
        """
        self._add_affine(moved - self._values(self.field))
        residual = self._moments(moved - self._values(self.field), len(self.field))
        step, before = np.zeros_like(residual), np.ones(3)
        for _ in range(MOST):
            z = residual / self.node_mass
            if not np.abs(z).max() > EXACT * self.size:
                break
            now = (residual * z).sum(axis=0)
            step = z + step * np.divide(now, before, out=np.zeros(3), where=before > 0)
            pushed = self._moments(self._values(step), len(self.field))
            scale = (step * pushed).sum(axis=0)
            part = np.divide(now, scale, out=np.zeros(3), where=scale > 0)
            self.field += part * step
            residual -= part * pushed
            before = now
        self.field += residual.sum(axis=0) / self.mass  # splines add up to 1: nothing is left of the centre of mass
        return bool(np.abs(residual / self.node_mass).max() < GOOD * self.size)

    def _add_affine(self, left: Array) -> None:
        """Take the affine part of each component of what is left (n, 3) m into the field: at a node, its value at the spline's middle."""
        for component in np.unique(self.component):
            mine, nodes = self.particle_component == component, self.node_component == component
            middle = self.rest[mine].mean(axis=0)
            row = np.column_stack([np.ones(np.count_nonzero(mine)), (self.rest[mine] - middle) / self.size])
            weighed = row * (self.particles.density[mine] * self.particles.volume[mine])[:, None]
            affine = np.linalg.lstsq(weighed.T @ row, weighed.T @ left[mine], rcond=1e-9)[0]
            self.field[nodes] += np.column_stack([np.ones(np.count_nonzero(nodes)), (self.node_place[nodes] - middle) / self.size]) @ affine

    def touching(self, cell: Index, shape: Index) -> NDArray[np.bool_]:
        """Which particles (n,) share nodes with some of their component that are not their neighbours.

        cell (n, 3): where they are in a box of so many nodes (3,).
        """
        where = self.rest * self.per.min()  # cells
        key = np.ravel_multi_index(tuple(cell.T), tuple(shape)) + int(np.prod(shape)) * self.particle_component
        full, of = np.unique(key, return_inverse=True)
        low, high = np.full((len(full), 3), np.inf), np.full((len(full), 3), -np.inf)
        np.minimum.at(low, of, where)
        np.maximum.at(high, of, where)
        least, most = low.copy(), high.copy()
        for offset in product((-1, 0, 1), repeat=3):
            to = full + int(np.dot(offset, [shape[1] * shape[2], shape[2], 1]))
            at = np.minimum(np.searchsorted(full, to), len(full) - 1)
            on = full[at] == to
            least[on], most[on] = np.minimum(least[on], low[at[on]]), np.maximum(most[on], high[at[on]])
        return (most - least > FAR).any(axis=1)[of]

    def relax(self, x: Array, F: Array, row: Index, touching: NDArray[np.bool_], steps: int) -> float:
        """Take x m and F the way they go in so many steps: flat in blocks of eight, row (n,) of each particle in them.

        touching (n,): keep their pressure. Held particles stay. Returns how far a particle has been moved at most, in cells along an axis.
        """
        block, lane = np.divmod(row, 8)
        moved = x.reshape(-1, 3, 8)[block, :, lane] - self.rest
        moved[self.held] = 0.0
        if not self.fit(moved):
            return 0.0
        before = x.copy()
        part = 1.0 - np.exp(-steps / SPAN)
        kernels.relax(self.cells, self.particles, self.field, moved, self.held, touching, OFF * self.size, part, row, x, F)
        return float((np.abs(x - before).reshape(-1, 3, 8).max(axis=(0, 2)) * self.per).max())


def _slabs(plane: Index) -> Index:
    """First cell of each slab of at least two planes, with cells sorted by plane (cells,)."""
    edges = slab_edges(int(plane[-1] - plane[0]) + 1, 2) + plane[0]
    first: Index = np.searchsorted(plane, edges)
    return first


def _stencils(base: Index, component: Index, shape: tuple[int, int, int]) -> tuple[NDArray[np.int32], Index]:
    """The 27 nodes of each cell (cells, 27), numbered over those that any cell of a component has.

    And (nodes,) which they are: the component times the number of nodes of the grid, plus the node's number in it.
    """
    offsets = np.array(list(product(range(3), repeat=3)))
    near = base[:, None, :] + offsets
    key = np.ravel_multi_index(tuple(near.reshape(-1, 3).T), shape) + component.repeat(27) * int(np.prod(shape))
    found, node = np.unique(key, return_inverse=True)
    return node.reshape(-1, 27).astype(np.int32), found
