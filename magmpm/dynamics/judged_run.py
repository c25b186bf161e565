"""A path of equilibria, or a motion that settles, on the grid that is chosen for the error or the time that its scene asks for."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.dynamics.judged_loads import at_its_rest, of_motion, of_path, refused
from magmpm.dynamics.path_judged import PathSeen
from magmpm.errors import SceneError, SolveError, TimeOver
from magmpm.results import measures
from magmpm.results.file_names import forget_motion
from magmpm.results.result import Result
from magmpm.results.tried_grids import tried_grids
from magmpm.scene import Scene, remedies
from magmpm.scene.coarsest import coarsest_cells
from magmpm.scene.warnings import of_known_error
from magmpm.statics import axis
from magmpm.statics.error_estimate import distance
from magmpm.statics.ladder import Ladder, Loads, particles, step_work
from magmpm.statics.layout import StaticModel
from magmpm.statics.resolution import Choice, check_possible, choose, nothing

PROVEN = 2.0  # times the coarsest grid's run: what it takes with the proof of its error, if the rest goes on as it began
TRIED = 3  # grids on which a path is tried, from the coarsest on


def resolved(
    scene: Scene,
    run: Callable[..., Result],
    prepare: Callable[[Scene], float],
    *,
    folder: Path | str | None,
    on_begin: Callable[[], None] | None,
) -> Result:
    """A path or a motion on the grid that is chosen for the error that its scene asks for, with that error.

    run: computes it on a grid, and writes to the folder (simulate.simulated, which tells on_begin); prepare: loads a scene's kernels, and
    returns the seconds it took. Raises SceneError, and as both do.
    """
    check_possible(scene)
    if scene.resolution.seconds is None or folder is None:
        return _on_grids(scene, run, prepare, folder is not None)
    with tried_grids(folder, on_begin) as apart:  # several grids are run in all, and one is the answer
        on_grid = partial(run, folder=apart, resume=False, on_begin=partial(forget_motion, apart))
        return _on_grids(scene, on_grid, prepare, True)


def _on_grids(scene: Scene, run: Callable[..., Result], prepare: Callable[[Scene], float], in_folder: bool) -> Result:
    return _motion(scene, run, prepare) if scene.solver.quasi_static is None else _path(scene, run, prepare, in_folder)


def _path(scene: Scene, run: Callable[..., Result], prepare: Callable[[Scene], float], in_folder: bool) -> Result:
    """A path: on the coarsest grid first, whose equilibria tell where it is judged.

    That run writes nothing, since the error may still be refused: then what the folder holds stays. Unless a time is asked for, of which a
    second run of the same grid would take too much.
    """
    begun, timed = time.perf_counter(), scene.resolution.seconds is not None
    aside = run if timed or not in_folder else partial(run, folder=None, resume=False, on_begin=None)
    try:
        compiled, coarse, seen, first, seconds = _coarse_path(scene, aside, prepare, begun)
    except TimeOver as late:
        late.state = late.state if timed or not in_folder else None  # the folder is as it was
        raise
    except SolveError:
        if in_folder and not timed:
            run(scene.with_cells(coarsest_cells(scene)))  # fails again, and leaves in the folder what it has
        raise
    cells = coarse.resolution.cells_across
    loads, times = of_path(scene, seen, cells)
    beside = _longer(scene, seconds, cells) if timed else nothing
    choice = _chosen(scene, loads, {cells: first}, begun=begun + compiled, beside=beside, coarsest=cells)
    judging = time.perf_counter() - begun - compiled
    if choice.scene.resolution.cells_across == cells and (timed or not in_folder):
        result, judging = first, judging - seconds  # told as those of the run
    else:
        seen = PathSeen(scene.length, times=times)
        result = run(choice.scene, on_state=seen.see)
    told, warnings = {**choice.told, "judged_at": times}, of_known_error(result.warnings)
    told["from_path"], at = max(_from_path(scene, choice, seen, times), default=(0.0, times[-1]))
    error, wanted = choice.error + told["from_path"], scene.resolution.allowed(scene.length)
    told["error_of_length"] = error / scene.length
    if wanted is not None and error > wanted:
        warnings.append(
            f"resolution: at t = {at:.6g} s the path is {1e3 * told['from_path']:.3g} mm from the equilibrium whose error was proven, on "
            f"another branch perhaps, so the error asked for, {1e3 * wanted:.3g} mm, is not met: compare runs of more `cells_across`"
        )
    warnings += _not_told(seen)
    spent = {**result.seconds, "setup": result.seconds["setup"] + judging, "compile": result.seconds["compile"] + compiled}
    return replace(result, scene_hash=scene.hash(), error_estimate=error, resolution=told, seconds=spent, warnings=warnings)


def _coarse_path(
    scene: Scene, run: Callable[..., Result], prepare: Callable[[Scene], float], begun: float
) -> tuple[float, Scene, PathSeen, Result, float]:
    """The path on the coarsest grid on which it is found: seconds of compiling, the scene, what it shows, its result and seconds."""
    compiled, least, failure = 0.0, coarsest_cells(scene), None
    for cells in range(least, least + TRIED):
        coarse, seen = scene.with_cells(cells), PathSeen(scene.length)
        compiled += prepare(coarse)
        try:
            result, seconds = _within(scene.resolution.seconds, begun + compiled, partial(run, on_state=seen.see), coarse)
        except TimeOver:
            raise
        except SolveError as error:  # some bodies need finer cells to be solved at all
            failure = failure or error
            continue
        if not seen.grids:
            raise refused(scene, "all of the body is in its guide, where nothing bends", "push it out, or give `cells_across`")
        return compiled, coarse, seen, result, seconds
    assert failure is not None
    raise failure


def _from_path(scene: Scene, choice: Choice, seen: PathSeen, times: list[float]) -> list[tuple[float, float]]:
    """How far (m) the path that was run is from each equilibrium at which it was judged, on the same grid, and the time (s)."""
    ladder = Ladder(scene, lambda on_grid: [])
    found = [one for one in zip(times, choice.models, choice.found, strict=True) if one[0] in seen.grids]
    return [(distance(ladder.points(model, one.point.grid), ladder.points(model, seen.grids[t])), t) for t, model, one in found]


def _not_told(seen: PathSeen) -> list[str]:
    """Warnings of where the error of a path does not tell all: around its jumps, and near critical loads."""
    warnings = [
        f"resolution: no error is told from t = {begins:.6g} to {ends:.6g} s, around a jump of the path, which comes sooner or later "
        "on other grids; the error told is that of the equilibria before and after"
        for begins, ends in seen.near_jumps()
    ]
    if (soft := seen.soft_at()) is not None:
        warnings.append(
            f"resolution: at t = {soft:.6g} s the body is near a critical load (its `stability` is low): on another grid the path may jump "
            "there, and be elsewhere from then on, which the error does not tell"
        )
    return warnings


def _chosen(
    scene: Scene, loads: Loads, known: dict[int, Result], *, begun: float, beside: Callable[[int], float], coarsest: int | None = None,
) -> Choice:  # fmt: skip
    """The choice of a grid; where it fails, with what is known as the state."""
    try:
        with remedies.named(scene):
            return choose(scene, loads, begun=begun, beside=beside, coarsest=coarsest)
    except SolveError as failed:  # its state is of an equilibrium that is judged, none of the path or the motion
        coarse = next(iter(known.values()), None)
        failed.state = None if coarse is None else replace(coarse, converged=False, failure=failed.reason)
        raise


def _motion(scene: Scene, run: Callable[..., Result], prepare: Callable[[Scene], float]) -> Result:
    """A motion, judged at the equilibrium that it settles at."""
    begun = time.perf_counter()
    loads = of_motion(scene)
    coarse = scene.with_cells(coarsest_cells(scene))
    compiled = prepare(at_its_rest(coarse))
    known: dict[int, Result] = {}
    beside: Callable[[int], float] = nothing
    if scene.resolution.seconds is not None:  # the coarsest grid's run tells what finer ones take, and is the answer if none fits
        compiled += prepare(coarse)
        known[coarse.resolution.cells_across], seconds = _within(scene.resolution.seconds, begun + compiled, run, coarse)
        beside = _longer(scene, seconds, coarse.resolution.cells_across)
    choice = _chosen(scene, loads, known, begun=begun + compiled, beside=beside)
    cells = choice.scene.resolution.cells_across
    judging = time.perf_counter() - begun - compiled
    if cells in known:
        judging -= sum(known[cells].seconds[key] for key in ("setup", "solve"))  # told as those of the run
    result = known.get(cells) or run(choice.scene)
    told, warnings, wanted = dict(choice.told), of_known_error(result.warnings), scene.resolution.allowed(scene.length)
    told["from_rest"] = _from_rest(result, choice.models[-1], choice.found[-1].point.grid, scene.resolution.of)
    error = choice.error + told["from_rest"]
    told["error_of_length"] = error / scene.length
    if wanted is not None and error > wanted:
        warnings.append(
            f"resolution: the motion ends {1e3 * told['from_rest']:.3g} mm from its rest, so the error asked for, "
            f"{1e3 * wanted:.3g} mm, is not met: let it last longer, or damp it more"
        )
    spent = {**result.seconds, "setup": result.seconds["setup"] + judging, "compile": result.seconds["compile"] + compiled}
    return replace(result, scene_hash=scene.hash(), error_estimate=error, resolution=told, seconds=spent, warnings=warnings)


def _within(limit: float | None, begun: float, run: Callable[..., Result], coarse: Scene) -> tuple[Result, float]:
    """The run on the coarsest grid and its seconds. Raises SceneError as soon as it takes longer than the time asked for, if one is."""
    ran = time.perf_counter()
    if limit is None:
        return run(coarse), time.perf_counter() - ran

    tell = getattr(run, "keywords", {}).get("on_progress")  # of a partial

    def watched(step: int, at: float) -> None:
        if tell is not None:
            tell(step, at)
        gone = time.perf_counter() - begun
        if gone > limit:
            done = f", of whose {coarse.duration:g} s {100 * at / coarse.duration:.2g} % were done by then" if at > 0.0 else ""
            raise SceneError(
                "resolution.seconds",
                received=f"{limit:g} s",
                rule=f"must be enough for the coarsest grid, {coarse.resolution.cells_across} cells across{done}",
                remedy=f"allow {PROVEN * gone * coarse.duration / at:.2g} s or more" if at > 0.0 else "allow much more",
            )

    return run(coarse, on_progress=watched), time.perf_counter() - ran


def _longer(scene: Scene, coarsest: float, first: int) -> Callable[[int], float]:
    """Seconds of a run with so many cells across, from those of the run that is done, with `first` cells across.

    Along a path they grow as a Newton step does; of a motion with particles and steps together, as the fourth power of the cells at most.
    """

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
