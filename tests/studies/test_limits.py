"""Designs that are evaluated can be made: directions of a set, at most k different ones, by every sampler."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rod_solve import STUDY, differentiate, solve, write_study

from magmpm.scene import Scene, load_scene
from magmpm.scene.variables import variables
from magmpm.studies.engine.loop import run_study
from magmpm.studies.problem.shape_distance import gaps, root_mean_square
from magmpm.studies.rods.rod_designs import _exchanges
from magmpm.studies.search.definition import load_study
from magmpm.studies.search.parameters import Makeable
from magmpm.studies.search.search_space import SearchSpace

AXES = np.vstack([np.eye(3), -np.eye(3)])
SET = "limits: {directions: [[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1]]"


def unit(rng: np.random.Generator, n: int) -> np.ndarray:
    found = rng.normal(size=(n, 3))
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def test_a_set_gives_its_nearest_direction() -> None:
    asked = unit(np.random.default_rng(0), 20)
    made = Makeable(AXES, None).made(asked)
    assert (np.sum(made * asked, axis=1) == (asked @ AXES.T).max(axis=1)).all()


def test_at_most_of_a_set_is_the_best_of_all_subsets() -> None:
    rng = np.random.default_rng(1)
    for _ in range(10):
        asked = unit(rng, 6)
        made = Makeable(AXES, 2).made(asked)
        assert len(np.unique(made, axis=0)) <= 2
        best = max((asked @ AXES[list(pair)].T).max(axis=1).sum() for pair in itertools.combinations(range(6), 2))
        assert np.sum(made * asked) == pytest.approx(best, rel=1e-14)


@pytest.mark.parametrize("k", [1, 2, 3, 5])
def test_groups_share_the_direction_of_their_sum(k: int) -> None:
    """It is a fixed point, and near the best of all partitions (found exhaustively): the largest sum of cosines."""
    rng = np.random.default_rng(k)
    for _ in range(10):
        asked = unit(rng, 5)
        made = Makeable(None, k).made(asked)
        assert len(np.unique(np.round(made, 12), axis=0)) <= k
        np.testing.assert_allclose(np.linalg.norm(made, axis=1), 1.0, rtol=1e-14)
        np.testing.assert_allclose(Makeable(None, k).made(made), made, atol=1e-14)
        best = max(
            sum(np.linalg.norm(asked[np.array(labels) == g].sum(axis=0)) for g in set(labels))
            for labels in itertools.product(range(k), repeat=5)
        )
        assert np.sum(made * asked) >= 0.95 * best  # k-means finds a local maximum


def test_what_can_be_made_stays() -> None:
    asked = np.repeat(unit(np.random.default_rng(3), 2), 3, axis=0)
    np.testing.assert_allclose(Makeable(None, 2).made(asked), asked, atol=1e-15)
    assert Makeable(None, 6).made(asked) is asked


def test_the_derivative_is_that_of_what_is_made() -> None:
    """By differences, where no segment changes its group."""
    rng = np.random.default_rng(4)
    limits, asked = Makeable(None, 2), unit(rng, 5)
    exact = limits.derivative(asked)
    for i, j in itertools.product(range(5), range(3)):
        step = np.zeros((5, 3))
        step[i, j] = 1e-6
        difference = (limits.made(asked + step) - limits.made(asked - step)) / 2e-6
        np.testing.assert_allclose(exact[:, :, i, j], difference, atol=1e-8)


def test_the_chain_rule_goes_through_the_limits(tmp_path: Path) -> None:
    """The tip of the rod by asked directions: differences of what is made."""
    study = load_study(write_study(tmp_path, STUDY + "limits: {at_most: 2}\n"))
    space = SearchSpace.of(study)
    x = space.drawn(np.random.default_rng(5))
    scene = space.scene_at(x)
    found = differentiate(scene, ["magnetization"])
    chained = found.centreline[-1] @ space.chain(variables(scene, ["magnetization"]), x)
    for j in range(space.size):
        step = 1e-5 * np.eye(space.size)[j]
        ends = [solve(space.scene_at(x + sign * step)).centreline[-1, 1:] for sign in (1, -1)]
        np.testing.assert_allclose(chained[:, j], (ends[0] - ends[1]) / 2e-5, atol=1e-5 * np.abs(chained).max())


GAUSS_NEWTON = [("gauss-newton", limits) for limits in (SET + "}", SET + ", at_most: 2}", "limits: {at_most: 2}")]


@pytest.mark.parametrize(("sampler", "limits"), [("random", SET + ", at_most: 2}"), *GAUSS_NEWTON[1:]])
def test_every_trial_can_be_made(sampler: str, limits: str, tmp_path: Path) -> None:
    text = STUDY.replace("random", sampler) + limits + "\n"
    study = load_study(write_study(tmp_path, text))
    report = run_study(study, solve=solve, differentiate=differentiate, out=tmp_path / "out")
    import optuna

    kept = optuna.load_study(study_name=study.name, storage=f"sqlite:///{tmp_path / 'out/study.db'}")
    allowed = {tuple(row) for row in AXES.tolist()}
    for trial in kept.trials:
        made = {tuple(np.round(row, 9) + 0.0) for row in trial.user_attrs["magnetization"]}
        assert "at_most" not in limits or len(made) <= 2
        assert "directions" not in limits or made <= allowed
    scene = load_scene(tmp_path / "out/best/scene.yaml")
    np.testing.assert_allclose([region.magnetization for region in scene.regions()], report.best["magnetization"], atol=1e-8)


def test_gauss_newton_is_better_than_snapping(tmp_path: Path) -> None:
    """Against 300 random designs of the set: the search from the rod's designs finds one as near as the best of these, in 6 trials."""
    study = load_study(write_study(tmp_path, STUDY.replace("random", "gauss-newton").replace("trials: 8", "trials: 6") + SET + "}\n"))
    best = run_study(study, solve=solve, differentiate=differentiate, out=tmp_path / "out").best["rms_m"]
    space, rng = SearchSpace.of(study), np.random.default_rng(1)
    others = [root_mean_square(gaps(solve(space.scene_at(space.drawn(rng))), study.target)) for _ in range(300)]
    assert best <= min(others) + 1e-5


@pytest.mark.parametrize(("more", "field"), [("}", ""), (", at_most: 2}", ""), (", at_most: 2}", "  field: {max: 20 mT}\n")])
def test_no_single_exchange_is_better_on_the_body(more: str, field: str, tmp_path: Path) -> None:
    """The body is softer than the rod by which starts are found, so its best exchange is not the body's. A field that varies goes on."""
    def soft(scene: Scene) -> Scene:
        data = scene.to_si()
        data["materials"]["magnetic"]["shear_modulus"] *= 0.6
        return Scene.from_si(data)

    def body(scene: Scene) -> Any:
        return solve(soft(scene))

    text = STUDY.replace("trials: 8", "trials: 2").replace("{}\n", "{}\n" + field) + SET + more + "\n"
    study = load_study(write_study(tmp_path, text.replace("random", "gauss-newton" if field else "random")))
    solves = {"solve": body, "differentiate": lambda scene, of: differentiate(soft(scene), of)}
    report = run_study(study, **solves, out=tmp_path / "out")
    space = SearchSpace.of(study)
    x = space.made(space.embedded(report.best["params"]))
    others = [root_mean_square(gaps(body(space.scene_at(y)), study.target)) for y in _exchanges(space, x)]
    assert not field or report.best["rms_m"] < 0.75 * min(report.rms_m[:2]), "no exchange is better, but another field is"
    assert len(others) >= 5
    assert report.best["rms_m"] <= min(others)
    assert report.trials == 2 + report.exchanged
    assert f"{report.exchanged} exchanged single directions" in report.why
    again = run_study(study, **solves, out=tmp_path / "out")
    assert again.trials == report.trials, "nothing is left to be exchanged"
