"""All that a report says of a study, as plain data in SI: `gather(folder, ...)`.

What can't be read (a database that is gone, a study file that has changed) leaves a note in `notes`, and the rest is there.
"""

from __future__ import annotations

import os
import shlex
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from magmpm.bodies.segments import StraightBody
from magmpm.compiled.arrays import Named, Plain
from magmpm.errors import MagmpmError, SolveError
from magmpm.inputs.user_files import read_regular
from magmpm.results.measures import tip_of
from magmpm.results.result import Result, versions
from magmpm.scene import Scene, load_scene
from magmpm.studies.engine import records
from magmpm.studies.engine.report import feasible, refused
from magmpm.studies.engine.storage import must_exist, open_storage, storage_faults, trials_of
from magmpm.studies.problem.study import Study
from magmpm.studies.search.best_scene import SCENE
from magmpm.studies.search.definition import differences, load_study
from magmpm.studies.search.samplers.choice import whole_definition
from magmpm.studies.search.samplers.optuna_ids import si_values
from magmpm.studies.search.search_space import SearchSpace
from magmpm.studies.sheet.verified_best import (
    SHARE_OF_LENGTH,
    allowed,
    in_time,
    last_equilibrium,
    together,
    verified,
)

if TYPE_CHECKING:
    import optuna
    from optuna.trial import FrozenTrial


def best_rows(trials: Sequence[FrozenTrial]) -> list[Plain]:
    """The feasible trials nearest to the target: number, value_m, rms_m, tip_error_m, stability, values."""
    told = [(si_values(t), t.number, t.user_attrs) for t in trials if feasible(t)]
    return [
        {
            "number": number,
            "value_m": values[0],
            "rms_m": float(known.get("rms_m", values[0])),
            **{key: known.get(key) for key in ("tip_error_m", "stability")},
            "values": list(values),
        }
        for values, number, known in sorted(told, key=lambda one: (one[0][0], one[1]))[:10]
    ]


def reasons(trials: Sequence[FrozenTrial]) -> list[tuple[str, str, int]]:
    """Reasons why trials failed or were refused: which of the two, the reason, and how many trials, most first."""
    counted: dict[tuple[str, str], int] = {}
    for trial in trials:
        if not feasible(trial):
            key = (
                "refused" if refused(trial) else "failed",
                str(trial.user_attrs.get("reason") or "not told"),
            )
            counted[key] = counted.get(key, 0) + 1
    return [
        (kind, reason, count)
        for (kind, reason), count in sorted(counted.items(), key=lambda item: -item[1])
    ]


def importances(kept: optuna.Study, trials: Sequence[FrozenTrial]) -> Plain:
    """Parameters in which the best trials differ from all: PED-ANOVA (Watanabe et al., IJCAI 2023), shares that sum to 1.

    `values`: parameter -> share, largest first; `trials`: of how many. Or `why` there are none.
    """
    from optuna.importance import PedAnovaImportanceEvaluator, get_param_importances

    good = [t for t in trials if feasible(t)]
    if len(good) < 4:
        return {"why": f"{len(good)} feasible trials are too few to tell which parameters mattered"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # experimental
        try:
            found = get_param_importances(
                kept, evaluator=PedAnovaImportanceEvaluator(), target=lambda t: t.values[0]
            )
        except (ValueError, RuntimeError) as error:
            return {"why": f"not known: {error}"}
    if not found or not sum(found.values()) > 0:
        return {"why": "no parameter tells the better trials from the others"}
    return {"values": {name: float(share) for name, share in found.items()}, "trials": len(trials)}


def when(trials: Sequence[FrozenTrial]) -> Plain:
    """`began` and `ended` (ISO dates), of the trials that say so."""
    began = min((t.datetime_start for t in trials if t.datetime_start is not None), default=None)
    ended = max(
        (t.datetime_complete for t in trials if t.datetime_complete is not None), default=None
    )
    return {
        name: at and at.isoformat(" ", "seconds")
        for name, at in (("began", began), ("ended_at", ended))
    }


def gather(
    folder: Path,
    report: Named,
    *,
    run: Callable[..., Result],
    differentiate: Callable[..., Any],
    storage: str | None = None,
    quick: bool = False,
    motion: bool = False,
) -> Plain:
    """Gather what is known of the study in a folder. report: what `magmpm design` wrote there (study.json).

    run, differentiate: magmpm.run and magmpm.sensitivities, by which the best design is evaluated again, unless quick. storage: the URL of
    the trials where the report's lacks a password. motion: run the best design of an insertion or a schedule in time, too.
    """
    import optuna

    notes: list[str] = []
    facts: Plain = {
        **report,
        "notes": notes,
        "versions": {**versions(), "optuna": optuna.__version__},
    }
    facts |= _of_trials(folder, report, storage, notes)
    study = _study(facts, notes)
    facts["command"] = _command(facts)
    facts["kind"] = next(
        (kind for kind in ("insertion", "schedule") if kind in (report.get("best") or {})), "shape"
    )
    facts["files"] = {} if study is None else _files(study)
    facts["target"] = None if study is None else study.target
    best = records.read_design(folder / records.BEST)
    facts["design"] = {} if "number" not in best else best
    if "number" not in best:
        return facts
    result = Result.load(folder / records.BEST)
    try:  # the whole body: of an insertion, the result's has only what is out of the guide
        scene = load_scene(folder / records.BEST / SCENE)
    except MagmpmError:
        scene = Scene.from_si(result.scene)
    body = without_guide(describe_body(scene), len(best.get("magnetization") or ()))
    names = (
        "converged",
        "iterations",
        "particles",
        "dof",
        "min_det_F",
        "max_det_F",
        "largest_stretch",
        "warnings",
        "versions",
    )
    numbers = {name: getattr(result, name) for name in names} | {
        "tip_m": [float(x) for x in tip_of(result)]
    }
    facts |= {"body": body, "best_scene": _text(folder / records.BEST / SCENE), "result": numbers}
    if motion:
        facts["motion"] = in_time(folder, best, study)
    if not quick:
        facts |= _verified(result, best, study, run, differentiate)
        facts |= _limits_of_errors(facts, body["length_m"])
    return facts


def _limits_of_errors(facts: Named, length: float) -> Plain:
    """The tolerances with the errors that move the tip by 1 % of the length and by the study's stop (`moves`: in words)."""
    rows = facts["tolerances"]
    if not isinstance(rows, list):
        return {}
    moves = {
        f"1 % of the length ({1e3 * SHARE_OF_LENGTH * length:.3g} mm)": SHARE_OF_LENGTH * length
    }
    if facts.get("stop_rms_m"):
        moves[f"the study's stop ({1e3 * facts['stop_rms_m']:.3g} mm)"] = float(facts["stop_rms_m"])
    limited = [
        {**row, "allowed": [allowed(row, distance) for distance in moves.values()]} for row in rows
    ]
    return {"tolerances": limited, "moves": list(moves), "together_m": together(rows)}


def _of_trials(folder: Path, report: Named, storage: str | None, notes: list[str]) -> Plain:
    """Facts in the storage; a note where it can't be read."""
    import optuna

    url = storage or report["storage"]
    try:
        must_exist(url, folder)
        with storage_faults(url):
            kept = optuna.load_study(study_name=report["name"], storage=open_storage(url))
            trials = [
                trial
                for trial in trials_of(kept, url)
                if trial.state == optuna.trial.TrialState.COMPLETE
            ]
            found: Plain = {
                "definition": kept.user_attrs.get("definition"),
            }
            shares = importances(kept, trials)
    except (MagmpmError, KeyError) as error:
        notes.append(
            "The trials could not be read, so their table and the parameters' importances are"
            f" missing: {error}"
        )
        return {}
    of_trials = {"best_trials": best_rows(trials), "why_not": reasons(trials), **when(trials)}
    return found | of_trials | {"importances": shares}


def _study(facts: Plain, notes: list[str]) -> Study | None:
    """The study as its file says it, if that is still the one that was run."""
    path = facts.get("study_file")
    if not path:
        return None
    try:
        study = load_study(path)
        facts["file_sampler"] = study.sampler
        study = study.changed(sampler=facts["sampler"])
    except MagmpmError as error:
        notes.append(f"The study's file can't be read any more: {error}")
        return None
    definition = whole_definition(study, SearchSpace.of(study).distributions())
    if facts.get("definition") and differences(facts["definition"], definition):
        notes.append(
            f"{Path(path).name} or a file that it names has changed since the study was begun; its"
            " stored definition is below."
        )
        return None
    return study


def _command(facts: Named) -> str:
    """The one line that makes the study again, from the folder in which the report was made where that holds the file."""
    path = Path(str(facts.get("study_file") or "STUDY.yaml"))
    shown = (
        os.path.relpath(path)
        if path.is_absolute() and path.is_relative_to(Path.cwd())
        else path.name
    )
    words = ["magmpm", "design", str(shown)]
    if facts["ended"] != "stop":
        words += ["--trials", str(facts["trials"])]
    if facts.get("file_sampler") != facts["sampler"]:
        words += ["--sampler", str(facts["sampler"])]
    return shlex.join(words)


def _files(study: Study) -> dict[str, str]:
    """The text of the study's own files, by name, where they are short, and its targets as tables."""
    found = {study.path.name: _text(study.path)}
    if study.scene_file is not None:
        found[Path(study.scene_file).name] = _text(Path(study.scene_file))
    targets = {f"at {frame.time:g} s": frame.target for frame in study.keyframes} or {
        "": study.target
    }
    for when, rows in targets.items():
        lines = [
            "s_mm,x_mm,y_mm,z_mm",
            *(",".join(f"{x:.9g}" for x in row) for row in (1e3 * rows + 0.0).tolist()),
        ]
        found[" ".join(["the target", when]).strip()] = "\n".join(lines)
    return {name: text for name, text in found.items() if text}


def _text(path: Path) -> str:
    try:
        return read_regular(path, 200_000).decode("utf-8", errors="replace")
    except OSError:
        return ""


def describe_body(scene: Scene) -> Plain:
    """The body of a design as a drawing needs it, SI: kind, length, section, clamp, and of each segment `from_m`, length_m, material,
    direction (unit vector or zeros), remanence_T, shear_modulus_Pa."""
    shape = scene.body.shape
    assert isinstance(shape, StraightBody)
    lengths = shape.segment_lengths()
    begins = np.concatenate([[0.0], np.cumsum(lengths)])
    segments = []
    for k, (region, length) in enumerate(zip(scene.regions(), lengths, strict=True)):
        material = scene.region_material(k)
        magnetized = any(region.magnetization)
        segments.append(
            {
                "number": k + 1,
                "from_m": float(begins[k]),
                "length_m": float(length),
                "material": region.material_name,
                "direction": [float(x) for x in region.magnetization],
                "remanence_T": float(material.remanence) if magnetized else 0.0,
                "shear_modulus_Pa": float(material.shear_modulus),
            }
        )
    section = {
        name: float(getattr(shape, name))
        for name in ("diameter", "inner_diameter", "width", "thickness")
        if hasattr(shape, name)
    }
    return {
        "kind": shape.kind,
        "length_m": float(shape.length),
        "section_m": section,
        "clamp": shape.clamp,
        "segments": segments,
    }


def without_guide(body: Plain, segments: int) -> Plain:
    """The body without the piece that the scene of a push puts before an insertion's own segments, of which there are so many."""
    extra = max(len(body["segments"]) - segments, 0) if segments else 0
    kept = body["segments"][extra:]
    begin = kept[0]["from_m"]
    moved = [
        {**segment, "number": k, "from_m": segment["from_m"] - begin}
        for k, segment in enumerate(kept, 1)
    ]
    return {**body, "length_m": body["length_m"] - begin, "segments": moved}


def _verified(
    result: Result,
    best: Named,
    study: Study | None,
    run: Callable[..., Result],
    differentiate: Callable[..., Any],
) -> Plain:
    try:
        last = last_equilibrium(result, best, study)
    except SolveError as error:
        return dict.fromkeys(("tolerances", "finer"), f"not known: {error.reason}")
    return verified(result, last, run, differentiate)
