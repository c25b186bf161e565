"""Where the grid of a path of equilibria, or of a motion that settles, is judged: at some of its equilibria (statics.resolution)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.dynamics.path_loads import FeedLoads, FieldLoads
from magmpm.effects import acting
from magmpm.errors import SceneError, SolveError
from magmpm.results import measures
from magmpm.results.result import Result
from magmpm.scene import Scene, memory, remedies
from magmpm.scene.coarsest import coarsest_cells
from magmpm.scene.joints import without_joints
from magmpm.statics import axis
from magmpm.statics.equilibrium import Equilibrium
from magmpm.statics.judged_times import judged_times
from magmpm.statics.ladder import Load, Loads, OnStep, particles, step_work
from magmpm.statics.layout import StaticModel
from magmpm.statics.resolution import at_rest, check_possible, choose, nothing

SETTLES = "a motion is judged at the equilibrium that it settles at"
TOUCHING = ("ground", "walls", "self_contact")


def of_path(scene: Scene) -> tuple[Loads, list[float]]:
    """The loads at which a path of equilibria is judged, and their times, s."""
    def loads(on_grid: Scene) -> list[Load]:
        return [_at(on_grid, t) for t in bent]

    coarse = scene.with_cells(coarsest_cells(scene))
    bent = [t for t in judged_times(scene) if _along(coarse, t).bends(t)]
    if not bent:
        raise _refused(scene, "all of the body is in its guide, where nothing bends", "push it out, or give `cells_across`")
    return loads, bent


def of_motion(scene: Scene) -> Loads:
    """The load of a motion's rest: the equilibrium that it settles at. Raises SceneError where it has none that is known."""
    touching = [name for name in TOUCHING if getattr(scene.effects, name) is not None]
    if touching or scene.effects.feed is not None:
        name = touching[0] if touching else "feed"
        raise _refused(scene, f"{SETTLES}, and with {name} that is not known", "give `cells_across`")
    if scene.body.shape.clamp == "none":
        raise _refused(scene, f"{SETTLES}, and a free body has none", "give `cells_across`")
    over = scene.field.over_time
    if over is not None and over.endless is not None:
        raise _refused(scene, f"{SETTLES}, and the field's {over.endless} has no end", "give `cells_across`")
    return lambda on_grid: at_rest(at_its_rest(on_grid))


def at_its_rest(scene: Scene) -> Scene:
    """The scene of the equilibrium that a motion settles at: without what acts in motion only."""
    data = scene.to_si()
    effects = {key: value for key, value in data["effects"].items() if key not in acting.ONLY_IN_MOTION}
    solver = {key: value for key, value in data["solver"].items() if key in ("anti_locking", "static")}
    return Scene.from_si({**data, "effects": effects, "solver": solver})


def _along(scene: Scene, at: float) -> FieldLoads | FeedLoads:
    with memory.within(scene):
        return FieldLoads(scene, at) if scene.effects.feed is None else FeedLoads(scene, at)


def _at(scene: Scene, at: float) -> Load:
    along = _along(scene, at)

    def first(on_step: OnStep | None) -> Equilibrium:
        return along.first(at, on_step)

    return Load(along.at(at), first)


def _refused(scene: Scene, rule: str, remedy: str) -> SceneError:
    return SceneError(f"resolution.{'error' if scene.resolution.error is not None else 'seconds'}", rule=rule, remedy=remedy)


def resolved(scene: Scene, run: Callable[..., Result], prepare: Callable[[Scene], float], on_step: OnStep | None) -> Result:
    """A path or a motion on the grid that is chosen for the error that its scene asks for, with that error.

    run: computes it on a grid; prepare: loads a scene's kernels, and returns the seconds it took. Raises SceneError, and as both do.
    """
    path = scene.solver.quasi_static is not None
    begun = time.perf_counter()
    check_possible(scene)
    loads, times = of_path(scene) if path else (of_motion(scene), [])
    coarse = scene.with_cells(coarsest_cells(scene))
    compiled = prepare(coarse if path else at_its_rest(coarse))
    known: dict[int, Result] = {}
    beside: Callable[[int], float] = nothing
    if scene.resolution.seconds is not None:  # the coarsest grid's run tells what finer ones take, and is the answer if none fits
        compiled += prepare(coarse)
        known[coarse.resolution.cells_across], seconds = _within(scene.resolution.seconds, begun + compiled, run, coarse)
        beside = _longer(scene, seconds)
    try:
        with remedies.named(scene):
            choice = choose(scene, loads, on_step, begun=begun + compiled, beside=beside)
    except SolveError as failed:  # its state is of an equilibrium that is judged, none of the path or the motion
        failed.state = next(iter(known.values()), None)
        raise
    cells = choice.scene.resolution.cells_across
    judging = time.perf_counter() - begun - compiled
    if cells in known:
        judging -= sum(known[cells].seconds[key] for key in ("setup", "solve"))  # told as those of the run
    result = known.get(cells) or run(choice.scene)
    told, error, warnings = dict(choice.told), choice.error, without_joints(result.warnings)
    if path:
        told["judged_at"] = times
    else:
        rest = choice.models[-1]
        wanted = scene.resolution.allowed(scene.length)
        told["from_rest"] = _from_rest(result, rest, choice.found[-1].point.grid, scene.resolution.of)
        error += told["from_rest"]
        told["error_of_length"] = error / scene.length
        if wanted is not None and error > wanted:
            warnings.append(
                f"resolution: the motion ends {1e3 * told['from_rest']:.3g} mm from its rest, so the error asked for, "
                f"{1e3 * wanted:.3g} mm, is not met: let it last longer, or damp it more"
            )
    spent = {**result.seconds, "setup": result.seconds["setup"] + judging, "compile": result.seconds["compile"] + compiled}
    return replace(result, scene_hash=scene.hash(), error_estimate=error, resolution=told, seconds=spent, warnings=warnings)


def _within(limit: float, begun: float, run: Callable[..., Result], coarse: Scene) -> tuple[Result, float]:
    """The run on the coarsest grid and its seconds. Raises SceneError as soon as it takes longer than the time asked for."""
    ran = time.perf_counter()

    def watched(step: int, at: float) -> None:
        if time.perf_counter() - begun > limit:
            done = f", of whose {coarse.duration:g} s {100 * at / coarse.duration:.2g} % were done by then" if at > 0.0 else ""
            raise SceneError(
                "resolution.seconds",
                received=f"{limit:g} s",
                rule=f"must be enough for the coarsest grid, {coarse.resolution.cells_across} cells across{done}",
                remedy=f"allow {1.5 * limit * coarse.duration / at:.2g} s or more" if at > 0.0 else "allow much more",
            )

    return run(coarse, on_progress=watched), time.perf_counter() - ran


def _longer(scene: Scene, coarsest: float) -> Callable[[int], float]:
    """Seconds of a run with so many cells across, from those of the coarsest grid.

    Along a path they grow as a Newton step does; of a motion with particles and steps together, as the fourth power of the cells at most.
    """

    first = coarsest_cells(scene)

    def takes(cells: int) -> float:
        if cells == first:
            return 0.0  # it is done
        fine, coarse = scene.with_cells(cells), scene.with_cells(first)
        if scene.solver.quasi_static is not None:
            return coarsest * step_work(fine) / step_work(coarse)
        return coarsest * particles(fine) / particles(coarse) * cells / first

    return takes


def _from_rest(result: Result, model: StaticModel, grid: Array, of: str) -> float:
    """Distance (m) between the end of a motion and its rest, where the error is meant."""
    if of == "tip":
        return float(np.linalg.norm(result.tip - axis.tip(model, grid)))
    return measures.largest_distance(result, axis.centreline(model, grid))
