"""The cost of accuracy: one scene at several cell sizes, each with its error and its time; beside them the rod and other settings."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np

from magmpm.bodies.curves import linear
from magmpm.compiled.arrays import Array
from magmpm.errors import InputError, SolveError
from magmpm.materials import young_modulus
from magmpm.model import build
from magmpm.results import measures
from magmpm.results.result import Result
from magmpm.rod.cosserat import solve_rod
from magmpm.scene import Scene
from magmpm.scene.coarsest import knots_of
from magmpm.statics.axis import centreline
from magmpm.statics.equilibrium import solve_static
from magmpm.statics.error_estimate import ALGEBRAIC, bound, left, order_to_finest, why_undetermined
from magmpm.statics.grids import operations
from magmpm.statics.layout import static_model

LADDER = (2, 3, 4, 5, 6, 8)
GOALS = (1e-2, 1e-3)  # of the length: what the conclusions name the cost of
# ratio of two cell sizes whose difference tells the coarser one's error (statics.error_estimate)
CLOSEST = 1.3

USUAL_CELLS = 4
MORE_PARTICLES = 3
SHIFTS = (
    (0.25, 0.25),
    (0.5, 0.5),
    (0.75, 0.25),
)  # of a cell: other places of the body's axis against the grid
CELLS_OF_MOTIONS = 2  # cells across, on which motions are compared

Solve = Callable[[Scene], Result]
Progress = Callable[[int, int, str], None]


@dataclass(frozen=True)
class Rung:
    """One cell size. Errors are the largest distances of the axis (of STL parts, of their centers) over the length; None if there is no
    reference."""

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
    bar: (
        float | None
    )  # bound of the discretization error over the length, given by a finer rung, or of the finest by a coarser one
    pareto: bool  # no other setting is both quicker and more accurate


@dataclass(frozen=True)
class NeighborModel:
    """A model that stands next to the ladder. Errors over the length: from the finest rung, from the scene's reference, and from the same
    scene on the same cells as the ladder has it; None where there is none."""

    name: str
    seconds: float
    error_finest: float | None
    error_reference: float | None
    error_same_cells: float | None = None

    @property
    def line(self) -> str:
        """The model in a line of the table."""
        known = {
            "finest": self.error_finest,
            "reference": self.error_reference,
            "ladder's answer on the same cells": self.error_same_cells,
        }
        distances = [
            f"{percent(error)} from the {of}" for of, error in known.items() if error is not None
        ]
        return f"{self.name}: {self.seconds:.3f} s, {', '.join(distances)}"


@dataclass(frozen=True)
class Ladder:
    """rungs, coarse to fine; orders: fitted orders of convergence, to the finest rung and to the reference; None where there is none.

    undetermined: why the rungs show no order, by "finest" and "reference"; beside: other models; algebraic_error: what the solve's
    tolerance leaves, over the length; asymptotic: whether errors fall as they must for an order to mean anything, None where too few
    show it; conclusions: what it all says, in words.
    """

    scene: str
    length: float  # m
    rungs: list[Rung]
    order_finest: float | None
    order_reference: float | None
    undetermined: dict[str, str]
    beside: list[NeighborModel]
    algebraic_error: float | None
    asymptotic: bool | None
    conclusions: list[str]
    failed: dict[str, str]  # settings that found no answer, and why

    def summary(self) -> dict[str, Any]:
        """Plain data, SI."""
        return asdict(self)

    def table(self) -> str:
        """The ladder as text."""
        lines = [
            "cells  cell mm  particles     dof  steps  seconds  set-up  solve  matrix MB  error to"
            " finest  error to reference      at most"
        ]
        for rung in self.rungs:
            lines.append(
                f"{rung.cells_across:5d}  {1e3 * rung.cell_size:7.3f}  {rung.particles:9d} "
                f" {rung.dof:6d}  {rung.iterations:5d}  {rung.seconds:7.3f} "
                f" {rung.split['setup']:6.3f} {rung.split['solve']:6.3f} "
                f" {rung.matrix_bytes / 1e6:9.1f}  {percent(rung.error_finest):>15} "
                f" {percent(rung.error_reference):>18} "
                f" {percent(rung.bar):>11}{'' if rung.pareto else '  *'}"
            )
        if not all(rung.pareto for rung in self.rungs):
            lines.append("* another setting is both quicker and more accurate")
        bars = [rung.bar for rung in self.rungs[:-1] if rung.bar is not None]
        if bars != sorted(bars, reverse=True):
            lines.append(
                "at most: what the finest cells prove; of cells nearly as fine they prove less, so"
                " it may rise as errors fall"
            )
        lines += [model.line for model in self.beside]
        if self.algebraic_error is not None:
            lines.append(f"the solve's tolerance leaves {100 * self.algebraic_error:.1e} % of L")
        for name, order in (("finest", self.order_finest), ("reference", self.order_reference)):
            if order is not None or name in self.undetermined:
                told = (
                    f"{order:.1f}"
                    if order is not None
                    else f"not determined: {self.undetermined[name]}"
                )
                lines.append(f"order of convergence to the {name}: {told}")
        lines += [f"{name} failed: {reason}" for name, reason in self.failed.items()]
        return "\n".join([*lines, *self.conclusions])


def climb(
    scene: Scene,
    solve: Solve,
    cells: Sequence[int] = LADDER,
    on_progress: Progress | None = None,
    motion: bool = False,
) -> Ladder:
    """Solve the scene at each number of cells across. motion: compare with settled motions as well (`settled`).

    Settings whose solve fails are left out, and named. Raises InputError for fewer than two different cell sizes, or sizes that the scene
    refuses, and SolveError if no solve succeeds.
    """
    cells = sorted(set(cells))
    if len(cells) < 2:
        raise InputError(
            f"--cells: got {cells}; a ladder needs at least two different cell sizes, such as"
            " 2,3,4,6"
        )
    scenes = [scene.with_cells(n) for n in cells]
    solved: dict[int, tuple[Result, float]] = {}
    failed: dict[str, SolveError] = {}
    for k, rung in enumerate(scenes):
        if on_progress is not None:
            on_progress(k, len(scenes), f"{cells[k]} cells across")
        try:
            solved[cells[k]] = timed(rung, solve)
        except SolveError as error:
            failed[f"{cells[k]} cells across"] = error
    if not solved:
        raise next(iter(failed.values()))
    cells = list(solved)
    runs = list(solved.values())
    finest = answer(runs[-1][0])
    length = scene.length
    rungs = _rungs(scene, cells, runs)
    others = other_models(scene, solve, finest, failed)
    if motion:
        if on_progress is not None:
            on_progress(len(scenes), len(scenes), "motions that settle")
        others += settled(scene, solve, finest, failed)
    errors = {
        "finest": {
            rung.cells_across: rung.error_finest for rung in rungs[:-1] if rung.error_finest
        },
        "reference": {
            rung.cells_across: rung.error_reference for rung in rungs if rung.error_reference
        },
    }
    orders = {
        "finest": order_to_finest(errors["finest"], cells[-1]),
        "reference": _order(errors["reference"]),
    }
    reasons = {
        name: why_undetermined(order, list(errors[name].values())) for name, order in orders.items()
    }
    undetermined = {name: reason for name, reason in reasons.items() if reason is not None}
    told = {name: None if name in undetermined else order for name, order in orders.items()}
    moved = float(
        np.abs(finest[:, 1:] - np.array([1.0, 0.0, 0.0]) * finest[:, :1] - finest[0, 1:]).max()
    )
    return Ladder(
        scene=scene.name,
        length=length,
        rungs=rungs,
        order_finest=told["finest"],
        order_reference=told["reference"],
        undetermined=undetermined,
        beside=others,
        algebraic_error=(
            ALGEBRAIC * scene.solver.static.tolerance**0.5 * moved / length
            if scene.static and scene.body.shape.line
            else None
        ),
        asymptotic=(
            False if "finest" in undetermined else None if len(errors["finest"]) < 3 else True
        ),
        conclusions=[*_conclusions(rungs, others), *_where(scene)],
        failed={name: error.reason for name, error in failed.items()},
    )


def _rungs(scene: Scene, cells: Sequence[int], runs: Sequence[tuple[Result, float]]) -> list[Rung]:
    finest = answer(runs[-1][0])
    reference = scene.reference_centreline()
    length = scene.length
    bars = _bars([result for result, _ in runs], cells)
    errors = [distance(result, finest if reference is None else reference) for result, _ in runs]
    rungs = []
    for k, (n, (result, seconds)) in enumerate(zip(cells, runs, strict=True)):
        bar = bars[k]
        better = [
            j
            for j, (_, other) in enumerate(runs)
            if j != k and other <= seconds and errors[j] <= errors[k]
        ]
        rungs.append(
            Rung(
                cells_across=n,
                cell_size=scene.thickness / n,
                particles=result.particles,
                dof=result.dof,
                iterations=result.iterations,
                seconds=seconds,
                error_finest=None if n == cells[-1] else distance(result, finest) / length,
                error_reference=None if reference is None else errors[k] / length,
                split={
                    key: float(result.seconds.get(key, 0.0))
                    for key in ("setup", "compile", "solve")
                },
                matrix_bytes=(
                    operations(scene.with_cells(n))[1]
                    if scene.static and scene.body.shape.line is not None
                    else 0.0
                ),
                bar=None if bar is None else bar / length,
                pareto=not better,
            )
        )
    return rungs


def _bars(results: Sequence[Result], cells: Sequence[int]) -> list[float | None]:
    """Bounds (m) of the discretization errors: of each grid by the finest one, of the finest by the coarsest that is fine enough for it."""
    bars: list[float | None] = []
    for k, n in enumerate(cells):
        other = (
            len(cells) - 1
            if k < len(cells) - 1
            else next((j for j in range(k, -1, -1) if cells[j] <= n / CLOSEST), None)
        )
        if other is None or max(n, cells[other]) < CLOSEST * min(n, cells[other]):
            bars.append(None)
            continue
        low = min(k, other)
        high = max(k, other)
        coarse = cells[low]
        fine = cells[high]
        finest = answer(results[high])
        others = {cells[j]: distance(results[j], finest) for j in range(high) if j != low}
        most = bound(coarse, fine, distance(results[low], finest), others)
        bars.append(most if n == coarse else most * left(coarse, fine))
    return bars


def _conclusions(rungs: Sequence[Rung], others: Sequence[NeighborModel]) -> list[str]:
    """Report what 1 % and 0.1 % cost, and whether the rod would be accurate enough."""
    if len(rungs) == 1 and _error(rungs[0]) is None:
        return [f"The error is not known: only {rungs[0].cells_across} cells across were solved."]
    said = []
    for wanted in GOALS:
        will_do = [
            rung for rung in rungs if _error(rung) is not None and (_error(rung) or 0.0) <= wanted
        ]
        if will_do:
            cheapest = min(will_do, key=lambda rung: rung.seconds)
            said.append(
                f"{100 * wanted:g} % of the length costs {cheapest.seconds:.2g} s here:"
                f" {cheapest.cells_across} cells across."
            )
        else:
            said.append(f"{100 * wanted:g} % of the length is not reached by these cells.")
    for rod in (model for model in others if model.name == "rod"):
        error = rod.error_finest if rod.error_reference is None else rod.error_reference
        if error is None:
            continue
        good = [f"{100 * wanted:g} %" for wanted in GOALS if error <= wanted]
        verdict = (
            f"would do for {' and for '.join(good)}"
            if good
            else f"would not do for {100 * GOALS[0]:g} %"
        )
        said.append(
            f"The rod {verdict}: it takes {rod.seconds:.2g} s and is off by {percent(error)}."
        )
    return said


def _where(scene: Scene) -> list[str]:
    """Note, for runs along time, that the grids are compared where it ends."""
    if not scene.in_time:
        return []
    what = "motion" if scene.solver.dynamic is not None else "path"
    return [
        f"All this is of the {what}'s end; `resolution: {{error: 1 %}}` bounds the errors of all"
        " its frames, which may be larger."
    ]


def _error(rung: Rung) -> float | None:
    return rung.bar if rung.error_reference is None else rung.error_reference


def _order(errors: dict[int, float]) -> float | None:
    """Slope of log error against log cell size, by least squares; errors by their cells across. None with fewer than two."""
    if len(errors) < 2:
        return None
    cells, error = np.log(np.array(list(errors.items()))).T
    return float(-np.polyfit(cells, error, 1)[0])


def percent(error: float | None) -> str:
    """An error over the length, as text."""
    return "-" if error is None else f"{100 * error:.4f} % of L"


def answer(result: Result) -> Array:
    """Answer that is compared, rows [s, x, y, z] m: the axis; of STL parts their centers, with their numbers for s."""
    if len(result.centreline):
        return result.centreline
    return np.column_stack([np.arange(len(result.segment_center)), result.segment_center])


def distance(result: Result, rows: Array) -> float:
    """Largest distance (m) between a result and rows [s, x, y, z] m, of another one or of a reference."""
    if len(result.centreline):
        return measures.largest_distance(result, rows)
    return float(np.linalg.norm(answer(result)[:, 1:] - rows[:, 1:], axis=1).max())


def timed(scene: Scene, solve: Solve) -> tuple[Result, float]:
    """The result and the median time of setup and solve, s."""
    times: list[float] = []
    while not times or (times[-1] < 1.0 and len(times) < 3):
        begun = perf_counter()
        result = solve(scene)
        times.append(perf_counter() - begun - result.seconds.get("compile", 0.0))
    return result, median(times)


def other_models(
    scene: Scene, solve: Solve, finest: Array, failed: dict[str, SolveError]
) -> list[NeighborModel]:
    """The rod, and what more particles and another place of the grid change at the usual cells; of equilibria only.

    finest: rows [s, x, y, z] m of the ladder's last rung; failed: takes the errors of what found no answer, by name.
    """
    if not scene.static or scene.in_time or scene.body.shape.line is None:
        return []
    found = []
    reference = scene.reference_centreline()
    begun = perf_counter()
    try:
        rod = solve_rod(scene)
    except SolveError as error:
        failed["rod"] = error
    else:
        seconds = perf_counter() - begun

        def off(rows: Array) -> float:
            """Largest distance over the length, between the rod and rows [s, x, y, z]."""
            return (
                float(np.linalg.norm(rod.at(rows[:, 0]) - rows[:, 1:], axis=1).max()) / scene.length
            )

        found.append(
            NeighborModel(
                "rod", seconds, off(finest), None if reference is None else off(reference)
            )
        )
    data = scene.with_cells(USUAL_CELLS).to_si()
    more = Scene.from_si(
        {**data, "resolution": {"cells_across": USUAL_CELLS, "particles_per_cell": MORE_PARTICLES}}
    )
    name = f"{MORE_PARTICLES} particles a cell along each direction, at {USUAL_CELLS} cells"
    try:
        found.append(_compared(name, *timed(more, solve), finest, reference, scene.length))
    except SolveError as error:
        failed[name] = error
    return [*found, *_shifted(scene.with_cells(USUAL_CELLS), finest, reference, failed)]


def _compared(
    name: str, result: Result, seconds: float, finest: Array, reference: Array | None, length: float
) -> NeighborModel:
    to_reference = None if reference is None else distance(result, reference) / length
    return NeighborModel(name, seconds, distance(result, finest) / length, to_reference)


def _shifted(
    scene: Scene, finest: Array, reference: Array | None, failed: dict[str, SolveError]
) -> list[NeighborModel]:
    """The worst of some other places of a catheter's axis against the grid: where the grid lies is no part of the physics."""
    body = scene.body.catheter
    at = scene.resolution
    if body is None:
        return []
    name = f"{len(SHIFTS)} other places of the grid, at {at.cells_across} cells, the worst"
    worst: dict[str, float] = {}
    times = []
    for shift in SHIFTS:
        begun = perf_counter()
        model = static_model(
            build(
                scene,
                body.discretize(at.cells_across, at.particles_per_cell, knots_of(scene), shift),
            )
        )
        try:
            found = solve_static(model, with_stability=False)
        except SolveError as error:
            failed[name] = error
            return []
        times.append(perf_counter() - begun)
        rows = centreline(model, found.point.grid)
        for against, other in (("finest", finest), ("reference", reference)):
            if other is not None:
                moved = linear(other[:, 0], rows[:, 0], rows[:, 1:])
                worst[against] = max(
                    worst.get(against, 0.0),
                    float(np.linalg.norm(moved - other[:, 1:], axis=1).max()) / scene.length,
                )
    return [NeighborModel(name, median(times), worst["finest"], worst.get("reference"))]


def settled(
    scene: Scene, solve: Solve, finest: Array, failed: dict[str, SolveError]
) -> list[NeighborModel]:
    """The same answer as a motion that settles, at CELLS_OF_MOTIONS cells: with its time step, and with half of it. Of a scene that
    moves, its own motion in the same ways. Empty where the materials have no density. failed: takes the errors of what found no answer,
    by name.
    """
    coarse = scene.with_cells(CELLS_OF_MOTIONS)
    resting = scene.static and not scene.in_time
    motion = coarse if not resting else None if scene.body.shape.line is None else _settling(coarse)
    if motion is None or motion.solver.dynamic is None:
        return []
    try:
        same, _ = timed(coarse, solve)
    except SolveError as error:
        failed[f"what motions are compared with, at {CELLS_OF_MOTIONS} cells"] = error
        return []
    reference = scene.reference_centreline()
    found = []
    step = None
    for part in (1.0, 0.5):
        data = motion.to_si()
        dynamic = {
            **data["solver"]["dynamic"],
            **({"time_step": part * step} if part < 1.0 and step is not None else {}),
        }
        try:
            result, seconds = timed(
                Scene.from_si({**data, "solver": {**data["solver"], "dynamic": dynamic}}), solve
            )
        except SolveError as error:
            failed[
                f"motion{', half the step' if part < 1.0 else ''}, at {CELLS_OF_MOTIONS} cells"
            ] = error
            continue
        step = result.time_step if part == 1.0 else step
        name = f"motion, step {1e6 * (result.time_step or 0.0):.3g} us, at {CELLS_OF_MOTIONS} cells"
        compared = _compared(name, result, seconds, finest, reference, scene.length)
        found.append(
            replace(compared, error_same_cells=distance(result, answer(same)) / scene.length)
        )
    return found


def _settling(scene: Scene) -> Scene | None:
    """The scene as a motion, damped critically, for as long as it takes to settle; None without densities."""
    used = [scene.materials[region.material_name] for region in scene.regions()]
    if any(material.density is None for material in used):
        return None
    softest = min(
        float(young_modulus(m.shear_modulus, m.bulk_to_shear * m.shear_modulus))
        / (m.density or math.inf)
        for m in used
    )
    # of a clamped beam: w L^2 root(rho A/(E I)) = 3.516; root(I/A) of a round section is a fourth of its thickness
    frequency = 3.516 / scene.length**2 * math.sqrt(softest) * scene.thickness / 4
    data = scene.to_si()
    solver = {key: value for key, value in data["solver"].items() if key != "static"}
    duration = 16.0 / frequency  # 2e-6 of the motion is left
    effects = {**data["effects"], "damping": {"rate": 2 * frequency}}
    dynamic = {"duration": duration, "output_every": duration / 4}
    return Scene.from_si({**data, "effects": effects, "solver": {**solver, "dynamic": dynamic}})


def save(ladder: Ladder, folder: Path) -> tuple[Path, Path]:
    """Write accuracy.json and accuracy.csv into a folder, made if missing; returns both paths."""
    folder.mkdir(parents=True, exist_ok=True)
    as_json = folder / "accuracy.json"
    as_csv = folder / "accuracy.csv"
    as_json.write_text(json.dumps(ladder.summary(), indent=1) + "\n", encoding="utf-8")
    with as_csv.open("w", newline="", encoding="utf-8") as stream:
        rows = [
            {key: value for key, value in asdict(rung).items() if key != "split"} | rung.split
            for rung in ladder.rungs
        ]
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return as_json, as_csv
