"""`stability: {margin: ...}`: designs on the brink are known, refused, and told to samplers as Optuna's constraints."""

import dataclasses
import json
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rod_solve import SCENE, STUDY, RodResult, RodSensitivities, differentiate, solve, write_study
from test_resume import same, trials_of

from magmpm.errors import SolveError
from magmpm.scene import Scene
from magmpm.studies.engine.loop import run_study
from magmpm.studies.engine.report import StudyReport
from magmpm.studies.search.definition import load_study

MARGIN = STUDY.replace("trials: 8", "trials: 12") + "stability: {margin: 0.1}\n"


def stability_of(scene: Scene) -> float:
    """Between -0.4 and 0.6, smooth in the design: half of random designs are below 0.1."""
    return 0.1 + 0.5 * scene.body.catheter.segments[0].magnetization[2]


def unsteady(scene: Scene) -> RodResult:
    return dataclasses.replace(solve(scene), stability=stability_of(scene))


def unsteady_derivatives(scene: Scene, of: Any) -> RodSensitivities:
    found = differentiate(scene, of)
    return dataclasses.replace(
        found, result=dataclasses.replace(found.result, stability=stability_of(scene))
    )


def run(folder: Path, how: Any = unsteady, text: str = MARGIN, **options: Any) -> StudyReport:
    study = load_study(write_study(folder, text))
    return run_study(
        study, solve=how, differentiate=unsteady_derivatives, out=folder / "out", **options
    )


@pytest.mark.parametrize("sampler", ["random", "tpe", "gauss-newton"])
def test_a_refused_design_is_never_the_best(sampler: str, tmp_path: Path) -> None:
    report = run(tmp_path, sampler=sampler)
    trials = trials_of(tmp_path / "out")
    below = [t.number for t in trials if t.user_attrs["stability"] < 0.1]
    assert [t.number for t in trials if t.constraints["0"] > 0] == below
    assert (
        [t.number for t in trials if t.user_attrs["feasible"] is False]
        == below
        == report.failed_trials
    )
    assert all(t.constraints["0"] == 0.1 - t.user_attrs["stability"] for t in trials)
    assert (report.refused, report.failed) == (len(below), 0)
    assert report.best["rms_m"] == min(
        t.user_attrs["rms_m"] for t in trials if t.number not in below
    )
    assert report.best["stability"] >= 0.1
    saved = json.loads((tmp_path / "out" / "best" / "design.json").read_text())
    assert saved["number"] == report.best["number"]
    assert all(t.value == 1e3 * t.user_attrs["rms_m"] for t in trials), (
        "a refused design keeps its distance"
    )


def test_the_reason_is_kept(tmp_path: Path) -> None:
    run(tmp_path, sampler="random")
    refused = [t for t in trials_of(tmp_path / "out") if t.user_attrs.get("refused")]
    assert refused, "half of random designs are"
    for trial in refused:
        assert (
            trial.user_attrs["reason"]
            == f"stability {trial.user_attrs['stability']:.3g} is below the margin, 0.1"
        )


def test_every_trial_has_the_constraint_however_it_ended(tmp_path: Path) -> None:
    def breaks(scene: Scene) -> RodResult:
        if stability_of(scene) > 0.3:
            raise SolveError("no equilibrium")
        return unsteady(scene)

    report = run(tmp_path, breaks, sampler="random")
    trials = trials_of(tmp_path / "out")
    failed = [t for t in trials if "stability" not in t.user_attrs]
    assert report.failed == len(failed) > 0
    assert all(len(t.constraints) == 1 for t in trials)
    assert all(t.constraints["0"] > 0 for t in failed)


def test_without_a_margin_stability_is_stored_and_nothing_is_refused(tmp_path: Path) -> None:
    report = run(tmp_path, text=STUDY, sampler="random")
    trials = trials_of(tmp_path / "out")
    assert report.refused == 0
    assert all(t.constraints == {"0": 0.0} and t.user_attrs["feasible"] for t in trials)
    assert min(t.user_attrs["stability"] for t in trials) < 0.1


def test_a_result_that_does_not_know_its_stability_fails_where_there_is_a_margin(
    tmp_path: Path,
) -> None:
    report = run(
        tmp_path,
        lambda scene: dataclasses.replace(solve(scene), stability=None),
        sampler="random",
        trials=2,
    )
    assert report.failed == 2
    assert "not known" in trials_of(tmp_path / "out")[0].user_attrs["reason"]


def test_tpe_learns_where_it_is_stable(tmp_path: Path) -> None:
    """Random designs are refused half of the time; its later designs less often."""
    run(tmp_path, text=MARGIN.replace("trials: 12", "trials: 40"), sampler="tpe")
    later = trials_of(tmp_path / "out")[10:]
    # 30 trials at random: 15 with a standard deviation of 2.7
    assert np.sum([t.constraints["0"] > 0 for t in later]) <= 9


def test_gauss_newton_steps_from_stable_designs_alone(tmp_path: Path) -> None:
    run(tmp_path, sampler="gauss-newton")
    trials = {t.number: t for t in trials_of(tmp_path / "out")}
    bases = [t.system_attrs["gauss_newton:plan"]["from"] for t in trials.values()]
    assert all(trials[base].constraints["0"] <= 0 for base in bases if base is not None)


def test_a_study_with_a_margin_resumes_bit_for_bit(tmp_path: Path) -> None:
    for trials in (12, 5, 12):
        run(
            tmp_path / ("whole" if trials == 12 and not (tmp_path / "parts").exists() else "parts"),
            sampler="tpe",
            trials=trials,
        )
    same(trials_of(tmp_path / "whole" / "out"), trials_of(tmp_path / "parts" / "out"))


# Studies that ask for an error: trials on the coarsest grid, the best designs again on finer ones, each with its error


ASKED = SCENE.replace("{cells_across: 4}", "{error: 0.1 %}")
COARSE = 2e-4  # m: error of the stand-in's coarse grid, 0.5 % of the length


class Grid:
    """The rod, bent too little by COARSE at the tip on two cells, and exact where an error is asked for; solved: those scenes."""

    def __init__(self, fails: bool = False) -> None:
        self.fails = fails
        self.solved = list[Scene]()

    def __call__(self, scene: Scene, **options: Any) -> RodResult:
        if scene.resolution.requested:
            self.solved.append(scene)
            if self.fails:
                raise SolveError("no equilibrium was found")
            result = solve(scene.with_cells(4))
            result.scene = scene.to_si()
            result.error_estimate = 2e-5  # type: ignore[attr-defined]
            tried = [{"cells_across": 2, "error": COARSE}, {"cells_across": 4, "error": 2e-5}]
            result.resolution = {"cells_across": 4, "tried": tried}  # type: ignore[attr-defined]
            return result
        assert scene.resolution.cells_across == 2, "trials run on the coarsest grid"
        result = solve(scene)
        result.centreline[:, 3] -= (
            COARSE * (result.centreline[:, 0] / result.centreline[-1, 0]) ** 2
        )
        return result


def studied(folder: Path, grid: Grid) -> StudyReport:
    return run_study(load_study(write_study(folder, STUDY, ASKED)), solve=grid, out=folder / "out")


def test_the_best_designs_are_judged_with_their_errors(tmp_path: Path) -> None:
    grid = Grid()
    report = studied(tmp_path, grid)
    first = min(report.verified, key=lambda one: one["rms_m"])
    assert first["number"] == report.best["number"]
    assert [one["verified_rms_m"] for one in report.verified] == sorted(
        one["verified_rms_m"] for one in report.verified
    )
    for one in report.verified:
        assert (one["error_estimate_m"], one["cells_across"], one["coarse_error_m"]) == (
            2e-5,
            4,
            COARSE,
        )
        assert abs(one["verified_rms_m"] - one["rms_m"]) < COARSE
    near = sorted(rms for rms in report.rms_m if rms <= report.best["rms_m"] + 2 * COARSE)
    assert sorted(one["rms_m"] for one in report.verified) == near[:5], (
        "those that the coarse grid can't tell from the best, and no others"
    )
    assert all(scene.resolution.error == 0.001 for scene in grid.solved)

    before = len(grid.solved)
    again = studied(tmp_path, grid)
    assert again.verified == report.verified
    assert len(grid.solved) == before, "what was verified is kept with the study"
    with closing(sqlite3.connect(tmp_path / "out/study.db")) as old, old:
        old.execute(
            "UPDATE study_user_attributes SET key = 'judged', value_json ="
            " replace(value_json, 'verified', 'judged') WHERE key = 'verified'"
        )
    assert studied(tmp_path, grid).verified == report.verified, "by its name before 0.1.0"
    assert len(grid.solved) == before


def test_a_design_that_fails_on_finer_grids_keeps_the_reason(tmp_path: Path) -> None:
    report = studied(tmp_path, Grid(fails=True))
    assert report.verified[0]["number"] == report.best["number"]
    assert "no equilibrium was found" in report.verified[0]["reason"]


def test_another_error_is_another_study(tmp_path: Path) -> None:
    study = load_study(write_study(tmp_path, STUDY, ASKED))
    other = load_study(write_study(tmp_path / "other", STUDY, ASKED.replace("0.1 %", "1 %")))
    plain = load_study(
        write_study(tmp_path / "plain", STUDY, SCENE.replace("cells_across: 4", "cells_across: 2"))
    )
    assert study.requested is not None
    assert plain.requested is None
    assert study.scene.resolution == plain.scene.resolution
    assert len({str(one.definition()) for one in (study, other, plain)}) == 3
    assert np.isclose(study.definition()["scene"]["resolution"]["error"], 0.001)


def test_designs_are_judged_by_their_whole_shape(tmp_path: Path) -> None:
    """The bound of a tip says nothing of a shape, nor of the distance from it."""
    study = load_study(
        write_study(tmp_path, STUDY, SCENE.replace("{cells_across: 4}", "{error: 0.1 mm, of: tip}"))
    )
    assert (study.requested.of, study.requested.allowed(study.scene.length)) == (
        "centreline",
        pytest.approx(1e-4),
    )
