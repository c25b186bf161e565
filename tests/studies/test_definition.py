"""A study is defined by exactly what determines its trials and their values."""

import gc
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from reference.damage import cut_short, garbage, null
from rod_solve import SCENE, STUDY, solve, write_study

from magmpm.errors import InputError
from magmpm.inputs.settings import json_schema
from magmpm.inputs.yaml_document import read_yaml
from magmpm.results.result import readable
from magmpm.studies.engine.loop import run_study
from magmpm.studies.problem.study_file import SCHEMA, StudyFile
from magmpm.studies.search.definition import Study, differences, load_study

Begun = Callable[[Path, int], Study]
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
        (
            "# a remark\n"
            + STUDY.replace("{centreline: target.csv}", "\n  centreline: ./target.csv"),
            SCENE,
        ),
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
    assert differences(before, load_study(path).definition()) == []


@pytest.mark.parametrize(
    ("study", "scene", "shown"),
    [
        (STUDY.replace("seed: 3", "seed: 4"), SCENE, "seed: 3 -> 4"),
        (STUDY.replace("random", "tpe"), SCENE, "sampler: random -> tpe"),
        (
            STUDY.replace("{}", "{}\n  field: {max: 9 mT}"),
            SCENE,
            "vary.field.max: nothing -> 0.009",
        ),
        (
            STUDY,
            SCENE.replace("120 kPa", "121 kPa"),
            "materials.magnetic.shear_modulus: 120000 -> 121000",
        ),
        (STUDY, SCENE.replace("6 mT", "5 mT"), "scene.field.uniform[1]: 0.006 -> 0.005"),
        (STUDY, SCENE.replace("[-1, 0, 0.5]", "[0, 0, 0]"), "segments[3].magnetization[0]: 1 -> 0"),
        (
            STUDY,
            SCENE.replace("cells_across: 4", "cells_across: 5"),
            "scene.resolution.cells_across: 4 -> 5",
        ),
        (
            STUDY,
            SCENE + "solver: {static: {tolerance: 1e-6}}\n",
            "scene.solver.static.tolerance: 1e-11 -> 1e-06",
        ),
        (
            STUDY,
            SCENE + "solver: {anti_locking: none}\n",
            "scene.solver.anti_locking: f-bar -> none",
        ),
        (
            STUDY,
            SCENE.replace("torque: {}", "torque: {}, gravity: {}"),
            "gravity.acceleration[2]: nothing -> -9.81",
        ),
    ],
    ids=[
        "seed",
        "sampler",
        "field",
        "material",
        "scene's field",
        "unmagnetised",
        "resolution",
        "tolerance",
        "anti-locking",
        "effect",
    ],
)
def test_another_definition_is_refused_and_the_difference_shown(
    study: str, scene: str, shown: str, tmp_path: Path, begun: Begun
) -> None:
    path = begun(tmp_path, 1).path
    out = tmp_path / "out"
    write_study(tmp_path, study, scene)
    with pytest.raises(InputError) as caught:
        run_study(load_study(path), solve=solve, out=out, trials=2)
    message = str(caught.value)
    assert shown in message
    assert "--out" in message
    assert "old values" in message
    write_study(tmp_path)
    assert run_study(load_study(path), solve=solve, out=out, trials=2).trials == 2, (
        "put back, it resumes"
    )


def test_another_target_is_refused(tmp_path: Path, begun: Begun) -> None:
    path = begun(tmp_path, 1).path
    out = tmp_path / "out"
    table = (tmp_path / "target.csv").read_text()
    last = table.rstrip().splitlines()[-1]
    (tmp_path / "target.csv").write_text(
        table.replace(last, last.replace(last.split(",")[3], "15"))
    )
    with pytest.raises(InputError, match=r"match\.centreline\[20\]: 40 .* -> 40 .* 15\n"):
        run_study(load_study(path), solve=solve, out=out, trials=2)


def test_many_differences_are_counted_rather_than_listed() -> None:
    old = {"row": list(range(30))}
    new = {"row": list(range(1, 31))}
    lines = differences(old, new)
    assert lines[0] == "row[0]: 0 -> 1"
    assert lines[-1] == "and 18 more"
    assert len(lines) == 13


def test_overrides_of_the_command_line(tmp_path: Path) -> None:
    study = load_study(write_study(tmp_path))
    assert vars(study.changed()) == vars(study)
    assert study.changed(trials=5, sampler="tpe").definition()["sampler"] == "tpe"


# A results folder belongs to one study


def test_another_study_is_refused_in_the_same_folder(tmp_path: Path, begun: Begun) -> None:
    """Their pictures and improvements would be mixed; the message names both and gives the remedy."""
    path = begun(tmp_path, 1).path
    other = path.with_name("other.yaml")
    other.write_text(path.read_text())
    with pytest.raises(InputError, match="probe") as caught:
        run_study(load_study(other), solve=solve, out=tmp_path / "out", trials=1)
    assert "other" in str(caught.value)
    assert "--out" in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"\xff\xfe\x00"])
def test_a_damaged_name_of_the_study(content: bytes, tmp_path: Path, begun: Begun) -> None:
    """An empty file is written again; a file with other bytes is refused."""
    study = begun(tmp_path, 1)
    (tmp_path / "out/study-name.txt").write_bytes(content)
    if content:
        with pytest.raises(InputError, match=r"study-name\.txt"):
            run_study(study, solve=solve, out=tmp_path / "out", trials=2)
    else:
        assert run_study(study, solve=solve, out=tmp_path / "out", trials=2).trials == 2


def _null_inside(path: Path) -> None:
    path.write_text('{"number": null}')


DAMAGES = [
    *(
        (name, damage)
        for name in ("state.npz", "result.json", "design.json")
        for damage in (cut_short, garbage, Path.unlink)
    ),
    *((name, damage) for name in ("result.json", "design.json") for damage in (null, _null_inside)),
]


@pytest.mark.parametrize(("name", "damage"), DAMAGES)
def test_a_damaged_design_is_made_again(
    name: str, damage: Callable[[Path], None], tmp_path: Path, begun: Begun
) -> None:
    """Best and improvements: a study continues, and repairs what can be solved again."""
    study = begun(tmp_path, 4)
    out = tmp_path / "out"
    folders = [out / "best", *sorted((out / "improvements").iterdir())]
    assert len(folders) >= 3, "the best and two that were better than what was before"
    good = [(folder / "design.json").read_text() for folder in folders]
    for folder in folders[:-1]:
        damage(folder / name)
    assert run_study(study, solve=solve, out=out, trials=5).trials == 5
    for folder, text in zip(folders[1:], good[1:]):
        found = json.loads((folder / "design.json").read_text())
        assert {key: found[key] for key in ("number", "params", "rms_m")} == {
            k: json.loads(text)[k] for k in ("number", "params", "rms_m")
        }
    assert all(readable(folder) for folder in folders)


# designs and trials belong together


def _refused(study: Study, out: Path, *says: str, **options: Any) -> None:
    # connections of the study before are closed now, and not while the folder is compared
    gc.collect()
    before = {
        path: path.read_bytes()
        for path in sorted(out.rglob("*"))
        if path.is_file() and path.name != ".lock"
    }
    with pytest.raises(InputError) as caught:
        run_study(study, solve=solve, out=out, **options)
    for part in (
        f"{out}: holds designs of trials that are not there",
        "rule: ",
        "remedy: ",
        f"--out {out}-2",
        *says,
    ):
        assert part in str(caught.value)
    after = {
        path: path.read_bytes()
        for path in sorted(out.rglob("*"))
        if path.is_file() and path.name != ".lock"
    }
    assert after == before


def test_a_deleted_or_empty_database_is_not_begun_anew_over_its_designs(
    tmp_path: Path, begun: Begun
) -> None:
    study = begun(tmp_path, 4)
    out = tmp_path / "out"
    kept = tmp_path / "kept"
    kept.mkdir()
    for path in out.glob("study.db*"):
        path.rename(kept / path.name)
    _refused(study, out, f"{out}/study.db is missing", "put the trials back")
    _refused(study, out, f"{out}/study.db is missing", trials=9)
    (out / "study.db").touch()
    _refused(study, out, f"{out}/study.db is empty")
    for path in kept.iterdir():
        path.rename(out / path.name)
    assert run_study(study, solve=solve, out=out, trials=5).trials == 5, (
        "with its trials back, it goes on"
    )


def test_another_database_is_refused_over_the_designs_of_the_first(tmp_path: Path) -> None:
    """It may be new, or contain a study of this name with other trials; naming the first database or moving the folder is accepted."""
    study = load_study(write_study(tmp_path))
    out = tmp_path / "out"
    run_study(study, solve=solve, out=out, trials=4)
    new = f"sqlite:///{tmp_path}/new.db"
    other = f"sqlite:///{tmp_path}/other.db"
    _refused(
        study, out, "new.db is missing", f"(sqlite:///{out}/study.db when they ended)", storage=new
    )
    assert not (tmp_path / "new.db").exists()
    seeded = load_study(write_study(tmp_path / "other", STUDY.replace("seed: 3", "seed: 4")))
    run_study(seeded, solve=solve, out=tmp_path / "elsewhere", trials=4, storage=other)
    _refused(seeded, out, "other.db has 4 trials, which are others", storage=other)
    assert (
        run_study(study, solve=solve, out=out, trials=5, storage=f"sqlite:///{out}/study.db").trials
        == 5
    )
    out.rename(tmp_path / "moved")
    assert run_study(study, solve=solve, out=tmp_path / "moved", trials=6).trials == 6
