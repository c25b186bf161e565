"""An equilibrium and its neighbors: how its unknowns and its axis answer to a small change of what the scene says.

At equilibrium r(c, p) = 0, with r the gradient of the energy with respect to the grid's coefficients c, and p any number of the scene. So
dc/dp = -K^-1 dr/dp, with the tangent K = dr/dc. Source: implicit function theorem.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import SolveError
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.scene.variables import Variable
from magmpm.statics import axis
from magmpm.statics.axis_order import arranged
from magmpm.statics.block_cholesky import factor, solve
from magmpm.statics.energy import Energy
from magmpm.statics.equilibrium import Equilibrium
from magmpm.statics.interacting import InteractingEnergy
from magmpm.statics.layout import StaticModel, static_model

STEP = {"magnetization": 1e-4, "field": 1e-5, "length": 1e-3, "diameter": 1e-3}  # rad, T; of the size


class Linearized:
    """The neighborhood of an equilibrium, with the factors of its tangent."""

    def __init__(self, found: Equilibrium) -> None:
        assert found.energy is not None
        itself = isinstance(found.energy, InteractingEnergy)
        self.energy: Energy = found.energy.alone if isinstance(found.energy, InteractingEnergy) else found.energy
        if itself:
            raise NotImplementedError("sensitivities with magnetic_interaction")
        self.model, self.grid = self.energy.model, found.point.grid
        _, panels = self.energy.tangent(self.energy.at(self.grid))
        if factor(panels, self.model.layout.split) >= 0:
            raise SolveError("the equilibrium is not stable: its tangent has no Cholesky factors, so it has no sensitivities")

    def solve(self, right: Array) -> Array:
        """K^-1 times right-hand sides (k, planes, m)."""
        return np.stack([solve(self.energy.panels, self.model.layout.split, one) for one in right])

    def responses(self, variables: tuple[Variable, ...]) -> tuple[Array, Array, Array]:
        """Derivatives by each variable of the coefficients (planes, m, k), of the rows of the axis (rows, 3, k), of the tip (3, k)."""
        grids, rows, tips = [], [], []
        for variable in variables:
            h = self._step(variable)
            near = [self._near(variable.changed(self.model.scene, sign * h)) for sign in (1, -1)]
            slope = (near[0][0] - near[1][0]) / (2 * h)
            change = -self.solve(slope[None])[0]
            there = [self._shape(model, self.grid) for _, model in near]
            moved = [self._shape(self.model, self.grid + sign * change * 1e-3) for sign in (1, -1)]
            grids.append(change)
            rows.append((there[0][0] - there[1][0]) / (2 * h) + (moved[0][0] - moved[1][0]) / 2e-3)
            tips.append((there[0][1] - there[1][1]) / (2 * h) + (moved[0][1] - moved[1][1]) / 2e-3)
        return tuple(np.stack(one, axis=-1) for one in (grids, rows, tips))  # type: ignore[return-value]

    def _near(self, scene: Scene) -> tuple[Array, StaticModel]:
        model, _ = arranged(static_model(build(scene)))
        if (model.layout.planes, model.layout.m) != self.grid.shape:
            raise NotImplementedError("a change of the number of cells")
        energy = Energy(replace(model))
        return energy.residual(energy.at(self.grid)), model

    @staticmethod
    def _shape(model: StaticModel, grid: Array) -> tuple[Array, Array]:
        rows = axis.centreline(model, grid)[:, 1:]
        if model.line is not None:
            return rows, axis.tip(model, grid)
        point = Energy(model).at(grid)
        last = model.particles.segment == model.particles.segment.max()
        volume = model.particles.volume[last]
        return rows, volume @ point.position[last] / volume.sum()

    def _step(self, variable: Variable) -> float:
        scene = self.model.scene
        if variable.material is not None:
            return 1e-4 * max(float(getattr(scene.materials[variable.material], variable.kind)), 1e-3)
        if variable.kind == "diameter":
            return STEP["diameter"] * scene.thickness
        if variable.kind == "length":
            return 1e-4 * scene.length
        return STEP[variable.kind]
