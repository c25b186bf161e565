"""Parameters and their designs, and the choices of TPE."""

from pathlib import Path

import numpy as np
import optuna
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rod_solve import SCENE, STUDY, write_study

from magmpm.compiled.arrays import Array
from magmpm.scene import Scene
from magmpm.studies.search.definition import load_study
from magmpm.studies.search.samplers.blocks import Direction
from magmpm.studies.search.samplers.choice import make_sampler
from magmpm.studies.search.samplers.tpe import Designs, DirectionTPE, TpeSettings
from magmpm.studies.search.search_space import SearchSpace

ANGLES = Direction("around", "along")
FIELD = STUDY.replace("magnetization: {}", "magnetization: {}\n  field: {max: 10 mT}")


def space_of(folder: Path, text: str = STUDY, scene: str | None = None) -> SearchSpace:
    return SearchSpace.of(load_study(write_study(folder, text, scene)))


def direction(around: float, along: float) -> Array:
    """The unit vector of two angles, degrees."""
    return ANGLES.read({"around": around, "along": along})


def test_angles_mean_what_they_are_called() -> None:
    """`along` raises toward the tip (+x); `around` rotates about the axis, from +y toward +z."""
    tight = {"rtol": 0, "atol": 1e-15}  # rounding of sines and cosines
    np.testing.assert_allclose(direction(around=0, along=0), [0, 1, 0], **tight)
    np.testing.assert_allclose(direction(around=90, along=0), [0, 0, 1], **tight)
    np.testing.assert_allclose(direction(around=123, along=90), [1, 0, 0], **tight)
    np.testing.assert_allclose(
        direction(around=0, along=-45), [-np.sqrt(0.5), np.sqrt(0.5), 0], **tight
    )


@given(around=st.floats(-180, 180), along=st.floats(-89.9, 89.9))
def test_angles_and_directions_are_inverse(around: float, along: float) -> None:
    vector = direction(around, along)
    assert np.linalg.norm(vector) == pytest.approx(1, abs=1e-15)
    # at a tenth of a degree from the pole, rounding errors of the vector are 600 times larger in the azimuth
    np.testing.assert_allclose(ANGLES.read(ANGLES.write(vector)), vector, rtol=0, atol=1e-12)


def test_two_angles_a_magnetised_segment_and_none_for_others(tmp_path: Path) -> None:
    space = space_of(tmp_path, scene=SCENE.replace("[-1, 0, 0.5]", "[0, 0, 0]"))  # the fourth
    assert list(space.bounds) == [
        f"segment_{n}_{a}_deg" for n in (1, 2, 3, 5) for a in ("around", "along")
    ]
    parameters = {name: 10.0 * k for k, name in enumerate(space.bounds)}
    found = space.directions(parameters)
    np.testing.assert_array_equal(found[3], [0, 0, 0])
    np.testing.assert_allclose(found[4], direction(60.0, 70.0))
    scene = space.scene_of(parameters)
    np.testing.assert_allclose(
        [s.magnetization for s in scene.body.catheter.segments], found, atol=1e-15
    )
    assert scene.field == space.scene.field


def test_a_varied_field_never_exceeds_its_limit(tmp_path: Path, rng: np.random.Generator) -> None:
    space = space_of(tmp_path, FIELD)
    assert list(space.bounds)[-3:] == ["field_mT", "field_azimuth_deg", "field_elevation_deg"]
    for _ in range(50):
        parameters = {name: rng.uniform(low, high) for name, (low, high) in space.bounds.items()}
        field = space.scene_of(parameters).field.uniform
        assert np.linalg.norm(field) == pytest.approx(1e-3 * parameters["field_mT"], rel=1e-12)
        assert np.linalg.norm(field) <= 10e-3 * (1 + 1e-12)
    parameters.update({"field_mT": 8.0, "field_azimuth_deg": 90.0, "field_elevation_deg": 0.0})
    np.testing.assert_allclose(space.field(parameters), [0, 8e-3, 0], atol=1e-17)


def test_only_the_field_can_be_varied(tmp_path: Path) -> None:
    space = space_of(tmp_path, STUDY.replace("magnetization: {}", "field: {max: 10 mT}"))
    assert list(space.bounds) == ["field_mT", "field_azimuth_deg", "field_elevation_deg"]
    parameters = {"field_mT": 5.0, "field_azimuth_deg": 0.0, "field_elevation_deg": 90.0}
    scene = space.scene_of(parameters)
    assert [s.magnetization for s in scene.body.catheter.segments] == [
        s.magnetization for s in space.scene.body.catheter.segments
    ]


def test_names_sort_from_base_to_tip(tmp_path: Path) -> None:
    data = space_of(tmp_path).scene.to_si()
    data["body"]["catheter"]["segments"] *= 3
    space = SearchSpace(scene=Scene.from_si(data), segments=tuple(range(15)), field_max=None)
    assert space.segment_names()[0] == "segment_01"
    assert space.segment_names() == sorted(space.segment_names())


# TPE


def test_tpe_begins_with_four_bends_that_surround_the_catheter(tmp_path: Path) -> None:
    """All segments equal, toward the corners of a regular tetrahedron: their sum is zero, and each pair is 109.5 degrees apart."""
    space = space_of(tmp_path)
    corners = []
    study = optuna.create_study()
    for k in range(4):
        study.sampler = make_sampler("tpe", space, 3, k)
        trial = study.ask(space.distributions())
        directions, _ = space.design(trial.params)
        assert np.ptp(directions, axis=0).max() < 1e-12
        corners.append(directions[0])
        study.tell(trial, k)
    np.testing.assert_allclose(np.sum(corners, axis=0), 0, atol=1e-12)
    np.testing.assert_allclose(
        np.array(corners) @ np.array(corners).T, np.eye(4) * 4 / 3 - 1 / 3, atol=1e-12
    )


@pytest.mark.parametrize("text", [STUDY, FIELD], ids=["magnetisation", "and field"])
def test_tpe_stays_in_bounds_and_gathers_about_good_designs(
    text: str, tmp_path: Path, rng: np.random.Generator
) -> None:
    """For a smooth objective over directions, the designs of later trials are far nearer to its minimum than random ones."""
    space = space_of(tmp_path, text)
    goal, _ = space.design(
        {name: rng.uniform(low, high) for name, (low, high) in space.bounds.items()}
    )
    study = optuna.create_study()
    values = []
    for k in range(60):
        study.sampler = make_sampler("tpe", space, 1, k)
        trial = study.ask(space.distributions())
        assert all(low <= trial.params[name] <= high for name, (low, high) in space.bounds.items())
        directions, _ = space.design(trial.params)
        values.append(
            float(np.mean(1 - np.sum(directions * goal, axis=1)))
        )  # random designs: mean 1
        study.tell(trial, values[-1])
    # with 5 or 6 directions the value of a random design is 1 +- 0.25, so 0.5 is two standard deviations away
    assert np.mean(values[-20:]) < 0.5


def test_tpe_sees_that_angles_go_round(tmp_path: Path) -> None:
    """The density of designs is continuous across +-180 degrees, and does not depend on the azimuth at the poles."""
    space = space_of(tmp_path)
    tpe = DirectionTPE(space, seed=1, finished=9)

    def at(around: float, along: float) -> Designs:
        return Designs(np.tile(direction(around, along), (1, 5, 1)), np.zeros((1, 0)))

    of = at(179.0, 20.0)
    assert tpe._density(at(-179.0, 20.0), of, 1.0) == pytest.approx(
        tpe._density(at(177.0, 20.0), of, 1.0)
    )
    pole = at(0.0, 90.0)
    assert tpe._density(at(10.0, 80.0), pole, 1.0) == pytest.approx(
        tpe._density(at(130.0, 80.0), pole, 1.0)
    )


def test_tpe_kernels_are_normalised_and_drawn_from(tmp_path: Path) -> None:
    """Relative to uniform, the density of one direction averages to 1 over the sphere; drawn cosines have its mean."""
    space = SearchSpace(scene=space_of(tmp_path).scene, segments=(0,), field_max=None)
    settings = TpeSettings(candidates=20_000, prior=1e-9)
    tpe = DirectionTPE(space, seed=1, finished=9, settings=settings)
    of = Designs(np.array([[[0.0, 0.6, 0.8]]]), np.zeros((1, 0)))
    sphere = np.random.default_rng(1).normal(size=(40_000, 1, 3))
    sphere /= np.linalg.norm(sphere, axis=2, keepdims=True)
    mean = np.exp(tpe._density(Designs(sphere, np.zeros((40_000, 0))), of, 1.0)).mean()
    # the standard deviation of the density over the sphere is about sqrt(K/2 - 1) = 2, so that of the mean is 0.01
    assert mean == pytest.approx(1, abs=0.04)
    drawn = tpe._draw(of, 1.0).directions @ of.directions[0, 0]
    K = settings.concentration
    # the mean cosine of the von Mises-Fisher density; its standard deviation is 1/K, so that of the mean is below 1e-3
    assert drawn.mean() == pytest.approx(1 / np.tanh(K) - 1 / K, abs=4e-3)


def test_another_seed_makes_tpe_choose_otherwise_in_each_of_its_stages(tmp_path: Path) -> None:
    """The first four trials are a tetrahedron turned by the study's seed alone; later draws depend on the finished trials too."""
    space = space_of(tmp_path, FIELD)
    of = Designs(np.tile([1.0, 0.0, 0.0], (3, 6, 1)), np.full((3, 1), 0.5))
    corners = {}
    chosen = {}
    for seed in (1, 2):
        for finished in (0, 1):
            tpe = DirectionTPE(space, seed, finished)
            corners[seed, finished] = tpe._alike(finished)[0][
                :5
            ]  # of the segments; the field is drawn
            chosen[seed, finished] = DirectionTPE(space, seed, finished).choose(of, of).directions
    for seed in (1, 2):
        first = corners[seed, 0]
        second = corners[seed, 1]
        np.testing.assert_array_equal(first, np.tile(first[0], (5, 1)))
        assert first[0] @ second[0] == pytest.approx(-1 / 3, abs=1e-12), (
            "two corners of one tetrahedron"
        )
        assert np.abs(chosen[seed, 0] - chosen[seed, 1]).max() > 0.01
    assert np.abs(corners[1, 0] - corners[2, 0]).max() > 0.01
    assert np.abs(chosen[1, 0] - chosen[2, 0]).max() > 0.01


def test_tpe_copes_with_no_candidate_from_the_prior(tmp_path: Path) -> None:
    space = space_of(tmp_path, FIELD)
    tpe = DirectionTPE(space, seed=1, finished=9, settings=TpeSettings(prior=1e-12))
    of = Designs(np.tile([1.0, 0.0, 0.0], (1, 6, 1)), np.full((1, 1), 0.5))
    chosen = tpe.choose(of, of)
    np.testing.assert_allclose(np.linalg.norm(chosen.directions, axis=2), 1, rtol=1e-12)
    assert 0 <= chosen.numbers[0, 0] <= 1
