"""The time loop: `move` follows the motion of a model, frame by frame."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.dynamics import energies, mass, watchdog
from magmpm.dynamics.apic import UpdatedMotion
from magmpm.dynamics.checkpoint import Checkpoint, motion_hash
from magmpm.dynamics.stable_step import StableStep, stable_step
from magmpm.dynamics.step_control import StepControl
from magmpm.dynamics.steps import Kinematics
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.effects import acting
from magmpm.effects.hooks import has_hook, pairs
from magmpm.errors import BudgetError, InputError, SceneError, SolveError, report
from magmpm.kernels.watch import BROKEN, WHY
from magmpm.model import Model
from magmpm.results.file_names import forget_motion
from magmpm.results.strain import Strain, strain_of
from magmpm.results.trajectory import MotionWriter
from magmpm.scene import Scene
from magmpm.scene.memory import GROWTH
from magmpm.scene.motion_options import DynamicOptions

SAVE_EVERY = 0.5  # s of work that a killed run may have to repeat
CHUNK = 256  # steps between two checks of the motion
Progress = Callable[[float, int], None]


@dataclass
class SimulationState:
    """The present state of a motion.

    stable: bounds of the step at the start; control: control of the step; dt s: last step; every s: time between frames; time s, steps:
    so far; x m, v m/s (n, 3), F, P Pa (n, 3, 3), energies J: at the last frame.
    """

    motion: TotalMotion | UpdatedMotion
    stable: StableStep
    control: StepControl
    dt: float
    every: float = 0.0
    time: float = 0.0
    steps: int = 0
    frame: int = 0
    x: Array = field(default_factory=lambda: np.zeros((0, 3)))
    v: Array = field(default_factory=lambda: np.zeros((0, 3)))
    F: Array = field(default_factory=lambda: np.zeros((0, 3, 3)))
    P: Array = field(default_factory=lambda: np.zeros((0, 3, 3)))
    energies: dict[str, float] = field(default_factory=dict)
    contacts: dict[str, Any] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    strain: Strain = field(default_factory=Strain)  # the largest of all frames


def formulation(scene: Scene) -> str:
    """The formulation, total or updated: what the scene says, or else updated if the body may touch itself."""
    options = _options(scene)
    touching = scene.effects.self_contact is not None
    return options.formulation or ("updated" if touching else "total")


def _options(scene: Scene) -> DynamicOptions:
    options = scene.solver.dynamic
    if options is None:
        raise InputError("the scene asks for no motion; add, say, `solver: {dynamic: {duration: 0.5 s}}`")
    return options


def begin(model: Model) -> SimulationState:
    """A motion that starts from the model at rest, with its time step.

    Raises InputError if the scene's time_step exceeds the stable step, or the particles need more than max_memory.
    """
    options = _options(model.scene)
    motion = TotalMotion(model) if formulation(model.scene) == "total" else UpdatedMotion(model)
    stable = stable_step(motion)
    _within_memory(motion, options)
    if options.time_step is not None and options.time_step > stable.largest * (1 + 1e-9):
        bounds = ", ".join(f"{name} {step:.4g} s" for name, step in stable.named.items())
        raise SceneError(
            "solver.dynamic.time_step",
            received=f"{options.time_step:.4g} s",
            rule=f"must be at most the stable step, {stable.largest:.4g} s ({bounds})",
            remedy="lower it, or leave it out: it is then chosen",
        )
    control = StepControl(motion, stable, options)
    return SimulationState(motion, stable, control, control.step, options.frame_interval, warnings=mass.warnings(model))


def _within_memory(motion: TotalMotion | UpdatedMotion, options: DynamicOptions) -> None:
    needed = memory(motion)
    if options.max_memory is not None and needed > options.max_memory:
        raise SceneError(
            "solver.dynamic.max_memory",
            received=f"{options.max_memory / 1e6:.4g} MB",
            rule=f"must be at least what this scene's particles and grid take, {needed / 1e6:.4g} MB",
            remedy="raise it, or use fewer cells_across",
        )


def _outgrown(motion: TotalMotion | UpdatedMotion, options: DynamicOptions) -> None:
    """Raise BudgetError if the grid, which grows with the body in the updated formulation, exceeds the scene's max_memory."""
    if options.max_memory is not None and (needed := memory(motion)) > options.max_memory:
        raise BudgetError(
            report(
                "solver.dynamic.max_memory",
                received=f"{options.max_memory / 1e6:.4g} MB",
                rule=f"the particles and the box around them must stay within it, and have grown to {needed / 1e6:.4g} MB",
                remedy="raise it, or hold the body together (clamp, ground, walls)",
            )
        )


def memory(motion: TotalMotion | UpdatedMotion) -> int:
    """Bytes by which a process grows for the particles and grid of a motion, including its model and the memory to build them.

    The larger of two: measured bytes for each particle (magmpm.scene.memory.GROWTH), and the sum of the present arrays.
    """
    parts_of = (getattr(motion, "packed", None), getattr(motion, "drift_correction", None))
    owners = [motion, *(part for part in parts_of if part is not None), motion.model, motion.model.particles]
    values = [value for owner in owners for value in vars(owner).values()]
    records = [value for value in values if hasattr(value, "_fields")]  # of arrays, as the kernels take them
    arrays = {id(part): part.nbytes for part in [*values, *chain(*records)] if isinstance(part, np.ndarray)}
    return max(sum(arrays.values()), GROWTH[motion.formulation] * len(motion.model.density))


def move(model: Model, **options: Any) -> SimulationState:
    """The whole motion of a model's scene, from rest. options: as in `integrate`."""
    return integrate(begin(model), **options)


def integrate(
    moved: SimulationState,
    *,
    folder: Path | str | None = None,
    resume: bool = False,
    on_progress: Progress | None = None,
) -> SimulationState:
    """The whole motion, from the state that `begin` returned.

    folder: where to write frames, energies, contacts and checkpoints (default: nowhere); resume: continue from the folder's checkpoint;
    on_progress(time in s, steps so far): called after every chunk of steps.
    Raises InputError before the first step. Raises SolveError where the motion goes wrong; the last good SimulationState is its state, and
    is on disk.
    """
    model = moved.motion.model
    options = _options(model.scene)
    saved = Checkpoint.load(folder, model.scene) if folder is not None and resume else None
    if saved is not None and folder is not None:
        saved.must_fit(moved.motion.state(), folder)
        _go_on_from(moved, saved)
        moved.every = saved.every
    _measure(moved, moved.motion.kinematics())
    writer = None if folder is None else _writer(moved, folder, saved)
    balance = watchdog.EnergyBalance() if _conserves(model) else None
    if balance is not None and saved is None:  # velocities of a checkpoint lag by half a step: less kinetic energy
        balance.check(moved.energies)
    if saved is None:
        _write(moved, writer)
    times = options.frame_times if saved is None else saved.times(options)
    scene_hash = motion_hash(model.scene)
    last = saved_last = _checkpoint(moved, scene_hash)
    saved_at = -math.inf
    try:
        while moved.frame < len(times):
            now = interval(moved, times[moved.frame], on_progress)
            moved.frame += 1
            _measure(moved, now)
            if balance is not None and (trouble := balance.check(moved.energies)) is not None:
                raise _stopped(moved, trouble)
            _write(moved, writer)
            moved.strain = moved.strain.worst(strain_of(model, moved.x, moved.F, moved.time))
            moved.control.at_frame()  # before the checkpoint, which stores the next step
            last = _checkpoint(moved, scene_hash)
            if folder is not None and monotonic() > saved_at + SAVE_EVERY:
                _save(moved, last, folder)
                saved_last, saved_at = last, monotonic()
    except SolveError as error:
        _go_on_from(moved, last)
        _measure(moved, moved.motion.kinematics())
        raise type(error)(error.reason, moved) from None
    finally:  # also if the run is interrupted
        if folder is not None and last is not saved_last:
            _save(moved, last, folder)
    return moved


def _writer(moved: SimulationState, folder: Path | str, saved: Checkpoint | None) -> MotionWriter:
    """Writer of a new file of frames in a folder; after a checkpoint, of the existing file, from the checkpoint's frame on."""
    model, most = moved.motion.model, _options(moved.motion.model.scene).max_disk
    if saved is None:
        forget_motion(folder)
        return MotionWriter(folder, model, max_disk=most)
    frames = saved.frame + 1
    return MotionWriter(folder, model, max_disk=most, resume_at=moved.time, resume_frames=frames, resume_contacts=moved.contacts)


def _save(moved: SimulationState, last: Checkpoint, folder: Path | str) -> None:
    """Save a checkpoint. If the disk refuses it, the motion continues with a warning."""
    try:
        last.save(folder)
    except OSError as error:
        what = f"{error.filename}: {error.strerror or error}: --resume can only go on from an earlier moment, or from the start"
        if what not in moved.warnings:
            moved.warnings.append(what)


def _checkpoint(moved: SimulationState, scene_hash: str) -> Checkpoint:
    """The checkpoint of a motion after a frame."""
    motion = moved.motion
    return Checkpoint(
        scene_hash=scene_hash, every=moved.every, time=moved.time, formulation=motion.formulation,
        frame=moved.frame, steps=moved.steps, control={**moved.control.state(), **moved.strain.state()}, state=motion.state(),
    )  # fmt: skip


def _go_on_from(moved: SimulationState, saved: Checkpoint) -> None:
    """Set a motion back to a checkpoint."""
    moved.motion.restore(saved.state)
    moved.control.restore(saved.control)
    moved.strain = Strain.restored(saved.control)
    moved.frame, moved.steps, moved.time = saved.frame, saved.steps, saved.time


def _conserves(model: Model) -> bool:
    """Whether no load can add energy: loads are constant, and there is no contact or constraint."""
    scene, named = model.scene, model.scene.effects
    if acting.feels_itself(scene):  # such loads lag by a chunk of steps
        return False
    if scene.field.varies and (named.magnetic_torque is None) != (named.magnetic_force is None):
        return False  # one without the other has no energy
    records = [record for record, _ in pairs(acting.collect(model.scene, times=np.array([0.0, 1.0])))]
    return all(len(record) == 1 for record in records) and not any(
        has_hook(hook, model.effects) for hook in ("contact", "node")
    )


def interval(moved: SimulationState, until: float, on_progress: Progress | None = None) -> Kinematics:
    """Take equal steps up to a time (s), no longer than moved.control allows. Where the control changes its bound, choose a new step.

    Raises SolveError where the motion can't go on.
    """
    model, motion, control = moved.motion.model, moved.motion, moved.control
    itself = acting.feels_itself(model.scene)
    while moved.time < until:
        start, done = moved.time, 0
        count = max(1, math.ceil((until - start) / control.step * (1 - 1e-12)))
        dt = (until - start) / count
        for first in range(0, count, CHUNK):
            steps = min(CHUNK, count - first)
            named = acting.collect(model.scene, times=start + dt * np.arange(first, first + steps, dtype=float))
            if itself:
                x, _, F = motion.particles()
                acting.refresh(named, model, x, F)
            motion.set_off(dt, named)
            taken, now, trouble = control.take(named, steps, dt)
            done = first + taken
            moved.steps, moved.dt = moved.steps + taken, dt
            moved.time = until if done == count else start + dt * done
            trouble = trouble or _wrong(moved, now)
            if trouble is not None:
                raise _stopped(moved, trouble)
            if on_progress is not None:
                on_progress(moved.time, moved.steps)
            if taken < steps or control.step < dt * (1 - 1e-12) or (control.step > 1.5 * dt and done < count):
                break
    motion.sort()
    return now


def _wrong(moved: SimulationState, now: Kinematics) -> watchdog.Trouble | None:
    """What is wrong with a motion, or None. Raises BudgetError where it needs more than max_memory."""
    model = moved.motion.model
    _outgrown(moved.motion, _options(model.scene))
    if moved.motion.watch[WHY] == BROKEN:
        return watchdog.outside_domain(model, now.x, moved.time) or watchdog.broken(model, now.x, now.v, now.F)
    return watchdog.check(model, now.x, now.v) or watchdog.outside_domain(model, now.x, moved.time)


def _stopped(moved: SimulationState, trouble: watchdog.Trouble) -> SolveError:
    where = ""
    if trouble.particle >= 0:
        place = moved.motion.model.particles.position[trouble.particle] * 1e3
        where = f" (particle {trouble.particle}, in the undeformed body at {', '.join(f'{c:.3g}' for c in place)} mm)"
    bound = f"the time step is {moved.dt:.3g} s, the stable bound at the start was {moved.stable.largest:.3g} s"
    return SolveError(f"step {moved.steps}, t = {moved.time:.6g} s: {trouble.cause}{where}; {bound}; remedy: {trouble.remedy}")


def _measure(moved: SimulationState, now: Kinematics) -> None:
    """Store stress, energies and contacts of the present state."""
    model, motion = moved.motion.model, moved.motion
    moved.x, moved.v, moved.F = now.x, now.v, now.F
    named = acting.collect(model.scene, times=np.array([moved.time]))
    with motion.threads.alone():
        elastic, moved.P = energies.elastic(model, now.F, motion.formulation == "total")
        acting.refresh(named, model, now.x, now.F)
        energies.add_effects_stress(model, now.x, now.F, named, moved.P)
        potentials = energies.effect_energies(model, now.x, now.F, moved.time)
    moved.energies = {"kinetic": now.kinetic, "elastic": elastic, **potentials}
    moved.contacts = {}
    for key, effect in model.scene.effects.named().items():
        if (contact := effect.report(model, moved.x, moved.v, moved.dt)) is not None:
            moved.contacts[key] = contact


def _write(moved: SimulationState, writer: MotionWriter | None) -> None:
    """Write the measured state as a frame."""
    if writer is None:
        return
    model = moved.motion.model
    center = model.particles.volume @ moved.x / model.particles.volume.sum()
    field = model.scene.outside_field().at(center, moved.time)[0] if model.scene.effects.in_a_field else np.zeros(3)
    writer.frame(moved.time, moved.x, moved.v, moved.F, moved.P, moved.energies, moved.contacts, field)
