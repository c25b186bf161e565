"""Equilibria along time: `follow` finds one after the other, and writes each as a frame.

The load of each is that of its time: the field by its schedule, weight in full, and the length that feed has pushed out of its guide. What
moves is so slow that inertia and losses do not matter. statics.branch finds each equilibrium from the one before, and says where a branch
ends.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.dynamics import energies
from magmpm.dynamics.checkpoint import Checkpoint, motion_hash
from magmpm.effects import acting
from magmpm.errors import SolveError
from magmpm.model import Model, build
from magmpm.results.file_names import JUMPS, STEPS, forget_motion
from magmpm.results.motion_tables import GrowingTable
from magmpm.results.path_tables import jump_in_words, path_row
from magmpm.results.strain import Strain, strain_of
from magmpm.results.trajectory import MotionWriter
from magmpm.scene import Scene
from magmpm.statics import axis
from magmpm.statics.axis_order import arranged
from magmpm.statics.branch import Branch, Jump, Reached
from magmpm.statics.energy import Point
from magmpm.statics.equilibrium import Equilibrium, one_blas_thread, restored, solve_static
from magmpm.statics.layout import StaticModel, static_model

FORMULATION = "quasi_static"
Progress = Callable[[float, int], None]


class FieldLoads:
    """The load of a body that stays where it is: only the field changes. statics.branch.Loads."""

    def __init__(self, scene: Scene, time: float) -> None:
        self.model = static_model(build(scene, time=time))
        self._arranged, self.of = arranged(self.model)

    def at(self, time: float) -> StaticModel:
        """The model, with its axes as the solve needs them, under the load of a time, s."""
        named = acting.collect(self.model.scene, times=np.array([time]))
        return replace(self._arranged, effects=named, time=time)

    def carried(self, grid: Array, before: float, after: float) -> Array:
        """The same coefficients: the grid stays."""
        return grid


@dataclass
class PathState:
    """What is known along a path of equilibria.

    loads: the path; branch: its last equilibrium; frame: number of the last; iterations: Newton steps so far; rows: what is known of each
    equilibrium (keys of `steps` in a Result); jumps: of each jump; warnings; strain: the worst of all.
    """

    loads: FieldLoads
    branch: Branch
    frame: int = 0
    iterations: int = 0
    rows: list[dict[str, Any]] = field(default_factory=list)
    jumps: list[dict[str, Any]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    strain: Strain = field(default_factory=Strain)

    @property
    def time(self) -> float:
        """Of the last equilibrium, s."""
        return self.branch.now.time

    @property
    def model(self) -> StaticModel:
        """The model under the load of the last equilibrium, in its own axes."""
        return replace(self.loads.model, time=self.time)

    @property
    def equilibrium(self) -> Equilibrium:
        """The last equilibrium, with particles in the order of the model."""
        point = self.branch.now.point
        found = Equilibrium(point, self.branch.now.iterations, True, np.zeros_like(point.grid))
        return restored(self.branch.loads.at(self.time), found, self.loads.of)


def begin(scene: Scene, saved: Checkpoint | None = None, on_step: Callable[[int, float], None] | None = None) -> PathState:
    """The first equilibrium, found as statics finds one; or the one of a checkpoint. Raises SolveError, InputError."""
    options = scene.solver.static
    first = scene.path_times()[0] if saved is None else saved.time
    loads = FieldLoads(scene, first)
    kind: dict[str, Any] = {"tolerance": options.tolerance, "max_steps": options.max_steps, "on_step": on_step}
    if saved is None:
        found = solve_static(loads.model, on_step=on_step)
        branch = Branch(loads, Reached(first, found.point, None, found.steps, np.inf), **kind)
        with one_blas_thread():
            branch.settle_in(found.point.grid)
        state = PathState(loads, branch, iterations=found.steps, warnings=found.warnings)
        _note(state)
        return state
    branch = Branch.restored(loads, saved.state, saved.control["branch"], **kind)
    more = saved.control
    return PathState(
        loads, branch, saved.frame, saved.steps, more["rows"], more["jumps"], more["warnings"], Strain.restored(more["strain"])
    )


def follow(
    scene: Scene,
    *,
    folder: Path | str | None = None,
    resume: bool = False,
    on_progress: Progress | None = None,
    on_step: Callable[[int, float], None] | None = None,
) -> PathState:
    """All equilibria of a scene's path.

    folder: where to write frames, tables and checkpoints (default: nowhere); resume: continue from the folder's checkpoint;
    on_progress(time in s, Newton steps so far): called after each equilibrium.
    Raises InputError before the first equilibrium. Raises SolveError where the path can't go on: its `state` is the last PathState,
    which is on disk too.
    """
    saved = Checkpoint.load(folder, scene) if folder is not None and resume else None
    times = scene.path_times()
    state = begin(scene, saved, on_step)
    files = None if folder is None else _Files(state, folder, saved)
    if saved is None and files is not None:
        files.write(state, ())
    for time in times[state.frame + 1 :]:
        try:
            with one_blas_thread():
                jumps = state.branch.advance(time)
            state.frame += 1
            state.iterations += state.branch.now.iterations
            state.jumps += (found := [_told(scene, state, jump) for jump in jumps])
            _note(state)
            if files is not None:
                files.write(state, found)
        except SolveError as error:
            raise type(error)(f"equilibrium at t = {time:.6g} s: {error.reason}", state) from None
        if on_progress is not None:
            on_progress(time, state.iterations)
    return state


def _note(state: PathState) -> None:
    """Add the last equilibrium to what is known."""
    model, now = state.model, state.equilibrium
    point = now.point
    state.strain = state.strain.worst(strain_of(model, point.position, point.F, state.time))
    state.rows.append(
        {
            "time": state.time,
            "tip": [float(x) for x in tip_of(model, point)],
            "field": [float(b) for b in field_at(model, point.position)],
            "energy": point.energy,
            "stability": state.branch.stability,
            "min_det_F": point.min_det_F,
            "max_det_F": point.max_det_F,
            "iterations": state.branch.now.iterations,
        }
    )


def tip_of(model: StaticModel, point: Point) -> Array:
    """Position (3,) m of the far end of a straight body, or the mean of the last part of any other."""
    if model.line is not None:
        return axis.tip(model, point.grid)
    last = model.particles.segment == model.particles.segment.max()
    return np.asarray(np.average(point.position[last], axis=0, weights=model.particles.volume[last]))


def field_at(model: Model, position: Array) -> Array:
    """The outside field (3,) T at the center of a body at positions (n, 3) m, at the model's time."""
    if not model.scene.effects.in_a_field:
        return np.zeros(3)
    center = model.particles.volume @ position / model.particles.volume.sum()
    return np.asarray(model.scene.outside_field().at(center, model.time)[0])


def _told(scene: Scene, state: PathState, jump: Jump) -> dict[str, Any]:
    """A jump as results tell it."""
    model = replace(state.model, time=jump.time)
    field = field_at(model, state.equilibrium.point.position)
    told = {**vars(jump), "field": float(np.linalg.norm(field))}
    state.warnings.append(jump_in_words(told))
    return told


class _Files:
    """Frames, tables and checkpoints of a path in a folder."""

    def __init__(self, state: PathState, folder: Path | str, saved: Checkpoint | None) -> None:
        self.folder, self.scene = Path(folder), state.model.scene
        self.steps, self.jumps = GrowingTable(self.folder / STEPS), GrowingTable(self.folder / JUMPS)
        self._hash = motion_hash(self.scene)
        options = self.scene.solver.quasi_static
        most = None if options is None else options.max_disk
        if saved is None:
            forget_motion(folder)
            self.frames = MotionWriter(folder, state.model, max_disk=most)
        else:
            self.frames = MotionWriter(folder, state.model, max_disk=most, resume_at=saved.time, resume_frames=saved.frame + 1)
            for table in (self.steps, self.jumps):
                table.cut(saved.time)

    def write(self, state: PathState, jumps: Any) -> None:
        """The last equilibrium, the jumps on the way to it, and the state from which the path goes on."""
        model, point, named = state.model, state.equilibrium.point, acting.collect(self.scene, times=state.model.times)
        elastic, stress = energies.elastic(model, point.F, True)
        acting.refresh(named, model, point.position, point.F)
        energies.add_effects_stress(model, point.position, point.F, named, stress)
        parts = energies.effect_energies(model, point.position, point.F, state.time)
        still = np.zeros_like(point.position)
        known = {"kinetic": 0.0, "elastic": elastic, **parts}
        self.frames.frame(state.time, point.position, still, point.F, stress, known, {}, field_at(model, point.position))
        self.steps.add(path_row(state.rows[-1]))
        for jump in jumps:
            self.jumps.add(path_row(jump))
        self._checkpoint(state).save(self.folder)

    def _checkpoint(self, state: PathState) -> Checkpoint:
        arrays, numbers = state.branch.state()
        more = {"branch": numbers, "rows": state.rows, "jumps": state.jumps, "warnings": state.warnings, "strain": state.strain.state()}
        return Checkpoint(
            scene_hash=self._hash, every=0.0, time=state.time, formulation=FORMULATION,
            frame=state.frame, steps=state.iterations, control=more, state=arrays,
        )  # fmt: skip
