"""One scene on several grids, for the error of each or the coarsest that will do: straight bodies by statics.grids, others by runs."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from magmpm.compiled.arrays import Plain
from magmpm.effects.magnetic_torque import MU0
from magmpm.errors import (
    InputError,
    MagmpmError,
    SceneError,
    SolveError,
    length,
    quantity,
)
from magmpm.results.measures import Frames, frames_of, near_jumps
from magmpm.results.result import Result
from magmpm.results.strain import LARGE_STRETCH, REMEDY
from magmpm.rod.cantilever import kink_warning
from magmpm.scene import Scene, memory
from magmpm.scene.coarsest import coarsest_cells
from magmpm.solving.precompile import PROOFS, SOLVE, prepare_kernels
from magmpm.solving.solve import Progress, RunOptions, solve
from magmpm.statics.grids import (
    PARTICLE,
    Equilibria,
    Grids,
    Solved,
    left_by_solve,
    operations,
    with_other_blocks,
)
from magmpm.statics.newton import OnStep
from magmpm.statics.resolution import (
    LEAST_REACHABLE_ERROR,
    LONGEST_RUN,
    ChosenGrid,
    choose,
    first_cells,
    known_error,
    needed_for,
)


@dataclass(frozen=True)
class DoneRun:
    """A run that was done: its result, and its frames (of a single equilibrium that one); seconds it took, kernels apart."""

    result: Result
    frames: Frames
    seconds: float

    @property
    def moved(self) -> float:
        """Largest displacement of a particle along an axis, m."""
        result = self.result
        return float(np.abs(result.particle_position - result.particle_reference).max())

    def on(self, cells: int) -> Solved:
        """The run as that of a grid."""
        of = self.result
        return Solved(
            cells, True, self.seconds, of.iterations, of.dof, of.centreline, of.tip, self.moved
        )


class Runs(Grids):
    """Whole runs of a scene, and of others that differ from it, each done once: along time, or of bodies that are not straight."""

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        self.of: str = scene.resolution.of
        self._answers: dict[tuple[str, int], DoneRun | MagmpmError] = {}

    def answer(
        self,
        change: Scene | None = None,
        cells: int | None = None,
        on_progress: Progress | None = None,
    ) -> DoneRun:
        """The answer of the scene, or of a `change` of it, on its cells or on so many across; raises as a run does."""
        scene = self.scene if change is None else change
        across = scene.resolution.cells_across if cells is None else cells
        key = (scene.hash(), across)
        if key not in self._answers:
            try:
                self._answers[key] = _answered(self.made(scene, across), on_progress)
            except MagmpmError as failure:
                self._answers[key] = failure
        found = self._answers[key]
        if isinstance(found, MagmpmError):
            raise found
        if key[0] == self.scene.hash():
            self.solved.setdefault(across, found.on(across))
        return found

    def made(self, scene: Scene, cells: int) -> Scene:
        """The scene as it is run on so many cells across."""
        return scene.with_cells(cells)

    def solve(self, cells: int) -> None:
        """Run the scene, if it has not been."""
        begun = time.perf_counter()

        def tell(step: int, at: float) -> None:
            self._check_hopeful(cells, time.perf_counter() - begun, at)
            if self.on_step is not None:
                self.on_step(step, at)

        self.answer(cells=cells, on_progress=tell)

    def frames_on(self, cells: int, scenes: tuple[Scene, ...] | None = None) -> Frames:
        """Frames of the answer on so many cells across; scenes: in place of those that are compared."""
        (scene,) = self.scenes if scenes is None else scenes
        return self.answer(scene, cells).frames

    def left_by_blocks(self, cells: int) -> float:
        """Run the same grid with another number of blocks."""
        made = [with_other_blocks(self.made(scene, cells)) for scene in self.scenes]
        share = max(share for _, share in made)
        if share == 0.0:
            return 0.0
        others = tuple(other for other, _ in made)
        spans = [
            span
            for scene, other in zip(self.scenes, others, strict=True)
            for span in near_jumps(
                self.answer(scene, cells).frames, self.answer(other, cells).frames
            )
        ]
        here = self.frames_on(cells)
        there = self.frames_on(cells, others)
        return share * max(here.distances(there, self.of, spans).values(), default=math.inf)

    def times(self, cells: int) -> float:
        """Cost of a run on a grid together with its error, over that of the run alone."""
        more = sum(self.effort(n) for n in needed_for(cells, self.scene))
        return 1.0 + more / self.effort(cells)

    def _check_hopeful(self, cells: int, gone: float, at: float) -> None:
        """Raise SceneError at a time (s) of the first grid's motion, `gone` s after it began, if the error requested will take too long."""
        scene = self.scene
        allowed = scene.resolution.allowed(scene.length)
        if (
            self.solved
            or not scene.in_time
            or allowed is None
            or at <= 0.0
            or gone < 0.01 * LONGEST_RUN
        ):  # then the pace is known
            return
        alone = gone * scene.duration / at
        times = self.times(cells)
        if alone * times > LONGEST_RUN:
            raise SceneError(
                "resolution.error",
                received=f"{100 * allowed / scene.length:.3g} % of the length",
                rule=(
                    f"must be within reach of {LONGEST_RUN:g} s: a run on {cells} cells"
                    " across takes"
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
        spans = self.spans(coarse, fine)
        return self.frames_on(coarse).distances(self.frames_on(fine), self.of, spans)

    def spans(self, coarse: int, fine: int) -> list[tuple[float, float]]:
        """Spans of time (s) around jumps, in which two grids may be on different branches."""
        return [
            span
            for scene in self.scenes
            for span in near_jumps(
                self.answer(scene, coarse).frames, self.answer(scene, fine).frames
            )
        ]

    def effort(self, cells: int, steps: float = 1.0) -> float:
        """Multiply-adds of a Newton step; of a motion particles times steps, which are as many as the cells allow."""
        scene = self.on(cells)
        particles = memory.fewest_particles(scene)
        return operations(scene)[0] + PARTICLE * particles if scene.static else particles * cells

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


class Pair(Runs):
    """Two scenes on the same grids: the answer on each is the way from the other's points to the one's, frame by frame."""

    def __init__(self, one: Scene, other: Scene, cells: int | None, of: str) -> None:
        """cells: across both, None: their own; of: centreline or tip. Raises InputError where they can't be compared."""
        super().__init__(_on_cells(one, cells))
        self.other = _on_cells(other, cells)
        self.of = of
        _check_comparable(self.scene, self.other, of)

    @property
    def scenes(self) -> tuple[Scene, ...]:
        return self.scene, self.other

    def solve(self, cells: int) -> None:
        """Run both scenes. Raises SolveError that says which of them failed."""
        for word, scene in zip(("first", "second"), self.scenes, strict=True):
            try:
                self.answer(scene, cells)
            except SolveError as error:
                where = f"the {word} scene on {cells} cells across"
                raise type(error)(f"{where}: {error.reason}", error.state) from None
        super().solve(cells)

    def frames_on(self, cells: int, scenes: tuple[Scene, ...] | None = None) -> Frames:
        compared = self.scenes if scenes is None else scenes
        one, other = (self.answer(scene, cells).frames for scene in compared)
        return one.minus(other)

    def apart(self, cells: int, finer: int) -> dict[float, float]:
        """The largest distance (m) of the two answers on `cells` in each frame, by its time (s), but near jumps."""
        found = self.frames_on(cells).sizes(self.of, self.spans(cells, finer))
        if not found:
            raise SolveError("the answers can't be compared: all frames are near a jump of a path")
        return found

    @property
    def algebraic(self) -> float:
        """Error that the solves of both leave, m: of equilibria LEAST_REACHABLE_ERROR of the length at least."""
        if not self.scene.static:
            return 0.0
        cells = next(iter(self.solved))
        return sum(
            max(
                left_by_solve(scene, self.answer(scene, cells).moved),
                LEAST_REACHABLE_ERROR * scene.length,
            )
            for scene in self.scenes
        )


def _answered(scene: Scene, on_progress: Progress | None) -> DoneRun:
    """Run a scene."""
    begun = time.perf_counter()
    frames = Frames()
    result = solve(scene, RunOptions(on_progress=on_progress, on_frame=frames.see))
    if not frames.times:
        frames = frames_of(result)
    frames.jumps = [jump["time"] for jump in result.jumps]
    return DoneRun(result, frames, time.perf_counter() - begun - result.seconds["compile"])


def _on_cells(scene: Scene, cells: int | None) -> Scene:
    """A scene on its cells, or on these. Raises InputError."""
    if cells is not None:
        return scene.with_cells(cells)
    parts = scene.body.parts
    if scene.resolution.requested or (parts is not None and parts.spacing is not None):
        raise SceneError(
            "resolution",
            found=f"{scene.name} gives no cells_across",
            rule="scenes are compared on grids of as many cells across",
            remedy="give the cells: magmpm.compare(a, b, cells=4)",
        )
    return scene


def _check_comparable(one: Scene, other: Scene, of: str) -> None:
    """Raises InputError where no point of one answer has a partner in the other."""
    across = [scene.resolution.cells_across for scene in (one, other)]
    if across[0] != across[1]:
        raise InputError(
            "cells",
            received=f"scenes of {across[0]} and {across[1]} cells across",
            rule="scenes are compared on grids of as many cells across",
            remedy="give them: magmpm.compare(a, b, cells=4); what the grid does, magmpm.error(a)",
        )
    if one.in_time != other.in_time:
        raise InputError(
            "solver",
            received="an equilibrium and a run along time",
            rule="frames have partners at the same time, and an equilibrium has none",
            remedy="give both a solver of one kind, or compare their ends: magmpm.runs.distance",
        )
    if not math.isclose(one.duration, other.duration, rel_tol=1e-9):
        raise InputError(
            "solver",
            received=f"runs of {one.duration:g} s and {other.duration:g} s",
            rule="frames are compared at the same time, so both runs end together",
            remedy="give both the same duration",
        )
    names = [
        [region.name for region in scene.regions()] if scene.body.shape.line is None else None
        for scene in (one, other)
    ]
    if names[0] != names[1]:
        raise InputError(
            "body",
            received=f"{_compared_by(names[0])} and {_compared_by(names[1])}",
            rule="each point needs its partner: the axis of straight bodies, parts by their names",
            remedy="compare bodies of one kind, parts of the same names in the same order",
        )
    if of not in ("centreline", "tip"):
        raise InputError(
            "of", received=repr(of), rule="is centreline or tip", remedy='leave it out, or of="tip"'
        )
    tips = [scene.body.parts is None or scene.body.parts.tip is not None for scene in (one, other)]
    if tips[0] != tips[1] or (of == "tip" and not tips[0]):
        raise InputError(
            "body.parts.tip",
            received="nothing",
            rule="the tip of parts is compared where both scenes name one",
            remedy="name the same part or point in both, say `tip: arm` in body.parts",
        )


def _compared_by(names: list[str] | None) -> str:
    """Points that a body is compared by, in words."""
    return "a straight body" if names is None else f"parts {', '.join(names)}"


def grids_of(scene: Scene) -> Grids:
    """Grids on which a scene is solved: equilibria of straight bodies from each other, all else by whole runs. Raises SceneError."""
    parts = scene.body.parts
    across = scene.resolution.cells_across
    if parts is not None and not math.isclose(parts.cell_size(across), parts.thickness / across):
        cells = max(2, round(parts.thickness / parts.cell_size(across)))
        raise SceneError(
            "body.parts.spacing",
            received=length(parts.cell_size(across)),
            rule="an error needs `cells_across`, which `spacing` replaces",
            remedy=f"leave it out, and write `resolution: {{cells_across: {cells}}}`, or an error",
        )
    return Runs(scene) if scene.in_time or scene.body.shape.line is None else Equilibria(scene)


def choose_grid(
    grids: Grids, on_step: OnStep | None = None, extra: Callable[[int], float] = lambda cells: 0.0
) -> tuple[ChosenGrid, float]:
    """The grid for the error or the time that a scene requests (statics.resolution.choose), and the seconds its kernels took to load."""
    compiled = _prepare(grids)
    choice = choose(grids, on_step, extra)
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


def _on_the_way(grids: Grids, choice: ChosenGrid) -> Plain:
    """Time (s) when the two grids differ the most, and the spans (s) around jumps in which no error is known, of runs along time."""
    if not isinstance(grids, Runs) or not grids.scene.in_time:
        return {}
    coarse = choice.cells
    fine = choice.report["finer"]["cells_across"]
    distances = grids.distances(coarse, fine)
    spans = grids.spans(coarse, fine)
    words = [
        f"resolution: the error is not known from t = {first:.6g} to {last:.6g} s, around a jump of"
        " the path, which comes sooner or later on other grids; the error reported is that of the"
        " equilibria before and after"
        for first, last in spans
    ]
    return {
        "largest_at": max(distances, key=distances.__getitem__),
        "unknown": spans,
        "warnings": words,
    }


def overloaded(scene: Scene) -> list[str]:
    """Warn, before a body at rest is solved, of materials that its loads stretch beyond what the law describes, whatever its shape.

    A fiber of neo-Hookean material that keeps its volume bears the stress G (l - 1/l^2) at a stretch l. Along the field a magnet has the
    stress B Br/mu0; the weight of a body that hangs is rho g L at its upper end.
    """
    effects = scene.effects
    field = 0.0 if effects.magnetic_torque is None else math.hypot(*scene.field.uniform)
    pull = 0.0
    if effects.gravity is not None and effects.fluid is None:  # where nothing buoys it up
        pull = scene.length * math.hypot(*effects.gravity.acceleration)
    moving = {region.material_name for region in scene.regions() if not region.held}
    found = []
    for name in sorted(moving) if scene.static else ():
        material = scene.materials[name]
        load = max(field * material.remanence / MU0, pull * (material.density or 0.0))
        if load > material.shear_modulus * (LARGE_STRETCH - LARGE_STRETCH**-2):
            found.append(
                f"materials.{name}: the loads ({quantity(load, 'Pa', 2)}) stretch a shear modulus"
                f" of {quantity(material.shear_modulus, 'Pa')} to more than {LARGE_STRETCH:g} times"
                f" its length, and the solve may be slow and fail; {REMEDY}"
            )
    return found


def notes_before(scene: Scene) -> list[str]:
    """Lines for the user before a run starts: wrong units, a tube that will kink, the cost of a requested error."""
    too_much = overloaded(scene)
    kink = None if too_much else kink_warning(scene)
    cost = cost_in_words(scene) if scene.resolution.requested else ""
    return [*[f"warning: {one}" for one in (*too_much, kink) if one], *([cost] if cost else [])]


def cost_in_words(scene: Scene) -> str:
    """The cost of knowing the error; "" for equilibria, which take a second or two."""
    grids = grids_of(scene)
    first = first_cells(scene)
    if not isinstance(grids, Runs):
        return ""
    *others, last = needed_for(first, scene)
    return (
        f"to know its error, the whole {'motion' if scene.solver.dynamic else 'path'} is run on"
        f" {', '.join(map(str, [first, *others]))} and {last} cells across: about"
        f" {grids.times(first):.2g} times as long as on {first} alone"
    )
