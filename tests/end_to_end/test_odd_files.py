"""A pipe, a device, a folder or a huge file instead of a scene, mesh, table or study is refused at once."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import bad_studies
import pytest
from test_bad_bodies import PARTS
from test_commands import SCENE
from test_import import robot_file

from magmpm.cli import main

PATIENCE = 30  # s for a command that takes one; without the check it waits forever, or fills the memory


@pytest.fixture
def _impatient() -> Iterator[None]:
    """Ends a test that hangs."""

    def end(number: int, frame: object) -> None:
        raise TimeoutError(f"no answer in {PATIENCE} s")

    before = signal.signal(signal.SIGALRM, end)
    signal.alarm(PATIENCE)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def odd(kind: str, path: Path) -> str:
    """Put something odd in place of a file; returns its name in the message."""
    path.unlink(missing_ok=True)
    if kind == "pipe":
        os.mkfifo(path)
        return "a named pipe (FIFO)"
    if kind == "device":
        path.symlink_to("/dev/zero")
        return "a device"
    if kind == "folder":
        path.mkdir()
        return "a folder"
    with path.open("wb") as stream:
        stream.truncate(10**9)  # a sparse file, which would fill the memory
    return f"received {10**9} bytes"


@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "huge"])
@pytest.mark.parametrize("place", ["scene", "mesh", "reference", "study", "target", "robot", "segment"])
@pytest.mark.usefixtures("_impatient")
def test_what_is_no_usable_file_is_refused_at_once(
    place: str, kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    if place == "scene":
        path = tmp_path / "scene.yaml"
        command = ["run", "scene.yaml"]
    elif place == "mesh":
        path = tmp_path / "base.stl"
        (tmp_path / "scene.yaml").write_text(PARTS)
        command = ["run", "scene.yaml"]
    elif place == "reference":
        path = tmp_path / "reference.csv"
        (tmp_path / "scene.yaml").write_text(SCENE + "reference: {centreline: reference.csv}\n")
        command = ["run", "scene.yaml"]
    elif place in ("study", "target"):
        for name, text in bad_studies.FILES.items():
            (tmp_path / name).write_text(text)
        path = tmp_path / {"study": "study.yaml", "target": "target.csv"}[place]
        command = ["design", "study.yaml"]
    else:
        robot = robot_file(tmp_path)
        path = robot if place == "robot" else tmp_path / "meshes" / "tip.STL"
        command = ["import", str(robot), "-o", "imported.yaml"]
    what = odd(kind, path)
    assert main(command) == 2
    said = capsys.readouterr().err
    assert path.name in said
    assert what in said or (place == "segment" and "the file must be in" in said)
    assert "rule: " in said
    assert not (tmp_path / "runs").exists()
