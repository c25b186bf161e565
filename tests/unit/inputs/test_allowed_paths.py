"""Paths in files: near ones and allowed ones may be read, others are refused before anything is read."""

import os
import shutil
from pathlib import Path

import pytest

from magmpm import load_scene
from magmpm.cli import main
from magmpm.errors import InputError
from magmpm.inputs.user_files import VARIABLE, allow, is_allowed

ROOT = Path(__file__).resolve().parents[3]
SCENE = (ROOT / "data/scenes/axial_transverse.yaml").read_text(encoding="utf-8")
TABLE = ROOT / "data/references/axial_transverse_5mT.csv"


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project in which the rule holds, and a table elsewhere."""
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "settings"))
    for name in ("project/scenes", "project/references", "elsewhere"):
        (tmp_path / name).mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "project" / "scenes")
    shutil.copy(TABLE, tmp_path / "project/references/known.csv")
    shutil.copy(TABLE, tmp_path / "elsewhere/known.csv")
    return tmp_path / "project"


def scene(project: Path, path: str) -> Path:
    file = project / "scenes" / "scene.yaml"
    file.write_text(SCENE.replace("../references/axial_transverse_5mT.csv", path), encoding="utf-8")
    return file


def test_the_folder_above_is_near(project: Path) -> None:
    assert load_scene(scene(project, "../references/known.csv")).reference is not None


@pytest.mark.parametrize(
    "path",
    [
        "../../elsewhere/known.csv",
        "/etc/passwd",
        "../references/link.csv",
        "../references/.hidden/known.csv",
    ],
)
def test_others_are_refused(project: Path, path: str) -> None:
    """Also those that a link leads to, and hidden ones; the message quotes nothing of the file."""
    (project / "references/link.csv").symlink_to(project.parent / "elsewhere/known.csv")
    (project / "references/.hidden").mkdir()
    shutil.copy(TABLE, project / "references/.hidden/known.csv")
    with pytest.raises(InputError, match="must stay below the folder above it") as refused:
        load_scene(scene(project, path))
    assert "scene.yaml:" in str(refused.value)
    assert "allow-outside" in str(refused.value)
    assert "root:" not in str(refused.value)


def test_what_the_user_allows(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the variable, by --allow-outside, by `magmpm import`, or by standing there."""
    file = scene(project, "../../elsewhere/known.csv")
    other = project.parent / "elsewhere"
    assert not is_allowed(other / "known.csv", file)
    monkeypatch.setenv(VARIABLE, os.pathsep.join(["/nowhere", str(other)]))
    assert is_allowed(other / "known.csv", file)
    monkeypatch.delenv(VARIABLE)
    allow(other)
    allow(other)
    assert is_allowed(other / "known.csv", file)
    assert (project.parent / "settings/magmpm/allowed-folders").read_text(
        encoding="utf-8"
    ) == f"{other}\n"
    monkeypatch.setenv("XDG_CONFIG_HOME", str(project))
    assert not is_allowed(other / "known.csv", file)
    monkeypatch.chdir(other)
    assert is_allowed(other / "known.csv", file)


def test_the_option(
    project: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = scene(project, "../../elsewhere/known.csv")
    assert main(["effects", "--quick", str(file)]) == 2
    assert "rule: a path in a file must stay" in capsys.readouterr().err
    monkeypatch.setenv(VARIABLE, "")  # which the option sets: it is put back after the test
    assert main(["effects", "--quick", "--allow-outside", str(file)]) == 0


def test_shipped_files_are_near_from_anywhere(project: Path) -> None:
    for file in sorted((ROOT / "data").rglob("*.yaml")):
        for folder in ("targets", "references", "measured", "scenes"):
            assert is_allowed(ROOT / "data" / folder / "x", file)
