"""The loads at which the grid of a path of equilibria, or of a motion that settles, is judged: at some of its equilibria."""

from __future__ import annotations

from magmpm.compiled.arrays import Array
from magmpm.dynamics.path_errors import differences
from magmpm.dynamics.path_judged import PathSeen
from magmpm.dynamics.quasi_static import loads_of
from magmpm.effects import acting
from magmpm.errors import SceneError
from magmpm.scene import Scene, memory
from magmpm.statics.equilibrium import Equilibrium, solve_from
from magmpm.statics.ladder import Load, Loads, OnStep
from magmpm.statics.resolution import at_rest

LOOKING = 0.1  # of the time asked for: what may be spent on finding the equilibria with the largest errors
SETTLES = "a motion is judged at the equilibrium that it settles at"
TOUCHING = ("ground", "walls", "self_contact")


def of_path(scene: Scene, seen: PathSeen, cells: int) -> tuple[Loads, list[float]]:
    """The loads at which a path of equilibria is judged, and their times, s.

    seen: of the path on a grid with so many cells across. There, the equilibria are the path's own; on other grids those near them. So
    what is proven is the branch that the path follows.
    """
    asked = scene.resolution.seconds
    times = seen.judged(differences(scene, seen, cells, None if asked is None else LOOKING * asked))

    def loads(on_grid: Scene) -> list[Load]:
        return [_at(on_grid, t, seen.grids[t] if on_grid.resolution.cells_across == cells else None) for t in times]

    return loads, times


def of_motion(scene: Scene) -> Loads:
    """The load of a motion's rest: the equilibrium that it settles at. Raises SceneError where it has none that is known."""
    touching = [name for name in TOUCHING if getattr(scene.effects, name) is not None]
    if touching or scene.effects.feed is not None:
        name = touching[0] if touching else "feed"
        raise refused(scene, f"{SETTLES}, and with {name} that is not known", "give `cells_across`")
    if scene.body.shape.clamp == "none":
        raise refused(scene, f"{SETTLES}, and a free body has none", "give `cells_across`")
    over = scene.field.over_time
    if over is not None and over.endless is not None:
        raise refused(scene, f"{SETTLES}, and the field's {over.endless} has no end", "give `cells_across`")
    return lambda on_grid: at_rest(at_its_rest(on_grid), of_motion=True)


def at_its_rest(scene: Scene) -> Scene:
    """The scene of the equilibrium that a motion settles at: without what acts in motion only."""
    data = scene.to_si()
    effects = {key: value for key, value in data["effects"].items() if key not in acting.ONLY_IN_MOTION}
    solver = {key: value for key, value in data["solver"].items() if key in ("anti_locking", "static")}
    return Scene.from_si({**data, "effects": effects, "solver": solver})


def _at(scene: Scene, at: float, known: Array | None) -> Load:
    """The load of a time, s. known: coefficients (planes, m) m of its equilibrium; loads that follow the shape can't begin there."""
    with memory.within(scene):
        along = loads_of(scene, at)
    model = along.at(at)

    def first(on_step: OnStep | None) -> Equilibrium:
        if known is None or acting.feels_itself(scene):
            return along.first(at, on_step)
        return solve_from(model, known, on_step=on_step)

    return Load(model, first)


def refused(scene: Scene, rule: str, remedy: str) -> SceneError:
    """Of a scene whose grid can't be judged."""
    return SceneError(f"resolution.{'error' if scene.resolution.error is not None else 'seconds'}", rule=rule, remedy=remedy)
