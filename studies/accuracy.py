"""The cost of accuracy: one scene solved at several cell sizes, each with its error and its time."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import InputError, SolveError
from magmpm.results import measures
from magmpm.results.result import Result
from magmpm.rod.cosserat import solve_rod
from magmpm.scene import Scene
from magmpm.statics.error_estimate import ALGEBRAIC, ORDER, factor
from magmpm.statics.ladder import operations

LADDER = (2, 3, 4, 5, 6, 8)
USUAL_CELLS, MORE_PARTICLES = 4, 3
ASKED = (1e-2, 1e-3)  # of the length: what the conclusions name the cost of
CLOSEST = 1.3  # ratio of two cell sizes whose difference tells the coarser one's error (statics.error_estimate)
REPEATS = 3  # runs of a cell size, of which the median counts, while a run takes less than a second

Solve = Callable[[Scene], Result]
Progress = Callable[[int, int, str], None]


@dataclass(frozen=True)
class Rung:
    """One cell size. Errors are the largest distances of the axis over the length; None if there is no reference."""

    cells_across: int
    cell_size: float  # m
    particles: int
    dof: int
    iterations: int
    seconds: float  # median, kernels compiled
    error_finest: float | None
    error_reference: float | None
    split: dict[str, float]  # s: setup, compile, solve, of the last run
    matrix_bytes: float  # of the factorized matrix, the largest part of the memory
    bar: float | None  # bound of the discretization error over the length, told by a finer rung, or of the finest by a coarser one
    pareto: bool  # no other setting is both quicker and more accurate


@dataclass(frozen=True)
class Model:
    """A model that stands beside the ladder: the rod, or the finest rung but one with more particles. Errors over the length."""

    name: str
    seconds: float
    error_finest: float
    error_reference: float | None


@dataclass(frozen=True)
class Ladder:
    """rungs, coarse to fine; order: fitted order of convergence toward the reference, or if there is none toward the finest.

    beside: other models; algebraic_error: what the solve's tolerance leaves, over the length; asymptotic: whether errors fall as they must
    for an order to mean anything; conclusions: what it all says, in words.
    """

    scene: str
    length: float  # m
    rungs: list[Rung]
    order_finest: float | None
    order_reference: float | None
    beside: list[Model]
    algebraic_error: float | None
    asymptotic: bool | None
    conclusions: list[str]

    def summary(self) -> dict[str, Any]:
        """Plain data, SI."""
        return asdict(self)

    def table(self) -> str:
        """The ladder as text."""
        lines = [
            "cells  cell mm  particles     dof  steps  seconds  set-up  solve  matrix MB  error to finest  error to reference      at most"
        ]
        for rung in self.rungs:
            lines.append(
                f"{rung.cells_across:5d}  {1e3 * rung.cell_size:7.3f}  {rung.particles:9d}  {rung.dof:6d}  {rung.iterations:5d}  "
                f"{rung.seconds:7.3f}  {rung.split['setup']:6.3f} {rung.split['solve']:6.3f}  {rung.matrix_bytes / 1e6:9.1f}  "
                f"{_percent(rung.error_finest):>15}  {_percent(rung.error_reference):>18}  {_percent(rung.bar):>11}"
                f"{'' if rung.pareto else '  *'}"
            )
        if not all(rung.pareto for rung in self.rungs):
            lines.append("* another setting is both quicker and more accurate")
        for model in self.beside:
            lines.append(
                f"{model.name}: {model.seconds:.3f} s, {_percent(model.error_finest)} from the finest, "
                f"{_percent(model.error_reference)} from the reference"
            )
        if self.algebraic_error is not None:
            lines.append(f"the solve's tolerance leaves {100 * self.algebraic_error:.1e} % of L")
        for name, order in (("finest", self.order_finest), ("reference", self.order_reference)):
            if order is not None:
                lines.append(f"order of convergence to the {name}: {order:.1f}")
        if self.asymptotic is False:
            lines.append("not in the asymptotic range: errors do not fall steadily with the cells, so the order means little here")
        return "\n".join([*lines, *self.conclusions])


def _percent(error: float | None) -> str:
    return "-" if error is None else f"{100 * error:.4f} % of L"


def climb(
    scene: Scene, solve: Solve, cells: Sequence[int] = LADDER, on_progress: Progress | None = None
) -> Ladder:
    """Solve the scene at each number of cells across.

    Raises InputError for fewer than two different cell sizes, or sizes that the scene refuses, and SolveError if a solve fails.
    """
    cells = sorted(set(cells))
    if scene.body.shape.line is None:
        raise InputError("accuracy compares centrelines, and a body of STL parts has none; give a scene of a catheter or a strip")
    if len(cells) < 2:
        raise InputError(
            f"--cells: got {cells}; a ladder needs at least two different cell sizes, such as 2,3,4,6"
        )
    scenes = [scene.with_cells(n) for n in cells]
    runs = []
    for k, rung in enumerate(scenes):
        if on_progress is not None:
            on_progress(k, len(scenes), f"{cells[k]} cells across")
        runs.append(_timed(rung, solve))
    finest, length = runs[-1][0].centreline, scene.length
    rungs, beside = _rungs(scene, cells, runs), _beside(scene, solve, finest)
    falling = [rung.error_finest for rung in rungs[:-1] if rung.error_finest]
    moved = float(np.abs(finest[:, 1:] - np.array([1.0, 0.0, 0.0]) * finest[:, :1] - finest[0, 1:]).max())
    return Ladder(
        scene=scene.name,
        length=length,
        rungs=rungs,
        order_finest=_order(rungs[:-1], "error_finest"),
        order_reference=_order(rungs, "error_reference"),
        beside=beside,
        algebraic_error=ALGEBRAIC * scene.solver.static.tolerance**0.5 * moved / length if scene.static else None,
        asymptotic=None if len(falling) < 2 else falling == sorted(falling, reverse=True),
        conclusions=_conclusions(rungs, beside),
    )


def _rungs(scene: Scene, cells: Sequence[int], runs: Sequence[tuple[Result, float]]) -> list[Rung]:
    finest, reference, length = runs[-1][0].centreline, scene.reference_centreline(), scene.length
    bars = _bars([result for result, _ in runs], cells)
    errors = [measures.largest_distance(result, finest if reference is None else reference) for result, _ in runs]
    rungs = []
    for k, (n, (result, seconds)) in enumerate(zip(cells, runs, strict=True)):
        bar = bars[k]
        better = [j for j, (_, other) in enumerate(runs) if j != k and other <= seconds and errors[j] <= errors[k]]
        rungs.append(
            Rung(
                cells_across=n,
                cell_size=scene.thickness / n,
                particles=result.particles,
                dof=result.dof,
                iterations=result.iterations,
                seconds=seconds,
                error_finest=None if n == cells[-1] else measures.largest_distance(result, finest) / length,
                error_reference=None if reference is None else errors[k] / length,
                split={key: float(result.seconds.get(key, 0.0)) for key in ("setup", "compile", "solve")},
                matrix_bytes=operations(scene.with_cells(n))[1] if scene.static else 0.0,
                bar=None if bar is None else bar / length,
                pareto=not better,
            )
        )
    return rungs


def _bars(results: Sequence[Result], cells: Sequence[int]) -> list[float | None]:
    """Bounds (m) of the discretization errors: of each grid by the finest one, of the finest by the coarsest that is fine enough for it."""
    bars: list[float | None] = []
    for k, n in enumerate(cells):
        other = len(cells) - 1 if k < len(cells) - 1 else next((j for j in range(k, -1, -1) if cells[j] <= n / CLOSEST), None)
        if other is None or max(n, cells[other]) < CLOSEST * min(n, cells[other]):
            bars.append(None)
            continue
        coarse, fine = min(n, cells[other]), max(n, cells[other])
        bound = factor(coarse, fine) * measures.largest_distance(results[k], results[other].centreline)
        bars.append(bound if n == coarse else bound * (coarse / fine) ** ORDER)
    return bars


def _beside(scene: Scene, solve: Solve, finest: Array) -> list[Model]:
    """The rod, and what more particles change at the usual grid, where these are to be had."""
    reference, length, found = scene.reference_centreline(), scene.length, []
    if not scene.static or scene.in_time:
        return []
    begun = perf_counter()
    try:
        rod = solve_rod(scene)
    except SolveError:
        rod = None
    if rod is not None:
        seconds = perf_counter() - begun

        def apart(rows: Array) -> float:
            """Largest distance over the length, between the rod and rows [s, x, y, z]."""
            return float(np.linalg.norm(rod.at(rows[:, 0]) - rows[:, 1:], axis=1).max()) / length

        found.append(Model("rod", seconds, apart(finest), None if reference is None else apart(reference)))
    data = scene.with_cells(USUAL_CELLS).to_si()
    more = Scene.from_si({**data, "resolution": {"cells_across": USUAL_CELLS, "particles_per_cell": MORE_PARTICLES}})
    result, seconds = _timed(more, solve)
    to_reference = None if reference is None else measures.largest_distance(result, reference) / length
    name = f"{MORE_PARTICLES} particles a cell along each direction, at {USUAL_CELLS} cells"
    return [*found, Model(name, seconds, measures.largest_distance(result, finest) / length, to_reference)]


def _conclusions(rungs: Sequence[Rung], beside: Sequence[Model]) -> list[str]:
    """What 1 % and 0.1 % cost, and whether the rod would do."""
    said = []
    for wanted in ASKED:
        will_do = [rung for rung in rungs if _error(rung) is not None and (_error(rung) or 0.0) <= wanted]
        if will_do:
            cheapest = min(will_do, key=lambda rung: rung.seconds)
            said.append(f"{100 * wanted:g} % of the length costs {cheapest.seconds:.2g} s here: {cheapest.cells_across} cells across.")
        else:
            said.append(f"{100 * wanted:g} % of the length is not reached by these cells.")
    for rod in (model for model in beside if model.name == "rod"):
        error = rod.error_finest if rod.error_reference is None else rod.error_reference
        good = [f"{100 * wanted:g} %" for wanted in ASKED if error <= wanted]
        verdict = f"would do for {' and for '.join(good)}" if good else f"would not do for {100 * ASKED[0]:g} %"
        said.append(f"The rod {verdict}: it takes {rod.seconds:.2g} s and is off by {_percent(error)}.")
    return said


def _error(rung: Rung) -> float | None:
    return rung.bar if rung.error_reference is None else rung.error_reference


def _timed(scene: Scene, solve: Solve) -> tuple[Result, float]:
    """The result and the median time of setup and solve."""
    times: list[float] = []
    while not times or (times[-1] < 1.0 and len(times) < REPEATS):
        begun = perf_counter()
        result = solve(scene)
        times.append(perf_counter() - begun - result.seconds.get("compile", 0.0))
    return result, median(times)


def _order(rungs: Sequence[Rung], key: str) -> float | None:
    """Slope of log error against log cell size, by least squares; None with fewer than two errors."""
    known = [(rung.cell_size, getattr(rung, key)) for rung in rungs if getattr(rung, key)]
    if len(known) < 2:
        return None
    size, error = np.log(np.array(known)).T
    return float(np.polyfit(size, error, 1)[0])


def save(ladder: Ladder, folder: Path) -> tuple[Path, Path]:
    """Write accuracy.json and accuracy.csv into a folder, made if missing; returns both paths."""
    folder.mkdir(parents=True, exist_ok=True)
    as_json, as_csv = folder / "accuracy.json", folder / "accuracy.csv"
    as_json.write_text(json.dumps(ladder.summary(), indent=1) + "\n", encoding="utf-8")
    with as_csv.open("w", newline="", encoding="utf-8") as stream:
        rows = [{key: value for key, value in asdict(rung).items() if key != "split"} | rung.split for rung in ladder.rungs]
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return as_json, as_csv
