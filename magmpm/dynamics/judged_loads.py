"""Where the grid of a path of equilibria, or of a motion that settles, is judged: at some of its equilibria (statics.resolution)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.dynamics.path_loads import FeedLoads, FieldLoads
from magmpm.effects import acting
from magmpm.errors import SceneError
from magmpm.results import measures
from magmpm.results.result import Result
from magmpm.scene import Scene, memory
from magmpm.statics import axis
from magmpm.statics.equilibrium import Equilibrium
from magmpm.statics.ladder import Load, Loads, OnStep
from magmpm.statics.layout import StaticModel
from magmpm.statics.resolution import at_rest, check_possible, choose

JUDGED = 3  # equilibria of a path: at equal parts of its times, the last one among them
SETTLES = "a motion is judged at the equilibrium that it settles at"
TOUCHING = ("ground", "walls", "self_contact")


def of_path(scene: Scene) -> tuple[Loads, list[float]]:
    """The loads at which a path of equilibria is judged, and their times, s."""
    times = scene.path_times()
    chosen = sorted({times[k] for k in np.linspace(0, len(times) - 1, JUDGED + 1).round().astype(int)[1:]})

    def loads(on_grid: Scene) -> list[Load]:
        return [_at(on_grid, t) for t in bent]

    coarse = scene.with_cells(2)
    bent = [t for t in chosen if _along(coarse, t).bends(t)]
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


def resolved(scene: Scene, run: Callable[[Scene], Result], prepare: Callable[[Scene], float], on_step: OnStep | None) -> Result:
    """A path or a motion on the grid that is chosen for the error that its scene asks for, with that error.

    run: computes it on a grid; prepare: loads a scene's kernels, and returns the seconds it took. Raises SceneError, and as both do.
    """
    path = scene.solver.quasi_static is not None
    if scene.resolution.seconds is not None:
        why = "a time can be asked for a single equilibrium: what a path or a motion takes, its branch or its stable step decides"
        raise _refused(scene, why, "ask for an error, or give `cells_across`")
    begun = time.perf_counter()
    check_possible(scene)
    loads, times = of_path(scene) if path else (of_motion(scene), [])
    coarse = scene.with_cells(2)
    compiled = prepare(coarse if path else at_its_rest(coarse))
    choice = choose(scene, loads, on_step)
    judging = time.perf_counter() - begun - compiled
    result = run(choice.scene)
    told, error, warnings = dict(choice.told), choice.error, list(result.warnings)
    if path:
        told["judged_at"] = times
    else:
        rest = choice.models[-1]
        wanted = scene.resolution.allowed(scene.length) or 0.0
        told["from_rest"] = _from_rest(result, rest, choice.found[-1].point.grid, scene.resolution.of)
        error += told["from_rest"]
        told["error_of_length"] = error / scene.length
        if error > wanted:
            warnings.append(
                f"resolution: the motion ends {1e3 * told['from_rest']:.3g} mm from its rest, so the error asked for, "
                f"{1e3 * wanted:.3g} mm, is not met: let it last longer, or damp it more"
            )
    seconds = {**result.seconds, "setup": result.seconds["setup"] + judging, "compile": result.seconds["compile"] + compiled}
    return replace(result, scene_hash=scene.hash(), error_estimate=error, resolution=told, seconds=seconds, warnings=warnings)


def _from_rest(result: Result, model: StaticModel, grid: Array, of: str) -> float:
    """Distance (m) between the end of a motion and its rest, where the error is meant."""
    if of == "tip":
        return float(np.linalg.norm(result.tip - axis.tip(model, grid)))
    return measures.largest_distance(result, axis.centreline(model, grid))
