"""One scene on several grids, for the error of each or the coarsest that will do: straight bodies by statics.grids, others by runs."""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from magmpm.effects.acting import instant_modulus
from magmpm.errors import SceneError, length, quantity, significant
from magmpm.materials import pressure_wave_speed
from magmpm.results.measures import Frames, frames_of, near_jumps
from magmpm.results.result import Result
from magmpm.rod.cantilever import kink_warning
from magmpm.scene import Scene, memory
from magmpm.scene.coarsest import coarsest_cells
from magmpm.solving.precompile import PROOFS, SOLVE, prepare_kernels
from magmpm.solving.solve import solve
from magmpm.statics.error_estimate import INTERMEDIATE
from magmpm.statics.grids import PARTICLE, Equilibria, Grids, Solved, operations
from magmpm.statics.newton import OnStep
from magmpm.statics.resolution import PATIENCE, ChosenGrid, choose, first_cells, known_error, proofs


class Runs(Grids):
    """Whole runs on several grids: along time, or of bodies that are not straight. results and frames by cells across."""

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        self.results: dict[int, Result] = {}
        self.frames: dict[int, Frames] = {}

    def solve(self, cells: int) -> None:
        """Run the scene, if it has not been."""
        if cells in self.solved:
            return
        begun = time.perf_counter()
        frames = Frames()

        def tell(step: int, at: float) -> None:
            self._check_hopeful(cells, time.perf_counter() - begun, at)
            if self.on_step is not None:
                self.on_step(step, at)

        result = solve(self.on(cells), on_progress=tell, on_frame=frames.see)
        if not frames.times:
            frames = frames_of(result)
        frames.jumps = [jump["time"] for jump in result.jumps]
        seconds = time.perf_counter() - begun - result.seconds["compile"]
        moved = float(np.abs(result.particle_position - result.particle_reference).max())
        self.results[cells], self.frames[cells] = result, frames
        self.solved[cells] = Solved(
            cells,
            True,
            seconds,
            result.iterations,
            result.dof,
            result.centreline,
            result.tip,
            moved,
        )

    def times(self, cells: int) -> float:
        """Cost of a run on a grid together with its error, over that of the run alone."""
        return 1.0 + sum(work(self.on(n)) for n in needed_for(self.scene, cells)) / work(
            self.on(cells)
        )

    def _check_hopeful(self, cells: int, gone: float, at: float) -> None:
        """Raise SceneError at a time (s) of the first grid's motion, `gone` s after it began, if the error requested will take too long."""
        scene = self.scene
        allowed = self.scene.resolution.allowed(self.scene.length)
        if (
            self.solved
            or not scene.in_time
            or allowed is None
            or at <= 0.0
            or gone < 0.01 * PATIENCE
        ):  # then the pace is known
            return
        end = (
            scene.solver.dynamic.duration
            if scene.solver.dynamic is not None
            else scene.path_times()[-1]
        )
        alone = gone * end / at
        times = self.times(cells)
        if alone * times > PATIENCE:
            raise SceneError(
                "resolution.error",
                received=f"{100 * allowed / scene.length:.3g} % of the length",
                rule=(
                    f"must be within reach of {PATIENCE:g} s: a run on {cells} cells across takes"
                    f" {alone:.2g} s, and to know its error {times:.2g} times as long"
                ),
                remedy=(
                    f"give cells_across: {cells} without an error, shorten it, or allow"
                    f" resolution.seconds: {1.2 * alone * times:.2g}"
                ),
            )

    def prove(self, cells: int, against: int) -> None:
        """Run the scene."""
        self.solve(cells)

    def distance_between(self, coarse: int, fine: int) -> float:
        """The largest distance (m) in any frame that is not near a jump of the path."""
        return max(self.distances(coarse, fine).values(), default=math.inf)

    def distances(self, coarse: int, fine: int) -> dict[float, float]:
        """The largest distance (m) in each frame but those near a jump, by its time (s)."""
        one = self.frames[coarse]
        other = self.frames[fine]
        return one.distances(other, self.scene.resolution.of, near_jumps(one, other))

    def takes(self, cells: int, proof: bool) -> float:
        """Seconds, from those of the finest grid that was run."""
        last = max(self.solved)
        return self.solved[last].seconds * work(self.on(cells)) / work(self.on(last))

    def size(self, cells: int) -> float:
        """Bytes of the matrix, or of particles and grid."""
        scene = self.on(cells)
        return (
            operations(scene)[1] if scene.static else memory.BYTES * memory.fewest_particles(scene)
        )

    @property
    def algebraic(self) -> float:
        """Error that the solves of equilibria leave, m."""
        return super().algebraic if self.scene.static else 0.0


def work(scene: Scene) -> float:
    """Multiply-adds of a Newton step; of a motion particles times steps, both in units of their own."""
    if scene.static:
        return operations(scene)[0] + PARTICLE * memory.fewest_particles(scene)
    return memory.fewest_particles(scene) * scene.resolution.cells_across


def grids_of(scene: Scene) -> Grids:
    """Grids on which a scene is solved: equilibria of straight bodies from each other, all else by whole runs."""
    return Runs(scene) if scene.in_time or scene.body.shape.line is None else Equilibria(scene)


def choose_grid(
    grids: Grids, on_step: OnStep | None = None, extra: Callable[[int], float] | None = None
) -> tuple[ChosenGrid, float]:
    """The grid for the error or the time that a scene requests (statics.resolution.choose), and the seconds its kernels took to load."""
    compiled = _prepare(grids)
    choice = choose(grids, on_step, extra or (lambda cells: 0.0))
    return replace(choice, report={**choice.report, **_on_the_way(grids, choice)}), compiled


def error_of_grid(grids: Grids, cells: int) -> ChosenGrid:
    """The error of the grid with so many cells across. Raises SceneError where no finer grid tells it, SolveError where one fails."""
    _prepare(grids)
    known = known_error(grids, cells)
    return replace(known, report={**known.report, **_on_the_way(grids, known)})


def _prepare(grids: Grids) -> float:
    return prepare_kernels(
        grids.on(coarsest_cells(grids.scene)),
        uses=(SOLVE, PROOFS) if isinstance(grids, Equilibria) else (SOLVE,),
    )


def _on_the_way(grids: Grids, choice: ChosenGrid) -> dict[str, Any]:
    """Time (s) when the two grids differ the most, and the spans (s) around jumps in which no error is known, of runs along time."""
    if not isinstance(grids, Runs) or not grids.scene.in_time:
        return {}
    coarse = choice.cells
    fine = choice.report["finer"]["cells_across"]
    distances = grids.distances(coarse, fine)
    spans = near_jumps(grids.frames[coarse], grids.frames[fine])
    words = [
        f"resolution: the error is not known from t = {first:.6g} to {last:.6g} s, around a jump of"
        " the path, which comes sooner or later on other grids; the error reported is that of the"
        " equilibria before and after"
        for first, last in spans
    ]
    return {
        "largest_at": max(distances, key=lambda t: distances[t]),
        "unknown": spans,
        "warnings": words,
    }


def needed_for(scene: Scene, cells: int) -> list[int]:
    """The finer grids, by their cells across, from which a grid's error is known."""
    return sorted({*INTERMEDIATE.get(cells, ()), proofs(scene)[cells]})


def notes_before(scene: Scene) -> list[str]:
    """Lines for the user before a run starts: that a tube will kink, and the cost of a requested error or of a motion's time step."""
    kink = kink_warning(scene)
    cost = cost_in_words(scene) if scene.resolution.requested else steps_in_words(scene)
    return [*([f"warning: {kink}"] if kink else []), *([cost] if cost else [])]


# largest stable step of a body, over the time that a pressure wave takes through a cell: 0.72 to
# 0.99 in bodies tried
BODY_STEP = 0.85


def steps_in_words(scene: Scene) -> str:
    """The time step of a motion, and how many of them it takes, by the stiffest material; "" for what is at rest."""
    options = scene.solver.dynamic
    if options is None:
        return ""
    used = dict.fromkeys(region.material_name for region in scene.regions())
    crossing = {name: scene.cell / _wave_speed(scene, name) for name in used}
    name = min(crossing, key=lambda one: crossing[one])
    step = options.safety * BODY_STEP * crossing[name]
    if options.time_step is not None:
        step = min(step, options.time_step)
    modulus = quantity(scene.materials[name].shear_modulus, "Pa")
    return (
        f"time steps of about {quantity(step, 's', 2)}, some"
        f" {significant(options.duration / step, 2)} for {quantity(options.duration, 's')} of"
        f" motion: a pressure wave crosses a cell ({length(scene.cell)}) of {name} (shear modulus"
        f" {modulus}) in {quantity(crossing[name], 's')}; larger cells, or less stiff or heavier"
        " material, take longer steps"
    )


def _wave_speed(scene: Scene, name: str) -> float:
    """Speed of pressure waves, m/s, in a material whose branches of viscosity have not relaxed."""
    material = scene.materials[name]
    assert material.density is not None  # a motion needs it: scene.rules
    bulk = material.bulk_to_shear * material.shear_modulus
    return pressure_wave_speed(
        material.shear_modulus + instant_modulus(scene), bulk, material.density
    )


def cost_in_words(scene: Scene) -> str:
    """The cost of knowing the error; "" for equilibria, which take a second or two."""
    grids = grids_of(scene)
    first = first_cells(scene)
    if not isinstance(grids, Runs):
        return ""
    *others, last = needed_for(scene, first)
    return (
        f"to know its error, the whole {'motion' if scene.solver.dynamic else 'path'} is run on"
        f" {', '.join(map(str, [first, *others]))} and {last} cells across: about"
        f" {grids.times(first):.2g} times as long as on {first} alone"
    )
