"""The best design of a study is a scene file that runs from any folder and reproduces the result of the trial."""

import re
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rod_solve import SCENE, STUDY, differentiate, solve, write_study

from magmpm.bodies.surface_mesh import Mesh, write_stl
from magmpm.inputs.csv_tables import write_centreline
from magmpm.inputs.settings import json_schema
from magmpm.scene import Scene, load_scene
from magmpm.scene.variables import Variable, variables
from magmpm.studies.engine.loop import run_study
from magmpm.studies.engine.report import StudyReport, best_trial, describe, on_the_brink
from magmpm.studies.problem.shape_distance import gaps, root_mean_square
from magmpm.studies.search.best_scene import PATHS
from magmpm.studies.search.definition import load_study
from magmpm.studies.sheet.facts import describe_body, without_guide
from magmpm.studies.sheet.verified_best import allowed, together, tolerances
from magmpm.viz.sheet.found import alarms

BOX = Mesh(
    np.array([[x, y, z] for x in (-10.0, 90.0) for y in (-60.0, 60.0) for z in (-60.0, 60.0)]),
    np.array(
        [
            [0, 1, 3],
            [0, 3, 2],
            [4, 6, 7],
            [4, 7, 5],
            [0, 4, 5],
            [0, 5, 1],
            [2, 3, 7],
            [2, 7, 6],
            [0, 2, 6],
            [0, 6, 4],
            [1, 5, 7],
            [1, 7, 3],
        ]
    ),
)


def best_of(folder: Path, text: str = STUDY, scene: str = SCENE) -> tuple[StudyReport, Path]:
    """The report of a study and the scene file of its best design."""
    report = run_study(
        load_study(write_study(folder, text, scene)), solve=solve, out=folder / "out"
    )
    return report, folder / "out/best/scene.yaml"


def same_answer(report: StudyReport, file: Path, monkeypatch: pytest.MonkeyPatch) -> Scene:
    """Reads the scene from another folder and checks that its rod has the same tip as in the trial."""
    monkeypatch.chdir("/")
    scene = load_scene(file.resolve())
    study = load_study(file.parents[2] / "probe.yaml")
    assert root_mean_square(gaps(solve(scene).centreline, study.target)) == report.best["rms_m"]
    return scene


def test_magnetisation_found_is_in_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its header describes it; its result equals that of the trial; unmagnetized segments stay unmagnetized."""
    report, file = best_of(
        tmp_path, scene=SCENE.replace("      - magnetization: [0, 0, 1]\n", "      - {}\n")
    )
    text = file.read_text()
    assert text.startswith(
        f"# The best design of the study probe: trial {report.best['number']}, rms "
    )
    assert "../../scene.yaml" in text.split("\n\n")[0]
    scene = same_answer(report, file, monkeypatch)
    assert [region.magnetization for region in scene.regions()] == [
        pytest.approx(m, abs=1e-8) for m in report.best["magnetization"]
    ]
    assert scene.regions()[2].magnetization == (0.0, 0.0, 0.0)
    assert scene.name == "probe best", "its results must not replace those of the study's scene"


def test_field_found_is_in_the_file_and_other_sources_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = SCENE.replace(
        "{uniform: [0 mT, 6 mT, 8 mT]}",
        "{uniform: [0 mT, 6 mT, 8 mT], over_time: {ramp: {duration: 1 s}}}",
    )
    report, file = best_of(
        tmp_path, STUDY.replace("magnetization: {}", "field: {max: 10 mT}"), scene
    )
    found = same_answer(report, file, monkeypatch)
    assert found.field.uniform == pytest.approx(report.best["field_T"], rel=1e-9)
    assert found.field.over_time is not None


def test_relative_paths_are_mended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A mesh, the table of a tube, a reference: each is found from the folder of the new file."""
    write_stl(BOX, tmp_path / "vessel.stl")
    s = np.linspace(0, 0.04, 5)
    write_centreline(tmp_path / "known.csv", np.column_stack([s, s, 0 * s, 0 * s]))
    scene = SCENE.replace(
        "{magnetic_torque: {}}",
        "{magnetic_torque: {}, walls: {surface: {mesh: vessel.stl, unit: mm}}}",
    )
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
            if re.search(
                "path,? relative to this file", str(part.get("description", "")), re.IGNORECASE
            ):
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


# A study whose file names no sampler gets the one that suits what it asks, and keeps the one by which it was begun


UNNAMED = STUDY.replace("sampler: random\n", "")
PLAIN = SCENE.replace("      - magnetization: [0, 1, 0]\n", "      - {}\n")


@pytest.mark.parametrize(
    ("text", "scene", "sampler", "why"),
    [
        (UNNAMED, SCENE, "gauss-newton", "derivatives by all that varies"),
        (
            UNNAMED + "stability: {margin: 0.1}\nrobust: {direction: 5 deg}\n",
            SCENE,
            "gauss-newton",
            "derivatives",
        ),
        (
            UNNAMED.replace("magnetization: {}", "magnetization: {}\n  order: {}"),
            PLAIN,
            "tpe",
            "can't choose an order",
        ),
        (
            UNNAMED.replace("{}", "{}\n  field: {max: 9 mT}") + "minimize: [rms, largest_field]\n",
            SCENE,
            "gauss-newton",
            "ladder of bounds",
        ),
        (UNNAMED, SCENE + "solver: {dynamic: {duration: 0.1 s}}\n", "tpe", "the scene is a motion"),
    ],
)
def test_the_sampler_follows_from_what_the_study_asks(
    text: str, scene: str, sampler: str, why: str, tmp_path: Path
) -> None:
    study = load_study(write_study(tmp_path, text, scene))
    assert study.sampler == sampler
    assert why in str(study.why_sampler)


def test_a_named_sampler_is_taken_without_a_word(tmp_path: Path) -> None:
    study = load_study(write_study(tmp_path, STUDY))
    assert (study.sampler, study.why_sampler) == ("random", None)
    unnamed = load_study(write_study(tmp_path / "unnamed", UNNAMED)).changed(sampler="cmaes")
    assert (unnamed.sampler, unnamed.why_sampler) == ("cmaes", None)


def test_a_study_that_was_begun_goes_on_with_its_sampler(tmp_path: Path) -> None:
    """Files without a sampler meant tpe once: their studies are resumed as what they are."""
    named = write_study(tmp_path, STUDY.replace("random", "tpe"))
    whole = run_study(load_study(named), solve=solve, out=tmp_path / "whole")
    run_study(load_study(named), solve=solve, out=tmp_path / "out", trials=4)
    named.write_text(UNNAMED)
    report = run_study(
        load_study(named), solve=solve, differentiate=differentiate, out=tmp_path / "out"
    )
    assert (report.sampler, report.why_sampler) == ("tpe", "the study was begun with it")
    assert report.rms_m == whole.rms_m


def test_without_derivatives_tpe(tmp_path: Path) -> None:
    report = run_study(
        load_study(write_study(tmp_path, UNNAMED)), solve=solve, out=tmp_path / "out", trials=2
    )
    assert report.sampler == "tpe"
    assert "no derivatives" in str(report.why_sampler)


def test_the_report_says_which_and_why(tmp_path: Path) -> None:
    study = load_study(write_study(tmp_path, UNNAMED))
    report = run_study(
        study, solve=solve, differentiate=differentiate, out=tmp_path / "out", trials=2
    )
    assert report.summary()["why_sampler"] == study.why_sampler


# Which trial is the best one, and what is said where it is on the brink


def trials(*pairs: tuple[float, float | None]) -> Any:
    """Feasible trials by rms (mm) and stability."""
    return [
        SimpleNamespace(
            number=k,
            values=[1e-3 * rms],
            params={},
            user_attrs={"feasible": True, "rms_m": 1e-3 * rms, "stability": stability},
        )
        for k, (rms, stability) in enumerate(pairs)
    ]


@pytest.mark.parametrize(
    ("pairs", "best"),
    [
        ([(0.30, 0.02), (0.32, 0.3), (0.31, 0.2)], 2),  # the nearest that is not on the brink
        ([(0.30, 0.02), (0.34, 0.9)], 0),  # costs 13 %
        ([(0.30, 0.02), (0.32, 0.05), (0.31, 0.04)], 1),  # all on it: the most stable
        (
            [(0.610, 0.065), (0.619, 0.107), (0.621, 0.398)],
            2,
        ),  # of those not on it: 0.3 % of rms for four times the stability
        ([(0.511, 0.078), (0.537, 0.080)], 0),  # all on it: 5 % of rms is too much for so little
        ([(0.30, 0.2), (0.31, 0.9)], 0),  # stable enough: rms decides
        ([(0.30, None), (0.31, 0.9)], 0),  # not known: rms decides
    ],
)
def test_of_nearly_equal_designs_the_stable_one_is_the_best(
    pairs: list[tuple[float, float | None]], best: int
) -> None:
    chosen = best_trial(trials(*pairs))
    assert chosen.number == best


def test_a_design_on_the_brink_is_told_with_its_depth() -> None:
    (trial,) = trials((0.3, 0.011))
    best = {
        **describe(trial),
        "insertion": [{"depth_m": 0.02, "stability": 0.5}, {"depth_m": 0.037, "stability": 0.011}],
    }
    (says,) = on_the_brink(best)
    assert "at 37 mm is 0.011" in says
    assert "nearly unstable" in str(alarms({"best": best, "body": {}, "warnings": [says]}))
    assert not on_the_brink({**best, "stability": 0.2})
    assert not on_the_brink(None)


# A report's sheet of a design: tolerances by their definition, and the body that is to be made


@dataclass
class Known:
    """Derivatives that a test chooses."""

    variables: tuple[Variable, ...]
    tip: np.ndarray


@pytest.fixture
def scene(tmp_path: object) -> Scene:
    return load_scene(write_study(tmp_path).with_name("scene.yaml"))  # type: ignore[arg-type]


def test_a_direction_counts_by_its_worst_turn(scene: Scene) -> None:
    """Two turns that move the tip the same way add as a vector: the worst turn is between them, by the root of two."""
    found = variables(scene, ["magnetization"])[:2]
    (row,) = tolerances(scene, Known(found, np.array([[0.01, 0.01], [0.0, 0.0], [0.0, 0.0]])))
    assert row["unit"] == "deg"
    assert row["tip_m_per_unit"] == pytest.approx(np.deg2rad(1.0) * 0.01 * np.sqrt(2))
    assert allowed(row, 0.4e-3) == pytest.approx(0.4e-3 / row["tip_m_per_unit"])
    assert allowed(row, 1.0) is None  # beyond what the first order says
    assert together([row]) == pytest.approx(np.sqrt(2) * 5 * row["tip_m_per_unit"])


def test_field_and_materials_count_by_their_own_size(scene: Scene) -> None:
    """A tip that follows the field: 1 % of it, and a turn of it; a material by its own value."""
    field = variables(scene, ["field"])
    remanence = variables(scene, ["remanence"])
    rows = tolerances(
        scene, Known((*field, *remanence), np.hstack([np.eye(3), [[0.5], [0.0], [0.0]]]))
    )
    by_name = {(row["what"], row["of"]): row["tip_m_per_unit"] for row in rows}
    assert by_name["strength", "field"] == pytest.approx(
        0.01 * 10e-3
    )  # m per T is one here, and the field 10 mT
    assert by_name["direction", "field"] == pytest.approx(np.deg2rad(1.0) * 10e-3)
    assert by_name["remanence", "magnetic"] == pytest.approx(0.01 * 0.138 * 0.5)


def test_segments_keep_their_numbers_where_the_first_are_in_the_guide(scene: Scene) -> None:
    found = variables(scene, ["magnetization"])[:2]
    (row,) = tolerances(scene, Known(found, np.ones((3, 2))), hidden=2)
    assert row["of"] == "segment 3"
    body = describe_body(scene)
    assert without_guide(body, len(body["segments"])) == body
    cut = without_guide(body, len(body["segments"]) - 1)
    assert [segment["number"] for segment in cut["segments"]] == [1, 2, 3, 4]
    assert cut["segments"][0]["from_m"] == 0.0
    assert cut["length_m"] == pytest.approx(0.032)
