"""Every broken scene file is refused with one message: file and line, key, value received, rule, remedy."""

from pathlib import Path

import bad_studies
import pytest
import yaml
from bad_scene import GOOD, BadScene, expected, write
from bad_scenes import CASES
from bad_studies import FILES, BadStudy

from magmpm.effects.acting import _INSTEAD
from magmpm.errors import InputError
from magmpm.materials import bulk_over_shear, poisson_ratio, shear_of_young, young_modulus
from magmpm.scene import load_scene
from magmpm.studies.search.definition import load_study


def refusal(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        load_scene(path)
    return str(caught.value)


def test_the_good_scene_is_good(tmp_path: Path) -> None:
    path = tmp_path / "probe.yaml"
    path.write_text(GOOD)
    assert load_scene(path).warnings() == []


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name.replace(" ", "-"))
def test_what_is_wrong_is_said_by_loader_and_command(case: BadScene, tmp_path: Path, told) -> None:
    path = write(case, tmp_path)
    with pytest.raises(InputError) as caught:
        load_scene(path)
    message = str(caught.value)
    missing = [phrase for phrase in expected(case, path) if phrase not in message]
    assert not missing, f"not said: {missing}\nin:\n{message}"
    assert "\n  rule: " in message
    assert "\n  remedy: " in message
    assert "problems in" not in message, f"one mistake, one problem:\n{message}"
    assert (
        told(
            "run",
            path,
            "--json",
            "--out",
            tmp_path / "out",
            status=2,
            says=tuple(expected(case, path)),
        ).out
        == ""
    )
    assert not (tmp_path / "out").exists()


def test_no_remedy_for_an_effect_is_to_remove_it(tmp_path: Path) -> None:
    """Who asks for an effect wants it: the message says what there is."""
    path = tmp_path / "probe.yaml"
    for key in (*_INSTEAD, "sparkles"):
        path.write_text(GOOD.replace("  gravity: {}", f"  {key}: {{}}"))
        remedy = refusal(path).rpartition("remedy: ")[2]
        assert remedy
        assert "remove it" not in remedy


def test_what_stands_for_young_and_poisson_is_the_same_material() -> None:
    """Through the conversions and back, at any ratio that a material may have; 1e-12: rounding."""
    for ratio in (0.7, 1.0, 5.0, 20.0, 500.0, 1e4):
        nu = poisson_ratio(1.0, ratio)
        young = young_modulus(120e3, 120e3 * ratio)
        assert bulk_over_shear(nu) == pytest.approx(
            ratio, rel=1e-12 * ratio + 1e-12
        )  # 1 - 2 nu has lost a digit for each factor of ten
        assert shear_of_young(young, nu) == pytest.approx(120e3, rel=1e-12)


def test_another_kind_of_file_gets_its_command(tmp_path: Path, told) -> None:
    study = write_good(tmp_path)
    robot = tmp_path / "robot.yaml"
    scene = tmp_path / yaml.safe_load(study.read_text())["scene"]
    robot.write_text("name: gripper\nn_segments: 1\nremenance: 0.1\nsegments: []\n")
    for command in ("run", "accuracy", "effects"):
        told(
            command,
            study,
            status=2,
            says=(str(study), "received a study", f"magmpm design {study}", scene.name),
        )
    told("run", robot, status=2, says=("received a robot", f"magmpm import {robot}"))
    told(
        "design",
        scene,
        "--no-pictures",
        status=2,
        says=(str(scene), "received a scene", f"magmpm run {scene}"),
    )
    study.write_text(study.read_text() + "materials: {}\n")
    told(
        "design",
        study,
        "--no-pictures",
        status=2,
        says=("materials", f'it belongs in the scene, the file "{scene.name}"'),
    )


def test_thousands_of_problems_are_counted_and_the_first_put_into_words(tmp_path: Path) -> None:
    """Each would take a millisecond."""
    path = tmp_path / "probe.yaml"
    path.write_text(GOOD + "".join(f"k{number}: 1\n" for number in range(3000)))
    lines = refusal(path).splitlines()
    assert lines[0] == f"3000 problems in {path}"
    assert lines[-1] == "... and 2980 more"


@pytest.mark.parametrize(
    "text", ["1" * 5000, "1" + "e1" * 5000, "1 " + "m" * 5000, "1 m" + "*m" * 5000]
)
def test_a_text_without_end_is_not_told_in_full(text: str, tmp_path: Path) -> None:
    path = tmp_path / "probe.yaml"
    path.write_text(GOOD.replace("40 mm", f"'{text}'"))
    assert len(refusal(path)) < 1000


def test_all_problems_are_listed_in_the_order_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "probe.yaml"
    path.write_text(
        GOOD.replace("40 mm", "40")
        .replace("6 mT", "6 mm")
        .replace("cells_across: 4", "seconds: -2 s")
    )
    lines = refusal(path).splitlines()
    assert lines[0] == f"3 problems in {path}"
    places = [line.split(": received")[0] for line in lines[1::3]]
    assert places == [
        f"{path}:12: body.catheter.length",
        f"{path}:22: field.uniform[1]",
        f"{path}:28: resolution.seconds",
    ]


# Every broken study is refused with a message that names file, line, key, value, rule and remedy, before anything runs


def write_good(folder: Path) -> Path:
    for name, text in FILES.items():
        (folder / name).write_text(text)
    return folder / "study.yaml"


def test_the_good_study_is_good(tmp_path: Path) -> None:
    study = load_study(write_good(tmp_path))
    assert (study.name, study.trials, study.stop_rms, study.field_max) == ("study", 35, 2e-3, 10e-3)


@pytest.mark.parametrize("case", bad_studies.CASES, ids=lambda case: case.name.replace(" ", "-"))
def test_what_is_wrong_in_a_study_is_said_by_loader_and_command(
    case: BadStudy, tmp_path: Path, told
) -> None:
    path = bad_studies.write(case, tmp_path)
    out = tmp_path / "out"
    with pytest.raises(InputError) as caught:
        load_study(path)
    message = str(caught.value)
    assert str(tmp_path) in message, "the file is named"
    assert "\n  rule: " in message or "no such file" in message or "this is a folder" in message
    assert "problems in" not in message, f"one mistake, one problem:\n{message}"
    assert all(phrase in message for phrase in case.says), message
    assert told("design", path, "--out", out, "--no-pictures", status=2, says=case.says).out == ""
    assert not out.exists(), "nothing is left behind"


@pytest.mark.parametrize("name", ["..yaml", "...yaml", "a\tb.yaml"])
def test_a_study_is_named_as_a_folder_can_be(
    name: str, tmp_path: Path, told, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`..yaml` would write its results into runs/ itself, `...yaml` beside it."""
    monkeypatch.chdir(tmp_path)
    write_good(tmp_path).rename(tmp_path / name)
    before = sorted(tmp_path.rglob("*"))
    says = name, "names the folder of results", "\n  rule: ", "\n  remedy: rename the file"
    told("design", name, "--no-pictures", status=2, says=says)
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (
            ["--sampler", "annealing"],
            (
                "--sampler",
                "annealing",
                "tpe, gp, cmaes, nsga2, random, gauss-newton, or optuna:NAME",
            ),
        ),
        (["--sampler", "optuna:CMAES"], ("--sampler", 'did you mean "optuna:CmaEsSampler"?')),
        (["--trials", "0"], ("--trials", "received 0", "at least 1")),
        (
            ["--trials", "99999999999"],
            (
                "--trials",
                "received 99999999999",
                "rule: must be at most 1000000",
                "remedy: --trials",
            ),
        ),
        (["--storage", "nodatabase://here"], ("--storage", "nodatabase", "usable URL")),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, list) else None,
)
def test_bad_options_end_with_status_2(
    arguments: list[str], says: tuple[str, ...], tmp_path: Path, told
) -> None:
    out = ["--out", tmp_path / "out", "--no-pictures"]
    assert told("design", write_good(tmp_path), *out, *arguments, status=2, says=says).out == ""
