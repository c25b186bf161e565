"""solve(scene) -> Result: one simulation of a scene on its own grid, with the effects that it names."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from magmpm.compiled.arrays import Array, NamedNumbers, Plain
from magmpm.compiled.thread_count import one_blas_thread
from magmpm.effects import acting as effects
from magmpm.effects.base import Contact
from magmpm.errors import SolveError
from magmpm.model import Model, build
from magmpm.results import measures
from magmpm.results.folder_lock import written_folder
from magmpm.results.result import Result, versions
from magmpm.results.strain import Strain, strain_of
from magmpm.rod.cantilever import is_cantilever
from magmpm.rod.cosserat import RodShape
from magmpm.scene import Scene, memory, remedies
from magmpm.solving.precompile import SOLVE, prepare_kernels
from magmpm.statics import axis as axis_of_unknowns
from magmpm.statics.contact import Touched, contacts_at_rest
from magmpm.statics.energy import Point
from magmpm.statics.equilibrium import Equilibrium, Following, solve_static
from magmpm.statics.interacting import energy_of
from magmpm.statics.layout import StaticModel, model_at_rest
from magmpm.statics.newton import factored
from magmpm.statics.own_contact import OwnContacts
from magmpm.statics.stability import on_the_brink
from magmpm.statics.unnamed_loads import missed_loads

if TYPE_CHECKING:
    from magmpm.dynamics.quasi_static import PathState
    from magmpm.dynamics.time_loop import SimulationState

Progress = Callable[[int, float], None]
# Called with each frame: its time (s), axis rows [s, x, y, z] (m, 4) m (none for parts), tip (3,) m (None for parts that name none), and
# centers of regions (k, 3) m.
OnFrame = Callable[[float, Array, Array | None, Array], None]


@dataclass(frozen=True)
class RunOptions:
    """Settings of a run beyond what its scene says; start, folder, resume, on_progress, on_begin: as of simulate.run.

    on_frame: called with each frame of what is solved along time, whether it is written or not. advise: warn of loads that equilibria lack
    (statics.unnamed_loads); of single ones of bodies that are no cantilevers always. on_note: is told the steps of a motion, in words.
    judged: find the stability of an equilibrium, a sixth of its time.
    """

    start: Result | RodShape | Following | None = None
    folder: Path | str | None = None
    resume: bool = False
    on_progress: Progress | None = None
    on_begin: Callable[[], None] | None = None
    on_frame: OnFrame | None = None
    advise: bool = False
    on_note: Callable[[str], None] | None = None
    judged: bool = True


AS_IT_IS = RunOptions()


def solve(scene: Scene, options: RunOptions = AS_IT_IS) -> Result:
    """Simulate a scene whose cells and effects are given: errors as of simulate.run, but only frames are written to a folder."""
    if options.start is not None and scene.in_time:
        raise ValueError(
            "start: received one for a scene that moves, which begins undeformed; leave it out"
        )
    if scene.static:
        scene.check_energy()
    with remedies.named(scene):
        if scene.solver.quasi_static is not None:
            return _path(scene, options)[0]
        return (_rest if scene.static else _motion)(scene, options)


def _rest(scene: Scene, options: RunOptions) -> Result:
    """The equilibrium of a scene, with the warnings that are asked for."""
    result, found = at_rest(scene, options.start, options.on_progress, judged=options.judged)
    advised = options.start is None and (options.advise or not is_cantilever(scene))
    result.warnings.extend(missed_loads(scene, found.energy, found.point) if advised else [])
    return result


def at_rest(
    scene: Scene,
    start: Result | RodShape | Following | None,
    on_progress: Progress | None,
    uses: Sequence[str] = (SOLVE,),
    judged: bool = True,
) -> tuple[Result, Equilibrium]:
    """The equilibrium of a scene, as a Result and as the solver found it. uses: of the kernels (precompile); judged: find its stability."""
    begun = time.perf_counter()
    with memory.within(scene):
        model = model_at_rest(scene)
    compiled = prepare_kernels(scene, uses=uses)
    ready = time.perf_counter()
    seconds = {"setup": ready - begun - compiled, "compile": compiled, "solve": 0.0}
    try:
        found = solve_static(
            model,
            correction=_neighbor(model, start),
            rod=start if isinstance(start, RodShape) else None,
            on_step=on_progress,
            with_stability=judged,
            following=start if isinstance(start, Following) else None,
        )
    except SolveError as error:
        seconds["solve"] = time.perf_counter() - ready
        raise with_state(error, seconds) from None
    seconds["solve"] = time.perf_counter() - ready
    return finite(result_of(model, found, seconds)), found


def end_of_path(scene: Scene) -> tuple[Result, Equilibrium]:
    """The last of a scene's equilibria along time, as the path's Result and as the solver found it.

    Raises InputError and SolveError as `solve` does. The scene has no `feed`: a body that stays where it is always bends.
    """
    result, equilibrium = along_path(scene)
    found = equilibrium(-1)
    assert found is not None  # of a fed catheter, it is None while all of it is in its guide
    return result, found


def along_path(
    scene: Scene, folder: Path | str | None = None
) -> tuple[Result, Callable[[int], Equilibrium | None]]:
    """Follow a path. Returns its Result, and a function that gives an equilibrium of the path by its number, as the solver found it.

    The function gives None while the whole body is in its guide. folder: where frames go; None: nowhere. Raises InputError and SolveError
    as `solve` does.
    """
    scene.check_energy()
    reached: list[tuple[StaticModel, Point] | None] = []

    def keep(state: PathState) -> None:
        branch = state.branch
        reached.append(
            None if branch is None else (branch.energy_at(state.time).model, branch.now.point)
        )

    with remedies.named(scene):
        result, _ = _path(scene, RunOptions(folder=folder), keep)

    def equilibrium(number: int) -> Equilibrium | None:
        found = reached[number]
        if found is None:
            return None
        model, point = found
        energy = energy_of(model)
        with one_blas_thread():
            factored(energy.alone, point)  # what is refined takes steps with these factors
        return Equilibrium(
            point,
            result.iterations,
            np.zeros_like(point.grid),
            energy=energy,
            stability=result.steps[number]["stability"],
        )

    return result, equilibrium


def with_state(error: SolveError, seconds: NamedNumbers) -> SolveError:
    """The error with its last good equilibrium as a Result, if that is known and finite; else with none."""
    last = error.state
    known = isinstance(last, Equilibrium) and last.model is not None
    return _failed(error, result_of(last.model, last, seconds, error.reason) if known else None)


def _failed(error: SolveError, state: Result | None) -> SolveError:
    """The error with this state, if it is finite."""
    return type(error)(error.reason, None if state is None or state.not_finite() else state)


def finite(result: Result) -> Result:
    """The result, if all its numbers are finite, as files need them. Raises SolveError otherwise."""
    if wrong := result.not_finite():
        raise SolveError(
            f"the solve ended with numbers that are not finite (in {', '.join(wrong)}), so there is"
            " no result; remedy: check the units of sizes, loads and materials; what is smallest"
            " and largest may be too far apart for the grid"
        )
    return result


def _along_time(options: RunOptions) -> Plain:
    """Options as the solvers along time take them; they call on_progress(time, steps)."""
    tell = options.on_progress or (lambda steps, at: None)
    return {
        "folder": options.folder,
        "resume": options.resume,
        "on_progress": lambda at, steps: tell(steps, at),
    }


def _motion(scene: Scene, options: RunOptions) -> Result:
    from magmpm.dynamics import (
        time_loop as dynamics,
    )  # needs HDF5: 20 MB that static designs do without

    begun = time.perf_counter()
    with memory.within(scene):
        model = build(scene)  # refuses what can't begin, before its kernels are compiled
        compiled = prepare_kernels(scene)
        moved = dynamics.begin(model)
    if options.on_note is not None:
        options.on_note(dynamics.steps_in_words(moved))
    ready = time.perf_counter()
    seconds = {"setup": ready - begun - compiled, "compile": compiled, "solve": 0.0}

    def see(state: SimulationState) -> None:
        if options.on_frame is not None:
            options.on_frame(state.time, *measures.of_particles(model, state.x))

    try:
        with written_folder(options.folder, options.resume, options.on_begin):
            moved = dynamics.integrate(moved, **_along_time(options), on_state=see)
    except SolveError as error:
        seconds["solve"] = time.perf_counter() - ready
        known = isinstance(error.state, dynamics.SimulationState)
        raise _failed(
            error, _moved_result(error.state, seconds, error.reason) if known else None
        ) from None
    seconds["solve"] = time.perf_counter() - ready
    return finite(_moved_result(moved, seconds))


def _path(
    scene: Scene,
    options: RunOptions,
    on_state: Callable[[PathState], None] | None = None,
) -> tuple[Result, PathState]:
    """A path of equilibria. on_state: called with each, in place of the options' on_frame."""
    from magmpm.dynamics import quasi_static  # single equilibria need neither it nor HDF5

    begun = time.perf_counter()
    with memory.within(scene):
        quasi_static.loads_of(
            scene, scene.path_times()[0]
        )  # refuses what can't begin, before its kernels are compiled
    compiled = prepare_kernels(scene)
    seconds = {"setup": 0.0, "compile": compiled, "solve": 0.0}

    def result_of(state: PathState, failure: str = "") -> Result:
        seconds["solve"] = time.perf_counter() - begun - compiled
        return _path_result(state, seconds, failure)

    see = on_state or _shown(options.on_frame)
    try:
        with (
            written_folder(options.folder, options.resume, options.on_begin),
            memory.within(scene),
        ):
            state = quasi_static.follow(scene, **_along_time(options), on_state=see)
    except SolveError as error:
        known = isinstance(error.state, quasi_static.PathState)
        raise _failed(error, result_of(error.state, error.reason) if known else None) from None
    result = result_of(state)
    if state.branch is not None and options.advise:
        energy = state.branch.energy_at(state.time)
        point = state.branch.now.point
        with one_blas_thread():
            factored(energy, point)
        result.warnings.extend(missed_loads(scene, energy, point))
    return finite(result), state


def _shown(on_frame: OnFrame | None) -> Callable[[PathState], None] | None:
    """A caller's on_frame as what follows a path calls it."""
    if on_frame is None:
        return None

    def see(state: PathState) -> None:
        shape = state.shape
        centers = measures.region_means(shape.model, shape.position)
        on_frame(state.time, shape.centreline, shape.tip, centers)

    return see


def _path_result(state: PathState, seconds: NamedNumbers, failure: str = "") -> Result:
    shape = state.shape
    last: Plain = next(reversed(state.rows), {"iterations": state.iterations, "stability": None})
    return _result(
        shape.model,
        shape.position,
        shape.F,
        state.time,
        strain=state.strain,
        warnings=state.warnings,
        seconds=seconds,
        failure=failure,
        stability=last["stability"],
        centreline=shape.centreline,
        tip=shape.tip,
        iterations=last["iterations"],
        dof=shape.dof,
        min_det_F=shape.min_det_F,
        max_det_F=shape.max_det_F,
        energy=state.energy,
        time=state.time,
        formulation="quasi_static",
        steps=state.rows,
        jumps=state.jumps,
        contacts=_contacts(shape.model, shape.touched, shape.own),
        load_share=state.load_share,
    )


def _moved_result(moved: SimulationState, seconds: NamedNumbers, failure: str = "") -> Result:
    model = moved.motion.model
    J = np.linalg.det(moved.F)
    axis, tip, _ = measures.of_particles(model, moved.x)
    return _result(
        model,
        moved.x,
        moved.F,
        moved.time,
        strain=moved.strain,
        warnings=moved.warnings + moved.control.warnings() + moved.motion.warnings(),
        seconds=seconds,
        failure=failure,
        stability=None,
        centreline=axis,
        tip=tip,
        iterations=moved.steps,
        dof=moved.motion.unknowns,
        min_det_F=float(J.min()),
        max_det_F=float(J.max()),
        energy=sum(moved.energies.values()) - moved.energies["kinetic"],
        time=moved.time,
        time_step=moved.dt,
        stable_steps={
            name: step for name, step in moved.stable.named.items() if math.isfinite(step)
        },
        formulation="total",
        kinetic_energy=moved.energies["kinetic"],
        contacts=_plain(moved.contacts, moved.largest),
    )


def _neighbor(model: StaticModel, start: object) -> Array | None:
    """The grid correction of a neighboring design: nearly the same for this design."""
    if not isinstance(start, Result):
        return None
    if start.grid_correction.shape == (model.layout.planes, model.layout.m):
        return start.grid_correction
    raise ValueError("start: the neighboring result must be on the same grid")


def _result(
    model: Model,
    position: Array,
    F: Array,
    at: float | None,
    *,
    strain: Strain,
    warnings: list[str],
    **own: Any,
) -> Result:
    """A result, with the field at the body's center at a time (s; None in statics). warnings: those of this solve; own: other fields."""
    scene = model.scene
    particles = model.particles
    of_field = scene.external_field().warnings if scene.effects.in_a_field else []
    of_any = {
        "grid_correction": np.zeros((0, 0)),
        "name": scene.name,
        "scene": scene.to_si(),
        "scene_hash": scene.hash(),
        "particle_reference": particles.position,
        "particle_position": position,
        "particle_volume": particles.volume,
        "particle_segment": particles.segment,
        "particle_det_F": np.linalg.det(F),
        "segment_center": measures.region_means(model, position),
        "segment_remanence": measures.region_magnetization(model, F),
        "field": model.field_at(position, at),
        "particles": len(position),
        "section": model.section,
        "converged": not own["failure"],
        "warnings": [
            *scene.warnings(),
            *effects.warnings(scene),
            *of_field,
            *warnings,
            *strain.warnings(model),
            *on_the_brink(own["stability"]),
        ],
        "largest_stretch": strain.stretch,
        "tightest_radius": strain.radius if math.isfinite(strain.radius) else None,
        "versions": dict(versions()),
    }
    return Result(**of_any | own)


def result_of(
    model: StaticModel, found: Equilibrium, seconds: NamedNumbers, failure: str = ""
) -> Result:
    point = found.point
    position = point.position
    return _result(
        model,
        position,
        point.F,
        model.time,
        strain=strain_of(model, position, point.F),
        warnings=found.warnings,
        seconds=seconds,
        failure=failure,
        stability=found.stability,
        grid_correction=found.correction,
        centreline=axis_of_unknowns.centreline(model, point.grid),
        tip=(
            measures.named_tip(model, position)
            if model.line is None
            else axis_of_unknowns.tip(model, point.grid)
        ),
        iterations=found.steps,
        dof=model.dof,
        min_det_F=point.min_det_F,
        max_det_F=point.max_det_F,
        energy=point.energy,
        load_share=found.load_share,
        start=found.start,
        contacts=_contacts(model, point.touched, point.own),
    )


def _contacts(model: Model, touched: Touched | None, own: OwnContacts | None) -> Plain:
    """Contacts of an equilibrium, as results have them."""
    found = {} if touched is None else contacts_at_rest(model, touched)
    return _plain(found | ({} if own is None else own.report()))


def _plain(
    contacts: Mapping[str, Contact], largest: Mapping[str, tuple[float, float]] | None = None
) -> Plain:
    """Contacts by name, as plain data; largest: of a motion, the largest force (N) of all frames by name, and its time (s)."""
    apart = Contact(force=np.zeros(3), count=0, depth=0.0, energy=0.0)
    most = largest or {}
    found = {}
    for key in dict.fromkeys([*contacts, *most]):
        one = contacts.get(key, apart)
        found[key] = {"force": one["force"].tolist(), "count": one["count"], "depth": one["depth"]}
        if "point" in one:
            found[key]["point"] = one["point"].tolist()
        if key in most:
            found[key] |= {"largest": most[key][0], "largest_at": most[key][1]}
    return found
