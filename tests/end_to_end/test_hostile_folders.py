"""Folders of results from others: links and HDF5 files that would make a command read or write files outside the folder."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from reference import drawn, motions

from magmpm.errors import InputError
from magmpm.results.file_names import MOTION
from magmpm.results.folder_lock import LOCK, folder_lock
from magmpm.results.trajectory import Motion


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A motion of three frames, and beside it a file that nobody may touch."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MAGMPM_RENDER", "matplotlib")
    drawn.written("out", motions.body(), np.linspace(0.0, 0.4, 3), drawn.scene())
    (tmp_path / "precious.txt").write_text("precious")
    return tmp_path / "out"


@pytest.mark.parametrize("name", [LOCK, ".picture.png", "energies.csv", "best/result.json", "study.db", "frames"])
def test_a_link_out_of_the_folder_is_refused(name: str, folder: Path, told: Callable[..., Any]) -> None:
    """The lock alone would empty the file it leads to."""
    precious, link = folder.parent / "precious.txt", folder / name
    link.parent.mkdir(exist_ok=True)
    link.unlink(missing_ok=True)
    link.symlink_to(folder.parent if name == "frames" else precious)
    told("render", folder, status=2, says=(f"{link}: received a link to", "  remedy: remove the link"))
    assert precious.read_text() == "precious"


def test_links_that_lead_nowhere_else_are_followed(folder: Path) -> None:
    """Within the folder; to folders of the user's own, which no command writes; the folder itself."""
    (folder / "first.csv").symlink_to("energies.csv")
    (folder / "data").symlink_to(folder.parent)
    (folder.parent / "link").symlink_to(folder)
    with folder_lock(folder.parent / "link"):
        pass


@pytest.mark.parametrize("kind", ["external link", "external storage", "virtual"])
def test_a_motion_whose_data_are_in_another_file_is_refused(kind: str, folder: Path) -> None:
    """HDF5 would read that file, and resuming would write into it."""
    with h5py.File(folder.parent / "other.h5", "w") as other:
        other["secret"] = np.zeros(3)
    with h5py.File(folder / MOTION, "r+", locking=False) as file:
        of = file["VTKHDF/PointData"]
        if kind == "external link":
            of["x"] = h5py.ExternalLink(str(folder.parent / "other.h5"), "secret")
        elif kind == "external storage":
            of.create_dataset("x", (8,), "u1", external=[(str(folder.parent / "precious.txt"), 0, 8)])
        else:
            layout = h5py.VirtualLayout((3,), "f8")
            layout[:] = h5py.VirtualSource(str(folder.parent / "other.h5"), "secret", (3,))
            of.create_virtual_dataset("x", layout)
    with pytest.raises(InputError, match="data of another file"):
        Motion.load(folder)
