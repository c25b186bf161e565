"""run(scene) -> Result: one simulation, as the scene says; sensitivities(scene): of its equilibrium to numbers of the scene."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

from magmpm.compiled.arrays import Plain
from magmpm.compiled.thread_count import one_blas_thread
from magmpm.errors import InputError, SolveError
from magmpm.results import notices
from magmpm.results.file_names import CHECKPOINT, NUMBERS, OF_EQUILIBRIUM, forget_motion
from magmpm.results.folder_lock import folder_lock
from magmpm.results.result import Result
from magmpm.results.trajectory import frame_files
from magmpm.rod.cosserat import RodShape
from magmpm.scene import Scene, load_scene, of_file, remedies
from magmpm.scene.coarsest import coarsest_cells
from magmpm.scene.rules import of_known_error
from magmpm.scene.variables import check_differentiable, variables
from magmpm.solving.effects_choice import choose_effects
from magmpm.solving.effects_choice import missed_effects as missed_effects
from magmpm.solving.precompile import DERIVATIVES, SOLVE, prepare_kernels
from magmpm.solving.several_grids import Runs, choose_grid, grids_of, overloaded
from magmpm.solving.solve import (
    AS_IT_IS,
    Progress,
    RunOptions,
    along_path,
    at_rest,
    end_of_path,
    finite,
    result_of,
    solve,
    with_state,
)
from magmpm.statics.equilibrium import Equilibrium, Following
from magmpm.statics.grids import Equilibria
from magmpm.statics.linearized import Linearized, Sensitivities
from magmpm.statics.stability import stability
from magmpm.statics.unnamed_loads import missed_loads


def run(
    scene: Scene | Path | str,
    *,
    start: Result | RodShape | None = None,
    folder: Path | str | None = None,
    resume: bool = False,
    on_progress: Progress | None = None,
    on_begin: Callable[[], None] | None = None,
    progress: bool | None = None,
) -> Result:
    """Simulate a scene: its equilibrium, equilibria along time (solver.quasi_static), or its motion (solver.dynamic).

    Warnings of the result are also given as MagmpmWarning, each once a scene; begin, end and errors
    go to the logger `magmpm`. Numbers of the result are in SI.

    Parameters
    ----------
    scene : Scene, Path or str
        A Scene, or the path of a scene file.
    start : Result or RodShape, optional
        Of a single equilibrium only: the result of a similar scene on the same grid, whose
        solution the solve starts from; or the shape of a rod, near which the equilibrium is
        found, be it on the branch that grows from zero load or not.
    folder : Path or str, optional
        Where the result is saved (Result.save), and the frames and checkpoints of a motion are
        written. What the folder held is replaced. None: nothing is written.
    resume : bool, default False
        Go on from the checkpoint in `folder`; without one, as for an equilibrium, the run
        begins at the start.
    on_progress : callable, optional
        `on_progress(step, number)` is called after each Newton step with its energy decrement
        (no unit), or along time with the time in s.
    on_begin : callable, optional
        Called without arguments when a motion starts from its beginning, before anything is
        written.
    progress : bool, optional
        Whether what runs along time shows a bar. None: on a terminal and in notebooks, unless
        MAGMPM_PROGRESS is 0.

    Returns
    -------
    Result
        The answer; of what runs along time its last moment.

    Raises
    ------
    InputError
        Before the run, if the scene or its file is wrong, or if another process writes to
        `folder`; where `scene` is a path, the message names file, line, key and value.
    SolveError
        If no equilibrium is found or a motion fails. Its `state` is the last good Result (not
        converged), or None; that of a motion is saved in `folder`.
    BudgetError
        If a motion would exceed its limit of disk space.
    ValueError
        If `start` is on another grid or given for what moves, or `resume` is requested without
        a folder.
    TypeError
        If `start` is neither a Result nor a RodShape.

    References
    ----------
    docs/theory.md has the equations, docs/design.md the method and its sources.

    Examples
    --------
    >>> import magmpm
    >>> scene = magmpm.load_scene("data/scenes/axial_transverse.yaml").with_cells(2)
    >>> result = magmpm.run(scene)
    >>> result.converged
    True
    >>> result.tip.shape  # x, y and z of the tip, m
    (3,)
    """
    by_user = notices.called_by_user()
    with nullcontext() if isinstance(scene, Scene) else of_file(scene):
        whole = scene if isinstance(scene, Scene) else load_scene(scene)
        if start is not None and not isinstance(start, Result | RodShape):
            raise TypeError(
                f"start: received {start!r}; must be a Result, as run(scene) returns it, a"
                " RodShape, or None"
            )
        if resume and folder is None:
            raise ValueError(
                "resume: received True without a folder; give the folder that holds the motion and"
                " its checkpoint"
            )
        options = RunOptions(start, folder, resume, on_progress, on_begin)
        return _told_run(whole, options, progress) if by_user else _saved_run(whole, options)


def _told_run(scene: Scene, options: RunOptions, progress: bool | None) -> Result:
    """The result, with a bar for what runs along time, lines in the log, and its warnings."""
    too_much = overloaded(scene)
    notices.warn(too_much, scene.hash())
    with notices.Watched(
        scene.name, scene.duration if scene.in_time else None, "s", progress
    ) as watched:
        if scene.in_time:
            options = replace(options, on_progress=watched.also(options.on_progress))
        try:
            result = _saved_run(scene, options)
        except SolveError as error:
            if isinstance(error.state, Result):
                error.state.warnings[:0] = too_much
                notices.warn(error.state.warnings, scene.hash())
            raise
        result.warnings[:0] = too_much
        watched.ended(result)
    notices.warn(result.warnings, scene.hash())
    return result


def _saved_run(scene: Scene, options: RunOptions) -> Result:
    """The run itself, saved where a folder is given."""
    folder = options.folder
    if folder is None:
        return simulated(scene, options)
    if scene.in_time:
        frame_files()  # before the folder is made
    begun = options.resume

    def begin() -> None:
        nonlocal begun
        begun = True
        for name in OF_EQUILIBRIUM:  # of an earlier run: not this motion's
            (Path(folder) / name).unlink(missing_ok=True)
        if options.on_begin is not None:
            options.on_begin()

    with folder_lock(folder):
        try:
            result = simulated(scene, replace(options, on_begin=begin))
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
    if (
        not begun or error.state.load_share < 1.0
    ):  # no equilibrium of it was written: it takes the place of what was there
        forget_motion(folder)
    try:
        error.state.save(folder)
    except OSError as failure:  # a full disk, say: why the motion failed matters more
        raise error from failure


def simulated(scene: Scene, options: RunOptions = AS_IT_IS) -> Result:
    """Run a scene as `run` does, for callers that save the result themselves.

    Parameters
    ----------
    scene : Scene
        What is simulated.
    options : RunOptions, default AS_IT_IS
        As of `run`; their folder takes the frames and checkpoints of a motion, and nothing
        else.

    Returns
    -------
    Result
        The answer, in SI.
    """
    if scene.effects.auto:
        choice = choose_effects(scene)
        found = simulated(choice.scene, replace(options, advise=False))
        return replace(found, effects_chosen=choice.reasons)
    if scene.resolution.requested:
        return _resolved(scene, options)[0]
    return solve(scene, options)


def sensitivities(
    scene: Scene | Path | str,
    of: Sequence[str] | None = None,
    *,
    start: Result | RodShape | Following | None = None,
) -> Sensitivities:
    """Solve a scene for its equilibrium, and find how the shape answers to numbers of the scene: exact first derivatives.

    The kinds of variables, each with the unit that its derivatives are per:

    * magnetization: direction of each magnetized region, toward growing azimuth about +z and toward
      growing elevation, rad;
    * field: its uniform part, along x, y and z, T;
    * remanence (T), shear_modulus (Pa; the bulk modulus in proportion), density (kg/m^3): of each
      material that the body uses;
    * length: of each segment of a catheter or strip, m; the body gets longer by as much;
    * diameter: of a catheter, m; a tube's bore stays;
    * an address, as in a study's `numbers`: `field.magnet[0].position[2]`,
      `effects.gravity.acceleration[2]`, `field.coils[*].current`: any number of the field, the
      effects, the materials or the magnetization, in its SI unit.

    Of equilibria along time (solver.quasi_static) it is the last one, on the branch on which the
    path has come to it.

    Parameters
    ----------
    scene : Scene, Path or str
        A Scene, or the path of a scene file.
    of : sequence of str, optional
        Kinds of variables, in any order; all that the scene has unless given.
    start : Result, RodShape or Following, optional
        As of `run`.

    Returns
    -------
    Sensitivities
        The equilibrium as `result`, and the derivatives of its shape with respect to k
        variables: `names`, `units`, `tip` (3, k), `centreline` (stations, 3, k), m per unit of
        each variable.

    Raises
    ------
    InputError
        As of `run`; for a name in `of` that is not known or of which the scene has no variable;
        for a scene that moves, and a path with friction or feed.
    SolveError
        As of `run`; where the softest motion has no stiffness: at a critical load, or of a body
        that is free to turn.
    ValueError
        For a start on another grid, or of a scene that runs along time or requests an error.
    TypeError
        If `start` is neither a Result nor a RodShape.

    References
    ----------
    Implicit function theorem, dc/dp = -K^-1 dr/dp: Tortorelli and Michaleris, Inverse Problems in
    Engineering 1 (1994) 71; docs/design.md, "Sensitivities".

    Examples
    --------
    >>> import magmpm
    >>> scene = magmpm.load_scene("data/scenes/axial_transverse.yaml").with_cells(2)
    >>> found = magmpm.sensitivities(scene, of=["field"])
    >>> found.names
    ('field_x', 'field_y', 'field_z')
    >>> found.tip.shape  # m of the tip's x, y and z for each T of the field's
    (3, 3)
    """
    by_user = notices.called_by_user()
    with nullcontext() if isinstance(scene, Scene) else of_file(scene):
        found = _differentiated(scene if isinstance(scene, Scene) else load_scene(scene), of, start)
    if by_user:
        notices.warn(found.result.warnings, found.result.scene_hash)
    return found


def _differentiated(
    scene: Scene, of: Sequence[str] | None, start: Result | RodShape | Following | None
) -> Sensitivities:
    """The sensitivities themselves."""
    if start is not None and not isinstance(start, Result | RodShape | Following):
        raise TypeError(
            f"start: received {start!r}; must be a Result, as run(scene) returns it, a RodShape, or"
            " None"
        )
    check_differentiable(scene)
    if scene.effects.auto:
        choice = choose_effects(scene)
        near = _differentiated(choice.scene, of, start)
        return replace(near, result=replace(near.result, effects_chosen=choice.reasons))
    wanted = variables(scene, of)
    if scene.resolution.requested:
        prepare_kernels(scene.with_cells(coarsest_cells(scene)), uses=(DERIVATIVES,))
        result, found = _resolved(scene, RunOptions(start))
        if (
            found is None
        ):  # whole runs have chosen the grid, and left no equilibrium: of a path, or of parts
            assert result.resolution is not None  # _resolved
            _, found = _equilibrium(scene.with_cells(result.resolution["cells_across"]), None)
    else:
        result, found = _equilibrium(scene, start)
    return Sensitivities(result, wanted, Linearized(found, wanted))


def sensitivities_along(
    scene: Scene, of: Sequence[str], folder: Path | str | None = None
) -> tuple[Result, Callable[[int], Sensitivities | None]]:
    """Follow a path of equilibria, and differentiate those that are asked for: each in the field of its time, on the path's branch.

    of: addresses, as of `sensitivities`. folder: as of `run`; None: nowhere. Returns the path's Result, and what gives the derivatives of
    the equilibrium with a number, None while all of a fed catheter is in its guide. Of a fed catheter they are those of the tip and of
    what presses it. Raises InputError and SolveError as `sensitivities` does; InputError where cells or effects are to be chosen.
    """
    check_differentiable(scene, fed=True)
    if scene.effects.auto or scene.resolution.requested:
        raise InputError(
            "resolution",
            received="an error, seconds, or `effects: auto`",
            rule="derivatives along a path need given cells and effects",
            remedy="write `resolution: {cells_across: 3}`, and name the effects",
        )
    wanted = variables(scene, of)
    free = scene.with_effects(feed=None)  # what is out of a guide is held at its exit
    prepare_kernels(free, uses=(SOLVE, DERIVATIVES))
    with nullcontext() if folder is None else folder_lock(folder):
        result, equilibrium = along_path(scene, folder)
        if folder is not None:
            result.save(folder)

    def at(number: int) -> Sensitivities | None:
        found = equilibrium(number)
        return None if found is None else Sensitivities(result, wanted, Linearized(found, wanted))

    return result, at


def _equilibrium(
    scene: Scene, start: Result | RodShape | Following | None
) -> tuple[Result, Equilibrium]:
    """The equilibrium that `run` ends with, of a scene whose cells and effects are given, and the kernels for its derivatives."""
    if not scene.in_time:
        return at_rest(scene, start, None, (SOLVE, DERIVATIVES))
    if start is not None:
        raise ValueError(
            "start: received one for a scene that moves, which begins undeformed; leave it out"
        )
    prepare_kernels(scene, uses=(SOLVE, DERIVATIVES))
    return end_of_path(scene)


def _resolved(scene: Scene, options: RunOptions) -> tuple[Result, Equilibrium | None]:
    """The answer on the grid that is chosen for the error or the time that a scene requests; of a straight body at rest as the solver found
    it, too. What runs along time is run on that grid once more into the folder, if one is given: nothing is written before it is chosen.
    """
    if options.start is not None:
        raise ValueError(
            "start: received one for a scene that asks for an error, whose grids are chosen in"
            " turn; give it cells_across"
        )
    again = options.folder is not None and scene.in_time
    begun = time.perf_counter()
    grids = grids_of(scene)

    def second_run(cells: int) -> float:
        if not again:
            return 0.0
        known = grids.solved.get(cells)
        return grids.takes(cells, proof=False) if known is None else known.seconds

    try:
        with remedies.named(scene):
            choice, compiled = choose_grid(grids, options.on_progress, second_run)
    except SolveError as error:
        if isinstance(grids, Equilibria):
            raise with_state(
                error, {"setup": 0.0, "compile": 0.0, "solve": time.perf_counter() - begun}
            ) from None
        if isinstance(grids, Runs) and grids.solved and error.state is None:
            first = grids.answer(cells=next(iter(grids.solved))).result
            error.state = replace(first, converged=False, failure=error.reason)
        raise
    seconds = {"setup": 0.0, "compile": compiled, "solve": time.perf_counter() - begun - compiled}
    found = None
    if isinstance(grids, Equilibria):
        found = grids.found[choice.cells]
        assert found.energy is not None
        with one_blas_thread():  # as the solves: the same bits
            found = replace(found, stability=stability(found.energy, found.point))
        result = finite(result_of(grids.models[choice.cells], found, seconds))
        result.warnings.extend(
            missed_loads(scene, found.energy, found.point) if options.advise else []
        )
    else:
        assert isinstance(grids, Runs)
        judging = seconds["solve"]
        if again:
            result = solve(grids.on(choice.cells), options)
        else:
            result = grids.answer(cells=choice.cells).result
            judging -= grids.solved[choice.cells].seconds
        seconds = {
            **result.seconds,
            "setup": result.seconds["setup"] + judging,
            "compile": result.seconds["compile"] + compiled,
        }
    answer: Plain = {
        "scene_hash": scene.hash(),
        "error_estimate": choice.error,
        "resolution": choice.report,
        "seconds": seconds,
    }
    warnings = [*of_known_error(result.warnings), *choice.report.get("warnings", [])]
    return replace(result, warnings=warnings, **answer), found
