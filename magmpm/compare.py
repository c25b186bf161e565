"""Compare runs: how far apart two are (`distance`), how wrong a scene's grid is (`error`), what an effect does (`influence`).

Straight bodies are compared along their axes at equal arc length, parts at the centers of their regions, both in all frames.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from magmpm.bodies.curves import on_rows
from magmpm.compiled.arrays import Array
from magmpm.effects.base import Effect
from magmpm.errors import InputError, MagmpmError, SolveError, report
from magmpm.model import build
from magmpm.precompile import PROOFS, SOLVE, prepare_kernels
from magmpm.results.result import Result
from magmpm.results.trajectory import Motion
from magmpm.rod.advice import Judgment, allowed_error, nearest, reason, unknown, variants, verdict
from magmpm.rod.shifts import Shift
from magmpm.scene import Scene, load_scene, memory
from magmpm.scene.coarsest import coarsest_cells
from magmpm.solve import measured, solve
from magmpm.statics.error_estimate import PROOF, WITNESS
from magmpm.statics.grids import PARTICLE, STATIONS, Equilibria, Grids, OnStep, Solved, operations, particles
from magmpm.statics.resolution import ChosenGrid, choose, known_error

FRAMES = 25  # of a motion with and without an effect


@dataclass
class Frames:
    """What is compared of a run: of each frame its time (s), points (m, 3) m and tip (3,) m; and the times (s) of jumps of a path."""

    times: list[float] = field(default_factory=list)
    points: list[Array] = field(default_factory=list)
    tips: list[Array] = field(default_factory=list)
    jumps: list[float] = field(default_factory=list)

    def see(self, time: float, axis: Array, tip: Array, centers: Array) -> None:
        """Add a frame (solve.OnFrame)."""
        along = np.linspace(0.0, axis[-1, 0], STATIONS) if len(axis) else None
        self.times.append(time)
        self.points.append(centers.copy() if along is None else on_rows(axis[:, 0], axis[:, 1:], along)[0])
        self.tips.append(np.array(tip))

    def distances(self, other: Frames, of: str = "centreline", skip: list[tuple[float, float]] | None = None) -> dict[float, float]:
        """The largest distance (m) in each frame that both have, by its time (s); spans of time (s) to `skip` are left out."""
        mine, theirs = (one.tips if of == "tip" else one.points for one in (self, other))
        return {
            t: float(np.linalg.norm(np.atleast_2d(a - b), axis=1).max())
            for t, a, b in zip(self.times, mine, [theirs[other.times.index(t)] if t in other.times else None for t in self.times])
            if b is not None and not any(first <= t <= last for first, last in skip or ())
        }  # fmt: skip


def frames_of(run: Result | Motion) -> Frames:
    """The frames of a saved motion or path; of a Result its end alone."""
    frames = Frames()
    if isinstance(run, Result):
        frames.see(run.time, run.centreline, run.tip, run.segment_center)
        return frames
    scene = Scene.from_si(run.scene or {})
    model = build(scene, time=0.0 if scene.static else None)
    for k, t in enumerate(run.times):
        frames.see(float(t), *measured(model, np.asarray(run.position(k), dtype=float)))
    return frames


def distance(one: Result | Motion, other: Result | Motion, *, of: str = "centreline") -> float:
    """The largest distance (m) between two runs of the same body, over all frames of two Motions, or at the end where one is a Result.

    of: centreline, at equal shares of the arc length (parts: between centers of regions); or tip. Raises ValueError where they have no
    time in common or another number of parts.
    """
    first, second = frames_of(one), frames_of(other)
    if isinstance(one, Result) or isinstance(other, Result):
        first, second = (Frames([0.0], frames.points[-1:], frames.tips[-1:]) for frames in (first, second))
    apart = first.distances(second, of)
    if not apart:
        raise ValueError("the two runs have no frame of the same time: give them the same duration and output_every, or steps")
    return max(apart.values())


class Runs(Grids):
    """Whole runs on several grids: along time, or of bodies that are not straight. results and frames by cells across."""

    def __init__(self, asked: Scene, on_step: OnStep | None = None) -> None:
        super().__init__(asked, on_step)
        self.results: dict[int, Result] = {}
        self.frames: dict[int, Frames] = {}
        self.mute: dict[str, Effect] = {}  # effects that the scene does not name, but whose kernels are used

    def solve(self, cells: int) -> None:
        """Run the scene, if it has not been."""
        if cells in self.solved:
            return
        begun, frames = time.perf_counter(), Frames()
        scene = self.on(cells)
        scene = scene.model_copy(update={"effects": scene.effects.model_copy(update={k: muted(e) for k, e in self.mute.items()})})
        result = solve(scene, on_progress=self.on_step, on_frame=frames.see)
        if not frames.times:
            frames = frames_of(result)
        frames.jumps = [jump["time"] for jump in result.jumps]
        seconds = time.perf_counter() - begun - result.seconds["compile"]
        moved = float(np.abs(result.particle_position - result.particle_reference).max())
        self.results[cells], self.frames[cells] = result, frames
        self.solved[cells] = Solved(cells, True, seconds, result.iterations, result.dof, result.centreline, result.tip, moved)

    def prove(self, cells: int, against: int) -> None:
        """Run the scene."""
        self.solve(cells)

    def apart(self, coarse: int, fine: int) -> float:
        """The largest distance (m) in any frame that is not near a jump of the path."""
        return max(self.distances(coarse, fine).values(), default=math.inf)

    def distances(self, coarse: int, fine: int) -> dict[float, float]:
        """The largest distance (m) in each frame but those near a jump, by its time (s)."""
        one, other = self.frames[coarse], self.frames[fine]
        return one.distances(other, self.asked.resolution.of, near_jumps(one, other))

    def takes(self, cells: int, proof: bool) -> float:
        """Seconds, from those of the finest grid that was run."""
        last = max(self.solved)
        return self.solved[last].seconds * work(self.on(cells)) / work(self.on(last))

    def size(self, cells: int) -> float:
        """Bytes of the matrix, or of particles and grid."""
        scene = self.on(cells)
        return operations(scene)[1] if scene.static else memory.BYTES * memory.fewest_particles(scene)

    @property
    def algebraic(self) -> float:
        """What the solves of equilibria leave, m."""
        return super().algebraic if self.asked.static else 0.0


def near_jumps(one: Frames, other: Frames) -> list[tuple[float, float]]:
    """Spans of time (s) in which two grids of a path may be on different branches: from jump to jump, and as long before and after, since
    the true jump is not farther from theirs than they are from each other, about (statics.error_estimate)."""
    pairs = [(min(a, b), max(a, b)) for a, b in zip(one.jumps, other.jumps)]
    return [(2 * first - last, 2 * last - first) for first, last in pairs]


def work(scene: Scene) -> float:
    """Multiply-adds of a Newton step; of a motion particles times steps, both in units of their own."""
    if scene.static:
        return operations(scene)[0] + PARTICLE * particles(scene)
    return particles(scene) * scene.resolution.cells_across


def grids_of(scene: Scene) -> Grids:
    """How a scene is solved on several grids: equilibria of straight bodies from each other, all else by whole runs."""
    return Runs(scene) if scene.in_time or scene.body.shape.line is None else Equilibria(scene)


def choose_grid(grids: Grids, on_step: OnStep | None = None, extra: Callable[[int], float] | None = None) -> tuple[ChosenGrid, float]:
    """The grid for the error or the time that a scene asks for (statics.resolution.choose), and the seconds its kernels took to load."""
    compiled = _prepare(grids)
    choice = choose(grids, on_step, extra or (lambda cells: 0.0))
    return replace(choice, report={**choice.report, **_on_the_way(grids, choice)}), compiled


def _prepare(grids: Grids) -> float:
    return prepare_kernels(grids.on(coarsest_cells(grids.asked)), uses=(SOLVE, PROOFS) if isinstance(grids, Equilibria) else (SOLVE,))


def _on_the_way(grids: Grids, choice: ChosenGrid) -> dict[str, Any]:
    """Of what runs along time: when (s) the two grids differ the most, and the spans (s) around jumps in which no error is known."""
    if not isinstance(grids, Runs) or not grids.asked.in_time:
        return {}
    coarse, fine = choice.cells, choice.report["finer"]["cells_across"]
    apart, spans = grids.distances(coarse, fine), near_jumps(grids.frames[coarse], grids.frames[fine])
    words = [
        f"resolution: the error is not known from t = {first:.6g} to {last:.6g} s, around a jump of the path, which comes sooner or later "
        "on other grids; the error reported is that of the equilibria before and after"
        for first, last in spans
    ]
    return {"largest_at": max(apart, key=lambda t: apart[t]), "unknown": spans, "warnings": words}


@dataclass(frozen=True)
class GridError:
    """error: bound (m) of the discretization error, anywhere on the axis and in any frame (parts: at their centers); report: as
    `Result.resolution`, with the grids, their seconds, the order seen, and the finer answer."""

    error: float
    report: dict[str, Any]

    def __repr__(self) -> str:
        """The error, and from which grids it is known."""
        grids = f"{self.report['cells_across']} cells across, known from {self.report['finer']['cells_across']}"
        return f"GridError(at most {1e3 * self.error:.3g} mm, {100 * self.report['error_of_length']:.2g} % of the length: {grids})"


def error(scene: Scene | Path | str) -> GridError:
    """Bound the error that a scene's grid leaves in its answer: its equilibrium, its path or its motion, whatever acts on it.

    The scene is run on its grid and on a finer one, and bodies on 2 cells on one between (statics.error_estimate). Where it asks for an
    error or a time, this is the error of the grid that a run would choose. Raises as `run`.
    """
    scene = scene if isinstance(scene, Scene) else load_scene(scene)
    grids = grids_of(scene)
    if scene.resolution.asked:
        choice = choose_grid(grids)[0]
    else:
        _prepare(grids)
        choice = known_error(grids, scene.resolution.cells_across)
        choice = replace(choice, report={**choice.report, **_on_the_way(grids, choice)})
    return GridError(choice.error, choice.report)


def cost_in_words(scene: Scene) -> str:
    """What knowing the error will cost, said before it starts; "" for equilibria, which take a second or two."""
    grids, first = grids_of(scene), coarsest_cells(scene)
    if not isinstance(grids, Runs):
        return ""
    others = sorted({*WITNESS.get(first, ()), PROOF[first]})
    times = 1.0 + sum(work(grids.on(n)) / work(grids.on(first)) for n in others)
    return (
        f"to know its error, the whole {'motion' if scene.solver.dynamic else 'path'} is run on {first}, "
        f"{' and '.join(map(str, others))} cells across: about {times:.2g} times as long as on {first} alone"
    )


FAINT = 1e-30  # of a load or a setting: what it moves is below the last digit
NEVER_MUTED = ("magnetic_interaction", "self_contact", "feed")  # with them a scene is solved in another way, or held by another clamp
CLOSE = 2.0  # times the error, or its half: between the two a motion's shift is found again on a finer grid


def influence(scene: Scene | Path | str, effect: str | None = None) -> list[Judgment]:
    """Find what effects do to a scene's answer, named or not: one effect, or all of them; and what to do about each.

    The scene is run with and without each, on the coarsest grid: the shift is their distance, over all frames. One cell more tells its
    uncertainty; a motion is run again only where the advice depends on it. self_contact matters where the body would go through itself.
    Raises InputError for a name that is no effect; what can't be run has its reason in `why`.
    """
    scene = scene if isinstance(scene, Scene) else load_scene(scene)
    every = list(scene.effects.every())
    if effect is not None and effect not in every:
        raise InputError(report("effect", received=repr(effect), rule=f"must be one of {', '.join(every)}", remedy="leave it out for all"))
    trials = _Trials(scene)
    return [trials.judged(key) for key in ([effect] if effect else every)]


class _Trials:
    """Runs of a scene's variants, each once on a grid."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.error, self._found = scene, allowed_error(scene), dict[tuple[Any, int], Frames]()
        self.pairs = {key: variants(scene, key) for key in scene.effects.every()}
        sides = [side for pair in self.pairs.values() if not isinstance(pair, str) for side in pair]
        named: dict[str, Effect] = {key: effect for side in sides for key, effect in side.effects.named().items()}
        self._muted = {key: effect for key, effect in named.items() if key not in NEVER_MUTED}

    def judged(self, key: str) -> Judgment:
        """What one effect does."""
        pair, named = self.pairs[key], getattr(self.scene.effects, key) is not None
        if isinstance(pair, str):
            return Judgment(key, named, 0.0, 0.0, "drop" if named else "irrelevant", pair)
        cells = coarsest_cells(self.scene)
        try:
            if key == "self_contact":
                return verdict(self.scene, key, Shift(self._overlap(pair[1], cells), 0.1 * self.scene.thickness), self.error)
            moved = self._shift(pair, cells)
            close = self.error / CLOSE < moved < self.error * CLOSE
            unsure = abs(self._shift(pair, cells + 1) - moved) if close or self.scene.static else 0.0
        except SolveError as failed:
            return unknown(key, named, failed.reason)
        except MagmpmError as failed:
            return unknown(key, named, reason(failed))
        return verdict(self.scene, key, Shift(moved, unsure), self.error)

    def _shift(self, pair: tuple[Scene, Scene], cells: int) -> float:
        first, second = (self._frames(side, cells) for side in pair)
        return max(first.distances(second).values())

    def _overlap(self, without: Scene, cells: int) -> float:
        """How deep (m) a straight body would go through itself; 0 where it does not, and for parts."""
        if without.body.shape.line is None:
            return 0.0
        thickness = without.thickness
        return max(0.0, *(thickness - nearest(axis, thickness) for axis in self._frames(without, cells).points))

    def _frames(self, variant: Scene, cells: int) -> Frames:
        key = tuple(variant.effects.named().items()), cells
        if key not in self._found:
            grids = Runs(_with_few_frames(variant))
            grids.mute = {name: effect for name, effect in self._muted.items() if getattr(variant.effects, name) is None}
            grids.solve(cells)
            self._found[key] = grids.frames[cells]
        return self._found[key]


def _with_few_frames(scene: Scene) -> Scene:
    """A motion with a frame at each of FRAMES equal parts of its duration."""
    dynamic = scene.solver.dynamic
    if dynamic is None:
        return scene
    options = dynamic.model_copy(update={"output_every": dynamic.duration / FRAMES, "time_step": None})
    return scene.model_copy(update={"solver": scene.solver.model_copy(update={"dynamic": options})})


def muted(effect: Effect) -> Effect:
    """The effect without effect: kernels call its hooks, which add nothing. So one set of kernels serves a scene with and without it."""
    kind = type(effect)

    def records(self: Any, scene: Any, strength: float = 1.0, times: Array | None = None) -> Any:
        return kind.records(self, scene, FAINT * strength, times)

    silent = type(kind.__name__, (kind,), {"records": records, "__module__": kind.__module__})
    weak: dict[str, Any] = {name: FAINT for name in ("rate", "viscosity", "stiffness") if name in kind.model_fields}
    return silent.model_construct(**{**dict(effect), **weak})  # type: ignore[no-any-return,attr-defined]
