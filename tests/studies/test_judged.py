"""Studies that ask for an error: trials on the coarsest grid, the best designs again on finer ones, each with its error."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rod_solve import SCENE, STUDY, RodResult, solve, write_study

from magmpm.errors import SolveError
from magmpm.scene import Scene
from magmpm.studies.engine.loop import run_study
from magmpm.studies.engine.report import StudyReport
from magmpm.studies.search.definition import load_study

ASKED = SCENE.replace("{cells_across: 4}", "{error: 0.1 %}")
COARSE = 2e-4  # m: error of the stand-in's coarse grid, 0.5 % of the length


class Grid:
    """The rod, bent too little by COARSE at the tip on two cells, and exact where an error is asked for; solved: those scenes."""

    def __init__(self, fails: bool = False) -> None:
        self.fails, self.solved = fails, list[Scene]()

    def __call__(self, scene: Scene, **options: Any) -> RodResult:
        if scene.resolution.asked:
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
        result.centreline[:, 3] -= COARSE * (result.centreline[:, 0] / result.centreline[-1, 0]) ** 2
        return result


def studied(folder: Path, grid: Grid) -> StudyReport:
    return run_study(load_study(write_study(folder, STUDY, ASKED)), solve=grid, out=folder / "out")


def test_the_best_designs_are_judged_with_their_errors(tmp_path: Path) -> None:
    grid = Grid()
    report = studied(tmp_path, grid)
    assert report.best is not None
    first = min(report.judged, key=lambda one: one["rms_m"])
    assert first["number"] == report.best["number"]
    assert [one["judged_rms_m"] for one in report.judged] == sorted(one["judged_rms_m"] for one in report.judged)
    for one in report.judged:
        assert (one["error_estimate_m"], one["cells_across"], one["coarse_error_m"]) == (2e-5, 4, COARSE)
        assert abs(one["judged_rms_m"] - one["rms_m"]) < COARSE
    near = sorted(rms for rms in report.rms_m if rms <= report.best["rms_m"] + 2 * COARSE)
    assert sorted(one["rms_m"] for one in report.judged) == near[:5], "those that the coarse grid can't tell from the best, and no others"
    assert all(scene.resolution.error == 0.001 for scene in grid.solved)

    before = len(grid.solved)
    again = studied(tmp_path, grid)
    assert again.judged == report.judged
    assert len(grid.solved) == before, "what was judged is kept with the study"


def test_a_design_that_fails_on_finer_grids_keeps_the_reason(tmp_path: Path) -> None:
    report = studied(tmp_path, Grid(fails=True))
    assert report.best is not None
    assert report.judged[0]["number"] == report.best["number"]
    assert "no equilibrium was found" in report.judged[0]["reason"]


def test_another_error_is_another_study(tmp_path: Path) -> None:
    study = load_study(write_study(tmp_path, STUDY, ASKED))
    other = load_study(write_study(tmp_path / "other", STUDY, ASKED.replace("0.1 %", "1 %")))
    plain = load_study(write_study(tmp_path / "plain", STUDY, SCENE.replace("cells_across: 4", "cells_across: 2")))
    assert study.asked is not None
    assert plain.asked is None
    assert study.scene.resolution == plain.scene.resolution
    assert len({str(one.definition()) for one in (study, other, plain)}) == 3
    assert np.isclose(study.definition()["scene"]["resolution"]["error"], 0.001)


def test_designs_are_judged_by_their_whole_shape(tmp_path: Path) -> None:
    """The bound of a tip says nothing of a shape, nor of the distance from it."""
    study = load_study(write_study(tmp_path, STUDY, SCENE.replace("{cells_across: 4}", "{error: 0.1 mm, of: tip}")))
    assert study.asked is not None
    assert (study.asked.of, study.asked.allowed(study.scene.length)) == ("centreline", pytest.approx(1e-4))
