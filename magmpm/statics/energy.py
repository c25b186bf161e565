"""Potential energy of a model as a function of the grid's coefficients: value, gradient and tangent.

It calls the steps of kernels.equilibrium. Newton's method, which updates the grid, is in statics.newton.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from magmpm.compiled.arrays import Array, Index
from magmpm.compiled.by_address import addresses
from magmpm.effects.calls import at_rest
from magmpm.kernels.changes import scatter, tangent_products
from magmpm.kernels.equilibrium import (
    StaticCells,
    StaticParticles,
    cell_energy,
    grid_to_particles,
    particles_to_grid,
    particles_to_grid_with_tangent,
)
from magmpm.statics.arcs import TurningParticles, along_arc
from magmpm.statics.contact import Touched
from magmpm.statics.layout import StaticModel
from magmpm.statics.own_contact import OwnContacts
from magmpm.statics.tangent_matrix import Bands, Sparse, new_matrix


@dataclass
class Point:
    """The energy at one state: grid coefficients (planes, m) m; displacement and position (n, 3) m and F (n, 3, 3) of the particles;
    touched: the points that touch obstacles (None: no obstacles); own: the pairs that touch (None: the body does not touch itself)."""

    grid: Array
    displacement: Array
    position: Array
    F: Array
    energy: float  # J; inf where some det F <= 0
    min_det_F: float
    max_det_F: float
    touched: Touched | None = None
    own: OwnContacts | None = None

    @property
    def pattern(self) -> Index | None:
        """Numbers of what touches: the tangent is another where they change. None where nothing can."""
        if self.touched is None or self.own is None:
            return None if self.touched is None else self.touched.pattern
        return np.concatenate([self.touched.pattern, -1 - self.own.pattern])


class Energy:
    """Potential energy of a model. It owns the work arrays, so a Newton step allocates almost nothing."""

    def __init__(self, model: StaticModel) -> None:
        self.model = model
        layout = model.layout
        self.shape = (layout.planes, layout.m)
        self.matrix = new_matrix(model.scene, layout)
        self.cells = StaticCells(
            layout.slab_first, layout.cell_first, layout.cell_plane, layout.cell_row, layout.most
        )
        self.particles = StaticParticles(
            model.weights,
            model.slopes,
            model.particles.volume,
            model.shear,
            model.bulk,
            model.modes,
            model.remanence,
            model.density,
        )
        self._calls = at_rest(model.effects)
        self._fortran = addresses()
        cells = len(layout.cell_plane)
        self._rest: float | None = None
        self._held: Array | None = None
        self._per_cell = np.empty((3, cells))
        self._fixed = layout.fixed if layout.fixed.any() else None

    @property
    def alone(self) -> Energy:
        """The part in which each particle is by itself: all of it, but for statics.interacting."""
        return self

    def held_load(self, load: Array | None) -> None:
        """Put the body under a load (planes, m) N that does not follow it, beside those of its effects."""
        self._held = load
        self._rest = None

    def load(self, model: StaticModel) -> None:
        """Put the same body under other loads: those of a model with the same grid and particles."""
        self.model = model
        self._calls = at_rest(model.effects)
        self.held_load(None)

    def at(self, grid: Array) -> Point:
        """State and energy for grid coefficients (planes, m) m."""
        model = self.model
        n = len(model.shear)
        u = np.empty((n, 3))
        F = np.empty((n, 3, 3))
        grid_to_particles(self.cells, self.particles, grid, model.axes, u, F)
        x = model.particles.position + u
        energy, low, high = self._per_cell
        cell_energy(self.cells, self.particles, self._calls, x, F, energy, low, high)
        touched = None if model.touching is None else model.touching.touched(model.effects, grid)
        total = float(energy.sum()) + (0.0 if touched is None else touched.energy)
        if model.layout.springs is not None:
            total += model.layout.springs.energy(grid)
        if self._held is not None:
            total -= float(np.sum(self._held * grid))
        own = None
        least = float(low.min())
        if model.pairs is not None and least > 0.0:
            own = model.pairs.touched(grid)
            total += own.energy
        return Point(grid, u, x, F, total, least, float(high.max()), touched, own)

    def displacement(self, grid: Array) -> Array:
        """Displacements (n, 3) m of the particles for grid coefficients (planes, m) m."""
        n = len(self.model.shear)
        u = np.empty((n, 3))
        grid_to_particles(self.cells, self.particles, grid, self.model.axes, u, np.empty((n, 3, 3)))
        return u

    @cached_property
    def _turning(self) -> TurningParticles:
        return TurningParticles(self.model, self.cells, self.particles)

    def settled(self) -> None:
        """Give back the memory that only the way to an equilibrium takes."""
        self.__dict__.pop("_turning", None)

    def arc(self, point: Point, direction: Array, fraction: float) -> Array:
        """Coefficients (planes, m) m after a fraction of a step `direction` (planes, m) m from a point, along an arc (statics.arcs)."""
        if self.model.layout.straight:
            return along_arc(self.model, point.grid, direction, fraction)
        return self._turning.moved(point.grid, point.F, direction, fraction)

    def clear_share(self, grid: Array, change: Array) -> float:
        """Share, at most 1, of a change of coefficients (planes, m) m in which the body can't pass through itself unseen."""
        return 1.0 if self.model.pairs is None else self.model.pairs.clear(grid, change)

    def rest_energy(self) -> float:
        """Energy of the undeformed body, J: the reference for the energy of a load."""
        if self._rest is None:
            self._rest = self.at(np.zeros(self.shape)).energy
        return self._rest

    def least_scale(self) -> float:
        """Smallest energy (J) that matters: a strain of 1e-9 in the whole body."""
        return 1e-18 * float(np.sum(self.model.shear * self.model.particles.volume))

    def residual(self, point: Point) -> Array:
        """Gradient of the energy, (planes, m) N."""
        out = np.zeros(self.shape)
        particles_to_grid(self.cells, self.particles, self._calls, point.position, point.F, out)
        return self._completed(point, out)

    def _completed(self, point: Point, residual: Array) -> Array:
        """A gradient (planes, m) N of the particles' energy, with that of springs and contact added, and no force on fixed unknowns."""
        if self.model.layout.springs is not None:
            residual += self.model.layout.springs.gradient(point.grid)
        if self._held is not None:
            residual -= self._held
        if point.touched is not None and self.model.touching is not None:
            residual -= self.model.touching.force(point.touched).reshape(residual.shape)
        if point.own is not None:
            residual -= point.own.force(residual.size // 3).reshape(residual.shape)
        return self.free(residual)

    def free(self, vector: Array) -> Array:
        """Set the fixed unknowns of a vector (planes, m) to zero, in place, and return it."""
        if self._fixed is not None:
            vector[self._fixed] = 0.0
        return vector

    def free_columns(self, columns: Array) -> Array:
        """`free` for columns (planes, k, m)."""
        if self._fixed is not None:
            columns.transpose(0, 2, 1)[self._fixed] = 0.0
        return columns

    def scattered(self, column: Index, P: Array, f: Array, columns: int) -> Array:
        """Stresses P (slots, n, 3, 3) Pa and forces f (slots, n, 3) N/m^3 of the particles on the grid: (planes, columns, m) N.

        column (slots, cells): which column a slot of a cell adds to, -1 for none.
        """
        out = np.zeros((self.shape[0], columns, self.shape[1]))
        scatter(self.cells, self.particles, column, P, f, self._fortran, out)
        return self.free_columns(out)

    def each_scattered(self, P: Array, f: Array) -> Array:
        """`scattered` with a column for each slot: (planes, slots, m) N."""
        column = np.repeat(np.arange(len(P))[:, None], len(self.model.layout.cell_plane), axis=1)
        return self.scattered(column, P, f, len(P))

    def solve_columns(self, right: Array) -> Array:
        """Solutions for right-hand sides (planes, k, m), from the factored tangent."""
        return self.matrix.solve_columns(right)

    def mass(self, columns: Array) -> Array:
        """The mass matrix of unit density times columns (planes, k, m)."""
        count = columns.shape[1]
        n = len(self.model.shear)
        u = np.empty((count, n, 3))
        for k in range(count):
            u[k] = self.displacement(np.ascontiguousarray(columns[:, k]))
        return self.each_scattered(np.zeros((count, n, 3, 3)), -u)

    @cached_property
    def volumes(self) -> Array:
        """Volumes (planes, 1, m) of the unknowns' splines: a mass matrix good enough to find soft vectors, since these are smooth."""
        return np.abs(self.mass(np.ones((self.shape[0], 1, self.shape[1]))))

    def products(self, point: Point, columns: Array) -> tuple[Array, Array]:
        """The second derivative (N), and the mass matrix of unit density, times columns (planes, k, m)."""
        planes, count, _ = columns.shape
        right = columns.transpose(0, 2, 1).reshape(planes, -1)
        stiff = np.zeros_like(right)
        heavy = np.zeros_like(right)
        tangent_products(
            self.cells,
            self.particles,
            self._calls,
            point.position,
            point.F,
            self._fortran,
            count,
            right,
            stiff,
            heavy,
        )
        stiff, heavy = (
            np.ascontiguousarray(one.reshape(planes, -1, count).transpose(0, 2, 1))
            for one in (stiff, heavy)
        )
        if point.touched is not None and self.model.touching is not None:
            stiff += self.model.touching.product(point.touched, columns)
        if point.own is not None:
            for k in range(count):
                nodes = np.ascontiguousarray(columns[:, k]).reshape(-1, 3)
                stiff[:, k] += point.own.product(nodes).reshape(planes, -1)
        if self.model.layout.springs is not None:
            for k in range(count):
                stiff[:, k] += self.model.layout.springs.gradient(
                    np.ascontiguousarray(columns[:, k])
                )
        return self.free_columns(stiff), self.free_columns(heavy)

    def tangent(self, point: Point) -> tuple[Array, Bands | Sparse]:
        """Gradient (planes, m) N, and second derivative as a matrix, N/m, which the next call overwrites."""
        matrix = self.matrix
        out = np.zeros(self.shape)
        table = None
        if point.own is not None and isinstance(matrix, Sparse):
            nodes, group = point.own.elements()
            table = matrix.coupled(nodes)
        matrix.clear()
        target = matrix.target(self.cells)
        particles_to_grid_with_tangent(
            self.cells,
            self.particles,
            self._calls,
            point.position,
            point.F,
            target,
            self._fortran,
            out,
        )
        if point.touched is not None and self.model.touching is not None:
            self.model.touching.add_tangent(point.touched, matrix.target(self.model.touching.cells))
        if point.own is not None and table is not None and isinstance(matrix, Sparse):
            point.own.add_tangent(table, group, matrix.blocks)
        matrix.finish()
        return self._completed(point, out), matrix
