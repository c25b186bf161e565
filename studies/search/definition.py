"""Definition of a study in its file: the scene, what is varied, what it must match, and how it is searched.

`load_study(path)` reads a file and all it names. A study's *definition* is everything that decides which trials are
made and how they are evaluated; the length of the study (`trials`, `stop`) is not part of it, so a study can be
extended, but is never silently continued as a different one.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array, Named
from magmpm.errors import InputError
from magmpm.inputs.csv_tables import read_centreline
from magmpm.inputs.settings import validate
from magmpm.inputs.user_files import REMEDY, RULE, is_allowed
from magmpm.inputs.yaml_document import Document, read_yaml
from magmpm.scene import Scene, load_scene
from magmpm.scene.coarsest import coarsest_cells
from magmpm.studies.problem.sampler_names import SAMPLERS, check_sampler_name
from magmpm.studies.problem.study import ShapeKeyframe, Study
from magmpm.studies.problem.study_file import Match, StudyFile
from magmpm.studies.search import study_checks
from magmpm.studies.search.samplers.choice import best_suited

__all__ = [
    "SAMPLERS",
    "Study",
    "StudyFile",
    "check_sampler_name",
    "differences",
    "load_study",
]


def load_study(path: Path | str) -> Study:
    """Read a study from its file, with the scene and the target that it names.

    Parameters
    ----------
    path : Path or str
        The file.

    Returns
    -------
    Study
        The study.

    Raises
    ------
    InputError
        With file, line, key, value, rule and remedy.
    """
    document = read_yaml(path)
    study_checks.check_file_name(document.path)
    if "scene" not in document and ("body" in document or "materials" in document):
        rule = (
            "a study names a scene, and says what is varied and what is matched: `scene`, `vary`,"
            " `match`"
        )
        remedy = (
            f"`magmpm run {path}` simulates the scene; a study of it is a file of its own, as"
            " docs/own_target.md writes one"
        )
        raise InputError(str(path), received="a scene", rule=rule, remedy=remedy)
    file = validate(StudyFile, document)
    folder = document.path.parent
    _must_be_near(document, folder / file.scene, "scene")
    try:
        scene = load_scene(folder / file.scene)
    except InputError as error:
        raise study_checks.named_in(error, study_checks.place(document, "scene")) from None
    study_checks.check_scene(scene, file, document)
    requested = None
    if (
        scene.resolution.requested
    ):  # of the whole shape, which designs are evaluated by: a bound for the tip as well
        requested = scene.resolution.model_copy(update={"of": "centreline"})
        scene = scene.with_cells(coarsest_cells(scene))
    study_checks.check_numbers(scene, file.vary, file.sampler, document)
    study_checks.check_robust(scene, file, document)
    target, keyframes = _targets(file, document, scene)
    study = Study(
        path=document.path,
        name=document.path.stem,
        scene=scene,
        target=target,
        vary=file.vary,
        trials=file.trials,
        sampler=file.sampler or "gauss-newton",
        seed=file.seed,
        stop_rms=None if file.stop is None else file.stop.rms,
        scene_file=folder / file.scene,
        depths=_depths(file, target, scene.thickness),
        keyframes=keyframes,
        hold=0.0 if file.schedule is None else file.schedule.hold,
        minimize=file.minimize,
        robust=file.robust,
        margin=None if file.stability is None else file.stability.margin,
        limits=file.limits,
        start=file.start,
        requested=requested,
    )
    return study if file.sampler is not None else best_suited(study)


def _targets(
    file: StudyFile, document: Document, scene: Scene
) -> tuple[Array, tuple[ShapeKeyframe, ...]]:
    """The target of a study (the path of an insertion, the last shape of a schedule), and the shapes of a schedule."""
    if isinstance(file.match, Match):
        key = "centreline" if file.match.centreline is not None else "path"
        return (
            _read_target(
                str(file.match.centreline or file.match.path), ("match", key), file, document, scene
            ),
            (),
        )
    frames = tuple(
        ShapeKeyframe(
            shape.time,
            _read_target(shape.centreline, ("match", k, "centreline"), file, document, scene),
        )
        for k, shape in enumerate(file.match)
    )
    return frames[-1].target, frames


def _must_be_near(document: Document, path: Path, *key: str | int) -> None:
    """Raises InputError for a path that a study may not name."""
    if not is_allowed(path, document.path):
        raise InputError(
            study_checks.place(document, *key), received=str(path), rule=RULE, remedy=REMEDY
        )


def _read_target(
    name: str, key: tuple[str | int, ...], file: StudyFile, document: Document, scene: Scene
) -> Array:
    """Rows [s, x, y, z] (m, 4) m of a table that the study names. Raises InputError."""
    csv = document.path.parent / name
    _must_be_near(document, csv, *key)
    try:
        target = read_centreline(csv)
    except InputError as error:
        raise study_checks.named_in(error, study_checks.place(document, *key)) from None
    study_checks.check_target(target, scene, file, csv, study_checks.place(document, *key))
    return target


def _depths(file: StudyFile, path: Array, thickness: float) -> tuple[float, ...]:
    """Inserted lengths, m, of an insertion along a path, (m, 4) m."""
    if file.insertion is None:
        return ()
    if isinstance(file.insertion.depths, tuple):
        return file.insertion.depths
    first = max(
        path[-1, 0] / file.insertion.depths, thickness
    )  # a piece shorter than its diameter is no rod
    return (
        tuple(np.linspace(first, path[-1, 0], file.insertion.depths).tolist())
        if file.insertion.depths > 1
        else (float(path[-1, 0]),)
    )


def differences(old: Named, new: Named) -> list[str]:
    """List the differences between two definitions; numbers count to 12 digits, the order of keys does not.

    Parameters
    ----------
    old : Mapping[str, Any]
        A definition.
    new : Mapping[str, Any]
        Another.

    Returns
    -------
    list of str
        One line a key: `sampler: tpe -> random`.
    """
    most = 12
    was = dict(_flat(old))
    now = dict(_flat(new))
    keys = [*was, *(key for key in now if key not in was)]
    lines = [
        f"{key}: {was.get(key, 'nothing')} -> {now.get(key, 'nothing')}"
        for key in keys
        if was.get(key) != now.get(key)
    ]
    if len(lines) > most:
        lines[most:] = [f"and {len(lines) - most} more"]
    return lines


def _flat(content: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """("body.catheter.length", "0.04") for every leaf of nested data."""
    if isinstance(content, Mapping) and content:
        for name, value in content.items():
            yield from _flat(value, f"{key}.{name}" if key else str(name))
    elif isinstance(content, (list, tuple)) and content:
        for i, value in enumerate(content):
            yield from _flat(value, f"{key}[{i}]")
    elif isinstance(content, (int, float)) and not isinstance(content, bool):
        yield key, f"{content + 0.0:.12g}"
    else:
        yield key, content if isinstance(content, str) else json.dumps(content)
