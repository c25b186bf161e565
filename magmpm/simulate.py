"""run(scene) -> Result: one simulation, as the scene says."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from magmpm.effects import acting as effects
from magmpm.errors import InputError, SolveError, report
from magmpm.inputs.yaml_document import of_file
from magmpm.model import Model, build
from magmpm.precompile import DERIVATIVES, PROOFS, SOLVE, prepare_kernels
from magmpm.results import measures
from magmpm.results.file_names import CHECKPOINT, NUMBERS, OF_EQUILIBRIUM, forget_motion
from magmpm.results.folder_lock import folder_lock, written_folder
from magmpm.results.result import Result
from magmpm.results.sensitivities import Sensitivities
from magmpm.results.strain import Strain, strain_of
from magmpm.results.versions import versions
from magmpm.rod.cosserat import RodShape
from magmpm.scene import Scene, load_scene, memory, remedies
from magmpm.scene.coarsest import coarsest_cells
from magmpm.scene.variables import variables
from magmpm.scene.warnings import of_known_error
from magmpm.statics import axis as axis_of_unknowns
from magmpm.statics.effects_choice import choose_effects
from magmpm.statics.effects_choice import missed_effects as missed_effects
from magmpm.statics.equilibrium import Equilibrium, Following, solve_static
from magmpm.statics.layout import StaticModel, static_model
from magmpm.statics.linearized import Linearized
from magmpm.statics.resolution import choose
from magmpm.statics.stability import on_the_brink
from magmpm.statics.unnamed_weight import missed_weight

if TYPE_CHECKING:
    from magmpm.dynamics.quasi_static import PathState
    from magmpm.dynamics.time_loop import SimulationState

Progress = Callable[[int, float], None]


def run(
    scene: Scene | Path | str,
    *,
    start: Result | RodShape | None = None,
    folder: Path | str | None = None,
    resume: bool = False,
    on_progress: Progress | None = None,
    on_begin: Callable[[], None] | None = None,
) -> Result:
    """Simulate a scene: its equilibrium, equilibria along time if it has solver.quasi_static, or its motion if it has solver.dynamic.

    scene: a Scene, or the path of a scene file.
    start: statics only: the result of a similar scene on the same grid, whose solution the solve starts from; or the shape of a rod: the
    equilibrium near it is found, be it on the branch that grows from zero load or not.
    folder: where the result is saved (Result.save), and a motion's frames and checkpoints are written; None: nowhere. What it held is
    replaced. resume: go on from the checkpoint in folder; without one, as for an equilibrium, the run begins at the start.
    on_progress(step, number): called after each Newton step with its energy decrement (no unit), or during a motion with its time in s.
    on_begin(): called when a motion starts from its beginning, before anything is written.

    Everything in the Result is in SI. docs/design.md names the method's formulas and their sources.
    Raises InputError before the run if the scene or the file is wrong, or if another process writes to folder; its message names the
    file, line, key and value if scene is a path (otherwise SceneError names the key and value).
    Raises SolveError if no equilibrium is found or a motion fails; its state is the last good Result (converged False), or None; that of a
    motion is saved in folder. Raises BudgetError if a motion would exceed its limit of disk space. Raises ValueError if start is on another
    grid, or given for what moves, or resume is asked without a folder; TypeError if start is no Result.
    """
    if not isinstance(scene, Scene):
        with of_file(scene):
            return run(load_scene(scene), start=start, folder=folder, resume=resume, on_progress=on_progress, on_begin=on_begin)
    if start is not None and not isinstance(start, Result | RodShape):
        raise TypeError(f"start: received {start!r}; must be a Result, as run(scene) returns it, a RodShape, or None")
    if folder is None:
        if resume:
            raise ValueError("resume: received True without a folder; give the folder that holds the motion and its checkpoint")
        return simulated(scene, start=start, on_progress=on_progress, on_begin=on_begin)

    begun = resume

    def begin() -> None:
        nonlocal begun
        begun = True
        for name in OF_EQUILIBRIUM:  # of an earlier run: not this motion's
            (Path(folder) / name).unlink(missing_ok=True)
        if on_begin is not None:
            on_begin()

    with folder_lock(folder):
        try:
            result = simulated(scene, start=start, folder=folder, resume=resume, on_progress=on_progress, on_begin=begin)
        except SolveError as error:
            if scene.in_time and error.state is not None:
                _save_last(error, folder, begun)
            raise
        if not scene.in_time:
            forget_motion(folder)
        result.save(folder)
    return result


def _save_last(error: SolveError, folder: Path | str, begun: bool) -> None:
    """Save the last good state of what runs along time; begun: whether its frames are there already. A motion that waits there stays."""
    if not begun and (Path(folder) / CHECKPOINT).exists() and not (Path(folder) / NUMBERS).exists():
        return
    if not begun or error.state.load_share < 1.0:  # no equilibrium of it was written: it takes the place of what was there
        forget_motion(folder)
    try:
        error.state.save(folder)
    except OSError as trouble:  # a full disk, say: why the motion failed matters more
        raise error from trouble


def simulated(
    scene: Scene,
    *,
    start: Result | RodShape | Following | None = None,
    folder: Path | str | None = None,
    resume: bool = False,
    on_progress: Progress | None = None,
    on_begin: Callable[[], None] | None = None,
    on_state: Callable[[PathState], None] | None = None,
) -> Result:
    """As `run`, for who saves the result: folder takes frames and checkpoints, nothing else. on_state(state): after each of a path."""
    on_grid = partial(simulated, folder=folder, resume=resume, on_progress=on_progress, on_begin=on_begin)
    if scene.effects.auto:
        choice = choose_effects(scene)
        return replace(on_grid(choice.scene, start=start), effects_chosen=choice.told)
    if scene.resolution.asked and scene.in_time:
        from magmpm.dynamics.judged_run import resolved  # equilibria need neither it nor HDF5

        return resolved(scene, on_grid, partial(prepare_kernels, uses=(SOLVE, PROOFS)), folder=folder, on_begin=on_begin)
    if start is not None and scene.in_time:
        raise ValueError("start: received one for a scene that moves, which begins undeformed; leave it out")
    if scene.static:
        scene.check_energy()
    with remedies.named(scene):
        if scene.solver.quasi_static is not None:
            return _path(scene, folder, resume, on_progress, on_begin, on_state)
        if scene.solver.dynamic is not None:
            return _motion(scene, folder, resume, on_progress, on_begin)
        result, found = _at_rest(scene, start, on_progress)
        return result if start is not None else replace(result, warnings=[*result.warnings, *missed_weight(scene, found)])


def sensitivities(scene: Scene | Path | str, of: Sequence[str] | None = None, *, start: Result | RodShape | None = None) -> Sensitivities:
    """Solve a scene for its equilibrium, and find how the shape answers to numbers of the scene: exact first derivatives.

    scene: a Scene, or the path of a scene file. start: as of `run`. of: the kinds of variables, in any order; all that the scene has
    unless given:

    * magnetization: the direction of each magnetized region, toward growing azimuth about +z and toward growing elevation, per rad;
    * field: its uniform part, along x, y and z, per T;
    * remanence (T), shear_modulus (Pa; the bulk modulus in proportion), density (kg/m^3): of each material that the body uses;
    * length: of each segment of a catheter or strip, m: the body gets longer by as much; diameter: of a catheter, m (a tube's bore stays).

    The answer has names, units, variables, result, tip (3, k) m, centreline (stations, 3, k) m, `at` and `adjoint` (Sensitivities).
    Method: the implicit function theorem, dc/dp = -K^-1 dr/dp; docs/design.md, "Sensitivities".
    Raises InputError as `run` does, for a name in `of` that is not known or of which the scene has no variable, and for a scene that
    moves; SolveError as `run` does; ValueError and TypeError for a wrong start.
    """
    if not isinstance(scene, Scene):
        with of_file(scene):
            return sensitivities(load_scene(scene), of, start=start)
    if start is not None and not isinstance(start, Result | RodShape):
        raise TypeError(f"start: received {start!r}; must be a Result, as run(scene) returns it, a RodShape, or None")
    if not scene.static:
        rule, remedy = "sensitivities are those of an equilibrium", "leave out solver.dynamic, or differentiate runs by differences"
        raise InputError(report("solver.dynamic", received="a motion", rule=rule, remedy=remedy))
    wanted = variables(scene, of)
    result, found = _at_rest(scene, start, None, (SOLVE, DERIVATIVES))
    return Sensitivities(result, wanted, Linearized(found, wanted))


def _at_rest(
    scene: Scene, start: Result | RodShape | Following | None, on_progress: Progress | None, uses: Sequence[str] = (SOLVE,)
) -> tuple[Result, Equilibrium]:
    """The equilibrium of a scene, as a Result and as the solver found it. uses: of the kernels (precompile)."""
    if scene.resolution.asked:
        return _resolved(scene, start, on_progress, uses)
    begun = time.perf_counter()
    with memory.within(scene):
        model = static_model(build(scene))
    compiled = prepare_kernels(scene, uses=uses)
    setup = time.perf_counter() - begun - compiled
    begun = time.perf_counter()
    try:
        rod = start if isinstance(start, RodShape) else None
        following = start if isinstance(start, Following) else None
        found = solve_static(model, correction=_neighbor(model, start), rod=rod, on_step=on_progress, following=following)
    except SolveError as error:
        raise _kept(error, {"setup": setup, "compile": compiled, "solve": time.perf_counter() - begun}) from None
    return _sound(_result(model, found, {"setup": setup, "compile": compiled, "solve": time.perf_counter() - begun})), found


def _resolved(scene: Scene, start: object, on_progress: Progress | None, uses: Sequence[str]) -> tuple[Result, Equilibrium]:
    """As _at_rest, on the grid that is chosen for the error or the time that the scene asks for."""
    if start is not None:
        raise ValueError("start: received one for a scene that asks for an error, whose grids are chosen in turn; give it cells_across")
    begun = time.perf_counter()
    compiled = prepare_kernels(scene.with_cells(coarsest_cells(scene)), uses=(*uses, PROOFS))
    try:
        choice = choose(scene, on_step=on_progress)
    except SolveError as error:
        raise _kept(error, {"setup": 0.0, "compile": compiled, "solve": time.perf_counter() - begun - compiled}) from None
    told: dict[str, Any] = {"scene_hash": scene.hash(), "error_estimate": choice.error, "resolution": choice.told}
    seconds = {"setup": 0.0, "compile": compiled, "solve": time.perf_counter() - begun - compiled}
    result = _result(choice.models[-1], choice.found[-1], seconds)
    return _sound(replace(result, warnings=of_known_error(result.warnings), **told)), choice.found[-1]


def _kept(error: SolveError, seconds: dict[str, float]) -> SolveError:
    """The error with its last good equilibrium as a Result, if that is known and finite; else with none."""
    last, state = error.state, None
    if isinstance(last, Equilibrium) and last.model is not None:
        state = _result(last.model, last, seconds, error.reason)
    return type(error)(error.reason, None if state is None or state.not_finite() else state)


def _sound(result: Result) -> Result:
    """The result, if all its numbers are finite, as files need them. Raises SolveError otherwise."""
    if wrong := result.not_finite():
        raise SolveError(
            f"the solve ended with numbers that are not finite (in {', '.join(wrong)}), so there is no result; "
            "remedy: check the units of sizes, loads and materials; what is smallest and largest may be too far apart for the grid"
        )
    return result


def _by_time(on_progress: Progress | None) -> Callable[[float, int], None]:
    """A caller's on_progress(steps, time) as the solvers along time call it: (time, steps)."""
    return lambda at, steps: None if on_progress is None else on_progress(steps, at)


def _motion(
    scene: Scene, folder: Path | str | None, resume: bool, on_progress: Progress | None, on_begin: Callable[[], None] | None
) -> Result:
    from magmpm.dynamics import time_loop as dynamics  # needs HDF5: 20 MB that static designs do without

    begun = time.perf_counter()
    with memory.within(scene):
        model = build(scene)  # refuses what can't begin, before its kernels are compiled
        compiled, moved = prepare_kernels(scene), dynamics.begin(model)
    seconds = {"setup": 0.0, "compile": compiled, "solve": 0.0}
    ready = time.perf_counter()
    try:
        with written_folder(folder, resume, on_begin):
            moved = dynamics.integrate(moved, folder=folder, resume=resume, on_progress=_by_time(on_progress))
    except SolveError as error:
        seconds.update(setup=ready - begun - compiled, solve=time.perf_counter() - ready)
        state = _moved_result(error.state, seconds, error.reason) if isinstance(error.state, dynamics.SimulationState) else None
        raise type(error)(error.reason, None if state is None or state.not_finite() else state) from None
    seconds.update(setup=ready - begun - compiled, solve=time.perf_counter() - ready)
    return _sound(_moved_result(moved, seconds))


def _path(
    scene: Scene, folder: Path | str | None, resume: bool, on_progress: Progress | None, on_begin: Callable[[], None] | None,
    on_state: Callable[[PathState], None] | None,
) -> Result:  # fmt: skip
    from magmpm.dynamics import quasi_static  # single equilibria need neither it nor HDF5

    begun, compiled = time.perf_counter(), prepare_kernels(scene)
    seconds = {"setup": 0.0, "compile": compiled, "solve": 0.0}

    def result_of(state: PathState, failure: str = "") -> Result:
        seconds["solve"] = time.perf_counter() - begun - compiled
        return _path_result(state, seconds, failure)

    try:
        with written_folder(folder, resume, on_begin), memory.within(scene):
            state = quasi_static.follow(scene, folder=folder, resume=resume, on_progress=_by_time(on_progress), on_state=on_state)
    except SolveError as error:
        failed = result_of(error.state, error.reason) if isinstance(error.state, quasi_static.PathState) else None
        raise type(error)(error.reason, None if failed is None or failed.not_finite() else failed) from None
    return _sound(result_of(state))


def _path_result(state: PathState, seconds: dict[str, float], failure: str = "") -> Result:
    shape = state.shape
    last: dict[str, Any] = next(reversed(state.rows), {"iterations": state.iterations, "stability": None})
    return Result(
        **_particles(shape.model, shape.position, shape.F, state.time),
        grid_correction=np.zeros((0, 0)),
        centreline=shape.centreline,
        tip=shape.tip,
        converged=not failure,
        iterations=last["iterations"],
        dof=shape.dof,
        min_det_F=shape.min_det_F,
        max_det_F=shape.max_det_F,
        energy=state.energy,
        seconds=seconds,
        warnings=_warnings(shape.model.scene) + state.warnings + state.strain.warnings(shape.model) + on_the_brink(last["stability"]),
        time=state.time,
        formulation="quasi_static",
        steps=state.rows,
        jumps=state.jumps,
        load_share=state.load_share,
        stability=last["stability"],
        **_strained(state.strain),
        failure=failure,
    )


def _moved_result(moved: SimulationState, seconds: dict[str, float], failure: str = "") -> Result:
    model = moved.motion.model
    J, axis = np.linalg.det(moved.F), measures.axis_of_particles(model, moved.x)
    return Result(
        **_particles(model, moved.x, moved.F, moved.time),
        grid_correction=np.zeros((0, 0)),
        centreline=axis,
        tip=axis[-1, 1:] if len(axis) else measures.region_means(model, moved.x)[-1],
        converged=not failure,
        iterations=moved.steps,
        dof=moved.motion.unknowns,
        min_det_F=float(J.min()),
        max_det_F=float(J.max()),
        energy=sum(moved.energies.values()) - moved.energies["kinetic"],
        seconds=seconds,
        warnings=_warnings(model.scene) + moved.warnings + moved.control.warnings() + moved.strain.warnings(model) + moved.lost.warnings(),
        time=moved.time,
        time_step=moved.dt,
        stable_steps={name: step for name, step in moved.stable.named.items() if math.isfinite(step)},
        formulation=moved.motion.formulation,
        kinetic_energy=moved.energies["kinetic"],
        **_strained(moved.strain),
        failure=failure,
    )


def _neighbor(model: StaticModel, start: object) -> NDArray[np.float64] | None:
    """The grid correction of a neighboring design: nearly the same for this design."""
    if not isinstance(start, Result):
        return None
    if start.grid_correction.shape == (model.layout.planes, model.layout.m):
        return start.grid_correction
    raise ValueError("start: the neighboring result must be on the same grid")


def _warnings(scene: Scene) -> list[str]:
    """What the author of the scene may not have meant, and about the field's map."""
    return [*scene.warnings(), *effects.warnings(scene), *(scene.outside_field().warnings if scene.effects.in_a_field else [])]


def _particles(model: Model, position: NDArray[np.float64], F: NDArray[np.float64], time: float | None) -> dict[str, Any]:
    """What every result holds: the scene, the particles, and the field at the body's center at a time (s; None in statics)."""
    scene, particles = model.scene, model.particles
    center = particles.volume @ position / particles.volume.sum()
    return {
        "name": scene.name,
        "scene": scene.to_si(),
        "scene_hash": scene.hash(),
        "particle_reference": particles.position,
        "particle_position": position,
        "particle_volume": particles.volume,
        "particle_segment": particles.segment,
        "particle_det_F": np.linalg.det(F),
        "segment_center": measures.region_means(model, position),
        "segment_remanence": measures.region_means(model, np.einsum("nij,nj->ni", F, model.remanence[:, :3])),
        "field": scene.outside_field().at(center, time)[0] if scene.effects.in_a_field else np.zeros(3),
        "particles": len(position),
        "section": model.section,
        "versions": versions(),
    }


def _strained(strain: Strain) -> dict[str, Any]:
    """What every result holds about its strain."""
    return {"largest_stretch": strain.stretch, "tightest_radius": strain.radius if math.isfinite(strain.radius) else None}


def _result(model: StaticModel, found: Equilibrium, seconds: dict[str, float], failure: str = "") -> Result:
    scene, point = model.scene, found.point
    position, strain = point.position, strain_of(model, point.position, point.F)
    return Result(
        **_particles(model, position, point.F, model.time),
        grid_correction=found.correction,
        centreline=axis_of_unknowns.centreline(model, point.grid),
        tip=measures.region_means(model, position)[-1] if model.line is None else axis_of_unknowns.tip(model, point.grid),
        converged=found.converged,
        iterations=found.steps,
        dof=model.dof,
        min_det_F=point.min_det_F,
        max_det_F=point.max_det_F,
        energy=point.energy,
        seconds=seconds,
        warnings=_warnings(scene) + found.warnings + strain.warnings(model) + on_the_brink(found.stability),
        **_strained(strain),
        load_share=found.load_share,
        stability=found.stability,
        failure=failure,
    )
