"""The grid chosen for an error or a time that a scene asks for: coarse equilibria first, then the cheapest grid that will do, proven.

The error of each grid is told from it and the coarser ones (statics.error_estimate), on the centreline or at the tip. What the next grid
costs is foretold from counted operations, calibrated by the grids that are already solved.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from magmpm.errors import SceneError
from magmpm.model import build
from magmpm.scene import Scene, memory
from magmpm.statics import axis
from magmpm.statics.equilibrium import Equilibrium, one_blas_thread, solve_static
from magmpm.statics.error_estimate import Rung, error_at, error_of_finest
from magmpm.statics.layout import StaticModel, static_model
from magmpm.statics.stability import stability

LADDER = (2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 16)  # cells across
STATIONS = 41  # along the body, where axes are compared
PATIENCE = 3600.0  # s: an error that would take longer can't be reached
FLOOR = 1e-6  # of the length: equilibria are known no better (docs/design.md, "End.")
SHARE = 0.5  # of the machine's memory that a grid may take


@dataclass
class Choice:
    """The chosen grid's solution. error: bound of its error, m; told: what results say of the choice (`resolution`)."""

    scene: Scene
    model: StaticModel
    found: Equilibrium
    error: float
    told: dict[str, Any]


@dataclass
class _Solved:
    scene: Scene
    model: StaticModel
    found: Equilibrium
    rung: Rung
    seconds: float
    operations: float


@dataclass
class _Ladder:
    asked: Scene
    on_step: Callable[[int, float], None] | None
    begun: float = field(default_factory=time.perf_counter)
    solved: list[_Solved] = field(default_factory=list)

    @property
    def rungs(self) -> list[Rung]:
        return [one.rung for one in self.solved]

    def solve(self, cells: int) -> None:
        """Add the equilibrium with so many cells across. Raises as solve_static does."""
        begun = time.perf_counter()
        scene = self.asked.with_cells(cells)
        with memory.within(scene):
            model = static_model(build(scene))
        found = solve_static(model, on_step=self.on_step, judged=False)
        rung = Rung(cells, model.grid.spacing[0], self._points(model, found))
        self.solved.append(_Solved(scene, model, found, rung, time.perf_counter() - begun, operations(scene)[0]))

    def _points(self, model: StaticModel, found: Equilibrium) -> np.ndarray:
        grid = found.point.grid
        if self.asked.resolution.of == "tip":
            return axis.tip(model, grid)[None]
        s = np.linspace(0.0, model.grid.spacing[0] * model.grid.cells[0], STATIONS)
        return axis.along_axis(model, grid, axis.section_weights(model), s)

    def seconds_at(self, cells: int) -> float:
        """What a grid will take, s, foretold from those solved."""
        last = self.solved[-1]
        return last.seconds * operations(self.asked.with_cells(cells))[0] / last.operations


def operations(scene: Scene) -> tuple[float, float]:
    """Multiply-adds of a factorization on the scene's grid, and the bytes of its matrix, before anything is built."""
    grid = scene.body.shape.grid(scene.resolution.cells_across)
    along, *across = grid.cells
    m = 3.0 * np.prod([n + 2.0 for n in across])
    return float(19 / 3 * along * m**3), float(8.0 * 3 * (along + 2) * m**2)


def choose(scene: Scene, on_step: Callable[[int, float], None] | None = None) -> Choice:
    """The cheapest grid that meets the error, or the best within the time, that a static scene asks for; solved, and its error proven.

    Raises SceneError where no grid can: with what it would take. Raises as solve_static does.
    """
    _possible(scene)
    ladder = _Ladder(scene, on_step)
    ladder.solve(LADDER[0])
    while (cells := _next(ladder)) is not None:
        ladder.solve(cells)
    return _chosen(ladder)


def _possible(scene: Scene) -> None:
    """Raises SceneError where the choice can't be made at all."""
    wanted = scene.resolution.allowed(scene.length)
    key = "resolution.error" if wanted is not None else "resolution.seconds"
    if scene.body.shape.line is None:
        raise SceneError(
            key, rule="errors are those of a centreline, and a body of STL parts has none", remedy="give `cells_across` instead, say 4"
        )
    if wanted is not None and wanted > 0.5 * scene.length:
        raise SceneError(key, received=f"{1e3 * wanted:g} mm", rule=f"must be at most half of the length, {500 * scene.length:g} mm",
                         remedy="check number and unit")  # fmt: skip
    if wanted is not None and wanted < FLOOR * scene.length:
        raise SceneError(
            key,
            received=f"{100 * wanted / scene.length:.2g} % of the length",
            rule=f"equilibria are known to {100 * FLOOR:g} % of the length at best: their solve ends there, whatever the grid",
            remedy=f"ask for {100 * FLOOR:g} % or more",
        )


def _next(ladder: _Ladder) -> int | None:
    """The cells to solve next; None where the last grid will do. Raises SceneError where none can."""
    scene, rungs = ladder.asked, ladder.rungs
    finer = [n for n in LADDER if n > rungs[-1].cells]
    if len(rungs) < 2:
        return finer[0]
    wanted = scene.resolution.allowed(scene.length)
    if wanted is None:
        left = (scene.resolution.seconds or 0.0) - (time.perf_counter() - ladder.begun)
        return max((n for n in finer if ladder.seconds_at(n) <= left), default=None)
    if error_of_finest(rungs) <= wanted:
        return None
    will_do = [n for n in finer if error_at(rungs, n) <= wanted]
    for cells in will_do[:1]:
        needed, seconds = operations(scene.with_cells(cells))[1], ladder.seconds_at(cells)
        if needed <= SHARE * memory.machine() and seconds <= PATIENCE:
            return cells
    raise _out_of_reach(ladder, wanted)


def _out_of_reach(ladder: _Ladder, wanted: float) -> SceneError:
    scene, rungs = ladder.asked, ladder.rungs
    length = scene.length
    cells = next((n for n in LADDER if n > rungs[-1].cells and error_at(rungs, n) <= wanted), LADDER[-1])
    least, bytes_needed, seconds = error_at(rungs, LADDER[-1]), operations(scene.with_cells(cells))[1], ladder.seconds_at(cells)
    if error_at(rungs, cells) > wanted:
        why = f"{LADDER[-1]} cells across, the most there are, are off by {100 * least / length:.2g} %, as {rungs[-1].cells} cells tell"
    else:
        why = f"it takes {cells} cells across, {bytes_needed / 1e9:.2g} GB and {seconds:.2g} s"
    return SceneError(
        "resolution.error",
        received=f"{100 * wanted / length:.3g} % of the length",
        rule=f"must be within reach of {SHARE * memory.machine() / 1e9:.3g} GB and {PATIENCE:g} s: {why}",
        remedy=f"ask for {100 * error_of_finest(rungs) / length:.2g} % or more, which {rungs[-1].cells} cells give",
    )


def _chosen(ladder: _Ladder) -> Choice:
    last, asked, length = ladder.solved[-1], ladder.asked.resolution, ladder.asked.length
    error = error_of_finest(ladder.rungs)
    told = {
        "cells_across": last.rung.cells,
        "particles_per_cell": asked.particles_per_cell,
        "asked": {key: value for key, value in asked.model_dump().items() if key in ("error", "of", "seconds")},
        "error_of_length": error / length,
        "tried": [{"cells_across": one.rung.cells, "dof": one.model.dof, "seconds": one.seconds} for one in ladder.solved],
    }
    assert last.found.energy is not None
    with one_blas_thread():
        found = replace(last.found, stability=stability(last.found.energy, last.found.point))
    return Choice(last.scene, last.model, found, error, told)
