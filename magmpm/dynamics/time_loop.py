"""The time loop: `move` simulates the motion of a model, frame by frame."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array, NamedNumbers, Plain
from magmpm.dynamics import energies, watchdog
from magmpm.dynamics.checkpoint import Checkpoint, motion_hash
from magmpm.dynamics.step_control import StableStep, StepControl, speed_of_sound, stable_step
from magmpm.dynamics.total_lagrangian import Kinematics, TotalMotion
from magmpm.effects import acting
from magmpm.errors import InputError, SceneError, SolveError, length, quantity
from magmpm.kernels.watch import BROKEN, WHY
from magmpm.model import Model
from magmpm.results.file_names import forget_motion
from magmpm.results.strain import Strain, strain_of
from magmpm.results.trajectory import Instant, MotionWriter
from magmpm.scene import Scene, time_limit
from magmpm.scene.memory import BYTES_PER_PARTICLE
from magmpm.scene.options import Dynamic

Progress = Callable[[float, int], None]


@dataclass
class SimulationState:
    """The present state of a motion.

    stable: bounds of the step at the start; control: control of the step; dt s: last step; every s: time between frames; time s, steps:
    so far; x m, v m/s (n, 3), F, P Pa (n, 3, 3), energies J, contacts: at the last frame; largest: the largest force (N) of each contact in
    any frame, and its time (s).
    """

    motion: TotalMotion
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
    energies: NamedNumbers = field(default_factory=dict)
    contacts: Plain = field(default_factory=dict)
    largest: dict[str, tuple[float, float]] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    strain: Strain = field(default_factory=Strain)  # the largest of all frames
    balance: watchdog.EnergyBalance = field(default_factory=watchdog.EnergyBalance)


def _options(scene: Scene) -> Dynamic:
    options = scene.solver.dynamic
    if options is None:
        raise InputError(
            "the scene is not a motion; add, for example, `solver: {dynamic: {duration: 0.5 s}}`"
        )
    return options


def begin(model: Model) -> SimulationState:
    """A motion at rest, with its time step. Raises InputError if the scene's time_step is not stable, or its max_memory is less."""
    options = _options(model.scene)
    motion = TotalMotion(model)
    stable = stable_step(motion)
    _within_memory(motion, options)
    if options.time_step is not None and options.time_step > stable.largest * (1 + 1e-9):
        bounds = ", ".join(f"{name} {step:.4g} s" for name, step in stable.named.items())
        raise SceneError(
            "solver.dynamic.time_step",
            received=f"{options.time_step:.4g} s",
            rule=f"must be at most the stable step, {stable.largest:.4g} s ({bounds})",
            remedy="lower it, or omit it: a stable step is then chosen",
        )
    control = StepControl(motion, stable, options)
    return SimulationState(motion, stable, control, control.step, options.frame_interval)


def steps_in_words(state: SimulationState) -> str:
    """The steps with which a motion begins, how many of them it takes, and what keeps them from being longer."""
    model = state.motion.model
    scene = model.scene
    spans = np.diff(np.unique([0.0, *_options(scene).frame_times]))
    steps = [_steps_in(span, state.dt) for span in spans]
    least = state.stable.least
    why = f"`{least}` allows no longer ones"
    if _options(scene).time_step is not None:
        why = "as `time_step` says"
    elif least == "body":
        fastest = int(np.argmax(speed_of_sound(model) * ~model.held))
        name = scene.regions()[model.particles.segment[fastest]].material_name
        why = (
            f"a pressure wave crosses a cell ({length(scene.cell)}) of {name} (shear modulus"
            f" {quantity(model.shear[fastest], 'Pa')}) in {quantity(state.stable.wave, 's')};"
            " larger cells, or less stiff or heavier material, take longer steps"
        )
    return (
        f"time steps of {quantity(spans[0] / steps[0], 's')}, {sum(steps)} for"
        f" {quantity(scene.duration, 's')} of motion: {why}"
    )


def _within_memory(motion: TotalMotion, options: Dynamic) -> None:
    needed = memory(motion)
    if options.max_memory is not None and needed > options.max_memory:
        raise SceneError(
            "solver.dynamic.max_memory",
            received=f"{options.max_memory / 1e6:.4g} MB",
            rule=(
                "must be at least the memory of this scene's particles and grid, "
                f"{needed / 1e6:.4g} MB"
            ),
            remedy="raise it, or use fewer cells_across",
        )


def memory(motion: TotalMotion) -> int:
    """Bytes by which a process grows for the particles and grid of a motion, including its model and the memory to build them.

    The larger of two: measured bytes for each particle (magmpm.scene.memory.GROWTH), and the sum of the present arrays.
    """
    owners = [motion, motion.packed, motion.model, motion.model.particles]
    values = [value for owner in owners for value in vars(owner).values()]
    records = [
        value for value in values if hasattr(value, "_fields")
    ]  # of arrays, as the kernels take them
    arrays = {
        id(part): part.nbytes
        for part in [*values, *chain(*records)]
        if isinstance(part, np.ndarray)
    }
    return max(sum(arrays.values()), BYTES_PER_PARTICLE * len(motion.model.density))


def move(model: Model, **options: Any) -> SimulationState:
    """The whole motion of a model's scene, from rest. options: as in `integrate`."""
    return integrate(begin(model), **options)


def integrate(
    state: SimulationState,
    *,
    folder: Path | str | None = None,
    resume: bool = False,
    on_progress: Progress | None = None,
    on_state: Callable[[SimulationState], None] | None = None,
) -> SimulationState:
    """The whole motion, from the state that `begin` returned.

    folder: where to write frames, energies, contacts and checkpoints (default: nowhere); resume: continue from the folder's checkpoint;
    on_progress(time in s, steps so far): called after every chunk of steps; on_state: at each frame from the start or checkpoint on.
    Raises InputError before the first step; SolveError where the motion fails: its `state` is the last good SimulationState, also on disk.
    """
    model = state.motion.model
    options = _options(model.scene)
    saved = Checkpoint.load(folder, model.scene) if folder is not None and resume else None
    if saved is not None and folder is not None:
        saved.must_fit(state.motion.state(), folder)
        _go_on_from(state, saved)
        state.every = saved.every
    else:
        _measure(state, state.motion.kinematics())
        state.balance.check(state.energies)
    writer = None if folder is None else _writer(state, folder, saved)
    conserves = energies.loads_conserve(model)
    rounding = watchdog.energy_rounding(model)
    see = on_state or (lambda _: None)
    see(state)
    _write(state, writer if saved is None else None)
    times = options.frame_times if saved is None else saved.times(options)
    scene_hash = motion_hash(model.scene)
    last = saved_last = _checkpoint(state, scene_hash)
    saved_at = -math.inf
    try:
        while state.frame < len(times):
            now = interval(state, times[state.frame], on_progress)
            state.frame += 1
            _measure(state, now)
            trouble = state.balance.check(state.energies, rounding) if conserves else None
            if trouble is not None:
                raise _stopped(state, trouble)
            see(state)
            _write(state, writer)
            state.strain = state.strain.worst(strain_of(model, state.x, state.F, state.time))
            state.control.at_frame()  # before the checkpoint, which stores the next step
            last = _checkpoint(state, scene_hash)
            if (
                folder is not None and monotonic() > saved_at + 0.5
            ):  # s of work that a killed run may have to repeat
                _save(state, last, folder)
                saved_last = last
                saved_at = monotonic()
    except SolveError as error:
        _go_on_from(state, last)
        raise type(error)(error.reason, state) from None
    finally:  # also if the run is interrupted
        if folder is not None and last is not saved_last:
            _save(state, last, folder)
    return state


def _writer(state: SimulationState, folder: Path | str, saved: Checkpoint | None) -> MotionWriter:
    """Writer of a new file of frames in a folder; after a checkpoint, of the existing file, from the checkpoint's frame on."""
    model = state.motion.model
    most = _options(state.motion.model.scene).max_disk
    if saved is None:
        forget_motion(folder)
        return MotionWriter(folder, model, max_disk=most)
    frames = saved.frame + 1
    return MotionWriter(
        folder,
        model,
        max_disk=most,
        resume_at=state.time,
        resume_frames=frames,
        resume_contacts=state.contacts,
    )


def _save(state: SimulationState, last: Checkpoint, folder: Path | str) -> None:
    """Save a checkpoint. If the disk refuses it, the motion continues with a warning."""
    try:
        last.save(folder)
    except OSError as error:
        what = (
            f"{error.filename}: {error.strerror or error}: --resume can only continue from an "
            "earlier time, or start over"
        )
        if what not in state.warnings:
            state.warnings.append(what)


def _checkpoint(state: SimulationState, scene_hash: str) -> Checkpoint:
    """The checkpoint of a motion after a frame."""
    motion = state.motion
    own = {} if motion.own is None else motion.own.state()
    return Checkpoint(
        scene_hash=scene_hash,
        every=state.every,
        time=state.time,
        formulation="total",
        frame=state.frame,
        steps=state.steps,
        state=motion.state(),
        control={
            **state.control.state(),
            **state.strain.state(),
            **state.balance.state(),
            **own,
            "dt": state.dt,
            "energies": state.energies,
            "largest": dict(state.largest),
        },
    )


def _go_on_from(state: SimulationState, saved: Checkpoint) -> None:
    """Set a motion back to a checkpoint, and take its energies from there: velocities half a step behind would give others."""
    known = saved.control
    state.motion.restore(saved.state)
    state.control.restore(known)
    if state.motion.own is not None:
        state.motion.own.restore(known)
    state.strain = Strain.restored(known)
    state.balance = watchdog.EnergyBalance.restored(known)
    state.frame = saved.frame
    state.steps = saved.steps
    state.time = saved.time
    state.dt = known.get("dt", state.dt)
    _measure(state, state.motion.kinematics())
    state.largest = dict(known.get("largest", {}))
    state.energies = known.get("energies", state.energies)


def _steps_in(seconds: float, longest: float) -> int:
    """Number of equal steps, no longer than the longest, in a time between frames."""
    return max(1, math.ceil(seconds / longest * (1 - 1e-12)))


def interval(
    state: SimulationState, until: float, on_progress: Progress | None = None
) -> Kinematics:
    """Take equal steps up to a time (s), no longer than state.control allows. Where the control changes its bound, choose a new step.

    Raises SolveError where the motion can't go on.
    """
    steps_between_checks = 256  # steps between two checks of the motion
    model = state.motion.model
    motion = state.motion
    control = state.control
    if state.time >= until:
        return motion.kinematics()
    if motion.own is not None:
        motion.own.begin()
    while state.time < until:
        start = state.time
        done = 0
        count = _steps_in(until - start, control.step)
        dt = (until - start) / count
        while done < count:
            first = done
            steps = min(steps_between_checks, count - first)
            times = start + dt * np.arange(first, first + steps, dtype=float)
            named = acting.collect(model.scene, times=times)
            named += motion.ends.records(times, dt)
            motion.set_off(dt, named)
            taken, now, trouble = control.take(named, steps, dt, start + dt * first)
            done = first + taken
            state.steps = state.steps + taken
            state.dt = dt
            state.time = until if done == count else start + dt * done
            trouble = trouble or _wrong(state, now)
            if trouble is not None:
                raise _stopped(state, trouble)
            if on_progress is not None:
                on_progress(state.time, state.steps)
            time_limit.check()
            if (
                taken < steps
                or control.step < dt * (1 - 1e-12)
                or (control.step > 1.5 * dt and done < count)
            ):
                break
    return now


def _wrong(state: SimulationState, now: Kinematics) -> watchdog.Trouble | None:
    """Failure of a motion, or None."""
    model = state.motion.model
    if state.motion.watch[WHY] == BROKEN:
        return watchdog.outside_domain(model, now.x, state.time) or watchdog.broken(
            model, now.x, now.v, now.F
        )
    return watchdog.check(model, now.x, now.v, state.time) or watchdog.outside_domain(
        model, now.x, state.time
    )


def _stopped(state: SimulationState, trouble: watchdog.Trouble) -> SolveError:
    where = ""
    if trouble.particle >= 0:
        place = state.motion.model.particles.position[trouble.particle] * 1e3
        where = (
            f" (particle {trouble.particle}, in the undeformed body at"
            f" {', '.join(f'{c:.3g}' for c in place)} mm)"
        )
    bound = (
        f"the time step is {state.dt:.3g} s, the stable bound at the start was"
        f" {state.stable.largest:.3g} s"
    )
    return trouble.kind(
        f"step {state.steps}, t = {state.time:.6g} s: {trouble.cause}{where}; {bound}; remedy:"
        f" {trouble.remedy}"
    )


def _measure(state: SimulationState, now: Kinematics) -> None:
    """Store stress, energies and contacts of the present state."""
    model = state.motion.model
    motion = state.motion
    state.x = now.x
    state.v = now.v
    state.F = now.F
    named = acting.collect(model.scene, times=np.array([state.time]))
    acting.refresh(named, model, now.x, now.F)
    state.P, state.energies, state.contacts = energies.measure(motion, named, now, state.time)
    for name, contact in state.contacts.items():
        size = float(np.linalg.norm(contact["force"]))
        if size > state.largest.get(name, (0.0, 0.0))[0]:
            state.largest[name] = (size, state.time)


def _write(state: SimulationState, writer: MotionWriter | None) -> None:
    """Write the measured state as a frame."""
    if writer is None:
        return
    field = state.motion.model.field_at(state.x, state.time)
    writer.frame(
        Instant(
            state.time, state.x, state.v, state.F, state.P, state.energies, state.contacts, field
        )
    )
