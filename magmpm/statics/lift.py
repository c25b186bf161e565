"""Shape of the unloaded body whose held parts are moved, to first order: how a solve goes on as they move.

The unknowns that follow what is moved are given (layout.Layout.fixed), so Newton's steps leave them alone: what a solve begins from
decides where they are.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.effects import acting
from magmpm.statics.block_cholesky import factor, solve
from magmpm.statics.energy import Energy
from magmpm.statics.layout import StaticModel
from magmpm.statics.stability import NO_LOAD


class Lift:
    """Coefficients (planes, m) m by which what is moved moves all of an unloaded body; those of a body of which nothing is moved are 0."""

    def __init__(self, model: StaticModel) -> None:
        self._moves, self._whole = model.scene.move or {}, {}
        if not model.driven:
            return
        unloaded = Energy(replace(model, effects=acting.collect(model.scene, NO_LOAD, model.times)))
        at = unloaded.at(np.zeros(unloaded.shape))
        _, panels = unloaded.tangent(at)
        if factor(panels, model.layout.split) >= 0:
            raise ArithmeticError("the unloaded body's tangent has no Cholesky factors")
        for name, move in self._moves.items():
            given = model.displaced(**{name: move.whole})
            pulled = unloaded.products(at, given[:, None])[0][:, 0]
            self._whole[name] = given - solve(panels, model.layout.split, np.ascontiguousarray(pulled))

    def at(self, time: float | None) -> Array:
        """At a time, s; None: at the end of its schedules."""
        return np.asarray(sum(move.share(time)[0] * self._whole[name] for name, move in self._moves.items()))

    def on(self, grid: Array, before: float, after: float) -> Array:
        """Coefficients `grid` (planes, m) m of a time, s, as those of another one begin; the same array where nothing is moved."""
        return grid if not self._moves else grid + (self.at(after) - self.at(before))


class GrowingLoads:
    """The path on which all loads of a model, and the way of what is moved, grow from nothing, at 0, to all, at 1. statics.branch.Loads."""

    def __init__(self, model: StaticModel) -> None:
        self._model, self._way = model, Lift(model).at(model.time)

    def at(self, time: float) -> StaticModel:
        """The model under a share of its loads; at 0 under next to none, by the same kernels."""
        return replace(self._model, effects=acting.collect(self._model.scene, max(time, NO_LOAD), self._model.times))

    def carried(self, grid: Array, before: float, after: float) -> Array:
        """The same coefficients: the grid stays."""
        return grid

    def moved(self, grid: Array, before: float, after: float) -> Array:
        """The same, with what holds the body where it is at the later share."""
        return grid + (after - before) * self._way
