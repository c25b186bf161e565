"""The commands as a user types them: output, files, exit status."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from reference.commands import scene_text
from small_study import STUDY as SHORT

from magmpm.results.result import Result
from magmpm.rod.cosserat import solve_rod
from magmpm.scene import load_scene

SCENE = scene_text(segments="{magnetization: [1, 0, 0]}, {magnetization: [0, 1, 0]}")
STUDY = (
    SHORT.replace("trials: 2", "trials: 3").replace("seed: 3", "seed: 7")
    + "stop: {rms: 0.001 mm}\n"
)
CONTRACT = {
    "tip",
    "centreline",
    "converged",
    "iterations",
    "particles",
    "dof",
    "min_det_F",
    "max_det_F",
    "seconds",
    "warnings",
}


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


def test_run_prints_one_json_object_as_the_contract_says(folder: Path, told) -> None:
    """`run --json`: every key of the contract, SI, and no other standard output."""
    out = json.loads(told("run", "scene.yaml", "--json").out)
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
    assert Result.load("runs/small").tip.tolist() == out["tip"]


def test_an_unknown_command_is_told_with_the_nearest(told) -> None:
    said = told("rnu", "scene.yaml", status=2).err
    assert said.startswith("magmpm: rnu: unknown command\n  rule: the commands are run, sweep, ")
    assert said.endswith("\n  remedy: try: magmpm run\n")
    assert told("xyz", status=2).err.endswith("\n  remedy: try: magmpm --help\n")


def test_a_storage_is_looked_at_before_kernels_are_compiled(folder: Path) -> None:
    env = {
        **os.environ,
        "XDG_CACHE_HOME": str(folder / "no kernels"),
        "MAGMPM_STORAGE": "mysql://me:secret@host/trials",
    }
    done = subprocess.run(
        [sys.executable, "-m", "magmpm", "design", "study.yaml"],
        env=env,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, list(folder.rglob("*.nbc")), "secret" in done.stderr) == (2, [], False)
    assert "\n  remedy: pip install mysqlclient" in done.stderr


def test_run_for_people_names_the_folder_and_the_section_error(folder: Path, told) -> None:
    """The printed report gives the folder of the result and the errors of the section."""
    text = told("run", "scene.yaml", "--out", "here", "--render").out
    assert "saved in        here" in text
    assert "section area and second moment exact to" in text
    assert (folder / "here/picture.png").stat().st_size > 5_000  # a blank page is smaller


def test_design_resumes_and_draws(folder: Path, told) -> None:
    """The first command runs the trials; the second finds them finished; further trials continue from there. Pictures name the study."""
    first = json.loads(told("design", "study.yaml", "--json").out)
    assert set(first) >= {
        "trials",
        "best",
        "first_trial_below_stop",
        "seconds_per_trial",
        "storage",
    }
    assert set(first["best"]) >= {"number", "rms_m", "params"}
    assert first["trials"] == 3
    assert first["first_trial_below_stop"] is None
    for name in ("best.png", "convergence.png", "best/result.json", "pictures/trial_002.png"):
        assert (folder / "runs/study" / name).exists(), name
    assert list((folder / "runs/study").glob("best_shapes.*"))
    assert {
        **json.loads((folder / "runs/study/study.json").read_text()),
        "files": first["files"],
    } == first
    assert (
        json.loads(told("design", "study.yaml", "--json", "--no-pictures").out)["rms_m"]
        == first["rms_m"]
    )
    more = json.loads(told("design", "study.yaml", "--json", "--trials", "4", "--no-pictures").out)
    assert more["rms_m"][:3] == first["rms_m"]
    assert more["trials"] == 4


def test_design_says_the_field_it_found_and_its_best_scene_runs(folder: Path, told) -> None:
    """Text and JSON contain the field; `best/scene.yaml` reproduces the result; at `stop` the message says so, and how to continue."""
    study = STUDY.replace(
        "{magnetization: {}}", "{magnetization: {}, field: {max: 10 mT}}"
    ).replace("0.001 mm", "1 m")
    (folder / "study.yaml").write_text(study)
    assert (
        "stopped after trial 0, because its rms is within `stop`, 1000 mm"
        in told("design", "study.yaml", "--no-pictures").out
    )
    found = json.loads(told("design", "study.yaml", "--json", "--trials", "2", "--no-pictures").out)
    assert found["trials"] == 2, "asked for, and so done past `stop`"
    text = told("design", "study.yaml", "--no-pictures").out
    assert "seconds per trial" in text
    assert "picture" not in text
    field = 1e3 * np.array(found["best"]["field_T"])
    assert (
        f"field          [{', '.join(f'{x:+.4f}' for x in field)}] mT, magnitude"
        f" {np.linalg.norm(field):.4g} mT" in text
    )
    assert "magmpm run runs/study/best/scene.yaml --render" in text
    tip = json.loads(told("run", "runs/study/best/scene.yaml", "--json").out)["tip"]
    kept = Result.load("runs/study/best").tip
    assert tip == pytest.approx(kept.tolist(), abs=1e-9)  # a solve ends at 1e-11 of the energy


def test_render_draws_a_saved_study_and_a_saved_run(folder: Path, told) -> None:
    """`render` needs only the folder."""
    told("run", "scene.yaml")
    assert [
        Path(file).name for file in json.loads(told("render", "runs/small", "--json").out)["files"]
    ] == ["picture.png"]
    told("render", "runs/small", "--frames", "all", status=2, says="dynamic")
    told("design", "study.yaml", "--no-pictures")
    assert not (folder / "runs/study/best.png").exists()
    files = json.loads(told("render", "runs/study", "--out", "drawn", "--json").out)["files"]
    assert {Path(f).name for f in files} >= {"best.png", "convergence.png"}
    assert all(Path(f).exists() for f in files)
    told("render", "runs/study", "--out", "paper", "--format", "pdf")
    assert {path.name for path in (folder / "paper").glob("*.pdf")} == {
        "best.pdf",
        "convergence.pdf",
    }


def test_accuracy_leaves_table_and_picture(folder: Path, told) -> None:
    """Table, CSV, JSON, picture; errors fall with the cell size."""
    out = json.loads(told("accuracy", "scene.yaml", "--cells", "2,3,4", "--json").out)
    errors = [rung["error_finest"] for rung in out["rungs"]]
    assert errors[-1] is None
    assert errors[0] > errors[1] > 0
    for name in ("accuracy.csv", "accuracy.json", "accuracy.png"):
        assert (folder / "runs/small" / name).exists(), name
    told("accuracy", "scene.yaml", "--cells", "2,3", "--format", "svg")
    assert "<text" in (folder / "runs/small/accuracy.svg").read_text(encoding="utf-8"), (
        "text as text"
    )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run", "missing.yaml"], ["missing.yaml"]),
        (["render", "nowhere"], ["nowhere", "holds no saved result"]),
        (["dashboard", "nowhere"], ["nowhere", "holds no study"]),
        (["accuracy", "scene.yaml", "--cells", "4"], ["at least two"]),
        (["accuracy", "scene.yaml", "--cells", "4,x"], ["4,x", "whole numbers"]),
        (["accuracy", "scene.yaml", "--cells", "4,99"], ["cells_across", "99"]),
        (["run", "scene.yaml", "--out", "target.csv"], ["--out", "target.csv"]),
        (["accuracy", "scene.yaml", "--out", "target.csv/x"], ["--out", "target.csv/x"]),
    ],
)
def test_wrong_arguments_end_with_status_2(
    folder: Path, told, arguments: list[str], words: list[str]
) -> None:
    """Errors of a command line are reported in terms of that command line."""
    assert "Traceback" not in told(*arguments, status=2, says=tuple(words)).err


def test_a_run_that_bears_no_load_keeps_the_unloaded_body(folder: Path, told) -> None:
    """A ramp whose first step fails: the last good state is the undeformed body, marked as not converged."""
    (folder / "scene.yaml").write_text(SCENE + "solver: {static: {max_steps: 1}}\n")
    remedy = "; to try: solver.static: {field_steps: 40, max_steps: 150}"
    says = (
        "of the load: no equilibrium within 1 Newton steps",
        remedy,
        "; the last good state is in none",
    )
    told("run", "scene.yaml", "--out", "none", status=3, says=says)
    kept = Result.load("none")
    assert not kept.converged
    assert np.array_equal(kept.particle_position, kept.particle_reference)


def test_a_process_of_its_own(folder: Path) -> None:
    """The installed command and `python -m magmpm.cli` both work; a closed pipe gives no traceback."""
    done = subprocess.run(
        [sys.executable, "-m", "magmpm.cli", "--help"],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ},
    )
    for word in ("run", "design", "accuracy", "render", "data/scenes/five_segments.yaml"):
        assert word in done.stdout


def test_style_chooses_how_a_body_at_rest_is_drawn(folder: Path, told) -> None:
    """A surface by default, or particles; for a motion the option is refused before the run."""
    from PIL import Image

    told("run", "scene.yaml", "--render")
    with Image.open("runs/small/picture.png") as picture:
        surface = picture.size
    told("render", "runs/small", "--style", "particles")
    with Image.open("runs/small/picture.png") as picture:
        assert picture.size != surface, "the page of particles has views from the top and the side"
    (folder / "moving.yaml").write_text(
        SCENE.replace("small", "moving") + "solver: {dynamic: {duration: 1 ms}}\n"
    )
    told(
        "run",
        "moving.yaml",
        "--render",
        "--style",
        "particles",
        status=2,
        says="--style: received particles",
    )
    assert not (folder / "runs/moving").exists()
