"""Messages about damaged files, and about disks that are full or not writable."""

import errno
import json
import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reference.damage import cut_short, emptied, null
from test_commands import SCENE

from magmpm.cli import main
from magmpm.errors import SolveError
from magmpm.results import measures
from magmpm.results.result import Result
from magmpm.scene import load_scene
from magmpm.simulate import run


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run."""
    folder = tmp_path_factory.mktemp("run")
    (folder / "scene.yaml").write_text(SCENE)
    assert main(["run", str(folder / "scene.yaml"), "--out", str(folder / "out")]) == 0
    return folder / "out"


def _null_inside(path: Path) -> None:
    path.write_text(path.read_text().replace('"converged": true', '"converged": null'))


@pytest.mark.parametrize(
    ("name", "damage"),
    [
        ("state.npz", cut_short),
        ("state.npz", emptied),
        ("result.json", cut_short),
        ("result.json", emptied),
        ("result.json", null),
        ("result.json", _null_inside),
    ],
)
def test_a_damaged_result_is_refused_by_its_file(name, damage, result, tmp_path, told) -> None:
    """`render` refuses it; a new run replaces it."""
    folder = tmp_path / "out"
    shutil.copytree(result, folder)
    damage(folder / name)
    says = (
        f"{folder / name}: the saved result can't be read (",
        "\n  rule: ",
        "\n  remedy: run the scene again",
    )
    told("render", folder, status=2, says=says)
    told("run", result.parent / "scene.yaml", "--out", folder)


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG])
def test_a_full_disk_names_file_and_remedy(
    number: int, result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, told
) -> None:
    """Status 1, because the input is not wrong; earlier files are kept, and no partial file remains."""
    folder = tmp_path / "out"
    shutil.copytree(result, folder)
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.name != ".lock"}

    def no_room(stream: Any, **_: Any) -> Any:
        stream.write(b"half")
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("magmpm.results.result.np.savez_compressed", no_room)
    says = f"{folder}/state.npz: {os.strerror(number)}\n  rule: ", "\n  remedy: free disk space"
    told("run", result.parent / "scene.yaml", "--out", folder, status=1, says=says)
    assert {
        path.name: path.read_bytes() for path in folder.iterdir() if path.name != ".lock"
    } == before


@pytest.mark.parametrize(
    "command",
    [["run", "scene.yaml"], ["render", "out"], ["accuracy", "scene.yaml", "--cells", "2,3"]],
)
def test_a_read_only_folder_is_refused(command, result, tmp_path, monkeypatch, told) -> None:
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
        says = "out\n  rule: the folder must be writable (Read-only file system)\n  remedy: "
        told(*command, "--out", "out", status=2, says=says)
    with monkeypatch.context() as patch:
        patch.setattr("magmpm.results.folder_lock.os.access", lambda path, mode: False)
        told(*command, "--out", "out", status=2, says="out\n  rule: the folder must be writable")


def test_an_unknown_renderer_is_refused_before_the_run(
    result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, told
) -> None:
    monkeypatch.setenv("MAGMPM_RENDER", "crayons")
    says = "MAGMPM_RENDER: received crayons\n  rule: must be one of pyvista, matplotlib\n  remedy: "
    for command in (
        ["run", result.parent / "scene.yaml", "--render", "--out", tmp_path / "new"],
        ["render", result],
    ):
        assert told(*command, status=2, says=says).out == ""
    assert not (tmp_path / "new").exists()


# No result file contains a NaN or an infinity: a run that ends with one has failed, and says where


ROOT = Path(__file__).parents[2]
HOLLOW = ROOT / "data/scenes/hollow.yaml"


@pytest.fixture(scope="module")
def good() -> Result:
    return run(load_scene(HOLLOW).with_cells(2))


@pytest.mark.parametrize(
    "broken", ["tip", "stable_steps", "energy", "particle_position", "section"]
)
def test_what_is_not_finite_is_named_and_not_saved(
    broken: str, good: Result, tmp_path: Path
) -> None:
    values = {
        "tip": np.array([0.0, np.nan, 0.0]),
        "stable_steps": {"wave": np.inf},
        "energy": np.nan,
        "particle_position": np.full_like(good.particle_position, -np.inf),
        "section": {"area_error": np.nan},
    }
    assert good.not_finite() == []
    bad = replace(good, **{broken: values[broken]})
    assert bad.not_finite() == [broken]
    with pytest.raises(ValueError, match=broken):
        bad.save(tmp_path / "out")
    assert not list((tmp_path / "out").glob("*.json"))


def test_a_run_that_ends_in_nan_ends_with_status_3(tmp_path, capsys, monkeypatch) -> None:
    """As for means over a segment without particles: no result is written, and the reason names the value that is not finite."""
    scene = tmp_path / "scene.yaml"
    scene.write_text(
        HOLLOW.read_text(encoding="utf-8").replace("cells_across: 4", "cells_across: 2"),
        encoding="utf-8",
    )
    monkeypatch.setattr(measures, "region_means", lambda model, values: np.full((1, 3), np.nan))
    assert main(["run", str(scene), "--out", str(tmp_path / "out"), "--json"]) == 3
    printed = capsys.readouterr()
    assert "not finite (in segment_center, segment_remanence)" in printed.err
    assert "remedy: " in printed.err
    assert not (tmp_path / "out" / "result.json").exists()
    if printed.out:
        json.loads(printed.out, parse_constant=lambda text: pytest.fail(f"{text} is no JSON"))
    with pytest.raises(SolveError, match="not finite"):
        run(load_scene(scene))
