"""The data that a trial stores; no failure of a trial ends a study."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pytest
from interruptible import draw
from rod_solve import STUDY, RodResult, solve, write_study
from test_resume import pictures, trials_of

from magmpm.errors import SolveError
from magmpm.results.measures import rms_distance, tip_error
from magmpm.scene import Scene
from magmpm.studies.engine.loop import run_study
from magmpm.studies.engine.report import StudyReport
from magmpm.studies.evaluate.trial import Trial
from magmpm.studies.search.definition import load_study
from magmpm.studies.search.search_space import SearchSpace

PENALTY = 0.04  # length of the catheter


def run(folder: Path, how: Any = solve, text: str = STUDY, **options: Any) -> StudyReport:
    return run_study(load_study(write_study(folder, text)), solve=how, out=folder / "out", **options)


def test_every_trial_keeps_its_numbers(tmp_path: Path) -> None:
    report = run(tmp_path, picture=draw)
    study = load_study(tmp_path / "probe.yaml")
    space = SearchSpace.of(study)
    for trial in trials_of(tmp_path / "out"):
        kept = trial.user_attrs
        scene = space.scene_of(trial.params)
        result = solve(scene)
        assert trial.value == kept["rms_m"] == rms_distance(result, study.target)  # type: ignore[arg-type]
        assert kept["tip_error_m"] == tip_error(result, study.target)  # type: ignore[arg-type]
        assert (kept["min_det_F"], kept["max_det_F"], kept["newton_steps"]) == (0.9, 1.1, result.iterations)
        assert kept["feasible"] is True
        assert kept["scene_hash"] == scene.hash()
        assert set(kept["seconds"]) == {"solve", "render", "total"}
        assert kept["seconds"]["total"] >= kept["seconds"]["solve"] > 0
        assert {"magmpm", "optuna"} <= set(kept["versions"])
        found = [s.magnetization for s in scene.body.catheter.segments]
        np.testing.assert_allclose(kept["magnetization"], found, atol=1e-9)  # stored with 9 digits
        assert kept["field_T"] == [0.0, 0.006, 0.008]
    assert report.best is not None
    assert report.best["rms_m"] == min(report.rms_m)
    assert report.rms_m[report.best["number"]] == report.best["rms_m"]
    assert report.best["params"] == trials_of(tmp_path / "out")[report.best["number"]].params


def test_the_report_is_the_contracts_and_json(tmp_path: Path) -> None:
    report = run(tmp_path, text=STUDY + "stop: {rms: 0.001 mm}\n")
    summary = json.loads(json.dumps(report.summary()))
    assert {"trials", "best", "first_trial_below_stop", "seconds_per_trial", "storage"} <= set(summary)
    assert set(summary["best"]) >= {"number", "rms_m", "params"}
    assert summary["storage"] == f"sqlite:///{(tmp_path / 'out/study.db').resolve()}"
    assert json.loads((tmp_path / "out/study.json").read_text()) == summary


def test_the_best_designs_result_is_kept(tmp_path: Path) -> None:
    report = run(tmp_path)
    improved = [n for n, rms in enumerate(report.rms_m) if rms == min(report.rms_m[: n + 1])]
    kept = sorted((tmp_path / "out/improvements").iterdir())
    assert [folder.name for folder in kept] == [f"{n:03d}" for n in improved]
    assert report.best is not None
    best = json.loads((tmp_path / "out/best/design.json").read_text())
    assert (best["number"], best["rms_m"]) == (report.best["number"], report.best["rms_m"])
    scene = Scene.from_si(json.loads((tmp_path / "out/best/result.json").read_text())["scene"])
    study = load_study(tmp_path / "probe.yaml")
    assert rms_distance(solve(scene), study.target) == report.best["rms_m"]  # type: ignore[arg-type]


def test_a_lost_result_of_the_best_is_solved_again(tmp_path: Path) -> None:
    """For example, if a study in a shared database is opened on another machine."""
    import shutil

    run(tmp_path)
    before = (tmp_path / "out/best/result.json").read_text()
    shutil.rmtree(tmp_path / "out/best")
    shutil.rmtree(tmp_path / "out/improvements")
    run(tmp_path)
    assert (tmp_path / "out/best/result.json").read_text() == before


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (SolveError("no equilibrium at 60 % of the load"), "no equilibrium at 60 % of the load"),
        (FloatingPointError("overflow encountered in exp"), "FloatingPointError: overflow encountered in exp"),
        (np.linalg.LinAlgError("Singular matrix"), "LinAlgError: Singular matrix"),
        (ValueError("shapes differ"), "ValueError: shapes differ"),
        (MemoryError(), "MemoryError: "),
    ],
    ids=lambda value: type(value).__name__,
)
def test_a_failed_solve_costs_a_trial_and_not_the_study(error: Exception, reason: str, tmp_path: Path) -> None:
    calls: list[Scene] = []

    def sometimes(scene: Scene) -> RodResult:
        calls.append(scene)
        if len(calls) % 2:
            raise error
        return solve(scene)

    report = run(tmp_path, sometimes, STUDY.replace("random", "tpe"), picture=draw)
    assert (report.trials, report.failed, report.ended) == (8, 4, "trials")
    for trial in trials_of(tmp_path / "out")[::2]:
        assert trial.state == optuna.trial.TrialState.COMPLETE
        assert trial.value == PENALTY
        assert trial.user_attrs["feasible"] is False
        assert trial.user_attrs["reason"] == reason
        assert pictures(tmp_path / "out", trial) == []
    assert report.best is not None
    assert report.best["number"] % 2 == 1
    log = tmp_path / "out/failures.log"
    assert log.exists() != isinstance(error, SolveError), "tracebacks of what was not foreseen"
    assert not log.exists() or reason.split(":")[0] in log.read_text()


@pytest.mark.parametrize("sampler", ["tpe", "cmaes", "random"])
def test_a_study_whose_solves_all_fail_ends_and_says_so(sampler: str, tmp_path: Path) -> None:
    def never(scene: Scene) -> RodResult:
        raise SolveError("unstable")

    report = run(tmp_path, never, STUDY.replace("trials: 8", "trials: 14"), sampler=sampler)
    assert (report.trials, report.failed) == (14, 14)
    assert report.best is None
    assert report.first_trial_below_stop is None
    assert not (tmp_path / "out/best").exists()
    assert len({json.dumps(t.params) for t in trials_of(tmp_path / "out")}) == 14, ("it keeps looking elsewhere")


@pytest.mark.parametrize("broken", ["nan", "inf", "unconverged"])
def test_a_result_that_is_none_costs_the_penalty(broken: str, tmp_path: Path) -> None:
    def spoiled(scene: Scene) -> RodResult:
        result = solve(scene)
        if broken == "unconverged":
            result.converged = False
        else:
            result.centreline[-1, 2] = float(broken)
        return result

    report = run(tmp_path, spoiled)
    assert (report.failed, report.best) == (8, None)
    assert set(report.rms_m) == {PENALTY}


def test_a_penalty_never_is_the_best_nor_below_stop(tmp_path: Path) -> None:
    """Even if every design is worse than the penalty, for example with a stop above the length of the catheter."""

    def never(scene: Scene) -> RodResult:
        raise SolveError("unstable")

    report = run(tmp_path, never, STUDY + "stop: {rms: 1 m}\n")
    assert (report.ended, report.best, report.first_trial_below_stop) == ("trials", None, None)


def test_a_picture_that_fails_is_a_note(tmp_path: Path) -> None:
    def broken(result: RodResult, path: Path, trial: Trial) -> Path:
        if trial.number % 2:
            raise RuntimeError("the drawing process died")
        return draw(result, path, trial)

    report = run(tmp_path, picture=broken)
    assert report.failed == 0
    for trial in trials_of(tmp_path / "out"):
        note = trial.user_attrs.get("picture_note")
        assert note == ("RuntimeError: the drawing process died" if trial.number % 2 else None)
        assert len(pictures(tmp_path / "out", trial)) == 1 - trial.number % 2


def test_callbacks_see_progress_and_the_time_left(tmp_path: Path) -> None:
    seen: list[Trial] = []
    report = run(tmp_path, on_trial=seen.append)
    assert [t.number for t in seen] == list(range(8))
    assert [t.finished for t in seen] == list(range(1, 9))
    assert {t.wanted for t in seen} == {8}
    assert [t.best_rms_m for t in seen] == [min(report.rms_m[: n + 1]) for n in range(8)]
    assert all(t.seconds_left > 0 for t in seen[:-1])
    assert seen[-1].seconds_left == 0


def test_memory_does_not_grow_with_trials(tmp_path: Path) -> None:
    """Results of a trial are freed: 10 MB per trial would be visible over 40 trials."""
    import psutil

    process, used = psutil.Process(), []

    def heavy(scene: Scene) -> RodResult:
        result = solve(scene)
        result.ballast = np.ones(1_250_000)  # type: ignore[attr-defined]
        used.append(process.memory_info().rss)
        return result

    run(tmp_path, heavy, STUDY.replace("trials: 8", "trials: 40"))
    # the last 30 trials: less than the size of two results, which leaves room for the allocator and Optuna's cache of trials
    assert used[-1] - used[10] < 20e6


def test_seconds_a_trial_hold_all_of_its_storage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Including its value: on a slow disk that can take longer than the solve."""
    value = optuna.Study.tell

    def slow_value(self: optuna.Study, *arguments: object) -> object:
        time.sleep(0.2)
        return value(self, *arguments)

    monkeypatch.setattr(optuna.Study, "tell", slow_value)
    begun = time.perf_counter()
    report = run(tmp_path, text=STUDY.replace("trials: 8", "trials: 3"))
    whole = time.perf_counter() - begun
    assert 0.2 <= report.seconds_per_trial <= whole / 3 + 0.05
