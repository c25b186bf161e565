"""Time that each effect adds to a scene: of a motion's step, or of a Newton step of its equilibrium, by short runs in pairs.

Each effect is timed by itself against no effect, at the settings that the scene has, or else at its key's example, where the body begins.
Both runs of a pair follow each other on one thread, and only their processor time counts: a busy machine disturbs their ratio little.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numba
import numpy as np

from magmpm.compiled.arrays import NamedNumbers, Plain
from magmpm.compiled.thread_count import one_blas_thread
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.effects.acting import Effects
from magmpm.effects.base import BodyEffect, Effect
from magmpm.errors import MagmpmError
from magmpm.inputs.settings import validate
from magmpm.model import Model, build
from magmpm.rod.cantilever import without_motion
from magmpm.scene import Scene
from magmpm.solving.precompile import prepare_kernels
from magmpm.statics.energy import Energy
from magmpm.statics.equilibrium import solve_static
from magmpm.statics.layout import model_at_rest, static_model
from magmpm.statics.rod_start import straight

Run = Callable[[], object]
Timed = Callable[[Scene], float]


def costs(scene: Scene) -> NamedNumbers:
    """Per cent that each effect by itself adds to a scene's cost.

    Parameters
    ----------
    scene : Scene
        A motion, whose steps are timed, or a scene at rest or along equilibria, whose Newton steps are.

    Returns
    -------
    dict of str to float
        By the key of each effect that can act on this body. Between runs on a busy machine they differ by a few per cent of a step.
    """
    timed = _steps if scene.solver.dynamic is not None else _newton_steps
    at_rest = scene if scene.solver.dynamic is not None else without_motion(scene)
    found = {}
    with _one_thread(), one_blas_thread():
        against = timed(_with(at_rest))
        for key, kind in Effects.every().items():
            try:
                if scene.solver.dynamic is None and issubclass(kind, BodyEffect):
                    found[key] = _of_solve(at_rest, key)
                elif not _only_moves(scene, kind):
                    found[key] = against(_with(at_rest, key))
            except MagmpmError:  # one that can't act on this body, or not at its example's settings
                continue
    return found


def _only_moves(scene: Scene, kind: type[Effect]) -> bool:
    """True if an effect takes no part in a scene at rest, or along equilibria."""
    return scene.solver.dynamic is None and kind.ONLY_IN_MOTION


def _with(scene: Scene, *keys: str) -> Scene:
    """The scene with these effects alone, at its own settings or those of their keys' examples; its kernels are compiled.

    Raises InputError where the scene can't have them.
    """
    settings: Plain = dict.fromkeys(Effects.every())
    for key in keys:
        examples = Effects.model_fields[key].examples or [{}]
        named = getattr(scene.effects, key)
        settings[key] = named or getattr(validate(Effects, {key: examples[0]}, "example"), key)
    found = scene.with_effects(**settings)
    prepare_kernels(found)
    return found


def _steps(bare: Scene) -> Timed:
    """Per cent that a scene's effects add to a step of its motion, by a function of that scene."""
    part = 0.004  # s, as long as a thread is left alone on most machines
    plain = stepping(build(bare))
    plain(1)
    steps = int(np.clip(part / max(_seconds(lambda: plain(1)), 1e-9), 2, 1000))

    def against(scene: Scene) -> float:
        ours = stepping(build(scene))
        return added_percent(lambda: ours(steps), lambda: plain(steps), pairs=9)

    return against


def stepping(model: Model) -> Callable[[int], None]:
    """A function that takes a number of steps in which nothing moves. It raises MagmpmError where the motion breaks."""
    motion = TotalMotion(model)
    still = 1e-12  # s

    def take(steps: int) -> None:
        _, broken = motion.advance(steps, still, model.effects)
        if broken:
            raise MagmpmError("the motion can't begin with this effect")

    return take


def _newton_steps(bare: Scene) -> Timed:
    """Per cent that a scene's effects add to a Newton step, energy, gradient, tangent and its factors, by a function of that scene."""
    plain = _energy(bare)
    start = straight(plain.model)

    def evaluate(energy: Energy) -> None:
        energy.tangent(energy.at(start))

    evaluate(plain)
    evaluating = _seconds(lambda: evaluate(plain))
    factoring = _seconds(plain.matrix.factor)

    def against(scene: Scene) -> float:
        ours = _energy(scene)
        added = added_percent(lambda: evaluate(ours), lambda: evaluate(plain), pairs=5)
        return added * evaluating / (evaluating + factoring)

    return against


def _energy(scene: Scene) -> Energy:
    """Energy of a scene at rest, as a Newton step evaluates it."""
    moment = scene.path_times()[0] if scene.in_time else None
    return Energy(static_model(build(scene, time=moment)))


def _of_solve(scene: Scene, key: str) -> float:
    """Per cent by which an effect between all particles lengthens a whole solve, as it also changes the number of steps."""
    others = [name for name in scene.effects.named() if name != key]
    ours = model_at_rest(_with(scene, *others, key))
    plain = model_at_rest(_with(scene, *others))
    return added_percent(lambda: solve_static(ours), lambda: solve_static(plain), pairs=2)


def added_percent(ours: Run, plain: Run, *, pairs: int) -> float:
    """Per cent by which one run takes longer than another: the median of pairs, of which every second one is the other way round."""
    ratios = []
    ours()
    plain()
    for k in range(pairs):
        first, second = (ours, plain) if k % 2 else (plain, ours)
        seconds = {first: _seconds(first)}
        seconds[second] = _seconds(second)
        ratios.append(seconds[ours] / max(seconds[plain], 1e-9))
    return 100 * (float(np.median(ratios)) - 1)


def _seconds(run: Run) -> float:
    """Processor time of this thread, s."""
    begun = time.thread_time()
    run()
    return time.thread_time() - begun


@contextmanager
def _one_thread() -> Iterator[None]:
    most = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(most)
