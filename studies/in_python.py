"""Studies, fits and the influence of effects as functions: `magmpm.design`, `magmpm.fit`, `magmpm.influence`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from pathlib import Path
from typing import Any

from magmpm.effects import acting as effects
from magmpm.errors import InputError, length, require
from magmpm.inputs.yaml_document import of_file
from magmpm.results import notices
from magmpm.scene import Scene, load_scene
from magmpm.studies.engine.report import StudyReport
from magmpm.studies.evaluate.trial import Trial
from magmpm.studies.explore.effects_table import EffectRow, EffectsTable, survey
from magmpm.studies.fitting.search import Fit
from magmpm.studies.goals.goal_study import has_goal, load_goal
from magmpm.studies.goals.report import GoalReport
from magmpm.studies.goals.sweep import sweep
from magmpm.studies.problem.study import Study

__all__ = ["design", "fit", "influence", "sweep"]

SceneLike = Scene | Path | str | Mapping[str, Any]


def design(
    study: Study | Path | str,
    *,
    folder: Path | str | None = None,
    trials: int | None = None,
    sampler: str | None = None,
    progress: bool | None = None,
    **more: Any,
) -> StudyReport | GoalReport:
    """Search the design that makes a target shape, or reaches the `goal` of its file, or go on with the search, as `magmpm design` does
    without its pictures.

    study: the path of a study file, or the Study that load_study makes of one. folder: of the results, runs/NAME unless given; best/ in it
    holds the best design as a Result and as a scene. trials, sampler: in place of the file's. more: workers, storage, on_trial and the
    other options of studies.engine.loop.run_study. Lengths of the report are in m.
    progress: whether a bar is shown; None: on a terminal and in notebooks, unless MAGMPM_PROGRESS is 0. Warnings of the report are also
    given as MagmpmWarning, once a study.
    Raises InputError for wrong files, names and numbers; MagmpmError where the trials can't be kept; TypeError for an unknown option.
    """
    require("optuna", "design", key="magmpm.design", use="studies")
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


def _for_goal(
    study: Path | str,
    folder: Path | str | None,
    trials: int | None,
    sampler: str | None,
    progress: bool | None,
    more: Mapping[str, Any],
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
            workers=more.get("workers") or 1,
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
    """Material constants that explain measurements best, with confidence intervals, as `magmpm fit` finds them.

    measured: the path of a table, or several of the same body (docs/fitting.md). scene: a Scene, the path of its file, or a dict as
    load_scene takes. options: vary, noise (m), angle_noise (rad), known, level, thorough of studies.fitting.fit.
    progress: whether the solves so far are shown; None: on a terminal and in notebooks, unless MAGMPM_PROGRESS is 0. Warnings of the fit
    are also given as MagmpmWarning.
    Raises InputError as the command does, also where the measurements can't distinguish constants; SolveError without an equilibrium.
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
    """Shift of the answer by each effect, named in the scene or not, as `magmpm effects` prints it; of one effect, its row alone.

    scene: a Scene, the path of its file, or a dict as load_scene takes. effect: a key of the scene's effects, such as "gravity". Shifts and
    their uncertainties are in m; costs, which take longest, are counted for all effects together.
    Raises InputError for a wrong scene, or a name that is no effect.
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
