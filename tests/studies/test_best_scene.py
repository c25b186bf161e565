"""The best design of a study is a scene file that runs from any folder and reproduces the result of the trial."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rod_solve import SCENE, STUDY, solve, write_study

from magmpm.bodies.surface_mesh import Mesh, write_stl
from magmpm.inputs.csv_tables import write_centreline
from magmpm.inputs.settings import json_schema
from magmpm.results.measures import rms_distance
from magmpm.scene import Scene, load_scene
from magmpm.studies.engine.loop import run_study
from magmpm.studies.engine.report import StudyReport
from magmpm.studies.search.best_scene import PATHS
from magmpm.studies.search.definition import load_study

BOX = Mesh(
    np.array([[x, y, z] for x in (-10.0, 90.0) for y in (-60.0, 60.0) for z in (-60.0, 60.0)]),
    np.array(
        [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    ),
)


def best_of(folder: Path, text: str = STUDY, scene: str = SCENE) -> tuple[StudyReport, Path]:
    """The report of a study and the scene file of its best design."""
    report = run_study(load_study(write_study(folder, text, scene)), solve=solve, out=folder / "out")
    return report, folder / "out/best/scene.yaml"


def same_answer(report: StudyReport, file: Path, monkeypatch: pytest.MonkeyPatch) -> Scene:
    """Reads the scene from another folder and checks that its rod has the same tip as in the trial."""
    monkeypatch.chdir("/")
    scene = load_scene(file.resolve())
    study = load_study(file.parents[2] / "probe.yaml")
    assert rms_distance(solve(scene), study.target) == pytest.approx(report.best["rms_m"], rel=1e-9)  # 15 digits are written
    return scene


def test_magnetisation_found_is_in_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its header describes it; its result equals that of the trial; unmagnetized segments stay unmagnetized."""
    report, file = best_of(tmp_path, scene=SCENE.replace("      - magnetization: [0, 0, 1]\n", "      - {}\n"))
    text = file.read_text()
    assert text.startswith(f"# The best design of the study probe: trial {report.best['number']}, rms ")
    assert "../../scene.yaml" in text.split("\n\n")[0]
    scene = same_answer(report, file, monkeypatch)
    assert [region.magnetization for region in scene.regions()] == [pytest.approx(m, abs=1e-8) for m in report.best["magnetization"]]
    assert scene.regions()[2].magnetization == (0.0, 0.0, 0.0)
    assert scene.name == "probe best", "its results must not replace those of the study's scene"


def test_field_found_is_in_the_file_and_other_sources_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = SCENE.replace("{uniform: [0 mT, 6 mT, 8 mT]}", "{uniform: [0 mT, 6 mT, 8 mT], over_time: {ramp: {duration: 1 s}}}")
    report, file = best_of(tmp_path, STUDY.replace("magnetization: {}", "field: {max: 10 mT}"), scene)
    found = same_answer(report, file, monkeypatch)
    assert found.field.uniform == pytest.approx(report.best["field_T"], rel=1e-9)
    assert found.field.over_time is not None


def test_relative_paths_are_mended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A mesh, the table of a tube, a reference: each is found from the folder of the new file."""
    write_stl(BOX, tmp_path / "vessel.stl")
    s = np.linspace(0, 0.04, 5)
    write_centreline(tmp_path / "known.csv", np.column_stack([s, s, 0 * s, 0 * s]))
    scene = SCENE.replace("{magnetic_torque: {}}", "{magnetic_torque: {}, walls: {surface: {mesh: vessel.stl, unit: mm}}}")
    scene += "solver: {dynamic: {duration: 1 s}}\nreference: {centreline: known.csv}\n"
    report, file = best_of(tmp_path, scene=scene)
    found = same_answer(report, file, monkeypatch)
    assert found.reference is not None
    assert "mesh: ../../vessel.stl" in file.read_text()


def test_every_key_that_names_a_file_is_known() -> None:
    """Every key that is a path in the schema must be among those that are rewritten."""
    named = set()

    def look(part: Any, key: str = "") -> None:
        if isinstance(part, dict):
            if re.search("path,? relative to this file", str(part.get("description", "")), re.IGNORECASE):
                named.add(key)
            for name, item in part.items():
                look(item, name)
        elif isinstance(part, list):
            for item in part:
                look(item, key)

    look(json_schema(Scene))
    assert named == PATHS


def test_a_later_better_trial_takes_its_place(tmp_path: Path) -> None:
    """The file is also written again if it was deleted or changed by a user: it belongs to the study."""
    first, file = best_of(tmp_path, STUDY.replace("trials: 8", "trials: 1"))
    before = file.read_text()
    study = load_study(tmp_path / "probe.yaml")
    more = run_study(study, solve=solve, out=tmp_path / "out", trials=8)
    assert more.best["number"] != first.best["number"]
    assert file.read_text() != before
    good = file.read_text()
    file.unlink()
    run_study(study, solve=solve, out=tmp_path / "out", trials=8)
    assert file.read_text() == good
