"""The image of a design takes the image of its shape, wherever a scene is said to have a symmetry."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pytest
from rod_solve import SCENE, STUDY, solve, write_study
from test_resume import trials_of

from magmpm.measures import rms_distance
from magmpm.scene import Scene, load_scene
from magmpm.simulate import run
from studies.definition import load_study
from studies.engine import run_study
from studies.search_space import SearchSpace
from studies.symmetry import image_distances, symmetries
from studies.tpe import DirectionTPE, Settings

GRAVITY = {"acceleration": (0.0, 3.0, 4.0)}  # m/s^2, along the field below
CASES = {
    "field across": ([0, 6e-3, 8e-3], None, 3),
    "field askew": ([4e-3, 6e-3, 8e-3], None, 1),
    "field along": ([9e-3, 0, 0], None, 3),
    "weight along the field": ([0, 6e-3, 8e-3], GRAVITY, 1),
    "weight in the plane": ([0, 6e-3, 8e-3], {"acceleration": (5.0, 3.0, 4.0)}, 1),
    "weight elsewhere": ([0, 6e-3, 8e-3], {"acceleration": (0.0, 0.0, -9.81)}, 0),
    "field along, weight across": ([9e-3, 0, 0], {"acceleration": (0.0, 0.0, -9.81)}, 1),
}


def scene_of(folder: Path, field: list[float], gravity: Any, rng: np.random.Generator) -> Scene:
    path = folder / "scene.yaml"
    path.write_text(SCENE)
    scene = load_scene(path).with_magnetizations(rng.normal(size=(5, 3))).with_field(field)
    return scene if gravity is None else scene.with_effects(gravity=gravity)


@pytest.mark.parametrize(("field", "gravity", "count"), CASES.values(), ids=CASES)
def test_images_of_designs_take_the_images_of_shapes(
    field: list[float], gravity: Any, count: int, tmp_path: Path, rng: np.random.Generator
) -> None:
    scene = scene_of(tmp_path, field, gravity, rng)
    found = symmetries(scene)
    assert len(found) == count
    directions = np.array([s.magnetization for s in scene.body.catheter.segments])
    shape = solve(scene).centreline[:, 1:]
    for symmetry in found:
        np.testing.assert_array_equal(symmetry.turn[:, 0], [1, 0, 0])
        np.testing.assert_allclose(symmetry.turn @ symmetry.turn, np.eye(3), atol=1e-15)
        image = solve(scene.with_magnetizations(symmetry.magnets(directions))).centreline[:, 1:]
        # the rod's Newton ends at about 1e-9 of its length
        np.testing.assert_allclose(image, shape @ symmetry.turn.T, rtol=0, atol=1e-8)


def test_the_solver_has_them_too(tmp_path: Path, rng: np.random.Generator) -> None:
    """To its discretisation: its grid is no mirror image of itself about this field's plane (half turns are exact)."""
    bend = [[1, 0, 0], [0.8, 0.6, 0.2], [0.6, -0.7, 0.3], [1, 0.5, 0], [0.9, 0.3, -0.3]]
    scene = scene_of(tmp_path, [0, 6e-3, 8e-3], None, rng).with_cells(2).with_magnetizations(bend)
    directions = np.array([s.magnetization for s in scene.body.catheter.segments])
    shape = run(scene).centreline[:, 1:]
    assert np.linalg.norm(shape[-1] - [0.04, 0, 0]) > 20e-3, "it moves far more than the tolerance"
    for symmetry in symmetries(scene):
        image = run(scene.with_magnetizations(symmetry.magnets(directions))).centreline[:, 1:]
        np.testing.assert_allclose(
            image, shape @ symmetry.turn.T, rtol=0, atol=3e-5
        )  # found: 1.4e-5 m, and 6e-7 at 4 cells


def test_distances_of_images_are_those_of_solves(tmp_path: Path, rng: np.random.Generator) -> None:
    study = load_study(write_study(tmp_path))
    scene = study.scene.with_magnetizations(rng.normal(size=(5, 3)))
    directions = np.array([s.magnetization for s in scene.body.catheter.segments])
    found = symmetries(scene)
    told = image_distances(solve(scene), study.target, found)  # type: ignore[arg-type]
    images = [solve(scene.with_magnetizations(s.magnets(directions))) for s in found]
    np.testing.assert_allclose(told, [rms_distance(i, study.target) for i in images], atol=1e-8)  # type: ignore[arg-type]


def test_other_effects_are_not_taken_to_be_symmetric(
    tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = scene_of(tmp_path, [0, 6e-3, 8e-3], None, rng)
    monkeypatch.setattr("studies.symmetry.EFFECTS", {"gravity"})
    assert symmetries(scene) == []


def test_fixed_magnets_have_no_images(tmp_path: Path) -> None:
    """Where only the field is varied, the image of a design is none of the study's designs."""
    text = STUDY.replace("magnetization: {}", "field: {max: 10 mT}")
    space = SearchSpace.of(load_study(write_study(tmp_path, text)))
    parameters = {"field_mT": 5.0, "field_azimuth_deg": 90.0, "field_elevation_deg": 20.0}
    assert space.images(parameters) == []


def test_tpe_learns_from_images(tmp_path: Path) -> None:
    """With images it knows four designs a trial; failed ones fail with all their images."""
    study = load_study(write_study(tmp_path, STUDY.replace("random", "tpe")))
    run_study(study, solve=solve, out=tmp_path / "out", trials=3)  # type: ignore[arg-type]
    trials, space = trials_of(tmp_path / "out"), SearchSpace.of(study)
    tpe = DirectionTPE(space, seed=1, finished=3)
    designs, values = tpe._read(trials)
    assert len(designs) == len(values) == 12
    for design, value in zip(designs.directions, values, strict=True):
        again = rms_distance(solve(study.scene.with_magnetizations(design)), study.target)  # type: ignore[arg-type]
        assert value == pytest.approx(again, abs=1e-8)
    alone = DirectionTPE(space, seed=1, finished=3, settings=Settings(images=False))
    assert len(alone._read(trials)[0]) == 3
    failed = optuna.trial.create_trial(
        params=trials[0].params,
        distributions=trials[0].distributions,
        value=0.04,
        user_attrs={"feasible": False},
    )
    np.testing.assert_array_equal(tpe._read([failed])[1], [0.04] * 4)
