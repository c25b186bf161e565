"""Equilibria of one scene on several grids: each begins at a coarser one's, and what the next will take is foretold."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.effects import acting
from magmpm.errors import SolveError, TimeOver
from magmpm.model import knots_of
from magmpm.scene import Scene, memory
from magmpm.statics import axis
from magmpm.statics.approach import approached
from magmpm.statics.between_grids import carried
from magmpm.statics.energy import Energy
from magmpm.statics.equilibrium import Equilibrium, solve_from
from magmpm.statics.error_estimate import distance
from magmpm.statics.layout import StaticModel

STATIONS = 41  # along the body, where axes are compared
PER_SOLVE = 3.0  # factorizations of a solve from a coarser one's shape, with its stability
PER_PROOF = 1.3  # of a proof: one, and now and then a solve
PARTICLE = 2.0e4  # multiply-adds, at the pace of the factorization, that a particle costs in a Newton step: measured, docs/accuracy.md
BESIDE = 2.0  # passes over the particles that building a model costs, in units of a Newton step's

OnStep = Callable[[int, float], None]


@dataclass(frozen=True)
class Load:
    """A load under which a grid is judged: its model, and how its equilibrium is found where no coarser grid is known."""

    model: StaticModel
    first: Callable[[OnStep | None], Equilibrium]


Loads = Callable[[Scene], Sequence[Load]]


@dataclass
class Solved:
    """One grid's equilibria, one for each load that is judged. points: (k, 3) m of each, where errors are meant.

    exact: solved to the scene's tolerance, rather than just enough for a proof.
    """

    cells: int
    loads: Sequence[Load]
    grids: list[Array]
    points: list[Array]
    found: list[Equilibrium]
    exact: bool
    seconds: float
    steps: float


@dataclass
class Ladder:
    """Grids solved so far. loads: those of a scene on its grid that are judged."""

    asked: Scene
    loads: Loads
    on_step: OnStep | None = None
    solved: dict[int, Solved] = field(default_factory=dict)
    _scenes: dict[int, Scene] = field(default_factory=dict)

    def on(self, cells: int) -> Scene:
        """The scene with so many cells across."""
        if cells not in self._scenes:
            self._scenes[cells] = self.asked.with_cells(cells)
        return self._scenes[cells]

    def solve(self, cells: int) -> Solved:
        """The equilibria with so many cells across, to the scene's tolerance. Raises as solve_static does."""
        if cells in self.solved and self.solved[cells].exact:
            return self.solved[cells]
        begun = time.perf_counter()
        loads, coarse = self._loads(cells), self._nearest(cells)
        found = [self._solved_one(load, coarse, k) for k, load in enumerate(loads)]
        grids = [one.point.grid for one in found]
        points = [self.points(load.model, grid) for load, grid in zip(loads, grids, strict=True)]
        steps = sum(one.steps for one in found) / len(found)
        self.solved[cells] = Solved(cells, loads, grids, points, found, True, time.perf_counter() - begun, steps)
        return self.solved[cells]

    def prove(self, cells: int, against: int) -> Solved:
        """Equilibria near enough to the true ones on this grid to tell the error of the grid `against`: mostly one factorization."""
        if cells in self.solved:
            return self.solved[cells]
        begun = time.perf_counter()
        loads, coarse = self._loads(cells), self._nearest(cells)
        if coarse is None or acting.feels_itself(self.asked):
            return self.solve(cells)
        compared = self.solved[against].points
        grids, points, steps = [], [], 0.0
        for k, load in enumerate(loads):
            model, start = load.model, carried(coarse.loads[k].model, coarse.grids[k], load.model)
            near = self._approached(model, start, compared[k])
            if near is None:
                found = self._solved_one(load, coarse, k)
                grids.append(found.point.grid)
                steps += found.steps
            else:
                grids.append(near)
                steps += 1.0
            points.append(self.points(model, grids[-1]))
        self.solved[cells] = Solved(cells, loads, grids, points, [], False, time.perf_counter() - begun, steps / len(loads))
        return self.solved[cells]

    def points(self, model: StaticModel, grid: Array) -> Array:
        """Where errors are meant, (k, 3) m: along the centreline, or at the tip."""
        if self.asked.resolution.of == "tip":
            return axis.tip(model, grid)[None]
        s = np.linspace(0.0, model.grid.faces[-1], STATIONS)
        return axis.along_axis(model, grid, axis.section_weights(model), s)

    def apart(self, coarse: int, fine: int) -> float:
        """Largest difference (m) between two grids, over all loads."""
        return max(distance(a, b) for a, b in zip(self.solved[coarse].points, self.solved[fine].points, strict=True))

    def seconds_at(self, cells: int, factorizations: float) -> float:
        """What a grid will take, s: counted operations and particles, at the pace of the last grids solved."""
        paces = [self._pace(one) for one in list(self.solved.values())[-2:]]
        multiplied, points = self._counted(cells)
        count = len(next(iter(self.solved.values())).loads)
        return count * min(
            rate * (factorizations * (multiplied + weight * points) + BESIDE * weight * points) for rate, weight in paces
        )

    def _pace(self, one: Solved) -> tuple[float, float]:
        """Seconds per multiply-add of a solved grid, and what a particle weighs in multiply-adds."""
        multiplied, points = self._counted(one.cells)
        weight = PARTICLE
        counted = one.steps * (multiplied + weight * points) + BESIDE * weight * points
        return one.seconds / (counted * len(one.loads)), weight

    def _counted(self, cells: int) -> tuple[float, float]:
        return operations(self.on(cells))[0], particles(self.on(cells))

    def _loads(self, cells: int) -> Sequence[Load]:
        return self.solved[cells].loads if cells in self.solved else self.loads(self.on(cells))

    def _nearest(self, cells: int) -> Solved | None:
        """The finest grid that is not finer; a proof of the same grid begins where it ended."""
        known = [n for n in self.solved if n <= cells]
        return self.solved[max(known)] if known else None

    def _solved_one(self, load: Load, coarse: Solved | None, k: int) -> Equilibrium:
        if coarse is None or acting.feels_itself(self.asked):
            return load.first(self.on_step)
        same = coarse.loads[k].model is load.model
        start = coarse.grids[k] if same else carried(coarse.loads[k].model, coarse.grids[k], load.model)
        try:
            return solve_from(load.model, start, on_step=self.on_step)
        except TimeOver:
            raise
        except SolveError:
            return load.first(self.on_step)

    def _approached(self, model: StaticModel, start: Array, compared: Array) -> Array | None:
        return approached(
            Energy(model),
            start,
            lambda grid: self.points(model, grid),
            compared,
            self.asked.length / self.asked.thickness,
            self.on_step or (lambda step, number: None),
        )


def particles(scene: Scene) -> float:
    """Particles of the scene's grid, before anything is built."""
    return memory.fewest_particles(scene)


def step_work(scene: Scene) -> float:
    """Multiply-adds of a Newton step on the scene's grid, at the pace of its factorization."""
    return operations(scene)[0] + PARTICLE * particles(scene)


def operations(scene: Scene) -> tuple[float, float]:
    """Multiply-adds of a factorization on the scene's grid, and the bytes of its matrix, before anything is built."""
    grid = scene.body.shape.grid(scene.resolution.cells_across, knots_of(scene))
    along, *across = (float(nodes) for nodes in grid.nodes)
    along, m = along - 2, 3.0 * across[0] * across[1]
    if scene.body.shape.in_plane_strain:
        m /= across[0]
    return 19 / 3 * along * m**3, 8.0 * 3 * (along + 2) * m**2


