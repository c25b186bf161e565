"""The commands as a user types them: output, files, exit status."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import bad_scene
import bad_scenes
import numpy as np
import pytest

from magmpm.cli import main
from magmpm.results.result import Result
from magmpm.rod.cosserat import solve_rod
from magmpm.scene import load_scene

ROOT = Path(__file__).parents[2]
SCENE = """\
name: small
materials:
  magnetic: {shear_modulus: 120 kPa, bulk_to_shear: 20, density: 1882 kg/m^3, remanence: 100 mT}
body:
  catheter:
    length: 20 mm
    diameter: 4 mm
    material: magnetic
    segments: [{magnetization: [1, 0, 0]}, {magnetization: [0, 1, 0]}]
field: {uniform: [0 mT, 0 mT, 5 mT]}
effects: {magnetic_torque: {}}
resolution: {cells_across: 2}
"""
STUDY = """\
scene: scene.yaml
vary: {magnetization: {}}
match: {centreline: target.csv}
trials: 3
sampler: random
seed: 7
stop: {rms: 0.001 mm}
"""
CONTRACT = {"tip", "centreline", "converged", "iterations", "particles", "dof", "min_det_F", "max_det_F", "seconds", "warnings"}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with a scene, a study and its target; pictures by matplotlib, which needs no OpenGL."""
    (tmp_path / "scene.yaml").write_text(SCENE)
    (tmp_path / "study.yaml").write_text(STUDY)
    rows = ["s_mm,x_mm,y_mm,z_mm", *(f"{s},{s},0,{0.01 * s * s}" for s in range(0, 21, 4))]
    (tmp_path / "target.csv").write_text("\n".join(rows) + "\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MAGMPM_RENDER", "matplotlib")
    return tmp_path


def test_run_prints_one_json_object_as_the_contract_says(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`run --json`: every key of the contract, SI, and no other standard output."""
    assert main(["run", "scene.yaml", "--json"]) == 0
    out = json.loads(capsys.readouterr().out)
    assert set(out) >= CONTRACT
    assert set(out["seconds"]) == {"setup", "compile", "solve"}
    assert len(out["tip"]) == 3
    assert np.shape(out["centreline"])[1] == 4
    assert out["converged"] is True
    rod = solve_rod(load_scene("scene.yaml")).position[-1]
    assert np.linalg.norm(rod - [0.02, 0, 0]) > 8e-4  # it bends,
    assert (
        np.linalg.norm(rod - out["tip"]) < 0.01 * 0.02
    )  # and in meters: the rod is accurate to 1 % of the length
    saved = Result.load("runs/small")
    assert saved.tip.tolist() == out["tip"]


def test_run_for_people_names_the_folder_and_the_section_error(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The printed report gives the folder of the result and the errors of the section."""
    assert main(["run", "scene.yaml", "--out", "here", "--render"]) == 0
    text = capsys.readouterr().out
    assert "saved in        here" in text
    assert "section area and second moment exact to" in text
    assert (folder / "here/picture.png").stat().st_size > 5_000  # a blank page is smaller


def test_design_resumes_and_draws(folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """The first command runs the trials; the second finds them finished; further trials continue from there. Pictures name the study."""
    assert main(["design", "study.yaml", "--json"]) == 0
    first = json.loads(capsys.readouterr().out)
    assert set(first) >= {"trials", "best", "first_trial_below_stop", "seconds_per_trial", "storage"}
    assert set(first["best"]) >= {"number", "rms_m", "params"}
    assert first["trials"] == 3
    assert first["first_trial_below_stop"] is None
    for name in ("best.png", "convergence.png", "best/result.json", "pictures/trial_002.png"):
        assert (folder / "runs/study" / name).exists(), name
    assert list((folder / "runs/study").glob("best_shapes.*"))

    assert main(["design", "study.yaml", "--json", "--no-pictures"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert again["rms_m"] == first["rms_m"]

    assert main(["design", "study.yaml", "--json", "--trials", "4", "--no-pictures"]) == 0
    more = json.loads(capsys.readouterr().out)
    assert more["rms_m"][:3] == first["rms_m"]
    assert more["trials"] == 4


def test_design_says_the_field_it_found_and_its_best_scene_runs(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Text and JSON contain the field; `best/scene.yaml` reproduces the result; at `stop` the message says so, and how to continue."""
    study = STUDY.replace("{magnetization: {}}", "{magnetization: {}, field: {max: 10 mT}}").replace("0.001 mm", "1 m")
    (folder / "study.yaml").write_text(study)
    assert main(["design", "study.yaml", "--no-pictures"]) == 0
    text = capsys.readouterr().out
    assert "stopped after trial 0, because its rms is within `stop`, 1000 mm" in text
    assert main(["design", "study.yaml", "--json", "--trials", "2", "--no-pictures"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["trials"] == 2, "asked for, and so done past `stop`"
    assert main(["design", "study.yaml", "--no-pictures"]) == 0
    text = capsys.readouterr().out
    field = 1e3 * np.array(found["best"]["field_T"])
    assert f"field          [{', '.join(f'{x:+.4f}' for x in field)}] mT, {np.linalg.norm(field):.4g} mT in all" in text
    assert "magmpm run runs/study/best/scene.yaml --render" in text
    assert main(["run", "runs/study/best/scene.yaml", "--json"]) == 0
    tip = json.loads(capsys.readouterr().out)["tip"]
    kept = Result.load("runs/study/best").tip
    assert tip == pytest.approx(kept.tolist(), abs=1e-9)  # a solve ends at 1e-11 of the energy


def test_render_draws_a_saved_study_and_a_saved_run(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`render` needs only the folder."""
    assert main(["run", "scene.yaml"]) == 0
    assert main(["render", "runs/small"]) == 0
    assert (folder / "runs/small/picture.png").exists()
    assert main(["design", "study.yaml", "--no-pictures"]) == 0
    assert not (folder / "runs/study/best.png").exists()
    capsys.readouterr()
    assert main(["render", "runs/study", "--out", "drawn", "--json"]) == 0
    files = json.loads(capsys.readouterr().out)["files"]
    assert {Path(f).name for f in files} >= {"best.png", "convergence.png"}
    assert all(Path(f).exists() for f in files)
    assert main(["render", "runs/study", "--out", "paper", "--format", "pdf"]) == 0
    assert {path.name for path in (folder / "paper").glob("*.pdf")} == {"best.pdf", "convergence.pdf"}


def test_accuracy_leaves_table_and_picture(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Table, CSV, JSON, picture; errors fall with the cell size."""
    assert main(["accuracy", "scene.yaml", "--cells", "2,3,4", "--json"]) == 0
    out = json.loads(capsys.readouterr().out)
    errors = [rung["error_finest"] for rung in out["rungs"]]
    assert errors[-1] is None
    assert errors[0] > errors[1] > 0
    for name in ("accuracy.csv", "accuracy.json", "accuracy.png"):
        assert (folder / "runs/small" / name).exists(), name
    assert main(["accuracy", "scene.yaml", "--cells", "2,3", "--format", "svg"]) == 0
    assert "<text" in (folder / "runs/small/accuracy.svg").read_text(encoding="utf-8"), "text as text"


def test_every_broken_scene_ends_with_status_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """For the command too: message on standard error, no standard output, no traceback, no run."""
    for number, case in enumerate(bad_scenes.CASES):
        here = tmp_path / str(number)
        here.mkdir()
        path = bad_scene.write(case, here)
        assert main(["run", str(path), "--json", "--out", str(here / "out")]) == 2, case
        captured = capsys.readouterr()
        assert captured.out == ""
        for phrase in bad_scene.expected(case, path):
            assert phrase in captured.err, case
        assert not (here / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run", "missing.yaml"], ["missing.yaml"]),
        (["render", "nowhere"], ["nowhere", "holds no saved result"]),
        (["dashboard", "nowhere"], ["nowhere", "holds no study"]),
        (["accuracy", "scene.yaml", "--cells", "4"], ["at least two"]),
        (["accuracy", "scene.yaml", "--cells", "4,x"], ["4,x", "whole numbers"]),
        (["accuracy", "scene.yaml", "--cells", "4,99"], ["cells_across", "99"]),
        (["design", "study.yaml", "--sampler", "tpee"], ["tpee", "tpe"]),
        (["design", "study.yaml", "--trials", "0"], ["0"]),
        (["run", "scene.yaml", "--out", "target.csv"], ["--out", "target.csv"]),
        (["accuracy", "scene.yaml", "--out", "target.csv/x"], ["--out", "target.csv/x"]),
    ],
)
def test_wrong_arguments_end_with_status_2(
    folder: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: list[str]
) -> None:
    """Errors of a command line are reported in terms of that command line."""
    assert main(arguments) == 2
    message = capsys.readouterr().err
    for word in words:
        assert word in message
    assert "Traceback" not in message


def test_a_run_that_bears_no_load_keeps_the_unloaded_body(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A ramp whose first step fails: the last good state is the undeformed body, marked as not converged."""
    (folder / "scene.yaml").write_text(SCENE + "solver: {static: {max_steps: 1}}\n")
    assert main(["run", "scene.yaml", "--out", "none"]) == 3
    said = capsys.readouterr().err
    assert "of the load: no equilibrium within 1 Newton steps" in said
    assert "; to try: solver.static: {field_steps: 40, max_steps: 150}" in said
    assert "; the last good state is in none" in said
    kept = Result.load("none")
    assert not kept.converged
    assert np.array_equal(kept.particle_position, kept.particle_reference)


def test_a_process_of_its_own(folder: Path) -> None:
    """The installed command and `python -m magmpm.cli` both work; a closed pipe gives no traceback."""
    done = subprocess.run([sys.executable, "-m", "magmpm.cli", "--help"], capture_output=True, text=True, check=True, env={**os.environ})
    for word in ("run", "design", "accuracy", "render", "data/scenes/five_segments.yaml"):
        assert word in done.stdout


def test_style_chooses_how_a_body_at_rest_is_drawn(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A surface by default, or particles; for a motion the option is refused before the run."""
    from PIL import Image

    assert main(["run", "scene.yaml", "--render"]) == 0
    with Image.open("runs/small/picture.png") as picture:
        surface = picture.size
    assert main(["render", "runs/small", "--style", "particles"]) == 0
    with Image.open("runs/small/picture.png") as picture:
        assert picture.size != surface, "the page of particles has views from the top and the side"
    (folder / "moving.yaml").write_text(SCENE.replace("small", "moving") + "solver: {dynamic: {duration: 1 ms}}\n")
    capsys.readouterr()
    assert main(["run", "moving.yaml", "--render", "--style", "particles"]) == 2
    assert "--style: received particles" in capsys.readouterr().err
    assert not (folder / "runs/moving").exists()
