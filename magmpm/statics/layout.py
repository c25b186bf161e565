"""The unknowns of a static solve: which ones a model has, their numbers, and which ones each cell touches.

Planes of unknowns lie across the longest side of the body: the first axis of its grid. The work of a factorization grows as the cube of the
unknowns in a plane. The columns of F and the reference remanence are along the grid's axes; positions stay in x, y, z. Energies depend on F
only through F^T F, det F and F Br, so they do not change.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array, Index, Mask, Plain
from magmpm.errors import SceneError, dotted, lengths
from magmpm.model import Driven, Model, build, reloaded
from magmpm.scene import Scene
from magmpm.scene.addresses import Place, put
from magmpm.statics.block_cholesky import split_plane
from magmpm.statics.bonds import Bonds, Springs, add_stiffness, bonds_of, held_by_faces
from magmpm.statics.contact import RestingSurface, resting
from magmpm.statics.elimination import Elimination, elimination
from magmpm.statics.own_contact import RestingPairs


@dataclass(frozen=True)
class UnknownsLayout:
    """Unknowns that each cell touches.

    Unknowns are numbered plane by plane along x: `planes` planes of m = 3 nodes_per_plane, dof = 3 node + component. A cell touches
    planes cell_plane .. + 2, and in each, three rows of three neighboring nodes, the first of each in cell_row.
    A "cell" here is the part of a grid cell that belongs to one region: it has one material.
    """

    planes: int
    nodes_per_plane: int
    cell_first: Index  # (cells + 1,) first particle of each cell
    cell_plane: Index  # (cells,)
    cell_row: Index  # (cells, 3)
    # (slabs + 1,) first cell of each slab of two base planes; after them come cells of parts at
    # rest, which add nothing
    slab_first: Index
    node_yz: Index  # (nodes_per_plane, 2) grid index of each node of a plane
    fixed: NDArray[
        np.bool_
    ]  # (planes, m) unknowns that are given: zero at nodes without material, at held parts, along y in plane strain
    straight: bool = True  # a body whose planes of nodes follow each other: its tangent has bands
    bonds: Bonds | None = None  # of a body of parts
    bonded: Index | None = (
        None  # (k, 28) number of the nodes of its bonds, among all (planes nodes_per_plane)
    )

    @property
    def m(self) -> int:
        """Number of unknowns in a plane."""
        return 3 * self.nodes_per_plane

    @property
    def split(self) -> int:
        """Plane where the two halves of the factorization meet (statics.block_cholesky)."""
        return split_plane(self.planes)

    @cached_property
    def free_nodes(self) -> Index:
        """Numbers (k,) of the nodes that have unknowns, among all (planes nodes_per_plane)."""
        return np.flatnonzero(~self.fixed.reshape(-1, 3).all(axis=1))

    @cached_property
    def elimination(self) -> Elimination:
        """Plan by which the sparse tangent is eliminated, by the numbers of `free_nodes`."""
        return self.eliminated([])

    def eliminated(self, more: Sequence[Index]) -> Elimination:
        """The same where more tables (elements, k) of places in `free_nodes` couple nodes."""
        elements = [self.nodes_of(self.cell_plane, self.cell_row), *more]
        if self.bonded is not None:
            elements.append(self.places_of(self.bonded))
        return elimination(elements, len(self.free_nodes))

    @cached_property
    def cell_blocks(self) -> NDArray[np.int32]:
        """Block (cells, 27, 27) of the sparse tangent that couples two nodes of a cell; -1 for none."""
        return self.cell_blocks_in(self.elimination)

    def cell_blocks_in(self, order: Elimination) -> NDArray[np.int32]:
        """The same of another plan."""
        return order.blocks_of(self.nodes_of(self.cell_plane, self.cell_row))

    @cached_property
    def bond_stiffness(self) -> Array:
        """Stiffness (blocks,) N/m that bonds add on each axis to the blocks of the sparse tangent."""
        return self.bond_stiffness_in(self.elimination)

    def bond_stiffness_in(self, order: Elimination) -> Array:
        """The same of another plan."""
        added = np.zeros(int(order.fronts.block_first[-1]))
        if self.bonds is not None and self.bonded is not None:
            block = order.blocks_of(self.places_of(self.bonded))
            add_stiffness(self.bonds.stiffness, self.bonds.share, block, added)
        return added

    @cached_property
    def springs(self) -> Springs | None:
        """The bonds as springs; None where there are none."""
        if self.bonds is None or self.bonded is None:
            return None
        return Springs(self.bonds, self.bonded, self.planes * self.nodes_per_plane)

    def nodes_of(self, plane: Index, row: Index) -> Index:
        """Places (cells, 27) in `free_nodes` of the nodes of cells, by their first planes (cells,) and rows (cells, 3); -1: not there."""
        across = np.arange(3)
        nodes = (
            (plane[:, None, None, None] + across[:, None, None]) * self.nodes_per_plane
            + row[:, None, :, None]
            + across
        )
        return self.places_of(nodes.reshape(len(plane), -1))

    def places_of(self, nodes: Index) -> Index:
        """Places in `free_nodes` of nodes by their numbers among all; -1: not there."""
        place = np.full(self.planes * self.nodes_per_plane, -1)
        place[self.free_nodes] = np.arange(len(self.free_nodes))
        return np.asarray(place[np.minimum(nodes, len(place) - 1)])

    @property
    def most(self) -> int:
        """Largest number of particles in a cell."""
        return int(np.diff(self.cell_first).max())


@dataclass(frozen=True, kw_only=True)
class StaticModel(Model):
    """A model for the static solve, with the numbers of its unknowns and its splines. See ``static_model``."""

    layout: UnknownsLayout
    weights: Array  # (n, 3, 3): axis, node
    slopes: Array  # (n, 3, 3) 1/m
    # (3, 3), or (n, 3, 3) of each particle: directions of the grid's axes, in columns. F, and
    # remanence, are along them
    axes: Array
    touching: RestingSurface | None = None  # by which it touches obstacles; None without obstacles
    pairs: RestingPairs | None = None  # by which it touches itself; None where it does not
    # of what is outside of a guide: the same part of another scene's body
    again: "Callable[[Scene], StaticModel] | None" = None

    @property
    def dof(self) -> int:
        """Number of unknowns."""
        return self.layout.planes * self.layout.m - int(self.layout.fixed.sum())

    def plane_coordinates(self) -> Array:
        """x (planes,) m of the planes of unknowns, from the base of the body."""
        x = self.grid.node_coordinates(0)
        return (
            np.tile(x, self.nodes_in_motion[0] // len(x))[int(self.clamped_face) :]
            - (self.grid.origin[0])
        )

    def displaced(self, **by: Array) -> Array:
        """Coefficients (planes, m) m of the nodes that follow what is moved by these displacements (3,) m; 0 for others."""
        out = np.zeros((self.layout.planes, self.layout.nodes_per_plane, 3))
        for name, nodes in driven_nodes(self):
            out[on_planes(self, nodes, self.layout.node_yz)] = by.get(name, np.zeros(3))
        return out.reshape(self.layout.planes, -1)

    @property
    def frame(self) -> Array:
        """Directions (3, 3), in columns, of the body's first, second and third axis: of a straight body x, y and z."""
        return np.eye(3) if self.line is not None else self.axes

    def along_axes(self, vectors: Array) -> Array:
        """Components (n, 3) along the grid's axes of a vector (n, 3) at each particle."""
        return (
            vectors @ self.axes
            if self.axes.ndim == 2
            else np.einsum("ni,nij->nj", vectors, self.axes)
        )


def static_model(model: Model) -> StaticModel:
    """The model with numbered unknowns, in its grid's axes.

    F = axes + sum of coefficients times slopes along the axes: it differs from that in x, y, z by a rotation of the undeformed body, which
    neither det F nor F^T F's invariants nor F Br feel.
    Raises SceneError where nothing holds the body, or a piece of a body of parts hangs on nothing that is held.
    """
    weights, slopes = model.splines()
    bonds = None
    across_gaps: tuple[Mask, ...] = ()
    if model.line is None:
        pieces = Pieces(model, weights)
        pieces.all_hang()
        bonds = bonds_of(model)
        if held_by_faces(model):  # by bonds: what is held sees no node, and stays where it is
            across_gaps = (pieces.held_across_gaps(bonds),)
            weights[model.held] = 0.0
            slopes[model.held] = 0.0
    elif model.free:
        raise SceneError(
            "body",
            found="no clamp holds it",
            rule="equilibrium needs a body that is held somewhere",
            remedy="clamp it, or simulate its motion: `solver: {dynamic: {duration: 0.5 s}}`",
        )
    axes = np.ascontiguousarray(model.grid.axes_at(model.particles.position))
    layout = make_layout(model, weights, bonds, across_gaps)
    about = {name: vars(model)[name] for name in Model.__dataclass_fields__}
    touching = (
        None
        if model.surface is None
        else resting(model.surface, layout.planes, layout.node_yz, model)
    )
    pairs = None
    if model.scene.effects.self_contact is not None:
        pairs = RestingPairs(model, held_by_faces(model)).numbered(layout, model.clamped_face)
    made = StaticModel(
        **about,
        layout=layout,
        weights=weights,
        slopes=slopes,
        axes=axes,
        touching=touching,
        pairs=pairs,
    )
    return _along_axes(made)


def _along_axes(model: StaticModel) -> StaticModel:
    """The model, whose remanence is along x, y, z, with that along its grid's axes."""
    given = model.remanence
    magnet = np.column_stack([model.along_axes(given[:, :3]), given[:, 3:]])
    return replace(model, remanence=magnet)


# The last scene, without what loads alone depend on, and its model
_last: tuple[Any, StaticModel] | None = None


def model_at_rest(scene: Scene) -> StaticModel:
    """The model of an equilibrium, which has what the last one has where only loads differ: the same to the last bit.

    What touches is made anew: it remembers what it found. Raises InputError as `build` and `static_model` do.
    """
    global _last
    form = _unloaded(scene)
    last = _last
    if last is not None and last[0] == form:
        return _along_axes(reloaded(last[1], scene))
    last = _last = None  # two models need not fit into the memory at once
    made = static_model(build(scene))
    _last = (form, made) if made.touching is None and made.pairs is None else None
    return made


def _unloaded(scene: Scene) -> Plain:
    """A scene's plain data without what loads alone depend on, each where it stands: a material may have any name."""
    data = scene.to_si()
    loads: list[Place] = [("name",), ("advice",), ("reference",), ("field",)]
    for name in scene.materials:
        loads += [("materials", name, "remanence"), ("materials", name, "density")]
    loads += [("body", *region.at, "magnetization") for region in scene.regions()]
    put(data, dict.fromkeys(loads), scene)
    return data


def make_layout(
    model: Model,
    weights: Array,
    bonds: Bonds | None = None,
    held_nodes: tuple[Mask, ...] = (),
) -> UnknownsLayout:
    """The numbering of a model's unknowns; weights (n, 3, 3): values of its splines at its particles.

    held_nodes: masks of nodes of the grid that are held, beside those of held particles.
    Where the lower x face is clamped, node 0 along x is eliminated (bodies.grid.clamp_first_node) and has no unknowns.
    """
    cell_first = model.particles.cell_first
    nodes_along = model.nodes_in_motion
    cell_x, iy, iz = model.particles.cell[cell_first[:-1]].T
    ix = model.grid.along.node[cell_x]
    ix = ix + model.grid.nodes[0] * model.component[cell_first[:-1]]

    # Each row of nodes is numbered without gaps, so the three nodes of a cell along z have consecutive numbers. Nodes of cells that can
    # move have numbers alone: a wide base does not widen the planes. Cells at rest beyond them share the first three nodes, at zero.
    _, rows, columns = nodes_along
    still = model.held[cell_first[:-1]] & (not model.driven)
    low = np.full(rows, columns)
    high = np.full(rows, -1)
    in_row = (
        [1, 1, 1] if model.plane_strain else [0, 1, 2]
    )  # in plane strain one row represents all three
    row = [
        (iy + shift) % rows for shift in in_row
    ]  # around a tube the last row is before the first
    for each in row:
        np.minimum.at(low, each[~still], iz[~still])
        np.maximum.at(high, each[~still], iz[~still] + 2)
    counts = np.maximum(high - low + 1, 0)
    numbered = np.all([(low[each] <= iz) & (iz + 2 <= high[each]) for each in row], axis=0)
    shared = [
        (row[0][cell], iz[cell] + k) for cell in np.flatnonzero(~numbered)[:1] for k in range(3)
    ]
    start = len(shared) + np.concatenate([[0], np.cumsum(counts)])
    cell_row = np.stack(
        [np.where(numbered, start[each] + iz - low[each], 0) for each in row], axis=1
    )
    node_yz = np.array(shared + [(y, low[y] + k) for y in range(rows) for k in range(counts[y])])

    cell_plane = np.maximum(ix - 1, 0) if model.clamped_face else ix
    slab = cell_plane // 2
    moving = int((~still).sum())
    slab_first = np.searchsorted(
        slab[:moving] if still[moving:].all() else slab, np.arange(slab.max() + 2)
    )  # see _renumbered
    planes = nodes_along[0] - int(model.clamped_face)
    nodes = int(start[-1])
    of_moving = np.repeat(~still, np.diff(cell_first))
    touched = _touched(
        cell_first, cell_plane, cell_row, of_moving[:, None, None] * weights, (planes, nodes)
    )
    fixed = np.repeat(~touched, 3, axis=1)  # nodes without material have no equation
    if model.held.any():
        held = model.held[:, None, None] * weights
        everywhere = np.stack([each * columns + iz for each in row], axis=1)
        on = _touched(cell_first, cell_plane, everywhere, held, (planes, rows * columns))
        fixed |= np.repeat(on[:, node_yz @ (columns, 1)], 3, axis=1)
    for mask in (*dict(driven_nodes(model)).values(), *held_nodes):
        fixed |= np.repeat(on_planes(model, mask, node_yz), 3, axis=1)
    if model.plane_strain:
        fixed[:, 1::3] = True
    number = None
    if bonds is not None:
        x, y, z = np.moveaxis(bonds.element, -1, 0)
        number = (x - int(model.clamped_face)) * nodes + start[y] + z - low[y]
    return UnknownsLayout(
        bonds=bonds,
        bonded=number,
        planes=planes,
        nodes_per_plane=nodes,
        cell_first=cell_first,
        cell_plane=cell_plane.astype(np.int64),
        cell_row=cell_row.astype(np.int64),
        slab_first=slab_first.astype(np.int64),
        node_yz=node_yz.astype(np.int64),
        fixed=fixed,
        straight=model.line is not None,
    )


def driven_nodes(model: Model) -> Driven:
    """The nodes that follow what is moved, by its name, in the shape of the grids of all components."""
    return tuple((name, on.reshape(model.nodes_in_motion)) for name, on in model.driven_in_motion)


def on_planes(model: Model, nodes: Mask, node_yz: Index) -> Mask:
    """True for the unknowns' nodes (planes, nodes_per_plane) that are among nodes of the grid."""
    return nodes[int(model.clamped_face) :, node_yz[:, 0], node_yz[:, 1]]


def _touched(
    cell_first: Index, cell_plane: Index, cell_row: Index, weights: Array, shape: tuple[int, int]
) -> Mask:
    """Nodes that any particle touches, True or False (planes, nodes_per_plane)."""
    heaviest = np.maximum.reduceat(np.abs(weights), cell_first[:-1], axis=0) > 0.0
    touched = np.zeros(shape, bool)
    for a, b, c in np.ndindex(3, 3, 3):
        on = heaviest[:, 0, a] & heaviest[:, 1, b] & heaviest[:, 2, c]
        touched[cell_plane[on] + a, cell_row[on, b] + c] = True
    return touched


class Pieces:
    """The pieces of a body of parts that can move: what is connected through grid nodes.

    What counts is each cell's material, not the parts: a mesh may have several solids.
    """

    def __init__(self, model: Model, weights: Array) -> None:
        """weights (n, 3, 3): values of the model's splines at its particles."""
        from scipy.sparse import coo_matrix  # 0.1 s to import, and straight bodies do not need it
        from scipy.sparse.csgraph import connected_components

        nodes = model.nodes_in_motion
        cell = model.first_in_motion(slice(None))
        number = np.ravel_multi_index(cell.T, nodes)
        _, first, of = np.unique(number, return_index=True, return_inverse=True)
        seen = np.zeros(
            (len(first), 3, 3), bool
        )  # nodes along each axis that the free particles of a cell see
        free = ~model.held
        np.logical_or.at(seen, of[free], weights[free] != 0.0)
        held_nodes = np.zeros(nodes, bool)
        for _, follows in driven_nodes(model):
            held_nodes |= follows
        seen_by = []
        at = []
        for a, b, c in np.ndindex(3, 3, 3):
            place = cell + np.array([a, b, c])
            by_held = (
                model.held
                & (weights[:, 0, a] != 0)
                & (weights[:, 1, b] != 0)
                & (weights[:, 2, c] != 0)
            )
            held_nodes[tuple(place[by_held].T)] = True
            on = np.flatnonzero(seen[:, 0, a] & seen[:, 1, b] & seen[:, 2, c])
            seen_by.append(on)
            at.append(np.ravel_multi_index(place[first[on]].T, nodes))
        seeing = np.concatenate(seen_by)
        named, index = np.unique(np.concatenate(at), return_inverse=True)
        count = len(first) + len(named)
        graph = coo_matrix(
            (np.ones(len(seeing)), (seeing, len(first) + index)), shape=(count, count)
        )
        _, group = connected_components(graph, directed=False)
        self._model = model
        self._of_particle = group[of]  # (n,)
        self._of_node = np.full(held_nodes.size, -1)
        self._of_node[named] = group[len(first) :]
        self._held_nodes = held_nodes
        # Where a clamp plane changed a cell's splines they no longer sum to one.
        self._clamped = free & np.any(np.abs(weights.sum(axis=2) - 1) > 1e-6, axis=1)

    def all_hang(self) -> None:
        """Raise SceneError unless each piece shares nodes with something that is held."""
        held = self._of_node[self._held_nodes.ravel()]
        anchored = np.union1d(self._of_particle[self._clamped], held)
        loose = ~self._model.held & ~np.isin(self._of_particle, anchored)
        if loose.any():
            one = self._of_particle[np.flatnonzero(loose)[0]]
            raise _loose(self._model, loose & (self._of_particle == one))

    def held_across_gaps(self, bonds: Bonds | None) -> Mask:
        """Nodes of the grid by which held parts hold pieces that touch none of their faces: parts less than two cells apart move as if
        joined."""
        by_faces: Index = np.zeros(0, np.int64)
        if bonds is not None:
            holds = np.abs(bonds.share.sum(axis=1)) > 0.5  # bonds of outer nodes sum to zero
            nodes = np.moveaxis(bonds.element[holds], -1, 0)
            by_faces = self._of_node[
                np.ravel_multi_index(tuple(nodes), self._model.nodes_in_motion)
            ]
        apart = ~np.isin(self._of_node, np.unique(by_faces)).reshape(self._held_nodes.shape)
        return self._held_nodes & apart


def _loose(model: Model, mine: Mask) -> SceneError:
    """The error about a piece of the body, its particles `mine` (n,), that nothing holds: its part, and where it is."""
    particles = model.particles
    size = np.bincount(particles.segment[mine], particles.volume[mine])
    k = int(np.argmax(size))
    region = model.scene.regions()[k]
    whole = float(particles.volume[particles.segment == k].sum())
    center = particles.volume[mine] @ particles.position[mine] / particles.volume[mine].sum()
    all_of_it = size[k] > (1 - 1e-9) * whole  # sums differ by rounding
    piece = (
        region.name
        if all_of_it
        else f"a piece of {region.name}, {1e9 * size[k]:.3g} of its {1e9 * whole:.3g} mm^3,"
    )
    return SceneError(
        dotted(("body", *region.at)),
        found=(
            f"{piece} touches no part that is held, nor one that hangs on such a part; its center"
            f" is {lengths(center)}"
        ),
        rule=(
            "equilibrium needs every part, and every separate solid of a part, to hang on "
            "something: contact and friction alone leave it free to move"
        ),
        remedy=(
            "move it until it touches the others, or clamp it in a mesh of its own, or simulate "
            "the motion, with `damping` to let it come to rest: `solver: {dynamic: {duration: "
            "0.5 s}}`"
        ),
    )
