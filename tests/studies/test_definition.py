"""A study is defined by exactly what determines its trials and their values."""

from __future__ import annotations

from pathlib import Path

import pytest
from jsonschema import Draft202012Validator
from rod_solve import SCENE, STUDY, solve, write_study

from magmpm.errors import InputError
from magmpm.inputs.settings import json_schema
from magmpm.inputs.yaml_document import read_yaml
from magmpm.studies.engine.loop import run_study
from magmpm.studies.problem.study_file import SCHEMA, StudyFile
from magmpm.studies.search.definition import definition_hash, differences, load_study

ROOT = Path(__file__).parents[2]
STUDIES = sorted((ROOT / "data/studies").glob("*.yaml"))


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_shipped_studies_load_and_fit_the_schema(path: Path) -> None:
    study = load_study(path)
    assert study.sampler == "gauss-newton", "named, or the best for it"
    assert study.name == path.stem
    Draft202012Validator(json_schema(StudyFile)).validate(dict(read_yaml(path)))


def test_schema_file_is_current() -> None:
    """`python -m magmpm.studies.problem.study_file` rewrites it."""
    import json

    assert json.loads(SCHEMA.read_text()) == json_schema(StudyFile)


def test_schema_knows_what_is_wrong() -> None:
    validator = Draft202012Validator(json_schema(StudyFile))
    good = {"scene": "a.yaml", "vary": {"magnetization": {}}, "match": {"centreline": "b.csv"}}
    assert validator.is_valid(good)
    assert not validator.is_valid({**good, "trails": 3})
    assert not validator.is_valid({**good, "sampler": "newton"})
    assert not validator.is_valid({**good, "stop": {"rms": "2"}})


@pytest.mark.parametrize(
    ("study", "scene"),
    [
        (STUDY.replace("trials: 8", "trials: 99"), SCENE),
        (STUDY + "stop: {rms: 1 mm}\n", SCENE),
        ("# a remark\n" + STUDY.replace("{centreline: target.csv}", "\n  centreline: ./target.csv"), SCENE),
        (STUDY, SCENE.replace("name: five segments", "name: another name")),
        (STUDY, SCENE.replace("length: 40 mm", "length: 4 cm").replace("120 kPa", "0.12 MPa")),
        (STUDY, SCENE.replace("[-1, 0, 0.5]", "[0, 1, 0]")),  # the start of the search is not used
    ],
    ids=["trials", "stop", "layout", "name", "units", "varied magnetisation"],
)
def test_what_does_not_change_the_definition(study: str, scene: str, tmp_path: Path) -> None:
    path = write_study(tmp_path)
    before = load_study(path).definition()
    write_study(tmp_path, study, scene)
    assert definition_hash(load_study(path).definition()) == definition_hash(before)
    assert differences(before, load_study(path).definition()) == []


@pytest.mark.parametrize(
    ("study", "scene", "shown"),
    [
        (STUDY.replace("seed: 3", "seed: 4"), SCENE, "seed: 3 -> 4"),
        (STUDY.replace("random", "tpe"), SCENE, "sampler: random -> tpe"),
        (STUDY.replace("{}", "{}\n  field: {max: 9 mT}"), SCENE, "vary.field.max: nothing -> 0.009"),
        (STUDY, SCENE.replace("120 kPa", "121 kPa"), "materials.magnetic.shear_modulus: 120000 -> 121000"),
        (STUDY, SCENE.replace("6 mT", "5 mT"), "scene.field.uniform[1]: 0.006 -> 0.005"),
        (STUDY, SCENE.replace("[-1, 0, 0.5]", "[0, 0, 0]"), "segments[3].magnetization[0]: 1 -> 0"),
        (STUDY, SCENE.replace("cells_across: 4", "cells_across: 5"), "scene.resolution.cells_across: 4 -> 5"),
        (STUDY, SCENE + "solver: {static: {tolerance: 1e-6}}\n", "scene.solver.static.tolerance: 1e-11 -> 1e-06"),
        (STUDY, SCENE + "solver: {anti_locking: none}\n", "scene.solver.anti_locking: f-bar -> none"),
        (STUDY, SCENE.replace("torque: {}", "torque: {}, gravity: {}"), "gravity.acceleration[2]: nothing -> -9.81"),
    ],
    ids=["seed", "sampler", "field", "material", "scene's field", "unmagnetised", "resolution", "tolerance", "anti-locking", "effect"],
)
def test_another_definition_is_refused_and_the_difference_shown(study: str, scene: str, shown: str, tmp_path: Path) -> None:
    path, out = write_study(tmp_path), tmp_path / "out"
    run_study(load_study(path), solve=solve, out=out, trials=1)
    write_study(tmp_path, study, scene)
    with pytest.raises(InputError) as caught:
        run_study(load_study(path), solve=solve, out=out, trials=2)
    message = str(caught.value)
    assert shown in message
    assert "--out" in message
    assert "old values" in message
    write_study(tmp_path)
    assert run_study(load_study(path), solve=solve, out=out, trials=2).trials == 2, "put back, it resumes"


def test_another_target_is_refused(tmp_path: Path) -> None:
    path, out = write_study(tmp_path), tmp_path / "out"
    run_study(load_study(path), solve=solve, out=out, trials=1)
    table = (tmp_path / "target.csv").read_text()
    last = table.rstrip().splitlines()[-1]
    (tmp_path / "target.csv").write_text(table.replace(last, last.replace(last.split(",")[3], "15")))
    with pytest.raises(InputError, match=r"match\.centreline\[20\]: 40 .* -> 40 .* 15\n"):
        run_study(load_study(path), solve=solve, out=out, trials=2)


def test_many_differences_are_counted_rather_than_listed() -> None:
    old, new = {"row": list(range(30))}, {"row": list(range(1, 31))}
    lines = differences(old, new)
    assert lines[0] == "row[0]: 0 -> 1"
    assert lines[-1] == "and 18 more"
    assert len(lines) == 13


def test_overrides_of_the_command_line(tmp_path: Path) -> None:
    study = load_study(write_study(tmp_path))
    assert study.changed() == study
    assert study.changed(trials=5, sampler="tpe").definition()["sampler"] == "tpe"
    with pytest.raises(InputError, match="--trials: received 0"):
        study.changed(trials=0)
    with pytest.raises(InputError, match='--sampler: received "newton"'):
        study.changed(sampler="newton")
