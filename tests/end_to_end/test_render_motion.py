"""`magmpm render` of a motion: files, messages, exit status."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from PIL import Image
from reference import drawn, motions

from magmpm.errors import InputError
from magmpm.results.file_names import MOTION
from magmpm.results.folder_lock import LOCK, folder_lock
from magmpm.results.trajectory import Motion, MotionWriter


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a motion of seven frames, runs/bending; pictures by matplotlib, which needs no OpenGL."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MAGMPM_RENDER", "matplotlib")
    drawn.written("runs/bending", motions.body(), np.linspace(0.0, 0.4, 7), drawn.scene())
    return tmp_path / "runs" / "bending"


@pytest.mark.parametrize("kind", ["svg", pytest.param("pdf", marks=pytest.mark.slow)])
def test_pictures_for_papers(folder: Path, kind: str, told) -> None:
    files = json.loads(
        told("render", "runs/bending", "--json", "--frames", "0", "--format", kind).out
    )["files"]
    names = [
        "movie.mp4",
        *(f"{name}.{kind}" for name in ("frames/frame_0000", "picture", "moments", "energies")),
    ]
    assert files == [f"runs/bending/{name}" for name in names]
    begins = {"svg": b"<?xml", "pdf": b"%PDF-"}[kind]
    assert all(Path(file).read_bytes().startswith(begins) for file in files[1:])
    assert not list(folder.glob("**/*.png"))
    if kind == "svg":
        assert "energy since the start" in (folder / "energies.svg").read_text(encoding="utf-8"), (
            "text as text"
        )


def test_a_motion_gets_a_movie_moments_a_picture_and_its_energies(folder: Path, told) -> None:
    """In the motion's folder, or where --out says."""
    files = json.loads(
        told(
            "render",
            "runs/bending",
            "--json",
            "--frames",
            "0,-1",
            "--fps",
            "10",
            "--out",
            "elsewhere",
        ).out
    )["files"]
    names = [
        "movie.mp4",
        "frames/frame_0000.png",
        "frames/frame_0006.png",
        "picture.png",
        "moments.png",
        "energies.png",
    ]
    assert files == [f"elsewhere/{name}" for name in names]
    for file in files:
        assert Path(file).stat().st_size > 5000
    with Image.open(files[1]) as first, Image.open(files[3]) as last:
        assert first.size == last.size == (1280, 720)
    # Committed posters must stay small, and such a short movie too.
    assert Path("elsewhere/moments.png").stat().st_size < 300_000
    assert Path("elsewhere/movie.mp4").stat().st_size < 1_048_576
    assert not (folder / "movie.mp4").exists()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--frames", "7"], ("--frames", "'7'", "0 to 6")),
        (["--frames", "first"], ("--frames", "'first'", "all")),
    ],
)
def test_bad_options_end_with_status_2(
    options: list[str], says: tuple[str, ...], folder: Path, told
) -> None:
    told("render", "runs/bending", *options, status=2, says=says)
    assert not (folder / "movie.mp4").exists()


def test_a_frame_rate_that_is_none_ends_with_status_2(
    folder: Path, told, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        told("render", "runs/bending", "--fps", "0")
    assert ended.value.code == 2
    assert "1 to 100" in capsys.readouterr().err


def test_a_motion_without_frames_is_said_to_be_one(folder: Path, told) -> None:
    MotionWriter("runs/bending", motions.body())
    told("render", "runs/bending", status=2, says="no frames yet")


# Folders of results from others: links and HDF5 files that would make a command read or write files outside the folder


@pytest.mark.parametrize(
    "name", [LOCK, ".picture.png", "energies.csv", "best/result.json", "study.db", "frames"]
)
def test_a_link_out_of_the_folder_is_refused(name: str, folder: Path, told) -> None:
    """The lock alone would empty the file it leads to."""
    precious = folder.parent / "precious.txt"
    link = folder / name
    precious.write_text("precious")
    link.parent.mkdir(exist_ok=True)
    link.unlink(missing_ok=True)
    link.symlink_to(folder.parent if name == "frames" else precious)
    told(
        "render",
        folder,
        status=2,
        says=(f"{link}: received a link to", "  remedy: remove the link"),
    )
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
            of.create_dataset(
                "x", (8,), "u1", external=[(str(folder.parent / "precious.txt"), 0, 8)]
            )
        else:
            layout = h5py.VirtualLayout((3,), "f8")
            layout[:] = h5py.VirtualSource(str(folder.parent / "other.h5"), "secret", (3,))
            of.create_virtual_dataset("x", layout)
    with pytest.raises(InputError, match="data of another file"):
        Motion.load(folder)
