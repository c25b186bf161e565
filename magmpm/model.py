"""A scene made ready to run, in equilibrium or in motion: particles, grid, materials, effects."""

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
from magmpm.bodies.volume_modes import volume_modes
from magmpm.effects import acting as effects
from magmpm.scene import Scene

Index = NDArray[np.int64]


@dataclass(frozen=True)
class Model:
    """What the kernels need: particles (n), their splines, materials, and effects. SI units."""

    scene: Scene
    grid: Grid
    particles: Particles
    shear: Array  # (n,) Pa
    bulk: Array  # (n,) Pa
    magnet: Array  # (n, 3) T, remanence in the undeformed body; a fourth column where an effect marks particles (effects.marked)
    density: Array  # (n,) kg/m^3
    effects: tuple[NDArray[Any], ...]  # records and data of each effect, in turn
    modes: Array  # (n, 0) or (n, 4): what the volume part of the energy is projected on, see bodies.volume_modes
    section: dict[str, float]  # relative errors of area and second moment
    held: NDArray[np.bool_]  # (n,) particles of parts that can't move
    clamped_face: bool  # the grid's lower x face is at rest: node 0 along x is eliminated (bodies.grid.clamp_first_node)
    plane_strain: bool  # one cell along y, whose middle node carries all: nothing varies along y, and u_y = 0
    line: Line | None  # the undeformed axis of a straight body
    planes: tuple[ClampPlane, ...]  # the grid's faces on which held parts, or a far end's clamp, hold the rest

    @property
    def free(self) -> bool:
        """Whether nothing holds the body."""
        return not (self.clamped_face or self.held.any())

    def splines(self) -> tuple[Array, Array]:
        """Values and slopes (1/m) of the three splines that each particle sees along each axis, (n, 3, 3): axis, node.

        What is clamped is built into them. They are not kept: each solver stores them in its own order.
        """
        grid, cell = self.grid, self.particles.cell
        xi = grid.locate(self.particles.position, cell)
        weights, slopes = spline_weights(xi), spline_slopes(xi) / grid.spacing[None, :, None]
        if self.clamped_face:
            first = cell[:, 0] == 0
            weights[first, 0], slopes[first, 0] = clamp_first_node(weights[first, 0], slopes[first, 0])
        if self.plane_strain:  # the middle node of the one cell across stands for all: nothing varies along y
            weights[:, 1], slopes[:, 1] = np.array([0.0, 1.0, 0.0]), 0.0
        for plane in self.planes:
            row = (cell[:, plane.axis] == plane.cell) & ~self.held
            clamp = clamp_low_node if plane.lower else clamp_last_node
            weights[row, plane.axis], slopes[row, plane.axis] = clamp(weights[row, plane.axis], slopes[row, plane.axis])
        if self.planes:  # held particles see no node: they stay where they are, and the nodes beyond the plane carry nothing
            weights[self.held], slopes[self.held] = 0.0, 0.0
        return weights, slopes


def build(scene: Scene, *, shift: tuple[float, float] = (0.0, 0.0)) -> Model:
    """The model of a scene. Raises InputError through the scene's own checks; costs milliseconds.

    shift: of a catheter's grid along y and z, in cells (bodies.rod_grid).
    """
    grid, particles, section, planes = _catheter(scene, shift) if any(shift) else _BODIES[scene.body.kind](scene)
    grid.locate(particles.position, particles.cell)  # each in its cell: kernels do not look
    shape = scene.body.shape
    pieces = scene.regions()
    of = particles.segment
    held = np.array([piece.held for piece in pieces])[of]
    clamped_face = shape.clamp in {"base", "both"} and scene.effects.feed is None  # what is fed, its guide holds
    plane_strain = isinstance(shape, Strip) and shape.plane_strain
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
        shear=shear[of],
        bulk=(shear * ratio)[of],
        magnet=effects.marked(scene, particles, _remanence(scene, particles)),
        density=np.array([material.density or 0.0 for material in materials])[of],
        effects=effects.collect(scene),
        modes=volume_modes(particles, ratio[of]) if averaged else np.zeros((len(of), 0)),
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


def kernel_arguments(model: Model) -> tuple[Any, ...]:
    """What every particle loop takes after the layout and the splines, in the kernels' order."""
    return model.shear, model.bulk, model.modes, model.effects, model.magnet, model.density
