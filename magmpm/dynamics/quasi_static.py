"""Equilibria along time: `follow` finds one after the other, and writes each as a frame.

The load of each is that of its time: the field by its schedule, weight in full, and the length that feed has pushed out of its guide. It
moves so slowly that inertia and losses do not matter. statics.branch finds each equilibrium from the last, and says where a branch ends.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Plain
from magmpm.compiled.thread_count import one_blas_thread
from magmpm.dynamics import energies
from magmpm.dynamics.checkpoint import Checkpoint, motion_hash
from magmpm.dynamics.path_loads import EquilibriumShape, FeedLoads, FieldLoads
from magmpm.effects import acting
from magmpm.effects.contact_law import springs
from magmpm.errors import SolveError
from magmpm.results.file_names import JUMPS, STEPS, forget_motion
from magmpm.results.measures import region_means
from magmpm.results.motion_tables import GrowingTable, jump_in_words, path_row
from magmpm.results.strain import Strain, strain_of
from magmpm.results.trajectory import Instant, MotionWriter
from magmpm.scene import Scene
from magmpm.statics.branch import SHORTEST_ARC, EquilibriumPath, Jump, Reached, point_of
from magmpm.statics.contact import Held, contacts_at_rest
from magmpm.statics.equilibrium import Equilibrium
from magmpm.statics.own_contact import HeldPairs

Progress = Callable[[float, int], None]


@dataclass
class PathState:
    """State of a path of equilibria.

    loads: the path; branch: its last equilibrium; frame: number of the last; iterations: Newton steps so far; rows: what is known of each
    equilibrium (keys of `steps` in a Result); jumps: of each jump; warnings; strain: the worst of all; load_share: of the load that
    `branch` carries: less than 1 (and no rows) where the first equilibrium was not found.
    """

    loads: FieldLoads | FeedLoads
    time: float  # of the last equilibrium, s
    branch: EquilibriumPath | None = None  # None: all of the body is in its guide
    frame: int = 0
    iterations: int = 0
    rows: list[Plain] = field(default_factory=list)
    jumps: list[Plain] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    strain: Strain = field(default_factory=Strain)
    load_share: float = 1.0

    @property
    def shape(self) -> EquilibriumShape:
        """The body at the last equilibrium."""
        return self.loads.shape(self.time, None if self.branch is None else self.branch.now.point)

    @property
    def energy(self) -> float:
        """Energy of the last equilibrium, J, as statics counts it."""
        return 0.0 if self.branch is None else self.branch.now.point.energy


def loads_of(scene: Scene, time: float) -> FieldLoads | FeedLoads:
    """The loads of a scene's path that begins at a time, s."""
    return FieldLoads(scene, time) if scene.effects.feed is None else FeedLoads(scene, time)


def begin(scene: Scene, saved: Checkpoint | None = None) -> PathState:
    """The first equilibrium, found as statics finds one; or the one of a checkpoint. Raises SolveError, InputError."""
    if saved is None:
        first = scene.path_times()[0]
        state = PathState(loads_of(scene, first), first)
        try:
            _note(state, _go_on(state, first))
        except SolveError as error:
            raise type(error)(
                f"equilibrium at t = {first:.6g} s: {error.reason}", _unbegun(state, error.state)
            ) from None
        return state
    loads = loads_of(scene, scene.path_times()[0])
    more = saved.control
    if "held_grip" in saved.state:
        loads.held = Held(*(saved.state[f"held_{name}"] for name in Held._fields))
    if "pairs_key" in saved.state:
        loads.held_pairs = HeldPairs.restored(saved.state)
    branch = None
    if more["branch"]:
        with one_blas_thread():
            branch = EquilibriumPath.restored(loads, saved.state, more["branch"], **_options(scene))
    known = PathState(
        loads,
        saved.time,
        branch,
        saved.frame,
        saved.steps,
        more["rows"],
        more["jumps"],
        more["warnings"],
    )
    return replace(known, strain=Strain.restored(more["strain"]))


def _unbegun(state: PathState, last: object) -> PathState | None:
    """A path whose first equilibrium was not found: the last good state of its ramp of the load, if there is one."""
    if not isinstance(last, Equilibrium):
        return None
    loads = state.loads
    point = replace(point_of(loads.at(state.time), last.point.grid), energy=last.point.energy)
    state.branch = EquilibriumPath(
        loads, Reached(state.time, point, None, last.steps, np.inf), **_options(loads.whole.scene)
    )
    state.iterations = last.steps
    state.load_share = last.load_share
    state.warnings += last.warnings
    shape = state.shape
    state.strain = strain_of(shape.model, shape.position, shape.F, state.time)
    return state


def _options(scene: Scene) -> Plain:
    return {"tolerance": scene.solver.static.tolerance, "max_steps": scene.solver.static.max_steps}


def _go_on(state: PathState, time: float) -> list[Jump]:
    """Go on to a time, s. Returns the jumps on the way. Raises SolveError."""
    loads = state.loads
    jumps = []
    scene = loads.whole.scene
    if not loads.bends(time):
        state.branch = None
    elif state.branch is None:
        found = loads.first(time)
        state.branch = EquilibriumPath(
            loads, Reached(time, found.point, None, found.steps, np.inf), **_options(scene)
        )
        with one_blas_thread():
            state.branch.settle_in(found.point.grid)
        state.warnings += found.warnings
        loads.hold(time, state.branch.now.point)
    else:
        with one_blas_thread():
            jumps = increments(state.branch, loads, time)
    state.time = time
    state.iterations += 0 if state.branch is None else state.branch.now.iterations
    return jumps


def increments(branch: EquilibriumPath, loads: FieldLoads | FeedLoads, time: float) -> list[Jump]:
    """Go on to a time (s) in one increment of friction, or where that does not converge in shorter ones. Raises SolveError.

    Each is half as long as the one that failed, down to SHORTEST_ARC of the whole, and twice as long as the one that did not.
    """
    jumps = list[Jump]()
    way = time - branch.now.time
    shortest = SHORTEST_ARC * way
    spent = 0
    while branch.now.time < time:
        begun = branch.now
        before = branch.before
        held = loads.held
        held_pairs = loads.held_pairs
        left = time - begun.time
        found = _increment(branch, loads, time if way >= left else begun.time + way)
        spent += branch.now.iterations
        if found is not None:
            jumps += found
            way = 2.0 * way
            continue
        way = 0.5 * min(way, left)
        branch.now = replace(begun, step=min(begun.step, way))
        branch.before = before
        loads.held = held
        loads.held_pairs = held_pairs
        if way < shortest:
            raise SolveError(
                "the body slips: it has no equilibrium with friction near the last one, at t = "
                f"{begun.time:.4g} s; remedy: simulate the motion, "
                "`solver: {dynamic: {duration: 0.5 s}}`"
            )
    branch.now = replace(branch.now, iterations=spent)
    return jumps


def _increment(
    branch: EquilibriumPath, loads: FieldLoads | FeedLoads, time: float
) -> list[Jump] | None:
    """`EquilibriumPath.advance`, and again at its end until friction holds the body as strongly as this presses it; None where it can't."""
    # solves of an equilibrium with friction, which settles by a factor of two or more each
    most_tries = 50
    loads.let_slide(branch.now.point)
    jumps = branch.advance(time)
    for _ in range(most_tries):
        if not loads.hold(time, branch.now.point):
            return jumps
        if not branch.settle():
            return None
    return None


def follow(
    scene: Scene,
    *,
    folder: Path | str | None = None,
    resume: bool = False,
    on_progress: Progress | None = None,
    on_state: Callable[[PathState], None] | None = None,
) -> PathState:
    """All equilibria of a scene's path.

    folder: where to write frames, tables and checkpoints (default: nowhere); resume: continue from the folder's checkpoint;
    on_progress(time in s, Newton steps so far): called after each equilibrium; on_state before it is written, and of the first.
    Raises InputError before the first equilibrium; SolveError where the path can't go on: its `state` is the last PathState, also on disk.
    """
    saved = Checkpoint.load(folder, scene) if folder is not None and resume else None
    times = scene.path_times()
    state = begin(scene, saved)
    files = None if folder is None else _Files(state, folder, saved)
    see = on_state or (lambda _: None)
    see(state)
    if saved is None and files is not None:
        files.write(state, ())
    for time in times[state.frame + 1 :]:
        last = state.time, state.branch, None if state.branch is None else state.branch.now
        try:
            jumps = _go_on(state, time)
            state.frame += 1
            found = _note(state, jumps)
            see(state)
            if files is not None:
                files.write(state, found)
        except SolveError as error:
            if (
                state.time == last[0]
            ):  # the branch may have stopped on its way, where a body that is fed has another length
                state.branch = last[1]
                if state.branch is not None and last[2] is not None:
                    state.branch.now = last[2]
            raise type(error)(f"equilibrium at t = {time:.6g} s: {error.reason}", state) from None
        if on_progress is not None:
            on_progress(time, state.iterations)
    return state


def _note(state: PathState, jumps: list[Jump]) -> list[Plain]:
    """Add the last equilibrium and the jumps before it. Returns the jumps as results have them, with the field and length then."""
    shape = state.shape
    branch = state.branch
    described = list[Plain]()
    for jump in jumps:
        field = shape.model.field_at(shape.position, jump.time)
        out = state.loads.inserted(jump.time)
        described.append(
            {
                **vars(jump),
                "field": float(np.linalg.norm(field)),
                **({} if out is None else {"inserted": out}),
            }
        )
    state.jumps += described
    state.warnings += [jump_in_words(jump) for jump in described]
    state.strain = state.strain.worst(strain_of(shape.model, shape.position, shape.F, state.time))
    inserted = state.loads.inserted(state.time)
    names = shape.model.scene.body.shape.part_names()
    centers = region_means(shape.model, shape.position).tolist() if names else []
    positions = dict(zip(names, centers, strict=True))
    state.rows.append(
        {
            "time": state.time,
            **({} if shape.tip is None else {"tip": [float(x) for x in shape.tip]}),
            **({"positions": positions} if positions else {}),
            "field": [float(b) for b in shape.model.field_at(shape.position, state.time)],
            **({} if inserted is None else {"inserted": inserted}),
            "energy": state.energy,
            "stability": _stability(branch),
            "min_det_F": shape.min_det_F,
            "max_det_F": shape.max_det_F,
            "iterations": 0 if branch is None else branch.now.iterations,
        }
    )
    return described


def _stability(branch: EquilibriumPath | None) -> float | None:
    if branch is None:
        return None
    with one_blas_thread():
        return branch.stability()


class _Files:
    """Frames, tables and checkpoints of a path in a folder."""

    def __init__(self, state: PathState, folder: Path | str, saved: Checkpoint | None) -> None:
        self.folder = Path(folder)
        self.scene = state.loads.whole.scene
        self.steps = GrowingTable(self.folder / STEPS)
        self.jumps = GrowingTable(self.folder / JUMPS)
        self._hash = motion_hash(self.scene)
        options = self.scene.solver.quasi_static
        most = None if options is None else options.max_disk
        if saved is None:
            forget_motion(folder)
            self.frames = MotionWriter(folder, state.loads.whole, max_disk=most)
        else:
            self.frames = MotionWriter(
                folder,
                state.loads.whole,
                max_disk=most,
                resume_at=saved.time,
                resume_frames=saved.frame + 1,
            )
            for table in (self.steps, self.jumps):
                table.cut(saved.time)

    def write(self, state: PathState, jumps: Any) -> None:
        """The last equilibrium, the jumps on the way to it, and the state from which the path goes on."""
        shape = state.shape
        model = shape.model
        x = shape.position
        F = shape.F
        named = acting.collect(self.scene, times=shape.model.times)
        elastic, stress = energies.elastic(model, F)
        acting.refresh(named, model, x, F)
        energies.add_effects_stress(model, x, F, named, stress)
        known = {
            "kinetic": 0.0,
            "elastic": elastic,
            **energies.effect_energies(model, x, F, state.time),
        }
        contacts = {} if shape.touched is None else contacts_at_rest(model, shape.touched)
        contacts |= {} if shape.own is None else shape.own.report()
        known |= springs(contacts)
        field = model.field_at(x, state.time)
        at_rest = np.zeros_like(x)
        self.frames.frame(Instant(state.time, x, at_rest, F, stress, known, contacts, field))
        self.steps.add(path_row(state.rows[-1]))
        for jump in jumps:
            self.jumps.add(path_row(jump))
        self._checkpoint(state).save(self.folder)

    def _checkpoint(self, state: PathState) -> Checkpoint:
        arrays, numbers = ({}, {}) if state.branch is None else state.branch.state()
        if state.loads.held is not None:
            arrays |= {f"held_{name}": value for name, value in state.loads.held._asdict().items()}
        if state.loads.held_pairs is not None:
            arrays |= state.loads.held_pairs.state()
        more = {
            "branch": numbers,
            "rows": state.rows,
            "jumps": state.jumps,
            "warnings": state.warnings,
            "strain": state.strain.state(),
        }
        return Checkpoint(
            scene_hash=self._hash,
            every=0.0,
            time=state.time,
            formulation="quasi_static",
            frame=state.frame,
            steps=state.iterations,
            control=more,
            state=arrays,
        )
