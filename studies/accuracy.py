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

from magmpm.errors import InputError
from magmpm.results import measures
from magmpm.results.result import Result
from magmpm.scene import Scene

LADDER = (2, 3, 4, 5, 6, 8)
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


@dataclass(frozen=True)
class Ladder:
    """rungs, coarse to fine; order: fitted order of convergence toward the reference, or if there is none toward the finest."""

    scene: str
    length: float  # m
    rungs: list[Rung]
    order_finest: float | None
    order_reference: float | None

    def summary(self) -> dict[str, Any]:
        """Plain data, SI."""
        return asdict(self)

    def table(self) -> str:
        """The ladder as text."""
        lines = ["cells  cell mm  particles     dof  steps  seconds  error to finest  error to reference"]
        for rung in self.rungs:
            lines.append(
                f"{rung.cells_across:5d}  {1e3 * rung.cell_size:7.3f}  {rung.particles:9d}  {rung.dof:6d}  {rung.iterations:5d}  "
                f"{rung.seconds:7.3f}  {_percent(rung.error_finest):>15}  {_percent(rung.error_reference):>18}"
            )
        for name, order in (("finest", self.order_finest), ("reference", self.order_reference)):
            if order is not None:
                lines.append(f"order of convergence to the {name}: {order:.1f}")
        return "\n".join(lines)


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
    finest = runs[-1][0].centreline
    reference, length = scene.reference_centreline(), scene.length
    rungs = []
    for n, (result, seconds) in zip(cells, runs, strict=True):
        rungs.append(
            Rung(
                cells_across=n,
                cell_size=scene.thickness / n,
                particles=result.particles,
                dof=result.dof,
                iterations=result.iterations,
                seconds=seconds,
                error_finest=None if n == cells[-1] else measures.largest_distance(result, finest) / length,
                error_reference=None
                if reference is None
                else measures.largest_distance(result, reference) / length,
            )
        )
    return Ladder(
        scene=scene.name,
        length=length,
        rungs=rungs,
        order_finest=_order(rungs[:-1], "error_finest"),
        order_reference=_order(rungs, "error_reference"),
    )


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
        writer = csv.DictWriter(stream, list(asdict(ladder.rungs[0])))
        writer.writeheader()
        writer.writerows(asdict(rung) for rung in ladder.rungs)
    return as_json, as_csv
