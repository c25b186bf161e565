"""Every command distinguishes the folder of a study from that of a run, and none writes into a folder of another kind."""

from __future__ import annotations

from pathlib import Path

import pytest
from test_commands import SCENE
from test_run_folders import _inside  # noqa: F401

from magmpm.cli import main
from magmpm.studies.problem.file_names import OWNER, REPORT

Said = pytest.CaptureFixture[str]


def folder_with(name: str, content: str = "{}", *, folder: str = "runs/small") -> Path:
    """A folder with one file."""
    path = Path(folder)
    path.mkdir(parents=True, exist_ok=True)
    (path / name).write_text(content, encoding="utf-8")
    return path


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("kept", [REPORT, OWNER])
@pytest.mark.parametrize("out", [[], ["--out", "runs/small"]])
def test_accuracy_refuses_a_studys_folder(kept: str, out: list[str], capsys: Said) -> None:
    """Before it computes: its mark would make it the folder of a run, and the study could not continue."""
    Path("scene.yaml").write_text(SCENE)
    folder = folder_with(kept)
    assert main(["accuracy", "scene.yaml", "--cells", "2,3", *out]) == 2
    assert "runs/small: holds a study" in capsys.readouterr().err
    assert names(folder) == [kept]
