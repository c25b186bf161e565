"""Kernels are compiled before the run: once, in separate processes, and then loaded from the disk cache.

Why separate processes: code compiled in this process and the same code loaded from the cache can differ in the last bit, because
functions that several kernels share are linked differently. Then a study that compiled its kernels and one that is resumed would not
agree bit for bit. So every process loads its kernels from the cache.

A scene's kernels are compiled in parts, on all cores. Each part does a little of what a run does, and is the same whatever acts; of what
acts, each hook is compiled for itself (effects.calls). What few runs need, derivatives and families of rods, is compiled for those that ask
for it (`uses`). One process compiles a set of kernels; others that need the same set wait for it, half a minute at most, and then compile
theirs beside it. Who needs another set waits for nobody: a kernel that two sets share stays as the first has saved it (compiled.cache).
"""

import hashlib
import json
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any, TextIO

import llvmlite.binding
import numba
import numpy as np
from filelock import lock_descriptor

from magmpm.compiled.arrays import Array, Plain
from magmpm.compiled.cache import compile_here, kept_all
from magmpm.compiled.environment import cache_folder, source_hash
from magmpm.compiled.parallel import compile_task
from magmpm.compiled.process import answers, started
from magmpm.effects import acting as effects
from magmpm.effects.calls import (
    Function,
    compile_functions,
    functions_at_rest,
    functions_in_motion,
    functions_of_changes,
)
from magmpm.errors import SolveError
from magmpm.model import build
from magmpm.results.folder_lock import holder, sign
from magmpm.results.strain import strain_of
from magmpm.rod.cantilever import is_cantilever, without_motion
from magmpm.rod.cosserat import RodModel, solve_rod
from magmpm.rod.family import RodFamily
from magmpm.scene import Scene
from magmpm.scene.coarsest import coarsest, knots_of
from magmpm.scene.time_limit import limited
from magmpm.scene.variables import variables
from magmpm.statics.changes import right_sides
from magmpm.statics.energy import Energy, Point
from magmpm.statics.equilibrium import solve_static
from magmpm.statics.layout import StaticModel, UnknownsLayout, model_at_rest, static_model
from magmpm.statics.linearized import Linearized
from magmpm.statics.rod_start import straight
from magmpm.statics.tangent_matrix import Bands, Sparse, new_matrix
from magmpm.statics.unnamed_loads import missed_loads

SECONDS_TO_WAIT = 30.0  # s to wait for another process that compiles the same kernels
REMINDED = 10.0  # s between two lines of who waits
# factorizations of the solve that only compiles: where a thousandth of the load is easy, it takes 2
# to 8
STEPS_OF_SMALL_SOLVE = 20.0
# bytes on the disk, without which compiling ahead is for nothing: a set of kernels takes 2 to 5 MB,
# while it is written twice
ROOM = 20e6
# what kernels are for
SOLVE = "solve"
DERIVATIVES = "sensitivities"
RODS = "rods"
PROOFS = "proofs of errors"
Tell = Callable[[str], None]
_ready: set[str] = set()


def on_stderr(line: str) -> None:
    """A line for the user who waits."""
    print(f"magmpm: {line}", file=sys.stderr, flush=True)


def prepare_kernels(scene: Scene, uses: Sequence[str] = (SOLVE,)) -> float:
    """Seconds it takes to compile, or load, the kernels for these uses of a scene's combination of effects; 0 once done in this process."""
    needed = _needed(scene, uses)
    if not needed.keys() - _ready:
        return 0.0
    begun = time.perf_counter()
    fill_cache(scene, uses=uses)
    small = coarsest(scene)
    for use in uses:
        if _kinds(scene, use) not in _ready:
            _WHOLE[use](small)
    _ready.update(needed)
    return time.perf_counter() - begun


def _needed(scene: Scene, uses: Sequence[str]) -> dict[str, str | Function]:
    """Uses and functions of effects that a scene needs compiled, by texts that distinguish one set of kernels from another."""
    found: dict[str, str | Function] = {_kinds(scene, use): use for use in uses}
    if SOLVE in uses or DERIVATIVES in uses:
        for function in _functions(scene, uses):
            found[json.dumps(function)] = function
    return found


def _functions(scene: Scene, uses: Sequence[str]) -> list[Function]:
    """Functions of the effects that a scene's kernels call."""
    named = effects.collect(scene, times=_times(scene))
    found = []
    if SOLVE in uses:
        found += (
            functions_in_motion(named)
            if scene.solver.dynamic is not None
            else functions_at_rest(named)
        )
        if scene.solver.quasi_static is not None:
            found += functions_in_motion(named)
        if scene.move and scene.solver.dynamic is not None:
            from magmpm.dynamics.total_lagrangian import MOVED

            found.append(MOVED)
    if DERIVATIVES in uses:
        found += functions_at_rest(named) + functions_of_changes(named)
        for one in effects.field_changes(scene, _times(scene)):
            found += functions_of_changes(one)
    return list(dict.fromkeys(found))


def fill_cache(scene: Scene, tell: Tell = on_stderr, uses: Sequence[str] = (SOLVE,)) -> bool:
    """Fill the disk cache with a scene's kernels for these uses. Returns whether any had to be compiled, of which `tell` gets lines."""
    needed = _needed(scene, uses)
    marker = {kinds: cache_folder() / f"ready-{_stamp(kinds)}" for kinds in needed}
    if all(path.exists() for path in marker.values()):
        return False
    with ExitStack() as alone:
        begun = time.monotonic()
        # Sorted: of two processes that need several sets, neither can wait for the other. Functions of
        # effects take a second: two processes may compile the same.
        sets = [kinds for kinds, use in needed.items() if isinstance(use, str)]
        for path in sorted(marker[kinds] for kinds in sets if not marker[kinds].exists()):
            alone.enter_context(_alone(path.with_suffix(".lock"), tell, begun + SECONDS_TO_WAIT))
        missing = [kinds for kinds, path in marker.items() if not path.exists()]
        if not missing:  # the process we waited for has made them
            return False
        begun = time.perf_counter()
        if not _has_room():
            tell(
                f"no room in {cache_folder()} for compiled kernels: this run compiles its own, up"
                f" to a minute; free {ROOM / 1e6:.0f} MB there"
            )
            return True
        jobs = [needed[kinds] for kinds in missing]
        what = " and ".join(
            describe(scene) if use == SOLVE else str(use) for use in jobs if isinstance(use, str)
        )
        tell(f"compiling kernels for {what or describe(scene)}; once on this machine")
        if _compiled_elsewhere(coarsest(scene), jobs, tell):
            with suppress(OSError):  # a cache that can't be marked is only filled again
                for kinds in missing:
                    marker[kinds].touch()
        tell(f"kernels compiled in {time.perf_counter() - begun:.0f} s")
    return True


def _has_room() -> bool:
    """True if the cache's disk has room for the kernels of a scene."""
    try:
        return shutil.disk_usage(cache_folder()).free > ROOM
    except OSError:
        return True  # the write itself will tell


def describe(scene: Scene) -> str:
    """The use of a scene's kernels, in a few words."""
    several = "statics along time" if scene.in_time else "statics"
    solver = several if scene.solver.dynamic is None else "motion"
    return f"{solver} with {' + '.join(scene.effects.named()) or 'no effects'}"


def _kinds(scene: Scene, use: str = SOLVE) -> str:
    """Text that distinguishes one set of kernels from another."""
    if use in (RODS, PROOFS):
        return use
    about = [scene.solver.anti_locking, scene.body.kind, knots_of(scene).at_rest, _solver(scene)]
    return json.dumps([*about, use])


def _solver(scene: Scene) -> str | bool:
    """Key that distinguishes the kernels of one way to solve a scene from another's."""
    itself = scene.effects.self_contact is not None
    if scene.solver.quasi_static is not None:
        return "quasi_static" + (" touches itself" if itself else "")
    if itself:
        return "touches itself" if scene.solver.dynamic is not None else "rests on itself"
    return scene.solver.dynamic is not None and "motion"


def _stamp(kinds: str) -> str:
    """Names a set of kernels as magmpm.compiled.cache distinguishes them: two of these are the same only if none needs compiling again."""
    known = [
        kinds,
        sys.version,
        numba.__version__,
        llvmlite.__version__,
        llvmlite.binding.get_host_cpu_name(),
        str(llvmlite.binding.get_host_cpu_features()),
        source_hash(),
    ]
    return hashlib.sha256(json.dumps(known).encode()).hexdigest()[:16]


def _times(scene: Scene) -> Array | None:
    """Times at which effects are evaluated: as in motion, or as in statics."""
    return np.zeros(1) if scene.in_time else None


@contextmanager
def _alone(lock: Path, tell: Tell, until: float) -> Iterator[None]:
    """Only one process at a time, which others wait for until a time of the monotonic clock, and tell whom they wait for.

    The lock ends with the process, however it ends. There is none if the cache can't be written.
    """
    try:
        stream = lock.open("a+")
    except OSError:
        yield
        return
    with stream:
        reminded = -np.inf
        while not (mine := _locked(stream)) and time.monotonic() < until:
            if time.monotonic() - reminded >= REMINDED:
                reminded = time.monotonic()
                left = max(until - reminded, 0.0)
                tell(
                    f"waiting for {_other(stream)}, which compiles the same kernels"
                    f" ({left:.0f} s more at most)"
                )
            time.sleep(0.05)
        if mine:
            sign(stream, str(os.getpid()))
        else:
            tell(f"{_other(stream)} is still compiling the same kernels; this one compiles its own")
        yield


def _locked(stream: TextIO) -> bool:
    """Tell whether the lock is ours now."""
    try:
        return lock_descriptor(stream.fileno(), blocking=False)
    except OSError:
        return False


def _other(stream: TextIO) -> str:
    """The process that has a lock, as it has written it."""
    return f"process {holder(stream) or 'unknown'}"


def _compiled_elsewhere(small: Scene, jobs: Sequence[str | Function], tell: Tell) -> bool:
    """Fill the disk cache from separate processes. Returns False if that failed (the kernels are then compiled here)."""
    uses = [use for use in jobs if isinstance(use, str)]
    parts: list[str | Function] = [part for use in uses for part in parts_of(small, use)]
    parts += [function for function in jobs if not isinstance(function, str)]
    later = [part for part in parts if part in _LATER]
    sooner = [part for part in parts if part not in _LATER]
    done = 0
    with started(min(len(parts), os.cpu_count() or 1), _begin, small.to_si()) as processes:
        for some in (sooner, later):
            for _, _, kept in answers(iter(some), processes):
                if kept is not True:  # a full disk, say: the rest would not be kept either
                    return False
                done += 1
                tell(f"{done} of {len(parts)} parts compiled")
        for process in processes[1:]:
            process.end()
        try:
            return all(
                processes[0].ask(use) for use in uses
            )  # what the parts have left out, and proof that they are all there
        except (
            Exception
        ):  # of whatever kind: the kernels are compiled where it matters, and it is reported there
            return False


# What the processes do: the parts of a scene's kernels.


def parts_of(small: Scene, use: str = SOLVE) -> list[str]:
    """Names of a scene's parts, longest first among those that are begun together."""
    if use != SOLVE:
        return list(_ADDED[use])
    if small.solver.dynamic is None:
        return [*_STATIC, "measured"] if small.in_time else list(_STATIC)
    return list(_MOTION)


def solve_small(small: Scene) -> None:
    """Begin to solve a coarse scene: it calls every kernel. The answer is not used, and may not exist."""
    with suppress(SolveError), _briefly():
        if small.solver.dynamic is not None:
            from magmpm.dynamics.time_loop import move

            move(build(small))
        elif small.in_time:
            from magmpm.dynamics.quasi_static import follow

            follow(small)
        else:
            found = solve_static(model_at_rest(small))
            missed_loads(small, found.energy, found.point)
            return
    if (
        small.solver.dynamic is None
    ):  # what comes after an equilibrium, which may not have been found
        _stability(small)


def differentiate_small(small: Scene) -> None:
    """Begin to solve a coarse scene, and differentiate it by one variable of each kind."""
    with suppress(SolveError), _briefly():
        each = {variable.kind: variable for variable in variables(small)}
        found = Linearized(solve_static(model_at_rest(small)), list(each.values()))
        found.adjoint(found.centreline[:, :, 0])


def _briefly() -> AbstractContextManager[None]:
    """A context in which a solve ends after STEPS_OF_SMALL_SOLVE factorizations, or steps of a motion: by then it has called all kernels
    that it calls."""
    return limited(STEPS_OF_SMALL_SOLVE, map(float, count()).__next__)


def _begin(_: object, small: Plain) -> Callable[[str | Function], bool]:
    """Begin a process: it compiles parts by their names, and reports whether the disk saved them."""
    every = {
        **_WHOLE,
        **_STATIC,
        **_MOTION,
        **{name: do for added in _ADDED.values() for name, do in added.items()},
    }
    scene = Scene.from_si(small)
    compile_here()

    def compile_part(part: str | Function) -> bool:
        if not isinstance(part, str):
            compile_functions([part])
            return kept_all()
        with suppress(SolveError):
            every[part](scene)
        return kept_all()

    return compile_part


def _built(small: Scene) -> StaticModel:
    """The model of a scene; of a fed body, which only its guide holds, as if it were clamped: the kernels are the same."""
    times = small.path_times()
    made = build(small, time=times[0] if times else None)
    return static_model(made if small.effects.feed is None else replace(made, clamped_face=True))


def _at_rest(small: Scene) -> tuple[Energy, Point]:
    """The energy of a body, and its undeformed state."""
    energy = Energy(_built(small))
    model = energy.model
    n = len(energy.model.shear)
    rest = np.broadcast_to(model.axes, (n, 3, 3)).copy()
    place = model.particles.position
    return energy, Point(straight(model), np.zeros((n, 3)), place, rest, 0.0, 1.0, 1.0)


def _tangent(small: Scene) -> None:
    energy, point = _at_rest(small)
    energy.tangent(point)


def _energy(small: Scene) -> None:
    energy = Energy(_built(small))
    point = energy.at(straight(energy.model))
    energy.residual(point)
    if point.touched is not None and energy.model.touching is not None:
        energy.model.touching.add_tangent(
            point.touched, energy.matrix.target(energy.model.touching.cells)
        )
    strain_of(energy.model, point.position, point.F)
    of_each = np.tile(np.eye(3), (len(energy.model.shear), 1, 1))
    for axes in (of_each[0], of_each):  # of all particles alike, and of a tube, whose grid is round
        energy.load(replace(energy.model, axes=axes))
        energy.at(straight(energy.model))


def _rod(small: Scene) -> None:
    if is_cantilever(small):
        solve_rod(without_motion(small))


def _factorization(small: Scene) -> None:
    layout = _layout(small)
    _solved(_ones(new_matrix(small, layout)), layout)


def _single(small: Scene) -> None:
    layout = _layout(small)
    _solved(_ones(Bands(layout)).rounded(), layout)


def _layout(small: Scene) -> UnknownsLayout:
    return _built(small).layout


def _ones(matrix: Bands | Sparse) -> Any:
    """A matrix as the identity."""
    matrix.clear()
    matrix.add_diagonal(1.0)
    return matrix


def _solved(matrix: Any, layout: UnknownsLayout) -> None:
    matrix.factor()
    matrix.solve(np.ones((layout.planes, layout.m)))


def _stability(small: Scene) -> None:
    energy, point = _at_rest(small)
    energy.products(point, energy.mass(np.zeros((energy.shape[0], 1, energy.shape[1]))))


def _changes(small: Scene) -> None:
    energy = Energy(_built(small))
    right_sides(energy, energy.at(straight(energy.model)), variables(small))


def _rods(small: Scene) -> None:
    each = np.ones((2, 3))
    at = np.zeros((3, 3))
    family = RodFamily(
        RodModel(np.ones(2), each, each, 0.0 * each, at, at), np.zeros((1, 2))
    )  # two elements without a load
    family.relaxed(family.straight(1), each[:1, None], at[:1])
    family.stability(family.straight(1)[0], each[:1], at[0])


def _tasks(name: str) -> Callable[[Scene], None]:
    """Compile a part of the tasks of a step."""

    def compile_tasks(small: Scene) -> None:
        motion, acting = _in_motion(small)
        for function, arguments in motion.tasks(acting)[name]:
            compile_task(function, arguments)

    return compile_tasks


def _steps(small: Scene) -> None:
    motion, acting = _in_motion(small)
    motion.advance(1, 1e-12, acting)
    motion.shape(motion.u)


def _in_motion(small: Scene) -> tuple[Any, tuple[Any, ...]]:
    """A motion, and the records of what acts."""
    from magmpm.dynamics.total_lagrangian import TotalMotion

    model = build(small)
    motion = TotalMotion(model)
    return motion, (*model.effects, *motion.ends.records(np.zeros(1), 1e-12))


def _measured(small: Scene) -> None:
    from magmpm.dynamics import energies, watchdog
    from magmpm.results.frame_arrays import FrameArrays

    model = build(small)
    x = model.particles.position
    F = np.tile(np.eye(3), (len(model.density), 1, 1))
    _, P = energies.elastic(model, F)
    energies.add_effects_stress(model, x, F, model.effects, P)
    energies.effect_energies(model, x, F, 0.0)
    watchdog.check(model, x, np.zeros_like(x))
    strain_of(model, x, F)
    FrameArrays(x, model.remanence[:, :3]).of(x, x, F, P)


_STATIC: dict[str, Callable[[Scene], None]] = {
    "stability": _stability,
    "factorization": _factorization,
    "tangent": _tangent,
    "rod": _rod,
    "energy": _energy,
}
_MOTION: dict[str, Callable[[Scene], None]] = {
    "forces": _tasks("forces"),
    "friction": _tasks("friction"),
    "nodes": _tasks("nodes"),
    "rod": _rod,
    "steps": _steps,
    "measured": _measured,
}
# parts that call what others compile, or are short enough to fill the time beside these
_LATER = ("steps", "measured")
_ADDED: dict[str, dict[str, Callable[[Scene], None]]] = {
    DERIVATIVES: {"changes": _changes},
    RODS: {"family": _rods},
    PROOFS: {"single": _single},
}
_WHOLE: dict[str, Callable[[Scene], None]] = {
    SOLVE: solve_small,
    DERIVATIVES: differentiate_small,
    RODS: _rods,
    PROOFS: _single,
}
