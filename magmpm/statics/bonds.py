"""Bonds: springs between coefficients of the grid, which do what a cut grid can't do by itself.

Outer nodes follow inner ones. Where a body's surface cuts the cells of its grid, some nodes see next to no material: a sliver of a cell.
The tangent is then as good as singular in their displacements, and rounding decides its sign. So each such node is bound to where the
nodes of the nearest well-filled cell of the same part would have it: the coefficients of a quadratic function are themselves quadratic in
the nodes' numbers, so that three nodes along each axis tell those beyond them. A body that moves, turns, is strained or bent evenly
stretches no bond, and bodies along the axes of the grid, whose cells are full, have none.
Sources: Hoellig, Reif, Wipper, SIAM J. Numer. Anal. 39 (2001) 442 (extended B-splines, where the outer nodes have no freedom of their own);
Burman, C. R. Acad. Sci. Paris 348 (2010) 1217 (ghost penalty); Badia, Neiva, Verdugo, CMAME 400 (2022) 115607 (both, by this form).

A part that is held by an oblique face is bound to it: points of the face to where they are. To fix all nodes that the held part touches
would hold up to a cell of the free one as well. Source: Babuska, Math. Comp. 27 (1973) 221 (the penalty method); what it gives way is of
the order of the stress over the bonds' stiffness, h/HELD of what the body is strained.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from magmpm.bodies.contact_surface import particle_of
from magmpm.bodies.grid import Grid
from magmpm.compiled.arrays import Array, Index, Mask
from magmpm.compiled.jit import compiled
from magmpm.model import Model

FILLED = 0.3  # of a cell's volume: a cell with more of the body holds its nodes by itself
FOLLOWS = 0.1  # of shear modulus times cell size: stiffness of an outer node's bond
# of shear modulus over cell size: stiffness of a held face's bonds, by its area; docs/design.md has
# others
HELD = 300.0
CORNERS = np.stack(np.meshgrid(*3 * (np.arange(3),), indexing="ij"), -1).reshape(27, 3)


@dataclass(frozen=True)
class Bonds:
    """Springs (k,) whose stretch is a sum of coefficients times shares.

    element (k, 28, 3): grid indices of the nodes, repeated where there are fewer; share (k, 28); size (k,) m: stiffness over the shear
    modulus, shear (k,) Pa, of the region (k,) that the bond is of.
    """

    element: Index
    share: Array
    size: Array
    shear: Array
    region: Index

    @property
    def stiffness(self) -> Array:
        """Stiffness (k,) N/m."""
        return self.size * self.shear


@compiled
def add_stiffness(stiffness, share, block, out):  # type: ignore[no-untyped-def]
    """Add the stiffness (k,) of bonds, between each two nodes of their shares (k, n), to blocks (k, n, n) of out (blocks,) N/m."""
    for k in range(len(stiffness)):
        for i in range(share.shape[1]):
            for j in range(share.shape[1]):
                if block[k, i, j] >= 0:
                    out[block[k, i, j]] += stiffness[k] * share[k, i] * share[k, j]


def held_by_faces(model: Model) -> bool:
    """True where parts are held by faces that do not lie along the grid, and do not move: these are held by bonds."""
    return model.line is None and bool(model.held.any()) and not model.planes and not model.driven


def bonds_of(model: Model) -> Bonds | None:
    """The bonds of a body of parts; None where it needs none."""
    found = [_outer_nodes(model)]
    if held_by_faces(model):
        found.append(_held_faces(model))
    known = [each for each in found if each is not None]
    if not known:
        return None
    return Bonds(
        *(
            np.concatenate([getattr(each, name) for each in known])
            for name in ("element", "share", "size", "shear", "region")
        )
    )


def _held_faces(model: Model) -> Bonds | None:
    """The bonds of faces on held parts."""
    shape = model.scene.body.shape
    points = shape.held_surface(model.grid)
    if not len(points.area):
        return None
    particle = particle_of(
        points, model.grid, model.particles, shape.part_of(model.particles), model.well_filled
    )
    cell = model.particles.cell[particle]
    first = model.first_in_motion(particle)
    weights = model.grid.splines(points.position, cell)[0]
    share = np.einsum("ka,kb,kc->kabc", weights[:, 0], weights[:, 1], weights[:, 2]).reshape(
        len(cell), 27
    )
    nodes = first[:, None] + CORNERS
    element = np.concatenate([nodes, nodes[:, :1]], axis=1)
    share = np.pad(share, ((0, 0), (0, 1)))
    size = HELD * points.area / _size(model.grid)
    return Bonds(
        element,
        share,
        size,
        model.shear[particle],
        model.particles.segment[particle].astype(np.int64),
    )


def _size(grid: Grid) -> float:
    return float(np.prod(grid.spacing)) ** (1 / 3)


def _outer_nodes(model: Model) -> Bonds | None:
    """The bonds of outer nodes."""
    grid = model.grid
    particles = model.particles
    moves = ~model.held
    own = particles.cell[moves]
    cell = model.first_in_motion(moves)  # of parts: the first node has the cell's number
    segment = particles.segment[moves]
    shear = model.shear[moves]
    nodes = model.nodes_in_motion
    number = np.ravel_multi_index(cell.T, nodes)
    filled = np.bincount(number, particles.volume[moves]) / float(np.prod(grid.spacing))
    full = filled[number] >= FILLED
    if full.all():
        return None
    inside = np.zeros(nodes, bool)
    touched = np.zeros(nodes, bool)
    part = np.full(
        nodes, -1
    )  # one that touches the node: the last of them, so that it is always the same
    for shift in CORNERS:
        at = tuple((cell + shift).T)
        touched[at] = True
        part[at] = np.maximum(part[at], segment)
        inside[tuple((cell[full] + shift).T)] = True
    outer = np.argwhere(touched & ~inside)
    inner = full.copy()
    for plane in model.planes:  # it changes the meaning of its nodes
        inner &= own[:, plane.axis] != plane.cell
    if not len(outer) or not inner.any():
        return None
    chosen = np.flatnonzero(inner)[
        _nearest(outer, part[tuple(outer.T)], cell[inner], segment[inner])
    ]
    base = cell[chosen]
    shares = [_extrapolated(outer[:, axis] - base[:, axis]) for axis in range(3)]
    share = np.einsum("ka,kb,kc->kabc", *shares).reshape(len(outer), 27)
    element = np.concatenate([outer[:, None], base[:, None] + CORNERS], axis=1)
    share = np.concatenate([np.ones((len(outer), 1)), -share], axis=1)
    size = np.full(len(outer), FOLLOWS * _size(grid))
    return Bonds(element, share, size, shear[chosen], segment[chosen].astype(np.int64))


def _extrapolated(place: Index) -> Array:
    """Shares (k, 3) of three coefficients in a row in the one at a place (k,), counted from the first of them."""
    t = place.astype(float)
    return np.stack([(t - 1) * (t - 2) / 2, -t * (t - 2), t * (t - 1) / 2], axis=1)


def _nearest(outer: Index, of: Index, cell: Index, segment: Index) -> Index:
    """The particle (k,) whose cell is the nearest to each outer node (k, 3), of the node's part (k,) if it has any."""
    from scipy.spatial import cKDTree  # 0.1 s to import, and straight bodies do not need it

    found = np.empty(len(outer), np.int64)
    for part in np.unique(of):
        mine = np.flatnonzero(segment == part)
        mine = mine if len(mine) else np.arange(len(segment))
        _, first = np.unique(cell[mine], axis=0, return_index=True)
        candidates = mine[first]
        # A node is centered on the cell before it.
        found[of == part] = candidates[cKDTree(cell[candidates]).query(outer[of == part] - 1)[1]]
    return found


class Springs:
    """The bonds of a layout: their energy and forces. All vectors are (planes, m)."""

    def __init__(self, bonds: Bonds, node: Index, count: int) -> None:
        """node (k, 28): each node's number among all `count` of the layout."""
        from scipy.sparse import csr_matrix

        rows = np.repeat(np.arange(len(node)), node.shape[1])
        self._stretch: Any = csr_matrix(
            (bonds.share.ravel(), (rows, node.ravel())), shape=(len(node), count)
        )
        self._bonds = bonds
        self.stiffness = bonds.stiffness

    def stretched(self, grid: Array) -> Array:
        """Stretch (k, 3) m of the springs for coefficients (planes, m) m."""
        return np.asarray(self._stretch @ grid.reshape(-1, 3))

    def energy(self, grid: Array) -> float:
        """Their energy, J."""
        return 0.5 * float(np.sum(self.stiffness[:, None] * self.stretched(grid) ** 2))

    def gradient(self, grid: Array) -> Array:
        """Gradient of the energy, (planes, m) N: linear in the coefficients, so it is also the tangent times a change of them."""
        return np.asarray(
            self._stretch.T @ (self.stiffness[:, None] * self.stretched(grid))
        ).reshape(grid.shape)

    def gradient_per_shear(self, grid: Array, regions: Mask) -> Array:
        """Change (planes, m) m^2 of the gradient with the shear modulus of these regions (regions,)."""
        size = np.where(regions[self._bonds.region], self._bonds.size, 0.0)
        return np.asarray(self._stretch.T @ (size[:, None] * self.stretched(grid))).reshape(
            grid.shape
        )
