"""The tangent of an equilibrium as a matrix: filled by a kernel, factored, and solved with.

Straight bodies have one of bands (statics.block_cholesky): their planes of nodes follow each other, and nothing has fewer operations.
Others have a sparse one (statics.sparse_cholesky), whose order of elimination follows arms, rings and whatever else they are made of.
Vectors are (planes, m) in both, as statics.layout numbers unknowns.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array, Index
from magmpm.compiled.kept_memory import empty
from magmpm.errors import SceneError
from magmpm.kernels.equilibrium import Blocks, Panels, StaticCells
from magmpm.scene import Scene, memory
from magmpm.statics import block_cholesky, sparse_cholesky
from magmpm.statics.elimination import Elimination
from magmpm.statics.layout import UnknownsLayout


class RoundedBands:
    """A matrix of bands in single precision, to be factored and solved with."""

    def __init__(self, panels: block_cholesky.Single, split: int) -> None:
        self._panels = panels
        self._split = split

    def factor(self) -> bool:
        """Factor in place. False if the matrix is not positive definite."""
        return block_cholesky.factor(self._panels, self._split) < 0

    def solve(self, right: Array) -> Array:
        """Solution (planes, m) for a right-hand side (planes, m), right to 1e-7 of the stiffest mode."""
        return block_cholesky.solve(self._panels, self._split, right)


class Bands:
    """A matrix of bands, in panels (planes + 2, m, 3 m) of statics.block_cholesky. What a sparse one shares is told here."""

    def __init__(self, layout: UnknownsLayout) -> None:
        self._layout = layout
        self.panels = block_cholesky.new_panels(layout.planes, layout.m)

    def clear(self) -> None:
        """Set all entries to zero."""
        block_cholesky.clear(self.panels)

    def target(self, cells: StaticCells) -> Panels:
        """Place where kernels add the matrices of cells."""
        return Panels(self.panels, self._layout.split)

    def finish(self) -> None:
        """Make fixed unknowns ones without a coupling, once all is added."""
        if self._layout.fixed.any():
            block_cholesky.fix(self.panels, self._layout.split, self._layout.fixed)

    def diagonal(self) -> Array:
        """The diagonal (planes, m), of what is not yet factored."""
        return np.einsum("jaa->ja", self.panels[: self._layout.planes, :, : self._layout.m])

    def add_diagonal(self, values: Array | float) -> None:
        """Add to the diagonal: values (planes, m), or one for all."""
        diagonal = self.diagonal()
        diagonal += values

    def factor(self) -> bool:
        """Factor in place. False if the matrix is not positive definite: it can then only be filled again."""
        return block_cholesky.factor(self.panels, self._layout.split) < 0

    def rounded(self) -> RoundedBands:
        """The same matrix in single precision, in the same memory: this one can then only be filled again."""
        return RoundedBands(block_cholesky.rounded(self.panels), self._layout.split)

    def solve(self, right: Array) -> Array:
        """Solution (planes, m) for a right-hand side (planes, m), from the factors."""
        return block_cholesky.solve(self.panels, self._layout.split, right)

    def solve_columns(self, right: Array) -> Array:
        """Solutions (planes, k, m) for right-hand sides (planes, k, m), from the factors."""
        return block_cholesky.solve_columns(self.panels, self._layout.split, right)


class Sparse:
    """A sparse matrix, in blocks (blocks, 3, 3) of the layout's elimination, and its factors, of blocks (size, size)."""

    size = 3

    def __init__(self, layout: UnknownsLayout) -> None:
        self._layout = layout
        self._coupled: Index = np.zeros((0, 0), np.int64)
        self._cell_blocks = layout.cell_blocks
        self._bond_stiffness = layout.bond_stiffness
        self._planned(layout.elimination)

    def _planned(self, order: Elimination) -> None:
        self._order = order
        self.blocks = np.zeros((int(order.fronts.block_first[-1]), 3, 3))
        self._values = empty((self.size**2 * order.values,))
        self._rooms = empty((2, self.size**2 * max(order.room, 1)))
        self._surface: tuple[StaticCells, Blocks] | None = None  # that touches, and its blocks

    def coupled(self, nodes: Index) -> NDArray[np.int32]:
        """Blocks (groups, k, k) that couple each two nodes of groups (groups, k), by their numbers among all, -1 for none.

        Where the pattern has no room for them it gets it, and is empty: it must be filled again.
        """
        places = np.where(nodes >= 0, self._layout.places_of(nodes), -1)
        if len(places) and not len(self._coupled):
            self._coupled = np.zeros((0, places.shape[1]), np.int64)
        both = self._coupled
        if len(places):
            both = np.unique(np.concatenate([both, places]), axis=0)
        if len(both) > len(self._coupled):
            self._coupled = both
            order = self._layout.eliminated([self._coupled])
            for name in ("_own", "_unknowns"):
                self.__dict__.pop(name, None)
            self._cell_blocks = self._layout.cell_blocks_in(order)
            self._bond_stiffness = self._layout.bond_stiffness_in(order)
            self._planned(order)
        return self._order.blocks_of(places)

    @cached_property
    def _own(self) -> Index:
        """The diagonal block of each node, in the order of elimination: the first of its row."""
        return self._order.fronts.block_first[:-1]

    @cached_property
    def _unknowns(self) -> Index:
        """Place (3 nodes,) of each unknown, in the order of elimination, among all (planes m)."""
        node = np.empty(len(self._order.number), np.int64)
        node[self._order.number] = self._layout.free_nodes
        return (3 * node[:, None] + np.arange(3)).ravel()

    def clear(self) -> None:
        self.blocks[:] = 0.0

    def target(self, cells: StaticCells) -> Blocks:
        if cells.plane is self._layout.cell_plane:
            return Blocks(self._cell_blocks, self.blocks)
        if self._surface is None or self._surface[0] is not cells:
            nodes = self._layout.nodes_of(cells.plane, cells.row)
            self._surface = cells, Blocks(self._order.blocks_of(nodes), self.blocks)
        return self._surface[1]

    def add_bonds(self, share: float = 1.0) -> None:
        """Add the bonds, or a share of their stiffness."""
        for axis in range(3):
            self.blocks[:, axis, axis] += share * self._bond_stiffness

    def finish(self) -> None:
        self.add_bonds()  # fixed unknowns have no number

    def diagonal(self) -> Array:
        largest = np.einsum("nii->ni", self.blocks[self._own])
        out = np.full(self._layout.planes * self._layout.m, largest.max(initial=0.0))
        out[self._unknowns] = largest.ravel()
        return out.reshape(self._layout.planes, self._layout.m)

    def add_diagonal(self, values: Array | float) -> None:
        each = (
            np.broadcast_to(values, (self._layout.planes, self._layout.m))
            .ravel()[self._unknowns]
            .reshape(-1, 3)
        )
        for axis in range(3):
            self.blocks[self._own, axis, axis] += each[:, axis]

    def factor(self) -> bool:
        return (
            sparse_cholesky.factor(self._order.fronts, self.blocks, self._values, self._rooms) < 0
        )

    def solve(self, right: Array) -> Array:
        return self.solve_columns(right[:, None])[:, 0]

    def solve_columns(self, right: Array) -> Array:
        planes, count, m = right.shape
        ordered = right.transpose(1, 0, 2).reshape(count, planes * m)[:, self._unknowns]
        out = np.zeros((count, planes * m))
        out[:, self._unknowns] = self._solved(ordered)
        return np.ascontiguousarray(out.reshape(count, planes, m).transpose(1, 0, 2))

    def _solved(self, ordered: Array) -> Array:
        """Solutions (k, unknowns) for right-hand sides (k, unknowns), both in the order of elimination."""
        return sparse_cholesky.solve_columns(self._order.fronts, self._values, ordered)


class SparseOfEachAxis(Sparse):
    """A sparse matrix that is the same for each axis and couples none of them: its factors are those of one."""

    size = 1

    def factor(self) -> bool:
        one = np.ascontiguousarray(self.blocks[:, :1, :1])
        return sparse_cholesky.factor(self._order.fronts, one, self._values, self._rooms) < 0

    def _solved(self, ordered: Array) -> Array:
        k = len(ordered)
        by_axis = ordered.reshape(k, -1, 3).transpose(0, 2, 1).reshape(3 * k, -1)
        found = super()._solved(by_axis)
        return found.reshape(k, 3, -1).transpose(0, 2, 1).reshape(k, -1)


def new_matrix(scene: Scene, layout: UnknownsLayout) -> Bands | Sparse:
    """A matrix of a layout's unknowns. Raises SceneError if it takes too much memory."""
    most_memory = 4e9  # bytes of the factored tangent
    needed = _bytes(scene, layout)
    if needed > most_memory:
        raise SceneError(
            "resolution",
            found=(
                f"statics of this body would take {needed / 1e9:.3g} GB for its tangent of"
                f" {3 * len(layout.free_nodes)} unknowns"
            ),
            rule=f"at most {most_memory / 1e9:g} GB are used",
            remedy=(
                "use larger cells, or let the body settle in a motion: `solver: {dynamic: "
                "{duration: 0.5 s}}` with damping"
            ),
        )
    with memory.for_matrix(scene, needed):
        return Bands(layout) if _has_bands(scene, layout) else Sparse(layout)


def _has_bands(scene: Scene, layout: UnknownsLayout) -> bool:
    """True if only planes that follow each other are coupled: a body that touches itself may couple any two."""
    return layout.straight and scene.effects.self_contact is None


def _bytes(scene: Scene, layout: UnknownsLayout) -> float:
    """Memory that the matrix of a layout takes, with its factors."""
    if _has_bands(scene, layout):
        return block_cholesky.panel_bytes(layout.planes, layout.m)
    order = layout.elimination
    return 72.0 * (order.values + 2 * order.room + int(order.fronts.block_first[-1]))
