"""A results folder belongs to one study."""

from __future__ import annotations

import gc
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rod_solve import STUDY, solve, write_study

from magmpm.errors import InputError
from magmpm.results.result import readable
from magmpm.studies.engine.loop import run_study
from magmpm.studies.search.definition import Study, load_study


def test_another_study_is_refused_in_the_same_folder(tmp_path: Path) -> None:
    """Their pictures and improvements would be mixed; the message names both and gives the remedy."""
    path = write_study(tmp_path)
    run_study(load_study(path), solve=solve, out=tmp_path / "out", trials=1)
    other = path.with_name("other.yaml")
    other.write_text(path.read_text())
    with pytest.raises(InputError, match="probe") as caught:
        run_study(load_study(other), solve=solve, out=tmp_path / "out", trials=1)
    assert "other" in str(caught.value)
    assert "--out" in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"\xff\xfe\x00"])
def test_a_damaged_name_of_the_study(content: bytes, tmp_path: Path) -> None:
    """An empty file is written again; a file with other bytes is refused."""
    study = load_study(write_study(tmp_path))
    run_study(study, solve=solve, out=tmp_path / "out", trials=1)
    (tmp_path / "out/study-name.txt").write_bytes(content)
    if content:
        with pytest.raises(InputError, match=r"study-name\.txt"):
            run_study(study, solve=solve, out=tmp_path / "out", trials=2)
    else:
        assert run_study(study, solve=solve, out=tmp_path / "out", trials=2).trials == 2


def _truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _garbage(path: Path) -> None:
    path.write_bytes(b"\x93garbage" * 50)


def _null(path: Path) -> None:
    path.write_text("null")


def _null_inside(path: Path) -> None:
    path.write_text('{"number": null}')


DAMAGES = [
    *((name, damage) for name in ("state.npz", "result.json", "design.json") for damage in (_truncated, _garbage)),
    *((name, damage) for name in ("result.json", "design.json") for damage in (_null, _null_inside)),
]


@pytest.mark.parametrize(("name", "damage"), DAMAGES)
def test_a_damaged_design_is_made_again(name: str, damage: Callable[[Path], None], tmp_path: Path) -> None:
    """Best and improvements: a study continues, and repairs what can be solved again."""
    study = load_study(write_study(tmp_path))
    out = tmp_path / "out"
    run_study(study, solve=solve, out=out, trials=4)
    folders = [out / "best", *sorted((out / "improvements").iterdir())]
    assert len(folders) >= 3, "the best and two that were better than what was before"
    good = [(folder / "design.json").read_text() for folder in folders]
    for folder in folders[:-1]:
        damage(folder / name)
    assert run_study(study, solve=solve, out=out, trials=5).trials == 5
    for folder, text in zip(folders[1:], good[1:]):
        found = json.loads((folder / "design.json").read_text())
        assert {key: found[key] for key in ("number", "params", "rms_m")} == {k: json.loads(text)[k] for k in ("number", "params", "rms_m")}
    assert all(readable(folder) for folder in folders)


# designs and trials belong together


def _refused(study: Study, out: Path, *says: str, **options: Any) -> None:
    gc.collect()  # connections of the study before are closed now, and not while the folder is compared
    before = {path: path.read_bytes() for path in sorted(out.rglob("*")) if path.is_file() and path.name != ".lock"}
    with pytest.raises(InputError) as caught:
        run_study(study, solve=solve, out=out, **options)
    for part in (f"{out}: holds designs of trials that are not there", "rule: ", "remedy: ", f"--out {out}-2", *says):
        assert part in str(caught.value)
    after = {path: path.read_bytes() for path in sorted(out.rglob("*")) if path.is_file() and path.name != ".lock"}
    assert after == before


def test_a_deleted_or_empty_database_is_not_begun_anew_over_its_designs(tmp_path: Path) -> None:
    study, out = load_study(write_study(tmp_path)), tmp_path / "out"
    run_study(study, solve=solve, out=out, trials=4)
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
    assert run_study(study, solve=solve, out=out, trials=5).trials == 5, "with its trials back, it goes on"


def test_another_database_is_refused_over_the_designs_of_the_first(tmp_path: Path) -> None:
    """It may be new, or contain a study of this name with other trials; naming the first database or moving the folder is accepted."""
    study, out = load_study(write_study(tmp_path)), tmp_path / "out"
    run_study(study, solve=solve, out=out, trials=4)
    new, other = f"sqlite:///{tmp_path}/new.db", f"sqlite:///{tmp_path}/other.db"
    _refused(study, out, "new.db is missing", f"(sqlite:///{out}/study.db when they ended)", storage=new)
    assert not (tmp_path / "new.db").exists()
    seeded = load_study(write_study(tmp_path / "other", STUDY.replace("seed: 3", "seed: 4")))
    run_study(seeded, solve=solve, out=tmp_path / "elsewhere", trials=4, storage=other)
    _refused(seeded, out, "other.db has 4 trials, which are others", storage=other)
    assert run_study(study, solve=solve, out=out, trials=5, storage=f"sqlite:///{out}/study.db").trials == 5
    out.rename(tmp_path / "moved")
    assert run_study(study, solve=solve, out=tmp_path / "moved", trials=6).trials == 6
