"""The cost of accuracy: one scene at several cell sizes, each with its error and its time; beside them the rod and other settings."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from time import perf_counter

import numpy as np

from magmpm.bodies.curves import linear
from magmpm.compiled.arrays import Array, NamedNumbers, Plain
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
from magmpm.statics.error_estimate import (
    bound,
    farthest,
    left,
    order_to_finest,
    why_undetermined,
)
from magmpm.statics.grids import left_by_solve, operations
from magmpm.statics.layout import static_model

LADDER = (2, 3, 4, 5, 6, 8)
GOALS = (1e-2, 1e-3)  # of the length: what the conclusions name the cost of

SHIFTS = (
    (0.25, 0.25),
    (0.5, 0.5),
    (0.75, 0.25),
)  # of a cell: other places of the body's axis against the grid

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
    split: NamedNumbers  # s: setup, compile, solve, of the last run
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

    def summary(self) -> Plain:
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
            told = None if order is None else f"{order:.1f}"
            if name in self.undetermined:
                told = f"not determined: {self.undetermined[name]}"
            if told is not None:
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
    """Solve the scene at each number of cells across. motion: compare with settled motions as well (`Beside.settled`).

    Settings whose solve fails are left out, and named. Raises InputError for fewer than two different cell sizes, or sizes that the scene
    refuses, and SolveError if no solve succeeds.
    """
    cells = sorted(set(cells))
    if len(cells) < 2:
        raise InputError(
            f"--cells: got {cells}; a ladder needs at least two different cell sizes, such as"
            " 2,3,4,6"
        )
    tell = on_progress or (lambda done, of, what: None)
    scenes = {f"{n} cells across": scene.with_cells(n) for n in cells}
    runs: dict[int, Timed] = {}
    failed: dict[str, SolveError] = {}
    for k, (name, rung) in enumerate(scenes.items()):
        tell(k, len(cells), name)
        try:
            runs[cells[k]] = timed(rung, solve)
        except SolveError as error:
            failed[name] = error
    if not runs:
        raise next(iter(failed.values()))
    beside = Beside(scene, solve, answer(runs[max(runs)].result), failed)
    rungs = _rungs(runs, beside)
    beside.other_models()
    if motion:
        tell(len(cells), len(cells), "motions that settle")
        beside.settled()
    to_finest = {one.cells_across: one.error_finest for one in rungs[:-1] if one.error_finest}
    to_reference = {one.cells_across: one.error_reference for one in rungs if one.error_reference}
    orders = {"finest": order_to_finest(to_finest, max(runs)), "reference": _order(to_reference)}
    errors = {"finest": to_finest, "reference": to_reference}
    undetermined = {
        name: why
        for name, order in orders.items()
        for why in [why_undetermined(order, list(errors[name].values()))]
        if why is not None
    }
    told = {name: None if name in undetermined else order for name, order in orders.items()}
    steady = None if len(to_finest) < 3 else True
    return Ladder(
        scene=scene.name,
        length=scene.length,
        rungs=rungs,
        order_finest=told["finest"],
        order_reference=told["reference"],
        undetermined=undetermined,
        beside=beside.found,
        algebraic_error=_algebraic(scene, beside.finest),
        asymptotic=False if "finest" in undetermined else steady,
        conclusions=[*_conclusions(rungs, beside.found), *_where(scene)],
        failed={name: error.reason for name, error in failed.items()},
    )


def _algebraic(scene: Scene, finest: Array) -> float | None:
    """Error over the length that the solve's tolerance leaves in an equilibrium of a straight body, of rows [s, x, y, z] m."""
    if not (scene.static and scene.body.shape.line):
        return None
    straight = np.array([1.0, 0.0, 0.0]) * finest[:, :1]
    moved = float(np.abs(finest[:, 1:] - straight - finest[0, 1:]).max())
    return left_by_solve(scene, moved) / scene.length


def _rungs(runs: Mapping[int, Timed], beside: Beside) -> list[Rung]:
    """A rung for each number of cells across."""
    scene = beside.scene
    bars = _bars({n: run.result for n, run in runs.items()})
    known = beside.finest if beside.reference is None else beside.reference
    errors = {n: distance(run.result, known) for n, run in runs.items()}
    straight = scene.static and scene.body.shape.line is not None
    rungs = []
    for n, run in runs.items():
        of = run.result
        bar = bars[n]
        better = [
            m
            for m, other in runs.items()
            if m != n and other.seconds <= run.seconds and errors[m] <= errors[n]
        ]
        to_finest, to_reference = beside.errors_of(of)
        rungs.append(
            Rung(
                cells_across=n,
                cell_size=scene.thickness / n,
                particles=of.particles,
                dof=of.dof,
                iterations=of.iterations,
                seconds=run.seconds,
                error_finest=None if n == max(runs) else to_finest,
                error_reference=to_reference,
                split={
                    key: float(of.seconds.get(key, 0.0)) for key in ("setup", "compile", "solve")
                },
                matrix_bytes=operations(scene.with_cells(n))[1] if straight else 0.0,
                bar=None if bar is None else bar / scene.length,
                pareto=not better,
            )
        )
    return rungs


def _bars(results: dict[int, Result]) -> dict[int, float | None]:
    """Bounds (m) of the discretization errors: of each grid by the finest one, of the finest by the coarsest that is fine enough for it."""
    # ratio of two cell sizes whose difference tells the coarser one's error (statics.error_estimate)
    closest = 1.3
    bars: dict[int, float | None] = dict.fromkeys(results)
    last = max(results)
    for n in results:
        coarser = (m for m in reversed(results) if m <= n / closest)
        other = last if n != last else next(coarser, n)
        low = min(n, other)
        high = max(n, other)
        if high < closest * low:
            continue
        finest = answer(results[high])
        others = {m: distance(results[m], finest) for m in results if m < high}
        most = bound(low, high, others.pop(low), others)
        bars[n] = most if n == low else most * left(low, high)
    return bars


def _conclusions(rungs: Sequence[Rung], others: Sequence[NeighborModel]) -> list[str]:
    """Report what 1 % and 0.1 % cost, and whether the rod would be accurate enough."""
    errors = [_known(rung.error_reference, rung.bar) for rung in rungs]
    if len(rungs) == 1 and errors[0] is None:
        return [f"The error is not known: only {rungs[0].cells_across} cells across were solved."]
    said = []
    for wanted in GOALS:
        will_do = [
            rung
            for rung, error in zip(rungs, errors, strict=True)
            if error is not None and error <= wanted
        ]
        cost = "is not reached by these cells."
        if will_do:
            cheapest = min(will_do, key=lambda rung: rung.seconds)
            cost = f"costs {cheapest.seconds:.2g} s here: {cheapest.cells_across} cells across."
        said.append(f"{100 * wanted:g} % of the length {cost}")
    for rod in (model for model in others if model.name == "rod"):
        error = _known(rod.error_reference, rod.error_finest)
        good = [f"{100 * wanted:g} %" for wanted in GOALS if error is not None and error <= wanted]
        would = f"would not do for {100 * GOALS[0]:g} %"
        if good:
            would = f"would do for {' and for '.join(good)}"
        off = percent(error)
        said.append(f"The rod {would}: it takes {rod.seconds:.2g} s and is off by {off}.")
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


def _known(to_reference: float | None, otherwise: float | None) -> float | None:
    """The error from the reference, or where there is none, another."""
    return otherwise if to_reference is None else to_reference


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
    return farthest(answer(result)[:, 1:], rows[:, 1:])


@dataclass(frozen=True)
class Timed:
    """A run: its result, and the median time of setup and solve, s."""

    result: Result
    seconds: float


def timed(scene: Scene, solve: Solve) -> Timed:
    """Run a scene; what takes less than a second, three times."""
    times: list[float] = []
    while not times or (times[-1] < 1.0 and len(times) < 3):
        begun = perf_counter()
        result = solve(scene)
        times.append(perf_counter() - begun - result.seconds.get("compile", 0.0))
    return Timed(result, median(times))


class Beside:
    """Models that stand beside a ladder, against its last rung, rows [s, x, y, z] m, and against the scene's reference.

    found: the models; failed: takes the errors of what found no answer, by name.
    """

    def __init__(
        self, scene: Scene, solve: Solve, finest: Array, failed: dict[str, SolveError]
    ) -> None:
        self.scene = scene
        self.solve = solve
        self.finest = finest
        self.reference = scene.reference_centreline()
        self.failed = failed
        self.found: list[NeighborModel] = []

    def errors(self, off: Callable[[Array], float]) -> tuple[float, float | None]:
        """Errors over the length against the finest rung and the reference (None without one); off: gives the distance (m) from rows."""
        length = self.scene.length
        reference = None if self.reference is None else off(self.reference) / length
        return off(self.finest) / length, reference

    def errors_of(self, result: Result) -> tuple[float, float | None]:
        """Errors of a result over the length."""
        return self.errors(lambda rows: distance(result, rows))

    def add(self, name: str, run: Timed, same: Result | None = None) -> None:
        """Note a run. same: the ladder's answer on the same cells."""
        to_finest, to_reference = self.errors_of(run.result)
        apart = None if same is None else distance(run.result, answer(same)) / self.scene.length
        self.found.append(NeighborModel(name, run.seconds, to_finest, to_reference, apart))

    def other_models(self) -> None:
        """The rod, and what more particles and another place of the grid change at the usual cells; of equilibria only."""
        more_particles = 3
        usual_cells = 4
        scene = self.scene
        if not scene.static or scene.in_time or scene.body.shape.line is None:
            return
        begun = perf_counter()
        try:
            rod = solve_rod(scene)
        except SolveError as error:
            self.failed["rod"] = error
        else:
            seconds = perf_counter() - begun
            errors = self.errors(lambda rows: farthest(rod.at(rows[:, 0]), rows[:, 1:]))
            self.found.append(NeighborModel("rod", seconds, *errors))
        cells = {"cells_across": usual_cells, "particles_per_cell": more_particles}
        more = Scene.from_si({**scene.with_cells(usual_cells).to_si(), "resolution": cells})
        name = f"{more_particles} particles a cell along each direction, at {usual_cells} cells"
        try:
            self.add(name, timed(more, self.solve))
        except SolveError as error:
            self.failed[name] = error
        self._shifted(scene.with_cells(usual_cells))

    def _shifted(self, scene: Scene) -> None:
        """The worst of some other places of a catheter's axis against the grid: where the grid lies is no part of the physics."""
        body = scene.body.catheter
        at = scene.resolution
        if body is None:
            return
        name = f"{len(SHIFTS)} other places of the grid, at {at.cells_across} cells, the worst"
        shapes: list[Array] = []
        times = []
        for shift in SHIFTS:
            begun = perf_counter()
            knots = knots_of(scene)
            grid = body.discretize(at.cells_across, at.particles_per_cell, knots, shift)
            model = static_model(build(scene, grid))
            try:
                found = solve_static(model, with_stability=False)
            except SolveError as error:
                self.failed[name] = error
                return
            times.append(perf_counter() - begun)
            shapes.append(centreline(model, found.point.grid))

        def worst(rows: Array) -> float:
            """The farthest of the shapes from rows, m."""
            at = rows[:, 0]
            return max(farthest(linear(at, one[:, 0], one[:, 1:]), rows[:, 1:]) for one in shapes)

        self.found.append(NeighborModel(name, median(times), *self.errors(worst)))

    def settled(self) -> None:
        """The same answer as a motion that settles, at two cells across: with its time step, and with half of it.

        Of a scene that moves, its own motion in the same ways. Nothing where the materials have no density.
        """
        cells = "at 2 cells"
        coarse = self.scene.with_cells(2)
        motion = _settling(coarse) if coarse.static and not coarse.in_time else coarse
        if motion is None or motion.solver.dynamic is None:
            return
        try:
            same = timed(coarse, self.solve).result
        except SolveError as error:
            self.failed[f"what motions are compared with, {cells}"] = error
            return
        data = motion.to_si()
        for words in ("", ", half the step"):
            try:
                run = timed(Scene.from_si(data), self.solve)
            except SolveError as error:
                self.failed[f"motion{words}, {cells}"] = error
                continue
            step = run.result.time_step or 0.0
            self.add(f"motion, step {1e6 * step:.3g} us, {cells}", run, same)
            if step:
                data["solver"]["dynamic"]["time_step"] = 0.5 * step


def _settling(scene: Scene) -> Scene | None:
    """The scene as a motion, damped critically, for as long as it takes to settle; None without densities, and of no straight body."""
    if scene.body.shape.line is None:
        return None
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
