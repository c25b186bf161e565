"""Two objectives: their values, the Pareto front, and studies that have them."""

import json
import math
from pathlib import Path

import numpy as np
import optuna
import pytest
from rod_solve import SCENE, STUDY, RodResult, solve, write_study
from test_resume import trials_of

from magmpm.errors import InputError, SolveError
from magmpm.scene import Scene
from magmpm.studies.engine.loop import run_study
from magmpm.studies.search.definition import load_study
from magmpm.studies.search.objectives import compromise, front, ranked, second, worst
from magmpm.studies.search.search_space import SearchSpace

FIELD = STUDY.replace("  magnetization: {}\n", "  magnetization: {}\n  field: {max: 10 mT}\n") + "minimize: [rms, largest_field]\n"
THICKNESS = "  magnetization: {}\n  diameter: {min: 3 mm, max: 5 mm}\n"
VOLUME = STUDY.replace("  magnetization: {}\n", THICKNESS) + "minimize: [rms, magnetized_volume]\n"


def trial(number: int, *values: float) -> optuna.trial.FrozenTrial:
    return optuna.trial.create_trial(values=list(values), user_attrs={"feasible": True}).__class__(
        number=number, state=optuna.trial.TrialState.COMPLETE, value=None, values=list(values), datetime_start=None, datetime_complete=None,
        params={}, distributions={}, user_attrs={}, system_attrs={}, intermediate_values={}, trial_id=number,
    )  # fmt: skip


def test_the_front_is_what_nothing_dominates(rng: np.random.Generator) -> None:
    """Against the definition, pair by pair, on values that often tie."""
    for _ in range(20):
        points = rng.integers(0, 6, size=(15, 2)).astype(float)
        found = {t.number for t in front([trial(k, *p) for k, p in enumerate(points)])}
        for k, p in enumerate(points):
            dominated = any(np.all(q <= p) and np.any(q < p) for q in points)
            twin = any(np.array_equal(points[j], p) for j in range(k))
            assert (k in found) == (not dominated and not twin)


def test_ranks_go_front_by_front() -> None:
    trials = [trial(0, 3.0, 3.0), trial(1, 1.0, 2.0), trial(2, 2.0, 1.0), trial(3, 2.0, 3.0), trial(4, 3.0, 2.0)]
    order = ranked(trials)
    assert set(order[:2]) == {1, 2}
    assert set(order[2:4]) == {3, 4}
    assert ranked([trial(0, 3.0), trial(1, 1.0), trial(2, 1.0)]) == [1, 2, 0]
    assert compromise([(0.0, 10.0), (1.0, 2.0), (10.0, 0.0)]) == 1
    assert compromise([(1.0, 1.0)]) == 0


def test_second_objectives_are_what_they_are_called(tmp_path: Path) -> None:
    space = SearchSpace.of(load_study(write_study(tmp_path / "field", FIELD)))
    parameters = space.parameters_at(space.drawn(np.random.default_rng(1))) | {"field_mT": 7.0}
    assert second("largest_field", space, parameters) == pytest.approx(7e-3, rel=1e-12)
    assert worst("largest_field", space) == 10e-3
    plain = SCENE.replace("magnetization: [-1, 0, 0.5]", "magnetization: [0, 0, 0]")
    space = SearchSpace.of(load_study(write_study(tmp_path / "volume", VOLUME, plain)))
    (name,) = [name for name in space.bounds if "diameter" in name]
    parameters = space.parameters_at(space.drawn(np.random.default_rng(1))) | {name: 3.5}
    assert second("magnetized_volume", space, parameters) == pytest.approx(4 * 8e-3 * math.pi / 4 * 3.5e-3**2, rel=1e-12)
    # the whole body at its thickest: never less than the volume of any design
    assert worst("magnetized_volume", space) == pytest.approx(40e-3 * math.pi / 4 * 5e-3**2, rel=1e-12)


@pytest.mark.parametrize("sampler", ["nsga2", "tpe", "random"])
def test_a_study_with_two_objectives_reports_its_front_and_resumes(sampler: str, tmp_path: Path) -> None:
    """Failed trials, every fifth, are never on the front; interrupted, it has the same trials."""
    study = load_study(write_study(tmp_path, FIELD.replace("trials: 8", "trials: 22")))
    calls: list[str] = []
    stop_at = -1

    def sometimes(scene: Scene) -> RodResult:
        calls.append(scene.hash())
        if len(calls) == stop_at:
            raise KeyboardInterrupt
        if int(scene.hash(), 16) % 5 == 0:
            raise SolveError("no equilibrium")
        return solve(scene)

    report = run_study(study, solve=sometimes, out=tmp_path / "whole", sampler=sampler)  # type: ignore[arg-type]
    calls, stop_at = [], 21
    assert run_study(study, solve=sometimes, out=tmp_path / "parts", sampler=sampler).ended == "interrupted"  # type: ignore[arg-type]
    run_study(study, solve=sometimes, out=tmp_path / "parts", sampler=sampler)  # type: ignore[arg-type]
    trials = trials_of(tmp_path / "whole")
    for one, other in zip(trials, trials_of(tmp_path / "parts"), strict=True):
        assert (one.params, one.values) == (other.params, other.values)
    summary = json.loads(json.dumps(report.summary()))
    assert summary["objectives"] == ["rms_m", "largest_field_T"]
    on_it = [entry["number"] for entry in summary["pareto"]]
    assert report.failed > 0
    assert not set(on_it) & set(report.failed_trials)
    for entry in summary["pareto"]:
        a, b = entry["values"]
        assert (a, b) == tuple(trials[entry["number"]].values)
        assert b == pytest.approx(1e-3 * entry["params"]["field_mT"], rel=1e-9)
        better = [v for v in summary["values"] if v is not None and v[0] <= a and v[1] <= b and v != [a, b]]
        assert better == []
    for k in report.failed_trials:
        assert trials[k].values == [0.04, 0.01]
        assert summary["values"][k] is None
    assert summary["compromise"] in on_it
    assert summary["best"]["number"] == on_it[0], "the nearest to the target is the first of the front"


def test_the_dashboard_knows_the_objectives_by_name(tmp_path: Path) -> None:
    run_study(load_study(write_study(tmp_path, FIELD)), solve=solve, out=tmp_path / "out", sampler="nsga2")  # type: ignore[arg-type]
    kept = optuna.load_study(study_name="probe", storage=f"sqlite:///{tmp_path}/out/study.db")
    assert kept.metric_names == ["rms_m", "largest_field_T"]
    assert [d.name for d in kept.directions] == ["MINIMIZE", "MINIMIZE"]


@pytest.mark.parametrize("sampler", ["gp", "cmaes", "gauss-newton", "optuna:CmaEsSampler"])
def test_a_sampler_of_one_objective_is_refused_before_any_trial(sampler: str, tmp_path: Path) -> None:
    study = load_study(write_study(tmp_path, FIELD))
    with pytest.raises(InputError, match="looks for the least of one objective") as caught:
        run_study(study, solve=solve, out=tmp_path / "out", sampler=sampler)  # type: ignore[arg-type]
    assert "sampler: nsga2" in str(caught.value)
    assert not (tmp_path / "out").exists()
