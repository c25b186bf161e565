"""The data that a trial stores; no failure of a trial ends a study."""

import json
import re
import time
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pytest
from interruptible import draw
from rod_solve import STUDY, RodResult, solve, write_study
from test_resume import pictures, trials_of

from magmpm.cli import main
from magmpm.errors import SolveError
from magmpm.inputs.csv_tables import write_centreline
from magmpm.scene import Scene, load_scene
from magmpm.studies.engine.loop import run_study
from magmpm.studies.engine.report import StudyReport
from magmpm.studies.evaluate.trial import Trial
from magmpm.studies.explore.accuracy import Beside, Solve, climb
from magmpm.studies.problem.shape_distance import gaps, root_mean_square
from magmpm.studies.search.definition import load_study
from magmpm.studies.search.samplers.optuna_ids import value_of
from magmpm.studies.search.search_space import SearchSpace

PENALTY = 0.04  # length of the catheter


def run(folder: Path, how: Any = solve, text: str = STUDY, **options: Any) -> StudyReport:
    return run_study(
        load_study(write_study(folder, text)), solve=how, out=folder / "out", **options
    )


def test_every_trial_keeps_its_numbers(tmp_path: Path) -> None:
    report = run(tmp_path, picture=draw)
    study = load_study(tmp_path / "probe.yaml")
    space = SearchSpace.of(study)
    for trial in trials_of(tmp_path / "out"):
        kept = trial.user_attrs
        scene = space.scene_of(trial.params)
        result = solve(scene)
        rms = root_mean_square(gaps(result.centreline, study.target))
        assert value_of(trial) == kept["rms_m"] == rms
        assert trial.value == 1e3 * rms
        assert kept["tip_error_m"] == np.linalg.norm(gaps(result.centreline, study.target)[-1])
        assert (kept["min_det_F"], kept["max_det_F"], kept["newton_steps"]) == (
            0.9,
            1.1,
            result.iterations,
        )
        assert kept["feasible"] is True
        assert kept["scene_hash"] == scene.hash()
        assert set(kept["seconds"]) == {"solve", "render", "total"}
        assert kept["seconds"]["total"] >= kept["seconds"]["solve"] > 0
        assert {"magmpm", "optuna"} <= set(kept["versions"])
        found = [s.magnetization for s in scene.body.catheter.segments]
        np.testing.assert_allclose(kept["magnetization"], found, atol=1e-9)  # stored with 9 digits
        assert kept["field_T"] == [0.0, 0.006, 0.008]
    assert not {"pareto", "front", "objectives"} & set(report.summary())
    assert report.best["rms_m"] == min(report.rms_m)
    assert report.rms_m[report.best["number"]] == report.best["rms_m"]
    assert report.best["params"] == trials_of(tmp_path / "out")[report.best["number"]].params


def test_the_best_designs_result_is_kept(tmp_path: Path) -> None:
    report = run(tmp_path)
    improved = [n for n, rms in enumerate(report.rms_m) if rms == min(report.rms_m[: n + 1])]
    kept = sorted((tmp_path / "out/improvements").iterdir())
    assert [folder.name for folder in kept] == [f"{n:03d}" for n in improved]
    best = json.loads((tmp_path / "out/best/design.json").read_text())
    assert (best["number"], best["rms_m"]) == (report.best["number"], report.best["rms_m"])
    scene = Scene.from_si(json.loads((tmp_path / "out/best/result.json").read_text())["scene"])
    study = load_study(tmp_path / "probe.yaml")
    assert root_mean_square(gaps(solve(scene).centreline, study.target)) == report.best["rms_m"]


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (SolveError("no equilibrium at 60 % of the load"), "no equilibrium at 60 % of the load"),
        (
            FloatingPointError("overflow encountered in exp"),
            "FloatingPointError: overflow encountered in exp",
        ),
        (np.linalg.LinAlgError("Singular matrix"), "LinAlgError: Singular matrix"),
        (ValueError("shapes differ"), "ValueError: shapes differ"),
        (MemoryError(), "MemoryError: "),
    ],
    ids=lambda value: type(value).__name__,
)
def test_a_failed_solve_costs_a_trial_and_not_the_study(
    error: Exception, reason: str, tmp_path: Path
) -> None:
    calls: list[Scene] = []

    def sometimes(scene: Scene) -> RodResult:
        calls.append(scene)
        if len(calls) % 2:
            raise error
        return solve(scene)

    report = run(tmp_path, sometimes, STUDY.replace("random", "tpe"), picture=draw, trials=4)
    assert (report.trials, report.failed, report.ended) == (4, 2, "trials")
    for trial in trials_of(tmp_path / "out")[::2]:
        assert trial.state == optuna.trial.TrialState.COMPLETE
        assert (trial.value, trial.user_attrs["values_si"]) == (1e3 * PENALTY, [PENALTY])
        assert trial.user_attrs["feasible"] is False
        assert trial.constraints == {"0": 1.0}
        assert trial.user_attrs["reason"] == reason
        assert pictures(tmp_path / "out", trial) == []
    assert report.best["number"] % 2 == 1
    log = tmp_path / "out/failures.log"
    assert log.exists() != isinstance(error, SolveError), "tracebacks of what was not foreseen"
    assert not log.exists() or reason.split(":")[0] in log.read_text()


@pytest.mark.parametrize("sampler", ["tpe", "cmaes", "random"])
def test_a_study_whose_solves_all_fail_ends_and_says_so(sampler: str, tmp_path: Path) -> None:
    """A penalty is never the best nor below `stop`, even if that is above the length of the catheter."""

    def never(scene: Scene) -> RodResult:
        raise SolveError("unstable")

    report = run(
        tmp_path,
        never,
        STUDY.replace("trials: 8", "trials: 14") + "stop: {rms: 1 m}\n",
        sampler=sampler,
    )
    assert (report.trials, report.failed, report.ended) == (14, 14, "trials")
    assert report.best is None
    assert report.first_trial_below_stop is None
    assert not (tmp_path / "out/best").exists()
    assert len({json.dumps(t.params) for t in trials_of(tmp_path / "out")}) == 14, (
        "it keeps looking elsewhere"
    )


@pytest.mark.parametrize("broken", ["nan", "inf", "unconverged"])
def test_a_result_that_is_none_costs_the_penalty(broken: str, tmp_path: Path) -> None:
    def spoiled(scene: Scene) -> RodResult:
        result = solve(scene)
        if broken == "unconverged":
            result.converged = False
        else:
            result.centreline[-1, 2] = float(broken)
        return result

    report = run(tmp_path, spoiled, trials=3)
    assert (report.failed, report.best) == (3, None)
    assert set(report.rms_m) == {PENALTY}


def test_a_picture_that_fails_is_a_note(tmp_path: Path) -> None:
    def broken(result: RodResult, path: Path, trial: Trial) -> Path:
        if trial.number % 2:
            raise RuntimeError("the drawing process died")
        return draw(result, path, trial)

    report = run(tmp_path, picture=broken, trials=4)
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

    process = psutil.Process()
    used = []

    def heavy(scene: Scene) -> RodResult:
        result = solve(scene)
        result.ballast = np.ones(1_250_000)  # type: ignore[attr-defined]
        used.append(process.memory_info().rss)
        return result

    run(tmp_path, heavy, STUDY.replace("trials: 8", "trials: 40"))
    # the last 30 trials: less than the size of two results, which leaves room for the allocator and Optuna's cache of trials
    assert used[-1] - used[10] < 20e6


def test_seconds_a_trial_hold_all_of_its_storage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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


# Errors of `magmpm accuracy` are relative to the length, and refer to the finest cells or to the reference


def off(scene: Scene) -> RodResult:
    """The result of a rod with an error of 0.16 mm over the squared number of cells; no time."""
    found = solve(scene)
    cells = scene.resolution.cells_across
    found.centreline[:, 3] += 0.16e-3 / cells**2 * found.centreline[:, 0] / 40e-3
    found.__dict__.update(seconds={}, particles=8 * cells**3, dof=3 * cells**3)
    return found


def test_errors_are_shares_of_the_length(tmp_path: Path) -> None:
    """40 mm: an error of 0.04 mm at 2 cells, 0.01 at 4; relative to the thickness of 4 mm they would be ten times as large."""
    write_study(tmp_path)
    scene = load_scene(tmp_path / "scene.yaml")
    shape = solve(scene).centreline
    ladder = climb(scene, off, (2, 4))
    assert ladder.length == 40e-3
    assert [rung.error_finest for rung in ladder.rungs] == [
        pytest.approx((0.04e-3 - 0.01e-3) / 40e-3, rel=1e-6),
        None,
    ]
    assert [rung.error_reference for rung in ladder.rungs] == [None, None]
    assert ladder.rungs[0].cell_size == 2e-3
    # 0.03 mm apart, at the slowest order 1.5 and with a safety of 1.25; the finer one has 2^-1.5 of that
    bar = 1.25 * 0.03 / 40 / (1 - 2**-1.5)
    assert [rung.bar for rung in ladder.rungs] == [
        pytest.approx(bar, rel=1e-6),
        pytest.approx(bar * 2**-1.5, rel=1e-6),
    ]
    rod, more, places = ladder.beside
    assert (
        0.0 < rod.error_finest < 6e-4
    )  # the finest is a rod itself, 0.01 mm off at the tip; the rows between stations are another 2e-4
    assert rod.error_reference is None
    assert more.error_finest < 1e-12
    assert places.name == "3 other places of the grid, at 4 cells, the worst"
    assert 1e-4 < places.error_finest < 0.02  # solved in truth: a rod is off by 0.7 % here
    assert ladder.conclusions[-1].startswith("The rod would do for 1 % and for 0.1 %")
    assert "0.1 % of the length costs" in ladder.conclusions[1]

    write_centreline(tmp_path / "reference.csv", shape)
    text = (tmp_path / "scene.yaml").read_text() + "reference: {centreline: reference.csv}\n"
    (tmp_path / "scene.yaml").write_text(text)
    ladder = climb(load_scene(tmp_path / "scene.yaml"), off, (2, 4))
    rows = 1e-4  # the table has few digits: 4e-9 m of the smallest error
    np.testing.assert_allclose(
        [rung.error_reference for rung in ladder.rungs], [1e-3, 0.25e-3], rtol=10 * rows
    )
    assert ladder.order_reference == pytest.approx(2.0, abs=0.01)


@pytest.fixture
def nothing_beside(monkeypatch: pytest.MonkeyPatch) -> None:
    """The ladder alone: what is solved beside it says nothing of orders."""
    monkeypatch.setattr(Beside, "other_models", lambda self: None)


@pytest.mark.usefixtures("nothing_beside")
@pytest.mark.parametrize(("order", "told"), [(2.0, 2.0), (4.0, 4.0), (7.6, None), (0.4, None)])
@pytest.mark.parametrize("cells", [(2, 3, 4), (2, 3, 4, 6, 8)])
def test_the_order_to_the_finest_is_that_of_the_errors(
    order: float, told: float | None, cells: tuple[int, ...], tmp_path: Path
) -> None:
    """Errors of c n^-p: three grids tell p, though the finest has an error itself; 0.02: p is sought in steps of 0.01. One that the method
    can't have is no number, but a sentence."""
    write_study(tmp_path)

    def wrong(scene: Scene) -> RodResult:
        found = solve(scene)
        found.centreline[:, 3] += (
            0.4e-3 * scene.resolution.cells_across**-order * found.centreline[:, 0] / 40e-3
        )
        found.__dict__.update(seconds={}, particles=1, dof=1)
        return found

    ladder = climb(load_scene(tmp_path / "scene.yaml"), wrong, cells)
    (line,) = (
        line
        for line in ladder.table().splitlines()
        if line.startswith("order of convergence to the finest")
    )
    if told is not None:
        assert ladder.order_finest == pytest.approx(told, abs=0.02)
        assert line.endswith(f": {told:.1f}")
        assert ladder.asymptotic is (None if len(cells) == 3 else True)
    else:
        assert (ladder.order_finest, ladder.asymptotic) == (None, False)
        assert "not determined: the errors fall" in line
        assert "the grids are too coarse" in line
        assert not re.search(r"7\.|0\.4", line)


@pytest.mark.usefixtures("nothing_beside")
def test_errors_that_rise_show_no_order(tmp_path: Path) -> None:
    write_study(tmp_path)

    def odd(scene: Scene) -> RodResult:
        found = solve(scene)
        found.centreline[:, 3] += (
            {2: 0.1e-3, 3: 0.2e-3, 4: 0.05e-3, 6: 0.0}[scene.resolution.cells_across]
            * found.centreline[:, 0]
            / 40e-3
        )
        found.__dict__.update(seconds={}, particles=1, dof=1)
        return found

    ladder = climb(load_scene(tmp_path / "scene.yaml"), odd, (2, 3, 4, 6))
    assert ladder.order_finest is None
    assert ladder.undetermined == {"finest": "the errors do not fall steadily with the cells"}


def test_bodies_of_parts_are_compared_by_the_centers_of_these() -> None:
    """Centers 0.8 mm off over the squared number of cells: at 2 cells 0.15 mm farther than at 4."""
    scene = load_scene(Path(__file__).parents[2] / "data/scenes/gallery/gripper.yaml")

    assert scene.cell == 0.5e-3, "the file gives a spacing"
    assert [scene.with_cells(n).cell for n in (2, 4)] == [scene.thickness / n for n in (2, 4)]

    def centers(scene: Scene) -> RodResult:
        cells = scene.resolution.cells_across
        found = RodResult(scene.to_si(), np.zeros((0, 4)))
        places = np.arange(42.0).reshape(14, 3) * 1e-3
        places[3, 1] += 0.8e-3 / cells**2
        found.__dict__.update(segment_center=places, seconds={}, particles=cells, dof=cells)
        return found

    ladder = climb(scene, centers, (2, 4))
    assert ladder.rungs[0].error_finest == pytest.approx(0.15e-3 / scene.length, rel=1e-9)
    assert ladder.beside == []
    assert ladder.algebraic_error is None


def failing(*cells: int) -> Solve:
    """A solver that finds no answer with so many cells across."""

    def solve_or_fail(scene: Scene) -> RodResult:
        if scene.resolution.cells_across in cells:
            raise SolveError(f"nothing at {scene.resolution.cells_across}")
        return off(scene)

    return solve_or_fail


def test_cells_that_find_no_answer_are_named_and_the_others_kept(tmp_path: Path) -> None:
    write_study(tmp_path)
    scene = load_scene(tmp_path / "scene.yaml")
    whole = climb(scene, off, (2, 5))
    ladder = climb(scene, failing(3), (2, 3, 5))
    assert [rung.cells_across for rung in ladder.rungs] == [2, 5]
    assert [rung.error_finest for rung in ladder.rungs] == [
        rung.error_finest for rung in whole.rungs
    ]
    assert ladder.failed == {"3 cells across": "nothing at 3"}
    assert "3 cells across failed: nothing at 3" in ladder.table()

    more = climb(scene, failing(4), (2, 5))  # what is compared beside the ladder has 4
    assert [name.partition(",")[0] for name in more.failed] == [
        "3 particles a cell along each direction"
    ]
    assert more.beside[0].name == "rod"

    alone = climb(scene, failing(3, 5), (2, 3, 5))
    assert alone.conclusions == ["The error is not known: only 2 cells across were solved."]
    with pytest.raises(SolveError, match="nothing at 2"):
        climb(scene, failing(2, 3, 5), (2, 3, 5))


def test_one_size_alone_ends_with_3(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Solved grids are kept."""
    write_study(tmp_path)
    monkeypatch.setattr("magmpm.simulate.run", failing(3))
    assert (
        main(
            [
                "accuracy",
                str(tmp_path / "scene.yaml"),
                "--cells",
                "2,3",
                "--out",
                str(tmp_path / "ladder"),
                "--json",
            ]
        )
        == 3
    )
    told = json.loads(capsys.readouterr().out)
    kept = json.loads((tmp_path / "ladder/accuracy.json").read_text())
    assert told["failed"] == kept["failed"] == {"3 cells across": "nothing at 3"}
    assert len(kept["rungs"]) == 1
    assert not (tmp_path / "ladder/accuracy.png").exists(), "there is no error to be drawn"


@pytest.mark.usefixtures("nothing_beside")
def test_along_a_path_it_is_told_what_the_errors_are_of(tmp_path: Path) -> None:
    """Its end: `run`, asked for an error, judges the whole path, and may need finer cells."""
    write_study(tmp_path)
    data = load_scene(tmp_path / "scene.yaml").to_si()
    field = {**data["field"], "over_time": {"ramp": {"duration": 1.0}}}
    ladder = climb(
        Scene.from_si({**data, "field": field, "solver": {"quasi_static": {"steps": 4}}}),
        off,
        (2, 5),
    )
    assert "of the path's end" in ladder.conclusions[-1]
    assert not any(
        "of the path's end" in said
        for said in climb(load_scene(tmp_path / "scene.yaml"), off, (2, 5)).conclusions
    )
