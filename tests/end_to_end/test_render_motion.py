"""`magmpm render` of a motion: files, messages, exit status."""

from __future__ import annotations

import json
import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from reference import drawn, motions

from magmpm.cli import main
from magmpm.results.trajectory import MotionWriter

SCENE = drawn.scene()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a motion of seven frames, runs/bending; pictures by matplotlib, which needs no OpenGL."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MAGMPM_RENDER", "matplotlib")
    model = motions.body()
    model.scene = SimpleNamespace(to_si=lambda: SCENE, name="bending")
    motions.write(MotionWriter("runs/bending", model), motions.bending(model, np.linspace(0.0, 0.4, 7)))
    return tmp_path / "runs" / "bending"


@pytest.mark.parametrize("kind", ["svg", pytest.param("pdf", marks=pytest.mark.slow)])
def test_pictures_for_papers(folder: Path, kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["render", "runs/bending", "--json", "--frames", "0", "--format", kind]) == 0
    files = json.loads(capsys.readouterr().out)["files"]
    names = ["movie.mp4", *(f"{name}.{kind}" for name in ("frames/frame_0000", "picture", "moments", "energies"))]
    assert files == [f"runs/bending/{name}" for name in names]
    begins = {"svg": b"<?xml", "pdf": b"%PDF-"}[kind]
    assert all(Path(file).read_bytes().startswith(begins) for file in files[1:])
    assert not list(folder.glob("**/*.png"))
    if kind == "svg":
        assert "energy since the start" in (folder / "energies.svg").read_text(encoding="utf-8"), "text as text"


def test_a_motion_gets_a_movie_moments_a_picture_and_its_energies(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """In the motion's folder, or where --out says."""
    assert main(["render", "runs/bending", "--json", "--frames", "0,-1", "--fps", "10", "--out", "elsewhere"]) == 0
    files = json.loads(capsys.readouterr().out)["files"]
    names = ["movie.mp4", "frames/frame_0000.png", "frames/frame_0006.png", "picture.png", "moments.png", "energies.png"]
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
    [(["--frames", "7"], ("--frames", "'7'", "0 to 6")), (["--frames", "first"], ("--frames", "'first'", "all"))],
)
def test_bad_options_end_with_status_2(options: list[str], says: tuple[str, ...], folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["render", "runs/bending", *options]) == 2
    printed = capsys.readouterr()
    assert all(phrase in printed.err for phrase in says), printed.err
    assert not (folder / "movie.mp4").exists()


def test_a_frame_rate_that_is_none_ends_with_status_2(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["render", "runs/bending", "--fps", "0"])
    assert ended.value.code == 2
    assert "1 to 100" in capsys.readouterr().err


def test_a_motion_without_frames_is_said_to_be_one(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    MotionWriter("runs/bending", motions.body())
    assert main(["render", "runs/bending"]) == 2
    assert "no frames yet" in capsys.readouterr().err


def test_an_equilibrium_saved_later_takes_the_motions_place(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "scene.yaml").write_text(
        "name: bending\n"
        "materials: {m: {shear_modulus: 120 kPa, bulk_to_shear: 20, density: 1882 kg/m^3, remanence: 100 mT}}\n"
        "body: {catheter: {length: 20 mm, diameter: 4 mm, material: m, segments: [{magnetization: [1, 0, 0]}]}}\n"
        "field: {uniform: [0 mT, 0 mT, 5 mT]}\neffects: {magnetic_torque: {}}\nresolution: {cells_across: 2}\n"
    )
    before = (folder / "motion.json").stat().st_mtime
    os.utime(folder / "motion.json", (before - 10, before - 10))
    assert main(["run", str(folder / "scene.yaml"), "--out", str(folder), "--overwrite"]) == 0
    capsys.readouterr()
    assert main(["render", str(folder), "--json"]) == 0
    assert [Path(file).name for file in json.loads(capsys.readouterr().out)["files"]] == ["picture.png"]
    assert main(["render", str(folder), "--frames", "all"]) == 2
    assert "dynamic" in capsys.readouterr().err
