"""A results folder belongs to one study."""

from __future__ import annotations

from pathlib import Path

import pytest
from rod_solve import solve, write_study

from magmpm.errors import InputError
from studies.definition import load_study
from studies.engine import run_study


def test_another_study_is_refused_in_the_same_folder(tmp_path: Path) -> None:
    """Their pictures and improvements would mix; the message names both and says what to do."""
    path = write_study(tmp_path)
    run_study(load_study(path), solve=solve, out=tmp_path / "out", trials=1)
    other = path.with_name("other.yaml")
    other.write_text(path.read_text())
    with pytest.raises(InputError, match="probe") as caught:
        run_study(load_study(other), solve=solve, out=tmp_path / "out", trials=1)
    assert "other" in str(caught.value)
    assert "--out" in str(caught.value)


def test_a_damaged_best_result_is_made_again(tmp_path: Path) -> None:
    """A study that is done repairs what it holds of its best trial."""
    study = load_study(write_study(tmp_path))
    run_study(study, solve=solve, out=tmp_path / "out", trials=2)
    saved = tmp_path / "out/best/result.json"
    good = saved.read_text()
    saved.write_text("{")
    run_study(study, solve=solve, out=tmp_path / "out", trials=2)
    assert saved.read_text() == good
