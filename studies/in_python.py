"""Studies, fits and the influence of effects as functions: `magmpm.design`, `magmpm.fit`, `magmpm.influence`."""

from __future__ import annotations

import hashlib
import inspect
import os
import shutil
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from magmpm.bodies.curves import arc_lengths
from magmpm.compiled.arrays import Named
from magmpm.effects import acting as effects
from magmpm.errors import InputError, length, require
from magmpm.inputs.yaml_document import of_file
from magmpm.results import notices
from magmpm.scene import Scene, load_scene
from magmpm.solving.influence import EffectRow
from magmpm.studies.engine.report import StudyReport
from magmpm.studies.evaluate.trial import Trial
from magmpm.studies.explore.effects_table import EffectsTable, survey
from magmpm.studies.fitting.search import Fit
from magmpm.studies.goals.goal_study import has_goal, load_goal
from magmpm.studies.goals.report import GoalReport
from magmpm.studies.goals.sweep import sweep
from magmpm.studies.problem.study import Study

__all__ = ["design", "fit", "influence", "sweep"]

FILES = "files"  # the folder of what a study given as a dict holds
SceneLike = Scene | Path | str | Named


def design(
    study: Study | Path | str | Named,
    *,
    folder: Path | str | None = None,
    trials: int | None = None,
    sampler: str | None = None,
    progress: bool | None = None,
    **more: Any,
) -> StudyReport | GoalReport:
    """Search the design that makes a target shape, or reaches the `goal` of its file, or go on with such a search.

    It is what `magmpm design` does, without its pictures. Warnings of the report are also given as
    MagmpmWarning, once a study.

    Parameters
    ----------
    study : Study, Path, str or dict
        The path of a study file, the Study that load_study makes of one, or a dict with the
        keys of such a file. There `scene` may be a Scene, a target or path an array (q, 4) of
        rows [s, x, y, z] or (q, 3) of points, m, and `python` a function of a module or script;
        paths are relative to the working folder. As a file it is kept in the folder of the
        results, study_HASH/NAME.yaml.
    folder : Path or str, optional
        Of the results; runs/NAME unless given, with the name of the file, or of a dict's scene.
        `best/` in it holds the best design as a Result and as a scene.
    trials : int, optional
        Number of trials, in place of the file's.
    sampler : str, optional
        Name of the sampler, in place of the file's.
    progress : bool, optional
        Whether a bar is shown. None: on a terminal and in notebooks, unless MAGMPM_PROGRESS is
        0.
    **more : object
        `workers`, `storage`, `on_trial` and the other options of
        `studies.engine.loop.run_study`; of a study with a goal these three.

    Returns
    -------
    StudyReport or GoalReport
        What the search has found so far; a GoalReport of a study with a `goal`. Lengths are in
        m.

    Raises
    ------
    InputError
        For wrong files, names and numbers.
    MagmpmError
        Where the trials can't be kept.
    TypeError
        For an unknown option.

    Examples
    --------
    >>> import magmpm
    >>> study = "data/studies/s_shape.yaml"
    >>> report = magmpm.design(study, trials=1, sampler="random", folder="s_shape")
    >>> report.trials
    1
    >>> report.best["rms_m"] > 0.0  # distance from the target, m
    True
    """
    require("optuna", "design", key="magmpm.design", use="studies")
    if isinstance(study, Mapping):
        study, folder = _as_file(study, folder)
    if isinstance(study, (str, Path)) and has_goal(study):
        return _for_goal(study, folder, trials, sampler, progress, more)
    from magmpm.simulate import run, sensitivities
    from magmpm.studies.engine.loop import run_study
    from magmpm.studies.search.definition import load_study

    if "out" in more:
        raise TypeError(
            "design() got an unexpected keyword argument 'out'; the folder of the results is"
            " `folder`, as of magmpm.run"
        )
    found = study if isinstance(study, Study) else load_study(study)
    out = Path("runs") / found.name if folder is None else folder
    of = f"study {found.name} in {out}"
    own = more.pop("on_trial", None)
    more.setdefault("on_advice", partial(notices.warn, of=of))
    with notices.Watched(
        found.name, found.trials if trials is None else trials, "trials", progress
    ) as watched:

        def tell(trial: Trial) -> None:
            best = "" if trial.best_rms_m is None else f"best {length(trial.best_rms_m)}"
            watched.at(trial.finished, best)
            if own is not None:
                own(trial)

        report = run_study(
            found,
            solve=run,
            differentiate=sensitivities,
            out=out,
            on_trial=tell,
            trials=trials,
            sampler=sampler,
            **more,
        )
        watched.ended(report)
    notices.warn(report.warnings, of)
    return report


def _as_file(study: Named, folder: Path | str | None) -> tuple[Path, Path]:
    """Write a study given as a dict into a folder of its own in that of its results. Returns the path of its file, and the latter folder.

    The folder's name is of what it holds, so that another study never takes its place. Raises InputError.
    """
    scene = study.get("scene")
    name = scene.name if isinstance(scene, Scene) else Path(str(scene)).stem
    out = Path("runs") / name if folder is None else Path(folder)
    part = out / f"study_{os.getpid()}.part"
    (part / FILES).mkdir(parents=True)
    try:
        said = yaml.safe_dump(_said(study, part, ""), sort_keys=False)
        (part / f"{name}.yaml").write_text(said, encoding="utf-8")
        content = b"".join(path.read_bytes() for path in sorted(part.rglob("*.*")))
        kept = out / f"study_{hashlib.sha256(content).hexdigest()[:8]}"
        if not kept.exists():
            part.rename(kept)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return kept / f"{name}.yaml", out


def _said(value: Any, folder: Path, key: str) -> Any:
    """A value of a study given in Python as its file says it; scenes and tables become files in the folder. Raises InputError."""
    if isinstance(value, Mapping):
        return {name: _said(one, folder, f"{key}.{name}".strip(".")) for name, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_said(one, folder, f"{key}.{k}") for k, one in enumerate(value)]
    if isinstance(value, Scene):
        return f"{FILES}/{value.save(folder / FILES / f'{key}.yaml').name}"
    if isinstance(value, np.ndarray):
        return f"{FILES}/{_table(value, folder / FILES / f'{key}.csv', key)}"
    if callable(value):
        return _place_of(value, key)
    named = key.rpartition(".")[2] in ("scene", "centreline", "path", "python")
    if isinstance(value, Path) or (named and isinstance(value, str)):
        return str(Path(value).resolve())
    return value


def _table(points: np.ndarray, path: Path, key: str) -> str:
    """The name of a table with these points, (q, 4) m of rows [s, x, y, z], or (q, 3) m, whose arc length is that of their polygon."""
    rows = np.asarray(points, dtype=float)
    if rows.ndim != 2 or rows.shape[1] not in (3, 4):
        raise InputError(
            key,
            received=f"an array {rows.shape}",
            rule="must have rows [x, y, z] or [s, x, y, z], m",
            remedy="give, say, np.column_stack([x, y, z])",
        )
    if rows.shape[1] == 3:
        rows = np.column_stack([arc_lengths(rows), rows])
    lines = [",".join(repr(float(x)) for x in row) for row in 1e3 * rows]
    path.write_text("\n".join(["s_mm,x_mm,y_mm,z_mm", *lines, ""]), encoding="utf-8")
    return path.name


def _place_of(function: Any, key: str) -> str:
    """FILE.py:FUNCTION of a function, by which the processes that run trials find it. Raises InputError where a file alone can't."""
    name = getattr(function, "__qualname__", repr(function))
    module = inspect.getmodule(function)
    file = Path(getattr(module, "__file__", None) or "")
    if not name.isidentifier() or file.suffix != ".py":
        raise InputError(
            key,
            received=name,
            rule="must be a function at the top level of a file: other processes read it there",
            remedy="write it into a file, say goal.py, and give `from goal import FUNCTION`",
        )
    return f"{file.resolve()}:{name}"


def _for_goal(
    study: Path | str,
    folder: Path | str | None,
    trials: int | None,
    sampler: str | None,
    progress: bool | None,
    more: Named,
) -> GoalReport:
    """`design` of a study with a goal. Raises TypeError for options that it has not."""
    from magmpm.studies.goals.search import search

    found = load_goal(study)
    unknown = set(more) - {"workers", "storage", "on_trial"} | ({"sampler"} if sampler else set())
    if unknown:
        raise TypeError(
            f"design() of a study with a goal has no argument {', '.join(sorted(unknown))}; it has"
            " folder, trials, workers, storage and on_trial"
        )
    out = Path("runs") / found.name if folder is None else Path(folder)
    count = found.file.trials if trials is None else trials
    own = more.get("on_trial")
    with notices.Watched(found.name, count, "trials", progress) as watched:

        def tell(line: str) -> None:
            watched.note(line)
            if own is not None:
                own(line)

        report = search(
            found,
            out,
            trials=trials,
            workers=more.get("workers"),
            storage=more.get("storage"),
            on_trial=tell,
        )
        watched.ended(report)
    return report


def fit(
    measured: Path | str | Sequence[Path | str],
    scene: SceneLike,
    *,
    progress: bool | None = None,
    **options: Any,
) -> Fit:
    """Find the material constants that explain measurements best, with confidence intervals, as `magmpm fit` does.

    Warnings of the fit are also given as MagmpmWarning.

    Parameters
    ----------
    measured : Path, str or sequence of Path or str
        The path of a table of measurements, or several of the same body (docs/fitting.md).
    scene : Scene, Path, str or dict
        A Scene, the path of its file, or a dict as load_scene takes.
    progress : bool, optional
        Whether the solves so far are shown. None: on a terminal and in notebooks, unless
        MAGMPM_PROGRESS is 0.
    **options : object
        `vary`, `noise` (m), `angle_noise` (rad), `known`, `level` and `thorough` of
        `studies.fitting.fit`.

    Returns
    -------
    Fit
        The constants with their intervals, and the residuals, in SI.

    Raises
    ------
    InputError
        As the command does, also where the measurements can't distinguish constants.
    SolveError
        Where no equilibrium is found.

    Examples
    --------
    >>> from pathlib import Path
    >>> import magmpm
    >>> scene = magmpm.load_scene("data/scenes/axial_transverse.yaml").with_cells(2)
    >>> rows = ["field_z_mT,tip_x_mm,tip_z_mm", "1,39.57,5.35", "3,36.84,14.21"]
    >>> _ = Path("tips.csv").write_text("\\n".join(rows))
    >>> found = magmpm.fit("tips.csv", scene, vary=["shear_modulus"], noise=0.2e-3, thorough=False)
    >>> constant = found.constants[0]  # value, low and high, in SI
    >>> constant.low < constant.value < constant.high
    True
    """
    from magmpm.studies.fitting import fit as found_by
    from magmpm.studies.fitting import read_tables

    whole = _scene(scene)
    tables = read_tables([measured] if isinstance(measured, (str, Path)) else list(measured), whole)
    own = options.pop("on_progress", None)
    with (
        _placed(scene),
        notices.Watched(f"fit of {whole.name}", None, "solves", progress) as watched,
    ):

        def tell(text: str) -> None:
            watched.note(text)
            if own is not None:
                own(text)

        found = found_by(tables, whole, on_progress=tell, **options)
        watched.ended(found)
    notices.warn(found.warnings, f"fit of {whole.hash()}")
    return found


def influence(scene: SceneLike, effect: str | None = None) -> EffectsTable | EffectRow:
    """Find how far each effect moves the answer, named in the scene or not, as `magmpm effects` prints it.

    Parameters
    ----------
    scene : Scene, Path, str or dict
        A Scene, the path of its file, or a dict as load_scene takes.
    effect : str, optional
        A key of the scene's effects, such as "gravity"; all of them unless given. What effects
        cost, which takes longest to find, is counted for all together only.

    Returns
    -------
    EffectsTable or EffectRow
        The table of all effects; of one effect its row alone. Shifts and their uncertainties
        are in m.

    Raises
    ------
    InputError
        For a wrong scene, or a name that is no effect.

    Examples
    --------
    >>> import magmpm
    >>> scene = magmpm.load_scene("data/scenes/axial_transverse.yaml").with_cells(2)
    >>> row = magmpm.influence(scene, "magnetic_torque")
    >>> row.shift_m > row.uncertainty_m  # m
    True
    """
    known = effects.Effects.every()
    if effect is not None and effect not in known:
        raise InputError(
            "effect",
            received=repr(effect),
            rule=f"must be one of {', '.join(known)}",
            remedy="leave it out for all",
        )
    with _placed(scene):
        table = survey(_scene(scene), measure=effect is None, only=effect)
    return table if effect is None else table.effects[0]


def _placed(scene: SceneLike) -> AbstractContextManager[None]:
    return of_file(scene) if isinstance(scene, (str, Path)) else nullcontext()


def _scene(scene: SceneLike) -> Scene:
    return scene if isinstance(scene, Scene) else load_scene(scene)
