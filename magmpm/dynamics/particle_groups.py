"""Particles of a model in groups of eight lanes, for the kernel of a motion."""

from dataclasses import dataclass

import numpy as np

from magmpm.bodies.contact_surface import ContactSurface
from magmpm.bodies.grid import spread
from magmpm.compiled.arrays import Array, Index, Mask
from magmpm.compiled.simd import WIDTH
from magmpm.dynamics.nodal_mass import NodalMass, nodal_mass
from magmpm.dynamics.wetted_pieces import wetted_pieces
from magmpm.kernels.fluid_drag import WettedPieces
from magmpm.kernels.impulses import SPLINES
from magmpm.kernels.surface_contact import SortedSurfacePoints
from magmpm.kernels.total_lagrangian_step import CellSlabs, Nodes, ParticleGroups
from magmpm.model import Model

NONE = np.zeros(0, np.int64)
NOTHING = np.zeros(0)
NO_SURFACE = ContactSurface(
    NOTHING.reshape(0, 3),
    NONE.reshape(0, 3),
    NOTHING.reshape(0, 3, 3),
    NOTHING,
    NONE,
    (NOTHING.reshape(0, 3), NONE),
    NOTHING,
)


@dataclass(frozen=True)
class Packed:
    """Groups of eight particles of one cell and one material, with cells sorted by slab; nodes of the whole grid, x slowest; the surface.

    If the last group of a cell is not full, its other lanes repeat its first particle with volume 0. particle (groups, 8): the model's
    particle in each lane, -1 for a repetition; mass: of the nodes.
    """

    cells: CellSlabs
    particles: ParticleGroups
    nodes: Nodes
    particle: Index
    mass: NodalMass
    surface: SortedSurfacePoints
    point: Index

    @property
    def node_place(self) -> Array:
        """Positions of the nodes in the undeformed body, (nodes, 3) m."""
        return self.nodes.place.reshape(-1, 3)


def slab_edges(cells: int, least: int) -> Index:
    """First cell of each slab, and the end. Slabs have at least `least` cells, and their number is a multiple of four if possible.

    Then both colors give two threads the same number of slabs: with 41 slabs, one thread would wait a twentieth of the time.
    """
    count = max(1, cells // least)
    count -= count % 4 if count > 4 else 0
    return np.linspace(0, cells, count + 1).astype(np.int64)


def pack(model: Model) -> Packed:
    """The particles and nodes of a model, packed in groups of eight."""
    shape = np.array(model.nodes_in_motion)
    first = model.first_in_motion(slice(None))
    axis = int(np.argmax(shape))  # slabs across the longest side, to get as many as possible
    along = first[:, axis] - first[:, axis].min()
    slabs = slab_edges(int(along.max()) + 1, 2)
    slab = np.searchsorted(slabs, along, side="right") - 1
    order = np.lexsort(
        (np.arange(len(slab)), model.particles.segment, first[:, 2], first[:, 1], first[:, 0], slab)
    )
    cell_key = np.column_stack([first, model.particles.segment, model.particles.cell[:, 0]])[order]
    starts = np.flatnonzero(np.any(np.diff(cell_key, axis=0, prepend=-1) != 0, axis=1))
    cell_group, particle, real = _groups(order, starts)

    weights, slopes = model.splines()
    slopes *= np.array(model.grid.spacing)[:, None]
    pattern, kinds = _alike(
        _lanes(np.concatenate([weights.reshape(-1, 9), slopes.reshape(-1, 9)], axis=1), particle)
    )
    kinds[:, 9:] /= np.repeat(np.array(model.grid.spacing), 3)[:, None]
    volume = np.where(real, model.particles.volume[particle], 0.0)
    count = model.modes.shape[1]
    moments, modes = (
        _alike(_lanes(model.modes, particle))
        if count
        else (np.zeros(len(particle), dtype=np.int64), np.zeros(WIDTH))
    )
    strides = (int(shape[1] * shape[2]), int(shape[2]))
    base = first @ np.array([*strides, 1])
    lumped, inverse, place = _nodes(model, weights, first)
    active = np.flatnonzero(lumped > 0)
    mass = nodal_mass(model, weights, base, strides, (lumped, inverse, place), active)
    slab_of_cell = slab[order[starts]]
    cells = CellSlabs(
        slab_first=np.searchsorted(slab_of_cell, np.arange(len(slabs))),
        first_group=cell_group,
        first_node=base[order[starts]],
        shear=model.shear[order[starts]],
        bulk=model.bulk[order[starts]],
        along_x=strides[0],
        along_y=strides[1],
    )
    particles = ParticleGroups(
        pattern=pattern,
        splines=kinds.ravel(),
        moments=moments,
        modes=modes.ravel(),
        mode_count=count,
        volume=volume.ravel(),
        density=model.density[particle].ravel(),
        remanence=_lanes(model.remanence, particle).ravel(),
        reference=_lanes(model.particles.position, particle).ravel(),
    )
    nodes = Nodes(active=active, inverse_mass=inverse, place=place.ravel())
    least = int(first[:, axis].min())
    wetted = wetted_pieces(model, axis, least, slabs, strides, nodes)
    surface, point = _surface(model, axis, least, slabs, strides, wetted)
    return Packed(cells, particles, nodes, np.where(real, particle, -1), mass, surface, point)


def _surface(
    model: Model,
    axis: int,
    least: int,
    slabs: Index,
    strides: tuple[int, int],
    wetted: WettedPieces,
) -> tuple[SortedSurfacePoints, Index]:
    """The contact surface of a model, empty where it has none, with its patches in slabs across an axis, and which of the model's points
    each of its points is; least: first node there; slabs: first cell of each."""
    found = model.surface or NO_SURFACE
    slab = np.searchsorted(slabs, found.first[:, axis] - least, side="right") - 1
    order = np.lexsort((*found.first.T[::-1], slab))
    starts = np.flatnonzero(np.any(np.diff(found.first[order], axis=0, prepend=-1) != 0, axis=1))
    first_group, point, real = _groups(order, starts)
    pattern, kinds = _alike(_lanes(found.weights.reshape(-1, 9), point))
    packed = SortedSurfacePoints(
        first_patch=np.searchsorted(slab[order][starts], np.arange(len(slabs))),
        first_point=np.append(starts, len(order)),
        first_node=(found.first[order][starts] @ np.array([*strides, 1])).astype(np.int64),
        weights=found.weights[order].ravel(),
        place=found.place[order].ravel(),
        mass=found.mass[order],
        friction=found.friction[order],
        first_group=first_group,
        pattern=pattern,
        lanes=kinds.ravel(),
        rest=_lanes(found.place, point).ravel(),
        layer=np.where(real, found.mass[point], 0.0).ravel(),
        grip=found.friction[point].ravel(),
        splines=np.zeros(SPLINES * len(starts)),
        wetted=wetted,
    )
    return packed, order


def _groups(order: Index, starts: Index) -> tuple[Index, Index, Mask]:
    """The first group of each cell, and after the last; what is in the lanes (groups, 8), in this order by cells that begin at `starts`;
    and whether it is there the first time: what a last group lacks are repetitions of its cell's first."""
    ends = np.append(starts[1:], len(order))
    groups = -(-(ends - starts) // WIDTH)
    first = np.append(0, np.cumsum(groups))
    cell = np.repeat(np.arange(len(starts)), groups)
    within = np.arange(first[-1] * WIDTH).reshape(-1, WIDTH) - (first[cell] * WIDTH)[:, None]
    real = within < (ends - starts)[cell][:, None]
    return first, order[starts[cell][:, None] + np.where(real, within, 0)], real


def _lanes(values: Array, particle: Index) -> Array:
    """Values (n, k) of particles as (groups, k, 8), contiguous."""
    return np.ascontiguousarray(values[particle].transpose(0, 2, 1))


def _alike(groups: Array) -> tuple[Index, Array]:
    """The different groups (kinds, k, 8) among groups (groups, k, 8), and where in their flat array each group begins.

    The numbers are of order one, and groups are the same if they agree to rounding. Cells differ only in position, so there are few kinds.
    They stay in the cache, where all groups would have to be read in every step.
    """
    rounded = np.round(groups, 12) + 0.0  # to 12 decimals; + 0.0 turns -0.0 into 0.0
    seen: dict[bytes, int] = {}
    first: list[int] = []
    kind = np.empty(len(groups), dtype=np.int64)
    for g in range(len(groups)):
        kind[g] = seen.setdefault(rounded[g].tobytes(), len(first))
        if kind[g] == len(first):
            first.append(g)
    return kind * groups[:1].size, groups[first]


def _nodes(model: Model, w: Array, first: Index) -> tuple[Array, Array, Array]:
    """Lumped mass (nodes,) kg, its inverse by component (3 nodes,) 1/kg, and place (nodes, 3) m of the grid's nodes.

    w (n, 3, 3): values of the particles' splines; first (n, 3): their first nodes.
    """
    own = model.density * model.particles.volume, model.held.astype(float)
    mass, held = (spread(of, first, model.nodes_in_motion, w) for of in own)
    inverse = np.zeros((len(mass), 3))
    free = (mass > 0) & (held == 0)
    for _, follows in model.driven_in_motion:
        free &= ~follows
    inverse[free] = 1.0 / mass[free, None]
    if model.plane_strain:
        inverse[:, 1] = 0.0
    axes = [model.grid.node_coordinates(axis) for axis in range(3)]
    axes[0] = np.tile(axes[0], model.nodes_in_motion[0] // len(axes[0]))
    place = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return mass, inverse.ravel(), place
