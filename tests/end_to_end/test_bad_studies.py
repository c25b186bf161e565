"""Every broken study is refused with a message that names file, line, key, value, rule and remedy, before anything runs."""

import contextlib
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from bad_scenes import DAMAGE
from bad_studies import CASES, FILES, BadStudy, write

from magmpm.errors import InputError, NotThereYet
from magmpm.studies.search.definition import load_study


def write_good(folder: Path) -> Path:
    for name, text in FILES.items():
        (folder / name).write_text(text)
    return folder / "study.yaml"


def test_the_good_study_is_good(tmp_path: Path) -> None:
    study = load_study(write_good(tmp_path))
    assert (study.name, study.trials, study.stop_rms, study.field_max) == ("study", 35, 2e-3, 10e-3)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name.replace(" ", "-"))
def test_what_is_wrong_is_said_by_loader_and_command(case: BadStudy, tmp_path: Path, told: Callable[..., Any]) -> None:
    path, out = write(case, tmp_path), tmp_path / "out"
    with pytest.raises(InputError) as caught:
        load_study(path)
    message = str(caught.value)
    assert str(tmp_path) in message, "the file is named"
    assert "\n  rule: " in message or "no such file" in message or "this is a folder" in message
    assert "problems in" not in message, f"one mistake, one problem:\n{message}"
    assert isinstance(caught.value, NotThereYet) == case.later
    assert all(phrase in message for phrase in case.says), message
    assert told("design", path, "--out", out, "--no-pictures", status=2, says=case.says).out == ""
    assert not out.exists(), "nothing is left behind"


@pytest.mark.parametrize("name", ["..yaml", "...yaml", "a\tb.yaml"])
def test_a_study_is_named_as_a_folder_can_be(name: str, tmp_path: Path, told: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
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
        (["--sampler", "annealing"], ("--sampler", "annealing", "tpe, gp, cmaes, nsga2, random, gauss-newton, or optuna:NAME")),
        (["--sampler", "optuna:CMAES"], ("--sampler", 'did you mean "optuna:CmaEsSampler"?')),
        (["--trials", "0"], ("--trials", "received 0", "at least 1")),
        (["--trials", "99999999999"], ("--trials", "received 99999999999", "rule: must be at most 1000000", "remedy: --trials")),
        (["--storage", "study.db"], ("--storage", "study.db", "sqlite:///study.db")),
        (["--storage", "nodatabase://here"], ("--storage", "nodatabase", "usable URL")),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, list) else None,
)
def test_bad_options_end_with_status_2(arguments: list[str], says: tuple[str, ...], tmp_path: Path, told: Callable[..., Any]) -> None:
    out = ["--out", tmp_path / "out", "--no-pictures"]
    assert told("design", write_good(tmp_path), *out, *arguments, status=2, says=says).out == ""


def test_damaged_files_never_crash(tmp_path: Path) -> None:
    """Good files with random damage give a study or an InputError, nothing else."""
    rng = random.Random(5)
    pieces = [*DAMAGE, "1e999", ".nan", "\0", "é"]
    for _ in range(300):
        write_good(tmp_path)
        path = tmp_path / rng.choice(list(FILES))
        text = path.read_text()
        at = rng.randrange(len(text))
        path.write_text(text[:at] + rng.choice(pieces) + text[at + rng.choice([0, 1, 3]) :])
        with contextlib.suppress(InputError):
            load_study(tmp_path / "study.yaml")
