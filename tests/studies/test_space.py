"""Blocks of a design: parameters and embedded coordinates agree, scenes have the values, the chain rule is that of the scenes made."""

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rod_solve import SCENE, STUDY, differentiate, solve, write_study

import magmpm
from magmpm.errors import InputError
from magmpm.rod.cosserat import solve_rod
from magmpm.scene import Scene, load_scene
from magmpm.scene.variables import variables
from magmpm.studies.engine.loop import run_study
from magmpm.studies.problem.shape_distance import gaps, root_mean_square
from magmpm.studies.rods.exchanges import _exchanges
from magmpm.studies.search.best_scene import as_yaml, moved_content
from magmpm.studies.search.definition import load_study
from magmpm.studies.search.parameters import Makeable
from magmpm.studies.search.samplers.choice import check_suits
from magmpm.studies.search.scene_edits import kept_total, orders
from magmpm.studies.search.search_space import SearchSpace, numbers_space

PLAIN = "  plain: {shear_modulus: 60 kPa, bulk_to_shear: 20}\nbody:"
MIXED = (
    SCENE.replace("body:", PLAIN)
    .replace("      - magnetization: [0, 1, 0]\n", "      - {material: plain}\n")
    .replace("      - magnetization: [0, 0, -1]\n", "      - {material: plain, length: 6 mm}\n")
)
EVERYTHING = (
    "{magnetization: {}, field: {max: 10 mT}, length: {min: 4 mm, max: 12 mm, total: %s}, diameter:"
    " {min: 3 mm, max: 5 mm}, remanence: {min: 50 mT, max: 200 mT, per: %s}, shear_modulus: {min:"
    " 60 kPa, max: 300 kPa, per: %s}, order: {}}"
)


def study_of(vary: str) -> str:
    return STUDY.replace("\n  magnetization: {}", f" {vary}")


def space_of(
    folder: Path, total: str = "keep", per: str = "segment", scene: str = MIXED
) -> SearchSpace:
    text = study_of(EVERYTHING % (total, per, per))
    return SearchSpace.of(load_study(write_study(folder, text, scene)))


def tip(scene: Scene) -> np.ndarray:
    return solve_rod(scene, 60).position[-1]


@pytest.mark.parametrize(
    ("total", "per"), [("keep", "segment"), ("free", "material"), ("keep", "material")]
)
def test_the_chain_rule_is_the_derivative_of_the_scenes(
    total: str, per: str, tmp_path: Path
) -> None:
    """Columns of the scene's variables times the chain, against central differences along the embedded coordinates; both of the rod's tip.

    Steps of 1e-5 of a range: differences are good to 1e-10 / 1e-5 = 1e-5 of the largest derivative of a block, here of 1.
    """
    plain = "      - {material: plain, length: 6 mm}\n"
    magnetized_tip = MIXED.replace(plain, "").replace("    segments:\n", "    segments:\n" + plain)
    space = space_of(tmp_path, total, per, magnetized_tip)
    assert space.segment_names() == ["segment_2", "segment_4", "segment_5"]
    assert_chain(space)


def assert_chain(space: SearchSpace) -> None:
    rng = np.random.default_rng(5)
    x = space.drawn(rng)
    scene = space.scene_at(x)
    found = variables(scene, space.sensitivities)
    step = {"rad": 1e-4, "T": 1e-6, "m": 1e-6, "Pa": 10.0, "m/s^2": 1e-3, "1": 1e-4}
    pairs = [[tip(v.changed(scene, sign * step[v.unit])) for sign in (1, -1)] for v in found]
    columns = np.stack(
        [
            (plus - minus) / (2 * step[v.unit])
            for (plus, minus), v in zip(pairs, found, strict=True)
        ],
        1,
    )
    chained = columns @ space.chain(found, x)
    for block, at in space.parts:
        largest = np.abs(chained[:, at]).max(initial=0.0)
        for j in range(at.start, at.stop):
            h = 1e-7 if block.bounds().keys() & {"field_mT"} else 1e-5
            step_j = h * np.eye(space.size)[j]
            difference = (tip(space.scene_at(x + step_j)) - tip(space.scene_at(x - step_j))) / (
                2 * h
            )
            np.testing.assert_allclose(
                chained[:, j], difference, atol=1e-5 * largest, err_msg=f"{block}"
            )


NUMBERS = """\
  numbers:
    - {of: "effects.gravity.acceleration[1]", min: -5 m/s^2, max: 5 m/s^2}
    - {of: [materials.magnetic.shear_modulus, materials.plain.shear_modulus], min: 60 kPa, max: 300 kPa, log: true}
    - {of: "field.uniform[2]", min: 0 mT, max: 10 mT}
"""
WEIGHTY = MIXED.replace(
    "kPa, bulk_to_shear: 20}", "kPa, bulk_to_shear: 20, density: 1100 kg/m^3}"
).replace("magnetic_torque: {}", "magnetic_torque: {}, gravity: {}")


def test_the_chain_rule_of_numbers_by_address(tmp_path: Path) -> None:
    """Weight, two moduli that share a value, and a component of the field; with directions."""
    text = STUDY.replace("  magnetization: {}\n", "  magnetization: {}\n" + NUMBERS)
    space = SearchSpace.of(load_study(write_study(tmp_path, text, WEIGHTY)))
    assert [number.ends[0] for number in space.numbers_within] == pytest.approx([-5.0, 60e3, 0.0])
    assert_chain(space)


TURNED = """\
  magnetization: {only: [segment 1]}
  numbers:
    - {of: "body.catheter.segments[2].magnetization", direction: {}}
    - {of: ["body.catheter.segments[1].magnetization", "body.catheter.segments[3].magnetization"], direction: {}, turned_about: [1, 0, 0]}
    - {of: "body.catheter.segments[4].magnetization", direction: {across: [0, 1, 0], at_most: 60 deg}}
    - {of: field.uniform, within: 10 mT}
"""


@pytest.mark.parametrize(
    "within", ["within: 10 mT", "within: 10 mT, direction: {across: [0, 1, 0]}"]
)
def test_the_chain_rule_of_directions_by_address(within: str, tmp_path: Path) -> None:
    """Free, tied around an axis, in a plane; and a vector in a ball or a disk: by differences of the rod's tip."""
    text = STUDY.replace("  magnetization: {}\n", TURNED.replace("within: 10 mT", within))
    space = SearchSpace.of(load_study(write_study(tmp_path, text)))
    assert space.freedom == 2 + 2 + 2 + 1 + (3 if within == "within: 10 mT" else 2)
    assert_chain(space)


def test_directions_by_address_are_those_of_their_words(tmp_path: Path) -> None:
    """The body's Gauss-Newton steps to a target are the same in number and near it, whichever word says what turns."""
    found = []
    for name, vary in (
        ("words", "{magnetization: {}, field: {max: 10 mT}}"),
        (
            "addresses",
            "{numbers: [{of: 'body.catheter.segments[*].magnetization', direction: {}}, {of: field.uniform, within: 10 mT}]}",
        ),
    ):
        text = study_of(vary).replace("sampler: random\n", "").replace("trials: 8", "trials: 6")
        path = write_study(
            tmp_path / name, text, SCENE.replace("cells_across: 4", "cells_across: 2")
        )
        assert load_study(path).sampler == "gauss-newton"
        found.append(magmpm.design(path, folder=tmp_path / name / "out", progress=False))
        scene = load_scene(tmp_path / name / "out/best/scene.yaml")
        assert np.linalg.norm(scene.field.uniform) <= 10e-3 * (1 + 1e-12)
    assert found[1].best["rms_m"] < 0.3 * found[1].rms_m[0]


CHOSEN = """{numbers: [{of: materials.magnetic.remanence, choices: [100 mT, 200 mT]},
    {of: effects.gravity, choices: [null, {}]}, {of: body.catheter.diameter, choices: [3 mm, 4 mm]},
    {of: resolution.cells_across, min: 3, max: 5}, {of: 'field.uniform[2]', min: 1 mT, max: 8 mT, log: true}]}"""


@pytest.mark.parametrize("sampler", ["tpe", "random", "nsga2"])
def test_values_are_chosen_by_address(sampler: str, tmp_path: Path) -> None:
    """A value, an effect or none, a size of the body, a whole number; the file of the best design is its scene."""
    path = write_study(tmp_path, study_of(CHOSEN).replace("random", sampler))
    study = load_study(path)
    report = run_study(study, solve=solve, out=tmp_path / "out")
    params = report.best["params"]
    assert params["materials.magnetic.remanence"] in ("100 mT", "200 mT")
    assert params["resolution.cells_across"] in (3, 4, 5)
    best = load_scene(tmp_path / "out/best/scene.yaml")
    assert (best.effects.gravity is None) == (params["effects.gravity"] is None)
    made = SearchSpace.of(study).scene_of(params)
    assert (best.body, best.field, best.materials, best.resolution) == (
        made.body,
        made.field,
        made.materials,
        made.resolution,
    )
    rms = root_mean_square(gaps(solve(best).centreline, study.target))
    assert rms == pytest.approx(report.best["rms_m"], rel=1e-9)


def test_values_that_are_no_scene_together_fail_their_trial(tmp_path: Path) -> None:
    """A bore as wide as the body, which each value alone is not; the reason is kept, and the search goes on and is resumed."""
    vary = """{magnetization: {}, numbers: [{of: body.catheter.diameter, choices: [3 mm, 5 mm]},
        {of: body.catheter.inner_diameter, min: 2.9 mm, max: 3.5 mm}]}"""
    study = load_study(write_study(tmp_path, study_of(vary)))
    run_study(study, solve=solve, out=tmp_path / "out", trials=5)
    report = run_study(study, solve=solve, out=tmp_path / "out")
    assert report.trials == 8
    assert 0 < report.failed < 8
    import optuna

    kept = optuna.load_study(
        study_name=study.name, storage=f"sqlite:///{tmp_path / 'out/study.db'}"
    )
    for trial in kept.trials:
        thin = trial.params["body.catheter.diameter"] == "3 mm"
        broken = thin and trial.params["body.catheter.inner_diameter (mm)"] >= 3.0
        assert trial.user_attrs["feasible"] != broken
        told = "must be less than the diameter"
        assert not broken or told in trial.user_attrs["reason"]


@pytest.mark.parametrize(
    ("number", "why"),
    [
        (
            "{of: materials.magnetic.remanence, choices: [100 mT, 200 mT]}",
            "gauss-newton can't choose among values of materials.magnetic.remanence",
        ),
        (
            "{of: body.catheter.inner_diameter, min: 1 mm, max: 2 mm}",
            "body.catheter.inner_diameter: it has no derivative",
        ),
        (
            "{of: resolution.cells_across, min: 3, max: 5}",
            "resolution.cells_across: must be the address of a real number",
        ),
    ],
)
def test_what_has_no_derivative_by_address_is_said_in_a_line(
    number: str, why: str, tmp_path: Path
) -> None:
    vary = f"{{magnetization: {{}}, numbers: [{number}]}}"
    study = load_study(write_study(tmp_path, study_of(vary).replace("sampler: random\n", "")))
    assert study.sampler == "tpe"
    assert why in str(study.why_sampler)
    text = study_of(vary).replace("random", "gauss-newton")
    newton = load_study(write_study(tmp_path, text))
    with pytest.raises(InputError, match="sampler: tpe") as error:
        check_suits(newton)
    assert why in str(error.value)


@pytest.mark.parametrize("sampler", ["random", "tpe"])
def test_a_number_by_its_address_is_that_of_its_key(sampler: str, tmp_path: Path) -> None:
    """The same trials, by another name of the parameter."""
    found = []
    for name, vary in (
        ("key", "{remanence: {min: 50 mT, max: 200 mT}}"),
        ("address", "{numbers: [{of: materials.magnetic.remanence, min: 50 mT, max: 200 mT}]}"),
    ):
        text = study_of(vary).replace("random", sampler)
        study = load_study(write_study(tmp_path / name, text))
        report = run_study(study, solve=solve, out=tmp_path / name / "out")
        found.append(report)
        best = load_scene(tmp_path / name / "out/best/scene.yaml")
        made = 1e3 * best.materials["magnetic"].remanence
        assert list(report.best["params"].values()) == pytest.approx([made], rel=1e-12)
    key, address = found
    assert address.rms_m == pytest.approx(key.rms_m, rel=1e-12)
    assert len(set(key.rms_m)) == 8
    assert list(address.best["params"]) == ["materials.magnetic.remanence (mT)"]


def test_derivatives_by_address_are_those_of_its_key(tmp_path: Path) -> None:
    """The same Gauss-Newton steps of the body itself."""
    found = []
    for name, vary in (
        ("key", "{magnetization: {}, remanence: {min: 50 mT, max: 200 mT}}"),
        (
            "address",
            "{magnetization: {}, numbers: [{of: materials.magnetic.remanence, min: 50 mT, max: 200 mT}]}",
        ),
    ):
        text = study_of(vary).replace("sampler: random\n", "").replace("trials: 8", "trials: 3")
        scene = SCENE.replace("cells_across: 4", "cells_across: 2")
        path = write_study(tmp_path / name, text, scene)
        assert load_study(path).sampler == "gauss-newton"
        found.append(magmpm.design(path, folder=tmp_path / name / "out", progress=False))
    key, address = found
    assert address.rms_m == pytest.approx(key.rms_m, rel=1e-9)
    assert min(key.rms_m[1:]) < key.rms_m[0]


def test_what_has_no_derivative_by_address_goes_by_tpe(tmp_path: Path) -> None:
    vary = "{numbers: [{of: materials.magnetic.bulk_to_shear, min: 10, max: 30}]}"
    text = study_of(vary).replace("sampler: random\n", "")
    assert load_study(write_study(tmp_path, text)).sampler == "gauss-newton"
    vary = "{numbers: [{of: resolution.particles_per_cell, min: 8.0, max: 27.0}]}"
    with pytest.raises(InputError, match=r"probe\.yaml"):
        load_study(write_study(tmp_path, study_of(vary)))


@pytest.mark.parametrize(
    ("number", "told"),
    [
        ("{of: materials.magnetic.remanense, min: 1 mT, max: 2 mT}", "did you mean"),
        ("{of: materials.magnetic.remanence, min: 0 mT, max: 2 mT, log: true}", "above 0"),
        ("{of: materials.magnetic.remanence, choices: [1 mT, 2 mm]}", "choices"),
        ("{of: body.catheter.diameter, min: -3 mm, max: 5 mm}", "the scene refuses it"),
        ("{of: materials.magnetic.remanence, direction: {}}", "an address of three numbers"),
        ("{of: field.uniform, within: 0 mT}", "must be above 0"),
        ("{of: materials.magnetic.remanence, min: 1 mm, max: 2 mm}", "the scene refuses it"),
        ("{of: materials.magnetic.remanence, min: 1, max: 2}", "a flux density needs a unit"),
        ("{of: 'body.catheter.segments[0].magnetization[1]', min: -1, max: 1}", "direction: {}"),
        ("{of: [], min: 1 mT, max: 2 mT}", "must have 1 or more entries"),
    ],
)
def test_wrong_numbers_of_shapes_are_refused(number: str, told: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"probe\.yaml:\d+: vary\.numbers") as error:
        load_study(write_study(tmp_path, study_of(f"{{numbers: [{number}]}}")))
    assert told in str(error.value)
    assert "remedy" in str(error.value)


def test_a_direction_out_of_its_plane_stays_near_its_part_in_the_plane(tmp_path: Path) -> None:
    """From +y and +z, across y: about +z, and not about an axis that has nothing to do with it."""
    at = "body.catheter.segments[0].magnetization"
    vary = f"{{numbers: [{{of: '{at}', direction: {{across: [0, 1, 0], at_most: 30 deg}}}}]}}"
    study = load_study(write_study(tmp_path, study_of(vary)))
    plain = study.scene.to_si()
    plain["body"]["catheter"]["segments"][0]["magnetization"] = [0, 1, 1]
    space = numbers_space(Scene.from_si(plain), study.vary)
    ((name, ends),) = space.bounds.items()
    for angle in ends:
        x, y, z = space.scene_of({name: angle}).regions()[0].magnetization
        assert (abs(x), y, z) == pytest.approx((0.5, 0.0, 0.75**0.5), abs=1e-12)


def test_choices_alone_go_by_tpe(tmp_path: Path) -> None:
    """They have no derivatives that could be asked for."""
    vary = "{numbers: [{of: body.catheter.diameter, choices: [3 mm, 4 mm]}]}"
    text = study_of(vary).replace("sampler: random\n", "")
    assert load_study(write_study(tmp_path, text)).sampler == "tpe"


@pytest.mark.parametrize("of", ["body.catheter.material", "'body.catheter.segments[0].material'"])
def test_no_material_is_chosen_for_segments_that_have_their_own(of: str, tmp_path: Path) -> None:
    """The chosen one would take the place of that whose number varies, which would then change nothing."""
    modulus = "shear_modulus: {min: 60 kPa, max: 300 kPa, per: %s}"
    vary = f"{{{modulus}, numbers: [{{of: {of}, choices: [magnetic, plain]}}]}}"
    assert load_study(write_study(tmp_path, study_of(vary % "material"), MIXED)).vary.numbers
    with pytest.raises(InputError, match="is varied twice"):
        load_study(write_study(tmp_path, study_of(vary % "segment"), MIXED))


def test_a_number_is_not_varied_twice(tmp_path: Path) -> None:
    vary = "{remanence: {min: 50 mT, max: 200 mT}, numbers: [{of: materials.magnetic.remanence, min: 50 mT, max: 90 mT}]}"
    with pytest.raises(InputError, match="is varied twice"):
        load_study(write_study(tmp_path, study_of(vary)))


@pytest.mark.parametrize("total", ["keep", "free"])
def test_parameters_and_coordinates_are_inverse(total: str, tmp_path: Path) -> None:
    space = space_of(tmp_path, total)
    rng = np.random.default_rng(1)
    assert space.size == 3 * 3 + 3 + 5 + 1 + 3 + 5
    assert space.freedom == 3 * 2 + 3 + 5 + 1 + 3 + 5 - (total == "keep")
    for _ in range(20):
        x = space.drawn(rng)
        parameters = space.parameters_at(x, {"order": "MMMPP"})
        assert set(parameters) == set(space.distributions())
        assert all(
            space.distributions()[name]._contains(space.distributions()[name].to_internal_repr(v))
            for name, v in parameters.items()
        )
        np.testing.assert_allclose(space.embedded(parameters), x, atol=1e-12)  # rounding of angles
        again = space.parameters(*space.design(parameters))
        np.testing.assert_allclose(space.embedded(again), x, atol=1e-12)


@pytest.mark.parametrize("order", [None, "PPMMM"])
@pytest.mark.parametrize(("total", "per"), [("keep", "segment"), ("free", "material")])
def test_the_file_of_a_design_is_its_scene(
    total: str, per: str, order: str | None, tmp_path: Path
) -> None:
    """To the last bit: as the trial had it, so does who runs the file."""
    space = space_of(tmp_path, total, per)
    x = space.drawn(np.random.default_rng(4))
    content = moved_content(tmp_path / "scene.yaml", tmp_path)
    parameters = space.parameters_at(x, {"order": order} if order else None)
    space.write(content, parameters)
    (tmp_path / "design.yaml").write_text(as_yaml(content), encoding="utf-8")
    again = load_scene(tmp_path / "design.yaml")
    scene = space.scene_of(parameters)
    assert (again.body, again.field, again.materials) == (
        scene.body,
        scene.field,
        scene.materials,
    )


def test_a_scene_has_the_values_of_its_design(tmp_path: Path) -> None:
    space = space_of(tmp_path, "free")
    x = space.drawn(np.random.default_rng(2))
    parameters = space.parameters_at(x, {"order": "PPMMM"})
    scene = space.scene_of(parameters)
    assert 1e3 * scene.thickness == pytest.approx(parameters["diameter_mm"], rel=1e-14)
    lengths = [
        parameters[f"segment_{i}_length_mm"] for i in (2, 5, 1, 3, 4)
    ]  # the plain ones, 2 and 5, are first
    assert scene.body.shape.segment_lengths() == pytest.approx(
        [1e-3 * length for length in lengths], rel=1e-14
    )
    assert scene.length == pytest.approx(1e-3 * sum(lengths), rel=1e-14)
    known = space.quantities(parameters)
    assert known["segment_lengths_m"] == pytest.approx(
        scene.body.shape.segment_lengths(), rel=1e-14
    )
    for i, piece in enumerate((2, 5, 1, 3, 4)):
        material = scene.region_material(i)
        assert 1e-3 * material.shear_modulus == pytest.approx(
            parameters[f"segment_{piece}_shear_modulus_kPa"], rel=1e-14
        )
        if piece not in (2, 5):
            assert 1e3 * material.remanence == pytest.approx(
                parameters[f"segment_{piece}_remanence_mT"], rel=1e-14
            )
    assert scene.magnetized_regions() == [2, 3, 4]
    np.testing.assert_allclose(
        space.directions(parameters), [r.magnetization for r in scene.regions()], atol=1e-15
    )


def test_values_per_material_are_shared(tmp_path: Path) -> None:
    space = space_of(tmp_path, per="material")
    assert {
        "remanence_of_magnetic_mT",
        "shear_modulus_of_magnetic_kPa",
        "shear_modulus_of_plain_kPa",
    } <= set(space.bounds)
    scene = space.scene_at(space.drawn(np.random.default_rng(2)))
    assert set(scene.materials) == {"magnetic", "plain"}


@pytest.mark.parametrize(
    "remanence",
    [
        "remanence: {min: 50 mT, max: 200 mT}",
        "numbers: [{of: materials.magnetic.remanence, min: 50 mT, max: 200 mT}]",
    ],
)
def test_a_materials_number_is_that_of_all_its_segments(remanence: str, tmp_path: Path) -> None:
    """Also where another number gives each segment a material of its own: in scenes, in files, and in derivatives."""
    vary = f"{{{remanence}, shear_modulus: {{min: 60 kPa, max: 300 kPa, per: segment}}}}"
    space = SearchSpace.of(load_study(write_study(tmp_path, study_of(vary))))
    x = np.full(space.size, 0.1)
    scene = space.scene_at(x)
    parameters = space.parameters_at(x)
    assert {scene.region_material(i).remanence for i in range(5)} == {0.065}
    content = moved_content(tmp_path / "scene.yaml", tmp_path)
    space.write(content, parameters)
    (tmp_path / "design.yaml").write_text(as_yaml(content), encoding="utf-8")
    assert load_scene(tmp_path / "design.yaml").materials == scene.materials
    assert_chain(space)


def test_kept_lengths_are_the_nearest_that_sum(tmp_path: Path) -> None:
    """A projection: sum and bounds hold, what obeys both stays, and the error is across all that does (the variational inequality)."""
    rng = np.random.default_rng(3)
    low = 4.0
    high = 12.0
    total = 40.0
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
        np.testing.assert_allclose(
            kept_total(asked + step, low, high, total)[0], found + derivative @ step, atol=1e-12
        )


def test_orders_are_all_ways_to_place_the_magnets(tmp_path: Path) -> None:
    space = space_of(tmp_path)
    assert len(orders(space.scene)) == len(set(orders(space.scene))) == 10  # 3 of 5 places
    assert orders(space.scene, own=True) == ("MPMMP",)
    same = space.scene_at(x := space.drawn(np.random.default_rng(0)), {"order": "MPMMP"})
    own = space.scene_at(x)
    assert same.hash() == own.hash()


def test_a_body_that_is_shorter_than_its_target_is_compared_with_its_tip(tmp_path: Path) -> None:
    """So that it gains nothing by being short: a straight body of half the length along a straight target."""
    scene = load_scene(write_study(tmp_path).parent / "scene.yaml").with_field([0, 0, 0])
    data = scene.to_si()
    data["body"]["catheter"]["length"] = 0.02
    s = np.linspace(0.0, 0.04, 41)
    target = np.column_stack([s, s, 0 * s, 0 * s])
    apart = gaps(solve(Scene.from_si(data)).centreline, target)
    np.testing.assert_allclose(apart[:, 0], np.minimum(s, 0.02) - s, atol=1e-9)
    assert root_mean_square(gaps(solve(scene).centreline, target)) < 1e-9


@pytest.mark.parametrize("sampler", ["random", "tpe"])
def test_a_study_of_everything_writes_its_best_design(
    sampler: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also its report has the values; the file is a scene with units that has the trial's rms."""
    text = study_of(EVERYTHING % ("keep", "segment", "segment")).replace("random", sampler)
    path = write_study(tmp_path, text, MIXED)
    report = run_study(load_study(path), solve=solve, out=tmp_path / "out")
    monkeypatch.chdir("/")
    scene = load_scene(tmp_path / "out/best/scene.yaml")
    assert scene.length == 0.04
    assert report.best["segment_lengths_m"] == pytest.approx(
        scene.body.shape.segment_lengths(), rel=1e-9
    )
    assert report.best["diameter_m"] == pytest.approx(scene.thickness, rel=1e-12)
    rms = root_mean_square(gaps(solve(scene).centreline, load_study(path).target))
    assert rms == pytest.approx(report.best["rms_m"], rel=1e-9)  # 15 digits are written


def test_tpe_returns_to_good_orders(tmp_path: Path) -> None:
    """Nine of ten orders can't reach a target made with the tenth: the good order is chosen more often than the tenth part of trials."""
    text = (
        study_of("{magnetization: {}, order: {}}")
        .replace("random", "tpe")
        .replace("trials: 8", "trials: 40")
    )
    path = write_study(tmp_path, text, MIXED)
    study = load_study(path)
    report = run_study(study, solve=solve, out=tmp_path / "out")
    import optuna

    kept = optuna.load_study(
        study_name=study.name, storage=f"sqlite:///{tmp_path / 'out/study.db'}"
    )
    chosen = [trial.params["order"] for trial in kept.trials[10:]]
    assert chosen.count(report.best["params"]["order"]) > len(chosen) / 10


# Designs that are evaluated can be made: directions of a set, at most k different ones, by every sampler


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
        best = max(
            (asked @ AXES[list(pair)].T).max(axis=1).sum()
            for pair in itertools.combinations(range(6), 2)
        )
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
    limits = Makeable(None, 2)
    asked = unit(rng, 5)
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
        np.testing.assert_allclose(
            chained[:, j], (ends[0] - ends[1]) / 2e-5, atol=1e-5 * np.abs(chained).max()
        )


GAUSS_NEWTON = [
    ("gauss-newton", limits)
    for limits in (SET + "}", SET + ", at_most: 2}", "limits: {at_most: 2}")
]


@pytest.mark.parametrize(
    ("sampler", "limits"), [("random", SET + ", at_most: 2}"), *GAUSS_NEWTON[1:]]
)
def test_every_trial_can_be_made(sampler: str, limits: str, tmp_path: Path) -> None:
    text = STUDY.replace("random", sampler) + limits + "\n"
    study = load_study(write_study(tmp_path, text))
    report = run_study(study, solve=solve, differentiate=differentiate, out=tmp_path / "out")
    import optuna

    kept = optuna.load_study(
        study_name=study.name, storage=f"sqlite:///{tmp_path / 'out/study.db'}"
    )
    allowed = {tuple(row) for row in AXES.tolist()}
    for trial in kept.trials:
        made = {tuple(np.round(row, 9) + 0.0) for row in trial.user_attrs["magnetization"]}
        assert "at_most" not in limits or len(made) <= 2
        assert "directions" not in limits or made <= allowed
    scene = load_scene(tmp_path / "out/best/scene.yaml")
    np.testing.assert_allclose(
        [region.magnetization for region in scene.regions()],
        report.best["magnetization"],
        atol=1e-8,
    )


def test_gauss_newton_is_better_than_snapping(tmp_path: Path) -> None:
    """Against 300 random designs of the set: the search from the rod's designs finds one as near as the best of these, in 6 trials."""
    study = load_study(
        write_study(
            tmp_path,
            STUDY.replace("random", "gauss-newton").replace("trials: 8", "trials: 6") + SET + "}\n",
        )
    )
    best = run_study(study, solve=solve, differentiate=differentiate, out=tmp_path / "out").best[
        "rms_m"
    ]
    space = SearchSpace.of(study)
    rng = np.random.default_rng(1)
    others = [
        root_mean_square(gaps(solve(space.scene_at(space.drawn(rng))).centreline, study.target))
        for _ in range(300)
    ]
    assert best <= min(others) + 1e-5


@pytest.mark.parametrize(
    ("more", "field"),
    [
        ("}", ""),
        pytest.param(", at_most: 2}", "", marks=pytest.mark.slow),
        (", at_most: 2}", "  field: {max: 20 mT}\n"),
    ],
)
def test_no_single_exchange_is_better_on_the_body(more: str, field: str, tmp_path: Path) -> None:
    """The body is softer than the rod by which starts are found, so its best exchange is not the body's. A field that varies goes on."""

    def soft(scene: Scene) -> Scene:
        data = scene.to_si()
        data["materials"]["magnetic"]["shear_modulus"] *= 0.6
        return Scene.from_si(data)

    def body(scene: Scene) -> Any:
        return solve(soft(scene))

    text = (
        STUDY.replace("trials: 8", "trials: 2").replace("{}\n", "{}\n" + field) + SET + more + "\n"
    )
    study = load_study(
        write_study(tmp_path, text.replace("random", "gauss-newton" if field else "random"))
    )
    solves = {"solve": body, "differentiate": lambda scene, of: differentiate(soft(scene), of)}
    report = run_study(study, **solves, out=tmp_path / "out")
    space = SearchSpace.of(study)
    x = space.made(space.embedded(report.best["params"]))
    others = [
        root_mean_square(gaps(body(space.scene_at(y)).centreline, study.target))
        for y in _exchanges(space, x)
    ]
    assert not field or report.best["rms_m"] < 0.75 * min(report.rms_m[:2]), (
        "no exchange is better, but another field is"
    )
    assert len(others) >= 5
    assert report.best["rms_m"] <= min(others)
    assert report.trials == 2 + report.exchanged
    assert f"{report.exchanged} exchanged single directions" in report.why
    again = run_study(study, **solves, out=tmp_path / "out")
    assert again.trials == report.trials, "nothing is left to be exchanged"
