"""gp: the model of a shape against its definition, and the search with it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import optuna
import pytest
from rod_solve import STUDY, solve, write_study

from magmpm.errors import SolveError
from magmpm.scene import Scene
from magmpm.studies.engine.loop import run_study
from magmpm.studies.search.definition import load_study
from magmpm.studies.search.samplers.gp import ShapeModel, ShapeSampler, layout_of
from magmpm.studies.search.search_space import SearchSpace

LAYOUT = layout_of([(True, 3)] * 3 + [(False, 3), (False, 1)])


def designs(n: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """n designs (n, 13) and smooth residuals of them (n, 30)."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(n, 13))
    return x, np.tanh(x @ np.random.default_rng(0).normal(size=(13, 30)) / 5) - 0.2


def test_the_model_passes_through_what_it_knows() -> None:
    x, residuals = designs(9)
    model = ShapeModel(LAYOUT, x, residuals)
    for at, known in zip(x, residuals, strict=True):
        mean, variance = model.predicted(at)
        # the noise, 1e-7 of a variance of order 1, and 1e-6 of the variance that the components leave out: 1e-3 of a size of 1
        np.testing.assert_allclose(mean, known, atol=3e-3)
        assert variance < 1e-4 * np.sum(residuals.var(axis=0))


def test_the_expected_square_is_that_of_samples_and_its_slope_is_exact() -> None:
    x, residuals = designs(12)
    model = ShapeModel(LAYOUT, x, residuals)
    at = np.random.default_rng(2).normal(size=13)
    mean, variance = model.predicted(at)
    value, slope = model.expected(at)
    assert value == pytest.approx(mean @ mean + variance, rel=1e-12)
    assert model.expected(at, caution=0.0)[0] == pytest.approx(mean @ mean, rel=1e-12)
    h = 1e-5
    found = [
        (model.expected(at + h * e)[0] - model.expected(at - h * e)[0]) / (2 * h)
        for e in np.eye(13)
    ]
    np.testing.assert_allclose(
        slope, found, atol=1e-7 * np.abs(slope).max()
    )  # h^2 times a third derivative of order 100
    # the expectation over normal components, by its definition
    scores, spread, *_ = model._at(at)
    drawn = scores + np.random.default_rng(3).normal(size=(400_000, len(scores))) * np.sqrt(
        spread * model._amplitude
    )
    squares = np.sum((drawn @ model._basis + model._mean) ** 2, axis=1)
    assert squares.mean() == pytest.approx(value, abs=5 * squares.std() / np.sqrt(len(squares)))


def test_more_designs_teach_more() -> None:
    """The error at other designs falls by far with 60 in place of 6 designs, and the variance says how large it is."""
    others, true = designs(50, seed=7)
    errors = []
    told = []
    for n in (6, 60):
        model = ShapeModel(LAYOUT, *designs(n))
        found = [model.predicted(at) for at in others]
        errors.append(
            np.mean([np.sum((mean - at) ** 2) for (mean, _), at in zip(found, true, strict=True)])
        )
        told.append(np.mean([variance for _, variance in found]))
    assert errors[1] < 0.3 * errors[0]
    assert 0.3 < told[1] / errors[1] < 3  # a model of the true spread has 1


def test_designs_alike_are_a_model_too() -> None:
    """Two equal shapes have no principal component: the search goes on all the same."""
    x, residuals = designs(2)
    model = ShapeModel(LAYOUT, x, np.tile(residuals[:1], (2, 1)))
    value, slope = model.expected(x[0])
    assert value == pytest.approx(residuals[0] @ residuals[0], rel=1e-6)
    assert np.isfinite(slope).all()


VARIED = {
    "field": "  field: {max: 10 mT}\n",
    "all": "  magnetization: {}\n  field: {max: 10 mT}\n  diameter: {min: 3 mm, max: 4 mm}\n",
}


@pytest.mark.parametrize("varied", VARIED)
def test_every_suggestion_is_a_design_and_the_search_gets_nearer(
    varied: str, tmp_path: Path
) -> None:
    """Any blocks: the parameters lie within their bounds, and the best of ten trials is well below the median of ten random ones."""
    text = (
        STUDY.replace("  magnetization: {}\n", VARIED[varied])
        .replace("trials: 8", "trials: 10")
        .replace("seed: 3", "seed: 1")
    )
    study = load_study(write_study(tmp_path, text))
    bounds = SearchSpace.of(study).bounds
    report = run_study(study, solve=solve, out=tmp_path / "gp", sampler="gp")
    others = run_study(study, solve=solve, out=tmp_path / "random", sampler="random")
    kept = optuna.load_study(study_name="probe", storage=f"sqlite:///{tmp_path}/gp/study.db")
    for trial in kept.trials:
        assert all(low <= trial.params[name] <= high for name, (low, high) in bounds.items())
    assert report.best["rms_m"] < 0.7 * np.median(others.rms_m)


def test_failed_trials_are_left_out_and_not_repeated(tmp_path: Path) -> None:
    study = load_study(write_study(tmp_path))
    calls = []

    def sometimes(scene: Scene) -> object:
        calls.append(scene.hash())
        if len(calls) % 2:
            raise SolveError("no equilibrium")
        return solve(scene)

    report = run_study(study, solve=sometimes, out=tmp_path / "out", sampler="gp")  # type: ignore[arg-type]
    assert (report.trials, report.failed) == (8, 4)
    assert len(set(calls)) == 8


def test_a_target_within_reach_is_found_in_few_trials(tmp_path: Path) -> None:
    """The shape of a known design, 3 to 15 mm from straight: within 2 mm of it in at most 25 trials.

    Random designs are within 2 mm of such a shape in one of some hundred trials."""
    study = load_study(write_study(tmp_path))
    directions = np.array([[1, 0, 0], [0.8, 0.6, 0], [0.6, 0, 0.8], [0.6, 0.8, 0], [0, 0.6, 0.8]])
    target = solve(study.scene.with_magnetizations(directions)).centreline[::4]
    near = replace(study, target=target, seed=1, stop_rms=2e-3, trials=25)
    report = run_study(near, solve=solve, out=tmp_path / "out", sampler="gp")
    assert report.ended == "stop", report.rms_m


def test_the_choice_depends_on_seed_and_trials_alone(tmp_path: Path) -> None:
    space = SearchSpace.of(load_study(write_study(tmp_path)))
    study = optuna.create_study()
    rng = np.random.default_rng(4)
    for k in range(5):
        study.sampler = ShapeSampler(space, 3, k)
        trial = study.ask(space.distributions())
        trial.set_user_attr("residuals", rng.normal(size=12).tolist())
        study.tell(trial, float(k))
    chosen = [
        ShapeSampler(space, seed, 5).sample_relative(study, study.trials[-1], space.distributions())
        for seed in (3, 3, 4)
    ]
    assert chosen[0] == chosen[1] != chosen[2]
