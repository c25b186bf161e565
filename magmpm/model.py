"""A scene made ready to run: particles, grid, numbering of the unknowns, effects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magmpm.bodies.grid import (
    Array,
    Grid,
    clamp_first_node,
    clamp_last_node,
    clamp_low_node,
    spline_slopes,
    spline_weights,
)
from magmpm.bodies.mesh_quadrature import ClampPlane, grid_of_parts, part_errors, part_particles
from magmpm.bodies.regions import Line
from magmpm.bodies.section_quadrature import (
    Particles,
    rod_grid,
    rod_particles,
    section_errors,
    strip_errors,
    strip_grid,
    strip_particles,
)
from magmpm.bodies.slender import Strip
from magmpm.effects import acting as effects
from magmpm.scene import Scene
from magmpm.statics.block_cholesky import split_plane

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
    fixed: NDArray[np.bool_]  # (planes, m) unknowns that stay zero: of nodes without material, of held parts, along y in plane strain

    @property
    def m(self) -> int:
        """Unknowns of a plane."""
        return 3 * self.nodes_per_plane

    @property
    def split(self) -> int:
        """Where the two halves of the factorisation meet (statics.block_cholesky)."""
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
    magnet: Array  # (n, 3) T, remanence in the undeformed body; a fourth column where an effect marks particles (effects.marked)
    density: Array  # (n,) kg/m^3
    effects: tuple[NDArray[Any], ...]  # records and data of each effect, in turn
    modes: Array  # (n, 0) or (n, 4): what the volume part of the energy is projected on, see volume_modes
    section: dict[str, float]  # relative errors of area and second moment
    held: NDArray[np.bool_]  # (n,) particles of parts that can't move
    clamped_face: bool  # the grid's lower x face is at rest: node 0 along x is eliminated (basis.clamp_first_node)
    plane_strain: bool  # one cell along y, whose middle node carries all: nothing varies along y, and u_y = 0
    line: Line | None  # the undeformed axis of a straight body
    planes: tuple[ClampPlane, ...] = ()  # the grid's faces on which held parts, or a far end's clamp, hold the rest
    order: tuple[int, int, int] = (0, 1, 2)  # reference axes that the grid's axes are: see statics.axis_order

    @property
    def dof(self) -> int:
        """Number of unknowns."""
        return self.layout.planes * self.layout.m - int(self.layout.fixed.sum())

    @property
    def free(self) -> bool:
        """Whether nothing holds the body."""
        return not (self.clamped_face or self.held.any())

    def plane_coordinates(self) -> Array:
        """x (planes,) m of the planes of unknowns, counted from the body's base."""
        x = self.grid.node_coordinates(0)[int(self.clamped_face) :]
        return x - self.grid.origin[0]


def build(scene: Scene, *, shift: tuple[float, float] = (0.0, 0.0)) -> Model:
    """The model of a scene. Raises InputError through the scene's own checks; costs milliseconds.

    shift: of a catheter's grid along y and z, in cells (bodies.rod_grid).
    """
    grid, particles, section, planes = _catheter(scene, shift) if any(shift) else _BODIES[scene.body.kind](scene)
    shape = scene.body.shape
    pieces = scene.regions()
    of = particles.segment
    held = np.array([piece.held for piece in pieces])[of]
    clamped_face = shape.clamp in {"base", "both"} and scene.effects.feed is None  # what is fed, its guide holds
    plane_strain = isinstance(shape, Strip) and shape.plane_strain
    xi = grid.locate(particles.position, particles.cell)
    weights, slopes = spline_weights(xi), spline_slopes(xi) / grid.spacing[None, :, None]
    if clamped_face:
        first = particles.cell[:, 0] == 0
        weights[first, 0], slopes[first, 0] = clamp_first_node(weights[first, 0], slopes[first, 0])
    if shape.clamp == "both":
        last = particles.cell[:, 0] == grid.cells[0] - 1
        weights[last, 0], slopes[last, 0] = clamp_last_node(weights[last, 0], slopes[last, 0])
    if plane_strain:  # the middle node of the one cell across stands for all: nothing varies along y
        weights[:, 1], slopes[:, 1] = np.array([0.0, 1.0, 0.0]), 0.0
    for plane in planes:
        row = (particles.cell[:, plane.axis] == plane.cell) & ~held
        clamp = clamp_low_node if plane.lower else clamp_last_node
        weights[row, plane.axis], slopes[row, plane.axis] = clamp(weights[row, plane.axis], slopes[row, plane.axis])
    if planes:  # held particles see no node: they stay where they are, and the nodes beyond the plane carry nothing
        weights[held], slopes[held] = 0.0, 0.0
    layout = make_layout(grid, particles, weights, held, clamped_face=clamped_face, plane_strain=plane_strain)
    materials = [scene.segment_material(k) for k in range(len(pieces))]
    if scene.effects.in_a_field:
        scene.outside_field().check_at_rest(particles.position, moving=not scene.static)
    ratio = np.array([material.bulk_to_shear for material in materials])
    averaged = scene.solver.anti_locking == "f-bar"
    shear = np.array([material.shear_modulus for material in materials])
    model = Model(
        scene=scene,
        grid=grid,
        particles=particles,
        layout=layout,
        weights=weights,
        slopes=slopes,
        shear=shear[of],
        bulk=(shear * ratio)[of],
        magnet=effects.marked(scene, particles, _remanence(scene, particles)),
        density=np.array([material.density or 0.0 for material in materials])[of],
        effects=effects.collect(scene),
        modes=volume_modes(particles, layout.cell_first, ratio[of]) if averaged else np.zeros((len(of), 0)),
        section=section,
        held=held,
        clamped_face=clamped_face,
        plane_strain=plane_strain,
        line=shape.line,
        planes=(*planes, *([ClampPlane(0, False, grid.cells[0] - 1)] if shape.clamp == "both" else [])),
    )
    effects.check(model)
    return model


Shape = tuple[Grid, Particles, dict[str, float], list[ClampPlane]]


def _catheter(scene: Scene, shift: tuple[float, float] = (0.0, 0.0)) -> Shape:
    """Grid, particles and the section's errors of a catheter."""
    catheter = scene.body.catheter
    assert catheter is not None  # asked for by kind
    outer, inner = catheter.diameter / 2, catheter.inner_diameter / 2
    grid = rod_grid(catheter.length, catheter.diameter, scene.resolution.cells_across, shift=shift)
    particles = rod_particles(
        grid,
        outer=outer,
        inner=inner,
        segment_ends=np.cumsum(catheter.segment_lengths()),
        particles_per_cell=scene.resolution.particles_per_cell,
    )
    return grid, particles, section_errors(particles, outer=outer, inner=inner, length=catheter.length), []


def _strip(scene: Scene) -> Shape:
    """Grid, particles and the section's errors of a strip."""
    strip = scene.body.strip
    assert strip is not None  # asked for by kind
    base, size = np.array(strip.position), np.array([strip.length, strip.width, strip.thickness])
    grid = strip_grid(base, size, scene.resolution.cells_across, one_wide=strip.plane_strain)
    ends = np.cumsum(strip.segment_lengths())
    particles = strip_particles(
        grid,
        segment_ends=base[0] + (ends if strip.segments is not None else np.array([strip.length])),
        particles_per_cell=scene.resolution.particles_per_cell,
        one_wide=strip.plane_strain,
    )
    if strip.segments is None:  # pieces of a profile are for show: they cut no cells
        middle = (particles.cell[:, 0] + 0.5) * grid.spacing[0]
        particles = replace(particles, segment=np.searchsorted(ends, middle).astype(np.int32))
    return grid, particles, strip_errors(particles, size), []


def _parts(scene: Scene) -> Shape:
    """Grid, particles, their errors, and the planes on which STL parts are clamped."""
    parts = scene.body.parts
    assert parts is not None  # asked for by kind
    triangles = parts.triangles()
    spacing = parts.spacing or parts.thickness / scene.resolution.cells_across
    grid, planes = grid_of_parts(triangles, [part.clamp for part in parts.meshes], spacing)
    particles = part_particles(grid, triangles, scene.resolution.particles_per_cell)
    return grid, particles, part_errors(particles, triangles), planes


_BODIES: dict[str, Callable[[Scene], Shape]] = {
    "catheter": _catheter,
    "strip": _strip,
    "parts": _parts,
}


def _remanence(scene: Scene, particles: Particles) -> Array:
    """Remanence of each particle in the undeformed body, (n, 3) T."""
    strip = scene.body.strip
    if strip is None or strip.magnetization_profile is None:
        return scene.segment_remanence()[particles.segment]
    profile = strip.magnetization_profile
    x, of = np.unique(particles.position[:, 0], return_inverse=True)
    share = (x - strip.position[0]) / strip.length
    directions = np.array([profile.direction(s, strip.length) for s in share.tolist()])
    return scene.materials[strip.material].remanence * directions[of]


def make_layout(
    grid: Grid, particles: Particles, weights: Array, held: NDArray[np.bool_], *, clamped_face: bool, plane_strain: bool
) -> Layout:
    """Numbering of the unknowns. clamped_face: node 0 along x is eliminated (basis.clamp_first_node) and has none."""
    cell, segment = particles.cell, particles.segment
    new = np.any(np.diff(cell, axis=0) != 0, axis=1) | (np.diff(segment) != 0)
    cell_first = np.concatenate([[0], np.flatnonzero(new) + 1, [len(cell)]])
    ix, iy, iz = cell[cell_first[:-1]].T

    # Each row of nodes keeps one unbroken run, so a cell's three nodes along z are neighbours in the numbering.
    _, rows, columns = grid.nodes
    low, high = np.full(rows, columns), np.full(rows, -1)
    in_row = [1, 1, 1] if plane_strain else [0, 1, 2]  # in plane strain one row stands for all three
    for shift in in_row:
        np.minimum.at(low, iy + shift, iz)
        np.maximum.at(high, iy + shift, iz + 2)
    counts = np.maximum(high - low + 1, 0)
    start = np.concatenate([[0], np.cumsum(counts)])
    cell_row = np.stack([start[iy + shift] + iz - low[iy + shift] for shift in in_row], axis=1)
    node_yz = np.array([(y, low[y] + k) for y in range(rows) for k in range(counts[y])])

    cell_plane = np.maximum(ix - 1, 0) if clamped_face else ix
    slab = cell_plane // 2
    slab_first = np.searchsorted(slab, np.arange(slab.max() + 2))
    planes, nodes = grid.nodes[0] - int(clamped_face), int(start[-1])
    touched = _touched(cell_first, cell_plane, cell_row, weights, (planes, nodes))
    fixed = np.repeat(~touched, 3, axis=1)  # nodes without material would be free to be anything
    if held.any():
        still = held[:, None, None] * weights
        fixed |= np.repeat(_touched(cell_first, cell_plane, cell_row, still, (planes, nodes)), 3, axis=1)
    if plane_strain:
        fixed[:, 1::3] = True
    return Layout(
        planes=planes,
        nodes_per_plane=nodes,
        cell_first=cell_first.astype(np.int64),
        cell_plane=cell_plane.astype(np.int64),
        cell_row=cell_row.astype(np.int64),
        slab_first=slab_first.astype(np.int64),
        node_yz=node_yz.astype(np.int64),
        fixed=fixed,
    )


def _touched(
    cell_first: Index, cell_plane: Index, cell_row: Index, weights: Array, shape: tuple[int, int]
) -> NDArray[np.bool_]:
    """Nodes (planes, nodes_per_plane) that some particle touches."""
    heaviest = np.maximum.reduceat(np.abs(weights), cell_first[:-1], axis=0) > 0.0
    touched = np.zeros(shape, bool)
    for a, b, c in np.ndindex(3, 3, 3):
        on = heaviest[:, 0, a] & heaviest[:, 1, b] & heaviest[:, 2, c]
        touched[cell_plane[on] + a, cell_row[on, b] + c] = True
    return touched


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
