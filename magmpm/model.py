"""A scene made ready to run, in equilibrium or in motion: particles, grid, materials, effects.

Where what holds the body is moved, the coefficient of nodes that follow it is its displacement: splines sum to one, so a face, or a held
part, whose nodes all have the same coefficient moves by it, exactly.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from magmpm.bodies.body_shape import BodyShape, Discretization, Line
from magmpm.bodies.contact_surface import (
    ContactSurface,
    SurfacePoints,
    layer_mass,
    particle_of,
    well_filled,
)
from magmpm.bodies.grid import (
    ClampPlane,
    Grid,
    clamp_first_node,
    clamp_last_node,
    clamp_low_node,
    each_node,
    spread,
)
from magmpm.bodies.polar_grid import PolarGrid
from magmpm.bodies.section_quadrature import Particles
from magmpm.bodies.wetted_surface import WettedSurface
from magmpm.compiled.arrays import Array, Index, Mask, NamedNumbers, Plain
from magmpm.effects import acting as effects
from magmpm.effects.contact_law import own_friction
from magmpm.effects.hooks import has_hook
from magmpm.effects.magnetization import rotating
from magmpm.errors import SceneError
from magmpm.scene import Scene
from magmpm.scene.coarsest import knots_of

Driven = tuple[
    tuple[str, Mask], ...
]  # by what moves them: which of the grid's nodes follow, in the grid's shape


def driven_nodes(
    shape: BodyShape, made: Discretization, moves: Collection[str]
) -> tuple[tuple[ClampPlane, ...], Driven]:
    """The planes on which a body is held, those that move marked, and the nodes that follow what is moved: base, tip or parts by name.

    Raises SceneError where parts that move apart hold at one face, or at the same nodes.
    """
    grid = made.grid
    cell = made.particles.cell
    on = {name: np.zeros(grid.nodes, bool) for name in moves}
    if shape.line is not None:
        ends = [(replace(plane, moved="tip" in on), "tip") for plane in made.planes]
        ends += [(ClampPlane(0, True, 0, moved=True), "base")] if "base" in on else []
        for plane, name in ends:
            if name in on:
                on[name][_layer(grid, plane)] = True
        return tuple(plane for plane, _ in ends), tuple(on.items())
    regions = shape.regions()
    names = np.array([region.name if region.held else "" for region in regions])[
        made.particles.segment
    ]
    planes = []
    for plane in made.planes:
        behind = cell[:, plane.axis] == plane.cell + (-1 if plane.lower else 1)
        holding = set(names[behind]) - {""}
        if holding & set(on):
            _one(holding)
            on[holding.pop()][_layer(grid, plane)] = True
            plane = replace(plane, moved=True)
        planes.append(plane)
    seen = (
        np.array([[1, 1, 1]]) if planes else np.array(list(np.ndindex(3, 3, 3)))
    )  # by a held particle: see Model.splines_at
    held = {name: np.zeros(grid.nodes, bool) for name in set(names) - {""}}
    for name, mask in held.items():
        for shift in seen:
            mask[tuple((cell[names == name] + shift).T)] = True
        if name in on:
            on[name] |= mask
    for name, mask in on.items():
        for other in held:
            if other != name and (mask & held[other]).any():
                _one({name, other})
    return tuple(planes), tuple(on.items())


def _layer(grid: Grid, plane: ClampPlane) -> tuple[slice | int, ...]:
    """Index of the nodes that have the displacement of a plane that moves."""
    first = int(grid.along.node[plane.cell]) if plane.axis == 0 else plane.cell
    return tuple(
        first + (0 if plane.lower else 2) if axis == plane.axis else slice(None)
        for axis in range(3)
    )


def _one(holding: set[str]) -> None:
    """Raise SceneError where not all that holds at one place is one."""
    if len(holding) > 1:
        raise SceneError(
            "move",
            found=(
                f"{' and '.join(sorted(holding))} hold the body at the same face or within a cell"
                " of each other"
            ),
            rule="a moved part must be the only one that holds its cells",
            remedy="give these parts one name, so that they move together, or use smaller cells",
        )


@dataclass(frozen=True)
class Wetted:
    """Pieces (n,) of a model that can move and that a fluid meets; first (n, 3): node indices, and values and slopes (n, 3, 3) of their
    splines, in motion; particle (n,): one in the cell of each."""

    surface: WettedSurface
    first: Index
    weights: Array
    slopes: Array
    particle: Index


OfAnyKind = TypeVar("OfAnyKind", bound="Model")


@dataclass(frozen=True)
class Model:
    """Model of a scene that both solvers use: its particles (n), their materials, and the effects. SI units."""

    scene: Scene
    grid: Grid
    particles: Particles
    shear: Array  # (n,) Pa
    bulk: Array  # (n,) Pa
    # (n, 3) T, in the undeformed body; a fourth column where an effect marks particles
    # (acting.marked)
    remanence: Array
    density: Array  # (n,) kg/m^3
    effects: tuple[NDArray[Any], ...]  # records and data of each effect, in turn
    # (n, 0) or (n, 4): what the volume part of the energy is projected on, see volume_modes
    modes: Array
    section: NamedNumbers  # relative errors of area and second moment
    held: Mask  # (n,) particles of parts that can't move
    # the grid's lower x face stays at rest: node 0 along x is eliminated
    # (bodies.grid.clamp_first_node)
    clamped_face: bool
    plane_strain: (
        bool  # one cell along y, whose middle node carries all: nothing varies along y, and u_y = 0
    )
    line: Line | None  # the undeformed axis of a straight body
    planes: tuple[
        ClampPlane, ...
    ]  # the grid's faces on which held parts, a far end's clamp, or one that moves, hold the rest
    driven: Driven  # nodes that follow what is moved
    time: float | None = None  # s, of the schedule of an equilibrium's field; None: its end

    @cached_property
    def tip_weights(self) -> Array | None:
        """Weights (n,) that give the position of a tip that a body of parts names from the particles'; None without one."""
        return self.scene.body.shape.tip_weights(self.grid, self.particles)

    @property
    def times(self) -> Array | None:
        """`time` as effects get it."""
        return None if self.time is None else np.array([self.time])

    @property
    def rotating(self) -> Mask:
        """Particles (n,) whose magnetization rotates and does not stretch."""
        return rotating(self.scene)[self.particles.segment]

    @property
    def free(self) -> bool:
        """True if nothing holds the body."""
        return not (self.clamped_face or self.held.any() or self.driven)

    def field_at(self, position: Array, time: float | None) -> Array:
        """The external field (3,) T at the center of particles at positions (n, 3) m, at a time (s; None: the end of the schedule)."""
        if not self.scene.effects.in_a_field:
            return np.zeros(3)
        center = self.particles.volume @ position / self.particles.volume.sum()
        return np.asarray(self.scene.external_field().at(center, time)[0])

    def splines(self) -> tuple[Array, Array]:
        """Values and slopes (1/m) of each particle's three splines along each axis, (n, 3, 3): axis, node. Not kept: solvers sort them."""
        return self.splines_at(self.particles.position, self.particles.cell, self.held)

    def splines_at(self, points: Array, cell: Index, held: Mask) -> tuple[Array, Array]:
        """The same for any points (n, 3) m in cells (n, 3), some held (n,). Clamps are built into them."""
        weights, slopes = self.grid.splines(points, cell)
        if self.clamped_face:
            first = cell[:, 0] == 0
            weights[first, 0], slopes[first, 0] = clamp_first_node(
                weights[first, 0], slopes[first, 0]
            )
        if (
            self.plane_strain
        ):  # the middle node of the one cell across stands for all: nothing varies along y
            weights[:, 1], slopes[:, 1] = np.array([0.0, 1.0, 0.0]), 0.0
        for plane in self.planes:
            row = (cell[:, plane.axis] == plane.cell) & ~held
            clamp = clamp_low_node if plane.lower else clamp_last_node
            own = weights[row, plane.axis], slopes[row, plane.axis]
            weights[row, plane.axis], slopes[row, plane.axis] = clamp(*own, moved=plane.moved)
        # held particles see no node: they stay where they are, and the nodes beyond the plane carry
        # nothing
        if self.planes:
            weights[held], slopes[held] = 0.0, 0.0
        if self.planes and self.driven:  # or one, which moves with them
            weights[held, :, 1] = 1.0
        return weights, slopes

    def first_nodes(self, cell: Index) -> Index:
        """Grid index (n, 3) of the first node that points in these cells (n, 3) touch, along x one more in clamped cells."""
        first = cell.astype(np.int64)
        first[:, 0] = self.grid.along.node[first[:, 0]]
        if self.clamped_face:
            first[:, 0] = np.maximum(first[:, 0], 1)
        return first

    @cached_property
    def component(self) -> Index:
        """Component of the body that each particle (n,) is in: in motion, and where the body touches itself, each has a grid of its own.
        Else at rest one grid has all: 0."""
        if self.scene.solver.dynamic is None and self.scene.effects.self_contact is None:
            return np.zeros(len(self.density), np.int64)
        return self.scene.body.shape.components(self.particles)

    @property
    def nodes_in_motion(self) -> tuple[int, int, int]:
        """Nodes along x, y, z where each component has a grid of its own: the grids follow each other along x."""
        nx, ny, nz = self.grid.nodes
        return (nx * (int(self.component.max()) + 1), ny, nz)

    def first_in_motion(self, particle: NDArray[np.integer | np.bool_] | slice) -> Index:
        """The same as first_nodes in motion, for cells of particles."""
        first = self.first_nodes(self.particles.cell[particle])
        first[:, 0] += self.grid.nodes[0] * self.component[particle]
        return first

    @property
    def driven_in_motion(self) -> Driven:
        """The nodes in motion (nodes,) that follow what is moved, by its name."""
        names = np.array([region.name if region.held else "" for region in self.scene.regions()])[
            self.particles.segment
        ]
        found = []
        for name, nodes in self.driven:
            on = np.isin(
                np.arange(int(self.component.max()) + 1), self.component[names == name]
            ) | (self.line is not None)
            found.append((name, (on[:, None, None, None] & nodes).ravel()))
        return tuple(found)

    @cached_property
    def well_filled(self) -> Mask:
        """Select the particles (n,) in cells whose splines may move points of the surface."""
        return well_filled(self.particles, self.scene.body.shape.part_of(self.particles))

    @property
    def _open_base(self) -> bool:
        """True if the base is part of the surface: nothing holds it."""
        return not self.clamped_face and "base" not in dict(self.driven)

    def _particle_of(self, points: SurfacePoints) -> Index:
        """The particle that moves as each point of the surface."""
        part = self.scene.body.shape.part_of(self.particles)
        return particle_of(points, self.grid, self.particles, part, self.well_filled)

    @cached_property
    def surface(self) -> ContactSurface | None:
        """Surface by which the body touches obstacles and itself; None where it can't."""
        touches = any(effect.PHASE == "contact" for effect in self.scene.effects.named().values())
        if not (touches or has_hook("contact", self.effects)):
            return None
        points = self.scene.body.shape.surface(self.grid, base=self._open_base)
        particle = self._particle_of(points)
        held = self.held[particle]
        place = points.position[~held]
        area = points.area[~held]
        on = particle[~held]
        (weights, _), first = (
            self.splines_at(place, self.particles.cell[on], np.zeros(len(on), bool)),
            self.first_in_motion(on),
        )
        mass = layer_mass(area, first, weights, self.mass_in_motion, self.nodes_in_motion)
        friction = own_friction(self.scene)[self.particles.segment[on]]
        return ContactSurface(
            place, first, weights, mass, on, (points.position[held], particle[held]), friction
        )

    @cached_property
    def wetted(self) -> Wetted:
        """Pieces of the body that a fluid around it meets."""
        found = self.scene.body.shape.wetted(self.grid, base=self._open_base)
        particle = self._particle_of(SurfacePoints(found.place, found.size, found.region))
        free = ~self.held[particle]
        surface = WettedSurface(**{name: values[free] for name, values in vars(found).items()})
        on = particle[free]
        weights, slopes = self.splines_at(
            surface.place, self.particles.cell[on], np.zeros(len(on), bool)
        )
        return Wetted(surface, self.first_in_motion(on), weights, slopes, on)

    @cached_property
    def mass_in_motion(self) -> Array:
        """Lumped mass (nodes,) kg of the nodes in motion."""
        own = self.density * self.particles.volume
        first = self.first_in_motion(slice(None))
        return spread(own, first, self.nodes_in_motion, self.splines()[0])

    def slowed(self, resistance: Array) -> float:
        """Bound (1/s) of the rate at which a resistance (n,) N s/m of wetted pieces slows nodes: the largest row sum of W M^-1 W' C."""
        at = self.wetted
        spreading = spread(resistance, at.first, self.nodes_in_motion, np.abs(at.weights))
        mass = self.mass_in_motion
        rate = np.divide(spreading, mass, out=np.zeros_like(mass), where=mass > 0)
        each = np.zeros(len(resistance))
        for node, share in each_node(at.first, self.nodes_in_motion, np.abs(at.weights)):
            each += share * rate[node]
        return float(each.max(initial=0.0))

    def steepness(self) -> Array:
        """Sums (n, 3) 1/m^2 of slope^2 / weight over the nodes that a particle sees along each axis: how fast it may be strained."""
        weights, slopes = self.splines()
        sums = (slopes**2 / np.where(weights > 0, weights, 1.0) * (weights > 0)).sum(axis=2)
        if self.plane_strain:
            sums[:, 1] = 0.0
        return np.asarray(sums)


def build(scene: Scene, made: Discretization | None = None, time: float | None = None) -> Model:
    """The model of a scene. Raises InputError through the scene's own checks; costs milliseconds.

    made: the body's grid and particles, if not those of the scene's resolution; time: s, of an equilibrium's field (None: at the end).
    """
    shape = scene.body.shape
    resolution = scene.resolution
    if resolution.requested:
        raise SceneError(
            f"resolution.{'error' if resolution.error is not None else 'seconds'}",
            rule=(
                "cells_across must be given here: only `magmpm run` and magmpm.run choose the "
                "cells for an error or a time"
            ),
            remedy="write, say, `resolution: {cells_across: 4}`",
        )
    if scene.effects.auto:
        raise SceneError(
            "effects",
            received="auto",
            rule=("effects must be named here: only `magmpm run` and magmpm.run choose them"),
            remedy="name those that `magmpm run` reports as chosen",
        )
    made = made or shape.discretize(
        resolution.cells_across, resolution.particles_per_cell, knots_of(scene)
    )
    made.grid.locate(
        made.particles.position, made.particles.cell
    )  # each in its cell: kernels do not look
    model = _filled(scene, shape, made, _acting(scene, made.particles, time), time)
    effects.check(model)
    return model


def reloaded(model: OfAnyKind, scene: Scene) -> OfAnyKind:
    """The model of a scene that differs from the model's in its loads alone: field, magnetization, remanence and density.

    Raises InputError through the scene's own checks.
    """
    loads = _loads(scene, scene.body.shape, model.particles)
    named = _acting(scene, model.particles, model.time)
    found = replace(model, scene=scene, effects=named, **loads)
    effects.check(found)
    return found


def _acting(scene: Scene, particles: Particles, time: float | None) -> tuple[NDArray[Any], ...]:
    """Records of the effects, at a time. Raises InputError where the field is not known at the particles."""
    if scene.effects.in_a_field:
        scene.external_field().check_at_rest(particles.position, moving=not scene.static, time=time)
    return effects.collect(scene, times=None if time is None else np.array([time]))


def _loads(scene: Scene, shape: BodyShape, particles: Particles) -> Plain:
    """Remanence and density of particles (n,), on which loads act, as a model has them."""
    materials = [scene.materials[region.material_name] for region in shape.regions()]
    of = particles.segment
    remanence = np.array([material.remanence for material in materials])[of, None]
    magnet = remanence * shape.magnetization(particles)
    density = np.array([material.density or 0.0 for material in materials])[of]
    return {"remanence": effects.marked(scene, particles, magnet), "density": density}


def reshaped(model: Model, shape: BodyShape, made: Discretization | None = None) -> Model:
    """The model with another body of the same kind; its scene, loads and field stay as they are.

    made: its grid and particles; unless given, on as many cells, for a body of nearly the same shape.
    """
    at = model.scene.resolution
    made = made or shape.discretize(
        at.cells_across, at.particles_per_cell, replace(knots_of(model.scene), like=model.grid)
    )
    return _filled(model.scene, shape, made, model.effects, model.time)


def _filled(
    scene: Scene,
    shape: BodyShape,
    made: Discretization,
    named: tuple[NDArray[Any], ...],
    time: float | None,
) -> Model:
    """The model of a scene's materials and these effects in the shape's grid and particles."""
    regions = shape.regions()
    held = np.array([region.held for region in regions])
    materials = [scene.materials[region.material_name] for region in regions]
    ratio = np.array([material.bulk_to_shear for material in materials])
    planes, driven = driven_nodes(shape, made, scene.move) if scene.move else (made.planes, ())
    particles = made.particles
    if shape.line is None:
        particles = _in_pieces(scene, shape, particles, held & (not driven))
    of = particles.segment
    averaged = scene.solver.anti_locking == "f-bar"
    shear = np.array([material.shear_modulus for material in materials])
    return Model(
        **_loads(scene, shape, particles),
        scene=scene,
        grid=made.grid,
        particles=particles,
        shear=shear[of],
        bulk=(shear * ratio)[of],
        effects=named,
        modes=volume_modes(made.grid, particles, ratio[of]) if averaged else np.zeros((len(of), 0)),
        section=made.errors,
        held=held[of],
        clamped_face=shape.clamp in {"base", "both"}
        and scene.effects.feed is None
        and "base" not in dict(driven),  # a guide holds: feed
        plane_strain=shape.in_plane_strain,
        line=shape.line,
        planes=planes,
        driven=driven,
        time=time,
    )


def _in_pieces(scene: Scene, shape: BodyShape, particles: Particles, still: Mask) -> Particles:
    """Particles of parts as the steps of statics take them: each component by itself, where each has a grid, and those at rest last.
    Motions have the same order, so that both can be compared particle by particle.

    still (parts,): parts at rest. Cells of the others are in the order of the planes that they touch, as threads share them."""
    alone = scene.effects.self_contact is not None
    component = shape.components(particles) if alone else np.zeros(len(particles.volume))
    of = np.lexsort((component, still[particles.segment]))
    return Particles(
        particles.position[of], particles.volume[of], particles.segment[of], particles.cell[of]
    )


LINEAR_STIFFNESS = (
    5.0  # of G: the most that the linear modes of the volume part carry, see volume_modes
)


def volume_modes(grid: Grid, particles: Particles, ratio: Array) -> Array:
    """Anti-locking (F-bar): functions on each cell's particles onto which det F is projected in the volume part of the energy.

    ratio (n,): K/G. Returns (n, 4) m^(-3/2): a constant and three linear modes, orthogonal under the particles' volumes. The volume
    energy of a cell is K/2 sum_k c_k^2 with c_k = sum V mode_k (J - 1). The linear modes carry at most LINEAR_STIFFNESS G in place
    of K: a cell's mean of J is held by K, its variation within the cell, which vanishes with the cell's size, more softly.
    Through a tube's wall it does not vanish, for one cell is all of the wall: there the linear mode has all of K.
    Source: F-bar, de Souza Neto et al., IJSS 33 (1996); as a projection for splines, Elguedj et al., CMAME 197 (2008).
    The measurements behind both choices are in docs/design.md.
    """
    modes = np.zeros((len(particles.volume), 4))
    cell_first = particles.cell_first
    cell = np.repeat(np.arange(len(cell_first) - 1), np.diff(cell_first))
    root = np.sqrt(particles.volume)
    for k, raw in enumerate([np.ones(len(cell)), *grid.own(particles.position, particles.cell).T]):
        mode = raw * root
        size = np.sqrt(np.bincount(cell, mode**2))
        for _ in range(2):  # twice: once leaves rounding of the size of the offset from the origin
            for j in range(k):
                mode = mode - modes[:, j] * np.bincount(cell, modes[:, j] * mode)[cell]
        left = np.sqrt(np.bincount(cell, mode**2))
        fine = left > 1e-9 * size  # particles in a line or a plane: the mode adds nothing
        modes[:, k] = np.where(fine[cell], mode / np.where(fine, left, 1.0)[cell], 0.0)
    soft = slice(1, 3 if isinstance(grid, PolarGrid) else 4)
    modes[:, soft] *= np.sqrt(np.minimum(1.0, LINEAR_STIFFNESS / ratio))[:, None]
    return modes / root[:, None]
