"""Reasons that a study gives for a target that it can't reach: curvature, the field's bound, directions without effect, other starts."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rod_solve import SCENE, STUDY, differentiate, solve, write_study
from test_rod_starts import scene_of

from magmpm.compiled.arrays import Array
from magmpm.inputs.csv_tables import write_centreline
from magmpm.rod.cosserat import solve_rod
from magmpm.scene import Scene
from magmpm.studies.engine.explain_miss import reachable_curvature, target_bends
from magmpm.studies.engine.loop import run_study
from magmpm.studies.engine.report import StudyReport
from magmpm.studies.search.definition import load_study

S = np.linspace(0.0, 0.04, 21)
NEWTON = STUDY.replace("sampler: random", "sampler: gauss-newton") + "stop: {rms: 0.1 mm}\n"
FIELD = NEWTON.replace("magnetization: {}", "magnetization: {}\n  field: {max: 1 mT}")


def study_of(folder: Path, target: Array, text: str = NEWTON, scene: str = SCENE, **options: Any) -> StudyReport:
    path = write_study(folder, text, scene)
    write_centreline(folder / "target.csv", target)
    return run_study(load_study(path), solve=solve, differentiate=differentiate, out=folder / "out", **options)


def shape(scene: Scene) -> Array:
    return np.column_stack([S, solve_rod(scene, 20).at(S)])


def arc(angle: float) -> Array:
    """A circular arc that turns by an angle, rad."""
    k = angle / 0.04
    return np.column_stack([S, np.sin(k * S) / k, (1 - np.cos(k * S)) / k, 0 * S])


def said(report: StudyReport) -> dict[str, Any]:
    return {one["what"]: one for one in report.limits}


def test_a_target_that_is_reached_needs_no_explanation(tmp_path: Path) -> None:
    target = shape(scene_of(tmp_path).with_magnetizations(np.random.default_rng(1).normal(size=(5, 3))))
    report = study_of(tmp_path, target)
    assert report.ended == "stop"
    assert report.limits == []


def test_a_field_at_its_bound_is_said_with_what_more_would_bring(tmp_path: Path) -> None:
    """A shape made in 8 mT, searched in 1: the multiplier foretells what a bound 0.05 mT higher brings."""
    scene = scene_of(tmp_path).with_magnetizations(np.eye(3)[[1, 1, 1, 1, 1]]).with_field([-3e-3, 0, 7.4e-3])
    report = study_of(tmp_path / "a", shape(scene), FIELD)
    found = said(report)
    assert found["field"]["bound_T"] == 1e-3
    assert found["field"]["rms_per_T"] < 0
    assert "field_mT is at its bound, 1 mT" in found["field"]["says"]
    stronger = found["stronger field"]
    assert stronger["field_T"][0] == 1e-3
    assert stronger["rms_m"][-1] <= 1e-4, "in some stronger field the rod reaches it"
    more = study_of(tmp_path / "b", shape(scene), FIELD.replace("max: 1 mT", "max: 1.05 mT"))
    gained = report.best["rms_m"] - more.best["rms_m"]
    assert gained == pytest.approx(-0.05e-3 * found["field"]["rms_per_T"], rel=0.3)  # second order, and where descents stop


def test_curvature_beyond_the_segments_is_said_with_its_place(tmp_path: Path) -> None:
    """An arc of 270 degrees: the tip can't bend, because nothing is beyond it."""
    found = said(study_of(tmp_path, arc(1.5 * np.pi)))["curvature"]
    assert found["target_per_m"] == pytest.approx(1.5 * np.pi / 0.04, rel=1e-2)
    assert found["reachable_per_m"] < found["target_per_m"]
    assert 0 <= found["s_m"][0] < found["s_m"][1] <= 0.04
    assert "bends with a radius of 8.49 mm" in found["says"]


def test_no_rod_bends_more_than_is_said_to_be_reachable(tmp_path: Path, rng: np.random.Generator) -> None:
    scene = scene_of(tmp_path)
    for gravity in (None, {}):
        s, most = reachable_curvature(scene.with_effects(gravity=gravity), None)
        for _ in range(20):
            rod = solve_rod(scene.with_effects(gravity=gravity).with_magnetizations(rng.normal(size=(5, 3))))
            bends = np.linalg.norm(rod.curvature[:, 1:], axis=1)
            # frames average the elements beside them; the bound falls toward the tip
            assert (bends[1:-1] <= np.interp(rod.s[1:-1], s, most) * (1 + 1e-6) + most[-1]).all()
    across = scene.with_magnetizations(np.tile([0, 0.8, -0.6], (5, 1))).with_field([1e-3, 0, 0])
    s, most = reachable_curvature(across, None)  # across the axis and the field, and hardly bent: the torque is all that it can be
    assert np.linalg.norm(solve_rod(across).curvature[0, 1:]) > 0.95 * most[0]


def test_bends_of_a_circle_are_one_over_its_radius() -> None:
    ends, bends = target_bends(arc(1.0), 0.002)
    np.testing.assert_allclose(bends, 1.0 / 0.04, rtol=1e-3)
    assert ends[0, 0] == 0
    coarse = target_bends(arc(1.0), 0.004)
    assert len(coarse[1]) == 10


def test_a_direction_that_moves_nothing_is_named(tmp_path: Path) -> None:
    """The last segment is all but free of remanence."""
    material = "{shear_modulus: 120 kPa, bulk_to_shear: 20, density: 1882 kg/m^3, remanence: 0.01 mT}"
    weak = SCENE.replace("remanence: 138 mT}", f"remanence: 138 mT}}\n  weak: {material}")
    weak = weak.replace("- magnetization: [0, 0, -1]", "- {magnetization: [0, 0, -1], material: weak}")
    found = said(study_of(tmp_path, arc(0.5 * np.pi), scene=weak))
    assert "segment_5" in found
    assert found["segment_5"]["m_per_rad"] < 1e-5
    assert "segment_4" not in found


def test_where_other_starts_ended_is_told(tmp_path: Path) -> None:
    report = study_of(tmp_path, arc(1.2 * np.pi), trials=16)
    others = said(report)["other starts"]["rms_m"]
    assert others == sorted(others)
    assert len(others) >= 1
    assert others[0] >= report.best["rms_m"]


def test_a_search_that_was_cut_short_says_so(tmp_path: Path) -> None:
    found = said(study_of(tmp_path, shape(scene_of(tmp_path)), NEWTON.replace("0.1 mm", "1e-6 mm"), trials=1))
    assert "still getting better" in found["trials"]["says"]


def test_directions_of_a_set_are_not_called_without_effect(tmp_path: Path) -> None:
    """They have no derivative; the derivative of what is made is zero, but another direction of the set moves the shape."""
    limits = "limits: {directions: [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]]}\ntrials: 2\n"
    report = study_of(tmp_path, arc(1.0), FIELD.replace("trials: 8\n", limits))
    assert report.limits, "it misses its stop"
    assert not [one for one in report.limits if one["what"].startswith("segment")]
