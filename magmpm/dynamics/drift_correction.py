"""Drift correction: ties the particles of the updated formulation to the deformation of their body.

F is integrated step by step from a velocity in the splines of a grid, and the particles move past this grid. In time, particles shift by
parts of a cell, in ways that relax their strain and leave the body bent. A strip of two cells that was folded and released kept a bend
of 13 % of its length, or 3 % with steps eight times smaller. A hyperelastic body has no such memory: its F is the gradient of its
deformation. So every INTERVAL steps the displacements of the particles are fitted by least squares, with the splines of the grid in the
undeformed body. Statics and the total formulation use the same splines. Positions move part of the way to the fit, and F to its gradient,
with det F averaged over cells as in statics (F-bar). The same strip then keeps 0.2 %, and a catheter under load settles at the static
shape (numbers in docs/stability.md). Correcting F alone is not enough: shifts that the fit can't represent would have no stiffness, and
would slowly grow.

The fit is weighted by mass, so the center of mass of what nothing holds stays where it is. Velocities do not change.

On a clamp the fit is at rest, as in statics: each node behind the clamp's face is minus its neighbor in front of it. Without this rule
bodies slipped out of their clamps and kept a stress there: a rod that was bent to 0.7 of its length and let go kept 1.1 % of it for good.

Folds of the body that touch, but are not neighbors, keep their pressure. Only the grid in space gives them this strain; if it relaxed, they
would sink into each other. They do not keep their tension, so folds that stick separate within a few spans. Particles more than OFF cells
away from the fit are left alone: there the body is torn. Each component of the body (magmpm.bodies.connectivity) has its own fit.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from magmpm.bodies.grid import ClampPlane
from magmpm.compiled.arrays import Array, Index
from magmpm.dynamics.particle_groups import slab_edges
from magmpm.kernels import reference_fit
from magmpm.model import Model

INTERVAL = 512  # steps from one fit to the next
SPAN = 1024.0  # steps in which particles move 1 - 1/e of the way to the fit; a third of it is stable as well
OFF = 0.25  # cells: particles farther from the fit are left alone
EXACT = 1e-6  # cells: residual of the normal equations at which the fit stops, per node
# Of the longest cell: particles within three cells of each other touch if their distance along an axis was larger (turned: 5.2). No whole
# number: particles in the same place of their cells are at distances of whole cells, and rounding would decide, in one way in a mirror.
FAR = 7.1
MOST = 24  # iterations of a fit: for a swing from rest, 20 reach the best fit to 1e-4 cells
GOOD = 1e-3  # cells: largest error of a fit that is used; if it is larger, F waits for the next fit


class DriftCorrection:
    """Fits of a model's displacements. `field` (nodes, 3) m: coefficients of the last fit, where the next fit starts."""

    def __init__(self, model: Model) -> None:
        grid, particles = model.grid, model.particles
        cell = particles.cell.astype(np.int64)
        cell_first = particles.cell_first
        base = cell[cell_first[:-1]]
        weighs = np.where(model.held & bool(model.planes), 0.0, model.density)  # parts that hold others at a face are no part of the fit
        self.particle_component = model.scene.body.shape.components(particles)
        self.component = self.particle_component[cell_first[:-1]]
        node, key = _stencils(base, self.component, grid.nodes)
        self.node_component, within = np.divmod(key, int(np.prod(grid.nodes)))
        at = np.stack(np.unravel_index(within, grid.nodes), axis=1)
        self.node_place = grid.origin + grid.spacing * (at - 0.5)
        self.per = 1.0 / grid.spacing
        self.cells = reference_fit.Cells(_slabs(base[:, 0]), cell_first, node, grid.origin + base * grid.spacing, self.per)
        self.particles = reference_fit.Particles(particles.position, particles.volume, weighs, model.modes)
        self.rest = particles.position
        self.size = float(grid.spacing.min())
        self.held = model.held
        self.faces = _across_clamps(model, at, key, np.isin(np.arange(len(key)), node[model.held[cell_first[:-1]]]))
        outside = np.unique(np.concatenate([np.zeros(0, np.int64), *(outer for outer, _ in self.faces)]))
        weight = weighs * particles.volume
        loose = np.setdiff1d(self.particle_component[weight > 0.0], self.node_component[outside])
        self.loose = [(self.node_component == one, float(weight[self.particle_component == one].sum())) for one in loose]
        self.field = np.zeros((len(key), 3))
        mass = self._forces(np.ones((len(cell), 3)))
        self.inverse_mass = np.divide(1.0, mass, out=np.zeros_like(mass), where=mass > 0.0)

    def _forces(self, values: Array) -> Array:
        """Sums over particles of mass, spline and values (n, 3): what acts on an outer node pulls its partner the other way."""
        out = np.zeros_like(self.field)
        reference_fit.moments(self.cells, self.particles, values, out)
        for outer, inner in self.faces:  # one after the other: where faces meet, a node is behind two of them
            out[inner] -= out[outer]
            out[outer] = 0.0
        return out

    def _values(self, field: Array) -> Array:
        out = np.empty((len(self.rest), 3))
        reference_fit.interpolate(self.cells, self.rest, field, out)
        return out

    def fit(self, moved: Array) -> bool:
        """Fit displacements moved (n, 3) m, starting from the last fit. Returns whether the fit is good enough to be used.

        The affine part of each component's motion since then is added directly: splines represent it exactly. Conjugate gradients on the
        normal equations find the rest, for all three axes at once.
        """
        self._add_affine(moved - self._values(self.field))
        self._hold(self.field)
        residual = self._forces(moved - self._values(self.field))
        step, before = np.zeros_like(residual), np.ones(3)
        for _ in range(MOST):
            z = residual * self.inverse_mass
            if not np.abs(z).max() > EXACT * self.size:
                break
            now = (residual * z).sum(axis=0)
            step = z + step * np.divide(now, before, out=np.zeros(3), where=before > 0)
            self._hold(step)
            pushed = self._forces(self._values(step))
            scale = (step * pushed).sum(axis=0)
            part = np.divide(now, scale, out=np.zeros(3), where=scale > 0)
            self.field += part * step
            residual -= part * pushed
            before = now
        self._keep_centers(residual)
        return bool(np.abs(residual * self.inverse_mass).max() < GOOD * self.size)

    def _hold(self, field: Array) -> None:
        """Put a nodal field (nodes, 3) to rest on the clamps, in place."""
        for outer, inner in reversed(self.faces):
            field[outer] = -field[inner]

    def _keep_centers(self, residual: Array) -> None:
        """Shift the field of each component that nothing holds by what is left of its center of mass: splines add up to 1."""
        for nodes, mass in self.loose:
            self.field[nodes] += residual[nodes].sum(axis=0) / mass

    def _add_affine(self, left: Array) -> None:
        """Add the affine part of the residual left (n, 3) m, by component, to the field: its value at the middle of each spline."""
        for component in np.unique(self.component):
            mine, nodes = self.particle_component == component, self.node_component == component
            middle = self.rest[mine].mean(axis=0)
            row = np.column_stack([np.ones(np.count_nonzero(mine)), (self.rest[mine] - middle) / self.size])
            weighed = row * (self.particles.density[mine] * self.particles.volume[mine])[:, None]
            affine = np.linalg.lstsq(weighed.T @ row, weighed.T @ left[mine], rcond=1e-9)[0]
            self.field[nodes] += np.column_stack([np.ones(np.count_nonzero(nodes)), (self.node_place[nodes] - middle) / self.size]) @ affine

    def touching(self, cell: Index, shape: Index) -> NDArray[np.bool_]:
        """Which particles (n,) share nodes with particles of their component that are not their neighbors.

        cell (n, 3): cells of the particles, in a box with shape (3,) nodes.
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
        """Move x m and F toward the fit, by the share due after `steps` steps. Both are flat blocks of eight; row (n,): of each particle.

        touching (n,): particles that keep their pressure. Held particles stay. Returns the largest move along an axis, in cells.
        """
        block, lane = np.divmod(row, 8)
        moved = x.reshape(-1, 3, 8)[block, :, lane] - self.rest
        moved[self.held] = 0.0
        if not self.fit(moved):
            return 0.0
        before = x.copy()
        part = 1.0 - np.exp(-steps / SPAN)
        reference_fit.relax(self.cells, self.particles, self.field, moved, self.held, touching, OFF * self.size, part, row, x, F)
        return float((np.abs(x - before).reshape(-1, 3, 8).max(axis=(0, 2)) * self.per).max())


def _across_clamps(model: Model, at: Index, key: Index, reached: NDArray[np.bool_]) -> list[tuple[Index, Index]]:
    """Nodes behind each face that clamps, and their partners in front of it: those that the motion mirrors (MovingGrid._mirrors). Parts
    hold where their own component reaches both nodes, and nowhere else.

    at (nodes, 3): place of each node in the grid; key (nodes,): as of `_stencils`; reached (nodes,): whether held particles see it.
    """
    stride = np.array([model.grid.nodes[1] * model.grid.nodes[2], model.grid.nodes[2], 1])
    faces = []
    for plane in (*model.planes, *([ClampPlane(0, True, 0)] if model.clamped_face else [])):
        behind, step = (plane.cell, 1) if plane.lower else (plane.cell + 2, -1)
        outer = np.flatnonzero(at[:, plane.axis] == behind)
        wanted = key[outer] + step * stride[plane.axis]
        inner = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
        there = key[inner] == wanted
        if model.held.any():
            there &= reached[outer] & reached[inner]
        faces.append((outer[there], inner[there]))
    return faces


def _slabs(plane: Index) -> Index:
    """First cell of each slab of at least two planes; plane (cells,): sorted plane of each cell."""
    edges = slab_edges(int(plane[-1] - plane[0]) + 1, 2) + plane[0]
    first: Index = np.searchsorted(plane, edges)
    return first


def _stencils(base: Index, component: Index, shape: tuple[int, int, int]) -> tuple[NDArray[np.int32], Index]:
    """The 27 nodes of each cell (cells, 27), numbered over the nodes that the cells of each component touch.

    And (nodes,) what these are: component times number of nodes in the grid, plus number of the node in the grid.
    """
    offsets = np.array(list(product(range(3), repeat=3)))
    near = base[:, None, :] + offsets
    key = np.ravel_multi_index(tuple(near.reshape(-1, 3).T), shape) + component.repeat(27) * int(np.prod(shape))
    found, node = np.unique(key, return_inverse=True)
    return node.reshape(-1, 27).astype(np.int32), found
