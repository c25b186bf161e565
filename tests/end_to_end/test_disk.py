"""Messages about damaged files, and about disks that are full or not writable."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from test_commands import SCENE
from test_motion_resumed import cut_short, emptied

from magmpm.cli import main

Said = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run."""
    folder = tmp_path_factory.mktemp("run")
    (folder / "scene.yaml").write_text(SCENE)
    assert main(["run", str(folder / "scene.yaml"), "--out", str(folder / "out")]) == 0
    return folder / "out"


def _null(path: Path) -> None:
    path.write_text("null")


def _null_inside(path: Path) -> None:
    path.write_text(path.read_text().replace('"converged": true', '"converged": null'))


@pytest.mark.parametrize(
    ("name", "damage"),
    [
        ("state.npz", cut_short), ("state.npz", emptied),
        ("result.json", cut_short), ("result.json", emptied), ("result.json", _null), ("result.json", _null_inside),
    ],
)  # fmt: skip
def test_a_damaged_result_is_refused_by_its_file(
    name: str, damage: Callable[[Path], None], result: Path, tmp_path: Path, capsys: Said
) -> None:
    """`render` refuses it; a new run replaces it."""
    folder = tmp_path / "out"
    shutil.copytree(result, folder)
    damage(folder / name)
    assert main(["render", str(folder)]) == 2
    said = capsys.readouterr().err
    for part in (f"{folder / name}: the saved result can't be read (", "\n  rule: ", "\n  remedy: run the scene again"):
        assert part in said, said
    assert main(["run", str(result.parent / "scene.yaml"), "--out", str(folder)]) == 0


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG])
def test_a_full_disk_names_file_and_remedy(
    number: int, result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Said
) -> None:
    """Status 1, because the input is not wrong; earlier files are kept, and no partial file remains."""
    folder = tmp_path / "out"
    shutil.copytree(result, folder)
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.name != ".lock"}

    def no_room(stream: Any, **_: Any) -> Any:
        stream.write(b"half")
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("magmpm.results.result.np.savez_compressed", no_room)
    assert main(["run", str(result.parent / "scene.yaml"), "--out", str(folder)]) == 1
    said = capsys.readouterr().err
    for part in (f"{folder}/state.npz: {os.strerror(number)}\n  rule: ", "\n  remedy: free room"):
        assert part in said, said
    assert {path.name: path.read_bytes() for path in folder.iterdir() if path.name != ".lock"} == before


@pytest.mark.parametrize("command", [["run", "scene.yaml"], ["render", "out"], ["accuracy", "scene.yaml", "--cells", "2,3"]])
def test_a_read_only_folder_is_refused(
    command: list[str], result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Said
) -> None:
    """Before the computation, with status 2; also if the lock file can be opened, but no other file can be created."""
    shutil.copytree(result, tmp_path / "out")
    shutil.copy(result.parent / "scene.yaml", tmp_path)
    monkeypatch.chdir(tmp_path)
    path_open = Path.open

    def read_only(self: Path, mode: str = "r", *arguments: Any, **options: Any) -> Any:
        if set(mode) & set("wa+"):
            raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(self))
        return path_open(self, mode, *arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", read_only)
        assert main([*command, "--out", "out"]) == 2
    said = capsys.readouterr().err
    assert "out\n  rule: the folder must be writable (Read-only file system)\n  remedy: " in said
    with monkeypatch.context() as patch:
        patch.setattr("magmpm.results.folder_lock.os.access", lambda path, mode: False)
        assert main([*command, "--out", "out"]) == 2
    assert "out\n  rule: the folder must be writable" in capsys.readouterr().err


def test_an_unknown_renderer_is_refused_before_the_run(result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Said) -> None:
    monkeypatch.setenv("MAGMPM_RENDER", "crayons")
    for command in (["run", str(result.parent / "scene.yaml"), "--render", "--out", str(tmp_path / "new")], ["render", str(result)]):
        assert main(command) == 2
        said = capsys.readouterr()
        assert "MAGMPM_RENDER: received crayons\n  rule: must be one of pyvista, matplotlib\n  remedy: " in said.err
        assert said.out == ""
    assert not (tmp_path / "new").exists()
