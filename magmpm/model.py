"""A scene made ready to run: particles, grid, numbering of the unknowns, effects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magmpm import effects
from magmpm.basis import Array, Grid, clamp_first_node, spline_slopes, spline_weights
from magmpm.bodies import Particles, rod_grid, rod_particles, section_errors
from magmpm.scene import Scene
from magmpm.statics.panels import split_plane

LINEAR_STIFFNESS = 5.0  # of G: what the linear modes of the volume part carry at most, see volume_modes
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Layout:
    """Which unknowns each cell touches.

    Unknowns are numbered plane by plane along x: `planes` planes of m = 3 nodes_per_plane, dof = 3 node + component. A cell touches
    planes cell_plane .. + 2, and in each, three rows of three neighbouring nodes, the first of each in cell_row.
    A "cell" here is the part of a grid cell that belongs to one segment: it has one material.
    """

    planes: int
    nodes_per_plane: int
    cell_first: Index  # (cells + 1,) first particle of each cell
    cell_plane: Index  # (cells,)
    cell_row: Index  # (cells, 3)
    slab_first: Index  # (slabs + 1,) first cell of each slab of two base planes
    node_yz: Index  # (nodes_per_plane, 2) grid index of each node of a plane

    @property
    def m(self) -> int:
        """Unknowns of a plane."""
        return 3 * self.nodes_per_plane

    @property
    def split(self) -> int:
        """Where the two halves of the factorisation meet (statics.panels)."""
        return split_plane(self.planes)

    @property
    def most(self) -> int:
        """Largest number of particles in a cell."""
        return int(np.diff(self.cell_first).max())


@dataclass(frozen=True)
class Model:
    """What the kernels need: particles (n), their splines, materials, and effects. SI units."""

    scene: Scene
    grid: Grid
    particles: Particles
    layout: Layout
    weights: Array  # (n, 3, 3): axis, node
    slopes: Array  # (n, 3, 3) 1/m
    shear: Array  # (n,) Pa
    bulk: Array  # (n,) Pa
    magnet: Array  # (n, 3) T, remanence in the undeformed body
    density: Array  # (n,) kg/m^3
    effects: tuple[NDArray[Any], ...]  # records and data of each effect, in turn
    modes: Array  # (n, 0) or (n, 4): what the volume part of the energy is projected on, see volume_modes
    section: dict[str, float]  # relative errors of area and second moment

    @property
    def dof(self) -> int:
        """Number of unknowns."""
        return self.layout.planes * self.layout.m


def build(scene: Scene) -> Model:
    """The model of a scene. Raises InputError through the scene's own checks; costs milliseconds."""
    catheter = scene.body.catheter
    outer, inner = catheter.diameter / 2, catheter.inner_diameter / 2
    grid = rod_grid(catheter.length, catheter.diameter, scene.resolution.cells_across)
    particles = rod_particles(
        grid,
        outer=outer,
        inner=inner,
        segment_ends=np.cumsum(catheter.segment_lengths()),
        particles_per_cell=scene.resolution.particles_per_cell,
    )
    xi = grid.locate(particles.position, particles.cell)
    weights, slopes = spline_weights(xi), spline_slopes(xi) / grid.spacing[None, :, None]
    first = particles.cell[:, 0] == 0
    weights[first, 0], slopes[first, 0] = clamp_first_node(weights[first, 0], slopes[first, 0])
    layout = _layout(grid, particles)
    materials = [scene.segment_material(k) for k in range(len(catheter.segments))]
    of = particles.segment
    ratio = np.array([material.bulk_to_shear for material in materials])
    averaged = scene.solver.static.anti_locking == "f-bar"
    shear = np.array([material.shear_modulus for material in materials])
    return Model(
        scene=scene,
        grid=grid,
        particles=particles,
        layout=layout,
        weights=weights,
        slopes=slopes,
        shear=shear[of],
        bulk=(shear * ratio)[of],
        magnet=scene.segment_remanence()[of],
        density=np.array([material.density or 0.0 for material in materials])[of],
        effects=effects.collect(scene),
        modes=volume_modes(particles, layout.cell_first, ratio[of]) if averaged else np.zeros((len(of), 0)),
        section=section_errors(particles, outer=outer, inner=inner, length=catheter.length),
    )


def _layout(grid: Grid, particles: Particles) -> Layout:
    """Numbering for a body clamped on the grid's lower x face (node 0 along x is eliminated: basis.clamp_first_node)."""
    cell, segment = particles.cell, particles.segment
    new = np.any(np.diff(cell, axis=0) != 0, axis=1) | (np.diff(segment) != 0)
    cell_first = np.concatenate([[0], np.flatnonzero(new) + 1, [len(cell)]])
    ix, iy, iz = cell[cell_first[:-1]].T

    # Each row of nodes keeps one unbroken run, so a cell's three nodes along z are neighbours in the numbering.
    _, rows, columns = grid.nodes
    low, high = np.full(rows, columns), np.full(rows, -1)
    for shift in range(3):
        np.minimum.at(low, iy + shift, iz)
        np.maximum.at(high, iy + shift, iz + 2)
    counts = np.maximum(high - low + 1, 0)
    start = np.concatenate([[0], np.cumsum(counts)])
    cell_row = np.stack([start[iy + shift] + iz - low[iy + shift] for shift in range(3)], axis=1)
    node_yz = np.array([(y, low[y] + k) for y in range(rows) for k in range(counts[y])])

    cell_plane = np.maximum(ix - 1, 0)
    slab = cell_plane // 2
    slab_first = np.searchsorted(slab, np.arange(slab.max() + 2))
    return Layout(
        planes=grid.nodes[0] - 1,
        nodes_per_plane=int(start[-1]),
        cell_first=cell_first.astype(np.int64),
        cell_plane=cell_plane.astype(np.int64),
        cell_row=cell_row.astype(np.int64),
        slab_first=slab_first.astype(np.int64),
        node_yz=node_yz.astype(np.int64),
    )


def volume_modes(particles: Particles, cell_first: Index, ratio: Array) -> Array:
    """Anti-locking (F-bar): functions on each cell's particles onto which det F is projected in the volume part of the energy.

    ratio (n,): K/G. Returns (n, 4) m^(-3/2): a constant and three linear modes, orthogonal under the particles' volumes. The volume
    energy of a cell is K/2 sum_k c_k^2 with c_k = sum V mode_k (J - 1). The linear modes carry at most LINEAR_STIFFNESS G in place
    of K: a cell's mean of J is held by K, its variation within the cell, which vanishes with the cell's size, more softly.
    Source: F-bar, de Souza Neto et al., IJSS 33 (1996); as a projection for splines, Elguedj et al., CMAME 197 (2008).
    The measurements behind both choices are in docs/design.md.
    """
    modes = np.zeros((len(particles.volume), 4))
    cell = np.repeat(np.arange(len(cell_first) - 1), np.diff(cell_first))
    root = np.sqrt(particles.volume)
    for k, raw in enumerate([np.ones(len(cell)), *particles.position.T]):
        mode = raw * root
        size = np.sqrt(np.bincount(cell, mode**2))
        for _ in range(2):  # twice: once leaves rounding of the size of the offset from the origin
            for j in range(k):
                mode = mode - modes[:, j] * np.bincount(cell, modes[:, j] * mode)[cell]
        left = np.sqrt(np.bincount(cell, mode**2))
        fine = left > 1e-9 * size  # particles in a line or a plane: the mode adds nothing
        modes[:, k] = np.where(fine[cell], mode / np.where(fine, left, 1.0)[cell], 0.0)
    modes[:, 1:] *= np.sqrt(np.minimum(1.0, LINEAR_STIFFNESS / ratio))[:, None]
    return modes / root[:, None]


def kernel_arguments(model: Model) -> tuple[Any, ...]:
    """What every particle loop takes after the layout and the splines, in the kernels' order."""
    return model.shear, model.bulk, model.modes, model.effects, model.magnet, model.density
