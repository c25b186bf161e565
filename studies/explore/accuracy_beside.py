"""Comparisons next to the ladder of `magmpm accuracy`: the rod, more particles, other places of the grid, and the motion that settles."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from time import perf_counter

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import SolveError
from magmpm.materials import young_modulus
from magmpm.model import build
from magmpm.results import measures
from magmpm.results.result import Result
from magmpm.rod.cosserat import solve_rod
from magmpm.scene import Scene
from magmpm.scene.coarsest import knots_of
from magmpm.statics.axis import centreline
from magmpm.statics.equilibrium import solve_static
from magmpm.statics.layout import static_model

USUAL_CELLS, MORE_PARTICLES = 4, 3
SHIFTS = ((0.25, 0.25), (0.5, 0.5), (0.75, 0.25))  # of a cell: other places of the body's axis against the grid
COARSE = 2  # cells across, on which motions are compared

Solve = Callable[[Scene], Result]


@dataclass(frozen=True)
class Model:
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
        errors = (self.error_finest, "from the finest"), (self.error_reference, "from the reference")
        told = [f"{percent(error)} {of}" for error, of in errors if error is not None]
        if self.error_same_cells is not None:
            told.append(f"{percent(self.error_same_cells)} from the ladder's answer on the same cells")
        return f"{self.name}: {self.seconds:.3f} s, {', '.join(told)}"


def percent(error: float | None) -> str:
    """An error over the length, as text."""
    return "-" if error is None else f"{100 * error:.4f} % of L"


def answer(result: Result) -> Array:
    """Answer that is compared, rows [s, x, y, z] m: the axis; of STL parts their centers, with their numbers for s."""
    if len(result.centreline):
        return result.centreline
    return np.column_stack([np.arange(len(result.segment_center)), result.segment_center])


def apart(result: Result, rows: Array) -> float:
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


def beside(scene: Scene, solve: Solve, finest: Array, failed: dict[str, SolveError]) -> list[Model]:
    """The rod, and what more particles and another place of the grid change at the usual cells; of equilibria only.

    finest: rows [s, x, y, z] m of the ladder's last rung; failed: takes the errors of what found no answer, by name.
    """
    if not scene.static or scene.in_time or scene.body.shape.line is None:
        return []
    found, reference = [], scene.reference_centreline()
    begun = perf_counter()
    try:
        rod = solve_rod(scene)
    except SolveError as error:
        failed["rod"] = error
    else:
        seconds = perf_counter() - begun

        def off(rows: Array) -> float:
            """Largest distance over the length, between the rod and rows [s, x, y, z]."""
            return float(np.linalg.norm(rod.at(rows[:, 0]) - rows[:, 1:], axis=1).max()) / scene.length

        found.append(Model("rod", seconds, off(finest), None if reference is None else off(reference)))
    data = scene.with_cells(USUAL_CELLS).to_si()
    more = Scene.from_si({**data, "resolution": {"cells_across": USUAL_CELLS, "particles_per_cell": MORE_PARTICLES}})
    name = f"{MORE_PARTICLES} particles a cell along each direction, at {USUAL_CELLS} cells"
    try:
        found.append(_compared(name, *timed(more, solve), finest, reference, scene.length))
    except SolveError as error:
        failed[name] = error
    return [*found, *_shifted(scene.with_cells(USUAL_CELLS), finest, reference, failed)]


def _compared(name: str, result: Result, seconds: float, finest: Array, reference: Array | None, length: float) -> Model:
    to_reference = None if reference is None else apart(result, reference) / length
    return Model(name, seconds, apart(result, finest) / length, to_reference)


def _shifted(scene: Scene, finest: Array, reference: Array | None, failed: dict[str, SolveError]) -> list[Model]:
    """The worst of some other places of a catheter's axis against the grid: where the grid lies is no part of the physics."""
    body, at = scene.body.catheter, scene.resolution
    if body is None:
        return []
    name = f"{len(SHIFTS)} other places of the grid, at {at.cells_across} cells, the worst"
    worst: dict[str, float] = {}
    times = []
    for shift in SHIFTS:
        begun = perf_counter()
        model = static_model(build(scene, body.discretize(at.cells_across, at.particles_per_cell, knots_of(scene), shift)))
        try:
            found = solve_static(model, judged=False)
        except SolveError as error:
            failed[name] = error
            return []
        times.append(perf_counter() - begun)
        rows = centreline(model, found.point.grid)
        for against, other in (("finest", finest), ("reference", reference)):
            if other is not None:
                moved = np.array([np.interp(other[:, 0], rows[:, 0], rows[:, k]) for k in (1, 2, 3)]).T
                worst[against] = max(worst.get(against, 0.0), float(np.linalg.norm(moved - other[:, 1:], axis=1).max()) / scene.length)
    return [Model(name, median(times), worst["finest"], worst.get("reference"))]


def settled(scene: Scene, solve: Solve, finest: Array, failed: dict[str, SolveError]) -> list[Model]:
    """The same answer as a motion that settles, at COARSE cells: with its time step, and with half of it. Of a scene that moves, its own
    motion in the same ways. Empty where the materials have no density. failed: takes the errors of what found no answer, by name."""
    coarse = scene.with_cells(COARSE)
    resting = scene.static and not scene.in_time
    motion = coarse if not resting else None if scene.body.shape.line is None else _settling(coarse)
    if motion is None or motion.solver.dynamic is None:
        return []
    try:
        same, _ = timed(coarse, solve)
    except SolveError as error:
        failed[f"what motions are compared with, at {COARSE} cells"] = error
        return []
    reference, found = scene.reference_centreline(), []
    step = None
    for part in (1.0, 0.5):
        data = motion.to_si()
        dynamic = {**data["solver"]["dynamic"], **({"time_step": part * step} if part < 1.0 and step is not None else {})}
        try:
            result, seconds = timed(Scene.from_si({**data, "solver": {**data["solver"], "dynamic": dynamic}}), solve)
        except SolveError as error:
            failed[f"motion{', half the step' if part < 1.0 else ''}, at {COARSE} cells"] = error
            continue
        step = result.time_step if part == 1.0 else step
        name = f"motion, step {1e6 * (result.time_step or 0.0):.3g} us, at {COARSE} cells"
        told = _compared(name, result, seconds, finest, reference, scene.length)
        found.append(Model(name, seconds, told.error_finest, told.error_reference, apart(result, answer(same)) / scene.length))
    return found


def _settling(scene: Scene) -> Scene | None:
    """The scene as a motion, damped critically, for as long as it takes to settle; None without densities."""
    used = [scene.materials[region.material_name] for region in scene.regions()]
    if any(material.density is None for material in used):
        return None
    softest = min(float(young_modulus(m.shear_modulus, m.bulk_to_shear * m.shear_modulus)) / (m.density or math.inf) for m in used)
    # of a clamped beam: w L^2 root(rho A/(E I)) = 3.516; root(I/A) of a round section is a fourth of its thickness
    frequency = 3.516 / scene.length**2 * math.sqrt(softest) * scene.thickness / 4
    data = scene.to_si()
    solver = {key: value for key, value in data["solver"].items() if key != "static"}
    duration = 16.0 / frequency  # 2e-6 of the motion is left
    effects = {**data["effects"], "damping": {"rate": 2 * frequency}}
    dynamic = {"duration": duration, "output_every": duration / 4}
    return Scene.from_si({**data, "effects": effects, "solver": {**solver, "dynamic": dynamic}})
