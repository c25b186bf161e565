"""The unknowns of a static solve: which ones a model has, their numbers, and which ones each cell touches."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array, Index
from magmpm.model import Model
from magmpm.statics.block_cholesky import split_plane
from magmpm.statics.contact import RestingSurface, resting


@dataclass(frozen=True)
class Layout:
    """Which unknowns each cell touches.

    Unknowns are numbered plane by plane along x: `planes` planes of m = 3 nodes_per_plane, dof = 3 node + component. A cell touches
    planes cell_plane .. + 2, and in each, three rows of three neighboring nodes, the first of each in cell_row.
    A "cell" here is the part of a grid cell that belongs to one region: it has one material.
    """

    planes: int
    nodes_per_plane: int
    cell_first: Index  # (cells + 1,) first particle of each cell
    cell_plane: Index  # (cells,)
    cell_row: Index  # (cells, 3)
    slab_first: Index  # (slabs + 1,) first cell of each slab of two base planes
    node_yz: Index  # (nodes_per_plane, 2) grid index of each node of a plane
    fixed: NDArray[np.bool_]  # (planes, m) unknowns that are given: zero at nodes without material, at held parts, along y in plane strain

    @property
    def m(self) -> int:
        """Number of unknowns in a plane."""
        return 3 * self.nodes_per_plane

    @property
    def split(self) -> int:
        """Plane where the two halves of the factorization meet (statics.block_cholesky)."""
        return split_plane(self.planes)

    @property
    def most(self) -> int:
        """Largest number of particles in a cell."""
        return int(np.diff(self.cell_first).max())


@dataclass(frozen=True, kw_only=True)
class StaticModel(Model):
    """A model for the static solve, with the numbers of its unknowns and its splines. See ``static_model``."""

    layout: Layout
    weights: Array  # (n, 3, 3): axis, node
    slopes: Array  # (n, 3, 3) 1/m
    axes: Array  # (3, 3), or (n, 3, 3) of each particle: directions of the grid's axes, in columns. F, and remanence, are along them
    order: tuple[int, int, int] = (0, 1, 2)  # reference axis of each axis of the grid: see statics.axis_order
    touching: RestingSurface | None = None  # by which it touches obstacles; None without obstacles

    @property
    def dof(self) -> int:
        """Number of unknowns."""
        return self.layout.planes * self.layout.m - int(self.layout.fixed.sum())

    def plane_coordinates(self) -> Array:
        """x (planes,) m of the planes of unknowns, from the base of the body."""
        x = self.grid.node_coordinates(0)[int(self.clamped_face) :]
        return x - self.grid.origin[0]

    def displaced(self, **by: Array) -> Array:
        """Coefficients (planes, m) m of the nodes that follow what is moved by these displacements (3,) m; 0 for others."""
        out = np.zeros((self.layout.planes, self.layout.nodes_per_plane, 3))
        for name, nodes in self.driven:
            out[on_planes(self, nodes, self.layout.node_yz)] = by.get(name, np.zeros(3))
        return out.reshape(self.layout.planes, -1)

    def along_axes(self, vectors: Array) -> Array:
        """Components (n, 3) along the grid's axes of a vector (n, 3) at each particle."""
        return vectors @ self.axes if self.axes.ndim == 2 else np.einsum("ni,nij->nj", vectors, self.axes)


def static_model(model: Model) -> StaticModel:
    """The model with numbered unknowns, in its grid's axes.

    F = axes + sum of coefficients times slopes along the axes: it differs from that in x, y, z by a rotation of the undeformed body, which
    neither det F nor F^T F's invariants nor F Br feel.
    """
    weights, slopes = model.splines()
    axes = model.grid.axes_at(model.particles.position)
    layout, about = make_layout(model, weights), {name: vars(model)[name] for name in Model.__dataclass_fields__}
    touching = None if model.surface is None else resting(model.surface, layout.planes, layout.node_yz, model)
    made = StaticModel(**about, layout=layout, weights=weights, slopes=slopes, axes=axes, touching=touching)
    if axes.ndim == 2:
        return made
    magnet = np.column_stack([made.along_axes(model.remanence[:, :3]), model.remanence[:, 3:]])
    return replace(made, remanence=magnet)


def make_layout(model: Model, weights: Array) -> Layout:
    """The numbering of a model's unknowns; weights (n, 3, 3): values of its splines at its particles.

    Where the lower x face is clamped, node 0 along x is eliminated (bodies.grid.clamp_first_node) and has no unknowns.
    """
    cell_first, nodes_along = model.particles.cell_first, model.grid.nodes
    cell_x, iy, iz = model.particles.cell[cell_first[:-1]].T
    ix = model.grid.along.node[cell_x]

    # Each row of nodes is numbered without gaps, so the three nodes of a cell along z have consecutive numbers.
    _, rows, columns = nodes_along
    low, high = np.full(rows, columns), np.full(rows, -1)
    in_row = [1, 1, 1] if model.plane_strain else [0, 1, 2]  # in plane strain one row represents all three
    row = [(iy + shift) % rows for shift in in_row]  # around a tube the last row is before the first
    for each in row:
        np.minimum.at(low, each, iz)
        np.maximum.at(high, each, iz + 2)
    counts = np.maximum(high - low + 1, 0)
    start = np.concatenate([[0], np.cumsum(counts)])
    cell_row = np.stack([start[each] + iz - low[each] for each in row], axis=1)
    node_yz = np.array([(y, low[y] + k) for y in range(rows) for k in range(counts[y])])

    cell_plane = np.maximum(ix - 1, 0) if model.clamped_face else ix
    slab = cell_plane // 2
    slab_first = np.searchsorted(slab, np.arange(slab.max() + 2))
    planes, nodes = nodes_along[0] - int(model.clamped_face), int(start[-1])
    touched = _touched(cell_first, cell_plane, cell_row, weights, (planes, nodes))
    fixed = np.repeat(~touched, 3, axis=1)  # nodes without material have no equation
    if model.held.any():
        still = model.held[:, None, None] * weights
        fixed |= np.repeat(_touched(cell_first, cell_plane, cell_row, still, (planes, nodes)), 3, axis=1)
    for _, follows in model.driven:
        fixed |= np.repeat(on_planes(model, follows, node_yz), 3, axis=1)
    if model.plane_strain:
        fixed[:, 1::3] = True
    return Layout(
        planes=planes, nodes_per_plane=nodes, cell_first=cell_first, cell_plane=cell_plane.astype(np.int64),
        cell_row=cell_row.astype(np.int64), slab_first=slab_first.astype(np.int64), node_yz=node_yz.astype(np.int64), fixed=fixed,
    )  # fmt: skip


def on_planes(model: Model, nodes: NDArray[np.bool_], node_yz: Index) -> NDArray[np.bool_]:
    """Which of the unknowns' nodes (planes, nodes_per_plane) are among nodes of the grid."""
    return nodes[int(model.clamped_face) :, node_yz[:, 0], node_yz[:, 1]]


def _touched(cell_first: Index, cell_plane: Index, cell_row: Index, weights: Array, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Nodes that any particle touches, True or False (planes, nodes_per_plane)."""
    heaviest = np.maximum.reduceat(np.abs(weights), cell_first[:-1], axis=0) > 0.0
    touched = np.zeros(shape, bool)
    for a, b, c in np.ndindex(3, 3, 3):
        on = heaviest[:, 0, a] & heaviest[:, 1, b] & heaviest[:, 2, c]
        touched[cell_plane[on] + a, cell_row[on, b] + c] = True
    return touched
