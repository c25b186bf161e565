"""Blocks of a design: parameters and embedded coordinates agree, scenes have the values, the chain rule is that of the scenes made."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rod_solve import SCENE, STUDY, solve, write_study

from magmpm.rod.cosserat import solve_rod
from magmpm.scene import Scene, load_scene
from magmpm.scene.variables import variables
from magmpm.studies.engine.loop import run_study
from magmpm.studies.problem.shape_distance import gaps, root_mean_square
from magmpm.studies.search.definition import load_study
from magmpm.studies.search.scene_edits import kept_total, orders
from magmpm.studies.search.search_space import SearchSpace

PLAIN = "  plain: {shear_modulus: 60 kPa, bulk_to_shear: 20}\nbody:"
MIXED = (
    SCENE.replace("body:", PLAIN)
    .replace("      - magnetization: [0, 1, 0]\n", "      - {material: plain}\n")
    .replace("      - magnetization: [0, 0, -1]\n", "      - {material: plain, length: 6 mm}\n")
)
EVERYTHING = (
    "{magnetization: {}, field: {max: 10 mT}, length: {min: 4 mm, max: 12 mm, total: %s}, diameter: {min: 3 mm, max: 5 mm}, "
    "remanence: {min: 50 mT, max: 200 mT, per: %s}, shear_modulus: {min: 60 kPa, max: 300 kPa, per: %s}, order: {}}"
)


def study_of(vary: str) -> str:
    return STUDY.replace("\n  magnetization: {}", f" {vary}")


def space_of(folder: Path, total: str = "keep", per: str = "segment") -> SearchSpace:
    return SearchSpace.of(load_study(write_study(folder, study_of(EVERYTHING % (total, per, per)), MIXED)))


def tip(scene: Scene) -> np.ndarray:
    return solve_rod(scene, 60).position[-1]


@pytest.mark.parametrize(("total", "per"), [("keep", "segment"), ("free", "material"), ("keep", "material")])
def test_the_chain_rule_is_the_derivative_of_the_scenes(total: str, per: str, tmp_path: Path) -> None:
    """Columns of the scene's variables times the chain, against central differences along the embedded coordinates; both of the rod's tip.

    Steps of 1e-5 of a range: differences are good to 1e-10 / 1e-5 = 1e-5 of the largest derivative of a block, here of 1.
    """
    space, rng = space_of(tmp_path, total, per), np.random.default_rng(5)
    x, order = space.drawn(rng), "PMMPM"
    scene = space.scene_at(x, order)
    found = variables(scene, space.sensitivities)
    step = {"rad": 1e-4, "T": 1e-6, "m": 1e-6, "Pa": 10.0}
    pairs = [[tip(v.changed(scene, sign * step[v.unit])) for sign in (1, -1)] for v in found]
    columns = np.stack([(plus - minus) / (2 * step[v.unit]) for (plus, minus), v in zip(pairs, found, strict=True)], 1)
    chained = columns @ space.chain(found, x, order)
    for block, at in zip(space.blocks, space.slices, strict=True):
        largest = np.abs(chained[:, at]).max(initial=0.0)
        for j in range(at.start, at.stop):
            h = 1e-7 if block.bounds().keys() & {"field_mT"} else 1e-5
            step_j = h * np.eye(space.size)[j]
            difference = (tip(space.scene_at(x + step_j, order)) - tip(space.scene_at(x - step_j, order))) / (2 * h)
            np.testing.assert_allclose(chained[:, j], difference, atol=1e-5 * largest, err_msg=f"{block}")


@pytest.mark.parametrize("total", ["keep", "free"])
def test_parameters_and_coordinates_are_inverse(total: str, tmp_path: Path) -> None:
    space, rng = space_of(tmp_path, total), np.random.default_rng(1)
    assert space.size == 3 * 3 + 3 + 5 + 1 + 3 + 5
    assert space.freedom == 3 * 2 + 3 + 5 + 1 + 3 + 5 - (total == "keep")
    for _ in range(20):
        x = space.drawn(rng)
        parameters = space.parameters_at(x, "MMMPP")
        assert set(parameters) == set(space.distributions())
        assert all(space.distributions()[name]._contains(space.distributions()[name].to_internal_repr(v)) for name, v in parameters.items())
        np.testing.assert_allclose(space.embedded(parameters), x, atol=1e-12)  # rounding of angles
        again = space.parameters(*space.design(parameters))
        np.testing.assert_allclose(space.embedded(again), x, atol=1e-12)


def test_a_scene_has_the_values_of_its_design(tmp_path: Path) -> None:
    space = space_of(tmp_path, "free")
    x = space.drawn(np.random.default_rng(2))
    parameters = space.parameters_at(x, "PPMMM")
    scene = space.scene_of(parameters)
    assert 1e3 * scene.thickness == pytest.approx(parameters["diameter_mm"], rel=1e-14)
    lengths = [parameters[f"segment_{i}_length_mm"] for i in (2, 5, 1, 3, 4)]  # the plain ones, 2 and 5, are first
    assert scene.body.shape.segment_lengths() == pytest.approx([1e-3 * length for length in lengths], rel=1e-14)
    assert scene.length == pytest.approx(1e-3 * sum(lengths), rel=1e-14)
    known = space.quantities(parameters)
    assert known["segment_lengths_m"] == pytest.approx(scene.body.shape.segment_lengths(), rel=1e-14)
    for i, piece in enumerate((2, 5, 1, 3, 4)):
        material = scene.region_material(i)
        assert 1e-3 * material.shear_modulus == pytest.approx(parameters[f"segment_{piece}_shear_modulus_kPa"], rel=1e-14)
        if piece not in (2, 5):
            assert 1e3 * material.remanence == pytest.approx(parameters[f"segment_{piece}_remanence_mT"], rel=1e-14)
    assert scene.magnetized_regions() == [2, 3, 4]
    np.testing.assert_allclose(space.directions(parameters), [r.magnetization for r in scene.regions()], atol=1e-15)


def test_values_per_material_are_shared(tmp_path: Path) -> None:
    space = space_of(tmp_path, per="material")
    assert {"remanence_of_magnetic_mT", "shear_modulus_of_magnetic_kPa", "shear_modulus_of_plain_kPa"} <= set(space.bounds)
    scene = space.scene_at(space.drawn(np.random.default_rng(2)))
    assert set(scene.materials) == {"magnetic", "plain"}


def test_kept_lengths_are_the_nearest_that_sum(tmp_path: Path) -> None:
    """A projection: sum and bounds hold, what obeys both stays, and the error is across all that does (the variational inequality)."""
    rng = np.random.default_rng(3)
    low, high, total = 4.0, 12.0, 40.0
    for _ in range(50):
        asked = rng.uniform(low, high, 5)
        found, derivative = kept_total(asked, low, high, total)
        assert found.sum() == pytest.approx(total, rel=1e-14)
        assert (found >= low).all()
        assert (found <= high).all()
        np.testing.assert_allclose(kept_total(found, low, high, total)[0], found, rtol=1e-14)
        other, _ = kept_total(rng.uniform(low, high, 5), low, high, total)
        assert (asked - found) @ (other - found) <= 1e-12
        np.testing.assert_allclose(derivative.sum(axis=0), 0.0, atol=1e-15)
        step = 1e-6 * rng.normal(size=5)
        np.testing.assert_allclose(kept_total(asked + step, low, high, total)[0], found + derivative @ step, atol=1e-12)


def test_orders_are_all_ways_to_place_the_magnets(tmp_path: Path) -> None:
    space = space_of(tmp_path)
    assert len(orders(space.scene)) == len(set(orders(space.scene))) == 10  # 3 of 5 places
    assert orders(space.scene, own=True) == ("MPMMP",)
    same, own = space.scene_at(x := space.drawn(np.random.default_rng(0)), "MPMMP"), space.scene_at(x)
    assert same.hash() == own.hash()


def test_a_body_that_is_shorter_than_its_target_is_compared_with_its_tip(tmp_path: Path) -> None:
    """So that it gains nothing by being short: a straight body of half the length along a straight target."""
    scene = load_scene(write_study(tmp_path).parent / "scene.yaml").with_field([0, 0, 0])
    data = scene.to_si()
    data["body"]["catheter"]["length"] = 0.02
    s = np.linspace(0.0, 0.04, 41)
    target = np.column_stack([s, s, 0 * s, 0 * s])
    apart = gaps(solve(Scene.from_si(data)), target)
    np.testing.assert_allclose(apart[:, 0], np.minimum(s, 0.02) - s, atol=1e-9)
    assert root_mean_square(gaps(solve(scene), target)) < 1e-9


@pytest.mark.parametrize("sampler", ["random", "tpe"])
def test_a_study_of_everything_writes_its_best_design(sampler: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also its report has the values; the file is a scene with units that has the trial's rms."""
    text = study_of(EVERYTHING % ("keep", "segment", "segment")).replace("random", sampler)
    path = write_study(tmp_path, text, MIXED)
    report = run_study(load_study(path), solve=solve, out=tmp_path / "out")
    monkeypatch.chdir("/")
    scene = load_scene(tmp_path / "out/best/scene.yaml")
    assert scene.length == 0.04
    assert report.best["segment_lengths_m"] == pytest.approx(scene.body.shape.segment_lengths(), rel=1e-9)
    assert report.best["diameter_m"] == pytest.approx(scene.thickness, rel=1e-12)
    rms = root_mean_square(gaps(solve(scene), load_study(path).target))
    assert rms == pytest.approx(report.best["rms_m"], rel=1e-9)  # 15 digits are written


def test_tpe_returns_to_good_orders(tmp_path: Path) -> None:
    """Nine of ten orders can't reach a target made with the tenth: the good order is chosen more often than the tenth part of trials."""
    text = study_of("{magnetization: {}, order: {}}").replace("random", "tpe").replace("trials: 8", "trials: 40")
    path = write_study(tmp_path, text, MIXED)
    study = load_study(path)
    report = run_study(study, solve=solve, out=tmp_path / "out")
    import optuna

    kept = optuna.load_study(study_name=study.name, storage=f"sqlite:///{tmp_path / 'out/study.db'}")
    chosen = [trial.params["order"] for trial in kept.trials[10:]]
    assert chosen.count(report.best["params"]["order"]) > len(chosen) / 10
