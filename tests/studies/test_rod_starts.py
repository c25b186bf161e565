"""Designs that the rod finds, and studies that begin with them."""

from pathlib import Path

import numpy as np
import pytest
from rod_solve import SCENE, STUDY, differentiate, solve, write_study
from test_resume import kill_in_trial, same, trials_of

from magmpm.compiled.arrays import Array
from magmpm.rod.cosserat import solve_rod
from magmpm.scene import Scene
from magmpm.studies.engine.loop import run_study
from magmpm.studies.rods.rod_designs import RodDesign, rod_designs
from magmpm.studies.search.definition import load_study
from magmpm.studies.search.search_space import SearchSpace

FIELD = STUDY.replace("magnetization: {}", "magnetization: {}\n  field: {max: 10 mT}")
START = STUDY + "start: rod\n"


def scene_of(folder: Path, scene: str = SCENE) -> Scene:
    return load_study(write_study(folder, scene=scene)).scene


def shape_of(scene: Scene, stations: int = 21) -> Array:
    """The rod's own shape, as a target that can be reached exactly."""
    s = np.linspace(0, scene.length, stations)
    return np.column_stack([s, solve_rod(scene).at(s)])


def rms(design: RodDesign, scene: Scene, regions: list[int], target: Array) -> float:
    every = np.array([region.magnetization for region in scene.regions()], dtype=float)
    every[regions] = design.directions
    shape = solve_rod(scene.with_magnetizations(every).with_field(design.field))
    return float(np.sqrt(np.mean(np.sum((shape.at(target[:, 0]) - target[:, 1:]) ** 2, axis=1))))


@pytest.mark.parametrize("seed", range(4))
def test_shapes_of_rods_are_found_again(seed: int, tmp_path: Path) -> None:
    """A target that a random design makes: the best design is within 0.3 % of the length, and its rms is what solve_rod says."""
    rng = np.random.default_rng(seed)
    scene = scene_of(tmp_path)
    if seed % 2:
        scene = scene.with_effects(gravity={})
    target = shape_of(scene.with_magnetizations(rng.normal(size=(5, 3))))
    found = rod_designs(scene, target, range(5), None, seed=seed)
    assert found[0].rms < 3e-3 * scene.length
    assert [d.rms for d in found] == sorted(d.rms for d in found)
    np.testing.assert_array_equal(found[0].field, scene.field.uniform)
    np.testing.assert_allclose([np.linalg.norm(d.directions, axis=1) for d in found], 1, rtol=0, atol=1e-12)
    assert found[0].rms == pytest.approx(rms(found[0], scene, [0, 1, 2, 3, 4], target), rel=1e-9)
    assert all(np.abs(a.directions - b.directions).max() > 0.1 for i, a in enumerate(found) for b in found[:i])


def test_a_varied_field_stays_within_its_bound_and_plain_segments_plain(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, SCENE.replace("[0, 0, 1]", "[0, 0, 0]"))
    regions = [0, 1, 3, 4]
    rng = np.random.default_rng(5)
    every = rng.normal(size=(5, 3))
    every[2] = 0
    target = shape_of(scene.with_magnetizations(every).with_field([3e-3, -6e-3, 5e-3]))
    found = rod_designs(scene, target, regions, 10e-3, seed=1)
    assert all(d.directions.shape == (4, 3) for d in found)
    assert max(np.linalg.norm(d.field) for d in found) <= 10e-3 * (1 + 1e-12)
    assert found[0].rms < 3e-3 * scene.length
    assert found[0].rms == pytest.approx(rms(found[0], scene, regions, target), rel=1e-9)


def test_a_field_that_varies_in_space_is_taken_where_the_body_shall_be(tmp_path: Path) -> None:
    """A magnet beside the tip: designs found in the field along the target are nearly right in the field where the rod then is."""
    dipole = "field: {uniform: [0 mT, 6 mT, 8 mT], dipole: {position: [50 mm, 60 mm, 0 mm], moment: [0 A m^2, 6 A m^2, 0 A m^2]}}"
    text = SCENE.replace("field: {uniform: [0 mT, 6 mT, 8 mT]}", dipole)
    text = text.replace("magnetic_torque: {}", "magnetic_torque: {}, magnetic_force: {}")
    scene = scene_of(tmp_path, text)
    target = shape_of(scene.with_magnetizations(np.random.default_rng(3).normal(size=(5, 3))))
    found = rod_designs(scene, target, range(5), None, seed=1)
    assert found[0].rms < 3e-3 * scene.length


def test_the_same_seed_gives_the_same_designs(tmp_path: Path) -> None:
    scene = scene_of(tmp_path)
    target = shape_of(scene)
    one, same_seed, other = (rod_designs(scene, target, range(5), None, seed=s, starts=16) for s in (1, 1, 2))
    assert [d.directions.tolist() for d in one] == [d.directions.tolist() for d in same_seed]
    assert one[0].directions.tolist() != other[0].directions.tolist()


def test_studies_begin_with_them_and_say_so(tmp_path: Path) -> None:
    report = run_study(load_study(write_study(tmp_path, START)), solve=solve, out=tmp_path / "out", sampler="random")
    plain = run_study(load_study(write_study(tmp_path / "plain")), solve=solve, out=tmp_path / "plain/out", sampler="random")
    trials = trials_of(tmp_path / "out")
    begun = [t for t in trials if t.user_attrs.get("start") == "rod"]
    assert [t.number for t in begun] == list(range(len(begun)))
    assert 1 <= len(begun) <= 6
    assert max(t.value for t in begun) < 0.05 * 0.04, "the tests' solve is a rod, a coarser one"
    assert report.trials == plain.trials == 8
    rest = [t.params for t in trials[len(begun) :]]
    assert rest == [t.params for t in trials_of(tmp_path / "plain" / "out")[len(begun) :]], "the others are those of the sampler"


def test_parameters_stand_for_the_designs(tmp_path: Path) -> None:
    study = load_study(write_study(tmp_path, FIELD + "start: rod\n"))
    run_study(study, solve=solve, out=tmp_path / "out", sampler="random", trials=1)
    space = SearchSpace.of(study)
    found = rod_designs(study.scene, study.target, range(5), 10e-3, seed=study.seed)
    params = trials_of(tmp_path / "out")[0].params
    # the study's search begins from other directions, whose rounding 30 steps have made larger
    np.testing.assert_allclose(space.directions(params), found[0].directions, rtol=0, atol=1e-6)
    np.testing.assert_allclose(space.field(params), found[0].field, rtol=0, atol=1e-8)


@pytest.mark.parametrize("sampler", ["tpe", pytest.param("gauss-newton", marks=pytest.mark.slow)])
def test_killed_among_its_starts_it_resumes_as_the_same_study(sampler: str, tmp_path: Path) -> None:
    path = write_study(tmp_path, START)
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    run_study(load_study(path), solve=solve, differentiate=differentiate, out=whole, sampler=sampler)
    kill_in_trial(path, parts, sampler, 2, "solve")
    kill_in_trial(path, parts, sampler, 1, "tell")
    run_study(load_study(path), solve=solve, differentiate=differentiate, out=parts, sampler=sampler)
    same(trials_of(whole), trials_of(parts))
