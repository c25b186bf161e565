"""Designs that the rod finds, and studies that begin with them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rod_solve import SCENE, STUDY, differentiate, solve, write_study
from test_resume import kill_in_trial, same, trials_of

from magmpm.compiled.arrays import Array
from magmpm.errors import InputError
from magmpm.inputs.csv_tables import write_centreline
from magmpm.rod.cosserat import solve_rod
from magmpm.scene import Scene, load_scene
from magmpm.studies.engine.explain_miss import _bound, reachable_curvature, target_bends
from magmpm.studies.engine.loop import run_study
from magmpm.studies.engine.report import StudyReport
from magmpm.studies.rods.rod_designs import RodDesign, RodForetells, rod_designs, rod_starts
from magmpm.studies.search.definition import load_study
from magmpm.studies.search.scene_edits import within
from magmpm.studies.search.search_space import SearchSpace
from magmpm.studies.search.well_posed import check_search, identifiability

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


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(k, marks=pytest.mark.slow) for k in (2, 3))])
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
    np.testing.assert_allclose(
        [np.linalg.norm(d.directions, axis=1) for d in found], 1, rtol=0, atol=1e-12
    )
    assert found[0].rms == pytest.approx(rms(found[0], scene, [0, 1, 2, 3, 4], target), rel=1e-9)
    assert all(
        np.abs(a.directions - b.directions).max() > 0.1
        for i, a in enumerate(found)
        for b in found[:i]
    )


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
    dipole = (
        "field: {uniform: [0 mT, 6 mT, 8 mT], dipole: {position: [50 mm, 60 mm, 0 mm], moment: [0 A"
        " m^2, 6 A m^2, 0 A m^2]}}"
    )
    text = SCENE.replace("field: {uniform: [0 mT, 6 mT, 8 mT]}", dipole)
    text = text.replace("magnetic_torque: {}", "magnetic_torque: {}, magnetic_force: {}")
    scene = scene_of(tmp_path, text)
    target = shape_of(scene.with_magnetizations(np.random.default_rng(3).normal(size=(5, 3))))
    found = rod_designs(scene, target, range(5), None, seed=1)
    assert found[0].rms < 3e-3 * scene.length


ARM = """\
name: arm
materials: {arm: {shear_modulus: 80 kPa, bulk_to_shear: 20, density: 1882 kg/m^3, remanence: 100 mT}}
body:
  strip: {length: 14 mm, width: 4 mm, thickness: 1.2 mm, material: arm, segments: [{magnetization: [1, 0, 0]}, {magnetization: [1, 0, 0]}]}
field: {uniform: [0 mT, 0 mT, 10 mT]}
effects: {magnetic_torque: {}, gravity: {}}
resolution: {cells_across: 2}
"""
FOLDED = np.array([[7.0, 6.3, 0.0, 2.6], [14.0, 6.0, 0.0, 9.3]]) / 1e3


def arm_in(folder: Path) -> Scene:
    path = folder / "arm.yaml"
    path.write_text(ARM)
    return load_scene(path)


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_what_a_weaker_field_reaches_a_stronger_one_reaches(seed: int, tmp_path: Path) -> None:
    """A strip whose tip folds back has mirrored equilibria; within no bound are the designs worse than within a smaller one.

    Tolerances: 5 % is what the issue allows, and a thousandth of the length is how near a rod of so many elements is to its limit.
    """
    scene = arm_in(tmp_path)
    least = np.inf
    for bound in (10e-3, 12e-3, 14e-3):
        found = rod_designs(scene, FOLDED, [0, 1], bound, seed=seed)
        assert all(np.linalg.norm(design.field) <= bound * (1 + 1e-12) for design in found)
        rms = min(design.rms for design in found)
        assert rms <= max(1.05 * least, least + 1e-3 * scene.length)
        least = min(least, rms)
    assert least < 0.01 * scene.length, "14 mT fold the tip back to a hundredth of the length"


CATHETER = """\
name: turned
materials: {magnetic: {shear_modulus: 85.805 kPa, bulk_to_shear: 20, density: 1900 kg/m^3, remanence: 108.638 mT}}
body:
  catheter:
    length: 19.863 mm
    diameter: 1.387 mm
    material: magnetic
    segments: [{magnetization: [1, 0, 0]}, {magnetization: [1, 0, 0]}, {magnetization: [1, 0, 0]}]
field: {uniform: [0 mT, 0 mT, 4 mT]}
effects: {magnetic_torque: {}, gravity: {}}
resolution: {cells_across: 2}
"""
TURNED = (
    np.array(
        [
            [3.311, 3.153, -0.822, -0.174],
            [6.621, 4.856, -3.502, -0.605],
            [9.932, 3.888, -6.567, -0.839],
            [13.242, 1.288, -8.565, -0.655],
            [16.553, -1.749, -9.802, -0.222],
            [19.863, -4.859, -10.812, 0.293],
        ]
    )
    / 1e3
)


@pytest.mark.slow
def test_a_search_goes_on_where_the_rod_is_about_to_snap(tmp_path: Path) -> None:
    """A catheter that turns by most of a circle, in less field than that needs: its best designs are about to snap, where descents end.

    Tolerance: from three seeds, 7.1 to 8.9 % of the length where descents ended there, and 4.5 to 5.4 % where they go on.
    """
    path = tmp_path / "scene.yaml"
    path.write_text(CATHETER)
    scene = load_scene(path)
    found = [rod_designs(scene, TURNED, [0, 1, 2], 7.85e-3, seed=seed)[0].rms for seed in (1, 2, 3)]
    assert max(found) < 0.06 * scene.length


def test_within_a_bound_of_a_front_designs_are_about_as_good_as_within_it_alone(
    tmp_path: Path,
) -> None:
    """A catheter that turns by half a circle, in half of the field that a front may use.

    Designs of other bounds, shortened, ended twice as far from the target as those of a search within this one alone.
    """
    scene = CATHETER.replace("19.863 mm", "30 mm").replace("1.387 mm", "2.4 mm")
    scene = scene.replace("85.805 kPa", "150 kPa").replace("108.638", "110")
    path = write_study(tmp_path, FIELD.replace("10 mT", "30 mT"), scene)
    turn = np.linspace(0.0, np.pi, 9)
    half = 30e-3 / np.pi * np.stack([turn, np.sin(turn), 0 * turn, 1 - np.cos(turn)], axis=1)
    write_centreline(tmp_path / "target.csv", half)
    study = load_study(path)
    space = SearchSpace.of(study)
    model = RodForetells.of(space, half)
    assert model is not None
    found = model.improved(0.5, rod_starts(space, half, 1, by_bound=True))
    alone = rod_designs(study.scene, half, [0, 1, 2], 15e-3)
    assert all(start["field_mT"] <= 15 * (1 + 1e-12) for _, start in found)
    assert found[0][0] < 1.5 * alone[0].rms


def test_designs_of_rods_are_on_the_branch_that_grows_from_no_load(tmp_path: Path) -> None:
    """The best design does not fold the strip to the wrong side, where descents from one shape to the next ended, 15 mm away."""
    scene = arm_in(tmp_path)
    found = rod_designs(scene, FOLDED, [0, 1], 8e-3, seed=1)
    straight = FOLDED[:, 1:] - np.column_stack([FOLDED[:, 0], 0 * FOLDED[:, :2]])
    assert found[0].rms < 0.2 * np.sqrt(np.mean(np.sum(straight**2, axis=1))), (
        "nearer than the straight body, which is 8.9 mm away"
    )


def test_the_same_seed_gives_the_same_designs(tmp_path: Path) -> None:
    scene = scene_of(tmp_path)
    target = shape_of(scene)
    one, same_seed, other = (
        rod_designs(scene, target, range(5), None, seed=s, starts=16) for s in (1, 1, 2)
    )
    assert [d.directions.tolist() for d in one] == [d.directions.tolist() for d in same_seed]
    assert one[0].directions.tolist() != other[0].directions.tolist()


def test_studies_begin_with_them_and_say_so(tmp_path: Path) -> None:
    report = run_study(
        load_study(write_study(tmp_path, START)),
        solve=solve,
        out=tmp_path / "out",
        sampler="random",
    )
    plain = run_study(
        load_study(write_study(tmp_path / "plain")),
        solve=solve,
        out=tmp_path / "plain/out",
        sampler="random",
    )
    trials = trials_of(tmp_path / "out")
    begun = [t for t in trials if t.user_attrs.get("start") == "rod"]
    assert [t.number for t in begun] == list(range(len(begun)))
    assert 1 <= len(begun) <= 6
    assert max(t.value for t in begun) < 0.05 * 40.0, "the tests' solve is a rod, a coarser one"
    assert report.trials == plain.trials == 8
    rest = [t.params for t in trials[len(begun) :]]
    assert rest == [t.params for t in trials_of(tmp_path / "plain" / "out")[len(begun) :]], (
        "the others are those of the sampler"
    )


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
    whole = tmp_path / "whole"
    parts = tmp_path / "parts"
    run_study(
        load_study(path), solve=solve, differentiate=differentiate, out=whole, sampler=sampler
    )
    kill_in_trial(path, parts, sampler, 2, "solve")
    kill_in_trial(path, parts, sampler, 1, "tell")
    run_study(
        load_study(path), solve=solve, differentiate=differentiate, out=parts, sampler=sampler
    )
    same(trials_of(whole), trials_of(parts))


# Reasons that a study gives for a target that it can't reach: curvature, the field's bound, directions without effect, other starts


S = np.linspace(0.0, 0.04, 21)
NEWTON = STUDY.replace("sampler: random", "sampler: gauss-newton") + "stop: {rms: 0.1 mm}\n"
WEAK = NEWTON.replace("magnetization: {}", "magnetization: {}\n  field: {max: 1 mT}")


def study_of(
    folder: Path, target: Array, text: str = NEWTON, scene: str = SCENE, **options: Any
) -> StudyReport:
    path = write_study(folder, text, scene)
    write_centreline(folder / "target.csv", target)
    return run_study(
        load_study(path), solve=solve, differentiate=differentiate, out=folder / "out", **options
    )


def shape(scene: Scene) -> Array:
    return np.column_stack([S, solve_rod(scene, 20).at(S)])


def arc(angle: float) -> Array:
    """A circular arc that turns by an angle, rad."""
    k = angle / 0.04
    return np.column_stack([S, np.sin(k * S) / k, (1 - np.cos(k * S)) / k, 0 * S])


def said(report: StudyReport) -> dict[str, Any]:
    return {one["what"]: one for one in report.limits}


def test_a_target_that_is_reached_needs_no_explanation(tmp_path: Path) -> None:
    target = shape(
        scene_of(tmp_path).with_magnetizations(np.random.default_rng(1).normal(size=(5, 3)))
    )
    report = study_of(tmp_path, target)
    assert report.ended == "stop"
    assert report.limits == []


def test_a_field_at_its_bound_is_said_with_what_more_would_bring(tmp_path: Path) -> None:
    """A shape made in 8 mT, searched in 1: the multiplier foretells what a bound 0.05 mT higher brings."""
    scene = (
        scene_of(tmp_path)
        .with_magnetizations(np.eye(3)[[1, 1, 1, 1, 1]])
        .with_field([-3e-3, 0, 7.4e-3])
    )
    report = study_of(tmp_path / "a", shape(scene), WEAK)
    found = said(report)
    assert found["field"]["bound_T"] == 1e-3
    assert found["field"]["rms_per_T"] < 0
    assert "field_mT is at its bound, 1 mT" in found["field"]["says"]
    stronger = found["stronger field"]
    assert stronger["field_T"][0] == 1e-3
    assert stronger["rms_m"][-1] <= 1e-4, "in some stronger field the rod reaches it"
    assert stronger["rms_m"] == sorted(stronger["rms_m"], reverse=True), (
        "what a field reaches, every stronger one reaches too"
    )
    more = study_of(tmp_path / "b", shape(scene), WEAK.replace("max: 1 mT", "max: 1.05 mT"))
    gained = report.best["rms_m"] - more.best["rms_m"]
    assert gained == pytest.approx(
        -0.05e-3 * found["field"]["rms_per_T"], rel=0.3
    )  # second order, and where descents stop


@pytest.mark.parametrize(
    ("at", "slope", "says"),
    [
        (1.0, -2e-3, "upper bound, 20:"),
        (0.0, 2e-3, "lower bound, 10:"),
        (1.0, 2e-3, None),
        (0.0, -2e-3, None),
        (0.5, -2e-3, None),
    ],
)
def test_a_number_is_said_to_be_at_its_bound_where_beyond_it_would_be_better(
    at: float, slope: float, says: str | None
) -> None:
    """By 2 mm of rms a whole range, 10 mm: by 0.2 mm of rms a millimeter."""
    found = _bound(
        within("length_mm", "length", (10e-3, 20e-3), 1e3, ()), np.array([at]), np.array([slope])
    )
    assert (found is None) is (says is None)
    if found is not None:
        assert f"length_mm is at its {says}" in found["says"]
        assert "lower the rms by 0.2 mm" in found["says"]
        assert found["rms_per_unit"] == pytest.approx(-0.2)


def test_curvature_beyond_the_segments_is_said_with_its_place(tmp_path: Path) -> None:
    """An arc of 270 degrees: the tip can't bend, because nothing is beyond it."""
    found = said(study_of(tmp_path, arc(1.5 * np.pi)))["curvature"]
    assert found["target_per_m"] == pytest.approx(1.5 * np.pi / 0.04, rel=1e-2)
    assert found["reachable_per_m"] < found["target_per_m"]
    assert 0 <= found["s_m"][0] < found["s_m"][1] <= 0.04
    assert "bends with a radius of 8.49 mm" in found["says"]


def test_no_rod_bends_more_than_is_said_to_be_reachable(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    scene = scene_of(tmp_path)
    for gravity in (None, {}):
        s, most = reachable_curvature(scene.with_effects(gravity=gravity), None)
        for _ in range(20):
            rod = solve_rod(
                scene.with_effects(gravity=gravity).with_magnetizations(rng.normal(size=(5, 3)))
            )
            bends = np.linalg.norm(rod.curvature[:, 1:], axis=1)
            # frames average the elements beside them; the bound falls toward the tip
            assert (bends[1:-1] <= np.interp(rod.s[1:-1], s, most) * (1 + 1e-6) + most[-1]).all()
    across = scene.with_magnetizations(np.tile([0, 0.8, -0.6], (5, 1))).with_field([1e-3, 0, 0])
    s, most = reachable_curvature(
        across, None
    )  # across the axis and the field, and hardly bent: the torque is all that it can be
    assert np.linalg.norm(solve_rod(across).curvature[0, 1:]) > 0.95 * most[0]
    np.testing.assert_allclose(
        most / most[0], (scene.length - s) / (scene.length - s[0]), rtol=1e-9
    )  # torques of what is beyond alone


def test_bends_of_a_circle_are_one_over_its_radius() -> None:
    ends, bends = target_bends(arc(1.0), 0.002)
    np.testing.assert_allclose(bends, 1.0 / 0.04, rtol=1e-3)
    assert ends[0, 0] == 0
    coarse = target_bends(arc(1.0), 0.004)
    assert len(coarse[1]) == 10


def test_a_direction_that_moves_nothing_is_named(tmp_path: Path) -> None:
    """The last segment is all but free of remanence."""
    material = (
        "{shear_modulus: 120 kPa, bulk_to_shear: 20, density: 1882 kg/m^3, remanence: 0.01 mT}"
    )
    weak = SCENE.replace("remanence: 138 mT}", f"remanence: 138 mT}}\n  weak: {material}")
    weak = weak.replace(
        "- magnetization: [0, 0, -1]", "- {magnetization: [0, 0, -1], material: weak}"
    )
    found = said(study_of(tmp_path, arc(0.5 * np.pi), scene=weak))
    assert "segment_5" in found
    assert found["segment_5"]["m_per_rad"] < 1e-5
    assert "segment_4" not in found


def test_where_other_starts_ended_is_told(tmp_path: Path) -> None:
    report = study_of(tmp_path, arc(1.2 * np.pi), trials=16)
    others = said(report)["other starts"]["rms_m"]
    assert others == sorted(others)
    assert len(others) >= 1
    assert others[0] >= report.best["rms_m"]


def test_a_search_that_was_cut_short_says_so(tmp_path: Path) -> None:
    found = said(
        study_of(tmp_path, shape(scene_of(tmp_path)), NEWTON.replace("0.1 mm", "1e-6 mm"), trials=1)
    )
    assert "still getting better" in found["trials"]["says"]


def test_directions_of_a_set_are_not_called_without_effect(tmp_path: Path) -> None:
    """They have no derivative; the derivative of what is made is zero, but another direction of the set moves the shape."""
    limits = "limits: {directions: [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]]}\ntrials: 2\n"
    report = study_of(tmp_path, arc(1.0), WEAK.replace("trials: 8\n", limits))
    assert report.limits, "it misses its stop"
    assert not [one for one in report.limits if one["what"].startswith("segment")]


# Warnings of a study before its first trial: that nothing moves the shape, or that the target can't tell its variables apart


STRAIGHT = SCENE.replace("[0 mT, 6 mT, 8 mT]", "[9 mT, 0 mT, 0 mT]")
ALONG = "\n".join(
    "      - magnetization: [1, 0, 0]" if "- magnetization" in line else line
    for line in STRAIGHT.split("\n")
)


def varied_study(folder: Path, vary: str, scene: str = SCENE, points: int = 20):
    path = write_study(folder, STUDY.replace("\n  magnetization: {}", f" {vary}"), scene)
    s = np.linspace(0.0, 0.04, points + 1)
    write_centreline(folder / "target.csv", np.column_stack([s, 0.99 * s, 0.1 * s, 0 * s]))
    return load_study(path)


def test_a_good_study_has_nothing_to_say(tmp_path: Path) -> None:
    study = varied_study(tmp_path, "{magnetization: {}}")
    assert check_search(study, SearchSpace.of(study)) == []
    found = identifiability(study, SearchSpace.of(study))
    assert found.freedom == found.seen == 10
    assert (found.moves > 1e-4).all(), "each turns the catheter by a radian's worth of some segment"


def test_nothing_that_varies_moves_the_shape(tmp_path: Path, told) -> None:
    """A field along a catheter that is magnetized along its axis bends nothing, whatever its remanence; it stretches less than counts."""
    study = varied_study(tmp_path, "{remanence: {min: 10 mT, max: 10.1 mT}}", ALONG)
    out = tmp_path / "out"
    parts = (
        "probe.yaml: vary: received 1 variable that moves",
        "at most",
        "something must move the shape",
        "remedy",
    )
    assert told("design", study.path, "--out", out, "--no-pictures", status=2, says=parts).out == ""
    assert not out.exists()


def test_more_variables_than_the_target_can_tell_apart(tmp_path: Path) -> None:
    """Two points beyond the base are six numbers, and ten angles vary: said with both numbers, and the study runs."""
    study = varied_study(tmp_path, "{magnetization: {}}", points=2)
    said = []
    report = run_study(study, solve=solve, out=tmp_path / "out", trials=1, on_advice=said.extend)
    assert said == report.warnings
    assert len(said) == 1
    assert "10 numbers vary" in said[0]
    assert "2 points beyond the base distinguish only 6 combinations of them" in said[0]


def test_a_field_and_directions_share_a_turn_only_if_all_turn(tmp_path: Path) -> None:
    """Field and magnetization may turn together about the axis, and the shape with them: the target tells all 13 numbers apart."""
    study = varied_study(tmp_path, "{magnetization: {}, field: {max: 10 mT}}")
    found = identifiability(study, SearchSpace.of(study))
    assert found.freedom == 13
    assert 11 <= found.seen <= 13


@pytest.mark.parametrize(
    ("sampler", "extra", "said"),
    [
        ("gauss-newton", "", "gauss-newton differentiates equilibria, and the scene is a motion"),
        (
            "tpe",
            "minimize: [rms, largest_field]\nrobust: {direction: 5 deg}\n",
            "`robust` judges a design by one objective",
        ),
        (
            "cmaes",
            "stability: {margin: 0.1}\n",
            "cmaes would learn from designs that `stability` refuses",
        ),
    ],
)
def test_the_command_leaves_nothing_of_what_its_sampler_cannot_search(
    sampler: str, extra: str, said: str, tmp_path: Path, told
) -> None:
    """With the sampler of the command line, too; the message names the study file."""
    study = varied_study(tmp_path, "{magnetization: {}, field: {max: 10 mT}}").path
    study.write_text(study.read_text() + extra)
    if not extra:
        scene = tmp_path / "scene.yaml"
        scene.write_text(scene.read_text() + "\nsolver: {dynamic: {duration: 1 ms}}\n")
    out = tmp_path / "out"
    told(
        "design",
        study,
        "--sampler",
        sampler,
        "--out",
        out,
        "--no-pictures",
        status=2,
        says=(said, "probe.yaml: "),
    )
    assert not out.exists()


def test_orders_alone_have_no_derivatives_and_are_not_judged(tmp_path: Path) -> None:
    plain = "      - {}\n"
    last = [line for line in SCENE.split("\n") if "- magnetization" in line][-1] + "\n"
    study = varied_study(tmp_path, "{order: {}}", SCENE.replace(last, plain))
    assert check_search(study, SearchSpace.of(study)) == []


def test_an_insertion_is_judged_at_its_depths() -> None:
    """Fields of their own at three depths: a variable moves the shapes that have it, and all numbers but few can be told apart."""
    from test_insertion import insertion

    found = insertion()
    seen = identifiability(found.study, found.space)
    assert seen.freedom == 15
    assert len(seen.moves) == 15
    assert (seen.moves > 1e-5).all()
    assert 12 <= seen.seen <= 15


def test_an_insertion_that_nothing_moves_is_refused() -> None:
    """Segments whose remanence alone varies, without a field: said before the first trial."""
    from dataclasses import replace

    from test_insertion import insertion

    from magmpm.studies.problem.variables import Vary, VaryRemanence

    found = insertion()
    assert found.study.scene.field.uniform == (
        0.0,
        0.0,
        0.0,
    ), "a remanence that varies needs a field to move anything"
    study = replace(
        found.study, vary=Vary(remanence=VaryRemanence(min=0.1, max=0.1001)), sampler="tpe"
    )
    with pytest.raises(InputError, match="something must move the shape"):
        check_search(study, SearchSpace.of(study))


def test_where_neither_directions_nor_field_vary_the_rod_divides_by_no_count(
    tmp_path: Path,
) -> None:
    """A search of other numbers alone begins from the scene as it is."""
    scene = scene_of(tmp_path)
    with np.errstate(all="raise"):
        (found,) = rod_designs(scene, shape_of(scene), [], None)
    assert found.rms < 1e-9
